//! JSON schemas of our own channels, for Foxglove's plots and for programs that read a recording without this source.
//!
//! They are generated from the recorded types: keys, kinds and nullability from the fields, descriptions from the
//! docstrings.

use schemars::generate::SchemaSettings;
use schemars::transform::RecursiveTransform;
use schemars::{JsonSchema, Schema};
use serde_json::{Value, json};

/// The schema of a serialised type, in the subset of JSON Schema that Foxglove's published reader accepts.
///
/// That reader refuses a channel over any key that it does not know: it follows no references, and needs exactly one
/// kind for each key. Therefore every subschema is inlined, a key that may be null has the kind of its other values
/// (its description states when it is null), and a key with values of several kinds is described in the description of
/// the message.
pub(super) fn of<T: JsonSchema>(title: &str) -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize().with(|settings| settings.inline_subschemas = true);
    let settings =
        settings.with_transform(RecursiveTransform(name_choices)).with_transform(RecursiveTransform(drop_null));
    let mut schema = settings.into_generator().into_root_schema_for::<T>();
    schema.insert("title".to_owned(), title.into());
    let mut schema = schema.to_value();
    describe_choices(&mut schema);
    schema
}

/// Gives a key that may be null the kind of its other values.
fn drop_null(schema: &mut Schema) {
    if let Some(Value::Array(kinds)) = schema.get_mut("type") {
        kinds.retain(|kind| kind != "null");
        if let [kind] = kinds.as_slice() {
            let kind = kind.clone();
            schema.insert("type".to_owned(), kind);
        }
    }
}

/// Removes each key of the message whose values are of several kinds, and lists its values in the message's
/// description.
fn describe_choices(message: &mut Value) {
    let Some(properties) = message["properties"].as_object_mut() else { return };
    let chosen = properties.iter().filter(|(_, schema)| schema.get("oneOf").is_some());
    let chosen: Vec<String> = chosen.map(|(key, _)| key.clone()).collect();
    let moved: Vec<(String, Value)> =
        chosen.into_iter().filter_map(|key| properties.remove(&key).map(|schema| (key, schema))).collect();
    for (key, schema) in moved {
        if let Some(required) = message["required"].as_array_mut() {
            required.retain(|name| *name != key);
        }
        let about = |schema: &Value| schema["description"].as_str().unwrap_or_default().to_owned();
        let choices = schema["oneOf"].as_array().into_iter().flatten();
        let lines = choices.map(|choice| format!("- {}: {}", name_of(choice), about(choice)));
        let text = format!("{}\n\n`{key}`: {}", about(message), about(&schema));
        message["description"] = [text].into_iter().chain(lines).collect::<Vec<_>>().join("\n").into();
    }
}

/// The name of a choice in a recording: the text itself, or the only key of the object.
fn name_of(choice: &Value) -> String {
    let names = choice["enum"].as_array().into_iter().flatten().filter_map(Value::as_str);
    let own = choice["const"].as_str().into_iter().chain(names);
    let keys = choice["properties"].as_object().into_iter().flat_map(|keys| keys.keys().map(String::as_str));
    own.chain(keys).collect::<Vec<_>>().join(", ")
}

/// Turns a `oneOf` of described names into an `enum` of texts, with all descriptions in one.
///
/// The published reader of Foxglove accepts texts, but refuses a `oneOf` of texts.
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
