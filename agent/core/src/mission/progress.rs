//! This vehicle's progress within a step: the elapsed times and the centre's progress.

use nalgebra::Vector2;
use skein_common::time::PlantTime;

use super::centre;
use super::plan::{Kind, Leg};
use crate::deadlines::Deadline;

/// The progress within the current step.
#[derive(Clone, Copy, Debug, Default)]
pub struct LegProgress {
    /// Time of the last update; `None` while paused.
    last: Option<PlantTime>,
    /// Time spent in the step, s.
    spent_s: f64,
    /// Time in place without interruption, s.
    placed_s: f64,
    /// Progress of the centre along the step's path, m.
    pub(super) along_m: f64,
    /// Speed of the centre along the path, m/s.
    speed_m_s: f64,
}

impl LegProgress {
    /// Begins another step without a pause.
    pub fn begin_next(&mut self) {
        *self = Self { last: self.last, ..Self::default() };
    }

    /// Pauses until the next [`Self::advance`]: the centre rests, and the time in place starts again.
    pub fn pause(&mut self) {
        *self = Self { last: None, placed_s: 0.0, speed_m_s: 0.0, ..*self };
    }

    /// Moves the centre to this progress if it is farther.
    pub fn catch_up(&mut self, along_m: f64) {
        self.along_m = self.along_m.max(along_m);
    }

    /// Time since the last update, s.
    pub fn since_s(&self, now: PlantTime) -> f64 {
        self.last.map_or(0.0, |last| now.seconds_since(last).max(0.0))
    }

    /// Advances to `now`: `others_m` is the centre's progress according to the other live members at this step, `live`
    /// the total number of members.
    pub fn advance(
        &mut self,
        now: PlantTime,
        leg: &Leg,
        in_place: bool,
        others_m: impl Iterator<Item = f64>,
        live: usize,
    ) {
        let dt_s = self.since_s(now);
        self.last = Some(now);
        self.spent_s += dt_s;
        self.placed_s = if in_place { self.placed_s + dt_s } else { 0.0 };
        if let Kind::Path(path) = &leg.kind {
            self.speed_m_s = centre::speed_m_s(path, self.along_m, others_m, live);
            self.along_m = (self.along_m + self.speed_m_s * dt_s).min(path.length_m());
        }
    }

    /// Whether this vehicle has completed the step.
    pub fn is_complete(&self, leg: &Leg) -> bool {
        let is_placed = Deadline::Dwelt(leg.dwell_s).is_past(self.placed_s) && self.placed_s > 0.0;
        match &leg.kind {
            Kind::Place => is_placed,
            Kind::Hold(hold_s) => Deadline::HoldOver(*hold_s).is_past(self.spent_s),
            Kind::Path(path) => is_placed && self.along_m >= path.length_m(),
            Kind::Land => false,
        }
    }

    /// The rest of this step: the centre's way along its path, m, and the time for which the vehicle has to be in place, s.
    pub fn remaining(&self, leg: &Leg) -> (f64, f64) {
        let path_m = match &leg.kind {
            Kind::Path(path) => (path.length_m() - self.along_m).max(0.0),
            _ => 0.0,
        };
        (path_m, (leg.dwell_s - self.placed_s).max(0.0))
    }

    /// Position and velocity of the centre, north and east, m and m/s.
    pub fn centre(&self, leg: &Leg) -> (Vector2<f64>, Vector2<f64>) {
        match &leg.kind {
            Kind::Path(path) => {
                let (centre_ne_m, along) = path.at(self.along_m);
                (centre_ne_m, along * self.speed_m_s)
            }
            _ => (leg.from_ne_m, Vector2::zeros()),
        }
    }
}
