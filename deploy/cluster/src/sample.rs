//! What a display shows of one vehicle at one instant: from a trace, which has the ground truth, or from a summary, which
//! has the vehicle's own estimate.

use skein_common::frame::{Attitude, PositionNed, VelocityNed};
use skein_common::message::{Failure, Health, PeerContact, Summary, Trace};
use skein_common::scenario::Setting;
use skein_common::state::{Activity, Membership};

/// One vehicle at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleSample {
    /// Time since the vehicle became an active member of the swarm, s.
    pub flown_s: Option<f64>,
    /// The vehicle's activity.
    pub activity: Activity,
    /// Whether the vehicle is an active member of the swarm.
    pub membership: Membership,
    /// The mission step that the agent is at, counted from 0.
    pub step: u32,
    /// The highest step whose goal the vehicle reached.
    pub reached: Option<u32>,
    /// Time for which the vehicle has been in formation without interruption, s; `None` while it is not.
    pub in_place_s: Option<f64>,
    /// Present values of the keys that operators have set in flight.
    pub settings: Vec<Setting>,
    /// Number of live members that the agent counts, itself included.
    pub live: u8,
    /// Position in the swarm's frame.
    pub position: PositionNed,
    /// Velocity over the ground.
    pub velocity: VelocityNed,
    /// Attitude.
    pub attitude: Attitude,
    /// The agent's estimate of the formation's centre, north and east, m.
    pub centre_ne_m: [f64; 2],
    /// Altitude setpoint above the origin, m.
    pub altitude_setpoint_m: Option<f64>,
    /// The formation field V: north, east, dimensionless.
    pub field_ne: Option<[f64; 2]>,
    /// The field converted to a position error: north, east, m.
    pub error_ne_m: Option<[f64; 2]>,
    /// Controls sent to the plant: roll, pitch, yaw, collective.
    pub controls: Option<[f64; 4]>,
    /// Share of the vehicle's energy that is left, 0 to 1, where it is known.
    pub energy_left: Option<f64>,
    /// Timing and counts of the agent's process, where they are known.
    pub process: Option<ProcessFigures>,
    /// Failures that the agent detected of its own vehicle.
    pub failures: Vec<Failure>,
    /// Every peer of which a message ever arrived.
    pub peers: Vec<PeerContact>,
}

/// Timing and counts of an agent's process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessFigures {
    /// Rate of simulator frames over the last second, Hz.
    pub frame_rate_hz: f64,
    /// Largest excess of the time between two frames over their period, over the last second, ms.
    pub jitter_ms: f64,
    /// 99th percentile of the time from a frame's arrival to its last control output, over the last second, µs.
    pub step_p99_us: f64,
    /// Number of steps that ended after the next frame was due, since the start.
    pub frame_overruns: u64,
    /// Number of messages and datagrams that were dropped, since the start.
    pub dropped: u64,
    /// Number of own messages that were not sent because the network was too slow, since the start.
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

impl VehicleSample {
    /// The ground truth of a trace. `health` is the vehicle's newest health report, which a trace lacks.
    pub fn of_trace(trace: &Trace, health: Option<&Health>) -> Self {
        Self {
            flown_s: None,
            activity: trace.activity,
            membership: trace.membership,
            step: trace.step,
            reached: trace.reached,
            in_place_s: trace.in_place_s,
            settings: trace.settings.clone(),
            live: trace.live,
            position: trace.position,
            velocity: trace.velocity,
            attitude: trace.attitude,
            centre_ne_m: trace.centre_ne_m,
            altitude_setpoint_m: Some(trace.altitude_setpoint_m),
            field_ne: Some(trace.field_ne),
            error_ne_m: Some(trace.error_ne_m),
            controls: trace.controls,
            energy_left: None,
            process: health.map(ProcessFigures::from),
            failures: health.map(|health| health.failures.clone()).unwrap_or_default(),
            peers: trace.peers.iter().map(|peer| PeerContact::new(peer.id, peer.age_s, peer.standing)).collect(),
        }
    }

    /// The estimates of a summary; `None` before the vehicle has estimated its position.
    pub fn of_summary(summary: &Summary) -> Option<Self> {
        Some(Self {
            flown_s: summary.flown_s,
            activity: summary.activity,
            membership: summary.membership,
            step: summary.step,
            reached: summary.reached,
            in_place_s: summary.in_place_s,
            settings: summary.settings.clone(),
            live: summary.live,
            position: summary.position?,
            velocity: summary.velocity,
            attitude: summary.attitude,
            centre_ne_m: summary.centre_ne_m,
            altitude_setpoint_m: summary.altitude_setpoint_m,
            field_ne: summary.field_ne,
            error_ne_m: summary.error_ne_m,
            controls: summary.controls,
            energy_left: summary.energy_left,
            process: Some(ProcessFigures {
                frame_rate_hz: summary.frame_rate_hz,
                jitter_ms: summary.jitter_ms,
                step_p99_us: summary.step_p99_us,
                frame_overruns: summary.frame_overruns,
                dropped: summary.dropped,
                unsent: summary.unsent,
            }),
            failures: summary.failures.clone(),
            peers: summary.peers.clone(),
        })
    }
}
