//! Failure diagnosis: finds failures of the agent's own vehicle from its measurements and commands alone.
//!
//! | failure | symptom |
//! | --- | --- |
//! | engine | the rotor, after reaching its speed, turns too slowly to lift; needs a measured rotor speed |
//! | servo | roll or pitch rate differs from the command, or the climb is opposite to the command |
//! | gyro | yaw rate differs from the pedals' command |
//! | position | it repeats, bit for bit: in the air while the velocity has led metres away from it, or on the ground with the altitude of the formation |
//!
//! The expected response follows from the aircraft's flight model; without a model only engine and position are
//! watched. A servo stuck at its commanded position has no symptom, and is found when it is commanded elsewhere. Servos and
//! gyro are judged only while a measurement comes at least every 0.1 s.

use core::ops::Range;

use skein_common::frame::Geodetic;
use skein_common::math;
use skein_common::message::Failure;
use skein_common::scenario::{Scenario, Servo};

use crate::aircraft::Aircraft;
use crate::failsafe::{Condition, Conditions};
use crate::helicopter::Parameters;
use crate::plant::{Controls, Measurement};

/// Ratio to the lift-off rotor speed above which the rotor counts as having been at speed.
const AT_SPEED: f64 = 1.05;
/// Path length after which a repeated position counts as frozen, m: single precision in degrees has steps of up to 1.7
/// m.
const FROZEN_OVER_M: f64 = 2.0;
/// Path length from which a repeated position does not follow the vehicle, m. The vehicle does not become an active member
/// meanwhile.
const FOLLOWS_WITHIN_M: f64 = 0.2;
/// Largest distance below its altitude at which a vehicle counts as being at it, m.
const BELOW_ALTITUDE_M: f64 = 1.0;
/// Time for which a vehicle on the ground repeats a position that it can only have in the air, until it counts as frozen, s.
const OFF_THE_GROUND_S: f64 = 1.0;
/// Height of the centre of gravity below which the ground may hold the vehicle, m.
const FREE_ABOVE_M: f64 = 1.5;
/// Collective above the hover's from which the gyro is not judged by a yaw rate below the command: the main rotor's
/// torque and a crosswind of 14 m/s then drive the tail rotor to its stop, and the nose is blown left although the gyro
/// works.
const TAIL_AT_STOP_OVER: f64 = 0.1;
/// Bank from which the gyro is not judged by a yaw rate towards that side, rad: a vehicle that leans into a strong wind from
/// the side has a fin that turns the nose into it, with more force than the tail rotor has.
const WEATHERCOCKS_FROM_RAD: f64 = 0.2;
/// Lower bound of the vertical share of the thrust, reached at a lean of 0.64 rad.
const MIN_UPRIGHT: f64 = 0.8;
/// Longest time step that counts, s. Responses to the controls are not judged over a longer one.
const LONGEST_STEP_S: f64 = 0.1;

/// The diagnosis of one vehicle. A failure stays found.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    rotor: RotorMonitor,
    monitor: Option<ControlMonitor>,
    position: Position,
    worst: Option<Failure>,
    stuck: Option<Servo>,
    is_frozen: bool,
}

impl Diagnosis {
    /// The diagnosis of a vehicle of this type before take-off.
    pub fn new(scenario: &Scenario, aircraft: &Aircraft) -> Self {
        let rotor = RotorMonitor { lifts_at_rad_s: aircraft.take_off_rotor_rad_s(), was_at_speed: false };
        let monitor = aircraft.helicopter.as_ref().map(|model| ControlMonitor::new(model, aircraft.trim.controls()));
        Self { rotor, monitor, position: Position::of(scenario), worst: None, stuck: None, is_frozen: false }
    }

    /// Evaluates a plausible measurement taken `dt_s` of plant time after the last one, and the controls commanded in
    /// between. Returns a newly found failure. After a first failure only worse failures and a frozen position are
    /// reported.
    pub fn update(&mut self, dt_s: f64, measurement: &Measurement, command: Option<Controls>) -> Option<Failure> {
        if let Some(monitor) = self.monitor.as_mut().filter(|_| dt_s > LONGEST_STEP_S) {
            // It is not known when the command reached the vehicle.
            monitor.reset();
        }
        let dt_s = dt_s.clamp(0.0, LONGEST_STEP_S);
        let unresponsive = match (&mut self.monitor, command) {
            (Some(monitor), Some(controls)) => monitor.unresponsive(dt_s, measurement, &controls),
            _ => None,
        };
        let found = match unresponsive {
            _ if self.rotor.is_without_power(measurement) => Some(Failure::Engine),
            Some(Control::Servo(_)) => Some(Failure::Servo),
            Some(Control::Gyro) => Some(Failure::Gyro),
            None => None,
        };
        let is_frozen = self.position.is_frozen(dt_s, measurement);
        if found > self.worst {
            self.worst = found;
            self.stuck = match (found, unresponsive) {
                (Some(Failure::Servo), Some(Control::Servo(servo))) => Some(servo),
                _ => self.stuck,
            };
            return found;
        }
        let froze = is_frozen && !self.is_frozen;
        self.is_frozen |= is_frozen;
        let froze = froze.then_some(Failure::Position);
        self.worst = self.worst.max(froze);
        froze
    }

    /// Forgets the observations, for a vehicle that may have been placed elsewhere at rest. Failures stay found.
    pub fn restart(&mut self) {
        self.rotor.was_at_speed = false;
        self.position.restart();
        if let Some(monitor) = &mut self.monitor {
            monitor.reset();
        }
    }

    /// The failures as conditions of the failsafe table.
    pub fn conditions(&self) -> Conditions {
        let cyclic = matches!(self.stuck, Some(Servo::Roll | Servo::Pitch)).then_some(Condition::CyclicStuck);
        self.found().map(Condition::from).chain(cyclic).collect()
    }

    /// The failures found: the worst one, and a frozen position.
    pub fn found(&self) -> impl Iterator<Item = Failure> + use<> {
        let position = self.is_frozen.then_some(Failure::Position);
        position.into_iter().chain(self.worst.filter(|worst| Some(*worst) != position))
    }

    /// Whether the measured position does not follow the vehicle. It may do so again before it counts as frozen.
    pub fn is_position_stuck(&self) -> bool {
        self.is_frozen || self.position.path_m > FOLLOWS_WITHIN_M || self.position.off_the_ground_s > 0.0
    }

    /// Whether the measured position has frozen. It stays so.
    pub fn is_position_frozen(&self) -> bool {
        self.is_frozen
    }
}

/// Detects a rotor that slows down.
#[derive(Clone, Debug)]
struct RotorMonitor {
    lifts_at_rad_s: Option<f64>,
    was_at_speed: bool,
}

impl RotorMonitor {
    fn is_without_power(&mut self, measurement: &Measurement) -> bool {
        let Some((speed_rad_s, lifts_at_rad_s)) = measurement.rotor_speed_rad_s.zip(self.lifts_at_rad_s) else {
            return false;
        };
        self.was_at_speed |= speed_rad_s > AT_SPEED * lifts_at_rad_s;
        self.was_at_speed && speed_rad_s < lifts_at_rad_s
    }
}

/// Detects a position that repeats.
#[derive(Clone, Debug)]
struct Position {
    /// Height above the ellipsoid from which a vehicle is at the altitude of a formation, m: one on the ground cannot be there.
    in_air_from_m: f64,
    last: Option<Geodetic>,
    /// Path length flown since the position last changed, m.
    path_m: f64,
    /// Time for which the vehicle on the ground has repeated a position in the air, s.
    off_the_ground_s: f64,
}

impl Position {
    fn of(scenario: &Scenario) -> Self {
        let altitudes_m = scenario.mission.steps.iter().map(|step| step.formation.altitude_m);
        let lowest_m = altitudes_m.fold(scenario.formation.altitude_m, f64::min);
        // Over hills the ground may be as high as the formation: there it flies higher.
        let is_flat = scenario.airspace.floor_above_ground_m.is_none();
        let above_origin_m = if is_flat { lowest_m - BELOW_ALTITUDE_M } else { f64::INFINITY };
        let in_air_from_m = scenario.origin.geodetic().altitude_m + above_origin_m;
        Self { in_air_from_m, last: None, path_m: 0.0, off_the_ground_s: 0.0 }
    }

    fn restart(&mut self) {
        (self.last, self.path_m, self.off_the_ground_s) = (None, 0.0, 0.0);
    }

    fn is_frozen(&mut self, dt_s: f64, measurement: &Measurement) -> bool {
        let repeats = self.last == Some(measurement.position);
        self.last = Some(measurement.position);
        // A vehicle at rest on the ground repeats its position whatever a noisy sensor gives as its velocity.
        let speed_m_s = if measurement.height_m > FREE_ABOVE_M { measurement.velocity.0.norm() } else { 0.0 };
        self.path_m = if repeats { self.path_m + speed_m_s * dt_s } else { 0.0 };
        // The agent of a vehicle that landed with a frozen position may be another one: nothing moves, and only the heights
        // differ.
        let is_off_the_ground =
            repeats && measurement.height_m <= FREE_ABOVE_M && measurement.position.altitude_m >= self.in_air_from_m;
        self.off_the_ground_s = if is_off_the_ground { self.off_the_ground_s + dt_s } else { 0.0 };
        self.path_m > FROZEN_OVER_M || self.off_the_ground_s > OFF_THE_GROUND_S
    }
}

/// The actuator behind a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Control {
    Servo(Servo),
    Gyro,
}

/// Compares the expected response to each control with the measured one.
#[derive(Clone, Debug)]
struct ControlMonitor {
    trim: Controls,
    roll: Rate,
    pitch: Rate,
    yaw: Rate,
    climb: Climb,
}

impl ControlMonitor {
    /// The expected responses of a hover, from the flight model. Held cyclic gives the body rate at which the lag of
    /// the stabiliser bar keeps the disc level with the body, p = B δ/τ_e with τ_e = 16/(γ_fb Ω); pedals give a yaw
    /// rate; collective gives the climb at which momentum theory has the hover's thrust, w = (4/3) Ω R Δθ0.
    ///
    /// Lags and limits were tuned on the built-in helicopter: in 384 flights with steps, turns and transits at 7 m/s,
    /// in wind and gusts of up to 8 m/s, the sums of climb and yaw reach two thirds of their limits, and those of roll
    /// and pitch stay at zero.
    fn new(model: &Parameters, trim: Controls) -> Self {
        let Parameters { head, servos, .. } = model;
        let speed_rad_s = head.nominal_speed_rad_s;
        let rate_rad_s = |disc_rad: f64| disc_rad * head.flybar_lock_number * speed_rad_s / 16.0;
        let collective_range_rad = servos.max_collective_rad - servos.min_collective_rad;
        let climb_m_s = 4.0 / 3.0 * speed_rad_s * model.main_rotor.radius_m * collective_range_rad;
        let cyclic = |disc_rad: f64| Rate::new(rate_rad_s(disc_rad), 0.045, CumulativeSum::over(0.25, 0.05));
        Self {
            trim,
            roll: cyclic(head.lateral_flap_gain_rad_per_rad * model.lateral_throw_rad()),
            pitch: cyclic(head.longitudinal_flap_gain_rad_per_rad * model.longitudinal_throw_rad()),
            yaw: Rate::new(model.yaw_rate_rad_s(), 0.06, CumulativeSum::over(0.6, 1.2)),
            climb: Climb {
                gain_m_s: climb_m_s,
                expected_m_s: 0.0,
                measured_m_s: 0.0,
                excess: CumulativeSum::over(7.0, 15.0),
            },
        }
    }

    fn reset(&mut self) {
        self.roll.reset();
        self.pitch.reset();
        self.yaw.reset();
        self.climb.reset();
    }

    /// The worst actuator that does not follow its control.
    fn unresponsive(&mut self, dt_s: f64, measurement: &Measurement, controls: &Controls) -> Option<Control> {
        let Measurement { rates, velocity, attitude, height_m, .. } = measurement;
        let is_free = *height_m > FREE_ABOVE_M;
        // A leaning rotor carries the vehicle with part of its thrust; the air it leans into may add lift or not.
        let upright = (math::cos(attitude.roll_rad) * math::cos(attitude.pitch_rad)).max(MIN_UPRIGHT);
        let above_trim = controls.collective - self.trim.collective;
        let lift_above_trim =
            if above_trim > 0.0 { (controls.collective - self.trim.collective / upright).max(0.0) } else { above_trim };
        let climb = self.climb.is_wrong(dt_s, lift_above_trim, -velocity.down_m_s(), is_free);
        let lacks_tail = above_trim > TAIL_AT_STOP_OVER;
        let is_weak_left = lacks_tail || attitude.roll_rad < -WEATHERCOCKS_FROM_RAD;
        let is_weak_right = attitude.roll_rad > WEATHERCOCKS_FROM_RAD;
        let ignored_rad_s = [(is_weak_left, f64::NEG_INFINITY), (is_weak_right, f64::INFINITY)];
        let [from_rad_s, to_rad_s] = ignored_rad_s.map(|(is_weak, far_rad_s)| if is_weak { far_rad_s } else { 0.0 });
        let rates = [
            (&mut self.roll, controls.roll - self.trim.roll, rates.roll_rad_s, 0.0..0.0),
            (&mut self.pitch, controls.pitch - self.trim.pitch, rates.pitch_rad_s, 0.0..0.0),
            (&mut self.yaw, controls.yaw - self.trim.yaw, rates.yaw_rad_s, from_rad_s..to_rad_s),
        ];
        let [roll, pitch, yaw] = rates.map(|(rate, deflection, measured_rad_s, ignored_rad_s)| {
            if !is_free {
                rate.reset();
            }
            is_free && rate.differs(dt_s, deflection, measured_rad_s, ignored_rad_s)
        });
        let wrong = [
            (roll, Control::Servo(Servo::Roll)),
            (pitch, Control::Servo(Servo::Pitch)),
            (climb, Control::Servo(Servo::Collective)),
            (yaw, Control::Gyro),
        ];
        wrong.into_iter().find_map(|(is_wrong, control)| is_wrong.then_some(control))
    }
}

/// Detects a body rate that differs from its command.
#[derive(Clone, Debug)]
struct Rate {
    /// Body rate at full control, rad/s.
    gain_rad_s: f64,
    /// Lag of the vehicle's response, s.
    lag_s: f64,
    expected_rad_s: f64,
    /// Measured minus expected rate, smoothed, rad/s.
    difference_rad_s: f64,
    excess: CumulativeSum,
}

/// Smoothing time of the difference, s: longer than the vehicle's own oscillations.
const RATE_SMOOTHING_S: f64 = 0.6;

impl Rate {
    fn new(gain_rad_s: f64, lag_s: f64, excess: CumulativeSum) -> Self {
        Self { gain_rad_s, lag_s, expected_rad_s: 0.0, difference_rad_s: 0.0, excess }
    }

    /// A difference in the range `ignored_rad_s` is ignored: there the vehicle has no control authority left.
    fn differs(&mut self, dt_s: f64, deflection: f64, measured_rad_s: f64, ignored_rad_s: Range<f64>) -> bool {
        follow(&mut self.expected_rad_s, self.gain_rad_s * deflection, dt_s / self.lag_s);
        follow(&mut self.difference_rad_s, measured_rad_s - self.expected_rad_s, dt_s / RATE_SMOOTHING_S);
        let counts = !ignored_rad_s.contains(&self.difference_rad_s);
        self.excess.exceeds(dt_s, if counts { self.difference_rad_s.abs() } else { 0.0 })
    }

    fn reset(&mut self) {
        (self.expected_rad_s, self.difference_rad_s, self.excess.sum) = (0.0, 0.0, 0.0);
    }
}

/// Detects a wrong climb. The climb per collective depends on the airspeed, which is unknown, so only a climb in the
/// direction opposite to the command counts.
#[derive(Clone, Debug)]
struct Climb {
    /// Climb over the collective's whole travel, m/s.
    gain_m_s: f64,
    expected_m_s: f64,
    measured_m_s: f64,
    excess: CumulativeSum,
}

/// Time constant of heave in the hover, s.
const HEAVE_S: f64 = 1.2;
/// Smoothing time of the measured climb, s.
const CLIMB_SMOOTHING_S: f64 = 0.5;
/// Climb rate below which the vehicle neither climbs nor sinks, m/s.
const STILL_M_S: f64 = 0.1;

impl Climb {
    fn is_wrong(&mut self, dt_s: f64, above_trim: f64, measured_m_s: f64, is_free: bool) -> bool {
        // The ground stops a vehicle from sinking and helps it to climb.
        let above_trim = if is_free { above_trim } else { 2.0 * above_trim.max(0.0) };
        follow(&mut self.expected_m_s, self.gain_m_s * above_trim, dt_s / HEAVE_S);
        follow(&mut self.measured_m_s, measured_m_s, dt_s / CLIMB_SMOOTHING_S);
        let follows = self.measured_m_s * self.expected_m_s.signum() > STILL_M_S;
        self.excess.exceeds(dt_s, if follows { 0.0 } else { (self.expected_m_s - self.measured_m_s).abs() })
    }

    fn reset(&mut self) {
        (self.expected_m_s, self.measured_m_s, self.excess.sum) = (0.0, 0.0, 0.0);
    }
}

/// Sum over time of a value's excess over its normal level (the cumulative sum of Page, "Continuous Inspection
/// Schemes", 1954).
#[derive(Clone, Debug)]
struct CumulativeSum {
    normal: f64,
    /// Limit of the sum, in the value's unit times seconds.
    limit: f64,
    sum: f64,
}

impl CumulativeSum {
    fn over(normal: f64, limit: f64) -> Self {
        Self { normal, limit, sum: 0.0 }
    }

    fn exceeds(&mut self, dt_s: f64, value: f64) -> bool {
        self.sum = (self.sum + (value - self.normal) * dt_s).max(0.0);
        self.sum > self.limit
    }
}

/// One step of a first-order lag by a `share` of the difference.
fn follow(value: &mut f64, target: f64, share: f64) {
    *value += (target - *value) * share.min(1.0);
}

#[cfg(test)]
mod tests;
