use core::f64::consts::{PI, TAU};
use skein_common::math;

use super::super::tests::points::{Points, laws};
use super::*;

const COUNT: usize = 5;
const GAIN_PER_S: f64 = 0.2;

/// Distance of the positions from the pattern, regardless of the pattern's position, m.
fn disagreement_m(points: &Points, slots: &[Vector2<f64>]) -> f64 {
    let offsets: Vec<_> = points.places_m.iter().zip(slots).map(|(place, slot)| place - slot).collect();
    let mean = offsets.iter().sum::<Vector2<f64>>() / offsets.len() as f64;
    offsets.iter().map(|offset| (offset - mean).norm_squared()).sum::<f64>().sqrt()
}

fn slots(lines: &str) -> Vec<Vector2<f64>> {
    let text = format!("swarm.vehicles = {COUNT}\n[formation]\n{lines}");
    let source = skein_common::scenario::Source { name: "test.toml", text: &text };
    let slots = Slots::of(&skein_common::scenario::load(&source, &[]).unwrap().scenario.formation);
    (0..COUNT).map(|rank| slots.slot_ne_m(rank, COUNT)).collect()
}

/// The theorem behind the law: displacements converge as exp(−k λ₂ t).
#[test]
fn the_convergence_rate_is_the_algebraic_connectivity_of_the_graph() {
    type Receives = fn(usize, usize) -> bool;
    let line: Receives = |one, other| one.abs_diff(other) == 1;
    let ring: Receives = |one, other| [1, COUNT - 1].contains(&one.abs_diff(other));
    let complete: Receives = |_, _| true;
    let n = COUNT as f64;
    let graphs = [
        ("line", line, 2.0 - 2.0 * math::cos(PI / n)),
        ("ring", ring, 2.0 - 2.0 * math::cos(TAU / n)),
        ("all", complete, n),
    ];
    let lines = format!(
        "law = 'displacement-consensus'\nslots = {{ pattern = 'line' }}\n\
         displacement_consensus = {{ gain_per_s = {GAIN_PER_S}, goal_gain_per_s = 0 }}"
    );
    for (name, receives, lambda_2) in graphs {
        let mut laws = laws(COUNT, &lines);
        let mut points = Points::scattered(COUNT, 100.0, 3);
        let slots = slots("slots.pattern = 'line'");
        let middle = |points: &Points| points.places_m.iter().sum::<Vector2<f64>>();
        let before = middle(&points);
        let unit_s = 1.0 / (GAIN_PER_S * lambda_2);
        points.fly(&mut laws, receives, 4.0 * unit_s);
        let first_m = disagreement_m(&points, &slots);
        points.fly(&mut laws, receives, 3.0 * unit_s);
        // The elapsed time is a whole number of steps.
        let passed_s = (3.0 * unit_s / 0.02).trunc() * 0.02;
        let rate_per_s = math::ln(first_m / disagreement_m(&points, &slots)) / passed_s;
        let share = rate_per_s / (GAIN_PER_S * lambda_2);
        assert!((share - 1.0).abs() < 0.02, "{name}: {rate_per_s} 1/s, {share} of k λ2");
        assert!((middle(&points) - before).norm() < 1e-6, "{name}: the mean position moves");
    }
}

#[test]
fn with_a_goal_gain_all_reach_their_slots_around_the_moving_centre_on_any_graph() {
    let lines = "law = 'displacement-consensus'\nslots = { pattern = 'v', spacing_m = 15 }\nheading_deg = 30";
    let slots = slots(lines);
    for receives in [|_, _| true, |_, _| false, |one: usize, other: usize| one.abs_diff(other) == 1] {
        let mut laws = laws(COUNT, lines);
        let mut points = Points::scattered(COUNT, 100.0, 4);
        points.goal.centre_velocity = skein_common::frame::VelocityNed::new(0.0, 2.0, 0.0);
        points.fly(&mut laws, receives, 120.0);
        for (place, slot) in points.places_m.iter().zip(&slots) {
            let off_m = place - slot - points.goal.centre.horizontal();
            assert!(off_m.norm() < 0.01, "{off_m}");
        }
        assert!(
            points
                .each(receives, |own, observation| laws[own].update(observation).reached)
                .into_iter()
                .all(|there| there)
        );
    }
}

#[test]
fn a_lost_vehicle_leaves_a_gap_that_no_vehicle_fills() {
    let mut laws = laws(COUNT, "law = 'displacement-consensus'");
    let mut points = Points::scattered(COUNT, 100.0, 5);
    let without_2 = |_, other| other != 1;
    points.fly(&mut laws, without_2, 200.0);
    for (nth, slot) in slots("").iter().enumerate().filter(|(nth, _)| *nth != 1) {
        assert!((points.places_m[nth] - slot).norm() < 0.01);
    }
}
