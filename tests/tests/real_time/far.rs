//! A flight far from the origin in real time, as `tests/virtual_time/far.rs` flies more of them in virtual time.

use skein_tests::share::Share;

/// Three vehicles, 54 km from the origin of the swarm's frame.
const FAR: &str = "name = 'far'
[origin]
latitude_deg = 60.0
longitude_deg = 179.5
elevation_m = 30
[swarm]
vehicles = 3
[formation]
radius_m = 60
altitude_m = 25
[mission]
steps = [{ centre_ne_m = [-20000, 50000], dwell_s = 60 }, { land = true }]
[vehicle.1]
start_ne_m = [-19960, 50005]
[vehicle.2]
start_ne_m = [-20025, 50030]
[vehicle.3]
start_ne_m = [-20020, 49965]
";

#[test]
fn a_swarm_far_away_flies_and_lands_in_real_time_over_stand_ins() {
    let _share = Share::of_flight(6);
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("far.toml"), FAR).unwrap();
    let mut fly = std::process::Command::new(env!("CARGO_BIN_EXE_skein-under-test"));
    fly.env("XDG_RUNTIME_DIR", folder.path().join("runtime")).env_remove("RUST_LOG").current_dir(folder.path());
    fly.args(["fly", "far.toml", "--plant", "standin", "--json", "--no-view", "--out", "out"]);
    for set in ["formation.altitude_m=8", "formation.radius_m=40", "mission.steps[0].dwell_s=5", "duration_s=600"] {
        fly.args(["--set", set]);
    }
    let flown = fly.output().unwrap();
    let (stdout, stderr) = (String::from_utf8_lossy(&flown.stdout), String::from_utf8_lossy(&flown.stderr));
    assert!(flown.status.success(), "{stderr}");
    let metrics = std::fs::read_to_string(folder.path().join("out/metrics.json")).unwrap();
    let metrics: serde_json::Value = serde_json::from_str(&metrics).unwrap();
    assert_eq!((&metrics["collisions"], &metrics["crashes"]), (&0.into(), &0.into()), "{stdout}{stderr}");
    assert!(metrics["at_altitude_s"].is_number() && metrics["setpoints_reached"].as_u64() >= Some(1), "{metrics}");
}
