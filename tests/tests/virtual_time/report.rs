//! Reports: the pictures of a flight are the same each time, and their page needs no other file.

use std::fs;
use std::path::Path;
use std::process::ExitCode;

use clap::Parser;
use skein::cli::{self, Cli};
use skein_common::scenario::Scenario;
use skein_lab::metrics::Run;
use skein_lab::metrics::figures::FIGURES;
use skein_lab::recording::Recording;
use skein_lab::report::figure::{Colour, Drawing, Item, Marker, Name, Shape, escaped};
use skein_lab::report::flight;
use skein_lab::report::page::Tone;
use skein_lab::report::verdict;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::study::Study;
use skein_lab::study::record_run;
use skein_tests::{of_scenario, scenario};

fn record(study: &Study, rate_hz: f64) -> Recording {
    let scenario = &study.scenario;
    let mut recording = Recording::new(scenario, Run::new(scenario, "study"));
    study.fly_watched(scenario.seed, Some((&mut recording, rate_hz))).unwrap();
    recording
}

fn recorded(name: &str, sets: &[&str], rate_hz: f64) -> Recording {
    record(&of_scenario(scenario(name, sets)), rate_hz)
}

/// Draws every figure, and checks the properties that all figures have.
fn drawn(recording: &Recording) -> Vec<(Drawing, String)> {
    let figures = flight::figures(recording);
    let drawn: Vec<_> = figures.into_iter().map(|figure| (figure.svg(), figure)).collect();
    for (svg, figure) in &drawn {
        let name = &figure.name;
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{name}");
        assert!(figure.subject.contains(&recording.scenario.name) && figure.subject.contains("seed"), "{name}");
        assert!(figure.subject.contains(&format!("skein {}", env!("CARGO_PKG_VERSION"))), "{name}");
        assert!(!figure.caption.is_empty(), "{name}");
        for axis in figure.panels.iter().flat_map(|panel| [&panel.x, &panel.y]) {
            let (_, unit) = axis.label.rsplit_once(", ").unwrap_or_default();
            let named =
                ["vehicle", "sender", "receiver", "receiver from sender", "receiver, a row for each sender", "groups"];
            let is_named = named.contains(&axis.label.as_str());
            assert!(is_named || ["s", "m", "%", "ms", "share of full"].contains(&unit), "{name}: {}", axis.label);
        }
    }
    drawn.iter().for_each(|(_, figure)| caption_names_what_is_drawn(figure));
    drawn.into_iter().map(|(svg, figure)| (figure, svg)).collect()
}

/// The phrases by which captions explain colours and shapes.
const PHRASES: [&str; 14] = [
    "Solid ring",
    "Broken rings",
    "Broken grey line",
    "Coloured lines",
    "Coloured bars",
    "Bold crosses",
    "Grey crosses",
    "Small dots",
    "Large dots",
    "Large markers",
    "Larger dots and markers",
    "Bars: ",
    "Line: ",
    "Dots: ",
];

/// Everything that is drawn is named in the picture or in its caption, and the caption explains nothing that is not drawn.
fn caption_names_what_is_drawn(figure: &Drawing) {
    let (name, caption) = (&figure.name, figure.full_caption());
    let items = || figure.panels.iter().flat_map(|panel| &panel.items).filter(|item| !item.shape.is_empty());
    for item in items() {
        let is_named = item.name != Name::None || matches!(item.shape, Shape::Note { .. });
        let meaning = item.meaning.as_deref();
        assert!(is_named || meaning.is_some(), "{name}: {item:?}");
        assert!(meaning.is_none_or(|meaning| caption.matches(meaning).count() == 1), "{name}: {meaning:?}");
    }
    for phrase in PHRASES.into_iter().filter(|phrase| caption.contains(phrase)) {
        let is_it = |item: &Item| item.meaning.as_ref().is_some_and(|meaning| meaning.starts_with(phrase));
        assert!(items().any(is_it), "{name}: {phrase}");
    }
    let crosses = |colour: Colour| {
        let is_cross = |item: &Item| matches!(item.shape, Shape::Dots { marker: Marker::Cross, .. });
        items().filter(|item| item.colour == colour && is_cross(item)).count()
    };
    assert_eq!(caption.contains("Bold crosses"), crosses(Colour::BLACK) > 0, "{name}");
    assert_eq!(caption.contains("Grey crosses"), crosses(Colour::GREY) > 0, "{name}");
}

fn figure<'a>(drawn: &'a [(Drawing, String)], name: &str) -> &'a Drawing {
    &drawn.iter().find(|(figure, _)| figure.name == name).unwrap().0
}

/// The notes of a picture, each with its place.
fn notes(figure: &Drawing) -> Vec<(&str, [f64; 2])> {
    let items = figure.panels.iter().flat_map(|panel| &panel.items);
    items
        .filter_map(|item| match &item.shape {
            Shape::Note { at, text, .. } => Some((text.as_str(), *at)),
            _ => None,
        })
        .collect()
}

fn names(drawn: &[(Drawing, String)]) -> Vec<&str> {
    drawn.iter().map(|(figure, _)| figure.name.as_str()).collect()
}

fn svg<'a>(drawn: &'a [(Drawing, String)], name: &str) -> &'a str {
    &drawn.iter().find(|(figure, _)| figure.name == name).unwrap().1
}

const ALWAYS: [&str; 6] = ["overview", "timeline", "final-places", "centre-distance", "altitude", "effort"];

/// A scenario of the paper.
fn of_paper(name: &str) -> Scenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/scenarios/paper").join(name);
    ScenarioArgs { scenario: Some(path), sets: Vec::new() }.read(Vec::new()).unwrap().scenario
}

/// The picture without numbers, whose last digits differ on other computers.
fn structure(svg: &str) -> String {
    svg.chars().filter(|letter| !letter.is_ascii_digit() && !matches!(letter, '.' | '-' | ',' | ' ')).collect()
}

/// The picture in the documentation is that of the present program: `skein report deploy/scenarios/paper` makes it
/// again, as `figures/hover-overview.svg`.
#[test]
fn the_picture_in_the_documentation_is_up_to_date() {
    let drawn = drawn(&record(&of_scenario(of_paper("hover.toml")), 10.0));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/scenarios/paper/hover.svg");
    let there = fs::read_to_string(&path).unwrap().replace('\r', "");
    let flown = svg(&drawn, "overview");
    // On other platforms the elementary functions differ in their last bits.
    if cfg!(all(target_os = "linux", target_arch = "x86_64")) {
        assert!(there == flown, "{} is not up to date: see the comment above this test", path.display());
    } else {
        assert_eq!(structure(&there), structure(flown));
    }
    for name in ALWAYS.iter().chain(&["pair-distance", "field", "message-age", "separation"]) {
        assert!(names(&drawn).contains(name), "{name}");
    }
    for text in ["R*", "band, R_in to R_out", "evenly spread on R*", "preset paper"] {
        assert!(flown.contains(text), "{text}");
    }
}

#[test]
fn a_moving_flock_has_snapshots() {
    let drawn = drawn(&record(&of_scenario(of_paper("flock.toml")), 2.0));
    for name in ALWAYS.iter().chain(&["pair-distance", "field", "snapshots"]) {
        assert!(names(&drawn).contains(name), "{name}");
    }
    let times = svg(&drawn, "snapshots").lines().filter(|line| line.ends_with(" s</text>")).count();
    assert!(times >= 6, "{times} snapshots");
}

#[test]
fn faults_are_marked_in_every_figure_over_time() {
    let recording = recorded("tour.toml", &["duration_s=320"], 2.0);
    let drawn = drawn(&recording);
    for name in ALWAYS.iter().chain(&["pair-distance", "message-age", "snapshots"]) {
        assert!(names(&drawn).contains(name), "{name}");
    }
    for name in ["centre-distance", "pair-distance", "altitude", "timeline"] {
        let svg = svg(&drawn, name);
        for mark in ["3 killed", "3 restarted", "links cut", "links healed", "5 engine out", "order: hold"] {
            assert!(svg.contains(mark), "{name}: {mark}");
        }
    }
    // The path of the vehicle whose agent was killed ends with a cross and its number.
    let overview = figure(&drawn, "overview");
    let crosses: Vec<[f64; 2]> = overview.panels[0]
        .items
        .iter()
        .filter_map(|item| match &item.shape {
            Shape::Dots { at, marker: Marker::Cross, .. } if item.colour == Colour::BLACK => at.first().copied(),
            _ => None,
        })
        .collect();
    assert_eq!(crosses.len(), 1, "one agent was killed");
    assert!(notes(overview).contains(&("3", crosses[0])), "{:?}", notes(overview));
    // A cut in two shows for each pair across it, and as two groups.
    let contact = figure(&drawn, "contact");
    let lost = contact.panels[0].items.iter().find(|item| item.name == Name::InLegend("not received".to_owned()));
    let Some(Shape::Cells(cells)) = lost.map(|item| &item.shape) else { panic!("no pair is shown without contact") };
    let across = cells.iter().filter(|(from, to)| from[0] < 155.0 && to[0] > 168.0).count();
    assert_eq!(across, 2 * 2 * 4, "pairs between 1, 2 and 3, 4, 5, 6");
    let Shape::Line { pieces, .. } = &contact.panels[1].items[0].shape else { panic!("a line of groups") };
    let groups = |from_s: f64, to_s: f64| {
        let inside = pieces.iter().flatten().filter(|[t_s, _]| (from_s..to_s).contains(t_s));
        inside.map(|[_, groups]| *groups).fold(0.0, f64::max)
    };
    assert_eq!((groups(90.0, 145.0), groups(155.0, 165.0), groups(180.0, 230.0)), (1.0, 2.0, 1.0));
    let timeline = svg(&drawn, "timeline");
    for text in ["gather", "gate", "reached the step", "reported a failure", "out of formation"] {
        assert!(timeline.contains(text), "{text}");
    }
}

#[test]
fn fifty_vehicles_are_drawn_as_an_envelope_and_a_single_one_has_no_pairs() {
    let fifty = ["swarm.vehicles=50", "start.square_m=300", "formation.radius_m=200", "duration_s=20"];
    let fifty = drawn(&recorded("hover.toml", &fifty, 1.0));
    assert!(svg(&fifty, "centre-distance").contains("all vehicles, least to largest"));
    assert!(svg(&fifty, "pair-distance").contains("all pairs, least to largest"));
    let Some(Shape::Cells(cells)) = figure(&fifty, "contact").panels[0].items.first().map(|item| &item.shape) else {
        panic!("cells")
    };
    assert!(cells.len() >= 50, "a row for each receiver");
    let sixteen = ["swarm.vehicles=16", "start.square_m=300", "formation.radius_m=120", "duration_s=20"];
    let sixteen = drawn(&recorded("hover.toml", &sixteen, 1.0));
    let ids = notes(figure(&sixteen, "overview"));
    assert!((1..=16).all(|id| ids.iter().any(|(text, _)| *text == id.to_string())), "{ids:?}");
    let alone = drawn(&recorded("hover.toml", &["swarm.vehicles=1", "duration_s=20"], 1.0));
    assert!(!names(&alone).contains(&"pair-distance") && !names(&alone).contains(&"separation"));
}

#[test]
fn recordings_without_steps_or_with_one_step_are_drawn_too() {
    let mut recording = recorded("hover.toml", &["duration_s=2"], 1.0);
    recording.tracks.iter_mut().for_each(|track| track.steps.truncate(1));
    for name in ALWAYS {
        assert!(names(&drawn(&recording)).contains(&name), "{name}");
    }
    recording.tracks.iter_mut().for_each(|track| track.steps.clear());
    assert!(ALWAYS.iter().all(|name| names(&drawn(&recording)).contains(name)));
    recording.tracks.clear();
    recording.noted.clear();
    assert_eq!(names(&drawn(&recording)), ALWAYS);
}

/// A collision and a crash are named with their time, their vehicles and the fault before them.
#[test]
fn the_verdict_names_what_went_wrong_when_with_which_vehicle_and_after_which_fault() {
    let mut recording = recorded("tour.toml", &["duration_s=260"], 10.0);
    let lines = verdict::of_flight(&recording, None);
    let says = |lines: &[skein_lab::report::page::Line], tone: Tone, text: &str| {
        lines.iter().any(|line| line.tone == tone && line.text.contains(text))
    };
    assert!(says(&lines, Tone::Plain, "6 vehicles flew the scenario tour"), "{lines:?}");
    assert!(says(&lines, Tone::Plain, "3 killed at 60 s; 3 restarted at 80 s; links cut at 150 s"), "{lines:?}");
    assert!(says(&lines, Tone::Plain, "5 at 240 s: engine out, autorotates"), "{lines:?}");
    assert!(says(&lines, Tone::Bad, "Vehicle 5 crashed at 24"), "{lines:?}");
    assert!(says(&lines, Tone::Bad, "s after engine out of vehicle 5"), "{lines:?}");
    assert!(!lines.iter().any(|line| line.text.contains("collided")), "{lines:?}");
    // Vehicle 2 is put 1.4 m beside vehicle 1 in the cut.
    let at = |track: usize, recording: &Recording| {
        recording.tracks[track].steps.iter().position(|step| step.t_s >= 160.0).unwrap()
    };
    let (one, other) = (at(0, &recording), at(1, &recording));
    let mut beside = recording.tracks[0].steps[one].trace.position;
    beside.0.x += 1.4;
    recording.tracks[1].steps[other].trace.position = beside;
    let lines = verdict::of_flight(&recording, None);
    assert!(says(&lines, Tone::Bad, "Vehicles 1 and 2 collided: 1.4 m apart at 160 s."), "{lines:?}");
}

fn skein(line: &[&str]) -> ExitCode {
    cli::run(Cli::try_parse_from(["skein"].iter().chain(line)).unwrap().command)
}

/// Reads the page and checks that it needs no other file.
fn page(folder: &Path) -> String {
    let page = fs::read_to_string(folder.join("index.html")).unwrap();
    let elsewhere = page.replace("http://www.w3.org/2000/svg", "");
    for needs in ["http:", "https:", "<script", "<link", "<img", "src=", "@import", "url("] {
        assert!(!elsewhere.contains(needs), "{needs}");
    }
    for (_, rest) in page.match_indices("href=\"").map(|(at, found)| page.split_at(at + found.len())) {
        let target = &rest[..rest.find('"').unwrap()];
        let is_there = match target.strip_prefix('#') {
            Some(id) => page.contains(&format!("id=\"{id}\"")),
            None => folder.join(target).is_file(),
        };
        assert!(is_there, "{target}");
    }
    page
}

#[test]
fn reports_of_scenarios_and_of_a_study_need_no_other_files() {
    let temporary = tempfile::tempdir().unwrap();
    let at = |name: &str| temporary.path().join(name).display().to_string();
    let text = "name = 'two'\nduration_s = 20\nswarm.vehicles = 2\nformation.radius_m = 40\n";
    fs::create_dir(at("scenarios")).unwrap();
    fs::write(at("scenarios/two.toml"), text).unwrap();
    let (scenarios, report) = (at("scenarios"), at("report"));
    assert_eq!(skein(&["report", &scenarios, "--out", &report]), ExitCode::SUCCESS);
    let page_of_scenarios = page(Path::new(&report));
    assert!(page_of_scenarios.contains("two, seed 1") && page_of_scenarios.contains("<svg"));
    assert!(page_of_scenarios.contains("<td>formation.radius_m</td><td>40.0</td>"));

    let (scenario, study, report) = (at("scenarios/two.toml"), at("study"), at("study-report"));
    let sweep = ["--seeds", "0..3", "--sweep", "network.delay_s=0,0.3", "--no-record"];
    let line = [&["study", &scenario, "--out", &study][..], &sweep].concat();
    assert_eq!(skein(&line), ExitCode::SUCCESS);
    let recording = at("alone.mcap");
    let loaded = ScenarioArgs { scenario: Some(scenario.into()), sets: Vec::new() }.read(Vec::new()).unwrap();
    record_run(&of_scenario(loaded.scenario.clone()), 1, &loaded.to_toml(), Path::new(&recording)).unwrap();
    (0..3).for_each(|seed| _ = fs::copy(&recording, at(&format!("study/point-1/seed-{seed}/run.mcap"))).unwrap());
    assert_eq!(skein(&["report", &study, "--out", &report]), ExitCode::SUCCESS);
    let page_of_study = page(Path::new(&report));
    for text in
        ["two: 6 runs", "network.delay_s", "figures/study-sweep.png", "figures/study-spread.png", "the worst run"]
    {
        assert!(page_of_study.contains(text), "{text}");
    }
    for page in [&page_of_scenarios, &page_of_study] {
        let first = |what: &str| page.find(what).unwrap();
        assert!(first("class=\"verdict\"") < first("<figure"), "the verdict comes before the pictures");
        assert!(first("<figure") < first("<table"), "the pictures come before the tables");
    }
    let shown = || FIGURES.iter().filter(|figure| page_of_study.contains(&format!("<th>{}</th>", figure.key)));
    assert!(shown().count() > 2, "the table of points has figures");
    for figure in shown() {
        assert!(page_of_study.contains(&escaped(&figure.meaning.replace('`', ""))), "{}", figure.key);
    }
    let report = at("flight-report");
    assert_eq!(skein(&["report", &recording, "--csv", "--out", &report]), ExitCode::SUCCESS);
    assert!(page(Path::new(&report)).contains("two, seed 1"));
    assert!(fs::read_dir(Path::new(&report).join("csv/alone")).unwrap().count() > 1);
    assert_eq!(skein(&["report", &at("nowhere")]), ExitCode::from(2));
}

#[test]
fn a_recording_that_is_cut_off_in_flight_is_not_reported_as_sound() {
    let temporary = tempfile::tempdir().unwrap();
    let at = |name: &str| temporary.path().join(name).display().to_string();
    fs::write(at("two.toml"), "duration_s = 20\nswarm.vehicles = 2\nformation.radius_m = 40\n").unwrap();
    let study = at("study");
    assert_eq!(
        skein(&["study", &at("two.toml"), "--seeds", "0..2", "--set", "record.runs=\"all\"", "--out", &study]),
        ExitCode::SUCCESS
    );
    let run = Path::new(&study).join("seed-0");
    let whole = fs::read(run.join("run.mcap")).unwrap();
    let report = |of: &str, name: &str| {
        let status = skein(&["report", of, "--out", &at(name)]);
        (status, page(Path::new(&at(name))))
    };
    let sentence = "in the middle of the flight: what happened then is unknown.";
    let cut = at("cut.mcap");
    fs::write(&cut, &whole[..whole.len() * 2 / 3]).unwrap();
    let (status, text) = report(&cut, "of-cut");
    assert_eq!(status, ExitCode::FAILURE);
    assert!(text.contains(sentence) && text.contains(" of 20 s, ") && !text.contains("\u{2713}"), "{text}");
    // A repaired file is whole, and its flight still has no end; so has a merged one.
    assert_eq!(skein(&["record", "--repair", &cut]), ExitCode::SUCCESS);
    let (status, text) = report(&at("cut.repaired.mcap"), "of-repaired");
    assert!(status == ExitCode::FAILURE && text.contains(sentence), "{text}");
    // A file that lacks only its index has the whole flight.
    fs::write(at("no-index.mcap"), &whole[..whole.len() - 40]).unwrap();
    let (status, text) = report(&at("no-index.mcap"), "of-no-index");
    assert!(status == ExitCode::SUCCESS && !text.contains("cut off"), "{text}");
    // In the folder of its run the figures are those of the whole flight, and the pictures lack its end.
    fs::copy(&cut, run.join("run.mcap")).unwrap();
    for (of, name) in [(study.clone(), "of-study"), (run.display().to_string(), "of-run")] {
        let (status, text) = report(&of, name);
        assert!(status == ExitCode::FAILURE && text.contains(sentence), "{name}: {text}");
    }
    // A damaged piece is missing, and the flight ends.
    let mut damaged = whole.clone();
    damaged[whole.len() / 2] ^= 0x10;
    fs::write(at("damaged.mcap"), &damaged).unwrap();
    let (status, text) = report(&at("damaged.mcap"), "of-damaged");
    assert!(status == ExitCode::SUCCESS && text.contains("is damaged: 1 of its pieces"), "{text}");
}

#[test]
fn a_fleets_recording_that_is_cut_off_is_not_reported_as_sound() {
    let temporary = tempfile::tempdir().unwrap();
    let at = |name: &str| temporary.path().join(name).display().to_string();
    fs::write(at("fleet.toml"), "duration_s = 300\nswarm.vehicles = 4\nformation.radius_m = 40\nfleet.teams = 4\n")
        .unwrap();
    assert_eq!(
        skein(&["study", &at("fleet.toml"), "--seeds", "0..2", "--set", "record.runs=\"all\"", "--out", &at("study")]),
        ExitCode::SUCCESS
    );
    let path = Path::new(&at("study")).join("seed-0").join(skein_lab::record::FLEET_FILE);
    let whole = fs::read(&path).unwrap();
    fs::write(at("cut.mcap"), &whole[..whole.len() * 2 / 3]).unwrap();
    assert_eq!(skein(&["report", &at("cut.mcap"), "--out", &at("of-cut")]), ExitCode::FAILURE);
    assert!(page(Path::new(&at("of-cut"))).contains("The recording of the fleet is cut off after"));
    fs::write(&path, &whole[..whole.len() * 2 / 3]).unwrap();
    assert_eq!(skein(&["report", &at("study"), "--out", &at("of-study")]), ExitCode::FAILURE);
    fs::write(&path, &whole).unwrap();
    assert_eq!(skein(&["report", &at("study"), "--out", &at("whole")]), ExitCode::SUCCESS);
}
