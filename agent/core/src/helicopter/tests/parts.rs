//! Parts of the model that hover and trim do not reach, compared with figures worked out by hand from the equations.

use super::*;
use crate::helicopter::main_rotor::MainRotorState;
use crate::helicopter::rotor::Rotor;

fn dynamics() -> Dynamics {
    Dynamics::new(&xcell60(), 0.0)
}

/// ½ρ times an area, kg/m.
fn half_density(area_m2: f64) -> f64 {
    0.5 * 1.225 * area_m2
}

#[test]
fn thrust_stops_at_its_limit_and_inflow_at_its_floor() {
    let p = xcell60();
    let rotor = Rotor::new(&p, &p.main_rotor, 1.0);
    let still = rotor.flow(167.0, 0.0, 0.0);
    assert_within(0.002, rotor.thrust_n(rotor.thrust_coefficient(1.0, 0.0, &still), &still), 213.0);
    assert_within(0.002, rotor.thrust_n(rotor.thrust_coefficient(-1.0, 0.0, &still), &still), -213.0);
    // Sinking exactly as fast as the wake: without its floor, D would be zero.
    let sinking = rotor.flow(167.0, 0.0, 0.03 * 167.0 * 0.775);
    for c_t in [0.0021, -0.0021] {
        let momentum = c_t / 1.8;
        let floor = 0.3 * (0.0021_f64 / 1.8).sqrt() + 0.001;
        assert_near(1e-9, rotor.inflow(c_t, 0.03, &sinking).rate, (momentum / floor - 0.03) / 0.037);
    }
}

#[test]
fn a_stopped_rotor_has_finite_rates() {
    let mut flight = Flight::trimmed(20.0);
    flight.state.0[15] = 0.0;
    let rates = flight.dynamics.rates(&flight.state, &flight.command, CALM);
    assert!(rates.0.iter().all(|rate| rate.is_finite()), "{rates:?}");
}

#[test]
fn climbing_into_the_wind_tilts_the_disc_forward() {
    let main_rotor = dynamics().main_rotor;
    let state = MainRotorState {
        speed_rad_s: 167.0,
        collective_rad: 0.1,
        lateral_rad: 0.0,
        longitudinal_rad: 0.0,
        lambda: 0.03,
        a1: 0.0,
        b1: 0.0,
    };
    let a1_rate = |down| main_rotor.action(&state, Vector::new(15.0, 0.0, down), CALM, 100.0, 1.0).a1_rate;
    let (tip_m_s, flap_lag_s) = (167.0 * 0.775, 16.0 / (0.8 * 167.0));
    let mu: f64 = 15.0 / tip_m_s;
    let lift = 5.5 * 0.04764;
    let dz = 0.2 * 16.0 * mu * mu / ((1.0 - 0.5 * mu * mu) * (8.0 * mu + lift));
    assert_within(1e-3, a1_rate(-2.0) - a1_rate(0.0), -2.0 * dz / tip_m_s / flap_lag_s);
}

#[test]
fn gyro_and_governor_do_not_wind_up_at_their_stops() {
    let Dynamics { tail, drive, .. } = dynamics();
    for (error, integral, theta, rate) in [
        (1.0, 0.2, 0.3, 0.3),
        (1.0, 0.45, 0.45, 0.0),
        (-1.0, 0.45, 0.35, -0.3),
        (-1.0, -0.25, -0.25, 0.0),
        (1.0, -0.25, -0.15, 0.3),
    ] {
        let (measured_theta, measured_rate) = tail.gyro(error, integral);
        assert_near(1e-12, measured_theta, theta);
        assert_near(1e-12, measured_rate, rate);
    }
    // (speed, integral, power, rate): within, above pushed out, above coming back, below pushed out, below coming back.
    for (speed, integral, power_w, rate) in [
        (157.0, 20.0, 1000.0, 10.0),
        (157.0, 60.0, 2000.0, 0.0),
        (177.0, 60.0, 2000.0, -10.0),
        (177.0, 0.0, 0.0, 0.0),
        (157.0, -20.0, 0.0, 10.0),
    ] {
        let throttle = drive.throttle(speed, integral);
        assert_near(1e-9, throttle.power_w, power_w);
        assert_near(1e-9, throttle.integral_rate, rate);
    }
}

#[test]
fn the_body_obeys_euler_and_newton_in_turning_axes() {
    let body = dynamics().body;
    let free = body.angular_acceleration(CALM, Vector::new(1.0, 2.0, 3.0));
    let euler = Vector::new(0.06 * 6.0 / 0.18, 0.10 * 3.0 / 0.34, -0.16 * 2.0 / 0.28);
    assert_near(1e-12, (free - euler).norm(), 0.0);
    // Level at 10 m/s, turning right at 1 rad/s: in body axes the velocity turns to the left.
    let level = body::ned_from_body([1.0, 0.0, 0.0, 0.0]);
    let (velocity, turn) = (Vector::new(10.0, 0.0, 0.0), Vector::new(0.0, 0.0, 1.0));
    let acceleration = body.acceleration(CALM, velocity, turn, &level);
    assert_near(1e-12, (acceleration - Vector::new(0.0, -10.0, 9.81)).norm(), 0.0);
}

#[test]
fn the_wake_reaches_the_tail_between_its_two_skew_angles() {
    let body = dynamics().body;
    let wake = |u, w| body.wake_at_tail_m_s(Vector::new(u, 0.0, w), 4.4);
    // χ_i = 0.005/0.08 and χ_f = 0.265/0.08.
    assert_eq!((wake(-5.0, 0.0), wake(0.2, 0.0), wake(5.0, 4.4), wake(5.0, 6.0)), (0.0, 0.0, 0.0, 0.0));
    assert_near(1e-9, wake(5.0, 0.0), 1.5 * (5.0 / 4.4 - 0.0625) / 3.25 * 4.4);
    assert_near(1e-9, wake(5.0, 2.0), 1.5 * (5.0 / 2.4 - 0.0625) / 3.25 * 4.4);
    assert_near(1e-9, wake(20.0, 0.0), 1.5 * 4.4);
}

#[test]
fn stabiliser_and_fin_lift_until_they_stall() {
    let Dynamics { body, tail, .. } = dynamics();
    for (u, w, product) in [(10.0, 1.0, 31.0), (-10.0, 1.0, 31.0), (10.0, 5.0, 125.0), (10.0, -5.0, -125.0)] {
        let stabiliser = body.stabiliser(Vector::new(u, 0.0, w), 0.0, 0.0);
        let z = -half_density(0.01) * product;
        assert_near(1e-12, (stabiliser.force - Vector::new(0.0, 0.0, z)).norm(), 0.0);
        assert_near(1e-12, (stabiliser.moment - Vector::new(0.0, 0.71 * z, 0.0)).norm(), 0.0);
    }
    // A pitch rate moves the stabiliser down, and the wake blows on it from above.
    assert!(body.stabiliser(Vector::new(10.0, 0.0, 0.0), 0.5, 0.0).moment.y < 0.0);
    assert!(body.stabiliser(Vector::new(10.0, 0.0, 0.0), 0.0, 2.0).moment.y > 0.0);
    // A stopped tail rotor in flat pitch does not affect the fin.
    for (u, v, product) in [(0.0, 10.0, 100.0), (10.0, 2.0, 44.0), (10.0, 10.0, 200.0), (10.0, -10.0, -200.0)] {
        let fin = tail.action((0.0, 0.0), 0.0, Vector::new(u, v, 0.0), CALM, 0.0).wrench;
        assert_near(0.003, fin.force.y, -half_density(0.012) * product);
        assert_near(1e-12, fin.moment.z, -0.91 * fin.force.y);
        assert_near(1e-12, fin.moment.x, 0.08 * fin.force.y);
    }
}

#[test]
fn the_tail_rotor_resists_rolling_and_yawing() {
    let tail = dynamics().tail;
    let force = |rates: Vector<f64>| tail.action((0.2, 0.08), 167.0, CALM, rates, 0.0).wrench.force.y;
    let tip_m_s = 4.66 * 167.0 * 0.13;
    // Rolling right moves the hub right: more flow against the inflow, more thrust to the left.
    let per_m_s = 0.830 * 1.225 * 0.05309 * tip_m_s * (5.0 * 0.1420 / 4.0);
    assert_within(0.01, force(Vector::new(1.0, 0.0, 0.0)) - force(CALM), -per_m_s * 0.08);
    // Turning right moves the hub left.
    assert!(force(Vector::new(0.0, 0.0, 0.5)) > force(CALM));
}

#[test]
fn the_fuselage_is_dragged_by_air_and_wake() {
    let drag = dynamics().body.fuselage(Vector::new(3.0, 0.0, 8.0), 4.0);
    let expected = Vector::new(0.1 * 3.0, 0.0, 0.15 * 4.0) * -half_density(5.0);
    assert_near(1e-12, (drag - expected).norm(), 0.0);
}

#[test]
fn derived_figures() {
    let p = xcell60();
    let solidity = |rotor: &parameters::RotorParameters| 2.0 * rotor.chord_m / (core::f64::consts::PI * rotor.radius_m);
    assert_near(0.00001, solidity(&p.main_rotor), 0.04764);
    assert_near(0.0001, solidity(&p.tail_rotor), 0.1420);
    assert_within(0.01, 0.849 / (4.0 * dynamics().hover().lambda * 167.0), p.main_rotor.inflow_lag_s);
}
