//! Reads a cluster file, as strictly as a scenario and with the same reader.

use std::collections::BTreeMap;
use std::fs;
use std::net::{IpAddr, Ipv6Addr};
use std::path::{Path, PathBuf};

use skein_agent::config::fleet;
use skein_common::id::{SwarmName, VehicleName};
use skein_common::scenario::{
    Described, FileKind, Key, Kind, Literal, PlantKind, Scenario, ScenarioError, Source, Written,
};
use tracing_subscriber::EnvFilter;

use super::{Install, Inventory, Node, SecurityKind, ServiceKind, System};
use crate::ports::HostPort;
use skein_lab::error::Error;
use skein_lab::scenario::ScenarioArgs;

const fn key(path: &'static str, kind: Kind, default: Literal, about: &'static str) -> Key {
    Key::new(path, kind, default, about)
}

/// Makes the list of keys: those of the file, and the keys of a node for `defaults`, for the nodes of a team, and for a
/// node of a swarm or of a fleet.
macro_rules! keys {
    ([$($key:expr),* $(,)?] [$($name:literal, $kind:expr, $about:literal;)*]) => {
        &[
            $($key,)*
            $(key(concat!("defaults.", $name), $kind, Literal::Nothing, $about),)*
            $(key(concat!("team.N.", $name), $kind, Literal::Nothing, $about),)*
            $(key(concat!("node.N.", $name), $kind, Literal::Nothing, $about),)*
            $(key(concat!("node.\"T/N\".", $name), $kind, Literal::Nothing, $about),)*
        ]
    };
}

#[rustfmt::skip]
const KEYS: &[Key] = keys! {
    [
        key("swarm", Kind::Name, Literal::Required, "the name of the swarm, namespace of all its traffic"),
        key("scenario", Kind::Text, Literal::Required, "the scenario file, which determines what flies"),
        key("security", Kind::OneOf(&["tls", "none"]), Literal::Text("tls"), "how every link is secured: mutual TLS and signed messages, or plain TCP"),
        key("files", Kind::Texts, Literal::Nothing, "files and folders elsewhere than beside the scenario that `install` may copy"),
        key("keys", Kind::Text, Literal::Text("keys"), "folder that `skein cluster keys` writes"),
    ]
    [
        "host", Kind::Text, "what `ssh` takes";
        "user", Kind::Text, "user who logs in there; default: according to ssh's own configuration";
        "system", Kind::OneOf(&["unix", "windows"]), "the system of its host: windows if the login shell is cmd.exe or PowerShell";
        "address", Kind::Text, "where peers reach it: an IP address or a name; default: the host, if that is an IP address";
        "plant", Kind::OneOf(PlantKind::NAMES), "the plant that it flies; default: that of the scenario";
        "xplane", Kind::Text, "HOST[:PORT] of its simulator as seen from its host";
        "install", Kind::OneOf(&["ssh", "manual"]), "manual: a folder to carry there";
        "binary", Kind::Text, "the program for its platform, if it is not the program that runs here";
        "folder", Kind::Text, "folder on its host, below the home folder unless absolute";
        "service", Kind::OneOf(&["auto", "systemd", "own"]), "service that restarts the agent; auto: systemd where it is available, else Skein's own supervisor";
        "log", Kind::Text, "log filter of its agent, in the syntax of RUST_LOG";
    ]
};

impl Inventory {
    /// Reads a cluster file and its scenario, in which it sets the name of the swarm.
    ///
    /// # Errors
    /// If a file cannot be read or is wrong: the first fault found.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let name = path.display().to_string();
        let text = fs::read_to_string(path).map_err(|error| {
            Error::Refused(format!(
                "{name}: {error}; name a cluster file with -f CLUSTER.toml or {}",
                super::find::VARIABLE
            ))
        })?;
        let path = std::path::absolute(path).map_err(|error| Error::Refused(format!("{name}: {error}")))?;
        let source = Source { name: &name, text: &text };
        let here = |fault: ScenarioError| Error::Scenario { fault: fault.into(), text: text.clone() };
        if toml::from_str::<toml::Table>(&text).is_ok_and(|table| table.is_empty()) {
            let help = "it has `swarm`, `scenario` and a table `[node.N]` with `host` and `address` for each vehicle";
            let empty = Written::read(&source, FileKind::Cluster, &[]).map_err(here)?;
            return Err(here(empty.fault("", "this cluster file is empty", Some(help.to_owned()))));
        }
        let written = Written::read(&source, FileKind::Cluster, KEYS).map_err(here)?;
        let bad = |key: &str, message: String, help: Option<String>| here(written.fault(key, message, help));
        let value = |key: &str| written.text(key).unwrap_or_default();
        let swarm = SwarmName::new(value("swarm")).map_err(|error| bad("swarm", error.to_string(), None))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let scenario_path = folder.join(value("scenario"));
        let scenario_text = fs::read_to_string(&scenario_path).map_err(|error| {
            let message = format!("`scenario`: {}: {error}", scenario_path.display());
            bad("scenario", message, Some("the path is relative to this file's folder".to_owned()))
        })?;
        let args = ScenarioArgs { scenario: Some(scenario_path.clone()), sets: Vec::new() };
        let scenario = args.read_any(vec![format!("swarm.name={}", toml::Value::from(swarm.as_str()))])?;
        let teams = scenario.all();
        fleet::check_size(teams).map_err(|why| bad("scenario", format!("`scenario`: {why}"), None))?;
        check_vehicles(&written, &value("scenario"), &scenario).map_err(here)?;
        let vehicles = teams.iter().flat_map(|team| fleet::names(&team.scenario).map(move |id| (id, &team.scenario)));
        let nodes: BTreeMap<_, _> = vehicles
            .zip(fleet::ports(teams))
            .map(|((id, scenario), (_, port))| Ok((id, Reader { written: &written, id }.node(folder, scenario, port)?)))
            .collect::<Result<_, ScenarioError>>()
            .map_err(here)?;
        check_simulators_are_not_shared(&written, &nodes).map_err(here)?;
        Ok(Self {
            security: if value("security") == "none" { SecurityKind::None } else { SecurityKind::Tls },
            files: files(&written, folder).map_err(here)?,
            keys: folder.join(written.text("keys").unwrap_or("keys".to_owned())),
            path,
            swarm,
            scenario_path,
            scenario_text,
            scenario,
            nodes,
        })
    }
}

/// Paths of `files`: what may be copied to the nodes. All of them must exist.
fn files(written: &Written<'_>, folder: &Path) -> Result<Vec<PathBuf>, ScenarioError> {
    let named = written.get("files");
    let named = named.iter().filter_map(toml::Value::as_array).flatten().filter_map(toml::Value::as_str);
    let paths: Vec<PathBuf> = named.map(|path| folder.join(path)).collect();
    match paths.iter().find(|path| !path.exists()) {
        Some(path) => Err(written.fault("files", format!("`files`: {} does not exist", path.display()), None)),
        None => Ok(paths),
    }
}

/// Path of a node's table.
fn table_of(id: VehicleName) -> String {
    format!("node.{}", id.quoted())
}

/// Checks that the cluster file and the scenario have the same vehicles. A team's table is enough for its vehicles.
fn check_vehicles(written: &Written<'_>, name: &str, scenario: &Described) -> Result<(), ScenarioError> {
    let teams = scenario.all();
    let ids: Vec<VehicleName> = teams.iter().flat_map(|team| fleet::names(&team.scenario)).collect();
    let fly = match ids.as_slice() {
        [first, .., last] if scenario.is_fleet() => format!("{} teams, vehicles {first} to {last}", teams.len()),
        [first, .., last] => format!("vehicles {first} to {last}"),
        only => format!("vehicle {} only", only.first().map_or_else(String::new, ToString::to_string)),
    };
    for team in written.names("team") {
        let path = format!("team.{team}");
        let has_it = |scenario: &Scenario| scenario.team.is_some_and(|own| own.id.to_string() == team);
        if !teams.iter().any(|team| has_it(&team.scenario)) {
            return Err(written.fault(&path, format!("`{path}` has no vehicles: {name} flies {fly}"), None));
        }
    }
    for node in written.names("node") {
        if !ids.iter().any(|id| id.to_string() == node) {
            let path = if node.contains('/') { format!("node.\"{node}\"") } else { format!("node.{node}") };
            let message = format!("`{path}` has no vehicle: {name} flies {fly}");
            return Err(written.fault(&path, message, None));
        }
    }
    for id in ids {
        let path = table_of(id);
        let of_team = id.team.map(|team| format!("team.{team}"));
        if written.get(&path).is_some() || of_team.as_ref().is_some_and(|team| written.get(team).is_some()) {
            continue;
        }
        let message = format!("`{path}` is missing: {name} flies {fly}");
        let help = match of_team {
            Some(team) => {
                format!("add a table `[{team}]` for all vehicles of the team, or `[{path}]` for vehicle {id}")
            }
            None => format!("add a table `[{path}]` for vehicle {id}"),
        };
        return Err(written.fault("node", message, Some(help)));
    }
    Ok(())
}

/// Checks that no two vehicles share a simulator, which flies one aircraft only.
fn check_simulators_are_not_shared(
    written: &Written<'_>,
    nodes: &BTreeMap<VehicleName, Node>,
) -> Result<(), ScenarioError> {
    let mut taken = BTreeMap::new();
    for (id, node) in nodes {
        let Some(simulator) = node.xplane.as_ref().and_then(|text| text.parse::<HostPort>().ok()) else { continue };
        let is_local = simulator.host == "localhost"
            || simulator.host.trim_matches(['[', ']']).parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
        // Loopback differs on every host; a host without a name is known by its address.
        let whose = is_local.then(|| node.host.clone().unwrap_or(node.address.clone()));
        if let Some(other) = taken.insert((whose, simulator.host, simulator.port), *id) {
            let path = format!("{}.xplane", table_of(*id));
            let message = format!("`{path}`: vehicle {other} already flies that simulator");
            return Err(written.fault(&path, message, Some("give each vehicle its own X-Plane".to_owned())));
        }
    }
    Ok(())
}

/// Reads one node.
struct Reader<'a> {
    written: &'a Written<'a>,
    id: VehicleName,
}

impl Reader<'_> {
    /// The node, whose vehicle flies this scenario and whose agent has this port.
    fn node(&self, folder: &Path, scenario: &Scenario, port: u16) -> Result<Node, ScenarioError> {
        let install = match self.value("install").as_deref() {
            Some("manual") => Install::Manual,
            _ => Install::Ssh,
        };
        // An alias, a name or an address, which ssh and a shell cannot misread.
        let is_host = |text: &str| is_of(text, "._-:%");
        let expected = "a host that ssh accepts, such as heli1 or 10.0.0.11; the login name belongs in `user`";
        let host = self.checked("host", expected, is_host)?;
        let user = self.checked("user", "a user's name", |text| is_of(text, "._-@+\\"))?;
        if host.is_none() && install == Install::Ssh {
            let help = "`host = \"heli1\"`, as given to ssh; or `install = \"manual\"`, to carry a folder there";
            return Err(self.missing("host", "the host to install on is unknown", help));
        }
        for key in ["host", "address", "xplane"] {
            self.not_link_local(key)?;
        }
        let stated = self.checked("address", "an IP address or a name, without a port", is_address)?;
        let of_host = || host.clone().filter(|host| host.parse::<IpAddr>().is_ok());
        let Some(address) = stated.or_else(of_host) else {
            let help = "`address = \"10.0.0.11\"`: an address of that host that all other hosts can reach";
            return Err(self.missing("address", "peers cannot use the names of ssh's configuration", help));
        };
        let plant = self.value("plant").and_then(|name| PlantKind::named(&name)).unwrap_or(scenario.swarm.plant);
        let binary = self.value("binary").map(|binary| folder.join(binary));
        Ok(Node {
            id: self.id,
            host,
            user,
            system: match self.value("system").as_deref() {
                Some("windows") => System::Windows,
                _ => System::Unix,
            },
            address,
            port,
            plant,
            xplane: self.xplane(plant, scenario)?,
            install,
            binary,
            folder: self
                .checked("folder", "a path of letters, digits, '.', '-', '_' and '/', without `..`", is_folder)?
                .unwrap_or(".skein".to_owned()),
            service: match self.value("service").as_deref() {
                Some("systemd") => ServiceKind::Systemd,
                Some("own") => ServiceKind::Own,
                _ => ServiceKind::Auto,
            },
            log: self.checked("log", "a filter in the syntax of RUST_LOG, such as info,skein_agent=debug", is_log)?,
        })
    }

    /// Address of the node's simulator, if its plant has one: from the cluster file, else from the scenario.
    fn xplane(&self, plant: PlantKind, scenario: &Scenario) -> Result<Option<String>, ScenarioError> {
        let expected = "HOST[:PORT] of a simulator";
        let stated =
            self.checked("xplane", expected, |text| !text.starts_with('-') && text.parse::<HostPort>().is_ok())?;
        if plant.spec().has_address() {
            return Ok(stated.or_else(|| scenario.vehicle(self.id.vehicle)?.xplane.clone()));
        }
        let own = format!("{}.xplane", table_of(self.id));
        match self.written.get(&own) {
            Some(_) => Err(self.written.fault(
                &own,
                format!("`{own}` has no effect with plant = \"{}\"; delete it", plant.spec().name),
                None,
            )),
            None => Ok(None),
        }
    }

    /// Path of the key: the node's own key if it is given, else that of its team, else the key in `defaults`.
    fn path(&self, key: &str) -> String {
        let tables = [Some(table_of(self.id)), self.id.team.map(|team| format!("team.{team}"))];
        let paths = tables.into_iter().flatten().map(|table| format!("{table}.{key}"));
        let mut written = paths.filter(|path| self.written.get(path).is_some());
        written.next().unwrap_or_else(|| format!("defaults.{key}"))
    }

    fn value(&self, key: &str) -> Option<String> {
        self.written.text(&self.path(key))
    }

    fn checked(
        &self,
        key: &str,
        expected: &str,
        is_good: impl Fn(&str) -> bool,
    ) -> Result<Option<String>, ScenarioError> {
        match self.value(key) {
            Some(text) if !is_good(&text) => {
                let path = self.path(key);
                Err(self.written.fault(&path, format!("`{path}` is \"{text}\", but has to be {expected}"), None))
            }
            text => Ok(text),
        }
    }

    /// Refuses a link-local address where the interface of each PC that dials it would have to be known.
    fn not_link_local(&self, key: &str) -> Result<(), ScenarioError> {
        // ssh on this PC alone dials `host`, and takes the interface behind a `%`.
        let is_wrong = |text: &String| is_link_local(text) && !(key == "host" && text.contains('%'));
        let Some(text) = self.value(key).filter(is_wrong) else { return Ok(()) };
        let path = self.path(key);
        let why = "a link-local address, which each PC can dial only over an interface that it names itself";
        let help = "give an address that all nodes reach, such as 10.0.0.11 or fd00::11; `ip address` on the host lists its \
                    addresses";
        Err(self.written.fault(&path, format!("`{path}` is \"{text}\", {why}"), Some(help.to_owned())))
    }

    fn missing(&self, key: &str, why: &str, help: &str) -> ScenarioError {
        let path = format!("{}.{key}", table_of(self.id));
        self.written.fault(&path, format!("`{path}` is missing: {why}"), Some(help.to_owned()))
    }
}

/// Whether the text has only letters, digits and the characters in `others`, and does not start like an option.
fn is_of(text: &str, others: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || others.contains(c);
    (1..=253).contains(&text.len()) && !text.starts_with('-') && text.chars().all(good)
}

/// Whether it is a link-local address of IPv6, with or without a port or an interface.
fn is_link_local(text: &str) -> bool {
    let inside = text.strip_prefix('[').map_or(text, |rest| rest.split(']').next().unwrap_or(rest));
    let address = inside.split('%').next().unwrap_or(inside);
    address.parse::<Ipv6Addr>().is_ok_and(|address| address.is_unicast_link_local())
}

/// Whether it is an address of one computer, or a name that a certificate can contain.
fn is_address(text: &str) -> bool {
    match text.parse::<IpAddr>() {
        Ok(ip) => !ip.is_unspecified() && !ip.is_multicast(),
        // A text of digits and dots is a mistyped address.
        Err(_) => {
            let label = |label: &str| (1..=63).contains(&label.len()) && is_of(label, "-_") && !label.ends_with('-');
            text.len() <= 253 && text.split('.').all(label) && text.chars().any(|c| c.is_ascii_alphabetic())
        }
    }
}

fn is_folder(text: &str) -> bool {
    let names: PathBuf = text.into();
    is_of(text, "._-/")
        && names.components().all(|part| !matches!(part, std::path::Component::ParentDir))
        && names.file_name().is_some()
}

fn is_log(text: &str) -> bool {
    EnvFilter::builder().parse(text).is_ok()
}
