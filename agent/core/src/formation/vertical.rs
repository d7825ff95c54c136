//! The altitude setpoint of a vehicle: the band of its rank, or the altitude that the field of an ellipsoid commands.

use core::ops::RangeInclusive;

use crate::estimate::Estimate;

/// Longest time step that counts, s: after a pause of the plant the setpoint does not jump.
const LONGEST_STEP_S: f64 = 0.1;
/// Speed at which a vehicle changes its band, m/s: other vehicles are changing theirs at the same time.
const BAND_CHANGE_M_S: f64 = 1.0;
/// Climb per unit of vertical field, m/s, and the fastest climb.
const CLIMB_PER_FIELD_M_S: f64 = 3.0;
const FASTEST_CLIMB_M_S: f64 = 2.0;
/// Largest distance of the setpoint on an ellipsoid from the vehicle, m: enough to climb at the fastest rate (the rules
/// command 0.5 m/s per metre).
const LEASH_M: f64 = 5.0;
/// Lowest altitude setpoint above the ground on an ellipsoid, m.
const LOWEST_M: f64 = 5.0;
/// Height at which a partition without the lowest id flies above the other one, m: more than the safety distance.
const PARTITION_RISE_M: f64 = 10.0;
/// Speed at which a partition rises above the other one, m/s: the vehicles of that one avoid a lost vehicle for ten seconds
/// after its last message, and then no longer know where it is.
const PARTITION_CLIMB_M_S: f64 = 2.0;
/// A vehicle whose partition flies above has climbed when it is at most this far below its altitude there, m.
const CLIMBED_M: f64 = 2.0;
/// A vehicle has risen when it is at most this far below the centre, m.
const RISEN_M: f64 = 1.0;

/// The altitude setpoint of one vehicle.
#[derive(Clone, Copy, Debug, Default)]
pub struct Heights {
    /// Height of the own band above the centre's altitude, m; `None` outside bands.
    offset_m: Option<f64>,
    /// The integrated altitude setpoint, m; `None` while it is not integrated.
    surface_m: Option<f64>,
    has_risen: bool,
    /// Rise above the altitude without lost peers, m.
    partition_rise_m: f64,
    /// The rise at which the climb ends, m; 0 unless the vehicle's partition flies above another one.
    partition_target_m: f64,
    /// The altitude to which the rise is added, m, in the last step of a formation.
    base_m: Option<f64>,
    /// The rise when the stay at a position began: the position's altitude includes it.
    partition_rise_at_stay_m: Option<f64>,
}

impl Heights {
    /// Rise added to the altitude of a vehicle, m; `is_above` states that its partition flies above. Partitions without
    /// contact both fly the mission, and neither knows where the other is, nor at which step: of two partitions the one
    /// without the lowest id rises above every altitude at which the other one may fly. `altitudes_m` are the
    /// altitude to which the rise is added and the range of those; `None` keeps what they were. A vehicle far below them
    /// stays below.
    pub fn partition_rise(
        &mut self,
        dt_s: f64,
        is_above: bool,
        altitudes_m: Option<(f64, RangeInclusive<f64>)>,
    ) -> f64 {
        self.partition_target_m = match altitudes_m {
            _ if !is_above => 0.0,
            Some((own_m, others_m)) if own_m + 2.0 * PARTITION_RISE_M > *others_m.start() => {
                PARTITION_RISE_M + (others_m.end() - own_m).max(0.0)
            }
            Some(_) => PARTITION_RISE_M,
            None => self.partition_target_m.max(PARTITION_RISE_M),
        };
        let dt_s = dt_s.clamp(0.0, LONGEST_STEP_S);
        let left_m = self.partition_target_m - self.partition_rise_m;
        self.partition_rise_m += left_m.clamp(-BAND_CHANGE_M_S * dt_s, PARTITION_CLIMB_M_S * dt_s);
        self.partition_rise_m
    }

    /// Takes the altitude of the step that is flown, m. At a new step a vehicle that flies above keeps its altitude.
    pub fn begin_step(&mut self, altitude_m: f64) {
        let before_m = self.base_m.replace(altitude_m).unwrap_or(altitude_m);
        if self.partition_target_m > 0.0 {
            self.partition_rise_m = (self.partition_rise_m + before_m - altitude_m).max(0.0);
        }
    }

    /// The altitude without a rise of a vehicle that stays at this altitude, m.
    pub fn stay_without_rise_m(&self, altitude_m: f64) -> f64 {
        altitude_m - self.partition_rise_at_stay_m.unwrap_or(self.partition_rise_m)
    }

    /// Whether the vehicle's partition flies above another one and the vehicle with this altitude setpoint has not climbed
    /// there yet. Until then it waits: the vehicles below it are on the way to their new positions, and it would cross
    /// their ways at their altitude. In a take-off both partitions climb equally fast, so that takes longer than the rise.
    pub fn is_climbing_above(&self, setpoint_m: f64, estimate: &Estimate) -> bool {
        let has_own_altitude = self.offset_m.is_some() || !self.has_risen;
        let below_m = if has_own_altitude { setpoint_m - estimate.position.altitude_m() } else { 0.0 };
        self.partition_target_m > 0.0 && self.partition_target_m - self.partition_rise_m + below_m > CLIMBED_M
    }

    /// Change of the rise since the vehicle has stayed at its position, m. A vehicle that `lands` descends; if it stays
    /// again, it stays at its altitude.
    pub fn risen_since_stay(&mut self, partition_rise_m: f64, lands: bool) -> f64 {
        if lands {
            self.partition_rise_at_stay_m = Some(partition_rise_m);
        }
        partition_rise_m - *self.partition_rise_at_stay_m.get_or_insert(partition_rise_m)
    }

    /// Ends the stay at a position.
    pub fn end_stay(&mut self) {
        self.partition_rise_at_stay_m = None;
    }

    /// The altitude of the own band among `live` bands `step_m` apart around the centre's, m:
    /// h = h_c + (rank − (N − 1)/2)·Δh. After a change of rank it moves slowly.
    pub fn in_band(&mut self, dt_s: f64, centre_m: f64, step_m: f64, rank: usize, live: usize) -> f64 {
        let target_m = (rank as f64 - (live as f64 - 1.0) / 2.0) * step_m;
        let furthest_m = BAND_CHANGE_M_S * dt_s.clamp(0.0, LONGEST_STEP_S);
        let offset_m = self.offset_m.map_or(target_m, |at_m| at_m + (target_m - at_m).clamp(-furthest_m, furthest_m));
        (self.offset_m, self.surface_m) = (Some(offset_m), None);
        centre_m + offset_m
    }

    /// The altitude on an ellipsoid around a centre at `centre_m`, for the field's upward component, m. A vehicle first
    /// rises to the centre's altitude.
    pub fn on_surface(&mut self, dt_s: f64, centre_m: f64, field_up: f64, estimate: &Estimate) -> f64 {
        self.climbing(dt_s, centre_m, CLIMB_PER_FIELD_M_S * field_up, estimate)
    }

    /// The altitude of a vehicle with this climb command, after it has risen to the centre's altitude, m.
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
