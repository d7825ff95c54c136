//! Suggestions: the key or word that was probably meant.

use strsim::osa_distance;

use super::{KEYS, Key, in_step, join, pattern};

/// Keys and words that are never suggested, because they land or abort the swarm: a suggestion that is followed unread must
/// not end the flight. Where one of them is the nearest, nothing is suggested. Messages that list every choice still name them.
const NEVER_SUGGESTED: [&str; 2] = ["land", "abort"];

/// The letters to insert, remove, replace or swap with their neighbour to make one text of the other, if they are few: one,
/// and one more for every four letters, at most `most`.
fn few_slips(candidate: &str, written: &str, most: usize) -> Option<usize> {
    let distance = osa_distance(candidate, written);
    (distance <= most.min(1 + written.len() / 4)).then_some(distance)
}

/// The valid path nearest to one that is not, if any is near: a letter or two off, or right but in another table.
pub(in crate::scenario) fn nearest(known: &[Key], path: &str) -> Option<String> {
    if path.len() > 100 {
        return None;
    }
    let (table, name) = path.rsplit_once('.').unwrap_or(("", path));
    let siblings = siblings(known, table).into_iter();
    // Most of the forgotten ends are units.
    let without_end =
        |sibling: &str| sibling.strip_prefix(name).is_some_and(|end| name.len() > 2 && end.starts_with('_'));
    let slips = |sibling| few_slips(sibling, name, usize::MAX).or(without_end(sibling).then_some(1));
    let beside = siblings.filter_map(|sibling| Some((slips(sibling)?, join(table, sibling))));
    let others = known.iter().filter(|key| !key.path.contains('N'));
    let elsewhere = others.clone().filter_map(|key| Some((1 + few_slips(key.name(), name, 1)?, key.path.to_owned())));
    // Two paths of one table are alike in most of their letters: only slips outside the name count here.
    let whole = others.filter_map(|key| Some((few_slips(key.path, path, MOST_IN_A_PATH)?, key.path.to_owned())));
    let is_dangerous = |path: &str| NEVER_SUGGESTED.contains(&path.rsplit('.').next().unwrap_or(path));
    let all = beside.chain(elsewhere).chain(whole).map(|(slips, path)| (slips, is_dangerous(&path), path));
    let (_, is_dangerous, path) = all.min_by_key(|(slips, is_dangerous, _)| (*slips, *is_dangerous))?;
    (!is_dangerous).then_some(path)
}

/// Slips in a whole path that still let it be recognised.
const MOST_IN_A_PATH: usize = 3;

/// Names of keys and tables directly inside a table.
pub(in crate::scenario) fn siblings(known: &[Key], table: &str) -> Vec<&'static str> {
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
pub fn nearest_of<'a>(words: impl Iterator<Item = &'a str>, word: &str) -> Option<&'a str> {
    let words = words.filter(|known| word.len() <= 2 * known.len());
    let close = |known: &'a str| Some((few_slips(word, known, usize::MAX)?, NEVER_SUGGESTED.contains(&known), known));
    words.filter_map(close).min().and_then(|(_, is_dangerous, known)| (!is_dangerous).then_some(known))
}

/// The scenario's keys whose path contains this text, in any case. A path out of a file is one too, as
/// `mission.steps[3].name` or `vehicle.2.aircraft`.
pub fn matching(text: &str) -> Vec<&'static Key> {
    let text = text.to_lowercase();
    let with = |part: &str| KEYS.iter().filter(|key| key.path.to_lowercase().contains(part)).collect::<Vec<_>>();
    let found = with(&text);
    if !found.is_empty() {
        return found;
    }
    let pattern = pattern(KEYS, &text).to_lowercase();
    with(in_step(&pattern.replace("[n]", "[N]")).unwrap_or(&pattern))
}

/// The scenario's key of which a text that [`matching`] does not find is most likely a misspelling.
pub fn meant(text: &str) -> Option<&'static Key> {
    if text.len() > 100 {
        return None;
    }
    let text = text.to_lowercase();
    let distance = |key: &'static Key| {
        let parts = key.path.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| part.len() > 2);
        let slips = parts.chain([key.name(), key.path]).filter_map(|part| few_slips(part, &text, usize::MAX)).min()?;
        Some((slips, key))
    };
    KEYS.iter().filter_map(distance).min_by_key(|(slips, _)| *slips).map(|(_, key)| key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_suggestion_lands_or_aborts_the_swarm() {
        let slips = ["lan", "lnad", "landd", "lands", "l", "laned", "wait", "waypoint", "hand", "band", "lane", "and"];
        for table in ["mission.steps[0]", "mission.events[0]", "formation", "", "mission"] {
            for slip in slips {
                let suggested = nearest(KEYS, &join(table, slip)).unwrap_or_default();
                assert!(!suggested.ends_with("land") && !suggested.ends_with("abort"), "{table} {slip}: {suggested}");
                assert!(!suggested.contains("[N]"), "{suggested} is no path of a file");
            }
        }
        let orders = ["hold", "goto", "land", "abort"];
        for slip in ["lnad", "lan", "landing", "abrot", "abor", "abrt", "about"] {
            assert_eq!(nearest_of(orders.into_iter(), slip), None, "{slip}");
        }
        assert_eq!(nearest_of(orders.into_iter(), "hlod"), Some("hold"));
    }

    #[test]
    fn keys_are_found_by_any_part_of_their_path() {
        let paths = |text: &str| matching(text).iter().map(|key| key.path).collect::<Vec<_>>();
        assert_eq!(paths("RADIUS"), ["formation.radius_m"]);
        assert_eq!(paths("vehicle.3.air"), ["vehicle.N.aircraft"]);
        assert_eq!(paths("mission.steps[2].name"), ["mission.steps[N].name"]);
        assert_eq!(paths("mission.steps[2].formation.radius_m"), ["formation.radius_m"]);
        assert_eq!(paths("").len(), KEYS.len());
        assert_eq!(paths("raduis"), [""; 0]);
    }

    #[test]
    fn a_misspelt_part_leads_to_its_key() {
        let path = |text: &str| meant(text).map(|key| key.path);
        assert_eq!(path("raduis"), Some("formation.radius_m"));
        assert_eq!(path("formation.raduis_m"), Some("formation.radius_m"));
        assert_eq!(path("bandwith"), Some("network.bandwidth_bit_s"));
        assert_eq!(path("qqqqqqqqqqqq"), None);
    }
}
