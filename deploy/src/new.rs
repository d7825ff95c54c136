//! `skein files new`: writes a commented start for what a user wants to make. It can fly at once.

pub(crate) mod discover;
mod start;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Subcommand, ValueEnum};
use skein_lab::error::Error;
use skein_lab::scenario::quoted;
use skein_lab::terminal::{of_writing, say, what_next};

use skein_cluster::os;
use start::Start;

/// `skein files new`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein files new scenario my-ring\n  skein files new law my-law --lang python")]
pub struct NewArgs {
    /// The file to make
    #[command(subcommand)]
    pub kind: NewKind,
}

/// The files that can be made.
#[derive(Clone, Debug, Subcommand)]
pub enum NewKind {
    /// A scenario: a copy of a shipped one, to be changed
    #[command(
        after_help = "Examples:\n  skein files new scenario my-ring\n  skein files new scenario my-tour --from tour"
    )]
    Scenario {
        /// Its name; the file is NAME.toml
        name: Name,
        /// The shipped scenario to begin with
        #[arg(long, value_name = "SHIPPED", default_value = "hover")]
        from: String,
    },
    /// A formation law of your own, and a scenario that flies it
    #[command(
        after_help = "Examples:\n  skein files new law my-law\n  skein files new law my-law --lang rust --source ../skein"
    )]
    Law {
        /// Its name
        name: Name,
        /// The language to write it in
        #[arg(long, value_enum, default_value_t = Language::Python)]
        lang: Language,
        /// Folder of Skein's source, which a law in Rust is compiled with
        #[arg(long, value_name = "DIR", required_if_eq("lang", "rust"))]
        source: Option<PathBuf>,
    },
    /// An aircraft for the built-in plant: a copy of the shipped one, and a scenario that flies it
    #[command(after_help = "Examples:\n  skein files new aircraft heavy\n  skein files new aircraft my-trex600")]
    Aircraft {
        /// Its name; the file is NAME.toml
        name: Name,
    },
    /// A cluster file, and the scenario that the cluster flies
    #[command(after_help = "Examples:\n  skein files new cluster\n  skein files new cluster --discover")]
    Cluster {
        /// Name of the swarm; the file is cluster.toml
        #[arg(default_value = "lab")]
        name: Name,
        /// Listen to the beacons of X-Planes, and write a node for each that is found
        #[arg(long)]
        discover: bool,
        /// Time to listen, s
        #[arg(long, value_name = "S", default_value_t = 5.0, requires = "discover")]
        wait: f64,
    },
    /// A study: a script that flies many seeds of several variants, compares them, and draws them
    #[command(after_help = "Examples:\n  skein files new study my-study\n  skein files new study loss --lang python")]
    Study {
        /// Its name; the file is NAME.sh, NAME.py or NAME.m
        name: Name,
        /// The language of the script
        #[arg(long, value_enum, default_value_t = ScriptLanguage::Sh)]
        lang: ScriptLanguage,
    },
}

/// A language of a law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Language {
    /// A process for each vehicle
    Python,
    /// Compiled into a program of your own
    Rust,
    /// A program that connects over TCP
    Matlab,
    /// A process for each vehicle
    Octave,
}

/// A language of a script that flies a study.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ScriptLanguage {
    /// A shell script of commands
    Sh,
    /// A script with the package skein-swarm, whose results are frames of pandas
    Python,
    /// A script for Matlab and Octave, with a reader of the tables
    Matlab,
}

/// The name of something new: it becomes part of file names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Name(String);

impl FromStr for Name {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        match text.starts_with(|c: char| c.is_ascii_lowercase()) && text.chars().all(is_plain) && text.len() <= 40 {
            true => Ok(Self(text.to_owned())),
            false => {
                Err("a name has lowercase letters, digits and hyphens, begins with a letter, and is at most 40 long"
                    .to_owned())
            }
        }
    }
}

impl std::fmt::Display for Name {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

/// Writes the files into the working directory, and says what to do with them.
///
/// # Errors
/// If a file of this name exists, or cannot be written.
pub fn run(args: &NewArgs) -> Result<(), Error> {
    let start = Start::of(&args.kind)?;
    let written = write(Path::new(""), &start)?;
    say(&format!("{written}{}", what_next(&start.next)));
    Ok(())
}

/// Writes the files into this folder, and returns the lines that name them.
fn write(folder: &Path, start: &Start) -> Result<String, Error> {
    let paths: Vec<PathBuf> = start.files.iter().map(|file| folder.join(&file.path)).collect();
    if let Some(there) = paths.iter().find(|path| path.exists()) {
        return Err(Error::Refused(format!("{} exists already; choose another name", there.display())));
    }
    for (path, file) in paths.iter().zip(&start.files) {
        let written = || {
            path.parent().map_or(Ok(()), fs::create_dir_all)?;
            fs::File::create_new(path)?.write_all(file.text.as_bytes())?;
            if file.is_program { os::set_mode(path, 0o755) } else { Ok(()) }
        };
        written().map_err(|error| Error::Failed(format!("{}: {}", path.display(), of_writing(&error))))?;
    }
    let line = |file: &start::NewFile| format!("written  {}  {}\n", quoted(&file.path), file.about);
    Ok(start.files.iter().map(line).collect())
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::Described;
    use skein_lab::scenario::ScenarioArgs;

    use super::*;

    fn name(text: &str) -> Name {
        text.parse().unwrap()
    }

    fn scenario_in(folder: &Path, file: &str) -> Described {
        let args = ScenarioArgs { scenario: Some(folder.join(file)), sets: Vec::new() };
        let described = args.read_any(Vec::new()).unwrap();
        described.all().iter().for_each(|team| drop(args.ready(&team.scenario).unwrap()));
        described
    }

    #[test]
    fn what_is_written_can_fly_as_it_is() {
        let kinds = [
            (NewKind::Scenario { name: name("mine"), from: "tour".to_owned() }, "mine.toml"),
            (NewKind::Scenario { name: name("teams"), from: "fleet".to_owned() }, "teams.toml"),
            (NewKind::Aircraft { name: name("heavy") }, "heavy-hover.toml"),
            (NewKind::Law { name: name("mylaw"), lang: Language::Python, source: None }, "mylaw.toml"),
            (NewKind::Law { name: name("matlaw"), lang: Language::Matlab, source: None }, "matlaw.toml"),
            (NewKind::Cluster { name: name("lab"), discover: false, wait: 0.0 }, "hover.toml"),
        ];
        let folder = tempfile::tempdir().unwrap();
        for (kind, scenario) in kinds {
            let start = Start::of(&kind).unwrap();
            let lines = write(folder.path(), &start).unwrap();
            assert_eq!(lines.lines().count(), start.files.len(), "{lines}");
            let described = scenario_in(folder.path(), scenario);
            let own = scenario.split(['.', '-']).next().unwrap();
            assert!(described.first().scenario.name.starts_with(own), "{}", described.first().scenario.name);
            let again = write(folder.path(), &start).unwrap_err().to_string();
            assert!(again.contains("exists already"), "{again}");
        }
        let cluster = skein_cluster::inventory::Inventory::read(&folder.path().join("cluster.toml")).unwrap();
        assert_eq!((cluster.swarm.as_str(), cluster.nodes.len()), ("lab", 4));
    }

    #[test]
    fn a_name_is_fit_for_a_file() {
        for good in ["a", "my-ring-2"] {
            assert!(good.parse::<Name>().is_ok());
        }
        for bad in ["", "../x", "A", "2a", "a b", "a.toml", "-a", &"a".repeat(41)] {
            assert!(bad.parse::<Name>().is_err(), "{bad}");
        }
    }

    #[test]
    fn only_a_shipped_scenario_can_be_copied() {
        let refused = Start::of(&NewKind::Scenario { name: name("a"), from: "flok".to_owned() }).unwrap_err();
        assert_eq!(refused.to_string(), "no shipped scenario is called \"flok\"; did you mean flock?");
    }
}
