use std::fs;

use skein_common::id::VehicleId;

use super::*;

/// Writes and reads a cluster of `vehicles` hosts from 10.0.0.11 on.
pub(crate) fn lab(folder: &Path, vehicles: usize, more: &str) -> Inventory {
    let nodes: String = (1..=vehicles).map(|id| format!("[node.{id}]\nhost = '10.0.0.{}'\n", 10 + id)).collect();
    read(folder, vehicles, &format!("swarm = 'lab'\nscenario = 'hover.toml'\n{more}\n{nodes}")).unwrap()
}

fn read(folder: &Path, vehicles: usize, text: &str) -> Result<Inventory, Error> {
    fs::write(folder.join("hover.toml"), format!("name = 'hover'\nswarm.vehicles = {vehicles}\n")).unwrap();
    let path = folder.join("cluster.toml");
    fs::write(&path, text).unwrap();
    Inventory::read(&path)
}

/// The error for this file of two nodes, without the folder's path.
fn refused(text: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let error = read(folder.path(), 2, text).map(|read| format!("{:?}", read.nodes)).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    error.to_string().replace(&format!("{}/", folder.path().display()), "")
}

const HEAD: &str = "swarm = 'lab'\nscenario = 'hover.toml'\n";

/// Like [`refused`], for a file whose first node has these lines.
fn node_refused(lines: &str) -> String {
    refused(&format!("{HEAD}[node.2]\nhost = '10.0.0.2'\n[node.1]\n{lines}\n"))
}

fn id(number: u8) -> VehicleName {
    VehicleId::new(number).unwrap().into()
}

#[test]
fn the_example_file_is_valid() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("scenarios")).unwrap();
    fs::write(folder.path().join("scenarios/hover.toml"), include_str!("../../../scenarios/hover.toml")).unwrap();
    let path = folder.path().join("cluster.toml");
    fs::write(&path, include_str!("../../../cluster.example.toml")).unwrap();
    let cluster = Inventory::read(&path).unwrap();
    assert_eq!((cluster.swarm.as_str(), cluster.scenario.first().scenario.swarm.name.as_str()), ("lab", "lab"));
    assert_eq!(cluster.scenario.first().scenario.name, "hover");
    assert_eq!(cluster.keys, folder.path().join("keys"));
    assert_eq!(cluster.scenario_folder(), folder.path().join("scenarios"));
    let endpoints: Vec<_> = cluster.nodes.values().map(|node| node.endpoint(cluster.security)).collect();
    assert_eq!(endpoints, ["tls/192.0.2.11:7447", "tls/192.0.2.12:7448", "tls/192.0.2.12:7449", "tls/192.0.2.14:7450"]);
    assert_eq!(cluster.dialled_by(id(3)), endpoints[..2]);
    let [first, _, third, fourth] = [1, 2, 3, 4].map(|number| &cluster.nodes[&id(number)]);
    assert_eq!((first.host.as_deref(), first.user.as_deref()), (Some("heli1.example"), Some("lab")));
    assert_eq!((first.plant, first.xplane.as_deref()), (PlantKind::Xplane, Some("127.0.0.1:49000")));
    assert_eq!(third.xplane.as_deref(), Some("192.0.2.23:49000"));
    assert_eq!((fourth.host.as_ref(), fourth.install), (None, Install::Manual));
    assert_eq!((fourth.folder.as_str(), fourth.service), (".skein", ServiceKind::Auto));
}

#[test]
fn a_link_local_address_is_refused_where_no_interface_can_be_known() {
    for lines in [
        "host = 'fe80::1'",
        "host = 'heli1'\naddress = 'fe80::1'",
        "host = 'heli1'\naddress = 'fe80::1%eth0'",
        "host = 'heli1'\naddress = 'febf::1'",
        "host = '10.0.0.1'\nplant = 'xplane'\nxplane = '[fe80::1]:49000'",
        "host = 'fe80::1'\naddress = '10.0.0.1'",
    ] {
        let refused = node_refused(lines);
        assert!(refused.contains("a link-local address, which each PC can dial only over an interface"), "{refused}");
    }
    let folder = tempfile::tempdir().unwrap();
    let ssh_names_it =
        format!("{HEAD}[node.1]\nhost = 'fe80::1%eth0'\naddress = 'fd00::1'\n[node.2]\nhost = '10.0.0.2'\n");
    assert!(read(folder.path(), 2, &ssh_names_it).is_ok());
}

#[test]
fn hosts_of_the_documentation_are_not_called() {
    let folder = tempfile::tempdir().unwrap();
    let called = |first: &str| {
        let text = format!("{HEAD}[node.1]\n{first}\n[node.2]\nhost = '10.0.0.2'\n");
        read(folder.path(), 2, &text).unwrap().check_hosts().map_err(|error| error.to_string())
    };
    for first in [
        "host = '192.0.2.11'",
        "host = 'heli1'\naddress = '192.0.2.11'",
        "host = 'heli1'\naddress = '198.51.100.1'",
        "host = '10.0.0.1'\nplant = 'xplane'\nxplane = '203.0.113.22:49000'",
        "host = 'heli1'\naddress = '2001:db8::11'",
        "host = 'heli1.example'\naddress = '10.0.0.1'",
        "host = 'heli1.example.com'\naddress = '10.0.0.1'",
        "host = 'heli1.invalid'\naddress = '10.0.0.1'",
        "install = 'manual'\naddress = 'heli1.EXAMPLE.net'",
    ] {
        let refused = called(first).unwrap_err();
        assert!(refused.contains("reserved for documentation") && refused.contains("put your hosts in"), "{refused}");
    }
    for first in ["host = '10.0.0.1'", "host = 'example'\naddress = '192.0.3.1'", "host = 'fd00::1'"] {
        assert_eq!(called(first), Ok(()), "{first}");
    }
}

#[test]
fn keys_of_a_node_override_the_defaults() {
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "{HEAD}security = 'none'\n[defaults]\nplant = 'standin'\nxplane = '127.0.0.1:49000'\nlog = 'debug'\nservice = 'own'\n\
         folder = '/opt/skein'\nbinary = 'bin/skein'\n[node.1]\nhost = '10.0.0.1'\n[node.2]\nhost = 'fd00::2'\n\
         plant = 'builtin'\nlog = 'info'\nservice = 'auto'\nfolder = 'elsewhere'\n"
    );
    let cluster = read(folder.path(), 2, &text).unwrap();
    let [first, second] = [1, 2].map(|number| &cluster.nodes[&id(number)]);
    assert_eq!((first.plant, first.xplane.as_deref()), (PlantKind::Standin, Some("127.0.0.1:49000")));
    assert_eq!((second.plant, second.xplane.as_ref()), (PlantKind::Builtin, None), "it has no simulator");
    assert_eq!((first.log.as_deref(), second.log.as_deref()), (Some("debug"), Some("info")));
    assert_eq!((first.service, second.service), (ServiceKind::Own, ServiceKind::Auto));
    assert_eq!((first.folder.as_str(), second.folder.as_str()), ("/opt/skein", "elsewhere"));
    assert_eq!(first.binary, Some(folder.path().join("bin/skein")));
    assert_eq!(second.endpoint(cluster.security), "tcp/[fd00::2]:7448");
}

#[test]
fn a_fault_has_a_line_and_a_remedy() {
    assert_eq!(refused("swrm = 'lab'"), "cluster.toml:1:1: unknown key `swrm`; did you mean `swarm`?");
    assert_eq!(
        node_refused("hots = 'heli1'"),
        "cluster.toml:6:1: unknown key `node.1.hots`; did you mean `node.1.host`?"
    );
    assert_eq!(
        refused(&format!("{HEAD}security = 'tsl'")),
        "cluster.toml:3:12: `security` is \"tsl\", but has to be one of \"tls\", \"none\"; did you mean \"tls\"?"
    );
    assert_eq!(refused("swarm = 7"), "cluster.toml:1:9: `swarm` has to be a text, not 7");
    assert_eq!(refused(&format!("{HEAD}[node.one]")), "cluster.toml:3:7: `node.one`: nodes are tables by id, 1 to 250");
    assert!(refused("swarm = ").starts_with("cluster.toml:1:9: not TOML: "));
    for empty in ["", "\n# nothing\n"] {
        assert!(refused(empty).starts_with("cluster.toml:1:1: this cluster file is empty; it has `swarm`"));
    }
    assert!(refused("scenario = 'hover.toml'").contains("`swarm` is missing"));
    assert!(refused("swarm = 'lab'").contains("`scenario` is missing"));
}

#[test]
fn every_vehicle_has_a_node_and_every_node_a_vehicle() {
    let one = "[node.1]\nhost = '10.0.0.1'\n";
    assert_eq!(
        refused(&format!("{HEAD}{one}")),
        "cluster.toml:3:2: `node.2` is missing: hover.toml flies vehicles 1 to 2; add a table `[node.2]` for vehicle 2"
    );
    let three = refused(&format!("{HEAD}{one}[node.2]\nhost = '10.0.0.2'\n[node.3]\nhost = '10.0.0.3'\n"));
    assert!(three.starts_with("cluster.toml:7:"), "{three}");
    assert!(three.ends_with(": `node.3` has no vehicle: hover.toml flies vehicles 1 to 2"), "{three}");
    assert!(refused(&format!("{HEAD}[node.300]\nhost = '10.0.0.1'\n")).contains("`node.300` has no vehicle"));
}

#[test]
fn a_node_needs_a_valid_host_and_address() {
    assert!(node_refused("host = 'heli1'").contains("`node.1.address` is missing: peers cannot use"));
    assert!(node_refused("address = '10.0.0.1'").contains("`node.1.host` is missing"));
    assert!(!node_refused("address = '10.0.0.1'\ninstall = 'manual'\nplant = 'x'").contains("host"));
    for host in ["-oProxyCommand=reboot", "a b", "a;b", "lab@heli1", "$(x)", "ä"] {
        let refused = node_refused(&format!("host = '{host}'\naddress = '10.0.0.1'"));
        assert!(refused.contains("`node.1.host` is"), "{host}: {refused}");
    }
    for address in ["0.0.0.0", "224.0.0.1", "10.0.0", "10.0.0.256", "10.0.0.1:7447", "-x", "a b", "a..b", ""] {
        let refused = node_refused(&format!("host = 'heli1'\naddress = '{address}'"));
        assert!(refused.contains("`node.1.address`"), "{address}: {refused}");
    }
    assert!(node_refused("host = '10.0.0.1'\nuser = '-l'").contains("`node.1.user`"));
}

#[test]
fn an_implausible_value_of_a_node_is_refused() {
    for folder in ["../x", "~/skein", "a b", "/", ".", "-rf", "a/../../b"] {
        let refused = node_refused(&format!("host = '10.0.0.1'\nfolder = '{folder}'"));
        assert!(refused.contains("`node.1.folder`"), "{folder}: {refused}");
    }
    assert!(node_refused("host = '10.0.0.1'\nlog = 'loud=='").contains("`node.1.log`"));
    assert!(node_refused("host = '10.0.0.1'\nplant = 'xplane'\nxplane = 'heli:x'").contains("`node.1.xplane`"));
    let no_simulator = node_refused("host = '10.0.0.1'\nplant = 'builtin'\nxplane = 'heli:49000'");
    assert!(no_simulator.contains("has no effect with plant"), "{no_simulator}");
}

#[test]
fn two_vehicles_do_not_fly_in_one_simulator() {
    let two = |first: &str, second: &str, xplane: &str| {
        format!(
            "{HEAD}[defaults]\nplant = 'xplane'\nxplane = '{xplane}'\n[node.1]\nhost = '{first}'\n[node.2]\nhost = '{second}'\n"
        )
    };
    let folder = tempfile::tempdir().unwrap();
    assert!(read(folder.path(), 2, &two("10.0.0.1", "10.0.0.2", "127.0.0.1:49000")).is_ok(), "each its own");
    let shared = refused(&two("10.0.0.1", "10.0.0.1", "127.0.0.1:49000"));
    assert!(shared.contains("`node.2.xplane`: vehicle 1 already flies that simulator"), "{shared}");
    assert!(refused(&two("10.0.0.1", "10.0.0.2", "10.0.0.9")).contains("vehicle 1 already flies that simulator"));
}

#[test]
fn a_fault_in_the_scenario_names_the_scenario_file() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("bad.toml"), "swarm.vehicels = 2\n").unwrap();
    let bad = read(folder.path(), 2, "swarm = 'lab'\nscenario = 'bad.toml'\n").unwrap_err().to_string();
    assert!(bad.ends_with("bad.toml:1:7: unknown key `swarm.vehicels`; did you mean `swarm.vehicles`?"), "{bad}");
    let none = refused("swarm = 'lab'\nscenario = 'no.toml'\n");
    assert!(none.starts_with("cluster.toml:2:12: `scenario`: no.toml: "), "{none}");
    let nowhere = Inventory::read(&folder.path().join("none.toml")).unwrap_err();
    assert!(nowhere.to_string().ends_with("; name a cluster file with -f CLUSTER.toml or SKEIN_CLUSTER"), "{nowhere}");
}

/// Reads a cluster that flies three teams of two, the second of three.
pub(crate) fn fleet(folder: &Path, text: &str) -> Result<Inventory, Error> {
    let scenario =
        "fleet.teams = 3\nfleet.spacing_m = 300\nswarm.vehicles = 2\n[[team]]\nids = [2]\nswarm.vehicles = 3\n";
    fs::write(folder.join("fleet.toml"), scenario).unwrap();
    let path = folder.join("cluster.toml");
    fs::write(&path, format!("swarm = 'lab'\nscenario = 'fleet.toml'\n{text}")).unwrap();
    Inventory::read(&path)
}

/// A host for each team; the agent of one vehicle of the second team runs on a host of its own.
pub(crate) const TEAMS: &str = "[team.1]\nhost = '10.0.0.1'\n[team.2]\nhost = '10.0.0.2'\n[team.3]\nhost = '10.0.0.3'\n\
                                [node.\"2/3\"]\nhost = '10.0.0.4'\nlog = 'debug'\n";

#[test]
fn the_nodes_of_a_team_share_its_table_and_have_a_row_of_ports() {
    let folder = tempfile::tempdir().unwrap();
    let cluster = fleet(folder.path(), TEAMS).unwrap();
    let nodes: Vec<String> =
        cluster.nodes.values().map(|node| format!("{} {}:{}", node.id, node.address, node.port)).collect();
    assert_eq!(
        nodes,
        [
            "1/1 10.0.0.1:7447",
            "1/2 10.0.0.1:7448",
            "2/1 10.0.0.2:7449",
            "2/2 10.0.0.2:7450",
            "2/3 10.0.0.4:7451",
            "3/1 10.0.0.3:7452",
            "3/2 10.0.0.3:7453"
        ]
    );
    let node = |name: &str| &cluster.nodes[&name.parse().unwrap()];
    assert_eq!((node("2/3").log.as_deref(), node("2/2").log.as_deref()), (Some("debug"), None));
    // Three teams 300 m apart: all may meet.
    assert_eq!(cluster.dialled_by("2/1".parse().unwrap()), ["tls/10.0.0.1:7447", "tls/10.0.0.1:7448"]);
}

#[test]
fn every_vehicle_of_a_fleet_has_a_node() {
    let refused = |text: &str| {
        let folder = tempfile::tempdir().unwrap();
        let error = fleet(folder.path(), text).map(|read| format!("{:?}", read.nodes)).unwrap_err().to_string();
        error.replace(&format!("{}/", folder.path().display()), "")
    };
    let without_third = TEAMS.replace("[team.3]\nhost = '10.0.0.3'\n", "");
    let missing = refused(&without_third);
    assert!(
        missing.contains(
            "`node.\"3/1\"` is missing: fleet.toml flies 3 teams, vehicles 1/1 to 3/2; add a table `[team.3]`"
        ),
        "{missing}"
    );
    let foreign = refused(&format!("{TEAMS}[node.\"2/4\"]\nhost = '10.0.0.5'\n"));
    assert!(foreign.starts_with("cluster.toml:12:") && foreign.contains("`node.\"2/4\"` has no vehicle"), "{foreign}");
    assert!(refused(&format!("{TEAMS}[node.2]\nhost = '10.0.0.5'\n")).contains("`node.2` has no vehicle"));
    assert!(refused(&format!("{TEAMS}[team.4]\nhost = '10.0.0.5'\n")).contains("`team.4` has no vehicles"));
    assert!(refused(&format!("{TEAMS}[team.x]\n")).contains("`team.x`: teams are tables by id, 1 to 4096"));
    assert_eq!(
        refused("[node.\"2/1\"]\nhots = 'heli1'\n"),
        "cluster.toml:4:1: unknown key `node.\"2/1\".hots`; did you mean `node.\"2/1\".host`?"
    );
    let shared = refused(&TEAMS.replace("[team.3]\n", "[team.3]\nplant = 'xplane'\nxplane = '127.0.0.1:49000'\n"));
    assert!(shared.contains("vehicle 3/1 already flies that simulator"), "{shared}");
    assert!(self::refused(&format!("{HEAD}[team.1]\nhost = '10.0.0.1'\n")).contains("`team.1` has no vehicles"));
}

#[test]
fn a_fleet_of_more_than_64_agents_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("large.toml"), "fleet.teams = 13\nswarm.vehicles = 5\n").unwrap();
    let large = read(folder.path(), 2, "swarm = 'lab'\nscenario = 'large.toml'\n").unwrap_err().to_string();
    assert!(large.contains("the fleet has 65 vehicles: fleets larger than 64 agents fly in virtual time"), "{large}");
}
