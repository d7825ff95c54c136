//! What one agent is told at its start: who it is, what it flies, where it listens, whom it dials, and whom it trusts.

mod security;

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use skein_common::frame::Origin;
use skein_common::id::VehicleId;
use skein_common::scenario::{self, ControlMode, FileKind, PlantKind, Scenario, ScenarioError, Source, Written};

use crate::link::Security;
use crate::link::seal::SealKey;
use crate::plant::builtin::BuiltIn;
use crate::plant::xplane::{self, XPlane, wire};
use crate::unix;
pub use security::SecurityTable;
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::formation::{self, NotFlown};
use skein_core::helicopter::{BuiltInVehicle, Script, TICK_S, Weather};
use skein_core::plant::Plant;
use skein_core::start::{TooFull, starts};
use skein_host::external::{self, ExternalError};
use skein_host::files::{self, FileError};

/// What an agent is asked to be.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(group = clap::ArgGroup::new("part").required(true).args(["config", "scenario"]))]
pub struct AgentOptions {
    /// A node's own file: its scenario, its id, where it listens and whom it dials
    #[arg(long, value_name = "FILE", conflicts_with = "id")]
    pub config: Option<PathBuf>,
    /// The scenario to take part in, over this computer's loopback
    #[arg(long, value_name = "FILE", requires = "id")]
    pub scenario: Option<PathBuf>,
    /// The vehicle's number, 1 to 250
    #[arg(long, value_name = "N")]
    pub id: Option<VehicleId>,
    /// The X-Plane to fly in
    #[arg(long, value_name = "HOST[:PORT]")]
    pub xplane: Option<String>,
    /// A key of the scenario, changed: formation.radius_m=50
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Take the line "stop" from standard input like a signal to end
    #[arg(long, hide = true)]
    pub child: bool,
    /// How long an earlier agent has flown the vehicle, s: the scenario's events go on from there
    #[arg(long, hide = true, value_name = "S", value_parser = seconds)]
    pub flown_s: Option<f64>,
    /// The run of the swarm, which `skein cluster up` prints: orders of another run are void
    #[arg(long, value_name = "N", value_parser = number)]
    pub run: Option<u64>,
}

/// A node's own file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AgentFile {
    /// Relative to this file.
    pub scenario: PathBuf,
    /// Who it is in that scenario.
    pub id: VehicleId,
    /// Endpoints to listen on, as Zenoh writes them.
    pub listen: Vec<String>,
    /// Endpoints of the peers that this one dials: of each pair, one dials the other.
    pub dial: Vec<String>,
    /// What to fly, if not what the scenario says.
    pub plant: Option<PlantKind>,
    /// `HOST[:PORT]` of the simulator.
    pub xplane: Option<String>,
    /// Keys; without them everything is plain.
    pub security: Option<SecurityTable>,
}

/// Why an agent cannot be what it is asked to be. Each is one sentence, and the user's to mend.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file that cannot be used.
    #[error(transparent)]
    Named(#[from] FileError),
    /// A node's file that is none.
    #[error("{0}")]
    File(String),
    /// A scenario that is none.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A scenario that this program cannot fly, or not in real time.
    #[error("{file}: {source}")]
    NotFlown {
        /// The scenario's file.
        file: String,
        /// What.
        source: NotFlown,
    },
    /// A vehicle that is not in the scenario.
    #[error("vehicle {id} does not fly in {file}, which has vehicles 1 to {vehicles}")]
    NotInSwarm {
        /// Who.
        id: VehicleId,
        /// The scenario's file.
        file: String,
        /// How many there are.
        vehicles: usize,
    },
    /// Starts that do not fit.
    #[error("{file}: {source}")]
    TooFull {
        /// The scenario's file.
        file: String,
        /// What does not fit.
        source: TooFull,
    },
    /// An aircraft that only X-Plane flies.
    #[error("the aircraft {0} has no [helicopter] table, which the built-in plant needs")]
    NoModel(String),
    /// An external law that cannot be reached.
    #[error(transparent)]
    Law(#[from] ExternalError),
    /// Secured links without the run of the swarm.
    #[error(
        "{0}: its links are secured, so it has to be told the run of the swarm: `--run N`, the number that `skein cluster up` \
         prints"
    )]
    NoRun(String),
    /// A simulator that cannot be addressed.
    #[error("{text:?} is no HOST[:PORT] of a simulator: {source}")]
    Address {
        /// As given.
        text: String,
        /// What the system says.
        source: io::Error,
    },
}

/// Everything that one agent needs, checked.
#[derive(Clone, Debug)]
pub struct Node {
    /// What the swarm does.
    pub scenario: Scenario,
    /// Notes on the scenario for its reader.
    pub notes: Vec<String>,
    /// Who this is.
    pub id: VehicleId,
    /// Where it listens.
    pub listen: Vec<String>,
    /// Whom it dials.
    pub dial: Vec<String>,
    /// What it flies.
    pub aircraft: Aircraft,
    /// How its controller decides.
    pub rules: Rules,
    /// Where its aircraft is.
    pub plant: PlantChoice,
    /// How long an earlier agent has flown the vehicle, s; `None` for the first.
    pub flown_s: Option<f64>,
    /// How its links are secured.
    pub security: Security,
    /// The key that orders are sealed with; without it they are believed unsealed.
    pub orders_key: Option<SealKey>,
    /// The run of the swarm; 0 where nobody counts.
    pub run: u64,
}

/// Where an aircraft is.
#[derive(Clone, Debug)]
pub enum PlantChoice {
    /// In this process.
    BuiltIn(Box<BuiltInVehicle>),
    /// Behind the protocol of X-Plane, at this address.
    Standin(SocketAddr),
    /// In an X-Plane, at this address or else on this computer.
    XPlane(Option<SocketAddr>),
}

impl PlantChoice {
    /// As the scenario spells it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::BuiltIn(_) => "builtin",
            Self::Standin(_) => "standin",
            Self::XPlane(_) => "xplane",
        }
    }
}

/// Where an agent listens that is started by hand, or another of this computer finds it.
pub fn loopback_endpoint(id: VehicleId) -> String {
    format!("tcp/127.0.0.1:{}", 7446 + u16::from(id.get()))
}

impl AgentOptions {
    /// Reads the files and checks everything.
    ///
    /// # Errors
    /// The first fault found.
    pub fn node(&self) -> Result<Node, ConfigError> {
        let file = match (&self.config, &self.scenario, self.id) {
            (Some(path), ..) => return self.node_of(read_agent_file(path)?, path.parent().unwrap_or(Path::new(""))),
            (None, Some(scenario), Some(id)) => AgentFile {
                scenario: scenario.clone(),
                id,
                listen: vec![loopback_endpoint(id)],
                dial: VehicleId::first(usize::from(id.get()) - 1).map(loopback_endpoint).collect(),
                plant: None,
                xplane: None,
                security: None,
            },
            _ => return Err(ConfigError::File("either --config, or --scenario and --id".to_owned())),
        };
        self.node_of(file, Path::new(""))
    }

    /// `own_folder` is where the node's file stands.
    fn node_of(&self, file: AgentFile, own_folder: &Path) -> Result<Node, ConfigError> {
        let AgentFile { scenario: path, id, listen, dial, plant, xplane, security } = file;
        let path = own_folder.join(path);
        let name = path.display().to_string();
        let loaded = scenario::load(&Source { name: &name, text: &files::read(&path)? }, &self.sets)?;
        let (mut notes, mut scenario) = (loaded.notes, loaded.scenario);
        check_live(&scenario).map_err(|source| ConfigError::NotFlown { file: name.clone(), source })?;
        let vehicles = scenario.swarm.vehicles;
        let folder = path.parent().unwrap_or(Path::new(""));
        external::find(&mut scenario, folder)?;
        let Some(vehicle) = scenario.vehicle(id) else {
            return Err(ConfigError::NotInSwarm { id, file: name, vehicles });
        };
        let (aircraft, _) = files::aircraft(&vehicle.aircraft, folder)?;
        let rules = files::rules(&scenario.control.rules, folder)?;
        let address = self.xplane.as_ref().or(xplane.as_ref());
        let plant = match (plant.unwrap_or(scenario.swarm.plant), address) {
            (PlantKind::Builtin, None) => {
                let start = starts(&scenario).map_err(|source| ConfigError::TooFull { file: name, source })?;
                let helicopter =
                    aircraft.helicopter.as_ref().ok_or_else(|| ConfigError::NoModel(vehicle.aircraft.clone()))?;
                let start = &start[usize::from(id.get()) - 1];
                let origin = Origin::new(scenario.origin.geodetic());
                let vehicle =
                    BuiltInVehicle::new(&origin, helicopter, start, &Weather::from(&scenario.world), scenario.seed, id);
                PlantChoice::BuiltIn(Box::new(vehicle))
            }
            (PlantKind::Standin, address) => {
                let address = address.or(vehicle.xplane.as_ref()).map(|text| simulator(text)).transpose()?;
                let port = wire::PORT + 10 * u16::from(id.get() - 1);
                PlantChoice::Standin(address.unwrap_or_else(|| (Ipv4Addr::LOCALHOST, port).into()))
            }
            // Who names an X-Plane wants to fly in it.
            (PlantKind::Builtin | PlantKind::Xplane, address) => {
                let address = address.or(vehicle.xplane.as_ref()).map(|text| simulator(text)).transpose()?;
                PlantChoice::XPlane(address)
            }
        };
        let (security, orders_key) = match security {
            None => (Security::Plain, None),
            Some(_) if self.run.is_none_or(|run| run == 0) => {
                let file = self.config.as_ref().map_or_else(String::new, |file| file.display().to_string());
                return Err(ConfigError::NoRun(file));
            }
            Some(table) => {
                let (security, orders_key) = table.of(own_folder);
                notes.extend(open_key(&security));
                (security, Some(orders_key))
            }
        };
        let (flown_s, run) = (self.flown_s, self.run.unwrap_or(0));
        Ok(Node { scenario, notes, id, listen, dial, aircraft, rules, plant, flown_s, security, orders_key, run })
    }
}

impl Node {
    /// The plant, ready to fly. Nothing of it is touched before its first frame.
    ///
    /// # Errors
    /// If a socket for talking to the simulator cannot be had.
    pub fn open_plant(&self) -> Result<Box<dyn Plant>, xplane::LinkError> {
        let address = match &self.plant {
            PlantChoice::BuiltIn(vehicle) => {
                let script = Script::of(&self.scenario.mission.events, self.id);
                return Ok(Box::new(BuiltIn::new((**vehicle).clone(), script, self.flown_s)));
            }
            PlantChoice::Standin(address) => Some(*address),
            PlantChoice::XPlane(address) => *address,
        };
        let origin = Origin::new(self.scenario.origin.geodetic());
        let listen = address.map_or(Ipv4Addr::UNSPECIFIED.into(), |address| listen_for(address.ip()));
        let rate_hz = (1.0 / TICK_S).round() as u32;
        Ok(Box::new(XPlane::new(&origin, address, &self.aircraft.xplane, rate_hz, listen)?))
    }
}

/// The local address from which a simulator is reached.
pub fn listen_for(simulator: IpAddr) -> IpAddr {
    match simulator {
        _ if simulator.is_loopback() => simulator,
        IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    }
}

/// Refuses a scenario that cannot be flown in real time.
///
/// # Errors
/// What of it cannot, by name.
pub fn check_live(scenario: &Scenario) -> Result<(), NotFlown> {
    if scenario.control.mode == ControlMode::Central {
        return Err(NotFlown("control.mode = \"central\" is flown only in a study".to_owned()));
    }
    formation::check(scenario)
}

fn read_agent_file(path: &Path) -> Result<AgentFile, ConfigError> {
    let (name, text) = (path.display().to_string(), files::read(path)?);
    let source = Source { name: &name, text: &text };
    let read = Written::typed(&source, FileKind::Agent).map_err(|fault| ConfigError::File(fault.to_string()))?;
    Ok(read.0)
}

/// What to say of a private key that is not private.
fn open_key(security: &Security) -> Option<String> {
    let Security::Tls(tls) = security else { return None };
    let key = tls.key.display();
    unix::others_can_read(&tls.key).then(|| format!("{key}: others can read this key; chmod 600 {key}"))
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.0..=1e9).contains(seconds));
    seconds.ok_or_else(|| "has to be a number of seconds, 0 to 1e9".to_owned())
}

fn number(text: &str) -> Result<u64, String> {
    let number = match text.strip_prefix("0x") {
        Some(digits) => u64::from_str_radix(digits, 16),
        None => text.parse(),
    };
    number.map_err(|_| "has to be a number, decimal or 0x...".to_owned())
}

/// The address in `HOST[:PORT]`, IPv4 first where a name has several.
pub fn simulator(text: &str) -> Result<SocketAddr, ConfigError> {
    let addresses = if let Ok(ip) = text.parse::<IpAddr>() {
        Ok(vec![(ip, wire::PORT).into()])
    } else if text.contains(':') {
        text.to_socket_addrs().map(Vec::from_iter)
    } else {
        (text, wire::PORT).to_socket_addrs().map(Vec::from_iter)
    };
    let address = |source| ConfigError::Address { text: text.to_owned(), source };
    let addresses = addresses.map_err(address)?;
    let first = addresses.iter().find(|address| address.is_ipv4()).or(addresses.first());
    first.copied().ok_or_else(|| address(io::ErrorKind::NotFound.into()))
}

#[cfg(test)]
mod tests;
