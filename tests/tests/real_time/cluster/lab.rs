//! The lab: eight hosts and the operator's PC on one bridge.
//!
//! ```text
//!   heli1 ... heli8     10.79.0.1 ... 10.79.0.8   each with sshd, the first seven with X-Plane's stand-in on their loopback
//!   pc8, pc9            10.79.0.208, 10.79.0.209  only such a stand-in: vehicles 8 and 9 are flown from heli8
//!   operator            10.79.0.100               with an ssh key, the hosts' keys, and the program
//!   eye                 10.79.0.200               runs the observer
//!   intruder            10.79.0.201               runs the intruders
//! ```

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use skein_tests::namespaces::{Namespaces, is_running, join, missing as no_namespaces, plug, pull, unplug};

use super::finished::Finished;
use super::host::{Host, HostSetup, keygen, private};

/// The program that cargo built, unless the environment variable `SKEIN_PROGRAM` names another one.
fn program() -> PathBuf {
    std::env::var_os("SKEIN_PROGRAM").map_or_else(|| env!("CARGO_BIN_EXE_skein-under-test").into(), PathBuf::from)
}

/// Number of hosts.
pub(super) const HOSTS: u8 = 8;
/// Name of the operator's PC.
const OPERATOR: &str = "operator";
const OPERATOR_ADDRESS: &str = "10.79.0.100";
/// Other PCs on the bridge, without sshd.
const OTHERS: [(&str, &str); 4] =
    [("eye", "10.79.0.200"), ("intruder", "10.79.0.201"), ("pc8", "10.79.0.208"), ("pc9", "10.79.0.209")];
/// The bridge's namespace.
const BRIDGE: &str = "switch";
/// Beginning of the names of these tests' folders; the process id of the test follows.
const MARK: &str = "cluster-";

pub(super) struct Lab {
    // The order in which they are dropped: no process outlives its network, and no file its processes.
    pub(super) operator: Option<Host>,
    pub(super) hosts: Vec<Host>,
    others: Vec<Host>,
    namespaces: Namespaces,
    _folder: Folder,
}

/// Reason why a lab cannot run here; `None` if it can.
pub(super) fn missing() -> Option<String> {
    if let Some(missing) = no_namespaces() {
        return Some(missing);
    }
    let programs = ["/usr/sbin/sshd", "ssh", "ssh-keygen", "unshare", "nsenter", "nft"];
    let is_missing = |program: &&&str| Command::new(program).arg("--help").output().is_err();
    programs.iter().find(is_missing).map(|program| format!("no program `{program}`"))
}

impl Lab {
    /// Starts the lab. `environment` gives the variables that sshd sets for logins on a host, by the host's number.
    pub(super) fn new(test: &str, environment: fn(u8) -> &'static [&'static str]) -> Self {
        let folder = Folder::new(test);
        let mut namespaces = Namespaces::new(&format!("cluster-{test}"));
        namespaces.add_bridge(BRIDGE);
        let home = folder.0.join("operator/root");
        let ssh = home.join(".ssh");
        fs::create_dir_all(&ssh).unwrap();
        keygen(&ssh.join("id_ed25519"));
        let authorized = fs::read_to_string(ssh.join("id_ed25519.pub")).unwrap();
        let mut hosts = Vec::new();
        for id in 1..=HOSTS {
            let (name, address) = (format!("heli{id}"), format!("10.79.0.{id}"));
            plug_in(&mut namespaces, &name, &address);
            let setup =
                HostSetup { name: &name, address: &address, authorized: &authorized, environment: environment(id) };
            hosts.push(Host::start(&namespaces.name(&name), &folder.0.join(&name), &setup));
        }
        let (mut config, mut known) = (String::new(), String::new());
        for host in &hosts {
            writeln!(config, "Host {}\n  HostName {}\n  IdentityFile ~/.ssh/id_ed25519", host.name, host.address)
                .unwrap();
            known += &host.known_host();
        }
        private(&ssh.join("config"), &config);
        private(&ssh.join("known_hosts"), &known);
        let others = OTHERS.map(|(name, address)| {
            plug_in(&mut namespaces, name, address);
            let setup = HostSetup { name, address, authorized: "", environment: &[] };
            Host::start(&namespaces.name(name), &folder.0.join(name), &setup)
        });
        let mut lab = Self { operator: None, hosts, others: others.into(), namespaces, _folder: folder };
        lab.put_operator();
        // On a busy PC an sshd needs seconds to start.
        let answers =
            |host: &Host| lab.operator().sh(&format!("ssh -o ConnectTimeout=20 {} true", host.name)).succeeded();
        lab.hosts.iter().for_each(|host| drop(answers(host)));
        lab
    }

    /// Connects the operator's PC to the bridge; it keeps the disk of an earlier one.
    pub(super) fn put_operator(&mut self) {
        plug_in(&mut self.namespaces, OPERATOR, OPERATOR_ADDRESS);
        let setup = HostSetup { name: OPERATOR, address: OPERATOR_ADDRESS, authorized: "", environment: &[] };
        let operator = Host::start(&self.namespaces.name(OPERATOR), &self._folder.0.join(OPERATOR), &setup);
        if !operator.path("/opt/skein").exists() {
            operator.put_program(&program(), "/opt/skein");
        }
        self.operator = Some(operator);
    }

    /// Removes the operator's PC at once, with its running programs.
    pub(super) fn take_operator(&mut self) {
        unplug(&self.namespaces.name(BRIDGE), &port(OPERATOR));
        self.operator = None;
        self.namespaces.remove(OPERATOR);
    }

    /// The operator's PC.
    pub(super) fn operator(&self) -> &Host {
        self.operator.as_ref().expect("the operator's PC is connected")
    }

    /// The PC of the observer.
    pub(super) fn eye(&self) -> &Host {
        &self.others[0]
    }

    /// The PC of the intruders.
    pub(super) fn intruder(&self) -> &Host {
        &self.others[1]
    }

    /// The host of the X-Plane of vehicle `id`.
    pub(super) fn pc(&self, id: u8) -> &Host {
        match id {
            8 => &self.others[2],
            9 => &self.others[3],
            _ => self.host(id),
        }
    }

    /// Host `id`.
    pub(super) fn host(&self, id: u8) -> &Host {
        &self.hosts[usize::from(id) - 1]
    }

    /// Runs `skein` on the operator's PC with these arguments, separated by spaces.
    pub(super) fn skein(&self, arguments: &str, within_s: u64) -> Finished {
        let mut command = self.operator().command("skein");
        Finished::of(command.args(arguments.split(' ')), Duration::from_secs(within_s))
    }

    /// Disconnects a host from the network, or connects it again.
    pub(super) fn cut(&self, id: u8, cut: bool) {
        let change = if cut { pull } else { plug };
        change(&self.namespaces.name(BRIDGE), &port(&self.host(id).name));
    }
}

/// Makes a namespace for a host and links it to the bridge.
fn plug_in(namespaces: &mut Namespaces, name: &str, address: &str) {
    let own = namespaces.add(name);
    join(&own, "eth0", &format!("{address}/24"), &namespaces.name(BRIDGE), &port(name));
}

fn port(name: &str) -> String {
    format!("to-{name}")
}

/// A folder of a test, removed when it is dropped. The next test removes the folders of killed tests.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let all = Path::new(env!("CARGO_TARGET_TMPDIR"));
        fs::create_dir_all(all).unwrap();
        for left in fs::read_dir(all).unwrap().flatten() {
            let name = left.file_name().to_string_lossy().into_owned();
            let owner = name.strip_prefix(MARK).and_then(|rest| rest.split('-').next());
            if owner.and_then(|owner| owner.parse().ok()).is_some_and(|owner| !is_running(owner)) {
                let _ = fs::remove_dir_all(left.path());
            }
        }
        let own = all.join(format!("{MARK}{}-{test}", std::process::id()));
        fs::create_dir(&own).unwrap();
        Self(own)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
