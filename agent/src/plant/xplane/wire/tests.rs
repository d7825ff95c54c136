use proptest::prelude::*;

use super::becn::Beacon;
use super::dref::Write;
use super::prel::Placement;
use super::rpos::Position;
use super::*;

mod messages;

/// Bytes of a layout written by hand: fields in hexadecimal, separated by spaces; `N*00` means N zero bytes.
fn typed(layout: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    for field in layout.split_whitespace() {
        if let Some(count) = field.strip_suffix("*00") {
            bytes.extend(vec![0; count.parse().unwrap()]);
        } else {
            let digit_pairs = field.as_bytes().as_chunks::<2>().0;
            bytes.extend(
                digit_pairs.iter().map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()),
            );
        }
    }
    bytes
}

fn encoded(encode: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut out = b"left over".to_vec();
    encode(&mut out);
    out
}

fn beacon() -> Beacon {
    Beacon {
        minor: 2,
        host_id: 1,
        version: 121_400,
        role: 1,
        port: 49000,
        name: "lab".into(),
        raknet_port: Some(49010),
    }
}

fn position() -> Position {
    Position {
        longitude_deg: -82.5,
        latitude_deg: 28.25,
        elevation_m: 100.0,
        height_m: 2.0,
        pitch_deg: 1.0,
        heading_deg: 90.0,
        roll_deg: -1.0,
        velocity_east_m_s: 0.5,
        velocity_up_m_s: 3.0,
        velocity_south_m_s: -0.5,
        roll_rate_rad_s: 0.25,
        pitch_rate_rad_s: -0.25,
        yaw_rate_rad_s: 4.0,
    }
}

const POSITION: &str = "52504f53 00 0000000000a054c0 0000000000403c40 0000000000005940 00000040 0000803f 0000b442 \
                        000080bf 0000003f 00004040 000000bf 0000803e 000080be 00008040";

mod golden {
    use super::*;

    #[test]
    fn becn() {
        let bytes = typed("4245434e 00 01 02 01000000 38da0100 01000000 68bf 6c616200 72bf");
        assert_eq!(encoded(|out| beacon().encode(out).unwrap()), bytes);
        assert_eq!(Beacon::decode(&bytes), Ok(beacon()));
    }

    #[test]
    fn rpos_request() {
        assert_eq!(encoded(|out| encode_rate(&rpos::TAG, 60, out)), typed("52504f53 00 363000"));
    }

    #[test]
    fn rpos() {
        let bytes = typed(POSITION);
        assert_eq!(bytes.len(), 69);
        assert_eq!(encoded(|out| position().encode(out)), bytes);
        assert_eq!(Position::decode(&bytes), Ok(position()));
    }

    #[test]
    fn rref_request() {
        let request = rref::DatarefRequest { frequency_hz: 50, index: 7, path: "sim/time/paused" };
        let bytes = typed("52524546 00 32000000 07000000 73696d2f74696d652f706175736564 385*00");
        assert_eq!(bytes.len(), 413);
        assert_eq!(encoded(|out| request.encode(out).unwrap()), bytes);
        assert_eq!(rref::DatarefRequest::decode(&bytes), Ok(request));
    }

    #[test]
    fn rref_values() {
        let pairs = [(7, 1.0), (-2, 0.5)];
        let bytes = typed("52524546 2c 07000000 0000803f feffffff 0000003f");
        assert_eq!(encoded(|out| rref::encode_values(&pairs, out).unwrap()), bytes);
        assert_eq!(rref::decode_values(&bytes).unwrap().collect::<Vec<_>>(), pairs);
    }

    #[test]
    fn dref() {
        let write = Write { value: -0.5, path: "sim/joystick/yoke_roll_ratio" };
        let path = "73696d2f6a6f79737469636b2f796f6b655f726f6c6c5f726174696f";
        let bytes = typed(&format!("44524546 00 000000bf {path} 472*00"));
        assert_eq!(bytes.len(), 509);
        assert_eq!(encoded(|out| write.encode(out).unwrap()), bytes);
        assert_eq!(Write::decode(&bytes), Ok(write));
    }

    #[test]
    fn prel() {
        let placement = Placement {
            aircraft: 0,
            latitude_deg: 28.25,
            longitude_deg: -82.5,
            elevation_m: 100.0,
            heading_deg: 90.0,
            speed_m_s: 0.0,
        };
        let bytes = typed(
            "5052454c 00 06000000 00000000 8*00 00000000 00000000 0000000000403c40 0000000000a054c0 0000000000005940 \
             0000000000805640 0000000000000000",
        );
        assert_eq!(bytes.len(), 69);
        assert_eq!(encoded(|out| placement.encode(out)), bytes);
        assert_eq!(Placement::decode(&bytes), Ok(placement));
    }
}

mod tolerance {
    use super::*;

    #[test]
    fn the_fifth_byte_is_ignored() {
        for fifth in [b'0', b'@', b'O', b',', 0xff] {
            let with = |mut bytes: Vec<u8>| {
                bytes[4] = fifth;
                bytes
            };
            assert!(Position::decode(&with(typed(POSITION))).is_ok());
            assert_eq!(decode_rate(&with(b"RPOS.50\0".to_vec()), &rpos::TAG).unwrap(), 50);
            let write = encoded(|out| Write { value: 1.0, path: "a/b" }.encode(out).unwrap());
            assert!(Write::decode(&with(write)).is_ok());
            assert!(rref::decode_values(&with(typed("52524546 2c 07000000 0000803f"))).is_ok());
            assert!(Beacon::decode(&with(encoded(|out| beacon().encode(out).unwrap()))).is_ok());
        }
    }

    #[test]
    fn paths_end_at_the_first_nul_whatever_pads_them() {
        for padding in [b' ', 0, 0xfe] {
            let mut write = encoded(|out| Write { value: 1.0, path: "a/b[2]" }.encode(out).unwrap());
            write[9 + 7..].fill(padding);
            assert_eq!(Write::decode(&write), Ok(Write { value: 1.0, path: "a/b[2]" }));
            let mut request =
                encoded(|out| rref::DatarefRequest { frequency_hz: 1, index: 1, path: "a" }.encode(out).unwrap());
            request[13 + 2..].fill(padding);
            assert_eq!(rref::DatarefRequest::decode(&request).unwrap().path, "a");
        }
    }

    #[test]
    fn rates_may_be_padded_or_end_without_a_nul() {
        let read = |text: &str| decode_rate(&[b"RPOS.", text.as_bytes()].concat(), &rpos::TAG);
        assert_eq!(["60\0", "60\0\0\0", "60", "60\0xyz"].map(read), [Ok(60); 4]);
        assert_eq!(read("0\0"), Ok(0));
        for nonsense in ["", "\0", "-1\0", "+5\0", "six\0", " 60\0", "99999999999\0"] {
            assert!(read(nonsense).is_err(), "{nonsense:?}");
        }
    }

    #[test]
    fn beacons_of_other_minor_versions_are_read() {
        let cut = encoded(|out| beacon().encode(out).unwrap());
        let short = Beacon { raknet_port: None, ..beacon() };
        let end = encoded(|out| short.encode(out).unwrap());
        assert_eq!(Beacon::decode(&end), Ok(short), "the end of the name is not a port");
        let old = Beacon { minor: 1, raknet_port: None, ..beacon() };
        assert_eq!(Beacon::decode(&encoded(|out| old.encode(out).unwrap())), Ok(old));

        let mut printed = cut[..cut.len() - 2].to_vec();
        printed.resize(521, 0);
        printed.extend(49010_u16.to_le_bytes());
        assert_eq!(printed.len(), 523);
        assert_eq!(Beacon::decode(&printed), Ok(beacon()));

        let mut future = cut.clone();
        future[6] = 3;
        assert_eq!(Beacon::decode(&future), Ok(Beacon { minor: 3, ..beacon() }));

        let nameless = Beacon::decode(&typed("4245434e 00 01 02 01000000 38da0100 01000000 68bf 0000")).unwrap();
        assert_eq!((nameless.name.as_str(), nameless.raknet_port, nameless.port), ("", None, 49000));

        let mut incompatible = cut.clone();
        incompatible[5] = 2;
        assert_eq!(Beacon::decode(&incompatible), Err(WireError::Incompatible));
        assert_eq!(Beacon::decode(&cut[..20]), Err(WireError::WrongSize));
        assert!(!Beacon { host_id: 2, ..beacon() }.is_master() && !Beacon { role: 2, ..beacon() }.is_master());
    }
}

mod refused {
    use super::*;

    #[test]
    fn wrong_sizes() {
        type Error = fn(&[u8]) -> Option<WireError>;
        let sized: [(&str, Error); 4] = [
            (POSITION, |bytes| Position::decode(bytes).err()),
            ("52524546 00 32000000 07000000 400*00", |bytes| rref::DatarefRequest::decode(bytes).err()),
            ("44524546 00 0000003f 500*00", |bytes| Write::decode(bytes).err()),
            ("5052454c 00 06000000 60*00", |bytes| Placement::decode(bytes).err()),
        ];
        for (layout, error) in sized {
            let mut bytes = typed(layout);
            assert_eq!(error(&bytes), None);
            bytes.push(0);
            assert_eq!(error(&bytes), Some(WireError::WrongSize));
            bytes.truncate(bytes.len() - 2);
            assert_eq!(error(&bytes), Some(WireError::WrongSize));
            bytes[0] = b'X';
            assert_eq!(error(&bytes), Some(WireError::WrongTag));
        }
        assert!(rref::decode_values(b"RREF,1234567").is_err());
        let too_many = [(0, 0.0); rref::MAX_VALUES + 1];
        assert_eq!(rref::encode_values(&too_many, &mut Vec::new()), Err(WireError::WrongSize));
        assert!(rref::decode_values(&[b"RREF,".as_slice(), &[0; 184 * 8]].concat()).is_err());
        assert_eq!(rref::decode_values(&[b"RREF,".as_slice(), &[0; 183 * 8]].concat()).unwrap().len(), 183);
    }

    #[test]
    fn numbers_that_are_not_finite() {
        for at in [5, 13, 21] {
            let mut bytes = typed(POSITION);
            bytes[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes());
            assert_eq!(Position::decode(&bytes), Err(WireError::NonFinite));
        }
        for at in (29..69).step_by(4) {
            let mut bytes = typed(POSITION);
            bytes[at..at + 4].copy_from_slice(&f32::NEG_INFINITY.to_le_bytes());
            assert_eq!(Position::decode(&bytes), Err(WireError::NonFinite));
        }
        let mut write = encoded(|out| Write { value: 1.0, path: "a" }.encode(out).unwrap());
        write[5..9].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(Write::decode(&write), Err(WireError::NonFinite));
    }

    #[test]
    fn positions_off_the_globe() {
        for position in
            [Position { latitude_deg: 90.1, ..position() }, Position { longitude_deg: -180.1, ..position() }]
        {
            assert_eq!(Position::decode(&encoded(|out| position.encode(out))), Err(WireError::OutOfRange));
        }
        let placed = |start: i32, aircraft: i32, latitude_deg: f64| {
            let mut bytes = typed("5052454c 00 64*00");
            bytes[5..9].copy_from_slice(&start.to_le_bytes());
            bytes[9..13].copy_from_slice(&aircraft.to_le_bytes());
            bytes[29..37].copy_from_slice(&latitude_deg.to_le_bytes());
            Placement::decode(&bytes).err()
        };
        assert_eq!(placed(6, 19, -90.0), None);
        for (start, aircraft, latitude_deg) in [(11, 0, 0.0), (6, 20, 0.0), (6, -1, 0.0), (6, 256, 0.0), (6, 0, 91.0)] {
            assert_eq!(placed(start, aircraft, latitude_deg), Some(WireError::OutOfRange));
        }
    }

    #[test]
    fn paths_that_are_not_text_or_too_long() {
        let long = |length| "x".repeat(length);
        let request = |path: &str| rref::DatarefRequest { frequency_hz: 1, index: 0, path }.encode(&mut Vec::new());
        assert_eq!((request(&long(399)), request(&long(400))), (Ok(()), Err(WireError::TooLong)));
        assert_eq!(request("a\0b"), Err(WireError::NotText));
        let write = |path: &str| Write { value: 0.0, path }.encode(&mut Vec::new());
        assert_eq!((write(&long(499)), write(&long(500))), (Ok(()), Err(WireError::TooLong)));
        let mut bytes = encoded(|out| Write { value: 1.0, path: "abc" }.encode(out).unwrap());
        bytes[10] = 0xff;
        assert_eq!(Write::decode(&bytes), Err(WireError::NotText));
        let negative = typed("52524546 00 ffffffff 07000000 400*00");
        assert_eq!(rref::DatarefRequest::decode(&negative), Err(WireError::OutOfRange));
    }
}

/// Bytes that start with a tag of a message, or without one: noise, plausible numbers, or text with any padding.
fn any_datagram() -> impl Strategy<Value = Vec<u8>> {
    let tag = prop::sample::select(vec![&b"BECN\0"[..], b"RPOS\0", b"RREF,", b"DREF0", b"PREL\0", b""]);
    let length = prop_oneof![0..600_usize, Just(64_usize), Just(408), Just(504), Just(1464), 1400..2000_usize];
    let noise = length.prop_flat_map(|length| prop::collection::vec(any::<u8>(), length));
    let text = (
        prop::collection::vec(any::<u8>(), 0..17),
        "[ -~]{0,40}\0",
        any::<u8>(),
        prop_oneof![0..9_usize, Just(408), Just(504)],
    );
    let text = text.prop_map(|(head, text, padding, length)| {
        let mut body = [&head, text.as_bytes()].concat();
        body.resize(length.max(body.len()), padding);
        body
    });
    let digits = "[0-9]{1,11}\0?".prop_map(String::into_bytes);
    let beacon = prop::collection::vec(any::<u8>(), 14..40).prop_map(|rest| [&[1], &rest[..]].concat());
    let placement =
        (6..8_i32, 0..21_i32, prop::collection::vec(-200.0..200.0_f64, 5)).prop_map(|(start, aircraft, rest)| {
            let numbers = rest.into_iter().flat_map(f64::to_le_bytes);
            [start.to_le_bytes(), aircraft.to_le_bytes()].concat().into_iter().chain([7; 16]).chain(numbers).collect()
        });
    (tag, prop_oneof![2 => noise, 2 => text, 1 => digits, 1 => beacon, 1 => placement])
        .prop_map(|(tag, body)| [tag, &body].concat())
}

fn any_f32() -> impl Strategy<Value = f32> {
    prop::num::f32::NORMAL | prop::num::f32::ZERO | prop::num::f32::NEGATIVE
}

prop_compose! {
    fn any_position()(
        (longitude_deg, latitude_deg, elevation_m) in (-180.0..=180.0, -90.0..=90.0, -1e6..1e6),
        rest in prop::array::uniform10(any_f32()),
    ) -> Position {
        let [height_m, pitch_deg, heading_deg, roll_deg, velocity_east_m_s, velocity_up_m_s, velocity_south_m_s, ..] = rest;
        let [.., roll_rate_rad_s, pitch_rate_rad_s, yaw_rate_rad_s] = rest;
        Position {
            longitude_deg, latitude_deg, elevation_m, height_m, pitch_deg, heading_deg, roll_deg, velocity_east_m_s,
            velocity_up_m_s, velocity_south_m_s, roll_rate_rad_s, pitch_rate_rad_s, yaw_rate_rad_s,
        }
    }
}

proptest! {
    #[test]
    fn every_decoded_message_encodes_to_the_same_bytes_and_has_one_kind(datagram in any_datagram()) {
        // A decoder ignores the fifth byte, the padding of a text after its NUL, and the name of a placement's airport.
        let agrees = |again: &[u8], ignored: std::ops::Range<usize>| {
            let ignored = |at: usize| at == 4 || ignored.contains(&at);
            again.iter().zip(&datagram).enumerate().all(|(at, (again, byte))| ignored(at) || again == byte)
        };
        let padding = |start: usize, text: &str| start + text.len()..usize::MAX;
        let mut messages = Vec::new();
        if let Ok(position) = Position::decode(&datagram) {
            let again = encoded(|out| position.encode(out));
            prop_assert!(again.len() == datagram.len() && agrees(&again, 0..0));
            prop_assert!(position.latitude_deg.abs() <= 90.0 && position.longitude_deg.abs() <= 180.0);
            messages.push(rpos::TAG);
        }
        if let Ok(write) = Write::decode(&datagram) {
            let mut again = Vec::new();
            match write.encode(&mut again) {
                Ok(()) => prop_assert!(again.len() == dref::SIZE && agrees(&again, padding(9, write.path)), "{write:?}"),
                // A path that fills its field is read, but always written with a NUL.
                Err(error) => prop_assert_eq!((error, write.path.len()), (WireError::TooLong, dref::SIZE - 9)),
            }
            prop_assert!(write.value.is_finite());
            messages.push(dref::TAG);
        }
        if let Ok(values) = rref::decode_values(&datagram) {
            let values: Vec<_> = values.collect();
            let again = encoded(|out| rref::encode_values(&values, out).unwrap());
            prop_assert!(again.len() == datagram.len() && agrees(&again, 0..0));
            messages.push(rref::TAG);
        }
        if let Ok(request) = rref::DatarefRequest::decode(&datagram) {
            let (mut again, size) = (Vec::new(), rref::REQUEST_SIZE);
            match request.encode(&mut again) {
                Ok(()) => prop_assert!(again.len() == size && agrees(&again, padding(13, request.path)), "{request:?}"),
                Err(error) => prop_assert_eq!((error, request.path.len()), (WireError::TooLong, size - 13)),
            }
            messages.push(rref::TAG);
        }
        if let Ok(rate_hz) = decode_rate(&datagram, &rpos::TAG) {
            let again = encoded(|out| encode_rate(&rpos::TAG, rate_hz, out));
            let digits = datagram[5..].split(|byte| *byte == 0).next().unwrap();
            let value = digits.iter().fold(0, |value, digit| 10 * value + u64::from(digit - b'0'));
            prop_assert_eq!(value, u64::from(rate_hz), "{:?}", digits);
            prop_assert_eq!(decode_rate(&again, &rpos::TAG), Ok(rate_hz));
            messages.push(rpos::TAG);
        }
        if let Ok(beacon) = Beacon::decode(&datagram) {
            // Bytes that are not UTF-8 become replacement characters, which are longer.
            if beacon.name.len() < 500 {
                let again = encoded(|out| beacon.encode(out).unwrap());
                prop_assert!(agrees(&again, 21..usize::MAX) && beacon.port > 0, "{beacon:?}");
                prop_assert_eq!(Beacon::decode(&again).map(|again| again.name), Ok(beacon.name));
            }
            messages.push(becn::TAG);
        }
        if let Ok(placement) = Placement::decode(&datagram) {
            let again = encoded(|out| placement.encode(out));
            prop_assert!(again.len() == datagram.len() && agrees(&again, 13..29), "{placement:?}");
            prop_assert!(placement.aircraft < 20 && placement.latitude_deg.abs() <= 90.0);
            messages.push(prel::TAG);
        }
        prop_assert!(messages.iter().all(|tag| datagram.starts_with(tag)), "{messages:?}");
    }

    #[test]
    fn every_message_survives_encoding_and_decoding(
        position in any_position(),
        rate_hz in any::<u32>(),
        value in any_f32(),
        (frequency_hz, index) in (0..=i32::MAX as u32, any::<i32>()),
        path in "[!-~]{0,399}",
        pairs in prop::collection::vec((any::<i32>(), any_f32()), 0..=rref::MAX_VALUES),
    ) {
        prop_assert_eq!(Position::decode(&encoded(|out| position.encode(out))), Ok(position));
        prop_assert_eq!(decode_rate(&encoded(|out| encode_rate(&rpos::TAG, rate_hz, out)), &rpos::TAG), Ok(rate_hz));
        let write = Write { value, path: &path };
        let bytes = encoded(|out| write.encode(out).unwrap());
        prop_assert_eq!(Write::decode(&bytes), Ok(write));
        let request = rref::DatarefRequest { frequency_hz, index, path: &path };
        let bytes = encoded(|out| request.encode(out).unwrap());
        prop_assert_eq!(rref::DatarefRequest::decode(&bytes), Ok(request));
        let values = encoded(|out| rref::encode_values(&pairs, out).unwrap());
        prop_assert_eq!(rref::decode_values(&values).unwrap().collect::<Vec<_>>(), pairs);
    }

    #[test]
    fn placements_and_beacons_survive_encoding_and_decoding(
        (aircraft, latitude_deg, longitude_deg) in (0..20_u8, -90.0..=90.0, -180.0..=180.0),
        (elevation_m, heading_deg, speed_m_s) in (-1e6..1e6, -360.0..360.0, 0.0..1e3),
        (minor, host_id, version, role, port) in (2..=255_u8, any::<i32>(), any::<i32>(), any::<u32>(), 1..=u16::MAX),
        (name, raknet_port) in ("[^\0]{0,100}", any::<u16>()),
    ) {
        let placement = Placement { aircraft, latitude_deg, longitude_deg, elevation_m, heading_deg, speed_m_s };
        prop_assert_eq!(Placement::decode(&encoded(|out| placement.encode(out))), Ok(placement));
        let beacon = Beacon { minor, host_id, version, role, port, name, raknet_port: Some(raknet_port) };
        prop_assert_eq!(Beacon::decode(&encoded(|out| beacon.encode(out).unwrap())), Ok(beacon));
    }
}
