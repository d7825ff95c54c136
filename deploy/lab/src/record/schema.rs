//! JSON schemas of our own channels, for Foxglove's plots and for readers of a recording without this source. They come from
//! the types that are recorded: keys, kinds and what may be null from the fields, descriptions from their docstrings.

use schemars::generate::SchemaSettings;
use schemars::transform::RecursiveTransform;
use schemars::{JsonSchema, Schema};
use serde_json::{Value, json};
use skein_common::message::Trace;

use super::format::{EventLine, FaultLine};

/// Name of the traces' schema.
pub(super) const TRACE: &str = "skein.Trace";
/// Name of the events' schema.
pub(super) const EVENT: &str = "skein.Event";
/// Name of the faults' schema.
pub(super) const FAULT: &str = "skein.Fault";

/// One step of a vehicle.
pub(super) fn trace() -> Value {
    of::<Trace>(TRACE)
}

/// What a vehicle reports of itself.
pub(super) fn event() -> Value {
    of::<EventLine<'_>>(EVENT)
}

/// What was done to the swarm.
pub(super) fn fault() -> Value {
    of::<FaultLine<'_>>(FAULT)
}

/// The schema of a type as it is written, every part of it in its place: not every reader follows references.
fn of<T: JsonSchema>(title: &str) -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize().with(|settings| settings.inline_subschemas = true);
    let mut schema =
        settings.with_transform(RecursiveTransform(name_choices)).into_generator().into_root_schema_for::<T>();
    schema.insert("title".to_owned(), title.into());
    schema.to_value()
}

/// A choice of described names becomes a text that is one of them, with all their descriptions: the published
/// reader of Foxglove knows texts, but refuses a `oneOf` of texts.
fn name_choices(schema: &mut Schema) {
    let Some(Value::Array(choices)) = schema.get("oneOf") else { return };
    let about = |choice: &Value| Some(format!("{}: {}", choice["const"].as_str()?, choice["description"].as_str()?));
    let Some(about) = choices.iter().map(about).collect::<Option<Vec<_>>>() else { return };
    let names = choices.iter().map(|choice| choice["const"].clone()).collect();
    let own = schema.get("description").and_then(Value::as_str);
    let description = own.into_iter().map(str::to_owned).chain(about).collect::<Vec<_>>().join("\n");
    schema.remove("oneOf");
    schema.insert("type".to_owned(), json!("string"));
    schema.insert("enum".to_owned(), Value::Array(names));
    schema.insert("description".to_owned(), description.into());
}
