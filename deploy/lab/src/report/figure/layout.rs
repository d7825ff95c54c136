//! The layout of a figure: places axes, legend, marks and names so that none covers another.

use super::axis::Scale;
use super::canvas::{Anchor, Canvas, SMALL_PX, text_width};
use super::plot::{Plot, draw, extent, swatch};
use super::{Colour, Drawing, Item, Mark, Name, Panel, Shape};

/// Sizes of letters, px.
const TITLE_PX: f64 = 18.5;
const PANEL_TITLE_PX: f64 = 15.0;
const LABEL_PX: f64 = 14.0;
/// Height of a line of small letters, px.
const LINE_PX: f64 = 16.0;
/// Names beside the ends of lines are cut to this width, px.
const WIDEST_NAME_PX: f64 = 150.0;
/// Numbers beside the y axis are this far apart at least, px.
const TICKS_PX: f64 = 38.0;
/// And numbers below the x axis.
const TICKS_ACROSS_PX: f64 = 80.0;

/// The figure's SVG.
pub(super) fn svg(figure: &Drawing) -> String {
    let [width, height] = figure.size_px;
    let mut canvas = Canvas::new(figure.size_px, &format!("{}. {}", figure.title, figure.subject));
    let mut top = 0.0;
    if !figure.title.is_empty() {
        canvas.text([12.0, 17.0], &figure.title, TITLE_PX, Colour::BLACK, Anchor::Left);
        canvas.text([12.0, 37.0], &figure.subject, SMALL_PX, Colour::GREY, Anchor::Left);
        top = 50.0;
    }
    let place = |panel: &Panel| {
        let [left, upper, right, lower] = panel.place;
        let down = |share: f64| top + share * (height - top);
        [left * width, down(upper), right * width, down(lower)]
    };
    for (one, margins) in figure.panels.iter().zip(margins(&figure.panels, place)) {
        panel(one, place(one), margins, &mut canvas);
    }
    canvas.finish()
}

/// The scales of a panel's axes.
fn scales(panel: &Panel) -> [Scale; 2] {
    let [x_numbers, y_numbers] = [0, 1].map(|axis| panel.items.iter().flat_map(move |item| extent(&item.shape, axis)));
    let marks_x = panel.marks.iter().map(|mark| mark.x);
    let padding = if panel.is_map { 0.05 } else { 0.0 };
    [panel.x.scale(x_numbers.chain(marks_x), padding), panel.y.scale(y_numbers, 0.05)]
}

/// Left and right of each panel's plot, px. Panels above each other have plots above each other.
fn margins(panels: &[Panel], place: impl Fn(&Panel) -> [f64; 4]) -> Vec<[f64; 2]> {
    let own = |panel: &Panel| {
        let [left, top, right, bottom] = place(panel);
        let [x, y] = scales(panel);
        let ticks = panel.y.ticks(&y, bottom - top, TICKS_PX);
        let label_px = LINE_PX * (y_label(panel, bottom - top).len() as f64 - 1.0);
        let left_px = 36.0 + label_px + ticks.iter().map(|(_, text)| text_width(text, SMALL_PX)).fold(0.0, f64::max);
        // A number stands around its tick, and the last tick may be at the very end.
        let width_px = right - left - left_px;
        let beyond_px = |(at, text): &(f64, String)| text_width(text, SMALL_PX) / 2.0 - (1.0 - x.share(*at)) * width_px;
        let x_ticks = if panel.x.is_named() { Vec::new() } else { panel.x.ticks(&x, width_px, TICKS_ACROSS_PX) };
        let right_px = x_ticks.iter().map(beyond_px).fold(16.0, f64::max);
        let names_px = panel.items.iter().filter_map(|item| match &item.name {
            Name::AtEnd(name) => Some(text_width(name, SMALL_PX) + 14.0),
            Name::None | Name::InLegend(_) | Name::OnLine(_) => None,
        });
        [left_px, names_px.fold(right_px, f64::max).min(WIDEST_NAME_PX)]
    };
    let all: Vec<_> = panels.iter().map(|panel| (panel.place[0], panel.place[2], own(panel))).collect();
    let widest = |(left, right, _): &(f64, f64, [f64; 2])| {
        let above = all.iter().filter(|other| other.0 == *left && other.1 == *right);
        above.fold([0.0; 2], |widest: [f64; 2], (.., own)| [widest[0].max(own[0]), widest[1].max(own[1])])
    };
    all.iter().map(widest).collect()
}

/// A panel between left, top, right, bottom, with these margins left and right of its plot.
fn panel(panel: &Panel, [left, top, right, bottom]: [f64; 4], margins: [f64; 2], canvas: &mut Canvas) {
    let [x, y] = scales(panel);
    // The axes' lines lie on whole pixels, and what is drawn at zero lies on them.
    let crisp = |px: f64| px.floor() + 0.5;
    let (plot_left, plot_right) = (crisp(left + margins[0]), crisp(right - margins[1]));
    let mut plot = Plot { left: plot_left, top: top + 6.0, right: plot_right, bottom: crisp(bottom - 46.0), x, y };

    if !panel.title.is_empty() {
        canvas.text([plot.left, plot.top + 8.0], &panel.title, PANEL_TITLE_PX, Colour::BLACK, Anchor::Left);
        plot.top += 22.0;
    }
    plot.top = legend(panel, &plot, right, canvas);
    let labels = labels(&panel.marks, &plot, right);
    let words_top = plot.top;
    let rows = labels.iter().map(|(.., row)| row + 1).max().unwrap_or(0);
    plot.top = crisp(plot.top + LINE_PX * rows as f64 + 4.0);
    if panel.is_map {
        plot.keep_scale();
    }

    // Areas lie below everything else.
    let is_area = |item: &&Item| matches!(item.shape, Shape::Area(_));
    panel.items.iter().filter(is_area).for_each(|item| draw(item, panel, &plot, canvas));
    panel.items.iter().filter(|item| !is_area(item)).for_each(|item| draw(item, panel, &plot, canvas));
    axes(panel, &plot, left, &y_label(panel, bottom - top), canvas);
    let height = |row: usize| words_top + (row as f64 + 0.5) * LINE_PX;
    for (mark, (.., row)) in panel.marks.iter().zip(&labels) {
        let x = plot.x_px(mark.x);
        canvas.rule([x, height(*row) - 5.0], [x, plot.bottom], Colour::GREY);
    }
    for (mark, (from, _, row)) in panel.marks.iter().zip(&labels) {
        canvas.text_on_paper([from + 4.0, height(*row)], &mark.text, SMALL_PX, Colour::BLACK, Anchor::Left);
    }
    names(panel, &plot, canvas);
}

/// The axes' lines, ticks, numbers and labels.
fn axes(panel: &Panel, plot: &Plot, left: f64, y_label: &[String], canvas: &mut Canvas) {
    let Plot { top, right, bottom, .. } = *plot;
    canvas.rule([plot.left, top], [plot.left, bottom], Colour::BLACK);
    canvas.rule([plot.left, bottom], [right, bottom], Colour::BLACK);
    let widest_px = panel.x.names().map(|name| text_width(name, SMALL_PX) + 10.0).fold(0.0, f64::max);
    let apart_px = if panel.x.is_named() { widest_px } else { TICKS_ACROSS_PX };
    for (number, text) in panel.x.ticks(&plot.x, right - plot.left, apart_px) {
        let x = plot.x_px(number);
        canvas.rule([x, bottom], [x, bottom + 4.0], Colour::BLACK);
        canvas.text([x, bottom + 14.0], &text, SMALL_PX, Colour::BLACK, Anchor::Centre);
    }
    // Names may stand closer than numbers.
    let apart_px = if panel.y.is_named() { 15.0 } else { TICKS_PX };
    for (number, text) in panel.y.ticks(&plot.y, bottom - top, apart_px) {
        let y = plot.at([0.0, number])[1];
        canvas.rule([plot.left - 4.0, y], [plot.left, y], Colour::BLACK);
        canvas.text([plot.left - 7.0, y], &text, SMALL_PX, Colour::BLACK, Anchor::Right);
    }
    let middle = [(plot.left + right) / 2.0, (top + bottom) / 2.0];
    canvas.text([middle[0], bottom + 34.0], &panel.x.label, LABEL_PX, Colour::BLACK, Anchor::Centre);
    for (nth, line) in y_label.iter().enumerate() {
        canvas.text_upwards([left + 12.0 + LINE_PX * nth as f64, middle[1]], line, LABEL_PX, Colour::BLACK);
    }
}

/// The label of the y axis of a panel of this height in one line, or in two if it is longer than the plot.
fn y_label(panel: &Panel, height_px: f64) -> Vec<String> {
    // Title, legend and marks above the plot, numbers and label below it.
    const BESIDE_PLOT_PX: f64 = 100.0;
    let label = &panel.y.label;
    if text_width(label, LABEL_PX) <= height_px - BESIDE_PLOT_PX {
        return vec![label.to_owned()];
    }
    let halves = label.match_indices(' ').map(|(at, _)| (&label[..at], &label[at + 1..]));
    let longer_px = |(one, other): &(&str, &str)| text_width(one, LABEL_PX).max(text_width(other, LABEL_PX));
    let best = halves.min_by(|one, other| longer_px(one).total_cmp(&longer_px(other)));
    best.map_or_else(|| vec![label.to_owned()], |(one, other)| vec![one.to_owned(), other.to_owned()])
}

/// The legend, wrapped; gives where it ends, px.
fn legend(panel: &Panel, plot: &Plot, right: f64, canvas: &mut Canvas) -> f64 {
    let mut entries: Vec<(&str, Vec<&Item>)> = Vec::new();
    for item in &panel.items {
        let Name::InLegend(name) = &item.name else { continue };
        match entries.iter_mut().find(|(known, _)| known == name) {
            Some((_, items)) => items.push(item),
            None => entries.push((name, vec![item])),
        }
    }
    let (mut x, mut y) = (plot.left, plot.top + LINE_PX / 2.0);
    for (name, items) in &entries {
        let width = 28.0 + text_width(name, SMALL_PX) + 12.0;
        if x + width > right && x > plot.left {
            (x, y) = (plot.left, y + LINE_PX);
        }
        // One swatch of each sort.
        let mut kinds = Vec::new();
        for item in items {
            let kind = std::mem::discriminant(&item.shape);
            if !kinds.contains(&kind) {
                kinds.push(kind);
                swatch(item, [x, y], canvas);
            }
        }
        canvas.text([x + 28.0, y], name, SMALL_PX, Colour::BLACK, Anchor::Left);
        x += width;
    }
    if entries.is_empty() { plot.top } else { y + LINE_PX / 2.0 + 2.0 }
}

/// Left and right end of each mark's label above the plot, px, and its row, 0 the highest. A label that overlaps an
/// earlier one is placed in a lower row, so that no mark's line crosses a label.
fn labels(marks: &[Mark], plot: &Plot, right: f64) -> Vec<(f64, f64, usize)> {
    let mut labels: Vec<(f64, f64, usize)> = Vec::with_capacity(marks.len());
    for mark in marks {
        let width = text_width(&mark.text, SMALL_PX) + 10.0;
        let from = plot.x_px(mark.x).min(right - width);
        let above = labels.iter().filter(|(_, to, _)| *to > from).map(|(.., row)| row + 1).max();
        labels.push((from, from + width, above.unwrap_or(0)));
    }
    labels
}

/// Names beside the ends of lines, pushed apart.
fn names(panel: &Panel, plot: &Plot, canvas: &mut Canvas) {
    let mut ends: Vec<([f64; 2], &str, Colour)> = Vec::new();
    limits(panel, plot, canvas);
    for item in &panel.items {
        let (Name::AtEnd(name), Shape::Line { pieces, .. }) = (&item.name, &item.shape) else { continue };
        let end = pieces.iter().rev().flat_map(|piece| piece.last()).next();
        let Some(end) = end.map(|end| plot.held(plot.at(*end))) else { continue };
        if end[0] < plot.right - 24.0 {
            // It ends before the others: its name stands where it ends.
            canvas.text_on_paper([end[0] + 7.0, end[1]], name, SMALL_PX, item.colour, Anchor::Left);
        } else {
            ends.push((end, name, item.colour));
        }
    }
    ends.sort_by(|one, other| one.0[1].total_cmp(&other.0[1]));
    let wanted: Vec<f64> = ends.iter().map(|(end, ..)| end[1]).collect();
    let places = apart(&wanted, LINE_PX - 2.0, plot.top, plot.bottom);
    for ((end, name, colour), y) in ends.iter().zip(places) {
        let x = plot.right + 10.0;
        canvas.lines(&[vec![[end[0] + 1.0, end[1]], [x - 2.0, y]]], 0.8, false, colour.faint(0.6));
        canvas.text([x, y], name, SMALL_PX, *colour, Anchor::Left);
    }
}

/// Names of limits on their lines: each above the line's left end or below it, or farther to the right where another name
/// is in the way.
fn limits(panel: &Panel, plot: &Plot, canvas: &mut Canvas) {
    // Left and right end and middle of the names so far, px.
    let mut taken: Vec<[f64; 3]> = Vec::new();
    for item in &panel.items {
        let (Name::OnLine(name), Shape::Line { pieces, .. }) = (&item.name, &item.shape) else { continue };
        let begins = pieces.iter().find_map(|piece| piece.first()).map(|place| plot.at(*place));
        let Some([x, y]) = begins.filter(|[_, y]| (plot.top..=plot.bottom).contains(y)) else { continue };
        let width = text_width(name, SMALL_PX) + 8.0;
        let places = (0..40).flat_map(|nth| {
            let from = x.max(plot.left) + 6.0 + 12.0 * f64::from(nth);
            [y - 9.0, y + 9.0].map(|middle| [from, from + width, middle])
        });
        let is_free = |[from, to, middle]: &[f64; 3]| {
            let is_inside = *to < plot.right && (plot.top + 4.0..plot.bottom - 4.0).contains(middle);
            let overlaps =
                |other: &[f64; 3]| other[0] < *to && *from < other[1] && (other[2] - middle).abs() < LINE_PX - 3.0;
            is_inside && !taken.iter().any(overlaps)
        };
        let Some(place) = places.into_iter().find(is_free) else { continue };
        taken.push(place);
        canvas.text_on_paper([place[0], place[2]], name, SMALL_PX, item.colour, Anchor::Left);
    }
}

/// Sorted places moved as little as keeps them this far apart and within the bounds, if that is possible.
fn apart(wanted: &[f64], least: f64, from: f64, to: f64) -> Vec<f64> {
    // Less the room of those before it, a place may be where the one before it is, but not above. Those that want to be
    // above meet where they want to be on average.
    let mut groups: Vec<(f64, usize)> = Vec::new();
    for (nth, place) in wanted.iter().enumerate() {
        let (mut sum, mut count) = (place - nth as f64 * least, 1);
        while let Some((before, members)) =
            groups.pop_if(|(before, members)| *before / *members as f64 > sum / count as f64)
        {
            (sum, count) = (sum + before, count + members);
        }
        groups.push((sum, count));
    }
    let last = (to - (wanted.len() as f64 - 1.0) * least).max(from);
    let places = groups.iter().flat_map(|(sum, count)| vec![(sum / *count as f64).clamp(from, last); *count]);
    places.enumerate().map(|(nth, place)| place + nth as f64 * least).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_pushed_apart_and_stay_inside() {
        assert_eq!(apart(&[10.0, 50.0], 10.0, 0.0, 100.0), [10.0, 50.0]);
        assert_eq!(apart(&[50.0, 50.0, 50.0], 10.0, 0.0, 100.0), [40.0, 50.0, 60.0]);
        assert_eq!(apart(&[98.0, 99.0], 10.0, 0.0, 100.0), [90.0, 100.0]);
        assert_eq!(apart(&[0.0, 1.0, 30.0], 10.0, 0.0, 100.0), [0.0, 10.0, 30.0]);
        assert!(apart(&[], 10.0, 0.0, 100.0).is_empty());
    }

    #[test]
    fn the_last_number_below_an_axis_has_room() {
        let axis = |to| crate::report::figure::Axis::new("bandwidth", "bit/s").within(0.0, to);
        let right_px = |to| margins(&[Panel::new(axis(to), axis(1.0))], |_| [0.0, 0.0, 300.0, 250.0])[0][1];
        let last_px = text_width("1,000,000", SMALL_PX);
        assert!((right_px(1e6) - last_px / 2.0).abs() < 1e-9);
        assert!(right_px(1.24e6) < last_px / 2.0, "the last number is not at the end");
    }

    #[test]
    fn a_label_that_overlaps_another_is_placed_lower() {
        let scale = |to: f64| crate::report::figure::Axis::new("time", "s").within(0.0, to).scale([].into_iter(), 0.0);
        let plot = Plot { left: 0.0, top: 0.0, right: 800.0, bottom: 100.0, x: scale(800.0), y: scale(1.0) };
        let mark = |x: f64| Mark { x, text: "vehicle 3 killed".to_owned() };
        let marks = [0.0, 20.0, 40.0, 400.0, 790.0].map(mark);
        let rows: Vec<_> = labels(&marks, &plot, 800.0).into_iter().map(|(.., row)| row).collect();
        assert_eq!(rows, [0, 1, 2, 0, 0]);
    }
}
