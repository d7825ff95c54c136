//! The last stage of the loop: what one step sends to the peers, and when it sends it.
//!
//! The vehicle sends its state when needed, as in DIS (IEEE 1278.1): when the peers' dead reckoning of it would be off
//! by more than a threshold, and at least once per `network.state_max_period_s`. It sends a heartbeat with its
//! agreement state when that state changes, again in a few frames after the change, and five times a second. When one of
//! the two is sent and the other is due within half a period of the heartbeat, both are sent in the same step: a second
//! message in the same instant costs the receivers almost nothing, whereas each instant wakes every one of them.

use alloc::boxed::Box;
use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use skein_common::frame::{Origin, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::math;
use skein_common::message::{self, Echo, EventKind, Header, Heartbeat, Intent, Order, State, Traffic};
use skein_common::scenario::{Network, SendMode};
use skein_common::time::{LocalTime, SenderStamp};

use crate::deadlines::{Deadline, HEARTBEAT_PERIOD_S};
use crate::estimate::Estimate;
use crate::mission::Mission;
use crate::mission::agreement::AgreementState;

/// Number of frames that repeat a changed agreement state: with 30 % loss, one peer in 50,000 misses all nine messages.
const CHANGE_REPEATS: u32 = 8;

/// A message that is due within this time goes with one that is sent now, s. Half a period of the heartbeat: then state
/// and heartbeat of a settled vehicle always go together, and neither is sent at more than twice its rate.
const SOON_S: f64 = 0.5 * HEARTBEAT_PERIOD_S;

/// The messages that one step sends.
///
/// The messages are in boxes because most steps send none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outbox {
    /// The own state, if the peers need a new one.
    pub state: Option<Box<State>>,
    /// The heartbeat with the agreement state, if it is due.
    pub mission: Option<Box<Heartbeat>>,
    /// The areas that the own team occupies and wants, if it is a team of a fleet and the others need to know.
    pub intent: Option<Box<Intent>>,
    /// The events of this step, in the order of the stages that found them.
    pub happened: Vec<EventKind>,
}

/// Decides when the vehicle sends its state and its heartbeat, and counts what it sent.
#[derive(Clone, Debug)]
pub struct SendSchedule {
    own: VehicleId,
    incarnation: Incarnation,
    /// Origin of the swarm's frame.
    origin: Origin,
    need: Need,
    sent: Option<SentState>,
    mission: Option<(Heartbeat, LocalTime)>,
    /// The newest order at the last heartbeat.
    newest_order: Option<Order>,
    /// Number of frames that still have to repeat the last change of the agreement state.
    repeats: u32,
    /// The states sent since the agent's start.
    pub(crate) states: Traffic,
    /// The heartbeats sent since the agent's start.
    pub(crate) heartbeats: Traffic,
    traces: u64,
    intents: u64,
}

/// The conditions under which the peers need a new state.
#[derive(Clone, Copy, Debug)]
struct Need {
    every_frame: bool,
    error_m: f64,
    error_m_s: f64,
    max_period_s: f64,
}

/// The last state sent, from which the peers dead-reckon the vehicle.
#[derive(Clone, Copy, Debug)]
struct SentState {
    position: PositionNed,
    velocity: VelocityNed,
    at: LocalTime,
}

impl Need {
    fn is_needed(&self, now: LocalTime, sent: Option<&SentState>, estimate: &Estimate) -> bool {
        let Some(sent) = sent else { return true };
        let since_s = now.seconds_since(sent.at);
        let reckoned = sent.position + sent.velocity.0 * since_s;
        self.every_frame
            || Deadline::StateDue(self.max_period_s).is_past(since_s)
            || (estimate.velocity - sent.velocity).norm_squared() > math::square(self.error_m_s)
            || (estimate.position - reckoned).norm_squared() > math::square(self.error_m)
    }
}

impl SendSchedule {
    /// The schedule of a vehicle whose agent has not sent anything yet; `origin` is that of the swarm's frame.
    pub fn new(own: VehicleId, incarnation: Incarnation, origin: &Origin, network: &Network) -> Self {
        let need = Need {
            every_frame: network.send == SendMode::EveryFrame,
            error_m: network.state_error_m,
            error_m_s: network.state_error_m_s,
            max_period_s: network.state_max_period_s,
        };
        Self {
            own,
            incarnation,
            origin: *origin,
            need,
            sent: None,
            mission: None,
            newest_order: None,
            repeats: 0,
            states: Traffic::default(),
            heartbeats: Traffic::default(),
            traces: 0,
            intents: 0,
        }
    }

    /// The messages to send now. With a stale estimate no state is sent: the peers extrapolate the last one and know
    /// its age. `peers` gives what a heartbeat with this stamp reports of the peers: the echo of one peer's heartbeat, and the
    /// peers lost as active members.
    pub fn outbox(
        &mut self,
        now: LocalTime,
        estimate: Option<&Estimate>,
        mission: &Mission,
        happened: Vec<EventKind>,
        peers: impl FnOnce(SenderStamp) -> (Option<Echo>, VehicleSet),
    ) -> Outbox {
        let is_heartbeat_due = self.is_heartbeat_due(now, mission);
        let state = estimate.filter(|estimate| self.is_state_due(now, estimate, is_heartbeat_due));
        let state = state.map(|estimate| Box::new(self.state(now, estimate)));
        let goes_along = state.is_some() && self.is_heartbeat_due_soon(now);
        let mission = (is_heartbeat_due || goes_along).then(|| Box::new(self.mission(now, mission, peers)));
        Outbox { state, mission, intent: None, happened }
    }

    /// The header of the next trace.
    pub fn header_of_trace(&mut self, now: LocalTime) -> Header {
        self.traces += 1;
        self.header(now, self.traces)
    }

    /// The header of the next intent.
    pub fn header_of_intent(&mut self, now: LocalTime) -> Header {
        self.intents += 1;
        self.header(now, self.intents)
    }

    /// Whether the peers need a new state now, or soon while a heartbeat is sent.
    fn is_state_due(&self, now: LocalTime, estimate: &Estimate, with_heartbeat: bool) -> bool {
        let soon = Deadline::StateDue(self.need.max_period_s - SOON_S);
        self.need.is_needed(now, self.sent.as_ref(), estimate)
            || with_heartbeat && self.sent.is_some_and(|sent| soon.is_past(now.seconds_since(sent.at)))
    }

    /// Whether a heartbeat is due soon. Where a state is sent every frame, the heartbeat waits for its own time, because
    /// there will be a state to go with.
    fn is_heartbeat_due_soon(&self, now: LocalTime) -> bool {
        let is_soon = |at| now.seconds_since(at) >= HEARTBEAT_PERIOD_S - SOON_S;
        !self.need.every_frame && self.mission.as_ref().is_some_and(|(_, at)| is_soon(*at))
    }

    fn state(&mut self, now: LocalTime, estimate: &Estimate) -> State {
        self.sent = Some(SentState { position: estimate.position, velocity: estimate.velocity, at: now });
        self.states.messages += 1;
        let message = State { header: self.header(now, self.states.messages), state: estimate.state(&self.origin) };
        self.states.bytes += message::encoded_len(&message) as u64;
        message
    }

    /// Whether a heartbeat is due. A change of the agreement state starts its repetitions.
    fn is_heartbeat_due(&mut self, now: LocalTime, mission: &Mission) -> bool {
        let Some((sent, at)) = &self.mission else { return true };
        let &Heartbeat { membership, step, vouched, reached, .. } = sent;
        let before = AgreementState { membership, step, vouched, reached };
        if (before, self.newest_order) != (mission.agreement_state(), mission.newest_order) {
            self.repeats = CHANGE_REPEATS + 1;
        }
        self.repeats > 0 || Deadline::HeartbeatDue.is_past(now.seconds_since(*at))
    }

    fn mission(
        &mut self,
        now: LocalTime,
        mission: &Mission,
        peers: impl FnOnce(SenderStamp) -> (Option<Echo>, VehicleSet),
    ) -> Heartbeat {
        self.repeats = self.repeats.saturating_sub(1);
        self.newest_order = mission.newest_order;
        let turn = self.heartbeats.messages as usize;
        let order = if self.repeats > 0 {
            self.newest_order
        } else {
            mission.orders.iter().nth(turn % mission.orders.len().max(1))
        };
        self.heartbeats.messages += 1;
        let header = self.header(now, self.heartbeats.messages);
        let (echo, lost) = peers(header.stamp);
        let AgreementState { membership, step, vouched, reached } = mission.agreement_state();
        let heartbeat = Heartbeat {
            header,
            plan: mission.plan,
            membership,
            step,
            vouched,
            reached,
            progress_m: mission.progress_m(),
            order,
            orders: mission.orders.len().min(u16::MAX.into()) as u16,
            echo,
            lost,
        };
        self.heartbeats.bytes += message::encoded_len(&heartbeat) as u64;
        self.mission = Some((heartbeat, now));
        heartbeat
    }

    fn header(&self, now: LocalTime, sequence: u64) -> Header {
        Header { sender: self.own, incarnation: self.incarnation, sequence, stamp: now.into() }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;
    use skein_common::frame::{Attitude, BodyRates, Geodetic};
    use skein_common::scenario::{Source, load};

    use super::*;

    fn estimate(north_m: f64, north_m_s: f64) -> Estimate {
        Estimate {
            position: PositionNed::new(north_m, 0.0, -30.0),
            geodetic: Geodetic::from_degrees(28.0, -82.0, 30.0),
            height_m: 30.0,
            velocity: VelocityNed::new(north_m_s, 0.0, 0.0),
            attitude: Attitude::default(),
            rates: BodyRates::default(),
            rotor_speed_rad_s: None,
        }
    }

    #[test]
    fn a_state_is_needed_when_dead_reckoning_would_be_off() {
        let need = Need { every_frame: false, error_m: 0.1, error_m_s: 0.1, max_period_s: 0.2 };
        let at = LocalTime::from_seconds;
        let sent = SentState {
            position: PositionNed::new(0.0, 0.0, -30.0),
            velocity: VelocityNed::new(5.0, 0.0, 0.0),
            at: at(1.0),
        };
        let needed =
            |seconds, north_m, north_m_s| need.is_needed(at(seconds), Some(&sent), &estimate(north_m, north_m_s));
        assert!(need.is_needed(at(1.0), None, &estimate(0.0, 0.0)), "nothing sent yet");
        assert!(!needed(1.1, 0.5, 5.0), "exactly where the peers dead-reckon the vehicle");
        assert!(needed(1.1, 0.61, 5.0), "0.11 m off");
        assert!(needed(1.1, 0.5, 5.11), "0.11 m/s off");
        assert!(needed(1.2, 1.0, 5.0), "the longest period");
        assert!(Need { every_frame: true, ..need }.is_needed(at(1.0), Some(&sent), &estimate(0.0, 5.0)));
    }

    #[test]
    fn state_and_heartbeat_of_a_settled_vehicle_go_together() {
        let scenario = load(&Source { name: "test.toml", text: "swarm.vehicles = 4" }, &[]).unwrap().scenario;
        let own = VehicleId::new(1).unwrap();
        let mission = Mission::new(&scenario, own, None);
        let mut schedule =
            SendSchedule::new(own, Incarnation(1), &Origin::new(scenario.origin.geodetic()), &scenario.network);
        let gust_m_s = scenario.network.state_error_m_s + 1.0;
        // A gust blows from the third to the sixteenth frame.
        let mut send = |frame: u32| {
            let now = LocalTime::from_seconds(0.02 * f64::from(frame));
            let north_m_s = if (3..16).contains(&frame) { gust_m_s } else { 0.0 };
            let north_m = gust_m_s * 0.02 * f64::from(frame.clamp(3, 16) - 3);
            let outbox =
                schedule.outbox(now, Some(&estimate(north_m, north_m_s)), &mission, Vec::new(), |_| Default::default());
            (outbox.state.is_some(), outbox.mission.is_some())
        };
        assert_eq!(send(0), (true, true));
        assert_eq!(
            [send(1), send(2), send(3)],
            [(false, false), (false, false), (true, false)],
            "no heartbeat for 60 ms"
        );
        assert!((4..10).all(|frame| send(frame) == (false, false)));
        assert_eq!(send(10), (true, true), "the state goes with the heartbeat, 60 ms before its time");
        assert!((11..16).all(|frame| send(frame) == (false, false)));
        assert_eq!(send(16), (true, true), "the heartbeat goes with the state, 80 ms before its time");
        assert!((17..26).all(|frame| send(frame) == (false, false)));
        assert_eq!(send(26), (true, true));
    }

    proptest! {
        #[test]
        fn a_peers_dead_reckoning_errs_at_most_by_the_thresholds_and_one_frames_motion(
            accelerations in proptest::collection::vec((-8.0..8.0, -8.0..8.0_f64, -8.0..8.0), 1..400),
            late_s in 0.0..0.02, state_error_m in 0.01..1.0, state_error_m_s in 0.05..3.0,
        ) {
            let scenario = load(&Source { name: "test.toml", text: "swarm.vehicles = 4" }, &[]).unwrap().scenario;
            let network = Network { state_error_m, state_error_m_s, state_max_period_s: 5.0, ..scenario.network.clone() };
            let own = VehicleId::new(1).unwrap();
            let mission = Mission::new(&scenario, own, None);
            let origin = Origin::new(scenario.origin.geodetic());
            let mut schedule = SendSchedule::new(own, Incarnation(1), &origin, &network);
            let mut flown = estimate(0.0, 0.0);
            let mut known: Option<(PositionNed, VelocityNed, LocalTime)> = None;
            let mut now = LocalTime::ZERO;
            for (north, east, down) in accelerations {
                let dt_s = 0.02 + late_s;
                now = now.plus_seconds(dt_s);
                let moved_m = flown.velocity.0 * dt_s;
                flown.position = flown.position + moved_m;
                flown.velocity.0 += Vector3::new(north, east, down) * dt_s;
                flown.geodetic = origin.geodetic_from_ned(flown.position);
                let errors = |(position, velocity, at): (PositionNed, VelocityNed, LocalTime)| {
                    let reckoned = position + velocity.0 * now.seconds_since(at);
                    ((flown.position - reckoned).norm(), (flown.velocity - velocity).norm())
                };
                if let Some(known) = known {
                    let frame_m = moved_m.norm() + known.1.0.norm() * dt_s;
                    prop_assert!(errors(known).0 <= state_error_m + frame_m + 1e-4, "before the next message");
                }
                let outbox = schedule.outbox(now, Some(&flown), &mission, Vec::new(), |_| Default::default());
                if let Some(State { state, .. }) = outbox.state.as_deref() {
                    let (position, convergence) = origin.locate(&state.position);
                    known = Some((position, convergence.velocity_from_local(state.velocity), now));
                }
                let (error_m, error_m_s) = errors(known.unwrap());
                prop_assert!(error_m <= state_error_m + 1e-4 && error_m_s <= state_error_m_s + 1e-9);
            }
        }
    }
}
