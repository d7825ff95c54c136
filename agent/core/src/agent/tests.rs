use proptest::prelude::*;
use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};
use skein_common::message::{Heartbeat as MissionMessage, Order, State, Trace, Verb, decode, encode};
use skein_common::scenario::{Source, load};
use skein_common::state::VehicleState;
use skein_common::time::{LocalTime, PlantTime};

use super::*;
use crate::peers::PeerMessage;
use crate::plant::{Controls, GroundTruth, VelocityCommand};
use crate::tests::{header, heartbeat, id, received_state};

mod suspended;

fn scenario(sets: &[&str]) -> Scenario {
    let sets: Vec<_> = sets.iter().map(|&set| set.to_owned()).collect();
    load(&Source { name: "test.toml", text: "swarm.vehicles = 4" }, &sets).unwrap().scenario
}

fn agent(scenario: &Scenario) -> Agent {
    let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
    Agent::new(scenario, id(1), Incarnation(7), &aircraft, Rules::shipped()).unwrap()
}

fn measured(altitude_m: f64) -> Measurement {
    Measurement {
        position: Geodetic::from_degrees(28.0, -82.0, altitude_m),
        height_m: altitude_m,
        velocity: VelocityNed::default(),
        attitude: Attitude { roll_rad: 4.61_f64.to_radians(), ..Attitude::default() },
        rates: BodyRates::default(),
        rotor_speed_rad_s: Some(167.0),
    }
}

/// An agent in flight, with its clocks.
struct Flight {
    agent: Agent,
    status: PlantStatus,
    plant_s: f64,
    local_s: f64,
}

impl Flight {
    /// An active agent at 30 m.
    fn new(scenario: &Scenario) -> Self {
        let mut flight = Self { agent: agent(scenario), status: PlantStatus::default(), plant_s: 0.0, local_s: 0.0 };
        for _ in 0..=110 {
            flight.frame(Some(&measured(30.0)), &[]);
        }
        assert_eq!(flight.agent.membership(), Membership::Active);
        flight
    }

    /// Advances by 20 ms, with or without a frame.
    fn frame(&mut self, measurement: Option<&Measurement>, messages: &[PeerMessage]) -> Outputs {
        self.local_s += 0.02;
        if measurement.is_some() {
            self.plant_s += 0.02;
        }
        let now = Now { plant: PlantTime::from_seconds(self.plant_s), local: LocalTime::from_seconds(self.local_s) };
        let received: Vec<_> = messages.iter().map(|&message| Received { message, at: now.local }).collect();
        self.agent.step(
            now,
            &Inputs {
                did_not_run_s: None,
                status: &self.status,
                measurement,
                received: &received,
                broadcast: Broadcast::default(),
                strangers: None,
                intents: &[],
                leave: false,
                answer: None,
            },
            &mut Workspace::default(),
        )
    }

    /// Steps without frames for this time; returns the events and the last command.
    fn without_frames(&mut self, seconds: f64) -> (Vec<EventKind>, Option<Command>) {
        let mut happened = Vec::new();
        let mut command = None;
        for _ in 0..(seconds / 0.02).round() as usize {
            let outputs = self.frame(None, &[]);
            happened.extend(outputs.outbox.happened);
            command = outputs.command;
        }
        (happened, command)
    }
}

fn state_of(sender: u8, sequence: u64, north_m: f64) -> PeerMessage {
    let scenario = scenario(&[]);
    let origin = Origin::new(scenario.origin.geodetic());
    let position = origin.geodetic_from_ned(PositionNed::new(north_m, 0.0, -30.0));
    let state = VehicleState { position, velocity: VelocityNed::default(), heading_rad: 0.0 };
    received_state(State { header: header(sender, sequence), state })
}

#[test]
fn no_controls_are_written_before_the_agent_is_active() {
    let mut flight =
        Flight { agent: agent(&scenario(&[])), status: PlantStatus::default(), plant_s: 0.0, local_s: 0.0 };
    let mut first_command_s = None;
    let mut active_s = None;
    let mut happened = Vec::new();
    for _ in 0..150 {
        let outputs = flight.frame(Some(&measured(0.24)), &[]);
        if outputs.command.is_some() {
            first_command_s.get_or_insert(flight.local_s);
        }
        if outputs.outbox.happened.contains(&EventKind::BecameActive) {
            active_s = Some(flight.local_s);
        }
        happened.extend(outputs.outbox.happened);
    }
    assert_eq!(happened, [EventKind::BecameActive], "the first data ever are not reported as back");
    assert!((active_s.unwrap() - 2.02).abs() < 1e-9, "two seconds after the first frame");
    assert_eq!(first_command_s, active_s);
}

#[test]
fn stale_data_give_neutral_controls_and_a_lost_simulator_is_reported_and_awaited() {
    let mut flight = Flight::new(&scenario(&["swarm.trim_error_rms_deg=0"]));
    assert_eq!(flight.without_frames(0.1), (vec![], None), "a late frame changes nothing");
    let (happened, command) = flight.without_frames(0.5);
    assert_eq!(happened, [EventKind::OwnDataStale]);
    assert_eq!(flight.agent.activity(), Activity::Blind);
    let controls = command.and_then(Command::controls).unwrap();
    assert_eq!((controls.roll, controls.pitch, controls.yaw), (0.0185, 0.0, 0.0), "cyclic and pedals at trim");
    assert!((0.5..0.7).contains(&controls.collective), "collective held: {controls:?}");
    let (happened, command) = flight.without_frames(2.0);
    assert_eq!((happened, command), (vec![EventKind::SimulatorLost], None));
    let back = flight.frame(Some(&measured(30.0)), &[]);
    assert_eq!(back.outbox.happened, [EventKind::OwnDataBack]);
    assert!(back.command.is_some());
    let joins = (flight.agent.membership(), flight.agent.activity());
    assert_eq!(joins, (Membership::Joining, Activity::Joining), "the vehicle rejoins in the air");
    for _ in 0..101 {
        flight.frame(Some(&measured(30.0)), &[]);
    }
    assert_eq!(flight.agent.membership(), Membership::Active);
}

#[test]
fn without_own_data_no_state_is_sent() {
    let mut flight = Flight::new(&scenario(&["network.send=every_frame"]));
    assert!(flight.frame(Some(&measured(30.0)), &[]).outbox.state.is_some());
    flight.without_frames(0.2);
    let outputs = flight.frame(None, &[]);
    assert_eq!(outputs.outbox.state, None, "the peers extrapolate the last state");
    let missions = (0..20).filter(|_| flight.frame(None, &[]).outbox.mission.is_some()).count();
    assert!(missions >= 1, "heartbeats are still sent");
}

#[test]
fn without_any_peer_the_vehicle_holds_its_position() {
    let mut flight = Flight::new(&scenario(&[]));
    let active = MissionMessage { plan: 0, ..heartbeat(header(2, 1)) };
    flight.frame(
        Some(&measured(30.0)),
        &[PeerMessage::Appeared(id(2)), state_of(2, 1, 80.0), PeerMessage::Mission(active)],
    );
    let outputs = flight.frame(Some(&measured(30.0)), &[PeerMessage::Vanished(id(2))]);
    assert_eq!(outputs.outbox.happened, [EventKind::PeerLost(id(2)), EventKind::AllPeersLost]);
    assert_eq!(flight.agent.activity(), Activity::Holding);
    flight.frame(Some(&measured(30.0)), &[PeerMessage::Appeared(id(2)), state_of(2, 2, 80.0)]);
    assert_eq!(flight.agent.activity(), Activity::Formation, "a peer is back");
}

#[test]
fn a_trace_with_an_impossible_age_of_a_peer_is_refused() {
    let mut flight = Flight::new(&scenario(&[]));
    flight.frame(Some(&measured(30.0)), &[state_of(2, 1, 50.0)]);
    let now = Now { plant: PlantTime::from_seconds(flight.plant_s), local: LocalTime::from_seconds(flight.local_s) };
    let trace = flight.agent.trace(now, &GroundTruth::default());
    assert_eq!((decode(&encode(&trace)).as_ref(), trace.peers.len()), (Ok(&trace), 1));
    for impossible in [f64::NAN, f64::INFINITY] {
        let mut wrong = trace.clone();
        wrong.peers[0].delay_s = Some(impossible);
        assert!(decode::<Trace>(&encode(&wrong)).is_err(), "{impossible}");
    }
}

#[test]
fn an_order_received_once_is_taken_and_repeated() {
    let mut flight = Flight::new(&scenario(&[]));
    let order = Order { epoch: 3, issuer: 9, verb: Verb::Land, vehicles: None, signature: None };
    let outputs = flight.frame(Some(&measured(30.0)), &[PeerMessage::Order(order)]);
    assert_eq!(outputs.outbox.happened, [EventKind::OrderTaken(order)]);
    assert_eq!(outputs.outbox.mission.and_then(|mission| mission.order), Some(order), "at once");
    let again = (0..10).find_map(|_| flight.frame(Some(&measured(30.0)), &[]).outbox.mission);
    assert_eq!(again.and_then(|mission| mission.order), Some(order), "and again within 0.2 s");
    assert_eq!(flight.agent.activity(), Activity::Landing);
}

#[test]
fn the_hidden_trim_error_follows_the_seed() {
    let trim = Aircraft::shipped("xcell60").unwrap().unwrap().trim;
    let of_seed = |seed: &str, vehicle| with_hidden_error(trim, &scenario(&[seed]), id(vehicle));
    assert_eq!(of_seed("seed=1", 1), of_seed("seed=1", 1));
    assert_ne!(of_seed("seed=1", 1), of_seed("seed=2", 1));
    assert_ne!(of_seed("seed=1", 1), of_seed("seed=1", 2));
    let errors: Vec<_> = (0..500).map(|seed| of_seed(&format!("seed={seed}"), 1).roll_rad - trim.roll_rad).collect();
    let rms_deg = (errors.iter().map(|error| error * error).sum::<f64>() / 500.0).sqrt().to_degrees();
    assert!((rms_deg - 0.3).abs() < 0.03, "{rms_deg}");
}

#[test]
fn a_law_that_refuses_its_parameters_is_named() {
    let refusal = |sets: &[&str]| {
        let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
        let agent = Agent::new(&scenario(sets), id(1), Incarnation(1), &aircraft, Rules::shipped());
        agent.map(|_| ()).unwrap_err().to_string()
    };
    let uneven = refusal(&["formation.law=olfati-saber", "formation.olfati_saber.action_a=6"]);
    assert!(uneven.ends_with("`formation.olfati_saber.action_a` is 6, but may not be above `action_b`, 5"), "{uneven}");
}

#[test]
fn a_point_mass_without_data_is_stopped() {
    let mut flight = Flight::new(&scenario(&["plant.model=point_mass"]));
    let flying = flight.frame(Some(&measured(25.0)), &[]).command.and_then(Command::velocity).unwrap();
    assert!(flying.climb_m_s > 0.0, "{flying:?}");
    let (happened, command) = flight.without_frames(0.5);
    let stop = Command::Velocity(VelocityCommand::default());
    assert_eq!((happened, command), (vec![EventKind::OwnDataStale], Some(stop)));
}

/// Any number, often an impossible one.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(-1e300), any::<f64>(), -100.0..100.0]
}

fn any_measurement() -> impl Strategy<Value = Measurement> {
    proptest::collection::vec(number(), 14).prop_map(|n| Measurement {
        position: Geodetic { latitude_rad: n[0], longitude_rad: n[1], altitude_m: n[2] },
        height_m: n[3],
        velocity: VelocityNed::new(n[4], n[5], n[6]),
        attitude: Attitude { roll_rad: n[7], pitch_rad: n[8], heading_rad: n[9] },
        rates: BodyRates { roll_rad_s: n[10], pitch_rad_s: n[11], yaw_rad_s: n[12] },
        rotor_speed_rad_s: Some(n[13]),
    })
}

/// A plausible measurement with one impossible number.
fn spoilt_measurement() -> impl Strategy<Value = Measurement> {
    (0_usize..8, number()).prop_map(|(field, value)| {
        let mut measurement = measured(30.0);
        match field {
            0 => measurement.position.latitude_rad = value,
            1 => measurement.position.altitude_m = value,
            2 => measurement.height_m = value,
            3 => measurement.velocity = VelocityNed::new(0.0, value, 0.0),
            4 => measurement.attitude.roll_rad = value,
            5 => measurement.attitude.heading_rad = value,
            6 => measurement.rates.yaw_rad_s = value,
            _ => measurement.rotor_speed_rad_s = Some(value),
        }
        measurement
    })
}

fn any_message() -> impl Strategy<Value = PeerMessage> {
    // The link drops implausible messages; any message that passes must do no harm.
    let place = (-1.57..1.57, -3.1..3.1, -900.0..9e4_f64);
    let velocity = (-170.0..170.0, -170.0..170.0, -170.0..170.0_f64);
    let state = (1_u8..9, any::<u64>(), place, velocity).prop_map(|(sender, sequence, place, velocity)| {
        let position = Geodetic { latitude_rad: place.0, longitude_rad: place.1, altitude_m: place.2 };
        let velocity = VelocityNed::new(velocity.0, velocity.1, velocity.2);
        State { header: header(sender, sequence), state: VehicleState { position, velocity, heading_rad: 0.0 } }
    });
    prop_oneof![
        state.prop_map(received_state),
        (-1e4..1e4, 1_u8..5, any::<u64>()).prop_map(|(north_m, sender, sequence)| state_of(sender, sequence, north_m)),
        (1_u8..9).prop_map(|sender| PeerMessage::Vanished(id(sender))),
        (1_u8..9).prop_map(|sender| PeerMessage::Appeared(id(sender))),
    ]
}

#[test]
fn a_released_vehicle_gets_no_controls_and_is_taken_back_without_a_step_of_the_controls() {
    let mut flight = Flight::new(&scenario(&[]));
    let order = |epoch, verb| {
        let vehicles = Some([id(1)].into_iter().collect());
        PeerMessage::Order(Order { epoch, issuer: 9, verb, vehicles, signature: None })
    };
    let released = flight.frame(Some(&measured(30.0)), &[order(1, Verb::Release)]);
    assert_eq!(released.command, Some(Command::Release));
    assert!(released.outbox.happened.contains(&EventKind::ControlsReleased), "{:?}", released.outbox.happened);
    let (happened, command) = flight.without_frames(0.4);
    assert_eq!((command, happened), (None, vec![EventKind::OwnDataStale]), "not even neutral controls");
    let followed: Vec<_> = (0..50).map(|_| flight.frame(Some(&measured(40.0)), &[])).collect();
    assert!(followed.iter().all(|outputs| outputs.command == Some(Command::Release)));
    assert!(followed.iter().any(|outputs| outputs.outbox.state.is_some()), "its peers know where it is");
    // Small ones: a vehicle that does not move under large ones would have a stuck servo.
    let by_pilot = Controls { roll: 0.02, pitch: -0.03, yaw: 0.0, collective: 0.9 };
    flight.status.controls = Some(by_pilot);
    let taken = flight.frame(Some(&measured(40.0)), &[order(2, Verb::Goto(0))]);
    assert!(taken.outbox.happened.contains(&EventKind::ControlsTakenBack), "{:?}", taken.outbox.happened);
    let mut before = taken.command.and_then(Command::controls).unwrap();
    let apart = |one: Controls, other: Controls| {
        let axes =
            [one.roll - other.roll, one.pitch - other.pitch, one.yaw - other.yaw, one.collective - other.collective];
        axes.into_iter().map(f64::abs).fold(0.0, f64::max)
    };
    assert!(apart(before, by_pilot) < 1e-12, "{before:?}");
    for _ in 0..60 {
        let after = flight.frame(Some(&measured(40.0)), &[]).command.and_then(Command::controls).unwrap();
        assert!(apart(before, after) < 0.03, "{before:?} {after:?}");
        before = after;
    }
    assert!(apart(before, by_pilot) > 0.1, "the rules fly after a second: {before:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn no_input_gives_a_command_beyond_its_limits(
        is_point_mass: bool,
        frames in proptest::collection::vec(
            (prop_oneof![any_measurement(), spoilt_measurement()], proptest::collection::vec(any_message(), 0..4)), 1..20,
        ),
    ) {
        let model = if is_point_mass { "plant.model=point_mass" } else { "plant.model=helicopter" };
        let mut flight = Flight::new(&scenario(&[model]));
        let is_within_limits = |command| match command {
            Command::Controls(controls) => !is_point_mass && controls.is_within_limits(),
            Command::Velocity(velocity) => is_point_mass && velocity.is_finite(),
            Command::Release => true,
        };
        for (measurement, messages) in frames {
            let outputs = flight.frame(Some(&measurement), &messages);
            prop_assert!(outputs.command.is_none_or(is_within_limits), "{outputs:?}");
            prop_assert!(outputs.outbox.state.is_none_or(|sent| sent.state.is_plausible()));
        }
        let recovered = flight.frame(Some(&measured(30.0)), &[]);
        prop_assert!(recovered.command.is_some_and(is_within_limits), "flies on afterwards");
    }
}
