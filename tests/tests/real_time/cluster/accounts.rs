//! Accounts and settings of ssh as people have them: shells that print, settings of a session, folders where nothing can be
//! written or run, a host that does not exist, and a second operator.

use std::fs;

use super::fleet;
use super::host::{Host, private};
use super::lab::Lab;

/// What a startup file of the account's shell does, and a part of what `check` shows of it.
const SHELLS: [(&str, &str); 4] = [
    (r"printf '\033]0;heli\007'", "heli"),
    ("printf '{'; echo tired >&2", "{"),
    ("echo welcome; trap 'echo bye; echo late >&2; exit 3' EXIT", "bye"),
    ("echo skein platform Linux none", "skein platform Linux none"),
];

/// Settings of ssh that belong to a session of a person.
const SETTINGS: [&str; 13] = [
    "RemoteCommand echo no",
    "RemoteCommand none\n  RequestTTY force",
    "RequestTTY yes",
    "LocalForward 8099 127.0.0.1:1\n  ExitOnForwardFailure yes",
    "LocalForward 8099 127.0.0.1:1",
    "RemoteForward 8098 127.0.0.1:1",
    "DynamicForward 8099",
    "StdinNull yes",
    "ForkAfterAuthentication yes",
    "SessionType none",
    "SessionType subsystem",
    "PermitLocalCommand yes\n  LocalCommand touch /root/ran; echo no",
    "LogLevel QUIET\n  IgnoreUnknown UseKeychain\n  UseKeychain yes\n  ForwardX11 yes\n  ForwardAgent yes\n  ControlMaster yes",
];

/// Writes a swarm of two vehicles under the built-in model; `keys` is the folder of the operator's keys.
fn describe(lab: &Lab, file: &str, keys: &str, second: &str) {
    let folder = lab.operator().path("/root/lab");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("ring.toml"), fleet::scenario(2)).unwrap();
    let text = format!(
        "swarm = 'lab'\nscenario = 'ring.toml'\nkeys = '{keys}'\n[defaults]\nplant = 'builtin'\nservice = 'own'\n\
         [node.1]\nhost = 'heli1'\naddress = '10.79.0.1'\n[node.2]\nhost = '{second}'\naddress = '10.79.0.2'\n"
    );
    fs::write(folder.join(file), text).unwrap();
}

/// The lines of a check, each as `PLACE WHAT STATE FOUND REMEDY`.
fn check(lab: &Lab) -> Vec<String> {
    let checked = lab.skein("check -f lab/cluster.toml --json", 90).json();
    let text = |value: &serde_json::Value| value.as_str().unwrap_or_default().to_owned();
    let line =
        |line: &serde_json::Value| ["place", "what", "state", "found", "remedy"].map(|key| text(&line[key])).join(" ");
    checked.as_array().unwrap().iter().map(line).collect()
}

#[track_caller]
fn assert_line(lines: &[String], parts: &[&str]) {
    assert!(lines.iter().any(|line| parts.iter().all(|part| line.contains(part))), "{parts:?}: {lines:#?}");
}

pub(super) fn are_used() {
    let lab = Lab::new("accounts", |_| &[]);
    describe(&lab, "cluster.toml", "keys", "heli2");
    lab.skein("cluster keys -f lab/cluster.toml", 30).succeeded();
    for (does, shown) in SHELLS {
        fs::write(lab.host(1).path("/root/.bashrc"), format!("{does}\n")).unwrap();
        lab.skein("cluster install -f lab/cluster.toml", 90).succeeded();
        let lines = check(&lab);
        assert_line(&lines, &["heli1 shell good", shown]);
        assert!(!lines.iter().any(|line| line.contains(" fault ")), "{does}: {lines:#?}");
        lab.skein("cluster logs --file lab/cluster.toml 1", 30).succeeded();
    }
    // It limits the account's files.
    fs::write(lab.host(1).path("/root/.bashrc"), "ulimit -f 8\n").unwrap();
    assert_line(&check(&lab), &["node 1 folder fault", "may have 8192 bytes", "ulimit -f"]);
    fs::write(lab.host(1).path("/root/.bashrc"), "exit 4\n").unwrap();
    assert_line(&check(&lab), &["heli1 ssh fault", "ended with status 4 without running the command"]);
    fs::remove_file(lab.host(1).path("/root/.bashrc")).unwrap();

    let config = lab.operator().path("/root/.ssh/config");
    let own = fs::read_to_string(&config).unwrap();
    for setting in SETTINGS {
        private(&config, &format!("Host *\n  {setting}\n{own}"));
        let lines = check(&lab);
        assert_line(&lines, &["heli1 ssh good login works"]);
        assert!(!lines.iter().any(|line| line.contains(" fault ")), "{setting}: {lines:#?}");
        lab.skein("cluster install -f lab/cluster.toml", 90).succeeded();
        let listening = lab.operator().sh("ss -ltn").succeeded().out;
        assert!(!listening.contains(":8099"), "{setting}: the operator's port is in use: {listening}");
        assert!(!lab.operator().path("/root/ran").exists(), "{setting}");
    }
    private(&config, &own);
    folders_are_told(&lab);
    a_host_that_is_out_is_not_awaited(&lab);
}

/// Folders where nothing can be written or run.
fn folders_are_told(lab: &Lab) {
    lab.skein("cluster uninstall -f lab/cluster.toml --node 2", 60).succeeded();
    let host: &Host = lab.host(2);
    for (option, cause, remedy) in
        [("noexec", "Permission denied", "findmnt -T .skein"), ("ro", "Read-only file system", "set `folder`")]
    {
        host.sh(&format!("mkdir -p /root/.skein && mount -t tmpfs -o {option} lab /root/.skein")).succeeded();
        assert_line(&check(lab), &["node 2 folder fault", ".skein", "root", cause, remedy]);
        let installed = lab.skein("cluster install -f lab/cluster.toml --node 2", 60);
        assert_eq!(installed.status, Some(1), "{installed}");
        assert!(installed.err.contains(cause) && installed.err.contains(remedy), "{installed}");
        host.sh("umount /root/.skein && rmdir /root/.skein").succeeded();
    }
}

/// A host whose name is unknown.
fn a_host_that_is_out_is_not_awaited(lab: &Lab) {
    describe(lab, "cluster.toml", "keys", "nowhere");
    let up = lab.skein("cluster up -f lab/cluster.toml --timeout 600", 100);
    assert_eq!(up.status, Some(1), "{up}");
    assert!(up.err.contains("node 2 is out: not waited for") && up.err.contains("this name is unknown"), "{up}");
    assert!(up.out.contains("1 of 2 vehicles of lab are ready"), "{up}");
    lab.skein("cluster down -f lab/cluster.toml --node 1", 120).succeeded();
}

pub(super) fn are_not_taken_over() {
    let lab = Lab::new("second", |_| &[]);
    describe(&lab, "cluster.toml", "keys", "heli2");
    describe(&lab, "other.toml", "other", "heli2");
    for file in ["cluster.toml", "other.toml"] {
        lab.skein(&format!("cluster keys -f lab/{file}"), 30).succeeded();
    }
    lab.skein("cluster install -f lab/cluster.toml", 90).succeeded();
    lab.skein("cluster up -f lab/cluster.toml", 90).succeeded();
    let agents = |lab: &Lab| [1, 2].map(|id| lab.host(id).processes(&["skein", "agent"]));
    let flying = agents(&lab);
    assert!(flying.iter().all(|agents| agents.len() == 1), "{flying:?}");
    let checked = lab.skein("check -f lab/other.toml", 60);
    assert_eq!(checked.status, Some(1), "{checked}");
    assert!(checked.out.contains("another authority") && checked.out.contains("take-over"), "{checked}");
    for (command, status) in [("install", 1), ("install --take-over", 2), ("install --rollback", 2), ("up", 2)] {
        let refused = lab.skein(&format!("cluster {command} -f lab/other.toml"), 90);
        assert_eq!(refused.status, Some(status), "{refused}");
        assert!(format!("{}{}", refused.out, refused.err).contains("another authority"), "{refused}");
        assert_eq!(agents(&lab), flying, "{command}");
    }
    // The swarm's own operator installs as before.
    lab.skein("cluster install -f lab/cluster.toml", 90).succeeded();
    assert_eq!(agents(&lab), flying);
    lab.skein("cluster down -f lab/cluster.toml", 120).succeeded();
    let refused = lab.skein("cluster install -f lab/other.toml", 90);
    assert_eq!(refused.status, Some(1), "{refused}");
    assert!(refused.err.contains("--take-over"), "{refused}");
    lab.skein("cluster install --take-over -f lab/other.toml", 90).succeeded();
    lab.skein("cluster up -f lab/other.toml", 90).succeeded();
    lab.skein("cluster down -f lab/other.toml", 120).succeeded();
}
