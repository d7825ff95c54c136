use std::collections::BTreeSet;

use serde_json::{Value, json};
use skein_common::frame::{Attitude, PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleName};
use skein_common::message::{Failure, PeerContact, ProcessFigures, VehicleFacts};
use skein_common::scenario::{Scenario, Setting, Source, load, load_any};
use skein_common::state::{Activity, Membership, PeerStatus};
use skein_lab::record::{PlayedPlace, Player, VehiclePlace};

use super::field::Field;
use super::snapshot::{Level, Snapshot, Status, Team, Vehicle, add_nearest, vehicles};
use super::verdict::Judged;
use super::*;
use skein_cluster::display::status::Known;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

fn scenario(text: &str) -> Scenario {
    load(&Source { name: "test.toml", text }, &[]).unwrap().scenario
}

fn four() -> Team {
    let steps = "mission.steps = [{ centre_ne_m = [0.0, 0.0] }, { hold_s = 20.0, formation = { radius_m = 60.0 } }, { land = true }]";
    Team::new(&scenario(&format!("swarm.vehicles = 4\n{steps}")))
}

/// Vehicle `number` of four, evenly on the ring, received so long ago.
fn observed(number: u8, silent_s: f64, change: impl FnOnce(&mut VehicleFacts)) -> Known {
    let bearing_rad = f64::from(number) * std::f64::consts::FRAC_PI_2;
    let (sin, cos) = skein_common::math::sin_cos(bearing_rad);
    let peer = |other: u8| PeerContact { id: id(other), age_ms: 80 + u32::from(other), standing: PeerStatus::Fresh };
    let mut sample = VehicleFacts {
        flown_s: Some(12.34),
        activity: Activity::Formation,
        membership: Membership::Active,
        in_place_s: Some(9.0),
        live: 4,
        position: Some(PositionNed::new(100.0 * cos, 100.0 * sin, -30.0)),
        velocity: VelocityNed::new(1.0, -2.0, 0.5),
        attitude: Attitude { roll_rad: 0.01, pitch_rad: -0.02, heading_rad: 1.5 },
        altitude_setpoint_m: Some(30.0),
        field_ne: Some([0.1, -0.1]),
        error_ne_m: Some([1.5, 0.0]),
        energy_left: Some(0.5),
        process: Some(ProcessFigures {
            frame_rate_hz: 50.0,
            jitter_ms: 0.2,
            step_p99_us: 24.0,
            frame_overruns: 0,
            dropped: 2,
            unsent: 1,
        }),
        peers: (1..=4).filter(|other| *other != number).map(peer).collect(),
        ..VehicleFacts::default()
    };
    change(&mut sample);
    let newest = Some((sample, Duration::from_secs_f64(silent_s)));
    Known { id: id(number), newest, is_healthy: true, ended: None, order: None }
}

fn snapshot(team: &Team, observed: &[Known]) -> Snapshot {
    let (rows, mut all) = vehicles(team, observed);
    add_nearest(&mut all);
    let status = verdict::status(&[Judged { team, observed, rows: &rows, vehicles: &all }]);
    Snapshot { t_s: Some(12.34), at_ms: 1_700_000_000_000, status, vehicles: all, teams: Vec::new() }
}

fn as_json(snapshot: &Snapshot) -> Value {
    serde_json::from_str(&snapshot.to_json(&BTreeSet::new(), None::<&Field>)).unwrap()
}

#[test]
fn a_snapshot_is_the_golden_json() {
    let team = four();
    let all = [1, 2, 3, 4].map(|number| observed(number, 0.05, |_| ()));
    let json = as_json(&snapshot(&team, &all));
    assert_eq!(
        json["status"],
        json!({
            "level": "ok",
            "text": "4/4 in formation · step 0 of 2 · worst gap 0.0° · nearest 141.4 m · oldest message 84 ms",
            "reasons": [],
        })
    );
    let golden = json!({
        "id": "1", "contact": true, "silent_s": 0.05, "phase": "formation", "in_place_s": 9.0, "membership": "active", "step": 0, "reached": null,
        "live": 4, "ne_m": [0.0, 100.0], "altitude_m": 30.0, "velocity_ned_m_s": [1.0, -2.0, 0.5],
        "attitude_rad": [0.01, -0.02, 1.5], "centre_ne_m": [0.0, 0.0], "distance_m": 100.0, "gap_deg": 90.0,
        "gap_error_deg": 0.0, "nearest_m": 141.421, "nearest": "2", "setpoint_altitude_m": 30.0, "field_ne": [0.1, -0.1],
        "error_ne_m": [1.5, 0.0], "controls": null, "energy_left": 0.5, "frame_rate_hz": 50.0, "jitter_ms": 0.2, "step_p99_us": 24.0,
        "overruns": 0, "refused": 2, "unsent": 1, "failures": [], "order": null,
        "peers": [["2", 82, "fresh"], ["3", 83, "fresh"], ["4", 84, "fresh"]],
    });
    let mut vehicle = json["vehicles"][0].clone();
    // A zero may be a negative one.
    vehicle["ne_m"][0] = json!(vehicle["ne_m"][0].as_f64().unwrap().abs());
    vehicle["gap_error_deg"] = json!(vehicle["gap_error_deg"].as_f64().unwrap().abs());
    assert_eq!(vehicle, golden);
    let top: Vec<_> = json.as_object().unwrap().keys().cloned().collect();
    assert_eq!(
        (top, &json["type"]),
        (["at_ms", "status", "t_s", "type", "vehicles"].map(str::to_owned).to_vec(), &json!("snapshot"))
    );
}

#[test]
fn a_vehicle_in_the_phase_formation_that_is_not_in_its_place_is_under_way() {
    let team = four();
    let strayed = |number: u8| {
        observed(number, 0.0, |sample| {
            sample.in_place_s = None;
            sample.position = Some(PositionNed::new(240.0 * f64::from(number), 0.0, -30.0));
        })
    };
    let far = snapshot(&team, &[1, 2, 3, 4].map(strayed));
    let json = as_json(&far);
    let text = json["status"]["text"].as_str().unwrap();
    assert!(text.starts_with("4/4 under way · ") && !text.contains("in formation"), "{text}");
    assert_eq!(
        (&json["vehicles"][0]["phase"], &json["vehicles"][0]["in_place_s"]),
        (&json!("formation"), &Value::Null)
    );
    let one = [
        observed(1, 0.0, |_| ()),
        strayed(2),
        strayed(3),
        observed(4, 0.0, |sample| sample.activity = Activity::Landing),
    ];
    let text = snapshot(&team, &one).status.text;
    // A vehicle that lands is in no formation, wherever it is.
    assert!(text.starts_with("1/4 in formation, 1 landing, 2 under way · "), "{text}");
}

#[test]
fn what_an_operator_has_set_is_drawn_from_when_it_takes_effect() {
    let team = four();
    let set = |text: &str| text.parse::<Setting>().unwrap();
    let tuned = |number: u8, radius: &str| {
        observed(number, 0.0, |sample| sample.settings = vec![set(radius), set("formation.safety_distance_m=200")])
    };
    let at = |all: &[Known]| as_json(&snapshot(&team, all));
    let before = at(&[1, 2, 3, 4].map(|number| observed(number, 0.0, |_| ())));
    assert_eq!(before["vehicles"][0]["formation"], Value::Null, "as the scenario has it");
    // On the way to 80 m.
    let during = at(&[1, 2, 3, 4].map(|number| tuned(number, "formation.radius_m=93.5")));
    let formation = &during["vehicles"][3]["formation"];
    assert_eq!((&formation["radius_m"], &formation["safety_distance_m"]), (&json!(93.5), &json!(200.0)));
    assert!(during["status"]["reasons"].to_string().contains("less than the safety distance of 200 m"), "{during}");
    // The field around a vehicle is that of its present ring.
    let inside = [1, 2, 3, 4].map(|number| tuned(number, "formation.radius_m=150"));
    let Field { north_m, .. } = field::field(&team, &inside, id(1)).unwrap();
    let all = [1, 2, 3, 4].map(|number| observed(number, 0.0, |_| ()));
    let Field { north_m: of_100_m, .. } = field::field(&team, &all, id(1)).unwrap();
    assert!((north_m[20] - of_100_m[20] - 75.0).abs() < 1e-9, "{} {}", north_m[20], of_100_m[20]);
    // A step with a value of its own keeps it.
    let second = observed(1, 0.0, |sample| (sample.step, sample.settings) = (1, vec![set("formation.radius_m=80")]));
    assert_eq!(at(&[second])["vehicles"][0]["formation"]["radius_m"], json!(60.0));
}

#[test]
fn a_silent_vehicle_stays_where_dead_reckoning_puts_it_for_five_seconds() {
    let team = four();
    let at = |silent_s: f64| {
        let all = [
            observed(1, 0.0, |_| ()),
            observed(3, silent_s, |sample| sample.position = Some(PositionNed::new(0.0, 0.0, -30.0))),
        ];
        let json = as_json(&snapshot(&team, &all));
        (json["vehicles"][1].clone(), json["status"].clone())
    };
    let (near, _) = at(0.5);
    assert_eq!((&near["contact"], &near["ne_m"]), (&json!(true), &json!([0.0, 0.0])));
    for (silent_s, ne_m) in [(2.0, [2.0, -4.0]), (5.0, [5.0, -10.0]), (60.0, [5.0, -10.0])] {
        let (ghost, status) = at(silent_s);
        assert_eq!(
            (&ghost["contact"], &ghost["ne_m"], &ghost["altitude_m"]),
            (&json!(false), &json!(ne_m), &json!(30.0))
        );
        assert_eq!((&ghost["nearest_m"], &ghost["phase"]), (&Value::Null, &json!("formation")));
        assert_eq!(status["level"], "bad");
        assert_eq!(status["reasons"][0], format!("vehicle 3: silent for {silent_s:.0} s"));
        assert!(status["text"].as_str().unwrap().starts_with("1/2 in formation, 1 silent"), "{status}");
    }
}

#[test]
fn the_status_names_what_is_wrong_the_worst_first() {
    let team = four();
    let status = |observed: &[Known]| snapshot(&team, observed).status;
    let all = |change: fn(u8, &mut VehicleFacts)| {
        [1, 2, 3, 4].map(|number| observed(number, 0.0, |sample| change(number, sample)))
    };
    let good = status(&all(|_, _| ()));
    assert_eq!((good.level, good.reasons.len()), (Level::Ok, 0));

    let cut = status(&all(|number, sample| {
        let own = number <= 2;
        sample
            .peers
            .iter_mut()
            .filter(|peer| (peer.id.get() <= 2) != own)
            .for_each(|peer| peer.standing = PeerStatus::Lost);
    }));
    assert_eq!((cut.level, cut.reasons), (Level::Bad, vec!["2 partitions: 1, 2 | 3, 4".to_owned()]));

    let one_way = status(&all(|number, sample| {
        if number == 3 {
            sample.peers[0].standing = PeerStatus::Lost;
        }
    }));
    assert_eq!(
        (one_way.level, one_way.reasons),
        (Level::Warn, vec!["vehicle 3 does not receive vehicle 1".to_owned()])
    );

    let several = status(&all(|number, sample| match number {
        1 => sample.failures = vec![Failure::Engine],
        2 => sample.process = sample.process.map(|process| ProcessFigures { frame_rate_hz: 31.0, ..process }),
        3 => sample.activity = Activity::Blind,
        _ => sample.position = Some(PositionNed::new(1.0, -100.0, -30.0)),
    }));
    assert_eq!(several.level, Level::Bad);
    let expected = [
        "vehicle 1: engine out, autorotates",
        "vehicle 3: no data from its simulator",
        "vehicles 4 and 3: 1.0 m apart, a collision",
    ];
    for reason in expected {
        assert!(
            several.reasons[..3].iter().any(|known| known == reason || known.contains("1.0 m apart, a collision")),
            "{several:?}"
        );
    }
    assert!(several.reasons.contains(&"vehicle 2: 31 frames a second, fewer than 45".to_owned()), "{several:?}");

    let many = status(&all(|_, sample| sample.failures = vec![Failure::Gyro, Failure::Servo, Failure::Engine]));
    assert_eq!((many.reasons.len(), many.reasons.last().map(String::as_str)), (9, Some("and 4 more")));
}

#[test]
fn a_large_swarm_is_sent_as_bytes_with_the_details_that_a_page_asks_for() {
    let team = Team::new(&scenario("swarm.vehicles = 101\nstart.square_m = 300.0\nformation.radius_m = 200.0"));
    let (step, north_m, east_m, altitude_m, in_place) = (2, 3.5, -1.0, 30.0, true);
    let place = |number: u8| VehiclePlace { id: id(number), step, north_m, east_m, altitude_m, in_place };
    let played = |number: u8| PlayedPlace { place: place(number), velocity_ne_m_s: [0.0, 5.0] };
    // Vehicle 2 is not in the recording at this time, and vehicle 3 is not in its place, whatever its altitude.
    let of = |number: u8| (number != 2).then(|| played(number));
    let strays = |mut played: PlayedPlace| {
        played.place.in_place = false;
        played
    };
    let played = |number: u8| if number == 3 { of(number).map(strays) } else { of(number) };
    let all = (1..=101).map(|number| Vehicle::of_place(VehicleName::from(id(number)), played(number).as_ref()));
    let status = Status::plain("101 vehicles".to_owned());
    let large = Snapshot { t_s: Some(7.5), at_ms: 0, status, vehicles: all.collect(), teams: Vec::new() };
    assert_eq!(team.scenario.swarm.vehicles, large.vehicles.len());
    let detail = BTreeSet::from(["7".to_owned(), "100".to_owned(), "none".to_owned()]);
    let json: Value = serde_json::from_str(&large.to_json(&detail, None::<&Field>)).unwrap();
    let ids: Vec<_> = json["vehicles"].as_array().unwrap().iter().map(|vehicle| vehicle["id"].clone()).collect();
    assert_eq!(ids, ["7", "100"]);
    let bytes = large.places().unwrap();
    assert_eq!((&bytes[..4], bytes.len()), (&b"SKEN"[..], 16 + 17 * 101));
    assert_eq!((&bytes[4..8], &bytes[8..16]), (&101_u32.to_le_bytes()[..], &7.5_f64.to_le_bytes()[..]));
    let float = |column: usize, nth: usize| {
        let at = 16 + 4 * (101 * column + nth);
        f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    };
    let of = |nth: usize| [0, 1, 2, 3].map(|column| float(column, nth));
    assert_eq!(of(0), [3.5, -1.0, 30.0, 1.571], "it heads east");
    assert!(of(1).iter().all(|number| number.is_nan()), "not in the recording");
    assert_eq!(bytes[16 + 16 * 101..][..3], [0b101, 0, 0b1], "in contact and in place, absent, in contact");
}

#[test]
fn the_first_message_has_the_scenario_as_the_page_draws_it() {
    let hello = hello::hello(&[four()], "a.mcap", Some((0.0, 20.0)), None);
    let hello: Value = serde_json::from_str(&hello).unwrap();
    assert_eq!(
        (&hello["type"], &hello["version"], &hello["source"]),
        (&json!("hello"), &json!(1), &json!("recording"))
    );
    assert_eq!(
        (&hello["to_s"], &hello["vehicles"][3]),
        (&json!(20.0), &json!({ "id": "4", "team": null, "number": 4 }))
    );
    let scenario = &hello["scenario"];
    assert_eq!(
        (&scenario["even"], &scenario["collision_distance_m"], &hello["teams"]),
        (&json!(true), &json!(2.0), &json!([]))
    );
    let steps = scenario["steps"].as_array().unwrap();
    let kinds: Vec<_> = steps.iter().map(|step| step["kind"].clone()).collect();
    assert_eq!(
        (kinds, &steps[1]["formation"]["radius_m"]),
        (vec![json!("centre"), json!("hold"), json!("land")], &json!(60.0))
    );

    let text = "swarm.vehicles = 2\n[fleet]\nteams = 2\nspacing_m = 800.0\n";
    let fleet = load_any(&Source { name: "fleet.toml", text }, &[]).unwrap();
    let teams: Vec<Team> = fleet.all().iter().map(|loaded| Team::new(&loaded.scenario)).collect();
    let hello = hello::hello(&teams, "x", None, Some(true));
    let hello: Value = serde_json::from_str(&hello).unwrap();
    assert_eq!(hello["vehicles"][2], json!({ "id": "2/1", "team": 2, "number": 1 }));
    assert_eq!(hello["teams"].as_array().unwrap().len(), 2);
    assert_eq!(hello["teams"][1]["scenario"], Value::Null, "it flies the same as team 1");
    // Team 2 is 800 m from team 1, and its own origin is shown there.
    let origin = teams[1].to_page(PositionNed::new(0.0, 0.0, 0.0));
    let place = teams[1].scenario.team.unwrap().place_ne_m;
    assert!(
        (origin.north_m() - place[0]).abs() < 0.01 && (origin.east_m() - place[1]).abs() < 0.01,
        "{origin:?} {place:?}"
    );
}

#[test]
fn the_field_of_a_ring_points_to_the_ring() {
    let team = four();
    let all = [1, 2, 3, 4].map(|number| observed(number, 0.0, |_| ()));
    let Field { vehicle, north_m, east_m, ne } = field::field(&team, &all, id(1)).unwrap();
    assert_eq!((vehicle.as_str(), north_m.len(), east_m.len(), ne.len()), ("1", 21, 21, 441));
    // Far in the north-west it points to the south-east.
    let [north, east] = ne[20 * 21];
    assert!(north_m[20] > 100.0 && east_m[0] < -100.0 && north < 0.0 && east > 0.0, "{north} {east}");
    let silent = [1, 2, 3, 4].map(|number| observed(number, 9.0, |_| ()));
    assert_eq!(field::field(&team, &silent, id(1)), None);
}

#[test]
fn a_recording_is_found_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let error = recording(folder.path()).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("no run.mcap and no fleet.mcap"), "{error}");
    let path = folder.path().join("run.mcap");
    std::fs::write(&path, "no recording").unwrap();
    let error = recording(folder.path()).unwrap_err().to_string();
    assert!(error.contains("run.mcap: not an MCAP file"), "{error}");
    assert!(Player::open(&path).is_err());
}
