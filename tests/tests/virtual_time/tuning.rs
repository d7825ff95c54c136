//! Keys that are changed in flight, in virtual time: over a network that loses messages, with a vehicle that joins later.

use std::collections::BTreeMap;

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Verb};
use skein_common::scenario::{Source, TunableKey, load};
use skein_lab::metrics::COLLISION_M;
use skein_lab::world::World;
use skein_tests::{airborne_pairs, of_scenario};

/// Time after take-off at which the keys are set, s.
const SET_S: f64 = 80.0;

/// Four vehicles over a network that loses a fifth of all messages. Vehicle 4's agent is away when the keys are set, and
/// two settings of the radius are ordered at the same time.
fn world(seed: u64, more: &str) -> World {
    let text = format!(
        r#"
        name = "tuning"
        seed = {seed}
        swarm.vehicles = 4
        formation.radius_m = 60
        network.loss = 0.2
        [mission]
        events = [
            {{ at_s = 70, for_s = 20, fault = "kill", vehicle = 4 }},
            {{ at_s = {SET_S}, order = "set", key = "formation.radius_m", value = 45 }},
            {{ at_s = {SET_S}, order = "set", key = "formation.radius_m", value = 80 }},
            {{ at_s = {SET_S}, order = "set", key = "formation.altitude_m", value = 40 }},
            {more}
        ]
        "#
    );
    let study = of_scenario(load(&Source { name: "tuning", text: &text }, &[]).unwrap().scenario);
    World::new(&study.scenario, &study.aircraft, &study.rules).unwrap()
}

/// Distance from the centre and altitude of each vehicle, m.
fn places(world: &World) -> Vec<(VehicleId, f64, f64)> {
    let place = |(id, _, truth, _): (VehicleId, _, &skein_core::plant::GroundTruth, _)| {
        (id, truth.position.horizontal().norm(), truth.position.altitude_m())
    };
    world.all_vehicles().map(place).collect()
}

#[test]
fn a_key_set_in_flight_reaches_all_vehicles_over_a_bad_network_and_moves_the_ring_without_a_jump() {
    for seed in 1..4 {
        let mut world = world(seed, "");
        let (mut closest_m, mut accepted, mut arrived_s) = (f64::INFINITY, [0; 4], None);
        while world.t_s() < 220.0 {
            world.tick();
            closest_m = airborne_pairs(&world).into_iter().fold(closest_m, |closest_m, (.., m)| closest_m.min(m));
            for (id, event) in world.events() {
                if matches!(event, EventKind::OrderTaken(order) if matches!(order.verb, Verb::Set(_))) {
                    accepted[usize::from(id.get()) - 1] += 1;
                }
                assert!(!matches!(event, EventKind::SettingRefused(_)), "seed {seed}: {id}: {event}");
            }
            let is_there = places(&world)
                .iter()
                .all(|(_, from_m, altitude_m)| (from_m - 80.0).abs() < 4.0 && (altitude_m - 40.0).abs() < 1.0);
            if world.t_s() > SET_S && is_there {
                arrived_s.get_or_insert(world.t_s() - SET_S);
            }
        }
        let all = places(&world);
        for (id, from_m, altitude_m) in &all {
            assert!((from_m - 80.0).abs() < 4.0, "seed {seed}: vehicle {id} is {from_m:.1} m from the centre");
            assert!((altitude_m - 40.0).abs() < 1.0, "seed {seed}: vehicle {id} is at {altitude_m:.1} m");
        }
        println!("seed {seed}: on the new ring after {arrived_s:?} s, closest {closest_m:.1} m, accepted {accepted:?}");
        // All vehicles accept both keys; one that receives the smaller of the two concurrent orders first accepts two of the radius.
        assert!(accepted.iter().all(|count| (2..=3).contains(count)), "seed {seed}: {accepted:?}");
        assert!(closest_m > COLLISION_M, "seed {seed}: {closest_m} m");
        // The values move at 1 m/s: 20 m further out. A vehicle that joins late begins 10 s after the others.
        assert!(arrived_s.is_some_and(|s| s < 100.0), "seed {seed}: {arrived_s:?}");
        for (id, agent, ..) in world.vehicles() {
            let known: Vec<String> = agent.orders().settings().iter().map(|(setting, _)| setting.to_string()).collect();
            assert_eq!(known, ["formation.radius_m=80", "formation.altitude_m=40"], "seed {seed}: vehicle {id}");
        }
    }
}

/// Eight vehicles over a network that loses a fifth of all messages, and delays each by up to 80 ms.
#[test]
fn a_setting_begins_at_all_vehicles_within_the_delay_of_a_message_and_at_none_before_all_know_it() {
    let key = TunableKey::find("formation.radius_m").unwrap();
    let mut spreads_s = Vec::new();
    for seed in 0..8 {
        let text = format!(
            "name = \"begin\"\nseed = {seed}\nswarm.vehicles = 8\n[formation]\nradius_m = 60\n[network]\nloss = 0.2\n\
             delay_s = 0.04\njitter_s = 0.04\n[mission]\n\
             events = [{{ at_s = {SET_S}, order = \"set\", key = \"formation.radius_m\", value = 80 }}]"
        );
        let study = of_scenario(load(&Source { name: "begin", text: &text }, &[]).unwrap().scenario);
        let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).unwrap();
        let (mut begun_s, mut known_s): (BTreeMap<VehicleId, f64>, BTreeMap<VehicleId, f64>) = Default::default();
        while begun_s.len() < 8 {
            world.tick();
            assert!(world.t_s() < SET_S + 10.0, "seed {seed}: begun {begun_s:?}, known {known_s:?}");
            for (id, agent, ..) in world.vehicles() {
                if !agent.orders().settings().is_empty() {
                    known_s.entry(id).or_insert(world.t_s());
                }
                if agent.settings().iter().any(|setting| setting.key == key) {
                    begun_s.entry(id).or_insert(world.t_s());
                }
            }
        }
        let range = |all: &BTreeMap<VehicleId, f64>| {
            all.values().fold((f64::INFINITY, 0.0_f64), |(first, last), at_s| (first.min(*at_s), last.max(*at_s)))
        };
        let ((first_s, last_s), (first_known_s, last_known_s)) = (range(&begun_s), range(&known_s));
        println!(
            "seed {seed}: known from {:.2} to {:.2} s after the order, begun from {:.2} to {:.2} s",
            first_known_s - SET_S,
            last_known_s - SET_S,
            first_s - SET_S,
            last_s - SET_S
        );
        assert!(first_s >= last_known_s, "seed {seed}: one began before all knew it");
        spreads_s.push(last_s - first_s);
    }
    assert!(spreads_s.iter().all(|spread_s| *spread_s < 0.15), "{spreads_s:?}");
}

#[test]
fn values_that_cannot_be_flown_together_are_refused_by_the_scenario_s_check() {
    let text = |value: &str| {
        format!(
            "swarm.vehicles = 4\n[mission]\nevents = [{{ at_s = 1, order = \"set\", key = \"formation.radius_m\", value = {value} }}]"
        )
    };
    let refused = |value: &str| load(&Source { name: "x", text: &text(value) }, &[]).unwrap_err().to_string();
    assert!(refused("-3").contains("out of the range of `formation.radius_m`"), "{}", refused("-3"));
    let why = refused("15");
    assert!(why.contains("formation.radius_m=15 cannot be flown: `formation.inner_width_m` is 20"), "{why}");
    assert!(load(&Source { name: "x", text: &text("80") }, &[]).is_ok());
}
