//! How to connect to a live swarm: on this PC, through the file that `fly` writes, or on a cluster.

mod secured;

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use skein_agent::link::Security;
use skein_agent::link::signature::{SigningKey, VerificationKey};
use skein_common::id::{SwarmName, TeamId, VehicleId};
use skein_common::topic::Branch;

use crate::endpoints::{self, Endpoints};
use crate::inventory::Inventory;
use crate::keys::Role;
use crate::keys::run::RunFile;
pub(crate) use secured::orders_key;
use skein_lab::error::Error;

/// Everything needed to connect to a swarm.
#[derive(Clone, Debug)]
pub struct Reach {
    /// The swarm's name.
    pub swarm: SwarmName,
    /// The part of the key space that belongs to the swarm: in a fleet, to one team.
    pub branch: Branch,
    /// Every agent's endpoint in Zenoh's notation, `tls/10.0.0.11:7447`.
    pub agents: BTreeMap<VehicleId, String>,
    /// How the links are secured, and with which role's certificate.
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
            Flown::File(path) => {
                let name = path.display().to_string();
                let text = fs::read_to_string(path).map_err(|error| Error::Refused(format!("{name}: {error}")))?;
                Ok((name, text))
            }
        }
    }
}

impl Reach {
    /// Makes a connection to the swarm on this PC that has this branch.
    pub fn here(there: &Endpoints, branch: Branch) -> Self {
        let own = there.agents.iter().filter(|(name, _)| name.team == branch.team());
        let agents = own.map(|(name, agent)| (name.vehicle, agent.clone())).collect();
        let flown = Flown::File(there.folder(branch).join("scenario.toml"));
        Self { branch, ..Self::plain(there.swarm.clone(), agents, flown) }
    }

    /// What messages call it: `swarm lab`, or in a fleet `team 3 of fleet lab`.
    pub fn title(&self) -> String {
        match self.branch.team() {
            Some(team) => format!("team {team} of fleet {}", self.swarm),
            None => format!("swarm {}", self.swarm),
        }
    }
}

/// Options that choose the swarm of a command.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct SwarmArgs {
    /// The swarm of this PC; not needed if only one flies here
    #[arg(long, global = true, value_name = "NAME", value_parser = |text: &str| SwarmName::new(text))]
    pub swarm: Option<SwarmName>,
    /// The file of the cluster that it flies on
    #[arg(short = 'f', long = "file", global = true, value_name = "CLUSTER.toml")]
    pub file: Option<PathBuf>,
}

impl SwarmArgs {
    /// Returns how to connect to the chosen swarm in this role.
    ///
    /// # Errors
    /// As [`Self::reach_teams`], or if it is a fleet of several teams.
    pub fn reach(&self, role: Role) -> Result<Reach, Error> {
        let mut reaches = self.reach_teams(role, &[])?;
        match (reaches.pop(), reaches.len()) {
            (Some(only), 0) => Ok(only),
            (last, others) => Err(Error::Refused(format!(
                "{} is a fleet of {} teams: choose one with --team N",
                last.map_or_else(String::new, |last| last.swarm.to_string()),
                others + 1
            ))),
        }
    }

    /// Returns how to connect to the chosen teams of the chosen swarm in this role; without `teams` to all of them, or to
    /// the one swarm that has no teams.
    ///
    /// # Errors
    /// If the swarm is not found, or several fly here and none is chosen, or the cluster file or its keys are wrong, or
    /// the fleet has no team of this number.
    pub fn reach_teams(&self, role: Role, teams: &[TeamId]) -> Result<Vec<Reach>, Error> {
        let mut reaches = match (&self.swarm, &self.file) {
            (Some(_), Some(_)) => {
                let why = "give either --swarm, for a swarm on this PC, or -f, for a cluster";
                return Err(Error::Refused(why.to_owned()));
            }
            (None, Some(file)) => Inventory::read(file)?.reaches(role)?,
            (swarm, None) => {
                let there = endpoints::find(&endpoints::folder(), swarm.as_ref())?;
                there.branches().into_iter().map(|branch| Reach::here(&there, branch)).collect()
            }
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inventory::tests::{TEAMS, fleet, lab};

    #[test]
    fn a_swarm_on_this_pc_and_a_cluster_cannot_both_be_chosen() {
        let both = SwarmArgs { swarm: SwarmName::new("lab").ok(), file: Some("cluster.toml".into()) };
        let error = both.reach(Role::Observer).unwrap_err();
        assert_eq!(error.to_string(), "give either --swarm, for a swarm on this PC, or -f, for a cluster");
        let missing = SwarmArgs { swarm: None, file: Some("no such/cluster.toml".into()) };
        let error = missing.reach(Role::Observer).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("no such/cluster.toml"), "{error}");
    }

    #[test]
    fn the_teams_of_a_cluster_are_chosen_by_number() {
        let folder = tempfile::tempdir().unwrap();
        fleet(folder.path(), &format!("security = 'none'\n{TEAMS}")).unwrap();
        let args = SwarmArgs { swarm: None, file: Some(folder.path().join("cluster.toml")) };
        let teams = |numbers: &[u16]| {
            let teams: Vec<_> = numbers.iter().map(|number| TeamId::new(*number).unwrap()).collect();
            let reaches = args.reach_teams(Role::Operator, &teams).map_err(|error| error.to_string())?;
            Ok::<_, String>(reaches.iter().map(|reach| (reach.title(), reach.agents.len())).collect::<Vec<_>>())
        };
        assert_eq!(teams(&[]).unwrap().len(), 3);
        assert_eq!(teams(&[2]).unwrap(), [("team 2 of fleet lab".to_owned(), 3)]);
        assert_eq!(teams(&[1, 4]).unwrap_err(), "fleet lab has teams 1 to 3, not 4");
        let error = args.reach(Role::Observer).unwrap_err().to_string();
        assert_eq!(error, "lab is a fleet of 3 teams: choose one with --team N");
        let alone = lab(folder.path(), 2, "security = 'none'");
        assert_eq!(args.reach(Role::Observer).unwrap().agents.len(), alone.nodes.len());
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
