use skein_common::scenario::{Source, load_any};
use skein_lab::record::Channels;

use super::*;

#[test]
fn a_port_alone_is_one_of_the_loopback() {
    assert_eq!(address("8765").unwrap().to_string(), "127.0.0.1:8765");
    assert_eq!(address("0.0.0.0:1").unwrap().to_string(), "0.0.0.0:1");
    assert_eq!(address("[::1]:80").unwrap().to_string(), "[::1]:80");
    for wrong in ["", "99999", "localhost", "1.2.3.4", ":80"] {
        assert!(address(wrong).unwrap_err().contains("a port such as 8765"), "{wrong}");
    }
}

#[test]
fn every_key_of_the_scenario_that_has_a_value_is_a_parameter() {
    let text = "swarm.vehicles = 3\n[formation]\nradius_m = 80\n";
    let described = load_any(&Source { name: "x", text }, &[]).unwrap();
    let parameters = Parameters::default();
    parameters.show(&described);
    let value = |key: &str| {
        let found = parameters.named(&[key.to_owned()]);
        assert_eq!(found.len(), 1, "{key}");
        (found[0].r#type, found[0].value.clone().unwrap())
    };
    assert_eq!(value("swarm.vehicles"), (None, ParameterValue::Integer(3)));
    assert_eq!(value("formation.radius_m"), (Some(ParameterType::Float64), ParameterValue::Float64(80.0)));
    assert_eq!(value("formation.law"), (None, ParameterValue::String("ring".to_owned())));
    let with_value = described.first().explain().iter().filter(|line| line.value.is_some()).count();
    assert_eq!(parameters.named(&[]).len(), with_value);
    assert_eq!(parameters.named(&["formation.none".to_owned()]), []);
}

/// The schema of each topic.
#[derive(Default)]
struct Schemas {
    schemas: Vec<Vec<u8>>,
    topics: std::collections::BTreeMap<String, usize>,
}

impl Sink for Schemas {
    fn add_schema(&mut self, _: &str, _: &str, data: &[u8]) -> Result<u16, RecordError> {
        self.schemas.push(data.to_vec());
        number(self.schemas.len())
    }

    fn add_channel(&mut self, topic: &str, schema: u16, _: &str) -> Result<u16, RecordError> {
        self.topics.insert(topic.to_owned(), usize::from(schema));
        number(self.topics.len())
    }

    fn put(&mut self, _: u16, _: u64, _: &[u8]) {}
}

#[test]
fn the_layout_shows_topics_and_keys_that_exist() {
    let layout: serde_json::Value = serde_json::from_str(include_str!("../../../foxglove/skein.json")).unwrap();
    let described = load_any(&Source { name: "x", text: "swarm.vehicles = 8" }, &[]).unwrap();
    let schemas = Channels::new(Schemas::default(), &described.first().scenario).unwrap().sink;
    let panels = layout["configById"].as_object().unwrap();
    let paths = panels.values().filter_map(|panel| panel["paths"].as_array()).flatten();
    let mut count = 0;
    for path in paths.map(|path| path["value"].as_str().unwrap()) {
        let (topic, key) = path.split_once('.').unwrap();
        let schema: serde_json::Value = serde_json::from_slice(&schemas.schemas[schemas.topics[topic]]).unwrap();
        let (key, in_items) = key.split_once("[:].").unwrap_or((key, ""));
        let property = &schema["properties"][key];
        assert!(property.is_object(), "{path}");
        assert!(in_items.is_empty() || property["items"]["properties"][in_items].is_object(), "{path}");
        count += 1;
    }
    assert_eq!(count, 3 * 8);
    let topics = [("3D!swarm", "topics"), ("map!swarm", "topicColors")].map(|(panel, key)| &panels[panel][key]);
    for topic in topics.iter().flat_map(|topics| topics.as_object().unwrap().keys()) {
        assert!(schemas.topics.contains_key(topic), "{topic}");
    }
    assert_eq!(panels["RosOut!log"]["topicToRender"], "/log");
    // Every panel is in the layout once.
    let text = layout["layout"].to_string();
    for panel in panels.keys() {
        assert_eq!(text.matches(&format!("\"{panel}\"")).count(), 1, "{panel}");
    }
}
