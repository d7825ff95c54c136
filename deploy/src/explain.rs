//! `skein files explain`: explains the keys of a scenario: what each accepts, its default, and the reason for it.

use std::fmt::Write;

use serde_json::{Value, json};
use skein_common::scenario::{Key, Kind, Literal, Range, TunableKey, matching, most_similar};

use skein_cluster::display::screen::columns;
use skein_lab::error::Error;
use skein_lab::terminal::wrapped;

/// `skein files explain`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein files explain radius\n  skein files explain network --json")]
pub struct ExplainArgs {
    /// Part of a key's dotted path, in any case, such as radius or network.loss; without it, every key
    #[arg(value_name = "PATTERN")]
    pub pattern: Option<String>,
    /// Print a JSON array of objects {name, kind, range, unit, default, paper, flock, about}
    #[arg(long)]
    pub json: bool,
}

/// Width of a label such as "default" with the space around it, columns.
const INDENT: usize = 11;

/// Prints the explanation of every key whose path contains the pattern.
///
/// # Errors
/// If no key contains the pattern.
pub fn run(args: &ExplainArgs) -> Result<(), Error> {
    let keys = find(args.pattern.as_deref().unwrap_or_default())?;
    skein_lab::terminal::say(&if args.json {
        skein_lab::terminal::json(&as_json(&keys))
    } else {
        as_text(&keys, columns())
    });
    Ok(())
}

fn find(pattern: &str) -> Result<Vec<&'static Key>, Error> {
    let found = matching(pattern);
    if !found.is_empty() {
        return Ok(found);
    }
    let help = most_similar(pattern).map_or_else(
        || "`skein files explain` without a pattern lists every key".to_owned(),
        |key| format!("did you mean {}?", key.path),
    );
    Err(Error::Refused(format!("no key contains \"{pattern}\"; {help}")))
}

/// Formats each key's path with a labelled line below it for each property.
fn as_text(keys: &[&Key], columns: usize) -> String {
    keys.iter().map(|key| key_as_text(key, columns)).collect::<Vec<_>>().join("\n")
}

fn key_as_text(key: &Key, columns: usize) -> String {
    let value = |literal: Literal| match literal {
        Literal::Number(_) | Literal::Integer(_) => with_unit(key, literal.to_string()),
        _ => literal.to_string(),
    };
    let mut default = value(key.default);
    for (value_there, place) in [(key.on_paper(), "preset = \"paper\""), (key.flock, "law = \"flock\"")] {
        if let Some(there) = value_there {
            let _ = write!(default, "; under {place}: {}", value(there));
        }
    }
    let lines = [
        ("kind", Some(key.kind.to_string())),
        ("range", key.kind.range().map(|range| with_unit(key, range))),
        ("default", Some(default)),
        ("flight", in_flight(key)),
        ("reason", Some(key.about.to_owned())),
    ];
    let mut text = format!("{}\n", key.path);
    for (label, content) in lines {
        let Some(content) = content else { continue };
        for (nth, line) in wrapped(&content, columns - INDENT).into_iter().enumerate() {
            let label = if nth == 0 { label } else { "" };
            let _ = writeln!(text, "  {label:<7}  {line}");
        }
    }
    text
}

/// The text about the key's fastest change in flight, if it can change there.
fn in_flight(key: &Key) -> Option<String> {
    let rate = with_unit(key, TunableKey::find(key.path)?.rate_per_s().to_string());
    Some(format!("`skein order set` changes it by at most {rate} a second"))
}

/// The number with the key's unit, if it has one: 45°, 100 m.
fn with_unit(key: &Key, number: String) -> String {
    match key.unit() {
        Some("°") => format!("{number}°"),
        Some(unit) if unit != "1" => format!("{number} {unit}"),
        _ => number,
    }
}

/// Makes a JSON object for each key. `range` is `{min, max, min_included}` for numbers, the array of choices if the key
/// has choices, else null. `paper` and `flock` are null if the default applies there too. A default that is the value
/// of another key is `{same_as}`; a key without a default is `{required}`.
fn as_json(keys: &[&Key]) -> Value {
    let object = |key: &&Key| {
        json!({
            "name": key.path,
            "kind": key.kind.to_string(),
            "range": range_as_json(key.kind),
            "unit": key.unit(),
            "default": literal_as_json(key.default),
            "paper": key.on_paper().map(literal_as_json),
            "flock": key.flock.map(literal_as_json),
            "about": key.about,
        })
    };
    keys.iter().map(object).collect()
}

fn range_as_json(kind: Kind) -> Value {
    match kind {
        Kind::Number(Range { min, max, min_included }) | Kind::NumberOr(_, Range { min, max, min_included }) => {
            json!({ "min": min, "max": max, "min_included": min_included })
        }
        Kind::Integer(min, max) => json!({ "min": min, "max": max, "min_included": true }),
        kind if !kind.choices().is_empty() => json!(kind.choices()),
        _ => Value::Null,
    }
}

fn literal_as_json(literal: Literal) -> Value {
    match literal {
        Literal::Required => json!({ "required": true }),
        Literal::Nothing => Value::Null,
        Literal::Same(path) => json!({ "same_as": path }),
        Literal::Number(number) => json!(number),
        Literal::Integer(number) => json!(number),
        Literal::Bool(truth) => json!(truth),
        Literal::Text(text) => json!(text),
        Literal::Toml(text) => text.parse::<toml::Value>().map_or(Value::Null, |value| json!(value)),
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::KEYS;

    use super::*;

    #[test]
    fn a_key_is_explained_in_aligned_lines() {
        let avoid = "\
formation.avoid_distance_m
  kind     number or \"adaptive\"
  range    above 0, at most 10000 m
  default  \"adaptive\"; under preset = \"paper\": 100 m; under law = \"flock\": 20 m
  reason   distance delta R_avoid below which neighbours repel each other; \"adaptive\": R* sqrt(2)
           sin(pi/N) for N live vehicles, so that the survivors of a loss space out again
";
        assert_eq!(as_text(&find("Avoid_Distance").unwrap(), 100), avoid);
        let send = "\
network.send
  kind     one of \"on_need\", \"every_frame\"
  default  \"on_need\"; under preset = \"paper\": \"every_frame\"
  reason   when a vehicle sends its state: when its peers' dead
           reckoning of it is off, or every frame
";
        assert_eq!(as_text(&find("network.send").unwrap(), 65), send);
    }

    #[test]
    fn every_key_appears_once_in_text_and_json() {
        let (keys, text) = (find("").unwrap(), as_text(&find("").unwrap(), 100));
        let json = as_json(&keys);
        let names: Vec<_> = json.as_array().unwrap().iter().map(|key| key["name"].as_str().unwrap()).collect();
        assert_eq!(names, KEYS.iter().map(|key| key.path).collect::<Vec<_>>());
        let headings: Vec<_> = text.lines().filter(|line| !line.is_empty() && !line.starts_with(' ')).collect();
        assert_eq!(headings, names);
        assert!(text.lines().all(|line| line.chars().count() <= 100));
        for key in json.as_array().unwrap() {
            let fields: Vec<_> = key.as_object().unwrap().keys().map(String::as_str).collect();
            assert_eq!(fields, ["about", "default", "flock", "kind", "name", "paper", "range", "unit"]);
        }
    }

    #[test]
    fn json_has_typed_values() {
        let of = |path: &str| as_json(&find(path).unwrap())[0].clone();
        let radius = of("formation.radius_m");
        assert_eq!(
            (&radius["default"], &radius["paper"], &radius["flock"]),
            (&json!(100.0), &Value::Null, &json!(50.0))
        );
        assert_eq!((&radius["unit"], &radius["range"]["min_included"]), (&json!("m"), &json!(false)));
        assert_eq!(of("formation.vertical")["range"], json!(["bands", "ellipsoid"]));
        assert_eq!(of("swarm.vehicles")["default"], json!({ "required": true }));
        assert_eq!(of("swarm.name")["default"], json!({ "same_as": "name" }));
        assert_eq!(of("network.send")["paper"], json!("every_frame"));
    }

    #[test]
    fn a_pattern_without_a_match_is_refused_with_the_nearest_key() {
        let refused = |pattern: &str| find(pattern).unwrap_err();
        assert_eq!(refused("raduis").to_string(), "no key contains \"raduis\"; did you mean formation.radius_m?");
        assert_eq!(refused("raduis").exit_code(), 2);
        let nothing = "no key contains \"zzzzzzzz\"; `skein files explain` without a pattern lists every key";
        assert_eq!(refused("zzzzzzzz").to_string(), nothing);
    }
}
