//! Messages between processes, their keys and signatures.

use std::collections::BTreeMap;

use skein_agent::link::signature::SigningKey;
use skein_agent::link::signature::messages::KeyRing;
use skein_common::frame::{Geodetic, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, SwarmName, VehicleId, VehicleSet};
use skein_common::message::{
    Area, ClockAnswer, ClockOffset, Drops, Encoding, Event, EventKind, Failure, Header, Health, Heartbeat, Intent,
    Message, Order, PeerContact, PeerHealth, ProcessFigures, Reason, Refused, Signature, SimulatorFault, State,
    Summary, Trace, Traffic, VERSION, VehicleFacts, Verb, decode, encode,
};
use skein_common::scenario::{Setting, TunableKey};
use skein_common::state::{Activity, Membership, PeerStatus, VehicleState};
use skein_common::time::{PlantTime, SenderStamp};
use skein_common::topic::{Branch, Cell, Topic};

use skein_fuzz::{assert_same, explore, explore_text};

use super::agent::a_trace;

pub(super) fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

pub(super) fn header(sender: u8, sequence: u64) -> Header {
    Header { sender: id(sender), incarnation: Incarnation(7), sequence, stamp: SenderStamp::from_seconds(1.5) }
}

fn state() -> State {
    let position = Geodetic::from_degrees(28.0, -82.0, 30.0);
    let state = VehicleState { position, velocity: VelocityNed::new(1.0, -2.0, 0.5), heading_rad: 1.5 };
    State { header: header(3, 42), state }
}

fn order() -> Order {
    let signature = Some(Signature::from_bytes([7; Signature::BYTES]));
    Order { epoch: 1, issuer: 9, verb: Verb::Goto(2), vehicles: Some(VehicleId::first(3).collect()), signature }
}

pub(super) fn heartbeat(sender: u8, sequence: u64) -> Heartbeat {
    let header = header(sender, sequence);
    let (membership, order) = (Membership::Active, Some(order()));
    Heartbeat {
        header,
        plan: 7,
        membership,
        step: 3,
        vouched: 1,
        reached: Some(2),
        progress_m: 0.5,
        order,
        orders: 1,
        echo: None,
        lost: VehicleSet::default(),
    }
}

fn health() -> Health {
    let clock = Some(ClockOffset { offset_s: -0.5, bound_s: 0.001 });
    let peer = PeerHealth { id: id(4), standing: PeerStatus::Fresh, age_s: 0.1, delay_s: Some(0.05), clock };
    let refused = Refused { reason: Reason::Forged, key: "vehicle/7/event".to_owned(), count: 2 };
    Health {
        header: header(3, 5),
        uptime_s: 1.0,
        activity: Activity::Formation,
        in_place_s: Some(4.0),
        plant: "standin".to_owned(),
        version: "0.1.0".to_owned(),
        failures: vec![Failure::Servo],
        simulator_faults: vec![SimulatorFault::RandomFailures],
        frame_rate_hz: 50.0,
        jitter_ms: 1.0,
        step_p50_us: 1.0,
        step_p99_us: 2.0,
        frame_overruns: 3,
        drops: Drops::default(),
        unsent: 7,
        refused: vec![refused],
        state_messages: 4,
        state_bytes: 5,
        links: 6,
        sent: Traffic::default(),
        received: Traffic::default(),
        peers: vec![peer; 2],
    }
}

fn intent() -> Intent {
    let area = Area { centre: Geodetic::from_degrees(28.0, -82.0, 30.0), radius_m: 100.0 };
    Intent { header: header(3, 6), occupied: area, wanted: Some(area) }
}

fn examples() -> Vec<Vec<u8>> {
    let clock = ClockAnswer { sender: id(3), question: 1, received_ns: 5, answered_ns: 6 };
    let event = Event { header: header(3, 4), what: EventKind::OrderTaken(order()) };
    let setting = Setting { key: TunableKey::Radius, value: 80.0 };
    let set = Order { verb: Verb::Set(setting), vehicles: None, ..order() };
    let state_and_order = [encode(&state()), encode(&order()), encode(&set)];
    let of_a_vehicle = [encode(&heartbeat(3, 1)), encode(&event), encode(&health()), encode(&a_trace())];
    [&state_and_order[..], &of_a_vehicle, &[encode(&clock), encode(&intent())]].concat()
}

/// The bytes are refused, or give a plausible message that is encoded and decoded again without a change. Only JSON may change the
/// last digit of a number.
fn assert_refused_or_plausible<M: Message + PartialEq + std::fmt::Debug>(bytes: &[u8]) {
    let Ok(message) = decode::<M>(bytes) else { return };
    assert!(message.is_plausible() && bytes.len() <= M::MAX_BYTES);
    assert!(bytes[0] == VERSION || M::ENCODING == Encoding::Json);
    let encoded = encode(&message);
    let again: M = decode(&encoded).unwrap();
    if M::ENCODING == Encoding::Json {
        let value = |bytes: &[u8]| serde_json::from_slice(bytes).unwrap();
        assert_same(&value(&encoded), &value(&encode(&again)));
    } else {
        assert_eq!(again, message);
    }
}

fn assert_each_kind_is_refused_or_plausible(bytes: &[u8]) {
    assert_refused_or_plausible::<State>(bytes);
    assert_refused_or_plausible::<Heartbeat>(bytes);
    assert_refused_or_plausible::<Order>(bytes);
    assert_refused_or_plausible::<Event>(bytes);
    assert_refused_or_plausible::<Health>(bytes);
    assert_refused_or_plausible::<Trace>(bytes);
    assert_refused_or_plausible::<ClockAnswer>(bytes);
    assert_refused_or_plausible::<Intent>(bytes);
}

/// A ring of vehicle 3 and the message that it signed, with its key.
fn signed() -> (KeyRing, String, Vec<u8>) {
    let pair = rcgen::KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
    let signing_key = SigningKey::from_pkcs8(&pair.serialize_der()).unwrap();
    let keys = BTreeMap::from([(Branch::SWARM.name(id(3)), signing_key.key())]);
    let ring = KeyRing::signed(SwarmName::new("fuzz").unwrap(), keys);
    let key = Topic::State(id(3), Cell::default()).key();
    let bytes = ring.write(Some(&signing_key), 5, &key, &state());
    (ring, key, bytes)
}

#[test]
fn a_summary_is_refused_or_plausible_and_stays_the_same() {
    let process = ProcessFigures {
        frame_rate_hz: 50.0,
        jitter_ms: 1.0,
        step_p99_us: 80.0,
        frame_overruns: 0,
        dropped: 4,
        unsent: 7,
    };
    let facts = VehicleFacts {
        flown_s: Some(2.5),
        activity: Activity::Formation,
        membership: Membership::Active,
        step: 1,
        reached: Some(0),
        settings: vec![Setting { key: TunableKey::Radius, value: 80.0 }],
        live: 3,
        position: Some(PositionNed::new(1.0, -2.0, -30.0)),
        velocity: VelocityNed::new(1.0, -2.0, 0.5),
        centre_ne_m: [0.0, 5.0],
        altitude_setpoint_m: Some(30.0),
        field_ne: Some([0.5, -0.5]),
        controls: Some([0.1, -0.1, 0.0, 0.5]),
        power_w: Some(900.0),
        energy_left: Some(0.5),
        process: Some(process),
        failures: vec![Failure::Servo],
        peers: vec![PeerContact { id: id(4), age_ms: 120, standing: PeerStatus::Fresh }; 2],
        ..VehicleFacts::default()
    };
    let summary = Summary { header: header(3, 9), plant_time: PlantTime::from_seconds(12.5), facts };
    let example = encode(&summary);
    assert_eq!(decode::<Summary>(&example), Ok(summary));
    explore(10_000, &[example], assert_refused_or_plausible::<Summary>);
}

#[test]
fn a_message_of_any_kind_is_refused_or_plausible() {
    explore(20_000, &examples(), assert_each_kind_is_refused_or_plausible);
}

#[test]
fn no_damaged_message_passes_as_signed() {
    let (ring, key, bytes) = signed();
    assert_eq!(ring.read::<State>(&key, &bytes).unwrap().message, state());
    let keys = [key.clone(), Topic::State(id(4), Cell::default()).key(), Topic::Health(id(3)).key()];
    let signed = bytes.clone();
    explore(2_000, &[bytes], |received| {
        for under in &keys {
            if let Ok(read) = ring.read::<State>(under, received) {
                assert!(*under == key && received == signed && read.message == state() && read.run == Some(5));
            }
        }
    });
}

#[test]
fn a_key_is_refused_or_is_the_key_of_its_topic() {
    let examples = [
        "vehicle/7/cell/-1/1/state",
        "vehicle/17/cell/0/-12/intent",
        "vehicle/7/alive",
        "vehicle/250/clock",
        "order/12",
        "team/3/vehicle/7/mission",
        "team/4096/order/18446744073709551615",
        "vehicle/+3/alive",
        "vehicle/03/health",
        "vehicle/3/cell/-0/+1/state",
        "team/+3/vehicle/7/event",
        "order/+1",
    ];
    explore_text(20_000, &examples, |key| {
        if let Some((branch, topic)) = Branch::parse(key) {
            assert_eq!(branch.key(&topic), key);
        }
    });
}
