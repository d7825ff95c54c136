//! The strongest wind in which the helicopter can hover: the trim's controls, power and tilt against their limits.
//!
//! `cargo test --release -p skein-agent --lib -- --nocapture wind_envelope` prints the table.

use core::f64::consts::TAU;

use super::*;

/// Extremes of the hover's trim in one wind over all directions.
#[derive(Clone, Copy, Debug)]
struct Needs {
    lowest_collective: f64,
    highest_collective: f64,
    /// Largest roll or pitch control, either sign.
    largest_cyclic: f64,
    lowest_tail_pitch_rad: f64,
    highest_tail_pitch_rad: f64,
    /// Largest lean relative to the hover in calm air, rad.
    largest_lean_rad: f64,
    largest_power_w: f64,
    /// Share of the main rotor's largest thrust coefficient.
    largest_thrust_share: f64,
}

/// The trim in a wind from this direction, clockwise from the nose, found in steps from the calm trim.
fn hover(dynamics: &Dynamics, speed_m_s: f64, from_rad: f64) -> Option<(Unknowns, State, ServoCommand)> {
    let (sin, cos) = math::sin_cos(from_rad);
    let velocity = |speed_m_s: f64| Vector::new(speed_m_s * cos, speed_m_s * sin, 0.0);
    let steps = (speed_m_s / 0.25) as u32;
    let unknowns =
        (0..=steps).try_fold(HOVER, |unknowns, step| solved(dynamics, velocity(0.25 * f64::from(step)), unknowns))?;
    let (state, command) = unpack(velocity(speed_m_s), &unknowns);
    Some((unknowns, state, command))
}

/// The needs of a hover in this wind; `None` if some direction has no trim.
fn needs(speed_m_s: f64) -> Option<Needs> {
    let parameters = xcell60();
    let (dynamics, controls) = (Dynamics::new(&parameters, -100.0), HeldControls::new(&parameters));
    let (calm, ..) = hover(&dynamics, 0.0, 0.0)?;
    let mut needs = Needs {
        lowest_collective: f64::INFINITY,
        highest_collective: 0.0,
        largest_cyclic: 0.0,
        lowest_tail_pitch_rad: f64::INFINITY,
        highest_tail_pitch_rad: f64::NEG_INFINITY,
        largest_lean_rad: 0.0,
        largest_power_w: 0.0,
        largest_thrust_share: 0.0,
    };
    for sixteenth in 0..16 {
        let (unknowns, state, command) = hover(&dynamics, speed_m_s, TAU * f64::from(sixteenth) / 16.0)?;
        let State([_, _, _, u, v, w, .., speed_rad_s, governor, tail_pitch_rad, _, _, collective_rad, lambda, _]) =
            state;
        let rotor = &dynamics.main_rotor.rotor;
        let flow = rotor.flow(speed_rad_s, u * u + v * v, w);
        let c_t = rotor.thrust_coefficient(collective_rad, lambda, &flow);
        let collective = (command.collective_rad - controls.min_collective_rad) / controls.collective_range_rad;
        let cyclic = command.lateral_rad.abs().max(command.longitudinal_rad.abs()) / controls.lateral_throw_rad;
        let lean_rad = math::hypot(unknowns[0] - calm[0], unknowns[1] - calm[1]);
        needs = Needs {
            lowest_collective: needs.lowest_collective.min(collective),
            highest_collective: needs.highest_collective.max(collective),
            largest_cyclic: needs.largest_cyclic.max(cyclic),
            lowest_tail_pitch_rad: needs.lowest_tail_pitch_rad.min(tail_pitch_rad),
            highest_tail_pitch_rad: needs.highest_tail_pitch_rad.max(tail_pitch_rad),
            largest_lean_rad: needs.largest_lean_rad.max(lean_rad),
            largest_power_w: needs.largest_power_w.max(dynamics.drive.throttle(speed_rad_s, governor).power_w),
            largest_thrust_share: needs.largest_thrust_share.max(c_t / parameters.main_rotor.max_thrust_coefficient),
        };
    }
    Some(needs)
}

/// Up to 12 m/s from any direction the hover's trim leaves a margin on every control and in power, and its lean is
/// below the 0.3 rad that the rules can command: in such winds the controller is the limit, not the helicopter.
#[test]
fn a_hover_in_12_m_s_of_wind_has_a_trim_with_room_on_every_control() {
    let parameters = xcell60();
    for speed_m_s in [0.0, 4.0, 8.0, 10.0, 12.0, 13.0, 14.0, 16.0, 18.0, 20.0] {
        let needs = needs(speed_m_s);
        println!("{speed_m_s:4.1} m/s: {needs:.3?}");
        if speed_m_s > 12.0 {
            continue;
        }
        let needs = needs.unwrap();
        assert!(needs.lowest_collective > 0.45 && needs.highest_collective < 0.65, "{speed_m_s} m/s: {needs:?}");
        assert!(needs.largest_cyclic < 0.5, "{speed_m_s} m/s: {needs:?}");
        assert!(needs.lowest_tail_pitch_rad > parameters.tail.min_pitch_rad + 0.05, "{speed_m_s} m/s: {needs:?}");
        assert!(needs.highest_tail_pitch_rad < parameters.tail.max_pitch_rad - 0.05, "{speed_m_s} m/s: {needs:?}");
        assert!(needs.largest_lean_rad < 0.3, "{speed_m_s} m/s: {needs:?}");
        assert!(needs.largest_power_w < 0.8 * parameters.engine.max_power_w, "{speed_m_s} m/s: {needs:?}");
    }
}
