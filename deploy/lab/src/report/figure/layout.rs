//! Where everything stands: axes, legend, marks and names, so that none covers another.

use plotters::prelude::DrawingBackend;
use skein_common::math;

use super::axis::Scale;
use super::canvas::{Anchor, Canvas, text_width};
use super::{Colour, Figure, Item, Mark, Marker, Name, Panel, Shape, path};
use crate::error::Error;

/// Sizes of letters, px.
const TITLE_PX: f64 = 20.0;
const PANEL_TITLE_PX: f64 = 16.0;
const LABEL_PX: f64 = 15.0;
const SMALL_PX: f64 = 13.5;
/// Height of a line of small letters, px.
const LINE_PX: f64 = 16.0;
/// Names beside the ends of lines are cut to this width, px.
const WIDEST_NAME_PX: f64 = 150.0;
/// Numbers beside the y axis are this far apart at least, px.
const TICKS_PX: f64 = 38.0;
/// And numbers below the x axis.
const TICKS_ACROSS_PX: f64 = 80.0;

/// A panel's plot, and how numbers become pixels in it.
struct Plot {
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
    x: Scale,
    y: Scale,
}

impl Plot {
    fn x_px(&self, x: f64) -> f64 {
        self.left + self.x.share(x) * (self.right - self.left)
    }

    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.x_px(x), self.bottom - self.y.share(y) * (self.bottom - self.top)]
    }

    fn edges(&self) -> [f64; 4] {
        [self.left, self.top, self.right, self.bottom]
    }

    fn holds(&self, [x, y]: [f64; 2]) -> bool {
        (self.left..=self.right).contains(&x) && (self.top..=self.bottom).contains(&y)
    }

    fn held(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x.clamp(self.left, self.right), y.clamp(self.top, self.bottom)]
    }
}

/// The figure's title; gives where the panels begin, px.
pub(super) fn heading<DB: DrawingBackend>(figure: &Figure, canvas: &Canvas<'_, DB>) -> Result<f64, Error> {
    if figure.title.is_empty() {
        return Ok(0.0);
    }
    canvas.text([12.0, 17.0], &figure.title, TITLE_PX, Colour::BLACK, Anchor::Left)?;
    canvas.text([12.0, 37.0], &figure.subject, SMALL_PX, Colour::GREY, Anchor::Left)?;
    Ok(50.0)
}

/// The scales of a panel's axes.
fn scales(panel: &Panel) -> [Scale; 2] {
    let [x_numbers, y_numbers] = [0, 1].map(|axis| panel.items.iter().flat_map(move |item| extent(&item.shape, axis)));
    let marks_x = panel.marks.iter().map(|mark| mark.x);
    let padding = if panel.is_map { 0.05 } else { 0.0 };
    [panel.x.scale(x_numbers.chain(marks_x), padding), panel.y.scale(y_numbers, 0.05)]
}

/// Left and right of each panel's plot, px. Panels above each other have plots above each other.
pub(super) fn margins(panels: &[Panel], place: impl Fn(&Panel) -> [f64; 4]) -> Vec<[f64; 2]> {
    let own = |panel: &Panel| {
        let [left, top, right, bottom] = place(panel);
        let [x, y] = scales(panel);
        let ticks = panel.y.ticks(&y, bottom - top, TICKS_PX);
        let left_px = 36.0 + ticks.iter().map(|(_, text)| text_width(text, SMALL_PX)).fold(0.0, f64::max);
        // A number stands around its tick, and the last tick may be at the very end.
        let width_px = right - left - left_px;
        let beyond_px = |(at, text): &(f64, String)| text_width(text, SMALL_PX) / 2.0 - (1.0 - x.share(*at)) * width_px;
        let x_ticks = if panel.x.is_named() { Vec::new() } else { panel.x.ticks(&x, width_px, TICKS_ACROSS_PX) };
        let right_px = x_ticks.iter().map(beyond_px).fold(16.0, f64::max);
        let names_px = panel.items.iter().filter_map(|item| match &item.name {
            Name::AtEnd(name) => Some(text_width(name, SMALL_PX) + 14.0),
            Name::None | Name::InLegend(_) => None,
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
pub(super) fn panel<DB: DrawingBackend>(
    panel: &Panel,
    [left, top, right, bottom]: [f64; 4],
    margins: [f64; 2],
    canvas: &Canvas<'_, DB>,
) -> Result<(), Error> {
    let [x, y] = scales(panel);
    let mut plot =
        Plot { left: left + margins[0], top: top + 6.0, right: right - margins[1], bottom: bottom - 46.0, x, y };

    if !panel.title.is_empty() {
        canvas.text([plot.left, plot.top + 8.0], &panel.title, PANEL_TITLE_PX, Colour::BLACK, Anchor::Left)?;
        plot.top += 22.0;
    }
    plot.top = legend(panel, &plot, right, canvas)?;
    let rows = mark_rows(&panel.marks, &plot, right);
    let labels_top = plot.top;
    plot.top += LINE_PX * rows.iter().map(|row| row + 1).max().unwrap_or(0) as f64 + 4.0;
    if panel.is_map {
        keep_scale(&mut plot);
    }

    areas_then_rest(panel, &plot, canvas)?;
    axes(panel, &plot, left, canvas)?;
    marks(&panel.marks, &rows, &plot, labels_top, right, canvas)?;
    names(panel, &plot, canvas)
}

/// Areas lie below the axes' lines and everything else.
fn areas_then_rest<DB: DrawingBackend>(panel: &Panel, plot: &Plot, canvas: &Canvas<'_, DB>) -> Result<(), Error> {
    let is_area = |item: &&Item| matches!(item.shape, Shape::Area(_));
    panel.items.iter().filter(is_area).try_for_each(|item| draw(item, panel, plot, canvas))?;
    panel.items.iter().filter(|item| !is_area(item)).try_for_each(|item| draw(item, panel, plot, canvas))
}

/// One metre north is as long as one metre east.
fn keep_scale(plot: &mut Plot) {
    let (width, height) = (plot.right - plot.left, plot.bottom - plot.top);
    let per_px = (plot.x.span() / width).max(plot.y.span() / height);
    plot.x = plot.x.widened(per_px * width);
    plot.y = plot.y.widened(per_px * height);
}

/// The axes' lines, ticks, numbers and labels.
fn axes<DB: DrawingBackend>(panel: &Panel, plot: &Plot, left: f64, canvas: &Canvas<'_, DB>) -> Result<(), Error> {
    let Plot { top, right, bottom, .. } = *plot;
    canvas.line(&[[plot.left, top], [plot.left, bottom], [right, bottom]], 1.0, Colour::BLACK)?;
    let widest_px = panel.x.names().map(|name| text_width(name, SMALL_PX) + 10.0).fold(0.0, f64::max);
    let apart_px = if panel.x.is_named() { widest_px } else { TICKS_ACROSS_PX };
    for (number, text) in panel.x.ticks(&plot.x, right - plot.left, apart_px) {
        let x = plot.x_px(number);
        canvas.line(&[[x, bottom], [x, bottom + 4.0]], 1.0, Colour::BLACK)?;
        canvas.text([x, bottom + 14.0], &text, SMALL_PX, Colour::BLACK, Anchor::Centre)?;
    }
    // Names may stand closer than numbers.
    let apart_px = if panel.y.is_named() { 15.0 } else { TICKS_PX };
    for (number, text) in panel.y.ticks(&plot.y, bottom - top, apart_px) {
        let y = plot.at([0.0, number])[1];
        canvas.line(&[[plot.left - 4.0, y], [plot.left, y]], 1.0, Colour::BLACK)?;
        canvas.text([plot.left - 7.0, y], &text, SMALL_PX, Colour::BLACK, Anchor::Right)?;
    }
    let middle = [(plot.left + right) / 2.0, (top + bottom) / 2.0];
    canvas.text([middle[0], bottom + 34.0], panel.x.label(), LABEL_PX, Colour::BLACK, Anchor::Centre)?;
    canvas.text_upwards([left + 12.0, middle[1]], panel.y.label(), LABEL_PX, Colour::BLACK)
}

fn draw<DB: DrawingBackend>(item: &Item, panel: &Panel, plot: &Plot, canvas: &Canvas<'_, DB>) -> Result<(), Error> {
    let px = |places: &[[f64; 2]]| -> Vec<[f64; 2]> { places.iter().map(|place| plot.at(*place)).collect() };
    match &item.shape {
        Shape::Line { pieces, width_px, is_dashed, markers } => {
            for piece in pieces {
                for line in path::clipped(&px(piece), plot.edges()) {
                    if *is_dashed {
                        canvas.dashed(&line, *width_px, item.colour)?;
                    } else {
                        canvas.line(&line, *width_px, item.colour)?;
                    }
                }
            }
            let Some((marker, phase)) = *markers else { return Ok(()) };
            let mut dots = dots_along(pieces, phase, plot);
            dots.try_for_each(|at| canvas.dot(at, marker, 7.0, item.colour))
        }
        Shape::Area(outlines) => outlines.iter().try_for_each(|outline| {
            let held: Vec<_> = px(outline).into_iter().map(|place| plot.held(place)).collect();
            canvas.fill(&held, item.colour)
        }),
        Shape::Dots { at, marker, size_px } => px(at)
            .into_iter()
            .filter(|place| plot.holds(*place))
            .try_for_each(|place| canvas.dot(place, *marker, *size_px, item.colour)),
        Shape::Bars(bars) => bars.iter().try_for_each(|(from, to, text)| {
            let ([x0, y0], [x1, y1]) = (plot.held(plot.at(*from)), plot.held(plot.at(*to)));
            canvas.fill(&[[x0, y0], [x1, y0], [x1, y1], [x0, y1]], item.colour)?;
            if text.is_empty() || (y1 - y0).abs() < 11.0 {
                return Ok(());
            }
            // In the middle, or else where no mark runs through it.
            let half = text_width(text, SMALL_PX) / 2.0 + 3.0;
            let is_free = |at: &f64| {
                let x = x0 + at * (x1 - x0);
                let is_inside = x0 <= x - half && x + half <= x1;
                is_inside && panel.marks.iter().all(|mark| (plot.x_px(mark.x) - x).abs() > half)
            };
            let Some(at) = [0.5, 0.38, 0.62, 0.25, 0.75, 0.12, 0.88].into_iter().find(is_free) else { return Ok(()) };
            canvas.text([x0 + at * (x1 - x0), (y0 + y1) / 2.0], text, SMALL_PX, Colour::BLACK, Anchor::Centre)
        }),
        Shape::Arrows(arrows) => arrows.iter().try_for_each(|(from, to)| {
            let (from, to) = (plot.at(*from), plot.at(*to));
            if plot.holds(from) && plot.holds(to) { arrow(from, to, item.colour, canvas) } else { Ok(()) }
        }),
        Shape::Note { at, text, side: [right, up] } => {
            let length = math::hypot(*right, *up).max(1e-9);
            let [x, y] = plot.at(*at);
            let anchor = match right / length {
                right if right > 0.4 => Anchor::Left,
                right if right < -0.4 => Anchor::Right,
                _ => Anchor::Centre,
            };
            let place = [x + 10.0 * right / length, y - 15.0 * up / length];
            canvas.text_on_paper(place, text, SMALL_PX, item.colour, anchor)
        }
    }
}

fn arrow<DB: DrawingBackend>(
    from: [f64; 2],
    to: [f64; 2],
    colour: Colour,
    canvas: &Canvas<'_, DB>,
) -> Result<(), Error> {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length = math::hypot(way[0], way[1]);
    if length < 0.5 {
        return canvas.dot(from, Marker::Circle, 1.5, colour.faint(0.99));
    }
    let head = (length * 0.5).min(5.0);
    let (ahead, aside) = ([way[0] / length, way[1] / length], [-way[1] / length, way[0] / length]);
    let corner = |side: f64| [0, 1].map(|axis| to[axis] - head * ahead[axis] + side * head * 0.5 * aside[axis]);
    canvas.line(&[from, corner(0.0)], 1.1, colour)?;
    canvas.fill(&[to, corner(1.0), corner(-1.0)], colour)
}

/// Eight places along a line from left to right, the first at this share of the distance between two.
fn dots_along<'a>(pieces: &'a [Vec<[f64; 2]>], phase: f64, plot: &'a Plot) -> impl Iterator<Item = [f64; 2]> + 'a {
    (0..8).filter_map(move |nth| {
        let x_px = plot.left + (f64::from(nth) + phase) / 8.0 * (plot.right - plot.left);
        let past = |place: &[f64; 2]| plot.x_px(place[0]) >= x_px;
        let piece = pieces.iter().find(|piece| piece.last().is_some_and(past) && !piece.first().is_some_and(past))?;
        let to = piece.partition_point(|place| !past(place));
        let (from, to) = (plot.at(piece[to - 1]), plot.at(piece[to]));
        let share = (x_px - from[0]) / (to[0] - from[0]).max(1e-9);
        Some([x_px, from[1] + share * (to[1] - from[1])]).filter(|at| plot.holds(*at))
    })
}

/// The legend, wrapped; gives where it ends, px.
fn legend<DB: DrawingBackend>(panel: &Panel, plot: &Plot, right: f64, canvas: &Canvas<'_, DB>) -> Result<f64, Error> {
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
                swatch(item, [x, y], canvas)?;
            }
        }
        canvas.text([x + 28.0, y], name, SMALL_PX, Colour::BLACK, Anchor::Left)?;
        x += width;
    }
    Ok(if entries.is_empty() { plot.top } else { y + LINE_PX / 2.0 + 2.0 })
}

/// How an item looks, in 24 px from here to the right.
fn swatch<DB: DrawingBackend>(item: &Item, [x, y]: [f64; 2], canvas: &Canvas<'_, DB>) -> Result<(), Error> {
    let ends = [[x, y], [x + 22.0, y]];
    match &item.shape {
        Shape::Line { width_px, is_dashed, markers, .. } => {
            if *is_dashed {
                canvas.dashed(&ends, *width_px, item.colour)?;
            } else {
                canvas.line(&ends, *width_px, item.colour)?;
            }
            match markers {
                Some((marker, _)) => canvas.dot([x + 11.0, y], *marker, 7.0, item.colour),
                None => Ok(()),
            }
        }
        Shape::Area(_) | Shape::Bars(_) => {
            let (top, bottom) = (y - 5.0, y + 5.0);
            canvas.fill(&[[x, top], [x + 22.0, top], [x + 22.0, bottom], [x, bottom]], item.colour)
        }
        Shape::Dots { marker, size_px, .. } => canvas.dot([x + 11.0, y], *marker, size_px.max(5.0), item.colour),
        Shape::Arrows(_) => arrow(ends[0], ends[1], item.colour, canvas),
        Shape::Note { .. } => Ok(()),
    }
}

/// The row of each mark's word above the plot, 0 the highest. A word that begins beneath an earlier one stands lower, so
/// that no mark's line runs through a word.
fn mark_rows(marks: &[Mark], plot: &Plot, right: f64) -> Vec<usize> {
    let mut rows: Vec<usize> = Vec::with_capacity(marks.len());
    let spans: Vec<_> = marks.iter().map(|mark| mark_span(mark, plot, right)).collect();
    for (nth, [from, _]) in spans.iter().enumerate() {
        let above = spans[..nth].iter().zip(&rows).filter(|([_, to], _)| to > from).map(|(_, row)| row + 1).max();
        rows.push(above.unwrap_or(0));
    }
    rows
}

/// From where to where a mark's word reaches, px.
fn mark_span(mark: &Mark, plot: &Plot, right: f64) -> [f64; 2] {
    let width = text_width(&mark.text, SMALL_PX) + 10.0;
    let from = plot.x_px(mark.x).min(right - width);
    [from, from + width]
}

fn marks<DB: DrawingBackend>(
    marks: &[Mark],
    rows: &[usize],
    plot: &Plot,
    labels_top: f64,
    right: f64,
    canvas: &Canvas<'_, DB>,
) -> Result<(), Error> {
    let height = |row: &usize| labels_top + (*row as f64 + 0.5) * LINE_PX;
    for (mark, row) in marks.iter().zip(rows) {
        let x = plot.x_px(mark.x);
        canvas.line(&[[x, height(row) - 5.0], [x, plot.bottom]], 0.9, Colour::GREY)?;
    }
    for (mark, row) in marks.iter().zip(rows) {
        let [from, _] = mark_span(mark, plot, right);
        canvas.text_on_paper([from + 4.0, height(row)], &mark.text, SMALL_PX, Colour::BLACK, Anchor::Left)?;
    }
    Ok(())
}

/// Names beside the ends of lines, pushed apart.
fn names<DB: DrawingBackend>(panel: &Panel, plot: &Plot, canvas: &Canvas<'_, DB>) -> Result<(), Error> {
    let mut ends: Vec<([f64; 2], &str, Colour)> = Vec::new();
    for item in &panel.items {
        let (Name::AtEnd(name), Shape::Line { pieces, .. }) = (&item.name, &item.shape) else { continue };
        let end = pieces.iter().rev().flat_map(|piece| piece.last()).next();
        let Some(end) = end.map(|end| plot.held(plot.at(*end))) else { continue };
        if end[0] < plot.right - 24.0 {
            // It ends before the others: its name stands where it ends.
            canvas.text_on_paper([end[0] + 7.0, end[1]], name, SMALL_PX, item.colour, Anchor::Left)?;
        } else {
            ends.push((end, name, item.colour));
        }
    }
    ends.sort_by(|one, other| one.0[1].total_cmp(&other.0[1]));
    let wanted: Vec<f64> = ends.iter().map(|(end, ..)| end[1]).collect();
    let places = apart(&wanted, LINE_PX - 2.0, plot.top, plot.bottom);
    for ((end, name, colour), y) in ends.iter().zip(places) {
        let x = plot.right + 10.0;
        canvas.line(&[[end[0] + 1.0, end[1]], [x - 2.0, y]], 0.8, colour.faint(0.6))?;
        canvas.text([x, y], name, SMALL_PX, *colour, Anchor::Left)?;
    }
    Ok(())
}

/// Sorted places moved as little as keeps them this far apart and within the bounds, if that is possible.
fn apart(wanted: &[f64], least: f64, from: f64, to: f64) -> Vec<f64> {
    // Places that touch form a block around the mean of what its members want.
    let mut blocks: Vec<(f64, usize)> = Vec::new();
    for &place in wanted {
        blocks.push((place, 1));
        while let [.., (above, above_count), (below, count)] = blocks[..] {
            let touches = above + (above_count as f64 + count as f64) / 2.0 * least > below;
            if !touches {
                break;
            }
            let all = above_count + count;
            let middle = (above * above_count as f64 + below * count as f64) / all as f64;
            blocks.truncate(blocks.len() - 2);
            blocks.push((held(middle, all, least, from, to), all));
        }
        if let Some((middle, count)) = blocks.last_mut() {
            *middle = held(*middle, *count, least, from, to);
        }
    }
    let first = |middle: f64, count: usize| middle - (count as f64 - 1.0) / 2.0 * least;
    blocks
        .iter()
        .flat_map(|&(middle, count)| (0..count).map(move |nth| first(middle, count) + nth as f64 * least))
        .collect()
}

/// The middle of a block that stays within the bounds.
fn held(middle: f64, count: usize, least: f64, from: f64, to: f64) -> f64 {
    let half = (count as f64 - 1.0) / 2.0 * least;
    middle.min(to - half).max(from + half)
}

/// The numbers of a shape on one of the axes, x or y.
fn extent(shape: &Shape, axis: usize) -> Vec<f64> {
    let of = |places: &[Vec<[f64; 2]>]| places.iter().flatten().map(|place| place[axis]).collect();
    match shape {
        Shape::Line { pieces, .. } => of(pieces),
        Shape::Area(outlines) => of(outlines),
        Shape::Dots { at, .. } => at.iter().map(|place| place[axis]).collect(),
        Shape::Bars(bars) => bars.iter().flat_map(|(from, to, _)| [from[axis], to[axis]]).collect(),
        Shape::Arrows(arrows) => arrows.iter().flat_map(|(from, to)| [from[axis], to[axis]]).collect(),
        Shape::Note { at, .. } => vec![at[axis]],
    }
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
    fn a_mark_beneath_a_word_stands_lower() {
        let scale = |to: f64| crate::report::figure::Axis::new("time", "s").within(0.0, to).scale([].into_iter(), 0.0);
        let plot = Plot { left: 0.0, top: 0.0, right: 800.0, bottom: 100.0, x: scale(800.0), y: scale(1.0) };
        let mark = |x: f64| Mark { x, text: "vehicle 3 killed".to_owned() };
        let rows = mark_rows(&[mark(0.0), mark(20.0), mark(40.0), mark(400.0), mark(790.0)], &plot, 800.0);
        assert_eq!(rows, [0, 1, 2, 0, 0]);
    }
}
