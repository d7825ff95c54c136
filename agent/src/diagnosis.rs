//! What an agent finds wrong with its own vehicle, from its own measurements and commands alone.
//!
//! | failure | found by |
//! | --- | --- |
//! | engine | the rotor, once at speed, turns too slowly to lift; not found where the plant tells no rotor speed |
//! | servo | roll, pitch or climb rate is not what the stick asks for |
//! | gyro | yaw rate is not what the pedals ask for |
//! | position | it repeats, bit for bit, while the velocity has led metres away from it |
//!
//! What the controls should do follows from the aircraft's flight model; of an aircraft without one only engine and
//! position are watched. A servo that sticks where it is wanted shows nothing, and is found when it is wanted elsewhere.

use skein_common::frame::Geodetic;
use skein_common::message::Failure;
use skein_common::scenario::Servo;

use crate::aircraft::Aircraft;
use crate::plant::helicopter::Parameters;
use crate::plant::{Measurement, Sticks};

/// A rotor was at speed if it turned faster than this, over the speed at which it lifts.
const AT_SPEED: f64 = 1.05;
/// Way that cannot have led back to the very same position, m: single precision in degrees has steps of up to 1.7 m.
const FROZEN_OVER_M: f64 = 2.0;
/// Below this height of the centre of gravity the ground may hold the vehicle, m.
const FREE_ABOVE_M: f64 = 1.5;
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

    /// The worst that has failed.
    pub fn worst(&self) -> Option<Failure> {
        self.worst
    }

    /// The servo that does not follow.
    pub fn stuck(&self) -> Option<Servo> {
        self.stuck
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
    roll: Channel,
    pitch: Channel,
    yaw: Channel,
    climb: Channel,
}

impl Controls {
    /// From the flight model of a hover: a held cyclic stick asks for the body rate at which the stabiliser bar's lag
    /// lets the disc stay level with the body, p = B δ/τ_e with τ_e = 16/(γ_fb Ω); pedals for a yaw rate; a collective
    /// above trim for the climb at which momentum theory gives the thrust of the hover, w = (4/3) Ω R Δθ0.
    ///
    /// The limits are twice what normal flights in gusts of W20 = 8 m/s and transits at 7 m/s against them showed.
    fn new(model: &Parameters, trim: Sticks) -> Self {
        let Parameters { head, servos, .. } = model;
        let speed_rad_s = head.nominal_speed_rad_s;
        let rate_rad_s = |gain: f64| gain * servos.cyclic_throw_rad * head.flybar_lock_number * speed_rad_s / 16.0;
        let collective_range_rad = servos.max_collective_rad - servos.min_collective_rad;
        let climb_m_s = 4.0 / 3.0 * speed_rad_s * model.main_rotor.radius_m * collective_range_rad;
        let cyclic = |gain: f64| Channel::new(rate_rad_s(gain), 0.045, 0.6, 0.4);
        Self {
            trim,
            roll: cyclic(head.lateral_flap_gain_rad_per_rad),
            pitch: cyclic(head.longitudinal_flap_gain_rad_per_rad),
            yaw: Channel::new(model.gyro.max_rate_rad_s, 0.06, 0.6, 0.6),
            climb: Channel::new(climb_m_s, 1.2, 1.0, 9.0),
        }
    }

    /// The worst control that the vehicle does not follow.
    fn deaf(&mut self, dt_s: f64, measurement: &Measurement, sticks: &Sticks) -> Option<Control> {
        let Measurement { rates, velocity, height_m, .. } = measurement;
        let climb = sticks.collective - self.trim.collective;
        if *height_m < FREE_ABOVE_M {
            // The ground holds attitude and heading, and whoever would sink.
            [&mut self.roll, &mut self.pitch, &mut self.yaw].into_iter().for_each(Channel::rest);
            let is_deaf = self.climb.differs(dt_s, climb.max(0.0), -velocity.down_m_s());
            return is_deaf.then_some(Control::Servo(Servo::Collective));
        }
        let differ = [
            (self.roll.differs(dt_s, sticks.roll - self.trim.roll, rates.roll_rad_s), Control::Servo(Servo::Roll)),
            (self.pitch.differs(dt_s, sticks.pitch - self.trim.pitch, rates.pitch_rad_s), Control::Servo(Servo::Pitch)),
            (self.climb.differs(dt_s, climb, -velocity.down_m_s()), Control::Servo(Servo::Collective)),
            (self.yaw.differs(dt_s, sticks.yaw - self.trim.yaw, rates.yaw_rad_s), Control::Gyro),
        ];
        differ.into_iter().find_map(|(differs, control)| differs.then_some(control))
    }
}

/// One stick: what it asks for follows it with a lag, and what the vehicle does is compared with that over a while.
#[derive(Clone, Debug)]
struct Channel {
    /// Of full stick.
    gain: f64,
    lag_s: f64,
    /// Of the comparison.
    while_s: f64,
    limit: f64,
    expected: f64,
    /// Done less expected.
    difference: f64,
}

impl Channel {
    fn new(gain: f64, lag_s: f64, while_s: f64, limit: f64) -> Self {
        Self { gain, lag_s, while_s, limit, expected: 0.0, difference: 0.0 }
    }

    fn differs(&mut self, dt_s: f64, stick: f64, done: f64) -> bool {
        let share = |over_s: f64| (dt_s / over_s).min(1.0);
        self.expected += (self.gain * stick - self.expected) * share(self.lag_s);
        self.difference += (done - self.expected - self.difference) * share(self.while_s);
        self.difference.abs() > self.limit
    }

    fn rest(&mut self) {
        (self.expected, self.difference) = (0.0, 0.0);
    }
}

#[cfg(test)]
mod tests;
