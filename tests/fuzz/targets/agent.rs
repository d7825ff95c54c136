//! The control loop and the agreement, which have a state: any sequence of inputs.

use arbitrary::{Error, Result, Unstructured};
use nalgebra::{Vector2, Vector3};
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
use skein_core::formation::laws::built_in;
use skein_core::impairments::StrangerNetwork;
use skein_core::intent::ReceivedIntent;
use skein_core::mission::agreement::{Agreement, AgreementState, OtherStates};
use skein_core::peers::{Broadcast, PeerMessage, Received, ReceivedState};
use skein_core::plant::{Command, GroundTruth, Measurement, PlantStatus};
use skein_core::skew::StepClock;
use skein_core::strangers::{KnownStrangers, StrangerState};
use skein_fuzz::explore;
use skein_tests::SHIPPED;

use super::draws::{between, number, option, parts, several, sometimes};
use super::messages::id;

/// What the fuzzed vehicles fly beside every built-in law: each conversion, with and without the safety filter, an external law,
/// alone and in a fleet whose teams wait for one another.
const FLIGHTS: [&[&str]; 6] = [
    &[],
    &["formation.safety_filter='cbf'", "mission.partition='quorum'"],
    &["formation.conversion='nonlinear'", "sensing.position='f32_latlon'", "sensing.velocity='differenced'"],
    &["formation.law='olfati-saber'", "formation.safety_filter='cbf'"],
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
#[derive(Clone)]
struct Flight {
    agent: Agent,
    strangers: StrangerNetwork,
    now: Now,
    workspace: Workspace,
}

impl Flight {
    fn new(sets: &[&str]) -> Self {
        let scenario = scenario(sets);
        let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
        let agent = Agent::new(&scenario, id(1), Incarnation(7), &aircraft, Rules::shipped()).unwrap();
        let mut strangers = StrangerNetwork::new(&scenario);
        strangers.begin(id(1));
        let mut flight = Self { agent, strangers, now: Now::default(), workspace: Workspace::default() };
        let undisturbed = Step { measurement: Some(measurement()), local_s: 0.02, plant_s: 0.02, ..Step::default() };
        (0..JOINED).for_each(|_| flight.step(&undisturbed));
        assert_eq!(flight.agent.membership(), Membership::Active);
        flight
    }

    /// Runs one step and checks all that comes out of it.
    fn step(&mut self, step: &Step) {
        self.now.local = self.now.local.plus_seconds(step.local_s);
        self.now.plant = self.now.plant.plus_seconds(step.plant_s);
        let at = |early_s: f64| self.now.local.plus_seconds(-early_s);
        let received: Vec<_> =
            step.received.iter().map(|(message, early_s)| Received { message: *message, at: at(*early_s) }).collect();
        let arrived = |intent: &(ReceivedIntent, f64)| ReceivedIntent { at: at(intent.1), ..intent.0 };
        let intents: Vec<_> = step.intents.iter().map(arrived).collect();
        self.strangers.set_receivers([(id(1), self.agent.position(), self.agent.strangers_reach_m())].into_iter());
        for (state, early_s) in &step.strangers {
            let state = StrangerState { at: at(*early_s), ..*state };
            self.strangers.send(&state, self.now.local, [id(1)].into_iter().collect());
        }
        self.strangers.deliver(self.now.local);
        let (records, clock) = (self.strangers.records(), StepClock::default());
        let status = PlantStatus { standstill: step.standstill, ..PlantStatus::default() };
        let inputs = Inputs {
            did_not_run_s: step.did_not_run_s,
            status: &status,
            measurement: step.measurement.as_ref(),
            received: &received,
            broadcast: Broadcast::default(),
            strangers: Some(KnownStrangers { records, right: self.now.local, clock }),
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

fn three(from: &mut Unstructured) -> Result<[f64; 3]> {
    Ok([number(from)?, number(from)?, number(from)?])
}

fn any_measurement(from: &mut Unstructured) -> Result<Measurement> {
    let usual = measurement();
    // One part is wrong at a time: an implausible measurement is refused as a whole.
    Ok(match from.int_in_range(0..=4)? {
        0 => Measurement { rotor_speed_rad_s: option(from, 0.7, number)?, ..usual },
        1 => Measurement { height_m: number(from)?, ..usual },
        2 => Measurement { velocity: VelocityNed::from(three(from)?), ..usual },
        3 => {
            let [roll_rad, pitch_rad, heading_rad] = three(from)?;
            let [roll_rad_s, pitch_rad_s, yaw_rad_s] = three(from)?;
            let attitude = Attitude { roll_rad, pitch_rad, heading_rad };
            Measurement { attitude, rates: BodyRates { roll_rad_s, pitch_rad_s, yaw_rad_s }, ..usual }
        }
        _ => Measurement { position: near(three(from)?), ..usual },
    })
}

/// A place so many metres, roughly, from where vehicle 1 begins.
fn near([north, east, up]: [f64; 3]) -> Geodetic {
    Geodetic::from_degrees(28.0 + 1e-5 * north, -82.0 + 1e-5 * east, 30.0 + up)
}

fn any_header(from: &mut Unstructured) -> Result<Header> {
    Ok(Header {
        sender: id(from.int_in_range(1..=4)?),
        incarnation: Incarnation(from.int_in_range(0..=2)?),
        sequence: from.int_in_range(0..=60)?,
        stamp: SenderStamp::from_nanoseconds(from.int_in_range(0..=20_000_000_000)?),
    })
}

fn any_order(from: &mut Unstructured) -> Result<Order> {
    let verb = match from.int_in_range(0..=5)? {
        0 => Verb::Hold,
        1 => Verb::Land,
        2 => Verb::Abort,
        3 => Verb::Goto(from.int_in_range(0..=MAX_STEP)?),
        4 => Verb::Goto(from.arbitrary()?),
        _ => {
            let key = *from.choose(TunableKey::ALL)?;
            let Range { min, max, .. } = key.range();
            // Few keys can have most of the numbers: most of the values are in the key's range.
            let value = if sometimes(from, 0.3)? { number(from)? } else { between(from, min, max.min(200.0))? };
            let setting = Setting { key, value };
            if !setting.is_in_range() {
                return Err(Error::IncorrectFormat);
            }
            Verb::Set(setting)
        }
    };
    let of_some = !matches!(verb, Verb::Set(_)) && sometimes(from, 0.5)?;
    let some =
        |from: &mut Unstructured| Ok(several(from, 3, |from| Ok(id(from.int_in_range(1..=5)?)))?.into_iter().collect());
    let vehicles = if of_some { Some(some(from)?) } else { None };
    Ok(Order { epoch: from.arbitrary()?, issuer: from.arbitrary()?, verb, vehicles, signature: None })
}

/// The message as a decoder hands it on, if one accepts it.
fn received<M: Message>(message: &M) -> Result<M> {
    decode(&encode(message)).map_err(|_| Error::IncorrectFormat)
}

/// A state that a decoder accepts.
fn any_state(from: &mut Unstructured) -> Result<State> {
    let state = VehicleState {
        position: near(three(from)?),
        velocity: VelocityNed::from(three(from)?),
        heading_rad: number(from)?,
    };
    received(&State { header: any_header(from)?, state })
}

fn any_team(from: &mut Unstructured) -> Result<TeamId> {
    Ok(TeamId::new(from.int_in_range(1..=4)?).unwrap())
}

/// A state of a vehicle of another team, as the link hands it on.
fn any_stranger(from: &mut Unstructured) -> Result<StrangerState> {
    let State { header, state } = any_state(from)?;
    Ok(StrangerState {
        id: FleetVehicle { team: any_team(from)?, vehicle: header.sender },
        order: header.order(),
        position: origin().ned_from_geodetic(&state.position),
        velocity: state.velocity,
        at: LocalTime::default(),
    })
}

fn any_area(from: &mut Unstructured) -> Result<Area> {
    Ok(Area { centre: near(three(from)?), radius_m: number(from)? as f32 })
}

/// An intent of a vehicle of another team, as the link hands it on.
fn any_intent(from: &mut Unstructured) -> Result<ReceivedIntent> {
    let intent = Intent { header: any_header(from)?, occupied: any_area(from)?, wanted: option(from, 0.5, any_area)? };
    Ok(ReceivedIntent::new(any_team(from)?, &received(&intent)?, &origin(), LocalTime::default()))
}

fn any_membership(from: &mut Unstructured) -> Result<Membership> {
    from.choose(&[Membership::Joining, Membership::Active, Membership::Left]).copied()
}

/// A message that a decoder accepts; most heartbeats are of this plan.
fn any_message(from: &mut Unstructured, plan: u64) -> Result<PeerMessage> {
    Ok(match from.int_in_range(0..=8)? {
        0..=2 => received_state(any_state(from)?),
        3..=5 => PeerMessage::Mission(received(&Heartbeat {
            header: any_header(from)?,
            plan: if sometimes(from, 0.7)? { plan } else { 1 },
            membership: any_membership(from)?,
            step: from.int_in_range(0..=4)?,
            vouched: from.int_in_range(0..=4)?,
            reached: option(from, 0.5, |from| from.int_in_range(0..=4))?,
            progress_m: number(from)?,
            order: option(from, 0.5, any_order)?,
            orders: from.arbitrary()?,
            echo: None,
            lost: VehicleId::first(from.int_in_range(0..=4)?).collect(),
        })?),
        6 => PeerMessage::Appeared(id(from.int_in_range(1..=4)?)),
        7 => PeerMessage::Vanished(id(from.int_in_range(1..=4)?)),
        _ => PeerMessage::Order(any_order(from)?),
    })
}

fn finite(from: &mut Unstructured) -> Result<f64> {
    let number = number(from)?;
    if number.is_finite() { Ok(number) } else { Err(Error::IncorrectFormat) }
}

fn any_answer(from: &mut Unstructured) -> Result<LawReply> {
    let command = if from.arbitrary()? {
        ReplyCommand::VelocityNed(Vector3::new(finite(from)?, finite(from)?, finite(from)?))
    } else {
        ReplyCommand::FieldNe(Vector2::new(finite(from)?, finite(from)?))
    };
    Ok(LawReply {
        vehicle: id(from.int_in_range(1..=2)?),
        tick: from.int_in_range(0..=200)?,
        command,
        heading_rad: option(from, 0.5, finite)?,
        reached: option(from, 0.5, |from| from.arbitrary())?,
        log: Vec::new(),
    })
}

fn any_step(from: &mut Unstructured, plan: u64) -> Result<Step> {
    let (local_s, plant_s) = match from.int_in_range(0..=7)? {
        0 => (between(from, 0.0, 3.0)?, between(from, -1.0, 3.0)?),
        1 => (between(from, 0.0, 100.0)?, between(from, -1e3, 1e3)?),
        _ => (0.02, 0.02),
    };
    let measurement = match from.int_in_range(0..=6)? {
        0 => None,
        1..=3 => Some(any_measurement(from)?),
        _ => Some(measurement()),
    };
    let standstill = [Standstill::Paused, Standstill::Crashed, Standstill::Placed];
    // Each comes up to a second before the step.
    let early = |from: &mut Unstructured| between(from, 0.0, 1.0);
    Ok(Step {
        local_s,
        plant_s,
        measurement,
        received: several(from, 3, |from| Ok((any_message(from, plan)?, early(from)?)))?,
        strangers: several(from, 2, |from| Ok((any_stranger(from)?, early(from)?)))?,
        intents: several(from, 2, |from| Ok((any_intent(from)?, early(from)?)))?,
        standstill: option(from, 0.1, |from| from.choose(&standstill).copied())?,
        did_not_run_s: option(from, 0.05, |from| between(from, 0.0, 5.0))?,
        leave: sometimes(from, 0.01)?,
        answer: option(from, 0.5, any_answer)?,
    })
}

#[test]
fn no_sequence_of_inputs_gives_a_control_outside_its_travel() {
    let flight = |sets: &[&str]| (Flight::new(sets), scenario(sets).plan_hash());
    let by_law = built_in().into_iter().map(|law| flight(&[&format!("formation.law='{law}'")]));
    let flights: Vec<_> = FLIGHTS.iter().map(|sets| flight(sets)).chain(by_law).collect();
    explore(1_500, &[], |bytes| {
        let mut from = Unstructured::new(bytes);
        let (mut flight, plan) = from.choose(&flights).cloned().unwrap_or(flights[0].clone());
        parts(&mut from, 80, |from| any_step(from, plan)).iter().for_each(|step| flight.step(step));
    });
}

/// What may happen to an agreement: states of others, whether an absent one may fly, an act, and the step that it is about.
type Act = (Vec<AgreementState>, bool, u8, u32);

fn any_act(from: &mut Unstructured) -> Result<Act> {
    let step = |from: &mut Unstructured| from.int_in_range(0..=MAX_STEP);
    let other = |from: &mut Unstructured| {
        let (membership, at) = (any_membership(from)?, step(from)?);
        let (vouched, reached) = (from.int_in_range(0..=at)?, option(from, 0.5, step)?);
        Ok(AgreementState { membership, step: at, vouched, reached })
    };
    Ok((several(from, 4, other)?, from.arbitrary()?, from.int_in_range(0..=4)?, from.arbitrary()?))
}

#[test]
fn no_reports_of_others_take_an_agreement_back_or_beyond_the_last_step() {
    const LAST_STEP: u32 = 3;
    explore(5_000, &[], |bytes| {
        let mut from = Unstructured::new(bytes);
        let partition = if from.arbitrary().unwrap_or(false) { Partition::Quorum } else { Partition::Continue };
        let mut agreement = Agreement::new(5, LAST_STEP, partition);
        agreement.set_membership(Membership::Active);
        for (states, absent_may_fly, act, to) in parts(&mut from, 40, any_act) {
            let before = agreement.own();
            let others = OtherStates { states: states.into_iter(), absent_may_fly };
            match act {
                0 => agreement.reach(),
                1 => drop(agreement.order(to)),
                2 => drop(agreement.advance(&others)),
                _ => drop(agreement.follow(&others)),
            }
            let after = agreement.own();
            assert!(after.step >= before.step && after.vouched >= before.vouched && after.reached >= before.reached);
            assert!(after.step <= LAST_STEP && after.vouched <= after.step && after.reached <= Some(LAST_STEP));
        }
    });
}
