//! A control law of one's own: all vehicles circle the centre, and each adjusts its speed to stay halfway between the
//! vehicle ahead and the vehicle behind.
//!
//! Pursuit on a circle, after J. Marshall, M. Broucke & B. Francis, "Formations of Vehicles in Cyclic Pursuit", IEEE
//! Trans. Automatic Control 49(11) (2004), with the vehicle ahead on the circle instead of the one with the next id.

use std::f64::consts::TAU;
use std::process::ExitCode;

use skein_lab::law::{Law, LawCommand, LawOutput, Laws, Observation, Setup, Vector2, math, number};

#[derive(Clone, Debug)]
struct Pursuit {
    speed_m_s: f64,
    homing_per_s: f64,
}

impl Pursuit {
    fn make(setup: &Setup<'_>) -> Result<Box<dyn Law>, String> {
        let speed_m_s = number(setup, "speed_m_s", 3.0)?;
        Ok(Box::new(Self { speed_m_s, homing_per_s: number(setup, "homing_per_s", 0.1)? }))
    }
}

impl Law for Pursuit {
    fn update(&mut self, observation: &Observation<'_>) -> LawOutput {
        let out_ne_m = observation.from_centre_ne_m();
        let bearing_rad = |from_centre: Vector2<f64>| math::atan2(from_centre.y, from_centre.x);
        let centre = observation.goal.centre.horizontal();
        let (mut ahead_rad, mut behind_rad) = (TAU, TAU);
        for neighbour in observation.neighbours {
            let gap_rad = bearing_rad(neighbour.position.horizontal() - centre) - bearing_rad(out_ne_m);
            ahead_rad = ahead_rad.min(gap_rad.rem_euclid(TAU));
            behind_rad = behind_rad.min((-gap_rad).rem_euclid(TAU));
        }
        let outward = out_ne_m.try_normalize(1e-6).unwrap_or(Vector2::x());
        let clockwise = Vector2::new(-outward.y, outward.x);
        let haste = (1.0 + ahead_rad - behind_rad).clamp(0.0, 2.0);
        let off_m = observation.goal.radius_m - out_ne_m.norm();
        let command = clockwise * (self.speed_m_s * haste) + outward * (self.homing_per_s * off_m);
        LawOutput { command: LawCommand::level(command), reached: off_m.abs() < 10.0 }
    }
}

fn main() -> ExitCode {
    skein_lab::cli::main_with(Laws::default().with("pursuit", Pursuit::make))
}
