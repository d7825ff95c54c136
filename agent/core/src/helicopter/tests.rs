//! Reference figures, signs and robustness of the flight model. Everything flies `deploy/aircraft/xcell60.toml`.

mod integration;
mod modes;
mod parts;
mod responses;
mod safety;
mod signs;
mod trim;
mod wind_envelope;

use nalgebra::{ArrayStorage, SMatrix, SVector};
use skein_common::math;

use super::*;

/// The aircraft file's `[helicopter]` table.
pub(super) fn xcell60() -> Parameters {
    #[derive(serde::Deserialize)]
    struct Aircraft {
        helicopter: Parameters,
    }
    let text = include_str!("../../../../deploy/aircraft/xcell60.toml");
    toml::from_str::<Aircraft>(text).unwrap().helicopter
}

impl BuiltInVehicle {
    /// The simulated helicopter.
    pub(crate) fn helicopter(&self) -> &Helicopter {
        &self.helicopter
    }
}

impl Dynamics {
    /// The state's rate of change.
    fn rates(&self, state: &State, command: &ServoCommand, wind: Vector<f64>) -> State {
        self.rates_and_inflows(state, command, wind).0
    }
}

const CALM: Vector<f64> = Vector::new(0.0, 0.0, 0.0);

/// Length of one integration step of a [`Flight`], s: a quarter of a tick.
const STEP_S: f64 = 0.005;

/// A helicopter flown step by step with blade commands instead of control deflections.
#[derive(Clone)]
struct Flight {
    dynamics: Dynamics,
    command: ServoCommand,
    state: State,
    time_s: f64,
}

impl Flight {
    /// A helicopter in steady flight north at this speed, 100 m above the ground.
    fn trimmed(speed_m_s: f64) -> Self {
        let dynamics = Dynamics::new(&xcell60(), -100.0);
        let velocity = Vector::new(speed_m_s, 0.0, 0.0);
        let unknowns = solved(&dynamics, velocity, HOVER).expect("a trim");
        let (state, command) = unpack(velocity, &unknowns);
        Self { dynamics, command, state, time_s: 0.0 }
    }

    fn advance(&mut self) {
        self.state = self.dynamics.step(STEP_S, &self.state, &self.command, CALM, &mut Stages::default());
        self.time_s += STEP_S;
    }

    /// The same as a [`Helicopter`], for its accessors.
    fn helicopter(&self) -> Helicopter {
        let (dynamics, controls) = (Arc::new(self.dynamics.clone()), HeldControls::new(&xcell60()));
        Helicopter { healthy: Arc::clone(&dynamics), dynamics, controls, state: self.state }
    }

    /// The samples of `value` at each step until `end_s`, with their times.
    fn record(&mut self, end_s: f64, value: impl Fn(&Self) -> f64) -> Vec<(f64, f64)> {
        let mut samples = vec![(self.time_s, value(self))];
        while self.time_s < end_s - 1e-9 {
            self.advance();
            samples.push((self.time_s, value(self)));
        }
        samples
    }
}

/// The unknowns of [`solved`]: roll, pitch, a1, b1, w_i, g_i, δ_lat, δ_lon, θ0, λ, λ_t.
type Unknowns = SVector<f64, 11>;

/// Starting values near a hover.
const HOVER: Unknowns =
    Unknowns::from_array_storage(ArrayStorage([[0.0, 0.0, 0.0, 0.0, 29.0, 0.2, 0.0, 0.0, 0.1, 0.03, 0.08]]));

/// The trim at this velocity (north, east, down) heading north, by Newton's method from `unknowns`.
fn solved(dynamics: &Dynamics, velocity: Vector<f64>, mut unknowns: Unknowns) -> Option<Unknowns> {
    for _ in 0..30 {
        let residual = residual(dynamics, velocity, &unknowns);
        let mut jacobian = SMatrix::<f64, 11, 11>::zeros();
        for i in 0..11 {
            let mut shifted = unknowns;
            shifted[i] += 1e-7;
            jacobian.set_column(i, &((self::residual(dynamics, velocity, &shifted) - residual) / 1e-7));
        }
        unknowns -= jacobian.lu().solve(&residual)?;
    }
    (residual(dynamics, velocity, &unknowns).amax() < 1e-9).then_some(unknowns)
}

/// Residual of the trim at this velocity (north, east, down), heading north: the rates of u to r, a1, b1, Ω, λ and λ_t,
/// which must vanish.
fn residual(dynamics: &Dynamics, velocity: Vector<f64>, unknowns: &Unknowns) -> SVector<f64, 11> {
    let (state, command) = unpack(velocity, unknowns);
    let State(rate) = dynamics.rates(&state, &command, CALM);
    SVector::from([3, 4, 5, 10, 11, 12, 13, 14, 15, 21, 22].map(|i: usize| rate[i]))
}

fn unpack(velocity: Vector<f64>, unknowns: &Unknowns) -> (State, ServoCommand) {
    let [roll, pitch, a1, b1, governor, gyro, lateral, longitudinal, collective, lambda, lambda_t] = unknowns.data.0[0];
    let ((sin_roll, cos_roll), (sin_pitch, cos_pitch)) = (math::sin_cos(0.5 * roll), math::sin_cos(0.5 * pitch));
    let quaternion = [cos_roll * cos_pitch, sin_roll * cos_pitch, cos_roll * sin_pitch, -sin_roll * sin_pitch];
    let velocity = body::ned_from_body(quaternion).to_body(velocity);
    let mut state = [0.0; 23];
    state[3..6].copy_from_slice(&[velocity.x, velocity.y, velocity.z]);
    state[6..10].copy_from_slice(&quaternion);
    state[13..].copy_from_slice(&[a1, b1, 167.0, governor, gyro, lateral, longitudinal, collective, lambda, lambda_t]);
    let command = ServoCommand {
        lateral_rad: lateral,
        longitudinal_rad: longitudinal,
        collective_rad: collective,
        yaw_rate_rad_s: 0.0,
    };
    (State(state), command)
}

/// Asserts that `value` is within the relative `share` of `target`.
#[track_caller]
fn assert_within(share: f64, value: f64, target: f64) {
    assert!((value - target).abs() <= share * target.abs(), "{value} is not within {share} of {target}");
}

/// Asserts that `value` is within `margin` of `target`.
#[track_caller]
fn assert_near(margin: f64, value: f64, target: f64) {
    assert!((value - target).abs() <= margin, "{value} is not within ±{margin} of {target}");
}
