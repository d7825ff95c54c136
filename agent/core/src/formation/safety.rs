//! A control-barrier safety filter for any law: the velocity nearest to the commanded one that keeps all vehicles
//! apart.
//!
//! After A. Ames et al., "Control Barrier Functions: Theory and Applications" (ECC 2019), with the shared
//! responsibility of U. Borrmann, L. Wang, A. Ames & M. Egerstedt, "Control Barrier Certificates for Safe Swarm
//! Behavior" (2015): with h = |p_i − p_j|² − d_s², each of the two vehicles ensures half of ḣ ≥ −κ h by its own
//! velocity alone,
//!
//! (p_i − p_j)·v_i ≥ −(κ/4) h.
//!
//! It is a first-order guarantee: a vehicle follows its velocity with a lag of about a second, and d_s has a margin for
//! that.
//!
//! **Moving together.** The vehicle flies v = c + w, the feed-forward c of a moving centre and the law's relative
//! command w. With all of v counted over the ground, a vehicle would brake for one ahead that moves away as fast: at 4
//! m/s from 34 m on. So both vehicles count their shares relative to the feed-forward, and the filter chooses w. But a
//! follower credits the vehicle ahead only with its actual velocity, so that c carries no vehicle into one that stays
//! behind:
//!
//! (p_i − p_j)·w ≥ −(κ/4) h + max(0, min(0, (p_i − p_j)·v_j) − (p_i − p_j)·c).
//!
//! The sum of both shares remains ḣ ≥ −κ h, even with different c. With this, four vehicles at 4 m/s stay within 40 m
//! of their centre; with everything counted over the ground they do not stay within 60 m.
//!
//! **Strangers.** A vehicle of another team may fly any law, and may not know of this one. So this vehicle ensures all of
//! ḣ ≥ −κ h alone, with the stranger's velocity as last received. If both do, they clear each other sooner.
//!
//! **Deadlock.** Vehicles that meet head-on would wait forever. A restricted velocity is first turned right by 37° or,
//! if that leaves almost nothing of it, by 90° or 135°. With 37° alone, sixteen vehicles can swap sides of a ring of
//! 60 m, but from random starts one swarm in ten ends in a knot of three or four vehicles that block each other. With
//! the larger turns, no swarm of 50 ended in such a knot, and the swap takes 61 s instead of 74 s.

use core::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use nalgebra::{Rotation2, Vector2, Vector3};

/// Right turns of a restricted velocity, rad; the first that leaves at least `STUCK_SHARE` of its length is used.
const RIGHT_TURNS_RAD: [f64; 3] = [0.6435, FRAC_PI_2, 3.0 * FRAC_PI_4];
const STUCK_SHARE: f64 = 0.1;
/// Rounding tolerance of a constraint, m²/s.
const SLACK: f64 = 1e-9;

/// The filter's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetyFilter {
    /// Safety distance between two vehicles d_s, m.
    pub distance_m: f64,
    /// Largest relative rate of change of h, κ, 1/s.
    pub rate_per_s: f64,
}

/// The half-plane of velocities that one neighbour allows: along·v ≥ least.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constraint {
    along_m: Vector2<f64>,
    least: f64,
}

impl Constraint {
    /// The velocities v with `away`·v ≥ `least_m_s`, for a unit vector `away`.
    pub(super) fn half_plane(away: Vector2<f64>, least_m_s: f64) -> Self {
        Self { along_m: away, least: least_m_s }
    }

    /// The same constraint for the velocity relative to `carried_ne_m_s`, this vehicle's feed-forward, while the other
    /// vehicle moves at `other_ne_m_s`.
    pub fn relative(self, carried_ne_m_s: Vector2<f64>, other_ne_m_s: Vector2<f64>) -> Self {
        let left_behind = self.along_m.dot(&other_ne_m_s).min(0.0) - self.along_m.dot(&carried_ne_m_s);
        Self { least: self.least + left_behind.max(0.0), ..self }
    }

    /// Margin of a velocity inside the half-plane, m²/s; negative outside.
    fn margin(&self, velocity_ne_m_s: Vector2<f64>) -> f64 {
        self.along_m.dot(&velocity_ne_m_s) - self.least
    }

    /// The nearest velocity on the half-plane's edge, m/s.
    fn project(&self, velocity_ne_m_s: Vector2<f64>) -> Vector2<f64> {
        velocity_ne_m_s - self.along_m * (self.margin(velocity_ne_m_s) / self.along_m.norm_squared())
    }

    /// The velocity on both edges, m/s, if they cross.
    fn crossing(&self, other: &Self) -> Option<Vector2<f64>> {
        let area = self.along_m.perp(&other.along_m);
        (area.abs() > SLACK).then(|| {
            let (a, b) = (self.along_m, other.along_m);
            Vector2::new(self.least * b.y - other.least * a.y, other.least * a.x - self.least * b.x) / area
        })
    }
}

impl SafetyFilter {
    /// The constraint for clearing another vehicle. `from_other_m` is the displacement from it to this vehicle, NED,
    /// and must not be vertical. `clear_m` is a distance to keep if it exceeds the filter's own.
    pub fn constraint(&self, from_other_m: Vector3<f64>, clear_m: f64) -> Constraint {
        let keep_m = self.distance_m.max(clear_m);
        let h = from_other_m.norm_squared() - keep_m * keep_m;
        Constraint { along_m: from_other_m.xy(), least: -self.rate_per_s / 4.0 * h }
    }

    /// The constraint for clearing a vehicle that flies at `their_ne_m_s` and may not know of this one: this vehicle ensures
    /// all of ḣ ≥ −κ h, (p_i − p_j)·w ≥ −(κ/2) h + (p_i − p_j)·(v_j − c), for its velocity w relative to the feed-forward c.
    /// `from_other_m` and `clear_m` are those of [`Self::constraint`].
    pub fn constraint_alone(
        &self,
        from_other_m: Vector3<f64>,
        clear_m: f64,
        their_ne_m_s: Vector2<f64>,
        carried_ne_m_s: Vector2<f64>,
    ) -> Constraint {
        let Constraint { along_m, least } = self.constraint(from_other_m, clear_m);
        Constraint { along_m, least: 2.0 * least + along_m.dot(&(their_ne_m_s - carried_ne_m_s)) }
    }

    /// Distance beyond which no vehicle and no obstacle with a radius of up to `obstacle_m` restricts a velocity of up to
    /// `speed_m_s`, with the feed-forward included, m: where (κ/4) h = d v.
    pub fn reach_m(&self, speed_m_s: f64, obstacle_m: f64) -> f64 {
        let keep_m = self.distance_m.max(obstacle_m);
        let half_m = 2.0 * speed_m_s / self.rate_per_s;
        half_m + (half_m * half_m + keep_m * keep_m).sqrt()
    }

    /// The velocity to fly, m/s; `None` if the commanded velocity satisfies all constraints. If no velocity satisfies
    /// them (a vehicle is already too near), it is the one that violates the worst constraint least.
    pub fn restrain(&self, command_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> Option<Vector2<f64>> {
        if is_allowed(command_ne_m_s, constraints) {
            return None;
        }
        let least_m_s = STUCK_SHARE * command_ne_m_s.norm();
        let mut turned =
            RIGHT_TURNS_RAD.iter().map(|&turn| nearest(Rotation2::new(turn) * command_ne_m_s, constraints));
        let first = turned.next()?;
        let moving = |velocity: &Vector2<f64>| velocity.norm() > least_m_s;
        Some(if moving(&first) { first } else { turned.find(moving).unwrap_or(first) })
    }
}

fn is_allowed(velocity_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> bool {
    constraints.iter().all(|constraint| constraint.margin(velocity_ne_m_s) >= -SLACK)
}

/// The allowed velocity nearest to the commanded one; if none is allowed, the one with the smallest violation.
fn nearest(command_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> Vector2<f64> {
    nearest_allowed(command_ne_m_s, constraints).unwrap_or_else(|| least_violation(command_ne_m_s, constraints))
}

/// The allowed velocity nearest to the commanded one, one constraint after the other: the nearest velocity that the
/// first ones allow stays the nearest one if the next allows it, and otherwise lies on the next one's edge. After R.
/// Seidel, "Small-Dimensional Linear Programming and Convex Hulls Made Easy", Discrete & Computational Geometry 6 (1991).
fn nearest_allowed(command_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> Option<Vector2<f64>> {
    let mut nearest = command_ne_m_s;
    for (nth, constraint) in constraints.iter().enumerate() {
        if constraint.margin(nearest) < -SLACK {
            nearest = nearest_on_edge(command_ne_m_s, constraint, &constraints[..nth])?;
        }
    }
    Some(nearest)
}

/// The velocity on this edge nearest to the commanded one that the other constraints allow.
fn nearest_on_edge(command_ne_m_s: Vector2<f64>, edge: &Constraint, others: &[Constraint]) -> Option<Vector2<f64>> {
    let foot = edge.project(command_ne_m_s);
    let direction = Vector2::new(-edge.along_m.y, edge.along_m.x);
    // The part of the edge that the others allow, from the foot: its two ends with the constraints that set them.
    let (mut begin, mut end) = ((f64::NEG_INFINITY, None), (f64::INFINITY, None));
    for other in others {
        let (slope, margin) = (other.along_m.dot(&direction), other.margin(foot));
        if slope.abs() <= SLACK {
            if margin < -SLACK {
                return None;
            }
        } else if slope > 0.0 && -margin / slope > begin.0 {
            begin = (-margin / slope, Some(other));
        } else if slope < 0.0 && -margin / slope < end.0 {
            end = (-margin / slope, Some(other));
        }
    }
    let corner = if begin.0 > 0.0 { begin.1 } else { end.1.filter(|_| end.0 < 0.0) };
    let Some(corner) = corner else { return Some(foot) };
    // Where the ends meet, rounding decides which comes first.
    edge.crossing(corner).filter(|velocity| begin.0 <= end.0 || is_allowed(*velocity, others))
}

/// The velocity that violates the worst constraint least, of the commanded one, rest, and all on an edge or in a corner.
fn least_violation(command_ne_m_s: Vector2<f64>, constraints: &[Constraint]) -> Vector2<f64> {
    let on_edges = constraints.iter().map(|constraint| constraint.project(command_ne_m_s));
    let in_corners = constraints
        .iter()
        .enumerate()
        .flat_map(|(nth, one)| constraints[..nth].iter().filter_map(|other| one.crossing(other)));
    let candidates = [command_ne_m_s, Vector2::zeros()].into_iter().chain(on_edges).chain(in_corners);
    let worst = |velocity: &Vector2<f64>| {
        let short = constraints.iter().map(|c| -c.margin(*velocity) / c.along_m.norm());
        short.fold(f64::NEG_INFINITY, f64::max)
    };
    candidates.min_by(|one, other| worst(one).total_cmp(&worst(other))).unwrap_or_default()
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

    /// The constraint of another vehicle; both move only as their laws command.
    fn from(north_m: f64, east_m: f64) -> Constraint {
        FILTER.constraint(Vector3::new(north_m, east_m, 0.0), 0.0)
    }

    #[test]
    fn far_from_all_others_the_velocity_is_unchanged() {
        assert_eq!(FILTER.restrain(Vector2::new(5.0, 0.0), &[from(-50.0, 0.0)]), None, "50 m ahead, 5 m/s");
        assert_eq!(FILTER.restrain(Vector2::new(5.0, 3.0), &[]), None);
    }

    #[test]
    fn a_vehicle_flying_at_another_is_slowed_and_turned_right() {
        let restrained = FILTER.restrain(Vector2::new(5.0, 0.0), &[from(-10.0, 0.0)]).unwrap();
        assert!((restrained.x - 0.45).abs() < 1e-9, "closes no faster than (κ/4) h / d: {restrained}");
        assert!(restrained.y > 1.0, "passes on the right: {restrained}");
        let wide = [FILTER.constraint(Vector3::new(-30.0, 0.0, 0.0), 25.0)];
        assert!(FILTER.restrain(Vector2::new(3.0, 0.0), &wide).is_some(), "keeps the larger clearance");
    }

    #[test]
    fn a_lower_vehicle_counts_by_its_three_dimensional_distance() {
        let below = [FILTER.constraint(Vector3::new(-10.0, 0.0, -6.0), 0.0)];
        let restrained = FILTER.restrain(Vector2::new(5.0, 0.0), &below).unwrap();
        assert!((restrained.x - 0.9).abs() < 1e-9, "h = 136 − 64 m²: {restrained}");
    }

    #[test]
    fn a_vehicle_that_is_too_near_backs_off() {
        assert!(FILTER.restrain(Vector2::zeros(), &[from(-4.0, 0.0)]).unwrap().x < -1.0);
        let stuck = FILTER.restrain(Vector2::new(3.0, 0.0), &[from(-4.0, 0.0), from(4.0, 0.0)]).unwrap();
        assert!(stuck.x.abs() < 1e-6, "favours neither of the two: {stuck}");
    }

    #[test]
    fn a_knot_of_three_unties_to_the_right() {
        // An equilateral triangle with sides of d_s, seen from its southern corner: no vehicle may approach another.
        // Turned by 37° alone, the commanded velocity still points between the two others and is cut to zero.
        let apart = FILTER.distance_m * math::cos(PI / 6.0);
        let others = [from(-apart, 4.0), from(-apart, -4.0)];
        let flown = FILTER.restrain(Vector2::new(2.0, -0.4), &others).unwrap();
        assert!(flown.y > 1.0 && flown.x < 0.0, "around them, to the right: {flown}");
    }

    #[test]
    fn a_swarm_moves_together_but_not_into_a_vehicle_that_stays() {
        let (north, at_rest) = (Vector2::new(4.0, 0.0), Vector2::zeros());
        let ahead = from(-12.0, 0.0);
        assert_eq!(FILTER.restrain(at_rest, &[ahead.relative(north, north)]), None, "both move");
        let stopped = FILTER.restrain(at_rest, &[ahead.relative(north, at_rest)]).unwrap() + north;
        assert!((stopped.x - 0.125 * 80.0 / 12.0).abs() < 1e-9, "same distance to a vehicle at rest: {stopped}");
        assert_eq!(FILTER.restrain(at_rest, &[from(12.0, 0.0).relative(north, at_rest)]), None, "moves away from it");
    }

    /// The nearest allowed velocity of all that are the commanded one, on an edge or in a corner.
    fn nearest_of_all(command: Vector2<f64>, constraints: &[Constraint]) -> Option<Vector2<f64>> {
        let on_edges = constraints.iter().map(|constraint| constraint.project(command));
        let in_corners = constraints.iter().flat_map(|one| constraints.iter().filter_map(|other| one.crossing(other)));
        let all = [command].into_iter().chain(on_edges).chain(in_corners);
        let square = |velocity: &Vector2<f64>| (velocity - command).norm_squared();
        all.filter(|velocity| is_allowed(*velocity, constraints))
            .min_by(|one, other| square(one).total_cmp(&square(other)))
    }

    proptest! {
        #[test]
        fn one_constraint_after_the_other_gives_the_nearest_velocity_of_all(
            command in vector(8.0), others in proptest::collection::vec((vector(60.0), vector(6.0)), 0..9),
        ) {
            let constraints: Vec<_> = others
                .iter()
                .filter(|(from, _)| from.norm() > 0.1)
                .map(|(place, moves)| from(place.x, place.y).relative(Vector2::new(2.0, 0.0), *moves))
                .collect();
            let (found, all) = (nearest_allowed(command, &constraints), nearest_of_all(command, &constraints));
            prop_assert_eq!(found.is_some(), all.is_some());
            for (found, all) in found.into_iter().zip(all) {
                prop_assert!((found - all).norm() < 1e-6, "{found} {all}");
            }
        }

        #[test]
        fn the_filtered_velocity_is_allowed_if_any_velocity_is(
            command in vector(15.0), others in proptest::collection::vec(vector(60.0), 1..8),
        ) {
            let outside = others.iter().filter(|from| from.norm() >= FILTER.distance_m);
            let constraints: Vec<_> = outside.map(|place| from(place.x, place.y)).collect();
            let flown = FILTER.restrain(command, &constraints).unwrap_or(command);
            prop_assert!(flown.iter().all(|speed| speed.is_finite()));
            // Outside the safety distance of all others, standing still is always allowed.
            prop_assert!(constraints.iter().all(|constraint| constraint.margin(flown) >= -1e-6));
        }

        #[test]
        fn the_two_shares_satisfy_the_constraint_with_any_feedforward(
            apart in vector(40.0), command in [vector(10.0), vector(10.0)], carried in [vector(6.0), vector(6.0)],
            moves in [vector(6.0), vector(6.0)], together: bool,
        ) {
            prop_assume!(apart.norm() > FILTER.distance_m);
            // Each flies the filtered velocity, against the other's actual velocity: found by iteration.
            let carried = if together { [carried[0]; 2] } else { carried };
            let fly = |nth: usize, from_other: Vector2<f64>, other| {
                let constraint = from(from_other.x, from_other.y).relative(carried[nth], other);
                carried[nth] + FILTER.restrain(command[nth], &[constraint]).unwrap_or(command[nth])
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
