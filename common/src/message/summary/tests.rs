use proptest::prelude::*;

use super::super::{DecodeError, ProcessFigures, VERSION, decode, encode, encoded_len};
use super::*;
use crate::frame::{Attitude, PositionNed, VelocityNed};
use crate::id::Incarnation;
use crate::state::{Activity, Membership};
use crate::time::SenderStamp;

fn summary(peers: u8) -> Summary {
    let contact = |id| PeerContact { id, age_ms: 85, standing: PeerStatus::Fresh };
    Summary {
        header: Header {
            sender: VehicleId::new(3).unwrap(),
            incarnation: Incarnation(1_000_000),
            sequence: 42,
            stamp: SenderStamp::from_seconds(1.5),
        },
        plant_time: PlantTime::from_seconds(2.0),
        facts: VehicleFacts {
            flown_s: Some(12.34),
            activity: Activity::Formation,
            membership: Membership::Active,
            step: 1,
            reached: Some(0),
            in_place_s: Some(8.5),
            settings: vec![Setting { key: TunableKey::Radius, value: 80.0 }],
            live: 4,
            position: Some(PositionNed::new(99.5, -1.25, -30.0)),
            velocity: VelocityNed::new(0.1, 0.0, -0.2),
            attitude: Attitude { roll_rad: 0.01, pitch_rad: -0.02, heading_rad: 1.5 },
            centre_ne_m: [0.0, 0.5],
            altitude_setpoint_m: Some(30.0),
            field_ne: Some([0.1, -0.1]),
            error_ne_m: Some([1.5, 0.0]),
            controls: Some([0.0, 0.1, -0.1, 0.5]),
            power_w: None,
            energy_left: Some(0.75),
            process: Some(ProcessFigures {
                frame_rate_hz: 50.0,
                jitter_ms: 0.2,
                step_p99_us: 24.0,
                frame_overruns: 0,
                dropped: 2,
                unsent: 1,
            }),
            failures: vec![Failure::Engine],
            peers: VehicleId::first(peers.into()).map(contact).collect(),
        },
    }
}

fn with(facts: VehicleFacts) -> Summary {
    Summary { facts, ..summary(0) }
}

/// What a program in another language reads.
const GOLDEN: &str = r#"{"version":8,"header":{"sender":3,"incarnation":1000000,"sequence":42,"stamp":1500000000},"plant_time":2000000000,"flown_s":12.34,"activity":"Formation","membership":"Active","step":1,"reached":0,"in_place_s":8.5,"settings":[{"key":"formation.radius_m","value":80.0}],"live":4,"position":[99.5,-1.25,-30.0],"velocity":[0.1,0.0,-0.2],"attitude":{"roll_rad":0.01,"pitch_rad":-0.02,"heading_rad":1.5},"centre_ne_m":[0.0,0.5],"altitude_setpoint_m":30.0,"field_ne":[0.1,-0.1],"error_ne_m":[1.5,0.0],"controls":[0.0,0.1,-0.1,0.5],"power_w":null,"energy_left":0.75,"frame_rate_hz":50.0,"jitter_ms":0.2,"step_p99_us":24.0,"frame_overruns":0,"dropped":2,"unsent":1,"failures":["Engine"],"peers":[[1,85,"Fresh"],[2,85,"Fresh"]]}"#;

#[test]
fn a_summary_is_the_golden_json() {
    assert_eq!(VERSION, 8, "a new version needs a new golden text");
    assert_eq!(String::from_utf8(encode(&summary(2))).unwrap(), GOLDEN);
    assert_eq!(encoded_len(&summary(2)), GOLDEN.len());
    assert_eq!(decode(GOLDEN.as_bytes()), Ok(summary(2)));
}

#[test]
fn numbers_are_rounded_to_three_decimals() {
    let third = 1.0 / 3.0;
    let fine = with(VehicleFacts {
        flown_s: Some(third),
        position: Some(PositionNed::new(third, -third, 1e6 * third)),
        attitude: Attitude { heading_rad: third, ..Attitude::default() },
        field_ne: Some([third; 2]),
        process: Some(ProcessFigures { jitter_ms: third, ..ProcessFigures::default() }),
        ..summary(0).facts
    });
    let small = fine.clone().rounded();
    let rounded = &small.facts;
    assert_eq!(rounded.flown_s, Some(0.333));
    assert_eq!(rounded.position, Some(PositionNed::new(0.333, -0.333, 333_333.333)));
    assert_eq!(
        (rounded.attitude.heading_rad, rounded.field_ne, rounded.process.unwrap().jitter_ms),
        (0.333, Some([0.333; 2]), 0.333)
    );
    assert!(encoded_len(&small) + 80 < encoded_len(&fine));
    assert_eq!(summary(2).rounded(), summary(2));
}

#[test]
fn the_largest_summary_fits() {
    let long = -123_456.789;
    let largest = Summary {
        header: Header {
            sender: VehicleId::new(VehicleId::MAX).unwrap(),
            incarnation: Incarnation(u64::MAX),
            sequence: u64::MAX,
            stamp: SenderStamp::from_nanoseconds(u64::MAX),
        },
        plant_time: PlantTime::MAX,
        facts: VehicleFacts {
            step: MAX_STEP,
            reached: Some(MAX_STEP),
            live: VehicleId::MAX,
            position: Some(PositionNed::new(long, long, long)),
            field_ne: Some([long; 2]),
            error_ne_m: Some([long; 2]),
            controls: Some([long; 4]),
            power_w: Some(-long),
            energy_left: Some(-long),
            process: Some(ProcessFigures { frame_overruns: u64::MAX, dropped: u64::MAX, ..ProcessFigures::default() }),
            failures: vec![Failure::Altitude; Failure::KINDS],
            peers: VehicleId::first(VehicleId::MAX.into())
                .map(|id| PeerContact { id, age_ms: u32::MAX, standing: PeerStatus::Fresh })
                .collect(),
            ..summary(0).facts
        },
    };
    assert_eq!(decode(&encode(&largest)), Ok(largest));
}

#[test]
fn what_no_correct_agent_sends_is_refused() {
    let refused = |from: &str, to: &str| {
        assert!(GOLDEN.contains(from), "{from}");
        decode::<Summary>(GOLDEN.replacen(from, to, 1).as_bytes()).unwrap_err()
    };
    assert_eq!(refused(r#""version":8"#, r#""version":7"#), DecodeError::Version(7));
    assert_eq!(refused("[99.5,-1.25,-30.0]", "[1e9,0,0]"), DecodeError::Implausible);
    assert_eq!(refused("[0.1,0.0,-0.2]", "[1e5,0,0]"), DecodeError::Implausible);
    assert_eq!(refused(r#""step":1"#, r#""step":10001"#), DecodeError::Implausible);
    assert_eq!(refused(r#""jitter_ms":0.2"#, r#""jitter_ms":-1"#), DecodeError::Implausible);
    for (from, to) in [
        ("99.5", "1e999"),
        ("99.5", "null"),
        ("99.5", "\"99.5\""),
        (r#""sender":3"#, r#""sender":0"#),
        ("Formation", "Formation\\u001b"),
        (r#"[1,85,"Fresh"]"#, r#"[1,85]"#),
        (r#"[1,85,"Fresh"]"#, r#"[1,-1,"Fresh"]"#),
        ("}", ""),
    ] {
        assert_eq!(refused(from, to), DecodeError::Malformed, "{from} {to}");
    }
    assert_eq!(decode::<Summary>(b""), Err(DecodeError::Empty));
    assert_eq!(decode::<Summary>(format!("{GOLDEN} {{}}").as_bytes()), Err(DecodeError::Malformed));
    assert_eq!(decode::<Summary>(&[b'['; 10_000]), Err(DecodeError::TooLong(10_000)));
    assert_eq!(
        decode::<Summary>(&[b'['; 8_000]),
        Err(DecodeError::Malformed),
        "deep nesting does not overflow the stack"
    );
}

proptest! {
    #[test]
    fn changed_bytes_are_refused_or_plausible(
        changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 0..4),
        cut in 0..4_usize,
    ) {
        let mut bytes = GOLDEN.as_bytes().to_vec();
        changes.iter().for_each(|(at, byte)| *at.get_mut(&mut bytes) = *byte);
        bytes.truncate(bytes.len() - cut);
        if let Ok(summary) = decode::<Summary>(&bytes) {
            prop_assert!(summary.is_plausible());
            prop_assert_eq!(decode(&encode(&summary)), Ok(summary));
        }
    }
}
