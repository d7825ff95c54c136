//! The steady hover in still air: the initial values of the inner states.

use super::dynamics::Dynamics;
use super::rotor::HoveringRotor;

/// Inner states of a steady hover out of ground effect.
#[derive(Clone, Copy, Debug)]
pub(super) struct HoverState {
    /// Inflow ratios λ and λ_t of main and tail rotor.
    pub(super) lambda: f64,
    pub(super) lambda_t: f64,
    /// Tail blade pitch θ_t, rad, which is also the gyro's integral.
    pub(super) tail_pitch_rad: f64,
    /// The governor's integral at nominal speed, rad.
    pub(super) governor_integral: f64,
}

impl Dynamics<f64> {
    /// Solves the equations of motion for rest. The bank angle that balances the tail's side force reduces the weight
    /// the rotor carries by its cosine, which changes the thrust by 0.3 %: five iterations are enough.
    pub(super) fn hover(&self) -> HoverState {
        let sin_bank = (0..5).fold(0.0, |sin_bank, _| self.sin_bank(&self.hovering_main(sin_bank)));
        let main = self.hovering_main(sin_bank);
        let speed_rad_s = self.drive.nominal_speed_rad_s;
        let tail = self.tail.hovering(main.torque_n_m / self.tail.arm_m, speed_rad_s);
        let load_n_m = main.torque_n_m + self.tail.gear_ratio * tail.torque_n_m;
        HoverState {
            lambda: main.lambda,
            lambda_t: tail.lambda,
            tail_pitch_rad: tail.theta,
            governor_integral: self.drive.integral_for(load_n_m * speed_rad_s),
        }
    }

    /// Whether a hover exists within the engine's power and the tail rotor's pitch limits.
    pub(super) fn can_hover(&self) -> bool {
        let HoverState { lambda, lambda_t, tail_pitch_rad, governor_integral } = self.hover();
        let full_throttle = 1.0 / self.drive.integral_gain;
        let (lower_stop_rad, upper_stop_rad) = self.tail.stops_rad();
        lambda.is_finite()
            && lambda_t.is_finite()
            && (lower_stop_rad..upper_stop_rad).contains(&tail_pitch_rad)
            && (0.0..full_throttle).contains(&governor_integral)
    }

    /// The main rotor in the hover. It carries the weight and the drag of the fuselage in its own wake.
    fn hovering_main(&self, sin_bank: f64) -> HoveringRotor {
        let weight_n = self.body.weight_n() * (1.0 - sin_bank * sin_bank).sqrt();
        let rotor = &self.main_rotor.rotor;
        let thrust_n = weight_n / (1.0 - self.body.drag.z * rotor.induced_squared_per_thrust());
        rotor.hovering(thrust_n, self.drive.nominal_speed_rad_s)
    }

    /// Sine of the bank angle in the hover. The tail's force Q/l to the left is balanced by the weight's component m g
    /// sin φ and by the disc's T b1; the disc's tilt also balances the moment of the tail's force: (K_β + T h_mr) b1 =
    /// h_tr Q/l.
    fn sin_bank(&self, main: &HoveringRotor) -> f64 {
        let side_n = main.torque_n_m / self.tail.arm_m;
        let b1 = side_n * self.tail.height_m / self.main_rotor.stiffness(main.thrust_n);
        (side_n - main.thrust_n * b1) / self.body.weight_n()
    }
}
