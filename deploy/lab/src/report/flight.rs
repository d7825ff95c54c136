//! Draws the figures of one flight.
//!
//! All figures use the ground truth of the vehicles, sampled at the same instants for all of them. Each of up to
//! [`FEW`] vehicles has a line with its own colour, markers and name. For more vehicles, the least, the median and the
//! largest value are drawn.

mod ages;
mod contact;
mod map;
mod marks;
mod timeline;
mod traces;

use std::borrow::Cow;

use skein_common::frame::PositionNed;
use skein_common::id::VehicleId;
use skein_common::message::Trace;
use skein_common::scenario::{Formation, Law, Preset, Scenario, Step as Leg, Target};
use skein_common::state::{Activity, Membership};

pub(super) use map::map;
pub(super) use marks::injected;

use super::figure::{self, Axis, Colour, Drawing, Item, Panel, WIDTH_PX};
use crate::metrics::{Run, StepShape};
use crate::recording::{Recording, Step};
use skein_common::statistics::quantile;

/// Most vehicles that have a line each.
pub const FEW: usize = 10;
/// Most samples of a flight.
const SAMPLES: f64 = 2400.0;
/// Largest age of a step that a sample uses, s; larger if steps were recorded less often.
const OLDEST_S: f64 = 0.5;

/// One flight, with all vehicles sampled at the same instants.
#[derive(Debug)]
pub struct Flight<'a> {
    recording: &'a Recording,
    /// Times of the samples from the start of the window, in order, s.
    times_s: Vec<f64>,
    /// Last step of each vehicle, in the order of ids, at each sample; `None` while its agent was dead.
    seen: Vec<Vec<Option<&'a Step>>>,
}

/// Draws all figures that apply to a flight.
pub fn figures(recording: &Recording) -> Vec<Drawing> {
    let flight = Flight::new(recording);
    let figures = [
        Some(map::overview(&flight)),
        Some(timeline::timeline(&flight)),
        contact::contact(&flight),
        Some(map::final_places(&flight)),
        Some(traces::centre_distance(&flight)),
        traces::pair_distance(&flight),
        map::snapshots(&flight),
        map::field(&flight),
        traces::separations(&flight),
        Some(traces::altitude(&flight)),
        Some(traces::effort(&flight)),
        ages::ages(&flight),
    ];
    figures.into_iter().flatten().collect()
}

/// Draws which vehicle receives which; `None` for a single vehicle, or without a recorded step.
pub(super) fn contact(recording: &Recording) -> Option<Drawing> {
    contact::contact(&Flight::new(recording))
}

/// A line of text that identifies the run.
pub fn subject(run: &Run) -> String {
    let Run { scenario, preset, law, conversion, target, seed, version, vehicles, .. } = run;
    let law =
        if matches!(law.as_str(), "ring" | "flock") { format!("{law}, {conversion} conversion") } else { law.clone() };
    let vehicles = if *vehicles == 1 { "1 vehicle".to_owned() } else { format!("{vehicles} vehicles") };
    let time = if target == "study" { "virtual time" } else { target };
    format!("{scenario} · {law} · preset {preset} · {vehicles} · seed {seed} · {time} · skein {version}")
}

impl<'a> Flight<'a> {
    /// Samples a recording.
    pub fn new(recording: &'a Recording) -> Self {
        let all =
            || recording.tracks.iter().flat_map(|track| track.steps.first().into_iter().chain(track.steps.last()));
        let ends = all().map(|step| step.t_s).filter(|t_s| t_s.is_finite());
        let ends = ends.fold(None, |ends: Option<(f64, f64)>, t_s| {
            Some(ends.map_or((t_s, t_s), |(from, to)| (from.min(t_s), to.max(t_s))))
        });
        // Not more often than steps were recorded, because the lines would show stairs.
        let between_steps = recording.tracks.iter().flat_map(|track| track.steps.windows(2).take(1));
        let recorded_s = between_steps.map(|pair| pair[1].t_s - pair[0].t_s).fold(f64::INFINITY, f64::min);
        let recorded_s = if recorded_s.is_finite() { recorded_s.max(0.1) } else { 0.1 };
        let times_s: Vec<f64> = ends.map_or(Vec::new(), |(from_s, to_s)| {
            let apart_s = ((to_s - from_s) / SAMPLES).max(recorded_s);
            let last = ((to_s - from_s) / apart_s).floor() as u32;
            // Counted from the end: the last sample is the last step.
            (0..=last).rev().map(|nth| to_s - f64::from(nth) * apart_s).collect()
        });
        let seen = recording.tracks.iter().map(|track| at_times(&track.steps, &times_s, recorded_s)).collect();
        Self { recording, times_s, seen }
    }

    fn scenario(&self) -> &Scenario {
        &self.recording.scenario
    }

    /// Number of vehicles.
    fn count(&self) -> usize {
        self.seen.len()
    }

    /// Index of this vehicle among all vehicles.
    fn index(&self, id: VehicleId) -> Option<usize> {
        self.recording.tracks.binary_search_by_key(&id, |track| track.id).ok()
    }

    fn is_few(&self) -> bool {
        self.count() <= FEW
    }

    fn id(&self, index: usize) -> VehicleId {
        self.recording.tracks[index].id
    }

    /// The vehicles that have a trace at this sample, by index, with their traces.
    fn at(&self, sample: usize) -> impl Iterator<Item = (usize, &'a Trace)> + '_ {
        let steps = self.seen.iter().enumerate();
        steps.filter_map(move |(index, steps)| Some((index, &steps.get(sample).copied().flatten()?.trace)))
    }

    /// The active members that have not landed at this sample, by index, with their traces.
    fn members(&self, sample: usize) -> impl Iterator<Item = (usize, &'a Trace)> + '_ {
        self.at(sample).filter(|(_, trace)| is_flying_member(trace))
    }

    /// The leading member at this sample: of those at the highest mission step the one with the lowest id.
    fn leader(&self, sample: usize) -> Option<&'a Trace> {
        self.members(sample)
            .map(|(_, trace)| trace)
            .reduce(|first, next| if next.step > first.step { next } else { first })
    }

    /// The highest mission step of a member at this sample.
    fn leading_step(&self, sample: usize) -> Option<u32> {
        self.leader(sample).map(|trace| trace.step)
    }

    /// The formation of the leading member at this sample, with the values that operators have set by then.
    fn formation(&self, sample: usize) -> Option<Cow<'_, Formation>> {
        let leader = self.leader(sample)?;
        self.scenario().formation_with(leader.step, &leader.settings)
    }

    fn leg(&self, step: u32) -> Option<&Leg> {
        self.scenario().mission.steps.get(step as usize)
    }

    /// The last sample at which the swarm flew a step of its mission that is no landing; the last of all samples if it never did.
    fn last_flown(&self) -> Option<usize> {
        let flies = |sample: &usize| {
            let leg = self.leading_step(*sample).and_then(|step| self.leg(step));
            leg.is_some_and(|leg| !matches!(leg.target, Target::Land(_)))
        };
        (0..self.times_s.len()).rev().find(flies).or_else(|| self.times_s.len().checked_sub(1))
    }

    /// The swarm's centre, north and east, m: the estimate of the leading member with the lowest id.
    fn centre_ne_m(&self, sample: usize) -> Option<[f64; 2]> {
        self.leader(sample).map(|trace| trace.centre_ne_m)
    }

    /// Whether the mission has a single place for the formation.
    fn has_one_place(&self) -> bool {
        let mut legs = self.scenario().mission.steps.iter().filter(|leg| !matches!(leg.target, Target::Land(_)));
        legs.next().is_some_and(|leg| matches!(leg.target, Target::Centre(_))) && legs.next().is_none()
    }

    /// Number of the same figure in the paper; `None` unless the paper's settings fly.
    fn number_in_paper(&self, name: &str) -> Option<u8> {
        let Scenario { preset, formation, .. } = self.scenario();
        match (formation.law, name) {
            _ if *preset != Preset::Paper => None,
            (Law::Ring, "final-places") => Some(5),
            (Law::Ring, "centre-distance") => Some(6),
            (Law::Ring, "pair-distance") => Some(7),
            (Law::Flock, "snapshots") => Some(8),
            (Law::Flock, "centre-distance" | "pair-distance") => Some(9),
            _ => None,
        }
    }

    /// Makes a figure of this flight.
    fn figure(
        &self,
        name: &str,
        title: &str,
        caption: impl Into<String>,
        height_px: f64,
        panels: Vec<Panel>,
    ) -> Drawing {
        Drawing {
            name: name.to_owned(),
            title: match self.number_in_paper(name) {
                Some(number) => format!("{title} (figure {number} of the paper)"),
                None => title.to_owned(),
            },
            subject: subject(&self.recording.run),
            caption: caption.into(),
            size_px: [WIDTH_PX, height_px],
            panels,
        }
    }

    /// The time axis of this flight.
    fn time_axis(&self) -> Axis {
        let axis = Axis::new("time", "s");
        match (self.times_s.first(), self.times_s.last()) {
            (Some(from_s), Some(to_s)) if to_s > from_s => {
                // The last sample lies a little before the end that was asked for.
                let end_s = self.scenario().duration_s.filter(|end_s| (0.0..1.0).contains(&(end_s - to_s)));
                axis.within(from_s.min(0.0), end_s.unwrap_or(*to_s))
            }
            _ => axis,
        }
    }

    /// A line over time for each vehicle; for many vehicles, their least, median and largest values.
    fn lines(&self, value: impl Fn(&Trace) -> Option<f64>) -> Vec<Item> {
        self.lines_of(|index, sample| value(&self.seen[index][sample]?.trace))
    }

    /// The lines of [`Self::lines`], of a value by the index of the vehicle and the sample.
    fn lines_of(&self, value: impl Fn(usize, usize) -> Option<f64>) -> Vec<Item> {
        let all = 0..self.count();
        if !self.is_few() {
            return self.envelope("vehicles", |sample| all.clone().filter_map(|index| value(index, sample)).collect());
        }
        let line = |index: usize| {
            let values = (0..self.times_s.len()).map(|sample| value(index, sample));
            let name = self.id(index).to_string();
            Item::line(self.over_time(values), Colour::nth(index)).marked(index).at_end(name)
        };
        all.map(line).collect()
    }

    /// Lines of the least, median and largest of many values at each sample.
    fn envelope(&self, of_what: &str, values: impl Fn(usize) -> Vec<f64>) -> Vec<Item> {
        let mut all: Vec<_> = (0..self.times_s.len()).map(values).collect();
        let mut line = |share: f64| self.over_time(all.iter_mut().map(|values| quantile(values, share)));
        let (least, middle, largest) = (line(0.0), line(0.5), line(1.0));
        let between =
            |(low, high): (&Vec<[f64; 2]>, &Vec<[f64; 2]>)| low.iter().chain(high.iter().rev()).copied().collect();
        let area = least.iter().zip(&largest).map(between).collect();
        vec![
            Item::new(figure::Shape::Area(area), Colour::SKY.faint(0.35))
                .in_legend(format!("all {of_what}, least to largest")),
            Item::line(least, Colour::BLUE).wide(0.9).at_end("least"),
            Item::line(largest, Colour::BLUE).wide(0.9).at_end("largest"),
            Item::line(middle, Colour::VERMILLION).wide(1.8).at_end("median"),
        ]
    }

    /// A line over time of a value that operators may have changed: two points if it has always been the same.
    fn level_over_time(&self, values: impl Iterator<Item = Option<f64>>) -> Vec<Vec<[f64; 2]>> {
        let mut line = self.over_time(values);
        for piece in &mut line {
            let is_level = piece.windows(2).all(|pair| pair[0][1] == pair[1][1]);
            if is_level && piece.len() > 2 {
                piece.drain(1..piece.len() - 1);
            }
        }
        line
    }

    /// A line over time, with gaps where a value is missing.
    fn over_time(&self, values: impl Iterator<Item = Option<f64>>) -> Vec<Vec<[f64; 2]>> {
        pieces(self.times_s.iter().zip(values).map(|(t_s, value)| Some([*t_s, value?])))
    }
}

/// Whether the vehicle is an active member that has not landed.
fn is_flying_member(trace: &Trace) -> bool {
    trace.membership == Membership::Active && trace.activity != Activity::Landed
}

/// The last step at or before each time.
fn at_times<'a>(steps: &'a [Step], times_s: &[f64], recorded_s: f64) -> Vec<Option<&'a Step>> {
    let oldest_s = OLDEST_S.max(1.5 * recorded_s);
    let at = |t_s: &f64| {
        // Half a microsecond of tolerance for the rounding of sums.
        let past = steps.partition_point(|step| step.t_s <= t_s + 5e-7);
        steps.get(past.checked_sub(1)?).filter(|step| t_s - step.t_s < oldest_s)
    };
    times_s.iter().map(at).collect()
}

/// Splits a sequence of places into pieces where a place is missing.
pub(super) fn pieces(places: impl Iterator<Item = Option<[f64; 2]>>) -> Vec<Vec<[f64; 2]>> {
    let mut pieces = vec![Vec::new()];
    for place in places {
        match (place, pieces.last_mut()) {
            (Some(place), Some(piece)) => piece.push(place),
            (None, Some(piece)) if !piece.is_empty() => pieces.push(Vec::new()),
            _ => {}
        }
    }
    pieces.retain(|piece| !piece.is_empty());
    pieces
}

/// Level ρ of a member in the formation of its step, m: the radius of the similar ellipse through its position.
fn level_m(scenario: &Scenario, trace: &Trace) -> Option<f64> {
    let formation = scenario.formation_with(trace.step, &trace.settings)?;
    let centre = PositionNed::new(trace.centre_ne_m[0], trace.centre_ne_m[1], -formation.altitude_m);
    Some(StepShape::of_formation(&formation).level_m(trace.position - centre))
}

/// The radii R_in, R*, R_out of a formation, m; `None` where its law does not define them.
fn radii_m(formation: &Formation) -> [Option<f64>; 3] {
    let is_ring = formation.law == Law::Ring;
    let edge_m = |width_m: f64| is_ring.then_some(formation.radius_m + width_m);
    [edge_m(-formation.inner_width_m), Some(formation.radius_m), edge_m(formation.outer_width_m)]
}

/// Converts north and east to the axes of a map: east and north.
fn on_map(ne_m: [f64; 2]) -> [f64; 2] {
    [ne_m[1], ne_m[0]]
}

fn place_on_map(position: PositionNed) -> [f64; 2] {
    [position.east_m(), position.north_m()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_a_gap_where_a_place_is_missing() {
        let places = [None, Some([0.0, 1.0]), Some([1.0, 1.0]), None, None, Some([4.0, 2.0])];
        assert_eq!(pieces(places.into_iter()), [vec![[0.0, 1.0], [1.0, 1.0]], vec![[4.0, 2.0]]]);
        assert!(pieces(std::iter::empty()).is_empty());
    }
}
