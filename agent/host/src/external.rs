//! Connects to an external law, another program: finds it, encodes the protocol, and carries the messages.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`protocol`] | messages as JSON lines: hello, ask and bye to the law; ready and answer from it |
//! | [`vector`] | queries and replies as vectors of numbers, for programs without JSON |
//! | [`session`] | one session: a child process, a TCP connection or a UDP socket |
//!
//! The core only has [`skein_core::formation::external`]. In virtual time the study carries the messages.

pub mod protocol;
pub mod session;
pub mod vector;

use std::env;
use std::io;
use std::path::{Path, PathBuf};

use skein_common::id::VehicleId;
use skein_common::scenario::{self, Law, Scenario};

/// Checked transport to a law.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LawTransport {
    /// Program and arguments, started as one process for each vehicle.
    Command(Vec<String>),
    /// Host and port that the law connects to.
    Listen(String, u16),
    /// Vectors in UDP datagrams.
    Udp {
        /// Host and port that queries are sent to.
        ask: (String, u16),
        /// Host and port that replies come to.
        answer: (String, u16),
    },
}

/// The reason why a law cannot be reached. Each error is one sentence that the user can act on.
#[derive(Debug, thiserror::Error)]
pub enum ExternalError {
    /// The program does not exist.
    #[error("formation.external.command: program {0:?} not found")]
    NoProgram(String),
    /// The program does not start.
    #[error("formation.external.command: {0:?} does not start: {1}")]
    Start(String, io::Error),
    /// The scenario names no transport, several, or an address that is not valid.
    #[error("formation.external: {0}")]
    Transport(String),
    /// A port cannot be bound.
    #[error("formation.external: {0}: {1}")]
    Port(String, io::Error),
}

impl LawTransport {
    /// Transport to this scenario's law; `None` if no step has an external law.
    ///
    /// # Errors
    /// If the program does not exist, or an address is not valid.
    pub fn of(scenario: &Scenario) -> Result<Option<Self>, ExternalError> {
        if !is_external(scenario) {
            return Ok(None);
        }
        let external = &scenario.formation.external;
        let transport = match (&external.command, &external.listen, &external.udp) {
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
            _ => return Err(ExternalError::Transport("give exactly one of command, listen and udp".to_owned())),
        };
        Ok(Some(transport))
    }
}

/// Replaces file names in the scenario's command, which are relative to its `folder`, by full paths, and checks that
/// its law can be reached.
///
/// # Errors
/// The same as [`LawTransport::of`].
pub fn find(scenario: &mut Scenario, folder: &Path) -> Result<(), ExternalError> {
    if let Some(command) = &mut scenario.formation.external.command {
        *command = resolve(command, folder).map_err(|error| ExternalError::Transport(error.to_string()))?;
    }
    LawTransport::of(scenario).map(drop)
}

/// Whether any step of the mission has an external law.
pub fn is_external(scenario: &Scenario) -> bool {
    scenario.mission.steps.iter().any(|step| step.formation.law == Law::External)
}

/// The command with full paths in place of those relative to the scenario's `folder`: a program with a path, and
/// arguments that name a file there. On Windows `python3` is `python`.
///
/// # Errors
/// If this process has no working directory.
pub fn resolve(command: &[String], folder: &Path) -> io::Result<Vec<String>> {
    let resolved = command.iter().enumerate().map(|(nth, message)| {
        let path = folder.join(message);
        let is_program = nth == 0;
        if cfg!(windows) && is_program && message == "python3" {
            // Python's installer for Windows writes no `python3.exe`.
            return Ok("python".to_owned());
        }
        let names_a_file = if is_program { has_path(message) } else { path.is_file() };
        if !names_a_file || Path::new(message).is_absolute() {
            return Ok(message.clone());
        }
        std::path::absolute(&path).map(|path| path.display().to_string())
    });
    resolved.collect()
}

/// Port for vehicle `id`: the first port plus the id.
///
/// # Errors
/// If that port number is too large.
pub fn port_of(first: u16, id: VehicleId) -> Result<u16, ExternalError> {
    let port = first.checked_add(id.get().into());
    port.ok_or_else(|| ExternalError::Transport(format!("port {first} plus the vehicle id {id} is above 65535")))
}

fn address(text: &str) -> Result<(String, u16), ExternalError> {
    let parsed = text.rsplit_once(':').and_then(|(host, port)| Some((host.to_owned(), port.parse().ok()?)));
    parsed.ok_or_else(|| ExternalError::Transport(format!("{text:?} is not HOST:PORT")))
}

fn has_path(program: &str) -> bool {
    Path::new(program).components().count() > 1
}

/// Whether the program exists: as a file if its name has a path, else in a folder of `PATH`.
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

    fn transport(lines: &str) -> Result<Option<LawTransport>, ExternalError> {
        let text = format!("swarm.vehicles = 2\n[formation]\n{lines}");
        let source = scenario::Source { name: "test.toml", text: &text };
        LawTransport::of(&scenario::load(&source, &[]).unwrap().scenario)
    }

    #[test]
    fn a_law_has_one_of_three_transports() {
        assert_eq!(transport("").unwrap(), None);
        let unused = "external.command = ['no/such program']";
        assert_eq!(transport(unused).unwrap(), None, "an unused command is not looked for");
        let law = |external: &str| transport(&format!("law = 'external'\nexternal.{external}"));
        let missing = law("command = ['no-such-program-7']").unwrap_err().to_string();
        assert_eq!(missing, "formation.external.command: program \"no-such-program-7\" not found");
        assert!(law("command = ['no/such/program']").is_err());
        assert_eq!(
            law("command = ['cargo', 'x']").unwrap(),
            Some(LawTransport::Command(vec!["cargo".into(), "x".into()]))
        );
        let listen = law("listen = 'tcp/127.0.0.1:5600'").unwrap();
        assert_eq!(listen, Some(LawTransport::Listen("127.0.0.1".into(), 5600)));
        let udp = law("udp = { ask = '[::1]:5700', answer = '0.0.0.0:5800' }").unwrap();
        assert_eq!(udp, Some(LawTransport::Udp { ask: ("[::1]".into(), 5700), answer: ("0.0.0.0".into(), 5800) }));
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
