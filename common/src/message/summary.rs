//! Summary of an agent for pages, ground stations and scripts: JSON, at most ten times a second.

use serde::{Deserialize, Serialize};

use super::{Encoding, Failure, Header, MAX_STEP, Message};
use crate::frame::{Attitude, PositionNed, VelocityNed};
use crate::id::VehicleId;
use crate::scenario::{Setting, TunableKey};
use crate::state::{Activity, Membership, PeerStatus, VehicleState};
use crate::time::PlantTime;
use crate::topic::{Author, Topic};

/// Summary of an agent: what its vehicle believes of itself, of the formation and of its peers. Every value is the
/// vehicle's own estimate or count, never the ground truth. Sent only while a process subscribes. Numbers are rounded to
/// three decimals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Sender, number and time of the message.
    pub header: Header,
    /// Simulator time of the last frame, ns.
    pub plant_time: PlantTime,
    /// Time since the vehicle became an active member of the swarm, s; null before.
    pub flown_s: Option<f64>,
    /// The vehicle's activity.
    pub activity: Activity,
    /// Whether the vehicle is an active member of the swarm.
    pub membership: Membership,
    /// The mission step that the agent is at, counted from 0.
    pub step: u32,
    /// The highest step whose goal the vehicle reached in this incarnation; null before the first.
    pub reached: Option<u32>,
    /// Time for which the vehicle has been in formation without interruption, s: at its altitude, and where the law wants it.
    /// Null while it is not in formation.
    #[serde(default)]
    pub in_place_s: Option<f64>,
    /// Present values of the keys that operators have set in flight.
    #[serde(default)]
    pub settings: Vec<Setting>,
    /// Number of live members that the agent counts, itself included.
    pub live: u8,
    /// Estimated position, north, east and down from the swarm's origin, m; null before the first estimate.
    pub position: Option<PositionNed>,
    /// Estimated velocity over the ground in the swarm's frame, north, east and down, m/s.
    pub velocity: VelocityNed,
    /// Estimated attitude; the heading is from the north at the swarm's origin.
    pub attitude: Attitude,
    /// Centre of the formation, north and east from the swarm's origin, m.
    pub centre_ne_m: [f64; 2],
    /// Altitude setpoint of the vehicle controller above the origin, m; null without a setpoint.
    pub altitude_setpoint_m: Option<f64>,
    /// The formation field V: north, east, dimensionless; null without a setpoint.
    pub field_ne: Option<[f64; 2]>,
    /// The field converted to a position error: north, east, m; null without a setpoint.
    pub error_ne_m: Option<[f64; 2]>,
    /// Controls sent to the plant: roll, pitch, yaw, collective; null while the agent does not control the plant, and for
    /// a point mass, which has none.
    pub controls: Option<[f64; 4]>,
    /// Shaft power that the plant reports, W; null where it does not.
    pub power_w: Option<f64>,
    /// Share of the vehicle's energy that is left, 0 to 1: all of it when the agent starts, less what the reported power has
    /// used. Null without a power, for an aircraft without a capacity, and from releases that did not send it.
    #[serde(default)]
    pub energy_left: Option<f64>,
    /// Rate of simulator frames over the last second, Hz.
    pub frame_rate_hz: f64,
    /// Largest excess of the time between two frames over their period, over the last second, ms.
    pub jitter_ms: f64,
    /// 99th percentile of the time from a frame's arrival to its last control output, over the last second, µs.
    pub step_p99_us: f64,
    /// Number of steps that ended after the next frame was due, since the start.
    pub frame_overruns: u64,
    /// Number of messages, links and datagrams that the agent refused or dropped, for any reason, since the start.
    pub dropped: u64,
    /// Number of own messages that the agent did not send because the network was too slow, since the start.
    #[serde(default)]
    pub unsent: u64,
    /// Failures that the agent detected of its own vehicle.
    pub failures: Vec<Failure>,
    /// Every peer of which a message ever arrived.
    pub peers: Vec<PeerContact>,
}

/// Contact with one peer. In JSON it is an array of its values, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "(VehicleId, u32, PeerStatus)", into = "(VehicleId, u32, PeerStatus)")]
pub struct PeerContact {
    /// The peer.
    pub id: VehicleId,
    /// Upper bound of the age of the peer's newest state by the receiver's clock, ms; it includes the delay once a round trip
    /// is known.
    pub age_ms: u32,
    /// Fresh, stale or lost.
    pub standing: PeerStatus,
}

impl PeerContact {
    /// Contact with a peer whose newest state has this age, s; an age beyond the range of [`Self::age_ms`] is cut to it.
    pub fn new(id: VehicleId, age_s: f64, standing: PeerStatus) -> Self {
        // A conversion from a float saturates.
        Self { id, age_ms: (1e3 * age_s).round() as u32, standing }
    }
}

impl From<(VehicleId, u32, PeerStatus)> for PeerContact {
    fn from((id, age_ms, standing): (VehicleId, u32, PeerStatus)) -> Self {
        Self { id, age_ms, standing }
    }
}

impl From<PeerContact> for (VehicleId, u32, PeerStatus) {
    fn from(PeerContact { id, age_ms, standing }: PeerContact) -> Self {
        (id, age_ms, standing)
    }
}

impl Summary {
    /// The same with every number rounded to three decimals: millimetres, milliseconds, milliradians. A number without
    /// noise in its last digits is a third as long as text.
    pub fn rounded(mut self) -> Self {
        let Attitude { roll_rad, pitch_rad, heading_rad } = &mut self.attitude;
        let numbers =
            [roll_rad, pitch_rad, heading_rad, &mut self.frame_rate_hz, &mut self.jitter_ms, &mut self.step_p99_us]
                .into_iter()
                .chain(self.velocity.0.iter_mut())
                .chain(self.position.iter_mut().flat_map(|position| position.0.iter_mut()))
                .chain(&mut self.centre_ne_m)
                .chain(self.field_ne.iter_mut().chain(&mut self.error_ne_m).flatten())
                .chain(self.controls.iter_mut().flatten())
                .chain(
                    [
                        &mut self.flown_s,
                        &mut self.in_place_s,
                        &mut self.altitude_setpoint_m,
                        &mut self.power_w,
                        &mut self.energy_left,
                    ]
                    .into_iter()
                    .flatten(),
                );
        numbers.for_each(|number| *number = (*number * 1e3).round() / 1e3);
        self
    }
}

impl Message for Summary {
    const MAX_BYTES: usize = 8 * 1024;
    const ENCODING: Encoding = Encoding::Json;

    fn is_plausible(&self) -> bool {
        let Self { position, velocity, attitude, .. } = self;
        let pairs = self.field_ne.iter().chain(&self.error_ne_m).chain([&self.centre_ne_m]).flatten();
        let options = [self.flown_s, self.in_place_s, self.altitude_setpoint_m, self.power_w, self.energy_left];
        let timing = [self.frame_rate_hz, self.jitter_ms, self.step_p99_us];
        position.is_none_or(|position| position.is_finite() && position.0.norm() < MAX_DISTANCE_M)
            && velocity.is_finite()
            && velocity.0.norm() <= VehicleState::MAX_SPEED_M_S
            && attitude.is_finite()
            && pairs
                .chain(options.iter().flatten())
                .chain(self.controls.iter().flatten())
                .all(|number| number.is_finite())
            && timing.iter().all(|number| number.is_finite() && *number >= 0.0)
            && self.step <= MAX_STEP
            && self.reached.is_none_or(|reached| reached <= MAX_STEP)
            && self.settings.len() <= TunableKey::ALL.len()
            && self.settings.iter().all(Setting::is_in_range)
            && self.failures.len() <= Failure::KINDS
            && self.peers.len() <= usize::from(VehicleId::MAX)
    }

    fn is_allowed_under(&self, topic: &Topic) -> bool {
        topic.author() == Author::Vehicle(self.header.sender)
    }
}

/// Largest plausible distance from the swarm's origin, m: the diameter of the Earth.
const MAX_DISTANCE_M: f64 = 13e6;

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{DecodeError, VERSION, decode, encode, encoded_len};
    use super::*;
    use crate::id::Incarnation;
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
            frame_rate_hz: 50.0,
            jitter_ms: 0.2,
            step_p99_us: 24.0,
            frame_overruns: 0,
            dropped: 2,
            unsent: 1,
            failures: vec![Failure::Engine],
            peers: VehicleId::first(peers.into()).map(contact).collect(),
        }
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
        let fine = Summary {
            flown_s: Some(third),
            position: Some(PositionNed::new(third, -third, 1e6 * third)),
            attitude: Attitude { heading_rad: third, ..Attitude::default() },
            field_ne: Some([third; 2]),
            jitter_ms: third,
            ..summary(0)
        };
        let rounded = fine.clone().rounded();
        assert_eq!(rounded.flown_s, Some(0.333));
        assert_eq!(rounded.position, Some(PositionNed::new(0.333, -0.333, 333_333.333)));
        assert_eq!(
            (rounded.attitude.heading_rad, rounded.field_ne, rounded.jitter_ms),
            (0.333, Some([0.333; 2]), 0.333)
        );
        assert!(encoded_len(&rounded) + 80 < encoded_len(&fine));
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
            step: MAX_STEP,
            reached: Some(MAX_STEP),
            live: VehicleId::MAX,
            position: Some(PositionNed::new(long, long, long)),
            field_ne: Some([long; 2]),
            error_ne_m: Some([long; 2]),
            controls: Some([long; 4]),
            power_w: Some(-long),
            energy_left: Some(-long),
            frame_overruns: u64::MAX,
            dropped: u64::MAX,
            failures: vec![Failure::Altitude; Failure::KINDS],
            peers: VehicleId::first(VehicleId::MAX.into())
                .map(|id| PeerContact { id, age_ms: u32::MAX, standing: PeerStatus::Fresh })
                .collect(),
            ..summary(0)
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
}
