//! Reports on a folder of scenarios: each is flown in virtual time, once for the figures and over many seeds for the
//! tables.

use std::collections::BTreeSet;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use skein_common::scenario::{Layer, Loaded, Preset};
use skein_host::parallel::cores;

use super::page::{Page, Part, Section};
use super::{flight_parts, stem, tables, verdict};
use crate::compare::folder::unreadable;
use crate::error::Error;
use crate::metrics::{Measured, Run};
use crate::recording::Recording;
use crate::scenario::{Ready, ScenarioArgs};
use crate::study::{Study, summarize};

/// Seeds over which the tables of figures are measured.
const SEEDS: Range<u64> = 0..20;
/// Figures that the table of a scenario shows.
const SHOWN: [&str; 12] = [
    "at_altitude_s",
    "in_band_s",
    "even_10deg_s",
    "radial_rms_m",
    "radial_mean_m",
    "spacing_error_deg",
    "nearest_pair_end_m",
    "min_separation_m",
    "collisions",
    "band_occupancy",
    "max_centre_distance_m",
    "centroid_lag_m",
];

/// The scenario files of a folder, sorted by name.
pub(super) fn in_folder(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let entries = fs::read_dir(folder).map_err(|error| unreadable(folder, &error))?;
    let mut paths: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|ending| ending == "toml") && path.is_file());
    paths.sort();
    Ok(paths)
}

/// Flies all scenarios and makes their page.
pub(super) fn page(folder: &Path, scenarios: &[PathBuf]) -> Result<Page, Error> {
    let mut all = Vec::new();
    for path in scenarios {
        let args = ScenarioArgs { scenario: Some(path.clone()), sets: Vec::new() };
        let loaded = args.read(Vec::new())?;
        let Ready { aircraft, rules, .. } = args.ready(&loaded.scenario)?;
        let study = Study { scenario: loaded.scenario.clone(), aircraft, rules, laws: Default::default() };
        all.push((path, loaded, study));
    }
    let is_paper = all.iter().all(|(_, loaded, _)| loaded.scenario.preset == Preset::Paper);
    let mut sections = Vec::new();
    for (path, loaded, study) in &all {
        let name = path.display();
        eprintln!("{name}: seeds {} to {} and a recording", SEEDS.start, SEEDS.end - 1);
        let failed = |error| Error::Failed(format!("{name}: {error}"));
        let mut recording = Recording::new(&loaded.scenario, Run::new(&loaded.scenario, "study"));
        let rate_hz = loaded.scenario.record.hz.in_study_hz();
        let flown = study.fly_watched(loaded.scenario.seed, Some((&mut recording, rate_hz))).map_err(failed)?;
        let mut parts = vec![Part::Verdict(verdict::of_flight(&recording, Some(&Measured::of(&flown))))];
        parts.extend(flight_parts(&recording));
        parts.push(measured(study).map_err(failed)?);
        let title = format!("{}, seed {}", loaded.scenario.name, loaded.scenario.seed);
        sections.push(Section { title, name: stem(path), parts });
    }
    sections.push(Section {
        title: if is_paper { "Parameters (the paper's Table 1)".to_owned() } else { "Parameters".to_owned() },
        name: "parameters".to_owned(),
        parts: vec![parameters(all.iter().map(|(_, loaded, _)| loaded))],
    });
    let version = format!("skein {}, revision {}", crate::VERSION, crate::REVISION);
    let (title, about) = if is_paper {
        let title = "The evaluation of Garcia & Barnes (2010)";
        (
            title.to_owned(),
            format!("R. Garcia & L. Barnes, Multi-UAV Simulator Utilizing X-Plane, section 5, flown by {version}."),
        )
    } else {
        (format!("Scenarios in {}", folder.display()), format!("Flown in virtual time by {version}."))
    };
    Ok(Page { title, about, verdict: Vec::new(), sections })
}

/// A table of the keys that the scenarios set, side by side. It leaves out missions and single vehicles.
fn parameters<'a>(all: impl Iterator<Item = &'a Loaded> + Clone) -> Part {
    let is_set = |origin: &Layer| !matches!(origin, Layer::Default);
    let is_plain = |key: &str| !key.contains('[') && !key.starts_with("vehicle.") && key != "name";
    let keys: BTreeSet<&str> = all
        .clone()
        .flat_map(|loaded| loaded.explain().iter().filter(|line| is_set(&line.origin) && is_plain(&line.key)))
        .map(|line| line.key.as_str())
        .collect();
    let cell = |loaded: &Loaded, key: &str| {
        let line = loaded.explain().iter().find(|line| line.key == key);
        line.and_then(|line| line.value.clone()).unwrap_or_else(|| "–".to_owned())
    };
    let about = |key: &str| {
        let mut lines = all.clone().flat_map(Loaded::explain);
        lines.find(|line| line.key == key).map_or(String::new(), |line| line.about.to_owned())
    };
    let row = |key: &str| {
        let cells = all.clone().map(|loaded| cell(loaded, key));
        [key.to_owned()].into_iter().chain(cells).chain([about(key)]).collect()
    };
    let names = all.clone().map(|loaded| loaded.scenario.name.clone());
    Part::Table {
        caption: "Keys that a scenario, its preset or another key sets; all other keys have their defaults.".to_owned(),
        head: ["key".to_owned()].into_iter().chain(names).chain(["meaning".to_owned()]).collect(),
        rows: keys.into_iter().map(row).collect(),
    }
}

/// Flies the scenario over many seeds and makes a table of its figures.
fn measured(study: &Study) -> Result<Part, crate::study::StudyError> {
    let summary = summarize(&study.fly_all(SEEDS, cores(), |_| {})?);
    let caption = format!("Figures over {} seeds.", SEEDS.end - SEEDS.start);
    Ok(tables::of_runs(caption, &summary, SHOWN.into_iter()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(unix)]
    fn a_scenario_that_fails_in_flight_ends_with_status_1() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gone.toml");
        let text = "swarm.vehicles = 1\n[formation]\nlaw = 'external'\nexternal.command = ['true']\n";
        fs::write(&path, text).unwrap();
        let error = page(folder.path(), &in_folder(folder.path()).unwrap()).unwrap_err();
        assert!(error.exit_code() == 1 && error.to_string().contains("the law of vehicle 1 has ended"), "{error}");
    }
}
