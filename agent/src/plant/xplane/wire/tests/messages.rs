//! Messages besides positions and datarefs. Layouts: Laminar Research, "Exchanging Data with X-Plane".

use std::iter;
use std::net::IpAddr;

use proptest::prelude::*;

use super::{encoded, typed};
use crate::plant::xplane::wire::aircraft::{ACFN, Load, Move, VEHS, VEHX};
use crate::plant::xplane::wire::operation::{CMND, Command};
use crate::plant::xplane::wire::radr::{self, RadarPoint, RadarPoint11};
use crate::plant::xplane::wire::rows::{
    self, DATA_OUTPUT, Destination, ISE4, ISE6, MAX_ROWS, Row, SELECTIONS, Selection, decode_rows, encode_rows,
};
use crate::plant::xplane::wire::{Packed, Tag, WireError, begin, decode_rate, encode_rate};

impl Selection {
    /// Encodes the selection.
    pub(in crate::plant::xplane) fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &self.tag);
        self.rows.iter().for_each(|row| row.write(out));
    }
}

impl Destination {
    /// Encodes the destination, in the shorter form if its address is IPv4.
    pub(in crate::plant::xplane) fn encode(&self, out: &mut Vec<u8>) {
        let (tag, lengths) = if self.address.is_ipv4() { (ISE4, [16, 8]) } else { (ISE6, [65, 7]) };
        begin(out, &tag);
        self.target.write(out);
        for (text, length) in [self.address.to_string(), self.port.to_string()].into_iter().zip(lengths) {
            out.extend(text.bytes().chain(iter::repeat(0)).take(length));
        }
        i32::from(self.is_on).write(out);
    }
}

const PLACE: &str = "0000000000403c40 0000000000a054c0 0000000000005940";

mod golden {
    use super::*;

    #[test]
    fn data() {
        let values = [Some(0.5), Some(-0.5), None, None, None, None, None, Some(1.0)];
        let rows = [Row { index: 8, values }, Row { index: 25, values: [Some(1.0); 8] }];
        let none = "00c079c4 ".repeat(5);
        let ones = "0000803f ".repeat(8);
        let bytes = typed(&format!("44415441 00 08000000 0000003f 000000bf {none} 0000803f 19000000 {ones}"));
        assert_eq!(encoded(|out| encode_rows(&rows, out).unwrap()), bytes);
        assert_eq!(decode_rows(&bytes).unwrap(), rows);
    }

    #[test]
    fn selections() {
        for (selected, tag) in SELECTIONS.into_iter().zip(["4453454c", "5553454c", "44434f43", "55434f43"]) {
            let selection = Selection { tag: selected, rows: vec![3, 138, -1] };
            let bytes = typed(&format!("{tag} 00 03000000 8a000000 ffffffff"));
            assert_eq!(encoded(|out| selection.encode(out)), bytes);
            assert_eq!(Selection::decode(&bytes), Ok(selection));
        }
        // ArduPilot always sends eight numbers, zeros behind those that it means, and '0' as the fifth byte.
        let eight = typed("4453454c 30 03000000 28*00");
        assert_eq!(Selection::decode(&eight).unwrap().rows, [3, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn destinations() {
        let to = |address: &str| Destination {
            target: DATA_OUTPUT,
            address: address.parse().unwrap(),
            port: 49005,
            is_on: true,
        };
        let four = typed("49534534 00 40000000 31302e302e302e37 8*00 3439303035 3*00 01000000");
        assert_eq!((four.len(), encoded(|out| to("10.0.0.7").encode(out))), (37, four.clone()));
        assert_eq!(Destination::decode(&four), Ok(to("10.0.0.7")));
        let six = typed("49534536 00 40000000 3a3a31 62*00 3439303035 2*00 01000000");
        assert_eq!((six.len(), encoded(|out| to("::1").encode(out))), (85, six.clone()));
        assert_eq!(Destination::decode(&six), Ok(to("::1")));
    }

    #[test]
    fn poses() {
        for (own, tag) in [(VEHX, "56454858"), (VEHS, "56454853")] {
            let moved = Move {
                tag: own,
                aircraft: 3,
                latitude_deg: 28.25,
                longitude_deg: -82.5,
                elevation_m: 100.0,
                heading_deg: 90.0,
                pitch_deg: 1.0,
                roll_deg: -1.0,
            };
            let bytes = typed(&format!("{tag} 00 03000000 {PLACE} 0000b442 0000803f 000080bf"));
            assert_eq!((bytes.len(), encoded(|out| moved.encode(out))), (45, bytes.clone()));
            assert_eq!(Move::decode(&bytes), Ok(moved));
        }
    }

    #[test]
    fn aircraft() {
        let load = Load { aircraft: 1, path: "Aircraft/My R22/R22.acf", livery: 2 };
        let body = "01000000 41697263726166742f4d79205232322f5232322e616366 129*00 02000000";
        let bytes = typed(&format!("4143464e 00 {body}"));
        assert_eq!((bytes.len(), encoded(|out| load.encode(out).unwrap())), (165, bytes.clone()));
        assert_eq!(Load::decode(&bytes), Ok(load));
    }

    #[test]
    fn operations() {
        let command = Command { path: "sim/operation/pause_toggle" };
        let path = "73696d2f6f7065726174696f6e2f70617573655f746f67676c65";
        let bytes = typed(&format!("434d4e44 00 {path} 00"));
        assert_eq!(encoded(|out| command.encode(out).unwrap()), bytes);
        // Clients end it with a NUL, pad it, or do neither.
        for sent in [&bytes[..], &bytes[..bytes.len() - 1], &[&bytes[..], &[b' '; 100]].concat()] {
            assert_eq!(Command::decode(sent), Ok(command));
        }
    }

    #[test]
    fn radar() {
        assert_eq!(encoded(|out| encode_rate(&radr::TAG, 10, out)), typed("52414452 00 3130 00"));
        let point = RadarPoint {
            longitude_deg: 1.0,
            latitude_deg: -1.0,
            base_m: 0.5,
            top_m: 2.0,
            clouds: 1.0,
            precipitation: 0.0,
        };
        let bytes = typed("52414452 00 0000803f 000080bf 0000003f 00000040 0000803f 00000000");
        assert_eq!(encoded(|out| RadarPoint::encode(&[point], out)), bytes);
        assert_eq!(RadarPoint::decode(&bytes), Ok(vec![point]));
        let point = RadarPoint11 { longitude_deg: 1.0, latitude_deg: -1.0, level: 7, height_m: 2.0 };
        let bytes = typed("52414452 00 0000803f 000080bf 07 00000040");
        assert_eq!(encoded(|out| RadarPoint11::encode(&[point], out)), bytes);
        assert_eq!(RadarPoint11::decode(&bytes), Ok(vec![point]));
    }
}

mod refused {
    use super::*;

    #[test]
    fn wrong_sizes() {
        let (row, point) = (typed("44415441 00 36*00"), typed("52414452 00 24*00"));
        for cut in 5..row.len() {
            assert_eq!(decode_rows(&row[..cut]), Err(WireError::WrongSize));
        }
        for cut in 5..point.len() {
            assert_eq!(RadarPoint::decode(&point[..cut]), Err(WireError::WrongSize));
        }
        assert_eq!(RadarPoint11::decode(&point), Err(WireError::WrongSize));
        assert_eq!(Selection::decode(b"DSEL.abc"), Err(WireError::WrongSize));
        assert_eq!(encode_rows(&[], &mut Vec::new()), Err(WireError::WrongSize));
        let row = Row { index: 0, values: [None; 8] };
        assert_eq!(encode_rows(&[row; MAX_ROWS + 1], &mut Vec::new()), Err(WireError::WrongSize));
    }

    #[test]
    fn numbers_and_texts_out_of_range() {
        let moved = |aircraft: &str, latitude: &str| {
            let place = format!("{latitude} 8*00 8*00");
            Move::decode(&typed(&format!("56454858 00 {aircraft} {place} 12*00"))).err()
        };
        assert_eq!(moved("13000000", "8*00"), None);
        assert_eq!(moved("14000000", "8*00"), Some(WireError::OutOfRange));
        assert_eq!(moved("ffffffff", "8*00"), Some(WireError::OutOfRange));
        assert_eq!(moved("00000000", "0000000000c05640"), Some(WireError::OutOfRange));
        assert_eq!(moved("00000000", "000000000000f07f"), Some(WireError::NonFinite));
        assert_eq!(decode_rows(&typed("44415441 00 4*00 0000807f 28*00")), Err(WireError::NonFinite));
        let to =
            |address: &str, port: &str| Destination::decode(&typed(&format!("49534534 00 4*00 {address} {port} 4*00")));
        assert_eq!(to("16*00", "3430 6*00"), Err(WireError::NotText));
        assert_eq!(to("3a3a31 13*00", "3430 6*00"), Err(WireError::OutOfRange));
        assert_eq!(to("312e312e312e31 9*00", "3939393939 3*00"), Err(WireError::OutOfRange));
        assert_eq!(Command::decode(b"CMND\0\0"), Err(WireError::NotText));
        assert_eq!(Command::decode(b"CMND\0a b"), Err(WireError::NotText));
        let long = "x".repeat(150);
        let load = Load { aircraft: 0, path: &long, livery: 0 };
        assert_eq!(load.encode(&mut Vec::new()), Err(WireError::TooLong));
        assert_eq!(Load { path: "a\0", ..load }.encode(&mut Vec::new()), Err(WireError::NotText));
    }
}

/// Bytes behind one of the tags, of the lengths that messages have and of others.
fn any_datagram() -> impl Strategy<Value = Vec<u8>> {
    let mut tags = vec![rows::TAG, ISE4, ISE6, ACFN, CMND, radr::TAG];
    tags.extend(SELECTIONS);
    tags.extend([VEHX, VEHS]);
    let length = prop_oneof![0..60_usize, prop::sample::select(vec![1_usize, 33, 81, 41, 161, 225, 157, 961, 37])];
    // Small numbers, texts and noise.
    let bytes = length.prop_flat_map(|length| {
        prop_oneof![
            prop::collection::vec(prop::sample::select(vec![0_u8, 0, 0, 1, 6, b'1', b'.']), length),
            prop::collection::vec(any::<u8>(), length),
        ]
    });
    (prop::sample::select(tags), bytes).prop_map(|(tag, bytes)| [&tag[..], &bytes].concat())
}

/// Whether what was decoded is decoded again from what it encodes to.
fn again<T: PartialEq>(first: &Result<T, WireError>, encode: impl FnOnce(&T) -> bool) -> bool {
    first.as_ref().map_or(true, encode)
}

proptest! {
    #[test]
    fn every_decoded_message_has_its_tag_and_is_decoded_again(datagram in any_datagram()) {
        let tag: Tag = *datagram.first_chunk().unwrap();
        let mut kinds = 0;
        macro_rules! check {
            ($tags:expr, $decode:path, |$message:ident, $out:ident| $encode:expr) => {
                let decoded = $decode(&datagram);
                kinds += u32::from(decoded.is_ok());
                prop_assert!(decoded.is_err() || $tags.contains(&tag), "{:?}", decoded);
                prop_assert!(again(&decoded, |$message| {
                    let mut bytes = Vec::new();
                    let $out = &mut bytes;
                    // What fills its field without a NUL, or has more rows than are sent, is read but not written.
                    if $encode.is_err() { return true; }
                    $decode(&bytes).as_ref() == Ok($message)
                }), "{:?}", decoded);
            };
        }
        check!([rows::TAG], decode_rows, |rows, out| encode_rows(rows, out));
        check!(SELECTIONS, Selection::decode, |it, out| { it.encode(out); Ok::<_, WireError>(()) });
        check!([ISE4, ISE6], Destination::decode, |it, out| { it.encode(out); Ok::<_, WireError>(()) });
        check!([*b"VEHX", *b"VEHS"], Move::decode, |it, out| { it.encode(out); Ok::<_, WireError>(()) });
        check!([ACFN], Load::decode, |it, out| it.encode(out));
        check!([CMND], Command::decode, |it, out| it.encode(out));
        let rate = |datagram: &[u8]| decode_rate(datagram, &radr::TAG);
        check!([radr::TAG], rate, |it, out| { encode_rate(&radr::TAG, *it, out); Ok::<_, WireError>(()) });
        check!([radr::TAG], RadarPoint::decode, |it, out| { RadarPoint::encode(it, out); Ok::<_, WireError>(()) });
        check!([radr::TAG], RadarPoint11::decode, |it, out| { RadarPoint11::encode(it, out); Ok::<_, WireError>(()) });
        // A radar's request and replies are distinguished by their sender.
        let most = if tag == radr::TAG { 3 } else { 1 };
        prop_assert!(kinds <= most, "{kinds} kinds");
    }

    #[test]
    fn every_message_survives_encoding_and_decoding(
        rows in prop::collection::vec((any::<i32>(), prop::array::uniform8(prop::option::of(-1e6..1e6_f32))), 1..=MAX_ROWS),
        selected in prop::collection::vec(any::<i32>(), 0..200),
        (aircraft, latitude_deg, longitude_deg, elevation_m) in (0..20_u8, -90.0..=90.0, -180.0..=180.0, -1e6..1e6),
        (address, port, target, is_on) in (any::<IpAddr>(), any::<u16>(), any::<i32>(), any::<bool>()),
        (heading_deg, pitch_deg, roll_deg) in (-360.0..360.0_f32, -90.0..90.0_f32, -180.0..180.0_f32),
        (path, livery) in ("[^\\x00-\\x1f\\x7f-\\u{9f}]{0,49}", any::<i32>()),
        nth in 0..4_usize,
    ) {
        let rows: Vec<Row> = rows.into_iter().map(|(index, values)| Row { index, values }).collect();
        prop_assume!(rows.iter().flat_map(|row| row.values).all(|value| value != Some(-999.0)));
        prop_assert_eq!(decode_rows(&encoded(|out| encode_rows(&rows, out).unwrap())), Ok(rows));
        let selection = Selection { tag: SELECTIONS[nth], rows: selected };
        prop_assert_eq!(Selection::decode(&encoded(|out| selection.encode(out))), Ok(selection));
        let to = Destination { target, address, port, is_on };
        prop_assert_eq!(Destination::decode(&encoded(|out| to.encode(out))), Ok(to));
        let tag = if is_on { VEHX } else { VEHS };
        let moved = Move {
            tag, aircraft, latitude_deg, longitude_deg, elevation_m, heading_deg, pitch_deg, roll_deg,
        };
        prop_assert_eq!(Move::decode(&encoded(|out| moved.encode(out))), Ok(moved));
        if path.len() <= 149 {
            let load = Load { aircraft, path: &path, livery };
            let bytes = encoded(|out| load.encode(out).unwrap());
            prop_assert_eq!(Load::decode(&bytes), Ok(load));
        }
        let point = RadarPoint {
            longitude_deg: heading_deg, latitude_deg: pitch_deg, base_m: roll_deg, top_m: 1.0, clouds: 0.5, precipitation: 0.0,
        };
        let points = vec![point; nth + 1];
        prop_assert_eq!(RadarPoint::decode(&encoded(|out| RadarPoint::encode(&points, out))), Ok(points));
        let point = RadarPoint11 { longitude_deg: heading_deg, latitude_deg: pitch_deg, level: aircraft, height_m: roll_deg };
        let points = vec![point; nth + 1];
        prop_assert_eq!(RadarPoint11::decode(&encoded(|out| RadarPoint11::encode(&points, out))), Ok(points));
    }
}
