//! Checks one host over ssh: login, clock, disk, platform, and for each of its nodes what is installed, what is
//! running, and whether its simulator answers.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::thread;

use skein_common::id::VehicleName;
use skein_common::scenario::Simulator;

use super::clock;
use super::ports::{AgentState, Calls};
use super::{LOGIN, Line};
use crate::clocks::CLOCK_S;
use crate::install::{ROOM, owner};
use crate::inventory::{Inventory, Node, System};
use crate::pack::pack;
use crate::program::Program;
use crate::protocol::{Answer, Ask, Facts, Installed};
use crate::remote::{Fault, Probed, Remote};
use crate::ssh::{Host, Ssh};
use skein_lab::error::Error;

/// Checks the hosts of one cluster.
pub(super) struct HostChecks<'a> {
    pub(super) inventory: &'a Inventory,
    pub(super) ssh: &'a Ssh,
    /// Name of the cluster file as the user gave it.
    pub(super) file: &'a str,
    /// The programs to install.
    pub(super) programs: &'a Programs,
}

/// Programs by their paths; without a path, this program.
pub(super) type Programs = BTreeMap<Option<PathBuf>, Result<Program, Error>>;

/// Reads every program that a node needs, once.
pub(super) fn programs(inventory: &Inventory) -> Programs {
    let mut programs = Programs::new();
    for node in inventory.nodes.values() {
        programs.entry(node.binary.clone()).or_insert_with_key(|path| Program::read(path.as_deref()));
    }
    programs
}

/// Results for one host.
#[derive(Default)]
pub(super) struct Asked {
    pub(super) lines: Vec<Line>,
    /// Results of its calls to every node's port.
    pub(super) calls: Option<Calls>,
    pub(super) agents: BTreeMap<VehicleName, AgentState>,
}

impl HostChecks<'_> {
    /// Runs all checks of one host.
    pub(super) fn host(&self, host: &Host, nodes: &[&Node]) -> Asked {
        let mut asked = Asked::default();
        let place = host.to_string();
        // A shared connection would hide a key that was removed, and a changed host key.
        self.ssh.forget(host);
        let login = self.ssh.run(host, "true", &Arc::default(), LOGIN);
        if let Err(sentence) = &login {
            let sentence = sentence.strip_prefix(&format!("{host}: ")).unwrap_or(sentence);
            asked.lines.push(Line::of_sentence(place, "ssh", sentence, &format!("`ssh {host} true` shows more")));
            asked.agents.extend(nodes.iter().map(|node| (node.id, AgentState::Unknown)));
            return asked;
        }
        asked.lines.push(Line::new(place.as_str(), "ssh", "login works"));
        if let Some(printed) = login.ok().map(|output| output.of_shell).filter(|printed| !printed.is_empty()) {
            let found =
                format!("the shell of this account prints \"{printed}\" around every answer, which is passed over");
            asked.lines.push(Line::new(place.as_str(), "shell", found));
        }
        asked.lines.extend(nodes.first().map(|node| self.clock(host, node)));
        for node in nodes {
            self.node(host, node, &mut asked);
        }
        let simulators = thread::scope(|scope| {
            let of_node = |node| scope.spawn(move || self.simulator(host, node));
            let asking: Vec<_> = nodes.iter().copied().map(of_node).collect();
            asking.into_iter().filter_map(|asking| asking.join().ok().flatten()).collect::<Vec<_>>()
        });
        asked.lines.extend(simulators);
        asked.calls = nodes.iter().find_map(|node| self.calls(host, node));
        asked
    }

    fn remote(&self) -> Remote<'_> {
        Remote { ssh: self.ssh, swarm: &self.inventory.swarm }
    }

    fn clock(&self, host: &Host, node: &Node) -> Line {
        let line = |found: String| Line::new(host.to_string(), "clock", found);
        match clock::measure(self.ssh, host, &clock::Dialogue::with(&self.remote(), node)) {
            Err(why) => line(why.strip_prefix(&format!("{host}: ")).unwrap_or(&why).to_owned()).unknown(),
            Ok(offset) => {
                let found = clock::to_text(offset);
                match offset.offset_s.abs() - offset.bound_s > CLOCK_S {
                    true => line(format!("{found} from this PC's; no flight depends on it, times in logs do")).warning(
                        match node.system {
                            System::Unix => format!(
                                "`ssh {host} sudo timedatectl set-ntp true`; or chrony, on a network without internet"
                            ),
                            System::Windows => format!("`ssh {host} w32tm /resync`, as its administrator"),
                        },
                    ),
                    false => line(found),
                }
            }
        }
    }

    /// Checks the platform, and what is installed.
    fn node(&self, host: &Host, node: &Node, asked: &mut Asked) {
        let line = |what, found: String| Line::of(node, what, found);
        let install = format!("`skein cluster install -f {}`", self.file);
        let program = match self.programs.get(&node.binary) {
            Some(Ok(program)) => program,
            why => {
                let why = why.and_then(|why| why.as_ref().err()).map(ToString::to_string).unwrap_or_default();
                return asked.lines.push(line("program", why).fault("name an existing file with `binary`"));
            }
        };
        match self.remote().probe(host, node, &program.release) {
            Err(why) => asked.lines.push(line("platform", why).fault(format!("`ssh {host} uname -sm` shows more"))),
            Ok(probed) => {
                asked.lines.extend(of_probe(host, node, program, &probed));
                if let Err(fault) = probed.folder.usable(program.bytes.len() as u64) {
                    asked.lines.push(Line::of_fault(node, "folder", &fault, "set `folder` to another"));
                }
            }
        }
        let facts = match self.remote().facts(host, node) {
            Ok(facts) => facts,
            Err(Fault::NotInstalled) => {
                asked.agents.insert(node.id, AgentState::DoesNot);
                return asked.lines.push(line("version", "nothing is installed".to_owned()).fault(install));
            }
            Err(Fault::Failed(why)) => return asked.lines.push(line("version", why).fault(install)),
        };
        asked.lines.extend(super::address::line(node, &facts.addresses, self.file));
        let agent = if facts.agent.is_some() { AgentState::Runs } else { AgentState::DoesNot };
        asked.agents.insert(node.id, agent);
        match pack(self.inventory, node.id) {
            Err(error) => {
                let remedy = "correct the scenario file";
                asked.lines.push(Line::of_fault(node, "configuration", &error.to_string(), remedy));
            }
            Ok(bundle) if owner::another(&facts, bundle.authority().as_deref()).is_some() => {
                let owner = facts.authority.clone().unwrap_or_default();
                let flies = if agent == AgentState::Runs { ", and it flies" } else { "" };
                let found = format!("it belongs to another authority, {owner}, than the keys of this PC{flies}");
                asked.lines.push(Line::of(node, "authority", found).fault(
                    "use the keys of that authority, or give this swarm another name or `folder`; once its operator has landed \
                     it, `skein cluster install --take-over` takes the node over",
                ));
            }
            Ok(bundle) => {
                let expected = Installed { release: program.release.clone(), bundle: bundle.id() };
                asked.lines.push(of_version(node, &facts, &expected, self.file));
            }
        }
    }

    fn simulator(&self, host: &Host, node: &Node) -> Option<Line> {
        let address = match (node.plant.spec().simulator, &node.xplane) {
            (Simulator::Inside, _) | (Simulator::Launched { .. }, None) => return None,
            (_, Some(address)) => address.clone(),
            (Simulator::Given, None) => "127.0.0.1".to_owned(),
        };
        match self.remote().ask(host, node, Ask::Simulator { address: address.clone() }) {
            Ok(Answer::Simulator(Ok(found))) => Some(Line::of(node, "X-Plane", found)),
            Ok(Answer::Simulator(Err(why))) => {
                let found = why.split("; ").next().unwrap_or_default();
                let remedy = format!(
                    "start X-Plane at {address}, as seen from {}, with a flight loaded, and let UDP through both ways; check `xplane`",
                    host.name
                );
                Some(Line::of(node, "X-Plane", found).fault(remedy))
            }
            _ => Some(Line::of(node, "X-Plane", "not asked, because nothing is installed").unknown()),
        }
    }

    fn calls(&self, host: &Host, node: &Node) -> Option<Calls> {
        let nodes = self.inventory.nodes.values();
        let endpoints = nodes.map(Node::host_port).collect();
        match self.remote().ask(host, node, Ask::Reach { endpoints }) {
            Ok(Answer::Reach(reached)) => {
                let reached = self.inventory.nodes.keys().copied().zip(reached).collect();
                Some(Calls { from: host.name.clone(), reached })
            }
            _ => None,
        }
    }
}

/// Makes the lines about a host's platform and disk.
fn of_probe(host: &Host, node: &Node, program: &Program, probed: &Probed) -> [Line; 2] {
    let glibc = probed.glibc.map(|(major, minor)| format!(", C library {major}.{minor}")).unwrap_or_default();
    let platform = match program.fits(&probed.platform, probed.glibc) {
        Ok(()) => Line::of(node, "platform", format!("{}{glibc}", probed.platform)),
        Err(why) => Line::of_fault(node, "platform", &why, "name another program with `binary`"),
    };
    let is_there = probed.sum.as_deref() == Some(program.sum.as_str());
    let needed = ROOM + if is_there { 0 } else { program.bytes.len() as u64 };
    let mebibytes = |bytes: u64| bytes >> 20;
    let free = format!("{} MiB free", mebibytes(probed.free_bytes));
    let disk = match probed.free_bytes < needed {
        true => Line::of(
            node,
            "disk",
            format!("{free}, {} MiB needed, in the file system of {}", mebibytes(needed), node.folder),
        )
        .fault(format!("`ssh {host} df -h` shows which disk is full: make room, or set `folder` to another")),
        false => Line::of(node, "disk", free),
    };
    [platform, disk]
}

/// Makes the line about what is installed and what is running.
pub(super) fn of_version(node: &Node, facts: &Facts, expected: &Installed, file: &str) -> Line {
    let line = |found: String| Line::of(node, "version", found);
    let install = format!("`skein cluster install -f {file}`");
    let Some(current) = &facts.current else { return line("nothing is installed".to_owned()).fault(install) };
    if current.release != expected.release {
        return line(format!("{} is installed, this PC has {}", current.release, expected.release)).fault(install);
    }
    if current.bundle != expected.bundle {
        return line("its configuration or keys differ from those on this PC".to_owned()).fault(install);
    }
    match &facts.agent {
        Some(agent) if agent.installed != *current => {
            line(format!("runs {}, but {} has been installed since", agent.installed.release, current.release))
                .fault(format!("`skein cluster down -f {file}`, then `skein cluster up -f {file}`"))
        }
        Some(agent) if agent.restarts > 0 => {
            let times = if agent.restarts == 1 { "once".to_owned() } else { format!("{} times", agent.restarts) };
            let found = format!("{}, runs, and was restarted {times}", current.release);
            line(found).warning(format!("`skein cluster logs -f {file}` shows why"))
        }
        Some(_) => line(format!("{}, runs", current.release)),
        None => line(format!("{}, does not run", current.release)),
    }
}
