use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use proptest::prelude::*;
use serde_json::Value;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{EventKind, Failure, Header, LawNumber, Order, Signature, Trace, Verb};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;

use super::format::{EventLine, FaultLine, log_time_ns, seconds_since, traced};
use super::*;
use crate::external::LawPool;
use crate::faults::InjectedFault;
use crate::metrics::Run;
use crate::recording::Recording;
use crate::scenario::ScenarioArgs;
use crate::study::Study;

/// Two vehicles that have flown for a moment, in steps of 20 ms.
pub(crate) fn steps() -> Vec<Trace> {
    let sets = ["swarm.vehicles=2", "duration_s=2"].map(str::to_owned);
    let scenario = ScenarioArgs::default().read(sets.into()).unwrap().scenario;
    let aircraft = vec![Aircraft::shipped("xcell60").unwrap().unwrap(); 2];
    let mut recording = Recording::new(&scenario, Run::new(&scenario, "study"));
    let study = Study { scenario, aircraft, rules: Rules::shipped(), laws: LawPool::default() };
    study.fly_watched(1, Some((&mut recording, 50.0))).unwrap();
    recording.tracks.into_iter().flat_map(|track| track.steps).map(|step| step.trace).collect()
}

/// The part of a value that its schema does not describe. Stricter than JSON Schema: every key of a message has to be one of the schema's
/// and required there, and every description a plain text.
fn mismatch(schema: &Value, value: &Value, path: &str) -> Option<String> {
    let fault = |what: &str| Some(format!("{path}: {value} {what} of {schema}"));
    if schema["description"].as_str().is_some_and(|about| about.is_empty() || about.contains("[`")) {
        return fault("has a strange description");
    }
    // A key that may be null is described so: its kind is that of its other values.
    if value.is_null() && schema["description"].as_str().is_some_and(|about| about.contains("null")) {
        return None;
    }
    let kind = match value {
        Value::Null => "null",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
        Value::Number(number) if number.is_f64() => "number",
        Value::Number(_) => "integer",
        Value::Bool(_) => "boolean",
    };
    let has_kind = schema["type"] == kind;
    let is_choice = schema["const"].is_null() || schema["const"] == *value;
    if !has_kind || !is_choice || schema["enum"].as_array().is_some_and(|choices| !choices.contains(value)) {
        return fault("has not the kind");
    }
    match value {
        Value::Object(message) => {
            // A key with values of several kinds is described with the message.
            let about = schema["description"].as_str().unwrap_or_default();
            let is_own = |key: &&str| !about.contains(&format!("`{key}`: "));
            let keys: BTreeSet<_> = message.keys().map(String::as_str).filter(is_own).collect();
            let properties = schema["properties"].as_object()?;
            let required = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
            if keys != properties.keys().map(String::as_str).collect() || keys != required {
                return fault("has not the keys");
            }
            let described = message.iter().filter_map(|(key, value)| Some((key, properties.get(key)?, value)));
            let mut mismatches =
                described.map(|(key, schema, value)| mismatch(schema, value, &format!("{path}.{key}")));
            mismatches.find_map(|mismatch| mismatch)
        }
        Value::Array(items) => {
            let length = items.len() as u64;
            let [least, most] = ["minItems", "maxItems"].map(|bound| schema[bound].as_u64());
            if least.is_some_and(|least| length < least) || most.is_some_and(|most| length > most) {
                return fault("has not the length");
            }
            let of = |nth| schema["prefixItems"].get(nth).unwrap_or(&schema["items"]);
            items.iter().enumerate().find_map(|(nth, item)| mismatch(of(nth), item, &format!("{path}[{nth}]")))
        }
        _ => None,
    }
}

#[test]
fn every_recorded_message_is_as_its_schema_describes() {
    let loaded = ScenarioArgs::default().read(vec!["swarm.vehicles=2".to_owned()]).unwrap();
    let (scenario, text) = (&loaded.scenario, loaded.to_toml());
    let about = RecordingInfo { scenario, scenario_toml: &text, run: &Run::new(scenario, "study"), is_fleet: false };
    let mut writer = Writer::begin(std::io::Cursor::new(Vec::new()), &about, "", 0).unwrap();
    let mut steps = steps();
    // A law's numbers, and what only flights in real time have.
    let last = steps.last_mut().unwrap();
    last.law_log = vec![LawNumber { name: "gain".to_owned(), value: 0.5 }];
    (last.step_us, last.law_misses, last.controls) = (Some(80.0), Some(1), None);
    steps.iter().for_each(|step| writer.step(0, step));
    let [one, two] = [1, 2].map(|number| VehicleId::new(number).unwrap());
    let order = Order {
        epoch: 1,
        issuer: 7,
        verb: Verb::Goto(1),
        vehicles: None,
        signature: Some(Signature::from_bytes([9; Signature::BYTES])),
    };
    for what in [
        EventKind::AtAltitude,
        EventKind::PeerLost(two),
        EventKind::Failed(Failure::Gyro),
        EventKind::OrderTaken(order),
        EventKind::ForcedAdvance { to: 2, without: [two].into_iter().collect() },
    ] {
        writer.event(0, one, Some(&steps[0].header), &what);
        writer.event(0, one, None, &what);
    }
    let links = vec![(one, two)];
    let faults = [InjectedFault::Died(one), InjectedFault::Failed(one, "servo_stuck"), InjectedFault::Cut { links }];
    faults.iter().for_each(|fault| writer.fault(0, None, fault));
    let bytes = writer.finish(0).unwrap().into_inner();
    let mut checked = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        if schema.encoding == "jsonschema" {
            let [schema_json, value]: [Value; 2] =
                [&schema.data, &message.data].map(|json| serde_json::from_slice(json).unwrap());
            assert_eq!(schema_json["title"], schema.name);
            assert_eq!(mismatch(&schema_json, &value, &schema.name), None);
            *checked.entry(schema.name.clone()).or_insert(0) += 1;
        }
    }
    let expected = [("skein.Event", 10), ("skein.Fault", 3), ("skein.Trace", steps.len())];
    assert_eq!(checked, expected.map(|(name, count)| (name.to_owned(), count)).into());
}

/// The part of a schema that Foxglove's published reader of JSON schemas does not know, by the rules of its source (`parseJsonSchema`).
fn unknown_to_foxglove(schema: &Value, path: &str) -> Option<String> {
    let no_choice = schema["oneOf"].is_null() && schema["anyOf"].is_null() && schema["$ref"].is_null();
    match schema["type"].as_str().filter(|_| no_choice) {
        Some("boolean" | "string" | "number" | "integer") => None,
        Some("object") => schema["properties"]
            .as_object()?
            .iter()
            .find_map(|(key, schema)| unknown_to_foxglove(schema, &format!("{path}.{key}"))),
        Some("array") if schema["items"]["type"] != "array" => {
            unknown_to_foxglove(&schema["items"], &format!("{path}[]"))
        }
        _ => Some(format!("{path}: {schema}")),
    }
}

#[test]
fn foxgloves_reader_knows_every_key_of_the_schemas() {
    let events = schema::of::<EventLine<'_>>("skein.Event");
    for schema in [&schema::of::<Trace>("skein.Trace"), &events, &schema::of::<FaultLine<'_>>("skein.Fault")] {
        assert_eq!((schema["type"].as_str(), unknown_to_foxglove(schema, "")), (Some("object"), None));
        assert!(schema["properties"].as_object().unwrap().len() > 1);
    }
    for choice in ["AtAltitude: ", "ForcedAdvance: ", "OrderTaken: "] {
        assert!(events["description"].as_str().unwrap().contains(&format!("- {choice}")), "{choice}");
    }
    let unknown = serde_json::json!({ "type": "object", "properties": { "a": { "type": ["number", "null"] } } });
    assert!(unknown_to_foxglove(&unknown, "").unwrap().starts_with(".a: "));
}

#[test]
fn what_a_schema_does_not_describe_is_found() {
    let (schema, recorded) = (schema::of::<Trace>("skein.Trace"), serde_json::to_value(&steps()[0]).unwrap());
    assert_eq!(mismatch(&schema, &recorded, ""), None);
    let wrong = |key: &str, value: Value| {
        let mut wrong = recorded.clone();
        wrong[key] = value;
        mismatch(&schema, &wrong, "").unwrap_or_default()
    };
    assert!(wrong("unknown", 1.into()).contains("has not the keys"));
    assert!(wrong("height_m", Value::Null).contains(".height_m: null has not the kind"));
    assert!(wrong("membership", "Gone".into()).contains("has not the kind"));
    assert!(wrong("position", vec![1.5; 2].into()).contains("has not the length"));
}

#[test]
fn a_fault_reads_back_as_it_was_recorded() {
    let [one, two] = [1, 2].map(|number| VehicleId::new(number).unwrap());
    for what in [InjectedFault::Failed(one, "servo_stuck"), InjectedFault::Cut { links: vec![(one, two)] }] {
        let line = serde_json::to_string(&what).unwrap();
        assert_eq!(serde_json::from_str::<InjectedFault>(&line).unwrap(), what);
    }
    assert!(serde_json::from_str::<InjectedFault>(r#"{"Failed":[1,"bored"]}"#).is_err(), "not a fault of any scenario");
}

#[test]
fn an_event_that_two_recorders_received_counts_once() {
    let folder = tempfile::tempdir().unwrap();
    let loaded = ScenarioArgs::default().read(vec!["swarm.vehicles=2".to_owned()]).unwrap();
    let (scenario, text) = (&loaded.scenario, loaded.to_toml());
    let about = RecordingInfo { scenario, scenario_toml: &text, run: &Run::new(scenario, "fly"), is_fleet: false };
    let header = steps()[0].header;
    // The second recorder receives it a little later, and a restarted agent sends the same in another incarnation.
    let received = |life: u64, sequence| Header { incarnation: Incarnation(life), sequence, ..header };
    let recorded = |name: &str, late_ns: u64| {
        let mut writer = Writer::begin(std::io::Cursor::new(Vec::new()), &about, "", 0).unwrap();
        for (nth, header) in [received(1, 1), received(1, 2), received(2, 1)].iter().enumerate() {
            writer.event(1_000 * nth as u64 + late_ns, header.sender, Some(header), &EventKind::AtAltitude);
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
    assert_eq!(seconds_since(0, 120_000_000), 0.12, "the exact decimal value");
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
    let about = RecordingInfo { scenario, scenario_toml: &text, run: &Run::new(scenario, "study"), is_fleet: false };
    let mut writer = Writer::begin(std::io::Cursor::new(Vec::new()), &about, "", 0).unwrap();
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

#[test]
fn vehicles_have_a_position_on_the_globe_twice_a_second_and_together() {
    let loaded = ScenarioArgs::default().read(vec!["swarm.vehicles=2".to_owned()]).unwrap();
    let (scenario, text) = (&loaded.scenario, loaded.to_toml());
    let about = RecordingInfo { scenario, scenario_toml: &text, run: &Run::new(scenario, "study"), is_fleet: false };
    let mut writer = Writer::begin(std::io::Cursor::new(Vec::new()), &about, "", 0).unwrap();
    let ids = [1, 2].map(|id| VehicleId::new(id).unwrap());
    let step = &steps()[0];
    // Two seconds with 50 steps each; the second vehicle's steps come 10 ms later.
    for nth in 0..200 {
        let mut step = step.clone();
        step.header.sender = ids[nth as usize % 2];
        writer.step(nth * 10_000_000, &step);
    }
    let bytes = writer.finish(0).unwrap().into_inner();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let located = messages.filter(|message| message.channel.topic.ends_with("/location"));
    let times_ms: Vec<u64> = located.map(|message| message.log_time / 1_000_000).collect();
    assert_eq!(times_ms, [0, 10, 500, 510, 1000, 1010, 1500, 1510]);
}

/// The steps of [`steps`], in the order of time.
static FLOWN: LazyLock<Vec<Trace>> = LazyLock::new(|| {
    let mut steps = steps();
    steps.sort_by(|one, other| one.plant_time.seconds().total_cmp(&other.plant_time.seconds()));
    steps
});

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn recordings_merge_to_that_of_a_recorder_that_received_everything(
        // Each step is received by the first recorder, by the second, or by both.
        received in prop::collection::vec(1_u8..4, FLOWN.len()), is_reversed: bool,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let loaded = ScenarioArgs::default().read(vec!["swarm.vehicles=2".to_owned()]).unwrap();
        let (scenario, text) = (&loaded.scenario, loaded.to_toml());
        let about = RecordingInfo { scenario, scenario_toml: &text, run: &Run::new(scenario, "fly"), is_fleet: false };
        let recorded = |name: &str, recorder: u8| {
            let mut writer = Writer::begin(std::io::Cursor::new(Vec::new()), &about, "", 0).unwrap();
            for (nth, (step, _)) in FLOWN.iter().zip(&received).enumerate().filter(|(_, (_, by))| *by & recorder != 0) {
                writer.step(nth as u64 * 10_000_000, step);
                if nth % 10 == 0 {
                    writer.event(nth as u64 * 10_000_000, step.header.sender, Some(&step.header), &EventKind::AtAltitude);
                }
            }
            let path = folder.path().join(name);
            std::fs::write(&path, writer.finish(0).unwrap().into_inner()).unwrap();
            path
        };
        let whole = read(&recorded("whole.mcap", 3)).unwrap();
        let mut parts = vec![recorded("1.mcap", 1), recorded("2.mcap", 2)];
        if is_reversed {
            parts.reverse();
        }
        let (once, twice) = (folder.path().join("once.mcap"), folder.path().join("twice.mcap"));
        merge(&parts, &once).unwrap();
        merge(&[once.clone(), parts[0].clone()], &twice).unwrap();
        for merged in [once, twice] {
            let merged = read(&merged).unwrap();
            prop_assert_eq!((&merged.tracks, &merged.noted), (&whole.tracks, &whole.noted));
        }
    }
}
