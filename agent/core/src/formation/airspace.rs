//! Keeps a vehicle in the scenario's airspace: inside the fence, clear of obstacles, between floor and ceiling,
//! and above the ground below it.
//!
//! Fence and obstacles are constraints of the safety filter ([`super::safety`]) beside those of other vehicles, so that they
//! hold under every law. With the distance d to the nearest point of an edge or an obstacle, less the margin, and the unit
//! vector n away from it, the vehicle's velocity over the ground v = c + w satisfies
//!
//! n·v ≥ −κ d.
//!
//! A vehicle follows its velocity with a lag of about a second. With κ = 0.25 1/s it comes to rest at the margin without
//! passing it; wind and a failing vehicle use up the margin.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use nalgebra::Vector2;
use skein_common::frame::PositionNed;
use skein_common::scenario::{self, Scenario, StaticObstacle, Target};

use super::safety::Constraint;

/// Largest speed of a vehicle towards an edge or an obstacle, as a share of the remaining distance a second, 1/s.
const RATE_PER_S: f64 = 0.25;
/// Largest speed at which a vehicle beyond the margin comes back, m/s.
const RETURN_M_S: f64 = 3.0;
/// Height above an obstacle's top from which on it is ignored, m.
const OVER_M: f64 = 5.0;
/// A direction shorter than this is undefined, m.
const COINCIDENT_M: f64 = 1e-6;

/// The airspace as the formation stage uses it.
#[derive(Clone, Debug, PartialEq)]
pub struct Airspace {
    edges: Vec<Edge>,
    obstacles: Vec<StaticObstacle>,
    margin_m: f64,
    floor_m: f64,
    floor_above_ground_m: f64,
    ceiling_m: f64,
}

/// An edge of the fence: a point on it, and the unit vector to the inside.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Edge {
    point_ne_m: Vector2<f64>,
    inward: Vector2<f64>,
}

impl Airspace {
    /// The airspace of a scenario; its fence is a convex polygon.
    pub fn new(settings: &scenario::Airspace) -> Self {
        let corners: Vec<Vector2<f64>> = settings.fence_ne_m.iter().map(|corner| Vector2::from(*corner)).collect();
        let next = |nth: usize| corners[(nth + 1) % corners.len()];
        let area: f64 = (0..corners.len()).map(|nth| corners[nth].perp(&next(nth))).sum();
        let edge = |nth: usize| {
            let along = (next(nth) - corners[nth]).normalize() * area.signum();
            Edge { point_ne_m: corners[nth], inward: Vector2::new(-along.y, along.x) }
        };
        Self {
            edges: (0..corners.len()).map(edge).collect(),
            obstacles: settings.obstacles.clone(),
            margin_m: settings.margin_m,
            floor_m: settings.floor_m.unwrap_or(f64::NEG_INFINITY),
            floor_above_ground_m: settings.floor_above_ground_m.unwrap_or(f64::NEG_INFINITY),
            ceiling_m: settings.ceiling_m.unwrap_or(f64::INFINITY),
        }
    }

    /// The constraints on the velocity relative to `carried_ne_m_s`, the feed-forward, of a vehicle at this position.
    pub fn constraints(
        &self,
        position: PositionNed,
        carried_ne_m_s: Vector2<f64>,
    ) -> impl Iterator<Item = Constraint> + '_ {
        let at = position.horizontal();
        let edges = self.edges.iter().map(move |edge| (edge.inward, edge.inward.dot(&(at - edge.point_ne_m))));
        let is_beside =
            move |obstacle: &&StaticObstacle| obstacle.top_m.is_none_or(|top_m| position.altitude_m() < top_m + OVER_M);
        let obstacles = self.obstacles.iter().filter(is_beside).map(move |obstacle| away_from(obstacle, at));
        edges.chain(obstacles).map(move |(away, distance_m)| {
            let away_m_s = (RATE_PER_S * (self.margin_m - distance_m)).min(RETURN_M_S);
            let least_m_s = away_m_s - away.dot(&carried_ne_m_s);
            Constraint::half_plane(away, least_m_s)
        })
    }

    /// The altitude nearest to this one between floor and ceiling, m above the origin, for a vehicle above ground at
    /// `ground_m`. The ground is the greater danger: the floor above it outranks the ceiling.
    pub fn altitude_m(&self, wanted_m: f64, ground_m: f64) -> f64 {
        wanted_m.max(self.floor_m).min(self.ceiling_m).max(ground_m + self.floor_above_ground_m)
    }

    /// Distance of a place to the nearest edge of the fence, m, negative outside; infinite without a fence.
    fn inside_m(&self, at: Vector2<f64>) -> f64 {
        let distances_m = self.edges.iter().map(|edge| edge.inward.dot(&(at - edge.point_ne_m)));
        distances_m.fold(f64::INFINITY, f64::min)
    }
}

/// The unit vector away from an obstacle at a place, and the distance to its surface, m, negative inside.
fn away_from(obstacle: &StaticObstacle, at: Vector2<f64>) -> (Vector2<f64>, f64) {
    let from_centre = at - Vector2::from(obstacle.centre_ne_m);
    let away = |direction: Vector2<f64>| {
        let length = direction.norm();
        if length > COINCIDENT_M { direction / length } else { Vector2::x() }
    };
    let Some(size_ne_m) = obstacle.size_ne_m else {
        return (away(from_centre), from_centre.norm() - obstacle.radius_m.unwrap_or(0.0));
    };
    let half_m = Vector2::from(size_ne_m) / 2.0;
    let beyond = from_centre.abs() - half_m;
    let sign = from_centre.map(|side| if side < 0.0 { -1.0 } else { 1.0 });
    if beyond.x <= 0.0 && beyond.y <= 0.0 {
        // Inside, the nearest face is the way out.
        let is_north = beyond.x > beyond.y;
        let face = if is_north { Vector2::new(sign.x, 0.0) } else { Vector2::new(0.0, sign.y) };
        return (face, beyond.max());
    }
    let outside = beyond.map(|side| side.max(0.0)).component_mul(&sign);
    (away(outside), outside.norm())
}

/// Checks that the mission stays in the airspace: the formation at every place and along every path inside the fence, no
/// place in an obstacle, and every altitude between floor and ceiling.
///
/// # Errors
/// The first step that leaves it, as a sentence with the remedy.
pub(super) fn check(scenario: &Scenario, extent_m: impl Fn(&scenario::Formation) -> f64) -> Result<(), String> {
    let settings = &scenario.airspace;
    if settings.is_unlimited() {
        return Ok(());
    }
    let airspace = Airspace::new(settings);
    for (nth, step) in scenario.mission.steps.iter().enumerate() {
        let formation = &step.formation;
        let altitude_m = formation.altitude_m;
        if !(airspace.floor_m..=airspace.ceiling_m).contains(&altitude_m) {
            return Err(format!(
                "mission.steps[{nth}]: formation.altitude_m is {altitude_m}, outside airspace.floor_m to airspace.ceiling_m"
            ));
        }
        // Where the ground is known: it is flat, at the height of the origin.
        let is_flat = scenario.swarm.plant.spec().is_ground_flat;
        if let Some(floor_m) = settings.floor_above_ground_m.filter(|floor_m| is_flat && altitude_m < *floor_m) {
            return Err(format!(
                "mission.steps[{nth}]: formation.altitude_m is {altitude_m}, below airspace.floor_above_ground_m, which is \
                 {floor_m}. Raise the formation or lower the floor"
            ));
        }
        let needed_m = extent_m(formation) + settings.margin_m;
        let (places, stays): (&[[f64; 2]], bool) = match &step.target {
            Target::Centre(centre_ne_m) => (core::slice::from_ref(centre_ne_m), true),
            Target::Path(path) => (path, false),
            Target::Hold(_) | Target::Land(_) => (&[], false),
        };
        for place in places {
            let inside_m = airspace.inside_m(Vector2::from(*place));
            if inside_m < needed_m {
                return Err(format!(
                    "mission.steps[{nth}]: the formation about {place:?} leaves the fence: it needs {needed_m} m on every side \
                     with airspace.margin_m, and the nearest edge is {inside_m:.1} m away. Move the place or the fence, or \
                     make the formation smaller"
                ));
            }
            let is_in_way = |obstacle: &&StaticObstacle| {
                let (_, distance_m) = away_from(obstacle, Vector2::from(*place));
                let is_under = obstacle.top_m.is_some_and(|top_m| altitude_m >= top_m + OVER_M);
                !is_under && distance_m < settings.margin_m
            };
            if let Some(obstacle) = settings.obstacles.iter().find(is_in_way).filter(|_| stays) {
                return Err(format!(
                    "mission.steps[{nth}]: the centre {place:?} is within airspace.margin_m of the obstacle about {:?}. Move \
                     the place",
                    obstacle.centre_ne_m
                ));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
