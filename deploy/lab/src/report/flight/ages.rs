//! Draws the ages of peers' states.

use skein_common::state::PeerStatus;

use super::Flight;
use super::marks::with_marks;
use super::traces::histogram;
use crate::report::figure::{Axis, Colour, Drawing, Item, Panel, Shape};
use skein_common::statistics::quantile;

/// Number of time spans in the panel over time.
const STRETCHES: usize = 160;
/// Shades of the panel by pairs.
const SHADES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// Draws the ages over time, as a histogram, and by pairs; `None` if no vehicle receives a peer.
pub(super) fn ages(flight: &Flight<'_>) -> Option<Drawing> {
    let mut all_ms: Vec<f64> = (0..flight.times_s.len()).flat_map(|sample| at_ms(flight, sample)).collect();
    let (oldest_ms, high_ms) = (quantile(&mut all_ms, 1.0)?, quantile(&mut all_ms, 0.99)?);
    // A few very old states from cut links would compress all others into a thin line: cut the axis off.
    let limit_ms = if oldest_ms > 3.0 * high_ms && high_ms > 0.0 { 2.0 * high_ms } else { oldest_ms };
    let (mut over_time, marked) = with_marks(flight, over_time(flight, limit_ms));
    over_time.place = [0.0, 0.0, 1.0, 0.46];
    all_ms.retain(|age_ms| *age_ms <= limit_ms);
    let cut = if limit_ms < oldest_ms {
        format!(" Ages above {limit_ms:.0} ms, up to {oldest_ms:.0} ms, are cut off.")
    } else {
        String::new()
    };
    let mut shares = histogram(&all_ms, Axis::new("age", "ms").including(0.0));
    shares.place = [0.0, 0.47, 0.5, 1.0];
    shares.title = "All states".to_owned();
    let mut pairs = by_pairs(flight);
    pairs.place = [0.5, 0.47, 1.0, 1.0];
    let caption = format!(
        "Age of every peer's newest state at every step, by the receiver's clock, without lost peers. Below right, the 99th percentile of the age for each receiver (up) and sender (across).{cut}{marked}"
    );
    Some(flight.figure("message-age", "Age of peers' states", caption, 700.0, vec![over_time, shares, pairs]))
}

/// The ages of all peers that are not lost at this sample, ms.
fn at_ms(flight: &Flight<'_>, sample: usize) -> Vec<f64> {
    let peers = flight.at(sample).flat_map(|(_, trace)| &trace.peers);
    peers.filter(|peer| peer.standing != PeerStatus::Lost).map(|peer| peer.age_s * 1e3).collect()
}

fn over_time(flight: &Flight<'_>, limit_ms: f64) -> Panel {
    let samples = flight.times_s.len();
    let each = samples.div_ceil(STRETCHES).max(1);
    let stretch = |first: usize| {
        let last = (first + each).min(samples);
        let ages_ms: Vec<f64> = (first..last).flat_map(|sample| at_ms(flight, sample)).collect();
        (flight.times_s[first..last].iter().sum::<f64>() / (last - first) as f64, ages_ms)
    };
    let mut stretches: Vec<_> = (0..samples).step_by(each).map(stretch).collect();
    let mut line =
        |share: f64| super::pieces(stretches.iter_mut().map(|(t_s, ages_ms)| Some([*t_s, quantile(ages_ms, share)?])));
    let mut panel = Panel::new(flight.time_axis(), Axis::new("age", "ms").including(0.0).within(0.0, 1.05 * limit_ms));
    panel.items = vec![
        Item::line(line(1.0), Colour::GREY).wide(1.0).at_end("oldest"),
        Item::line(line(0.99), Colour::VERMILLION).dashed().at_end("99 %"),
        Item::line(line(0.5), Colour::BLUE).wide(2.0).at_end("median"),
    ];
    panel
}

/// A panel with a field for each receiver and sender.
fn by_pairs(flight: &Flight<'_>) -> Panel {
    let count = flight.count();
    let names = |sign: f64| (0..count).map(|nth| (sign * (nth as f64 + 1.0), flight.id(nth).to_string())).collect();
    let mut panel = Panel::new(Axis::named("sender", names(1.0)), Axis::named("receiver", names(-1.0)));
    panel.title = "By pairs".to_owned();
    let mut ages_ms = vec![Vec::new(); count * count];
    for sample in 0..flight.times_s.len() {
        for (receiver, trace) in flight.at(sample) {
            for peer in trace.peers.iter().filter(|peer| peer.standing != PeerStatus::Lost) {
                let Some(sender) = flight.index(peer.id) else { continue };
                ages_ms[receiver * count + sender].push(peer.age_s * 1e3);
            }
        }
    }
    let high_ms: Vec<Option<f64>> = ages_ms.iter_mut().map(|ages_ms| quantile(ages_ms, 0.99)).collect();
    let known = || high_ms.iter().flatten().copied();
    let (Some(least_ms), Some(largest_ms)) = (known().reduce(f64::min), known().reduce(f64::max)) else { return panel };
    let step_ms = (largest_ms - least_ms) / SHADES.len() as f64;
    let shade = |age_ms: f64| (((age_ms - least_ms) / step_ms.max(1e-9)) as usize).min(SHADES.len() - 1);
    for (nth, share) in SHADES.into_iter().enumerate() {
        let field = |(pair, age_ms): (usize, &Option<f64>)| {
            let (receiver, sender) = (pair / count, pair % count);
            let (x, y) = (sender as f64 + 1.0, -(receiver as f64 + 1.0));
            let corners = ([x - 0.46, y - 0.46], [x + 0.46, y + 0.46], String::new());
            age_ms.filter(|age_ms| shade(*age_ms) == nth).map(|_| corners)
        };
        let bars: Vec<_> = high_ms.iter().enumerate().filter_map(field).collect();
        if !bars.is_empty() {
            let (from, to) = (least_ms + nth as f64 * step_ms, least_ms + (nth as f64 + 1.0) * step_ms);
            let name = if step_ms < 0.5 { format!("{least_ms:.0} ms") } else { format!("{from:.0}–{to:.0} ms") };
            panel.items.push(Item::new(Shape::Bars(bars), Colour::of_amount(share)).in_legend(name));
        }
    }
    panel
}
