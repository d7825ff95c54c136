//! Steady flight.

use super::*;

fn net_tail_force_n(flight: &Flight) -> f64 {
    // In still air and at rest only the tail balances the main rotor's torque.
    let [.., speed, _, gyro, lateral, longitudinal, collective, lambda, lambda_t] = flight.state.0;
    let (a1, b1) = (flight.state.0[13], flight.state.0[14]);
    let state = main_rotor::MainRotorState {
        speed_rad_s: speed,
        collective_rad: collective,
        lateral_rad: lateral,
        longitudinal_rad: longitudinal,
        lambda,
        a1,
        b1,
    };
    let main = flight.dynamics.main_rotor.action(&state, CALM, CALM, 100.0, 1.0);
    let tail = flight.dynamics.tail.action((gyro, lambda_t), speed, CALM, CALM, 0.0);
    assert_within(1e-9, -tail.wrench.force.y, main.torque_n_m / flight.dynamics.tail.arm_m);
    -tail.wrench.force.y
}

#[test]
fn the_hover_trim_matches_the_reference() {
    let hover = Flight::trimmed(0.0);
    let attitude = hover.helicopter().attitude();
    assert_near(0.05, attitude.roll_rad.to_degrees(), 4.61);
    assert_near(0.05, attitude.pitch_rad.to_degrees(), 0.0);
    assert_near(0.002, hover.command.collective_rad, 0.0999);
    assert_near(0.002, (hover.command.collective_rad + 0.05) / 0.25, 0.600);
    assert_within(0.02, hover.state.0[17], 0.236);
    assert_within(0.02, net_tail_force_n(&hover), 7.11);
    assert_within(0.01, hover.helicopter().power_w(), 1182.0);
    assert_within(0.01, hover.helicopter().power_w() / 2000.0, 0.591);
    assert_near(0.002, hover.command.lateral_rad / 0.1, 0.0185);
    assert_near(0.002, hover.command.longitudinal_rad / 0.1, 0.0);
}

#[test]
fn the_forward_flight_trims_match_the_reference() {
    let trims = [0.0, 5.0, 10.0, 15.0, 20.0].map(|speed_m_s| Flight::trimmed(speed_m_s).helicopter());
    for (trim, power_w) in trims.iter().zip([1182.0, 1086.0, 1018.0, 1126.0, 1427.0]) {
        assert_within(0.03, trim.power_w(), power_w);
    }
    assert_within(0.03, trims[2].attitude().pitch_rad.to_degrees(), -4.10);
    assert_within(0.03, trims[2].attitude().roll_rad.to_degrees(), 4.00);
    assert_within(0.03, trims[4].attitude().pitch_rad.to_degrees(), -15.7);
    assert_near(1e-9, trims[4].velocity().north_m_s(), 20.0);
}

#[test]
fn power_is_least_between_8_and_13_m_s() {
    let speeds = (0..=40).map(|half| 0.5 * f64::from(half));
    let cheapest = speeds.min_by(|a, b| {
        Flight::trimmed(*a).helicopter().power_w().total_cmp(&Flight::trimmed(*b).helicopter().power_w())
    });
    assert!((8.0..=13.0).contains(&cheapest.unwrap()), "{cheapest:?}");
}

#[test]
fn the_start_has_the_inner_states_of_the_hover() {
    let State(start) = Helicopter::at_rest(&xcell60(), 1.0, 2.0, 30.0, 0.5).state;
    for (index, figure) in [(16, 29.56), (17, 0.236), (21, 0.0343), (22, 0.0847)] {
        assert_within(0.001, start[index], figure);
        // The closed form is compared with Newton's method on the complete model.
        assert_within(1e-6, start[index], Flight::trimmed(0.0).state.0[index]);
    }
    assert_eq!((start[0], start[1], start[15]), (1.0, 2.0, 167.0));
    assert_near(0.0005, -start[2] - 30.0, 0.242);
}

#[test]
fn a_hands_off_helicopter_holds_its_exact_trim() {
    let mut flight = Flight::trimmed(0.0);
    let start = flight.state;
    for _ in 0..2_000 {
        flight.advance();
        for (now, then) in flight.state.0.iter().zip(&start.0) {
            assert_near(1e-6, *now, *then);
        }
    }
}
