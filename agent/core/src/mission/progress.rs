//! This vehicle's progress within a step: the elapsed times and the progress of the moving centre, which all vehicles share
//! without a common clock.
//!
//! The centre's progress s is its distance from the beginning of its path, m. Every agent integrates its own,
//!
//! ṡ_i = clamp( v + κ Σ_j (s_j − s_i), 0, 2v ),   κ = 0.5/N 1/s,
//!
//! over the live members j at the same step, sends it in its heartbeat, and never goes back. All run at v; a difference
//! decays at about κN and stays within v times the age of the heartbeats.

use nalgebra::Vector2;
use skein_common::time::PlantTime;

use super::plan::{Kind, Leg, Path};
use crate::deadlines::Deadline;

/// Rate κN at which differences decay, 1/s.
const CONSENSUS_PER_S: f64 = 0.5;

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
            self.speed_m_s = speed_m_s(path, self.along_m, others_m, live);
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

/// Rate ṡ for the own progress, the others' progress at the same step, and `live` members in total, m/s. Zero at the
/// path's end.
fn speed_m_s(path: &Path, own_m: f64, others_m: impl Iterator<Item = f64>, live: usize) -> f64 {
    if own_m >= path.length_m() {
        return 0.0;
    }
    let ahead_m: f64 = others_m.map(|other_m| other_m - own_m).sum();
    (path.speed_m_s + CONSENSUS_PER_S / live.max(1) as f64 * ahead_m).clamp(0.0, 2.0 * path.speed_m_s)
}
