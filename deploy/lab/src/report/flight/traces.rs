//! Draws quantities over time.

use std::f64::consts::PI;

use skein_common::math;
use skein_common::scenario::{AvoidDistance, Formation, Law, SafetyFilter, Target};

use super::marks::with_marks;
use super::{Flight, is_flying_member, level_m, radii_m};
use crate::metrics::{AIRBORNE_ABOVE_M, COLLISION_M};
use crate::report::figure::{Axis, Colour, Drawing, Item, Mark, Panel, Shape};

/// Most pairs that have a line each.
const FEW_PAIRS: usize = 10;
/// Time over which the root mean square of the controls is taken, s.
const EFFORT_S: f64 = 5.0;
/// Number of bars of a histogram.
const BARS: usize = 48;

/// The panel with the distance of each vehicle from the formation's centre, and the band (the paper's figures 6 and 9).
pub(super) fn centre_distance_panel(flight: &Flight<'_>) -> Panel {
    let scenario = flight.scenario();
    let was_round = (0..flight.times_s.len()).all(|at| flight.formation(at).is_none_or(|flown| flown.gamma == 1.0));
    let is_round = was_round && scenario.mission.steps.iter().all(|leg| leg.formation.gamma == 1.0);
    let quantity = if is_round { "distance from the centre" } else { "ρ, level of the ellipse" };
    let mut panel = Panel::new(flight.time_axis(), Axis::new(quantity, "m").including(0.0));
    panel.items = band(flight);
    panel.items.extend(flight.lines(|trace| level_m(scenario, trace).filter(|_| is_flying_member(trace))));
    panel
}

/// The band of the swarm's step over time.
fn band(flight: &Flight<'_>) -> Vec<Item> {
    let radii = |sample| {
        let leg = flight.leading_step(sample).and_then(|step| flight.leg(step));
        let flies = leg.is_some_and(|leg| !matches!(leg.target, Target::Land(_)));
        flight.formation(sample).filter(|_| flies).map_or([None; 3], |formation| radii_m(&formation))
    };
    let radii: Vec<_> = (0..flight.times_s.len()).map(radii).collect();
    let [inner, middle, outer] = [0, 1, 2].map(|nth| flight.over_time(radii.iter().map(|radii| radii[nth])));
    let mut items = Vec::new();
    let is_ring = !inner.is_empty();
    if is_ring {
        let between =
            |(low, high): (&Vec<[f64; 2]>, &Vec<[f64; 2]>)| low.iter().chain(high.iter().rev()).copied().collect();
        let area = inner.iter().zip(&outer).map(between).collect();
        items.push(Item::new(Shape::Area(area), Colour::PALE.faint(0.6)).in_legend("band, R_in to R_out"));
        let edge = |line, name: &str| Item::line(line, Colour::GREY).wide(0.9).on_line(name);
        items.push(edge(outer, "R_out"));
        items.push(edge(inner, "R_in"));
    }
    items.push(Item::line(middle, Colour::BLACK).wide(1.2).dashed().on_line("R*"));
    items
}

pub(super) fn centre_distance(flight: &Flight<'_>) -> Drawing {
    let panel = with_marks(flight, centre_distance_panel(flight));
    let (panel, marked) = panel;
    let caption = format!(
        "Distance of every member from its own estimate of the formation's centre, in the metric in which the ellipse is R*. A line for each vehicle has its number at its end; of many vehicles the least, the median and the largest value are drawn.{marked}"
    );
    flight.figure("centre-distance", "Distance from the centre", caption, 400.0, vec![panel])
}

/// The panel with the distance of every pair (the paper's figure 7).
pub(super) fn pair_distance_panel(flight: &Flight<'_>) -> Panel {
    let mut panel = Panel::new(flight.time_axis(), Axis::new("distance apart", "m").including(0.0));
    panel.items = even_distances(flight);
    panel.items.extend(limit_distances(flight));
    let count = flight.count();
    if count * (count.max(1) - 1) / 2 > FEW_PAIRS {
        panel.items.extend(flight.envelope("pairs", |sample| pairs_m(flight, sample)));
        return panel;
    }
    let pairs = (0..count).flat_map(|one| (one + 1..count).map(move |other| (one, other)));
    for (nth, (one, other)) in pairs.enumerate() {
        let distances = (0..flight.times_s.len()).map(|sample| pair_m(flight, sample, one, other));
        let name = format!("{}–{}", flight.id(one), flight.id(other));
        panel.items.push(Item::line(flight.over_time(distances), Colour::nth(nth)).marked(nth).at_end(name));
    }
    panel
}

/// The distances on an evenly spread ring; none unless the ring is a circle in one place.
fn even_distances(flight: &Flight<'_>) -> Vec<Item> {
    let formation = &flight.scenario().formation;
    let count = flight.count();
    let is_known = flight.has_one_place() && formation.law == Law::Ring && formation.gamma == 1.0;
    if !is_known || !(2..=5).contains(&count) {
        return Vec::new();
    }
    let radii_m = flown(flight, |formation| Some(formation.radius_m).filter(|_| formation.gamma == 1.0));
    let line = |chords: usize| {
        let per_radius = 2.0 * math::sin(PI * chords as f64 / count as f64);
        let distances_m = radii_m.iter().map(|radius_m| radius_m.map(|radius_m| radius_m * per_radius));
        let line = Item::line(flight.level_over_time(distances_m), Colour::BLACK);
        line.wide(1.0).dashed().on_line("evenly spread on R*")
    };
    (1..=count / 2).map(line).collect()
}

/// A value of the formation at each sample, where no vehicle flies as the next or the last one had it.
fn flown(flight: &Flight<'_>, value: impl Fn(&Formation) -> Option<f64>) -> Vec<Option<f64>> {
    let first = (0..flight.times_s.len()).find_map(|sample| flight.formation(sample));
    let mut last = value(first.as_deref().unwrap_or(&flight.scenario().formation));
    let mut at = |sample| {
        last = flight.formation(sample).map_or(last, |formation| value(&formation));
        last
    };
    (0..flight.times_s.len()).map(&mut at).collect()
}

/// The distances that no pair may have: that of a collision, and that which the safety filter keeps.
fn limit_distances(flight: &Flight<'_>) -> Vec<Item> {
    let (Some(from_s), Some(to_s)) = (flight.times_s.first(), flight.times_s.last()) else { return Vec::new() };
    let line = |distance_m: f64, name: String| {
        let line = vec![vec![[*from_s, distance_m], [*to_s, distance_m]]];
        Item::line(line, Colour::VERMILLION).wide(1.0).dashed().on_line(name)
    };
    let safety = safety_distances(flight).map(|distances_m| {
        let (first, last) = (distances_m.first().copied().flatten(), distances_m.last().copied().flatten());
        let name = match first.filter(|_| first == last) {
            Some(distance_m) => format!("safety distance, {distance_m} m"),
            None => "safety distance".to_owned(),
        };
        let line = Item::line(flight.level_over_time(distances_m.into_iter()), Colour::VERMILLION);
        line.wide(1.0).dashed().on_line(name)
    });
    safety.into_iter().chain([line(COLLISION_M, format!("collision, {COLLISION_M} m"))]).collect()
}

/// The distance that the safety filter keeps at each sample, m; `None` without a filter.
fn safety_distances(flight: &Flight<'_>) -> Option<Vec<Option<f64>>> {
    let is_filtered = flight.scenario().formation.safety_filter != SafetyFilter::None;
    is_filtered.then(|| flown(flight, |formation| Some(formation.safety_distance_m)))
}

pub(super) fn pair_distance(flight: &Flight<'_>) -> Option<Drawing> {
    if flight.count() < 2 {
        return None;
    }
    let (panel, marked) = with_marks(flight, pair_distance_panel(flight));
    let caption = format!("True distance, in three dimensions, of every two members that have not landed.{marked}");
    Some(flight.figure("pair-distance", "Distance between vehicles", caption, 400.0, vec![panel]))
}

fn pair_m(flight: &Flight<'_>, sample: usize, one: usize, other: usize) -> Option<f64> {
    let position = |index: usize| {
        let trace = &flight.seen[index].get(sample).copied().flatten()?.trace;
        is_flying_member(trace).then_some(trace.position)
    };
    Some((position(one)? - position(other)?).norm())
}

fn pairs_m(flight: &Flight<'_>, sample: usize) -> Vec<f64> {
    let members: Vec<_> = flight.members(sample).map(|(_, trace)| trace.position).collect();
    let pairs = members.iter().enumerate().flat_map(|(nth, one)| members[..nth].iter().map(move |other| (one, other)));
    pairs.map(|(one, other)| (*one - *other).norm()).collect()
}

/// Draws a histogram of the distance from each airborne vehicle to the nearest other one.
pub(super) fn separations(flight: &Flight<'_>) -> Option<Drawing> {
    let nearest_m = |sample: usize| {
        let high: Vec<_> = flight
            .at(sample)
            .filter(|(_, trace)| trace.height_m > AIRBORNE_ABOVE_M)
            .map(|(_, trace)| trace.position)
            .collect();
        let of = |nth: usize| {
            let others = high.iter().enumerate().filter(|(other, _)| *other != nth);
            others.map(|(_, other)| (*other - high[nth]).norm()).reduce(f64::min)
        };
        (0..high.len()).filter_map(of).collect::<Vec<_>>()
    };
    let all_m: Vec<f64> = (0..flight.times_s.len()).flat_map(nearest_m).collect();
    let least_m = all_m.iter().copied().reduce(f64::min)?;
    let mut panel = histogram(&all_m, Axis::new("distance to the nearest vehicle", "m").including(0.0));
    panel.marks.push(Mark { x: COLLISION_M, text: format!("collision, {COLLISION_M} m") });
    let formation = &flight.scenario().formation;
    if let Some(distances_m) = safety_distances(flight) {
        let mut all_m: Vec<f64> = distances_m.into_iter().flatten().collect();
        // A value that was set in flight is marked as it was at the beginning and at the end.
        let ends_m = [all_m.first().copied(), all_m.pop()];
        let mark = |x: f64| Mark { x, text: format!("safety distance, {x} m") };
        panel.marks.extend(ends_m[0].map(mark));
        panel.marks.extend(ends_m[1].filter(|_| ends_m[0] != ends_m[1]).map(mark));
    }
    if let AvoidDistance::Fixed(distance_m) = formation.avoid_distance_m {
        panel.marks.push(Mark { x: distance_m, text: format!("avoidance at half strength, {distance_m} m") });
    }
    panel.marks.sort_by(|one, other| one.x.total_cmp(&other.x));
    let caption = format!(
        "Distance from every vehicle above {AIRBORNE_ABOVE_M} m to the nearest other one, over the whole flight. The least is {least_m:.1} m."
    );
    Some(flight.figure("separation", "Distance to the nearest vehicle", caption, 340.0, vec![panel]))
}

/// A histogram of values, in percent of all samples.
pub(super) fn histogram(values: &[f64], x: Axis) -> Panel {
    let (from, to) = values.iter().fold((0.0_f64, 0.0_f64), |(from, to), value| (from.min(*value), to.max(*value)));
    let width = if to > from { (to - from) / BARS as f64 } else { 1.0 / BARS as f64 };
    let mut counts = [0_usize; BARS];
    for value in values {
        counts[(((value - from) / width) as usize).min(BARS - 1)] += 1;
    }
    let bar = |(nth, count): (usize, &usize)| {
        let left = from + nth as f64 * width;
        ([left, 0.0], [left + 0.92 * width, 100.0 * *count as f64 / values.len() as f64], String::new())
    };
    let bars = counts.iter().enumerate().filter(|(_, count)| **count > 0).map(bar).collect();
    let mut panel = Panel::new(x, Axis::new("share of samples", "%").including(0.0));
    panel.items.push(Item::new(Shape::Bars(bars), Colour::BLUE).meaning("Bars: the share of samples in each interval"));
    panel
}

/// Draws the altitude of every vehicle, and the altitude setpoint.
pub(super) fn altitude(flight: &Flight<'_>) -> Drawing {
    let mut panel = Panel::new(flight.time_axis(), Axis::new("altitude", "m").including(0.0));
    let leader = |sample| flight.members(sample).next().map(|(_, trace)| trace.altitude_setpoint_m);
    let setpoint = flight.over_time((0..flight.times_s.len()).map(leader));
    panel.items.push(Item::line(setpoint, Colour::BLACK).wide(1.2).dashed().in_legend("setpoint of the lowest id"));
    panel.items.extend(flight.lines(|trace| Some(trace.position.altitude_m())));
    let (panel, marked) = with_marks(flight, panel);
    let caption = format!("True altitude above the origin.{marked}");
    flight.figure("altitude", "Altitude", caption, 360.0, vec![panel])
}

/// Draws the controls of every vehicle.
pub(super) fn effort(flight: &Flight<'_>) -> Drawing {
    let cyclic = smooth(flight);
    let mut above =
        Panel::new(flight.time_axis(), Axis::new("cyclic and pedals (rms)", "share of full").including(0.0));
    above.items = flight.lines_of(|index, sample| cyclic[index][sample]);
    let (mut above, marked) = with_marks(flight, above);
    above.place = [0.0, 0.0, 1.0, 0.54];
    let mut below = Panel::new(flight.time_axis(), Axis::new("collective", "share of full"));
    below.items = flight.lines(|trace| trace.controls.map(|controls| controls[3]));
    below.place = [0.0, 0.54, 1.0, 1.0];
    let caption = format!(
        "Above, the controls for roll, pitch and yaw (full deflection is 1): root mean square over {EFFORT_S} s. Below, the collective.{marked}"
    );
    flight.figure("effort", "Control effort", caption, 560.0, vec![above, below])
}

/// Root mean square of each vehicle's controls over the last [`EFFORT_S`], at each sample.
fn smooth(flight: &Flight<'_>) -> Vec<Vec<Option<f64>>> {
    let apart_s = flight.times_s.windows(2).next().map_or(1.0, |pair| pair[1] - pair[0]);
    let window = (EFFORT_S / apart_s).round().max(1.0) as usize;
    let of = |steps: &Vec<Option<&crate::recording::Step>>| {
        let squares: Vec<Option<f64>> = steps
            .iter()
            .map(|step| step.and_then(|step| step.trace.controls))
            .map(|controls| controls.map(|[roll, pitch, yaw, _]| (roll * roll + pitch * pitch + yaw * yaw) / 3.0))
            .collect();
        let rms = |sample: usize| {
            squares[sample]?;
            let recent = squares[(sample + 1).saturating_sub(window)..=sample].iter().flatten();
            let (count, sum) = recent.fold((0, 0.0), |(count, sum), square| (count + 1, sum + square));
            Some((sum / f64::from(count)).sqrt())
        };
        (0..squares.len()).map(rms).collect()
    };
    flight.seen.iter().map(of).collect()
}
