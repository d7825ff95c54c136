//! Pictures for reports: what is to be seen, said in the quantities' own units, becomes SVG and PNG.
//!
//! The only place that knows plotters. A [`Figure`] is plain data: panels with two axes each, and in them lines, areas,
//! dots, bars and arrows, in the order in which they are drawn. What would make a picture hard to read is looked after
//! here: the letters come with the program, scales and ticks are chosen, labels keep clear of each other.
//!
//! Everything is drawn `FINE` times as large as it is shown, because plotters rounds to whole pixels. The same figure
//! gives the same bytes.

mod axis;
mod canvas;
mod layout;
mod path;

use std::path::Path;

use plotters::prelude::*;

use crate::error::Error;
pub use axis::Axis;
use canvas::Canvas;

/// Pixels drawn for each pixel shown.
const FINE: f64 = 4.0;
/// Pixels of a PNG for each pixel shown.
const PNG_FINE: u32 = 2;
/// How wide figures are shown, px.
pub const WIDTH_PX: f64 = 880.0;

/// A colour, and how much of what is below it covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour {
    rgb: [u8; 3],
    opacity: f64,
}

impl Colour {
    const fn new(red: u8, green: u8, blue: u8) -> Self {
        Self { rgb: [red, green, blue], opacity: 1.0 }
    }

    /// Letters, axes, the most important line.
    pub const BLACK: Self = Self::new(0x22, 0x22, 0x22);
    /// What is beside the point.
    pub const GREY: Self = Self::new(0x76, 0x76, 0x76);
    /// What is behind everything.
    pub const PALE: Self = Self::new(0xd9, 0xd9, 0xd9);
    /// The paper.
    pub const WHITE: Self = Self::new(0xff, 0xff, 0xff);
    /// Of M. Okabe & K. Ito's set, which the colour-blind tell apart; without their yellow, too light for lines.
    pub const BLUE: Self = Self::new(0x00, 0x72, 0xb2);
    /// As [`Self::BLUE`].
    pub const VERMILLION: Self = Self::new(0xd5, 0x5e, 0x00);
    /// As [`Self::BLUE`].
    pub const GREEN: Self = Self::new(0x00, 0x9e, 0x73);
    /// As [`Self::BLUE`].
    pub const PURPLE: Self = Self::new(0xcc, 0x79, 0xa7);
    /// As [`Self::BLUE`].
    pub const ORANGE: Self = Self::new(0xe6, 0x9f, 0x00);
    /// As [`Self::BLUE`].
    pub const SKY: Self = Self::new(0x56, 0xb4, 0xe9);

    /// The colour of the `index`-th of several; after seven they come again.
    pub fn nth(index: usize) -> Self {
        const SET: [Colour; 7] = [
            Colour::BLUE,
            Colour::VERMILLION,
            Colour::GREEN,
            Colour::PURPLE,
            Colour::ORANGE,
            Colour::SKY,
            Colour::BLACK,
        ];
        SET[index % SET.len()]
    }

    /// The same, covering this share of what is below.
    pub fn faint(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    /// From pale to dark blue, in steps of lightness: for amounts, `share` from 0 to 1.
    pub fn of_amount(share: f64) -> Self {
        const FROM: [f64; 3] = [186.0, 209.0, 230.0];
        const TO: [f64; 3] = [0.0, 42.0, 92.0];
        let mix = |index: usize| (FROM[index] + (TO[index] - FROM[index]) * share.clamp(0.0, 1.0)).round() as u8;
        Self::new(mix(0), mix(1), mix(2))
    }
}

/// The shape of a dot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Marker {
    Circle,
    Square,
    Triangle,
    Diamond,
    Down,
    Cross,
}

impl Marker {
    /// The shape of the `index`-th of several; with its colour it is its own up to forty-two.
    pub fn nth(index: usize) -> Self {
        [Self::Circle, Self::Square, Self::Triangle, Self::Diamond, Self::Down, Self::Cross][index % 6]
    }
}

/// What is drawn of one thing. Places are x, y in the units of the axes; whatever lies outside is cut off.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A line, in pieces where something is missing between.
    Line {
        /// The pieces.
        pieces: Vec<Vec<[f64; 2]>>,
        /// px.
        width_px: f64,
        /// Broken.
        is_dashed: bool,
        /// Dots along a line that runs from left to right, and how far the first is from the left, as a share of their
        /// distance: lines on top of each other then show them all.
        markers: Option<(Marker, f64)>,
    },
    /// Filled outlines.
    Area(Vec<Vec<[f64; 2]>>),
    /// A dot at each place.
    Dots {
        /// The places.
        at: Vec<[f64; 2]>,
        /// Their shape.
        marker: Marker,
        /// Across, px.
        size_px: f64,
    },
    /// Filled from corner to corner, with a text where there is room for it.
    Bars(Vec<([f64; 2], [f64; 2], String)>),
    /// From a place to a place.
    Arrows(Vec<([f64; 2], [f64; 2])>),
    /// A short text beside a place, on the side that this direction points to.
    Note {
        /// The place.
        at: [f64; 2],
        /// The text.
        text: String,
        /// Right and up.
        side: [f64; 2],
    },
}

/// Where the name of a thing stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Name {
    /// Nowhere.
    None,
    /// Beside the end of its line, in its colour.
    AtEnd(String),
    /// In the legend above. Neighbouring things of the same name share a place in it.
    InLegend(String),
}

/// One thing in a panel.
#[derive(Clone, Debug)]
pub struct Item {
    /// What is drawn.
    pub shape: Shape,
    /// In which colour.
    pub colour: Colour,
    /// What it is called.
    pub name: Name,
}

impl Item {
    /// Something without a name.
    pub fn new(shape: Shape, colour: Colour) -> Self {
        Self { shape, colour, name: Name::None }
    }

    /// A line in pieces.
    pub fn line(pieces: Vec<Vec<[f64; 2]>>, colour: Colour) -> Self {
        Self::new(Shape::Line { pieces, width_px: 1.5, is_dashed: false, markers: None }, colour)
    }

    /// The same line, this wide. Nothing else changes.
    pub fn wide(mut self, px: f64) -> Self {
        if let Shape::Line { width_px, .. } = &mut self.shape {
            *width_px = px;
        }
        self
    }

    /// The same line, broken. Nothing else changes.
    pub fn dashed(mut self) -> Self {
        if let Shape::Line { is_dashed, .. } = &mut self.shape {
            *is_dashed = true;
        }
        self
    }

    /// The same line with the dots of the `index`-th of several. Nothing else changes.
    pub fn marked(mut self, index: usize) -> Self {
        if let Shape::Line { markers, .. } = &mut self.shape {
            // The golden ratio keeps any number of lines' dots apart.
            *markers = Some((Marker::nth(index), (index as f64 * 0.618 + 0.3).fract()));
        }
        self
    }

    /// The same with its name beside its end.
    pub fn at_end(self, name: impl Into<String>) -> Self {
        Self { name: Name::AtEnd(name.into()), ..self }
    }

    /// The same with its name in the legend.
    pub fn in_legend(self, name: impl Into<String>) -> Self {
        Self { name: Name::InLegend(name.into()), ..self }
    }
}

/// Something that happened: a line from top to bottom with a word above.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Where on the x axis.
    pub x: f64,
    /// The word.
    pub text: String,
}

/// Two axes and what is between them.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Left, top, right and bottom edge as shares of the figure below its title.
    pub place: [f64; 4],
    /// Above the panel, if not empty.
    pub title: String,
    /// To the right.
    pub x: Axis,
    /// Upwards.
    pub y: Axis,
    /// Both axes have the same scale.
    pub is_map: bool,
    /// From back to front.
    pub items: Vec<Item>,
    /// In the order of x.
    pub marks: Vec<Mark>,
}

impl Panel {
    /// An empty panel that fills the figure.
    pub fn new(x: Axis, y: Axis) -> Self {
        let place = [0.0, 0.0, 1.0, 1.0];
        Self { place, title: String::new(), x, y, is_map: false, items: Vec::new(), marks: Vec::new() }
    }
}

/// One picture.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Its files' name, without the ending.
    pub name: String,
    /// What is to be seen.
    pub title: String,
    /// Of what: scenario, law, seed, version.
    pub subject: String,
    /// What a reader has to know, in sentences; it stands below the picture on a page.
    pub caption: String,
    /// Width and height as shown, px.
    pub size_px: [f64; 2],
    /// Its parts.
    pub panels: Vec<Panel>,
}

impl Figure {
    /// As an SVG document that needs nothing else.
    ///
    /// # Errors
    /// If the letters that come with the program cannot be used.
    pub fn svg(&self) -> Result<String, Error> {
        let (width, height) = self.fine_size();
        let mut drawn = String::new();
        {
            let area = SVGBackend::with_string(&mut drawn, (width, height)).into_drawing_area();
            self.draw(&Canvas::new(&area, 0.05)?)?;
            area.present().map_err(|error| canvas::failed(&error))?;
        }
        let [shown_width, shown_height] = self.size_px;
        let size = format!("width=\"{width}\" height=\"{height}\"");
        let shown = format!("width=\"{shown_width}\" height=\"{shown_height}\" role=\"img\"");
        let title = format!(">\n<title>{}</title>\n", escaped(&format!("{}. {}", self.title, self.subject)));
        Ok(drawn.replacen(&size, &shown, 1).replacen(">\n", &title, 1))
    }

    /// Writes it as PNG.
    ///
    /// # Errors
    /// If that cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), Error> {
        let (width, height) = self.fine_size();
        let mut fine = vec![0; (width * height * 3) as usize];
        {
            let area = BitMapBackend::with_buffer(&mut fine, (width, height)).into_drawing_area();
            // plotters sets a bitmap's letters higher than an SVG's.
            self.draw(&Canvas::new(&area, 0.15)?)?;
            area.present().map_err(|error| canvas::failed(&error))?;
        }
        let by = FINE as u32 / PNG_FINE;
        let size = (width / by, height / by);
        let mut file = BitMapBackend::new(path, size);
        let written = file.blit_bitmap((0, 0), size, &smaller(&fine, width, by)).and_then(|()| file.present());
        written.map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
    }

    /// Width and height as drawn, px.
    fn fine_size(&self) -> (u32, u32) {
        let [width, height] = self.size_px.map(|px| (px * FINE).round() as u32);
        (width, height)
    }

    fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<'_, DB>) -> Result<(), Error> {
        let [width, height] = self.size_px;
        canvas.fill(&[[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]], Colour::WHITE)?;
        let top = layout::heading(self, canvas)?;
        let place = |panel: &Panel| {
            let [left, upper, right, lower] = panel.place;
            let down = |share: f64| top + share * (height - top);
            [left * width, down(upper), right * width, down(lower)]
        };
        let margins = layout::margins(&self.panels, place);
        self.panels
            .iter()
            .zip(margins)
            .try_for_each(|(panel, margins)| layout::panel(panel, place(panel), margins, canvas))
    }
}

/// As it may stand between tags, or in an attribute.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The mean of each `by` times `by` pixels of an RGB picture that is this wide.
fn smaller(fine: &[u8], width: u32, by: u32) -> Vec<u8> {
    let (width, by) = (width as usize, by as usize);
    let height = fine.len() / 3 / width;
    let mut small = Vec::with_capacity(fine.len() / by / by);
    for y in 0..height / by {
        for x in 0..width / by {
            for channel in 0..3 {
                let pixel = |nth: usize| fine[((y * by + nth / by) * width + x * by + nth % by) * 3 + channel];
                let sum: usize = (0..by * by).map(|nth| usize::from(pixel(nth))).sum();
                small.push((sum / (by * by)) as u8);
            }
        }
    }
    small
}

#[cfg(test)]
mod tests;
