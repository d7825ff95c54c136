//! The files that the program carries, so that it flies without a copy of its source: scenarios, examples of laws, and
//! the template of a cluster file.

use skein_common::scenario::{Source, nearest_of};

use crate::error::Error;

macro_rules! carried {
    ($($name:literal: $path:literal,)*) => {
        [$(Source { name: $name, text: include_str!(concat!("../../", $path)) },)*]
    };
}

/// The scenarios that fly by their name alone: the name of the file without `.toml`.
pub const SCENARIOS: [Source<'_>; 10] = carried! {
    "hover.toml": "scenarios/hover.toml",
    "flock.toml": "scenarios/flock.toml",
    "tour.toml": "scenarios/tour.toml",
    "laws.toml": "scenarios/laws.toml",
    "crossing.toml": "scenarios/crossing.toml",
    "sinusoid.toml": "scenarios/sinusoid.toml",
    "fleet.toml": "scenarios/fleet.toml",
    "ten-thousand.toml": "scenarios/ten-thousand.toml",
    "paper-hover.toml": "scenarios/paper/hover.toml",
    "paper-flock.toml": "scenarios/paper/flock.toml",
};

/// The scenario that flies when the command line names none: a hover formation.
pub const HOVER: Source<'_> = SCENARIOS[0];
/// A flock that follows a moving centre.
pub const FLOCK: Source<'_> = SCENARIOS[1];

/// Formation laws as programs in other languages.
pub const LAWS: [Source<'_>; 3] = carried! {
    "ring.py": "laws/ring.py",
    "ring.m": "laws/ring.m",
    "goto_tcp.m": "laws/goto_tcp.m",
};

/// Reads the tables of studies and recordings in Matlab and Octave.
pub const TABLE_READER: Source<'_> = Source { name: "skein_table.m", text: include_str!("../../laws/skein_table.m") };

/// A study as a script for Matlab and Octave.
pub const MATLAB_STUDY: Source<'_> = Source { name: "study.m", text: include_str!("../../laws/study.m") };

/// A cluster file with every key explained.
pub const CLUSTER: Source<'_> = Source { name: "cluster.toml", text: include_str!("../../cluster.example.toml") };

/// The shipped scenario with this name; `.toml` may follow it.
pub fn scenario(name: &str) -> Option<Source<'static>> {
    let name = name.strip_suffix(".toml").unwrap_or(name);
    SCENARIOS.into_iter().find(|shipped| name_of(shipped) == name)
}

/// The shipped scenario with this name.
///
/// # Errors
/// If no shipped scenario has it; the error names the most similar one.
pub fn find(name: &str) -> Result<Source<'static>, Error> {
    scenario(name).ok_or_else(|| {
        let help = most_similar(name).map_or_else(
            || "`skein files scenarios` lists them".to_owned(),
            |similar| format!("did you mean {similar}?"),
        );
        Error::Refused(format!("no shipped scenario is called \"{name}\"; {help}"))
    })
}

/// The name of the shipped scenario that is most similar to this text, if one is similar.
pub fn most_similar(text: &str) -> Option<&'static str> {
    nearest_of(SCENARIOS.iter().map(name_of), text)
}

/// The name by which a shipped scenario flies.
pub fn name_of(shipped: &Source<'static>) -> &'static str {
    shipped.name.strip_suffix(".toml").unwrap_or(shipped.name)
}

/// The comment that begins a shipped scenario, in one line.
pub fn about(shipped: &Source<'static>) -> String {
    let comment = shipped.text.lines().map_while(|line| line.strip_prefix('#'));
    comment.map(str::trim).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::load_any;

    use super::*;

    #[test]
    fn every_shipped_scenario_is_found_by_its_name_and_can_be_read() {
        for shipped in SCENARIOS {
            assert_eq!(scenario(name_of(&shipped)).map(|found| found.text), Some(shipped.text));
            assert_eq!(scenario(shipped.name).map(|found| found.text), Some(shipped.text));
            assert!(load_any(&shipped, &[]).is_ok(), "{}", shipped.name);
            assert!(about(&shipped).len() > 40, "{}", about(&shipped));
        }
        assert!(scenario("no-such-scenario").is_none() && scenario("external").is_none());
        assert_eq!(most_similar("flok"), Some("flock"));
    }

    /// A scenario that needs a file beside it cannot fly by its name alone.
    #[test]
    fn every_scenario_of_the_source_is_shipped_unless_it_needs_another_file() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenarios");
        let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let missing: Vec<String> = names.filter(|name| name.ends_with(".toml") && scenario(name).is_none()).collect();
        assert_eq!(missing, ["external.toml"]);
    }
}
