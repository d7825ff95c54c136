//! Places an aircraft on the ground at its vehicle's start, by UDP: for an agent before its flight, and for `skein xplane place`.
//!
//! X-Plane confirms no placement. Where the aircraft is decides whether it was placed; until then the placement is repeated.

use std::time::{Duration, Instant};

use skein_common::frame::{Geodetic, Origin, PositionNed};
use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_core::start::starts;

use super::wire::prel::Placement;
use super::wire::rpos::Position;

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

/// The progress of a placement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlacingState {
    /// The aircraft is elsewhere, and attempts are left.
    UnderWay,
    /// The aircraft is at its start.
    There,
    /// The aircraft is elsewhere after all attempts.
    Failed,
}

/// The placement of an aircraft at the start of its vehicle.
#[derive(Debug)]
pub struct Placing {
    place: Placement,
    origin: Origin,
    attempts: u32,
    last: Option<Instant>,
}

impl Placing {
    /// The placement of the aircraft at this start; nothing is sent yet.
    pub fn at(place: Placement) -> Self {
        let Placement { latitude_deg, longitude_deg, elevation_m, .. } = place;
        let origin = Origin::new(Geodetic::from_degrees(latitude_deg, longitude_deg, elevation_m));
        Self { place, origin, attempts: 0, last: None }
    }

    /// The progress of the placement, with the aircraft at this position.
    pub fn state(&self, position: &Position) -> PlacingState {
        match self.away_m(position) {
            away_m if away_m < THERE_M => PlacingState::There,
            _ if self.attempts >= ATTEMPTS => PlacingState::Failed,
            _ => PlacingState::UnderWay,
        }
    }

    /// The placement to send now, if one is due. `position` is the aircraft's, if it is known.
    pub fn due(&mut self, position: Option<&Position>, now: Instant) -> Option<Placement> {
        let is_over = self.attempts >= ATTEMPTS || position.is_some_and(|position| self.away_m(position) < THERE_M);
        if is_over || self.last.is_some_and(|last| now < last + AGAIN) {
            return None;
        }
        self.last = Some(now);
        self.attempts += 1;
        let near = position.filter(|position| self.away_m(position) < SAME_GROUND_M);
        let ground_m = near.map(|position| position.elevation_m - f64::from(position.height_m));
        Some(Placement { elevation_m: ground_m.unwrap_or(self.place.elevation_m), ..self.place })
    }

    /// Horizontal distance of this position from the start, m.
    pub fn away_m(&self, position: &Position) -> f64 {
        let at = Geodetic::from_degrees(position.latitude_deg, position.longitude_deg, self.place.elevation_m);
        self.origin.ned_from_geodetic(&at).horizontal().norm()
    }
}

/// Distance from a scenario's origin up to which the ground is compared with the origin's elevation, m.
pub const NEAR_ORIGIN_M: f64 = 2000.0;
/// Difference of the ground from the origin's elevation above which it is reported, m: half the default altitude of a
/// formation, which is above the origin.
pub const LEVEL_WITHIN_M: f64 = 15.0;

/// Distance of an aircraft at this position from the scenario's origin, and height of the ground below it above the origin, m.
pub fn from_origin_m(origin: &Origin, position: &Position) -> (f64, f64) {
    let at = Geodetic::from_degrees(position.latitude_deg, position.longitude_deg, position.elevation_m);
    let from = origin.ned_from_geodetic(&at);
    (from.horizontal().norm(), from.altitude_m() - f64::from(position.height_m))
}

/// Whether an aircraft flies at this position.
pub fn is_flying(position: &Position) -> bool {
    position.height_m > FLIES_ABOVE_M
}

/// Place and heading of the vehicle's start in its scenario; `None` if the scenario has no such vehicle, or no room for the
/// starts of all.
pub fn start_of(scenario: &Scenario, id: VehicleId) -> Option<Placement> {
    let nth = scenario.ids().position(|other| other == id)?;
    let start = *starts(scenario).ok()?.get(nth)?;
    let origin = Origin::new(scenario.origin.geodetic());
    let (place, convergence) = origin.place(PositionNed::new(start.north_m, start.east_m, 0.0));
    Some(Placement {
        aircraft: 0,
        latitude_deg: place.latitude_deg(),
        longitude_deg: place.longitude_deg(),
        elevation_m: place.altitude_m,
        heading_deg: convergence.heading_to_local(start.heading_rad).to_degrees().rem_euclid(360.0),
        speed_m_s: 0.0,
    })
}
