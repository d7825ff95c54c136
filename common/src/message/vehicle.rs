//! Facts of one vehicle: what an agent publishes of it, and how displays and tables show that. A new fact is declared in this
//! file alone: a field of [`VehicleFacts`], of [`Trace`] too if it is to be recorded, and a row of [`FACTS`] if it is one
//! number. The docstrings of the trace's fields are the descriptions in the JSON schema of recordings.

use serde::{Deserialize, Serialize};

use super::{Failure, Header, Health, Message, PeerContact, message};
use crate::frame::{Attitude, PositionNed, VelocityNed};
use crate::id::VehicleId;
use crate::scenario::{Setting, TunableKey};
use crate::state::{Activity, Membership, PeerStatus};
use crate::time::PlantTime;
use crate::topic::{Author, Topic};

/// Facts of one vehicle at one instant, for displays. A [`Summary`](super::Summary) has them by the vehicle's own estimate,
/// [`Trace::facts`] by the ground truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VehicleFacts {
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
    /// Timing and counts of the agent's process. Every summary has them, a trace by the vehicle's health report.
    #[serde(flatten)]
    pub process: Option<ProcessFigures>,
    /// Failures that the agent detected of its own vehicle.
    pub failures: Vec<Failure>,
    /// Every peer of which a message ever arrived.
    pub peers: Vec<PeerContact>,
}

/// Timing and counts of an agent's process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProcessFigures {
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
}

impl From<&Health> for ProcessFigures {
    fn from(health: &Health) -> Self {
        Self {
            frame_rate_hz: health.frame_rate_hz,
            jitter_ms: health.jitter_ms,
            step_p99_us: health.step_p99_us,
            frame_overruns: health.frame_overruns,
            dropped: health.drops.total(),
            unsent: health.unsent,
        }
    }
}

impl VehicleFacts {
    /// The position; the swarm's origin before the vehicle has estimated one.
    pub fn place(&self) -> PositionNed {
        self.position.unwrap_or_default()
    }

    /// Age of the oldest state of a peer in contact, ms.
    fn oldest_peer_ms(&self) -> Option<f64> {
        let in_contact = self.peers.iter().filter(|peer| peer.standing != PeerStatus::Lost);
        in_contact.map(|peer| f64::from(peer.age_ms)).reduce(f64::max)
    }

    /// The same with every number rounded to three decimals: millimetres, milliseconds, milliradians. A number without
    /// noise in its last digits is a third as long as text.
    pub(super) fn rounded(mut self) -> Self {
        let Attitude { roll_rad, pitch_rad, heading_rad } = &mut self.attitude;
        let timing =
            self.process.iter_mut().flat_map(|ProcessFigures { frame_rate_hz, jitter_ms, step_p99_us, .. }| {
                [frame_rate_hz, jitter_ms, step_p99_us]
            });
        let optional = [
            &mut self.flown_s,
            &mut self.in_place_s,
            &mut self.altitude_setpoint_m,
            &mut self.power_w,
            &mut self.energy_left,
        ];
        [roll_rad, pitch_rad, heading_rad]
            .into_iter()
            .chain(timing)
            .chain(self.velocity.0.iter_mut())
            .chain(self.position.iter_mut().flat_map(|position| position.0.iter_mut()))
            .chain(&mut self.centre_ne_m)
            .chain(self.field_ne.iter_mut().chain(&mut self.error_ne_m).flatten())
            .chain(self.controls.iter_mut().flatten())
            .chain(optional.into_iter().flatten())
            .for_each(|number| *number = (*number * 1e3).round() / 1e3);
        self
    }
}

/// Trace of one step of an agent: its estimates, the ground truth and its outputs. Sent only while a process
/// subscribes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Trace {
    /// Sender, number and time of the message.
    pub header: Header,
    /// Simulator time of the frame, ns.
    pub plant_time: PlantTime,
    /// Whether the vehicle is an active member of the swarm.
    pub membership: Membership,
    /// The vehicle's activity.
    pub activity: Activity,
    /// Number of live members that the agent counts, itself included.
    pub live: u8,
    /// The mission step that the agent is at, counted from 0.
    pub step: u32,
    /// The highest step whose goal the vehicle reached in this incarnation; null before the first.
    pub reached: Option<u32>,
    /// Time for which the vehicle has been in formation without interruption, s: at its altitude, and where the law wants it;
    /// null while it is not in formation, and from releases that did not record it.
    #[serde(default)]
    pub in_place_s: Option<f64>,
    /// Present values of the keys that operators have set in flight.
    #[serde(default)]
    pub settings: Vec<Setting>,
    /// The agent's estimate of the formation's centre, north and east, m.
    pub centre_ne_m: [f64; 2],
    /// Estimated own position, north, east and down, m.
    pub estimate: PositionNed,
    /// True position in the swarm's frame, north, east and down, m.
    pub position: PositionNed,
    /// True height above the ground, m.
    pub height_m: f64,
    /// True velocity in the swarm's frame, north, east and down, m/s.
    pub velocity: VelocityNed,
    /// True attitude in the swarm's frame, Euler angles 3-2-1, rad.
    pub attitude: Attitude,
    /// Shaft power, W; null where the plant does not report it.
    pub power_w: Option<f64>,
    /// The formation field V: north, east, dimensionless.
    pub field_ne: [f64; 2],
    /// The field converted to a position error: north, east, m.
    pub error_ne_m: [f64; 2],
    /// Altitude setpoint of the vehicle controller above the origin, m.
    pub altitude_setpoint_m: f64,
    /// Controls sent to the plant: roll, pitch, yaw, collective; null while the agent does not control the plant, and for
    /// a point mass, which has none.
    #[serde(rename = "sticks")]
    pub controls: Option<[f64; 4]>,
    /// Every peer of which a message ever arrived.
    pub peers: Vec<PeerAge>,
    /// Time from the previous frame's arrival to its last control output, µs; null in virtual time.
    pub step_us: Option<f64>,
    /// Number of activations of the safety filter since the start; null without a filter.
    pub safety_activations: Option<u64>,
    /// Number of requests that the external law did not answer since the start; null without an external law.
    pub law_misses: Option<u64>,
    /// Whether the fallback flies in the place of the external law; null where the vehicle flies by no external law, and from
    /// releases that did not record it.
    #[serde(default)]
    pub fallback_flies: Option<bool>,
    /// Numbers that the external law asked to record with its last answer.
    pub law_log: Vec<LawNumber>,
    /// Number of steps that ended after the next frame was due, since the start.
    pub frame_overruns: u64,
    /// Number of state messages sent since the start.
    pub state_messages: u64,
    /// Payload of the state messages sent, bytes.
    pub state_bytes: u64,
}

impl Trace {
    /// The trace of a vehicle that is where these facts have it; it lacks what only a trace has.
    pub fn new(header: Header, plant_time: PlantTime, facts: VehicleFacts) -> Self {
        Self {
            header,
            plant_time,
            membership: facts.membership,
            activity: facts.activity,
            live: facts.live,
            step: facts.step,
            reached: facts.reached,
            in_place_s: facts.in_place_s,
            settings: facts.settings,
            centre_ne_m: facts.centre_ne_m,
            estimate: facts.position.unwrap_or_default(),
            position: facts.position.unwrap_or_default(),
            height_m: 0.0,
            velocity: facts.velocity,
            attitude: facts.attitude,
            power_w: facts.power_w,
            field_ne: facts.field_ne.unwrap_or_default(),
            error_ne_m: facts.error_ne_m.unwrap_or_default(),
            altitude_setpoint_m: facts.altitude_setpoint_m.unwrap_or_default(),
            controls: facts.controls,
            peers: Vec::new(),
            step_us: None,
            safety_activations: None,
            law_misses: None,
            fallback_flies: None,
            law_log: Vec::new(),
            frame_overruns: 0,
            state_messages: 0,
            state_bytes: 0,
        }
    }

    /// The facts of the vehicle by the ground truth. `health` is its newest health report, of which a trace has nothing.
    pub fn facts(&self, health: Option<&Health>) -> VehicleFacts {
        VehicleFacts {
            flown_s: None,
            activity: self.activity,
            membership: self.membership,
            step: self.step,
            reached: self.reached,
            in_place_s: self.in_place_s,
            settings: self.settings.clone(),
            live: self.live,
            position: Some(self.position),
            velocity: self.velocity,
            attitude: self.attitude,
            centre_ne_m: self.centre_ne_m,
            altitude_setpoint_m: Some(self.altitude_setpoint_m),
            field_ne: Some(self.field_ne),
            error_ne_m: Some(self.error_ne_m),
            controls: self.controls,
            power_w: self.power_w,
            energy_left: None,
            process: health.map(ProcessFigures::from),
            failures: health.map(|health| health.failures.clone()).unwrap_or_default(),
            peers: self.peers.iter().map(|peer| PeerContact::new(peer.id, peer.age_s, peer.standing)).collect(),
        }
    }
}

/// A number that an external law asks to record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LawNumber {
    /// Name that the law gives the number, at most 32 bytes.
    pub name: String,
    /// The number; it is finite.
    pub value: f64,
}

impl LawNumber {
    /// Largest length of a name, bytes.
    pub const MAX_NAME: usize = 32;
    /// Largest number of recorded numbers in one answer.
    pub const MAX_COUNT: usize = 16;

    fn is_plausible(&self) -> bool {
        self.name.len() <= Self::MAX_NAME && self.value.is_finite()
    }
}

/// Age of one peer's newest state at one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PeerAge {
    /// The peer.
    pub id: VehicleId,
    /// Status of the peer as this vehicle sees it.
    pub standing: PeerStatus,
    /// Upper bound of the age of the peer's newest state by the receiver's clock, s; it includes the delay once a round
    /// trip is known.
    pub age_s: f64,
    /// Upper bound of the network delay of that state, s; null until a round trip is known.
    #[serde(default)]
    pub delay_s: Option<f64>,
    /// Exact delay that the scenario's network impairments added to that state, s.
    pub delivered_age_s: f64,
}

impl PeerAge {
    fn is_plausible(&self) -> bool {
        [self.age_s, self.delivered_age_s].iter().chain(&self.delay_s).all(|number| number.is_finite())
    }

    /// Time since the newest state of the peer arrived, s.
    pub fn silent_s(&self) -> f64 {
        self.age_s - self.delay_s.unwrap_or_default()
    }
}

message!(Trace, 16 * 1024, |trace| Author::Vehicle(trace.header.sender), |trace| {
    let pairs = trace.field_ne.iter().chain(&trace.error_ne_m).chain(&trace.centre_ne_m);
    let options = trace.power_w.iter().chain(&trace.step_us).chain(&trace.in_place_s);
    trace.estimate.is_finite()
        && trace.position.is_finite()
        && trace.velocity.is_finite()
        && trace.attitude.is_finite()
        && trace.height_m.is_finite()
        && trace.altitude_setpoint_m.is_finite()
        && pairs.chain(options).chain(trace.controls.iter().flatten()).all(|number| number.is_finite())
        && trace.settings.len() <= TunableKey::ALL.len()
        && trace.settings.iter().all(Setting::is_in_range)
        && trace.peers.iter().all(PeerAge::is_plausible)
        && trace.law_log.len() <= LawNumber::MAX_COUNT
        && trace.law_log.iter().all(LawNumber::is_plausible)
});

/// The name of a column of `trace.csv`, and the text of its cell for a step.
pub type TraceColumn = (&'static str, fn(&Trace) -> String);

/// The columns of `trace.csv` after the time. Their names stay the same from release to release, and new columns come last.
pub const TRACE_COLUMNS: &[TraceColumn] = &[
    ("vehicle", |trace| trace.header.sender.to_string()),
    ("incarnation", |trace| trace.header.incarnation.0.to_string()),
    ("sequence", |trace| trace.header.sequence.to_string()),
    ("stamp_s", |trace| trace.header.stamp.seconds().to_string()),
    ("plant_time_s", |trace| trace.plant_time.seconds().to_string()),
    ("membership", |trace| format!("{:?}", trace.membership)),
    ("activity", |trace| format!("{:?}", trace.activity)),
    ("live", |trace| trace.live.to_string()),
    ("step", |trace| trace.step.to_string()),
    ("reached", |trace| optional(trace.reached)),
    ("centre_north_m", |trace| trace.centre_ne_m[0].to_string()),
    ("centre_east_m", |trace| trace.centre_ne_m[1].to_string()),
    ("estimate_north_m", |trace| trace.estimate.north_m().to_string()),
    ("estimate_east_m", |trace| trace.estimate.east_m().to_string()),
    ("estimate_down_m", |trace| trace.estimate.down_m().to_string()),
    ("north_m", |trace| trace.position.north_m().to_string()),
    ("east_m", |trace| trace.position.east_m().to_string()),
    ("down_m", |trace| trace.position.down_m().to_string()),
    ("height_m", |trace| trace.height_m.to_string()),
    ("velocity_north_m_s", |trace| trace.velocity.north_m_s().to_string()),
    ("velocity_east_m_s", |trace| trace.velocity.east_m_s().to_string()),
    ("velocity_down_m_s", |trace| trace.velocity.down_m_s().to_string()),
    ("roll_rad", |trace| trace.attitude.roll_rad.to_string()),
    ("pitch_rad", |trace| trace.attitude.pitch_rad.to_string()),
    ("heading_rad", |trace| trace.attitude.heading_rad.to_string()),
    ("power_w", |trace| optional(trace.power_w)),
    ("field_north", |trace| trace.field_ne[0].to_string()),
    ("field_east", |trace| trace.field_ne[1].to_string()),
    ("error_north_m", |trace| trace.error_ne_m[0].to_string()),
    ("error_east_m", |trace| trace.error_ne_m[1].to_string()),
    ("altitude_setpoint_m", |trace| trace.altitude_setpoint_m.to_string()),
    ("stick_roll", |trace| optional(trace.controls.map(|controls| controls[0]))),
    ("stick_pitch", |trace| optional(trace.controls.map(|controls| controls[1]))),
    ("stick_yaw", |trace| optional(trace.controls.map(|controls| controls[2]))),
    ("stick_collective", |trace| optional(trace.controls.map(|controls| controls[3]))),
    ("step_us", |trace| optional(trace.step_us)),
    ("safety_activations", |trace| optional(trace.safety_activations)),
    ("frame_overruns", |trace| trace.frame_overruns.to_string()),
    ("state_messages", |trace| trace.state_messages.to_string()),
    ("state_bytes", |trace| trace.state_bytes.to_string()),
    ("law_misses", |trace| optional(trace.law_misses)),
    ("fallback_flies", |trace| optional(trace.fallback_flies)),
];

/// The text of a cell, which is empty without a value.
fn optional(value: Option<impl ToString>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// A fact that is one number, and how displays show it.
#[derive(Clone, Copy, Debug)]
pub struct Fact {
    /// Its key in JSON: in snapshots of the page and, where it has a column, in the progress lines of `fly --json`.
    pub key: &'static str,
    /// The number of a vehicle; `None` while it is unknown.
    pub of: fn(&VehicleFacts) -> Option<f64>,
    /// The choice between the numbers of two vehicles for the row of a team.
    pub of_team: fn(f64, f64) -> f64,
    /// The number that people read is so many times the number.
    pub factor: f64,
    /// Decimals that people read.
    pub decimals: usize,
    /// `true` if the page receives it.
    pub on_page: bool,
    /// The line on the page's card of a vehicle.
    pub line: Option<FactLine>,
    /// The column in the table on a terminal.
    pub column: Option<FactColumn>,
}

/// The presentation of a fact on the page's card of a vehicle.
#[derive(Clone, Copy, Debug)]
pub struct FactLine {
    /// The name before the number.
    pub name: &'static str,
    /// The unit after the number.
    pub unit: &'static str,
    /// The meaning of the number.
    pub about: &'static str,
}

/// The presentation of a fact as a column of the table on a terminal.
#[derive(Clone, Copy, Debug)]
pub struct FactColumn {
    /// Its headings: on a terminal of 80 columns, and on a wide one.
    pub titles: [&'static str; 2],
    /// The least width of its numbers.
    pub width: u16,
    /// Its place in the order of importance: of the columns that do not fit, the one with the greatest is left out first.
    pub rank: u8,
    /// The meaning of its numbers, their unit, and which values are bad.
    pub about: &'static str,
}

/// Every fact that is one number, in the order in which it is shown.
pub const FACTS: &[Fact] = &[
    Fact {
        factor: 100.0,
        line: Some(FactLine {
            name: "energy",
            unit: "% left",
            about: "share of the battery, or of the tank, that is left",
        }),
        ..fact("energy_left", |facts| facts.energy_left, f64::min)
    },
    Fact {
        decimals: 1,
        column: Some(FactColumn {
            titles: ["Hz", "frames/s"],
            width: 4,
            rank: 8,
            about: "simulator frames per second; bad if far below 50 (below the simulator's own rate)",
        }),
        ..fact("frame_rate_hz", |facts| Some(facts.process?.frame_rate_hz), f64::min)
    },
    fact("jitter_ms", |facts| Some(facts.process?.jitter_ms), f64::max),
    Fact {
        on_page: false,
        column: Some(FactColumn {
            titles: ["peer ms", "peer age ms"],
            width: 7,
            rank: 9,
            about: "age of the oldest state of a peer in contact, with delay, ms; above 500 is stale",
        }),
        ..fact("peer_age_ms", VehicleFacts::oldest_peer_ms, f64::max)
    },
    Fact {
        column: Some(FactColumn {
            titles: ["p99 µs", "p99 step µs"],
            width: 6,
            rank: 12,
            about: "99th percentile of the time from a frame to its control, µs; bad above 20000",
        }),
        ..fact("step_p99_us", |facts| Some(facts.process?.step_p99_us), f64::max)
    },
];

/// A fact that is a number in the snapshots of the page, and has no line and no column.
const fn fact(key: &'static str, of: fn(&VehicleFacts) -> Option<f64>, of_team: fn(f64, f64) -> f64) -> Fact {
    Fact { key, of, of_team, factor: 1.0, decimals: 0, on_page: true, line: None, column: None }
}

/// The numbers of [`FACTS`], of one vehicle or of a team.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FactValues([Option<f64>; FACTS.len()]);

impl FactValues {
    /// The numbers of a vehicle.
    pub fn of(facts: &VehicleFacts) -> Self {
        Self(std::array::from_fn(|nth| (FACTS[nth].of)(facts)))
    }

    /// The numbers of a team with these vehicles.
    pub fn of_team(vehicles: &[Self]) -> Self {
        Self(std::array::from_fn(|nth| vehicles.iter().filter_map(|vehicle| vehicle.0[nth]).reduce(FACTS[nth].of_team)))
    }

    /// The number of the fact with this key; `None` while it is unknown.
    pub fn get(&self, key: &str) -> Option<f64> {
        self.iter().find(|(fact, _)| fact.key == key).and_then(|(_, value)| value)
    }

    /// Every fact with its number.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Fact, Option<f64>)> {
        FACTS.iter().zip(self.0)
    }
}
