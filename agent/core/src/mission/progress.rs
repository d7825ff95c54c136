//! How far this vehicle is within a step: the times that it counts, and where it takes the centre to be.

use nalgebra::Vector2;
use skein_common::time::PlantTime;

use super::centre;
use super::plan::{Kind, Leg};
use crate::deadlines::Deadline;

/// How far the present step is.
#[derive(Clone, Copy, Debug, Default)]
pub struct LegProgress {
    /// When time was counted last; `None` while it is not counted.
    last: Option<PlantTime>,
    /// Time spent in the step, s.
    spent_s: f64,
    /// Time in place without interruption, s.
    placed_s: f64,
    /// How far the centre is along the path, m.
    along_m: f64,
    /// How fast it moves along it, m/s.
    speed_m_s: f64,
}

impl LegProgress {
    /// How far the centre is along the step's path, m.
    pub fn along_m(&self) -> f64 {
        self.along_m
    }

    /// At the beginning of another step; time is counted on.
    pub fn begin_next(&mut self) {
        *self = Self { last: self.last, ..Self::default() };
    }

    /// Time does not count until the next [`Self::pass`]: the centre rests, and being in place begins anew.
    pub fn pause(&mut self) {
        *self = Self { last: None, placed_s: 0.0, speed_m_s: 0.0, ..*self };
    }

    /// Takes the centre to be here, if that is farther.
    pub fn catch_up(&mut self, along_m: f64) {
        self.along_m = self.along_m.max(along_m);
    }

    /// Time since it was counted last, s.
    pub fn since_s(&self, now: PlantTime) -> f64 {
        self.last.map_or(0.0, |last| now.seconds_since(last).max(0.0))
    }

    /// Time passes: `others_m` are how far the other live members at this step take the centre to be, `live` how many
    /// members there are at all.
    pub fn pass(
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

    /// Whether nothing of the step is left to this vehicle.
    pub fn is_over(&self, leg: &Leg) -> bool {
        let is_placed = Deadline::Dwelt(leg.dwell_s).is_past(self.placed_s) && self.placed_s > 0.0;
        match &leg.kind {
            Kind::Place => is_placed,
            Kind::Hold(hold_s) => Deadline::HoldOver(*hold_s).is_past(self.spent_s),
            Kind::Path(path) => is_placed && self.along_m >= path.length_m(),
            Kind::Land => false,
        }
    }

    /// Where the centre is and how it moves, north and east, m and m/s.
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
