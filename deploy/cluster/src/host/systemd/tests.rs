use std::process::Output;

use tempfile::TempDir;

use super::*;
use crate::host::node::{ACTIVE, RUN};
use crate::host::place::SwarmFolder;
use crate::protocol::Installed;
use crate::ssh::tests::write_script;
use skein_common::id::SwarmName;

/// A host whose `systemctl` and `loginctl` record their arguments.
struct Host {
    folder: TempDir,
    systemd: Systemd,
}

impl Host {
    fn new(is_users: bool) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let bin = folder.path().join("bin");
        fs::create_dir(&bin).unwrap();
        for program in ["systemctl", "loginctl"] {
            let calls = folder.path().join("calls");
            let script = format!("echo {program} \"$@\" >>{}\necho Linger=no", calls.display());
            write_script(&bin.join(program), &script);
        }
        let path = std::env::join_paths([bin, "/usr/bin".into(), "/bin".into()]).unwrap();
        let systemd = Systemd { is_users, units: folder.path().join("units"), path: Some(path) };
        Self { folder, systemd }
    }

    fn place(&self) -> SwarmFolder {
        let folder = self.folder.path().join("a b%c/lab");
        let swarm = SwarmName::new("lab").unwrap();
        SwarmFolder { folder, swarm, release: "r1".to_owned(), systemd: self.systemd.clone() }
    }

    fn node(&self) -> NodeFolder {
        self.place().node("3".parse().unwrap())
    }

    /// The recorded calls since the last call of this function.
    fn calls(&self) -> Vec<String> {
        let calls = self.folder.path().join("calls");
        let text = fs::read_to_string(&calls).unwrap_or_default();
        files::remove(&calls).unwrap();
        text.lines().map(str::to_owned).collect()
    }
}

#[test]
fn a_unit_is_written_once_and_removed_again() {
    let host = Host::new(true);
    let (place, node) = (host.place(), host.node());
    host.systemd.ready().unwrap();
    let linger = ["loginctl show-user --property=Linger", "loginctl enable-linger"];
    assert_eq!(host.calls(), [&["systemctl --user show --property=Version"], &linger[..]].concat());
    assert_eq!(
        (host.systemd.install_service(&place.swarm, &node), host.systemd.install_service(&place.swarm, &node)),
        (Ok(true), Ok(false))
    );
    assert_eq!(host.calls(), ["systemctl --user daemon-reload"]);
    host.systemd.start(&place.swarm, &node).unwrap();
    host.systemd.stop(&place.swarm, &node).unwrap();
    let unit = "skein-lab-3.service";
    assert_eq!(
        host.calls(),
        [
            format!("systemctl --user reset-failed {unit}"),
            format!("systemctl --user enable {unit}"),
            format!("systemctl --user start --no-block {unit}"),
            format!("systemctl --user disable {unit}"),
            format!("systemctl --user stop --no-block {unit}"),
        ]
    );
    host.systemd.remove_service(&place.swarm, &node).unwrap();
    let calls = [format!("systemctl --user disable {unit}"), "systemctl --user daemon-reload".to_owned()];
    assert_eq!(host.calls(), [&calls[..], &["loginctl disable-linger".to_owned()]].concat());
    assert!(files::entries(&host.systemd.units).is_empty());
    host.systemd.remove_service(&place.swarm, &node).unwrap();
    assert!(host.calls().is_empty(), "no unit is left");
}

#[test]
fn the_systems_instance_does_not_need_lingering() {
    let host = Host::new(false);
    host.systemd.ready().unwrap();
    host.systemd.install_service(&host.place().swarm, &host.node()).unwrap();
    assert_eq!(host.calls(), ["systemctl show --property=Version", "systemctl daemon-reload"]);
}

#[test]
fn an_error_of_systemd_is_reported_with_its_own_message() {
    let host = Host::new(true);
    write_script(&host.folder.path().join("bin/systemctl"), "echo 'Failed to connect to bus' >&2; exit 1");
    let error = host.systemd.ready().unwrap_err();
    assert_eq!(error, "systemctl --user show --property=Version: Failed to connect to bus");
    // Without a unit there is nothing to stop.
    let (place, node) = (host.place(), host.node());
    host.systemd.stop(&place.swarm, &node).unwrap();
    host.systemd.install_service(&place.swarm, &node).unwrap_err();
    let error = host.systemd.stop(&place.swarm, &node).unwrap_err();
    assert!(error.contains("stop --no-block skein-lab-3.service: Failed to connect"), "{error}");
}

#[test]
fn a_path_that_a_unit_cannot_contain_is_refused() {
    let host = Host::new(true);
    let place = SwarmFolder { folder: "/home/a\"b/lab".into(), ..host.place() };
    assert!(host.systemd.text(&place.swarm, &place.node("1".parse().unwrap())).is_err());
}

/// A tool of systemd on a unit; `None`, with a message, if it is missing. With `SKEIN_NAMESPACES=required` it must be there.
fn analyze(arguments: &[&str], unit: &Path) -> Option<Output> {
    let output = Command::new("systemd-analyze").args(arguments).arg(unit).output().ok();
    if output.is_none() {
        let missing = "systemd-analyze was not found";
        assert_ne!(std::env::var("SKEIN_NAMESPACES").as_deref(), Ok("required"), "{missing}");
        eprintln!("not verified: {missing}");
    }
    output
}

/// Installs the unit of a node whose program exists, because systemd looks for it.
fn installed(host: &Host) -> PathBuf {
    let (place, node) = (host.place(), host.node());
    host.systemd.install_service(&place.swarm, &node).unwrap();
    let install = node.install(&Installed { release: "r1".to_owned(), bundle: "00".to_owned() });
    for folder in [&install, &node.file(RUN)] {
        fs::create_dir_all(folder).unwrap();
    }
    os::link(Path::new("/bin/true"), &install.join("skein")).unwrap();
    os::link(&Path::new("../installs").join(install.file_name().unwrap()), &node.file(ACTIVE)).unwrap();
    host.systemd.units.join(unit(&place.swarm, &node))
}

#[test]
fn the_unit_is_valid() {
    for is_users in [true, false] {
        let host = Host::new(is_users);
        let unit = installed(&host);
        let verify = || analyze(&["verify", "--man=no"], &unit);
        let Some(verified) = verify() else { return };
        let output = String::from_utf8_lossy(&verified.stderr).into_owned();
        assert!(verified.status.success() && !output.contains("skein"), "{output}");
        // The verification does find faults.
        let text = fs::read_to_string(&unit).unwrap();
        let faults = [
            ("run/active", "run/gone"),
            ("KillMode=mixed", "KillMode=mixde"),
            ("WatchdogSec", "Watchdog"),
            ("UMask=0", "UMask=x"),
        ];
        for (right, wrong) in faults {
            fs::write(&unit, text.replace(right, wrong)).unwrap();
            let output = String::from_utf8_lossy(&verify().unwrap().stderr).into_owned();
            assert!(output.contains("skein-lab-3.service"), "{wrong}: {output}");
        }
    }
}

/// The exposure that systemd computes is from 0 (no access) to 10 (all that root has).
#[test]
fn the_systems_unit_can_do_little_besides_flying() {
    let host = Host::new(false);
    let unit = installed(&host);
    let exposure = |limit: &str| {
        let threshold = format!("--threshold={limit}");
        let found = analyze(&["security", "--offline=yes", "--no-pager", &threshold], &unit)?;
        Some((found.status.success(), String::from_utf8_lossy(&found.stdout).into_owned()))
    };
    let Some((is_below, output)) = exposure("30") else { return };
    assert!(is_below, "{output}");
    let text = fs::read_to_string(&unit).unwrap();
    fs::write(&unit, text.replace("CapabilityBoundingSet=", "#")).unwrap();
    let (is_below, output) = exposure("30").unwrap();
    assert!(!is_below, "root's capabilities count: {output}");
}
