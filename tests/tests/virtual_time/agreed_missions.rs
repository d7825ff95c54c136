//! Missions in virtual time over bad networks, with split swarms and with faults: a few cells of the tables that
//! `cargo run --release -p skein-tests --bin tables` prints.

use skein_common::message::Failure;
use skein_tests::missions::{self, Grounded, Mission};
use skein_tests::{faults, halves, in_parallel, tour};

/// Period of the heartbeats, s.
const PUBLISH_PERIOD_S: f64 = 0.2;
/// One frame of virtual time, s.
const FRAME_S: f64 = 0.02;

#[test]
fn all_vehicles_finish_a_tour_together_over_any_network() {
    let cells = [(2, 0.0, 0.0, 1.0), (4, 0.2, 0.5, 3.0), (8, 0.0, 1.0, 1.0), (8, 0.3, 0.2, 3.0), (16, 0.2, 0.0, 3.0)];
    for (vehicles, loss, delay_s, periods) in cells {
        for report in in_parallel(0..2, |seed| tour::fly(vehicles, loss, delay_s, seed)) {
            let cell = format!("{vehicles} vehicles, loss {loss}, delay {delay_s} s, seed {}", report.run.seed);
            assert_eq!(report.setpoints_reached, Some(tour::PLACES), "{cell}");
            assert!(report.setpoint_skew.unwrap() <= 1, "{cell}: {:?}", report.setpoint_skew);
            assert_eq!((report.false_suspicions, report.forced_advances), (Some(0), Some(0)), "{cell}");
            let latency_s = report.advance_latency_s.unwrap();
            let limit_s = delay_s + periods * PUBLISH_PERIOD_S + FRAME_S;
            assert!(latency_s >= delay_s && latency_s <= limit_s, "{cell}: {latency_s} s");
            assert_eq!(report.collisions, 0, "{cell}");
        }
    }
}

#[test]
fn partitions_continue_or_hold_by_their_policy_and_rejoin_soon() {
    for (partition, first, vehicles) in halves::CASES {
        let flights = in_parallel(0..4, |seed| halves::fly(partition, first, vehicles, seed));
        for (seed, flight) in flights.iter().enumerate() {
            let case = format!("{partition}, {first} of {vehicles}, seed {seed}: {flight:?}");
            assert!(flight.rejoined_s.is_some_and(|s| s > 0.0 && s < 3.0), "{case}");
            assert!(!flight.has_collided(), "{case}");
        }
        // A partition that has to respace first may not reach its place while the cut lasts, but in some flights it
        // does.
        let advanced = |steps: fn(&halves::PartitionFlight) -> u32| flights.iter().any(|flight| steps(flight) > 0);
        let case = format!("{partition}, {first} of {vehicles}: {flights:?}");
        assert_eq!(advanced(|flight| flight.first_steps), partition == "continue" || 2 * first > vehicles, "{case}");
        assert_eq!(advanced(|flight| flight.second_steps), partition == "continue", "{case}");
    }
}

#[test]
fn no_fault_of_one_vehicle_stops_the_mission_of_the_others() {
    for (name, fault) in faults::FAULTS {
        for (seed, flight) in in_parallel(2..5, |seed| faults::fly(Some(fault), 4, seed)).iter().enumerate() {
            let case = format!("{name}, seed {}: {flight:?}", seed + 2);
            assert!(flight.collisions.is_empty(), "{case}: {:?}", flight.collisions);
            assert!(flight.finished, "{case}");
            let (is_noticed, is_back) = (flight.noticed_s.is_some(), flight.back_s.is_some());
            match name {
                "clock jump" => assert!(!is_noticed, "{case}: no peer may notice"),
                "engine out" | "servo stuck" | "gyro off" | "gps frozen" => assert!(is_noticed && !is_back, "{case}"),
                _ => assert!(flight.noticed_s.unwrap() < 2.1 && flight.back_s.unwrap() < 25.0, "{case}"),
            }
        }
    }
}

#[test]
fn two_groups_that_a_cut_separates_keep_apart_whatever_each_receives_and_whenever_they_land() {
    // Every place has the same slots, so that two groups without contact fly to the same positions.
    let law = ["formation.law = \"virtual-structure\"", "formation.radius_m = 40", "formation.altitude_m = 25"];
    let places = ["{ centre_ne_m = [0, 0] }", "{ centre_ne_m = [60, 0] }", "{ centre_ne_m = [60, 60] }"];
    let landing = ["{ centre_ne_m = [0, 0] }", "{ hold_s = 25 }"];
    let cases = [
        ("the group that does not receive has the lowest id", "from = [2, 3], to = [1, 4]", &places[..]),
        ("the group that receives has the lowest id", "from = [1, 4], to = [2, 3]", &places[..]),
        ("a landing while a cut lasts", "from = [1, 2], to = [3, 4], both_ways = true", &landing[..]),
        ("a landing while a cut in one direction lasts", "from = [3, 4], to = [1, 2]", &landing[..]),
    ];
    for (case, cut, steps) in cases {
        let cut = format!("{{ at_s = 30, fault = \"cut\", {cut}, for_s = 60 }}");
        let flights = in_parallel(0..6, |seed| missions::fly(&Mission::of(seed, 4, &law, steps, &[&cut])));
        for (seed, flight) in flights.iter().enumerate() {
            println!("{case}, seed {seed}: closest {:.1} m; {flight}", flight.closest_m);
            assert!(flight.is_sound(), "{case}, seed {seed}: {flight}");
        }
    }
}

#[test]
fn a_vehicle_that_landed_with_a_frozen_position_and_gets_a_new_agent_holds_no_other_vehicle() {
    let steps = ["[0, 0]", "[150, 0]", "[-150, 0]", "[150, 150]"].map(|place| format!("{{ centre_ne_m = {place} }}"));
    let steps = steps.each_ref().map(String::as_str);
    let faults = [
        "{ at_s = 30, fault = \"gps_frozen\", vehicle = 2 }",
        "{ at_s = 70, fault = \"kill\", vehicle = 2, for_s = 20 }",
    ];
    let keys = ["formation.radius_m = 60.0", "formation.altitude_m = 25.0"];
    for flight in in_parallel(3..9, |seed| missions::fly(&Mission::of(seed, 3, &keys, &steps, &faults))) {
        assert!(flight.is_sound() && flight.ended_s.is_some_and(|ended_s| ended_s < 400.0), "{flight}");
    }
}

#[test]
fn a_member_that_cannot_reach_its_place_leaves_and_the_others_end_the_mission() {
    let steps = ["{ centre_ne_m = [0, 0] }", "{ centre_ne_m = [200, 0] }"];
    // In the second step one slot lies inside the obstacle.
    let obstacle = "airspace.obstacles = [{ centre_ne_m = [300, 0], radius_m = 15 }]";
    let keys = ["formation.law = \"virtual-structure\"", obstacle];
    for flight in in_parallel(0..4, |seed| missions::fly(&Mission::of(seed, 3, &keys, &steps, &[]))) {
        let reported: Vec<_> = flight.grounded.keys().map(|(_, why)| *why).collect();
        assert_eq!(reported, [Grounded::Failed(Failure::Place)], "one vehicle, and it reports why: {flight}");
        assert!(flight.collisions.is_empty() && flight.ended_s.is_some_and(|ended_s| ended_s < 300.0), "{flight}");
    }
}

#[test]
fn random_missions_end_by_landing_without_a_collision_and_ground_no_healthy_vehicle() {
    for (mission, flight) in in_parallel(0..40, |seed| {
        let mission = Mission::random(seed);
        let flight = missions::fly(&mission);
        (mission, flight)
    }) {
        assert!(flight.is_sound(), "{flight}\n{}", mission.text());
    }
}
