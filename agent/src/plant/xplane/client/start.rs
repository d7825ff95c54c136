//! Places an aircraft on the ground at its start.
//!
//! X-Plane confirms no placement, so that it is repeated until the aircraft is there. An aircraft in the air is never
//! placed: an agent that starts again in flight finds it flying.

use std::time::{Duration, Instant};

use super::distance_m;
use crate::plant::xplane::wire::prel::Placement;
use crate::plant::xplane::wire::rpos::Position;

/// Distance from the start within which an aircraft is there, m.
const THERE_M: f64 = 3.0;
/// Height of the aircraft's reference point above which it flies, m.
const FLIES_ABOVE_M: f32 = 3.0;
/// Time between two attempts: X-Plane may load scenery after a placement.
const AGAIN: Duration = Duration::from_secs(2);
/// Number of attempts after which the aircraft is left where it is.
const ATTEMPTS: u32 = 10;
/// Distance up to which the ground at the start has the elevation of the ground below the aircraft, m.
const SAME_GROUND_M: f64 = 10_000.0;

/// The placement of an aircraft that waits at another place.
#[derive(Debug)]
pub(super) struct Start {
    place: Placement,
    attempts: u32,
    last: Option<Instant>,
}

impl Start {
    pub(super) fn at(place: Placement) -> Self {
        Self { place, attempts: 0, last: None }
    }

    /// Whether nothing is left to do for an aircraft at this position.
    pub(super) fn is_over(&self, position: &Position) -> bool {
        let has_failed = self.attempts >= ATTEMPTS;
        if has_failed {
            tracing::warn!("the simulator did not place the aircraft at its start: the flight begins where it is");
        }
        has_failed || position.height_m > FLIES_ABOVE_M || self.away_m(position) < THERE_M
    }

    /// The placement to send now, if one is due.
    pub(super) fn due(&mut self, position: &Position, now: Instant) -> Option<Placement> {
        if self.last.is_some_and(|last| now < last + AGAIN) {
            return None;
        }
        self.last = Some(now);
        self.attempts += 1;
        let ground_m = position.elevation_m - f64::from(position.height_m);
        let is_near = self.away_m(position) < SAME_GROUND_M;
        Some(if is_near { Placement { elevation_m: ground_m, ..self.place } } else { self.place })
    }

    fn away_m(&self, position: &Position) -> f64 {
        distance_m((position.latitude_deg, position.longitude_deg), (self.place.latitude_deg, self.place.longitude_deg))
    }
}
