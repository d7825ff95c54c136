//! Putting a swarm onto this PC: ports, files, processes.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use skein_agent::config::fleet;
use skein_common::frame::{Origin, PositionNed};
use skein_common::id::{SwarmName, VehicleId, VehicleName};
use skein_common::scenario::{Described, Scenario, Simulator};
use skein_core::helicopter::Start;

use super::children::{Children, ProcessRole};
use super::plan::Plan;
use skein_cluster::endpoints::{self, Endpoints, EndpointsFile};
use skein_cluster::ports;
use skein_lab::error::Error;
use skein_lab::out::{self, Claim};

fn failed(what: &str, error: io::Error) -> Error {
    Error::Failed(format!("{what}: {error}"))
}

/// Finds ports for all agents, and writes the folder's scenario and the file by which other commands find the agents. Returns where the
/// agents listen, that file, and the claim that keeps other commands from the folder.
///
/// # Errors
/// If a swarm of this name flies here already (nothing is written then), or a file or port cannot be had.
pub fn prepare_site(described: &Described, out: &Path) -> Result<(Endpoints, EndpointsFile, Claim), Error> {
    let swarm = &described.first().scenario.swarm.name;
    refuse_a_second(swarm)?;
    let claim = out::claim(out)?;
    out::write(&out.join("scenario.toml"), described.to_toml())?;
    let agents = endpoints_of(described).map_err(|error| failed("no free ports", error))?;
    let endpoints = Endpoints { swarm: swarm.clone(), pid: std::process::id(), out: out.to_owned(), agents };
    // Before the agents: an agent that outlives this process can be found.
    let file = endpoints.leave(&endpoints::folder()).map_err(|error| {
        Error::Failed(format!("the runtime folder: {error}; name one of your own with `export XDG_RUNTIME_DIR=FOLDER`"))
    })?;
    Ok((endpoints, file, claim))
}

/// Starts a process for each vehicle of this plan, and one for its simulator where that is a stand-in.
///
/// # Errors
/// If a file, port or process cannot be had; what was started by then is ended.
pub fn launch(plan: &Plan, described: &Described, endpoints: &Endpoints) -> Result<Children, Error> {
    let scenario = plan.scenario();
    let folder = plan.out.join("agents");
    let mut aircraft = plan.ready.aircraft_files.iter();
    fs::create_dir_all(&folder).map_err(|error| failed(&plan.out.display().to_string(), error))?;
    if scenario.team.is_some() {
        // For commands about the team alone; its agents read the fleet's file.
        out::write(&plan.out.join("scenario.toml"), plan.loaded.to_toml())?;
    }
    aircraft.try_for_each(|(name, text)| out::write(&aircraft_file(endpoints, name), text))?;
    let mut children = Children::default();
    let simulators = match scenario.swarm.plant.spec().simulator {
        Simulator::Launched { command } => start_standins(command, plan, endpoints, &folder, &mut children)
            .map_err(|error| failed("stand-ins", error))?,
        Simulator::Inside | Simulator::Given => plan.xplanes.clone(),
    };
    let scenario_file = if scenario.team.is_some() { "../../scenario.toml" } else { "../scenario.toml" };
    for (nth, name) in fleet::names(scenario).enumerate() {
        let id = name.vehicle;
        let file = agent_file(name, scenario_file, described, endpoints, simulators.get(nth));
        let path = folder.join(format!("{id}.toml"));
        out::write(&path, file)?;
        let arguments: [OsString; 6] =
            ["agent".into(), "--config".into(), path.into(), "--child".into(), "--inputs".into(), (&folder).into()];
        let started = children.start(ProcessRole::Agent, id, arguments.into(), &log(&folder, ProcessRole::Agent, id));
        started.map_err(|error| failed(&format!("agent {name}"), error))?;
    }
    Ok(children)
}

/// An aircraft's file stands beside the scenario as flown, where its agents look for it.
fn aircraft_file(endpoints: &Endpoints, name: &str) -> PathBuf {
    endpoints.out.join(format!("{name}.toml"))
}

/// The path of a process's log.
pub fn log(folder: &Path, role: ProcessRole, id: VehicleId) -> PathBuf {
    folder.join(match role {
        ProcessRole::Agent => format!("{id}.log"),
        ProcessRole::Standin => format!("{id}-standin.log"),
    })
}

fn refuse_a_second(swarm: &SwarmName) -> Result<(), Error> {
    let folder = endpoints::folder();
    match endpoints::read(&folder, swarm) {
        Ok(Some(there)) if there.any_agent_answers() => Err(Error::Refused(format!(
            "a swarm named {swarm} flies here already; land it with `skein order land --swarm {swarm}`, or give this one \
             another name with --set swarm.name=NAME"
        ))),
        // What is left of a swarm that is gone is written over.
        _ => Ok(()),
    }
}

/// An endpoint on the loopback for every agent.
fn endpoints_of(described: &Described) -> io::Result<BTreeMap<VehicleName, String>> {
    let names: Vec<_> = described.all().iter().flat_map(|team| fleet::names(&team.scenario)).collect();
    let ports = ports::tcp(names.len())?;
    Ok(names.into_iter().zip(ports).map(|(name, port)| (name, format!("tcp/127.0.0.1:{port}"))).collect())
}

/// The configuration file of an agent: it dials agents with lower names, so that every pair connects once.
fn agent_file(
    name: VehicleName,
    scenario: &str,
    described: &Described,
    endpoints: &Endpoints,
    simulator: Option<&String>,
) -> String {
    let agent = |name: VehicleName| endpoints.agents.get(&name).cloned();
    let id: toml::Value = match name.team {
        Some(_) => name.to_string().into(),
        None => i64::from(name.vehicle.get()).into(),
    };
    let listen = agent(name).into_iter().collect::<Vec<_>>().into();
    let dial = fleet::dialled(name, described.all()).filter_map(agent).collect::<Vec<_>>().into();
    let keys = [("scenario", scenario.into()), ("id", id), ("listen", listen), ("dial", dial)];
    let xplane = simulator.map(|simulator| ("xplane", simulator.as_str().into()));
    let keys = keys.into_iter().chain(xplane).map(|(key, value)| (key.to_owned(), value));
    toml::Table::from_iter(keys).to_string()
}

/// Starts a stand-in for every vehicle. Gives their addresses.
fn start_standins(
    command: &[&str],
    plan: &Plan,
    endpoints: &Endpoints,
    folder: &Path,
    children: &mut Children,
) -> io::Result<Vec<String>> {
    let scenario = plan.scenario();
    let first = ports::udp_row(scenario.swarm.vehicles)?;
    let origin = Origin::new(scenario.origin.geodetic());
    let mut addresses = Vec::new();
    for (vehicle, start) in scenario.vehicle.iter().zip(&plan.ready.starts) {
        let aircraft = aircraft_file(endpoints, &vehicle.aircraft);
        let options = standin_options(scenario, &origin, vehicle.id, start, first, &aircraft);
        let arguments = command.iter().map(OsString::from).chain(options).collect();
        children.start(ProcessRole::Standin, vehicle.id, arguments, &log(folder, ProcessRole::Standin, vehicle.id))?;
        let port = ports::simulator(first, vehicle.id).ok_or(io::ErrorKind::AddrNotAvailable)?;
        addresses.push(format!("127.0.0.1:{port}"));
    }
    Ok(addresses)
}

fn standin_options(
    scenario: &Scenario,
    origin: &Origin,
    id: VehicleId,
    start: &Start,
    first_port: u16,
    aircraft: &Path,
) -> Vec<OsString> {
    let (place, convergence) = origin.place(PositionNed::new(start.north_m, start.east_m, 0.0));
    let local_deg = |heading_rad: f64| convergence.heading_to_local(heading_rad).to_degrees().to_string();
    let world = &scenario.world;
    let options = [
        ("port", first_port.to_string()),
        ("id", id.to_string()),
        ("lat", place.latitude_deg().to_string()),
        ("lon", place.longitude_deg().to_string()),
        ("alt", scenario.origin.elevation_m.to_string()),
        ("heading", local_deg(start.heading_rad)),
        ("beacon", false.to_string()),
        ("seed", scenario.seed.to_string()),
        ("wind-m-s", world.wind_m_s.to_string()),
        ("wind-from-deg", local_deg(world.wind_from_deg.to_radians())),
        ("gust-w20-m-s", world.gust_w20_m_s.to_string()),
    ];
    let options = options.into_iter().flat_map(|(name, value)| [format!("--{name}").into(), value.into()]);
    let whole = [OsString::from("--until-unused"), "--aircraft".into(), aircraft.into()];
    whole.into_iter().chain(options).collect()
}

#[cfg(test)]
mod tests {
    use skein_common::math;

    use super::*;
    use skein_lab::scenario::ScenarioArgs;

    #[test]
    fn of_every_pair_one_dials_the_other() {
        let described = ScenarioArgs::default().read_any(Vec::new()).unwrap();
        let agents = endpoints_of(&described).unwrap();
        let swarm = SwarmName::new("x").unwrap();
        let endpoints = Endpoints { swarm, pid: 1, out: PathBuf::new(), agents: agents.clone() };
        let mut pairs = Vec::new();
        for id in fleet::names(&described.first().scenario) {
            let file = agent_file(id, "../scenario.toml", &described, &endpoints, None);
            let file: toml::Table = file.parse().unwrap();
            assert_eq!(file["listen"].as_array().unwrap()[0].as_str(), Some(agents[&id].as_str()));
            for dialled in file["dial"].as_array().unwrap() {
                let (other, _) = agents.iter().find(|(_, agent)| dialled.as_str() == Some(agent)).unwrap();
                pairs.push((other.vehicle.get(), id.vehicle.get()));
            }
        }
        pairs.sort_unstable();
        assert_eq!(pairs, [(1, 2), (1, 3), (1, 4), (2, 3), (2, 4), (3, 4)]);
    }

    #[test]
    fn a_stand_in_stands_where_the_vehicle_starts() {
        use clap::Parser;
        use skein_agent::plant::xplane::standin::StandinOptions;

        #[derive(Parser)]
        struct Cli {
            #[command(flatten)]
            options: StandinOptions,
        }
        let sets =
            ["seed=7", "world.wind_m_s=3", "world.wind_from_deg=-90", "origin.elevation_m=12"].map(str::to_owned);
        let scenario = ScenarioArgs::default().read(sets.into()).unwrap().scenario;
        let origin = Origin::new(scenario.origin.geodetic());
        let start = Start { north_m: -40.0, east_m: 30.0, heading_rad: -1.0 };
        let id = VehicleId::new(3).unwrap();
        let options = standin_options(&scenario, &origin, id, &start, 50_000, Path::new("a.toml"));
        let arguments = [OsString::from("standin")].into_iter().chain(options);
        let StandinOptions {
            port,
            lat_deg,
            lon_deg,
            alt_m,
            heading_deg,
            seed,
            wind_m_s,
            wind_from_deg,
            until_unused,
            beacon,
            ..
        } = Cli::try_parse_from(arguments).unwrap().options;
        assert_eq!((port, alt_m, seed, wind_m_s), (50_000, 12.0, 7, 3.0));
        assert!(until_unused && !beacon);
        let place = skein_common::frame::Geodetic::from_degrees(lat_deg, lon_deg, alt_m);
        // The stand-in's north is that of its place.
        let (offset, convergence) = origin.locate(&place);
        assert!((convergence.heading_from_local(heading_deg.to_radians()) + 1.0).abs() < 1e-9);
        let wind_from_rad = convergence.heading_from_local(wind_from_deg.to_radians());
        assert!((wind_from_rad.to_degrees() + 90.0).abs() < 1e-9);
        assert!(
            math::hypot(offset.north_m() + 40.0, offset.east_m() - 30.0) < 1e-4,
            "to a tenth of a millimetre: {offset:?}"
        );
    }
}
