//! A hover of an aircraft with its rule bases on the built-in flight model, to find rules that cannot fly it.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::fmt;

use nalgebra::Vector2;
use skein_common::frame::{Geodetic, Origin, wrap_rad};
use skein_common::id::VehicleId;
use skein_common::math;

use crate::aircraft::Aircraft;
use crate::control::{Rules, VehicleController};
use crate::estimate::Estimate;
use crate::helicopter::{BuiltInVehicle, Parameters, Start, TICK_S, Weather};
use crate::setpoint::{Setpoint, VELOCITY_PER_ERROR_PER_S};

/// The names of the axes, in the order of [`of_each_axis`].
pub const AXES: [&str; 4] = ["roll", "pitch", "heading", "collective"];

/// Duration of the hover, from the ground, s, and that of its end, in which it is measured.
const DURATION_S: f64 = 50.0;
const MEASURED_S: f64 = 15.0;
/// The place at which the vehicle has to hover: from its start north and east, m, altitude above it, m, and turn from its first
/// heading, rad.
const PLACE_NE_M: [f64; 2] = [3.0, -4.0];
const ALTITUDE_M: f64 = 20.0;
const TURNED_RAD: f64 = 0.8;

/// Height below which a vehicle has not taken off, m.
const ON_THE_GROUND_M: f64 = 2.0;

/// The figures of a hover, over its last seconds unless stated otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hover {
    /// Root mean square of the distance from the place, m.
    pub place_rms_m: f64,
    /// Root mean square of the altitude's error, m.
    pub altitude_rms_m: f64,
    /// Root mean square of the heading's error, degrees.
    pub heading_rms_deg: f64,
    /// Largest turn rate, degrees/s.
    pub turn_rate_deg_s: f64,
    /// Share of the time in which a control was at an end of its travel.
    pub saturation: f64,
    /// Largest tilt since take-off, degrees.
    pub tilt_deg: f64,
    /// Whether the vehicle was in the air at the end.
    pub is_airborne: bool,
}

/// Takes a figure from a hover.
type Figure = fn(&Hover) -> f64;

/// A figure of a hover with its largest value at which the hover holds: far from what usable rules need.
const LIMITS: [(&str, f64, &str, Figure); 6] = [
    ("distance", 4.0, "m", |hover| hover.place_rms_m),
    ("altitude error", 4.0, "m", |hover| hover.altitude_rms_m),
    ("heading error", 10.0, "°", |hover| hover.heading_rms_deg),
    ("turn rate", 30.0, "°/s", |hover| hover.turn_rate_deg_s),
    ("controls at their stops", 0.2, "of the time", |hover| hover.saturation),
    ("tilt", 60.0, "°", |hover| hover.tilt_deg),
];

impl Hover {
    /// The reason why the hover did not hold, with the figures beyond their limits; `None` if it held.
    pub fn fault(&self) -> Option<String> {
        if !self.is_airborne {
            return Some("the vehicle was on the ground at the end".to_string());
        }
        // NaN is beyond every limit.
        let holds = |limit: f64, value: f64| value <= limit;
        let beyond: Vec<String> = LIMITS
            .iter()
            .filter(|(_, limit, _, figure)| !holds(*limit, figure(self)))
            .map(|(name, limit, unit, figure)| format!("{name} {:.1} {unit} (at most {limit})", figure(self)))
            .collect();
        (!beyond.is_empty()).then(|| beyond.join(", "))
    }
}

impl fmt::Display for Hover {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { place_rms_m, altitude_rms_m, heading_rms_deg, turn_rate_deg_s, saturation, .. } = self;
        write!(
            f,
            "within {place_rms_m:.2} m and {altitude_rms_m:.2} m of altitude, heading within {heading_rms_deg:.1}°, at most \
             {turn_rate_deg_s:.1}°/s, controls at their stops {:.0} % of the time",
            100.0 * saturation
        )
    }
}

/// Flies a hover of this aircraft in calm air, from the ground, with exact estimates. `None` without a flight model.
pub fn hover(aircraft: &Aircraft, rules: &Rules, auto_trim: bool) -> Option<Hover> {
    let parameters = aircraft.helicopter.as_ref()?;
    let controller = VehicleController::new(rules.clone(), aircraft.trim, aircraft.gains, auto_trim);
    fly(parameters, controller)
}

/// Flies a hover for each axis: with its rules, and with the shipped ones for the other axes. `None` without a flight
/// model.
pub fn of_each_axis(aircraft: &Aircraft, rules: &Rules, auto_trim: bool) -> Option<[Hover; 4]> {
    let shipped = Rules::shipped();
    let of = |axis: usize| hover(aircraft, &shipped.with_axis_of(axis, rules), auto_trim);
    Some([of(0)?, of(1)?, of(2)?, of(3)?])
}

fn fly(parameters: &Parameters, mut controller: VehicleController) -> Option<Hover> {
    let origin = Origin::new(Geodetic::from_degrees(0.0, 0.0, 0.0));
    let calm = Weather { wind_m_s: 0.0, wind_from_rad: 0.0, gust_w20_m_s: 0.0 };
    let id = VehicleId::first(1).next()?;
    let mut vehicle = BuiltInVehicle::new(&origin, parameters, &Start::default(), &calm, 0, id);
    let place_ne_m = Vector2::from(PLACE_NE_M);
    let ticks = (DURATION_S / TICK_S) as u32;
    let measured_from = ((DURATION_S - MEASURED_S) / TICK_S) as u32;
    let (mut squares, mut count) = ([0.0; 3], 0.0);
    let (mut stopped, mut turn_rate_rad_s, mut tilt_rad) = (0.0, 0.0_f64, 0.0_f64);
    for tick in 0..ticks {
        let frame = vehicle.frame();
        let measured = &frame.measurement;
        let estimate = Estimate {
            position: frame.truth.position,
            geodetic: measured.position,
            height_m: measured.height_m,
            velocity: measured.velocity,
            attitude: measured.attitude,
            rates: measured.rates,
            rotor_speed_rad_s: measured.rotor_speed_rad_s,
        };
        let away_ne_m = place_ne_m - estimate.position.0.xy();
        let setpoint = Setpoint {
            relative_velocity_ne_m_s: away_ne_m * VELOCITY_PER_ERROR_PER_S,
            feedforward_ne_m_s: Vector2::zeros(),
            altitude_m: ALTITUDE_M,
            heading_rad: TURNED_RAD,
        };
        let controls = controller.step(TICK_S, &estimate, &setpoint).controls;
        let attitude = estimate.attitude;
        tilt_rad = tilt_rad.max(attitude.roll_rad.abs()).max(attitude.pitch_rad.abs());
        if tick >= measured_from {
            let heading_error_rad = wrap_rad(TURNED_RAD - attitude.heading_rad);
            let errors = [away_ne_m.norm(), estimate.position.altitude_m() - ALTITUDE_M, heading_error_rad];
            squares.iter_mut().zip(errors).for_each(|(sum, error)| *sum += math::square(error));
            turn_rate_rad_s = turn_rate_rad_s.max(estimate.rates.yaw_rad_s.abs());
            stopped += if controls.is_at_a_stop() { 1.0 } else { 0.0 };
            count += 1.0;
        }
        vehicle.advance(Some(controls));
    }
    let [place_rms_m, altitude_rms_m, heading_rms_rad] = squares.map(|sum| (sum / count).sqrt());
    Some(Hover {
        place_rms_m,
        altitude_rms_m,
        heading_rms_deg: heading_rms_rad.to_degrees(),
        turn_rate_deg_s: turn_rate_rad_s.to_degrees(),
        saturation: stopped / count,
        tilt_deg: tilt_rad.to_degrees(),
        is_airborne: vehicle.frame().truth.height_m > ON_THE_GROUND_M,
    })
}

#[cfg(test)]
mod tests;
