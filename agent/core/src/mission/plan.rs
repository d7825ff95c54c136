//! The steps of a mission as the agents fly them: the centre in each step, and the condition for its completion.

use alloc::vec;
use alloc::vec::Vec;

use nalgebra::Vector2;
use skein_common::scenario::{Mission, Target};

/// One step of a mission.
#[derive(Clone, Debug, PartialEq)]
pub struct Leg {
    /// The target of the step.
    pub kind: Kind,
    /// Centre at the beginning of the step, north and east, m.
    pub from_ne_m: Vector2<f64>,
    /// Time in place that completes the step, s.
    pub dwell_s: f64,
}

impl Leg {
    /// Whether a vehicle has to be at its place to complete the step.
    pub fn needs_place(&self) -> bool {
        matches!(self.kind, Kind::Place | Kind::Path(_))
    }
}

/// The target of a step.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// Fly to the formation around the centre.
    Place,
    /// Hold the formation for this time, s.
    Hold(f64),
    /// Follow the centre along this path to the formation at its end.
    Path(Path),
    /// Land.
    Land,
}

/// A polyline along which the centre moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Speed of the centre, m/s.
    pub speed_m_s: f64,
    corners_ne_m: Vec<Vector2<f64>>,
    /// Distance of each corner from the first along the path, m.
    at_m: Vec<f64>,
}

impl Path {
    /// A path through at least two corners at this speed.
    fn new(corners_ne_m: Vec<Vector2<f64>>, speed_m_s: f64) -> Self {
        let mut at_m = vec![0.0];
        for pair in corners_ne_m.windows(2) {
            at_m.push(at_m[at_m.len() - 1] + (pair[1] - pair[0]).norm());
        }
        Self { speed_m_s, corners_ne_m, at_m }
    }

    /// Length from the first corner to the last, m.
    pub fn length_m(&self) -> f64 {
        self.at_m.last().copied().unwrap_or(0.0)
    }

    /// Position at this distance along the path, and the direction in which the path continues; zero at its end.
    pub fn at(&self, progress_m: f64) -> (Vector2<f64>, Vector2<f64>) {
        let progress_m = progress_m.max(0.0);
        let next = self.at_m.partition_point(|&at_m| at_m <= progress_m);
        match (self.corners_ne_m.get(next.saturating_sub(1)), self.corners_ne_m.get(next)) {
            (Some(&from), Some(&to)) => {
                let along = (to - from).normalize();
                (from + along * (progress_m - self.at_m[next.saturating_sub(1)]), along)
            }
            _ => (self.corners_ne_m.last().copied().unwrap_or_default(), Vector2::zeros()),
        }
    }
}

/// The steps of a scenario's mission.
pub fn legs(mission: &Mission) -> Vec<Leg> {
    let mut from_ne_m = Vector2::zeros();
    let legs = mission.steps.iter().map(|step| {
        let kind = match &step.target {
            Target::Centre(centre_ne_m) => {
                from_ne_m = Vector2::from(*centre_ne_m);
                Kind::Place
            }
            Target::Hold(hold_s) => Kind::Hold(*hold_s),
            Target::Path(corners) => {
                Kind::Path(Path::new(corners.iter().copied().map(Vector2::from).collect(), step.speed_m_s))
            }
            Target::Land(_) => Kind::Land,
        };
        let leg = Leg { kind, from_ne_m, dwell_s: step.dwell_s };
        if let Kind::Path(path) = &leg.kind {
            from_ne_m = path.at(path.length_m()).0;
        }
        leg
    });
    legs.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_followed_around_its_corners_to_its_end() {
        let path = Path::new([[0.0, 0.0], [30.0, 0.0], [30.0, 40.0]].map(Vector2::from).into(), 2.0);
        assert_eq!(path.length_m(), 70.0);
        let north = Vector2::new(1.0, 0.0);
        let east = Vector2::new(0.0, 1.0);
        assert_eq!(path.at(0.0), (Vector2::new(0.0, 0.0), north));
        assert_eq!(path.at(12.0), (Vector2::new(12.0, 0.0), north));
        assert_eq!(path.at(30.0), (Vector2::new(30.0, 0.0), east), "a corner has the next direction");
        assert_eq!(path.at(50.0), (Vector2::new(30.0, 20.0), east));
        assert_eq!(path.at(70.0), (Vector2::new(30.0, 40.0), Vector2::zeros()));
        assert_eq!(path.at(1e6), (Vector2::new(30.0, 40.0), Vector2::zeros()), "never beyond the end");
        assert_eq!(path.at(-5.0), (Vector2::new(0.0, 0.0), north));
    }
}
