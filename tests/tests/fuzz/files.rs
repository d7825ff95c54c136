//! Files: recordings, inputs of agents, scenarios, aircraft, cluster files; and the requests between an operator's PC and its hosts.

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use skein::cluster::protocol::{Answer, Request};
use skein::inventory::Inventory;
use skein_agent::inputs::InputsReader;
use skein_common::message::Message;
use skein_common::scenario::{Described, Source, load_any};
use skein_core::aircraft::Aircraft;
use skein_lab::record::{self, Player};
use skein_lab::study::record_run;
use skein_tests::{SHIPPED, study};

use super::inputs::{cases, damaged, damaged_text};

#[test]
fn a_damaged_recording_is_refused_or_read_and_its_repair_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let as_flown = "swarm.vehicles = 2\nduration_s = 2\n";
    record_run(&study("hover.toml", &["swarm.vehicles=2", "duration_s=2"]), 1, as_flown, &path).unwrap();
    let recording = fs::read(&path).unwrap();
    assert!(record::read(&path).is_ok(), "the example is a recording");
    proptest!(cases(150), |(bytes in damaged(vec![recording]))| {
        let path = folder.path().join("damaged.mcap");
        fs::write(&path, &bytes).unwrap();
        let _ = record::read(&path);
        play(&path);
        if let Ok(record::Repaired { to: Some(repaired), messages, .. }) = record::repair(&path) {
            let again = record::repair(&repaired).unwrap();
            prop_assert_eq!((again.to, again.messages), (None, messages));
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
        let _ = reader.flown().station();
        let mut steps = 0;
        while let Ok(Some(_)) = reader.next_step() {
            steps += 1;
        }
        steps
    };
    let all = steps(file);
    assert!(all > 50, "the example has steps");
    proptest!(cases(300), |(bytes in damaged(vec![file.to_vec()]))| prop_assert!(steps(&bytes) <= 2 * all));
}

#[test]
fn a_damaged_scenario_is_refused_or_what_flies_of_it_reads_back() {
    let examples =
        ["hover.toml", "tour.toml"].map(|name| SHIPPED.iter().find(|(shipped, _)| *shipped == name).unwrap().1);
    let fleet = "[fleet]\nteams = 3\n[[team]]\nids = [2]\nformation.radius_m = 50\n[swarm]\nvehicles = 4\n";
    let examples = [examples[0], examples[1], fleet];
    let load = |text: &str| load_any(&Source { name: "damaged.toml", text }, &[]);
    examples.iter().for_each(|text| drop(load(text).unwrap()));
    proptest!(cases(1_000), |(text in damaged_text(&examples))| match load(&text) {
        Ok(described) => {
            let again = load(&described.to_toml()).unwrap();
            let flown = |described: &Described| described.all().iter().map(|loaded| loaded.scenario.clone()).collect::<Vec<_>>();
            prop_assert_eq!(flown(&again), flown(&described));
        }
        Err(error) => prop_assert!(error.to_string().starts_with("damaged.toml"), "{}", error),
    });
}

#[test]
fn a_damaged_aircraft_is_refused_or_has_a_flight_model_of_finite_numbers() {
    let examples = [Aircraft::SHIPPED[0].1, Aircraft::TO_FIT[0].1];
    assert!(Aircraft::from_text("aircraft.toml", examples[0]).is_ok(), "the example is an aircraft");
    proptest!(cases(2_000), |(text in damaged_text(&examples))| match Aircraft::from_text("damaged.toml", &text) {
        Ok(aircraft) => prop_assert!(aircraft.take_off_rotor_rad_s().is_none_or(|speed| speed.is_finite() && speed > 0.0)),
        Err(error) => prop_assert!(error.to_string().starts_with("damaged.toml"), "{}", error),
    });
}

#[test]
fn a_damaged_cluster_file_is_refused_or_read() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scenario.toml"), "swarm.vehicles = 2\n").unwrap();
    fs::write(folder.path().join("law.py"), "").unwrap();
    let examples = [
        "swarm = 'a'\nscenario = 'scenario.toml'\n[defaults]\nuser = 'heli'\n\
         [node.1]\nhost = '10.0.0.1'\n[node.2]\nhost = 'fe80::2'\nplant = 'xplane'\nxplane = '127.0.0.1:49000'\n",
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
    proptest!(cases(3_000), |(text in damaged_text(&examples))| {
        // An error is made of the text, so that it is written too.
        if let Err(error) = read(&text) {
            prop_assert!(!error.to_string().is_empty());
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
    let check = |text: &str| {
        if let Ok(request) = serde_json::from_str::<Request>(text) {
            let again = serde_json::to_string(&request).unwrap();
            assert_eq!(serde_json::from_str::<Request>(&again).unwrap(), request);
        }
        if let Ok(answer) = serde_json::from_str::<Answer>(text) {
            let again = serde_json::to_string(&answer).unwrap();
            assert_eq!(serde_json::from_str::<Answer>(&again).unwrap(), answer);
        }
    };
    examples.iter().for_each(|text| check(text));
    proptest!(cases(20_000), |(text in damaged_text(&examples))| check(&text));
}
