//! Fleets in virtual time: teams that share the air.

use std::num::NonZeroUsize;

use skein_common::id::TeamId;
use skein_lab::metrics::{FleetReport, Measured};
use skein_lab::record::{self, TeamPlaces};
use skein_lab::study::{FleetRecording, fly_fleet};
use skein_tests::fleet;

fn fly(text: &str, threads: usize) -> FleetReport {
    fly_fleet(&fleet(text, &["seed=3".to_owned()]), NonZeroUsize::new(threads).unwrap(), None).unwrap().0
}

fn figure(report: &FleetReport, key: &str) -> f64 {
    Measured::of(report).value(key).unwrap()
}

/// Three teams whose rings take the place of the next one, over a network that loses and delays.
const ROTATION: &str = "name = 'rotation'\nduration_s = 260\n[fleet]\nteams = 3\npattern = 'line'\nspacing_m = 300\n\
    [swarm]\nvehicles = 4\n[formation]\nradius_m = 60\n[network]\nloss = 0.2\ndelay_s = 0.2\n\
    [mission]\nsteps = [{ centre_ne_m = [0, 0] }, { centre_ne_m = [0, 300] }, { land = true }]\n\
    [[team]]\nids = 3\nmission.steps = [{ centre_ne_m = [0, 0] }, { centre_ne_m = [0, -600] }, { land = true }]\n";

#[test]
fn a_fleet_flies_the_same_in_one_thread_and_in_several() {
    let measured = [1, 2, 3].map(|threads| {
        let mut measured = Measured::of(&fly(ROTATION, threads));
        measured.figures.retain(|key, _| !["wall_s", "real_time_factor"].contains(&key.as_str()));
        measured
    });
    assert!(measured.iter().all(|other| *other == measured[0]));
    assert_eq!(measured[0].figures["collisions"], Some(0.0));
    assert_eq!(measured[0].figures["setpoints_reached"], Some(2.0), "a circle of waiting teams ends");
}

/// Two teams that want the place between them at the same time, for ten seconds each, one after the other.
const SAME_PLACE: &str = "name = 'same'\nduration_s = 400\n[fleet]\nteams = 2\npattern = 'line'\nspacing_m = 800\n\
    [swarm]\nvehicles = 4\n[formation]\nradius_m = 60\n[mission]\nsteps = [{ centre_ne_m = [0, 0] }, \
    { centre_ne_m = [0, 400], dwell_s = 10 }, { centre_ne_m = [400, 400] }, { land = true }]\n[[team]]\nids = 2\n\
    mission.steps = [{ centre_ne_m = [0, 0] }, { centre_ne_m = [0, -400], dwell_s = 10 }, \
    { centre_ne_m = [-400, -400] }, { land = true }]\n";

/// The first and the last second in which a vehicle of this team flew the mission's second step.
fn in_second_step(places: &[TeamPlaces], team: u16) -> (f64, f64) {
    let flies = |places: &&TeamPlaces| {
        places.team == TeamId::new(team).unwrap() && places.vehicles.iter().any(|vehicle| vehicle.step == 1)
    };
    let times: Vec<f64> = places.iter().filter(flies).map(|places| places.t_s).collect();
    (times[0], times[times.len() - 1])
}

#[test]
fn two_teams_take_the_same_place_one_after_the_other_the_lower_first() {
    let folder = tempfile::tempdir().unwrap();
    let teams = fleet(SAME_PLACE, &["seed=1".to_owned()]);
    let recording = FleetRecording { folder: folder.path(), scenario_toml: SAME_PLACE, teams_toml: &[] };
    let (report, recorded) = fly_fleet(&teams, NonZeroUsize::MIN, Some(&recording)).unwrap();
    recorded.unwrap();
    assert_eq!((figure(&report, "collisions"), figure(&report, "setpoints_reached")), (0.0, 3.0));
    let places = record::read_fleet(&folder.path().join(record::FLEET_FILE)).unwrap().places;
    let (first, second) = (in_second_step(&places, 1), in_second_step(&places, 2));
    assert!(first.1 <= second.0, "{first:?} {second:?}");
    assert!(first.1 - first.0 > 10.0 && second.1 - second.0 > 10.0, "{first:?} {second:?}");
}

/// Two fleets of four teams of four that fly through each other, with this change of the second one.
fn meeting(change: &str) -> String {
    let places: Vec<String> = (0..8)
        .map(|nth| format!("[{}, {}]", if nth < 4 { 0 } else { 500 } + nth % 2 * 160, nth / 2 % 2 * 160))
        .collect();
    format!(
        "name = 'meeting'\nduration_s = 300\n[fleet]\nteams = 8\npattern = 'list'\nplaces_ne_m = [{}]\n\
         [swarm]\nvehicles = 4\n[start]\nsquare_m = 80\n[formation]\nradius_m = 40\n[network]\nloss = 0.2\n\
         delay_s = 0.2\n[mission]\nsteps = [{{ centre_ne_m = [0, 0], dwell_s = 5 }}, {{ centre_ne_m = [500, 0] }}, \
         {{ land = true }}]\n[[team]]\nids = [5, 6, 7, 8]\nmission.steps = [{{ centre_ne_m = [0, 0], dwell_s = 5 }}, \
         {{ centre_ne_m = [-500, 0] }}, {{ land = true }}]\n{change}",
        places.join(", ")
    )
}

#[test]
fn two_fleets_fly_through_each_other_over_a_lossy_network() {
    let report = fly(&meeting(""), 2);
    assert_eq!((figure(&report, "collisions"), figure(&report, "setpoints_reached")), (0.0, 2.0));
    let apart_m = figure(&report, "across_separation_m");
    assert!((4.0..60.0).contains(&apart_m), "they meet, and keep apart: {apart_m} m");
}

#[test]
fn vehicles_whose_clocks_jump_still_know_the_other_teams() {
    for by_s in [-100, 3600] {
        let jump = |vehicle| format!("{{ at_s = 20, fault = 'clock_jump', vehicle = {vehicle}, by_s = {by_s} }}");
        let jumps = [1, 2, 3, 4].map(jump).join(", ");
        let report =
            fly(&meeting(&format!("[[team]]\nids = [1, 2, 3, 4, 5, 6, 7, 8]\nmission.events = [{jumps}]\n")), 2);
        assert_eq!((figure(&report, "collisions"), figure(&report, "setpoints_reached")), (0.0, 2.0), "{by_s} s");
        assert!(figure(&report, "across_separation_m") > 4.0, "{by_s} s");
    }
}

#[test]
fn a_vehicle_that_receives_nothing_and_flies_straight_on_is_avoided() {
    let change = "[[team]]\nids = [8]\nswarm.vehicles = 1\nformation.law = 'virtual-structure'\n\
                  mission.events = [{ at_s = 0, fault = 'isolate' }]\nmission.steps = [{ centre_ne_m = [0, 0], \
                  dwell_s = 40 }, { path_ne_m = [[0, 0], [-800, -80]], speed_m_s = 5 }, { land = true }]\n";
    let report = fly(&meeting(change), 2);
    assert_eq!(figure(&report, "across_collisions"), 0.0);
    assert!(figure(&report, "across_separation_m") < 60.0);
}

#[test]
fn an_isolated_team_receives_nothing_and_is_not_received() {
    let all = figure(&fly(&meeting(""), 1), "stranger_states");
    let isolate = |both_ways: bool| {
        let change = format!(
            "[[team]]\nids = [1]\nmission.events = [{{ at_s = 0, fault = 'isolate', both_ways = {both_ways} }}]\n"
        );
        figure(&fly(&meeting(&change), 1), "stranger_states")
    };
    let (one_way, both_ways) = (isolate(false), isolate(true));
    // Of 56 directed pairs of teams seven end at the isolated one, and seven begin there.
    assert!((0.80..0.95).contains(&(one_way / all)), "{one_way} of {all}");
    assert!((0.65..0.82).contains(&(both_ways / all)), "{both_ways} of {all}");
}

#[test]
fn the_shipped_fleet_has_64_teams_of_16() {
    let text = include_str!("../../../deploy/scenarios/fleet.toml");
    let teams = fleet(text, &["seed=1".to_owned()]);
    assert_eq!(teams.iter().map(|team| team.scenario.swarm.vehicles).collect::<Vec<_>>(), [16; 64]);
}
