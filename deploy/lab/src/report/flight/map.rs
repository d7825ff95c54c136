//! Draws maps: the swarm seen from above.

use std::f64::consts::TAU;

use nalgebra::{Rotation2, Vector2};
use skein_common::frame::PositionNed;
use skein_common::id::VehicleId;
use skein_common::math;
use skein_common::message::Trace;
use skein_common::scenario::{Formation, Law, StaticObstacle, Target};
use skein_common::state::Membership;
use skein_core::formation;
use skein_core::formation::law::Neighbour;

use super::traces::{centre_distance_panel, pair_distance_panel};
use super::{Flight, is_flying_member, on_map, pieces, place_on_map, radii_m};
use crate::report::figure::{Axis, Colour, Drawing, Item, Marker, Panel, Shape, WIDTH_PX};

/// Length of the trails of a flight whose centre moves, s.
const TRAIL_S: f64 = 60.0;
/// Number of intervals between the snapshots along one path.
const ALONG_PATH: usize = 6;
/// Most snapshots of a flight.
const MOST_SNAPSHOTS: usize = 9;
/// Number of arrows across the field.
const ARROWS: i32 = 23;
/// Most vehicles whose numbers are beside their places and trails.
const NAMED: usize = 24;
/// Width and height of a square figure, px.
const SQUARE_PX: f64 = 720.0;

/// Makes a figure square.
fn square(figure: Drawing) -> Drawing {
    Drawing { size_px: [SQUARE_PX; 2], ..figure }
}

/// An empty map, with east to the right and north up.
pub(in crate::report) fn map() -> Panel {
    Panel { is_map: true, ..Panel::new(Axis::new("east", "m"), Axis::new("north", "m")) }
}

/// Draws the final positions of all vehicles, with the ellipses and the paths to them (the paper's figure 5).
pub(super) fn final_places(flight: &Flight<'_>) -> Drawing {
    let caption = format!(
        "The vehicles from above at {}, and their paths{}.",
        flight.last_flown().map_or("the end".to_owned(), |last| format!("{:.0} s", flight.times_s[last])),
        if flight.has_one_place() { String::new() } else { format!(" in the last {TRAIL_S} s") },
    );
    let end_s = flight.last_flown().filter(|_| !flight.has_one_place()).map(|last| flight.times_s[last]);
    let panel = places_panel(flight, end_s.map_or(f64::NEG_INFINITY, |end_s| end_s - TRAIL_S), false);
    square(flight.figure("final-places", "Final positions", caption, SQUARE_PX, vec![panel]))
}

/// A map of the vehicles at the last sample that was flown and of their paths since `since_s`, s, with the path of the
/// centre if that is wanted.
fn places_panel(flight: &Flight<'_>, since_s: f64, with_centre: bool) -> Panel {
    let mut panel = map();
    let Some(last) = flight.last_flown() else { return panel };
    let first = flight.times_s.partition_point(|t_s| *t_s < since_s);
    panel.items = airspace(flight);
    panel.items.extend(with_centre.then(|| centre_path(flight)));
    panel.items.extend(ellipses(flight, last));
    panel.items.extend(trails(flight, first, last));
    panel.items.extend(vehicles(flight, last));
    // Above a vehicle that flies now where another one ended.
    panel.items.extend(ended_trails(flight, first, last));
    panel
}

/// The fence and the obstacles of the airspace.
fn airspace(flight: &Flight<'_>) -> Vec<Item> {
    let airspace = &flight.scenario().airspace;
    let closed = |corners: &[[f64; 2]]| corners.iter().chain(corners.first()).map(|corner| on_map(*corner)).collect();
    let obstacle = |obstacle: &StaticObstacle| {
        let outline: Vec<[f64; 2]> = match (obstacle.size_ne_m, obstacle.radius_m) {
            (Some([north_m, east_m]), _) => {
                let corners = [[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]];
                let corner = |[north, east]: [f64; 2]| {
                    [obstacle.centre_ne_m[0] + north * north_m, obstacle.centre_ne_m[1] + east * east_m]
                };
                closed(&corners.map(corner))
            }
            (None, radius_m) => {
                let point = |nth: i32| {
                    let (east, north) = math::sin_cos(f64::from(nth) * TAU / 60.0);
                    let radius_m = radius_m.unwrap_or(0.0);
                    [obstacle.centre_ne_m[0] + radius_m * north, obstacle.centre_ne_m[1] + radius_m * east]
                };
                closed(&(0..60).map(point).collect::<Vec<_>>())
            }
        };
        Item::new(Shape::Area(vec![outline]), Colour::GREY.faint(0.55)).meaning("Grey areas: obstacles")
    };
    let mut items: Vec<Item> = airspace.obstacles.iter().map(obstacle).collect();
    if !airspace.fence_ne_m.is_empty() {
        let fence = Item::line(vec![closed(&airspace.fence_ne_m)], Colour::VERMILLION).wide(1.8);
        items.push(fence.meaning("Orange outline: the fence"));
    }
    items
}

/// The ellipses R_in, R* and R_out of the swarm's step.
fn ellipses(flight: &Flight<'_>, sample: usize) -> Vec<Item> {
    let Some((formation, centre_ne_m)) = flight.formation(sample).zip(flight.centre_ne_m(sample)) else {
        return Vec::new();
    };
    let line = |(nth, radius_m): (usize, Option<f64>)| {
        let line = Item::line(vec![ellipse(&formation, radius_m?, centre_ne_m)], Colour::BLACK);
        Some(match nth {
            1 => line.wide(1.2).meaning("Solid ring: R*, the circle or ellipse of the formation"),
            _ => line.wide(0.9).dashed().meaning("Broken rings: R_in and R_out, the band's edges"),
        })
    };
    radii_m(&formation).into_iter().enumerate().filter_map(line).collect()
}

/// Points of the ellipse of this level.
fn ellipse(formation: &Formation, radius_m: f64, centre_ne_m: [f64; 2]) -> Vec<[f64; 2]> {
    let turn = Rotation2::new(formation.heading_rad());
    let point = |nth: i32| {
        let (east, north) = math::sin_cos(f64::from(nth) * TAU / 120.0);
        let axes = Vector2::new(north * radius_m, east * radius_m / formation.gamma.sqrt());
        let ne_m = Vector2::from(centre_ne_m) + turn * axes;
        on_map([ne_m.x, ne_m.y])
    };
    (0..=120).map(point).collect()
}

/// The paths of all vehicles from one sample to another, each with a dot at its start.
fn trails(flight: &Flight<'_>, first: usize, last: usize) -> Vec<Item> {
    let paths: Vec<_> = (0..flight.count()).map(|index| path(flight, index, first, last)).collect();
    let start = |(index, path): (usize, &Vec<Vec<[f64; 2]>>)| {
        let at = path.first().and_then(|piece| piece.first()).copied().into_iter().collect();
        Item::new(Shape::Dots { at, marker: Marker::Circle, size_px: 4.0 }, colour(flight, index))
            .meaning("Small dots: the starts of the paths")
    };
    let starts: Vec<Item> = paths.iter().enumerate().map(start).collect();
    lines(flight, paths).into_iter().chain(starts).collect()
}

/// The places of a vehicle from one sample to another, interrupted while its agent did not run.
fn path(flight: &Flight<'_>, index: usize, first: usize, last: usize) -> Vec<Vec<[f64; 2]>> {
    let steps = &flight.seen[index][first..=last];
    pieces(steps.iter().map(|step| step.map(|step| place_on_map(step.trace.position))))
}

/// A line for the path of each vehicle.
fn lines(flight: &Flight<'_>, paths: Vec<Vec<Vec<[f64; 2]>>>) -> Vec<Item> {
    let (width_px, opacity) = if flight.count() <= NAMED { (1.2, 0.75) } else { (0.7, 0.3) };
    let line = |(index, path)| {
        let line = Item::line(path, colour(flight, index).faint(opacity)).wide(width_px);
        line.meaning("Coloured lines: the paths of the vehicles")
    };
    paths.into_iter().enumerate().map(line).collect()
}

/// A cross with the vehicle's number where the path of a vehicle ends because its agent ended, whether or not another agent
/// continues it later.
fn ended_trails(flight: &Flight<'_>, first: usize, last: usize) -> Vec<Item> {
    let mut items = Vec::new();
    for index in 0..flight.count() {
        let steps = &flight.seen[index][first..=last];
        // Vehicles that leave after their landing have ended as they should.
        let ends = steps.windows(2).filter_map(|pair| match pair {
            [Some(step), None] if step.trace.membership != Membership::Left => Some(place_on_map(step.trace.position)),
            _ => None,
        });
        for at in ends {
            let cross = Shape::Dots { at: vec![at], marker: Marker::Cross, size_px: 13.0 };
            let meaning = "Bold crosses: here the agent of the numbered vehicle ended";
            items.push(Item::new(cross, Colour::BLACK).meaning(meaning));
            let text = flight.id(index).to_string();
            items.push(Item::new(Shape::Note { at, text, side: [1.0, 1.0] }, Colour::BLACK));
        }
    }
    items
}

/// The colour of a vehicle on maps.
fn colour(flight: &Flight<'_>, index: usize) -> Colour {
    if flight.count() <= NAMED { Colour::nth(index) } else { Colour::BLUE }
}

/// All vehicles at their positions, with their numbers if they are few; a grey cross marks a vehicle that has left the
/// formation.
fn vehicles(flight: &Flight<'_>, sample: usize) -> Vec<Item> {
    let centre = flight.centre_ne_m(sample).map_or([0.0; 2], on_map);
    let mut items = Vec::new();
    for (index, trace) in flight.at(sample) {
        let at = place_on_map(trace.position);
        let is_member = is_flying_member(trace);
        let is_named = flight.count() <= NAMED;
        let (colour, marker, meaning) = match is_member {
            true if is_named => (colour(flight, index), Marker::nth(index), "Large markers: the numbered vehicles"),
            true => (Colour::BLUE, Marker::Circle, "Large dots: the vehicles"),
            false => (Colour::GREY, Marker::Cross, "Grey crosses: vehicles out of the formation"),
        };
        let size_px = if is_named { 11.0 } else { 6.0 };
        items.push(Item::new(Shape::Dots { at: vec![at], marker, size_px }, colour).meaning(meaning));
        if is_named || !is_member {
            let text = flight.id(index).to_string();
            let text = if is_member { text } else { format!("{text}, out") };
            let side = [at[0] - centre[0], at[1] - centre[1]];
            items.push(Item::new(Shape::Note { at, text, side }, Colour::BLACK));
        }
    }
    items
}

/// Draws the swarm at some instants along its path (the paper's figure 8); `None` if the swarm stays in one place.
pub(super) fn snapshots(flight: &Flight<'_>) -> Option<Drawing> {
    let samples = instants(flight);
    if samples.len() < 2 {
        return None;
    }
    let disc =
        |sample: &usize| Some((Vector2::from(flight.centre_ne_m(*sample)?), reach_m(&*flight.formation(*sample)?)));
    let (samples, discs): (Vec<_>, Vec<_>) =
        samples.into_iter().filter_map(|sample| Some((sample, disc(&sample)?))).unzip();
    let overlap = |(nth, (centre, reach_m)): (usize, &(Vector2<f64>, f64))| {
        discs[..nth].iter().any(|(other, other_m)| (centre - other).norm() < reach_m + other_m)
    };
    if discs.iter().enumerate().any(overlap) {
        return Some(one_by_one(flight, &samples));
    }
    let mut panel = map();
    panel.items.extend(airspace(flight));
    panel.items.push(centre_path(flight));
    let last = *samples.last()?;
    panel.items.extend(trails(flight, 0, last));
    for &sample in &samples {
        panel.items.extend(ellipses(flight, sample));
        panel.items.extend(vehicles_small(flight, sample));
    }
    panel.items.extend(ended_trails(flight, 0, last));
    panel.items.extend(times(flight, &samples, &discs));
    let caption = "The swarm from above at some instants, each with its time.";
    Some(flight.figure("snapshots", "Snapshots along the path", caption, 640.0, vec![panel]))
}

/// The time of each snapshot, beside its ellipse, on the side with the fewest other paths and ellipses.
fn times(flight: &Flight<'_>, samples: &[usize], discs: &[(Vector2<f64>, f64)]) -> Vec<Item> {
    let paths_ne_m: Vec<Vector2<f64>> = (0..flight.times_s.len())
        .step_by(8)
        .flat_map(|sample| flight.at(sample).map(|(_, trace)| trace.position.horizontal()))
        .collect();
    let beside = |(sample, (centre, reach_m)): (&usize, &(Vector2<f64>, f64))| {
        let crowd = |towards: &Vector2<f64>| {
            let label = centre + towards * (reach_m * 1.45);
            let paths_nearby = paths_ne_m.iter().filter(|path| (*path - label).norm() < 0.5 * reach_m).count();
            let others =
                discs.iter().filter(|(other, other_m)| (other - label).norm() < other_m + 0.5 * reach_m).count();
            paths_nearby + 1000 * others
        };
        // East comes first, because a text is wide.
        let towards =
            [(0.0, 1.0), (0.0, -1.0), (-0.7, 0.7), (0.7, 0.7), (-0.7, -0.7), (0.7, -0.7), (-1.0, 0.0), (1.0, 0.0)];
        let towards =
            towards.map(|(north, east)| Vector2::new(north, east)).into_iter().min_by_key(crowd).unwrap_or_default();
        let edge = centre + towards * *reach_m;
        let text = format!("{:.0} s", flight.times_s[*sample]);
        let shape = Shape::Note { at: on_map([edge.x, edge.y]), text, side: [towards.y, towards.x] };
        Item::new(shape, Colour::BLACK)
    };
    samples.iter().zip(discs).map(beside).collect()
}

/// Draws the snapshots in a panel each, if they overlap.
fn one_by_one(flight: &Flight<'_>, samples: &[usize]) -> Drawing {
    let columns = 3.0;
    let rows = (samples.len() as f64 / columns).ceil();
    let mut before = 0;
    let mut panels = Vec::new();
    for (nth, &sample) in samples.iter().enumerate() {
        let mut panel = map();
        let step = flight.leading_step(sample);
        let name = step.and_then(|step| flight.leg(step)).and_then(|leg| leg.name.as_deref()).unwrap_or_default();
        panel.title = format!("{:.0} s\u{a0} {name}", flight.times_s[sample]);
        panel.items = airspace(flight);
        panel.items.extend(ellipses(flight, sample));
        let since: Vec<_> = (0..flight.count()).map(|index| path(flight, index, before, sample)).collect();
        panel.items.extend(lines(flight, since));
        panel.items.extend(vehicles_small(flight, sample));
        panel.items.extend(ended_trails(flight, before, sample));
        let (column, row) = ((nth % 3) as f64, (nth / 3) as f64);
        panel.place = [column / columns, row / rows, (column + 1.0) / columns, (row + 1.0) / rows];
        panels.push(panel);
        before = sample;
    }
    let caption = "The swarm from above before it leaves each place, with the paths since the panel before.";
    flight.figure("snapshots", "Snapshots along the path", caption, 50.0 + rows * 300.0, panels)
}

/// The vehicles with small markers and without names, for crowded maps.
fn vehicles_small(flight: &Flight<'_>, sample: usize) -> Vec<Item> {
    let mut items = vehicles(flight, sample);
    items.retain(|item| matches!(item.shape, Shape::Dots { .. }));
    for item in &mut items {
        if let Shape::Dots { size_px, .. } = &mut item.shape {
            *size_px = size_px.min(7.0);
        }
        // Without numbers.
        if item.meaning.as_deref().is_some_and(|meaning| meaning.starts_with("Large")) {
            item.meaning = Some("Larger dots and markers: the vehicles".to_owned());
        }
    }
    items
}

/// Largest distance of a formation from its centre, m.
fn reach_m(formation: &Formation) -> f64 {
    let outer_m = radii_m(formation).into_iter().flatten().fold(0.0, f64::max);
    outer_m * formation.gamma.sqrt().recip().max(1.0)
}

/// The samples of the snapshots: the end of every step, and instants along a path.
fn instants(flight: &Flight<'_>) -> Vec<usize> {
    let Some(last) = flight.last_flown() else { return Vec::new() };
    let steps: Vec<_> = (0..=last).map(|sample| flight.leading_step(sample)).collect();
    let mut instants = Vec::new();
    for (step, leg) in flight.scenario().mission.steps.iter().enumerate() {
        let is_at = |at: &Option<u32>| *at == Some(step as u32);
        let (Some(from), Some(to)) = (steps.iter().position(is_at), steps.iter().rposition(is_at)) else { continue };
        match leg.target {
            Target::Path(_) => {
                instants.extend((0..=ALONG_PATH).map(|nth| from + (to - from) * nth / ALONG_PATH));
            }
            Target::Centre(_) => instants.push(to),
            // A hold repeats the place of the step before.
            Target::Hold(_) | Target::Land(_) => {}
        }
    }
    instants.dedup();
    let many = instants.len();
    let kept = |nth: usize| nth * (many - 1) / (MOST_SNAPSHOTS - 1);
    if many <= MOST_SNAPSHOTS { instants } else { (0..MOST_SNAPSHOTS).map(|nth| instants[kept(nth)]).collect() }
}

fn centre_path(flight: &Flight<'_>) -> Item {
    let path = pieces((0..flight.times_s.len()).map(|sample| flight.centre_ne_m(sample).map(on_map)));
    Item::line(path, Colour::GREY).wide(1.0).dashed().meaning("Broken grey line: the path of the centre")
}

/// Draws the field of the law around the formation; `None` for laws without a field.
pub(super) fn field(flight: &Flight<'_>) -> Option<Drawing> {
    let last = flight.last_flown()?;
    let flown = flight.formation(last)?;
    if !matches!(flown.law, Law::Ring | Law::Flock) {
        return None;
    }
    let centre_ne_m = flight.centre_ne_m(last)?;
    let members: Vec<(usize, &Trace)> = flight.members(last).collect();
    let (own, _) = *members.first()?;
    let neighbours: Vec<_> = members[1..].iter().map(|(index, trace)| neighbour(flight.id(*index), trace)).collect();
    let ring = formation::ring(&flown);
    let centre = PositionNed::new(centre_ne_m[0], centre_ne_m[1], -flown.altitude_m);
    let half_m = reach_m(&flown) * 1.35;
    let apart_m = 2.0 * half_m / f64::from(ARROWS - 1);
    let mut shades: Vec<Vec<([f64; 2], [f64; 2])>> = vec![Vec::new(); 5];
    for nth in 0..ARROWS * ARROWS {
        let from_centre_m = |nth: i32| f64::from(nth - ARROWS / 2) * apart_m;
        let (north_m, east_m) = (from_centre_m(nth / ARROWS), from_centre_m(nth % ARROWS));
        let place = PositionNed::new(centre_ne_m[0] + north_m, centre_ne_m[1] + east_m, centre.0.z);
        let field_ne = ring.field(flight.id(own), place, centre, &neighbours, &[]).xy();
        let size = field_ne.norm();
        // The root keeps the arrows of a weak field long enough to show a direction.
        let arrow_ne_m = field_ne / size.max(1e-9) * size.min(1.0).sqrt() * 0.92 * apart_m;
        let [east_m, north_m] = place_on_map(place);
        let half = [arrow_ne_m.y / 2.0, arrow_ne_m.x / 2.0];
        let shade = ((size * 5.0) as usize).min(4);
        shades[shade].push(([east_m - half[0], north_m - half[1]], [east_m + half[0], north_m + half[1]]));
    }
    let mut panel = map();
    for (nth, arrows) in shades.into_iter().enumerate() {
        let share = nth as f64 / 5.0;
        let name = if nth == 4 { format!("|V| above {share:.1}") } else { format!("{share:.1}–{:.1}", share + 0.2) };
        panel.items.push(Item::new(Shape::Arrows(arrows), Colour::of_amount(share + 0.1)).in_legend(name));
    }
    panel.items.extend(ellipses(flight, last));
    panel.items.extend(vehicles(flight, last));
    let own = flight.id(own);
    let caption = format!(
        "The dimensionless field V of vehicle {own} at each place at {:.0} s, with the other vehicles at their positions. The length of an arrow grows with the root of |V|.",
        flight.times_s[last],
    );
    let title = format!("Field of vehicle {own} around the formation");
    Some(square(flight.figure("field", &title, caption, SQUARE_PX, vec![panel])))
}

/// A neighbour as a vehicle with a perfect network would observe it.
fn neighbour(id: VehicleId, trace: &Trace) -> Neighbour {
    let heading_rad = trace.attitude.heading_rad;
    Neighbour { id, position: trace.position, velocity: trace.velocity, heading_rad, age_s: 0.0, is_fresh: true }
}

/// Draws an overview of the flight in one figure.
pub(super) fn overview(flight: &Flight<'_>) -> Drawing {
    let mut places = places_panel(flight, f64::NEG_INFINITY, !flight.has_one_place());
    places.place = [0.0, 0.0, 0.47, 1.0];
    let (mut distance, mut pairs) = (centre_distance_panel(flight), pair_distance_panel(flight));
    let has_pairs = flight.count() > 1;
    distance.place = [0.47, 0.0, 1.0, if has_pairs { 0.5 } else { 1.0 }];
    pairs.place = [0.47, 0.5, 1.0, 1.0];
    let caption = if has_pairs {
        "Left, the paths from above. Right, the distance of every vehicle from the formation's centre, and below it the distances between vehicles."
    } else {
        "Left, the path from above. Right, the distance of the vehicle from the formation's centre."
    };
    let panels = if has_pairs { vec![places, distance, pairs] } else { vec![places, distance] };
    let mut figure = flight.figure("overview", "The flight at a glance", caption, 560.0, panels);
    figure.size_px[0] = WIDTH_PX + 80.0;
    figure
}
