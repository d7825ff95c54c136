//! Swarms in virtual time over a network with all impairments at once.

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, PeerAge, Trace, encode};
use skein_common::scenario::Scenario;
use skein_common::state::{Membership, PeerStatus};
use skein_core::agent::Agent;
use skein_lab::faults::InjectedFault;
use skein_lab::metrics::Report;
use skein_lab::world::World;
use skein_tests::{of_scenario, scenario, study};

/// All impairments at once, and clocks that all differ.
const ALL: [&str; 16] = [
    "network.loss=0.2",
    "network.burst_s=0.3",
    "network.delay_s=0.1",
    "network.jitter_s=0.3",
    "network.reorder=0.1",
    "network.reorder_s=0.5",
    "network.duplicate=0.1",
    "network.bandwidth_bit_s=200000",
    "network.queue_s=0.3",
    "network.range_m=400",
    "network.fade_m=150",
    "network.graph=nearest",
    "network.neighbours=3",
    "network.links=[{ from = [2], to = [1, 3], both_ways = true, loss = 0.4, delay_s = 0.2 }]",
    "vehicle.1={ clock_offset_s = -7200, clock_drift_ppm = 100 }",
    "vehicle.3={ clock_offset_s = 86400, clock_drift_ppm = -100 }",
];

fn world(scenario: &Scenario) -> World {
    let study = of_scenario(scenario.clone());
    World::new(&study.scenario, &study.aircraft, &study.rules).unwrap()
}

/// The traces of all agents in the last tick, as bytes.
fn bytes(world: &mut World) -> Vec<Vec<u8>> {
    world.traces().map(|trace| encode(&trace)).collect()
}

#[test]
fn a_flight_with_all_impairments_is_repeatable_bit_for_bit() {
    let tour = scenario("tour.toml", &[&ALL[..], &["seed=3"]].concat());
    let (mut one, mut other) = (world(&tour), world(&tour));
    for tick in 0..6_000 {
        one.tick();
        other.tick();
        assert_eq!(bytes(&mut one), bytes(&mut other), "tick {tick}");
        assert!(one.events().eq(other.events()));
    }
}

#[test]
fn duplicate_messages_change_no_decision() {
    let sets = ["network.loss=0.1", "network.burst_s=0.2", "network.jitter_s=0.4", "network.reorder=0.1"];
    let with = |share: &str| world(&scenario("tour.toml", &[&sets[..], &[share]].concat()));
    let (mut once, mut twice) = (with("network.duplicate=0"), with("network.duplicate=0.5"));
    let old = |world: &World| world.vehicles().map(|(_, agent, ..)| agent.drops().old).sum::<u64>();
    for tick in 0..6_000 {
        once.tick();
        twice.tick();
        if tick % 10 == 0 {
            assert_eq!(bytes(&mut once), bytes(&mut twice), "tick {tick}");
        }
        assert!(once.events().eq(twice.events()));
    }
    assert!(old(&twice) > old(&once) + 1_000, "{} and {} messages were dropped", old(&once), old(&twice));
}

#[test]
fn wrong_clocks_change_the_figures_hardly() {
    let clocks = [
        "vehicle.1={ clock_offset_s = -10800, clock_drift_ppm = 100 }",
        "vehicle.2={ clock_offset_s = 7200, clock_drift_ppm = -100 }",
        "vehicle.4={ clock_offset_s = 86400.5, clock_drift_ppm = -50 }",
    ];
    let duration = ["duration_s=200"];
    let fly = |sets: &[&str]| study("hover.toml", &[&duration[..], sets].concat()).fly(1).unwrap();
    let (right, wrong) = (fly(&[]), fly(&clocks));
    let near = |name: &str, figure: fn(&Report) -> Option<f64>, bound: f64| {
        let (right, wrong) = (figure(&right).unwrap(), figure(&wrong).unwrap());
        assert!((right - wrong).abs() <= bound, "{name}: {right} with right clocks, {wrong} with wrong ones");
    };
    near("in_band_s", |report| report.in_band_s, 0.04);
    near("even_10deg_s", |report| report.even_10deg_s, 0.1);
    near("even_5deg_s", |report| report.even_5deg_s, 0.1);
    near("radial_rms_m", |report| report.radial_rms_m, 1e-3);
    near("spacing_error_deg", |report| report.spacing_error_deg, 1e-2);
    near("min_separation_m", |report| report.min_separation_m, 0.01);
    near("peer_age_p99_ms", |report| report.peer_age_p99_ms, 1.0);
    let messages = [&right, &wrong].map(|report| report.state_messages as f64);
    assert!((messages[0] / messages[1] - 1.0).abs() < 0.01, "{messages:?}");
    assert_eq!(wrong.false_suspicions, Some(0));
}

/// Delivery delays of the newest state of each peer, s, in all traces of a hover flight: one list for each receiver.
fn delivered_ages(sets: &[&str]) -> Vec<Vec<(VehicleId, f64)>> {
    let mut world = world(&scenario("hover.toml", sets));
    let mut ages = vec![Vec::new(); 4];
    for _ in 0..2_000 {
        world.tick();
        for Trace { header, peers, .. } in world.traces() {
            let its = peers.iter().map(|peer| (peer.id, peer.delivered_age_s));
            ages[usize::from(header.sender.get()) - 1].extend(its);
        }
    }
    ages
}

#[test]
fn a_trace_has_the_exact_delivery_delay_of_each_peers_state() {
    assert!(delivered_ages(&[]).iter().flatten().all(|(_, age_s)| *age_s == 0.0));
    let exact = delivered_ages(&["network.delay_s=0.15"]);
    assert!(exact.iter().all(|ages| ages.len() > 5_000));
    assert!(exact.iter().flatten().all(|(_, age_s)| (age_s - 0.15).abs() < 1e-9));
    let link = "network.links=[{ from = [2], to = [3], delay_s = 0.75 }]";
    let ages = delivered_ages(&["network.delay_s=0.1", "network.jitter_s=0.2", link]);
    for (receiver, ages) in (1..).zip(&ages) {
        for (sender, age_s) in ages {
            let is_slow = (sender.get(), receiver) == (2, 3);
            let least_s = if is_slow { 0.75 } else { 0.1 };
            assert!((least_s..least_s + 0.2).contains(age_s), "{receiver} of {sender}: {age_s} s");
        }
    }
}

#[test]
fn a_delay_that_begins_in_flight_is_in_the_ages_from_its_first_message_on() {
    let event = "mission.events=[{ at_s = 20, fault = 'delay', from = [1, 2, 3], to = [4], both_ways = true, \
                 delay_s = 0.6, for_s = 15 }]";
    let mut world = world(&scenario("hover.toml", &["record.hz=50", event]));
    while !world.all_active() {
        world.tick();
    }
    let zero_s = world.t_s();
    let is_delayed = |one: VehicleId, other: VehicleId| (one.get() == 4) != (other.get() == 4);
    let (mut faults, mut late) = (Vec::new(), 0);
    while world.t_s() < zero_s + 50.0 {
        world.tick();
        let t_s = world.t_s() - zero_s;
        faults.extend(world.faults().iter().map(|fault| (t_s, fault.clone())));
        assert!(!world.events().any(|(_, what)| matches!(what, EventKind::PeerLost(_))), "{t_s} s");
        for Trace { header, peers, .. } in world.traces() {
            for peer in peers {
                let PeerAge { id, age_s, delivered_age_s, .. } = peer;
                // The measured age is never below the exact delay, which only the simulated network knows.
                assert!(
                    age_s >= delivered_age_s - 1e-9,
                    "{t_s} s, {} of {id}: {age_s}, {delivered_age_s}",
                    header.sender
                );
                late += u32::from(delivered_age_s > 0.59);
                let bounds_s = match t_s {
                    // The vehicles take off at slightly different times, and each counts from its own.
                    21.5..34.0 if is_delayed(header.sender, id) => 0.6..1.8,
                    21.5..34.0 | ..19.0 | 40.0.. => 0.0..0.4,
                    _ => continue,
                };
                assert!(bounds_s.contains(&age_s), "{t_s} s, {} of {id}: {age_s} s", header.sender);
            }
        }
    }
    assert!(late > 6 * 700, "{late} ages with the delay in them");
    let all_s = |is: fn(&InjectedFault) -> bool| {
        faults.iter().filter(|(_, fault)| is(fault)).map(|(t_s, _)| *t_s).collect::<Vec<_>>()
    };
    let (begins_s, ends_s) = (
        all_s(|fault| matches!(fault, InjectedFault::Delayed { .. })),
        all_s(|fault| matches!(fault, InjectedFault::DelayOver { .. })),
    );
    assert!(!begins_s.is_empty() && begins_s.iter().all(|t_s| (19.0..20.1).contains(t_s)), "{begins_s:?}");
    assert!(!ends_s.is_empty() && ends_s.iter().all(|t_s| (34.0..35.1).contains(t_s)), "{ends_s:?}");
}

#[test]
fn ages_include_the_delay_and_neither_delay_nor_clock_jumps_lose_a_vehicle() {
    let jumps = "mission.events=[{ at_s = 15, fault = 'clock_jump', vehicle = 2, by_s = 3600 }, \
                 { at_s = 20, fault = 'clock_jump', vehicle = 3, by_s = -100000 }]";
    let mut world = world(&scenario("hover.toml", &["network.delay_s=2", jumps]));
    let mut ages_s = Vec::new();
    while world.t_s() < 60.0 {
        world.tick();
        // After a round trip and one echo to each of the three peers.
        if world.t_s() > 6.0 {
            let peers: Vec<_> = world.traces().flat_map(|trace| trace.peers).collect();
            assert!(peers.iter().all(|peer| peer.standing == PeerStatus::Stale), "{} s: {peers:?}", world.t_s());
            ages_s.extend(peers.iter().map(|peer| peer.age_s));
        }
    }
    assert!(ages_s.len() > 30_000, "{}", ages_s.len());
    let [least_s, most_s] =
        [f64::min as fn(f64, f64) -> f64, f64::max].map(|of| ages_s.iter().copied().reduce(of).unwrap());
    assert!(least_s >= 4.0 && most_s < 4.4, "the round trip, and at most 0.2 s of silence: {least_s} to {most_s}");
}

#[test]
fn with_few_neighbours_no_peer_is_lost_and_all_agree_on_the_mission() {
    for graph in [
        &["network.graph=nearest", "network.neighbours=2"][..],
        &["network.graph=edges", "network.edges=[[1,2],[2,3],[3,4],[4,5],[5,6],[6,1],[1,6],[2,1]]"],
    ] {
        let sets = [graph, &["mission.events=[]", "formation.altitude_m=30"]].concat();
        let mut world = world(&scenario("tour.toml", &sets));
        let (mut seen, mut began) = (Vec::new(), false);
        while !world.has_finished() && world.t_s() < 900.0 {
            world.tick();
            let lost = |what: &EventKind| matches!(what, EventKind::PeerLost(_) | EventKind::ForcedAdvance { .. });
            let events: Vec<_> = world.events().collect();
            assert!(!events.iter().any(|(_, what)| lost(what)), "{graph:?}: {events:?}");
            began |= world.all_active();
            if began {
                let steps = || world.vehicles().map(|(_, agent, ..)| agent.at_step());
                assert!(steps().max().unwrap() - steps().min().unwrap() <= 1);
                let all = |(_, agent, ..): (VehicleId, &Agent, _, _)| agent.peers_in_contact().len() == 5;
                assert!(world.t_s() < 5.0 || world.vehicles().all(all));
                seen.extend(world.vehicles().map(|(_, agent, ..)| agent.peers().count()));
            }
        }
        assert!(world.has_finished(), "{graph:?}: not within {} s", world.t_s());
        let mean = seen.iter().sum::<usize>() as f64 / seen.len() as f64;
        assert!((1.3..2.5).contains(&mean), "{graph:?}: states of {mean} peers are received at a time");
    }
}

#[test]
fn a_vehicle_out_of_range_is_lost_and_found_again() {
    // Two vehicles start 60 m apart and fly on a ring of 100 m radius, out of the range of 150 m.
    let sets = ["swarm.vehicles=2", "network.range_m=150", "vehicle.1.start_ne_m=[0,0]", "vehicle.2.start_ne_m=[0,60]"];
    let mut world = world(&scenario("hover.toml", &sets));
    let (mut lost, mut found) = (0, 0);
    while world.t_s() < 200.0 {
        world.tick();
        for (_, what) in world.events() {
            lost += u32::from(matches!(what, EventKind::PeerLost(_)));
            found += u32::from(matches!(what, EventKind::PeerFound(_)));
        }
    }
    assert!(lost >= 2 && found >= 2, "lost {lost}, found {found}");
    assert!(world.vehicles().all(|(_, agent, ..)| agent.membership() == Membership::Active));
    let places: Vec<_> = world.vehicles().map(|(_, _, truth, _)| truth.position).collect();
    assert!((places[0] - places[1]).norm() > 140.0);
}

#[test]
fn all_vehicles_finish_a_tour_over_a_bad_network_together() {
    let hard = [
        "mission.events=[]",
        "network.loss=0.2",
        "network.burst_s=0.3",
        "network.jitter_s=0.3",
        "network.reorder=0.1",
        "network.duplicate=0.1",
        // Some bursts of a mean length of 0.3 s are longer than two seconds.
        "network.peer_stale_s=5",
    ];
    for seed in 0..2 {
        let report = study("tour.toml", &hard).fly(seed).unwrap();
        assert_eq!((report.setpoints_reached, report.setpoint_skew), (Some(6), Some(1)), "seed {seed}");
        let suspicions = (report.false_suspicions, report.forced_advances, report.collisions);
        assert_eq!(suspicions, (Some(0), Some(0), 0), "seed {seed}");
    }
}
