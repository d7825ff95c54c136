//! Files: recordings, inputs of agents, scenarios, aircraft, cluster files; and the requests between an operator's PC and its hosts.

use std::fs;
use std::path::Path;

use skein_agent::inputs::InputsReader;
use skein_agent::link::security::{Certified, certified};
use skein_cluster::inventory::Inventory;
use skein_cluster::protocol::{Answer, Request};
use skein_cluster::simulators::web::read_answer;
use skein_common::message::Message;
use skein_common::scenario::{Described, Scenario, Source, load_any};
use skein_core::aircraft::Aircraft;
use skein_fuzz::{assert_same, explore, explore_text};
use skein_lab::record::{self, Player};
use skein_lab::study::record_run;
use skein_tests::{SHIPPED, study};

#[test]
fn a_damaged_recording_is_refused_or_read_and_its_repair_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let as_flown = "swarm.vehicles = 2\nduration_s = 2\n";
    record_run(&study("hover.toml", &["swarm.vehicles=2", "duration_s=2"]), 1, as_flown, &path).unwrap();
    let recording = fs::read(&path).unwrap();
    assert!(record::read(&path).is_ok(), "the example is a recording");
    explore(150, &[recording], |bytes| {
        let path = folder.path().join("damaged.mcap");
        fs::write(&path, bytes).unwrap();
        let _ = record::read(&path);
        play(&path);
        if let Ok(record::Repaired { to: Some(repaired), messages, .. }) = record::repair(&path) {
            let again = record::repair(&repaired).unwrap();
            assert_eq!((again.to, again.messages), (None, messages));
            fs::remove_file(repaired).unwrap();
        }
    });
}

/// Plays what can be played of a file that may be damaged.
fn play(path: &Path) {
    let Ok(mut player) = Player::open(path) else { return };
    let (from_s, to_s) = player.span_s();
    let _ = player.events();
    for at_s in [from_s, 0.5, to_s, -1.0] {
        let traces = player.traces(at_s).map(|traces| traces.values().all(|(_, trace)| trace.is_plausible()));
        assert!(traces.unwrap_or(true));
    }
}

#[test]
fn damaged_inputs_of_an_agent_are_refused_or_read_up_to_the_damage() {
    let file = include_bytes!("../../specimens/messages-7/vehicle-2.inputs");
    let steps = |bytes: &[u8]| {
        let Ok(mut reader) = InputsReader::new(bytes) else { return 0 };
        let _ = reader.flown.station();
        let mut steps = 0;
        while let Ok(Some(_)) = reader.next_step() {
            steps += 1;
        }
        steps
    };
    let all = steps(file);
    assert!(all > 50, "the example has steps");
    explore(300, &[file.to_vec()], |bytes| assert!(steps(bytes) <= bytes.len()));
}

#[test]
fn a_damaged_scenario_is_refused_or_what_flies_of_it_reads_back() {
    let examples =
        ["hover.toml", "tour.toml"].map(|name| SHIPPED.iter().find(|(shipped, _)| *shipped == name).unwrap().1);
    let fleet = "[fleet]\nteams = 3\n[[team]]\nids = [2]\nformation.radius_m = 50\n[swarm]\nvehicles = 4\n";
    let examples = [examples[0], examples[1], fleet];
    let load = |text: &str| load_any(&Source { name: "damaged.toml", text }, &[]);
    examples.iter().for_each(|text| drop(load(text).unwrap()));
    explore_text(1_000, &examples, |text| match load(text) {
        Ok(described) => {
            let again = load(&described.to_toml()).unwrap();
            let flown = |described: &Described| {
                described.all().iter().map(|loaded| loaded.scenario.clone()).collect::<Vec<_>>()
            };
            assert_eq!(flown(&again), flown(&described));
            // The recording of a team has the team's own scenario.
            let first = described.first();
            let alone = load(&first.to_toml()).unwrap();
            assert!(!alone.is_fleet(), "a team is a swarm");
            assert_eq!(alone.first().scenario, Scenario { team: None, ..first.scenario.clone() });
        }
        Err(error) => assert!(error.to_string().starts_with("damaged.toml"), "{}", error),
    });
}

#[test]
fn a_damaged_aircraft_is_refused_or_has_a_flight_model_of_finite_numbers() {
    let examples = [Aircraft::SHIPPED[0].1, Aircraft::TO_FIT[0].1];
    assert!(Aircraft::from_text("aircraft.toml", examples[0]).is_ok(), "the example is an aircraft");
    explore_text(2_000, &examples, |text| match Aircraft::from_text("damaged.toml", text) {
        Ok(aircraft) => assert!(aircraft.take_off_rotor_rad_s().is_none_or(|speed| speed.is_finite() && speed > 0.0)),
        Err(error) => assert!(error.to_string().starts_with("damaged.toml"), "{}", error),
    });
}

#[test]
fn a_damaged_cluster_file_is_refused_or_read() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scenario.toml"), "swarm.vehicles = 2\n").unwrap();
    fs::write(folder.path().join("law.py"), "").unwrap();
    let examples = [
        "swarm = 'a'\nscenario = 'scenario.toml'\n[defaults]\nuser = 'heli'\n\
         [node.1]\nhost = '10.0.0.1'\n[node.2]\nhost = 'fd00::2'\nplant = 'xplane'\nxplane = '127.0.0.1:49000'\n",
        "swarm = 'a'\nscenario = 'scenario.toml'\nsecurity = 'none'\nfiles = ['law.py']\n\
         [node.1]\nhost = 'heli1'\naddress = '10.0.0.1'\nplant = 'standin'\n[node.2]\nhost = '10.0.0.2'\ninstall = 'manual'\n",
    ];
    let path = folder.path().join("cluster.toml");
    let read = |text: &str| {
        fs::write(&path, text).unwrap();
        Inventory::read(&path).map(|_| ())
    };
    for example in examples {
        read(example).unwrap();
    }
    explore_text(3_000, &examples, |text| {
        // An error is made of the text, so that it is written too.
        if let Err(error) = read(text) {
            assert!(!error.to_string().is_empty());
        }
    });
}

#[test]
fn a_damaged_request_or_answer_of_a_host_is_refused_or_stays_the_same() {
    let examples = [
        r#"{"swarm":"a","id":"1","ask":"Facts"}"#,
        r#"{"swarm":"a","id":"3/1","ask":{"Start":{"run":5}}}"#,
        r#"{"swarm":"a","id":"1","ask":{"Stop":{"within_s":60.0}}}"#,
        r#"{"swarm":"a","id":"1","ask":{"Log":{"lines":10,"follow":false}}}"#,
        r#"{"Failed":"no disk"}"#,
        r#"{"Reach":["Taken","Refused",{"No":"timeout"}]}"#,
        r#"{"Carries":null}"#,
    ];
    explore_text(20_000, &examples, |text| {
        if let Ok(request) = serde_json::from_str::<Request>(text) {
            let again: Request = serde_json::from_str(&serde_json::to_string(&request).unwrap()).unwrap();
            assert_same(&serde_json::to_value(request).unwrap(), &serde_json::to_value(again).unwrap());
        }
        if let Ok(answer) = serde_json::from_str::<Answer>(text) {
            let again: Answer = serde_json::from_str(&serde_json::to_string(&answer).unwrap()).unwrap();
            assert_same(&serde_json::to_value(answer).unwrap(), &serde_json::to_value(again).unwrap());
        }
    });
}

#[test]
fn an_answer_of_a_web_api_is_read_or_refused_in_one_short_line() {
    let examples = [
        r#"200{"data":[{"id":2051,"name":"sim/time/paused","value_type":"int","is_writable":true}]}"#,
        r#"200{"api":{"versions":["v1","v2","v3"]},"x-plane":{"version":"12.4.0"}}"#,
        r#"404{"error_code":"dataref_not_found","error_message":"Dataref doesn't exist"}"#,
        r#"403{"error_code":"dataref_is_readonly"}"#,
        r#"403"#,
    ];
    explore_text(20_000, &examples, |answer| {
        let Some((status, text)) = answer.split_at_checked(3) else { return };
        if let Err(error) = read_answer("127.0.0.1:8086", status.parse().unwrap_or(200), text) {
            let shown = error.to_string();
            assert!(!shown.contains(char::is_control) && shown.len() < 1_000, "{shown:?}");
        }
    });
}

#[test]
fn a_certificate_is_refused_or_names_its_owner_and_key() {
    let pair = rcgen::KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
    let mut about = rcgen::CertificateParams::new(["127.0.0.1".to_owned()]).unwrap();
    about.distinguished_name.push(rcgen::DnType::CommonName, "vehicle-2");
    let example = about.self_signed(&pair).unwrap().der().to_vec();
    let read = certified(&example).unwrap();
    assert_eq!((read.name.as_str(), read.key.as_slice()), ("vehicle-2", pair.public_key_raw()));
    let within = |bytes: &[u8], part: &[u8]| part.is_empty() || bytes.windows(part.len()).any(|window| window == part);
    explore(20_000, &[example], |bytes| {
        if let Ok(Certified { name, key }) = certified(bytes) {
            assert!(within(bytes, name.as_bytes()) && within(bytes, &key), "both stand in the certificate");
        }
    });
}
