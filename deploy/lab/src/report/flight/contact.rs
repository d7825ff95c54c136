//! Draws which vehicle receives which other one over time.
//!
//! Up to [`FEW_PAIRS`] vehicles have a row for every pair of receiver and sender, coloured by the age of the sender's
//! newest state at the receiver. More vehicles have a row for each receiver, coloured by the share of the running vehicles
//! that it receives. Below, the number of groups into which the swarm is cut apart.

use std::ops::Range;

use skein_common::state::{Membership, PeerStatus};

use super::marks::with_marks;
use super::{Flight, pieces};
use crate::metrics::Components;
use crate::report::figure::{Axis, Colour, Drawing, Item, Panel, Shape};

/// Most vehicles with a row for each pair.
const FEW_PAIRS: usize = 16;
/// Most vehicles whose pairs are named one by one.
const FEW_NAMES: usize = 6;
/// Height of a row that has its name, and least height of a raster, px.
const NAME_PX: f64 = 16.0;
const LEAST_PX: f64 = 400.0;
/// Share of the picture that the raster takes.
const RASTER: f64 = 0.76;
/// Number of columns of the raster.
const COLUMNS: usize = 320;
/// Limits of the ages of the raster's colours, s.
const AGES_S: [f64; 3] = [0.5, 1.0, 2.0];
/// Shares of the swarm, the limits of the colours of a large one.
const SHARES: [f64; 4] = [1.0, 0.75, 0.5, 0.25];

/// The contact of a receiver with a sender during one column of the raster, from the best to the worst.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Contact {
    /// Its newest state is younger than this limit of [`AGES_S`], or older than all of them.
    Received(usize),
    /// Contact is lost, or was never made, because the sender's agent does not run or has left the swarm.
    Gone,
    /// Contact is lost or was never made although the sender is in the swarm.
    Lost,
}

/// Draws who receives whom; `None` for a single vehicle, or without a recorded step.
pub(super) fn contact(flight: &Flight<'_>) -> Option<Drawing> {
    let count = flight.count();
    if count < 2 || flight.times_s.len() < 2 {
        return None;
    }
    let (mut raster, caption) = if count <= FEW_PAIRS { by_pairs(flight) } else { by_receivers(flight) };
    raster.place = [0.0, 0.0, 1.0, RASTER];
    let (raster, marked) = with_marks(flight, raster);
    let mut groups = groups_panel(flight);
    groups.place = [0.0, RASTER + 0.01, 1.0, 1.0];
    let rows = if count <= FEW_PAIRS { count * count } else { count };
    let row_px = if count <= FEW_NAMES { NAME_PX } else { 0.0 };
    let height_px = 130.0 + (row_px * rows as f64).max(if count <= 4 { 0.0 } else { LEAST_PX }) / RASTER;
    let caption = format!(
        "{caption} Below, the number of groups into which the swarm is cut apart: two vehicles are in one group if each \
         receives the other, directly or through others.{marked}"
    );
    Some(flight.figure("contact", "Which vehicle receives which", caption, height_px, vec![raster, groups]))
}

/// The contact of the receiver with the sender at a sample; `None` while the receiver's agent does not run.
fn contact_at(flight: &Flight<'_>, sample: usize, receiver: usize, sender: usize) -> Option<Contact> {
    let trace = &flight.seen[receiver].get(sample).copied().flatten()?.trace;
    let id = flight.id(sender);
    let peer = trace.peers.iter().find(|peer| peer.id == id && peer.standing != PeerStatus::Lost);
    Some(match peer {
        Some(peer) => {
            Contact::Received(AGES_S.iter().position(|limit_s| peer.age_s <= *limit_s).unwrap_or(AGES_S.len()))
        }
        None if has_gone(flight, sample, sender) => Contact::Gone,
        None => Contact::Lost,
    })
}

/// Whether a vehicle's agent does not run, or has left the swarm.
fn has_gone(flight: &Flight<'_>, sample: usize, vehicle: usize) -> bool {
    let step = flight.seen[vehicle].get(sample).copied().flatten();
    step.is_none_or(|step| step.trace.membership == Membership::Left)
}

/// The first and the last sample of each column of the raster, and the column's ends on the time axis, s.
fn columns(flight: &Flight<'_>) -> Vec<(Range<usize>, [f64; 2])> {
    let samples = flight.times_s.len();
    let each = samples.div_ceil(COLUMNS).max(1);
    let apart_s = flight.times_s[1] - flight.times_s[0];
    let column = |first: usize| {
        let last = (first + each).min(samples);
        (first..last, [flight.times_s[first] - apart_s, flight.times_s[last - 1]])
    };
    (0..samples).step_by(each).map(column).collect()
}

/// Adds a cell to those of its colour. It lengthens the cell before if that has the same colour and row.
fn put(cells: &mut Vec<([f64; 2], [f64; 2])>, [from_s, to_s]: [f64; 2], [low, high]: [f64; 2]) {
    match cells.last_mut() {
        Some((before, end)) if before[1] == low && (end[0] - from_s).abs() < 1e-6 => end[0] = to_s,
        _ => cells.push(([from_s, low], [to_s, high])),
    }
}

/// The raster with these rows, each at its place on the axis. A shade is a colour with its name in the legend;
/// `shade_of` chooses that of a row in the samples of a column.
fn raster<Row>(
    flight: &Flight<'_>,
    axis: Axis,
    rows: impl Iterator<Item = (f64, Row)>,
    shades: Vec<(Colour, String)>,
    shade_of: impl Fn(&Row, &Range<usize>) -> Option<usize>,
) -> Panel {
    let columns = columns(flight);
    let mut cells = vec![Vec::new(); shades.len()];
    for (middle, row) in rows {
        for (samples, ends_s) in &columns {
            if let Some(shade) = shade_of(&row, samples) {
                put(&mut cells[shade], *ends_s, [middle - 0.5, middle + 0.5]);
            }
        }
    }
    let shaded = shades.into_iter().zip(cells).filter(|(_, cells)| !cells.is_empty());
    let item = |((colour, name), cells)| Item::new(Shape::Cells(cells), colour).in_legend(name);
    Panel { items: shaded.map(item).collect(), ..Panel::new(flight.time_axis(), axis) }
}

/// The raster with a row for each pair, grouped by receiver.
fn by_pairs(flight: &Flight<'_>) -> (Panel, String) {
    let count = flight.count();
    // Each group of rows is followed by a gap.
    let row = |(receiver, sender): (usize, usize)| {
        let nth = if sender > receiver { sender - 1 } else { sender };
        -((receiver * count + nth) as f64 + 1.0)
    };
    let pairs = || {
        let all = (0..count).flat_map(move |receiver| (0..count).map(move |sender| (receiver, sender)));
        all.filter(|(receiver, sender)| receiver != sender)
    };
    let named_each = count <= FEW_NAMES;
    let names: Vec<(f64, String)> = if named_each {
        let name = |(receiver, sender)| format!("{} from {}", flight.id(receiver), flight.id(sender));
        pairs().map(|pair| (row(pair), name(pair))).collect()
    } else {
        let middle = |receiver: usize| -((receiver * count) as f64 + count as f64 / 2.0);
        (0..count).map(|receiver| (middle(receiver), flight.id(receiver).to_string())).collect()
    };
    let axis = if named_each { "receiver from sender" } else { "receiver, a row for each sender" };
    let axis = Axis::named(axis, names).within(-((count * count) as f64 - 0.4), -0.4);
    let shades = vec![
        (Colour::of_amount(0.0), format!("state younger than {} s", AGES_S[0])),
        (Colour::of_amount(0.45), format!("{} to {} s", AGES_S[0], AGES_S[1])),
        (Colour::of_amount(0.75), format!("{} to {} s", AGES_S[1], AGES_S[2])),
        (Colour::of_amount(1.0), format!("older than {} s", AGES_S[2])),
        (Colour::PALE, "sender does not run or has left".to_owned()),
        (Colour::VERMILLION, "not received".to_owned()),
    ];
    let shade_of = |&(receiver, sender): &(usize, usize), samples: &Range<usize>| {
        let worst = samples.clone().filter_map(|sample| contact_at(flight, sample, receiver, sender)).max()?;
        Some(match worst {
            Contact::Received(limit) => limit,
            Contact::Gone => AGES_S.len() + 1,
            Contact::Lost => AGES_S.len() + 2,
        })
    };
    let panel = raster(flight, axis, pairs().map(|pair| (row(pair), pair)), shades, shade_of);
    let caption = "A row for each receiver and sender, grouped by receiver: the age of the sender's newest state at the \
                   receiver, the oldest in each column. Blank: the receiver's agent does not run.";
    (panel, caption.to_owned())
}

/// The raster with a row for each receiver of a large swarm.
fn by_receivers(flight: &Flight<'_>) -> (Panel, String) {
    let count = flight.count();
    let row = |receiver: usize| -(receiver as f64 + 1.0);
    let names = (0..count).map(|receiver| (row(receiver), flight.id(receiver).to_string())).collect();
    let shades = [
        (Colour::of_amount(0.0), "receives all others"),
        (Colour::of_amount(0.4), "75 % or more"),
        (Colour::of_amount(0.7), "50 % or more"),
        (Colour::of_amount(1.0), "25 % or more"),
        (Colour::VERMILLION, "fewer than 25 %"),
    ];
    let shades = shades.map(|(colour, name)| (colour, name.to_owned())).to_vec();
    let shade_of = |&receiver: &usize, samples: &Range<usize>| {
        // One sample stands for its column: a large swarm has thousands of pairs.
        let sample = samples.end - 1;
        let others = (0..count).filter(|sender| *sender != receiver);
        let of = others.filter_map(|sender| contact_at(flight, sample, receiver, sender));
        let of: Vec<Contact> = of.filter(|contact| *contact != Contact::Gone).collect();
        let received = of.iter().filter(|contact| **contact != Contact::Lost).count();
        let share = received as f64 / of.len() as f64;
        let shade = SHARES.iter().position(|least| share >= *least).unwrap_or(SHARES.len());
        (!of.is_empty()).then_some(shade)
    };
    let rows = (0..count).map(|receiver| (row(receiver), receiver));
    let panel = raster(flight, Axis::named("receiver", names), rows, shades, shade_of);
    let caption = "A row for each receiver: the share of the other vehicles in the swarm of which it has a state. Blank: \
                   the receiver's agent does not run.";
    (panel, caption.to_owned())
}

/// The panel with the number of groups over time.
fn groups_panel(flight: &Flight<'_>) -> Panel {
    let columns = columns(flight);
    let most = |(samples, [from_s, to_s]): &(Range<usize>, [f64; 2])| {
        let groups = groups(flight, samples.end - 1);
        let level = (groups > 0).then_some(groups as f64);
        [level.map(|groups| [*from_s, groups]), level.map(|groups| [*to_s, groups])]
    };
    let places: Vec<Option<[f64; 2]>> = columns.iter().flat_map(most).collect();
    let largest = places.iter().flatten().map(|place| place[1]).fold(2.0, f64::max);
    let mut panel = Panel::new(flight.time_axis(), Axis::new("groups", "1").within(0.0, largest + 0.5));
    panel
        .items
        .push(Item::line(pieces(places.into_iter()), Colour::BLUE).wide(1.8).meaning("Line: the number of groups"));
    panel
}

/// Into how many groups the vehicles of the swarm are cut apart at this sample. Vehicles that have left or do not run are
/// in none.
fn groups(flight: &Flight<'_>, sample: usize) -> usize {
    let members: Vec<usize> = (0..flight.count()).filter(|vehicle| !has_gone(flight, sample, *vehicle)).collect();
    let receives = |receiver: usize, sender: usize| {
        contact_at(flight, sample, receiver, sender).is_some_and(|contact| contact < Contact::Gone)
    };
    let mut components = Components::default();
    components.find(members.len(), |one, other| {
        let (one, other) = (members[one], members[other]);
        receives(one, other) && receives(other, one)
    });
    components.sizes.len()
}
