#![expect(deprecated, reason = "QGroundControl and MAVSDK still send what newer messages replace")]

use std::f64::consts::{FRAC_PI_2, PI};
use std::time::Duration;

use mavlink::dialects::common::{
    COMMAND_INT_DATA, COMMAND_LONG_DATA, MISSION_REQUEST_LIST_DATA, MavCmd, MavFrame, MavMessage, MavMissionType,
    MavModeFlag, MavResult, MavSeverity, PARAM_REQUEST_LIST_DATA, SET_MODE_DATA,
};
use mavlink::{MavHeader, MavlinkVersion, MessageData};
use proptest::prelude::*;
use skein_common::frame::{Attitude, Geodetic, Origin, PositionNed, VelocityNed};
use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Failure, VehicleFacts, Verb};
use skein_common::scenario::{Source, load, load_any};
use skein_common::state::{Activity, Membership};

use super::bridge::{Bridge, Outgoing, Reaction};
use super::frames::{self, Frames};
use super::modes::Mode;
use super::telemetry;
use crate::snapshot::Team;
use skein_cluster::display::status::Known;
use skein_cluster::os;

const STATION: MavHeader = MavHeader { system_id: 255, component_id: 190, sequence: 0 };
const TOUR: &str = "swarm.vehicles = 4\n[mission]\nsteps = [{ centre_ne_m = [0, 0] }, { hold_s = 1 }, { land = true }]";

fn sample(activity: Activity) -> VehicleFacts {
    VehicleFacts {
        flown_s: Some(1.0),
        activity,
        membership: Membership::Active,
        step: 1,
        live: 4,
        position: Some(PositionNed::new(100.0, -50.0, -30.0)),
        velocity: VelocityNed(nalgebra::Vector3::new(1.5, -2.0, -0.25)),
        attitude: Attitude { roll_rad: 0.1, pitch_rad: -0.2, heading_rad: -FRAC_PI_2 },
        controls: Some([0.0, 0.0, 0.0, 0.55]),
        energy_left: Some(0.746),
        ..VehicleFacts::default()
    }
}

fn team(text: &str) -> Team {
    Team::new(&load(&Source { name: "x", text }, &[]).unwrap().scenario)
}

fn observed(team: &Team, silent: Duration, sample: &VehicleFacts) -> Vec<Known> {
    let known = |id| Known { id, newest: Some((sample.clone(), silent)), is_healthy: true, ended: None, order: None };
    team.scenario.ids().map(known).collect()
}

/// A bridge that has observed the vehicles of the tour in this activity.
fn bridge(activity: Activity, takes_orders: bool) -> Bridge {
    let teams = [team(TOUR)];
    let mut bridge = Bridge::new(&teams, takes_orders, 0);
    bridge.step(Duration::from_secs(1), &teams, &[observed(&teams[0], Duration::ZERO, &sample(activity))]);
    bridge
}

fn command(system: u8, command: MavCmd, first: f32) -> MavMessage {
    let long = COMMAND_LONG_DATA {
        target_system: system,
        target_component: 1,
        command,
        param1: first,
        ..COMMAND_LONG_DATA::DEFAULT
    };
    MavMessage::COMMAND_LONG(long)
}

fn results(answers: &[Outgoing]) -> Vec<(u8, MavResult)> {
    let result = |(system, message): &Outgoing| match message {
        MavMessage::COMMAND_ACK(ack) => {
            assert_eq!((ack.target_system, ack.target_component), (255, 190));
            Some((*system, ack.result))
        }
        _ => None,
    };
    answers.iter().filter_map(result).collect()
}

/// The texts, whole again.
fn texts(answers: &[Outgoing]) -> String {
    let text = |(_, message): &Outgoing| match message {
        MavMessage::STATUSTEXT(text) => Some(text.text.to_str().unwrap().to_owned()),
        _ => None,
    };
    answers.iter().filter_map(text).collect()
}

#[test]
fn positions_and_velocities_are_degrees_millimetres_and_centimetres_in_north_east_down() {
    let scenario = team(TOUR).scenario;
    let home = scenario.origin.geodetic();
    let origin = Origin::new(home);
    let MavMessage::GLOBAL_POSITION_INT(place) = telemetry::position(&sample(Activity::Formation), &origin, &home, 7)
    else {
        panic!()
    };
    let truth = origin.geodetic_from_ned(PositionNed::new(100.0, -50.0, -30.0));
    assert!((f64::from(place.lat) * 1e-7 - truth.latitude_deg()).abs() < 1e-7);
    assert!((f64::from(place.lon) * 1e-7 - truth.longitude_deg()).abs() < 1e-7);
    // 100 m north is more latitude, 50 m west is less longitude.
    assert!(f64::from(place.lat) * 1e-7 > home.latitude_deg() && f64::from(place.lon) * 1e-7 < home.longitude_deg());
    assert!((place.relative_alt - 30_000).abs() <= 2, "{}", place.relative_alt);
    assert_eq!(place.alt - place.relative_alt, (home.altitude_m * 1e3).round() as i32);
    assert_eq!((place.vx, place.vy, place.vz, place.time_boot_ms), (150, -200, -25, 7));
    assert_eq!(place.hdg, 27_000, "west");

    let MavMessage::ATTITUDE(attitude) = telemetry::attitude(&sample(Activity::Formation), &origin, 7) else {
        panic!()
    };
    assert_eq!((attitude.roll, attitude.pitch), (0.1, -0.2));
    // 50 m west of the origin, its meridian is turned by four millionths of a radian.
    assert!((attitude.yaw + FRAC_PI_2 as f32).abs() < 1e-5, "{}", attitude.yaw);
    assert!(attitude.rollspeed.is_nan(), "unknown");
    let MavMessage::VFR_HUD(hud) = telemetry::hud(&sample(Activity::Formation), &origin) else { panic!() };
    assert_eq!((hud.groundspeed, hud.climb, hud.heading, hud.throttle), (2.5, 0.25, 270, 55));
    for (energy_left, battery_remaining) in [(Some(0.746), 75), (Some(0.0), 0), (None, -1)] {
        let sample = VehicleFacts { energy_left, ..sample(Activity::Formation) };
        let MavMessage::SYS_STATUS(status) = telemetry::system_status(&sample) else { panic!() };
        assert_eq!(status.battery_remaining, battery_remaining);
        assert_eq!((status.voltage_battery, status.current_battery), (u16::MAX, -1), "unknown");
    }
}

#[test]
fn a_heading_is_from_0_to_less_than_360_degrees_and_a_yaw_within_half_a_turn() {
    let scenario = team(TOUR).scenario;
    let home = scenario.origin.geodetic();
    for (heading_rad, hdg, yaw_rad) in
        [(0.0, 0, 0.0), (-1e-9, 0, -1e-9), (1.5 * PI, 27_000, -FRAC_PI_2), (3.0 * PI - 0.01, 17_942, PI - 0.01)]
    {
        let mut sample = VehicleFacts { position: Some(PositionNed::default()), ..sample(Activity::Formation) };
        sample.attitude.heading_rad = heading_rad;
        let MavMessage::GLOBAL_POSITION_INT(place) = telemetry::position(&sample, &Origin::new(home), &home, 0) else {
            panic!()
        };
        let MavMessage::ATTITUDE(attitude) = telemetry::attitude(&sample, &Origin::new(home), 0) else { panic!() };
        assert!(place.hdg.abs_diff(hdg) <= 1 && place.hdg < 36_000, "{heading_rad}: {}", place.hdg);
        assert!((f64::from(attitude.yaw) - yaw_rad).abs() < 1e-6, "{heading_rad}: {}", attitude.yaw);
    }
}

#[test]
fn far_from_the_origin_velocity_and_heading_refer_to_the_local_north_and_altitudes_to_the_ellipsoid() {
    // 100 km east of an origin at 60 degrees north the meridian is turned by 1.56 degrees to the west.
    let home = Geodetic::from_degrees(60.0, 10.0, 100.0);
    let origin = Origin::new(home);
    let position = Some(PositionNed::new(0.0, 1e5, -30.0));
    let attitude = Attitude { heading_rad: 0.0, ..Attitude::default() };
    let velocity = VelocityNed::new(10.0, 0.0, 0.0);
    let sample = VehicleFacts { position, attitude, velocity, ..sample(Activity::Formation) };
    let MavMessage::GLOBAL_POSITION_INT(place) = telemetry::position(&sample, &origin, &home, 0) else { panic!() };
    assert_eq!((place.alt, place.relative_alt), (130_000, 30_000));
    assert!(place.hdg.abs_diff(156) <= 3, "{}", place.hdg);
    assert_eq!((place.vx, place.vy), (1000, 27));
    let MavMessage::ATTITUDE(attitude) = telemetry::attitude(&sample, &origin, 0) else { panic!() };
    assert!((attitude.yaw - 0.0272).abs() < 3e-4, "{}", attitude.yaw);
    let MavMessage::VFR_HUD(hud) = telemetry::hud(&sample, &origin) else { panic!() };
    assert_eq!((hud.alt, hud.heading), (130.0, 1));
}

#[test]
fn a_mode_has_the_numbers_of_px4_and_only_a_vehicle_off_the_ground_is_armed() {
    let all = [
        (Activity::Joining, 0x0104_0000, false),
        (Activity::TakingOff, 0x0204_0000, true),
        (Activity::Holding, 0x0304_0000, true),
        (Activity::Formation, 0x0404_0000, true),
        (Activity::Landing, 0x0604_0000, true),
        (Activity::Landed, 0x0604_0000, false),
        (Activity::Released, 0x0001_0000, true),
    ];
    for (activity, custom_mode, armed) in all {
        let MavMessage::HEARTBEAT(beat) = telemetry::heartbeat(&sample(activity)) else { panic!() };
        assert_eq!(beat.custom_mode, custom_mode, "{activity}");
        assert_eq!(beat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED), armed, "{activity}");
        let (main, sub) = Mode::split(custom_mode);
        assert_eq!(Mode::from_numbers(main, sub), Some(Mode::of(activity)));
    }
    assert_eq!((Mode::from_numbers(0, 0), Mode::from_numbers(255, 255)), (None, None));
}

#[test]
fn a_summary_is_sent_once_and_a_silent_vehicle_sends_nothing() {
    let teams = [team(TOUR)];
    let mut bridge = Bridge::new(&teams, false, 0);
    let mut step = |now_ms: u64, silent_ms: u64, sample: &VehicleFacts| {
        let observed = [observed(&teams[0], Duration::from_millis(silent_ms), sample)];
        bridge.step(Duration::from_millis(now_ms), &teams, &observed)
    };
    let count =
        |messages: &[Outgoing], fits: fn(&MavMessage) -> bool| messages.iter().filter(|(_, one)| fits(one)).count();
    let is_position: fn(&MavMessage) -> bool = |one| matches!(one, MavMessage::GLOBAL_POSITION_INT(_));
    let is_heartbeat: fn(&MavMessage) -> bool = |one| matches!(one, MavMessage::HEARTBEAT(_));
    let mut flying = sample(Activity::Formation);
    let first = step(1_000, 10, &flying);
    assert_eq!((count(&first, is_position), count(&first, is_heartbeat)), (4, 4));
    assert!(texts(&first).contains("vehicle 3: under way to its place in the formation"), "{}", texts(&first));
    assert_eq!(step(1_050, 60, &flying), [], "the same summary");
    let next = step(1_100, 0, &flying);
    assert_eq!((count(&next, is_position), count(&next, is_heartbeat)), (4, 0));
    assert_eq!(count(&step(2_000, 0, &flying), is_heartbeat), 4);
    // A phase is no place: the vehicle is in formation once it is there, and that is reported once in a step.
    flying.in_place_s = Some(0.0);
    assert_eq!(texts(&step(2_010, 0, &flying)).matches(": in formation").count(), 4);
    flying.in_place_s = None;
    assert_eq!(texts(&step(2_030, 0, &flying)), "");
    flying.in_place_s = Some(1.0);
    assert_eq!(texts(&step(2_050, 0, &flying)), "");
    // A change is sent at once, with its text; a failure is named once.
    flying.activity = Activity::Landing;
    flying.failures = vec![Failure::Engine];
    let landing = step(2_100, 0, &flying);
    assert_eq!(count(&landing, is_heartbeat), 4);
    assert!(
        texts(&landing).contains("vehicle 1: landing") && texts(&landing).contains("engine"),
        "{}",
        texts(&landing)
    );
    assert_eq!(texts(&step(2_200, 0, &flying)), "");
    assert_eq!(step(9_000, 5_000, &flying), [], "silent for 5 s");
}

#[test]
fn requests_are_answered_so_that_no_ground_station_waits() {
    let mut bridge = bridge(Activity::Formation, false);
    let list = PARAM_REQUEST_LIST_DATA { target_system: 3, target_component: 1 };
    let answers = bridge.receive(STATION, &MavMessage::PARAM_REQUEST_LIST(list)).answers;
    let [(3, MavMessage::PARAM_VALUE(value))] = answers.as_slice() else { panic!("{answers:?}") };
    assert_eq!((value.param_count, value.param_value, value.param_id.to_str()), (1, 3.0, Ok("MAV_SYS_ID")));
    for mission_type in [MavMissionType::MAV_MISSION_TYPE_MISSION, MavMissionType::MAV_MISSION_TYPE_FENCE] {
        let list = MISSION_REQUEST_LIST_DATA { target_system: 2, target_component: 0, mission_type };
        let answers = bridge.receive(STATION, &MavMessage::MISSION_REQUEST_LIST(list)).answers;
        let [(2, MavMessage::MISSION_COUNT(count))] = answers.as_slice() else { panic!("{answers:?}") };
        assert_eq!((count.count, count.mission_type, count.target_system), (0, mission_type, 255));
    }
    let answers = bridge.receive(STATION, &command(1, MavCmd::MAV_CMD_REQUEST_MESSAGE, 148.0)).answers;
    assert_eq!(results(&answers), [(1, MavResult::MAV_RESULT_ACCEPTED)]);
    assert!(matches!(answers.as_slice(), [_, (1, MavMessage::AUTOPILOT_VERSION(_))]), "{answers:?}");
    // Every vehicle answers a request to all; none a vehicle that is not there, or another component.
    let all = bridge.receive(STATION, &command(0, MavCmd::MAV_CMD_REQUEST_MESSAGE, 242.0)).answers;
    assert_eq!(results(&all).len(), 4);
    assert_eq!(bridge.receive(STATION, &command(9, MavCmd::MAV_CMD_NAV_LAND, 0.0)), Reaction::default());
    let camera = COMMAND_LONG_DATA { target_system: 1, target_component: 100, ..COMMAND_LONG_DATA::DEFAULT };
    assert_eq!(bridge.receive(STATION, &MavMessage::COMMAND_LONG(camera)), Reaction::default());
    for unknown in [MavCmd::MAV_CMD_DO_SET_SERVO, MavCmd::MAV_CMD_IMAGE_START_CAPTURE] {
        let answers = bridge.receive(STATION, &command(1, unknown, 0.0)).answers;
        assert_eq!(results(&answers), [(1, MavResult::MAV_RESULT_UNSUPPORTED)]);
    }
}

#[test]
fn a_command_becomes_an_order_and_is_acknowledged_when_the_swarm_has_answered() {
    let mut bridge = bridge(Activity::Formation, true);
    let land = command(2, MavCmd::MAV_CMD_NAV_LAND, 0.0);
    let Reaction { answers, order } = bridge.receive(STATION, &land);
    assert_eq!(results(&answers), [(2, MavResult::MAV_RESULT_IN_PROGRESS)]);
    let order = order.unwrap();
    assert_eq!((order.verb, order.vehicle), (Verb::Land, VehicleId::new(2).unwrap().into()));
    // Sent again, it is not given again; another one has to wait.
    let again = bridge.receive(STATION, &land);
    assert_eq!((results(&again.answers), again.order), (vec![(2, MavResult::MAV_RESULT_IN_PROGRESS)], None));
    let other = bridge.receive(STATION, &command(2, MavCmd::MAV_CMD_NAV_LOITER_UNLIM, 0.0));
    assert_eq!(results(&other.answers), [(2, MavResult::MAV_RESULT_TEMPORARILY_REJECTED)]);
    let done = bridge.ordered(&order, Ok("land: accepted by vehicle 2"));
    assert_eq!(
        (results(&done), texts(&done)),
        (vec![(2, MavResult::MAV_RESULT_ACCEPTED)], "land: accepted by vehicle 2".to_owned())
    );
    let order = bridge.receive(STATION, &command(2, MavCmd::MAV_CMD_NAV_LOITER_UNLIM, 0.0)).order.unwrap();
    assert_eq!(order.verb, Verb::Hold);
    let long = "not accepted by vehicle 2, which is in contact but does not answer; all of the others fly on as before";
    let failed = bridge.ordered(&order, Err(long));
    assert_eq!((results(&failed), texts(&failed)), (vec![(2, MavResult::MAV_RESULT_FAILED)], long.to_owned()));
}

#[test]
fn every_way_to_give_an_order_is_understood() {
    let verb = |activity: Activity, message: &MavMessage| {
        bridge(activity, true).receive(STATION, message).order.map(|order| order.verb)
    };
    let flying = Activity::Formation;
    assert_eq!(
        verb(flying, &command(1, MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH, 0.0)),
        Some(Verb::Goto(2)),
        "the step that lands"
    );
    assert_eq!(verb(Activity::Holding, &command(1, MavCmd::MAV_CMD_MISSION_START, 0.0)), Some(Verb::Goto(1)));
    assert_eq!(verb(Activity::Landing, &command(1, MavCmd::MAV_CMD_NAV_TAKEOFF, 0.0)), Some(Verb::Goto(1)));
    assert_eq!(verb(flying, &command(1, MavCmd::MAV_CMD_NAV_TAKEOFF, 0.0)), None, "it flies already");
    assert_eq!(verb(flying, &command(1, MavCmd::MAV_CMD_DO_PAUSE_CONTINUE, 0.0)), Some(Verb::Hold));
    let nowhere = COMMAND_LONG_DATA {
        target_system: 1,
        command: MavCmd::MAV_CMD_DO_REPOSITION,
        param5: f32::NAN,
        param6: f32::NAN,
        ..COMMAND_LONG_DATA::DEFAULT
    };
    assert_eq!(verb(flying, &MavMessage::COMMAND_LONG(nowhere)), Some(Verb::Hold), "pause of QGroundControl");
    let reposition = |x: i32, y: i32| {
        MavMessage::COMMAND_INT(COMMAND_INT_DATA {
            target_system: 1,
            command: MavCmd::MAV_CMD_DO_REPOSITION,
            frame: MavFrame::MAV_FRAME_GLOBAL,
            x,
            y,
            ..COMMAND_INT_DATA::DEFAULT
        })
    };
    assert_eq!(verb(flying, &reposition(i32::MAX, i32::MAX)), Some(Verb::Hold));
    assert_eq!(verb(flying, &reposition(1, 2)), None, "a place of its own");
    for (mode, expected) in [(Mode::Land, Verb::Land), (Mode::Hold, Verb::Hold), (Mode::Return, Verb::Goto(2))] {
        let custom_mode = mode.custom();
        let set = SET_MODE_DATA { target_system: 1, custom_mode, base_mode: MavModeFlag::empty() };
        assert_eq!(verb(flying, &MavMessage::SET_MODE(set)), Some(expected));
        let (main, sub) = ((custom_mode >> 16 & 0xff) as f32, (custom_mode >> 24) as f32);
        let long = COMMAND_LONG_DATA {
            target_system: 1,
            command: MavCmd::MAV_CMD_DO_SET_MODE,
            param1: 1.0,
            param2: main,
            param3: sub,
            ..COMMAND_LONG_DATA::DEFAULT
        };
        assert_eq!(verb(flying, &MavMessage::COMMAND_LONG(long)), Some(expected));
    }
    // No order without a vehicle's id, and none that a mission does not have.
    assert_eq!(verb(flying, &command(0, MavCmd::MAV_CMD_NAV_LAND, 0.0)), None);
    let teams = [team("swarm.vehicles = 1")];
    let mut hover = Bridge::new(&teams, true, 0);
    let refused = hover.receive(STATION, &command(1, MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH, 0.0));
    assert_eq!((results(&refused.answers), refused.order), (vec![(1, MavResult::MAV_RESULT_DENIED)], None));
    assert!(texts(&refused.answers).contains("no step of its mission lands"), "{}", texts(&refused.answers));
}

#[test]
fn without_orders_every_order_is_denied_with_the_reason() {
    let mut bridge = bridge(Activity::Formation, false);
    for order in [MavCmd::MAV_CMD_NAV_LAND, MavCmd::MAV_CMD_NAV_LOITER_UNLIM, MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH] {
        let Reaction { answers, order } = bridge.receive(STATION, &command(4, order, 0.0));
        assert_eq!((results(&answers), order), (vec![(4, MavResult::MAV_RESULT_DENIED)], None));
        assert!(texts(&answers).contains("start `skein view` with --orders"), "{}", texts(&answers));
    }
}

#[test]
fn no_ground_station_starts_or_stops_a_rotor_whatever_the_rotor_does() {
    for activity in [Activity::Joining, Activity::TakingOff, Activity::Formation, Activity::Landed] {
        for (takes_orders, first) in [(false, 0.0), (false, 1.0), (true, 0.0), (true, 1.0), (true, f32::NAN)] {
            let mut bridge = bridge(activity, takes_orders);
            let arm = command(2, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, first);
            let Reaction { answers, order } = bridge.receive(STATION, &arm);
            assert_eq!(
                (results(&answers), order),
                (vec![(2, MavResult::MAV_RESULT_DENIED)], None),
                "{activity} {first}"
            );
            assert!(texts(&answers).contains("the agent st"), "{}", texts(&answers));
        }
    }
}

/// A command without a line in the book's table is denied with a text, or unsupported; nothing is accepted without being done.
#[test]
fn every_other_command_is_refused() {
    let known = [
        MavCmd::MAV_CMD_NAV_LAND,
        MavCmd::MAV_CMD_NAV_LOITER_UNLIM,
        MavCmd::MAV_CMD_NAV_TAKEOFF,
        MavCmd::MAV_CMD_MISSION_START,
        MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH,
        MavCmd::MAV_CMD_DO_PAUSE_CONTINUE,
        MavCmd::MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
    ];
    // The parameters, the number, the system, the component and the count of repetitions.
    let named = |number: u16| {
        let payload = [&[0; 28][..], &number.to_le_bytes(), &[1, 1, 0]].concat();
        COMMAND_LONG_DATA::deser(MavlinkVersion::V2, &payload).ok().map(|long| long.command)
    };
    let mut count = 0;
    for number in (0..=u16::MAX).filter_map(named).filter(|number| !known.contains(number)) {
        for first in [0.0, 1.0, 7.0, f32::NAN] {
            let mut bridge = bridge(Activity::Formation, true);
            let Reaction { answers, order } = bridge.receive(STATION, &command(1, number, first));
            let result = results(&answers);
            let is_refused = [MavResult::MAV_RESULT_DENIED, MavResult::MAV_RESULT_UNSUPPORTED]
                .iter()
                .any(|refusal| result == [(1, *refusal)]);
            assert!(is_refused && order.is_none(), "{number:?} {first}: {result:?}");
            let is_denied = result == [(1, MavResult::MAV_RESULT_DENIED)];
            assert_eq!(is_denied, !texts(&answers).is_empty(), "{number:?}: a denial has its reason");
        }
        count += 1;
    }
    assert!(count > 100, "{count} commands");
    let unclear = command(1, MavCmd::MAV_CMD_DO_PAUSE_CONTINUE, f32::NAN);
    let Reaction { answers, order } = bridge(Activity::Holding, true).receive(STATION, &unclear);
    assert_eq!((results(&answers), order), (vec![(1, MavResult::MAV_RESULT_DENIED)], None));
}

#[test]
fn an_offset_moves_all_system_ids_and_a_unit_id_stays_with_its_vehicle() {
    let uid = |name: &str, offset: u8, system: u8| {
        let teams = [team(&format!("swarm.name = \"{name}\"\nswarm.vehicles = 4"))];
        let mut bridge = Bridge::new(&teams, true, offset);
        let sent = bridge.step(
            Duration::from_secs(1),
            &teams,
            &[observed(&teams[0], Duration::ZERO, &sample(Activity::Formation))],
        );
        let systems: std::collections::BTreeSet<u8> = sent.iter().map(|(system, _)| *system).collect();
        assert_eq!(systems, (offset + 1..=offset + 4).collect());
        let nobody = if offset == 0 { 5 } else { offset };
        let land = |system| bridge.receive(STATION, &command(system, MavCmd::MAV_CMD_NAV_LAND, 0.0)).order;
        let orders = [system, nobody].map(land).map(|order| order.map(|order| order.vehicle.vehicle.get()));
        assert_eq!(orders, [Some(system - offset), None]);
        let list = PARAM_REQUEST_LIST_DATA { target_system: system, target_component: 1 };
        let answers = bridge.receive(STATION, &MavMessage::PARAM_REQUEST_LIST(list)).answers;
        let [(_, MavMessage::PARAM_VALUE(value))] = answers.as_slice() else { panic!("{answers:?}") };
        assert_eq!(value.param_value, f32::from(system), "MAV_SYS_ID");
        let answers = bridge.receive(STATION, &command(system, MavCmd::MAV_CMD_REQUEST_MESSAGE, 148.0)).answers;
        let [_, (_, MavMessage::AUTOPILOT_VERSION(version))] = answers.as_slice() else { panic!("{answers:?}") };
        assert_eq!(version.uid.to_le_bytes(), version.uid2[..8]);
        assert_ne!(version.uid, 0);
        version.uid2
    };
    assert_eq!(uid("red", 0, 2), uid("red", 100, 102));
    let different = [uid("red", 0, 2), uid("red", 0, 3), uid("blue", 0, 2), uid("blue", 200, 203)];
    assert_eq!(different.iter().collect::<std::collections::BTreeSet<_>>().len(), 4);
    let two = [team("swarm.vehicles = 4")];
    let mut last = Bridge::new(&two, true, 248);
    let sent =
        last.step(Duration::from_secs(1), &two, &[observed(&two[0], Duration::ZERO, &sample(Activity::Formation))]);
    let systems: std::collections::BTreeSet<u8> = sent.iter().map(|(system, _)| *system).collect();
    assert_eq!(systems, [249, 250].into());
}

#[test]
fn events_are_texts_of_their_severity() {
    let mut bridge = bridge(Activity::Formation, false);
    let name = VehicleId::new(3).unwrap().into();
    let mut severity = |what: EventKind| {
        let sent = bridge.event(name, &what.to_string(), what.severity());
        let of = |(system, message): &Outgoing| match message {
            MavMessage::STATUSTEXT(text) => (*system, text.severity),
            _ => panic!("{message:?}"),
        };
        sent.first().map(of)
    };
    assert_eq!(severity(EventKind::AllPeersLost), Some((3, MavSeverity::MAV_SEVERITY_CRITICAL)));
    assert_eq!(severity(EventKind::OwnDataStale), Some((3, MavSeverity::MAV_SEVERITY_CRITICAL)));
    assert_eq!(severity(EventKind::LandingWaits), Some((3, MavSeverity::MAV_SEVERITY_WARNING)));
    assert_eq!(severity(EventKind::Landed), None, "as it should be");
    assert_eq!(severity(EventKind::Failed(Failure::Engine)), None, "the summary has the failure");
}

#[test]
fn vehicles_of_a_fleet_are_numbered_through_up_to_250() {
    let text = "swarm.vehicles = 100\nstart.square_m = 400\nformation.radius_m = 1200\n[fleet]\nteams = 3\n";
    let described = load_any(&Source { name: "x", text }, &[]).unwrap();
    let teams: Vec<Team> = described.all().iter().map(|loaded| Team::new(&loaded.scenario)).collect();
    let observed: Vec<_> =
        teams.iter().map(|team| observed(team, Duration::ZERO, &sample(Activity::Formation))).collect();
    let mut bridge = Bridge::new(&teams, true, 0);
    let sent = bridge.step(Duration::from_secs(1), &teams, &observed);
    let systems: std::collections::BTreeSet<u8> = sent.iter().map(|(system, _)| *system).collect();
    assert_eq!((systems.first(), systems.last(), systems.len()), (Some(&1), Some(&250), 250));
    let order = bridge.receive(STATION, &command(201, MavCmd::MAV_CMD_NAV_LAND, 0.0)).order.unwrap();
    assert_eq!(order.vehicle.to_string(), "3/1");
}

#[test]
fn a_key_is_required_of_every_message_and_signs_every_message() {
    let message = command(1, MavCmd::MAV_CMD_NAV_LAND, 0.0);
    let frames = |key: Option<u8>| Frames::new(key.map(|byte| [byte; 32]));
    let (mut open, mut own, mut foreign) = (frames(None), frames(Some(1)), frames(Some(2)));
    let (unsigned, signed, forged) =
        (open.write(255, &message), own.write(255, &message), foreign.write(255, &message));
    let reader = frames(Some(1));
    assert_eq!(reader.read(&unsigned), [], "unsigned");
    assert_eq!(reader.read(&forged), [], "signed with another key");
    assert_eq!(reader.read(&signed).len(), 1);
    assert_eq!(reader.read(&signed), [], "repeated");
    let mut changed = own.write(255, &message);
    changed[12] ^= 1;
    assert_eq!(reader.read(&changed), []);
    assert_eq!(frames(None).read(&unsigned)[0].1, message);
    // Numbers of each system, in order; several messages in one datagram.
    let datagram: Vec<u8> = [7, 7, 7, 8].into_iter().flat_map(|system| open.write(system, &message)).collect();
    let read: Vec<_> =
        frames(None).read(&datagram).iter().map(|(header, _)| (header.system_id, header.sequence)).collect();
    assert_eq!(read, [(7, 0), (7, 1), (7, 2), (8, 0)]);
}

#[test]
fn a_key_that_is_no_key_is_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("key");
    assert!(frames::key(&path).is_err());
    std::fs::write(&path, "too short").unwrap();
    let why = frames::key(&path).unwrap_err().to_string();
    assert!(why.contains("9 bytes, not 32") && why.contains("openssl rand"), "{why}");
    std::fs::write(&path, [7; 32]).unwrap();
    os::set_mode(&path, 0o644).unwrap();
    assert!(frames::key(&path).unwrap_err().to_string().contains("`chmod 600 "));
    os::set_mode(&path, 0o600).unwrap();
    assert_eq!(frames::key(&path).unwrap(), [7; 32]);
    for wrong in ["", "127.0.0.1", "127.0.0.1:0", "127.0.0.1:99999"] {
        assert!(super::address(wrong).unwrap_err().to_string().contains("HOST:PORT"), "{wrong}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, ..ProptestConfig::default() })]

    /// Bytes of any kind, and frames with any change, never panic and never give an order without a command that is one.
    #[test]
    fn no_datagram_panics(bytes in prop::collection::vec(any::<u8>(), 0..600), at in any::<prop::sample::Index>(), to in any::<u8>()) {
        let mut bridge = bridge(Activity::Formation, true);
        let frames = Frames::new(None);
        for (header, message) in frames.read(&bytes) {
            bridge.receive(header, &message);
        }
        let mut frame = Frames::new(None).write(255, &command(1, MavCmd::MAV_CMD_NAV_LAND, 0.0));
        let index = at.index(frame.len());
        let is_same = frame[index] == to;
        frame[index] = to;
        for (header, message) in frames.read(&frame) {
            let reaction = bridge.receive(header, &message);
            // Everything but the start and the checksum itself is in the checksum.
            prop_assert!(is_same || reaction.order.is_none());
        }
    }

    /// Commands with any parameters, to any system.
    #[test]
    fn no_command_panics(number in 0_usize..6, parameters in any::<[f32; 7]>(), system in any::<u8>(), x in any::<i32>()) {
        let mut bridge = bridge(Activity::Holding, true);
        let command = [
            MavCmd::MAV_CMD_DO_SET_MODE, MavCmd::MAV_CMD_REQUEST_MESSAGE, MavCmd::MAV_CMD_DO_REPOSITION,
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, MavCmd::MAV_CMD_DO_PAUSE_CONTINUE, MavCmd::MAV_CMD_NAV_TAKEOFF,
        ][number];
        let [param1, param2, param3, param4, param5, param6, param7] = parameters;
        let long = COMMAND_LONG_DATA { param1, param2, param3, param4, param5, param6, param7, command, target_system: system, target_component: 0, confirmation: 0 };
        let int = COMMAND_INT_DATA { param1, param2, param3, param4, x, y: x, z: param7, command, target_system: system, ..COMMAND_INT_DATA::DEFAULT };
        for message in [MavMessage::COMMAND_LONG(long), MavMessage::COMMAND_INT(int)] {
            let Reaction { order, .. } = bridge.receive(STATION, &message);
            prop_assert!(order.is_none_or(|order| u16::from(order.vehicle.vehicle.get()) == u16::from(system)));
        }
    }
}
