//! The control loop and the agreement, which have a state: any sequence of inputs.

use nalgebra::{Vector2, Vector3};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;
use skein_common::frame::{Attitude, BodyRates, Geodetic, Origin, VelocityNed};
use skein_common::id::{FleetVehicle, Incarnation, TeamId, VehicleId};
use skein_common::message::{
    Area, Header, Heartbeat, Intent, MAX_STEP, Message, Order, Standstill, State, Trace, Verb, decode, encode,
};
use skein_common::scenario::{Partition, Range, Scenario, Setting, Source, TunableKey, load_any};
use skein_common::state::{Membership, VehicleState};
use skein_common::time::{LocalTime, Now, SenderStamp};
use skein_core::agent::{Agent, Inputs};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::formation::Workspace;
use skein_core::formation::external::{LawReply, ReplyCommand};
use skein_core::intent::ReceivedIntent;
use skein_core::mission::agreement::{Agreement, AgreementState, OtherStates};
use skein_core::peers::{Broadcast, PeerMessage, Received, ReceivedState};
use skein_core::plant::{Command, GroundTruth, Measurement};
use skein_core::strangers::{StrangerState, StrangersReceived};
use skein_tests::SHIPPED;

use super::inputs::{cases, number};
use super::messages::id;

/// What the fuzzed vehicles fly: every law and conversion, with and without the safety filter, alone and in a fleet whose teams
/// wait for one another.
const FLIGHTS: [&[&str]; 10] = [
    &[],
    &["formation.safety_filter='cbf'", "mission.partition='quorum'"],
    &["formation.conversion='nonlinear'", "sensing.position='f32_latlon'", "sensing.velocity='differenced'"],
    &["formation.law='flock'"],
    &["formation.law='olfati-saber'", "formation.safety_filter='cbf'"],
    &["formation.law='vasarhelyi'"],
    &["formation.law='virtual-structure'"],
    &["formation.law='displacement-consensus'"],
    &["formation.law='external'", "formation.external.command=['law']"],
    &["fleet.teams=3", "mission.steps=[{ centre_ne_m = [0, 0] }, { centre_ne_m = [900, 0] }, { land = true }]"],
];
/// Frames after which a vehicle is an active member.
const JOINED: u32 = 110;

pub(super) fn measurement() -> Measurement {
    Measurement {
        position: Geodetic::from_degrees(28.0, -82.0, 30.0),
        height_m: 30.0,
        velocity: VelocityNed::default(),
        attitude: Attitude::default(),
        rates: BodyRates::default(),
        rotor_speed_rad_s: Some(167.0),
    }
}

/// What vehicle 1 flies with these keys set, in a fleet that of the first team.
fn scenario(sets: &[&str]) -> Scenario {
    let (name, shipped) = SHIPPED[0];
    let is_fleet = sets.iter().any(|set| set.starts_with("fleet."));
    let text = if is_fleet { format!("{shipped}\n[fleet]\nteams = 2\n") } else { shipped.to_owned() };
    let sets: Vec<_> = sets.iter().map(|&set| set.to_owned()).collect();
    load_any(&Source { name, text: &text }, &sets).unwrap().first().scenario.clone()
}

/// An agent with its clocks.
struct Flight {
    agent: Agent,
    now: Now,
    workspace: Workspace,
}

impl Flight {
    fn new(sets: &[&str]) -> Self {
        let scenario = scenario(sets);
        let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
        let agent = Agent::new(&scenario, id(1), Incarnation(7), &aircraft, Rules::shipped()).unwrap();
        let mut flight = Self { agent, now: Now::default(), workspace: Workspace::default() };
        let undisturbed = Step { measurement: Some(measurement()), local_s: 0.02, plant_s: 0.02, ..Step::default() };
        (0..JOINED).for_each(|_| flight.step(&undisturbed));
        assert_eq!(flight.agent.membership(), Membership::Active);
        flight
    }

    /// Runs one step and checks all that comes out of it.
    fn step(&mut self, step: &Step) {
        self.now.local = self.now.local.plus_seconds(step.local_s);
        self.now.plant = self.now.plant.plus_seconds(step.plant_s);
        self.agent.simulator_stands_still(step.standstill);
        if let Some(for_s) = step.did_not_run_s {
            self.agent.did_not_run(for_s);
        }
        let at = |early_s: f64| self.now.local.plus_seconds(-early_s);
        let received: Vec<_> =
            step.received.iter().map(|(message, early_s)| Received { message: *message, at: at(*early_s) }).collect();
        let arrived = |intent: &(ReceivedIntent, f64)| ReceivedIntent { at: at(intent.1), ..intent.0 };
        let intents: Vec<_> = step.intents.iter().map(arrived).collect();
        let strangers = step.strangers.iter().map(|(state, early_s)| StrangerState { at: at(*early_s), ..*state });
        let (stamped, just_now): (Vec<_>, Vec<_>) = strangers.partition(|state| state.at < at(0.5));
        let inputs = Inputs {
            measurement: step.measurement.as_ref(),
            received: &received,
            broadcast: Broadcast::default(),
            strangers: StrangersReceived { stamped: &stamped, now: &just_now },
            intents: &intents,
            leave: step.leave,
            answer: step.answer.as_ref(),
        };
        let outputs = self.agent.step(self.now, &inputs, &mut self.workspace);
        let is_sane = match outputs.command {
            Some(Command::Controls(controls)) => controls.is_within_limits(),
            Some(Command::Velocity(velocity)) => velocity.is_finite(),
            Some(Command::Release) | None => true,
        };
        assert!(is_sane, "{:?}", outputs.command);
        let outbox = &outputs.outbox;
        assert!(outbox.state.as_ref().is_none_or(|state| state.is_plausible()), "{outbox:?}");
        assert!(outbox.mission.as_ref().is_none_or(|heartbeat| heartbeat.is_plausible()), "{outbox:?}");
        let trace = self.agent.trace(self.now, &GroundTruth::default());
        assert!(trace.is_plausible(), "{trace:?}");
    }
}

/// A trace with all its parts.
pub(super) fn a_trace() -> Trace {
    let mut flight = Flight::new(FLIGHTS[0]);
    let state = VehicleState { position: measurement().position, velocity: VelocityNed::default(), heading_rad: 0.0 };
    let header = Header { sender: id(2), incarnation: Incarnation(1), sequence: 1, stamp: SenderStamp::ZERO };
    let received = vec![(received_state(State { header, state }), 0.0)];
    flight.step(&Step { measurement: Some(measurement()), received, local_s: 0.02, plant_s: 0.02, ..Step::default() });
    flight.agent.trace(flight.now, &GroundTruth::default())
}

fn origin() -> Origin {
    Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0))
}

fn received_state(state: State) -> PeerMessage {
    PeerMessage::State(ReceivedState::new(state, &origin()))
}

/// The inputs of one step.
#[derive(Clone, Debug, Default)]
struct Step {
    /// Time since the last step by the two clocks, s.
    local_s: f64,
    plant_s: f64,
    measurement: Option<Measurement>,
    /// Messages, and how long before this step they arrived, s.
    received: Vec<(PeerMessage, f64)>,
    strangers: Vec<(StrangerState, f64)>,
    intents: Vec<(ReceivedIntent, f64)>,
    standstill: Option<Standstill>,
    did_not_run_s: Option<f64>,
    leave: bool,
    answer: Option<LawReply>,
}

fn any_measurement() -> impl Strategy<Value = Measurement> {
    let place = (number(), number(), number(), number());
    let motion = ([number(), number(), number()], [number(), number(), number()], [number(), number(), number()]);
    (place, motion, option::of(number()), 0_u8..4).prop_map(|(place, motion, rotor_speed_rad_s, wrong)| {
        let (north_m, east_m, down_m, height_m) = place;
        let ([north, east, down], [roll_rad, pitch_rad, heading_rad], [roll_rad_s, pitch_rad_s, yaw_rad_s]) = motion;
        let near = Geodetic::from_degrees(28.0 + 1e-5 * north_m, -82.0 + 1e-5 * east_m, 30.0 - down_m);
        let usual = measurement();
        // Mostly one part is wrong at a time: an implausible measurement is refused as a whole.
        Measurement {
            position: if wrong != 1 { near } else { usual.position },
            height_m: if wrong == 1 { height_m } else { usual.height_m },
            velocity: if wrong == 2 { VelocityNed::new(north, east, down) } else { usual.velocity },
            attitude: if wrong == 3 { Attitude { roll_rad, pitch_rad, heading_rad } } else { usual.attitude },
            rates: if wrong == 3 { BodyRates { roll_rad_s, pitch_rad_s, yaw_rad_s } } else { usual.rates },
            rotor_speed_rad_s: if wrong == 0 { rotor_speed_rad_s } else { usual.rotor_speed_rad_s },
        }
    })
}

fn any_header() -> impl Strategy<Value = Header> {
    let stamp = (0_u64..20_000_000_000).prop_map(SenderStamp::from_nanoseconds);
    (1_u8..=4, 0_u64..3, 0_u64..60, stamp).prop_map(|(sender, incarnation, sequence, stamp)| Header {
        sender: id(sender),
        incarnation: Incarnation(incarnation),
        sequence,
        stamp,
    })
}

fn any_order() -> impl Strategy<Value = Order> {
    let verb = prop_oneof![
        Just(Verb::Hold),
        Just(Verb::Land),
        Just(Verb::Abort),
        (0..=MAX_STEP).prop_map(Verb::Goto),
        any::<u32>().prop_map(Verb::Goto)
    ];
    let vehicles = option::of(vec((1_u8..=5).prop_map(id), 1..4).prop_map(|all| all.into_iter().collect()));
    // Few keys can have most of the numbers: half of the values are in the key's range.
    let value = prop_oneof![number().prop_map(Ok), (0.0..1.0).prop_map(Err)];
    let setting = (select(TunableKey::ALL), value).prop_filter_map("out of range", |(key, value)| {
        let Range { min, max, .. } = key.range();
        let setting = Setting { key, value: value.unwrap_or_else(|share: f64| min + share * (max.min(200.0) - min)) };
        setting.is_in_range().then_some((Verb::Set(setting), None))
    });
    (any::<u64>(), any::<u64>(), prop_oneof![2 => (verb, vehicles), 1 => setting])
        .prop_map(|(epoch, issuer, (verb, vehicles))| Order { epoch, issuer, verb, vehicles, signature: None })
}

/// A state that a decoder accepts.
fn any_state() -> impl Strategy<Value = State> {
    let numbers = (number(), number(), number(), [number(), number(), number()]);
    (any_header(), numbers).prop_filter_map("implausible", |(header, (north, east, up, velocity))| {
        let position = Geodetic::from_degrees(28.0 + 1e-5 * north, -82.0 + 1e-5 * east, up);
        let state = VehicleState { position, velocity: VelocityNed::from(velocity), heading_rad: 0.1 * east };
        decode(&encode(&State { header, state })).ok()
    })
}

fn any_team() -> impl Strategy<Value = TeamId> {
    (1_u16..=4).prop_map(|number| TeamId::new(number).unwrap())
}

/// A state of a vehicle of another team, as the link hands it on.
fn any_stranger() -> impl Strategy<Value = StrangerState> {
    (any_team(), any_state()).prop_map(|(team, State { header, state })| StrangerState {
        id: FleetVehicle { team, vehicle: header.sender },
        order: header.order(),
        position: origin().ned_from_geodetic(&state.position),
        velocity: state.velocity,
        at: LocalTime::default(),
    })
}

/// An intent of a vehicle of another team, as the link hands it on.
fn any_intent() -> impl Strategy<Value = ReceivedIntent> {
    let area = |(north, east, up, radius_m): (f64, f64, f64, f64)| Area {
        centre: Geodetic::from_degrees(28.0 + 1e-5 * north, -82.0 + 1e-5 * east, up),
        radius_m: radius_m as f32,
    };
    let any_area = move || (number(), number(), number(), number()).prop_map(area);
    (any_team(), any_header(), any_area(), option::of(any_area())).prop_filter_map(
        "implausible",
        |(team, header, occupied, wanted)| {
            let message: Intent = decode(&encode(&Intent { header, occupied, wanted })).ok()?;
            Some(ReceivedIntent::new(team, &message, &origin(), LocalTime::default()))
        },
    )
}

/// A message that a decoder accepts.
fn any_message(plan: u64) -> impl Strategy<Value = PeerMessage> {
    let state = any_state().prop_map(received_state);
    let steps = (0_u32..5, 0_u32..5, option::of(0_u32..5), number());
    let membership = select(vec![Membership::Joining, Membership::Active, Membership::Left]);
    let orders = (option::of(any_order()), any::<u16>());
    let heartbeat = (any_header(), steps, membership, orders, any::<bool>()).prop_filter_map(
        "implausible",
        move |(header, (step, vouched, reached, progress_m), membership, (order, orders), is_same)| {
            let plan = if is_same { plan } else { 1 };
            let lost = VehicleId::first(usize::from(orders) % 5).collect();
            let echo = None;
            let message =
                Heartbeat { header, plan, membership, step, vouched, reached, progress_m, order, orders, echo, lost };
            decode::<Heartbeat>(&encode(&message)).ok().map(PeerMessage::Mission)
        },
    );
    prop_oneof![
        3 => state,
        3 => heartbeat,
        1 => (1_u8..=4).prop_map(|number| PeerMessage::Appeared(id(number))),
        1 => (1_u8..=4).prop_map(|number| PeerMessage::Vanished(id(number))),
        1 => any_order().prop_map(PeerMessage::Order),
    ]
}

fn any_answer() -> impl Strategy<Value = LawReply> {
    let finite = || number().prop_filter("not finite", |number| number.is_finite());
    let command = prop_oneof![
        [finite(), finite(), finite()].prop_map(|velocity| ReplyCommand::VelocityNed(Vector3::from(velocity))),
        [finite(), finite()].prop_map(|field| ReplyCommand::FieldNe(Vector2::from(field))),
    ];
    (1_u8..3, 0_u64..200, command, option::of(finite()), option::of(any::<bool>())).prop_map(
        |(vehicle, tick, command, heading_rad, reached)| LawReply {
            vehicle: id(vehicle),
            tick,
            command,
            heading_rad,
            reached,
            log: Vec::new(),
        },
    )
}

fn any_step(plan: u64) -> impl Strategy<Value = Step> {
    let elapsed = prop_oneof![6 => Just((0.02, 0.02)), 1 => (0.0..3.0, -1.0..3.0), 1 => (0.0..100.0, -1e3..1e3)];
    let measurement =
        prop_oneof![3 => Just(Some(measurement())), 3 => any_measurement().prop_map(Some), 1 => Just(None)];
    let standstill = option::weighted(0.1, select(vec![Standstill::Paused, Standstill::Crashed, Standstill::Placed]));
    (
        (elapsed, measurement, vec((any_message(plan), 0.0..1.0), 0..4)),
        (standstill, option::weighted(0.05, 0.0..5.0), prop::bool::weighted(0.01), option::of(any_answer())),
        (vec((any_stranger(), 0.0..1.0), 0..3), vec((any_intent(), 0.0..1.0), 0..3)),
    )
        .prop_map(
            |((elapsed, measurement, received), (standstill, did_not_run_s, leave, answer), (strangers, intents))| {
                let (local_s, plant_s) = elapsed;
                let of_others = Step { strangers, intents, ..Step::default() };
                Step { local_s, plant_s, measurement, received, standstill, did_not_run_s, leave, answer, ..of_others }
            },
        )
}

#[test]
fn no_sequence_of_inputs_gives_a_control_outside_its_travel() {
    for sets in FLIGHTS {
        let plan = scenario(sets).plan_hash();
        proptest!(cases(150), |(steps in vec(any_step(plan), 1..80))| {
            let mut flight = Flight::new(sets);
            steps.iter().for_each(|step| flight.step(step));
        });
    }
}

#[test]
fn no_reports_of_others_take_an_agreement_back_or_beyond_the_last_step() {
    const LAST_STEP: u32 = 3;
    let step = || 0..=MAX_STEP;
    let membership = select(vec![Membership::Joining, Membership::Active, Membership::Left]);
    let other = (membership, step(), step(), option::of(step())).prop_map(|(membership, step, vouched, reached)| {
        AgreementState { membership, step, vouched: vouched.min(step), reached }
    });
    let act = (vec(other, 0..5), any::<bool>(), 0_u8..5, any::<u32>());
    proptest!(cases(5_000), |(acts in vec(act, 0..40), is_quorum in any::<bool>())| {
        let partition = if is_quorum { Partition::Quorum } else { Partition::Continue };
        let mut agreement = Agreement::new(5, LAST_STEP, partition);
        agreement.set_membership(Membership::Active);
        for (states, absent_may_fly, act, to) in acts {
            let before = agreement.own();
            let others = OtherStates { states: states.into_iter(), absent_may_fly };
            match act {
                0 => agreement.reach(),
                1 => drop(agreement.order(to)),
                2 => drop(agreement.advance(&others)),
                _ => drop(agreement.follow(&others)),
            }
            let after = agreement.own();
            prop_assert!(after.step >= before.step && after.vouched >= before.vouched && after.reached >= before.reached);
            prop_assert!(after.step <= LAST_STEP && after.vouched <= after.step && after.reached <= Some(LAST_STEP));
        }
    });
}
