//! What an agent finds wrong with its own vehicle, from its own measurements and commands alone.
//!
//! | failure | found by |
//! | --- | --- |
//! | engine | the rotor, once at speed, turns too slowly to lift; not found where the plant tells no rotor speed |
//! | servo | roll or pitch rate is not what the stick asks for, or it climbs where it should sink, or sinks where it should climb |
//! | gyro | yaw rate is not what the pedals ask for |
//! | position | it repeats, bit for bit, while the velocity has led metres away from it |
//!
//! What the controls should do follows from the aircraft's flight model; of an aircraft without one only engine and
//! position are watched. A servo that sticks where it is wanted shows nothing, and is found when it is wanted elsewhere.

use skein_common::frame::Geodetic;
use skein_common::math;
use skein_common::message::Failure;
use skein_common::scenario::Servo;

use crate::aircraft::Aircraft;
use crate::failsafe::{Condition, Conditions};
use crate::helicopter::Parameters;
use crate::plant::{Measurement, Sticks};

/// A rotor was at speed if it turned faster than this, over the speed at which it lifts.
const AT_SPEED: f64 = 1.05;
/// Way that cannot have led back to the very same position, m: single precision in degrees has steps of up to 1.7 m.
const FROZEN_OVER_M: f64 = 2.0;
/// Below this height of the centre of gravity the ground may hold the vehicle, m.
const FREE_ABOVE_M: f64 = 1.5;
/// With so much collective beyond the hover's the main rotor's torque, and a wind of 14 m/s across, take the tail rotor to its
/// stop: a nose that is blown left, against the pedals, shows no broken gyro.
const TAIL_AT_STOP_OVER: f64 = 0.1;
/// The share of the thrust that carries a vehicle is not taken for less than this: it leans by 0.64 rad then.
const LEAST_UPRIGHT: f64 = 0.8;
/// No step counts for longer than this, s.
const LONGEST_STEP_S: f64 = 0.1;

/// Watches one vehicle. What it has found stays found.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    rotor: Rotor,
    controls: Option<Controls>,
    position: Position,
    worst: Option<Failure>,
    stuck: Option<Servo>,
    is_frozen: bool,
}

impl Diagnosis {
    /// Of a vehicle of this type, not yet flying.
    pub fn new(aircraft: &Aircraft) -> Self {
        let rotor = Rotor { lifts_at_rad_s: aircraft.take_off_rotor_rad_s(), was_at_speed: false };
        let controls = aircraft.helicopter.as_ref().map(|model| Controls::new(model, aircraft.trim.sticks()));
        Self { rotor, controls, position: Position::default(), worst: None, stuck: None, is_frozen: false }
    }

    /// Takes up a measurement that the estimator took for true, `dt_s` of the plant's time after the last, and what was
    /// commanded between the two. Gives what is newly found. Once something was found, only what is worse is looked for, and
    /// the position.
    pub fn update(&mut self, dt_s: f64, measurement: &Measurement, command: Option<Sticks>) -> Option<Failure> {
        let dt_s = dt_s.clamp(0.0, LONGEST_STEP_S);
        let deaf = match (&mut self.controls, command) {
            (Some(controls), Some(sticks)) => controls.deaf(dt_s, measurement, &sticks),
            _ => None,
        };
        let found = match deaf {
            _ if self.rotor.is_without_power(measurement) => Some(Failure::Engine),
            Some(Control::Servo(_)) => Some(Failure::Servo),
            Some(Control::Gyro) => Some(Failure::Gyro),
            None => None,
        };
        let is_frozen = self.position.is_frozen(dt_s, measurement);
        if found > self.worst {
            self.worst = found;
            self.stuck = match (found, deaf) {
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

    /// The vehicle may have been set elsewhere, at rest: what was seen so far says nothing of what comes. What has failed
    /// stays so.
    pub fn begin_anew(&mut self) {
        self.rotor.was_at_speed = false;
        self.position = Position::default();
        if let Some(controls) = &mut self.controls {
            controls.rest();
        }
    }

    /// What has failed, as the failsafe table knows it.
    pub fn conditions(&self) -> Conditions {
        let cyclic = matches!(self.stuck, Some(Servo::Roll | Servo::Pitch)).then_some(Condition::CyclicStuck);
        self.found().map(Condition::from).chain(cyclic).collect()
    }

    /// Everything that has failed, as far as it is looked for: the worst, and the position.
    pub fn found(&self) -> impl Iterator<Item = Failure> + use<> {
        let position = self.is_frozen.then_some(Failure::Position);
        position.into_iter().chain(self.worst.filter(|worst| Some(*worst) != position))
    }

    /// Whether the measured position has frozen. It stays so.
    pub fn is_position_frozen(&self) -> bool {
        self.is_frozen
    }
}

/// A rotor that slows down.
#[derive(Clone, Debug)]
struct Rotor {
    lifts_at_rad_s: Option<f64>,
    was_at_speed: bool,
}

impl Rotor {
    fn is_without_power(&mut self, measurement: &Measurement) -> bool {
        let Some((speed_rad_s, lifts_at_rad_s)) = measurement.rotor_speed_rad_s.zip(self.lifts_at_rad_s) else {
            return false;
        };
        self.was_at_speed |= speed_rad_s > AT_SPEED * lifts_at_rad_s;
        self.was_at_speed && speed_rad_s < lifts_at_rad_s
    }
}

/// A position that repeats.
#[derive(Clone, Debug, Default)]
struct Position {
    last: Option<Geodetic>,
    /// Way flown since it last changed, m.
    way_m: f64,
}

impl Position {
    fn is_frozen(&mut self, dt_s: f64, measurement: &Measurement) -> bool {
        let repeats = self.last == Some(measurement.position);
        self.last = Some(measurement.position);
        self.way_m = if repeats { self.way_m + measurement.velocity.0.norm() * dt_s } else { 0.0 };
        self.way_m > FROZEN_OVER_M
    }
}

/// What a stick moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Control {
    Servo(Servo),
    Gyro,
}

/// What each stick should do, against what the vehicle does.
#[derive(Clone, Debug)]
struct Controls {
    trim: Sticks,
    roll: Rate,
    pitch: Rate,
    yaw: Rate,
    climb: Climb,
}

impl Controls {
    /// From the flight model of a hover. A held cyclic stick asks for the body rate at which the lag of the stabiliser
    /// bar keeps the disc level with the body, p = B δ/τ_e with τ_e = 16/(γ_fb Ω); pedals ask for a yaw rate; collective
    /// for the climb in which momentum theory has the thrust of the hover, w = (4/3) Ω R Δθ0.
    ///
    /// Lags and limits were found on the built-in helicopter: 384 flights with steps, turns and transits at 7 m/s, in wind
    /// and gusts of up to 8 m/s, come to two thirds of the limits of climb and yaw and to none of those of roll and pitch.
    fn new(model: &Parameters, trim: Sticks) -> Self {
        let Parameters { head, servos, .. } = model;
        let speed_rad_s = head.nominal_speed_rad_s;
        let rate_rad_s = |gain: f64| gain * servos.cyclic_throw_rad * head.flybar_lock_number * speed_rad_s / 16.0;
        let collective_range_rad = servos.max_collective_rad - servos.min_collective_rad;
        let climb_m_s = 4.0 / 3.0 * speed_rad_s * model.main_rotor.radius_m * collective_range_rad;
        let cyclic = |gain: f64| Rate::new(rate_rad_s(gain), 0.045, Excess::over(0.25, 0.05));
        Self {
            trim,
            roll: cyclic(head.lateral_flap_gain_rad_per_rad),
            pitch: cyclic(head.longitudinal_flap_gain_rad_per_rad),
            yaw: Rate::new(model.gyro.max_rate_rad_s, 0.06, Excess::over(0.6, 1.2)),
            climb: Climb { gain_m_s: climb_m_s, expected_m_s: 0.0, done_m_s: 0.0, excess: Excess::over(7.0, 15.0) },
        }
    }

    fn rest(&mut self) {
        self.roll.rest();
        self.pitch.rest();
        self.yaw.rest();
        self.climb.rest();
    }

    /// The worst control that the vehicle does not follow.
    fn deaf(&mut self, dt_s: f64, measurement: &Measurement, sticks: &Sticks) -> Option<Control> {
        let Measurement { rates, velocity, attitude, height_m, .. } = measurement;
        let is_free = *height_m > FREE_ABOVE_M;
        // A rotor that leans carries the vehicle with a part of its thrust; the air that it leans into helps it, or does not.
        let upright = (math::cos(attitude.roll_rad) * math::cos(attitude.pitch_rad)).max(LEAST_UPRIGHT);
        let above_trim = sticks.collective - self.trim.collective;
        let lifts =
            if above_trim > 0.0 { (sticks.collective - self.trim.collective / upright).max(0.0) } else { above_trim };
        let climb = self.climb.is_wrong(dt_s, lifts, -velocity.down_m_s(), is_free);
        let lacks_tail = above_trim > TAIL_AT_STOP_OVER;
        let short_rad_s = if lacks_tail { f64::NEG_INFINITY } else { 0.0 };
        let rates = [
            (&mut self.roll, sticks.roll - self.trim.roll, rates.roll_rad_s, 0.0),
            (&mut self.pitch, sticks.pitch - self.trim.pitch, rates.pitch_rad_s, 0.0),
            (&mut self.yaw, sticks.yaw - self.trim.yaw, rates.yaw_rad_s, short_rad_s),
        ];
        let [roll, pitch, yaw] = rates.map(|(rate, stick, done_rad_s, short_rad_s)| {
            if !is_free {
                rate.rest();
            }
            is_free && rate.differs(dt_s, stick, done_rad_s, short_rad_s)
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

/// A stick that asks for a body rate.
#[derive(Clone, Debug)]
struct Rate {
    /// At full stick.
    gain_rad_s: f64,
    /// Of the machine.
    lag_s: f64,
    expected_rad_s: f64,
    /// Done less expected, smoothed.
    difference_rad_s: f64,
    excess: Excess,
}

/// Differences are smoothed over this time: the machine's own oscillations are faster, s.
const RATE_SMOOTHING_S: f64 = 0.6;

impl Rate {
    fn new(gain_rad_s: f64, lag_s: f64, excess: Excess) -> Self {
        Self { gain_rad_s, lag_s, expected_rad_s: 0.0, difference_rad_s: 0.0, excess }
    }

    /// A difference between `short_rad_s` and 0 does not count: there the machine has no authority left.
    fn differs(&mut self, dt_s: f64, stick: f64, done_rad_s: f64, short_rad_s: f64) -> bool {
        follow(&mut self.expected_rad_s, self.gain_rad_s * stick, dt_s / self.lag_s);
        follow(&mut self.difference_rad_s, done_rad_s - self.expected_rad_s, dt_s / RATE_SMOOTHING_S);
        let counts = !(short_rad_s..0.0).contains(&self.difference_rad_s);
        self.excess.adds_up(dt_s, if counts { self.difference_rad_s.abs() } else { 0.0 })
    }

    fn rest(&mut self) {
        (self.expected_rad_s, self.difference_rad_s, self.excess.sum) = (0.0, 0.0, 0.0);
    }
}

/// The collective. How much climb it gives depends on the air's speed, which is not known: only who climbs where it should
/// sink, or the other way round, counts.
#[derive(Clone, Debug)]
struct Climb {
    /// Over the collective's whole travel.
    gain_m_s: f64,
    expected_m_s: f64,
    done_m_s: f64,
    excess: Excess,
}

/// Time constant of heave in the hover, s.
const HEAVE_S: f64 = 1.2;
/// Of the measured climb, s.
const CLIMB_SMOOTHING_S: f64 = 0.5;
/// Slower than this it neither climbs nor sinks, m/s.
const STILL_M_S: f64 = 0.1;

impl Climb {
    fn is_wrong(&mut self, dt_s: f64, above_trim: f64, done_m_s: f64, is_free: bool) -> bool {
        // The ground holds whoever would sink, and helps whoever would climb.
        let above_trim = if is_free { above_trim } else { 2.0 * above_trim.max(0.0) };
        follow(&mut self.expected_m_s, self.gain_m_s * above_trim, dt_s / HEAVE_S);
        follow(&mut self.done_m_s, done_m_s, dt_s / CLIMB_SMOOTHING_S);
        let follows = self.done_m_s * self.expected_m_s.signum() > STILL_M_S;
        self.excess.adds_up(dt_s, if follows { 0.0 } else { (self.expected_m_s - self.done_m_s).abs() })
    }

    fn rest(&mut self) {
        (self.expected_m_s, self.done_m_s, self.excess.sum) = (0.0, 0.0, 0.0);
    }
}

/// What goes beyond the normal, added up over time (the cumulative sum of Page, "Continuous Inspection Schemes", 1954).
#[derive(Clone, Debug)]
struct Excess {
    normal: f64,
    /// Times seconds.
    limit: f64,
    sum: f64,
}

impl Excess {
    fn over(normal: f64, limit: f64) -> Self {
        Self { normal, limit, sum: 0.0 }
    }

    fn adds_up(&mut self, dt_s: f64, value: f64) -> bool {
        self.sum = (self.sum + (value - self.normal) * dt_s).max(0.0);
        self.sum > self.limit
    }
}

/// One step of a first-order lag, `share` of the way.
fn follow(value: &mut f64, target: f64, share: f64) {
    *value += (target - *value) * share.min(1.0);
}

#[cfg(test)]
mod tests;
