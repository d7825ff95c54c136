//! At which height a vehicle flies: in the band of its rank, or where the field of an ellipsoid takes it.

use crate::estimate::Estimate;

/// No step counts for longer than this, s: after a pause of the plant no set-point jumps.
const LONGEST_STEP_S: f64 = 0.1;
/// A vehicle whose rank changes moves to its new band this fast, m/s: others are on their way too.
const BAND_CHANGE_M_S: f64 = 1.0;
/// Climb asked for a vertical field of one, m/s, and the fastest.
const CLIMB_PER_FIELD_M_S: f64 = 3.0;
const FASTEST_CLIMB_M_S: f64 = 2.0;
/// The set-point on an ellipsoid is never farther from the vehicle than this, m: enough to climb at the fastest rate (the
/// rules ask for half a metre per second and metre).
const LEASH_M: f64 = 5.0;
/// Nobody is sent lower than this above the ground, m, whatever the ellipsoid says.
const LOWEST_M: f64 = 5.0;
/// Those who miss a vehicle with a smaller id than any of them fly this much higher, m: more than the safety distance.
const ABOVE_MISSED_M: f64 = 10.0;
/// A vehicle has risen when it is no farther below the centre than this, m.
const RISEN_M: f64 = 1.0;

/// The height set-point of one vehicle.
#[derive(Clone, Copy, Debug, Default)]
pub struct Heights {
    /// Of the own band above the centre's altitude, m, while there are bands.
    offset_m: Option<f64>,
    /// The set-point, m, while it is integrated.
    surface_m: Option<f64>,
    has_risen: bool,
    /// Above where it would fly if nobody were missed, m.
    above_missed_m: f64,
    /// The same when the stay at a place began: the place's altitude has it.
    above_missed_at_stay_m: Option<f64>,
}

impl Heights {
    /// What to add to the altitude of a vehicle that `is_above` those whom it misses, m. Parts of a swarm that do not hear
    /// each other both fly the mission, and neither knows where the other is: of two parts the one without the smallest id
    /// rises above the other.
    pub fn above_missed(&mut self, dt_s: f64, is_above: bool) -> f64 {
        let wanted_m = if is_above { ABOVE_MISSED_M } else { 0.0 };
        let furthest_m = BAND_CHANGE_M_S * dt_s.clamp(0.0, LONGEST_STEP_S);
        self.above_missed_m += (wanted_m - self.above_missed_m).clamp(-furthest_m, furthest_m);
        self.above_missed_m
    }

    /// How much higher the parts of the swarm have wanted this vehicle since it has stayed at its place, m; a vehicle that
    /// `lands` comes down, and if it stays again, then where it is.
    pub fn risen_since_stay(&mut self, above_missed_m: f64, lands: bool) -> f64 {
        if lands {
            self.above_missed_at_stay_m = Some(above_missed_m);
        }
        above_missed_m - *self.above_missed_at_stay_m.get_or_insert(above_missed_m)
    }

    /// The vehicle stays at its place no more.
    pub fn end_stay(&mut self) {
        self.above_missed_at_stay_m = None;
    }

    /// The altitude of the own band among `live` bands `step_m` apart around the centre's, m:
    /// h = h_c + (rank − (N − 1)/2)·Δh, with a rank that changes slowly.
    pub fn in_band(&mut self, dt_s: f64, centre_m: f64, step_m: f64, rank: usize, live: usize) -> f64 {
        let wanted_m = (rank as f64 - (live as f64 - 1.0) / 2.0) * step_m;
        let furthest_m = BAND_CHANGE_M_S * dt_s.clamp(0.0, LONGEST_STEP_S);
        let offset_m = self.offset_m.map_or(wanted_m, |at_m| at_m + (wanted_m - at_m).clamp(-furthest_m, furthest_m));
        (self.offset_m, self.surface_m) = (Some(offset_m), None);
        centre_m + offset_m
    }

    /// The altitude on an ellipsoid around a centre at `centre_m`, for the field's upward part, m. A vehicle first rises to
    /// the centre's altitude.
    pub fn on_surface(&mut self, dt_s: f64, centre_m: f64, field_up: f64, estimate: &Estimate) -> f64 {
        self.climbing(dt_s, centre_m, CLIMB_PER_FIELD_M_S * field_up, estimate)
    }

    /// The altitude of a vehicle that is to climb like this, once it has risen to the centre's altitude; m.
    pub fn climbing(&mut self, dt_s: f64, centre_m: f64, climb_m_s: f64, estimate: &Estimate) -> f64 {
        let altitude_m = estimate.position.altitude_m();
        let lowest_m = altitude_m - estimate.height_m + LOWEST_M;
        self.offset_m = None;
        self.has_risen |= altitude_m > centre_m - RISEN_M;
        if !self.has_risen {
            return centre_m;
        }
        let climb_m_s = climb_m_s.clamp(-FASTEST_CLIMB_M_S, FASTEST_CLIMB_M_S);
        let moved_m = self.surface_m.unwrap_or(altitude_m) + climb_m_s * dt_s.clamp(0.0, LONGEST_STEP_S);
        let surface_m = moved_m.clamp(altitude_m - LEASH_M, altitude_m + LEASH_M).max(lowest_m);
        self.surface_m = Some(surface_m);
        surface_m
    }
}

#[cfg(test)]
mod tests;
