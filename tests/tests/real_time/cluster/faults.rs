//! Problems that prevent a flight, one on each host, and the report of `skein check -f` about them.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::fleet::{self, Fleet};
use super::host::keygen;
use super::lab::{HOSTS, Lab};
use super::print_line;

/// Path of the library that fakes the time, on Debian and its derivatives.
const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1";

/// Host, problem, the check that finds it, a part of its finding, a part of its advice.
const FAULTS: [(u8, &str, &str, &str, &str); 8] = [
    (1, "the operator's key removed", "ssh", "accepts none of your keys", "ssh-copy-id heli1"),
    (2, "disconnected", "ssh", "", "check"),
    (3, "another host key", "ssh", "its host key has changed", "ssh-keygen -R heli3"),
    (4, "a firewall closes its port", "port", "10.79.0.4:7450 is closed for this PC", "TCP port 7450"),
    (5, "a clock 2.5 s ahead", "clock", "+2", "timedatectl set-ntp true"),
    (6, "no X-Plane", "X-Plane", "", "X-Plane"),
    (7, "a full disk", "disk", "MiB free", "make room"),
    (8, "another release", "version", "is installed, this PC has", "skein cluster install"),
];

/// Environment that sshd sets on the host whose clock is wrong.
fn environment(id: u8) -> &'static [&'static str] {
    match id {
        5 => &[
            "LD_PRELOAD=/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1",
            "FAKETIME=+2.5s",
            "DONT_FAKE_MONOTONIC=1",
        ],
        _ => &[],
    }
}

/// Reason why this test cannot run here; `None` if it can.
pub(super) fn missing() -> Option<String> {
    (!Path::new(FAKETIME).exists()).then(|| format!("no {FAKETIME}"))
}

/// Makes all problems at once and runs one check.
pub(super) fn are_found() {
    let lab = Lab::new("faults", environment);
    fleet::describe(&lab, HOSTS);
    let _fleet = Fleet::start(&lab, (1..=HOSTS).filter(|id| *id != 6));
    let skein = |lab: &Lab, arguments: &str| lab.skein(&format!("{arguments} -f lab/cluster.toml --json"), 90);
    skein(&lab, "cluster keys").succeeded();
    // The disk has room for the program and no more.
    lab.host(7).sh("mkdir /root/.skein && mount -t tmpfs -o size=160m lab /root/.skein").succeeded();
    let program = lab.operator().path("/opt/skein");
    let other = other_release(&program);
    let own = program.with_extension("own");
    fs::rename(&program, &own).unwrap();
    fs::rename(&other, &program).unwrap();
    skein(&lab, "cluster install --node 8").succeeded();
    fs::rename(&own, &program).unwrap();
    skein(&lab, "cluster install --node 1 2 3 4 5 6 7").succeeded();

    fs::write(lab.host(1).path("/opt/sshd/authorized"), "").unwrap();
    lab.cut(2, true);
    let known = lab.operator().path("/root/.ssh/known_hosts");
    let own = lab.host(3).known_host();
    let other = known.with_file_name("other");
    keygen(&other);
    let other = format!("{} {}", lab.host(3).address, fs::read_to_string(other.with_extension("pub")).unwrap());
    fs::write(&known, fs::read_to_string(&known).unwrap().replace(&own, &other)).unwrap();
    let rules = "add table inet lab; add chain inet lab in { type filter hook input priority 0; }; \
                 add rule inet lab in tcp dport 7450 drop";
    lab.host(4).sh(&format!("nft '{rules}'")).succeeded();
    lab.host(7).sh("cat /dev/zero >/root/.skein/full 2>/dev/null; true").succeeded();

    // ssh keeps its connections: this call without JSON opens new ones.
    let table = lab.skein("check -f lab/cluster.toml", 60);
    let check = skein(&lab, "check");
    assert_eq!(check.status, Some(1), "{check}");
    let lines = check.json();
    let lines = lines.as_array().unwrap();
    let text = |line: &Value, key: &str| line[key].as_str().unwrap_or_default().to_owned();
    let mut found = String::new();
    for (id, problem, what, finding, remedy) in FAULTS {
        let (node, host) = (format!("node {id}"), format!("heli{id}"));
        let is_it = |line: &&Value| {
            let place = text(line, "place");
            (place == node || place == host || place.ends_with(&format!("@{host}")))
                && text(line, "what") == what
                && text(line, "state") == if what == "clock" { "warning" } else { "fault" }
                && text(line, "found").contains(finding)
                && text(line, "remedy").contains(remedy)
        };
        let line = lines.iter().find(is_it).unwrap_or_else(|| panic!("{host}, {problem}: not found in {check}"));
        found += &format!("  {host}, {problem}: {}: {} -> {}\n", what, text(line, "found"), text(line, "remedy"));
        // The table may be wrapped anywhere.
        assert!(table.out.contains(what) && table.out.contains("FAULT"), "{table}");
    }
    // Checks without a problem are good.
    for (id, what) in [(6, "clock"), (6, "disk"), (6, "ssh"), (8, "clock"), (8, "X-Plane"), (5, "disk"), (4, "version")]
    {
        let is_it = |line: &&Value| {
            [format!("node {id}"), format!("heli{id}")].contains(&text(line, "place")) && text(line, "what") == what
        };
        let line = lines.iter().find(is_it).unwrap_or_else(|| panic!("heli{id}: no {what} in {check}"));
        assert_eq!(text(line, "state"), "good", "{line}");
    }
    print_line(&format!("skein check -f, {:.1} s, with a fault on every host:\n{found}", check.took_s()));
}

/// The same program with additional bytes: another release.
pub(super) fn other_release(program: &Path) -> PathBuf {
    let other = program.with_extension("other");
    let mut bytes = fs::read(program).unwrap();
    bytes.extend(b"\nanother release\n");
    fs::write(&other, bytes).unwrap();
    fs::set_permissions(&other, fs::metadata(program).unwrap().permissions()).unwrap();
    other
}
