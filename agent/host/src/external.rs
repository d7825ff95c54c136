//! The way to an external law, another program: how it is found, what is said, and who carries it.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`protocol`] | JSON lines: hello, ask, bye; ready, answer |
//! | [`vector`] | the same content as vectors of numbers, for programs without JSON |
//! | [`talk`] | a child process, a TCP connection or a UDP socket that carries them |
//!
//! The core knows none of this: it has [`skein_core::formation::external`]. In virtual time the study carries the words.

pub mod protocol;
pub mod talk;
pub mod vector;

use std::env;
use std::io;
use std::path::{Path, PathBuf};

use skein_common::id::VehicleId;
use skein_common::scenario::{self, Law, Scenario};

/// How a law is reached, checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Way {
    /// Program and arguments: one process for each vehicle.
    Command(Vec<String>),
    /// The law connects to this host and port.
    Listen(String, u16),
    /// Vectors go to the first and come to the second.
    Udp {
        /// Host and port of asks.
        ask: (String, u16),
        /// Host and port of answers.
        answer: (String, u16),
    },
}

/// Why a law cannot be reached. Each is one sentence, and the user's to mend.
#[derive(Debug, thiserror::Error)]
pub enum ExternalError {
    /// No such program.
    #[error("formation.external.command: there is no program {0:?}")]
    NoProgram(String),
    /// A program that does not start.
    #[error("formation.external.command: {0:?} does not start: {1}")]
    Start(String, io::Error),
    /// None or several of the ways, or an address that is none.
    #[error("formation.external: {0}")]
    Way(String),
    /// A port that cannot be had.
    #[error("formation.external: {0}: {1}")]
    Port(String, io::Error),
}

impl Way {
    /// How this scenario's law is reached; `None` if no step has an external law.
    ///
    /// # Errors
    /// A program that does not exist, or an address that is none.
    pub fn of(scenario: &Scenario) -> Result<Option<Self>, ExternalError> {
        if !is_external(scenario) {
            return Ok(None);
        }
        let external = &scenario.formation.external;
        let way = match (&external.command, &external.listen, &external.udp) {
            (Some(command), None, None) => {
                let program = command.first().map_or("", String::as_str);
                if !exists(program) {
                    return Err(ExternalError::NoProgram(program.to_owned()));
                }
                Self::Command(command.clone())
            }
            (None, Some(listen), None) => {
                let (host, port) = address(listen.strip_prefix("tcp/").unwrap_or(listen))?;
                Self::Listen(host, port)
            }
            (None, None, Some(scenario::Udp { ask, answer })) => {
                Self::Udp { ask: address(ask)?, answer: address(answer)? }
            }
            _ => return Err(ExternalError::Way("one of command, listen and udp".to_owned())),
        };
        Ok(Some(way))
    }
}

/// Gives the files of the scenario's command their full paths, which start from its `folder`, and makes sure that its law
/// can be reached.
///
/// # Errors
/// As [`Way::of`].
pub fn find(scenario: &mut Scenario, folder: &Path) -> Result<(), ExternalError> {
    if let Some(command) = &mut scenario.formation.external.command {
        *command = resolve(command, folder).map_err(|error| ExternalError::Way(error.to_string()))?;
    }
    Way::of(scenario).map(drop)
}

/// Whether any step of the mission has an external law.
pub fn is_external(scenario: &Scenario) -> bool {
    scenario.mission.steps.iter().any(|step| step.formation.law == Law::External)
}

/// The command with full paths in place of those that start from the scenario's `folder`: of a program with a path, and
/// of arguments that name a file there.
///
/// # Errors
/// If this process has no working folder.
pub fn resolve(command: &[String], folder: &Path) -> io::Result<Vec<String>> {
    let resolved = command.iter().enumerate().map(|(nth, word)| {
        let path = folder.join(word);
        let is_program = nth == 0;
        let names_a_file = if is_program { has_path(word) } else { path.is_file() };
        if !names_a_file || Path::new(word).is_absolute() {
            return Ok(word.clone());
        }
        std::path::absolute(&path).map(|path| path.display().to_string())
    });
    resolved.collect()
}

/// The port of vehicle `id`, which follows from the first.
///
/// # Errors
/// If there are no so high ports.
pub fn port_of(first: u16, id: VehicleId) -> Result<u16, ExternalError> {
    let port = first.checked_add(id.get().into());
    port.ok_or_else(|| ExternalError::Way(format!("no port is left for vehicle {id} above {first}")))
}

fn address(text: &str) -> Result<(String, u16), ExternalError> {
    let parsed = text.rsplit_once(':').and_then(|(host, port)| Some((host.to_owned(), port.parse().ok()?)));
    parsed.ok_or_else(|| ExternalError::Way(format!("{text:?} is no HOST:PORT")))
}

fn has_path(program: &str) -> bool {
    Path::new(program).components().count() > 1
}

/// Whether there is such a program: a file, if the name has a path, else one of a folder in `PATH`.
fn exists(program: &str) -> bool {
    let is_there = |path: PathBuf| path.is_file() || path.with_extension("exe").is_file();
    if has_path(program) {
        return is_there(program.into());
    }
    let folders = env::var_os("PATH").unwrap_or_default();
    !program.is_empty() && env::split_paths(&folders).any(|folder| is_there(folder.join(program)))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn way(lines: &str) -> Result<Option<Way>, ExternalError> {
        let text = format!("swarm.vehicles = 2\n[formation]\n{lines}");
        let source = scenario::Source { name: "test.toml", text: &text };
        Way::of(&scenario::load(&source, &[]).unwrap().scenario)
    }

    #[test]
    fn a_law_is_reached_in_one_of_three_ways() {
        assert_eq!(way("").unwrap(), None);
        let nobody = "external.command = ['no/such program']";
        assert_eq!(way(nobody).unwrap(), None, "a command that no step uses is not looked for");
        let law = |external: &str| way(&format!("law = 'external'\nexternal.{external}"));
        let missing = law("command = ['no-such-program-7']").unwrap_err().to_string();
        assert_eq!(missing, "formation.external.command: there is no program \"no-such-program-7\"");
        assert!(law("command = ['no/such/program']").is_err());
        assert_eq!(law("command = ['cargo', 'x']").unwrap(), Some(Way::Command(vec!["cargo".into(), "x".into()])));
        let listen = law("listen = 'tcp/127.0.0.1:5600'").unwrap();
        assert_eq!(listen, Some(Way::Listen("127.0.0.1".into(), 5600)));
        let udp = law("udp = { ask = '[::1]:5700', answer = '0.0.0.0:5800' }").unwrap();
        assert_eq!(udp, Some(Way::Udp { ask: ("[::1]".into(), 5700), answer: ("0.0.0.0".into(), 5800) }));
    }

    #[test]
    fn files_beside_the_scenario_are_found_from_anywhere() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("law.py"), "").unwrap();
        let command = ["python3", "-u", "law.py", "other.py", "/law.py"].map(str::to_owned);
        let resolved = resolve(&command, folder.path()).unwrap();
        let full = folder.path().join("law.py").display().to_string();
        assert_eq!(resolved, ["python3", "-u", full.as_str(), "other.py", "/law.py"]);
        let program = resolve(&["./law".to_owned()], folder.path()).unwrap();
        assert_eq!(Path::new(&program[0]), folder.path().join("law"));
    }

    #[test]
    fn every_vehicle_has_a_port_while_there_are_some() {
        let id = |number| VehicleId::new(number).unwrap();
        assert_eq!(port_of(5600, id(3)).unwrap(), 5603);
        assert!(port_of(65_500, id(40)).is_err());
    }
}
