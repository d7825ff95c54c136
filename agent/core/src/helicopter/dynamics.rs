//! The equations of motion: the state and its rate of change.

use super::body::{self, Body};
use super::drive::Drive;
use super::ground::Contact;
use super::main_rotor::{MainRotor, MainRotorState};
use super::parameters::Parameters;
use super::rotor::Inflow;
use super::tail::Tail;
use super::vector::Vector;
use crate::lanes::{Mask, Real, numbers};

/// Number of states.
pub(super) const STATES: usize = 23;

/// Smaller magnitudes are set to zero: a hands-off hover decays towards denormal numbers, which are slow.
const NEGLIGIBLE: f64 = 1e-30;

/// The states, or their rates of change:
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
pub(super) struct State<R = f64>(pub(super) [R; STATES]);

impl<R: Real> Default for State<R> {
    fn default() -> Self {
        Self([R::default(); STATES])
    }
}

/// Repeats a block for every index of the state. A loop over the states would be compiled to instructions that gather
/// one state of several vehicles from apart.
macro_rules! for_each_state {
    ($index:ident, $body:block) => {
        for_each_state!(@ $index, $body, 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22)
    };
    (@ $index:ident, $body:block, $($value:literal)*) => {
        $({
            const $index: usize = $value;
            $body
        })*
    };
}

impl<R: Real> State<R> {
    /// `self + dt · rate`.
    #[inline(always)]
    pub(super) fn plus(&self, dt: f64, rate: &Self) -> Self {
        let mut sum = *self;
        for_each_state!(I, {
            sum.0[I] = sum.0[I] + rate.0[I] * dt;
        });
        sum
    }

    /// The state after a step of the classical fourth-order Runge-Kutta method of this length, s, from the rates at its
    /// stages.
    #[inline(always)]
    pub(super) fn after(&self, step_s: f64, k1: &Self, k2: &Self, k3: &Self, k4: &Self) -> Self {
        let mut next = *self;
        for_each_state!(I, {
            next.0[I] = next.0[I] + (k1.0[I] + (k2.0[I] + k3.0[I]) * 2.0 + k4.0[I]) * (step_s / 6.0);
        });
        next
    }

    /// `yes` where the mask is set, `no` elsewhere.
    #[inline(always)]
    pub(super) fn select(mask: R::Mask, yes: &Self, no: &Self) -> Self {
        let mut selected = *no;
        for_each_state!(I, {
            selected.0[I] = R::select(mask, yes.0[I], no.0[I]);
        });
        selected
    }

    /// The same state with an attitude of length one, a rotor that does not turn backwards and without negligible
    /// values.
    #[inline(always)]
    pub(super) fn within_bounds(mut self) -> Self {
        // Drag stops a rotor without power but does not turn it backwards.
        self.0[15] = self.0[15].max(R::splat(0.0));
        let [w, x, y, z] = [self.0[6], self.0[7], self.0[8], self.0[9]];
        let scale = R::splat(1.0) / (w * w + x * x + y * y + z * z).sqrt();
        for_each_state!(I, {
            let value = if matches!(I, 6..10) { self.0[I] * scale } else { self.0[I] };
            self.0[I] = R::select(value.abs().lt(R::splat(NEGLIGIBLE)), R::splat(0.0), value);
        });
        self
    }
}

numbers! {
    /// The commands to the servos and the yaw gyro.
    #[derive(Clone, Copy, Debug, Default)]
    pub(super) struct ServoCommand<R> {
        /// Commanded blade pitch δ_lat*, δ_lon*, θ0* of the servos, rad.
        pub(super) lateral_rad: R,
        pub(super) longitudinal_rad: R,
        pub(super) collective_rad: R,
        /// Commanded yaw rate r_cmd, rad/s.
        pub(super) yaw_rate_rad_s: R,
    }
}

numbers! {
    /// The constants of one helicopter in flight.
    #[derive(Clone, Debug, Default)]
    pub(super) struct Dynamics<R> {
        pub(super) main_rotor: MainRotor<R>,
        pub(super) tail: Tail<R>,
        pub(super) body: Body<R>,
        pub(super) drive: Drive<R>,
        contact: Contact<R>,
        /// 1/τ of the three servos, 1/s; 0 for a stuck one.
        pub(super) inverse_servo_lags: [R; 3],
        /// Down coordinate of the ground, m.
        pub(super) ground_down_m: R,
    }
}

impl Dynamics<f64> {
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
}

impl<R: Real> Dynamics<R> {
    /// Height of the centre of gravity above the height at which the skids may touch the ground, m.
    #[inline(always)]
    pub(super) fn height_above_reach_m(&self, state: &State<R>) -> R {
        self.ground_down_m - state.0[2] - self.contact.reach_m
    }

    /// The poles of the servos, and of the inflow ratios of main and tail rotor, 1/s. A stuck servo does not move by any.
    #[inline(always)]
    pub(super) fn fast_poles(&self, [main, tail]: &[Inflow<R>; 2]) -> [R; 3] {
        let [lateral, longitudinal, collective] = self.inverse_servo_lags;
        let servos = lateral.max(longitudinal).max(collective);
        [-servos, self.main_rotor.rotor.inflow_pole(main), self.tail.rotor.inflow_pole(tail)]
    }

    /// The state's rate of change, and how the inflows of main and tail rotor change.
    #[inline(always)]
    pub(super) fn rates_and_inflows(
        &self,
        state: &State<R>,
        command: &ServoCommand<R>,
        wind: Vector<R>,
    ) -> (State<R>, [Inflow<R>; 2]) {
        #[rustfmt::skip]
        let State([
            _, _, down, u, v, w, q_w, q_x, q_y, q_z, p, q, r, a1, b1, speed_rad_s, governor_integral, gyro_integral,
            lateral_rad, longitudinal_rad, collective_rad, lambda, lambda_t,
        ]) = *state;
        let velocity = Vector::new(u, v, w);
        let rates = Vector::new(p, q, r);
        let quaternion = [q_w, q_x, q_y, q_z];
        let ned_from_body = body::ned_from_body(quaternion);
        let air = velocity - ned_from_body.to_body(wind);
        let height_m = self.ground_down_m - down;

        let main_state = MainRotorState { speed_rad_s, collective_rad, lateral_rad, longitudinal_rad, lambda, a1, b1 };
        let main = self.main_rotor.action(&main_state, air, rates, height_m, ned_from_body.down.z);
        let wake_m_s = self.body.wake_at_tail_m_s(air, main.induced_m_s);
        let (theta_t, gyro_rate) = self.tail.gyro(command.yaw_rate_rad_s - r, gyro_integral);
        let tail = self.tail.action((theta_t, lambda_t), speed_rad_s, air, rates, wake_m_s);
        let throttle = self.drive.throttle(speed_rad_s, governor_integral);

        let mut sum = main.wrench;
        sum.force += self.body.fuselage(air, main.induced_m_s);
        sum += self.body.stabiliser(air, q, wake_m_s);
        sum += tail.wrench;
        let near_ground = height_m.lt(self.contact.reach_m);
        if near_ground.any() {
            sum += self.contact.wrench(near_ground, height_m, velocity, rates, &ned_from_body);
        }

        let over_ground = ned_from_body.to_ned(velocity);
        let acceleration = self.body.acceleration(sum.force, velocity, rates, &ned_from_body);
        let angular = self.body.angular_acceleration(sum.moment, rates);
        let turning = body::quaternion_rate(quaternion, rates);
        let load_n_m = main.torque_n_m + tail.shaft_torque_n_m;
        let rates = State([
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
            main.inflow.rate,
            tail.inflow.rate,
        ]);
        (rates, [main.inflow, tail.inflow])
    }
}
