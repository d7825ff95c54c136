use std::collections::BTreeSet;

use serde_json::Value;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{Happening, Header, Trace};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;

use super::format::{EventLine, FaultLine, log_time_ns, seconds_since, traced};
use super::*;
use crate::external::LawPool;
use crate::faults::Incident;
use crate::metrics::Run;
use crate::recording::Recording;
use crate::scenario::ScenarioArgs;
use crate::study::Study;

/// Two vehicles that have flown for a moment, in steps of 20 ms.
pub(super) fn steps() -> Vec<Trace> {
    let sets = ["swarm.vehicles=2", "duration_s=2"].map(str::to_owned);
    let scenario = ScenarioArgs::default().read(sets.into()).unwrap().scenario;
    let aircraft = vec![Aircraft::shipped("xcell60").unwrap().unwrap(); 2];
    let mut recording = Recording::new(&scenario, Run::new(&scenario, "study"));
    let study = Study { scenario, aircraft, rules: Rules::shipped(), laws: LawPool::default() };
    study.fly_watched(1, Some((&mut recording, 50.0))).unwrap();
    recording.tracks.into_iter().flat_map(|track| track.steps).map(|step| step.trace).collect()
}

/// Every key of the message is one of the schema's, and the reverse, objects in it included.
fn assert_described(schema: &Value, message: &Value, name: &str) {
    let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
    let properties = &schema["properties"];
    assert_eq!(keys(properties), keys(message), "{name}: every key of the message is to stand in record/schema.rs");
    let required: BTreeSet<_> =
        schema["required"].as_array().unwrap().iter().map(|key| key.as_str().unwrap()).collect();
    assert_eq!(required, keys(message).iter().map(String::as_str).collect());
    for (key, value) in message.as_object().unwrap() {
        let inner = &properties[key];
        let kinds = match &inner["type"] {
            Value::Array(kinds) => kinds.clone(),
            kind => vec![kind.clone()],
        };
        let kind = match value {
            Value::Null => "null",
            Value::String(_) => "string",
            Value::Array(_) => "array",
            Value::Object(_) => "object",
            Value::Number(number) if number.is_f64() => "number",
            Value::Number(_) => "integer",
            Value::Bool(_) => "boolean",
        };
        // Of any kind: described in words.
        let is_open = kinds == [Value::Null];
        assert!(is_open || kinds.contains(&kind.into()), "{name}: {key} is {kind}, not {kinds:?}");
        match value {
            Value::Object(_) if !is_open => assert_described(inner, value, key),
            Value::Array(items) => items.iter().filter(|item| item.is_object()).for_each(|item| {
                assert_described(&inner["items"], item, key);
            }),
            _ => {}
        }
    }
}

#[test]
fn schemas_describe_every_key_of_every_message() {
    for step in steps() {
        assert_described(&schema::trace(), &serde_json::to_value(&step).unwrap(), "trace");
    }
    let id = VehicleId::new(1).unwrap();
    let (incarnation, sequence) = (Some(Incarnation(5)), Some(7));
    let event =
        EventLine { vehicle: id, incarnation, sequence, text: "reached step 2".into(), what: Happening::Reached(2) };
    assert_described(&schema::event(), &serde_json::to_value(&event).unwrap(), "event");
    let fault = |vehicle, what: Incident| FaultLine {
        vehicle,
        text: what.to_string().into(),
        what: std::borrow::Cow::Owned(what),
    };
    let faults = [
        fault(Some(id), Incident::Failed(id, "servo_stuck")),
        fault(None, Incident::Cut { links: vec![(id, VehicleId::new(2).unwrap())] }),
    ];
    for line in faults {
        let line_json = serde_json::to_value(&line).unwrap();
        let described = match line.vehicle {
            Some(_) => line_json.clone(),
            None => {
                let mut one = line_json.clone();
                one["vehicle"] = 1.into();
                one
            }
        };
        assert_described(&schema::fault(), &described, "fault");
        let back: FaultLine<'_> = serde_json::from_value(line_json).unwrap();
        assert_eq!(back.what, line.what);
    }
    assert!(serde_json::from_str::<Incident>(r#"{"Failed":[1,"bored"]}"#).is_err(), "no word of the scenario's");
}

#[test]
fn an_event_that_two_recorders_heard_counts_once() {
    let folder = tempfile::tempdir().unwrap();
    let loaded = ScenarioArgs::default().read(vec!["swarm.vehicles=2".to_owned()]).unwrap();
    let (scenario, text) = (&loaded.scenario, loaded.to_toml());
    let about = About { scenario, scenario_toml: &text, run: &Run::new(scenario, "fly"), clock: "" };
    let header = steps()[0].header;
    // The second recorder hears it a little later, and a restarted agent says the same in another life.
    let heard = |life: u64, sequence| Header { incarnation: Incarnation(life), sequence, ..header };
    let recorded = |name: &str, late_ns: u64| {
        let mut writer = Writer::new(std::io::Cursor::new(Vec::new()), &about, 0).unwrap();
        for (nth, header) in [heard(1, 1), heard(1, 2), heard(2, 1)].iter().enumerate() {
            writer.happened(1_000 * nth as u64 + late_ns, header.sender, Some(header), &Happening::AtAltitude);
        }
        let path = folder.path().join(name);
        std::fs::write(&path, writer.finish(0).unwrap().into_inner()).unwrap();
        path
    };
    let (one, other, both) = (recorded("1.mcap", 0), recorded("2.mcap", 300), folder.path().join("both.mcap"));
    merge(&[one.clone(), other], &both).unwrap();
    assert_eq!((read(&both).unwrap().noted, read(&one).unwrap().noted.len()), (read(&one).unwrap().noted, 3));
}

#[test]
fn times_go_through_nanoseconds() {
    for (t_s, ns) in [(0.0, 100), (0.02, 20_000_100), (-1e-9, 99), (1e9, 1_000_000_000_000_000_100)] {
        assert_eq!(log_time_ns(100, t_s), ns);
        assert!((seconds_since(100, ns) - t_s).abs() < 1e-9);
    }
    assert_eq!(seconds_since(0, 120_000_000), 0.12, "what the decimal says");
    assert_eq!(log_time_ns(0, -5.0), 0, "nothing is before all time");
}

#[test]
fn topics_name_their_vehicle() {
    let id = VehicleId::new(17).unwrap();
    assert_eq!(traced(&format::trace_topic(id)), Some(id));
    for other in ["/vehicle/17/location", "/vehicle/0/trace", "/vehicle/300/trace", "/vehicle//trace", "/events", ""] {
        assert_eq!(traced(other), None, "{other}");
    }
}

#[test]
fn a_step_with_impossible_numbers_is_counted_and_the_rest_is_there() {
    let loaded = ScenarioArgs::default().read(vec!["swarm.vehicles=2".to_owned()]).unwrap();
    let (scenario, text) = (&loaded.scenario, loaded.to_toml());
    let about = About { scenario, scenario_toml: &text, run: &Run::new(scenario, "study"), clock: "" };
    let mut writer = Writer::new(std::io::Cursor::new(Vec::new()), &about, 0).unwrap();
    let steps = steps();
    let mut broken = steps[1].clone();
    broken.height_m = f64::NAN;
    let mut stranger = steps[2].clone();
    stranger.header.sender = VehicleId::new(9).unwrap();
    for (nth, step) in [&steps[0], &broken, &stranger, &steps[3]].into_iter().enumerate() {
        writer.step(nth as u64, step);
    }
    let bytes = writer.finish(7).unwrap().into_inner();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE);
    std::fs::write(&path, &bytes).unwrap();
    let read = read(&path).unwrap();
    assert_eq!(read.tracks.iter().map(|track| track.steps.len()).sum::<usize>(), 2);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let last = summary.metadata_indexes.last().unwrap();
    let recorder = mcap::read::metadata(&bytes, last).unwrap().metadata;
    assert_eq!((recorder["refused_steps"].as_str(), recorder["dropped"].as_str()), ("1", "7"));
}
