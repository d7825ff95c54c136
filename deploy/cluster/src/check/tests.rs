//! Tests with a script in place of `ssh` and this PC as the host.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use super::ports::AgentState;
use super::*;
use crate::findings::State;
use crate::inventory::tests::lab;
use crate::keys::command as cluster_keys;
use crate::protocol::{Facts, Installed, RunningAgent};
use crate::ssh::tests::{fake, heli, write_script};
use skein_host::clock;

/// Results for a host on which the programs in `bin` replace the system's.
fn asked(script: &str, bin: &[(&str, &str)]) -> host::Asked {
    let folder = tempfile::tempdir().unwrap();
    for name in ["bin", "home"] {
        fs::create_dir(folder.path().join(name)).unwrap();
    }
    for (name, text) in bin {
        write_script(&folder.path().join("bin").join(name), text);
    }
    let ssh = fake(
        folder.path(),
        &format!("{script}\nexport HOME=\"$PWD/home\" PATH=\"$PWD/bin:$PATH\"; cd home; exec sh -c \"$command\""),
    );
    let inventory = lab(folder.path(), 1, "");
    let nodes: Vec<_> = inventory.nodes.values().collect();
    let programs = host::programs(&inventory);
    HostChecks { inventory: &inventory, ssh: &ssh, file: "lab.toml", programs: &programs }.host(&heli("heli1"), &nodes)
}

fn line(asked: &host::Asked, what: &str) -> Line {
    asked.lines.iter().find(|line| line.what == what).unwrap_or_else(|| panic!("{what}: {:?}", asked.lines)).clone()
}

#[test]
fn a_host_without_skein_lacks_only_the_installation() {
    let asked = asked("", &[]);
    for what in ["ssh", "clock", "platform", "disk"] {
        assert_eq!(line(&asked, what).state, State::Good, "{:?}", line(&asked, what));
    }
    let version = line(&asked, "version");
    assert_eq!((version.state, version.found.as_str()), (State::Fault, "nothing is installed"));
    assert_eq!(version.remedy.as_deref(), Some("`skein cluster install -f lab.toml`"));
    assert_eq!(asked.agents.values().copied().collect::<Vec<_>>(), [AgentState::DoesNot]);
    assert!(asked.calls.is_none());
}

#[test]
fn a_host_that_refuses_the_login_is_not_asked_further() {
    for (output, found, remedy) in [
        ("lab@heli1: Permission denied (publickey).", "accepts none of your keys", "`ssh-copy-id heli1`"),
        ("ssh: connect to host heli1 port 22: No route to host", "no route from this network", "both are connected"),
        ("Host key verification failed.", "its host key is not known on this PC", "`ssh heli1` once by hand"),
    ] {
        let asked = asked(&format!("echo '{output}' >&2; exit 255"), &[]);
        let [line] = asked.lines.as_slice() else { panic!("{:?}", asked.lines) };
        assert_eq!((line.place.as_str(), line.what, line.state), ("heli1", "ssh", State::Fault));
        assert!(line.found.starts_with(found) && line.remedy.as_ref().unwrap().contains(remedy), "{line:?}");
        assert_eq!(asked.agents.values().copied().collect::<Vec<_>>(), [AgentState::Unknown]);
    }
}

#[test]
fn a_host_that_hangs_is_given_up() {
    let from = clock::now();
    let asked = asked("sleep 60", &[]);
    let ssh = line(&asked, "ssh");
    assert_eq!((asked.lines.len(), ssh.state), (1, State::Fault));
    // The limit is exact, whatever else this PC does meanwhile; and nothing has waited for the host's answer.
    assert_eq!(ssh.found, format!("the command took longer than {:.0} s", LOGIN.as_secs_f64()));
    assert!(clock::now() - from < Duration::from_secs(60));
}

#[test]
fn a_wrong_clock_is_reported_with_its_sign() {
    let ahead = asked("", &[("date", "exec /bin/date -d '90 seconds' \"$@\"")]);
    let clock = line(&ahead, "clock");
    assert_eq!(clock.state, State::Warning, "agents fly by their own clocks");
    assert!(clock.found.starts_with("+1 min "), "{clock:?}");
    assert!(clock.remedy.unwrap().contains("timedatectl set-ntp true"));
    let silent = asked("", &[("date", "echo no")]);
    assert_eq!(line(&silent, "clock").state, State::Unknown);
}

#[test]
fn a_full_disk_and_another_platform_are_faults() {
    let full =
        "echo 'Filesystem 1024-blocks Used Available Capacity Mounted on'; echo '/dev/sda1 1000000 990000 10000 99% /'";
    let asked = asked("", &[("df", full), ("uname", "echo Linux mips"), ("getconf", "echo glibc 2.12")]);
    let (disk, platform) = (line(&asked, "disk"), line(&asked, "platform"));
    assert_eq!((disk.state, platform.state), (State::Fault, State::Fault));
    assert!(disk.found.starts_with("9 MiB free, ") && disk.remedy.unwrap().contains("`ssh heli1 df -h`"));
    assert!(platform.found.starts_with("is Linux mips") && platform.remedy.unwrap().contains("`binary`"));
}

#[test]
fn another_version_is_a_fault_whether_installed_or_running() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = lab(folder.path(), 1, "");
    let node = inventory.nodes.values().next().unwrap();
    let installed = |release: &str, bundle: &str| Installed { release: release.to_owned(), bundle: bundle.to_owned() };
    let expected = installed("2", "b");
    let running = |installed, restarts| Some(RunningAgent { pid: 7, installed, run: 1, restarts, landing_s: 0.0 });
    let of = |current: Installed, agent| {
        let facts = Facts { current: Some(current), agent, ..Facts::default() };
        host::of_version(node, &facts, &expected, "lab.toml")
    };
    for (line, state, found) in [
        (of(installed("1", "b"), None), State::Fault, "1 is installed, this PC has 2"),
        (of(installed("2", "a"), None), State::Fault, "its configuration or keys differ from those on this PC"),
        (of(expected.clone(), running(installed("1", "b"), 0)), State::Fault, "runs 1, but 2 has been installed since"),
        (of(expected.clone(), running(expected.clone(), 2)), State::Warning, "2, runs, and was restarted 2 times"),
        (of(expected.clone(), running(expected.clone(), 0)), State::Good, "2, runs"),
        (of(expected.clone(), None), State::Good, "2, does not run"),
    ] {
        assert_eq!((line.state, line.found.as_str(), line.remedy.is_some()), (state, found, state != State::Good));
    }
}

#[test]
fn missing_invalid_or_readable_keys_are_faults() {
    let folder = tempfile::tempdir().unwrap();
    let mut inventory = lab(folder.path(), 2, "");
    let lines = |inventory: &Inventory| keys::lines(inventory, "lab.toml");
    let [missing] = &lines(&inventory)[..] else { panic!("one line") };
    assert!(missing.state == State::Fault && missing.found.contains("authority.pem does not exist"), "{missing:?}");
    assert!(missing.remedy.as_ref().unwrap().contains("skein cluster keys"));
    cluster_keys::make(&inventory, None, None, clock::utc()).unwrap();
    let [good] = &lines(&inventory)[..] else { panic!("one line") };
    assert!(good.state == State::Good && good.found.starts_with("all 6 are valid; the first expires on 2"), "{good:?}");
    inventory.nodes.get_mut(&"2".parse().unwrap()).unwrap().address = "10.0.0.99".to_owned();
    let [moved] = &lines(&inventory)[..] else { panic!("one line") };
    assert_eq!((moved.state, moved.found.as_str()), (State::Fault, "vehicle-2.pem has another address"));
    let names = inventory.keys.join("names.toml");
    let of_before = fs::read_to_string(&names).unwrap().replace("2 = \"observer-2\"\n", "");
    fs::write(&names, of_before).unwrap();
    let [shared, _] = &lines(&inventory)[..] else { panic!("two lines") };
    assert!(
        shared.state == State::Fault && shared.found.starts_with("the observer at node 2 has no key of its own"),
        "{shared:?}"
    );
    fs::set_permissions(&inventory.keys, fs::Permissions::from_mode(0o755)).unwrap();
    let [open] = &lines(&inventory)[..] else { panic!("one line") };
    assert!(
        open.found.ends_with("can be read by others") && open.remedy.as_ref().unwrap().contains("`chmod 700"),
        "{open:?}"
    );
    let [plain] = &lines(&lab(folder.path(), 2, "security = 'none'"))[..] else { panic!("one line") };
    assert_eq!(plain.state, State::Warning);
}

#[test]
fn a_pc_without_the_operators_keys_has_a_note_and_no_fault() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = lab(folder.path(), 2, "");
    cluster_keys::make(&inventory, None, None, clock::utc()).unwrap();
    let lines = || keys::lines(&inventory, "lab.toml");
    for (removed, valid, missing) in [
        ("orders.key", "all 6 are valid", "orders.key is not in"),
        ("operator.key", "all 5 are valid", "operator.key and orders.key are not in"),
        ("operator.pem", "all 5 are valid", "operator.key and orders.key are not in"),
    ] {
        fs::remove_file(inventory.keys.join(removed)).unwrap();
        let [good, note] = &lines()[..] else { panic!("two lines: {:?}", lines()) };
        assert!(good.state == State::Good && good.found.starts_with(valid), "{good:?}");
        assert_eq!((note.what, note.state, &note.remedy), ("orders", State::Good, &None));
        assert!(note.found.starts_with("orders cannot be given from this PC: "), "{note:?}");
        assert!(note.found.contains(missing), "{note:?}");
        assert!(verdict(&lines()).is_ok());
    }
    // A PC with the key needs its certificate, and every PC the keys by which it looks.
    fs::remove_file(inventory.keys.join("observer.key")).unwrap();
    let [fault, note] = &lines()[..] else { panic!("two lines: {:?}", lines()) };
    assert_eq!((fault.state, fault.found.as_str()), (State::Fault, "observer.pem or its key is missing"));
    assert_eq!(note.what, "orders");
    fs::write(inventory.keys.join("operator.key"), "").unwrap();
    fs::set_permissions(inventory.keys.join("operator.key"), fs::Permissions::from_mode(0o600)).unwrap();
    assert!(lines().iter().any(|line| line.found == "operator.pem or its key is missing"), "{:?}", lines());
}

#[test]
fn the_table_and_the_json_agree() {
    let line = Line::new("heli1", "clock", "+90000.0 ±0.4 ms").fault("`ssh heli1 sudo timedatectl set-ntp true`");
    let table = as_table(&[Line::new("heli1", "ssh", "login works"), line.clone()], true);
    let fault = table.lines().last().unwrap();
    assert!(fault.contains("FAULT") && fault.contains("+90000.0") && fault.contains("set-ntp"), "{table}");
    let json = serde_json::to_value(&line).unwrap();
    assert_eq!((&json["state"], &json["what"]), (&"fault".into(), &"clock".into()));
}
