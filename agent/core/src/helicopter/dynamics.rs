//! The equations of motion: the state, its rate of change and the integration step.

use nalgebra::Vector3;

use super::body::{self, Body};
use super::drive::Drive;
use super::ground::Contact;
use super::main_rotor::{MainRotor, MainRotorState};
use super::parameters::Parameters;
use super::tail::Tail;

/// Length of one Runge-Kutta step, s. The fastest pole is −169 1/s, a third of the method's stability limit.
pub(super) const STEP_S: f64 = 0.005;

/// Smaller magnitudes are set to zero: a hands-off hover decays towards denormal numbers, which are slow.
const NEGLIGIBLE: f64 = 1e-30;

/// The 23 states, or their rates of change:
///
/// | index | states | |
/// | --- | --- | --- |
/// | 0–2 | north, east, down | position of the centre of gravity, m |
/// | 3–5 | u, v, w | velocity over the ground in body axes, m/s |
/// | 6–9 | q_w, q_x, q_y, q_z | attitude, unit quaternion from body to NED |
/// | 10–12 | p, q, r | body rates, rad/s |
/// | 13, 14 | a1, b1 | tilt of the main rotor's disc, back and right, rad |
/// | 15, 16 | Ω, w_i | main rotor speed, rad/s, and the governor's integral, rad |
/// | 17 | g_i | yaw gyro's integral, rad |
/// | 18–20 | δ_lat, δ_lon, θ0 | servos: blade pitch, rad |
/// | 21, 22 | λ, λ_t | inflow ratios of main and tail rotor |
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State(pub(super) [f64; 23]);

impl State {
    /// `self + dt · rate`.
    #[inline]
    fn plus(&self, dt: f64, rate: &Self) -> Self {
        let mut sum = *self;
        for (sum, rate) in sum.0.iter_mut().zip(&rate.0) {
            *sum += dt * rate;
        }
        sum
    }

    #[inline]
    fn with_unit_quaternion(mut self) -> Self {
        let quaternion = &mut self.0[6..10];
        let scale = 1.0 / quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
        quaternion.iter_mut().for_each(|part| *part *= scale);
        self
    }

    #[inline]
    fn without_negligible(mut self) -> Self {
        for value in &mut self.0 {
            if value.abs() < NEGLIGIBLE {
                *value = 0.0;
            }
        }
        self
    }
}

/// The commands to the servos and the yaw gyro.
#[derive(Clone, Copy, Debug)]
pub(super) struct Command {
    /// Commanded blade pitch δ_lat*, δ_lon*, θ0* of the servos, rad.
    pub(super) lateral_rad: f64,
    pub(super) longitudinal_rad: f64,
    pub(super) collective_rad: f64,
    /// Commanded yaw rate r_cmd, rad/s.
    pub(super) yaw_rate_rad_s: f64,
}

/// The constants of one helicopter in flight.
#[derive(Clone, Debug)]
pub(super) struct Dynamics {
    pub(super) main_rotor: MainRotor,
    pub(super) tail: Tail,
    pub(super) body: Body,
    pub(super) drive: Drive,
    contact: Contact,
    /// 1/τ of the three servos, 1/s; 0 for a stuck one.
    pub(super) inverse_servo_lags: [f64; 3],
    /// Down coordinate of the ground, m.
    pub(super) ground_down_m: f64,
}

impl Dynamics {
    pub(super) fn new(parameters: &Parameters, ground_altitude_m: f64) -> Self {
        Self {
            main_rotor: MainRotor::new(parameters),
            tail: Tail::new(parameters),
            body: Body::new(parameters),
            drive: Drive::new(parameters),
            contact: Contact::new(parameters),
            inverse_servo_lags: [1.0 / parameters.servos.lag_s; 3],
            ground_down_m: -ground_altitude_m,
        }
    }

    /// Advances by one step of the classical fourth-order Runge-Kutta method, with command and wind (NED, m/s) held.
    #[inline]
    pub(super) fn step(&self, state: &State, command: &Command, wind: &Vector3<f64>) -> State {
        let k1 = self.rates(state, command, wind);
        let k2 = self.rates(&state.plus(0.5 * STEP_S, &k1), command, wind);
        let k3 = self.rates(&state.plus(0.5 * STEP_S, &k2), command, wind);
        let k4 = self.rates(&state.plus(STEP_S, &k3), command, wind);
        let mut next = *state;
        for (i, value) in next.0.iter_mut().enumerate() {
            *value += STEP_S / 6.0 * (k1.0[i] + 2.0 * (k2.0[i] + k3.0[i]) + k4.0[i]);
        }
        // Drag stops a rotor without power but does not turn it backwards.
        next.0[15] = next.0[15].max(0.0);
        next.with_unit_quaternion().without_negligible()
    }

    /// The state's rate of change.
    pub(super) fn rates(&self, state: &State, command: &Command, wind: &Vector3<f64>) -> State {
        #[rustfmt::skip]
        let State([
            _, _, down, u, v, w, q_w, q_x, q_y, q_z, p, q, r, a1, b1, speed_rad_s, governor_integral, gyro_integral,
            lateral_rad, longitudinal_rad, collective_rad, lambda, lambda_t,
        ]) = *state;
        let velocity = Vector3::new(u, v, w);
        let rates = Vector3::new(p, q, r);
        let quaternion = [q_w, q_x, q_y, q_z];
        let ned_from_body = body::ned_from_body(quaternion);
        let air = velocity - ned_from_body.tr_mul(wind);
        let height_m = self.ground_down_m - down;

        let main_state = MainRotorState { speed_rad_s, collective_rad, lateral_rad, longitudinal_rad, lambda, a1, b1 };
        let main = self.main_rotor.action(&main_state, &air, &rates, height_m, ned_from_body.m33);
        let wake_m_s = self.body.wake_at_tail_m_s(&air, main.induced_m_s);
        let (theta_t, gyro_rate) = self.tail.gyro(command.yaw_rate_rad_s - r, gyro_integral);
        let tail = self.tail.action((theta_t, lambda_t), speed_rad_s, &air, &rates, wake_m_s);
        let throttle = self.drive.throttle(speed_rad_s, governor_integral);

        let mut sum = main.wrench;
        sum.force += self.body.fuselage(&air, main.induced_m_s);
        sum += self.body.stabiliser(&air, q, wake_m_s);
        sum += tail.wrench;
        if height_m < self.contact.reach_m {
            sum += self.contact.wrench(height_m, &velocity, &rates, &ned_from_body);
        }

        let over_ground = ned_from_body * velocity;
        let acceleration = self.body.acceleration(&sum.force, &velocity, &rates, &ned_from_body);
        let angular = self.body.angular_acceleration(&sum.moment, &rates);
        let turning = body::quaternion_rate(quaternion, &rates);
        let load_n_m = main.torque_n_m + tail.shaft_torque_n_m;
        State([
            over_ground.x,
            over_ground.y,
            over_ground.z,
            acceleration.x,
            acceleration.y,
            acceleration.z,
            turning[0],
            turning[1],
            turning[2],
            turning[3],
            angular.x,
            angular.y,
            angular.z,
            main.a1_rate,
            main.b1_rate,
            self.drive.shaft_acceleration(speed_rad_s, throttle.power_w, load_n_m),
            throttle.integral_rate,
            gyro_rate,
            (command.lateral_rad - lateral_rad) * self.inverse_servo_lags[0],
            (command.longitudinal_rad - longitudinal_rad) * self.inverse_servo_lags[1],
            (command.collective_rad - collective_rad) * self.inverse_servo_lags[2],
            main.lambda_rate,
            tail.lambda_rate,
        ])
    }
}
