//! Eight hosts and the operator's PC on one bridge.
//!
//! ```text
//!   heli1 ... heli8     10.79.0.1 ... 10.79.0.8   each with sshd, the first seven with X-Plane's stand-in on their loopback
//!   pc8, pc9            10.79.0.208, 10.79.0.209  nothing but such a stand-in: vehicles 8 and 9 are flown from heli8
//!   operator            10.79.0.100               with an ssh key, the hosts' keys, and the program
//!   eye                 10.79.0.200               looks on
//!   stranger            10.79.0.201               nobody has invited it
//! ```

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use skein_tests::namespaces::{Namespaces, is_running, join, missing as no_namespaces, plug, pull, unplug};

use super::host::{Host, Wanted, keygen, private};
use super::ran::Ran;

/// The program as cargo has built it.
const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// How many hosts.
pub(super) const HOSTS: u8 = 8;
/// What the operator's PC is called.
const OPERATOR: &str = "operator";
const OPERATOR_ADDRESS: &str = "10.79.0.100";
/// Others on the bridge: without sshd.
const OTHERS: [(&str, &str); 4] =
    [("eye", "10.79.0.200"), ("stranger", "10.79.0.201"), ("pc8", "10.79.0.208"), ("pc9", "10.79.0.209")];
/// The bridge's namespace.
const BRIDGE: &str = "switch";
/// How the folders of these tests begin; the number of the test's process follows.
const MARK: &str = "cluster-";

pub(super) struct Lab {
    // In the order in which they go: no process outlives its network, no file its processes.
    pub(super) operator: Option<Host>,
    pub(super) hosts: Vec<Host>,
    others: Vec<Host>,
    namespaces: Namespaces,
    _folder: Folder,
}

/// What stands against such a lab here.
pub(super) fn missing() -> Option<String> {
    if let Some(missing) = no_namespaces() {
        return Some(missing);
    }
    let programs = ["/usr/sbin/sshd", "ssh", "ssh-keygen", "unshare", "nsenter", "nft"];
    let is_missing = |program: &&&str| Command::new(program).arg("--help").output().is_err();
    programs.iter().find(is_missing).map(|program| format!("no program `{program}`"))
}

impl Lab {
    /// Starts it. `environment` is what sshd sets for those who log in on a host, by the host's number.
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
            let wanted =
                Wanted { name: &name, address: &address, authorized: &authorized, environment: environment(id) };
            hosts.push(Host::start(&namespaces.name(&name), &folder.0.join(&name), &wanted));
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
            let wanted = Wanted { name, address, authorized: "", environment: &[] };
            Host::start(&namespaces.name(name), &folder.0.join(name), &wanted)
        });
        let mut lab = Self { operator: None, hosts, others: others.into(), namespaces, _folder: folder };
        lab.put_operator();
        lab
    }

    /// Puts the operator's PC onto the bridge: with the same disk, if there was one before.
    pub(super) fn put_operator(&mut self) {
        plug_in(&mut self.namespaces, OPERATOR, OPERATOR_ADDRESS);
        let wanted = Wanted { name: OPERATOR, address: OPERATOR_ADDRESS, authorized: "", environment: &[] };
        let operator = Host::start(&self.namespaces.name(OPERATOR), &self._folder.0.join(OPERATOR), &wanted);
        if !operator.path("/opt/skein").exists() {
            operator.put_program(Path::new(PROGRAM), "/opt/skein");
        }
        self.operator = Some(operator);
    }

    /// Takes it away as it is: whatever runs there does not come to its end.
    pub(super) fn take_operator(&mut self) {
        unplug(&self.namespaces.name(BRIDGE), &port(OPERATOR));
        self.operator = None;
        self.namespaces.remove(OPERATOR);
    }

    /// The operator's PC.
    pub(super) fn operator(&self) -> &Host {
        self.operator.as_ref().expect("the operator's PC is there")
    }

    /// The PC that looks on.
    pub(super) fn eye(&self) -> &Host {
        &self.others[0]
    }

    /// The PC that nobody has invited.
    pub(super) fn stranger(&self) -> &Host {
        &self.others[1]
    }

    /// Where the X-Plane of vehicle `id` runs.
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

    /// `skein` on the operator's PC with these words, as one types them.
    pub(super) fn skein(&self, words: &str, within_s: u64) -> Ran {
        let mut command = self.operator().command("skein");
        Ran::of(command.args(words.split(' ')), Duration::from_secs(within_s))
    }

    /// Cuts a host off, or puts it back.
    pub(super) fn cut(&self, id: u8, cut: bool) {
        let change = if cut { pull } else { plug };
        change(&self.namespaces.name(BRIDGE), &port(&self.host(id).name));
    }
}

/// A namespace for a host, joined to the bridge.
fn plug_in(namespaces: &mut Namespaces, name: &str, address: &str) {
    let own = namespaces.add(name);
    join(&own, "eth0", &format!("{address}/24"), &namespaces.name(BRIDGE), &port(name));
}

fn port(name: &str) -> String {
    format!("to-{name}")
}

/// A folder of a test's own, which goes with it. What killed tests have left goes at the next one's start.
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
