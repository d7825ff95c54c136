//! Configuration of one agent at its start: its id, its plant, where it listens, whom it dials and which keys it
//! trusts.

pub mod fleet;

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use skein_common::id::{VehicleId, VehicleName};
use skein_common::scenario::{
    self, ControlMode, Described, FileKind, Loaded, PlantKind, Scenario, ScenarioError, Source, Written,
};

use crate::link::Security;
use crate::link::security::Tls;
use crate::link::signature::VerificationKey;
use crate::plant::{PlantChoice, PlantError, PlantVehicle};
use crate::unix;
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::formation::{self, UnsupportedScenario};
use skein_host::external::{self, ExternalError};
use skein_host::files::{self, FileError};

/// Command-line options of an agent.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(group = clap::ArgGroup::new("part").required(true).args(["config", "scenario"]))]
pub struct AgentOptions {
    /// A node's own file: its scenario, its id, the endpoints it listens on and dials
    #[arg(long, value_name = "FILE", conflicts_with = "id")]
    pub config: Option<PathBuf>,
    /// The scenario to fly, over this computer's loopback
    #[arg(long, value_name = "FILE", requires = "id")]
    pub scenario: Option<PathBuf>,
    /// The vehicle's number, 1 to 250; in a fleet with its team: 3/7
    #[arg(long, alias = "vehicle", value_name = "N")]
    pub id: Option<VehicleName>,
    /// Address of the X-Plane to fly in
    #[arg(long, value_name = "HOST[:PORT]")]
    pub xplane: Option<String>,
    /// Change a key of the scenario: formation.radius_m=50
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// End on the line "stop" from standard input, as on a signal
    #[arg(long, hide = true)]
    pub child: bool,
    /// Time for which an earlier agent has flown the vehicle, s: the scenario's events continue from there
    #[arg(long, hide = true, value_name = "S", value_parser = seconds)]
    pub flown_s: Option<f64>,
    /// The run of the swarm, printed by `skein cluster up`: orders of another run are refused
    #[arg(long, value_name = "N", value_parser = number)]
    pub run: Option<u64>,
    /// Folder for the inputs of the agent: after a fault, or under record.inputs, `skein replay` runs them again
    #[arg(long, value_name = "DIR")]
    pub inputs: Option<PathBuf>,
}

/// Contents of a node's own file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AgentFile {
    /// Path of the scenario, relative to this file.
    pub scenario: PathBuf,
    /// Its vehicle: the id, in a fleet with the team, `"3/7"`.
    pub id: VehicleName,
    /// Endpoints to listen on, in Zenoh's notation.
    pub listen: Vec<String>,
    /// Endpoints of the peers to dial; in each pair of agents one dials the other.
    pub dial: Vec<String>,
    /// Plant to fly, if not the scenario's.
    pub plant: Option<PlantKind>,
    /// Simulator's address, `HOST[:PORT]`.
    pub xplane: Option<String>,
    /// Keys and certificates; without them links are plain.
    pub security: Option<Tls>,
}

/// The reason why an agent cannot start. Each error is one sentence that the user can act on.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file named by the scenario cannot be used.
    #[error(transparent)]
    Named(#[from] FileError),
    /// The node's file is not valid.
    #[error("{0}")]
    File(String),
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Agents cannot fly the scenario: it uses a feature that they do not support, has too many vehicles for real time, or has
    /// too little room for their starts.
    #[error("{0}: {1}")]
    InScenario(String, #[source] Box<dyn Error + Send + Sync>),
    /// The vehicle is not in the scenario's file, which has this number of vehicles.
    #[error("vehicle {0} does not fly in {1}, which has vehicles 1 to {2}")]
    NotInSwarm(VehicleId, String, usize),
    /// The vehicle is named without a team in a fleet, with one in a swarm, or with one that the fleet does not have.
    #[error("vehicle {0} does not fly in {1}: in a fleet a vehicle is named with its team, 3/7, and only there")]
    Team(VehicleName, String),
    /// The plant cannot fly the vehicle.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The external law cannot be reached.
    #[error(transparent)]
    Law(#[from] ExternalError),
    /// Links are secured, but the number of the run is missing.
    #[error(
        "{0}: its links are secured, so it needs the number of the run of the swarm: `--run N`, the number that \
         `skein cluster up` prints"
    )]
    NoRun(String),
}

impl ConfigError {
    fn in_scenario(file: &str, source: impl Error + Send + Sync + 'static) -> Self {
        Self::InScenario(file.to_owned(), Box::new(source))
    }
}

/// The checked configuration of one agent.
#[derive(Clone, Debug)]
pub struct Node {
    /// The scenario.
    pub scenario: Scenario,
    /// Notes on the scenario and the keys for the user.
    pub notes: Vec<String>,
    /// Id of the vehicle.
    pub id: VehicleId,
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Endpoints to dial.
    pub dial: Vec<String>,
    /// Its aircraft.
    pub aircraft: Aircraft,
    /// Rule bases of its flight controller.
    pub rules: Rules,
    /// Plant that flies its aircraft.
    pub plant: PlantChoice,
    /// Time for which an earlier agent has flown the vehicle, s; `None` for the first agent.
    pub flown_s: Option<f64>,
    /// The security of its links.
    pub security: Security,
    /// Public key that verifies orders; without it orders are accepted without a signature.
    pub orders_key: Option<VerificationKey>,
    /// Run of the swarm; 0 where runs have no number.
    pub run: u64,
    /// The folder for the inputs of the agent; `None` keeps none.
    pub inputs: Option<InputsFolder>,
}

/// The folder for the inputs of an agent, and the facts that a replay needs beside them.
#[derive(Clone, Debug, PartialEq)]
pub struct InputsFolder {
    /// The folder; a file in it is named after the vehicle and the agent's incarnation.
    pub path: PathBuf,
    /// The complete scenario file.
    pub scenario: String,
    /// Name of the vehicle.
    pub vehicle: VehicleName,
    /// The vehicle's aircraft file.
    pub aircraft: String,
    /// The rule bases, if they are not those that come with the program.
    pub rules: Option<[String; 4]>,
}

impl AgentOptions {
    /// Reads the files and checks the whole configuration.
    ///
    /// # Errors
    /// The first fault found.
    pub fn node(&self) -> Result<Node, ConfigError> {
        match (&self.config, &self.scenario, self.id) {
            (Some(path), ..) => {
                let (name, text) = (path.display().to_string(), files::read(path)?);
                let source = Source { name: &name, text: &text };
                let read = Written::typed(&source, FileKind::Agent);
                let (file, _): (AgentFile, _) = read.map_err(|fault| ConfigError::File(fault.to_string()))?;
                let own_folder = path.parent().unwrap_or(Path::new(""));
                let described = self.described(&own_folder.join(&file.scenario))?;
                self.node_of(file, own_folder, described)
            }
            (None, Some(path), Some(name)) => self.by_hand(path, name),
            _ => Err(ConfigError::File("give either --config, or --scenario and --id".to_owned())),
        }
    }

    /// Configuration of a vehicle of this scenario whose agents are all started by hand on this computer.
    fn by_hand(&self, path: &Path, name: VehicleName) -> Result<Node, ConfigError> {
        let described = self.described(path)?;
        let teams = described.all();
        let ports: BTreeMap<_, _> = fleet::ports(teams).collect();
        let endpoint = |name| ports.get(&name).map(|port| format!("tcp/127.0.0.1:{port}"));
        let file = AgentFile {
            scenario: path.to_owned(),
            id: name,
            // Nowhere for a vehicle that does not fly, which is refused below.
            listen: endpoint(name).into_iter().collect(),
            dial: fleet::dialled(name, teams).filter_map(endpoint).collect(),
            plant: None,
            xplane: None,
            security: None,
        };
        self.node_of(file, Path::new(""), described)
    }

    /// Reads the scenario file.
    fn described(&self, path: &Path) -> Result<Described, ConfigError> {
        let name = path.display().to_string();
        let described = scenario::load_any(&Source { name: &name, text: &files::read(path)? }, &self.sets)?;
        let checked = fleet::check_size(described.all());
        checked.map_err(|source| ConfigError::in_scenario(&name, source))?;
        Ok(described)
    }

    /// Checks a node's file, whose paths start from `own_folder`, and its scenario.
    fn node_of(&self, file: AgentFile, own_folder: &Path, described: Described) -> Result<Node, ConfigError> {
        let AgentFile { scenario: path, id: full_name, listen, dial, plant, xplane, security } = file;
        let path = own_folder.join(path);
        let name = path.display().to_string();
        let id = full_name.vehicle;
        let whole = self.inputs.as_ref().map(|_| described.to_toml());
        let Loaded { mut notes, mut scenario, .. } =
            described.into_team(full_name.team).ok_or_else(|| ConfigError::Team(full_name, name.clone()))?;
        check_live(&scenario).map_err(|source| ConfigError::in_scenario(&name, source))?;
        let vehicles = scenario.swarm.vehicles;
        let folder = path.parent().unwrap_or(Path::new(""));
        external::find(&mut scenario, folder)?;
        let Some(vehicle) = scenario.vehicle(id) else {
            return Err(ConfigError::NotInSwarm(id, name, vehicles));
        };
        let (aircraft, aircraft_text) = files::aircraft(&vehicle.aircraft, folder)?;
        let (rules, rule_texts) = files::rules(&scenario.control.rules, folder)?;
        if scenario.record.inputs && self.inputs.is_none() {
            notes.push(
                "record.inputs: this agent has no folder for its inputs, so it writes none; add --inputs DIR".into(),
            );
        }
        let inputs = self.inputs.clone().zip(whole).map(|(path, scenario)| InputsFolder {
            path,
            scenario,
            vehicle: full_name,
            aircraft: aircraft_text,
            rules: rule_texts,
        });
        let address = self.xplane.as_ref().or(xplane.as_ref());
        let flown_s = self.flown_s;
        let vehicle = PlantVehicle { scenario: &scenario, id, aircraft: &aircraft, rules: &rules, flown_s };
        let plant = PlantChoice::new(plant.unwrap_or(scenario.swarm.plant), address.map(String::as_str), &vehicle);
        let plant = plant.map_err(|error| match error {
            PlantError::StartArea(source) => ConfigError::in_scenario(&name, source),
            error => error.into(),
        })?;
        let (security, orders_key) = match security {
            None => (Security::Plain, None),
            Some(_) if self.run.is_none_or(|run| run == 0) => {
                let file = self.config.as_ref().map_or_else(String::new, |file| file.display().to_string());
                return Err(ConfigError::NoRun(file));
            }
            Some(tls) => {
                let (orders_key, tls) = (tls.orders, tls.in_folder(own_folder));
                if unix::others_can_read(&tls.key) {
                    let key = tls.key.display();
                    notes.push(format!("{key}: other users can read this key; run chmod 600 {key}"));
                }
                (Security::Tls(tls), Some(orders_key))
            }
        };
        let run = self.run.unwrap_or(0);
        Ok(Node {
            scenario,
            notes,
            id,
            listen,
            dial,
            aircraft,
            rules,
            plant,
            flown_s,
            security,
            orders_key,
            run,
            inputs,
        })
    }
}

/// Refuses a scenario that cannot be flown in real time.
///
/// # Errors
/// The first unsupported feature, by name.
pub fn check_live(scenario: &Scenario) -> Result<(), UnsupportedScenario> {
    if scenario.control.mode == ControlMode::Central {
        return Err(UnsupportedScenario("control.mode = \"central\" is flown only in a study".to_owned()));
    }
    formation::check(scenario)?;
    formation::check_airspace(scenario)
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.0..=1e9).contains(seconds));
    seconds.ok_or_else(|| "must be a number of seconds, 0 to 1e9".to_owned())
}

fn number(text: &str) -> Result<u64, String> {
    let number = match text.strip_prefix("0x") {
        Some(digits) => u64::from_str_radix(digits, 16),
        None => text.parse(),
    };
    number.map_err(|_| "must be a number, decimal or 0x...".to_owned())
}

#[cfg(test)]
mod tests;
