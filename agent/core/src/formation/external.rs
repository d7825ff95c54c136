//! An external law: a law that runs in another program, with the agent's queries and its handling of the replies.
//!
//! The core does not contain the program. A step returns an [`LawQuery`]; a later step takes the [`LawReply`]. Until then, and
//! while replies are missing, the vehicle flies the last reply. In real time `skein_agent::external` exchanges queries
//! and replies with the program, in virtual time `skein_lab::external`; recorded replies can replace the program.
//!
//! ```text
//!             `misses` queries in a row without a reply
//!   Flies ----------------------------------------------> Lost: the fallback law flies
//!     ^                                                    |
//!     +---------------------- a reply ---------------------+
//! ```

use alloc::vec::Vec;

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::VehicleId;
use skein_common::message::{EventKind, LawNumber};
use skein_common::scenario;
use skein_common::time::PlantTime;

use super::law::{Goal, LawCommand, LawOutput, Neighbour, Observation};

/// Rounding of frame times, s: a query may be sent this much early.
const ROUNDING_S: f64 = 1e-6;

/// A query to a law, with everything that a built-in law observes. Names and order are those of the wire format.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LawQuery {
    /// The vehicle that sends the query.
    pub vehicle: VehicleId,
    /// Number of the query since the agent's start, from 0.
    pub tick: u64,
    /// Plant time of this vehicle, s; not comparable between vehicles.
    pub time_s: f64,
    /// Plant time since the last query, s; 0 for the first.
    pub dt_s: f64,
    /// The vehicle's own estimate.
    pub own: OwnState,
    /// The other live members, by id.
    pub peers: Vec<Neighbour>,
    /// The formation's goal.
    pub goal: Goal,
}

/// The vehicle's own state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OwnState {
    /// Position in the swarm's frame.
    #[serde(rename = "position_ned_m")]
    pub position: PositionNed,
    /// Velocity over the ground.
    #[serde(rename = "velocity_ned_m_s")]
    pub velocity: VelocityNed,
    /// Heading clockwise from north, rad.
    pub heading_rad: f64,
    /// Age of the estimate, s.
    pub age_s: f64,
}

/// The reply of an external law. Every number is finite; no other property is guaranteed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LawReply {
    /// The vehicle whose query is answered.
    pub vehicle: VehicleId,
    /// The number of the query.
    pub tick: u64,
    /// The commanded velocity or field.
    pub command: ReplyCommand,
    /// Commanded heading, clockwise from north, rad; `None` leaves it to the mission.
    pub heading_rad: Option<f64>,
    /// Whether the vehicle is in place; `None` leaves the decision to the agent.
    pub reached: Option<bool>,
    /// Numbers for the recording, at most [`LawNumber::MAX_COUNT`].
    pub log: Vec<LawNumber>,
}

/// The command of an external law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ReplyCommand {
    /// Velocity over the ground, north, east, down, m/s.
    VelocityNed(#[serde(with = "crate::encoding::vector")] Vector3<f64>),
    /// Field, north and east, dimensionless, at the goal's altitude.
    FieldNe(#[serde(with = "crate::encoding::vector")] Vector2<f64>),
}

/// One vehicle's exchange with its external law.
#[derive(Clone, Debug, Default)]
pub struct External {
    period_s: f64,
    max_speed_m_s: f64,
    /// Number of misses in a row after which the law is lost.
    timeout: u32,
    now: PlantTime,
    /// Time of the next query; `None` while the law is suspended.
    next_query: Option<PlantTime>,
    last_query: Option<PlantTime>,
    ticks: u64,
    /// Number of the query that is still without a reply.
    pending: Option<u64>,
    /// The last accepted reply.
    last: Option<LawReply>,
    misses_in_a_row: u32,
    /// Number of queries without a reply so far.
    pub(crate) misses: u64,
    /// Whether the fallback flies in the place of the law; `None` while the law is suspended.
    pub(crate) fallback_flies: Option<bool>,
    /// Query and event to hand out after this step.
    ask: Option<LawQuery>,
    event: Option<EventKind>,
}

impl External {
    /// An external law before the first query.
    pub fn new(external: &scenario::External) -> Self {
        Self {
            period_s: external.period_s,
            max_speed_m_s: external.max_speed_m_s,
            timeout: external.misses,
            ..Self::default()
        }
    }

    /// Sets the time of this step and takes a reply, if there is one. Only a reply to the pending query is accepted.
    pub fn receive_reply(&mut self, now: PlantTime, answer: Option<&LawReply>) {
        self.now = now;
        let Some(answer) = answer.filter(|answer| self.pending == Some(answer.tick)) else { return };
        self.event = self.is_lost().then_some(EventKind::LawBack);
        (self.pending, self.misses_in_a_row) = (None, 0);
        self.last = Some(answer.clone());
    }

    /// The output of the law from its last reply, in the form of a built-in law, with the commanded heading, clockwise from
    /// north, rad, `None` of which leaves it to the mission; queries the law when the next query is due. `None` while the
    /// law is lost.
    pub fn output(&mut self, observation: &Observation<'_>) -> Option<(LawOutput, Option<f64>)> {
        self.query_if_due(observation);
        self.fallback_flies = Some(self.is_lost());
        if self.is_lost() {
            return None;
        }
        let centre_m = observation.from_centre_ne_m();
        let is_near = centre_m.norm() <= observation.goal.radius_m && observation.is_slow();
        let Some(answer) = &self.last else {
            // Before the first reply the vehicle stays where it is.
            return Some((LawOutput { command: LawCommand::Displacement(Vector2::zeros()), reached: false }, None));
        };
        let command = match answer.command {
            ReplyCommand::VelocityNed(velocity) => {
                let velocity = velocity.cap_magnitude(self.max_speed_m_s);
                LawCommand::Velocity { ne_m_s: velocity.xy(), down_m_s: Some(velocity.z) }
            }
            ReplyCommand::FieldNe(field) => LawCommand::Field(field.push(0.0)),
        };
        let reached = answer.reached.unwrap_or(is_near);
        Some((LawOutput { command, reached }, answer.heading_rad))
    }

    /// Prepares the next query when it is due. A query still pending then was missed.
    fn query_if_due(&mut self, observation: &Observation<'_>) {
        let since_next_query_s = self.next_query.map_or(0.0, |next_query| self.now.seconds_since(next_query));
        if since_next_query_s < -ROUNDING_S {
            return;
        }
        if self.pending.is_some() {
            self.misses += 1;
            self.misses_in_a_row = self.misses_in_a_row.saturating_add(1);
            if self.misses_in_a_row == self.timeout {
                self.event = Some(EventKind::LawLost);
            }
        }
        // Queries keep an even period independent of the frames, but periods missed in a pause are not made up.
        let on_time = self.next_query.filter(|_| since_next_query_s < self.period_s);
        let (tick, dt_s) = (self.ticks, self.last_query.map_or(0.0, |last| self.now.seconds_since(last)));
        self.next_query = Some(on_time.unwrap_or(self.now).plus_seconds(self.period_s));
        (self.last_query, self.pending, self.ticks) = (Some(self.now), Some(tick), tick + 1);
        self.ask = Some(LawQuery {
            vehicle: observation.own,
            tick,
            time_s: self.now.seconds(),
            dt_s,
            own: OwnState {
                position: observation.position,
                velocity: observation.velocity,
                heading_rad: observation.heading_rad,
                // The estimate is from this very step.
                age_s: 0.0,
            },
            peers: observation.neighbours.to_vec(),
            goal: observation.goal,
        });
    }

    /// Suspends the law while the vehicle does not fly a formation: its last reply is dropped.
    pub fn suspend(&mut self) {
        (self.next_query, self.pending, self.last, self.misses_in_a_row) = (None, None, None, 0);
        self.fallback_flies = None;
    }

    /// Takes the query to send after this step, and adds the law's event to `happened`.
    pub fn take_query(&mut self, happened: &mut Vec<EventKind>) -> Option<LawQuery> {
        happened.extend(self.event.take());
        self.ask.take()
    }

    /// The numbers the law wants recorded.
    pub fn log(&self) -> &[LawNumber] {
        self.last.as_ref().map_or(&[], |answer| &answer.log)
    }

    fn is_lost(&self) -> bool {
        self.misses_in_a_row >= self.timeout
    }
}

#[cfg(test)]
mod tests;
