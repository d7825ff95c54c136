//! Files of earlier releases: each is still read, or refused with what to do. `tests/specimens/README.md` describes the
//! specimens. Beside them, `expected.txt` has what each gives; after an intended change, `SKEIN_GOLDEN=write` in this
//! test's environment writes it again. The keys of a specimen's cluster are tested where keys are made.

use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use skein_agent::inputs::InputsReader;
use skein_cluster::inventory::Inventory;
use skein_common::math;
use skein_common::scenario::{Described, Scenario, Source, load_any};
use skein_core::aircraft::Aircraft;
use skein_core::control::Sugeno;
use skein_core::formation::Workspace;
use skein_lab::record::{self, Player};
use skein_lab::recording::NotedKind;

const SPECIMENS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/specimens");

/// What a file gives.
type Given = Result<String, Box<dyn Error>>;

/// The entries of a folder, by name.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    all.sort();
    all
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap()
}

/// The lines of a complete scenario. The comments are left out: they name where each value comes from, and a copy of the
/// file names the first file.
fn values(toml: &str) -> Vec<String> {
    let value = |line: &str| line.split_once(" #").map_or(line, |(value, _)| value).trim().to_owned();
    toml.lines().map(value).filter(|line| !line.is_empty()).collect()
}

/// A complete scenario: every value that it gives is the value that this release flies.
fn scenario(path: &Path) -> Given {
    let written = text(path);
    let described = load_any(&Source { name: "scenario.toml", text: &written }, &[])?;
    let flown = values(&described.to_toml());
    let lost: Vec<_> = values(&written).into_iter().filter(|value| !flown.contains(value)).collect();
    assert!(lost.is_empty(), "{}: this release flies other values than {lost:#?}", path.display());
    Ok(summary(&described))
}

/// A fleet as a user wrote it. What it gives is complete, and gives the same again.
fn fleet(path: &Path) -> Given {
    let described = load_any(&Source { name: "fleet.toml", text: &text(path) }, &[])?;
    let again = load_any(&Source { name: "again.toml", text: &described.to_toml() }, &[])?;
    let scenarios =
        |described: &Described| described.all().iter().map(|team| team.scenario.clone()).collect::<Vec<_>>();
    assert_eq!(scenarios(&described), scenarios(&again), "{}", path.display());
    Ok(summary(&described))
}

/// What flies, in a line.
fn summary(described: &Described) -> String {
    let first = &described.first().scenario;
    let duration_s = first.duration_s.unwrap_or(f64::NAN);
    if !described.is_fleet() {
        return format!("scenario {} of {} vehicles, {duration_s} s", first.name, first.swarm.vehicles);
    }
    let teams = described.all();
    let count = |is: fn(&Scenario) -> usize| teams.iter().map(|team| is(&team.scenario)).sum::<usize>();
    let places = teams.iter().filter_map(|team| team.scenario.team).map(|team| team.place_ne_m);
    let farthest_m = places.map(|[north_m, east_m]| math::hypot(north_m, east_m)).fold(0.0, f64::max);
    format!(
        "fleet {} of {} teams with {} vehicles, {} steps and {} events, the farthest {farthest_m:.0} m from the origin, \
         {duration_s} s",
        first.name,
        teams.len(),
        count(|team| team.swarm.vehicles),
        count(|team| team.mission.steps.len()),
        count(|team| team.mission.events.len())
    )
}

/// A recording: as reports read it, and as the page plays it.
fn recording(path: &Path) -> Given {
    let recording = record::read(path)?;
    let steps: Vec<_> = recording.tracks.iter().map(|track| track.steps.len().to_string()).collect();
    let is_fault = |what: &NotedKind| matches!(what, NotedKind::Fault(_));
    let (faults, events): (Vec<_>, Vec<_>) = recording.noted.iter().partition(|noted| is_fault(&noted.what));
    let height_m = recording.tracks[0].steps.last().map_or(f64::NAN, |step| step.trace.height_m);
    let mut player = Player::open(path)?;
    let (from_s, to_s) = player.span_s();
    let played = player.events()?.len();
    Ok(format!(
        "recording of {} steps, {} events, {} faults; vehicle 1 ends at {height_m:.3} m; plays {from_s:.2} to {to_s:.2} s with \
         {played} events",
        steps.join(" + "),
        events.len(),
        faults.len()
    ))
}

/// The inputs of an agent. The core runs again with all of them; what it decides may differ from release to release.
fn inputs(path: &Path) -> Given {
    let file = fs::read(path)?;
    let mut reader = InputsReader::new(&file)?;
    let (mut station, mut workspace, mut steps) = (reader.flown.station()?, Workspace::default(), 0);
    while let Some(mut step) = reader.next_step()? {
        station.step_with(&mut step.inputs, &mut workspace);
        steps += 1;
    }
    Ok(format!("inputs of vehicle {}, {steps} steps", reader.flown.vehicle))
}

fn cluster(path: &Path) -> Given {
    let cluster = Inventory::read(path)?;
    let endpoints: Vec<_> = cluster.nodes.values().map(|node| node.endpoint(cluster.security)).collect();
    Ok(format!("cluster {} of {}", cluster.swarm, endpoints.join(", ")))
}

fn aircraft(path: &Path) -> Given {
    let aircraft = Aircraft::from_text("aircraft.toml", &text(path))?;
    let rotor_rad_s = aircraft.take_off_rotor_rad_s().unwrap_or(f64::NAN);
    Ok(format!("aircraft that takes off at {rotor_rad_s:.2} rad/s"))
}

fn rules(path: &Path) -> Given {
    let rules = Sugeno::parse("rules.fis", &text(path))?;
    let outputs = [-0.7, 0.0, 0.2].map(|input| rules.evaluate(&vec![input; rules.inputs()]));
    let outputs = outputs.map(|output| format!("{:.6}", output.unwrap()));
    Ok(format!("rules of {} inputs that give {}", rules.inputs(), outputs.join(", ")))
}

/// Reads a specimen in the way that its name asks for; `None` for the keys and the expected results.
fn read(path: &Path) -> Option<Given> {
    let name = path.file_name().unwrap().to_str().unwrap();
    let extension = path.extension().unwrap_or_default().to_str().unwrap();
    Some(match (name, extension) {
        ("keys", _) | ("expected.txt", _) => return None,
        ("scenario.toml" | "fleet-complete.toml", _) => scenario(path),
        ("fleet.toml", _) => fleet(path),
        ("cluster.toml", _) => cluster(path),
        ("aircraft.toml", _) => aircraft(path),
        (_, "mcap") => recording(path),
        (_, "inputs") => inputs(path),
        (_, "fis") => rules(path),
        _ => panic!("{}: this test does not know how to read it", path.display()),
    })
}

#[test]
fn files_of_earlier_releases_are_read_or_refused_with_a_remedy() {
    let folders: Vec<_> = entries(Path::new(SPECIMENS)).into_iter().filter(|path| path.is_dir()).collect();
    assert!(folders.len() >= 3, "{folders:?}");
    for folder in folders {
        let mut given = String::new();
        for path in entries(&folder) {
            let Some(read) = read(&path) else { continue };
            let result = read.unwrap_or_else(|error| format!("refused: {error}"));
            // A release with a new number reads them alike.
            let result = result.replace(&format!("this one is {}", skein_lab::VERSION), "this one is [VERSION]");
            let name = path.file_name().unwrap().to_str().unwrap();
            let _ = writeln!(given, "{name}: {}", result.replace(&format!("{}/", folder.display()), ""));
        }
        let golden = folder.join("expected.txt");
        if std::env::var("SKEIN_GOLDEN").is_ok_and(|what| what == "write") {
            fs::write(&golden, &given).unwrap();
        }
        assert_eq!(given, text(&golden), "{}", folder.display());
    }
}
