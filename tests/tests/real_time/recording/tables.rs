//! A recording as tables.

use skein_tests::share::Share;
use std::collections::BTreeMap;
use std::fs;

use skein_lab::record::{csv, read};

use super::{SETS, flown};

#[test]
fn every_step_every_pair_and_every_event_has_its_row() {
    let _share = Share::of(100);
    let folder = tempfile::tempdir().unwrap();
    let (.., path) = flown(&folder, &SETS, 6);
    let written = csv(&path, &folder.path().join("tables")).unwrap();
    let tables: BTreeMap<String, String> = written
        .iter()
        .map(|path| (path.file_name().unwrap().to_str().unwrap().to_owned(), fs::read_to_string(path).unwrap()))
        .collect();
    let recording = read(&path).unwrap();
    let steps: usize = recording.tracks.iter().map(|track| track.steps.len()).sum();

    let mut rows = tables["trace.csv"].lines();
    let names: Vec<&str> = rows.next().unwrap().split(',').collect();
    let begins = ["t_s", "vehicle", "incarnation", "sequence", "stamp_s", "plant_time_s", "membership", "activity"];
    assert_eq!(names[..8], begins);
    assert!(rows.clone().all(|row| row.split(',').count() == names.len()));
    assert_eq!(rows.clone().count(), steps);
    let column = |name: &str| names.iter().position(|it| *it == name).unwrap();
    let last: Vec<&str> = rows.rfind(|row| row.split(',').nth(1) == Some("1")).unwrap().split(',').collect();
    let step = recording.tracks[0].steps.last().unwrap();
    let cell = |name: &str| last[column(name)].parse::<f64>().unwrap();
    assert_eq!(
        (cell("t_s"), cell("north_m"), cell("down_m")),
        (step.t_s, step.trace.position.0.x, step.trace.position.0.z)
    );
    assert_eq!(
        (cell("stick_collective"), cell("error_east_m")),
        (step.trace.controls.unwrap()[3], step.trace.error_ne_m[1])
    );
    assert_eq!((last[column("membership")], last[column("step_us")]), ("Active", ""));

    let pairs: usize = recording.tracks.iter().flat_map(|track| &track.steps).map(|step| step.trace.peers.len()).sum();
    assert_eq!(tables["peers.csv"].lines().count(), pairs + 1);
    assert!(
        tables["peers.csv"].starts_with("t_s,vehicle,peer,standing,age_s,delay_s,delivered_age_s\n0.02,1,2,Fresh,")
    );
    assert_eq!(tables["events.csv"].lines().count(), recording.noted.len() + 1);
    assert!(tables["events.csv"].contains(",fault,2,engine_out of vehicle 2\n"));
    assert!(tables["events.csv"].contains(",event,1,at altitude\n"));
}
