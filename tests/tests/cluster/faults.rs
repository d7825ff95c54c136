//! What stands against a flight, each fault on a host of its own, and what `skein check -f` says of it.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::fleet::{self, Fleet};
use super::host::keygen;
use super::lab::{HOSTS, Lab};
use super::say;

/// Where Debian and its kin have the library that fakes the time.
const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1";

/// Host, what is wrong there, the check that finds it, what it says, and what it has one do.
const FAULTS: [(u8, &str, &str, &str, &str); 8] = [
    (1, "the operator's key taken away", "ssh", "accepts none of your keys", "ssh-copy-id heli1"),
    (2, "cut off", "ssh", "", "check"),
    (3, "another host key", "ssh", "its host key has changed", "ssh-keygen -R heli3"),
    (4, "a firewall before its port", "port", "10.79.0.4:7450 is closed for this PC", "TCP port 7450"),
    (5, "a clock 2.5 s ahead", "clock", "+2", "timedatectl set-ntp true"),
    (6, "no X-Plane", "X-Plane", "", "X-Plane"),
    (7, "a full disk", "disk", "MiB free", "make room"),
    (8, "another release", "version", "is installed, this PC has", "skein cluster install"),
];

/// What sshd sets on the host whose clock is off.
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

/// What stands against this test here.
pub(super) fn missing() -> Option<String> {
    (!Path::new(FAKETIME).exists()).then(|| format!("no {FAKETIME}"))
}

/// Every fault at once, one check.
pub(super) fn are_found() {
    let lab = Lab::new("faults", environment);
    fleet::describe(&lab, HOSTS);
    let _fleet = Fleet::start(&lab, &[6]);
    let skein = |lab: &Lab, words: &str| lab.skein(&format!("{words} -f lab/cluster.toml --json"), 90);
    skein(&lab, "cluster keys").good();
    // It has room for the program, then nothing more.
    lab.host(7).sh("mkdir /root/.skein && mount -t tmpfs -o size=160m lab /root/.skein").good();
    let program = lab.operator().path("/opt/skein");
    let other = other_release(&program);
    let own = program.with_extension("own");
    fs::rename(&program, &own).unwrap();
    fs::rename(&other, &program).unwrap();
    skein(&lab, "cluster install --node 8").good();
    fs::rename(&own, &program).unwrap();
    skein(&lab, "cluster install --node 1 2 3 4 5 6 7").good();

    fs::write(lab.host(1).path("/opt/sshd/authorized"), "").unwrap();
    lab.cut(2, true);
    let known = lab.operator().path("/root/.ssh/known_hosts");
    let own = lab.host(3).known_host();
    let stranger = known.with_file_name("stranger");
    keygen(&stranger);
    let stranger = format!("{} {}", lab.host(3).address, fs::read_to_string(stranger.with_extension("pub")).unwrap());
    fs::write(&known, fs::read_to_string(&known).unwrap().replace(&own, &stranger)).unwrap();
    let rules = "add table inet lab; add chain inet lab in { type filter hook input priority 0; }; \
                 add rule inet lab in tcp dport 7450 drop";
    lab.host(4).sh(&format!("nft '{rules}'")).good();
    lab.host(7).sh("cat /dev/zero >/root/.skein/full 2>/dev/null; true").good();

    // Its connections from before are kept: it looks anew.
    let table = lab.skein("check -f lab/cluster.toml", 60);
    let check = skein(&lab, "check");
    assert_eq!(check.status, Some(1), "{check}");
    let lines = check.json();
    let lines = lines.as_array().unwrap();
    let text = |line: &Value, key: &str| line[key].as_str().unwrap_or_default().to_owned();
    let mut found = String::new();
    for (id, wrong, what, says, remedy) in FAULTS {
        let (node, host) = (format!("node {id}"), format!("heli{id}"));
        let is_it = |line: &&Value| {
            let place = text(line, "place");
            (place == node || place == host || place.ends_with(&format!("@{host}")))
                && text(line, "what") == what
                && text(line, "state") == "fault"
                && text(line, "found").contains(says)
                && text(line, "remedy").contains(remedy)
        };
        let line = lines.iter().find(is_it).unwrap_or_else(|| panic!("{host}, {wrong}: not found in {check}"));
        found += &format!("  {host}, {wrong}: {}: {} -> {}\n", what, text(line, "found"), text(line, "remedy"));
        // As people see it, however it is wrapped.
        assert!(table.out.contains(what) && table.out.contains("FAULT"), "{table}");
    }
    // Nothing is wrong where nothing is.
    for (id, what) in [(6, "clock"), (6, "disk"), (6, "ssh"), (8, "clock"), (8, "X-Plane"), (5, "disk"), (4, "version")]
    {
        let is_it = |line: &&Value| {
            [format!("node {id}"), format!("heli{id}")].contains(&text(line, "place")) && text(line, "what") == what
        };
        let line = lines.iter().find(is_it).unwrap_or_else(|| panic!("heli{id}: no {what} in {check}"));
        assert_eq!(text(line, "state"), "good", "{line}");
    }
    say(&format!("skein check -f, {:.1} s, with a fault on every host:\n{found}", check.took_s()));
}

/// The same program with some more bytes.
pub(super) fn other_release(program: &Path) -> PathBuf {
    let other = program.with_extension("other");
    let mut bytes = fs::read(program).unwrap();
    bytes.extend(b"\nanother release\n");
    fs::write(&other, bytes).unwrap();
    fs::set_permissions(&other, fs::metadata(program).unwrap().permissions()).unwrap();
    other
}
