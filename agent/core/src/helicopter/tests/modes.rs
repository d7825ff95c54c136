//! The modes of the hover: eigenvalues of the numerically linearised model.

use nalgebra::{Complex, DMatrix, Schur};
use skein_common::math;

use super::*;

/// Eigenvalues of a function of the state, linearised at the hover, in all states but the position; the quaternion's
/// redundant direction adds one.
fn eigenvalues_of(function: impl Fn(&Flight, &State) -> State) -> Vec<Complex<f64>> {
    let flight = Flight::trimmed(0.0);
    let step = 1e-6;
    let shifted = |i: usize, shift: f64| {
        let mut state = flight.state;
        state.0[i] += shift;
        function(&flight, &state)
    };
    let mut jacobian = DMatrix::zeros(20, 20);
    for column in 0..20 {
        let (up, down) = (shifted(column + 3, step), shifted(column + 3, -step));
        for row in 0..20 {
            jacobian[(row, column)] = (up.0[row + 3] - down.0[row + 3]) / (2.0 * step);
        }
    }
    // The iterations are limited so that a wrong model fails instead of hanging.
    let schur = Schur::try_new(jacobian, f64::EPSILON, 1_000).unwrap();
    schur.complex_eigenvalues().iter().copied().collect()
}

/// Eigenvalues of the equations, 1/s.
fn eigenvalues() -> Vec<Complex<f64>> {
    eigenvalues_of(|Flight { dynamics, command, .. }, state| dynamics.rates(state, command, CALM))
}

/// The eigenvalue nearest to this complex number.
fn nearest(eigenvalues: &[Complex<f64>], re: f64, im: f64) -> Complex<f64> {
    let distance = |value: &&Complex<f64>| math::hypot(value.re - re, value.im - im);
    *eigenvalues.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
}

/// Frequency and damping of the oscillation nearest to this frequency and damping.
fn oscillation(eigenvalues: &[Complex<f64>], omega: f64, zeta: f64) -> (f64, f64) {
    let value = nearest(eigenvalues, -zeta * omega, omega * (1.0 - zeta * zeta).sqrt());
    (math::hypot(value.re, value.im), -value.re / math::hypot(value.re, value.im))
}

#[test]
fn the_modes_of_the_hover_match_the_reference() {
    let eigenvalues = eigenvalues();
    for (tolerance, omega, zeta) in [(0.02, 20.17, 0.207), (0.02, 14.68, 0.284), (0.03, 1.58, 0.82)] {
        let (measured_omega, measured_zeta) = oscillation(&eigenvalues, omega, zeta);
        assert_within(tolerance, measured_omega, omega);
        assert_within(tolerance, measured_zeta, zeta);
    }
    let heave = nearest(&eigenvalues, -0.81, 0.0);
    assert_within(0.03, heave.re, -0.81);
    assert_eq!(heave.im, 0.0);
    for (re, im) in [(-0.037, 0.154), (-0.016, 0.157)] {
        let slow = nearest(&eigenvalues, re, im);
        assert_within(0.1, slow.re, re);
        assert_within(0.1, slow.im, im);
    }
    // The inflows determine the integration step.
    assert_within(0.02, nearest(&eigenvalues, -169.0, 0.0).re, -169.0);
    assert_within(0.02, nearest(&eigenvalues, -84.0, 0.0).re, -84.0);
}

/// What the integration makes of the modes: the eigenvalues of a tick are those of the equations, exp(s t).
#[test]
fn a_tick_has_the_modes_of_the_equations() {
    let ticked = eigenvalues_of(|Flight { dynamics, command, .. }, state| {
        dynamics.tick(state, command, CALM, &mut Stages::default())
    });
    for exact in eigenvalues().into_iter().filter(|exact| exact.im >= 0.0 && exact.norm() > 1e-3) {
        let turned = (exact * TICK_S).exp();
        let value = nearest(&ticked, turned.re, turned.im).ln() / TICK_S;
        let difference = (value - exact).norm() / exact.norm();
        println!("{exact:24.5} {value:24.5} {:9.5} %", 100.0 * difference);
        // What the inflows do by themselves has ended before the tick has: of it only the end is right.
        assert!(difference < 1e-3 || exact.re < -1.0 / TICK_S, "{value} instead of {exact}");
    }
}

#[test]
fn roll_and_flap_mode_is_that_of_a_mass_on_the_hub_spring() {
    let p = xcell60();
    let spring = p.head.hub_stiffness_n_m_per_rad + p.mass_kg * p.gravity_m_s2 * p.main_rotor.height_m;
    let flap_lag_s = 16.0 / (p.head.flybar_lock_number * p.head.nominal_speed_rad_s);
    assert_near(0.0005, flap_lag_s, 0.120);
    let omega = (spring / p.inertia.roll_kg_m2).sqrt();
    let zeta = 1.0 / (2.0 * flap_lag_s * omega);
    assert_near(0.05, omega, 20.1);
    let (measured_omega, measured_zeta) = oscillation(&eigenvalues(), omega, zeta);
    assert_within(0.02, measured_omega, omega);
    assert_within(0.02, measured_zeta, zeta);
}
