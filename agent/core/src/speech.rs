//! What an agent tells the others, and when.
//!
//! A state is said on need, as in DIS (IEEE 1278.1): when the others' dead reckoning of this vehicle would be off by more
//! than a threshold, and at least every so often. The agreement's register is said on change, a few times more in the frames after
//! it, and five times a second.

use alloc::vec::Vec;

use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::math;
use skein_common::message::{self, Echo, Happening, Header, Mission as MissionMessage, State};
use skein_common::scenario::{Network, SendMode};
use skein_common::time::{LocalTime, SenderStamp};

use crate::estimate::Estimate;
use crate::mission::Mission;

/// The agreement's register is repeated this often, s.
pub const MISSION_PERIOD_S: f64 = 0.2;
/// A period is over this share of it early, so that a clock that runs slow, as quartz may by 100 ppm, does not make it a frame
/// longer.
const EARLY: f64 = 2e-4;
/// After a change it is repeated in so many frames: with three words in ten lost, one peer in 50,000 then misses all nine.
const CHANGE_REPEATS: u32 = 8;

/// What one step says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Said {
    /// The own state, if the others need it.
    pub state: Option<State>,
    /// The part in the agreement, if it is time.
    pub mission: Option<MissionMessage>,
    /// What happened.
    pub happened: Vec<Happening>,
}

/// Decides what to say.
#[derive(Clone, Debug)]
pub struct Speech {
    own: VehicleId,
    incarnation: Incarnation,
    need: Need,
    told: Option<Told>,
    mission: Option<(MissionMessage, LocalTime)>,
    /// How often the register is still to be repeated for its last change.
    repeats: u32,
    state_messages: u64,
    state_bytes: u64,
    missions: u64,
    mission_bytes: u64,
    traces: u64,
}

/// When the others need to hear a state.
#[derive(Clone, Copy, Debug)]
struct Need {
    every_frame: bool,
    error_m: f64,
    error_m_s: f64,
    max_period_s: f64,
}

/// What the others know.
#[derive(Clone, Copy, Debug)]
struct Told {
    position: PositionNed,
    velocity: VelocityNed,
    at: LocalTime,
}

impl Need {
    fn is_there(&self, now: LocalTime, told: Option<&Told>, estimate: &Estimate) -> bool {
        let Some(told) = told else { return true };
        let since_s = now.seconds_since(told.at);
        let reckoned = told.position + told.velocity.0 * since_s;
        self.every_frame
            || since_s >= self.max_period_s * (1.0 - EARLY)
            || (estimate.velocity - told.velocity).norm_squared() > math::square(self.error_m_s)
            || (estimate.position - reckoned).norm_squared() > math::square(self.error_m)
    }
}

impl Speech {
    /// A vehicle that has said nothing in this life.
    pub fn new(own: VehicleId, incarnation: Incarnation, network: &Network) -> Self {
        let need = Need {
            every_frame: network.send == SendMode::EveryFrame,
            error_m: network.state_error_m,
            error_m_s: network.state_error_m_s,
            max_period_s: network.state_max_period_s,
        };
        let (told, mission) = (None, None);
        Self {
            own,
            incarnation,
            need,
            told,
            mission,
            repeats: 0,
            state_messages: 0,
            state_bytes: 0,
            missions: 0,
            mission_bytes: 0,
            traces: 0,
        }
    }

    /// What to say now. Without an estimate that still holds, the state is kept to oneself: the others carry the last one
    /// forward and see its age. `echo` gives the echo for a heartbeat with this stamp.
    pub fn say(
        &mut self,
        now: LocalTime,
        estimate: Option<&Estimate>,
        mission: &Mission,
        happened: Vec<Happening>,
        echo: impl FnOnce(SenderStamp) -> Option<Echo>,
    ) -> Said {
        Said { state: estimate.and_then(|e| self.state(now, e)), mission: self.mission(now, mission, echo), happened }
    }

    /// States said in this life.
    pub fn state_messages(&self) -> u64 {
        self.state_messages
    }

    /// Their payload, bytes.
    pub fn state_bytes(&self) -> u64 {
        self.state_bytes
    }

    /// Words about the agreement said in this life, and their payload, bytes.
    pub fn missions(&self) -> (u64, u64) {
        (self.missions, self.mission_bytes)
    }

    /// The header of the next trace.
    pub fn header_of_trace(&mut self, now: LocalTime) -> Header {
        self.traces += 1;
        self.header(now, self.traces)
    }

    fn state(&mut self, now: LocalTime, estimate: &Estimate) -> Option<State> {
        if !self.need.is_there(now, self.told.as_ref(), estimate) {
            return None;
        }
        self.told = Some(Told { position: estimate.position, velocity: estimate.velocity, at: now });
        self.state_messages += 1;
        let said = State { header: self.header(now, self.state_messages), state: estimate.state() };
        self.state_bytes += message::encode(&said).len() as u64;
        Some(said)
    }

    fn mission(
        &mut self,
        now: LocalTime,
        mission: &Mission,
        echo: impl FnOnce(SenderStamp) -> Option<Echo>,
    ) -> Option<MissionMessage> {
        let (membership, step, vouched, reached, order) =
            (mission.membership(), mission.at(), mission.vouched(), mission.reached(), mission.order());
        let due = self.mission.as_ref().is_none_or(|(told, at)| {
            let before = (told.membership, told.step, told.vouched, told.reached, told.order);
            if before != (membership, step, vouched, reached, order) {
                self.repeats = CHANGE_REPEATS + 1;
            }
            self.repeats > 0 || now.seconds_since(*at) >= MISSION_PERIOD_S * (1.0 - EARLY)
        });
        if !due {
            return None;
        }
        self.repeats = self.repeats.saturating_sub(1);
        self.missions += 1;
        let header = self.header(now, self.missions);
        let (plan, progress_m) = (mission.plan(), mission.progress_m());
        let echo = echo(header.stamp);
        // The run is the edge's: what is agreed on is the same in all of them.
        let said = MissionMessage { header, plan, membership, step, vouched, reached, progress_m, order, echo };
        self.mission_bytes += message::encode(&said).len() as u64;
        self.mission = Some((said, now));
        Some(said)
    }

    fn header(&self, now: LocalTime, sequence: u64) -> Header {
        Header { sender: self.own, incarnation: self.incarnation, sequence, stamp: now.into() }
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{Attitude, BodyRates, Geodetic};

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
        let told = Told {
            position: PositionNed::new(0.0, 0.0, -30.0),
            velocity: VelocityNed::new(5.0, 0.0, 0.0),
            at: at(1.0),
        };
        let needed =
            |seconds, north_m, north_m_s| need.is_there(at(seconds), Some(&told), &estimate(north_m, north_m_s));
        assert!(need.is_there(at(1.0), None, &estimate(0.0, 0.0)), "nothing told yet");
        assert!(!needed(1.1, 0.5, 5.0), "just where the others think");
        assert!(needed(1.1, 0.61, 5.0), "0.11 m off");
        assert!(needed(1.1, 0.5, 5.11), "0.11 m/s off");
        assert!(needed(1.2, 1.0, 5.0), "long enough");
        assert!(Need { every_frame: true, ..need }.is_there(at(1.0), Some(&told), &estimate(0.0, 5.0)));
    }
}
