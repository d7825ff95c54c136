//! Draws the mission step of each vehicle over time.

use skein_common::message::{EventKind, Trace};
use skein_common::scenario::Target;
use skein_common::state::{Activity, Membership};

use super::Flight;
use super::marks::with_marks;
use crate::recording::{Noted, NotedKind};
use crate::report::figure::{Axis, Colour, Drawing, Item, Marker, Panel, Shape};

/// Half the height of a bar, as a share of the distance between two rows.
const HALF: f64 = 0.36;

/// Draws the timeline of the mission, with a row for each vehicle.
pub(super) fn timeline(flight: &Flight<'_>) -> Drawing {
    let row = |index: usize| -f64::from(flight.id(index).get());
    let names = (0..flight.count()).map(|index| (row(index), flight.id(index).to_string())).collect();
    let mut panel = Panel::new(flight.time_axis(), Axis::named("vehicle", names));
    for step in 0..flight.scenario().mission.steps.len() {
        panel.items.extend(step_bars(flight, step as u32, &row));
    }
    panel.items.extend(grey_bars(flight, "joining", &row, |trace| trace.membership == Membership::Joining));
    let others = |trace: &Trace| trace.membership != Membership::Joining && is_out_of_formation(trace);
    panel.items.extend(grey_bars(flight, "out of formation: holding, landing, landed", &row, others));
    panel.items.extend(dots(flight, &row));
    let (panel, marked) = with_marks(flight, panel);
    let height_px = 150.0 + (26.0 * flight.count() as f64).min(560.0);
    let caption = format!("What every vehicle did over time. No bar: its agent does not run.{marked}");
    flight.figure("timeline", "Mission", caption, height_px, vec![panel])
}

/// Whether the vehicle does something else than fly its mission step.
fn is_out_of_formation(trace: &Trace) -> bool {
    trace.membership == Membership::Left
        || matches!(
            trace.activity,
            Activity::Holding | Activity::Landing | Activity::Landed | Activity::Blind | Activity::Released
        )
}

fn step_bars(flight: &Flight<'_>, step: u32, row: &impl Fn(usize) -> f64) -> Option<Item> {
    let leg = flight.leg(step)?;
    let name = match (&leg.name, &leg.target) {
        (Some(name), _) => name.clone(),
        (None, Target::Land(_)) => "land".to_owned(),
        (None, _) => step.to_string(),
    };
    let is_shown =
        |trace: &Trace| trace.step == step && trace.membership == Membership::Active && !is_out_of_formation(trace);
    let bars = bars(flight, row, &name, is_shown);
    // Neighbouring steps differ in lightness too.
    let opacity = if step.is_multiple_of(2) { 0.5 } else { 0.28 };
    let meaning = "Coloured bars: the step of the mission, with its name or its number from 0 where there is room";
    let colour = Colour::nth(step as usize % 6).faint(opacity);
    (!bars.is_empty()).then(|| Item::new(Shape::Bars(bars), colour).meaning(meaning))
}

fn grey_bars(
    flight: &Flight<'_>,
    name: &str,
    row: &impl Fn(usize) -> f64,
    is_shown: impl Fn(&Trace) -> bool,
) -> Option<Item> {
    let bars = bars(flight, row, "", is_shown);
    let colour = if name == "joining" { Colour::PALE } else { Colour::GREY.faint(0.7) };
    (!bars.is_empty()).then(|| Item::new(Shape::Bars(bars), colour).in_legend(name))
}

/// A bar for every time span in which the condition holds.
fn bars(
    flight: &Flight<'_>,
    row: &impl Fn(usize) -> f64,
    name: &str,
    is_shown: impl Fn(&Trace) -> bool,
) -> Vec<([f64; 2], [f64; 2], String)> {
    let apart_s = flight.times_s.windows(2).next().map_or(0.1, |pair| pair[1] - pair[0]);
    let mut bars: Vec<([f64; 2], [f64; 2], String)> = Vec::new();
    for (index, steps) in flight.seen.iter().enumerate() {
        let mut is_open = false;
        for (t_s, step) in flight.times_s.iter().zip(steps) {
            let is_in = step.is_some_and(|step| is_shown(&step.trace));
            match bars.last_mut() {
                Some((_, to, _)) if is_in && is_open => to[0] = *t_s,
                _ if is_in => {
                    bars.push(([t_s - apart_s, row(index) - HALF], [*t_s, row(index) + HALF], name.to_owned()))
                }
                _ => {}
            }
            is_open = is_in;
        }
    }
    bars
}

/// Markers of the events that vehicles reported of their mission.
fn dots(flight: &Flight<'_>, row: &impl Fn(usize) -> f64) -> Vec<Item> {
    let size_px = if flight.is_few() { 7.0 } else { 4.0 };
    let item = |is_shown: fn(&EventKind) -> bool, marker, colour, name: &str| {
        let place = |noted: &Noted| match &noted.what {
            NotedKind::Event(who, what) if is_shown(what) => {
                flight.index(*who).map(|index| [noted.t_s, row(index) - HALF])
            }
            NotedKind::Event(..) | NotedKind::Fault(_) => None,
        };
        let at: Vec<[f64; 2]> = flight.recording.noted.iter().filter_map(place).collect();
        (!at.is_empty()).then(|| Item::new(Shape::Dots { at, marker, size_px }, colour).in_legend(name))
    };
    let (down, up, red) = (Marker::Down, Marker::Triangle, Colour::VERMILLION);
    let items = [
        item(|what| matches!(what, EventKind::Reached(_)), Marker::Circle, Colour::BLACK, "reached the step"),
        item(|what| matches!(what, EventKind::ForcedAdvance { .. }), down, red, "left a step without a member"),
        item(|what| matches!(what, EventKind::Skipped { .. }), up, Colour::BLUE, "carried forward"),
        item(|what| matches!(what, EventKind::Failed(_)), Marker::Cross, red, "reported a failure"),
    ];
    items.into_iter().flatten().collect()
}
