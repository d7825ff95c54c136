//! JSON schemas of our own channels: for Foxglove's plots, and for whoever reads a recording without this source.

use serde_json::{Map, Value, json};

/// Name of the traces' schema.
pub(super) const TRACE: &str = "skein.Trace";
/// Name of the events' schema.
pub(super) const EVENT: &str = "skein.Event";
/// Name of the faults' schema.
pub(super) const FAULT: &str = "skein.Fault";

/// Kind of a value.
#[derive(Clone, Copy)]
enum Kind {
    Number,
    Integer,
    Text,
    /// So many numbers.
    Numbers(usize),
}

impl Kind {
    fn schema(self) -> Value {
        match self {
            Self::Number => json!({ "type": "number" }),
            Self::Integer => json!({ "type": "integer" }),
            Self::Text => json!({ "type": "string" }),
            Self::Numbers(count) => {
                json!({ "type": "array", "items": { "type": "number" }, "minItems": count, "maxItems": count })
            }
        }
    }
}

/// One key: its kind, whether it may be null, what it means.
type Key = (&'static str, Kind, bool, &'static str);

const HEADER: [Key; 4] = [
    ("sender", Kind::Integer, false, "the vehicle"),
    ("incarnation", Kind::Integer, false, "its agent's life: a restarted agent has a larger one"),
    ("sequence", Kind::Integer, false, "grows with every step of this life"),
    ("stamp", Kind::Integer, false, "the agent's own monotonic clock, ns"),
];

const ATTITUDE: [Key; 3] = [
    ("roll_rad", Kind::Number, false, "right bank positive"),
    ("pitch_rad", Kind::Number, false, "nose up positive"),
    ("heading_rad", Kind::Number, false, "clockwise from true north"),
];

const PEER: [Key; 5] = [
    ("id", Kind::Integer, false, "the peer"),
    ("standing", Kind::Text, false, "Fresh, Stale or Lost"),
    (
        "age_s",
        Kind::Number,
        false,
        "upper bound of the age of its newest state by this vehicle's clock, its delay included once known, s",
    ),
    (
        "delay_s",
        Kind::Number,
        true,
        "upper bound of the time that this state was on its way, s; null until a round trip is known",
    ),
    (
        "delivered_age_s",
        Kind::Number,
        false,
        "how late that was when delivered: what the scenario's network made of it, s",
    ),
];

const LAW_NUMBER: [Key; 2] = [
    ("name", Kind::Text, false, "the law's name for it"),
    ("value", Kind::Number, false, "as it was with the law's last answer"),
];

const STEP: [Key; 22] = [
    ("plant_time", Kind::Integer, false, "the simulator's time of the frame, ns"),
    ("membership", Kind::Text, false, "Joining, Active or Left: whether the others count on it"),
    ("activity", Kind::Text, false, "what it is doing"),
    ("live", Kind::Integer, false, "members it counts as live, itself included"),
    ("step", Kind::Integer, false, "step of the mission that it is at, counted from 0"),
    ("reached", Kind::Integer, true, "highest step that it reached in this life"),
    ("centre_ne_m", Kind::Numbers(2), false, "where it takes the formation's centre to be: north, east, m"),
    ("estimate", Kind::Numbers(3), false, "own position as estimated: north, east, down, m"),
    ("position", Kind::Numbers(3), false, "position as it really was: north, east, down, m"),
    ("height_m", Kind::Number, false, "above the ground, m"),
    ("velocity", Kind::Numbers(3), false, "as it really was: north, east, down, m/s"),
    ("power_w", Kind::Number, true, "shaft power, where the plant tells it, W"),
    ("field_ne", Kind::Numbers(2), false, "the formation field: north, east, dimensionless"),
    ("error_ne_m", Kind::Numbers(2), false, "the field converted to a position error: north, east, m"),
    ("altitude_setpoint_m", Kind::Number, false, "altitude asked of the vehicle controller, m above the origin"),
    ("sticks", Kind::Numbers(4), true, "roll, pitch, yaw, collective as written; null while left alone"),
    ("step_us", Kind::Number, true, "from the frame's arrival to its last control, real time only, microseconds"),
    ("safety_activations", Kind::Integer, true, "how often the safety filter has stepped in since the start"),
    ("law_misses", Kind::Integer, true, "asks that an external law has not answered since the start"),
    ("frame_overruns", Kind::Integer, false, "steps that ended after the next frame was due, since the start"),
    ("state_messages", Kind::Integer, false, "state messages said since the start"),
    ("state_bytes", Kind::Integer, false, "their payload, bytes"),
];

/// An object in which every key is always there.
fn object(title: &str, keys: &[Key]) -> Map<String, Value> {
    let property = |&(name, kind, nullable, about): &Key| {
        let mut schema = kind.schema();
        if nullable {
            schema["type"] = json!([schema["type"], "null"]);
        }
        schema["description"] = about.into();
        (name.to_owned(), schema)
    };
    let properties: Map<_, _> = keys.iter().map(property).collect();
    let mut schema = Map::new();
    schema.insert("title".to_owned(), title.into());
    schema.insert("type".to_owned(), "object".into());
    schema.insert("required".to_owned(), keys.iter().map(|(name, ..)| *name).collect());
    schema.insert("properties".to_owned(), properties.into());
    schema
}

/// Adds a key that always holds this.
fn with(mut schema: Map<String, Value>, name: &str, held: impl Into<Value>) -> Map<String, Value> {
    if let Some(Value::Array(required)) = schema.get_mut("required") {
        required.push(name.into());
    }
    if let Some(Value::Object(properties)) = schema.get_mut("properties") {
        properties.insert(name.to_owned(), held.into());
    }
    schema
}

/// One step of a vehicle.
pub(super) fn trace() -> Value {
    let peers = json!({ "type": "array", "items": object("peer", &PEER), "description": "every peer ever heard" });
    let step = with(object(TRACE, &STEP), "header", object("header", &HEADER));
    let log =
        json!({ "type": "array", "items": object("number", &LAW_NUMBER), "description": "what an external law logs" });
    with(with(with(step, "attitude", object("attitude", &ATTITUDE)), "peers", peers), "law_log", log).into()
}

/// What a vehicle said of itself.
pub(super) fn event() -> Value {
    let keys = [
        ("vehicle", Kind::Integer, false, "who says it"),
        ("incarnation", Kind::Integer, true, "its agent's life: a restarted agent has a larger one; null in a study"),
        ("sequence", Kind::Integer, true, "grows with every event of this life; null in a study"),
        ("text", Kind::Text, false, "as people read it"),
    ];
    with(
        object(EVENT, &keys),
        "what",
        json!({ "description": "as programs read it: a word, or a word with its values" }),
    )
    .into()
}

/// What was done to the swarm.
pub(super) fn fault() -> Value {
    let keys =
        [("vehicle", Kind::Integer, true, "to whom, if to one"), ("text", Kind::Text, false, "as people read it")];
    let what = "as programs read it: Died, Restarted, Failed with the scenario's word, Cut, Healed, Delayed or DelayOver with [sender, receiver]";
    with(object(FAULT, &keys), "what", json!({ "description": what })).into()
}
