//! Plans a flight before anything is begun: what is to be flown, where its files go, and that nothing stands against it.

use std::path::PathBuf;

use skein_agent::config::fleet;
use skein_common::scenario::{Described, Loaded, PlantKind, Scenario, Simulator};

use super::{FlyArgs, PlantArg};
use crate::prepare::{Prepared, prepare};
use skein_cluster::simulators;
use skein_lab::error::Error;
use skein_lab::external::Trial;
use skein_lab::out;
use skein_lab::scenario::{Ready, quoted};
use skein_lab::terminal::complain;

/// The plan of a swarm, or of all teams of a fleet.
#[derive(Clone, Debug)]
pub struct Plans {
    /// The scenario, or the fleet.
    pub described: Described,
    /// The folder for everything that is written; does not exist yet, or is empty.
    pub out: PathBuf,
    /// The flight of the swarm, or of each team.
    pub plans: Vec<Plan>,
}

/// A flight that may begin.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The scenario with the origin of its values.
    pub loaded: Loaded,
    /// The aircraft, rules and starts that it begins with.
    pub ready: Ready,
    /// HOST:PORT of each vehicle's X-Plane, in the order of ids; empty for other plants.
    pub xplanes: Vec<String>,
    /// The folder for everything that is written about this swarm or team; does not exist yet, or is empty.
    pub out: PathBuf,
    /// The command that flies the same flight again.
    pub again: String,
    /// The command that flies the scenario in virtual time with many seeds.
    pub study: String,
}

impl Plans {
    /// Reads and checks everything.
    ///
    /// # Errors
    /// Whatever stands against the flight.
    pub fn new(args: &FlyArgs) -> Result<Self, Error> {
        let described = as_named(args, args.scenario.read_any(sets(args)?)?)?;
        let refused = |why: String| Error::Refused(format!("{}: {why}", args.scenario.name()));
        fleet::check_size(described.all()).map_err(|why| refused(why.to_string()))?;
        let simulator = described.first().scenario.swarm.plant.spec().simulator;
        if described.is_fleet() && simulator == Simulator::Given {
            return Err(refused("a fleet flies in the built-in plant or in stand-ins".to_owned()));
        }
        let mut trial = Trial::default();
        let teams = described.all().iter();
        let ready = teams.map(|team| prepare(&args.scenario, &team.scenario, Some(&args.xplane), &mut trial));
        let ready = ready.collect::<Result<Vec<_>, _>>()?;
        let warnings = ready.first().into_iter().flat_map(|first| first.ready.rules.warnings.iter());
        warnings.for_each(|warning| complain(&format!("warning: {warning}")));
        let out = out::folder(args.out.as_deref(), &described.first().scenario.name)?;
        let plan = |(team, ready): (&Loaded, Prepared)| {
            let folder = team.scenario.team.map_or_else(|| out.clone(), |team| out.join(format!("team-{}", team.id)));
            Plan::new(args, team.clone(), ready, folder)
        };
        let plans = described.all().iter().zip(ready).map(plan).collect();
        Ok(Self { described, out, plans })
    }
}

impl Plan {
    fn new(args: &FlyArgs, loaded: Loaded, ready: Prepared, out: PathBuf) -> Self {
        let scenario = &loaded.scenario;
        let seed = scenario.team.map_or(scenario.seed, |team| team.seed);
        let Prepared { ready, xplanes } = ready;
        let set = |key: &str, value: String| (key.to_owned(), value);
        let duration = args.duration_s.map(|duration_s| set("duration_s", duration_s.to_string()));
        let plant = args.plant.map(|PlantArg(plant)| set("swarm.plant", plant.spec().name.to_owned()));
        let more: Vec<_> = plant.into_iter().chain(duration.clone()).collect();
        let mut again = args.scenario.command("fly", &more, Some(seed));
        if !args.xplane.is_empty() {
            let named: Vec<String> = args.xplane.iter().map(ToString::to_string).collect();
            again += &format!(" --xplane {}", quoted(&named.join(",")));
        }
        let built_in = PlantKind::Builtin;
        let built_in = (scenario.swarm.plant != built_in).then(|| set("swarm.plant", built_in.spec().name.to_owned()));
        let more: Vec<_> = built_in.into_iter().chain(duration).collect();
        let study = args.scenario.command("study", &more, None) + " --seeds 0..20";
        Self { ready, xplanes, out, again, study, loaded }
    }

    /// The scenario to be flown.
    pub fn scenario(&self) -> &Scenario {
        &self.loaded.scenario
    }
}

/// The same with the X-Planes that the command line names, so that the scenario as flown names them.
fn as_named(args: &FlyArgs, described: Described) -> Result<Described, Error> {
    if described.is_fleet() || args.xplane.is_empty() {
        return Ok(described);
    }
    let scenario = &described.first().scenario;
    let addresses = simulators::addresses(scenario, &args.xplane)?;
    let named = scenario.ids().zip(addresses).map(|(id, address)| format!("vehicle.{id}.xplane={address}"));
    args.scenario.read_any(sets(args)?.into_iter().chain(named).collect())
}

/// The options that are another spelling of a `--set`.
pub(super) fn sets(args: &FlyArgs) -> Result<Vec<String>, Error> {
    let plant = match (args.plant.map(|PlantArg(plant)| plant), args.xplane.is_empty()) {
        (Some(plant), false) if plant != PlantKind::Xplane => {
            return Err(Error::Refused("--xplane gives the address of X-Plane: use it with --plant xplane".to_owned()));
        }
        (None, false) => Some(PlantKind::Xplane),
        (plant, _) => plant,
    };
    let plant = plant.map(|plant| format!("swarm.plant={}", plant.spec().name));
    let seed = args.seed.map(|seed| format!("seed={seed}"));
    let duration = args.duration_s.map(|duration_s| format!("duration_s={duration_s}"));
    Ok([plant, seed, duration].into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;
    use skein_lab::scenario::ScenarioArgs;

    fn args(sets: &[&str]) -> FlyArgs {
        let sets = sets.iter().map(|set| (*set).to_owned()).collect();
        FlyArgs { scenario: ScenarioArgs { scenario: None, sets }, ..FlyArgs::default() }
    }

    #[test]
    fn options_are_another_spelling_of_sets() {
        let folder = tempfile::tempdir().unwrap();
        let args = FlyArgs {
            seed: Some(7),
            duration_s: Some(20.5),
            plant: Some(PlantArg(PlantKind::Standin)),
            out: Some(folder.path().join("run")),
            ..args(&["seed=1", "duration_s=9"])
        };
        let plan = Plans::new(&args).unwrap().plans.remove(0);
        let scenario = plan.scenario();
        assert_eq!((scenario.seed, scenario.duration_s, scenario.swarm.plant), (7, Some(20.5), PlantKind::Standin));
        assert_eq!(plan.ready.starts.len(), 4);
        assert!(plan.xplanes.is_empty() && plan.out.is_absolute());
        assert!(!folder.path().join("run").exists(), "a plan writes nothing");
        let sets = "--set seed=1 --set duration_s=9 --set swarm.plant";
        assert_eq!(plan.again, format!("skein fly {sets}=standin --set duration_s=20.5 --seed 7"));
        assert_eq!(plan.study, format!("skein study {sets}=builtin --set duration_s=20.5 --seeds 0..20"));
    }

    #[test]
    fn the_scenario_as_flown_names_the_x_planes_of_the_command_line() {
        let args = FlyArgs { xplane: vec!["127.0.0.2:50000".parse().unwrap()], ..args(&["swarm.vehicles=2"]) };
        let described = as_named(&args, args.scenario.read_any(sets(&args).unwrap()).unwrap()).unwrap();
        let text = described.first().to_toml();
        assert!(
            text.contains("xplane = \"127.0.0.2:50000\"") && text.contains("xplane = \"127.0.0.2:50010\""),
            "{text}"
        );
        assert_eq!(described.first().scenario.swarm.plant, PlantKind::Xplane);
    }

    #[test]
    fn an_x_plane_that_does_not_answer_stands_against_the_flight() {
        let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = silent.local_addr().unwrap().to_string();
        let folder = tempfile::tempdir().unwrap();
        let args = FlyArgs {
            xplane: vec![address.parse().unwrap()],
            out: Some(folder.path().join("run")),
            ..args(&["swarm.vehicles=1"])
        };
        let error = Plans::new(&args).unwrap_err();
        assert_eq!((error.to_string(), error.exit_code()), (simulators::ask(&address).unwrap_err(), 1));
        assert!(!folder.path().join("run").exists());
        let against = FlyArgs { plant: Some(PlantArg(PlantKind::Builtin)), ..args };
        assert_eq!(Plans::new(&against).unwrap_err().exit_code(), 2);
    }
}
