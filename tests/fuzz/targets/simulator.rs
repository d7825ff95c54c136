//! X-Plane's protocol: the decoders, the stand-in's side and the agent's side.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;

use arbitrary::{Result, Unstructured};
use skein_agent::plant::xplane::client::{Client, Indices};
use skein_agent::plant::xplane::server::{Server, Surroundings, Version};
use skein_agent::plant::xplane::wire::aircraft::{Move, VEHX};
use skein_agent::plant::xplane::wire::becn::Beacon;
use skein_agent::plant::xplane::wire::dref::Write;
use skein_agent::plant::xplane::wire::operation::Command as RunCommand;
use skein_agent::plant::xplane::wire::prel::Placement;
use skein_agent::plant::xplane::wire::rows::{self, Row};
use skein_agent::plant::xplane::wire::rpos::{self, Position};
use skein_agent::plant::xplane::wire::rref::{self, DatarefRequest};
use skein_agent::plant::xplane::wire::{MAX_DATAGRAM, aircraft, decode_rate, encode_rate, radr};
use skein_common::frame::{Geodetic, Origin};
use skein_common::time::PlantTime;
use skein_core::aircraft::Profile;
use skein_core::plant::{Command, Controls, Frame, GroundTruth};
use skein_fuzz::explore;
use skein_host::clock::now;

use super::agent::measurement;
use super::draws::{number, parts, sometimes};

const SIMULATOR: Ipv4Addr = Ipv4Addr::LOCALHOST;
const DATAREFS: [&str; 8] = [
    "sim/flightmodel/position/latitude",
    "sim/time/paused",
    "sim/operation/override/override_joystick",
    "sim/joystick/yoke_roll_ratio",
    "sim/cockpit2/engine/actuators/prop_ratio[0]",
    "sim/cockpit2/engine/actuators/throttle_ratio[15]",
    "sim/network/dataout/network_data_rate",
    "sim/weather/region/wind_speed_msc[3]",
];

fn encoded(encode: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut datagram = Vec::new();
    encode(&mut datagram);
    datagram
}

fn position() -> Position {
    Position { latitude_deg: 28.0, longitude_deg: -82.0, elevation_m: 20.0, height_m: 20.0, ..Position::default() }
}

/// What clients send.
fn requests() -> Vec<Vec<u8>> {
    let placement = Placement {
        aircraft: 0,
        latitude_deg: 28.0,
        longitude_deg: -82.0,
        elevation_m: 0.0,
        heading_deg: 90.0,
        speed_m_s: 0.0,
    };
    let pose = Move {
        tag: VEHX,
        aircraft: 3,
        latitude_deg: 28.0,
        longitude_deg: -82.0,
        elevation_m: 30.0,
        heading_deg: 90.0,
        pitch_deg: 0.0,
        roll_deg: 0.0,
    };
    let mut all = vec![
        encoded(|out| encode_rate(&rpos::TAG, 50, out)),
        encoded(|out| placement.encode(out)),
        encoded(|out| pose.encode(out)),
        encoded(|out| encode_rate(&radr::TAG, 10, out)),
        encoded(|out| rows::encode_rows(&[Row { index: 8, values: [Some(0.1); 8] }; 2], out).unwrap()),
        b"ISE4\0\x40\0\0\x00127.0.0.1\0\0\0\0\0\0\x0049005\0\0\0\x01\0\0\0".to_vec(),
        b"DSEL\0\x03\0\0\0\x11\0\0\0".to_vec(),
    ];
    for path in DATAREFS {
        for frequency_hz in [20, 0] {
            all.push(encoded(|out| DatarefRequest { frequency_hz, index: 7, path }.encode(out).unwrap()));
        }
        all.push(encoded(|out| Write { value: 0.5, path }.encode(out).unwrap()));
        all.push(encoded(|out| Write { value: 1.0, path }.encode(out).unwrap()));
    }
    for path in ["sim/operation/pause_toggle", "sim/operation/reset_flight", "sim/none"] {
        all.push(encoded(|out| RunCommand { path }.encode(out).unwrap()));
    }
    all
}

/// What a simulator sends to a client that asked with these indices.
fn replies(indices: &[i32]) -> Vec<Vec<u8>> {
    let values: Vec<_> = indices.iter().map(|index| (*index, 1.0)).collect();
    let beacon = Beacon {
        minor: 2,
        host_id: 1,
        version: 124_000,
        role: 1,
        port: 49_000,
        name: "x-plane".to_owned(),
        raknet_port: Some(49_010),
    };
    let mut all = vec![
        encoded(|out| position().encode(out)),
        encoded(|out| Position { latitude_deg: 28.001, yaw_rate_rad_s: 3.0, ..position() }.encode(out)),
        encoded(|out| rref::encode_values(&values, out).unwrap()),
        encoded(|out| beacon.encode(out).unwrap()),
    ];
    all.extend(values.iter().map(|value| encoded(|out| rref::encode_values(&[*value], out).unwrap())));
    all
}

/// Decodes a datagram as each message. Those that are accepted give the same message again from their own bytes.
fn decode_as_each(datagram: &[u8]) {
    if let Ok(position) = Position::decode(datagram) {
        assert!(position.latitude_deg.abs() <= 90.0 && position.longitude_deg.abs() <= 180.0);
        assert_eq!(Position::decode(&encoded(|out| position.encode(out))), Ok(position));
    }
    if let Ok(rate_hz) = decode_rate(datagram, &rpos::TAG) {
        assert_eq!(decode_rate(&encoded(|out| encode_rate(&rpos::TAG, rate_hz, out)), &rpos::TAG), Ok(rate_hz));
    }
    if let Ok(request) = DatarefRequest::decode(datagram) {
        let again = encoded(|out| request.encode(out).unwrap());
        assert_eq!(DatarefRequest::decode(&again), Ok(request));
    }
    if let Ok(write) = Write::decode(datagram) {
        assert!(write.value.is_finite());
        let again = encoded(|out| write.encode(out).unwrap());
        assert_eq!(Write::decode(&again), Ok(write));
    }
    if let Ok(placement) = Placement::decode(datagram) {
        assert_eq!(Placement::decode(&encoded(|out| placement.encode(out))), Ok(placement));
    }
    if let Ok(pose) = Move::decode(datagram) {
        assert_eq!(Move::decode(&encoded(|out| pose.encode(out))), Ok(pose));
    }
    // A name that is not UTF-8 is repaired, and may then be too long for a beacon.
    if let Ok(beacon) = Beacon::decode(datagram)
        && beacon.name.len() < 500
    {
        let again = encoded(|out| beacon.encode(out).unwrap());
        assert_eq!(Beacon::decode(&again), Ok(beacon));
    }
    if let Ok(rows) = rows::decode_rows(datagram) {
        assert!(rows.iter().flat_map(|row| row.values).flatten().all(f32::is_finite));
    }
    if let Ok(values) = rref::decode_values(datagram) {
        assert!(values.len() * 8 + 5 == datagram.len());
    }
    let _ = RunCommand::decode(datagram);
    let _ = (aircraft::Load::decode(datagram), decode_rate(datagram, &radr::TAG));
}

fn sender(from: &mut Unstructured) -> Result<SocketAddr> {
    let (host, port) = (from.int_in_range(1..=3)?, from.int_in_range(5000..=5002)?);
    Ok((Ipv4Addr::new(127, 0, 0, host), port).into())
}

/// One of these datagrams, in half of the cases with damage, or noise.
fn datagram(from: &mut Unstructured, examples: &[Vec<u8>]) -> Result<Vec<u8>> {
    let mut datagram = from.choose(examples)?.clone();
    while !datagram.is_empty() && sometimes(from, 0.5)? {
        let at = from.choose_index(datagram.len())?;
        match from.int_in_range(0..=4)? {
            0 => datagram.truncate(at),
            1 => datagram.extend(from.arbitrary::<[u8; 8]>()?),
            2 => {
                datagram.iter_mut().skip(at).zip((number(from)? as f32).to_le_bytes()).for_each(|(old, new)| *old = new)
            }
            3 => datagram.iter_mut().skip(at).zip(number(from)?.to_le_bytes()).for_each(|(old, new)| *old = new),
            _ => datagram[at] = from.arbitrary()?,
        }
    }
    Ok(datagram)
}

#[test]
fn a_datagram_is_refused_or_decoded() {
    explore(40_000, &[requests(), replies(&[1, 2, 3])].concat(), decode_as_each);
}

#[test]
fn the_stand_in_takes_any_datagram_and_sends_only_whole_messages() {
    let requests = requests();
    explore(1_000, &[], |bytes| {
        let mut from = Unstructured::new(bytes);
        let version = if from.arbitrary().unwrap_or(false) { Version::V11 } else { Version::V12 };
        let mut server = Server::new(version, 50, Surroundings::default());
        let received = parts(&mut from, 40, |from| Ok((datagram(from, &requests)?, sender(from)?)));
        for (nth, (datagram, from)) in received.iter().enumerate() {
            let _ = server.handle(datagram, *from);
            let controls = server.take_controls();
            assert!(controls.is_none_or(|controls| controls.is_within_limits()), "{controls:?}");
            let frame = Frame {
                time: PlantTime::from_seconds(0.02 * nth as f64),
                measurement: measurement(),
                truth: GroundTruth::default(),
            };
            server.publish(&frame, 0.02, |_, sent| {
                assert!(sent.len() <= MAX_DATAGRAM);
                let is_whole = Position::decode(sent).is_ok()
                    || rref::decode_values(sent).is_ok()
                    || rows::decode_rows(sent).is_ok()
                    || radr::RadarPoint::decode(sent).is_ok()
                    || radr::RadarPoint11::decode(sent).is_ok();
                assert!(is_whole, "{sent:?}");
            });
        }
    });
}

#[test]
fn an_agent_takes_any_datagram_and_writes_only_controls_within_their_travel() {
    let indices: Vec<i32> = (1000..1011).collect();
    let drawn = || {
        let mut next = 1000_i32;
        Indices::draw(|bytes| {
            for place in bytes.chunks_mut(4) {
                place.copy_from_slice(&next.to_le_bytes());
                next += 1;
            }
            true
        })
    };
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
    let replies = replies(&indices);
    explore(1_000, &[], |bytes| {
        let steps = parts(&mut Unstructured::new(bytes), 60, |from| {
            let received = (datagram(from, &replies)?, sender(from)?, from.int_in_range(0..=60)?);
            Ok((received, [number(from)?, number(from)?, number(from)?, number(from)?]))
        });
        let mut client = Client::new(&origin, &Profile::default(), 50, drawn().unwrap());
        let mut at = now();
        let mut sent: Vec<Vec<u8>> = Vec::new();
        for ((datagram, from, later_ms), [roll, pitch, yaw, collective]) in steps {
            at += Duration::from_millis(later_ms);
            client.renew(at, &mut |datagram| sent.push(datagram.to_vec()));
            client.receive(&datagram, from, IpAddr::V4(SIMULATOR), at);
            if let Some(frame) = client.frame() {
                assert!(frame.truth.position.is_finite() && frame.measurement.velocity.is_finite());
                assert!(frame.measurement.attitude.is_finite() && frame.measurement.rates.is_finite());
            }
            let controls = Command::Controls(Controls { roll, pitch, yaw, collective });
            client.command(controls, at, &mut |datagram| sent.push(datagram.to_vec()));
            for datagram in sent.drain(..) {
                let Ok(Write { path, value }) = Write::decode(&datagram) else {
                    assert!(decode_rate(&datagram, &rpos::TAG).is_ok() || DatarefRequest::decode(&datagram).is_ok());
                    continue;
                };
                assert!((-1.0..=1.0).contains(&value), "{path} = {value}");
            }
        }
    });
}
