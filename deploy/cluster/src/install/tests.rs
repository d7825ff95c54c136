use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use super::super::bundle::BundleFile;
use super::super::protocol::RunningAgent;
use super::super::ssh::tests::{heli, node};
use super::*;
use crate::inventory::Install;
use crate::inventory::tests::lab;
use crate::nodes::Outcome;

fn installed(release: &str) -> Installed {
    Installed { release: release.to_owned(), bundle: "b".to_owned() }
}

#[test]
fn only_a_vehicle_that_runs_another_version_is_restarted() {
    let node = node(3, Some("heli1"));
    let agent = |release| RunningAgent { pid: 1, installed: installed(release), run: 7, restarts: 0, landing_s: 660.0 };
    let needed = |current, agent: Option<RunningAgent>| {
        let facts = Facts { current: Some(installed(current)), agent, ..Facts::default() };
        Restart::needed(&heli("heli1"), &node, &facts).map(|restart| (restart.run, restart.landing_s))
    };
    assert_eq!(needed("new", Some(agent("old"))), Some((7, 660.0)));
    assert_eq!(needed("new", Some(agent("new"))), None);
    assert_eq!(needed("new", None), None);
}

#[test]
fn the_table_shows_what_was_done() {
    let mut rows = vec![InstalledNode::new(&node(1, Some("heli1"))), InstalledNode::new(&node(10, Some("heli10")))];
    rows[0].outcome.done = "installed";
    (rows[0].outcome.seconds, rows[0].copied_bytes, rows[0].copy_s) = (2.34, 12_345_678, 0.96);
    rows[1].outcome.fail("heli10: no room".to_owned());
    let wanted = " node  host    done       all s  copied MB  copying s
    1  heli1   installed    2.3       12.3        1.0
   10  heli10  failed                                  heli10: no room\n";
    assert_eq!(row::table(&rows, false), wanted);
    rows[0].restart_s = Some(4.0);
    assert!(row::table(&rows, true).contains("restart s"));
    assert!(row::table(&rows, true).ends_with("nothing was changed: this is what would be done\n"));
}

#[test]
fn the_object_of_a_node_has_what_was_done_what_is_installed_and_how_long_it_took() {
    let mut row = InstalledNode::new(&node(1, Some("heli1")));
    (row.outcome.done, row.outcome.runs) = ("rolled-back", Some(installed("r")));
    let id = serde_json::to_string(&row.outcome.node).unwrap();
    let outcome = |of: &str| format!(r#"{{"node":{id},"host":"heli1","done":"{of}","why":null,"note":null,"#);
    let times = r#""seconds":0.0,"probe_s":0.0,"copied_bytes":0,"copy_s":0.0,"apply_s":0.0,"restart_s":null}"#;
    let wanted = outcome("rolled-back") + r#""release":"r","bundle":"b","# + times;
    assert_eq!(serde_json::to_string(&row).unwrap(), wanted);
    assert_eq!(row.outcome.to_text(), "node 1 rolled back");
    let landed = Outcome { done: "landed", ..Outcome::new(&node(1, Some("heli1"))) };
    assert_eq!(serde_json::to_string(&landed).unwrap(), outcome("landed") + r#""seconds":0.0}"#);
}

#[test]
fn a_node_without_ssh_gets_a_folder_to_carry() {
    let folder = tempfile::tempdir().unwrap();
    let mut inventory = lab(folder.path(), 2, "");
    let id = "2".parse().unwrap();
    inventory.nodes.get_mut(&id).unwrap().install = Install::Manual;
    let chosen = ChosenNodes { ids: inventory.nodes.keys().copied().collect(), inventory };
    let node = chosen.manual().next().unwrap();
    assert_eq!((node.id, chosen.hosts().len()), (id, 1));
    let file = |content: &str, is_secret| BundleFile { is_secret, is_executable: false, content: content.into() };
    let files = [("agent.toml", file("id = 2", false)), ("keys/observer.key", file("secret", true))];
    let files = files.map(|(path, file)| (path.to_owned(), file));
    let program = Arc::new(Program::read(None).unwrap());
    let mut given = Payload { program, bundle: Bundle { files: files.into() } };
    let nodes = NodesArgs {
        file: crate::FileArgs { file: Some(chosen.inventory.path.clone()) },
        nodes: Vec::new(),
        verbose: false,
        json: false,
    };
    let out = folder.path().join("manual");
    let mut args =
        InstallArgs { nodes, dry_run: true, rollback: false, take_over: false, timeout_s: 1.0, out: out.clone() };
    let write = |args: &InstallArgs, given: &Payload| {
        let row = manual::write(args, &chosen, node, Some(given));
        assert_eq!(row.outcome.why, None);
        row.outcome.done
    };
    assert_eq!(write(&args, &given), "written");
    assert!(!out.exists(), "a dry run writes nothing");
    args.dry_run = false;
    assert_eq!(write(&args, &given), "written");
    assert_eq!(write(&args, &given), UNCHANGED);
    given.bundle.files.get_mut("agent.toml").unwrap().content = b"id = 2 # other".to_vec();
    assert_eq!(write(&args, &given), "written");
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let there = out.join("node-2");
    assert_eq!((mode(&there), mode(&there.join("keys/observer.key"))), (0o700, 0o600));
    assert_eq!(fs::read_to_string(there.join("agent.toml")).unwrap(), "id = 2 # other");
    let readme = fs::read_to_string(there.join("README.txt")).unwrap();
    assert!(readme.contains("./skein agent --config agent.toml --run RUN") && readme.contains("7448"), "{readme}");
    assert!(readme.contains(r"begin with `.\skein.exe`"), "{readme}");
    assert!(!there.join("skein").exists(), "the platform is unknown");
    // A program for Windows.
    let windows = folder.path().join("skein.exe");
    fs::write(&windows, b"MZ").unwrap();
    given.program = Arc::new(Program { bytes: b"MZ".as_slice().into(), ..(*given.program).clone() });
    let node = Node { binary: Some(windows), ..node.clone() };
    let args = InstallArgs { out: folder.path().join("other"), ..args };
    assert_eq!(manual::write(&args, &chosen, &node, Some(&given)).outcome.done, "written");
    let readme = fs::read_to_string(args.out.join("node-2/README.txt")).unwrap();
    let commands = [r".\skein.exe agent --config agent.toml", r".\skein.exe cluster status -f cluster.toml"];
    assert!(commands.iter().all(|command| readme.contains(command)) && !readme.contains("./skein"), "{readme}");
}
