//! Agents of a live flight with faults, run again with their recorded inputs.

use skein_tests::share::Share;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};

use serde_json::Value;
use tempfile::TempDir;

/// A ring of four in a wind, over a lossy network. Agent 2 is killed and restarted, the simulator of vehicle 3 stands still for a
/// while, and nothing goes wrong at vehicles 1 and 4 themselves.
const SCENARIO: &str = r#"
name = "replayed"
swarm.vehicles = 4
formation.radius_m = 30
world = { wind_m_s = 3, gust_w20_m_s = 2 }
network = { loss = 0.1, delay_s = 0.05, jitter_s = 0.05 }
[mission]
events = [
  { at_s = 6, fault = "kill", vehicle = 2, for_s = 4 },
  { at_s = 8, fault = "simulator_freeze", vehicle = 3, for_s = 4 },
]
"#;

/// One flight at a time: the agents of two would share the processors.
static FLIGHT: Mutex<()> = Mutex::new(());

fn skein(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_skein-under-test")).args(arguments).current_dir(folder).output().unwrap()
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// The files of inputs that a flight of 30 s leaves, in order of their names.
fn flown(folder: &Path, sets: &[&str]) -> Vec<PathBuf> {
    let _alone = FLIGHT.lock().unwrap_or_else(PoisonError::into_inner);
    fs::write(folder.join("replayed.toml"), SCENARIO).unwrap();
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    let arguments = ["fly", "replayed.toml", "--duration", "30", "--out", "out", "--no-view"];
    let flight = skein(folder, &arguments.into_iter().chain(sets).collect::<Vec<_>>());
    assert!(flight.status.success(), "{}", text(&flight));
    let entries = fs::read_dir(folder.join("out/agents")).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = entries.filter(|path| path.extension().is_some_and(|end| end == "inputs")).collect();
    files.sort();
    files
}

fn vehicle_of(path: &Path) -> u8 {
    path.file_name().unwrap().to_str().unwrap().split_once('-').unwrap().0.parse().unwrap()
}

fn replayed(folder: &Path, file: &Path, more: &[&str]) -> Value {
    let mut arguments = vec!["replay", file.to_str().unwrap(), "--json"];
    arguments.extend(more);
    let output = skein(folder, &arguments);
    assert!(output.status.success(), "{}", text(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn every_agent_of_a_live_flight_with_faults_decides_the_same_again() {
    let _share = Share::of(60);
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let files = flown(folder, &["record.inputs=true"]);
    assert_eq!(files.iter().map(|path| vehicle_of(path)).collect::<Vec<_>>(), [1, 2, 2, 3, 4]);
    for file in &files {
        let all = replayed(folder, file, &[]);
        let seconds = all["end_s"].as_f64().unwrap();
        let (bytes, steps) = (fs::metadata(file).unwrap().len(), all["steps"].as_u64().unwrap());
        println!("vehicle {}: {steps} steps, {:.1} kB/s", all["vehicle"], bytes as f64 / seconds / 1e3);
        assert_eq!((&all["same"], &all["damage"]), (&Value::Bool(true), &Value::Null));
        assert!(steps > 100 && seconds > 3.0, "{steps} steps, {seconds} s");
    }
    // Only the process that was killed had no time to write its last second.
    let of_3 = &files[3];
    let events = replayed(folder, of_3, &[])["events"].to_string();
    assert!(events.contains("simulator lost"), "{events}");
    let state = &replayed(folder, of_3, &["--break-at", "SimulatorLost"])["state"];
    assert_eq!(state["activity"], "Blind");
    assert_eq!(state["peers"].as_array().unwrap().len(), 3);
    let text_of = |more: &[&str]| text(&skein(folder, &[&["replay", of_3.to_str().unwrap()], more].concat()));
    let shown = text_of(&["--break-at", "5"]);
    assert!(shown.contains("\nat 5.0") && shown.contains("  peer 1 "), "{shown}");
    assert!(text_of(&[]).contains("all outputs are the same as in flight, byte for byte"));
    assert!(text_of(&["--break-at", "1e6"]).contains("no step at 1000000 s or later"));

    // A changed byte is found.
    let mut bytes = fs::read(of_3).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(folder.join("changed.inputs"), &bytes).unwrap();
    let changed = skein(folder, &["replay", "changed.inputs"]);
    assert_eq!(changed.status.code(), Some(2), "{}", text(&changed));
    assert!(text(&changed).contains("do not match their checksum"), "{}", text(&changed));
    // A file of another kind is refused.
    let other = skein(folder, &["replay", "replayed.toml"]);
    assert_eq!(other.status.code(), Some(2));
    assert!(text(&other).contains("this is not a file of an agent's inputs"), "{}", text(&other));
}

#[test]
fn only_the_agent_that_meets_a_fault_leaves_its_inputs() {
    let _share = Share::of(60);
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let files = flown(folder, &[]);
    assert_eq!(files.iter().map(|path| vehicle_of(path)).collect::<Vec<_>>(), [3]);
    assert_eq!(replayed(folder, &files[0], &[])["same"], true);
}
