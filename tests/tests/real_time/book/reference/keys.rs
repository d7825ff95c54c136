//! `reference/keys.md`: every key of a scenario.

use std::collections::BTreeSet;
use std::process::Command;

use skein_common::scenario::{KEYS, Key, Literal, TunableKey};

use super::{head, row};
use crate::book::PROGRAM;

/// The page.
pub(super) fn page() -> String {
    let mut body = format!(
        "The program explains the same keys:\n\n```console\n$ skein files explain band_step\n{}```\n\nThe path of a key is its table and \
         its name: `radius_m` of `[formation]` is `formation.radius_m` for `--set`. `N` is a vehicle's id, `[N]` an index of \
         a list, counted from 0. In the column of units `1` is a pure number. \
         A key with the mark † can [change in flight](../missions.md#tuning-in-flight). Some defaults depend on another key: see [Presets](#presets).\n\n",
        explained("band_step")
    );
    let mut seen = BTreeSet::new();
    for key in KEYS {
        if seen.insert(table(key)) {
            body += &section(table(key));
        }
    }
    body += &presets();
    let purpose = "After reading this page you can write every key of a scenario file. It has the kind, range, default and unit \
                   of each key, and the reason for the default.";
    super::page("Keys of a scenario", purpose, "the keys' table", &body)
}

/// Output of `skein files explain`.
fn explained(pattern: &str) -> String {
    String::from_utf8(Command::new(PROGRAM).args(["files", "explain", pattern]).output().unwrap().stdout).unwrap()
}

/// The table in which a key is written; empty for the top level.
fn table(key: &Key) -> &'static str {
    key.path.rsplit_once('.').map_or("", |(table, _)| table)
}

fn section(of: &str) -> String {
    let title = if of.is_empty() { "Top level".to_owned() } else { format!("`[{of}]`") };
    let rows: String = KEYS.iter().filter(|key| table(key) == of).map(key_row).collect();
    format!("## {title}\n\n{}{rows}\n", head(&["key", "kind", "range", "default", "unit", "meaning"]))
}

fn key_row(key: &Key) -> String {
    let (kind, range) = (key.kind.to_string(), key.kind.range().unwrap_or_default());
    let unit = key.unit().unwrap_or_default();
    let mark = if TunableKey::find(key.path).is_some() { " †" } else { "" };
    row(&[&format!("`{}`{mark}", key.name()), &kind, &range, &shown(key.default), unit, key.about])
}

/// A default as a file spells it, or a description of it.
fn shown(value: Literal) -> String {
    match value {
        Literal::Required => "required".to_owned(),
        Literal::Nothing => String::new(),
        Literal::Same(path) => format!("that of `{path}`"),
        other => format!("`{other}`"),
    }
}

/// Defaults that depend on another key.
fn presets() -> String {
    let rows = |there: fn(&Key) -> Option<Literal>| -> String {
        let row_of = |key: &Key| Some(row(&[&format!("`{}`", key.path), &shown(key.default), &shown(there(key)?)]));
        KEYS.iter().filter_map(row_of).collect()
    };
    format!(
        "## Presets\n\nA key that is not written has its default. `preset = \"paper\"` has other defaults for these keys, those of Garcia \
         & Barnes 2010:\n\n{}{}\n`formation.law = \"flock\"` has other defaults for these keys, in both presets:\n\n{}{}",
        head(&["key", "default", "`preset = \"paper\"`"]),
        rows(Key::on_paper),
        head(&["key", "default", "`law = \"flock\"`"]),
        rows(|key| key.flock)
    )
}
