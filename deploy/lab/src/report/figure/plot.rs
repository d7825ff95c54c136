//! A panel's plot: from numbers to pixels, and each item as it looks in it.

use skein_common::math;

use super::axis::Scale;
use super::canvas::{Anchor, Canvas, SMALL_PX, text_width};
use super::{Colour, Item, Marker, Panel, Shape};

/// A panel's plot, and how numbers become pixels in it.
pub(super) struct Plot {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) right: f64,
    pub(super) bottom: f64,
    pub(super) x: Scale,
    pub(super) y: Scale,
}

impl Plot {
    pub(super) fn x_px(&self, x: f64) -> f64 {
        self.left + self.x.share(x) * (self.right - self.left)
    }

    pub(super) fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.x_px(x), self.bottom - self.y.share(y) * (self.bottom - self.top)]
    }

    /// Lines in pixels, interrupted at missing numbers and at numbers that a logarithmic axis cannot show.
    fn lines(&self, pieces: &[Vec<[f64; 2]>]) -> Vec<Vec<[f64; 2]>> {
        // Far outside, any place is as good as another, and a renderer has numbers for it.
        let near = |place: &[f64; 2]| place.map(|px| px.clamp(-1e5, 1e5));
        let lines = |piece: &Vec<[f64; 2]>| {
            let places: Vec<_> = piece.iter().map(|place| self.at(*place)).collect();
            let parts = places.split(|[x, y]| !(x.is_finite() && y.is_finite()));
            parts.map(|part| part.iter().map(near).collect()).collect::<Vec<_>>()
        };
        pieces.iter().flat_map(lines).collect()
    }

    /// One metre north becomes as long as one metre east.
    pub(super) fn keep_scale(&mut self) {
        let (width, height) = (self.right - self.left, self.bottom - self.top);
        let per_px = (self.x.span() / width).max(self.y.span() / height);
        self.x = self.x.widened(per_px * width);
        self.y = self.y.widened(per_px * height);
    }

    fn holds(&self, [x, y]: [f64; 2]) -> bool {
        (self.left..=self.right).contains(&x) && (self.top..=self.bottom).contains(&y)
    }

    pub(super) fn held(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x.clamp(self.left, self.right), y.clamp(self.top, self.bottom)]
    }
}

/// An item in its panel's plot.
pub(super) fn draw(item: &Item, panel: &Panel, plot: &Plot, canvas: &mut Canvas) {
    match &item.shape {
        Shape::Line { pieces, width_px, is_dashed, markers } => {
            let lines = plot.lines(pieces);
            let draw = |canvas: &mut Canvas| canvas.lines(&lines, *width_px, *is_dashed, item.colour);
            if lines.iter().flatten().all(|place| plot.holds(*place)) {
                draw(canvas);
            } else {
                // A line along an edge keeps its width.
                canvas.within([plot.left - 1.0, plot.top - 1.0, plot.right + 1.0, plot.bottom + 1.0], draw);
            }
            if let Some((marker, phase)) = *markers {
                dots_along(pieces, phase, plot).for_each(|at| canvas.dot(at, marker, 7.0, item.colour));
            }
        }
        Shape::Area(outlines) => {
            for outline in plot.lines(outlines) {
                canvas.fill(&outline.into_iter().map(|place| plot.held(place)).collect::<Vec<_>>(), item.colour);
            }
        }
        Shape::Dots { at, marker, size_px } => {
            let places = at.iter().map(|place| plot.at(*place)).filter(|place| plot.holds(*place));
            places.for_each(|place| canvas.dot(place, *marker, *size_px, item.colour));
        }
        Shape::Bars(bars) => {
            for (from, to, text) in bars {
                let ([x0, y0], [x1, y1]) = (plot.held(plot.at(*from)), plot.held(plot.at(*to)));
                canvas.fill(&[[x0, y0], [x1, y0], [x1, y1], [x0, y1]], item.colour);
                // In the middle, or else where no mark runs through it.
                let half = text_width(text, SMALL_PX) / 2.0 + 3.0;
                let is_free = |x: &f64| {
                    let is_inside = x0 <= x - half && x + half <= x1 && (y1 - y0).abs() >= 11.0;
                    is_inside && panel.marks.iter().all(|mark| (plot.x_px(mark.x) - x).abs() > half)
                };
                let places = [0.5, 0.38, 0.62, 0.25, 0.75, 0.12, 0.88].map(|share| x0 + share * (x1 - x0));
                if let Some(x) = places.into_iter().find(is_free).filter(|_| !text.is_empty()) {
                    canvas.text([x, (y0 + y1) / 2.0], text, SMALL_PX, Colour::BLACK, Anchor::Centre);
                }
            }
        }
        Shape::Cells(cells) => {
            let corners = |(from, to): &([f64; 2], [f64; 2])| [plot.held(plot.at(*from)), plot.held(plot.at(*to))];
            canvas.cells(cells.iter().map(corners), item.colour);
        }
        Shape::Arrows(arrows) => {
            let arrows = arrows.iter().map(|(from, to)| [plot.at(*from), plot.at(*to)]);
            arrows
                .filter(|ends| ends.iter().all(|end| plot.holds(*end)))
                .for_each(|[from, to]| arrow(from, to, item.colour, canvas));
        }
        Shape::Note { at, text, side: [right, up] } => {
            let length = math::hypot(*right, *up).max(1e-9);
            let [x, y] = plot.at(*at);
            let anchor = match right / length {
                right if right > 0.4 => Anchor::Left,
                right if right < -0.4 => Anchor::Right,
                _ => Anchor::Centre,
            };
            // Without a side the text is at the place itself.
            let place = [x + 10.0 * right / length, y - 15.0 * up / length];
            canvas.text_on_paper(place, text, SMALL_PX, item.colour, anchor);
        }
    }
}

fn arrow(from: [f64; 2], to: [f64; 2], colour: Colour, canvas: &mut Canvas) {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length = math::hypot(way[0], way[1]);
    if length < 0.5 {
        return canvas.dot(from, Marker::Circle, 1.5, colour.faint(0.99));
    }
    let head = (length * 0.5).min(5.0);
    let (ahead, aside) = ([way[0] / length, way[1] / length], [-way[1] / length, way[0] / length]);
    let corner = |side: f64| [0, 1].map(|axis| to[axis] - head * ahead[axis] + side * head * 0.5 * aside[axis]);
    canvas.lines(&[vec![from, corner(0.0)]], 1.1, false, colour);
    canvas.fill(&[to, corner(1.0), corner(-1.0)], colour);
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

/// Draws a sample of an item for the legend, in 24 px from here to the right.
pub(super) fn swatch(item: &Item, [x, y]: [f64; 2], canvas: &mut Canvas) {
    let (from, middle, to) = ([x, y], [x + 11.0, y], [x + 22.0, y]);
    match &item.shape {
        Shape::Line { width_px, is_dashed, markers, .. } => {
            canvas.lines(&[vec![from, to]], *width_px, *is_dashed, item.colour);
            markers.iter().for_each(|(marker, _)| canvas.dot(middle, *marker, 7.0, item.colour));
        }
        Shape::Area(_) | Shape::Bars(_) | Shape::Cells(_) => {
            let (top, bottom) = (y - 5.0, y + 5.0);
            canvas.fill(&[[x, top], [to[0], top], [to[0], bottom], [x, bottom]], item.colour);
        }
        Shape::Dots { marker, size_px, .. } => canvas.dot(middle, *marker, size_px.max(5.0), item.colour),
        Shape::Arrows(_) => arrow(from, to, item.colour, canvas),
        Shape::Note { .. } => {}
    }
}

/// The numbers of a shape on one of the axes, x or y.
pub(super) fn extent(shape: &Shape, axis: usize) -> Vec<f64> {
    let of = |places: &[Vec<[f64; 2]>]| places.iter().flatten().map(|place| place[axis]).collect();
    match shape {
        Shape::Line { pieces, .. } => of(pieces),
        Shape::Area(outlines) => of(outlines),
        Shape::Dots { at, .. } => at.iter().map(|place| place[axis]).collect(),
        Shape::Bars(bars) => bars.iter().flat_map(|(from, to, _)| [from[axis], to[axis]]).collect(),
        Shape::Cells(ends) | Shape::Arrows(ends) => ends.iter().flat_map(|(from, to)| [from[axis], to[axis]]).collect(),
        Shape::Note { at, .. } => vec![at[axis]],
    }
}
