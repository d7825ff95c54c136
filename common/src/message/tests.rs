use proptest::prelude::*;

use super::*;
use crate::frame::{Geodetic, VelocityNed};

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

fn mission() -> Mission {
    let order = Order { epoch: 1, issuer: 9, verb: Verb::Land };
    Mission {
        header: header(),
        plan: 7,
        membership: Membership::Active,
        step: 3,
        reached: Some(2),
        progress_m: 0.5,
        order: Some(order),
    }
}

/// The header above: id 3, incarnation, sequence 42, stamp, as postcard's variable-length integers.
const HEADER: [u8; 10] = [3, 0xc0, 0x84, 0x3d, 42, 0x80, 0xde, 0xa0, 0xcb, 0x05];

#[test]
fn a_state_has_these_bytes() {
    let mut golden = vec![VERSION];
    golden.extend(HEADER);
    for number in [0.5_f64, -1.25, 30.0, 1.0, -2.0, 0.5, 1.5] {
        golden.extend(number.to_le_bytes());
    }
    assert_eq!(encode(&state()), golden);
    assert_eq!(decode(&golden), Ok(state()));
}

#[test]
fn agreement_and_events_have_these_bytes() {
    let mut golden = vec![VERSION];
    golden.extend(HEADER);
    golden.extend([7, 1, 3, 1, 2]);
    golden.extend(0.5_f64.to_le_bytes());
    golden.extend([1, 1, 9, 1]);
    assert_eq!(encode(&mission()), golden);
    assert_eq!(decode(&golden), Ok(mission()));

    let mut golden = vec![VERSION];
    golden.extend(HEADER);
    golden.extend([2, 4]);
    let event = Event { header: header(), what: Happening::PeerLost(VehicleId::new(4).unwrap()) };
    assert_eq!(encode(&event), golden);
    assert_eq!(decode(&golden), Ok(event));
}

#[test]
fn what_no_correct_peer_says_is_refused() {
    let good = encode(&state());
    assert_eq!(decode::<State>(&[]), Err(DecodeError::Empty));
    let mut other = good.clone();
    other[0] = 9;
    assert_eq!(decode::<State>(&other), Err(DecodeError::Version(9)));
    let mut longer = good.clone();
    longer.push(0);
    assert_eq!(decode::<State>(&longer), Err(DecodeError::Malformed));
    assert_eq!(decode::<State>(&[VERSION; 4096]), Err(DecodeError::TooLong(4096)));
    assert_eq!(decode::<State>(&good[..good.len() - 1]), Err(DecodeError::Malformed));
    let mut nobody = good.clone();
    nobody[1] = 0;
    assert_eq!(decode::<State>(&nobody), Err(DecodeError::Malformed), "vehicle 0 does not exist");
    for (offset, bad) in [(11, f64::NAN), (11, 2.0), (27, f64::INFINITY), (35, 1e6), (59, f64::NEG_INFINITY)] {
        let mut bytes = good.clone();
        bytes[offset..offset + 8].copy_from_slice(&bad.to_le_bytes());
        assert_eq!(decode::<State>(&bytes), Err(DecodeError::Implausible), "{bad} at {offset}");
    }
}

#[test]
fn the_larger_order_wins_whoever_is_asked_first() {
    let early = Order { epoch: 1, issuer: 900, verb: Verb::Land };
    let late = Order { epoch: 2, issuer: 1, verb: Verb::Hold };
    assert_eq!(early.max(late), late);
    let end = Order { epoch: 1, issuer: 0, verb: Verb::Abort };
    assert_eq!(end.max(late), end, "nothing takes an abort back");
    assert_eq!(Some(early).max(None), Some(early));
}

proptest! {
    #[test]
    fn any_bytes_are_decoded_or_refused(mut bytes in proptest::collection::vec(any::<u8>(), 0..200), versioned: bool) {
        if versioned && !bytes.is_empty() {
            bytes[0] = VERSION;
        }
        if let Ok(said) = decode::<State>(&bytes) {
            prop_assert!(said.is_plausible());
        }
        if let Ok(said) = decode::<Trace>(&bytes) {
            prop_assert!(said.is_plausible());
        }
        if let Ok(said) = decode::<Health>(&bytes) {
            prop_assert!(said.is_plausible());
        }
        let _ = decode::<Mission>(&bytes);
        let _ = decode::<Event>(&bytes);
    }

    #[test]
    fn a_flipped_bit_never_makes_an_implausible_state(byte in 0_usize..67, bit in 0_u8..8) {
        let mut bytes = encode(&state());
        bytes[byte] ^= 1 << bit;
        if let Ok(said) = decode::<State>(&bytes) {
            prop_assert!(said.is_plausible());
        }
    }
}
