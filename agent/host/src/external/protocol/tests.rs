use std::mem::discriminant;

use proptest::prelude::*;
use skein_common::scenario::{Source, load};

use super::*;
use skein_core::formation::external::OwnState;
use skein_core::formation::law::{Goal, Neighbour};

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

fn text(sent: &MessageToLaw<'_>) -> String {
    String::from_utf8(sent.line()).unwrap()
}

fn answer_to(line: &str) -> Result<LawReply, Fault> {
    match read(line.as_bytes())? {
        MessageFromLaw::LawReply(answer) => Ok(answer),
        MessageFromLaw::Ready => panic!("ready"),
    }
}

/// The lines from the interface's documentation, byte for byte.
#[test]
fn messages_to_a_law_have_exactly_these_bytes() {
    let mut parameters = toml::Table::new();
    parameters.insert("gain".to_owned(), 0.3.into());
    let hello = Hello {
        protocol: 1,
        run: "hover/42".to_owned(),
        vehicle: id(3),
        ids: VehicleId::first(4).collect(),
        seed: 9001,
        time: Time::Virtual,
        period_s: 0.1,
        max_speed_m_s: 5.0,
        parameters,
    };
    let line = r#"{"say":"hello","protocol":1,"run":"hover/42","vehicle":3,"ids":[1,2,3,4],"seed":9001,"time":"virtual","period_s":0.1,"max_speed_m_s":5.0,"parameters":{"gain":0.3}}"#;
    assert_eq!(text(&MessageToLaw::Hello(&hello)), format!("{line}\n"));
    let ask = LawQuery {
        vehicle: id(3),
        tick: 417,
        time_s: 41.7,
        dt_s: 0.1,
        own: OwnState {
            position: [81.0, -60.2, -30.0].into(),
            velocity: [0.1, 0.4, 0.0].into(),
            heading_rad: 1.57,
            age_s: 0.02,
        },
        peers: vec![Neighbour {
            id: id(1),
            position: [99.1, 3.2, -30.1].into(),
            velocity: [0.0, 0.2, 0.0].into(),
            heading_rad: 0.0,
            age_s: 0.06,
            is_fresh: true,
        }],
        goal: Goal {
            step: 0,
            centre: [0.0, 0.0, -30.0].into(),
            centre_velocity: [0.0, 0.0, 0.0].into(),
            heading_rad: 0.0,
            radius_m: 100.0,
            gamma: 1.0,
        },
    };
    let line = r#"{"say":"ask","vehicle":3,"tick":417,"time_s":41.7,"dt_s":0.1,"own":{"position_ned_m":[81.0,-60.2,-30.0],"velocity_ned_m_s":[0.1,0.4,0.0],"heading_rad":1.57,"age_s":0.02},"peers":[{"id":1,"position_ned_m":[99.1,3.2,-30.1],"velocity_ned_m_s":[0.0,0.2,0.0],"heading_rad":0.0,"age_s":0.06,"fresh":true}],"goal":{"step":0,"centre_ned_m":[0.0,0.0,-30.0],"centre_velocity_ned_m_s":[0.0,0.0,0.0],"heading_rad":0.0,"radius_m":100.0,"gamma":1.0}}"#;
    assert_eq!(text(&MessageToLaw::LawQuery(&ask)), format!("{line}\n"));
    assert_eq!(text(&MessageToLaw::Bye), "{\"say\":\"bye\"}\n");
}

#[test]
fn valid_lines_of_a_law_are_read() {
    assert_eq!(read(br#"{"say":"ready","protocol":1}"#), Ok(MessageFromLaw::Ready));
    assert_eq!(
        read(br#"{"protocol":1.0,"say":"ready","name":"mine"}"#),
        Ok(MessageFromLaw::Ready),
        "unknown keys are ignored"
    );
    let line =
        r#"{"say":"answer","vehicle":3,"tick":417,"velocity_ned_m_s":[0.4,-1.2,0],"log":{"consensus_error":0.31}}"#;
    let answer = answer_to(line).unwrap();
    assert_eq!((answer.vehicle, answer.tick), (id(3), 417));
    assert_eq!(answer.command, ReplyCommand::VelocityNed(Vector3::new(0.4, -1.2, 0.0)));
    assert_eq!(answer.log, [LawNumber { name: "consensus_error".to_owned(), value: 0.31 }]);
    assert_eq!((answer.heading_rad, answer.reached), (None, None));
    let line = r#"{"say":"answer","vehicle":3.0,"tick":4e2,"field_ne":[0.1,-0.3],"heading_rad":1.5,"reached":false}"#;
    let answer = answer_to(line).unwrap();
    assert_eq!((answer.tick, answer.heading_rad, answer.reached), (400, Some(1.5), Some(false)));
    assert_eq!(answer.command, ReplyCommand::FieldNe(Vector2::new(0.1, -0.3)));
}

#[test]
fn invalid_lines_are_refused_by_kind() {
    let kind = |line: &str| discriminant(&read(line.as_bytes()).unwrap_err());
    let answer = |rest: &str| format!("{{\"say\":\"answer\",\"vehicle\":3,\"tick\":4{rest}}}");
    let velocity = |value: &str| answer(&format!(",\"velocity_ned_m_s\":{value}"));
    let content = discriminant(&Fault::Content(""));
    for broken in ["", "{", "[1]", "7", "nonsense", "{\"say\":\"answer\",", "\u{fffd}", &velocity("[NaN,0,0]")] {
        assert_eq!(kind(broken), discriminant(&Fault::NotJson(String::new(), String::new())), "{broken}");
    }
    for displaced in ["{}", "{\"say\":7}", "{\"say\":\"ask\"}", "{\"tick\":3}"] {
        assert_eq!(kind(displaced), discriminant(&Fault::OutOfPlace(String::new())), "{displaced}");
    }
    assert_eq!(kind("{\"say\":\"ready\",\"protocol\":2}"), discriminant(&Fault::Protocol));
    assert_eq!(kind("{\"say\":\"ready\"}"), discriminant(&Fault::Protocol));
    let both = answer(",\"velocity_ned_m_s\":[0,0,0],\"field_ne\":[0,0]");
    let wrong = [
        answer(""),
        both,
        velocity("[1,2]"),
        velocity("[1,2,null]"),
        velocity("[1,2,\"3\"]"),
        velocity("[1,2,1e300]"),
        velocity("[1,2,3,4]"),
        velocity("5"),
        answer(",\"field_ne\":[0,0,0]"),
        answer(",\"field_ne\":[0,0],\"heading_rad\":\"north\""),
        answer(",\"field_ne\":[0,0],\"reached\":1"),
        "{\"say\":\"answer\",\"vehicle\":-1,\"tick\":4,\"field_ne\":[0,0]}".to_owned(),
        "{\"say\":\"answer\",\"vehicle\":1,\"tick\":4.5,\"field_ne\":[0,0]}".to_owned(),
    ];
    for wrong in wrong {
        assert_eq!(kind(&wrong), content, "{wrong}");
    }
    let unknown = "{\"say\":\"answer\",\"vehicle\":251,\"tick\":4,\"field_ne\":[0,0]}";
    assert_eq!(read(unknown.as_bytes()), Err(Fault::Vehicle(251)));
}

#[test]
fn a_law_log_is_limited_to_what_a_recording_holds() {
    let many: Vec<String> = (0..40).map(|nth| format!("\"n{nth:02}\":{nth}")).collect();
    let reply = |log: &str| format!("{{\"say\":\"answer\",\"vehicle\":3,\"tick\":4,\"field_ne\":[0,0],\"log\":{log}}}");
    let log = answer_to(&reply(&format!("{{{}}}", many.join(",")))).unwrap().log;
    assert_eq!((log.len(), log[15].name.as_str(), log[15].value), (LawNumber::MAX_COUNT, "n15", 15.0));
    let long = "ü".repeat(40);
    let log = answer_to(&reply(&format!("{{\"{long}\":1,\"text\":\"x\",\"none\":null}}"))).unwrap().log;
    assert_eq!(log, [LawNumber { name: "ü".repeat(16), value: 1.0 }], "a name has 32 bytes; only numbers are kept");
    assert!(answer_to(&reply("7")).unwrap().log.is_empty());
}

#[test]
fn every_vehicle_and_run_has_a_seed_of_its_own() {
    let hello = |seed: u64, own: u8, time| {
        let sets = [format!("seed={seed}")];
        let text = "swarm.vehicles = 3\nformation.external.parameters = { gain = 0.3, names = ['a'] }";
        Hello::new(&load(&Source { name: "test.toml", text }, &sets).unwrap().scenario, id(own), time)
    };
    let one = hello(7, 1, Time::Real);
    assert_eq!((one.run.as_str(), one.ids.len(), one.period_s), ("swarm/7", 3, 0.1));
    assert!(text(&MessageToLaw::Hello(&one)).contains(r#""time":"real""#));
    assert!(text(&MessageToLaw::Hello(&one)).contains(r#""parameters":{"gain":0.3,"names":["a"]}"#));
    assert_eq!(one.seed, hello(7, 1, Time::Virtual).seed);
    assert!(one.seed != hello(7, 2, Time::Real).seed && one.seed != hello(8, 1, Time::Real).seed);
    assert!(one.seed < 1 << 32, "exact in any language");
}

proptest! {
    #[test]
    fn bytes_that_are_no_json_are_refused_and_quoted_on_one_line_that_does_nothing_to_a_terminal(
        line in proptest::collection::vec(any::<u8>(), 0..300),
    ) {
        prop_assume!(!serde_json::from_slice(&line).is_ok_and(|value: Value| value.is_object()));
        let fault = read(&line).unwrap_err();
        prop_assert!(matches!(fault, Fault::NotJson(..)), "{fault:?}");
        let text = fault.to_string();
        prop_assert!(!text.chars().any(char::is_control), "{text:?}");
        prop_assert!(text.chars().count() < 200 + 10 * EXCERPT);
    }

    #[test]
    fn a_line_with_other_bytes_in_it_is_refused_or_says_what_it_says(
        at in any::<proptest::sample::Index>(),
        byte in any::<u8>(),
    ) {
        let mut line = br#"{"say":"answer","vehicle":3,"tick":17,"field_ne":[0.5,-2],"heading_rad":1.25}"#.to_vec();
        *at.get_mut(&mut line) = byte;
        let value = serde_json::from_slice::<Value>(&line);
        match read(&line) {
            Ok(MessageFromLaw::LawReply(answer)) => {
                let value = value.unwrap();
                prop_assert_eq!(value["vehicle"].as_f64(), Some(answer.vehicle.get().into()));
                prop_assert_eq!(value["tick"].as_f64(), Some(answer.tick as f64));
                let ReplyCommand::FieldNe(field) = answer.command else { panic!("{answer:?}") };
                prop_assert_eq!(&value["field_ne"], &serde_json::json!([value["field_ne"][0], value["field_ne"][1]]));
                prop_assert_eq!(value["field_ne"][0].as_f64(), Some(field.x));
                prop_assert_eq!(value["field_ne"][1].as_f64(), Some(field.y));
                prop_assert_eq!(value["heading_rad"].as_f64(), answer.heading_rad);
            }
            Ok(MessageFromLaw::Ready) => panic!("ready"),
            Err(fault) => prop_assert_eq!(matches!(fault, Fault::NotJson(..)), value.is_err(), "{}", fault),
        }
    }

    #[test]
    fn every_reply_that_is_read_can_be_flown(
        key in prop_oneof![Just("velocity_ned_m_s"), Just("field_ne"), Just("heading_rad"), Just("log"), Just("tick")],
        value in "[0-9eE+.,\\-\\[\\]{}\":nulNaI ]{0,30}",
    ) {
        let line = format!(r#"{{"say":"answer","vehicle":3,"tick":1,"field_ne":[0.5,0],"{key}":{value}}}"#);
        if let Ok(MessageFromLaw::LawReply(answer)) = read(line.as_bytes()) {
            let command: Vec<f64> = match answer.command {
                ReplyCommand::VelocityNed(velocity) => velocity.iter().copied().collect(),
                ReplyCommand::FieldNe(field) => field.iter().copied().collect(),
            };
            prop_assert!(command.iter().chain(&answer.heading_rad).all(|number| number.abs() <= MAX_NUMBER));
            prop_assert!(answer.log.len() <= LawNumber::MAX_COUNT);
        }
    }
}
