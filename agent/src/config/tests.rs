use std::fs;

use skein_core::builtin::BuiltInPlant;
use tempfile::TempDir;

use super::*;

const SCENARIO: &str =
    "[swarm]\nvehicles = 3\n[formation]\nsafety_filter = \"none\"\n[vehicle.2]\nxplane = \"[::1]:5000\"\n";

/// Makes a folder with a scenario and a node's file of this text.
fn folder(agent: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("scenarios")).unwrap();
    fs::write(folder.path().join("scenarios/three.toml"), SCENARIO).unwrap();
    fs::write(folder.path().join("agent.toml"), agent).unwrap();
    folder
}

fn by_config(folder: &TempDir) -> AgentOptions {
    let config = Some(folder.path().join("agent.toml"));
    let (scenario, id, xplane, sets) = (None, None, None, Vec::new());
    AgentOptions { config, scenario, id, xplane, sets, child: false, flown_s: None, run: None, inputs: None }
}

fn by_scenario(folder: &TempDir, id: u8) -> AgentOptions {
    let scenario = Some(folder.path().join("scenarios/three.toml"));
    AgentOptions { config: None, scenario, id: VehicleId::new(id).ok().map(VehicleName::from), ..by_config(folder) }
}

fn address(plant: &PlantChoice) -> Option<String> {
    match plant {
        PlantChoice::BuiltIn(_) | PlantChoice::XPlane(None) => None,
        PlantChoice::Standin(address) | PlantChoice::XPlane(Some(address)) => Some(address.to_string()),
    }
}

#[test]
fn a_nodes_file_gives_its_id_plant_and_endpoints() {
    let folder = folder(
        "scenario = \"scenarios/three.toml\"\nid = 3\nlisten = [\"tcp/10.0.0.3:7449\"]\ndial = [\"tcp/10.0.0.1:7447\"]\nxplane = \"10.0.0.9\"",
    );
    let node = by_config(&folder).node().unwrap();
    assert_eq!((node.id.get(), node.scenario.swarm.vehicles), (3, 3));
    assert_eq!((node.listen, node.dial), (vec!["tcp/10.0.0.3:7449".into()], vec!["tcp/10.0.0.1:7447".into()]));
    assert_eq!((node.plant.kind().spec().name, address(&node.plant)), ("xplane", Some("10.0.0.9:49000".into())));
}

const SECURED: &str = r#"
scenario = "scenarios/three.toml"
id = 3
listen = ["tls/10.0.0.3:7449"]
dial = []
[security]
authority = "authority.pem"
certificate = "node.pem"
key = "keys/node.key"
orders = "000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1eFF"
observers = ["observer", "observer-1"]
operator = "operator.2"
[security.vehicles]
1 = { name = "vehicle-1", key = "0101010101010101010101010101010101010101010101010101010101010101" }
3 = { name = "vehicle-3.2", key = "0202020202020202020202020202020202020202020202020202020202020202" }
"#;

#[test]
fn a_nodes_file_names_its_keys_and_all_vehicles() {
    let folder = folder(SECURED);
    fs::create_dir(folder.path().join("keys")).unwrap();
    fs::write(folder.path().join("keys/node.key"), "").unwrap();
    let node = AgentOptions { run: Some(7), ..by_config(&folder) }.node().unwrap();
    let Security::Tls(tls) = &node.security else { panic!("plain") };
    assert_eq!(tls.authority, folder.path().join("authority.pem"));
    assert_eq!(tls.key, folder.path().join("keys/node.key"));
    let known: Vec<_> =
        tls.vehicles.iter().map(|(id, known)| (id.vehicle.get(), known.name.as_str(), known.key)).collect();
    assert_eq!(known, [(1, "vehicle-1", VerificationKey([1; 32])), (3, "vehicle-3.2", VerificationKey([2; 32]))]);
    assert_eq!((tls.observers.join(" ").as_str(), tls.operator.as_str()), ("observer observer-1", "operator.2"));
    let mut orders_key: [u8; 32] = std::array::from_fn(|nth| nth as u8);
    orders_key[31] = 255;
    assert_eq!((node.orders_key, node.run), (Some(VerificationKey(orders_key)), 7));
    if cfg!(unix) {
        let note = node.notes.last().unwrap();
        assert!(note.contains("keys/node.key: other users can read this key; run chmod 600 "), "{note}");
    }

    let without_run = by_config(&folder).node().unwrap_err().to_string();
    assert!(without_run.ends_with("`--run N`, the number that `skein cluster up` prints"), "{without_run}");
    assert_eq!(AgentOptions { run: Some(0), ..by_config(&folder) }.node().unwrap_err().to_string(), without_run);

    let refused = |from: &str, to: &str| {
        assert!(SECURED.contains(from));
        fs::write(folder.path().join("agent.toml"), SECURED.replace(from, to)).unwrap();
        by_config(&folder).node().unwrap_err().to_string()
    };
    let table = [
        ("1eFF", "1e", "agent.toml:10:10: `security.orders`: a public key must have 64 hexadecimal digits"),
        ("1eFF", "1eGG", "a public key must have 64 hexadecimal digits"),
        ("1eFF", "1eä", "a public key must have 64 hexadecimal digits"),
        ("0202\" }", "02\" }", "a public key must have 64 hexadecimal digits"),
        ("3 = { n", "300 = { n", "vehicle ids are 1 to 250, not 300"),
        ("orders = ", "boss = ", "unknown key `security.boss`"),
        ("key = \"keys/node.key\"\n", "", "`security.key` is missing; add it to this table"),
    ];
    for (from, to, expected) in table {
        let error = refused(from, to);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn a_run_is_a_decimal_or_hexadecimal_number() {
    assert_eq!((number("7"), number("0xfFfFfFfFfFfFfFfF"), number("0x")), (Ok(7), Ok(u64::MAX), number("x")));
    assert!(number("-1").is_err());
}

#[test]
fn an_agent_started_by_hand_dials_the_lower_ids() {
    let folder = folder("");
    let node = by_scenario(&folder, 3).node().unwrap();
    assert_eq!(node.listen, ["tcp/127.0.0.1:7449"]);
    assert_eq!(node.dial, ["tcp/127.0.0.1:7447", "tcp/127.0.0.1:7448"]);
    assert_eq!(node.plant.kind().spec().name, "builtin");
    assert!(by_scenario(&folder, 1).node().unwrap().dial.is_empty());
}

#[test]
fn an_option_overrides_the_scenarios_simulator_address() {
    let folder = folder("");
    let plant = |id, set: &str, xplane: Option<&str>| {
        let options = by_scenario(&folder, id);
        let node = AgentOptions { sets: vec![set.into()], xplane: xplane.map(Into::into), ..options }.node().unwrap();
        (node.plant.kind().spec().name, address(&node.plant))
    };
    let (standin, xplane) = ("swarm.plant=standin", "swarm.plant=xplane");
    assert_eq!(plant(3, standin, None), ("standin", Some("127.0.0.1:49020".into())));
    assert_eq!(plant(2, standin, None), ("standin", Some("[::1]:5000".into())));
    assert_eq!(plant(2, standin, Some("127.0.0.2:1")), ("standin", Some("127.0.0.2:1".into())));
    assert_eq!(plant(3, xplane, None), ("xplane", None));
    assert_eq!(plant(3, "seed=1", Some("127.0.0.2")), ("xplane", Some("127.0.0.2:49000".into())));
    assert_eq!(plant(2, "seed=1", None), ("builtin", None));
}

#[test]
fn a_point_mass_flies_in_the_built_in_plant_only() {
    let folder = folder("");
    let node = |xplane: Option<&str>| {
        let (sets, options) = (vec!["plant.model=point_mass".into()], by_scenario(&folder, 3));
        AgentOptions { sets, xplane: xplane.map(Into::into), ..options }.node()
    };
    assert!(
        matches!(node(None).unwrap().plant, PlantChoice::BuiltIn(plant) if matches!(*plant, BuiltInPlant::PointMass(_)))
    );
    let refusal = node(Some("127.0.0.2")).unwrap_err().to_string();
    assert!(
        refusal.starts_with("vehicle 3: `plant.model` = \"point_mass\" flies in the built-in plant only"),
        "{refusal}"
    );
}

#[test]
fn files_with_errors_are_refused_in_one_sentence() {
    let place = "scenario = \"scenarios/three.toml\"\n";
    let table = [
        (
            "id = 1\nspeed = 3",
            "agent.toml:3:1: unknown key `speed`; the keys here are `scenario`, `id`, `listen`, `dial`",
        ),
        ("id = 251\nlisten = []\ndial = []", "agent.toml:2:6: `id`: vehicle ids are 1 to 250, not 251"),
        ("id = 1\ndial = []", "agent.toml:1:1: `listen` is missing; add it to the file"),
        ("id = 4\nlisten = []\ndial = []", "vehicle 4 does not fly in"),
        (
            "id = 1\nlisten = []\ndial = []\nxplane = \"no such host\"",
            "\"no such host\" is not the address HOST[:PORT] of a simulator",
        ),
        ("id = \"", "agent.toml:2:"),
    ];
    for (text, expected) in table {
        let folder = folder(&(place.to_owned() + text));
        let error = by_config(&folder).node().unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{error}");
    }
    for (fleet, id, good) in [
        ("", "3", true),
        ("", "\"1/3\"", false),
        ("[fleet]\nteams = 2\n", "\"2/3\"", true),
        ("[fleet]\nteams = 2\n", "3", false),
        ("[fleet]\nteams = 2\n", "\"3/3\"", false),
    ] {
        let folder = folder(&format!("{place}id = {id}\nlisten = []\ndial = []"));
        fs::write(folder.path().join("scenarios/three.toml"), SCENARIO.to_owned() + fleet).unwrap();
        match by_config(&folder).node() {
            Ok(node) => assert!(good && node.scenario.team.is_some() != fleet.is_empty(), "{fleet}{id}"),
            Err(error) => assert!(!good && error.to_string().contains("named with its team, 3/7"), "{error}"),
        }
    }
    let error = by_config(&folder("scenario = \"x.toml\"\nid = 1\nlisten = []\ndial = []")).node().unwrap_err();
    assert!(error.to_string().starts_with("cannot read ") && error.to_string().contains("x.toml"), "{error}");
}

#[test]
fn errors_in_a_scenario_name_the_file_and_the_key() {
    let folder = folder("");
    let refused =
        |set: &str| AgentOptions { sets: vec![set.into()], ..by_scenario(&folder, 1) }.node().unwrap_err().to_string();
    let unknown = refused("formation.raduis_m=50");
    assert!(unknown.starts_with("--set formation.raduis_m=50: unknown key"), "{unknown}");
    let not_flown = refused("control.mode=central");
    assert!(not_flown.contains("three.toml") && not_flown.ends_with("is flown only in a study"), "{not_flown}");
}

#[test]
fn aircraft_and_rules_are_found_beside_the_scenario() {
    let folder = folder("");
    let path = |name: &str| folder.path().join("scenarios").join(name);
    fs::write(path("mine.toml"), Aircraft::SHIPPED[0].1).unwrap();
    fs::create_dir(path("rules")).unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/controllers");
    for axis in ["roll", "pitch", "heading"] {
        fs::copy(shipped.join(format!("{axis}.fis")), path("rules").join(format!("{axis}.fis"))).unwrap();
    }
    let of = |sets: &[&str]| {
        AgentOptions { sets: sets.iter().map(|set| (*set).to_owned()).collect(), ..by_scenario(&folder, 1) }.node()
    };
    of(&["swarm.aircraft=mine"]).unwrap();
    assert!(matches!(of(&["swarm.aircraft=yours"]), Err(ConfigError::Named(FileError::Read(..)))));
    let missing = of(&["control.rules=rules"]).unwrap_err().to_string();
    assert!(missing.contains("collective.fis"), "{missing}");
    fs::copy(shipped.join("collective.fis"), path("rules/collective.fis")).unwrap();
    of(&["control.rules=rules"]).unwrap();
    fs::write(path("rules/roll.fis"), "nonsense").unwrap();
    assert!(matches!(of(&["control.rules=rules"]), Err(ConfigError::Named(FileError::Rules(_)))));
}
