//! The tick's method against the classical fourth-order Runge-Kutta method with short steps.
//!
//! `cargo test --release -p skein-core --lib -- --nocapture helicopter::tests::integration` prints the measured figures.

use super::*;
use crate::helicopter::integration::Exponential;

/// The state after one tick in so many steps of the classical method.
fn classical_tick(flight: &Flight, mut state: State, steps: u32) -> State {
    let step_s = TICK_S / f64::from(steps);
    let rates = |state: &State| flight.dynamics.rates(state, &flight.command, CALM);
    for _ in 0..steps {
        let k1 = rates(&state);
        let k2 = rates(&state.plus(0.5 * step_s, &k1));
        let k3 = rates(&state.plus(0.5 * step_s, &k2));
        let k4 = rates(&state.plus(step_s, &k3));
        state = state.after(step_s, &k1, &k2, &k3, &k4).within_bounds();
    }
    state
}

/// The states of a flight after each of so many ticks.
fn flown(flight: &Flight, ticks: usize, tick: impl Fn(State) -> State) -> Vec<State> {
    core::iter::successors(Some(flight.state), |state| Some(tick(*state))).take(ticks + 1).collect()
}

/// A step of one command, by its name, and the states that respond to it, by their names and indices.
type Response = (&'static str, fn(&mut ServoCommand), &'static [(&'static str, usize)]);

const RESPONSES: [Response; 4] = [
    ("roll", |command| command.lateral_rad += 0.025, &[("p", 10), ("b1", 14), ("servo", 18)]),
    ("pitch", |command| command.longitudinal_rad += 0.025, &[("q", 11), ("a1", 13), ("servo", 19)]),
    ("yaw", |command| command.yaw_rate_rad_s = 1.0, &[("r", 12)]),
    ("climb", |command| command.collective_rad += 0.0125, &[("w", 5), ("rotor speed", 15), ("servo", 20)]),
];

/// For each state that responds: the largest difference from the classical method with steps of 1.25 ms at any tick of
/// four seconds, as a share of the state's largest change, of the tick's method and of the classical one with steps of
/// 5 ms.
fn differences(speed_m_s: f64) -> Vec<(String, [f64; 2])> {
    let mut rows = Vec::new();
    for (name, change, states) in RESPONSES {
        let mut flight = Flight::trimmed(speed_m_s);
        change(&mut flight.command);
        let by = |tick: &dyn Fn(State) -> State| flown(&flight, 200, tick);
        let exact = by(&|state| classical_tick(&flight, state, 16));
        let ways = [
            by(&|state| flight.dynamics.tick(&state, &flight.command, CALM, &mut Stages::default())),
            by(&|state| classical_tick(&flight, state, 4)),
        ];
        for &(state, i) in states {
            let largest = |from: &dyn Fn(usize) -> f64| {
                (0..exact.len()).map(|k| (exact[k].0[i] - from(k)).abs()).fold(0.0, f64::max)
            };
            let change = largest(&|_| flight.state.0[i]);
            let shares = ways.each_ref().map(|way| largest(&|k| way[k].0[i]) / change);
            rows.push((format!("{speed_m_s} m/s, {name}: {state}"), shares));
        }
    }
    rows
}

#[test]
fn step_responses_in_the_air_are_those_of_much_shorter_steps() {
    for (name, [ticked, classical]) in [0.0, 10.0, 20.0].into_iter().flat_map(differences) {
        println!("{name:32} {:8.4} % {:8.4} %", 100.0 * ticked, 100.0 * classical);
        assert!(ticked < 1e-3, "{name}: {ticked}");
    }
}

#[test]
fn a_tick_near_the_ground_is_that_of_much_shorter_steps() {
    // Dropped from the height of a hand, at collective 0.2: the skids touch at two different times.
    let mut flight = Flight::trimmed(0.0);
    flight.state.0[2] = 100.0 - 0.3;
    flight.command.collective_rad = 0.0;
    let ticked =
        flown(&flight, 50, |state| flight.dynamics.tick(&state, &flight.command, CALM, &mut Stages::default()));
    let exact = flown(&flight, 50, |state| classical_tick(&flight, state, 64));
    for i in 0..3 {
        let difference_m = ticked.iter().zip(&exact).map(|(a, b)| (a.0[i] - b.0[i]).abs()).fold(0.0, f64::max);
        assert!(difference_m < 1e-3, "{difference_m} m");
    }
}

#[test]
fn a_linear_state_is_exact_in_one_step_of_any_length() {
    for pole in [-1e-9, -0.1, -33.0, -169.0, -799.0] {
        let exponential = Exponential::new(TICK_S, pole);
        // ẏ = L (y − y₀) + N has the solution y₀ + N (exp(L t) − 1)/L.
        let exact = |t: f64| if pole > -1e-6 { t } else { (math::exp(pole * t) - 1.0) / pole };
        assert_within(1e-9, exponential.change([1.0; 4]), exact(TICK_S));
        for (stage, share) in [(1, 0.5), (2, 0.5), (3, 1.0)] {
            assert_within(1e-9, exponential.at(stage, 0.0, 1.0, 1.0), exact(share * TICK_S));
        }
    }
}

#[test]
fn a_servo_moves_exactly_as_its_lag_says() {
    let mut flight = Flight::trimmed(0.0);
    let target = flight.command.lateral_rad;
    flight.command.lateral_rad += 0.05;
    for tick in 1..=10 {
        flight.state = flight.dynamics.tick(&flight.state, &flight.command, CALM, &mut Stages::default());
        let moved = 1.0 - math::exp(-f64::from(tick) * TICK_S / 0.03);
        assert_near(1e-12, flight.state.0[18] - target, 0.05 * moved);
    }
}

#[test]
fn half_the_step_has_a_sixteenth_of_the_error() {
    let mut flight = Flight::trimmed(10.0);
    flight.command.lateral_rad += 0.025;
    flight.command.collective_rad += 0.0125;
    let stepped = |steps: u32| {
        let step_s = 0.08 / f64::from(steps);
        (0..steps).fold(flight.state, |state, _| {
            flight.dynamics.step(step_s, &state, &flight.command, CALM, &mut Stages::default())
        })
    };
    let exact = stepped(512);
    let error = |steps| {
        let state = stepped(steps);
        [5, 10, 11, 12, 21, 22].map(|i: usize| (state.0[i] - exact.0[i]).abs())
    };
    for (long, short) in error(16).into_iter().zip(error(32)) {
        println!("{long:e} {short:e}: {}", long / short);
        assert!(long / short > 12.0, "{long} and {short}");
    }
}
