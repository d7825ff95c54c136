//! Figures for reports: a description in the units of the quantities is rendered as SVG and PNG.
//!
//! A [`Drawing`] is plain data: panels with two axes each, and in them lines, areas, dots, bars and arrows, in the order
//! in which they are drawn. What would make a picture hard to read is looked after here: scales and ticks are chosen,
//! labels keep clear of each other. The PNG is a rendering of the SVG, with a font that comes with the program. The same
//! figure gives the same bytes.

mod axis;
mod canvas;
mod layout;
mod plot;

use std::path::Path;

use crate::error::Error;
use crate::out;
pub use axis::Axis;

/// Width at which figures are shown, px.
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
    /// The colour of whatever is beside the point.
    pub const GREY: Self = Self::new(0x76, 0x76, 0x76);
    /// The colour of whatever is behind everything.
    pub const PALE: Self = Self::new(0xd9, 0xd9, 0xd9);
    /// Blue of M. Okabe & K. Ito's colour-blind-safe set, without its yellow, which is too light for lines.
    pub const BLUE: Self = Self::new(0x00, 0x72, 0xb2);
    /// Vermillion of the same set.
    pub const VERMILLION: Self = Self::new(0xd5, 0x5e, 0x00);
    /// Green of the same set.
    pub const GREEN: Self = Self::new(0x00, 0x9e, 0x73);
    /// Purple of the same set.
    pub const PURPLE: Self = Self::new(0xcc, 0x79, 0xa7);
    /// Orange of the same set.
    pub const ORANGE: Self = Self::new(0xe6, 0x9f, 0x00);
    /// Sky of the same set.
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
    Plus,
    Cross,
}

impl Marker {
    /// The shape of the `index`-th of several; with its colour it is its own up to forty-two. [`Self::Cross`] is not among
    /// them: it marks what has ended.
    pub fn nth(index: usize) -> Self {
        [Self::Circle, Self::Square, Self::Triangle, Self::Diamond, Self::Down, Self::Plus][index % 6]
    }
}

/// The shape of one thing that is drawn. Places are x, y in the units of the axes; whatever lies outside is cut off.
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
    /// Filled from corner to corner, without gaps between neighbours: the cells of a raster.
    Cells(Vec<([f64; 2], [f64; 2])>),
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

impl Shape {
    /// Whether nothing is drawn of it.
    pub fn is_empty(&self) -> bool {
        match self {
            Self::Line { pieces, .. } | Self::Area(pieces) => pieces.iter().all(Vec::is_empty),
            Self::Dots { at, .. } => at.is_empty(),
            Self::Bars(bars) => bars.is_empty(),
            Self::Cells(cells) => cells.is_empty(),
            Self::Arrows(arrows) => arrows.is_empty(),
            Self::Note { text, .. } => text.is_empty(),
        }
    }
}

/// The place of the name of a thing, with the name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Name {
    /// Nowhere.
    None,
    /// Beside the end of its line, in its colour.
    AtEnd(String),
    /// On its line, above its left end, in its colour: for limits.
    OnLine(String),
    /// In the legend above. Neighbouring things of the same name share a place in it.
    InLegend(String),
}

/// One thing in a panel.
#[derive(Clone, Debug)]
pub struct Item {
    /// Its shape.
    pub shape: Shape,
    /// Its colour.
    pub colour: Colour,
    /// Its name, and where that stands.
    pub name: Name,
    /// A phrase for the caption that explains what is drawn, such as "Broken lines: the band's edges"; `None` if the
    /// picture itself names it.
    pub meaning: Option<String>,
}

impl Item {
    /// Something without a name.
    pub fn new(shape: Shape, colour: Colour) -> Self {
        Self { shape, colour, name: Name::None, meaning: None }
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

    /// The same with its name on its line.
    pub fn on_line(self, name: impl Into<String>) -> Self {
        Self { name: Name::OnLine(name.into()), ..self }
    }

    /// The same, explained by this phrase in the caption.
    pub fn meaning(self, phrase: impl Into<String>) -> Self {
        Self { meaning: Some(phrase.into()), ..self }
    }

    /// The same with its name in the legend.
    pub fn in_legend(self, name: impl Into<String>) -> Self {
        Self { name: Name::InLegend(name.into()), ..self }
    }
}

/// An event: a line from top to bottom with a label above.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Place on the x axis, in the axis's unit.
    pub x: f64,
    /// The label.
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
pub struct Drawing {
    /// Its files' name, without the ending.
    pub name: String,
    /// The title: what is to be seen.
    pub title: String,
    /// The line below the title: scenario, law, seed, version.
    pub subject: String,
    /// A description of the picture, in sentences. [`Drawing::full_caption`] adds what its items mean.
    pub caption: String,
    /// Width and height as shown, px.
    pub size_px: [f64; 2],
    /// Its parts.
    pub panels: Vec<Panel>,
}

impl Drawing {
    /// The drawing as an SVG document that needs nothing else.
    pub fn svg(&self) -> String {
        layout::svg(self)
    }

    /// The caption with the meaning of everything that is drawn and not named in the picture, each once, in the order of
    /// drawing. It is made from the items, so that it names exactly what is drawn.
    pub fn full_caption(&self) -> String {
        let mut caption = self.caption.trim_end().to_owned();
        let mut named: Vec<&str> = Vec::new();
        for item in self.panels.iter().flat_map(|panel| &panel.items).filter(|item| !item.shape.is_empty()) {
            let Some(meaning) = item.meaning.as_deref().filter(|meaning| !named.contains(meaning)) else { continue };
            named.push(meaning);
            caption += &format!(" {meaning}.");
        }
        caption
    }

    /// Writes it as PNG.
    ///
    /// # Errors
    /// If that cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), Error> {
        out::write(path, canvas::png(&self.svg())?)
    }
}

/// The text as it may stand between tags, or in an attribute.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests;
