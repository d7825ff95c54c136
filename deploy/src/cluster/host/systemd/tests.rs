use tempfile::TempDir;

use super::*;
use crate::cluster::host::place::Place;
use crate::cluster::protocol::Installed;
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
            let script = format!("#!/bin/sh\necho {program} \"$@\" >>{}\necho Linger=no\n", calls.display());
            fs::write(bin.join(program), script).unwrap();
            os::set_mode(&bin.join(program), 0o755).unwrap();
        }
        let path = std::env::join_paths([bin, "/usr/bin".into(), "/bin".into()]).unwrap();
        let systemd = Systemd { is_users, units: folder.path().join("units"), path: Some(path) };
        Self { folder, systemd }
    }

    fn place(&self) -> Place {
        let folder = self.folder.path().join("a b%c/lab");
        let swarm = SwarmName::new("lab").unwrap();
        Place { folder, swarm, release: "r1".to_owned(), systemd: self.systemd.clone() }
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
            format!("systemctl --user start --no-block {unit}"),
            format!("systemctl --user stop --no-block {unit}"),
        ]
    );
    host.systemd.remove_service(&place.swarm, &node).unwrap();
    assert_eq!(host.calls(), ["systemctl --user daemon-reload", "loginctl disable-linger"]);
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
    let failing = "#!/bin/sh\necho 'Failed to connect to bus' >&2; exit 1\n";
    fs::write(host.folder.path().join("bin/systemctl"), failing).unwrap();
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
    let place = Place { folder: "/home/a\"b/lab".into(), ..host.place() };
    assert!(text(&place.swarm, &place.node("1".parse().unwrap())).is_err());
}

/// Verified by systemd itself; with `SKEIN_NAMESPACES=required` it must be available.
#[test]
fn the_unit_is_valid() {
    let host = Host::new(true);
    let (place, node) = (host.place(), host.node());
    host.systemd.install_service(&place.swarm, &node).unwrap();
    let unit = host.systemd.units.join(unit(&place.swarm, &node));
    let verify = |unit: &Path| Command::new("systemd-analyze").args(["verify", "--man=no"]).arg(unit).output();
    // The program must exist at the path in the unit.
    let install = node.install(&Installed { release: "r1".to_owned(), bundle: "00".to_owned() });
    for folder in [&install, &node.run()] {
        fs::create_dir_all(folder).unwrap();
    }
    os::symlink(Path::new("/bin/true"), &install.join("skein")).unwrap();
    os::symlink(&Path::new("../installs").join(install.file_name().unwrap()), &node.active()).unwrap();
    let Ok(verified) = verify(&unit) else {
        let missing = "systemd-analyze was not found";
        assert_ne!(std::env::var("SKEIN_NAMESPACES").as_deref(), Ok("required"), "{missing}");
        return eprintln!("not verified: {missing}");
    };
    let output = String::from_utf8_lossy(&verified.stderr).into_owned();
    assert!(verified.status.success() && !output.contains("skein"), "{output}");
    // The verification does find faults.
    let text = fs::read_to_string(&unit).unwrap();
    for (right, wrong) in
        [("run/active", "run/gone"), ("KillMode=mixed", "KillMode=mixde"), ("WatchdogSec", "Watchdog")]
    {
        fs::write(&unit, text.replace(right, wrong)).unwrap();
        let verified = verify(&unit).unwrap();
        let output = String::from_utf8_lossy(&verified.stderr).into_owned();
        assert!(output.contains("skein-lab-3.service"), "{wrong}: {output}");
    }
}
