//! A law that is another program: the question that an agent asks, and what is flown of the answer.
//!
//! The program stays outside of the core. A step hands out an [`Ask`]; a later step takes the [`Answer`]. Until then, and
//! while asks are missed, the last answer stands. In real time `skein_agent::external` carries both to the
//! program and back, in virtual time `skein_lab::external`; recorded answers can take their place.
//!
//! ```text
//!             `misses` asks in a row unanswered
//!   Flies ----------------------------------------> Lost: the fallback flies
//!     ^                                              |
//!     +------------------ an answer -----------------+
//! ```

use alloc::vec::Vec;

use nalgebra::{Vector2, Vector3};
use serde::Serialize;
use skein_common::id::VehicleId;
use skein_common::message::{Happening, LawNumber};
use skein_common::scenario;
use skein_common::time::PlantTime;

use super::law::{self, Neighbour, Sight};

/// An ask may come this much early, s: times of frames are rounded.
const ROUNDING_S: f64 = 1e-6;

/// What a law is asked: everything that a built-in law sees. The names and their order are those of the wire.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ask {
    /// Whose law is asked.
    pub vehicle: VehicleId,
    /// Counts the asks of this agent's life, from 0.
    pub tick: u64,
    /// This vehicle's plant time, s; it means nothing to another.
    pub time_s: f64,
    /// Plant time since the last ask, s; 0 for the first.
    pub dt_s: f64,
    /// The own estimate.
    pub own: Own,
    /// The live members, by id.
    pub peers: Vec<Peer>,
    /// Where the formation is to be.
    pub goal: Goal,
}

/// The vehicle itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Own {
    /// m.
    pub position_ned_m: [f64; 3],
    /// Over the ground, m/s.
    pub velocity_ned_m_s: [f64; 3],
    /// Clockwise from north.
    pub heading_rad: f64,
    /// Of the estimate, s.
    pub age_s: f64,
}

/// Another live member.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peer {
    /// Who.
    pub id: VehicleId,
    /// Carried forward to now at constant velocity, m.
    pub position_ned_m: [f64; 3],
    /// As last heard, m/s.
    pub velocity_ned_m_s: [f64; 3],
    /// As last heard, clockwise from north.
    pub heading_rad: f64,
    /// Of its last word, s.
    pub age_s: f64,
    /// Not stale.
    pub fresh: bool,
}

/// The formation's place and size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Goal {
    /// Of the mission, counted from 0.
    pub step: usize,
    /// m; at the altitude where this vehicle is to fly.
    pub centre_ned_m: [f64; 3],
    /// m/s.
    pub centre_velocity_ned_m_s: [f64; 3],
    /// Of the ellipse's first axis, clockwise from north.
    pub heading_rad: f64,
    /// R*.
    pub radius_m: f64,
    /// γ.
    pub gamma: f64,
}

/// What a law has answered. Every number is finite; nothing else is certain of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// To whose ask.
    pub vehicle: VehicleId,
    /// To which ask.
    pub tick: u64,
    /// Where the vehicle is to go.
    pub wanted: Wanted,
    /// Where its nose is to point, clockwise from north, if the law minds.
    pub heading_rad: Option<f64>,
    /// Whether it is where it belongs, if the law knows.
    pub reached: Option<bool>,
    /// To be recorded: at most [`LawNumber::MAX_COUNT`].
    pub log: Vec<LawNumber>,
}

/// Where a law wants its vehicle to go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wanted {
    /// With this velocity over the ground, north, east, down, m/s.
    VelocityNed(Vector3<f64>),
    /// Along this field, north and east, dimensionless, at the goal's altitude.
    FieldNe(Vector2<f64>),
}

/// One vehicle's dealings with its law.
#[derive(Clone, Debug)]
pub struct External {
    period_s: f64,
    max_speed_m_s: f64,
    /// So many misses in a row, and it is lost.
    patience: u32,
    now: PlantTime,
    /// When the next ask is due; `None` while the law has nothing to say.
    due: Option<PlantTime>,
    asked: Option<PlantTime>,
    ticks: u64,
    /// Asked and not answered yet.
    open: Option<u64>,
    /// The last answer that was taken.
    last: Option<Answer>,
    missed_in_a_row: u32,
    misses: u64,
    /// To be asked, and to be told, after this step.
    ask: Option<Ask>,
    told: Option<Happening>,
}

impl External {
    /// A law that has not been asked yet.
    pub fn new(external: &scenario::External) -> Self {
        Self {
            period_s: external.period_s,
            max_speed_m_s: external.max_speed_m_s,
            patience: external.misses,
            now: PlantTime::ZERO,
            due: None,
            asked: None,
            ticks: 0,
            open: None,
            last: None,
            missed_in_a_row: 0,
            misses: 0,
            ask: None,
            told: None,
        }
    }

    /// The time of this step, and an answer, if one has come: it counts if it is one to the open ask.
    pub fn hear(&mut self, now: PlantTime, answer: Option<&Answer>) {
        self.now = now;
        let Some(answer) = answer.filter(|answer| self.open == Some(answer.tick)) else { return };
        self.told = self.is_lost().then_some(Happening::LawBack);
        (self.open, self.missed_in_a_row) = (None, 0);
        self.last = Some(answer.clone());
    }

    /// What the law wants, from its last answer; asks it again when it is time. `None` while it is lost.
    pub fn consult(&mut self, sight: &Sight<'_>) -> Option<Consulted> {
        self.ask_if_due(sight);
        if self.is_lost() {
            return None;
        }
        let centre_m = sight.from_centre_ne_m();
        let is_near = centre_m.norm() <= sight.goal.radius_m && sight.is_slow();
        let Some(answer) = &self.last else {
            // It has not said anything yet: nobody goes anywhere.
            let answer = law::Answer { wanted: law::Wanted::Way(Vector2::zeros()), is_there: false };
            return Some(Consulted { answer, heading_rad: None });
        };
        let wanted = match answer.wanted {
            Wanted::VelocityNed(velocity) => {
                let velocity = velocity.cap_magnitude(self.max_speed_m_s);
                law::Wanted::Velocity { ne_m_s: velocity.xy(), down_m_s: Some(velocity.z) }
            }
            Wanted::FieldNe(field) => law::Wanted::Field(field.push(0.0)),
        };
        let is_there = answer.reached.unwrap_or(is_near);
        Some(Consulted { answer: law::Answer { wanted, is_there }, heading_rad: answer.heading_rad })
    }

    /// An ask that is still open when the next is due was missed.
    fn ask_if_due(&mut self, sight: &Sight<'_>) {
        let since_due_s = self.due.map_or(0.0, |due| self.now.seconds_since(due));
        if since_due_s < -ROUNDING_S {
            return;
        }
        if self.open.is_some() {
            self.misses += 1;
            self.missed_in_a_row = self.missed_in_a_row.saturating_add(1);
            if self.missed_in_a_row == self.patience {
                self.told = Some(Happening::LawLost);
            }
        }
        // Evenly, whenever the frames come; but what was slept through is not made up for.
        let on_time = self.due.filter(|_| since_due_s < self.period_s);
        let (tick, dt_s) = (self.ticks, self.asked.map_or(0.0, |asked| self.now.seconds_since(asked)));
        self.due = Some(on_time.unwrap_or(self.now).plus_seconds(self.period_s));
        (self.asked, self.open, self.ticks) = (Some(self.now), Some(tick), tick + 1);
        self.ask = Some(Ask {
            vehicle: sight.own,
            tick,
            time_s: self.now.seconds(),
            dt_s,
            own: Own::from(sight),
            peers: sight.neighbours.iter().map(Peer::from).collect(),
            goal: Goal::from(&sight.goal),
        });
    }

    /// The law has nothing to say in what the vehicle does now: its last answer is forgotten.
    pub fn rest(&mut self) {
        (self.due, self.open, self.last, self.missed_in_a_row) = (None, None, None, 0);
    }

    /// What is to be asked and told after this step.
    pub fn asked(&mut self, happened: &mut Vec<Happening>) -> Option<Ask> {
        happened.extend(self.told.take());
        self.ask.take()
    }

    /// Asks that were not answered so far.
    pub fn misses(&self) -> u64 {
        self.misses
    }

    /// What the law wants recorded.
    pub fn log(&self) -> &[LawNumber] {
        self.last.as_ref().map_or(&[], |answer| &answer.log)
    }

    fn is_lost(&self) -> bool {
        self.missed_in_a_row >= self.patience
    }
}

/// What an external law wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Consulted {
    /// As any law's.
    pub answer: law::Answer,
    /// Where the nose is to point, clockwise from north, if the law minds.
    pub heading_rad: Option<f64>,
}

impl From<&Sight<'_>> for Own {
    /// A law is asked about a frame of this very step: no older one is flown on.
    fn from(sight: &Sight<'_>) -> Self {
        Self {
            position_ned_m: sight.position.0.into(),
            velocity_ned_m_s: sight.velocity.0.into(),
            heading_rad: sight.heading_rad,
            age_s: 0.0,
        }
    }
}

impl From<&Neighbour> for Peer {
    fn from(neighbour: &Neighbour) -> Self {
        Self {
            id: neighbour.id,
            position_ned_m: neighbour.position.0.into(),
            velocity_ned_m_s: neighbour.velocity.0.into(),
            heading_rad: neighbour.heading_rad,
            age_s: neighbour.age_s,
            fresh: neighbour.is_fresh,
        }
    }
}

impl From<&law::Goal> for Goal {
    fn from(goal: &law::Goal) -> Self {
        Self {
            step: goal.step,
            centre_ned_m: goal.centre.0.into(),
            centre_velocity_ned_m_s: goal.centre_velocity.0.into(),
            heading_rad: goal.heading_rad,
            radius_m: goal.radius_m,
            gamma: goal.gamma,
        }
    }
}

#[cfg(test)]
mod tests;
