use tempfile::TempDir;

use super::*;
use crate::host::files::tests::fail_after;
use crate::host::node::RUN;
use crate::host::systemd::Systemd;
use crate::protocol::Service;
use skein_common::id::{SwarmName, VehicleId};

/// A host's folder.
struct Host {
    folder: TempDir,
}

impl Host {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn swarm(&self) -> PathBuf {
        self.folder.path().join("skein/lab")
    }

    fn copy(&self, release: &str) {
        let folder = self.swarm().join("releases").join(release);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join(PROGRAM), release).unwrap();
    }

    fn place(&self, release: &str) -> SwarmFolder {
        SwarmFolder {
            folder: self.swarm(),
            swarm: SwarmName::new("lab").unwrap(),
            release: release.to_owned(),
            systemd: Systemd::here(),
        }
    }

    fn node(&self, id: u8) -> NodeFolder {
        let node = self.place("r1").node(VehicleId::new(id).unwrap().into());
        node::make_folders(&[node.file(INSTALLS), node.file(RUN)]).unwrap();
        node
    }

    /// Installs as the operator's PC does: first the program, then the files.
    fn apply(&self, id: u8, release: &str, bundle: &Bundle) -> Result<bool, String> {
        self.copy(release);
        apply(&self.place(release), &self.node(id), bundle, &SETTINGS)
    }

    fn releases(&self) -> Vec<String> {
        names(&self.place("r1").releases())
    }
}

const SETTINGS: Settings = Settings { service: Service::Own, log: None };

fn names(folder: &Path) -> Vec<String> {
    files::entries(folder).iter().map(|path| files::name(path).unwrap().to_owned()).collect()
}

fn bundle(content: &str) -> Bundle {
    let file = |content: &str, is_secret, is_executable| BundleFile {
        is_secret,
        is_executable,
        content: content.as_bytes().to_vec(),
    };
    let files = [
        ("agent.toml", file(content, false, false)),
        ("node.key", file("secret", true, false)),
        ("laws/mine/law.py", file("#!", false, true)),
    ];
    Bundle { files: files.map(|(name, file)| (name.to_owned(), file)).into() }
}

fn is(release: &str, content: &str) -> Option<Installed> {
    Some(Installed { release: release.to_owned(), bundle: bundle(content).id() })
}

#[test]
fn installing_again_changes_nothing() {
    let host = Host::new();
    assert_eq!(host.apply(1, "r1", &bundle("a")), Ok(true));
    assert_eq!(host.apply(1, "r1", &bundle("a")), Ok(false));
    let node = host.node(1);
    assert_eq!((linked(&node.file(CURRENT)), linked(&node.file(PREVIOUS))), (is("r1", "a"), None));
    assert_eq!(fs::read_to_string(node.file(CURRENT).join("agent.toml")).unwrap(), "a");
    assert_eq!(fs::read_to_string(node.file(CURRENT).join(PROGRAM)).unwrap(), "r1", "the program by its link");
    for (file, mode) in [("agent.toml", 0o644), ("node.key", 0o600), ("laws/mine/law.py", 0o755), ("laws/mine", 0o700)]
    {
        assert!(os::has_mode(&node.file(CURRENT).join(file), mode), "{file}");
    }
    assert!(os::has_mode(&node.path, 0o700));
    // A change of the log filter is a change, and keeps the earlier version.
    let logs = Settings { log: Some("debug".to_owned()), ..SETTINGS };
    assert_eq!(apply(&host.place("r1"), &node, &bundle("a"), &logs), Ok(true));
    assert_eq!((linked(&node.file(CURRENT)), linked(&node.file(PREVIOUS))), (is("r1", "a"), None));
}

#[test]
fn an_upgrade_can_be_rolled_back_and_older_versions_are_removed() {
    let host = Host::new();
    let node = host.node(1);
    assert!(rollback(&node).unwrap_err().contains("no earlier version to go back to"));
    host.apply(1, "r1", &bundle("a")).unwrap();
    assert!(rollback(&node).is_err());
    host.apply(1, "r1", &bundle("b")).unwrap();
    host.apply(1, "r2", &bundle("c")).unwrap();
    assert_eq!((linked(&node.file(CURRENT)), linked(&node.file(PREVIOUS))), (is("r2", "c"), is("r1", "b")));
    assert_eq!(names(&node.file(INSTALLS)).len(), 2);
    rollback(&node).unwrap();
    assert_eq!((linked(&node.file(CURRENT)), linked(&node.file(PREVIOUS))), (is("r1", "b"), is("r2", "c")));
    rollback(&node).unwrap();
    assert_eq!(linked(&node.file(CURRENT)), is("r2", "c"));
    host.apply(1, "r2", &bundle("d")).unwrap();
    assert_eq!(host.releases(), ["r2"], "no node needs the other release");
}

#[test]
fn a_release_that_another_node_needs_is_kept() {
    let host = Host::new();
    host.apply(1, "r1", &bundle("a")).unwrap();
    host.apply(2, "r2", &bundle("a")).unwrap();
    host.apply(2, "r2", &bundle("b")).unwrap();
    assert_eq!(host.releases(), ["r1", "r2"]);
    assert_eq!(remove(&host.place("r2"), &host.place("r2").node("1".parse().unwrap())), Ok(true));
    assert_eq!(host.releases(), ["r2"]);
    assert_eq!(names(&host.swarm()), ["lock", "node-2", "releases"]);
    assert_eq!(remove(&host.place("r2"), &host.place("r2").node("2".parse().unwrap())), Ok(true));
    assert_eq!(names(host.folder.path()), [""; 0], "nothing is left");
}

#[test]
fn a_path_that_is_not_plain_is_refused_before_anything_is_written() {
    let host = Host::new();
    let node = host.node(1);
    for path in ["../x", "/etc/x", "a//b", "a/./b", "", "a/..", "a\\b", "c:x", "a\nb", "skein", "skein/x"] {
        let mut bad = bundle("a");
        let file = bad.files["agent.toml"].clone();
        bad.files.insert(path.to_owned(), file);
        let error = host.apply(1, "r1", &bad).unwrap_err();
        assert!(error.contains("cannot be a file of a node"), "{path:?}: {error}");
        assert_eq!(names(&node.file(INSTALLS)), [""; 0]);
    }
    let error = apply(&host.place("r9"), &node, &bundle("a"), &SETTINGS).unwrap_err();
    assert!(error.contains("this program does not exist"), "{error}");
}

#[test]
fn a_damaged_install_is_repaired() {
    let host = Host::new();
    let node = host.node(1);
    host.apply(1, "r1", &bundle("a")).unwrap();
    let damages: [fn(&Path); 4] = [
        |install| fs::write(install.join("agent.toml"), "other").unwrap(),
        |install| fs::remove_file(install.join("laws/mine/law.py")).unwrap(),
        |install| os::set_mode(&install.join("node.key"), 0o644).unwrap(),
        |install| fs::remove_file(install.join(PROGRAM)).unwrap(),
    ];
    for damage in damages {
        damage(&node.file(CURRENT));
        assert_eq!(host.apply(1, "r1", &bundle("a")), Ok(true));
        assert_eq!(host.apply(1, "r1", &bundle("a")), Ok(false));
        assert!(is_whole(&node.file(CURRENT), &bundle("a")));
        assert_eq!(names(&node.file(INSTALLS)).len(), 1);
    }
}

/// Interrupts the installation before each of its changes: what would run is complete every time, and the same request
/// finishes the work.
#[test]
fn an_installation_can_be_interrupted_at_any_moment() {
    let mut moments = 0;
    for changes in 0.. {
        let host = Host::new();
        let node = host.node(1);
        host.apply(1, "r1", &bundle("a")).unwrap();
        fail_after(changes);
        let upgraded = host.apply(1, "r2", &bundle("b"));
        fail_after(u32::MAX);
        let current = linked(&node.file(CURRENT)).unwrap();
        match current.release.as_str() {
            "r1" => assert!(is_whole(&node.file(CURRENT), &bundle("a")) && upgraded.is_err()),
            _ => assert!(is_whole(&node.file(CURRENT), &bundle("b"))),
        }
        host.apply(1, "r2", &bundle("b")).unwrap();
        assert_eq!(
            (linked(&node.file(CURRENT)), linked(&node.file(PREVIOUS))),
            (is("r2", "b"), is("r1", "a")),
            "{changes}"
        );
        assert!(is_whole(&node.file(CURRENT), &bundle("b")) && is_whole(&node.file(PREVIOUS), &bundle("a")));
        assert_eq!(names(&node.file(INSTALLS)).len(), 2, "no draft is left after {changes}");
        assert_eq!(names(&node.path), ["current", "installs", "previous", "run", "settings.json"], "{changes}");

        fail_after(changes);
        let taken_away = remove(&host.place("r2"), &node);
        fail_after(u32::MAX);
        if taken_away.is_err() {
            remove(&host.place("r2"), &node).unwrap();
        }
        assert_eq!(names(host.folder.path()), [""; 0], "{changes}");
        moments += 1;
        if upgraded.is_ok() && taken_away.is_ok() {
            break;
        }
    }
    assert!(moments > 15, "only {moments} moments were tried");
}
