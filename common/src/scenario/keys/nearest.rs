//! Suggestions for misspelt keys and choices.

use strsim::osa_distance;

use super::{KEYS, formation_table_of_step, join, pattern};
use crate::scenario::key::Key;

/// Keys, choices and orders that are never suggested, because they land or abort the swarm: a user who accepts a suggestion
/// without reading it must not end the flight. If one of them is the most similar, nothing is suggested. Error messages
/// that list every choice still contain them.
pub const NEVER_SUGGESTED: [&str; 2] = ["land", "abort"];

/// Number of typos between two texts (letters inserted, removed, replaced or swapped), if they are few: one, and one
/// more for every four letters, at most `most`.
fn few_typos(candidate: &str, written: &str, most: usize) -> Option<usize> {
    let distance = osa_distance(candidate, written);
    (distance <= most.min(1 + written.len() / 4)).then_some(distance)
}

/// The valid path most similar to an unknown one: with a typo or two, or of the same name in another table.
pub(in crate::scenario) fn nearest(known: &[Key], path: &str) -> Option<String> {
    if path.len() > 100 {
        return None;
    }
    let (table, name) = path.rsplit_once('.').unwrap_or(("", path));
    let siblings = siblings(known, table).into_iter();
    // A forgotten ending is most often a unit.
    let without_end =
        |sibling: &str| sibling.strip_prefix(name).is_some_and(|end| name.len() > 2 && end.starts_with('_'));
    let typos = |sibling| few_typos(sibling, name, usize::MAX).or(without_end(sibling).then_some(1));
    let beside = siblings.filter_map(|sibling| Some((typos(sibling)?, join(table, sibling))));
    let others = known.iter().filter(|key| !key.path.contains('N'));
    let elsewhere = others.clone().filter_map(|key| Some((1 + few_typos(key.name(), name, 1)?, key.path.to_owned())));
    // Two paths of one table have most of their letters in common: only typos outside the name count here.
    let whole = others.filter_map(|key| Some((few_typos(key.path, path, MOST_IN_A_PATH)?, key.path.to_owned())));
    let is_dangerous = |path: &str| NEVER_SUGGESTED.contains(&path.rsplit('.').next().unwrap_or(path));
    let all = beside.chain(elsewhere).chain(whole).map(|(typos, path)| (typos, is_dangerous(&path), path));
    let (_, is_dangerous, path) = all.min_by_key(|(typos, is_dangerous, _)| (*typos, *is_dangerous))?;
    (!is_dangerous).then_some(path)
}

/// Largest number of typos in a whole path.
const MOST_IN_A_PATH: usize = 3;

/// Names of the keys and tables directly inside a table.
pub(in crate::scenario) fn siblings(known: &[Key], table: &str) -> Vec<&'static str> {
    let pattern = pattern(known, table);
    let prefix = formation_table_of_step(&pattern).unwrap_or(&pattern);
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

/// The choice most similar to a text, if one is similar.
pub fn nearest_of<'a>(choices: impl Iterator<Item = &'a str>, text: &str) -> Option<&'a str> {
    let choices = choices.filter(|known| text.len() <= 2 * known.len());
    let close = |known: &'a str| Some((few_typos(text, known, usize::MAX)?, NEVER_SUGGESTED.contains(&known), known));
    choices.filter_map(close).min().and_then(|(_, is_dangerous, known)| (!is_dangerous).then_some(known))
}

/// The scenario's keys whose path contains this text, in upper or lower case. The text may be a path of a file, such as
/// `mission.steps[3].name` or `vehicle.2.aircraft`.
pub fn matching(text: &str) -> Vec<&'static Key> {
    let text = text.to_lowercase();
    let with = |part: &str| KEYS.iter().filter(|key| key.path.to_lowercase().contains(part)).collect::<Vec<_>>();
    let found = with(&text);
    if !found.is_empty() {
        return found;
    }
    let pattern = pattern(KEYS, &text).to_lowercase();
    with(formation_table_of_step(&pattern.replace("[n]", "[N]")).unwrap_or(&pattern))
}

/// The scenario's key most similar to a text for which [`matching`] finds none.
pub fn most_similar(text: &str) -> Option<&'static Key> {
    if text.len() > 100 {
        return None;
    }
    let text = text.to_lowercase();
    let distance = |key: &'static Key| {
        let parts = key.path.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| part.len() > 2);
        let typos = parts.chain([key.name(), key.path]).filter_map(|part| few_typos(part, &text, usize::MAX)).min()?;
        Some((typos, key))
    };
    KEYS.iter().filter_map(distance).min_by_key(|(typos, _)| *typos).map(|(_, key)| key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_suggestion_lands_or_aborts_the_swarm() {
        let typos = ["lan", "lnad", "landd", "lands", "l", "laned", "wait", "waypoint", "hand", "band", "lane", "and"];
        for table in ["mission.steps[0]", "mission.events[0]", "formation", "", "mission"] {
            for typo in typos {
                let suggested = nearest(KEYS, &join(table, typo)).unwrap_or_default();
                assert!(!suggested.ends_with("land") && !suggested.ends_with("abort"), "{table} {typo}: {suggested}");
                assert!(!suggested.contains("[N]"), "{suggested} is not a path of a file");
            }
        }
        let orders = ["hold", "goto", "land", "abort"];
        for typo in ["lnad", "lan", "landing", "abrot", "abor", "abrt", "about"] {
            assert_eq!(nearest_of(orders.into_iter(), typo), None, "{typo}");
        }
        assert_eq!(nearest_of(orders.into_iter(), "hlod"), Some("hold"));
    }

    #[test]
    fn keys_are_found_by_any_part_of_their_path() {
        let paths = |text: &str| matching(text).iter().map(|key| key.path).collect::<Vec<_>>();
        assert_eq!(paths("RADIUS"), ["formation.radius_m", "airspace.obstacles[N].radius_m"]);
        assert_eq!(paths("vehicle.3.air"), ["vehicle.N.aircraft"]);
        assert_eq!(paths("mission.steps[2].name"), ["mission.steps[N].name"]);
        assert_eq!(paths("mission.steps[2].formation.radius_m"), ["formation.radius_m"]);
        assert_eq!(paths("").len(), KEYS.len());
        assert_eq!(paths("raduis"), [""; 0]);
    }

    #[test]
    fn a_misspelt_part_leads_to_its_key() {
        let path = |text: &str| most_similar(text).map(|key| key.path);
        assert_eq!(path("raduis"), Some("formation.radius_m"));
        assert_eq!(path("formation.raduis_m"), Some("formation.radius_m"));
        assert_eq!(path("bandwith"), Some("network.bandwidth_bit_s"));
        assert_eq!(path("qqqqqqqqqqqq"), None);
    }
}
