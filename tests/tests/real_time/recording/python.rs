//! What the public Python reader finds.

use skein_common::math;
use std::fs;
use std::path::Path;

use serde_json::Value;
use skein_lab::record::repair;
use skein_tests::python::look;
use skein_tests::share::Share;

use super::{SETS, flown};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(number).collect()
}

/// What every recording of a swarm has, in Foxglove's frames.
pub(super) fn check(found: &Value, vehicles: usize) {
    let schema = |topic: &str| found["schemas"][topic].clone();
    let protobuf = |name: &str| Value::from(vec![name, "protobuf", "protobuf"]);
    let json = |name: &str| Value::from(vec![name, "jsonschema", "json"]);
    assert_eq!(schema("/tf"), protobuf("foxglove.FrameTransforms"));
    assert_eq!(schema("/scene/vehicles"), protobuf("foxglove.SceneUpdate"));
    assert_eq!(schema("/scene/formation"), protobuf("foxglove.SceneUpdate"));
    assert_eq!(schema("/log"), protobuf("foxglove.Log"));
    assert_eq!(schema("/events"), json("skein.Event"));
    assert_eq!(found["wrong_keys"], Value::Array(Vec::new()), "every key that the schemas name, and no other");
    let counts = found["counts"].as_object().unwrap();
    let all: u64 = counts.values().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!(found["messages"].as_u64(), Some(all));
    let span_ns = numbers(&found["span_ns"]);
    let span_s = (span_ns[1] - span_ns[0]) / 1e9;
    for id in 1..=vehicles {
        let trace = format!("/vehicle/{id}/trace");
        assert_eq!(schema(&trace), json("skein.Trace"));
        assert_eq!(schema(&format!("/vehicle/{id}/location")), protobuf("foxglove.LocationFix"));
        let fixes = counts[&format!("/vehicle/{id}/location")].as_u64().unwrap();
        assert!((1..=(2.0 * span_s) as u64 + 2).contains(&fixes), "{fixes} in {span_s} s");
        let frame = format!("vehicle/{id}");
        let (last, traced) = (&found["last"][&frame], &found["traces"][id.to_string()]);
        let [north, east, down] = numbers(&traced["position"])[..] else { panic!("three numbers") };
        assert_eq!(numbers(&last["place"]), [east, north, -down], "east, north, up");
        assert_eq!((&last["parent"], &last["is_on_time"]), (&"world".into(), &true.into()));
        // It climbed, and stayed upright.
        let (first_m, highest_m) = (number(&found["first"][&frame]["place"][2]), number(&found["highest_m"][&frame]));
        assert!(first_m < 2.0 && highest_m > first_m + 1.0, "from {first_m} m up to {highest_m} m");
        assert!(number(&found["upright"][&frame]) > 0.8, "never hung upside down");
        let heading_rad = number(&traced["attitude"]["heading_rad"]);
        let forward = numbers(&last["forward"]);
        let along = forward[0] * math::sin(heading_rad) + forward[1] * math::cos(heading_rad);
        assert!(along > 0.9, "its nose points along its heading: {forward:?}, {heading_rad}");
        let (fix, at) = (numbers(&found["fixes"][&frame][0]), numbers(&found["fixes"][&frame][1]));
        let (north, down) = (at[0], at[2]);
        // A degree of latitude is about 111 km.
        assert!((fix[0] - 28.0 - north / 110_850.0).abs() < 1e-5 && (fix[2] + down).abs() < 0.1, "{fix:?}");
    }
    let scene = found["scene"].as_array().unwrap();
    assert!(scene.contains(&Value::from(vec!["/scene/vehicles", "vehicle/1", "vehicle/1"])));
    assert!(scene.contains(&Value::from(vec!["/scene/formation", "formation", "centre"])));
    assert_eq!(found["last"]["centre"]["parent"], "world");
    assert!(found["attachments"]["scenario.toml"].as_str().unwrap().contains("vehicles = "));
}

#[test]
fn a_study_opens_in_python_and_agrees_with_its_figures() {
    let _share = Share::of(100);
    let folder = tempfile::tempdir().unwrap();
    let calm = ["duration_s=30", "swarm.vehicles=3", "formation.altitude_m=8", "formation.radius_m=60"];
    let (_, report, path) = flown(&folder, &[&calm[..], &["record.hz=50"]].concat(), 7);
    let Some(found) = look(&[&path]) else { return };
    let found = &found[0];
    check(found, 3);
    let close = |one: &Value, two: f64| (number(one) - two).abs() < 1e-9;
    assert!(close(&found["nearest_pair_m"], report.nearest_pair_end_m.unwrap()));
    assert!(close(&found["tilt_deg"], report.max_tilt_deg), "{} {}", found["tilt_deg"], report.max_tilt_deg);
    assert_eq!(found["state_messages"].as_u64(), Some(report.state_messages));
    assert_eq!(found["counts"]["/vehicle/2/trace"], 1_500);
    assert_eq!(found["counts"]["/vehicle/2/location"], 61);
    assert_eq!(found["is_ordered"], true);
    assert_eq!(found["span_ns"], Value::from(vec![0, 30_000_000_000_u64]));
    let run = &found["metadata"]["skein.run"];
    assert_eq!((&run["seed"], &run["target"], &run["format"]), (&"7".into(), &"study".into(), &"1".into()));
    assert_eq!((&run["version"], &run["revision"]), (&report.run.version.into(), &report.run.revision.into()));
    assert_eq!(found["metadata"]["skein.window_ends"]["log_time_ns"], "30000000000");
    assert_eq!(found["metadata"]["skein.recorder"]["refused_steps"], "0");
}

#[test]
fn repaired_files_open_in_python_with_all_that_was_kept() {
    let _share = Share::of(100);
    let folder = tempfile::tempdir().unwrap();
    let (.., path) = flown(&folder, &SETS, 8);
    let bytes = fs::read(&path).unwrap();
    let repaired: Vec<_> = (1..=5)
        .map(|part| {
            let cut = folder.path().join(format!("cut-{part}.mcap"));
            fs::write(&cut, &bytes[..bytes.len() * part / 6]).unwrap();
            repair(&cut).unwrap()
        })
        .collect();
    let files: Vec<&Path> = repaired.iter().map(|repaired| repaired.to.as_deref().unwrap()).collect();
    let Some(found) = look(&[&files[..], &[&path]].concat()) else { return };
    for (found, repaired) in found.iter().zip(&repaired) {
        assert_eq!(found["messages"].as_u64(), Some(repaired.messages));
        assert_eq!(found["metadata"]["skein.run"]["seed"], "8");
    }
    let whole = &found[5];
    let faults: Vec<&str> = whole["faults"].as_array().unwrap().iter().filter_map(|it| it["text"].as_str()).collect();
    assert_eq!(faults.len(), 5, "{faults:?}");
    let expected = [
        "cut: vehicle 1 to 2",
        "healed: vehicle 1 to 2",
        "the agent of vehicle 3 ended",
        "vehicle 3 has a new agent",
        "engine_out of vehicle 2",
    ];
    assert!(expected.iter().all(|text| faults.contains(text)), "{faults:?}");
    let log = whole["log"].as_array().unwrap();
    assert!(expected.iter().all(|text| log.contains(&(*text).into())));
    assert_eq!(log.len(), faults.len() + whole["events"].as_array().unwrap().len());
    assert_eq!(whole["faults"][4]["what"]["Failed"][1], "engine_out");
}
