//! A control-barrier safety filter around any law: the velocity nearest to the wanted one that keeps everybody apart.
//!
//! After A. Ames et al., "Control Barrier Functions: Theory and Applications" (ECC 2019), with the half-responsibility of
//! U. Borrmann, L. Wang, A. Ames & M. Egerstedt, "Control Barrier Certificates for Safe Swarm Behavior" (2015): with
//! h = |p_i − p_j|² − d_s², each of the two sees to half of ḣ ≥ −κ h by its own velocity alone,
//!
//! (p_i − p_j)·v_i ≥ −(κ/4) h.
//!
//! It is a first-order guarantee: a vehicle follows its velocity with a lag of about a second, and d_s has room for that.
//!
//! **Moving together.** What is flown is v = c + w, the feed-forward c of a moving centre and what the law wants besides. With
//! all of it counted over the ground, the one behind would be braked for one ahead who moves away as fast: at 4 m/s from
//! 34 m on. So the two count their halves from the velocity that they share, and the filter chooses w; but whoever follows
//! counts on no more than the one ahead really moves, so that c carries nobody into a vehicle that stays behind:
//!
//! (p_i − p_j)·w ≥ −(κ/4) h + max(0, min(0, (p_i − p_j)·v_j) − (p_i − p_j)·c).
//!
//! The sum of the halves stays ḣ ≥ −κ h, even for two with different c. Four at 4 m/s stay within 40 m of their centre so, and
//! not within 60 m if all is counted over the ground.
//!
//! **Deadlock.** Those who meet head-on would wait for ever. A velocity that is cut is first turned right, by 37° or, if that
//! leaves next to nothing of it, by 90° or 135°. With 37° alone sixteen vehicles do change places across a ring of 60 m, but
//! of random starts one swarm in ten ends in a knot of three or four, each of which wants through the others; with the
//! larger turns none of 50 does, and the crossing takes 61 instead of 74 s.

use core::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use nalgebra::{Rotation2, Vector2, Vector3};

/// A velocity that is cut is first turned right by one of these, rad: the first that leaves this share of its length.
const TURNS_RAD: [f64; 3] = [0.6435, FRAC_PI_2, 3.0 * FRAC_PI_4];
const STUCK_SHARE: f64 = 0.1;
/// What a constraint may be short of by rounding, m²/s.
const SLACK: f64 = 1e-9;

/// The filter's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetyFilter {
    /// Nobody comes nearer than this, m (d_s).
    pub distance_m: f64,
    /// How fast the distance may be used up, 1/s (κ).
    pub rate_per_s: f64,
}

/// One neighbour's half-plane of allowed velocities: along·v ≥ least.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constraint {
    along_m: Vector2<f64>,
    least: f64,
}

impl Constraint {
    /// The same for the velocity relative to `carried_ne_m_s`, at which this vehicle moves anyway, while the other moves at
    /// `other_ne_m_s`.
    pub fn relative(self, carried_ne_m_s: Vector2<f64>, other_ne_m_s: Vector2<f64>) -> Self {
        let left_behind = self.along_m.dot(&other_ne_m_s).min(0.0) - self.along_m.dot(&carried_ne_m_s);
        Self { least: self.least + left_behind.max(0.0), ..self }
    }

    /// How far inside its half-plane a velocity is, m²/s; negative outside.
    fn margin(&self, velocity_ne_m_s: Vector2<f64>) -> f64 {
        self.along_m.dot(&velocity_ne_m_s) - self.least
    }

    /// The nearest velocity on the half-plane's edge.
    fn project(&self, velocity_ne_m_s: Vector2<f64>) -> Vector2<f64> {
        velocity_ne_m_s - self.along_m * (self.margin(velocity_ne_m_s) / self.along_m.norm_squared())
    }

    /// The velocity on both edges, if they cross.
    fn crossing(&self, other: &Self) -> Option<Vector2<f64>> {
        let area = self.along_m.perp(&other.along_m);
        (area.abs() > SLACK).then(|| {
            let (a, b) = (self.along_m, other.along_m);
            Vector2::new(self.least * b.y - other.least * a.y, other.least * a.x - self.least * b.x) / area
        })
    }
}

impl SafetyFilter {
    /// What keeping clear of somebody at `from_other_m` (the way from there to the own place, NED, not straight up) allows.
    /// `clear_m` is the distance to keep, if it is more than the filter's own.
    pub fn constraint(&self, from_other_m: Vector3<f64>, clear_m: f64) -> Constraint {
        let keep_m = self.distance_m.max(clear_m);
        let h = from_other_m.norm_squared() - keep_m * keep_m;
        Constraint { along_m: from_other_m.xy(), least: -self.rate_per_s / 4.0 * h }
    }

    /// `None` if the wanted velocity is allowed as it is; else the one to fly, m/s. Where nothing is allowed (somebody is
    /// already too near), the one that violates the worst constraint least.
    pub fn restrain(&self, wanted_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> Option<Vector2<f64>> {
        if is_allowed(wanted_ne_m_s, constraints) {
            return None;
        }
        let least_m_s = STUCK_SHARE * wanted_ne_m_s.norm();
        let mut turned = TURNS_RAD.iter().map(|&turn| nearest(Rotation2::new(turn) * wanted_ne_m_s, constraints));
        let first = turned.next()?;
        let moving = |velocity: &Vector2<f64>| velocity.norm() > least_m_s;
        Some(if moving(&first) { first } else { turned.find(moving).unwrap_or(first) })
    }
}

fn is_allowed(velocity_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> bool {
    constraints.iter().all(|constraint| constraint.margin(velocity_ne_m_s) >= -SLACK)
}

/// The allowed velocity nearest to the wanted one; the least forbidden one, if none is allowed.
fn nearest(wanted_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> Vector2<f64> {
    // The nearest point of a polygon is the point itself, or on one edge, or on two.
    let on_edges = constraints.iter().map(|constraint| constraint.project(wanted_ne_m_s));
    let in_corners = constraints
        .iter()
        .enumerate()
        .flat_map(|(nth, one)| constraints[..nth].iter().filter_map(|other| one.crossing(other)));
    let candidates = || [wanted_ne_m_s, Vector2::zeros()].into_iter().chain(on_edges.clone()).chain(in_corners.clone());
    let square = |velocity: &Vector2<f64>| (velocity - wanted_ne_m_s).norm_squared();
    let allowed = candidates().filter(|&velocity| is_allowed(velocity, constraints));
    let nearest = allowed.min_by(|one, other| square(one).total_cmp(&square(other)));
    nearest.unwrap_or_else(|| {
        let worst = |velocity: &Vector2<f64>| {
            let short = constraints.iter().map(|c| -c.margin(*velocity) / c.along_m.norm());
            short.fold(f64::NEG_INFINITY, f64::max)
        };
        candidates().min_by(|one, other| worst(one).total_cmp(&worst(other))).unwrap_or_default()
    })
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use proptest::prelude::*;
    use skein_common::math;

    use super::*;

    const FILTER: SafetyFilter = SafetyFilter { distance_m: 8.0, rate_per_s: 0.5 };

    fn vector(size: f64) -> impl Strategy<Value = Vector2<f64>> {
        (-size..size, -size..size).prop_map(|(x, y)| Vector2::new(x, y))
    }

    /// Nobody moves but as the law wants.
    fn from(north_m: f64, east_m: f64) -> Constraint {
        FILTER.constraint(Vector3::new(north_m, east_m, 0.0), 0.0)
    }

    #[test]
    fn far_from_everybody_nothing_is_changed() {
        assert_eq!(FILTER.restrain(Vector2::new(5.0, 0.0), &[from(-50.0, 0.0)]), None, "50 m ahead, 5 m/s");
        assert_eq!(FILTER.restrain(Vector2::new(5.0, 3.0), &[]), None);
    }

    #[test]
    fn who_flies_at_somebody_is_slowed_down_and_turned_right() {
        let restrained = FILTER.restrain(Vector2::new(5.0, 0.0), &[from(-10.0, 0.0)]).unwrap();
        assert!((restrained.x - 0.45).abs() < 1e-9, "closes no faster than (κ/4) h / d: {restrained}");
        assert!(restrained.y > 1.0, "and passes on the right: {restrained}");
        let wide = [FILTER.constraint(Vector3::new(-30.0, 0.0, 0.0), 25.0)];
        assert!(FILTER.restrain(Vector2::new(3.0, 0.0), &wide).is_some(), "a wide berth where one is asked for");
    }

    #[test]
    fn somebody_lower_counts_by_the_whole_distance() {
        let below = [FILTER.constraint(Vector3::new(-10.0, 0.0, -6.0), 0.0)];
        let restrained = FILTER.restrain(Vector2::new(5.0, 0.0), &below).unwrap();
        assert!((restrained.x - 0.9).abs() < 1e-9, "h = 136 − 64 m²: {restrained}");
    }

    #[test]
    fn whoever_is_too_near_backs_off() {
        assert!(FILTER.restrain(Vector2::zeros(), &[from(-4.0, 0.0)]).unwrap().x < -1.0);
        let stuck = FILTER.restrain(Vector2::new(3.0, 0.0), &[from(-4.0, 0.0), from(4.0, 0.0)]).unwrap();
        assert!(stuck.x.abs() < 1e-6, "between two it favours neither: {stuck}");
    }

    #[test]
    fn a_knot_of_three_unties_to_the_right() {
        // An even triangle with sides of d_s, from its southern corner: nobody may move towards anybody. Turned by 37° alone
        // the wanted velocity still lies between the two others, and nothing of it is left.
        let apart = FILTER.distance_m * math::cos(PI / 6.0);
        let others = [from(-apart, 4.0), from(-apart, -4.0)];
        let flown = FILTER.restrain(Vector2::new(2.0, -0.4), &others).unwrap();
        assert!(flown.y > 1.0 && flown.x < 0.0, "around them, to the right: {flown}");
    }

    #[test]
    fn a_swarm_moves_together_and_into_nobody_who_stays() {
        let (north, at_rest) = (Vector2::new(4.0, 0.0), Vector2::zeros());
        let ahead = from(-12.0, 0.0);
        assert_eq!(FILTER.restrain(at_rest, &[ahead.relative(north, north)]), None, "both move");
        let stopped = FILTER.restrain(at_rest, &[ahead.relative(north, at_rest)]).unwrap() + north;
        assert!((stopped.x - 0.125 * 80.0 / 12.0).abs() < 1e-9, "as near to one at rest as ever: {stopped}");
        assert_eq!(FILTER.restrain(at_rest, &[from(12.0, 0.0).relative(north, at_rest)]), None, "one behind is left");
    }

    proptest! {
        #[test]
        fn what_is_flown_is_allowed_whenever_anything_is(
            wanted in vector(15.0), others in proptest::collection::vec(vector(60.0), 1..8),
        ) {
            let outside = others.iter().filter(|from| from.norm() >= FILTER.distance_m);
            let constraints: Vec<_> = outside.map(|place| from(place.x, place.y)).collect();
            let flown = FILTER.restrain(wanted, &constraints).unwrap_or(wanted);
            prop_assert!(flown.iter().all(|speed| speed.is_finite()));
            // Outside everybody's distance standing still is always allowed.
            prop_assert!(constraints.iter().all(|constraint| constraint.margin(flown) >= -1e-6));
        }

        #[test]
        fn two_halves_are_a_whole_however_the_two_are_carried(
            apart in vector(40.0), wanted in [vector(10.0), vector(10.0)], carried in [vector(6.0), vector(6.0)],
            moves in [vector(6.0), vector(6.0)], together: bool,
        ) {
            prop_assume!(apart.norm() > FILTER.distance_m);
            // Each flies what its filter lets it, against what the other really flies: found by taking turns.
            let carried = if together { [carried[0]; 2] } else { carried };
            let fly = |nth: usize, from_other: Vector2<f64>, other| {
                let constraint = from(from_other.x, from_other.y).relative(carried[nth], other);
                carried[nth] + FILTER.restrain(wanted[nth], &[constraint]).unwrap_or(wanted[nth])
            };
            let mut flown = moves;
            for _ in 0..50 {
                flown = [fly(0, apart, flown[1]), fly(1, -apart, flown[0])];
            }
            let closing = 2.0 * apart.dot(&(flown[0] - flown[1]));
            let h = apart.norm_squared() - math::square(FILTER.distance_m);
            prop_assert!(closing >= -FILTER.rate_per_s * h - 1e-6, "ḣ ≥ −κ h: {closing}");
        }
    }
}
