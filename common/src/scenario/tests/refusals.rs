//! Every error of a scenario file, with its text.

use super::*;

/// The error of this file.
fn refusal(text: &str, sets: &[&str]) -> String {
    match try_load("a.toml", text, sets) {
        Err(error) => error.to_string(),
        Ok(_) => format!("accepted: {text} {sets:?}"),
    }
}

/// A file of four vehicles, with `rest` from line 5 on, in `[formation]`.
fn file_with(rest: &str) -> String {
    format!("[swarm]\nvehicles = 4\n[formation]\nradius_m = 100\n{rest}\n")
}

fn check(cases: &[(&str, &str)]) {
    for (rest, expected) in cases {
        assert_eq!(refusal(&file_with(rest), &[]), format!("a.toml:{expected}"), "{rest}");
    }
}

#[test]
fn an_empty_file_is_refused_because_the_number_of_vehicles_is_missing() {
    let missing = "`swarm.vehicles` is missing; add the number of vehicles: `[swarm]`, `vehicles = 4`";
    for text in ["", "# nothing\n", "[swarm]\n", "name = 'x'"] {
        assert_eq!(refusal(text, &[]), format!("a.toml:1:1: {missing}"), "{text:?}");
    }
    assert_eq!(refusal("name = 'x'\n\n  [swarm]\nname = 'x'", &[]), format!("a.toml:3:3: {missing}"));
    assert_eq!(refusal("", &["swarm.name=x"]), format!("a.toml:1:1: {missing}"));
}

#[test]
fn a_file_that_is_not_toml_is_refused() {
    check(&[
        ("hello", "5:6: not TOML: key with no value, expected `=`"),
        ("gamma = ", "5:9: not TOML: string values must be quoted, expected literal string"),
        ("radius_m = 3", "5:1: not TOML: duplicate key; remove one of the two"),
        ("[vehicle.3]\n[vehicle.3]", "6:10: not TOML: duplicate key; remove one of the two"),
        ("[[[", "5:3: not TOML: unquoted keys cannot be empty, expected letters, numbers, `-`, `_`"),
    ]);
}

#[test]
fn an_unknown_key_is_refused_with_the_most_similar_key() {
    check(&[
        ("raduis_m = 3", "5:1: unknown key `formation.raduis_m`; did you mean `formation.radius_m`?"),
        ("  heading = 3", "5:3: unknown key `formation.heading`; did you mean `formation.heading_deg`?"),
        ("speed_m_s = 3", "5:1: unknown key `formation.speed_m_s`; did you mean `mission.speed_m_s`?"),
        ("[formaton]", "5:2: unknown key `formaton`; did you mean `formation`?"),
        ("[vehicle.3]\naircarft = 'r22'", "6:1: unknown key `vehicle.3.aircarft`; did you mean `vehicle.3.aircraft`?"),
        (
            "qqqqqqqqqqqq = 3",
            "5:1: unknown key `formation.qqqqqqqqqqqq`; `skein files explain formation` lists the keys",
        ),
        ("\"radius_m \" = 3", "5:1: unknown key `formation.\"radius_m \"`; did you mean `formation.radius_m`?"),
        ("[\"formation.gamma\"]", "5:2: unknown key `\"formation.gamma\"`; did you mean `formation.gamma`?"),
        (
            "[mission]\nsteps = [{ hold_s = 1, formation = { raduis_m = 9 } }]",
            "6:38: unknown key `mission.steps[0].formation.raduis_m`; did you mean `mission.steps[0].formation.radius_m`?",
        ),
    ]);
    let step = |key: &str| refusal(&file_with(&format!("[mission]\nsteps = [{{ {key} = [0, 0] }}]")), &[]);
    assert!(step("path").ends_with("unknown key `mission.steps[0].path`; did you mean `mission.steps[0].path_ne_m`?"));
    for dangerous in ["waypoint", "lnad", "lamd"] {
        assert!(!step(dangerous).contains("did you mean"), "{}", step(dangerous));
    }
    let events = "events = []\nswarm.vehicles = 4";
    assert_eq!(refusal(events, &[]), "a.toml:1:1: unknown key `events`; did you mean `mission.events`?");
    let external = file_with("[mission]\nsteps = [{ hold_s = 1, formation = { external = { misses = 2 } } }]");
    let lists = "`skein files explain mission.steps[0].formation` lists the keys";
    let unknown = "unknown key `mission.steps[0].formation.external`";
    assert_eq!(refusal(&external, &[]), format!("a.toml:6:38: {unknown}; {lists}"));
    let extrnal = refusal(&external.replace("external", "extrnal"), &[]);
    assert_eq!(extrnal, format!("a.toml:6:38: unknown key `mission.steps[0].formation.extrnal`; {lists}"));
    let set = "mission.steps[0].formation.external.misses=2";
    assert_eq!(refusal(SHIPPED[2].1, &[set]), format!("--set {set}: {unknown}; {lists}"));
}

#[test]
fn a_removed_key_is_refused_at_its_position_with_the_reason() {
    let removed = "`network.state_json_hz` was removed: the state for people will be published as `summary`";
    let line = file_with("[network]\nstate_json_hz = 0");
    assert_eq!(refusal(&line, &[]), format!("a.toml:6:1: {removed}; remove the line"));
    let set = "network.state_json_hz=5";
    assert_eq!(refusal(HOVER, &[set]), format!("--set {set}: {removed}; leave this `--set` out"));
}

#[test]
fn an_unknown_key_similar_to_none_is_refused_with_all_keys_of_the_table() {
    let steps = "unknown key `mission.steps[0].qqqq`; the keys here are `name`, `centre_ne_m`, `hold_s`, `path_ne_m`, `land`, \
                 `dwell_s`, `speed_m_s`, `formation`";
    check(&[
        ("[mission]\nsteps = [{ qqqq = 1 }]", &format!("6:12: {steps}")),
        ("qqqqqqqq = 3", "5:1: unknown key `formation.qqqqqqqq`; `skein files explain formation` lists the keys"),
    ]);
}

#[test]
fn a_file_of_another_kind_is_refused_with_its_kind() {
    let cluster = "swarm = 'lab'\nscenario = 'hover.toml'\n[node.1]\nhost = 'heli1'\n";
    let it_is = "this is a cluster file, not a scenario; run `skein cluster up -f a.toml`";
    assert_eq!(refusal(cluster, &[]), format!("a.toml:1:1: {it_is}"));
    // A cluster file is recognised without a node too.
    for (text, place) in [
        ("swarm = 'lab'\nscenario = 'hover.toml'\n", "1:1"),
        ("scenario = 'hover.toml'\nsecurity = 'none'\n", "2:1"),
        ("scenario = 'hover.toml'\n[defaults]\nplant = 'standin'\n", "2:2"),
        ("scenario = 'hover.toml'\nswarm = 'lab'\n[nodes.1]\nhost = 'heli1'\n", "2:1"),
    ] {
        assert_eq!(refusal(text, &[]), format!("a.toml:{place}: {it_is}"));
    }
    let aircraft = "rotor_speed_rad_s = 170\n[trim]\nroll_stick = 0\n";
    let it_is = "this is an aircraft file, not a scenario; name it in a scenario: `swarm.aircraft = \"a\"`";
    assert_eq!(refusal(aircraft, &[]), format!("a.toml:2:2: {it_is}"));
    let agent = "scenario = 'hover.toml'\nid = 1\nlisten = []\ndial = []\n";
    let it_is = "this is an agent's file, not a scenario; run `skein agent --config a.toml`";
    assert_eq!(refusal(agent, &[]), format!("a.toml:3:1: {it_is}"));
    let of = |kind: FileKind, text: &str| {
        Written::read(&Source { name: "a.toml", text }, kind, &[]).map(drop).unwrap_err().to_string()
    };
    let it_is =
        "this is a scenario, not a cluster file; run `skein fly a.toml`, or name it in a cluster file as `scenario`";
    assert_eq!(of(FileKind::Cluster, HOVER.trim_start_matches(|c| c != '[')), format!("a.toml:1:2: {it_is}"));
    assert!(of(FileKind::Aircraft, cluster).contains("this is a cluster file, not an aircraft file; `swarm.aircraft`"));
    // A file with keys of two kinds is read as the expected kind: the foreign key is unknown.
    assert!(refusal(&format!("{HOVER}\n[trim]\n"), &[]).contains("unknown key `trim`"));
    let cluster = "swarm = 'lab'\nscenario = 'hover.toml'\nduration_s = 5\n";
    assert!(of(FileKind::Cluster, cluster).contains("unknown key"), "not a scenario: its `swarm` is a name");
}

#[test]
fn a_value_of_the_wrong_kind_is_refused() {
    check(&[
        ("gamma = 'x'", "5:9: `formation.gamma` has to be a number, not \"x\""),
        ("gamma = true", "5:9: `formation.gamma` has to be a number, not true"),
        ("gamma = [1]", "5:9: `formation.gamma` has to be a number"),
        ("gamma = { a = 1 }", "5:9: `formation.gamma` has to be a number, not a table"),
        ("gamma = 1979-05-27", "5:9: `formation.gamma` has to be a number, not 1979-05-27"),
        (
            "avoid_distance_m = 'none'",
            "5:20: `formation.avoid_distance_m` has to be a number or \"adaptive\", not \"none\"",
        ),
        ("feedforward = 1", "5:15: `formation.feedforward` has to be true or false, not 1"),
        (
            "law = 'vasarheli'",
            "5:7: `formation.law` is \"vasarheli\", but has to be one of \"ring\", \"flock\", \"olfati-saber\", \
             \"vasarhelyi\", \"virtual-structure\", \"displacement-consensus\", \"external\"; did you mean \"vasarhelyi\"?",
        ),
        ("law = 3", "5:7: `formation.law` has to be a text, not 3"),
        ("vertical = 'flat'", "5:12: `formation.vertical` is \"flat\", but has to be one of \"bands\", \"ellipsoid\""),
        ("[mission]\nsteps = []", "6:9: `mission.steps` has to be a list of one table or more, not an empty list"),
        ("[mission]\nsteps = [3]", "6:10: `mission.steps[0]` has to be a table, not 3"),
        (
            "[mission]\nsteps = [{ centre_ne_m = [0, 0, 0] }]",
            "6:26: `mission.steps[0].centre_ne_m` has to be a point, [north, east]",
        ),
        (
            "[mission]\nsteps = [{ path_ne_m = [[0, 0], [0, 'x']] }]",
            "6:37: `mission.steps[0].path_ne_m` has to be a point, [north, east], not \"x\"",
        ),
        (
            "[mission]\nsteps = [{ land = false }]",
            "6:19: `mission.steps[0].land` has to be true, or left out, not false",
        ),
        (
            "[network]\nedges = [[1, 2], [2]]",
            "6:18: `network.edges` has to be pairs of vehicle ids, sender first: [[1, 2], [2, 3]]",
        ),
        (
            "external.parameters = { a = 1979-05-27 }",
            "5:29: `formation.external.parameters.a` has to be a value that JSON can represent, not 1979-05-27",
        ),
        (
            "external.listen = '127.0.0.1:5600'",
            "5:19: `formation.external.listen` is \"127.0.0.1:5600\", but has to be tcp/HOST:PORT, PORT 1 to 65285",
        ),
    ]);
    assert_eq!(refusal("swarm = 4", &[]), "a.toml:1:9: `swarm` has to be a table, not 4");
    assert_eq!(refusal("swarm.vehicles = 4.0", &[]), "a.toml:1:18: `swarm.vehicles` has to be a whole number, not 4.0");
    let control = "swarm.vehicles = 4\ncontrol.rules = \"a\\nb\"";
    assert_eq!(refusal(control, &[]), "a.toml:2:17: `control.rules` has to be one line of text that is not empty");
}

#[test]
fn a_number_out_of_range_is_refused() {
    check(&[
        ("gamma = 0", "5:9: `formation.gamma` is 0, out of its range: 0.01 to 100"),
        ("gain_m = 0", "5:10: `formation.gain_m` is 0, out of its range: above 0, at most 1000"),
        ("altitude_m = 3", "5:14: `formation.altitude_m` is 3, out of its range: 3.5 to 10000"),
        ("gamma = nan", "5:9: nan is not a finite number"),
        ("gamma = -inf", "5:9: -inf is not a finite number"),
        ("gamma = 1e999", "5:9: 1e999 is not a finite number"),
        ("gamma = 99999999999999999999", "5:9: 99999999999999999999 is too large an integer"),
        ("external.parameters.a = [nan]", "5:26: nan is not a finite number"),
        ("[network]\nedges = [[1, 300]]", "6:14: `network.edges`: vehicle ids are 1 to 250, not 300"),
    ]);
    let vehicles = |count| refusal(&format!("swarm.vehicles = {count}"), &[]);
    assert_eq!(vehicles("0"), "a.toml:1:18: `swarm.vehicles` is 0, out of its range: 1 to 250");
    assert_eq!(vehicles("251"), "a.toml:1:18: `swarm.vehicles` is 251, out of its range: 1 to 250");
    let seed = "swarm.vehicles = 4\nseed = -1";
    assert_eq!(refusal(seed, &[]), "a.toml:2:8: `seed` is -1, out of its range: 0 to 9223372036854775807");
}

#[test]
fn a_name_that_is_not_valid_in_a_key_is_refused() {
    let name = |line: &str| refusal(&format!("swarm.vehicles = 4\n{line}"), &[]);
    let rule = "has to be 1 to 64 letters, digits, '-' or '_';";
    assert_eq!(name("swarm.name = 'a/b'"), format!("a.toml:2:14: `swarm.name` {rule} \"a/b\" is not"));
    assert_eq!(name("name = 'a b'"), format!("a.toml:2:8: `name` {rule} \"a b\" is not"));
}

#[test]
fn an_aircraft_is_named_with_or_without_its_files_ending() {
    for name in ["r22", "r22.toml"] {
        let text = format!("[swarm]\nvehicles = 2\naircraft = '{name}'\n[vehicle.2]\naircraft = 'bell.toml'");
        let scenario = try_load("a.toml", &text, &[]).unwrap().scenario;
        let aircraft: Vec<_> = scenario.vehicle.iter().map(|vehicle| vehicle.aircraft.as_str()).collect();
        assert_eq!((scenario.swarm.aircraft.as_str(), aircraft), ("r22", vec!["r22", "bell"]));
    }
    for bad in ["../r22.toml", "aircraft/r22", "r 22", ".toml", "r22.toml.toml", "r22.tml"] {
        let refusal = refusal(&format!("swarm.vehicles = 2\nswarm.aircraft = '{bad}'"), &[]);
        let expected = format!(
            "a.toml:2:18: `swarm.aircraft` names a TOML file beside this one by 1 to 64 letters, digits, '-' or '_', with or \
             without \".toml\"; \"{bad}\" does not"
        );
        assert_eq!(refusal, expected);
    }
}

#[test]
fn a_vehicle_outside_the_swarm_is_refused() {
    check(&[
        ("[vehicle.x]", "5:10: `vehicle.x`: vehicles are tables by id, 1 to 250"),
        ("[vehicle.N]", "5:10: `vehicle.N`: vehicles are tables by id, 1 to 250"),
        ("[vehicle.03]", "5:10: `vehicle.03`: vehicles are tables by id, 1 to 250"),
        ("[vehicle.5]", "5:10: `vehicle.5`: vehicle 5 is not in the swarm, which has vehicles 1 to 4"),
        ("[vehicle.0]", "5:10: `vehicle.0`: vehicle ids are 1 to 250, not 0"),
        ("[vehicle.251]", "5:10: `vehicle.251`: vehicle ids are 1 to 250, not 251"),
        ("[network]\ngraph = 'edges'", "6:9: `network.graph` = \"edges\" needs `network.edges`"),
        (
            "[network]\nedges = [[1, 2], [2, 5]]",
            "6:22: `network.edges[1][1]`: vehicle 5 is not in the swarm, which has vehicles 1 to 4",
        ),
        ("[network]\nedges = [[2, 2]]", "6:10: `network.edges[0]`: vehicle 2 cannot send to itself"),
        (
            "[network]\nlinks = [{ from = [1], loss = 0 }, { to = [3, 5], loss = 1 }]",
            "6:47: `network.links[1].to[1]`: vehicle 5 is not in the swarm, which has vehicles 1 to 4",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, fault = 'kill', vehicle = 5 }]",
            "6:49: `mission.events[0].vehicle`: vehicle 5 is not in the swarm, which has vehicles 1 to 4",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, fault = 'cut', from = [1], to = [2, 7] }]",
            "6:59: `mission.events[0].to[1]`: vehicle 7 is not in the swarm, which has vehicles 1 to 4",
        ),
    ]);
}

#[test]
fn steps_and_events_with_contradicting_keys_are_refused() {
    check(&[
        (
            "[mission]\nsteps = [{ name = 'a' }]",
            "6:10: `mission.steps[0]` needs one of `centre_ne_m`, `hold_s`, `path_ne_m`, `land`",
        ),
        (
            "[mission]\nsteps = [{ hold_s = 3, land = true }]",
            "6:24: `mission.steps[0]` takes only one of `centre_ne_m`, `hold_s`, `path_ne_m`, `land`",
        ),
        (
            "[mission]\nsteps = [{ hold_s = 3, dwell_s = 1 }]",
            "6:24: `mission.steps[0]`: `dwell_s` has no effect beside `hold_s`",
        ),
        (
            "[mission]\nsteps = [{ land = true }, { hold_s = 3 }]",
            "6:10: `mission.steps[0]`: `land` is allowed only in the last step",
        ),
        (
            "[mission]\nsteps = [{ path_ne_m = [[0, 0]] }]",
            "6:24: `mission.steps[0].path_ne_m` has to be two points or more, [[north, east], [north, east]]",
        ),
        (
            "[mission]\nsteps = [{ path_ne_m = [[0, 0], [0, 0.0]] }]",
            "6:33: `mission.steps[0].path_ne_m`: two points in a row are equal",
        ),
        ("[mission]\nevents = [{ at_s = 1 }]", "6:11: `mission.events[0]` needs one of `fault`, `order`"),
        (
            "[mission]\nevents = [{ fault = 'kill', vehicle = 3 }]",
            "6:11: `mission.events[0]`: fault = \"kill\" needs `at_s`",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, fault = 'kill' }]",
            "6:11: `mission.events[0]`: fault = \"kill\" needs `vehicle`",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, order = 'land', for_s = 2 }]",
            "6:39: `mission.events[0]`: `for_s` has no effect beside order = \"land\"",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, order = 'goto', step = 1 }]",
            "6:46: `mission.events[0].step` is 1, but the last step is 0",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, order = 'release' }]",
            "6:11: `mission.events[0]`: order = \"release\" needs `vehicles`",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, order = 'hold', vehicles = [] }]",
            "6:50: `mission.events[0].vehicles` has to be a list of vehicle ids, not an empty list",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, order = 'hold', vehicles = [1, 7] }]",
            "6:54: `mission.events[0].vehicles[1]`: vehicle 7 is not in the swarm, which has vehicles 1 to 4",
        ),
    ]);
}

#[test]
fn values_that_contradict_each_other_are_refused() {
    check(&[
        ("inner_width_m = 100", "5:17: `formation.inner_width_m` is 100, but has to be below `radius_m`, 100"),
        (
            "law = 'flock'\nouter_width_m = 120",
            "6:17: `formation.outer_width_m` is 120, but has to be below `radius_m`, 100",
        ),
        ("far_gain_m = 3", "5:14: `formation.far_gain_m` is 3, but has to be at least `gain_m`, 7"),
        ("band_step_m = 20", "5:15: the lowest of 4 bands is at 0 m, but has to be at 3.5 m at least"),
        ("vertical = 'ellipsoid'", "5:12: the ellipsoid reaches down to -70.0 m, but has to end at 5 m at least"),
        (
            "law = 'virtual-structure'\nvertical = 'ellipsoid'",
            "6:12: `formation.vertical` = \"ellipsoid\" needs law \"ring\" or \"flock\": no other law has a vertical field",
        ),
        (
            "safety_distance_m = 150",
            "4:12: 4 neighbours on this ring are 141.4 m apart, less than `formation.safety_distance_m`, 150; \
             `radius_m` = 107 is enough",
        ),
        (
            "[mission]\nsteps = [{ hold_s = 1, formation = { radius_m = 9 } }]",
            "6:49: `formation.inner_width_m` is 20, but has to be below `radius_m`, 9",
        ),
        (
            "law = 'virtual-structure'\nslots.pattern = 'list'\nslots.offsets_ne_m = [[0, 0], [20, 0]]",
            "7:22: `formation.slots.offsets_ne_m` has 2 slots for 4 vehicles",
        ),
        (
            "law = 'displacement-consensus'\nslots = { pattern = 'grid', spacing_m = 5 }",
            "6:41: two slots are 5.0 m apart, less than `formation.safety_distance_m`, 8",
        ),
        (
            "slots.spacin_m = 3",
            "5:7: unknown key `formation.slots.spacin_m`; did you mean `formation.slots.spacing_m`?",
        ),
        ("law = 'external'", "5:7: law \"external\" needs one of `command`, `listen`, `udp` in `[formation.external]`"),
        (
            "law = 'external'\nexternal = { command = ['a'], listen = 'tcp/a:1' }",
            "6:12: law \"external\" needs one of `command`, `listen`, `udp` in `[formation.external]`",
        ),
        ("external.udp.ask = 'a:5'", "5:10: `formation.external.udp` needs both `ask` and `answer`"),
        (
            "external.deadline_s = 0.5",
            "5:23: `formation.external.deadline_s` is 0.5, but may not be above `period_s`, 0.1",
        ),
        (
            "[network]\npeer_stale_s = 0.15",
            "6:16: `network.peer_stale_s` is 0.15, but has to be above `network.state_max_period_s`, 0.2: otherwise every peer is stale",
        ),
        (
            "safety_filter = 'none'\n[airspace]\nceiling_m = 90",
            "5:17: `airspace` has no effect under `formation.safety_filter` = \"none\": the safety filter keeps it; set it to \
             \"cbf\"",
        ),
        (
            "[airspace]\nfence_ne_m = [[0, 0], [0, 90], [40, 40], [90, 0]]",
            "6:14: `airspace.fence_ne_m` is not a convex polygon of three corners or more, one after the other around it: leave \
             out the corners that point inwards, or make them obstacles",
        ),
        (
            "[airspace]\nfloor_m = 60\nceiling_m = 50",
            "6:11: `airspace.floor_m` is 60, not below `airspace.ceiling_m`, which is 50",
        ),
        (
            "[airspace]\nobstacles = [{ centre_ne_m = [0, 0] }]",
            "6:14: `airspace.obstacles[0]` needs one of `radius_m`, `size_ne_m`",
        ),
        ("[airspace]\nobstacles = [{ radius_m = 3 }]", "6:14: `airspace.obstacles[0]` needs `centre_ne_m`"),
        ("[network]\nlinks = [{ loss = 0.5 }]", "6:10: `network.links[0]` does not name its links: add `from` or `to`"),
        (
            "[network]\nlinks = [{ to = [1] }]",
            "6:10: `network.links[0]` changes nothing about its links: add `loss` or another key",
        ),
        (
            "[network]\nlinks = [{ to = [1], los = 1 }]",
            "6:22: unknown key `network.links[0].los`; did you mean `network.links[0].loss`?",
        ),
        ("[network]\nlinks = [{ to = [1], loss = 2 }]", "6:29: `network.links[0].loss` is 2, out of its range: 0 to 1"),
        ("[network]\nrange_m = 50\nfade_m = 60", "7:10: `network.fade_m` is 60, but may not be above `range_m`, 50"),
        (
            "[network]\nfade_m = 60",
            "6:10: `network.fade_m` needs `network.range_m`, the distance from which on all messages are lost",
        ),
        (
            "[start]\npattern = 'as_is'",
            "6:11: `start.pattern` = \"as_is\" is for X-Plane: with another plant every vehicle needs `start_ne_m` in `[vehicle.N]`",
        ),
        ("[start]\npattern = 'ring'\nsquare_m = 10", "7:12: 4 starts on a ring 10 m wide are less than 15 m apart"),
        (
            "[vehicle]\n1.start_ne_m = [0, 0]\n2.start_ne_m = [3, 4]",
            "7:16: vehicles 1 and 2 start 5 m apart, less than `start.separation_m`, 15",
        ),
        (
            "[mission]\nevents = [{ at_s = 1, fault = 'kill_control' }]",
            "6:31: `mission.events[0]`: fault = \"kill_control\" needs `control.mode` = \"central\": this swarm has no \
             central controller",
        ),
        (
            "[control]\nmode = 'central'\n[mission]\nevents = [{ at_s = 1, fault = 'kill', vehicle = 2 }]",
            "8:31: `mission.events[0]`: fault = \"kill\" has no effect under `control.mode` = \"central\": \
             use \"kill_control\"",
        ),
        (
            "[plant]\nmodel = 'point_mass'\n[mission]\nevents = [{ at_s = 1, fault = 'gyro_off', vehicle = 2 }]",
            "8:31: `mission.events[0]`: fault = \"gyro_off\" has no effect under `plant.model` = \"point_mass\", which has no gyro",
        ),
        (
            "[world]\ngust_w20_m_s = 5\n[plant]\nmodel = 'point_mass'",
            "6:16: `world.gust_w20_m_s` has no effect under `plant.model` = \"point_mass\": a point mass holds its velocity over \
             the ground",
        ),
        (
            "[plant]\npeer_acf = 'Aircraft/heli.acf'",
            "6:12: `plant.peer_acf` has no effect without `plant.show_peers`, the number of peers that are shown",
        ),
        ("[plant]\nshow_peers = 20", "6:14: `plant.show_peers` is 20, out of its range: 0 to 19"),
        ("[plant]\nlocal_time_h = 24.5", "6:16: `plant.local_time_h` is 24.5, out of its range: 0 to 24"),
        ("[plant]\npayload_kg = -1", "6:14: `plant.payload_kg` is -1, out of its range: 0 to 10000"),
        (
            "[plant]\nmodel = 'plane'",
            "6:9: `plant.model` is \"plane\", but has to be one of \"helicopter\", \"point_mass\"",
        ),
    ]);
    let long = refusal(HOVER, &["plant.show_peers=3", &format!("plant.peer_acf={}", "a".repeat(150))]);
    assert!(long.ends_with("`plant.peer_acf` has to be at most 149 bytes long, without control characters"), "{long}");
    let standin = "--set swarm.plant=standin: `plant.model` = \"point_mass\" needs `swarm.plant` = \"builtin\": X-Plane and its \
                   stand-in fly helicopters";
    assert_eq!(refusal("swarm.vehicles = 4\nplant.model = 'point_mass'", &["swarm.plant=standin"]), standin);
    for fault in ["engine_out", "servo_stuck"] {
        let event = format!("mission.events=[{{ at_s = 1, fault = \"{fault}\", vehicle = 1 }}]");
        assert!(refusal(HOVER, &[&event, "plant.model=point_mass"]).contains("has no effect under"), "{fault}");
    }
    let survived =
        "mission.events=[{ at_s = 1, fault = 'gps_frozen', vehicle = 1 }, { at_s = 9, fault = 'kill', vehicle = 2 }]";
    loaded(HOVER, &[survived, "plant.model=point_mass"]);
    loaded(HOVER, &["control.mode=central", "plant.model=point_mass"]);
    let crowd =
        "a.toml:1:18: 120 random starts 15 m apart do not fit in a square of 150 m; `start.square_m` = 216 is enough";
    assert_eq!(refusal("swarm.vehicles = 120", &[]), crowd);
    let room = ["start.square_m=216", "formation.radius_m=153"];
    assert!(refusal("swarm.vehicles = 120", &room[..1]).ends_with("`radius_m` = 153 is enough"));
    loaded("swarm.vehicles = 120", &room);
}

#[test]
fn a_mission_with_too_many_steps_is_refused_at_the_first_one_above() {
    let step = "[[mission.steps]]\nhold_s = 1\n";
    let mission = |steps: usize| format!("swarm.vehicles = 4\n{}", step.repeat(steps));
    loaded(&mission(1000), &[]);
    let expected = "a.toml:2002:1: `mission.steps` has 1002 steps; a mission has at most 1000";
    assert_eq!(refusal(&mission(1002), &[]), expected);
}

#[test]
fn an_error_of_a_set_option_quotes_the_option_instead_of_a_line() {
    let spelling = "not the path of a key; paths look like formation.radius_m and mission.steps[0].name";
    let cases = [
        ("formation.raduis_m=50", "unknown key `formation.raduis_m`; did you mean `formation.radius_m`?"),
        ("radius_m=50", "unknown key `radius_m`; did you mean `formation.radius_m`?"),
        ("formation[0].gamma=3", "unknown key `formation[0].gamma`; did you mean `formation.gamma`?"),
        ("vehicle.x.aircraft=r22", "unknown key `vehicle.x.aircraft`; did you mean `swarm.aircraft`?"),
        ("mission.steps[N].name=x", spelling),
        ("formation.radius_m=-5", "`formation.radius_m` is -5, out of its range: above 0, at most 100000"),
        ("formation.radius_m=abc", "`formation.radius_m` has to be a number, not \"abc\""),
        ("formation.radius_m=[", "not TOML: unclosed array, expected `]`"),
        ("formation.radius_m=nan", "nan is not a finite number"),
        ("formation.radius_m=", "`formation.radius_m` has no value"),
        ("formation.radius_m", "not of the form key=value"),
        ("..=3", spelling),
        ("formation=3", "`formation` has to be a table, not 3"),
        ("swarm.name=a b", "`swarm.name` has to be 1 to 64 letters, digits, '-' or '_'; \"a b\" is not"),
        ("vehicle.9.aircraft=r22", "`vehicle.9`: vehicle 9 is not in the swarm, which has vehicles 1 to 4"),
        ("mission.steps[0].hold_s=50", "`mission.steps` has no entries in a.toml"),
        // The file's width was valid until the radius changed.
        ("formation.radius_m=15", "`formation.inner_width_m` is 20, but has to be below `radius_m`, 15"),
    ];
    for (set, expected) in cases {
        assert_eq!(refusal(&file_with("inner_width_m = 20"), &[set]), format!("--set {set}: {expected}"));
    }
    let beyond = refusal(SHIPPED[2].1, &["mission.steps[7].dwell_s=1"]);
    let expected = "`mission.steps[7]` is beyond the end: `mission.steps` has 7, counted from 0";
    assert_eq!(beyond, format!("--set mission.steps[7].dwell_s=1: {expected}"));
    assert!(
        refusal("swarm.vehicles = 0", &["swarm.vehicles=4"]).starts_with("a.toml:1:18: "),
        "the file itself is wrong"
    );
}

#[test]
fn an_error_has_its_position_and_key_as_fields() {
    let text = "swarm.vehicles = 4\r\nformation.raduis_m = 5\r\n";
    let error = try_load("my.toml", text, &[]).unwrap_err();
    assert_eq!((&*error.file, error.line, error.column), ("my.toml", Some(2), Some(11)));
    assert_eq!(error.key.as_deref(), Some("formation.raduis_m"));
    assert_eq!(error.help.as_deref(), Some("did you mean `formation.radius_m`?"));
    assert_eq!(error.span.map(|span| &text[span]), Some("raduis_m"));
    let error = try_load("my.toml", text, &["seed=x"]).unwrap_err();
    assert_eq!(error.line, Some(2));
    let error = try_load("my.toml", HOVER, &["seed=x"]).unwrap_err();
    assert_eq!((&*error.file, error.line, error.column, error.span), ("--set seed=x", None, None, None));
}

#[test]
fn columns_count_characters_and_no_byte_order_mark() {
    assert_eq!(refusal("\u{feff}x = 1", &[]), "a.toml:1:1: unknown key `x`; `skein files explain` lists the keys");
    let text = "swarm = { name = 'ä', vehicles = 4 }";
    assert_eq!(
        refusal(text, &[]),
        "a.toml:1:18: `swarm.name` has to be 1 to 64 letters, digits, '-' or '_'; \"ä\" is not"
    );
    let text = "# ä\n\"ä\" = { u = 1 }\nswarm.vehicles = 4";
    assert_eq!(refusal(text, &[]), "a.toml:2:1: unknown key `\"ä\"`; `skein files explain` lists the keys");
}
