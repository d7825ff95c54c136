//! Everything needed to connect to a live swarm: on this PC, through the file that `fly` writes, or on a cluster.

mod secured;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use skein_agent::link::Security;
use skein_agent::link::signature::{SigningKey, VerificationKey};
use skein_common::id::{SwarmName, TeamId, VehicleId};
use skein_common::scenario::{Described, Source, load_any};
use skein_common::topic::Branch;

use crate::endpoints::{self, Endpoints};
use crate::inventory::Inventory;
use crate::inventory::find::{self, Unnamed};
use crate::keys::Role;
use crate::keys::run::RunFile;
use skein_lab::error::Error;
use skein_lab::terminal::complain;

/// Everything needed to connect to a swarm.
#[derive(Clone, Debug)]
pub struct Reach {
    /// The swarm's name.
    pub swarm: SwarmName,
    /// The part of the key space that belongs to the swarm: in a fleet, to one team.
    pub branch: Branch,
    /// Every agent's endpoint in Zenoh's notation, `tls/10.0.0.11:7447`.
    pub agents: BTreeMap<VehicleId, String>,
    /// The security of the links, with the certificate of a role if they are secured.
    pub security: Security,
    /// The key that verifies the signatures of orders; `None` where orders are not signed.
    pub orders_key: Option<VerificationKey>,
    /// The key that signs orders; only an operator has it.
    pub signing_key: Option<Arc<SigningKey>>,
    /// The run that this PC began last, if any.
    pub own_run: Option<u64>,
    /// The file that records the orders in that run.
    pub run_file: Option<RunFile>,
    /// The scenario that is flown.
    pub scenario: Flown,
}

/// A complete scenario in flight.
#[derive(Clone, Debug)]
pub enum Flown {
    /// The file that contains it.
    File(PathBuf),
    /// Its text.
    Text(String),
}

impl Reach {
    /// Makes a connection to a swarm whose links are plain TCP.
    pub fn plain(swarm: SwarmName, agents: BTreeMap<VehicleId, String>, scenario: Flown) -> Self {
        Self {
            swarm,
            branch: Branch::SWARM,
            agents,
            security: Security::Plain,
            orders_key: None,
            signing_key: None,
            own_run: None,
            run_file: None,
            scenario,
        }
    }

    /// All agents' endpoints, in the order of ids.
    pub fn all(&self) -> Vec<String> {
        self.agents.values().cloned().collect()
    }

    /// Returns the scenario in flight: its name for error messages, and its text.
    ///
    /// # Errors
    /// If the scenario file cannot be read.
    pub fn flown(&self) -> Result<(String, String), Error> {
        match &self.scenario {
            Flown::Text(text) => Ok((format!("the scenario of {}", self.swarm), text.clone())),
            Flown::File(path) => read(path),
        }
    }

    /// Makes a connection to the swarm on this PC that has this branch.
    pub fn here(there: &Endpoints, branch: Branch) -> Self {
        let own = there.agents.iter().filter(|(name, _)| name.team == branch.team());
        let agents = own.map(|(name, agent)| (name.vehicle, agent.clone())).collect();
        let flown = Flown::File(there.folder(branch).join("scenario.toml"));
        Self { branch, ..Self::plain(there.swarm.clone(), agents, flown) }
    }

    /// Its name in messages: `swarm lab`, or in a fleet `team 3 of fleet lab`.
    pub fn title(&self) -> String {
        match self.branch.team() {
            Some(team) => format!("team {team} of fleet {}", self.swarm),
            None => format!("swarm {}", self.swarm),
        }
    }
}

/// The name of a file and its text.
fn read(path: &Path) -> Result<(String, String), Error> {
    let name = path.display().to_string();
    let text = fs::read_to_string(path).map_err(|error| Error::Refused(format!("{name}: {error}")))?;
    Ok((name, text))
}

/// Options that choose the swarm of a command.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct SwarmArgs {
    /// The swarm of this PC; not needed if only one flies here
    #[arg(long, global = true, value_name = "NAME", value_parser = |text: &str| SwarmName::new(text))]
    pub swarm: Option<SwarmName>,
    /// The file of the cluster that it flies on. Without -f and --swarm: the swarm that flies on this PC, or the cluster of the
    /// file that the environment variable SKEIN_CLUSTER names, else of cluster.toml in this folder; if both can be meant,
    /// the command is refused
    #[arg(short = 'f', long = "file", global = true, value_name = "CLUSTER.toml")]
    pub file: Option<PathBuf>,
}

/// The place where the swarm of a command flies.
#[derive(Clone, Debug)]
pub enum Place {
    /// On this PC, begun by `fly`.
    Here(Endpoints),
    /// On a cluster.
    Cluster(Box<Inventory>),
}

impl SwarmArgs {
    /// Chooses the swarm: the one that an option names, else the only candidate of those that fly on this PC and of the
    /// cluster that the environment or the current folder names. Announces on stderr what no option has named.
    ///
    /// # Errors
    /// If the swarm is not found, or there are several candidates, or the cluster file is wrong.
    pub fn choose(&self) -> Result<Place, Error> {
        let folder = endpoints::folder();
        match (&self.swarm, &self.file) {
            (Some(_), Some(_)) => {
                let why = "give either --swarm, for a swarm on this PC, or -f, for a cluster";
                Err(Error::Refused(why.to_owned()))
            }
            (None, Some(file)) => Ok(Place::Cluster(Box::new(Inventory::read(file)?))),
            (Some(swarm), None) => Ok(Place::Here(endpoints::find(&folder, Some(swarm))?)),
            (None, None) => choose_unnamed(&folder, find::unnamed()),
        }
    }
}

/// Chooses the swarm that no option names. An order must not reach a swarm by surprise: if both a swarm of this PC and a
/// cluster can be meant, neither is chosen.
fn choose_unnamed(folder: &Path, cluster: Option<Unnamed>) -> Result<Place, Error> {
    let Some(cluster) = cluster else {
        let here = endpoints::find(folder, None)?;
        complain(&format!("swarm {} on this PC", here.swarm));
        return Ok(Place::Here(here));
    };
    if let Some(swarm) = endpoints::flying(folder).first() {
        return Err(Error::Refused(format!(
            "swarm {swarm} flies on this PC, and {cluster} can be meant too: choose with --swarm {swarm} or -f {}",
            cluster.path.display()
        )));
    }
    complain(&cluster.to_string());
    Ok(Place::Cluster(Box::new(Inventory::read(&cluster.path)?)))
}

impl Place {
    /// Returns how to connect to the chosen teams of the swarm in this role; without `teams` to all of them, or to the one
    /// swarm that has no teams.
    ///
    /// # Errors
    /// If the keys of the cluster are wrong, or the fleet has no team of this number.
    pub fn reach_teams(&self, role: Role, teams: &[TeamId]) -> Result<Vec<Reach>, Error> {
        let mut reaches: Vec<Reach> = match self {
            Self::Cluster(inventory) => {
                inventory.check_hosts()?;
                inventory.reaches(role)?
            }
            Self::Here(there) => there.branches().into_iter().map(|branch| Reach::here(there, branch)).collect(),
        };
        let has = |team: TeamId| reaches.iter().any(|reach| reach.branch.team() == Some(team));
        if let Some(missing) = teams.iter().find(|team| !has(**team)) {
            return Err(Error::Refused(match reaches.as_slice() {
                [only] if only.branch.team().is_none() => format!("--teams: {} is one swarm without teams", only.swarm),
                several => {
                    let fleet = several.first().map_or_else(String::new, |reach| reach.swarm.to_string());
                    format!("fleet {fleet} has teams 1 to {}, not {missing}", several.len())
                }
            }));
        }
        reaches.retain(|reach| teams.is_empty() || reach.branch.team().is_some_and(|team| teams.contains(&team)));
        Ok(reaches)
    }

    /// The scenario in flight: that of the cluster file, or the one that `fly` wrote on this PC.
    ///
    /// # Errors
    /// If the scenario file cannot be read.
    pub fn described(&self) -> Result<Described, Error> {
        let there = match self {
            Self::Cluster(inventory) => return Ok(inventory.scenario.clone()),
            Self::Here(there) => there,
        };
        let (name, text) = read(&there.out.join("scenario.toml"))?;
        load_any(&Source { name: &name, text: &text }, &[])
            .map_err(|fault| Error::Scenario { fault: fault.into(), text: text.clone() })
    }

    /// Whether another swarm of this name has been started on this PC since this one was found.
    pub fn is_replaced(&self) -> bool {
        let Self::Here(there) = self else { return false };
        endpoints::read(&endpoints::folder(), &there.swarm).is_ok_and(|now| now.is_some_and(|now| now != *there))
    }

    /// The name of the swarm.
    pub fn swarm(&self) -> &SwarmName {
        match self {
            Self::Here(there) => &there.swarm,
            Self::Cluster(inventory) => &inventory.swarm,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;
    use crate::inventory::tests::{TEAMS, fleet, lab};
    use crate::tests::{LEFT_ALONE, close};

    #[test]
    fn a_swarm_on_this_pc_and_a_cluster_cannot_both_be_chosen() {
        let both = SwarmArgs { swarm: SwarmName::new("lab").ok(), file: Some("cluster.toml".into()) };
        let error = both.choose().unwrap_err();
        assert_eq!(error.to_string(), "give either --swarm, for a swarm on this PC, or -f, for a cluster");
        let missing = SwarmArgs { swarm: None, file: Some("no such/cluster.toml".into()) };
        let error = missing.choose().unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("no such/cluster.toml"), "{error}");
    }

    #[test]
    fn without_an_option_a_swarm_is_chosen_only_if_no_other_can_be_meant() {
        let place = tempfile::tempdir().unwrap();
        let runtime = place.path().join("skein");
        let inventory = lab(place.path(), 2, "security = 'none'");
        let cluster = |by_variable| Some(Unnamed { path: inventory.path.clone(), by_variable });
        let error = choose_unnamed(&runtime, None).unwrap_err();
        assert!(error.exit_code() == 1 && error.to_string().starts_with("no swarm flies here"), "{error}");
        let chosen = choose_unnamed(&runtime, cluster(false)).unwrap();
        assert!(matches!(&chosen, Place::Cluster(chosen) if chosen.nodes.len() == 2), "{chosen:?}");

        let agent = TcpListener::bind(LEFT_ALONE).unwrap();
        let there = Endpoints {
            swarm: SwarmName::new("hover").unwrap(),
            pid: 1,
            out: place.path().to_owned(),
            agents: BTreeMap::from([(
                VehicleId::first(1).next().unwrap().into(),
                format!("tcp/{}", agent.local_addr().unwrap()),
            )]),
        };
        let _file = there.leave(&runtime).unwrap();
        assert!(matches!(choose_unnamed(&runtime, None).unwrap(), Place::Here(chosen) if chosen == there));
        for by_variable in [false, true] {
            let error = choose_unnamed(&runtime, cluster(by_variable)).unwrap_err();
            let both = format!("choose with --swarm hover or -f {}", inventory.path.display());
            assert!(error.exit_code() == 2 && error.to_string().ends_with(&both), "{error}");
            assert_eq!(error.to_string().contains("SKEIN_CLUSTER"), by_variable, "{error}");
        }
        close(agent);
        let chosen = choose_unnamed(&runtime, cluster(true)).unwrap();
        assert!(matches!(chosen, Place::Cluster(_)), "the swarm of this PC has ended");
    }

    #[test]
    fn the_teams_of_a_cluster_are_chosen_by_number() {
        let folder = tempfile::tempdir().unwrap();
        fleet(folder.path(), &format!("security = 'none'\n{TEAMS}")).unwrap();
        let args = SwarmArgs { swarm: None, file: Some(folder.path().join("cluster.toml")) };
        let teams = |numbers: &[u16]| {
            let teams: Vec<_> = numbers.iter().map(|number| TeamId::new(*number).unwrap()).collect();
            let reaches =
                args.choose().unwrap().reach_teams(Role::Operator, &teams).map_err(|error| error.to_string())?;
            Ok::<_, String>(reaches.iter().map(|reach| (reach.title(), reach.agents.len())).collect::<Vec<_>>())
        };
        assert_eq!(teams(&[]).unwrap().len(), 3);
        assert_eq!(teams(&[2]).unwrap(), [("team 2 of fleet lab".to_owned(), 3)]);
        assert_eq!(teams(&[1, 4]).unwrap_err(), "fleet lab has teams 1 to 3, not 4");
        let alone = lab(folder.path(), 2, "security = 'none'");
        assert_eq!(teams(&[]).unwrap()[0].1, alone.nodes.len());
        assert_eq!(teams(&[1]).unwrap_err(), "--teams: lab is one swarm without teams");
    }

    #[test]
    fn the_scenario_is_read_only_on_demand() {
        let swarm = SwarmName::new("lab").unwrap();
        let missing = Reach::plain(swarm.clone(), BTreeMap::new(), Flown::File("none/scenario.toml".into()));
        assert!(missing.flown().unwrap_err().to_string().starts_with("none/scenario.toml: "));
        let (name, text) = Reach::plain(swarm, BTreeMap::new(), Flown::Text("x".to_owned())).flown().unwrap();
        assert_eq!((name.as_str(), text.as_str()), ("the scenario of lab", "x"));
    }
}
