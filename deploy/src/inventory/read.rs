//! Reading it: as strict as the scenario, by the same reader.

use std::collections::BTreeMap;
use std::fs;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use skein_common::id::{SwarmName, VehicleId};
use skein_common::scenario::{FileKind, Key, Kind, Literal, Loaded, PlantKind, ScenarioError, Source, Written};
use tracing_subscriber::EnvFilter;

use super::{Install, Inventory, Node, SecurityKind, ServiceKind};
use crate::simulators::HostPort;
use skein_lab::error::Error;
use skein_lab::scenario::ScenarioArgs;

/// Agents listen from here on: the port is this and the id.
const BASE_PORT: u16 = 7446;

const fn key(path: &'static str, kind: Kind, default: Literal, about: &'static str) -> Key {
    Key::new(path, kind, default, about)
}

/// The keys of the file, and those of a node both for one and for all.
macro_rules! keys {
    ([$($key:expr),* $(,)?] [$($name:literal, $kind:expr, $about:literal;)*]) => {
        &[
            $($key,)*
            $(key(concat!("defaults.", $name), $kind, Literal::Nothing, $about),)*
            $(key(concat!("node.N.", $name), $kind, Literal::Nothing, $about),)*
        ]
    };
}

#[rustfmt::skip]
const KEYS: &[Key] = keys! {
    [
        key("swarm", Kind::Name, Literal::Required, "the name of the swarm, namespace of all its traffic"),
        key("scenario", Kind::Text, Literal::Required, "the scenario's file, which says what flies"),
        key("security", Kind::OneOf(&["tls", "none"]), Literal::Text("tls"), "of every link; none has to be asked for"),
        key("files", Kind::Texts, Literal::Nothing, "files and folders elsewhere than beside the scenario that `install` may copy"),
        key("keys", Kind::Text, Literal::Text("keys"), "folder that `skein cluster keys` writes"),
    ]
    [
        "host", Kind::Text, "what `ssh` takes";
        "user", Kind::Text, "who logs in there; else as ssh's own configuration says";
        "address", Kind::Text, "where peers reach it: an IP address or a name; the host, if that is an IP address";
        "plant", Kind::OneOf(&["builtin", "standin", "xplane"]), "what it flies; else what the scenario says";
        "xplane", Kind::Text, "HOST[:PORT] of its simulator as seen from its host";
        "install", Kind::OneOf(&["ssh", "manual"]), "manual: a folder to carry there";
        "binary", Kind::Text, "the program for its platform, if not the one that runs here";
        "folder", Kind::Text, "on its host, below the home folder unless absolute";
        "service", Kind::OneOf(&["auto", "systemd", "own"]), "who starts the agent again; auto: systemd where it runs";
        "log", Kind::Text, "what its agent logs, as RUST_LOG takes it";
    ]
};

impl Inventory {
    /// Reads a cluster's file and its scenario, which the cluster's name is put into.
    ///
    /// # Errors
    /// The first fault found in either, or a file that cannot be read.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let name = path.display().to_string();
        let text = fs::read_to_string(path).map_err(|error| {
            Error::Refused(format!("{name}: {error}; a cluster's file is named with -f CLUSTER.toml"))
        })?;
        let path = std::path::absolute(path).map_err(|error| Error::Refused(format!("{name}: {error}")))?;
        let of_scenario = |path: &Path, swarm: &SwarmName| {
            let args = ScenarioArgs { scenario: Some(path.to_owned()), sets: Vec::new() };
            args.read(vec![format!("swarm.name={}", toml::Value::from(swarm.as_str()))])
        };
        read(&path, &Source { name: &name, text: &text }, of_scenario).map_err(|fault| match fault {
            Fault::Here(fault) => Error::Scenario { fault, text },
            Fault::Scenario(error) => error,
        })
    }
}

/// Which of the two files is at fault.
enum Fault {
    Here(Box<ScenarioError>),
    Scenario(Error),
}

impl From<ScenarioError> for Fault {
    fn from(fault: ScenarioError) -> Self {
        Self::Here(Box::new(fault))
    }
}

fn read(
    path: &Path,
    source: &Source<'_>,
    of_scenario: impl FnOnce(&Path, &SwarmName) -> Result<Loaded, Error>,
) -> Result<Inventory, Fault> {
    if toml::from_str::<toml::Table>(source.text).is_ok_and(|table| table.is_empty()) {
        let help = "it has `swarm`, `scenario` and a table `[node.N]` with `host` and `address` for each vehicle";
        let empty = Written::read(source, FileKind::Cluster, &[])?;
        return Err(empty.fault("", "nothing stands in this cluster's file", Some(help.to_owned())).into());
    }
    let written = Written::read(source, FileKind::Cluster, KEYS)?;
    let text = |key: &str| written.text(key).unwrap_or_default();
    let swarm = SwarmName::new(text("swarm")).map_err(|error| written.fault("swarm", error.to_string(), None))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let scenario_path = folder.join(text("scenario"));
    let scenario_text = fs::read_to_string(&scenario_path).map_err(|error| {
        let message = format!("`scenario`: {}: {error}", scenario_path.display());
        written.fault("scenario", message, Some("it is looked for from this file's folder".to_owned()))
    })?;
    let scenario = of_scenario(&scenario_path, &swarm).map_err(Fault::Scenario)?;
    let ids = who(&written, &text("scenario"), &scenario)?;
    let of_node = |id| Ok((id, Reader { written: &written, id }.node(folder, &scenario)?));
    let nodes: BTreeMap<_, _> = ids.into_iter().map(of_node).collect::<Result<_, ScenarioError>>()?;
    alone_in_their_simulators(&written, &nodes)?;
    Ok(Inventory {
        security: if text("security") == "none" { SecurityKind::None } else { SecurityKind::Tls },
        files: files(&written, folder)?,
        keys: folder.join(written.text("keys").unwrap_or("keys".to_owned())),
        path: path.to_owned(),
        swarm,
        scenario_path,
        scenario_text,
        scenario,
        nodes,
    })
}

/// The files that are named as free to be copied, and that have to be there.
fn files(written: &Written<'_>, folder: &Path) -> Result<Vec<PathBuf>, ScenarioError> {
    let named = written.get("files");
    let named = named.iter().filter_map(toml::Value::as_array).flatten().filter_map(toml::Value::as_str);
    let paths: Vec<PathBuf> = named.map(|path| folder.join(path)).collect();
    match paths.iter().find(|path| !path.exists()) {
        Some(path) => Err(written.fault("files", format!("`files`: {} is not there", path.display()), None)),
        None => Ok(paths),
    }
}

/// The ids, which both files have to agree on.
fn who(written: &Written<'_>, name: &str, scenario: &Loaded) -> Result<Vec<VehicleId>, ScenarioError> {
    let fly = match scenario.scenario.swarm.vehicles {
        1 => "vehicle 1 only".to_owned(),
        vehicles => format!("vehicles 1 to {vehicles}"),
    };
    let ids: Vec<_> = scenario.scenario.ids().collect();
    for node in written.names("node") {
        if !ids.iter().any(|id| id.to_string() == node) {
            let message = format!("`node.{node}` has no vehicle: {name} flies {fly}");
            return Err(written.fault(&format!("node.{node}"), message, None));
        }
    }
    for id in &ids {
        let path = format!("node.{id}");
        if written.get(&path).is_none() {
            let message = format!("`{path}` is missing: {name} flies {fly}");
            return Err(written.fault("node", message, Some(format!("say where vehicle {id} is: `[{path}]`"))));
        }
    }
    Ok(ids)
}

/// One simulator flies one aircraft.
fn alone_in_their_simulators(written: &Written<'_>, nodes: &BTreeMap<VehicleId, Node>) -> Result<(), ScenarioError> {
    let mut taken = BTreeMap::new();
    for (id, node) in nodes {
        let Some(simulator) = node.xplane.as_ref().and_then(|text| text.parse::<HostPort>().ok()) else { continue };
        let is_local = simulator.host == "localhost"
            || simulator.host.trim_matches(['[', ']']).parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
        // Loopback is another one on every host, and where the host has no name it is known by its address.
        let whose = is_local.then(|| node.host.clone().unwrap_or(node.address.clone()));
        if let Some(other) = taken.insert((whose, simulator.host, simulator.port), *id) {
            let path = format!("node.{id}.xplane");
            let message = format!("`{path}`: that simulator is flown by vehicle {other} already");
            return Err(written.fault(&path, message, Some("each vehicle has an X-Plane of its own".to_owned())));
        }
    }
    Ok(())
}

/// Reads one node.
struct Reader<'a> {
    written: &'a Written<'a>,
    id: VehicleId,
}

impl Reader<'_> {
    fn node(&self, folder: &Path, scenario: &Loaded) -> Result<Node, ScenarioError> {
        let install = match self.word("install").as_deref() {
            Some("manual") => Install::Manual,
            _ => Install::Ssh,
        };
        let host =
            self.checked("host", "what ssh takes, such as heli1 or 10.0.0.11; who logs in is `user`", is_host)?;
        let user = self.checked("user", "a user's name", is_user)?;
        if host.is_none() && install == Install::Ssh {
            let help = "`host = \"heli1\"`, as ssh takes it; or `install = \"manual\"`, to carry a folder there";
            return Err(self.missing("host", "nobody knows where to install", help));
        }
        let address = match self.checked("address", "an IP address or a name, without a port", is_address)? {
            Some(address) => address,
            None => match host.as_deref().filter(|host| host.parse::<IpAddr>().is_ok()) {
                Some(host) => host.to_owned(),
                None => {
                    let help = "`address = \"10.0.0.11\"`: an address of that host that all others can reach";
                    return Err(self.missing("address", "peers do not know the names that ssh does", help));
                }
            },
        };
        let plant = match self.word("plant").as_deref() {
            Some("builtin") => PlantKind::Builtin,
            Some("standin") => PlantKind::Standin,
            Some("xplane") => PlantKind::Xplane,
            _ => scenario.scenario.swarm.plant,
        };
        let binary = self.word("binary").map(|binary| folder.join(binary));
        Ok(Node {
            id: self.id,
            host,
            user,
            address,
            port: BASE_PORT + u16::from(self.id.get()),
            plant,
            xplane: self.xplane(plant, scenario)?,
            install,
            binary,
            folder: self
                .checked("folder", "a path of letters, digits, '.', '-', '_' and '/', without `..`", is_folder)?
                .unwrap_or(".skein".to_owned()),
            service: match self.word("service").as_deref() {
                Some("systemd") => ServiceKind::Systemd,
                Some("own") => ServiceKind::Own,
                _ => ServiceKind::Auto,
            },
            log: self.checked("log", "what RUST_LOG takes, such as info,skein_agent=debug", is_log)?,
        })
    }

    /// Where its simulator is, for plants that have one: as the node says, as all say, as the scenario says.
    fn xplane(&self, plant: PlantKind, scenario: &Loaded) -> Result<Option<String>, ScenarioError> {
        let expected = "HOST[:PORT] of a simulator";
        let said =
            self.checked("xplane", expected, |text| !text.starts_with('-') && text.parse::<HostPort>().is_ok())?;
        if plant != PlantKind::Builtin {
            return Ok(said.or_else(|| scenario.scenario.vehicle(self.id)?.xplane.clone()));
        }
        let own = format!("node.{}.xplane", self.id);
        match self.written.get(&own) {
            Some(_) => Err(self.written.fault(&own, format!("`{own}` means nothing beside plant = \"builtin\""), None)),
            None => Ok(None),
        }
    }

    /// The key's path: the node's own, or else that for all.
    fn path(&self, key: &str) -> String {
        let own = format!("node.{}.{key}", self.id);
        if self.written.get(&own).is_some() { own } else { format!("defaults.{key}") }
    }

    fn word(&self, key: &str) -> Option<String> {
        self.written.text(&self.path(key))
    }

    fn checked(
        &self,
        key: &str,
        expected: &str,
        is_good: impl Fn(&str) -> bool,
    ) -> Result<Option<String>, ScenarioError> {
        match self.word(key) {
            Some(text) if !is_good(&text) => {
                let path = self.path(key);
                Err(self.written.fault(&path, format!("`{path}` is \"{text}\", but has to be {expected}"), None))
            }
            text => Ok(text),
        }
    }

    fn missing(&self, key: &str, why: &str, help: &str) -> ScenarioError {
        let path = format!("node.{}.{key}", self.id);
        self.written.fault(&path, format!("`{path}` is missing: {why}"), Some(help.to_owned()))
    }
}

/// Whether it has only letters, digits and these, and begins like no option.
fn is_of(text: &str, others: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || others.contains(c);
    (1..=253).contains(&text.len()) && !text.starts_with('-') && text.chars().all(good)
}

/// An alias, a name or an address: nothing that ssh or a shell would read as something else.
fn is_host(text: &str) -> bool {
    is_of(text, "._-:%")
}

fn is_user(text: &str) -> bool {
    is_of(text, "._-@+\\")
}

/// An address of one computer, or a name as certificates carry them.
fn is_address(text: &str) -> bool {
    match text.parse::<IpAddr>() {
        Ok(ip) => !ip.is_unspecified() && !ip.is_multicast(),
        // Numbers and dots alone are an address that was mistyped.
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
