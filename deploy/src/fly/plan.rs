//! What is to be flown, where its files go, and that nothing stands against it: all of it before anything is begun.

use std::net::ToSocketAddrs;
use std::path::PathBuf;

use skein_agent::plant::xplane::wire;
use skein_common::id::VehicleId;
use skein_common::scenario::{Loaded, PlantKind, Scenario};

use super::{FlyArgs, PlantArg, ports};
use crate::error::Error;
use crate::out;
use crate::scenario::Ready;

/// A flight that may begin.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The scenario with the origin of its values.
    pub loaded: Loaded,
    /// What it begins with.
    pub ready: Ready,
    /// HOST:PORT of each vehicle's X-Plane, in the order of ids; empty for other plants.
    pub xplanes: Vec<String>,
    /// The folder for everything that is written; does not exist yet, or is empty.
    pub out: PathBuf,
}

impl Plan {
    /// Reads and checks everything.
    ///
    /// # Errors
    /// Whatever stands against the flight.
    pub fn new(args: &FlyArgs) -> Result<Self, Error> {
        let loaded = args.scenario.read(sets(args)?)?;
        let scenario = &loaded.scenario;
        let ready = args.scenario.ready_live(scenario)?;
        let xplanes = match scenario.swarm.plant {
            PlantKind::Xplane => xplanes(scenario, args.xplane.as_ref())?,
            PlantKind::Builtin | PlantKind::Standin => Vec::new(),
        };
        let out = out::folder(args.out.as_deref(), &scenario.name)?;
        Ok(Self { ready, xplanes, out, loaded })
    }

    /// What flies.
    pub fn scenario(&self) -> &Scenario {
        &self.loaded.scenario
    }
}

/// The options that are another spelling of a `--set`.
fn sets(args: &FlyArgs) -> Result<Vec<String>, Error> {
    let plant = match (args.plant, &args.xplane) {
        (Some(PlantArg::Builtin | PlantArg::Standin), Some(_)) => {
            return Err(Error::Refused("--xplane says where X-Plane is: it goes with --plant xplane".to_owned()));
        }
        (None, Some(_)) => Some(PlantArg::Xplane),
        (plant, _) => plant,
    };
    let plant = plant.map(|plant| format!("swarm.plant={}", plant.word()));
    let seed = args.seed.map(|seed| format!("seed={seed}"));
    let duration = args.duration.map(|duration_s| format!("duration_s={duration_s}"));
    Ok([plant, seed, duration].into_iter().flatten().collect())
}

/// Where each vehicle's X-Plane is: as the command says, else as the scenario says, else on this PC.
fn xplanes(scenario: &Scenario, first: Option<&HostPort>) -> Result<Vec<String>, Error> {
    let here = HostPort { host: "127.0.0.1".to_owned(), port: wire::PORT };
    let address = |id: VehicleId| match (first, scenario.vehicle(id).and_then(|vehicle| vehicle.xplane.clone())) {
        (None, Some(own)) => Ok(own),
        (first, _) => {
            let HostPort { host, port } = first.unwrap_or(&here);
            let own = ports::simulator(*port, id)
                .ok_or_else(|| Error::Refused(format!("--xplane: no port is left for vehicle {id}")))?;
            Ok(format!("{host}:{own}"))
        }
    };
    let addresses = scenario.ids().map(address).collect::<Result<Vec<_>, Error>>()?;
    for address in &addresses {
        address.to_socket_addrs().map_err(|error| Error::Refused(format!("X-Plane at {address}: {error}")))?;
    }
    Ok(addresses)
}

/// A host and a port of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HostPort {
    /// A name or an address.
    pub host: String,
    /// Of UDP.
    pub port: u16,
}

impl std::str::FromStr for HostPort {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let (host, port) = text.rsplit_once(':').unwrap_or((text, ""));
        let port = if port.is_empty() && !text.contains(':') { Ok(wire::PORT) } else { port.parse() };
        match port {
            Ok(port) if port > 0 && !host.is_empty() => Ok(Self { host: host.to_owned(), port }),
            _ => Err("has to be HOST:PORT".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::ScenarioArgs;

    fn args(sets: &[&str]) -> FlyArgs {
        let sets = sets.iter().map(|set| (*set).to_owned()).collect();
        FlyArgs { scenario: ScenarioArgs { scenario: None, sets }, ..FlyArgs::default() }
    }

    #[test]
    fn options_are_another_spelling_of_sets() {
        let folder = tempfile::tempdir().unwrap();
        let args = FlyArgs {
            seed: Some(7),
            duration: Some(20.5),
            plant: Some(PlantArg::Standin),
            out: Some(folder.path().join("run")),
            ..args(&["seed=1", "duration_s=9"])
        };
        let plan = Plan::new(&args).unwrap();
        let scenario = plan.scenario();
        assert_eq!((scenario.seed, scenario.duration_s, scenario.swarm.plant), (7, Some(20.5), PlantKind::Standin));
        assert_eq!(plan.ready.starts.len(), 4);
        assert!(plan.xplanes.is_empty() && plan.out.is_absolute());
        assert!(!folder.path().join("run").exists(), "a plan writes nothing");
    }

    #[test]
    fn every_vehicle_has_an_x_plane_of_its_own() {
        let to = |text: &str| Some(text.parse::<HostPort>().unwrap());
        let plan = Plan::new(&FlyArgs { xplane: to("127.0.0.2:50000"), ..args(&[]) }).unwrap();
        assert_eq!(plan.scenario().swarm.plant, PlantKind::Xplane);
        assert_eq!(plan.xplanes, ["127.0.0.2:50000", "127.0.0.2:50010", "127.0.0.2:50020", "127.0.0.2:50030"]);
        let own = args(&["swarm.plant=xplane", "vehicle.2.xplane=127.0.0.3:49000"]);
        assert_eq!(Plan::new(&own).unwrap().xplanes[..2], ["127.0.0.1:49000", "127.0.0.3:49000"]);
        let beyond = Plan::new(&FlyArgs { xplane: to("127.0.0.2:65530"), ..args(&[]) }).unwrap_err();
        assert_eq!(beyond.to_string(), "--xplane: no port is left for vehicle 2");
        assert!(Plan::new(&args(&["swarm.plant=xplane", "vehicle.2.xplane=no host:49000"])).is_err());
        let against = FlyArgs { xplane: to("heli"), plant: Some(PlantArg::Builtin), ..args(&[]) };
        assert_eq!(Plan::new(&against).unwrap_err().exit_code(), 2);
    }

    #[test]
    fn hosts_and_ports() {
        let parse = |text: &str| text.parse::<HostPort>().map(|parsed| (parsed.host, parsed.port)).ok();
        assert_eq!(parse("heli"), Some(("heli".to_owned(), 49_000)));
        assert_eq!(parse("10.0.0.7:49010"), Some(("10.0.0.7".to_owned(), 49_010)));
        for bad in ["", ":", ":1", "heli:", "heli:x", "heli:0", "heli:70000"] {
            assert_eq!(parse(bad), None, "{bad:?}");
        }
    }
}
