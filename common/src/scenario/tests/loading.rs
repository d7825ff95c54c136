use std::collections::BTreeSet;

use super::*;
use crate::id::VehicleId;

/// Value and origin of this key.
fn line(loaded: &Loaded, key: &str) -> (Option<String>, String) {
    let line = loaded.explain().iter().find(|line| line.key == key).unwrap_or_else(|| panic!("no {key}"));
    (line.value.clone(), line.origin.to_string())
}

#[test]
fn every_shipped_scenario_loads_under_both_presets() {
    for (name, text) in SHIPPED {
        let loaded = try_load(name, text, &[]).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(format!("{}.toml", loaded.scenario.name), name);
        assert_eq!(loaded.scenario.swarm.name.as_str(), loaded.scenario.name);
        assert!(loaded.notes.is_empty(), "{name}: {:?}", loaded.notes);
        let paper = try_load(name, text, &["preset=paper"]).unwrap_or_else(|error| panic!("{error}"));
        if name == "sinusoid.toml" {
            assert_eq!(paper.notes, ["formation.conversion in sinusoid.toml overrides the preset \"paper\""]);
        } else {
            assert!(paper.notes.is_empty(), "{name}: {:?}", paper.notes);
        }
    }
}

#[test]
fn the_tour_is_read_with_its_steps_and_events() {
    let tour = loaded(SHIPPED[2].1, &[]).scenario;
    let id = |number| VehicleId::new(number).unwrap();
    assert_eq!(tour.duration_s, Some(1800.0));
    assert_eq!((tour.network.loss, tour.network.delay_s), (0.05, 0.2));
    assert_eq!(tour.mission.steps.len(), 7);

    let [gather, gate, long, _, wait, _, land] = &tour.mission.steps[..] else { panic!("seven steps") };
    assert_eq!((gather.name.as_deref(), &gather.target), (Some("gather"), &Target::Centre([0.0, 0.0])));
    assert_eq!(gather.formation, tour.formation);
    assert_eq!(gate.formation, Formation { radius_m: 60.0, altitude_m: 50.0, ..tour.formation.clone() });
    // From [formation], not from the step before.
    assert_eq!(long.formation, Formation { gamma: 4.0, heading_deg: 45.0, ..tour.formation.clone() });
    assert_eq!(long.formation.heading_rad(), std::f64::consts::FRAC_PI_4);
    assert_eq!((gather.dwell_s, wait.dwell_s), (3.0, 20.0));
    assert_eq!(land.target, Target::Land(true));

    let cut = Fault::Cut { from: vec![id(1), id(2)], to: vec![id(3), id(4), id(5), id(6)], both_ways: true };
    let event = |at_s, for_s, what| ScriptedEvent { at_s, for_s, what };
    let expected = [
        event(60.0, Some(20.0), EventAction::Fault(Fault::Kill { vehicle: id(3) })),
        event(150.0, Some(20.0), EventAction::Fault(cut)),
        event(240.0, None, EventAction::Fault(Fault::EngineOut { vehicle: id(5) })),
        event(300.0, Some(15.0), EventAction::Order(ScriptedOrder { verb: ScriptedVerb::Hold, vehicles: None })),
    ];
    assert_eq!(tour.mission.events, expected);
}

#[test]
fn the_flock_follows_its_path_then_lands() {
    let flock = loaded(SHIPPED[1].1, &[]).scenario;
    assert_eq!(
        (flock.formation.law, flock.formation.radius_m, flock.formation.outer_width_m),
        (Law::Flock, 50.0, 10.0)
    );
    assert_eq!(flock.formation.avoidance, Avoidance::Full);
    let targets: Vec<_> = flock.mission.steps.into_iter().map(|step| step.target).collect();
    let path = vec![[0.0, 0.0], [300.0, 0.0], [300.0, 300.0], [160.0, 440.0]];
    assert_eq!(targets, [Target::Hold(40.0), Target::Path(path), Target::Land(true)]);
}

#[test]
fn the_sinusoid_has_the_parameters_of_the_acceptance_test() {
    let swinging = loaded(SHIPPED[3].1, &["formation.conversion=linear", "formation.gain_m=56"]).scenario;
    assert_eq!((swinging.formation.conversion, swinging.formation.gain_m), (Conversion::Linear, 56.0));
    let sinusoid = loaded(SHIPPED[3].1, &[]).scenario;
    let formation = &sinusoid.formation;
    assert_eq!(formation.edge_steepness_per_m, Some(2.0));
    assert_eq!(formation.avoidance, Avoidance::Full);
    assert_eq!(formation.conversion, Conversion::Nonlinear);
    assert_eq!((formation.gain_m, formation.far_gain_m, formation.gain_knee), (3.5, 56.0, 0.4));
    assert_eq!(sinusoid.sensing.position, PositionSensing::F32Latlon);
    assert_eq!(sinusoid.sensing.velocity, VelocitySensing::Differenced);
    assert_eq!(sinusoid.sensing.differenced_tau_s, 1.0);
    assert!(!sinusoid.control.auto_trim);
}

/// The documented table: default, then the paper's value where it differs.
#[test]
fn defaults_and_paper_values_are_the_documented_ones() {
    #[rustfmt::skip]
    let documented = [
        ("formation.avoid_distance_m", r#""adaptive""#, Some("100.0")),
        ("formation.avoidance", r#""tangential""#, None), ("formation.circulation", "0.0", None),
        ("formation.vertical", r#""bands""#, None), ("formation.band_step_m", "0.0", None),
        ("formation.conversion", r#""nonlinear""#, Some(r#""linear""#)),
        ("formation.gain_m", "7.0", None), ("formation.far_gain_m", "28.0", None), ("formation.gain_knee", "0.3", None),
        ("sensing.position", r#""exact""#, Some(r#""f32_latlon""#)),
        ("airspace.ceiling_m", r#""none""#, None), ("airspace.floor_m", r#""none""#, None),
        ("airspace.floor_above_ground_m", r#""none""#, None), ("airspace.margin_m", "10.0", None),
        ("world.wind_m_s", "0.0", None), ("world.wind_from_deg", "0.0", None), ("world.gust_w20_m_s", "0.0", None),
        ("swarm.plant", r#""builtin""#, None), ("swarm.aircraft", r#""xcell60""#, None),
        ("origin.latitude_deg", "28.0", None), ("origin.longitude_deg", "-82.0", None), ("origin.elevation_m", "0.0", None),
        ("mission.progress_timeout_s", "60.0", None),
        ("mission.partition", r#""continue""#, None),
        ("network.state_error_m", "0.1", None), ("network.state_error_m_s", "0.1", None),
        ("network.state_max_period_s", "0.2", None),
        ("network.loss", "0.0", None), ("network.delay_s", "0.0", None), ("network.jitter_s", "0.0", None),
        ("network.burst_s", r#""none""#, None), ("network.reorder", "0.0", None),
        ("network.duplicate", "0.0", None), ("network.bandwidth_bit_s", r#""none""#, None),
        ("network.fade_m", r#""none""#, None), ("network.queue_s", "0.2", None),
        ("network.range_m", r#""none""#, None),
        ("formation.edge_steepness_per_m", r#""from_widths""#, None),
        ("formation.safety_filter", r#""cbf""#, Some(r#""none""#)),
        ("formation.safety_distance_m", "8.0", None), ("formation.safety_rate_per_s", "0.5", None),
        ("formation.edge_share", "0.01", None), ("formation.heading_deg", "0.0", None),
        ("formation.feedforward", "true", Some("false")),
        ("control.auto_trim", "true", Some("false")), ("control.rules", r#""shipped""#, None),
        ("sensing.velocity", r#""measured""#, None), ("sensing.differenced_tau_s", "1.0", None),
        ("sensing.latency_s", "0.0", None), ("sensing.dropout", "0.0", None), ("sensing.dropout_s", r#""none""#, None),
        ("sensing.correlation_s", r#""none""#, None),
        ("sensing.noise.position_m", "0.0", None), ("sensing.noise.rate_deg_s", "0.0", None),
        ("sensing.bias.position_m", "0.0", None), ("sensing.bias.rate_deg_s", "0.0", None),
        ("plant.model", r#""helicopter""#, None), ("plant.min_frame_rate_hz", "20.0", None),
        ("plant.show_peers", "0", None), ("plant.stick_release", r#""none""#, None), ("plant.random_failures", "false", None),
        ("plant.local_time_h", r#""none""#, None), ("plant.payload_kg", r#""none""#, None), ("plant.fuel_kg", r#""none""#, None),
        ("plant.point_mass.max_speed_m_s", "10.0", None),
        ("plant.point_mass.max_climb_m_s", "2.5", None), ("plant.point_mass.max_acceleration_m_s2", "3.0", None),
        ("plant.point_mass.lag_s", "1.0", None), ("plant.point_mass.max_turn_deg_s", "60.0", None),
        ("plant.point_mass.turn_lag_s", "0.2", None),
        ("swarm.trim_error_rms_deg", "0.3", None),
        ("start.pattern", r#""random""#, None), ("start.square_m", "150.0", None), ("start.separation_m", "15.0", None),
        ("mission.speed_m_s", "2.0", Some("1.0")), ("mission.dwell_s", "3.0", None),
        ("network.peer_stale_s", "2.0", None), ("network.graph", r#""all""#, None),
        ("record.runs", r#""worst-and-median""#, None), ("record.hz", r#""auto""#, None), ("record.inputs", "false", None),
        ("control.mode", r#""each""#, None),
        ("formation.external.period_s", "0.1", None), ("formation.external.deadline_s", "0.05", None),
        ("formation.external.fallback", r#""ring""#, None), ("formation.external.misses", "3", None),
        ("formation.external.max_speed_m_s", "5.0", None), ("seed", "1", None),
    ];
    let (default, paper) = (loaded(HOVER, &[]), loaded(HOVER, &["preset=paper"]));
    for (key, ours, theirs) in documented {
        assert_eq!(line(&default, key), (Some(ours.to_owned()), "default".to_owned()), "{key}");
        let origin = if theirs.is_some() { "preset" } else { "default" };
        assert_eq!(line(&paper, key), (Some(theirs.unwrap_or(ours).to_owned()), origin.to_owned()), "{key} on paper");
    }
    let differing: Vec<_> = KEYS.iter().filter(|key| key.paper.is_some()).map(|key| key.path).collect();
    let listed: Vec<_> = documented.iter().filter(|(.., theirs)| theirs.is_some()).map(|(key, ..)| *key).collect();
    assert_eq!(differing.iter().collect::<BTreeSet<_>>(), listed.iter().collect::<BTreeSet<_>>());

    let sent = |loaded: &Loaded| line(loaded, "network.send");
    assert_eq!(sent(&default), (Some("\"on_need\"".to_owned()), "default".to_owned()));
    assert_eq!(sent(&paper), (Some("\"every_frame\"".to_owned()), "from sensing.position".to_owned()));
    assert_eq!((default.scenario.record.hz.in_study_hz(), default.scenario.record.hz.live_hz()), (10.0, 50.0));
}

#[test]
fn a_flock_avoids_at_20_m_under_both_presets() {
    for sets in [&["formation.law=flock"][..], &["formation.law=flock", "preset=paper"]] {
        let formation = loaded("swarm.vehicles = 4", sets).scenario.formation;
        assert_eq!(formation.avoid_distance_m, AvoidDistance::Fixed(20.0));
        assert_eq!((formation.radius_m, formation.outer_width_m), (50.0, 10.0));
    }
    assert_eq!(loaded("swarm.vehicles = 4", &[]).scenario.formation.radius_m, 100.0);
}

#[test]
fn set_options_override_the_file_which_overrides_preset_and_default() {
    let gain = |text: &str, sets: &[&str]| {
        let loaded = loaded(&format!("swarm.vehicles = 4\n{text}"), sets);
        (line(&loaded, "mission.speed_m_s"), loaded.scenario.mission.speed_m_s)
    };
    let expected = |value: &str, origin: &str, number: f64| ((Some(value.to_owned()), origin.to_owned()), number);
    assert_eq!(gain("", &[]), expected("2.0", "default", 2.0));
    assert_eq!(gain("preset = 'paper'", &[]), expected("1.0", "preset", 1.0));
    assert_eq!(gain("mission.speed_m_s = 3\npreset = 'paper'", &[]), expected("3.0", "a.toml:2", 3.0));
    let sets = ["mission.speed_m_s=5", "mission.speed_m_s = 4"];
    assert_eq!(gain("preset = 'paper'\nmission.speed_m_s = 3", &sets), expected("4.0", "--set", 4.0));
}

#[test]
fn notes_name_the_keys_of_the_file_that_override_the_preset() {
    let text = "preset = 'paper'\nswarm.vehicles = 4\n[formation]\nconversion = 'nonlinear'\nfeedforward = false\n";
    let paper = try_load("hover.toml", text, &["control.auto_trim=true"]).unwrap();
    assert_eq!(paper.notes, ["formation.conversion in hover.toml overrides the preset \"paper\""]);
    assert!(loaded(text, &["formation.conversion=linear"]).notes.is_empty());
    assert!(loaded(text, &["preset=default"]).notes.is_empty());
}

#[test]
fn rounded_positions_are_sent_every_frame_unless_the_file_sets_network_send() {
    let send = |sets: &[&str]| loaded(HOVER, sets).scenario.network.send;
    assert_eq!(send(&["sensing.position=f32_latlon"]), SendMode::EveryFrame);
    assert_eq!(send(&["sensing.position=f32_latlon", "network.send=on_need"]), SendMode::OnNeed);
    assert_eq!(send(&["preset=paper", "sensing.position=exact"]), SendMode::OnNeed);
}

#[test]
fn set_options_change_list_entries_and_make_tables() {
    let sets = ["mission.steps[1].formation.radius_m=50", "vehicle.3.aircraft=r22", "mission.events[1].to[3]=4"];
    let loaded = loaded(SHIPPED[2].1, &sets);
    let tour = &loaded.scenario;
    assert_eq!((tour.mission.steps[1].formation.radius_m, tour.mission.steps[1].formation.altitude_m), (50.0, 50.0));
    let aircraft: Vec<_> = tour.vehicle.iter().map(|vehicle| vehicle.aircraft.as_str()).collect();
    assert_eq!(aircraft, ["xcell60", "xcell60", "r22", "xcell60", "xcell60", "xcell60"]);
    assert_eq!(line(&loaded, "mission.steps[1]").1, "--set");
    assert_eq!(line(&loaded, "mission.steps[2]").1, "a.toml:17");
    assert_eq!(line(&loaded, "vehicle.3.aircraft"), (Some("\"r22\"".to_owned()), "--set".to_owned()));
}

#[test]
fn a_step_with_another_law_has_the_defaults_of_that_law() {
    let text = "swarm.vehicles = 4\nformation.outer_width_m = 15\nmission.steps = [{ hold_s = 1, formation = { law = 'flock' } },\n\
                { hold_s = 1, formation = { law = 'flock', avoid_distance_m = 30 } }, { hold_s = 1 }]";
    let first = loaded(text, &[]);
    let again = loaded(&first.to_toml(), &[]);
    assert_eq!(again.scenario, first.scenario);
    let formation = |step: usize| &first.scenario.mission.steps[step].formation;
    assert_eq!(formation(2), &first.scenario.formation);
    assert_eq!(
        (formation(0).radius_m, formation(0).outer_width_m),
        (50.0, 15.0),
        "the file's value applies in every step"
    );
    assert_eq!(formation(0).avoid_distance_m, AvoidDistance::Fixed(20.0));
    assert_eq!(formation(1).avoid_distance_m, AvoidDistance::Fixed(30.0));
    assert_eq!((formation(2).radius_m, formation(2).avoid_distance_m), (100.0, AvoidDistance::Adaptive));
}

#[test]
fn a_text_such_as_none_unsets_a_value_of_the_file() {
    let sets = ["duration_s=none", "formation.edge_steepness_per_m=from_widths", "formation.avoid_distance_m=adaptive"];
    let scenario = loaded(SHIPPED[3].1, &sets).scenario;
    assert_eq!((scenario.duration_s, scenario.formation.edge_steepness_per_m), (None, None));
    assert_eq!(scenario.formation.avoid_distance_m, AvoidDistance::Adaptive);
}

#[test]
fn a_vehicle_has_settings_of_its_own() {
    let text = "swarm.vehicles = 2\n[vehicle.2]\nstart_ne_m = [30, -40]\nheading_deg = 90\nxplane = '10.0.0.2:49000'\n";
    let scenario = loaded(text, &[]).scenario;
    let [first, second] = &scenario.vehicle[..] else { panic!("two vehicles") };
    assert_eq!((first.start_ne_m, first.heading_rad()), (None, None));
    assert_eq!(second.start_ne_m, Some([30.0, -40.0]));
    assert_eq!(second.heading_rad(), Some(std::f64::consts::FRAC_PI_2));
    assert_eq!(scenario.vehicle(second.id), Some(second));
    assert_eq!(scenario.ids().collect::<Vec<_>>(), [first.id, second.id]);
}

#[test]
fn one_vehicle_has_a_list_of_one_slot() {
    let list = "swarm.vehicles = 1\nformation = { law = 'virtual-structure', slots = { pattern = 'list', offsets_ne_m = [[3, 4]] } }";
    assert_eq!(loaded(list, &[]).scenario.formation.slots.offsets_ne_m, Some(vec![[3.0, 4.0]]));
}

#[test]
fn an_external_law_has_its_table() {
    let text = "swarm.vehicles = 2\nformation.law = 'external'\n[formation.external]\n\
                udp = { ask = '127.0.0.1:5700', answer = '127.0.0.1:5800' }\nparameters = { gain = 0.3, n = [1, 'a'] }\n";
    let loaded = loaded(text, &["formation.external.parameters.gain=0.5"]);
    let external = &loaded.scenario.formation.external;
    assert_eq!(external.udp.as_ref().map(|udp| udp.answer.as_str()), Some("127.0.0.1:5800"));
    assert_eq!(external.parameters["gain"].as_float(), Some(0.5));
    assert_eq!(external.parameters["n"].as_array().map(Vec::len), Some(2));
}

#[test]
fn a_step_changes_single_parameters_of_a_law_and_keeps_the_rest() {
    let text = "swarm.vehicles = 3\n[formation]\nlaw = 'virtual-structure'\nslots.spacing_m = 12\n[mission]\n\
                steps = [{ hold_s = 1 }, { centre_ne_m = [0, 0], formation = { slots = { pattern = 'v' } } }]\n";
    let scenario = loaded(text, &["formation.vasarhelyi.repulsion_per_s=0.2"]).scenario;
    let [first, second] = [0, 1].map(|step| scenario.mission.steps[step].formation.clone());
    assert_eq!((first.slots.pattern, second.slots.pattern), (Pattern::Circle, Pattern::V));
    assert_eq!((second.slots.spacing_m, second.vasarhelyi.repulsion_per_s), (12.0, 0.2));
    let set = loaded(text, &["mission.steps[1].formation.slots.spacing_m=30"]).scenario;
    assert_eq!(set.mission.steps[1].formation.slots.spacing_m, 30.0);
    assert_eq!(set.mission.steps[0].formation.slots.spacing_m, 12.0);
}

/// With every key written, the types and the table have the same paths.
#[test]
fn the_table_and_the_types_have_the_same_keys() {
    let text = "duration_s = 5\nswarm.vehicles = 2\nplant = { show_peers = 1, peer_acf = 'a.acf', stick_release = 0.5, local_time_h = 0, payload_kg = 9, fuel_kg = 9 }\nsensing = { correlation_s = 9, dropout_s = 1 }\n\
        [airspace]\nfence_ne_m = [[-500, -500], [-500, 500], [500, 0]]\nceiling_m = 90\nfloor_m = 5\nfloor_above_ground_m = 6\n\
        obstacles = [{ centre_ne_m = [0, 300], radius_m = 9, top_m = 50 }, { centre_ne_m = [0, 300], size_ne_m = [9, 9] }]\n[network]\nedges = [[1, 2]]\nrange_m = 9\n\
        fade_m = 5\nburst_s = 1\nbandwidth_bit_s = 1e6\nlinks = [{ from = [1], to = [2], both_ways = true, loss = 0.1,\n\
        burst_s = 1, delay_s = 1, jitter_s = 1, reorder = 0.1, reorder_s = 1, duplicate = 0.1, bandwidth_bit_s = 1, queue_s = 1 }]\n\
        [formation]\nedge_steepness_per_m = 1\nslots.offsets_ne_m = [[0, 0], [9, 9]]\n\
        [formation.external]\ncommand = ['a']\nlisten = 'tcp/a:1'\nudp = { ask = 'a:1', answer = 'a:2' }\n\
        [vehicle.1]\nstart_ne_m = [99, 0]\nheading_deg = 0\nxplane = 'a:1'\nweb = 'a:2'\n\
        [mission]\nsteps = [{ name = 'a', centre_ne_m = [0, 0] }, { hold_s = 1 }, { path_ne_m = [[0, 0], [1, 1]] }, { land = true }]\n\
        events = [{ at_s = 1, for_s = 1, fault = 'kill', vehicle = 1 }, { at_s = 1, fault = 'cut', from = [1], to = [2] },\n\
        { at_s = 1, fault = 'delay', from = [1], to = [2], delay_s = 1 },\n\
        { at_s = 1, fault = 'servo_stuck', vehicle = 1 }, { at_s = 1, fault = 'clock_jump', vehicle = 1 },\n\
        { at_s = 1, order = 'goto', step = 1, vehicles = [1] },\n\
        { at_s = 1, order = 'set', key = 'formation.gain_m', value = 8 }]\n";
    let scenario = loaded(text, &[]).scenario;
    let mut paths = BTreeSet::new();
    collect(&toml::Value::try_from(&scenario).unwrap(), "", &mut paths);
    let in_step = |path: &String| path.starts_with("mission.steps[N].formation.") || path == "vehicle.N.id";
    paths.retain(|path| !in_step(path));
    // A list of tables appears as the keys of its entries.
    let plain = KEYS.iter().filter(|key| !matches!(key.kind, Kind::Tables));
    let keys: BTreeSet<_> = plain.map(|key| key.path.to_owned()).collect();
    assert_eq!(paths, keys);

    let read_back: Scenario = toml::Value::try_from(&scenario).unwrap().try_into().unwrap();
    assert_eq!(read_back, scenario);
}

/// Paths of all values, spelled as in the table.
fn collect(value: &toml::Value, path: &str, paths: &mut BTreeSet<String>) {
    let is_free = path.ends_with(".parameters");
    match value {
        toml::Value::Table(table) if !is_free => table.iter().for_each(|(name, inner)| {
            collect(inner, &if path.is_empty() { name.clone() } else { format!("{path}.{name}") }, paths);
        }),
        toml::Value::Array(items) if path == "vehicle" => {
            items.iter().for_each(|item| collect(item, "vehicle.N", paths));
        }
        toml::Value::Array(items) if items.iter().all(toml::Value::is_table) => {
            items.iter().for_each(|item| collect(item, &format!("{path}[N]"), paths));
        }
        _ => drop(paths.insert(path.to_owned())),
    }
}

/// The types accept every choice of the table.
#[test]
fn every_choice_of_every_key_loads() {
    for key in KEYS.iter().filter(|key| !key.path.contains('N')) {
        let Kind::OneOf(choices) = key.kind else { continue };
        for choice in choices {
            // Keys that some of the choices require.
            let plant = if key.path == "plant.model" { "builtin" } else { "xplane" };
            let text = format!(
                "swarm.vehicles = 2\nswarm.plant = '{plant}'\nnetwork.edges = [[1, 2]]\n\
                 formation.external.command = ['a']\nformation.gamma_z = 25\n"
            );
            let loaded = loaded(&text, &[&format!("{}={choice}", key.path)]);
            assert_eq!(line(&loaded, key.path).0, Some(format!("{choice:?}")));
        }
    }
}

#[test]
fn every_default_passes_its_own_check() {
    for key in KEYS.iter().filter(|key| !key.path.contains('N') && key.path != "mission.steps") {
        for literal in [Some(key.default), key.paper, key.flock].into_iter().flatten() {
            let value = match literal {
                Literal::Required | Literal::Nothing | Literal::Same(_) => continue,
                Literal::Number(number) => number.to_string(),
                Literal::Integer(number) => number.to_string(),
                Literal::Bool(truth) => truth.to_string(),
                Literal::Text(text) => text.to_owned(),
                Literal::Toml(text) => text.to_owned(),
            };
            loaded("swarm.vehicles = 2", &[&format!("{}={value}", key.path)]);
        }
    }
}

#[test]
fn every_key_has_a_meaning_and_one_unit() {
    for key in KEYS {
        let is_short = ["name", "mission.steps[N].name"].contains(&key.path);
        let length = key.about.split_whitespace().count();
        assert!((if is_short { 2 } else { 3 }..=30).contains(&length), "{}: {}", key.path, key.about);
        assert!(!key.about.contains("  ") && !key.about.ends_with('.'), "{}: {}", key.path, key.about);
        let units = usize::from(key.own_unit.is_some()) + usize::from(split_unit(key.name()).is_some());
        assert_eq!(units, usize::from(key.kind.has_numbers()), "{}: one unit, in the name or beside it", key.path);
    }
    let unit = |path: &str| KEYS.iter().find(|key| key.path == path).and_then(Key::unit);
    assert_eq!(unit("network.bandwidth_bit_s"), Some("bit/s"));
    assert_eq!(unit("formation.olfati_saber.c1_per_s2"), Some("1/s²"));
    assert_eq!(unit("formation.vasarhelyi.friction_m_s2"), Some("m/s²"));
    assert_eq!((unit("sensing.noise.rate_deg_s"), unit("sensing.noise.heading_deg")), (Some("°/s"), Some("°")));
    assert_eq!((unit("record.hz"), unit("formation.gamma"), unit("formation.law")), (Some("Hz"), Some("1"), None));
}

#[test]
fn a_default_of_the_paper_preset_may_depend_on_another_key() {
    let on_paper = |path: &str| KEYS.iter().find(|key| key.path == path).and_then(Key::on_paper);
    assert_eq!(on_paper("network.send"), Some(Literal::Text("every_frame")));
    assert_eq!(on_paper("formation.conversion"), Some(Literal::Text("linear")));
    assert_eq!(on_paper("formation.radius_m"), None);
}

#[test]
fn the_plan_hash_depends_on_values_and_not_on_their_spelling() {
    let hash = |text: &str, sets: &[&str]| loaded(text, sets).scenario.plan_hash();
    let hover = hash(HOVER, &[]);
    let pinned = [
        0xf379_66ca_a9aa_668e,
        0x200d_3f62_baf7_c0d2,
        0xcf41_d36c_db4d_448d,
        0xb83b_e239_da5e_8fd2,
        0x23d0_a50a_c675_d6b7,
        0x4891_f467_f092_8b41,
    ];
    assert_eq!(SHIPPED.map(|(_, text)| hash(text, &[])), pinned);
    assert_eq!(hash(&HOVER.replace('\n', "\r\n"), &[]), hover);
    assert_eq!(hash(&format!("\u{feff}# a comment\n{HOVER}"), &[]), hover);
    assert_eq!(hash(&HOVER.replace("radius_m = 100 ", "radius_m = 1e2"), &[]), hover);
    assert_eq!(hash(&loaded(HOVER, &[]).to_toml(), &[]), hover);
    for same in ["name=x", "seed=2", "duration_s=9", "world.wind_m_s=3", "formation.external.command=['a']"] {
        assert_eq!(hash(HOVER, &[same]), hover, "{same}");
    }
    for other in [
        "formation.radius_m=101",
        "swarm.vehicles=5",
        "mission.dwell_s=4",
        "mission.partition=quorum",
        "origin.latitude_deg=29",
        "mission.steps=[{hold_s=1}]",
        "airspace.ceiling_m=90",
        "formation.external.parameters.a=1",
    ] {
        assert_ne!(hash(HOVER, &[other]), hover, "{other}");
    }
}

#[test]
fn a_set_option_can_remove_all_events() {
    let text = "swarm.vehicles = 2\n[mission]\nevents = [{ at_s = 5, order = \"hold\" }]\n";
    let source = Source { name: "x.toml", text };
    assert_eq!(load(&source, &[]).unwrap().scenario.mission.events.len(), 1);
    assert!(load(&source, &["mission.events=[]".to_owned()]).unwrap().scenario.mission.events.is_empty());
}
