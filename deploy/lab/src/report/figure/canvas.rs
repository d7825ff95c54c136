//! Where is drawn: plotters behind a handful of strokes, in pixels as they are shown.

use std::fmt::Display;
use std::sync::LazyLock;

use epaint_default_fonts::UBUNTU_LIGHT;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontTransform, register_font};

use super::{Colour, FINE, Marker, path};
use crate::error::Error;

/// Browsers take letters of their own, which are wider.
const WIDER: f64 = 1.1;
/// The only letters there are.
const FONT: &str = "sans-serif";
/// Length of a dash, px.
const DASH_PX: f64 = 5.0;

/// A cluster's PC may have no letters: they come with the program.
static LETTERS: LazyLock<bool> = LazyLock::new(|| register_font(FONT, FontStyle::Normal, UBUNTU_LIGHT).is_ok());

/// Something to draw on.
pub(super) struct Canvas<'a, DB: DrawingBackend> {
    area: &'a DrawingArea<DB, Shift>,
    /// By which share of their size letters have to be moved down to stand in the middle of their place.
    lowered: f64,
}

/// Where a text stands from its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    Left,
    Centre,
    Right,
}

/// How a figure fails.
pub(super) fn failed(error: &dyn Display) -> Error {
    Error::Failed(format!("a figure cannot be drawn: {error}"))
}

/// How wide a text is, px.
pub(super) fn text_width(text: &str, size_px: f64) -> f64 {
    // Without letters nothing is drawn at all.
    let box_size = || (FONT, size_px * FINE).into_font().box_size(text).unwrap_or_default();
    let (width, _) = if *LETTERS { box_size() } else { (0, 0) };
    f64::from(width) / FINE * WIDER
}

fn fine([x, y]: [f64; 2]) -> (i32, i32) {
    ((x * FINE).round() as i32, (y * FINE).round() as i32)
}

fn colour(colour: Colour) -> RGBAColor {
    let [red, green, blue] = colour.rgb;
    RGBAColor(red, green, blue, colour.opacity)
}

impl<'a, DB: DrawingBackend> Canvas<'a, DB> {
    pub(super) fn new(area: &'a DrawingArea<DB, Shift>, lowered: f64) -> Result<Self, Error> {
        if *LETTERS { Ok(Self { area, lowered }) } else { Err(failed(&"its letters are damaged")) }
    }

    /// A line through these places.
    pub(super) fn line(&self, line: &[[f64; 2]], width_px: f64, of: Colour) -> Result<(), Error> {
        let mut points: Vec<_> = path::simplified(line).into_iter().map(fine).collect();
        points.dedup();
        if points.len() < 2 {
            return Ok(());
        }
        let style = colour(of).stroke_width((width_px * FINE).round() as u32);
        self.area.draw(&PathElement::new(points, style)).map_err(|error| failed(&error))
    }

    /// The same in dashes.
    pub(super) fn dashed(&self, line: &[[f64; 2]], width_px: f64, of: Colour) -> Result<(), Error> {
        path::dashes(&path::simplified(line), DASH_PX).iter().try_for_each(|dash| self.line(dash, width_px, of))
    }

    /// A filled outline.
    pub(super) fn fill(&self, outline: &[[f64; 2]], of: Colour) -> Result<(), Error> {
        let mut points: Vec<_> = path::simplified(outline).into_iter().map(fine).collect();
        points.dedup();
        if points.len() < 3 {
            return Ok(());
        }
        self.area.draw(&Polygon::new(points, colour(of).filled())).map_err(|error| failed(&error))
    }

    /// A dot, with a rim of the paper's colour that parts it from others.
    pub(super) fn dot(&self, at: [f64; 2], marker: Marker, size_px: f64, of: Colour) -> Result<(), Error> {
        if of.opacity == 1.0 && marker != Marker::Cross {
            self.bare_dot(at, marker, size_px + 1.5, Colour::WHITE)?;
        }
        self.bare_dot(at, marker, size_px, of)
    }

    fn bare_dot(&self, at: [f64; 2], marker: Marker, size_px: f64, of: Colour) -> Result<(), Error> {
        let half = size_px / 2.0;
        let corners = |corners: &[[f64; 2]]| -> Vec<[f64; 2]> {
            corners.iter().map(|[x, y]| [at[0] + x * half, at[1] + y * half]).collect()
        };
        match marker {
            Marker::Circle => {
                let radius = (half * FINE).round() as u32;
                self.area.draw(&Circle::new(fine(at), radius, colour(of).filled())).map_err(|error| failed(&error))
            }
            Marker::Square => self.fill(&corners(&[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]]), of),
            Marker::Triangle => self.fill(&corners(&[[0.0, -1.15], [1.05, 0.75], [-1.05, 0.75]]), of),
            Marker::Diamond => self.fill(&corners(&[[0.0, -1.2], [1.2, 0.0], [0.0, 1.2], [-1.2, 0.0]]), of),
            Marker::Down => self.fill(&corners(&[[0.0, 1.15], [1.05, -0.75], [-1.05, -0.75]]), of),
            Marker::Cross => {
                self.line(&corners(&[[-0.85, -0.85], [0.85, 0.85]]), size_px / 4.0, of)?;
                self.line(&corners(&[[-0.85, 0.85], [0.85, -0.85]]), size_px / 4.0, of)
            }
        }
    }

    /// A text, its middle at the height of the place.
    pub(super) fn text(&self, at: [f64; 2], text: &str, size_px: f64, of: Colour, anchor: Anchor) -> Result<(), Error> {
        self.write(at, text, (size_px, of), anchor, FontTransform::None)
    }

    /// A text that hides a little of what is behind it.
    pub(super) fn text_on_paper(
        &self,
        at: [f64; 2],
        text: &str,
        size_px: f64,
        of: Colour,
        anchor: Anchor,
    ) -> Result<(), Error> {
        let width = text_width(text, size_px) + 2.0;
        let from = match anchor {
            Anchor::Left => at[0] - 2.0,
            Anchor::Centre => at[0] - width / 2.0,
            Anchor::Right => at[0] - width + 2.0,
        };
        let (to, top, bottom) = (from + width, at[1] - 0.55 * size_px, at[1] + 0.55 * size_px);
        self.fill(&[[from, top], [to, top], [to, bottom], [from, bottom]], Colour::WHITE.faint(0.75))?;
        self.text(at, text, size_px, of, anchor)
    }

    /// A text from bottom to top, its middle at the place.
    pub(super) fn text_upwards(&self, at: [f64; 2], text: &str, size_px: f64, of: Colour) -> Result<(), Error> {
        self.write(at, text, (size_px, of), Anchor::Centre, FontTransform::Rotate270)
    }

    fn write(
        &self,
        at: [f64; 2],
        text: &str,
        (size_px, of): (f64, Colour),
        anchor: Anchor,
        turned: FontTransform,
    ) -> Result<(), Error> {
        let down_px = self.lowered * size_px;
        let at = match turned {
            FontTransform::None => [at[0], at[1] + down_px],
            _ => [at[0] + down_px, at[1]],
        };
        let horizontal = match anchor {
            Anchor::Left => HPos::Left,
            Anchor::Centre => HPos::Center,
            Anchor::Right => HPos::Right,
        };
        let font = (FONT, size_px * FINE).into_font().transform(turned);
        let style = font.color(&colour(of)).pos(Pos::new(horizontal, VPos::Center));
        self.area.draw(&Text::new(text.to_owned(), fine(at), style)).map_err(|error| failed(&error))
    }
}
