//! Turns measurements into the vehicle's [`Estimate`] of its own state.
//!
//! The scenario selects the sensing, over any plant. `f32_latlon` rounds latitude and longitude in degrees to single
//! precision, as X-Plane's data rows do and as Garcia & Barnes 2010 read them: a grid of 0.2 to 0.8 m. `differenced`
//! replaces the measured velocity by the filtered difference of positions. After the measured position has frozen, the
//! vehicle dead-reckons from it by the measured velocity.

use core::f64::consts::TAU;

use nalgebra::{Vector2, Vector3};
use skein_common::frame::{Attitude, BodyRates, Geodetic, Origin, PositionNed, VelocityNed};
use skein_common::math;
use skein_common::scenario::{PositionSensing, Sensing, VelocitySensing};
use skein_common::state::VehicleState;
use skein_common::time::{LocalTime, Now, PlantTime};

use crate::plant::Measurement;

/// Largest plausible body rate, rad/s; faster rates come from a broken sensor.
const MAX_RATE_RAD_S: f64 = 50.0;

/// Longest time over which a measured velocity is integrated, s: after a pause of the measurements the vehicle may have
/// had any velocity.
const LONGEST_STEP_S: f64 = 0.5;

/// The vehicle's estimate of its own state at one instant. Every number is finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Position in the swarm's frame.
    pub position: PositionNed,
    /// The same position as sent to peers.
    pub geodetic: Geodetic,
    /// Height of the centre of gravity above the ground, m.
    pub height_m: f64,
    /// Velocity over the ground in the swarm's frame.
    pub velocity: VelocityNed,
    /// Attitude in the swarm's frame.
    pub attitude: Attitude,
    /// Angular velocity.
    pub rates: BodyRates,
    /// Main rotor speed, rad/s, if the plant reports it.
    pub rotor_speed_rad_s: Option<f64>,
}

impl Estimate {
    /// The estimate that believes a measurement entirely, in the frame at `origin`.
    pub fn of(measurement: &Measurement, origin: &Origin) -> Self {
        let &Measurement { position: geodetic, height_m, velocity, attitude, rates, rotor_speed_rad_s } = measurement;
        let (position, convergence) = origin.locate(&geodetic);
        let velocity = convergence.velocity_from_local(velocity);
        let attitude = convergence.attitude_from_local(attitude);
        Self { position, geodetic, height_m, velocity, attitude, rates, rotor_speed_rad_s }
    }

    /// The part of the estimate that is sent to peers; `origin` is that of the swarm's frame.
    pub fn state(&self, origin: &Origin) -> VehicleState {
        let convergence = origin.convergence_at(&self.geodetic);
        VehicleState {
            position: self.geodetic,
            velocity: convergence.velocity_to_local(self.velocity),
            heading_rad: convergence.heading_to_local(self.attitude.heading_rad),
        }
    }

    /// Whether peers would accept its state.
    fn is_plausible(&self) -> bool {
        // The length of a velocity is the same in both frames.
        let Self { geodetic: position, velocity, attitude, .. } = *self;
        VehicleState { position, velocity, heading_rad: attitude.heading_rad }.is_plausible()
    }
}

/// The estimation stage: keeps the estimate of the last plausible measurement, with its time.
#[derive(Clone, Debug)]
pub struct Estimator {
    /// Origin of the swarm's frame.
    pub(crate) origin: Origin,
    rounds_to_f32: bool,
    difference: Option<Difference>,
    reckoning: DeadReckoning,
    latest: Option<(Estimate, LocalTime)>,
    /// Whether the last update used a measurement.
    pub(crate) is_new: bool,
    /// Number of implausible measurements.
    pub(crate) refused: u64,
}

/// Displacement by the measured velocity since the measured position last changed.
#[derive(Clone, Copy, Debug, Default)]
struct DeadReckoning {
    is_on: bool,
    /// The position, and the time of its last update.
    last: Option<(Geodetic, PlantTime)>,
    displacement_ned_m: Vector3<f64>,
}

/// Velocity as the filtered difference of positions.
#[derive(Clone, Copy, Debug)]
struct Difference {
    /// Time constant τ of the first-order filter, s.
    tau_s: f64,
    previous: Option<(Vector2<f64>, PlantTime)>,
    velocity_ne_m_s: Vector2<f64>,
}

impl Estimator {
    /// An estimator with this `sensing`, in the frame at `origin`.
    pub fn new(origin: Origin, sensing: &Sensing) -> Self {
        let difference = match sensing.velocity {
            VelocitySensing::Measured => None,
            VelocitySensing::Differenced => {
                Some(Difference { tau_s: sensing.differenced_tau_s, previous: None, velocity_ne_m_s: Vector2::zeros() })
            }
        };
        Self {
            origin,
            rounds_to_f32: sensing.position == PositionSensing::F32Latlon,
            difference,
            reckoning: DeadReckoning::default(),
            latest: None,
            is_new: false,
            refused: 0,
        }
    }

    /// From now on the estimator ignores the measured position, which has been frozen since it last changed, and
    /// dead-reckons the vehicle from there by the measured velocity.
    pub fn dead_reckon(&mut self) {
        self.reckoning.is_on = true;
    }

    /// Uses a measurement if it is present and plausible, and if its estimate is: the peers would refuse another one.
    /// Returns the newest estimate, whatever its age.
    pub fn update(&mut self, now: Now, measurement: Option<&Measurement>) -> Option<Estimate> {
        let estimate = measurement.filter(|measurement| is_plausible(measurement));
        let estimate = estimate.map(|measurement| self.estimate(now.plant, measurement));
        let estimate = estimate.filter(Estimate::is_plausible);
        self.is_new = estimate.is_some();
        self.refused += u64::from(measurement.is_some() && estimate.is_none());
        self.latest = estimate.map(|estimate| (estimate, now.local)).or(self.latest);
        self.latest.map(|(estimate, _)| estimate)
    }

    /// Age of the estimate by the local clock, s; `None` before the first measurement.
    pub fn age_s(&self, now: LocalTime) -> Option<f64> {
        self.latest.map(|(_, at)| now.seconds_since(at))
    }

    fn estimate(&mut self, at: PlantTime, measurement: &Measurement) -> Estimate {
        let mut estimate = Estimate::of(measurement, &self.origin);
        let place = self.reckoning.update(at, measurement, &estimate.velocity);
        if self.rounds_to_f32 || place != measurement.position {
            estimate.geodetic = if self.rounds_to_f32 { rounded(&place) } else { place };
            estimate.position = self.origin.ned_from_geodetic(&estimate.geodetic);
        }
        if self.reckoning.is_on {
            estimate.position.0 += self.reckoning.displacement_ned_m;
            estimate.geodetic = self.origin.geodetic_from_ned(estimate.position);
        }
        if let Some(difference) = self.difference.as_mut().filter(|_| !self.reckoning.is_on) {
            let [north_m_s, east_m_s] = difference.update(at, estimate.position.horizontal()).into();
            estimate.velocity = VelocityNed::new(north_m_s, east_m_s, measurement.velocity.down_m_s());
        }
        estimate
    }
}

impl DeadReckoning {
    /// Returns the position from which the displacement is counted. `velocity` is the measured one in the swarm's frame.
    fn update(&mut self, at: PlantTime, measurement: &Measurement, velocity: &VelocityNed) -> Geodetic {
        let (begin, displacement_ned_m) = match self.last {
            Some((begin, before)) if self.is_on || begin == measurement.position => {
                let dt_s = at.seconds_since(before).clamp(0.0, LONGEST_STEP_S);
                (begin, self.displacement_ned_m + velocity.0 * dt_s)
            }
            _ => (measurement.position, Vector3::zeros()),
        };
        (self.last, self.displacement_ned_m) = (Some((begin, at)), displacement_ned_m);
        begin
    }
}

impl Difference {
    /// The filtered velocity: v += (dt/τ) ((p_k − p_{k−1})/dt − v), from v = 0.
    fn update(&mut self, at: PlantTime, position_ne_m: Vector2<f64>) -> Vector2<f64> {
        if let Some((before_ne_m, before)) = self.previous {
            let dt_s = at.seconds_since(before);
            if dt_s > 0.0 {
                let share = (dt_s / self.tau_s).min(1.0);
                self.velocity_ne_m_s += ((position_ne_m - before_ne_m) / dt_s - self.velocity_ne_m_s) * share;
            }
        }
        self.previous = Some((position_ne_m, at));
        self.velocity_ne_m_s
    }
}

/// The position with latitude and longitude in degrees rounded to single precision.
fn rounded(place: &Geodetic) -> Geodetic {
    let through_f32 = |degrees: f64| f64::from(degrees as f32);
    Geodetic::from_degrees(through_f32(place.latitude_deg()), through_f32(place.longitude_deg()), place.altitude_m)
}

fn is_plausible(measurement: &Measurement) -> bool {
    let Measurement { position, height_m, velocity, attitude, rates, rotor_speed_rad_s } = measurement;
    let rate = |rad_s: f64| rad_s.abs() <= MAX_RATE_RAD_S;
    position.is_plausible()
        && height_m.is_finite()
        && velocity.0.norm_squared() <= math::square(VehicleState::MAX_SPEED_M_S)
        && [attitude.roll_rad, attitude.pitch_rad, attitude.heading_rad].iter().all(|angle| angle.abs() <= TAU)
        && rate(rates.roll_rad_s)
        && rate(rates.pitch_rad_s)
        && rate(rates.yaw_rad_s)
        && rotor_speed_rad_s.is_none_or(f64::is_finite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::sensing_without_errors as sensing;

    fn origin() -> Origin {
        Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0))
    }

    fn measured(north_m: f64, east_m: f64) -> Measurement {
        Measurement {
            position: origin().geodetic_from_ned(PositionNed::new(north_m, east_m, -30.0)),
            height_m: 30.0,
            velocity: VelocityNed::new(1.0, 2.0, 3.0),
            attitude: Attitude::default(),
            rates: BodyRates::default(),
            rotor_speed_rad_s: Some(167.0),
        }
    }

    fn at(seconds: f64) -> Now {
        Now { plant: PlantTime::from_seconds(seconds), local: LocalTime::from_seconds(seconds) }
    }

    #[test]
    fn exact_sensing_gives_the_measurement() {
        let mut estimator = Estimator::new(origin(), &sensing(PositionSensing::Exact, VelocitySensing::Measured));
        let estimate = estimator.update(at(1.0), Some(&measured(12.0, -7.0))).unwrap();
        assert!((estimate.position - PositionNed::new(12.0, -7.0, -30.0)).norm() < 1e-5);
        // 7 m west of the origin, the local north is turned by half a millionth of a radian.
        assert!((estimate.velocity - VelocityNed::new(1.0, 2.0, 3.0)).norm() < 2e-6);
        assert_eq!(estimator.age_s(LocalTime::from_seconds(1.5)), Some(0.5));
        assert!(estimator.is_new);
        estimator.update(at(1.0), None);
        assert_eq!((estimator.is_new, estimator.age_s(LocalTime::from_seconds(1.0))), (false, Some(0.0)));
    }

    #[test]
    fn single_precision_gives_a_grid_of_the_published_size() {
        let mut estimator = Estimator::new(origin(), &sensing(PositionSensing::F32Latlon, VelocitySensing::Measured));
        let mut places = |direction: fn(f64) -> (f64, f64)| {
            let mut places: Vec<f64> = (0..4000)
                .map(|k| {
                    let (north, east) = direction(f64::from(k) * 0.005);
                    let position = estimator.update(at(1.0), Some(&measured(north, east))).unwrap().position;
                    ((position.north_m() + position.east_m()) * 1e3).round() / 1e3
                })
                .collect();
            places.dedup();
            20.0 / places.len() as f64
        };
        let (north_step_m, east_step_m) = (places(|metres| (metres, 0.0)), places(|metres| (0.0, metres)));
        assert!((north_step_m - 0.21).abs() < 0.02, "{north_step_m}");
        assert!((east_step_m - 0.75).abs() < 0.05, "{east_step_m}");
    }

    #[test]
    fn differenced_velocity_follows_with_its_time_constant() {
        let mut estimator = Estimator::new(origin(), &sensing(PositionSensing::Exact, VelocitySensing::Differenced));
        let mut velocity = VelocityNed::default();
        for tick in 0..=50 {
            let seconds = f64::from(tick) * 0.02;
            velocity = estimator.update(at(seconds), Some(&measured(2.0 * seconds, 0.0))).unwrap().velocity;
        }
        assert!((velocity.north_m_s() - 2.0 * (1.0 - math::exp(-1.0))).abs() < 0.02, "63 % after one time constant");
        assert_eq!(velocity.down_m_s(), 3.0, "the climb rate stays measured");
    }

    #[test]
    fn a_frozen_position_is_dead_reckoned_from_where_it_froze() {
        for velocity in [VelocitySensing::Measured, VelocitySensing::Differenced] {
            let mut estimator = Estimator::new(origin(), &sensing(PositionSensing::Exact, velocity));
            estimator.update(at(0.0), Some(&measured(7.0, -3.0)));
            for tick in 1..=50 {
                // The position froze one second before the diagnosis finds it.
                let estimate = estimator.update(at(f64::from(tick) * 0.02), Some(&measured(10.0, 20.0))).unwrap();
                assert!((estimate.position - PositionNed::new(10.0, 20.0, -30.0)).norm() < 1e-5);
            }
            estimator.dead_reckon();
            // The measured positions no longer matter.
            for tick in 51..=100 {
                estimator.update(at(f64::from(tick) * 0.02), Some(&measured(f64::from(tick), 0.0)));
            }
            let estimate = estimator.update(at(2.02), Some(&measured(0.0, 0.0))).unwrap();
            let displacement = estimate.position - PositionNed::new(10.0, 20.0, -30.0);
            assert!((displacement - Vector3::new(2.0, 4.0, 6.0)).norm() < 1e-5, "{displacement:?}");
            assert_eq!(estimate.velocity, VelocityNed::new(1.0, 2.0, 3.0));
            let sent = origin().ned_from_geodetic(&estimate.geodetic);
            assert!((sent - estimate.position).norm() < 1e-5);
        }
    }

    #[test]
    fn a_pause_of_the_measurements_is_not_dead_reckoned() {
        let mut estimator = Estimator::new(origin(), &sensing(PositionSensing::Exact, VelocitySensing::Measured));
        estimator.update(at(0.0), Some(&measured(10.0, 20.0)));
        estimator.update(at(200.0), Some(&measured(10.0, 20.0)));
        estimator.dead_reckon();
        let estimate = estimator.update(at(200.02), Some(&measured(0.0, 0.0))).unwrap();
        let moved_m = (estimate.position - PositionNed::new(10.0, 20.0, -30.0)).norm();
        assert!(moved_m < 0.6 * estimate.velocity.0.norm(), "{moved_m} m");
    }

    #[test]
    fn an_estimate_that_peers_would_refuse_is_not_used() {
        let mut estimator = Estimator::new(origin(), &sensing(PositionSensing::Exact, VelocitySensing::Differenced));
        let good = estimator.update(at(0.0), Some(&measured(0.0, 0.0)));
        // A jump of the position, as of a simulator that places the aircraft elsewhere, is a velocity of 50 km/s.
        assert_eq!(estimator.update(at(0.02), Some(&measured(1e6, 0.0))), good);
        assert_eq!((estimator.refused, estimator.is_new), (1, false));
    }

    #[test]
    fn an_impossible_measurement_is_refused_and_the_last_estimate_kept() {
        let mut estimator = Estimator::new(origin(), &sensing(PositionSensing::Exact, VelocitySensing::Measured));
        let good = estimator.update(at(1.0), Some(&measured(0.0, 0.0)));
        let breakages: [fn(&mut Measurement); 5] = [
            |m| m.position.latitude_rad = f64::NAN,
            |m| m.height_m = f64::INFINITY,
            |m| m.velocity = VelocityNed::new(1e4, 0.0, 0.0),
            |m| m.attitude.heading_rad = f64::NAN,
            |m| m.rates.yaw_rad_s = 1e3,
        ];
        for (count, breakage) in (1..).zip(breakages) {
            let mut broken = measured(0.0, 0.0);
            breakage(&mut broken);
            assert_eq!(estimator.update(at(2.0), Some(&broken)), good);
            assert_eq!(estimator.refused, count);
        }
        assert_eq!(estimator.age_s(LocalTime::from_seconds(3.0)), Some(2.0));
    }
}
