use std::fs;
use std::path::Path;

use clap::Parser;
use skein_agent::config::AgentOptions;
use skein_agent::plant::xplane::wire;
use skein_common::id::{VehicleId, VehicleName};
use skein_common::scenario::PlantKind;
use skein_host::atomic_file::{self, Durability};

use super::*;
use crate::inventory::Inventory;
use crate::inventory::tests::{TEAMS, fleet, lab};
use crate::keys::Role;
use crate::keys::command as keys;
use skein_agent::link::Security;
use skein_host::clock;

fn id(number: u8) -> VehicleName {
    VehicleId::new(number).unwrap().into()
}

/// Makes a cluster of three nodes with keys.
fn cluster(folder: &Path, more: &str) -> Inventory {
    let inventory = lab(folder, 3, more);
    keys::make(&inventory, None, None, clock::utc()).unwrap();
    inventory
}

/// Writes the files as a node's host does.
fn unpack(bundle: &Bundle, folder: &Path) {
    for (path, file) in &bundle.files {
        let path = folder.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        atomic_file::write(&path, &file.content, Durability::of(file.is_secret)).unwrap();
    }
}

/// The command line of an agent.
#[derive(Parser)]
struct Agent {
    #[command(flatten)]
    options: AgentOptions,
}

/// The configuration that an agent reads from this folder.
fn node(folder: &Path) -> skein_agent::config::Node {
    let config = folder.join("agent.toml");
    let line = ["skein-agent", "--config", config.to_str().unwrap(), "--run", "7"];
    Agent::try_parse_from(line).unwrap().options.node().unwrap_or_else(|error| panic!("{error}"))
}

fn text<'b>(bundle: &'b Bundle, path: &str) -> &'b str {
    std::str::from_utf8(&bundle.files[path].content).unwrap()
}

#[test]
fn an_agent_can_start_with_the_files_of_its_node() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = cluster(folder.path(), "[defaults]\nplant = 'standin'\nxplane = '127.0.0.1:49000'");
    let bundle = pack(&inventory, id(2)).unwrap();
    let there = tempfile::tempdir().unwrap();
    unpack(&bundle, there.path());
    let node = node(there.path());
    assert_eq!((node.id, node.listen), (id(2).vehicle, vec!["tls/10.0.0.12:7448".to_owned()]));
    assert_eq!(node.dial, ["tls/10.0.0.11:7447"], "one of each pair dials");
    assert_eq!(node.scenario.swarm.name.as_str(), "lab");
    let standin = (std::net::Ipv4Addr::LOCALHOST, wire::PORT).into();
    assert!(matches!(node.plant, skein_agent::plant::PlantChoice::Standin(address) if address == standin));
    for (path, file) in &bundle.files {
        assert_eq!(file.is_secret, path.ends_with(".key"), "{path}");
    }
    let names: Vec<_> = bundle.files.keys().map(String::as_str).collect();
    let expected = [
        "agent.toml",
        "authority.pem",
        "cluster.toml",
        "keys/authority.pem",
        "keys/names.toml",
        "keys/observer-2.key",
        "keys/observer-2.pem",
        "keys/orders.pub",
        "node.key",
        "node.pem",
        "scenario.toml",
    ];
    assert_eq!(names, expected, "never the operator's keys, nor those of another node");
}

#[test]
fn the_swarm_can_be_observed_from_a_node() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = cluster(folder.path(), "[defaults]\nuser = 'lab'\nfolder = 'elsewhere'");
    let there = tempfile::tempdir().unwrap();
    unpack(&pack(&inventory, id(3)).unwrap(), there.path());
    let read = Inventory::read(&there.path().join("cluster.toml")).unwrap();
    let hosts = |inventory: &Inventory| inventory.nodes.values().map(|node| node.host.clone()).collect::<Vec<_>>();
    assert_eq!(hosts(&read), hosts(&inventory));
    let endpoints = |of: &Inventory| of.nodes.values().map(|node| node.endpoint(of.security)).collect::<Vec<_>>();
    assert_eq!((&read.swarm, endpoints(&read)), (&inventory.swarm, endpoints(&inventory)));
    assert_eq!(read.scenario.first().scenario, inventory.scenario.first().scenario);
    assert_eq!(read.keys, there.path().join("keys"));
    let Security::Tls(tls) = read.reaches(Role::Observer).unwrap().remove(0).security else { panic!("secured") };
    assert_eq!(tls.key, read.keys.join("observer-3.key"));
    assert_eq!(tls.observers, ["observer", "observer-1", "observer-2", "observer-3"]);
    let orders = read.reaches(Role::Operator).map(|_| ()).unwrap_err().to_string();
    assert!(orders.contains("operator.pem does not exist"), "{orders}");
}

#[test]
fn the_same_cluster_gives_the_same_bytes_from_anywhere() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let inventory = cluster(folder.path(), "");
    let bundle = pack(&inventory, id(1)).unwrap();
    assert_eq!(pack(&inventory, id(1)).unwrap().id(), bundle.id());
    assert_ne!(pack(&inventory, id(2)).unwrap().id(), bundle.id());
    for entry in fs::read_dir(&inventory.keys).unwrap().map(Result::unwrap) {
        let path = elsewhere.path().join("keys").join(entry.file_name());
        crate::os::private_folder(path.parent().unwrap()).unwrap();
        fs::copy(entry.path(), path).unwrap();
    }
    let copy = pack(&lab(elsewhere.path(), 3, ""), id(1)).unwrap();
    assert_eq!(copy.id(), bundle.id());
    assert!(
        bundle
            .files
            .values()
            .all(|file| { !String::from_utf8_lossy(&file.content).contains(folder.path().to_str().unwrap()) })
    );
}

#[test]
fn a_change_at_one_node_does_not_change_the_files_of_others() {
    let folder = tempfile::tempdir().unwrap();
    let mut inventory = cluster(folder.path(), "");
    let before = [1, 2].map(|number| pack(&inventory, id(number)).unwrap().id());
    let second = inventory.nodes.get_mut(&id(2)).unwrap();
    second.plant = PlantKind::Xplane;
    second.xplane = Some("10.0.0.22".to_owned());
    second.folder = "elsewhere".to_owned();
    let after = [1, 2].map(|number| pack(&inventory, id(number)).unwrap().id());
    assert_eq!((before[0] == after[0], before[1] == after[1]), (true, false));
}

#[test]
fn a_revocation_changes_the_files_of_every_node() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = cluster(folder.path(), "");
    let before = pack(&inventory, id(1)).unwrap();
    keys::make(&inventory, None, Some("3".parse().unwrap()), clock::utc()).unwrap();
    let after = pack(&inventory, id(1)).unwrap();
    assert!(text(&before, "agent.toml").contains("\n3 = { name = \"vehicle-3\", key = \""));
    assert!(text(&after, "agent.toml").contains("\n3 = { name = \"vehicle-3.2\", key = \""));
    let observers = r#"observers = ["observer", "observer-1", "observer-2", "observer-3.2"]"#;
    assert!(text(&after, "agent.toml").contains(observers), "{}", text(&after, "agent.toml"));
    assert_ne!(before.id(), after.id());
}

#[test]
fn a_bundle_needs_valid_keys() {
    let folder = tempfile::tempdir().unwrap();
    let mut inventory = lab(folder.path(), 3, "");
    let missing = pack(&inventory, id(1)).unwrap_err().to_string();
    assert!(missing.ends_with("authority.pem does not exist: `skein cluster keys` creates it"), "{missing}");
    keys::make(&inventory, None, None, clock::utc()).unwrap();
    inventory.nodes.get_mut(&id(1)).unwrap().address = "10.0.0.99".to_owned();
    let moved = pack(&inventory, id(1)).unwrap_err().to_string();
    assert!(moved.contains("vehicle-1.pem has another address: `skein cluster keys -f "), "{moved}");
    let plain = pack(&lab(folder.path(), 3, "security = 'none'"), id(1)).unwrap();
    assert!(!text(&plain, "agent.toml").contains("[security]") && !plain.files.contains_key("node.key"));
    assert!(text(&plain, "agent.toml").contains("listen = [\"tcp/10.0.0.11:7447\"]"));
}

#[test]
fn a_point_mass_needs_the_built_in_plant_at_every_node() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("points.toml"), "swarm.vehicles = 1\nplant.model = 'point_mass'").unwrap();
    let bundle = |node: &str| {
        let path = folder.path().join("cluster.toml");
        let text =
            format!("swarm = 'lab'\nscenario = 'points.toml'\nsecurity = 'none'\n[node.1]\nhost = '10.0.0.1'\n{node}");
        fs::write(&path, text).unwrap();
        pack(&Inventory::read(&path).unwrap(), id(1))
    };
    bundle("").unwrap();
    let refusal = bundle("plant = 'standin'\nxplane = '127.0.0.1:49000'").unwrap_err().to_string();
    let why =
        "vehicle 1: `plant.model` = \"point_mass\" needs the built-in plant, but its node has plant = \"standin\"";
    assert!(refusal.ends_with(why), "{refusal}");
}

#[test]
fn files_that_the_scenario_names_are_copied() {
    let folder = tempfile::tempdir().unwrap();
    let (lab_folder, laws) = (folder.path().join("lab"), folder.path().join("laws"));
    fs::create_dir_all(&lab_folder).unwrap();
    fs::create_dir(&laws).unwrap();
    fs::write(laws.join("law.py"), "print(1)").unwrap();
    fs::write(lab_folder.join("law.py"), "print(2)").unwrap();
    let controllers = Path::new(env!("CARGO_MANIFEST_DIR")).join("../controllers");
    let (_, shipped) = Aircraft::SHIPPED[0];
    fs::write(lab_folder.join("mine.toml"), shipped).unwrap();
    let scenario = |command: &str| {
        format!(
            "swarm.vehicles = 1\nswarm.aircraft = 'mine'\ncontrol.rules = '{}'\nformation.law = 'external'\n\
             formation.external.command = {command}\n",
            controllers.display()
        )
    };
    let read = |command: &str| {
        fs::write(lab_folder.join("my.toml"), scenario(command)).unwrap();
        let path = lab_folder.join("cluster.toml");
        let text = format!(
            "swarm = 'lab'\nscenario = 'my.toml'\nsecurity = 'none'\nfiles = ['../laws', '{}']\nnode.1.host = '10.0.0.1'\n",
            controllers.display()
        );
        fs::write(&path, text).unwrap();
        pack(&Inventory::read(&path).unwrap(), id(1))
    };
    let bundle = read("['cargo', '-u', '../laws/law.py', 'law.py', '--fast']").unwrap();
    assert_eq!((text(&bundle, "law/law.py"), text(&bundle, "law/2/law.py")), ("print(1)", "print(2)"));
    assert_eq!(text(&bundle, "mine.toml"), shipped);
    let there = tempfile::tempdir().unwrap();
    unpack(&bundle, there.path());
    let node = node(there.path());
    let law = |path: &str| there.path().join(path).display().to_string();
    let command = node.scenario.formation.external.command.unwrap();
    assert_eq!(command, ["cargo", "-u", &law("law/law.py"), &law("law/2/law.py"), "--fast"]);
    assert!(node.scenario.swarm.plant == PlantKind::Builtin && bundle.files.contains_key("rules/roll.fis"));
    fs::write(lab_folder.join("fly"), "#!/bin/sh").unwrap();
    let bundle = read("['./fly', 'law.py']").unwrap();
    assert!(bundle.files["law/fly"].is_executable && !bundle.files["law/law.py"].is_executable);
    assert!(text(&bundle, "scenario.toml").contains("command = [\"law/fly\", \"law/law.py\"]"));
}

#[cfg(unix)]
#[test]
fn a_file_outside_the_scenarios_folder_is_copied_only_if_the_cluster_file_permits_it() {
    use std::os::unix::fs::symlink;

    let folder = tempfile::tempdir().unwrap();
    let [lab, ssh] = ["a/lab", "ssh"].map(|name| folder.path().join(name));
    fs::create_dir_all(lab.join("keys")).unwrap();
    fs::create_dir(&ssh).unwrap();
    fs::write(ssh.join("id"), "a private key").unwrap();
    fs::write(lab.join("keys/orders.key"), "another").unwrap();
    fs::write(lab.join("law.py"), "print(1)").unwrap();
    symlink(ssh.join("id"), lab.join("link.py")).unwrap();
    symlink(&ssh, lab.join("linked")).unwrap();
    fs::write(lab.join("mine.toml"), Aircraft::SHIPPED[0].1).unwrap();
    fs::rename(lab.join("mine.toml"), ssh.join("mine.toml")).unwrap();
    symlink(ssh.join("mine.toml"), lab.join("mine.toml")).unwrap();
    let path = lab.join("cluster.toml");
    let bundle = |files: &str, more: &str| {
        let scenario = format!("swarm.vehicles = 1\nformation.law = 'external'\n{more}\n");
        fs::write(lab.join("my.toml"), scenario).unwrap();
        let text =
            format!("swarm = 'lab'\nscenario = 'my.toml'\nsecurity = 'none'\n{files}\nnode.1.host = '10.0.0.1'\n");
        fs::write(&path, text).unwrap();
        pack(&Inventory::read(&path)?, id(1))
    };
    let law = |argument: &str| format!("formation.external.command = ['cat', 'law.py', '{argument}']");
    let copied = |bundle: &Bundle| bundle.files.values().any(|file| file.content == b"a private key");
    for argument in ["../../ssh/id", "link.py", "linked/id"] {
        let error = bundle("", &law(argument)).unwrap_err();
        let message = error.to_string();
        assert!(message.contains(&format!("{argument} is not in the scenario's folder")), "{message}");
        let remedy = format!("`files = [\"{}\"]` in {}", ssh.join("id").display(), path.display());
        assert!(message.contains(&remedy) && error.exit_code() == 2, "{message}");
        for files in ["files = ['../../ssh/id']", "files = ['nothing', '../../ssh']"] {
            fs::write(lab.join("nothing"), "").unwrap();
            assert!(copied(&bundle(files, &law(argument)).unwrap()), "{files}");
        }
    }
    assert!(!copied(&bundle("", &law("law.py")).unwrap()));
    let key = bundle("files = ['keys']", &law("keys/orders.key")).unwrap_err().to_string();
    assert!(key.contains("keys/orders.key is in the folder of keys"), "{key}");
    let with_aircraft = format!("{}\nswarm.aircraft = 'mine'", law("law.py"));
    let aircraft = bundle("", &with_aircraft).unwrap_err().to_string();
    assert!(
        aircraft.contains("vehicle 1: ") && aircraft.contains("mine.toml is not in the scenario's folder"),
        "{aircraft}"
    );
    assert!(bundle("files = ['../../ssh/mine.toml']", &with_aircraft).is_ok());
    let missing = bundle("files = ['../none']", &law("law.py")).unwrap_err().to_string();
    assert!(missing.contains("cluster.toml:4") && missing.ends_with("a/lab/../none does not exist"), "{missing}");
}

#[test]
fn an_agent_of_a_fleet_can_start_with_the_files_of_its_node() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = fleet(folder.path(), TEAMS).unwrap();
    keys::make(&inventory, None, None, clock::utc()).unwrap();
    let there = tempfile::tempdir().unwrap();
    let bundle = pack(&inventory, "2/1".parse().unwrap()).unwrap();
    unpack(&bundle, there.path());
    let node = node(there.path());
    let team = node.scenario.team.map(|team| (team.id.get(), team.teams));
    assert_eq!((team, node.id.get(), node.scenario.swarm.vehicles), (Some((2, 3)), 1, 3));
    assert_eq!(node.listen, ["tls/10.0.0.2:7449"]);
    assert_eq!(node.dial, ["tls/10.0.0.1:7447", "tls/10.0.0.1:7448"]);
    let Security::Tls(tls) = &node.security else { panic!("secured") };
    assert_eq!(
        tls.vehicles.keys().map(ToString::to_string).collect::<Vec<_>>().join(" "),
        "1/1 1/2 2/1 2/2 2/3 3/1 3/2"
    );
    assert_eq!(tls.vehicles[&"2/1".parse().unwrap()].name, "vehicle-2-1");
    assert!(node.security.signing_key("2/1".parse().unwrap()).unwrap().is_some());
    assert!(node.security.signing_key("3/1".parse().unwrap()).is_err(), "vehicle 1 of another team");
    // The fleet can be observed from there, by teams.
    let read = Inventory::read(&there.path().join("cluster.toml")).unwrap();
    let reaches = read.reaches(Role::Observer).unwrap();
    let teams: Vec<_> = reaches.iter().map(|reach| (reach.title(), reach.agents.len())).collect();
    let title = |team: u8| format!("team {team} of fleet lab");
    assert_eq!(teams, [(title(1), 2), (title(2), 3), (title(3), 2)]);
}

#[test]
fn teams_with_other_rules_get_other_files() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = fleet(folder.path(), &format!("security = 'none'\n{TEAMS}")).unwrap();
    let controllers = Path::new(env!("CARGO_MANIFEST_DIR")).join("../controllers");
    for rules in ["fast", "slow"] {
        fs::create_dir(folder.path().join(rules)).unwrap();
        for entry in fs::read_dir(&controllers).unwrap().map(Result::unwrap) {
            let text = fs::read_to_string(entry.path()).unwrap() + &format!("\n# {rules}\n");
            fs::write(folder.path().join(rules).join(entry.file_name()), text).unwrap();
        }
    }
    let scenario = fs::read_to_string(&inventory.scenario_path).unwrap();
    let team = |id: u8, rules: &str| format!("[[team]]\nids = [{id}]\ncontrol.rules = '{rules}'\n");
    fs::write(&inventory.scenario_path, scenario + &team(1, "fast") + &team(2, "slow") + &team(3, "fast")).unwrap();
    let inventory = Inventory::read(&inventory.path).unwrap();
    let bundle = pack(&inventory, "3/1".parse().unwrap()).unwrap();
    for (folder, rules) in [("rules", "fast"), ("rules-2", "slow")] {
        assert!(text(&bundle, &format!("{folder}/roll.fis")).ends_with(&format!("# {rules}\n")));
    }
    assert!(!bundle.files.keys().any(|path| path.starts_with("rules-3")));
    let there = tempfile::tempdir().unwrap();
    unpack(&bundle, there.path());
    let read = Inventory::read(&there.path().join("cluster.toml")).unwrap();
    let rules = read.scenario.all().iter().map(|team| team.scenario.control.rules.clone());
    let folder = |name: &str| scenario::Rules::Folder(there.path().join(name));
    assert_eq!(rules.collect::<Vec<_>>(), [folder("rules"), folder("rules-2"), folder("rules")]);
}
