//! Reports on the figures of many runs, point by point.

use std::collections::{BTreeMap, BTreeSet};

use skein_common::scenario::split_unit;

use super::figure::{Axis, Colour, Drawing, Item, Marker, Panel, Shape, WIDTH_PX};
use super::page::{Page, Part, Section};
use super::{fleet, flight_parts, recording, slug, tables, verdict};
use crate::compare::folder::{Flown, Folder};
use crate::error::Error;
use crate::metrics::{Measured, Outcome, figures, worst_and_median};
use crate::record;
use crate::study::{self, Summary};

/// Figures that are drawn, the most important first: the first [`MOST_PANELS`] of those that vary.
const DRAWN: [&str; 25] = [
    "even_10deg_s",
    "in_band_s",
    "radial_rms_m",
    "spacing_error_deg",
    "min_separation_m",
    "nearest_pair_end_m",
    "collisions",
    "crashes",
    "setpoints_reached",
    "duration_s",
    "advance_latency_s",
    "max_centre_distance_m",
    "centroid_lag_m",
    "band_occupancy",
    "transient_s",
    "detection_s",
    "forced_advances",
    "order",
    "connected_share",
    "oscillation_m",
    "max_tilt_deg",
    "stick_rms",
    "peer_age_p99_ms",
    "state_messages",
    "safety_activations",
];
const MOST_PANELS: usize = 9;
/// Number of panels side by side.
const COLUMNS: usize = 3;
/// Height of a panel, px.
const PANEL_PX: f64 = 250.0;
/// Most runs of a point that are drawn one by one.
const MOST_DOTS: usize = 200;
/// Most lines of different colours in a panel.
const MOST_LINES: usize = 6;
/// Longest name of a point below an axis, characters: points with longer names are numbered.
const LONGEST_NAME: usize = 14;
/// Most recorded flights on a page, to keep it readable.
const MOST_FLIGHTS: usize = 6;

/// Runs that differ only in their seeds.
struct PointRuns<'a> {
    /// Folder of the point, relative to the folder of the study.
    place: String,
    /// Values of the swept keys; the folder if the study is not a sweep.
    values: Vec<String>,
    runs: Vec<&'a Flown>,
    summary: Summary,
}

impl PointRuns<'_> {
    fn name(&self) -> String {
        self.values.join(", ")
    }

    /// The number of a study's point, or the name of any other folder.
    fn number(&self) -> &str {
        self.place.strip_prefix("point-").unwrap_or(&self.place)
    }

    fn measured(&self) -> Vec<Measured> {
        self.runs.iter().map(|run| run.measured.clone()).collect()
    }
}

/// Makes the page of a folder of runs.
///
/// # Errors
/// A recording in the folder cannot be read.
pub(super) fn page(folder: &Folder) -> Result<Page, Error> {
    let points = points(folder);
    let subject = subject(folder);
    let mut parts = Vec::new();
    if folder.is_unfinished {
        parts.push(Part::Text("This study is incomplete: some runs are missing.".to_owned()));
    }
    if let [run] = folder.runs.as_slice() {
        return of_one(folder, run, &points, subject);
    }
    let drawn_figures = [lines(&folder.swept, &points, &subject), spread(&folder.swept, &points, &subject)];
    parts.extend(drawn_figures.into_iter().flatten().map(Part::Drawing));
    match points.as_slice() {
        [point] => {
            let caption = format!("Figures over {} runs.", folder.runs.len());
            parts.push(tables::of_runs(caption, &point.summary, point.summary.keys().map(String::as_str)));
        }
        points => {
            parts.push(of_points(&folder.swept, points));
            parts.push(tables::definitions(drawn(points).into_iter()));
        }
    }
    let mut sections = vec![Section { title: "All runs".to_owned(), name: "study".to_owned(), parts }];
    sections.extend(flights(folder, &points)?);
    let scenario = folder.runs.first().and_then(|run| run.text("scenario")).unwrap_or("Study");
    let title = format!("{scenario}: {} runs", folder.runs.len());
    let about = format!("{subject} · {}", folder.path.display());
    Ok(Page { title, about, verdict: verdict::of_study(folder), sections })
}

/// Makes the page of a folder with a single run: its pictures, then its figures.
fn of_one(folder: &Folder, run: &Flown, points: &[PointRuns<'_>], subject: String) -> Result<Page, Error> {
    let mut sections = flights(folder, points)?;
    sections.iter_mut().for_each(|section| section.title = "Pictures".to_owned());
    // The verdict of the flight is that of the page.
    let mut verdict = verdict::of_run(run);
    for section in &mut sections {
        section.parts.retain(|part| match part {
            Part::Verdict(lines) => {
                verdict.clone_from(lines);
                false
            }
            _ => true,
        });
    }
    let parts = vec![tables::of_run(&run.measured)];
    sections.push(Section { title: "Figures".to_owned(), name: "study".to_owned(), parts });
    let title = format!("{}, seed {}", run.text("scenario").unwrap_or("A run"), run.measured.seed);
    Ok(Page { title, about: format!("{subject} · {}", folder.path.display()), verdict, sections })
}

/// Groups the runs by point, in the order of their folders.
fn points(folder: &Folder) -> Vec<PointRuns<'_>> {
    let varying = folder.varying();
    let mut points: Vec<PointRuns<'_>> = Vec::new();
    for run in &folder.runs {
        let place = above(run, folder);
        if let Some(point) = points.iter_mut().find(|point| point.place == place) {
            point.runs.push(run);
            continue;
        }
        let values = match folder.swept.as_slice() {
            [] => vec![place.clone()],
            swept => swept.iter().map(|key| value(run, key, &varying)).collect(),
        };
        points.push(PointRuns { place, values, runs: vec![run], summary: Summary::new() });
    }
    for point in &mut points {
        point.summary = study::summary(&point.measured());
    }
    points
}

/// The value of a swept key in a run; for a table or a list, the values in it that vary.
fn value(run: &Flown, swept: &str, varying: &BTreeSet<&str>) -> String {
    let text = |key: &str| run.scenario.get(key).map(|value| value.trim_matches('"'));
    if let Some(value) = text(swept) {
        return value.to_owned();
    }
    let inside = |key: &str| Some(format!("{}={}", key[swept.len()..].trim_start_matches('.'), text(key)?));
    let values: Vec<String> = Folder::below(swept, varying.iter().copied()).filter_map(inside).collect();
    if values.is_empty() { "–".to_owned() } else { values.join(" ") }
}

/// Folder of a run's point, relative to the folder of the study: the folder of the run without that of its seed.
fn above(run: &Flown, folder: &Folder) -> String {
    let inside = run.folder.strip_prefix(&folder.path).unwrap_or(&run.folder);
    let is_seed = inside.file_name().is_some_and(|name| name.to_string_lossy().starts_with("seed-"));
    let above = if is_seed { inside.parent().unwrap_or(inside) } else { inside };
    above.display().to_string()
}

/// A line with what all runs have in common.
fn subject(folder: &Folder) -> String {
    let values = |key: &str| folder.texts(key).into_iter().collect::<Vec<_>>().join(", ");
    // A fleet has more vehicles than each of its teams.
    let teams = folder.runs.first().and_then(|run| run.measured.value("teams"));
    let vehicles = match teams {
        Some(teams) => format!(" · {teams} teams"),
        None => {
            folder.constant("swarm.vehicles").flatten().map_or_else(String::new, |count| format!(" · {count} vehicles"))
        }
    };
    let seeds = folder.runs.iter().map(|run| run.measured.seed);
    let seeds = match (seeds.clone().min(), seeds.max()) {
        (Some(first), Some(last)) if first < last => format!("seeds {first} to {last}"),
        (first, _) => format!("seed {}", first.unwrap_or(0)),
    };
    format!(
        "{} · {} · preset {}{vehicles} · {seeds} · {} · skein {}",
        values("scenario"),
        values("law"),
        values("preset"),
        values("target"),
        values("version"),
    )
}

/// A table with a row for each point.
fn of_points(swept: &[String], points: &[PointRuns<'_>]) -> Part {
    let keys: Vec<&str> = drawn(points).into_iter().take(6).collect();
    let cell = |point: &PointRuns<'_>, key: &str| {
        point.summary.get(key).map_or_else(|| "–".to_owned(), |figure| study::median_and_worst(key, figure))
    };
    let row = |point: &PointRuns<'_>| {
        let seed = worst_and_median(&point.measured()).map(|(worst, _)| worst.to_string()).unwrap_or_default();
        let cells = keys.iter().map(|key| cell(point, key));
        let number = (!swept.is_empty()).then(|| point.number().to_owned());
        let values = number.into_iter().chain(point.values.iter().cloned()).chain([point.runs.len().to_string()]);
        values.chain(cells).chain([seed]).collect()
    };
    let names = if swept.is_empty() { vec!["folder".to_owned()] } else { [&["point".to_owned()], swept].concat() };
    let head = names.into_iter().chain(["runs".to_owned()]).chain(keys.iter().map(|key| (*key).to_owned()));
    Part::Table {
        caption: "Median [worst] of the runs at each point.".to_owned(),
        head: head.chain(["worst seed".to_owned()]).collect(),
        rows: points.iter().map(row).collect(),
    }
}

/// The figures that are drawn: those that differ between runs.
fn drawn(points: &[PointRuns<'_>]) -> Vec<&'static str> {
    let varies = |key: &&str| {
        let mut all = points.iter().flat_map(|point| &point.runs).filter_map(|run| run.measured.outcome(key));
        all.next().is_some_and(|first| all.any(|other| other != first))
    };
    DRAWN.into_iter().filter(varies).take(MOST_PANELS).collect()
}

/// The values of a figure at a point, and the number of runs in which its event never happened.
fn values(point: &PointRuns<'_>, key: &str) -> (Vec<f64>, usize) {
    let runs = || point.runs.iter().map(|run| &run.measured);
    let never = runs().filter(|run| run.outcome(key) == Some(Outcome::Never)).count();
    (runs().filter_map(|run| run.value(key)).collect(), never)
}

/// Draws every run of every point as a dot, with the quartiles and the median.
fn spread(swept: &[String], points: &[PointRuns<'_>], subject: &str) -> Option<Drawing> {
    let keys = drawn(points);
    // Tables and lists are too long for labels side by side.
    let is_long = !swept.is_empty() && points.iter().any(|point| point.name().chars().count() > LONGEST_NAME);
    let name = |point: &PointRuns<'_>| if is_long { point.number().to_owned() } else { point.name() };
    let names = || points.iter().enumerate().map(|(nth, point)| (nth as f64 + 1.0, name(point))).collect::<Vec<_>>();
    let what = match points {
        [_] => "all runs".to_owned(),
        _ if is_long => "point".to_owned(),
        _ => match short(swept).as_slice() {
            [key] => axis(key).label,
            keys => keys.join(", "),
        },
    };
    let panel = |key: &&str| {
        let mut panel = Panel::new(Axis::named(&what, names()), axis(key));
        if points.len() == 1 {
            panel.x = Axis::named(&what, vec![(1.0, String::new())]);
        }
        for (nth, point) in points.iter().enumerate() {
            panel.items.extend(strip(nth as f64 + 1.0, point, key));
        }
        let never: usize = points.iter().map(|point| values(point, key).1).sum();
        if never > 0 {
            panel.title = format!("{never} runs never");
        }
        panel
    };
    let panels = keys.iter().map(panel).collect();
    let caption = "A dot is a run. The bar reaches from the first to the third quartile; the line in it is the median. A run in which the event never happened ranks worst; a quartile or median that falls on such a run is missing.";
    grid("spread", "All runs", subject, caption, panels)
}

fn strip(x: f64, point: &PointRuns<'_>, key: &str) -> Vec<Item> {
    let (values, _) = values(point, key);
    let every = values.len().div_ceil(MOST_DOTS).max(1);
    // The golden ratio spreads the dots of neighbouring seeds.
    let dot = |(nth, value): (usize, &f64)| [x + ((nth as f64 * 0.618).fract() - 0.5) * 0.5, *value];
    let dots = values.iter().enumerate().step_by(every).map(dot).collect();
    let mut items = Vec::new();
    if let Some((low, high)) = point.summary.get(key).and_then(|figure| figure.q1.zip(figure.q3)) {
        items.push(Item::new(Shape::Bars(vec![([x - 0.33, low], [x + 0.33, high], String::new())]), Colour::PALE));
    }
    items.push(Item::new(Shape::Dots { at: dots, marker: Marker::Circle, size_px: 4.5 }, Colour::BLUE.faint(0.55)));
    if let Some(median) = point.summary.get(key).and_then(|figure| figure.median) {
        let line = vec![vec![[x - 0.33, median], [x + 0.33, median]]];
        items.push(Item::line(line, Colour::VERMILLION).wide(2.2));
    }
    items
}

/// Draws medians and quartiles over the swept key with the most values, with a line for each value of the other keys.
///
/// `None` if no swept key has numbers as values.
fn lines(swept: &[String], points: &[PointRuns<'_>], subject: &str) -> Option<Drawing> {
    let number = |point: &PointRuns<'_>, nth: usize| point.values.get(nth)?.parse::<f64>().ok();
    let choices = |nth: usize| {
        let mut values: Vec<f64> = points.iter().map(|point| number(point, nth)).collect::<Option<_>>()?;
        values.sort_by(f64::total_cmp);
        values.dedup();
        (values.len() > 1).then_some(values)
    };
    // The key with the most values, all of them numbers, becomes the axis; each combination of the others is a line.
    let over = (0..swept.len()).filter_map(|nth| Some((nth, choices(nth)?.len())));
    // Of keys with equally many values, the first.
    let (over, _) = over.rev().max_by_key(|(_, count)| *count)?;
    let xs = choices(over)?;
    let mut series: BTreeMap<usize, (String, Vec<&PointRuns<'_>>)> = BTreeMap::new();
    for point in points {
        let others: Vec<String> =
            (0..swept.len()).filter(|nth| *nth != over).map(|nth| point.values[nth].clone()).collect();
        let name = others.join(", ");
        let known = series.iter().find(|(_, (other, _))| *other == name).map(|(nth, _)| *nth);
        let nth = known.unwrap_or(series.len());
        series.entry(nth).or_insert_with(|| (name, Vec::new())).1.push(point);
    }
    // A line needs two points and a colour of its own.
    if series.len() > MOST_LINES || series.values().any(|(_, points)| points.len() < 2) {
        return None;
    }
    let is_wide = xs[0] > 0.0 && xs[xs.len() - 1] / xs[0] > 30.0;
    let others = short(swept).into_iter().enumerate().filter(|(nth, _)| *nth != over).map(|(_, name)| name);
    let others = others.collect::<Vec<_>>().join(", ");
    let panel = |key: &&str| {
        let x = axis(swept[over].rsplit('.').next().unwrap_or(&swept[over]));
        let mut panel = Panel::new(if is_wide { x.log() } else { x }, axis(key));
        for (nth, (name, points)) in &series {
            let name = if others.is_empty() { String::new() } else { format!("{others} {name}") };
            panel.items.extend(line(*nth, name, points, over, key));
        }
        panel
    };
    let panels = drawn(points).iter().map(panel).collect();
    let caption = format!(
        "Medians over {}, with the quartiles as an area. A line has a gap where the event never happened in the median run.",
        swept[over]
    );
    grid("sweep", &format!("Over {}", swept[over]), subject, &caption, panels)
}

fn line(nth: usize, name: String, points: &[&PointRuns<'_>], over: usize, key: &str) -> Vec<Item> {
    let x = |point: &&&PointRuns<'_>| point.values[over].parse::<f64>().unwrap_or(0.0);
    let mut points: Vec<_> = points.iter().collect();
    points.sort_by(|one, other| x(one).total_cmp(&x(other)));
    let figure = |point: &&&PointRuns<'_>| point.summary.get(key).cloned();
    let median = |point: &&&PointRuns<'_>| Some([x(point), figure(point)?.median?]);
    let medians = super::flight::pieces(points.iter().map(median));
    let between = |point: &&&PointRuns<'_>| Some((x(point), figure(point)?.q1?, figure(point)?.q3?));
    let between: Vec<_> = points.iter().filter_map(between).collect();
    let low = between.iter().map(|(x, low, _)| [*x, *low]);
    let area = low.chain(between.iter().rev().map(|(x, _, high)| [*x, *high])).collect();
    let colour = Colour::nth(nth);
    let dots = Shape::Dots { at: medians.iter().flatten().copied().collect(), marker: Marker::nth(nth), size_px: 7.0 };
    let (mut line, mut dots) = (Item::line(medians, colour), Item::new(dots, colour));
    if !name.is_empty() {
        (line, dots) = (line.in_legend(name.clone()), dots.in_legend(name));
    }
    vec![Item::new(Shape::Area(vec![area]), colour.faint(0.18)), line, dots]
}

/// Arranges panels in rows.
fn grid(name: &str, title: &str, subject: &str, caption: &str, mut panels: Vec<Panel>) -> Option<Drawing> {
    if panels.is_empty() {
        return None;
    }
    let columns = panels.len().min(COLUMNS);
    let rows = panels.len().div_ceil(columns);
    for (nth, panel) in panels.iter_mut().enumerate() {
        let (column, row) = ((nth % columns) as f64, (nth / columns) as f64);
        let (wide, high) = (1.0 / columns as f64, 1.0 / rows as f64);
        panel.place = [column * wide, row * high, (column + 1.0) * wide, (row + 1.0) * high];
    }
    Some(Drawing {
        name: name.to_owned(),
        title: title.to_owned(),
        subject: subject.to_owned(),
        caption: caption.to_owned(),
        size_px: [WIDTH_PX, 50.0 + PANEL_PX * rows as f64],
        panels,
    })
}

/// The keys without their tables: the part behind the last dot.
fn short(keys: &[String]) -> Vec<String> {
    keys.iter().map(|key| key.rsplit('.').next().unwrap_or(key).to_owned()).collect()
}

/// The axis of a figure, or of another key whose name ends in its unit.
fn axis(key: &str) -> Axis {
    if let Some(figure) = figures::of(key) {
        let unit = if figure.unit == "degrees" { "°" } else { figure.unit };
        return Axis::new(figure.name, unit);
    }
    let (quantity, unit) = match split_unit(key) {
        // The name of `record.hz` consists of the unit alone.
        Some(("", "Hz")) => ("rate", "Hz"),
        Some((quantity, unit)) if !quantity.is_empty() => (quantity, unit),
        _ => (key, "1"),
    };
    Axis::new(&quantity.replace('_', " "), unit)
}

/// Sections with the recorded runs: the worst and the median run of each point, up to [`MOST_FLIGHTS`].
fn flights(folder: &Folder, points: &[PointRuns<'_>]) -> Result<Vec<Section>, Error> {
    let mut sections: Vec<Section> = Vec::new();
    let recorded =
        |run: &&&Flown| [record::FILE, record::FLEET_FILE].iter().any(|file| run.folder.join(file).is_file());
    for point in points {
        let Some((worst, median)) = worst_and_median(&point.measured()) else { continue };
        let shown = if worst == median {
            vec![(worst, "")]
        } else {
            vec![(worst, "the worst run"), (median, "the median run")]
        };
        for (seed, which) in shown {
            let Some(run) = point.runs.iter().filter(recorded).find(|run| run.measured.seed == seed) else { continue };
            if sections.len() == MOST_FLIGHTS {
                let more = "More runs have recordings: make a report of any of their folders to see them.";
                sections.iter_mut().last().into_iter().for_each(|last| last.parts.push(Part::Text(more.to_owned())));
                return Ok(sections);
            }
            let inside = run.folder.strip_prefix(&folder.path).unwrap_or(&run.folder);
            let titled = |title: &str| {
                let set = folder.swept.iter().zip(&point.values).map(|(key, value)| format!("{key} = {value}"));
                let set = if folder.swept.is_empty() { point.name() } else { set.collect::<Vec<_>>().join(", ") };
                let parts = [title, &set, which].map(str::to_owned);
                parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
            };
            let name = format!("flight-{}", slug(&inside.display().to_string())).trim_end_matches('-').to_owned();
            let fleet = titled(&format!("{}, seed {seed}", run.text("scenario").unwrap_or("The fleet")));
            if let Some(mut section) = fleet::section(&run.folder, fleet, name.clone(), &subject(folder))? {
                section.parts.insert(0, Part::Verdict(verdict::of_run(run)));
                sections.push(section);
                continue;
            }
            let (recording, title) = recording(&run.folder.join(record::FILE))?;
            let mut parts = vec![Part::Verdict(verdict::of_flight(&recording, Some(&run.measured)))];
            parts.extend(flight_parts(&recording));
            sections.push(Section { title: titled(&title), name, parts });
        }
    }
    Ok(sections)
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{KEYS, Kind};

    use super::*;

    #[test]
    fn every_point_of_a_sweep_has_its_own_values_and_summary() {
        let run = |point: usize, seed: u64, late_s: f64, scenario: &[(&str, &str)]| Flown {
            folder: format!("sweep/point-{point}/seed-{seed}").into(),
            measured: Measured {
                seed,
                texts: BTreeMap::new(),
                figures: BTreeMap::from([("in_band_s".to_owned(), Some(late_s))]),
                never: BTreeSet::new(),
                uncontrolled: Vec::new(),
            },
            scenario: scenario.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect(),
        };
        let calm = [("mission.events", "[]"), ("network.loss", "0"), ("vehicle.1.aircraft", "\"light\"")];
        let killed = [
            ("mission.events[0].at_s", "60"),
            ("mission.events[0].fault", "\"kill\""),
            ("network.loss", "0"),
            ("vehicle.1.aircraft", "\"heavy\""),
            ("vehicle.10.aircraft", "\"light\""),
        ];
        let folder = Folder {
            path: "sweep".into(),
            runs: vec![
                run(1, 0, 5.0, &calm),
                run(1, 1, 6.0, &calm),
                run(2, 0, 50.0, &killed),
                run(2, 1, 40.0, &killed),
                run(3, 0, 7.0, &calm),
            ],
            is_unfinished: false,
            swept: ["mission.events", "network.loss", "vehicle.1", "start"].map(str::to_owned).to_vec(),
        };
        let points = points(&folder);
        let values: Vec<_> = points.iter().map(|point| point.values.join("|")).collect();
        let of_calm = "[]|0|aircraft=light|–";
        assert_eq!(values, [of_calm, "[0].at_s=60 [0].fault=kill|0|aircraft=heavy|–", of_calm]);
        let medians: Vec<_> = points.iter().map(|point| point.summary["in_band_s"].median).collect();
        assert_eq!(medians, [Some(5.5), Some(45.0), Some(7.0)]);
        let worst: Vec<_> = points.iter().map(|point| worst_and_median(&point.measured())).collect();
        assert_eq!(worst, [Some((1, 0)), Some((0, 1)), Some((0, 0))]);
    }

    #[test]
    fn the_name_of_every_numeric_key_ends_in_its_unit() {
        const UNITS: [&str; 13] = ["m", "s", "ms", "us", "s2", "per", "bit", "deg", "hz", "j", "bytes", "ppm", "rad"];
        for key in KEYS.iter().filter(|key| matches!(key.kind, Kind::Number(_) | Kind::NumberOr(..))) {
            let name = key.path.rsplit('.').next().unwrap_or(key.path);
            let label = axis(name).label;
            let (quantity, unit) = label.rsplit_once(", ").unwrap_or((&label, "1"));
            let last = quantity.rsplit(' ').next().unwrap();
            assert!(!UNITS.contains(&last), "{name}: {label}");
            let spelled = unit.replace("1/", "per_").replace('/', "_").replace('²', "2").replace('°', "deg");
            assert!(unit == "1" || name.ends_with(&spelled.replace("Hz", "hz")), "{name}: {label}");
        }
    }

    #[test]
    fn the_label_of_an_axis_has_the_unit_of_its_key() {
        for (key, label) in [
            ("in_band_s", "all in the band from then on, s"),
            ("bandwidth_bit_s", "bandwidth, bit/s"),
            ("friction_m_s2", "friction, m/s²"),
            ("radius_m", "radius, m"),
            ("speed_m_s", "speed, m/s"),
            ("loss", "loss"),
            ("collisions", "pairs nearer than 2 m, pairs"),
            ("spacing_error_deg", "largest gap error, mean, °"),
        ] {
            assert_eq!(axis(key).label, label);
        }
    }
}
