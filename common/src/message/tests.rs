use proptest::prelude::*;

use super::*;
use crate::frame::{Geodetic, VelocityNed};
use crate::scenario::TunableKey;
use crate::state::{Activity, PeerStatus};

fn header() -> Header {
    Header {
        sender: VehicleId::new(3).unwrap(),
        incarnation: Incarnation(1_000_000),
        sequence: 42,
        stamp: SenderStamp::from_seconds(1.5),
    }
}

fn state() -> State {
    State {
        header: header(),
        state: VehicleState {
            position: Geodetic { latitude_rad: 0.5, longitude_rad: -1.25, altitude_m: 30.0 },
            velocity: VelocityNed::new(1.0, -2.0, 0.5),
            heading_rad: 1.5,
        },
    }
}

fn signature() -> Signature {
    Signature::from_bytes(std::array::from_fn(|nth| nth as u8))
}

fn mission() -> Heartbeat {
    let order = Order { epoch: 1, issuer: 9, verb: Verb::Land, vehicles: None, signature: Some(signature()) };
    Heartbeat {
        header: header(),
        plan: 7,
        membership: Membership::Active,
        step: 3,
        vouched: 1,
        reached: Some(2),
        progress_m: 0.5,
        order: Some(order),
        orders: 1,
        echo: Some(Echo {
            of: VehicleId::new(2).unwrap(),
            stamp: SenderStamp::from_nanoseconds(300),
            held_us: 200_000,
        }),
        lost: [1, 65].map(|number| VehicleId::new(number).unwrap()).into_iter().collect(),
    }
}

fn setting() -> Order {
    let verb = Verb::Set(Setting { key: TunableKey::Radius, value: 80.0 });
    Order { epoch: 5, issuer: 9, verb, vehicles: None, signature: None }
}

/// The header above: id 3, incarnation, sequence 42, stamp, as postcard's variable-length integers.
const HEADER: [u8; 10] = [3, 0xc0, 0x84, 0x3d, 42, 0x80, 0xde, 0xa0, 0xcb, 0x05];

#[test]
fn a_state_is_encoded_as_the_golden_bytes() {
    let mut golden = vec![VERSION];
    golden.extend(HEADER);
    for number in [0.5_f64, -1.25, 30.0, 1.0, -2.0, 0.5, 1.5] {
        golden.extend(number.to_le_bytes());
    }
    assert_eq!(encode(&state()), golden);
    assert_eq!(encoded_len(&state()), golden.len());
    assert_eq!(decode(&golden), Ok(state()));
}

#[test]
fn a_heartbeat_and_an_event_are_encoded_as_the_golden_bytes() {
    let mut golden = vec![VERSION];
    golden.extend(HEADER);
    golden.extend([7, 1, 3, 1, 1, 2]);
    golden.extend(0.5_f64.to_le_bytes());
    // The order and its signature.
    golden.extend([1, 1, 9, 1, 0, 1]);
    golden.extend(signature().to_bytes());
    // Vehicle 2's stamp, held for 0.2 s, after the number of orders.
    golden.extend([1, 1, 2, 0xac, 0x02, 0xc0, 0x9a, 0x0c]);
    // The lost vehicles 1 and 65.
    golden.extend([1, 1, 0, 0]);
    assert_eq!(encode(&mission()), golden);
    assert_eq!(decode(&golden), Ok(mission()));
    let plain = Heartbeat { order: mission().order.map(|order| Order { signature: None, ..order }), ..mission() };
    assert_eq!(encode(&plain).len(), golden.len() - 64, "an order without a signature spends one byte on that");

    let mut golden = vec![VERSION];
    golden.extend(HEADER);
    golden.extend([2, 4]);
    let event = Event { header: header(), what: EventKind::PeerLost(VehicleId::new(4).unwrap()) };
    assert_eq!(encode(&event), golden);
    assert_eq!(decode(&golden), Ok(event));
}

#[test]
fn an_event_of_the_simulator_is_encoded_as_the_golden_bytes_and_its_text_has_to_be_printable() {
    let text = ShortText::of("a/b");
    for (what, numbers) in [
        (EventKind::SimulatorStopped(Standstill::OtherAircraft(text)), [22, 5]),
        (EventKind::SimulatorFault(SimulatorFault::NoDataref(text)), [26, 0]),
    ] {
        let mut golden = vec![VERSION];
        golden.extend(HEADER);
        golden.extend(numbers);
        golden.extend([3, b'a', b'/', b'b']);
        let event = Event { header: header(), what };
        assert_eq!((encode(&event), decode(&golden)), (golden.clone(), Ok(event)));
        *golden.last_mut().unwrap() = 0x1b;
        assert_eq!(decode::<Event>(&golden), Err(DecodeError::Implausible));
    }
}

#[test]
fn ground_off_the_origin_is_encoded_as_the_golden_bytes_and_has_a_limit() {
    let event =
        |off_m| Event { header: header(), what: EventKind::SimulatorFault(SimulatorFault::GroundOffOrigin(off_m)) };
    let mut golden = vec![VERSION];
    golden.extend(HEADER);
    golden.extend([26, 3, 83]);
    assert_eq!((encode(&event(-42)), decode(&golden)), (golden, Ok(event(-42))));
    for off_m in [20_001, i32::MIN, i32::MAX] {
        assert_eq!(decode::<Event>(&encode(&event(off_m))), Err(DecodeError::Implausible));
    }
}

#[test]
fn an_order_to_some_vehicles_is_encoded_as_the_golden_bytes() {
    let vehicles = [1, 3, 65].map(|number| VehicleId::new(number).unwrap()).into_iter().collect();
    let order = Order { epoch: 5, issuer: 9, verb: Verb::Release, vehicles: Some(vehicles), signature: None };
    let golden = [VERSION, 5, 9, 4, 1, 0b101, 1, 0, 0, 0];
    assert_eq!((encode(&order), decode(&golden)), (golden.to_vec(), Ok(order)));
    assert_eq!(order.to_string(), "release, vehicle 1, 3, 65");
    for refused in [Order { vehicles: None, ..order }, Order { vehicles: Some(VehicleSet::default()), ..order }] {
        assert_eq!(decode::<Order>(&encode(&refused)), Err(DecodeError::Implausible), "{refused}");
        let heartbeat = Heartbeat { order: Some(refused), ..mission() };
        assert_eq!(decode::<Heartbeat>(&encode(&heartbeat)), Err(DecodeError::Implausible), "{refused}");
    }
}

#[test]
fn an_order_that_sets_a_key_is_encoded_as_the_golden_bytes_and_its_value_has_to_be_in_the_key_s_range() {
    let set = |key, value| Order { verb: Verb::Set(Setting { key, value }), ..setting() };
    for (nth, key) in TunableKey::ALL.iter().enumerate() {
        let value = key.range().max.min(80.0);
        let mut golden = vec![VERSION, 5, 9, 5, nth as u8];
        golden.extend(value.to_le_bytes());
        golden.extend([0, 0]);
        let order = set(*key, value);
        assert_eq!((encode(&order), decode(&golden)), (golden, Ok(order)), "{order}");
    }
    assert_eq!(setting().to_string(), "set formation.radius_m=80");
    let of_some = Order { vehicles: Some(VehicleId::first(2).collect()), ..setting() };
    let bad = [f64::NAN, f64::INFINITY, -3.0, 0.0, 1e9].map(|value| set(TunableKey::Radius, value));
    for refused in bad.into_iter().chain([of_some]) {
        assert_eq!(decode::<Order>(&encode(&refused)), Err(DecodeError::Implausible), "{refused}");
        let heartbeat = Heartbeat { order: Some(refused), ..mission() };
        assert_eq!(decode::<Heartbeat>(&encode(&heartbeat)), Err(DecodeError::Implausible), "{refused}");
        let event = Event { header: header(), what: EventKind::OrderTaken(refused) };
        assert_eq!(decode::<Event>(&encode(&event)), Err(DecodeError::Implausible), "{refused}");
    }

    let mut golden = vec![VERSION];
    golden.extend(HEADER);
    golden.extend([27, 0]);
    golden.extend(80.0_f64.to_le_bytes());
    let radius = Setting { key: TunableKey::Radius, value: 80.0 };
    let event = Event { header: header(), what: EventKind::SettingRefused(radius) };
    assert_eq!((encode(&event), decode(&golden)), (golden, Ok(event)));
    let waits = Event { header: header(), what: EventKind::LandingWaits };
    let golden = [&[VERSION][..], &HEADER, &[28]].concat();
    assert_eq!((encode(&waits), decode(&golden)), (golden, Ok(waits)));
    let endless = EventKind::SettingRefused(Setting { value: f64::INFINITY, ..radius });
    assert_eq!(decode::<Event>(&encode(&Event { header: header(), what: endless })), Err(DecodeError::Implausible));
}

#[test]
fn bytes_that_no_correct_peer_sends_are_refused() {
    let good = encode(&state());
    assert_eq!(decode::<State>(&[]), Err(DecodeError::Empty));
    let mut other = good.clone();
    other[0] = VERSION + 1;
    assert_eq!(decode::<State>(&other), Err(DecodeError::Version(VERSION + 1)));
    let mut longer = good.clone();
    longer.push(0);
    assert_eq!(decode::<State>(&longer), Err(DecodeError::Malformed));
    assert_eq!(decode::<State>(&[VERSION; 4096]), Err(DecodeError::TooLong(4096)));
    assert_eq!(decode::<State>(&good[..good.len() - 1]), Err(DecodeError::Malformed));
    let mut without_sender = good.clone();
    without_sender[1] = 0;
    assert_eq!(decode::<State>(&without_sender), Err(DecodeError::Malformed), "vehicle 0 does not exist");
    for (offset, bad) in [(11, f64::NAN), (11, 2.0), (27, f64::INFINITY), (35, 1e6), (59, f64::NEG_INFINITY)] {
        let mut bytes = good.clone();
        bytes[offset..offset + 8].copy_from_slice(&bad.to_le_bytes());
        assert_eq!(decode::<State>(&bytes), Err(DecodeError::Implausible), "{bad} at {offset}");
    }
}

#[test]
fn the_larger_of_two_orders_wins_in_either_sequence() {
    let early = Order { epoch: 1, issuer: 900, verb: Verb::Land, vehicles: None, signature: None };
    let late = Order { epoch: 2, issuer: 1, verb: Verb::Hold, vehicles: None, signature: None };
    assert_eq!(early.max(late), late);
    let end = Order { epoch: 1, issuer: 0, verb: Verb::Abort, vehicles: None, signature: None };
    assert_eq!(end.max(late), end, "no order revokes an abort");
    assert_eq!(Some(early).max(None), Some(early));
    let signed = Order { signature: Some(signature()), ..late };
    assert!(signed > late && signed.max(late) == signed && signed != late, "two different orders are never equal");
}

#[test]
fn the_largest_messages_fit() {
    let most = Header {
        sender: VehicleId::new(VehicleId::MAX).unwrap(),
        incarnation: Incarnation(u64::MAX),
        sequence: u64::MAX,
        stamp: SenderStamp::from_nanoseconds(u64::MAX),
    };
    let vehicles = Some(VehicleId::first(VehicleId::MAX.into()).collect());
    let (verb, signature) = (Verb::Goto(u32::MAX), Some(signature()));
    let order = Order { epoch: u64::MAX, issuer: u64::MAX, verb, vehicles, signature };
    let mission = Heartbeat {
        header: most,
        plan: u64::MAX,
        membership: Membership::Left,
        step: MAX_STEP,
        vouched: MAX_STEP,
        reached: Some(MAX_STEP),
        progress_m: 1e8,
        order: Some(order),
        orders: u16::MAX,
        echo: Some(Echo { of: most.sender, stamp: most.stamp, held_us: u32::MAX }),
        lost: VehicleId::first(VehicleId::MAX.into()).collect(),
    };
    assert_eq!(decode(&encode(&mission)), Ok(mission));
    assert_eq!(decode(&encode(&order)), Ok(order));
    let longest = SimulatorFault::NoDataref(ShortText::of(&"x".repeat(ShortText::MAX_LENGTH)));
    for what in [EventKind::OrderTaken(order), EventKind::SimulatorFault(longest)] {
        let event = Event { header: most, what };
        assert_eq!(decode(&encode(&event)), Ok(event));
    }
    let health = health(VehicleId::MAX);
    assert_eq!(decode(&encode(&health)).as_ref(), Ok(&health));
}

/// The largest health report of an agent in a swarm of this many vehicles.
fn health(vehicles: u8) -> Health {
    let peer = |id| PeerHealth {
        id,
        standing: PeerStatus::Fresh,
        age_s: 0.1,
        delay_s: Some(0.05),
        clock: Some(ClockOffset { offset_s: -0.5, bound_s: 0.001 }),
    };
    let refused = Refused { reason: Reason::Forged, key: "k".repeat(Refused::MAX_KEY), count: u64::MAX };
    Health {
        header: header(),
        uptime_s: 1.0,
        activity: Activity::Formation,
        in_place_s: Some(10.0),
        plant: "standin".to_owned(),
        version: "v".repeat(Health::MAX_VERSION),
        failures: vec![Failure::Servo; Failure::KINDS],
        simulator_faults: vec![
            SimulatorFault::NoDataref(ShortText::of(&"x".repeat(ShortText::MAX_LENGTH)));
            SimulatorFault::MAX_COUNT
        ],
        frame_rate_hz: 50.0,
        jitter_ms: 1.0,
        step_p50_us: 1.0,
        step_p99_us: 2.0,
        frame_overruns: u64::MAX,
        drops: Drops { forged: u64::MAX, ..Drops::default() },
        unsent: u64::MAX,
        refused: vec![refused; Refused::MAX_COUNT],
        state_messages: u64::MAX,
        state_bytes: u64::MAX,
        links: u32::MAX,
        sent: Traffic { messages: u64::MAX, bytes: u64::MAX },
        received: Traffic { messages: u64::MAX, bytes: u64::MAX },
        peers: VehicleId::first(vehicles.into()).map(peer).collect(),
    }
}

#[test]
fn a_health_report_with_too_many_or_implausible_values_is_refused() {
    let with = |change: fn(&mut Health)| {
        let mut health = health(2);
        change(&mut health);
        decode::<Health>(&encode(&health)).err()
    };
    let implausible = Some(DecodeError::Implausible);
    assert_eq!(with(|_| {}), None);
    assert_eq!(with(|health| health.refused.push(health.refused[0].clone())), implausible);
    assert_eq!(
        with(|health| health.refused[0].key = "\u{1b}[2J".to_owned()),
        implausible,
        "this key would clear the screen"
    );
    assert_eq!(with(|health| health.refused[0].key.push('k')), implausible);
    assert_eq!(with(|health| health.failures.push(Failure::Gyro)), implausible);
    assert_eq!(with(|health| health.version.push('v')), implausible);
    assert_eq!(
        with(|health| health.peers[1].clock = Some(ClockOffset { offset_s: f64::NAN, bound_s: 0.0 })),
        implausible
    );
    assert_eq!(with(|health| health.peers[1].clock = Some(ClockOffset { offset_s: 0.0, bound_s: -1.0 })), implausible);
    let printable = Refused::printable("vehicle/7\u{1b}/ü");
    assert_eq!((printable.as_str(), Refused::printable(&"x".repeat(200)).len()), ("vehicle/7?/?", Refused::MAX_KEY));
}

/// Bytes of a good message of any kind, up to two of them changed, and perhaps cut off or followed by more.
fn nearly_a_message() -> impl Strategy<Value = Vec<u8>> {
    let event = Event { header: header(), what: EventKind::PeerLost(VehicleId::new(4).unwrap()) };
    let order = Order { epoch: 1, issuer: 9, verb: Verb::Goto(2), vehicles: None, signature: Some(signature()) };
    let taken = Event { header: header(), what: EventKind::OrderTaken(setting()) };
    let signed = Order { signature: Some(signature()), ..setting() };
    let good = [
        encode(&state()),
        encode(&mission()),
        encode(&order),
        encode(&signed),
        encode(&event),
        encode(&taken),
        encode(&health(2)),
    ];
    let changes = proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 0..3);
    (proptest::sample::select(good.to_vec()), changes, 0..4_usize, 0..4_usize).prop_map(
        |(mut bytes, changes, cut, more)| {
            changes.iter().for_each(|(at, byte)| *at.get_mut(&mut bytes) = *byte);
            bytes.truncate(bytes.len() - cut);
            bytes.resize(bytes.len() + more, 0);
            bytes
        },
    )
}

/// A message of this kind is refused, or these bytes are its only encoding of their length, with nothing left over.
fn assert_refused_or_its_own_bytes<M: Message + PartialEq + std::fmt::Debug>(
    bytes: &[u8],
) -> Result<(), TestCaseError> {
    let Ok(message) = decode::<M>(bytes) else { return Ok(()) };
    prop_assert!(message.is_plausible() && bytes[0] == VERSION && bytes.len() <= M::MAX_BYTES);
    let again = encode(&message);
    // Only postcard's integers have longer encodings than their own.
    prop_assert!(again == bytes || again.len() < bytes.len());
    prop_assert_eq!(decode(&again), Ok(message));
    prop_assert!(decode::<M>(&[bytes, &[0]].concat()).is_err(), "one byte too many");
    prop_assert!(decode::<M>(&bytes[..bytes.len() - 1]).is_err(), "one byte too few");
    Ok(())
}

proptest! {
    #[test]
    fn any_bytes_are_refused_or_are_the_bytes_of_what_they_decode_to(
        bytes in prop_oneof![proptest::collection::vec(any::<u8>(), 0..200), nearly_a_message()],
    ) {
        assert_refused_or_its_own_bytes::<State>(&bytes)?;
        assert_refused_or_its_own_bytes::<Heartbeat>(&bytes)?;
        assert_refused_or_its_own_bytes::<Order>(&bytes)?;
        assert_refused_or_its_own_bytes::<Event>(&bytes)?;
        assert_refused_or_its_own_bytes::<Health>(&bytes)?;
        assert_refused_or_its_own_bytes::<Trace>(&bytes)?;
    }

    #[test]
    fn a_flipped_bit_never_makes_an_implausible_state(byte in 0_usize..67, bit in 0_u8..8) {
        let mut bytes = encode(&state());
        bytes[byte] ^= 1 << bit;
        if let Ok(message) = decode::<State>(&bytes) {
            prop_assert!(message.is_plausible());
        }
    }
}

#[test]
fn a_later_incarnation_is_newer_whatever_the_sequence_number() {
    let order = |life, sequence| Header { incarnation: Incarnation(life), sequence, ..header() }.order();
    assert!(order(2, 1) > order(1, 99) && order(1, 99) > order(1, 98) && order(1, 98) == order(1, 98));
}
