//! `reference/messages.md`: every message between processes, with its fields.

use std::collections::BTreeMap;

use skein_common::message::{
    ClockAnswer, Event, Health, Heartbeat, Intent, Message, Order, State, Summary, Trace, VERSION,
};
use skein_common::scenario::{KEYS, TunableKey};
use skein_common::topic::{TOPIC_DESCRIPTIONS, TopicDescription};

use super::source::{Field, Item, items};
use super::{head, row};

/// Where the messages and their parts are defined.
const SOURCES: [&str; 11] = [
    include_str!("../../../../../common/src/message.rs"),
    include_str!("../../../../../common/src/message/health.rs"),
    include_str!("../../../../../common/src/message/vehicle.rs"),
    include_str!("../../../../../common/src/message/summary.rs"),
    include_str!("../../../../../common/src/message/intent.rs"),
    include_str!("../../../../../common/src/message/order.rs"),
    include_str!("../../../../../common/src/message/simulator.rs"),
    include_str!("../../../../../common/src/message/clock.rs"),
    include_str!("../../../../../common/src/scenario/model/setting.rs"),
    include_str!("../../../../../common/src/state.rs"),
    include_str!("../../../../../common/src/frame.rs"),
];

/// Types whose definition is not a struct with named fields, as they are encoded.
const PLAIN: [(&str, &str); 18] = [
    ("VehicleId", "vehicle id (`u8`, 1 to 250)"),
    (
        "VehicleSet",
        "set of vehicle ids (4 × `u64`: the bit of value 2^((n − 1) mod 64) of the number (n − 1) / 64 is vehicle n)",
    ),
    ("Incarnation", "`u64`"),
    ("SenderStamp", "`u64`, ns"),
    ("PlantTime", "`u64`, ns"),
    ("PositionNed", "3 × `f64`: north, east, down, m"),
    ("VelocityNed", "3 × `f64`: north, east, down, m/s"),
    ("Signature", "64 bytes"),
    ("String", "text"),
    (
        "ShortText",
        "text of at most 96 printable ASCII characters; of a longer one the end after `...`, or the beginning before it",
    ),
    ("f64", "`f64`"),
    ("f32", "`f32`"),
    ("u64", "`u64`"),
    ("u32", "`u32`"),
    ("u16", "`u16`"),
    ("i32", "`i32`"),
    ("u8", "`u8`"),
    ("bool", "`bool`"),
];

/// Types whose fields stand in the place of the field, with `#[serde(flatten)]`.
const FLAT: [&str; 2] = ["VehicleFacts", "Option<ProcessFigures>"];

/// The largest size of each message, bytes.
const SIZES: [(&str, usize); 9] = [
    ("State", State::MAX_BYTES),
    ("Intent", Intent::MAX_BYTES),
    ("Heartbeat", Heartbeat::MAX_BYTES),
    ("Health", Health::MAX_BYTES),
    ("Event", Event::MAX_BYTES),
    ("Trace", Trace::MAX_BYTES),
    ("Summary", Summary::MAX_BYTES),
    ("ClockAnswer", ClockAnswer::MAX_BYTES),
    ("Order", Order::MAX_BYTES),
];

/// The page.
pub(super) fn page() -> String {
    let found: Vec<Item> = SOURCES.iter().flat_map(|source| items(source)).chain([tunable_keys()]).collect();
    let items: BTreeMap<&str, &Item> = found.iter().map(|item| (&*item.name, item)).collect();
    let (mut parts, mut sections) = (Vec::new(), String::new());
    for description in &TOPIC_DESCRIPTIONS {
        if let Some(name) = description.message {
            sections += &message(description, items[name], &items, &mut parts);
        }
    }
    let messages: Vec<&str> = TOPIC_DESCRIPTIONS.iter().filter_map(|description| description.message).collect();
    sections += "## Types in messages\n\n";
    let mut nth = 0;
    while let Some(name) = parts.get(nth).cloned() {
        if !messages.contains(&&*name) {
            sections += &part(items[&*name], &items, &mut parts);
        }
        nth += 1;
    }
    let body = format!("{}\n## Encoding\n\n{}\n{sections}", topics(), encoding());
    let purpose =
        "After reading this page you can subscribe to a swarm's messages with any Zenoh client and decode them.";
    super::page("Messages", purpose, "`common/src/topic/described.rs` and the docstrings of the messages", &body)
}

/// The keys that can change in flight: a macro defines them.
fn tunable_keys() -> Item {
    let field = |key: &TunableKey| {
        let about = KEYS.iter().find(|known| known.path == key.path()).map_or("", |known| known.about);
        Field { name: key.path().to_owned(), kind: String::new(), about: about.to_owned() }
    };
    let fields = TunableKey::ALL.iter().map(field).collect();
    Item { name: "TunableKey".to_owned(), about: "A key that can change in flight.".to_owned(), is_enum: true, fields }
}

/// The table of keys.
fn topics() -> String {
    let row_of = |description: &TopicDescription| {
        let message =
            description.message.map_or("none".to_owned(), |name| format!("[`{name}`](#{})", name.to_lowercase()));
        row(&[&format!("`{}`", description.key), &message, description.sender, description.receivers])
    };
    let rows: String = TOPIC_DESCRIPTIONS.iter().map(row_of).collect();
    format!(
        "Agents publish over Zenoh. The swarm's name (`swarm.name` in the scenario) is the namespace of all keys: the full key of \
         vehicle 3's health in the swarm `lab` is `lab/vehicle/3/health`. `N` is a vehicle's id, `ISSUER` a random number of the \
         operator's process, and `X` and `Y` count squares of 1 km north and east from the origin. In a \
         fleet all keys of a team lie below `team/` and its number, and the squares count from the fleet's origin: an agent \
         receives the states and intents in a square with the one key expression `lab/team/*/vehicle/*/cell/X/Y/*`. *Observers* are `skein fly`, \
         `skein record`, `skein view`, `skein order` and `skein cluster`.\n\n{}{rows}",
        head(&["key", "message", "sender", "receivers"])
    )
}

/// How a message becomes bytes.
fn encoding() -> String {
    format!(
        "A message is one byte, the version ({VERSION}), and the [postcard](https://postcard.jamesmunns.com) encoding of its struct: \
         the fields in the order of its table, without names.\n\n\
         | type | bytes |\n| --- | --- |\n| `u8` | one byte |\n| `bool` | one byte: 0 or 1 |\n| `u32`, `u64` | varint: seven bits a byte, the lowest first, the top \
         bit set in all but the last |\n| `i32` | varint of twice the number, of a negative one of twice its amount less one |\n\
         | `f64` | 8 bytes, little-endian |\n| text | its length in bytes as a varint, then UTF-8 |\n\
         | list of | the number of its items as a varint, then the items |\n| optional | 0, or 1 and the value |\n\
         | enum | the number of the variant, from 0, as a varint, then what the variant holds |\n\n\
         [`Summary`](#summary) alone is JSON: an object with the fields of its table and `version`. An optional value is null or the value, a \
         vector an array, and an enum the name of its variant. [Programs](../programs.md#a-swarm-in-ten-lines) reads it with ten lines of Python.\n\n\
         Receivers drop and count a message of another version, one that is longer than its largest size, one with bytes left over, \
         and one with a number that is not finite or out of its range.\n\n\
         Where a swarm is secured, 72 bytes follow each message but orders: the run of the swarm (8 bytes, little-endian) and an Ed25519 signature \
         by the vehicle's key (64 bytes) of a context, the swarm's name, the run, the key expression and the message. An \
         order carries its own signature in `signature`.\n"
    )
}

/// The section of one message.
fn message(
    description: &TopicDescription,
    item: &Item,
    items: &BTreeMap<&str, &Item>,
    parts: &mut Vec<String>,
) -> String {
    let TopicDescription { key, when, delivery, .. } = description;
    let (_, size) = SIZES.iter().find(|(name, _)| *name == item.name).unwrap();
    let facts = [("key", format!("`{key}`")), ("when", (*when).to_owned()), ("delivery", (*delivery).to_owned())];
    let facts = facts
        .iter()
        .chain(&[("size", format!("at most {size} bytes"))])
        .fold(String::new(), |text, (name, fact)| text + &row(&[name, fact]));
    format!("## {}\n\n{}\n\n{}{facts}\n{}\n", item.name, item.about, head(&["", ""]), fields(item, items, parts))
}

/// The section of a struct or an enum inside messages.
fn part(item: &Item, items: &BTreeMap<&str, &Item>, parts: &mut Vec<String>) -> String {
    format!("### {}\n\n{}\n\n{}\n", item.name, item.about, fields(item, items, parts))
}

/// The table of fields or variants; notes the types that they need.
fn fields(item: &Item, items: &BTreeMap<&str, &Item>, parts: &mut Vec<String>) -> String {
    let names: &[&str] =
        if item.is_enum { &["number", "variant", "holds", "meaning"] } else { &["field", "type", "meaning"] };
    head(names) + &rows(item, items, parts)
}

/// The rows of that table.
fn rows(item: &Item, items: &BTreeMap<&str, &Item>, parts: &mut Vec<String>) -> String {
    let mut rows = String::new();
    for (nth, Field { name, kind, about }) in item.fields.iter().enumerate() {
        let name = format!("`{name}`");
        if item.is_enum {
            let held: Vec<_> = kind.split(", ").filter(|kind| !kind.is_empty()).collect();
            let held = held.iter().map(|held| match held.split_once(": ") {
                Some((name, kind)) => format!("`{name}`: {}", shown(kind, items, parts)),
                None => shown(held, items, parts),
            });
            let held: Vec<_> = held.collect();
            rows += &row(&[&nth.to_string(), &name, &held.join(", "), about]);
        } else if FLAT.contains(&&**kind) {
            let inner = kind.trim_start_matches("Option<").trim_end_matches('>');
            rows += &self::rows(items[inner], items, parts);
        } else {
            rows += &row(&[&name, &shown(kind, items, parts), about]);
        }
    }
    rows
}

/// A Rust type for a reader of any language.
fn shown(kind: &str, items: &BTreeMap<&str, &Item>, parts: &mut Vec<String>) -> String {
    let inside = |outer: &str| kind.strip_prefix(outer)?.strip_suffix('>');
    if let Some(inner) = inside("Option<") {
        return format!("optional {}", shown(inner, items, parts));
    }
    if let Some(inner) = inside("Vec<") {
        return format!("list of {}", shown(inner, items, parts));
    }
    if let Some((inner, count)) = kind.strip_prefix('[').and_then(|kind| kind.strip_suffix(']')?.split_once("; ")) {
        return format!("{count} × {}", shown(inner, items, parts));
    }
    if let Some((_, plain)) = PLAIN.iter().find(|(name, _)| *name == kind) {
        return (*plain).to_owned();
    }
    assert!(items.contains_key(kind), "{kind} is neither in the sources nor in the table of plain types");
    if !parts.iter().any(|part| part == kind) {
        parts.push(kind.to_owned());
    }
    format!("[`{kind}`](#{})", kind.to_lowercase())
}
