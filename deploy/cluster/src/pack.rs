//! Makes the files of a node: configuration, scenario, aircraft, rules, keys. The same cluster gives the same bytes on any PC and
//! from any folder, so that a second `install` changes nothing.

use std::fs;
use std::path::{Path, PathBuf};

use skein_agent::config::fleet;
use skein_agent::link::signature::VerificationKey;
use skein_common::id::VehicleName;
use skein_common::scenario::{self, ModelKind, Scenario, Simulator, Source};
use skein_core::aircraft::Aircraft;
use skein_core::start::starts;
use toml::Value as Toml;

use crate::bundle::{Bundle, BundleFile, SCENARIO};
use crate::inventory::{Install, Inventory, Node, SecurityKind};
use crate::keys::folder::{AUTHORITY, Folder, NAMES, Names, ORDERS_PUBLIC, stem, vehicles_toml};
use crate::keys::{Role, accepted_pair};
use skein_lab::error::Error;
use skein_lab::scenario::aircraft_of;

/// The four axes; each has a file of rules.
const AXES: [&str; 4] = ["roll", "pitch", "heading", "collective"];
/// Key of the command of an external law.
const COMMAND: &str = "formation.external.command";

/// Makes all files of this node except the program.
///
/// # Errors
/// If agents cannot fly the scenario, one of its files cannot be read, or keys are missing or invalid.
pub fn pack(inventory: &Inventory, id: VehicleName) -> Result<Bundle, Error> {
    let node = inventory.nodes.get(&id);
    let node = node.ok_or_else(|| Error::Refused(format!("vehicle {id} is not in {}", inventory.path.display())))?;
    let mut bundle = Bundle::default();
    bundle.add_scenario(inventory)?;
    let security = match inventory.security {
        SecurityKind::Tls => bundle.add_keys(inventory, node)?,
        SecurityKind::None => String::new(),
    };
    bundle.add("agent.toml", agent_toml(inventory, node) + &security);
    bundle.add("cluster.toml", cluster_toml(inventory));
    Ok(bundle)
}

impl Bundle {
    fn add(&mut self, path: &str, content: impl Into<Vec<u8>>) {
        // Of the files that are added here only private keys are secret.
        let file = BundleFile { is_secret: path.ends_with(".key"), is_executable: false, content: content.into() };
        self.files.insert(path.to_owned(), file);
    }

    /// Adds the complete scenario, or that of the whole fleet, and the files that it names.
    fn add_scenario(&mut self, inventory: &Inventory) -> Result<(), Error> {
        let refused = |why: String| Error::Refused(format!("{}: {why}", inventory.scenario_path.display()));
        let from = inventory.scenario_folder();
        let sources = Sources::of(inventory);
        // Named without its folder, so that the origins in the complete file do not depend on where the bundle is made.
        let name = inventory.scenario_path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into());
        let load = |sets: &[String]| {
            let text = &inventory.scenario_text;
            scenario::load_any(&Source { name: &name, text }, sets)
                .map_err(|fault| Error::Scenario { fault: fault.into(), text: text.clone() })
        };
        let mut sets = vec![format!("swarm.name={}", Toml::from(inventory.swarm.as_str()))];
        let as_written = load(&sets)?;
        for (resolved, written) in inventory.scenario.all().iter().zip(as_written.all()) {
            let scenario = &resolved.scenario;
            let key =
                |key: &str| scenario.team.map_or_else(|| key.to_owned(), |team| format!("team.{}.{key}", team.id));
            skein_agent::config::check_live(scenario).map_err(|error| refused(error.to_string()))?;
            starts(scenario).map_err(|error| refused(error.to_string()))?;
            self.add_aircraft(inventory, scenario, &sources)?;
            if let scenario::Rules::Folder(rules) = &scenario.control.rules {
                skein_host::files::rules(&scenario.control.rules, from)
                    .map_err(|error| refused(format!("control.rules: {error}")))?;
                let folder = self.add_rules(rules, &sources).map_err(&refused)?;
                sets.push(format!("{}={}", key("control.rules"), Toml::from(folder)));
            }
            if let Some(command) = self.add_law(&written.scenario, from, &sources).map_err(&refused)? {
                sets.push(format!("{}={}", key(COMMAND), Toml::from(command)));
            }
        }
        self.add(SCENARIO, load(&sets)?.to_toml());
        Ok(())
    }

    /// Adds the files of the aircraft that this swarm or team flies.
    fn add_aircraft(&mut self, inventory: &Inventory, scenario: &Scenario, sources: &Sources) -> Result<(), Error> {
        let refused = |why: String| Error::Refused(format!("{}: {why}", inventory.scenario_path.display()));
        let from = inventory.scenario_folder();
        for (id, vehicle) in fleet::names(scenario).zip(&scenario.vehicle) {
            let name = &vehicle.aircraft;
            let (aircraft, text) = aircraft_of(vehicle, from, &inventory.scenario_path.display().to_string())?;
            let plant = inventory.nodes.get(&id).map(|node| node.plant.spec());
            let other = plant.filter(|plant| plant.command_for(scenario.plant.model).is_none());
            if let Some(other) = other {
                let why = format!("vehicle {id}: `plant.model` = \"point_mass\" needs the built-in plant");
                return Err(refused(format!("{why}, but its node has plant = \"{}\"", other.name)));
            }
            let needs_model = plant.is_some_and(|plant| plant.simulator == Simulator::Inside);
            if needs_model && scenario.plant.model == ModelKind::Helicopter && aircraft.helicopter.is_none() {
                return Err(refused(format!("vehicle {id}: only X-Plane can fly the aircraft \"{name}\"")));
            }
            // Shipped aircraft are part of the program.
            if !Aircraft::SHIPPED.iter().any(|(shipped, _)| shipped == name) {
                sources
                    .check(&from.join(format!("{name}.toml")))
                    .map_err(|why| refused(format!("vehicle {id}: {why}")))?;
                self.add(&format!("{name}.toml"), text);
            }
        }
        Ok(())
    }

    /// Adds the rules of the controller from this folder. Returns their folder in the bundle: teams may have other rules.
    fn add_rules(&mut self, rules: &Path, sources: &Sources) -> Result<String, String> {
        let mut files = Vec::new();
        for axis in AXES {
            let path = rules.join(format!("{axis}.fis"));
            sources.check(&path).map_err(|why| format!("control.rules: {why}"))?;
            files.push((axis, BundleFile { is_secret: false, is_executable: false, content: read(&path)? }));
        }
        // The first folder that is free or has the same files: teams with equal rules share one.
        let mut nth = 1;
        loop {
            let folder = if nth == 1 { "rules".to_owned() } else { format!("rules-{nth}") };
            let path = |axis: &str| format!("{folder}/{axis}.fis");
            if files.iter().all(|(axis, file)| self.files.get(&path(axis)).is_none_or(|there| there == file)) {
                self.files.extend(files.into_iter().map(|(axis, file)| (path(axis), file)));
                return Ok(folder);
            }
            nth += 1;
        }
    }

    /// Adds the files that the command of an external law names. Returns the command with the files' new paths, if
    /// there are any.
    fn add_law(&mut self, written: &Scenario, from: &Path, sources: &Sources) -> Result<Option<Vec<String>>, String> {
        let Some(mut command) = written.formation.external.command.clone() else { return Ok(None) };
        let mut found = false;
        for (nth, argument) in command.iter_mut().enumerate() {
            let path = from.join(&*argument);
            let is_program = nth == 0;
            // A program without a path is found through the node's `PATH`.
            let may_be_here = !is_program || Path::new(argument).components().count() > 1;
            if !may_be_here || Path::new(argument).is_absolute() || !path.is_file() {
                continue;
            }
            let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into());
            sources.check(&path).map_err(|why| format!("{COMMAND}: {why}"))?;
            let content = read(&path).map_err(|error| format!("{COMMAND}: {error}"))?;
            // Files with the same name from two folders get two paths.
            let places = (1..).map(|nth| if nth == 1 { format!("law/{name}") } else { format!("law/{nth}/{name}") });
            let file = BundleFile { is_secret: false, is_executable: is_program, content };
            let is_free = |place: &String| self.files.get(place).is_none_or(|there| *there == file);
            let Some(place) = { places }.find(is_free) else { continue };
            self.files.insert(place.clone(), file);
            *argument = place;
            found = true;
        }
        Ok(found.then_some(command))
    }

    /// Adds the node's certificate, and that of its observer, so that the swarm can be observed from the node. Returns the
    /// table `[security]` of its configuration.
    fn add_keys(&mut self, inventory: &Inventory, node: &Node) -> Result<String, Error> {
        let keys = Folder(inventory.keys.clone());
        keys.check_private()?;
        let (authority, names) = (keys.need(AUTHORITY)?, keys.need_names()?);
        let orders = keys.orders_key()?;
        let observer = Role::NodeObserver(node.id);
        for (role, place) in
            [(Role::Vehicle(node.id), "node".to_owned()), (observer, format!("keys/{}", stem(observer)))]
        {
            let (pair, _) = accepted_pair(inventory, &keys, role)?;
            self.add(&format!("{place}.pem"), pair.certificate);
            self.add(&format!("{place}.key"), pair.key);
        }
        self.add(&format!("keys/{AUTHORITY}"), authority.as_str());
        self.add("authority.pem", authority);
        self.add(&format!("keys/{ORDERS_PUBLIC}"), format!("{orders}\n"));
        self.add(&format!("keys/{NAMES}"), names.to_toml());
        Ok(security_toml(inventory, names, orders))
    }
}

/// The folders from which files may be copied to the nodes. A scenario may come from another person and must not be
/// able to copy any file it names.
struct Sources {
    /// Files below these folders may be copied, links resolved: the scenario's folder, and the paths in `files` of the
    /// cluster file.
    free: Vec<PathBuf>,
    /// The folder of keys, from which nothing is copied.
    keys: PathBuf,
    /// Path of the cluster file.
    file: PathBuf,
}

impl Sources {
    fn of(inventory: &Inventory) -> Self {
        let resolved = |path: &Path| fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let folder = inventory.scenario_folder();
        let free = inventory.files.iter().map(PathBuf::as_path).chain([folder]).map(resolved).collect();
        Self { free, keys: resolved(&inventory.keys), file: inventory.path.clone() }
    }

    /// Checks that this file may be copied, with links resolved.
    fn check(&self, path: &Path) -> Result<(), String> {
        let real = fs::canonicalize(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let is_below = |folder: &PathBuf| real.starts_with(folder);
        if is_below(&self.keys) {
            return Err(format!("{} is in the folder of keys, from which a scenario can copy nothing", real.display()));
        }
        if self.free.iter().any(is_below) {
            return Ok(());
        }
        Err(format!(
            "{} is not in the scenario's folder, and is not copied to the hosts; put it there, or permit the copy with `files = \
             [\"{}\"]` in {}",
            path.display(),
            real.display(),
            self.file.display()
        ))
    }
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// Makes the agent's configuration file.
fn agent_toml(inventory: &Inventory, node: &Node) -> String {
    let (swarm, plant) = (&inventory.swarm, node.plant.spec().name);
    let id = node.id.quoted();
    let listen = Toml::from(vec![node.endpoint(inventory.security)]);
    let dial = Toml::from(inventory.dialled_by(node.id));
    let mut text = format!(
        "# Node {} of {swarm}.\nscenario = \"scenario.toml\"\nid = {id}\nlisten = {listen}\ndial = {dial}\nplant = \"{plant}\"\n",
        node.id
    );
    if let Some(xplane) = &node.xplane {
        text += &format!("xplane = {}\n", Toml::from(xplane.as_str()));
    }
    text
}

fn security_toml(inventory: &Inventory, mut names: Names, orders: VerificationKey) -> String {
    names.retain(|id| inventory.nodes.contains_key(&id));
    format!(
        "\n[security]\nauthority = \"authority.pem\"\ncertificate = \"node.pem\"\nkey = \"node.key\"\norders = \"{orders}\"\n\
         observers = {}\noperator = \"{}\"\n\n[security.vehicles]\n{}",
        Toml::from(names.all_observers()),
        names.operator,
        vehicles_toml(&names.vehicles)
    )
}

/// Makes the cluster file for a node, with which `skein cluster status` works there. It has only the addresses of the
/// other nodes: a change at one node must not be a new configuration for all.
fn cluster_toml(inventory: &Inventory) -> String {
    let security = match inventory.security {
        SecurityKind::Tls => "tls",
        SecurityKind::None => "none",
    };
    let mut text = format!(
        "# To observe the swarm from here: skein cluster status -f cluster.toml\nswarm = \"{}\"\nscenario = \"scenario.toml\"\n\
         security = \"{security}\"\nkeys = \"keys\"\n",
        inventory.swarm
    );
    for (id, node) in &inventory.nodes {
        text += &format!("\n[node.{}]\n", id.quoted());
        let entries = [
            ("host", node.host.as_deref()),
            ("address", Some(node.address.as_str())),
            ("install", (node.install == Install::Manual).then_some("manual")),
        ];
        let line = |(name, value): (&str, Option<&str>)| Some(format!("{name} = {}\n", Toml::from(value?)));
        text.extend(entries.into_iter().filter_map(line));
    }
    text
}

#[cfg(test)]
mod tests;
