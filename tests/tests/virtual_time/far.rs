//! Flights far from the origin, over long ways and at the poles, in virtual time: a study with the built-in helicopter, and
//! agents over the bytes of X-Plane's protocol. Heights are above the origin's height on the ellipsoid, whatever the distance,
//! and a ring keeps its place whatever the direction of the meridians.

use std::num::NonZeroUsize;

use skein_common::frame::{Origin, PositionNed};
use skein_common::math;
use skein_common::message::EventKind;
use skein_common::scenario::{Scenario, Source, load};
use skein_common::state::Membership;
use skein_lab::metrics::{Measured, Run};
use skein_lab::recording::Recording;
use skein_lab::study::fly_fleet;
use skein_tests::wire::{Frames, Swarm};
use skein_tests::{fleet, in_parallel, of_scenario};

const RADIUS_M: f64 = 60.0;
const ALTITUDE_M: f64 = 25.0;
/// Where the vehicles stand before take-off, from the centre of their ring, m.
const STARTS_NE_M: [[f64; 2]; 3] = [[40.0, 5.0], [-25.0, 30.0], [-20.0, -35.0]];
const STEADY: Frames = Frames { rate: 50, jitter: 0.0, drop: 0.0 };
/// Longest time until all have landed, s.
const LIMIT_S: f64 = 400.0;

/// A hover of three vehicles around this centre, which end it by landing where they are.
fn hover(latitude_deg: f64, centre_ne_m: [f64; 2]) -> Scenario {
    load(&Source { name: "far.toml", text: &hover_file(latitude_deg, centre_ne_m) }, &[]).unwrap().scenario
}

fn hover_file(latitude_deg: f64, [north_m, east_m]: [f64; 2]) -> String {
    let starts = (1..).zip(STARTS_NE_M).map(|(id, [north, east])| {
        format!("[vehicle.{id}]\nstart_ne_m = [{:?}, {:?}]\n", north_m + north, east_m + east)
    });
    format!(
        "name = 'far'\n[origin]\nlatitude_deg = {latitude_deg:?}\nlongitude_deg = 179.5\nelevation_m = 30\n\
         [swarm]\nvehicles = 3\n[formation]\nradius_m = {RADIUS_M:?}\naltitude_m = {ALTITUDE_M:?}\n\
         [mission]\nsteps = [{{ centre_ne_m = [{north_m:?}, {east_m:?}], dwell_s = 60 }}, {{ land = true }}]\n{}",
        starts.collect::<String>()
    )
}

/// The vehicles that are not at their altitude and in the ring's band, with their errors, m.
fn out_of_place(vehicles: impl Iterator<Item = PositionNed>, [north_m, east_m]: [f64; 2]) -> Vec<[f64; 2]> {
    let errors = vehicles.map(|position| {
        let from_centre_m = math::hypot(position.north_m() - north_m, position.east_m() - east_m);
        [from_centre_m - RADIUS_M, position.altitude_m() - ALTITUDE_M]
    });
    errors.filter(|[radial_m, height_m]| radial_m.abs() > 12.0 || height_m.abs() > 2.0).collect()
}

/// Flies it over the protocol until all have landed.
fn fly_over_the_protocol(latitude_deg: f64, centre_ne_m: [f64; 2]) {
    let scenario = hover(latitude_deg, centre_ne_m);
    let what = format!("latitude {latitude_deg}, centre {centre_ne_m:?}");
    let mut swarm = Swarm::new(&scenario, STEADY);
    let (mut was_checked, mut last_heights_m) = (false, [f64::INFINITY; 3]);
    while !(0..3).all(|nth| swarm.agent(nth).membership() == Membership::Left && last_heights_m[nth] < 1.0) {
        assert!(swarm.now().seconds() < LIMIT_S, "{what}: not landed, at {last_heights_m:?} m: {:?}", swarm.events);
        swarm.run();
        for (nth, last_height_m) in last_heights_m.iter_mut().enumerate() {
            let (position, height_m) = swarm.place(nth);
            assert!((position.altitude_m() - height_m).abs() < 1e-3, "{what}: {position:?} at {height_m} m");
            if let Some(estimate) = swarm.agent(nth).position() {
                let off_m = (estimate - position).norm();
                assert!(off_m < 1.0, "{what}: the agent is {off_m} m from where it believes to be");
            }
            *last_height_m = height_m;
        }
        // The last second before the landing.
        if !was_checked && (0..3).any(|nth| swarm.agent(nth).has_finished()) {
            was_checked = true;
            let places = (0..3).map(|nth| swarm.place(nth).0);
            let out = out_of_place(places, centre_ne_m);
            assert!(out.is_empty(), "{what}: {out:?}");
        }
    }
    assert!(was_checked, "{what}");
    let at_altitude = swarm.events.iter().filter(|(_, _, event)| *event == EventKind::AtAltitude).count();
    assert_eq!(at_altitude, 3, "{what}: {:?}", swarm.events);
}

const CENTRES_NE_M: [[f64; 2]; 4] = [[0.0, 20_000.0], [0.0, 50_000.0], [-99_900.0, 0.0], [99_900.0, -99_900.0]];

#[test]
fn a_swarm_far_from_the_origin_keeps_its_ring_at_its_altitude_and_lands_over_the_protocol() {
    in_parallel(0..CENTRES_NE_M.len() as u64, |nth| fly_over_the_protocol(28.0, CENTRES_NE_M[nth as usize]));
    fly_over_the_protocol(-70.0, CENTRES_NE_M[1]);
}

#[test]
fn a_ring_at_a_pole_keeps_its_place_over_the_protocol() {
    let latitudes_deg = [90.0, -90.0, -89.99999, 89.9997, 89.99];
    in_parallel(0..5, |nth| fly_over_the_protocol(latitudes_deg[nth as usize], [0.0, 0.0]));
}

#[test]
fn a_study_far_from_the_origin_measures_what_it_measures_at_the_origin() {
    let flown = |latitude_deg: f64, centre_ne_m: [f64; 2]| {
        // Long enough for the figures of the last 100 s.
        let file = hover_file(latitude_deg, centre_ne_m).replace("dwell_s = 60", "dwell_s = 200");
        let study = of_scenario(load(&Source { name: "far.toml", text: &file }, &[]).unwrap().scenario);
        let mut recording = Recording::new(&study.scenario, Run::new(&study.scenario, "study"));
        let report = study.fly_watched(1, Some((&mut recording, 5.0))).unwrap();
        for step in recording.tracks.iter().flat_map(|track| &track.steps) {
            let trace = &step.trace;
            assert!((trace.position.altitude_m() - trace.height_m).abs() < 1e-9);
        }
        let at_end = recording.tracks.iter().map(|track| track.steps.last().unwrap().trace.height_m);
        (report, at_end.collect::<Vec<_>>())
    };
    let (at_origin, _) = flown(28.0, [0.0, 0.0]);
    for (latitude_deg, centre_ne_m) in
        [(28.0, [0.0, 20_000.0]), (28.0, [0.0, 50_000.0]), (60.0, [-99_900.0, 99_900.0]), (90.0, [0.0, 0.0])]
    {
        let (report, heights_m) = flown(latitude_deg, centre_ne_m);
        let what = format!("latitude {latitude_deg}, centre {centre_ne_m:?}");
        assert_eq!(
            (report.collisions, report.crashes, report.setpoints_reached),
            (0, 0, at_origin.setpoints_reached),
            "{what}"
        );
        let near = |one: Option<f64>, other: Option<f64>, within: f64| (one.unwrap() - other.unwrap()).abs() < within;
        assert!(near(report.at_altitude_s, at_origin.at_altitude_s, 0.5), "{what}");
        assert!(near(report.in_band_s, at_origin.in_band_s, 2.0), "{what}");
        assert!(near(report.radial_rms_m, at_origin.radial_rms_m, 0.1), "{what}");
        assert!(near(report.altitude_rms_m, at_origin.altitude_rms_m, 0.05), "{what}");
        assert!(heights_m.iter().all(|height_m| height_m.is_finite()), "{what}: {heights_m:?}");
    }
}

#[test]
fn a_way_of_tens_of_kilometres_is_flown_at_one_height() {
    let text = "name = 'long'\nduration_s = 4000\n[plant]\nmodel = 'point_mass'\npoint_mass.max_speed_m_s = 40\n[swarm]\nvehicles = 2\n\
                [formation]\nradius_m = 40\n[airspace]\nceiling_m = 40\nfloor_m = 10\n[mission]\nspeed_m_s = 20\n\
                steps = [{ hold_s = 20 }, { path_ne_m = [[0, 0], [0, 30000], [-8000, 60000]] }, { land = true }]\n";
    let scenario = load(&Source { name: "long.toml", text }, &[]).unwrap().scenario;
    let altitude_m = scenario.formation.altitude_m;
    let origin = Origin::new(scenario.origin.geodetic());
    let mut recording = Recording::new(&scenario, Run::new(&scenario, "study"));
    let report = of_scenario(scenario).fly_watched(1, Some((&mut recording, 1.0))).unwrap();
    assert_eq!((report.setpoints_reached, report.collisions, report.crashes), (Some(2), 0, 0));
    for track in &recording.tracks {
        let under_way = track.steps.iter().filter(|step| step.trace.step == 1 && step.t_s > 30.0);
        let farthest_m = under_way.map(|step| {
            let position = step.trace.position;
            assert!((position.altitude_m() - altitude_m).abs() < 1.0, "{position:?}");
            let place = origin.geodetic_from_ned(position);
            assert!((place.altitude_m - origin.geodetic().altitude_m - altitude_m).abs() < 1.0, "{place:?}");
            position.horizontal().norm()
        });
        assert!(farthest_m.fold(0.0, f64::max) > 60_000.0);
    }
}

/// Two teams whose origins are 50 km apart and that want the same place in the middle of the first one's flight.
const WIDE: &str = "name = 'wide'\nduration_s = 420\n[fleet]\nteams = 2\npattern = 'list'\nplaces_ne_m = [[0, 0], [0, 50000]]\n\
    [swarm]\nvehicles = 3\n[formation]\nradius_m = 60\n[mission]\nsteps = [{ centre_ne_m = [0, 0] }, \
    { centre_ne_m = [0, 400], dwell_s = 10 }, { centre_ne_m = [400, 400] }, { land = true }]\n[[team]]\nids = 2\n\
    vehicle.1.start_ne_m = [40, -49195]\nvehicle.2.start_ne_m = [-25, -49170]\nvehicle.3.start_ne_m = [-20, -49235]\n\
    mission.steps = [{ centre_ne_m = [0, -49200] }, { centre_ne_m = [0, -49600], dwell_s = 10 }, \
    { centre_ne_m = [-400, -49600] }, { land = true }]\n";

#[test]
fn teams_of_a_fleet_50_km_wide_meet_at_one_height_and_take_turns() {
    let flown = |text: &str| {
        let teams = fleet(text, &["seed=3".to_owned()]);
        let measured = Measured::of(&fly_fleet(&teams, NonZeroUsize::MIN, None).unwrap().0);
        move |key: &str| measured.figures[key].unwrap()
    };
    let wide = flown(WIDE);
    assert_eq!((wide("collisions"), wide("across_collisions"), wide("setpoints_reached")), (0.0, 0.0, 3.0));
    assert!((5.0..300.0).contains(&wide("across_separation_m")), "{}", wide("across_separation_m"));
    assert!(wide("stranger_states") > 0.0);
}
