//! Suggestions: the key or word that was probably meant.

use super::{Key, in_step, join, pattern};

/// The valid path nearest to one that is not, if any is near: a letter or two off, or right but in another table.
pub(in crate::scenario) fn nearest(known: &[Key], path: &str) -> Option<String> {
    if path.len() > 100 {
        return None;
    }
    let (table, name) = path.rsplit_once('.').unwrap_or(("", path));
    let siblings = siblings(known, table);
    let close = |candidate: &str, to: &str| {
        let distance = edit_distance(candidate, to);
        (distance <= 1 + to.len() / 4).then_some(distance)
    };
    let beside = siblings.iter().filter_map(|sibling| Some((close(sibling, name)?, join(table, sibling))));
    let elsewhere = known.iter().filter(|key| !key.path.contains("N")).filter_map(|key| {
        let last = key.path.rsplit_once('.').map_or(key.path, |(_, last)| last);
        Some((1 + close(last, name)?, key.path.to_owned()))
    });
    let whole = known.iter().filter_map(|key| Some((close(key.path, path)?, key.path.to_owned())));
    beside.chain(elsewhere).chain(whole).min_by_key(|(distance, _)| *distance).map(|(_, path)| path)
}

/// Names of keys and tables directly inside a table.
fn siblings(known: &[Key], table: &str) -> Vec<&'static str> {
    let pattern = pattern(known, table);
    let prefix = in_step(&pattern).unwrap_or(&pattern);
    let mut names: Vec<&str> = known
        .iter()
        .filter_map(
            |key| if prefix.is_empty() { Some(key.path) } else { key.path.strip_prefix(prefix)?.strip_prefix('.') },
        )
        .filter_map(|rest| rest.split(['.', '[']).next())
        .collect();
    if pattern == "mission.steps[N]" {
        names.push("formation");
    }
    if pattern == "mission.steps[N].formation" {
        names.retain(|name| *name != "external");
    }
    names.dedup();
    names
}

/// The word nearest to one that is none of these, if any is near.
pub(in crate::scenario) fn nearest_of<'a>(words: impl Iterator<Item = &'a str>, word: &str) -> Option<&'a str> {
    let close = |known: &'a str| (edit_distance(known, word), known);
    let nearest = words.filter(|known| word.len() <= 2 * known.len()).map(close).min();
    nearest.filter(|(distance, known)| *distance <= 1 + known.len() / 4).map(|(_, known)| known)
}

/// Letters to insert, remove, replace or swap with their neighbour (optimal string alignment).
fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut before_last = vec![0; b.len() + 1];
    let mut last: Vec<usize> = (0..=b.len()).collect();
    for i in 0..a.len() {
        let mut row = vec![i + 1; b.len() + 1];
        for j in 0..b.len() {
            let replaced = last[j] + usize::from(a[i] != b[j]);
            row[j + 1] = replaced.min(last[j + 1] + 1).min(row[j] + 1);
            if i > 0 && j > 0 && a[i] == b[j - 1] && a[i - 1] == b[j] {
                row[j + 1] = row[j + 1].min(before_last[j - 1] + 1);
            }
        }
        before_last = std::mem::replace(&mut last, row);
    }
    last[b.len()]
}
