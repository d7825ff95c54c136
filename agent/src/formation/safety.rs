//! A control-barrier safety filter around any law: the velocity nearest to the wanted one that keeps everybody apart.
//!
//! After A. Ames et al., "Control Barrier Functions: Theory and Applications" (ECC 2019), with the half-responsibility of
//! U. Borrmann, L. Wang, A. Ames & M. Egerstedt, "Control Barrier Certificates for Safe Swarm Behavior" (2015): with
//! h = |p_i − p_j|² − d_s², each of the two sees to half of ḣ ≥ −κ h by its own velocity alone,
//!
//! (p_i − p_j)·v_i ≥ −(κ/4) h.
//!
//! It is a first-order guarantee: a vehicle follows its velocity with a lag of about a second, and d_s has room for that.

use nalgebra::Vector2;

/// A velocity that is cut is first turned right by this share of its length, so that two who meet head-on pass each other
/// instead of waiting for ever.
const RIGHT_HAND_SHARE: f64 = 0.75;
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
    /// What keeping clear of somebody at `from_other_ne_m` (the vector from there to the own place, not zero) allows.
    /// `clear_m` is the distance to keep, if it is more than the filter's own.
    pub fn constraint(&self, from_other_ne_m: Vector2<f64>, clear_m: f64) -> Constraint {
        let keep_m = self.distance_m.max(clear_m);
        let h = from_other_ne_m.norm_squared() - keep_m * keep_m;
        Constraint { along_m: from_other_ne_m, least: -self.rate_per_s / 4.0 * h }
    }

    /// `None` if the wanted velocity is allowed as it is; else the one to fly, m/s. Where nothing is allowed (somebody is
    /// already too near), the one that violates the worst constraint least.
    pub fn restrain(&self, wanted_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> Option<Vector2<f64>> {
        let is_allowed = |velocity| constraints.iter().all(|constraint| constraint.margin(velocity) >= -SLACK);
        if is_allowed(wanted_ne_m_s) {
            return None;
        }
        let right = Vector2::new(-wanted_ne_m_s.y, wanted_ne_m_s.x);
        let turned = (wanted_ne_m_s + right * RIGHT_HAND_SHARE).cap_magnitude(wanted_ne_m_s.norm());
        // The nearest point of a polygon is the point itself, or on one edge, or on two.
        let on_edges = constraints.iter().map(|constraint| constraint.project(turned));
        let in_corners = constraints
            .iter()
            .enumerate()
            .flat_map(|(nth, one)| constraints[..nth].iter().filter_map(|other| one.crossing(other)));
        let candidates = || [turned, Vector2::zeros()].into_iter().chain(on_edges.clone()).chain(in_corners.clone());
        let nearest = candidates()
            .filter(|&velocity| is_allowed(velocity))
            .min_by(|one, other| (one - turned).norm_squared().total_cmp(&(other - turned).norm_squared()));
        nearest.or_else(|| {
            let worst = |velocity: &Vector2<f64>| {
                let short = constraints.iter().map(|c| -c.margin(*velocity) / c.along_m.norm());
                short.fold(f64::NEG_INFINITY, f64::max)
            };
            candidates().min_by(|one, other| worst(one).total_cmp(&worst(other)))
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FILTER: SafetyFilter = SafetyFilter { distance_m: 8.0, rate_per_s: 0.5 };

    fn vector(size: f64) -> impl Strategy<Value = Vector2<f64>> {
        (-size..size, -size..size).prop_map(|(x, y)| Vector2::new(x, y))
    }

    #[test]
    fn far_from_everybody_nothing_is_changed() {
        let constraints = [FILTER.constraint(Vector2::new(-50.0, 0.0), 0.0)];
        assert_eq!(FILTER.restrain(Vector2::new(5.0, 0.0), &constraints), None, "50 m ahead, 5 m/s");
        assert_eq!(FILTER.restrain(Vector2::new(5.0, 3.0), &[]), None);
    }

    #[test]
    fn who_flies_at_somebody_is_slowed_down_and_turned_right() {
        let ahead = [FILTER.constraint(Vector2::new(-10.0, 0.0), 0.0)];
        let restrained = FILTER.restrain(Vector2::new(5.0, 0.0), &ahead).unwrap();
        assert!((restrained.x - 0.45).abs() < 1e-9, "closes no faster than (κ/4) h / d: {restrained}");
        assert!(restrained.y > 1.0, "and passes on the right: {restrained}");
        let wide = [FILTER.constraint(Vector2::new(-30.0, 0.0), 25.0)];
        assert!(FILTER.restrain(Vector2::new(3.0, 0.0), &wide).is_some(), "a wide berth where one is asked for");
    }

    #[test]
    fn whoever_is_too_near_backs_off() {
        let inside = [FILTER.constraint(Vector2::new(-4.0, 0.0), 0.0)];
        assert!(FILTER.restrain(Vector2::zeros(), &inside).unwrap().x < -1.0);
        let between = [FILTER.constraint(Vector2::new(-4.0, 0.0), 0.0), FILTER.constraint(Vector2::new(4.0, 0.0), 0.0)];
        let stuck = FILTER.restrain(Vector2::new(3.0, 0.0), &between).unwrap();
        assert!(stuck.x.abs() < 1e-6, "between two it favours neither: {stuck}");
    }

    proptest! {
        #[test]
        fn what_is_flown_is_allowed_whenever_anything_is(
            wanted in vector(15.0), others in proptest::collection::vec(vector(60.0), 1..8),
        ) {
            let constraints: Vec<_> = others
                .iter()
                .filter(|from| from.norm() >= FILTER.distance_m)
                .map(|&from| FILTER.constraint(from, 0.0))
                .collect();
            let flown = FILTER.restrain(wanted, &constraints).unwrap_or(wanted);
            prop_assert!(flown.iter().all(|speed| speed.is_finite()));
            // Outside everybody's distance standing still is always allowed.
            prop_assert!(constraints.iter().all(|constraint| constraint.margin(flown) >= -1e-6));
        }

        #[test]
        fn two_halves_are_a_whole(apart in vector(40.0), one in vector(10.0), other in vector(10.0)) {
            prop_assume!(apart.norm() > FILTER.distance_m);
            let fly = |wanted, from| FILTER.restrain(wanted, &[FILTER.constraint(from, 0.0)]).unwrap_or(wanted);
            let closing = 2.0 * apart.dot(&(fly(one, apart) - fly(other, -apart)));
            let h = apart.norm_squared() - FILTER.distance_m.powi(2);
            prop_assert!(closing >= -FILTER.rate_per_s * h - 1e-6, "ḣ ≥ −κ h");
        }
    }
}
