//! Writes a figure's SVG, and renders the PNG from it.

use std::fmt::{Display, Write};
use std::sync::{Arc, LazyLock};

use epaint_default_fonts::UBUNTU_LIGHT;
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{FontResolver, Options, Tree, fontdb};
use skein_common::math;
use skrifa::instance::{LocationRef, Size};
use skrifa::{FontRef, MetadataProvider};

use super::{Colour, Marker, escaped};
use crate::error::Error;

/// Size of the small text of a figure: ticks, legends, names.
pub(super) const SMALL_PX: f64 = 12.5;

/// Pixels of a PNG for each pixel shown.
const PNG_FINE: f32 = 2.0;
/// The fonts that browsers take for the text: our own where it is installed, else what the system reads well.
const FONTS: &str = "Ubuntu, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif";
/// Most of those are wider than ours, in which text is measured.
const WIDER: f64 = 1.1;
/// Height of capital letters as a share of the font size; the baseline is half of it below the middle.
const LETTER_HEIGHT: f64 = 0.7;
/// Points nearer than this to a line without them are left out, px.
const UNSEEN_PX: f64 = 0.1;

/// Our font, for PNGs: a cluster's PC may have none.
static FONT: LazyLock<Arc<fontdb::Database>> = LazyLock::new(|| {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_source(fontdb::Source::Binary(Arc::new(UBUNTU_LIGHT)));
    Arc::new(fonts)
});

/// The width of a text, px.
pub(super) fn text_width(text: &str, size_px: f64) -> f64 {
    let Ok(font) = FontRef::new(UBUNTU_LIGHT) else { return 0.0 };
    let (glyphs, metrics) = (font.charmap(), font.glyph_metrics(Size::new(size_px as f32), LocationRef::default()));
    let width = |letter| f64::from(metrics.advance_width(glyphs.map(letter).unwrap_or_default()).unwrap_or_default());
    text.chars().map(width).sum::<f64>() * WIDER
}

/// The SVG as PNG.
pub(super) fn png(svg: &str) -> Result<Vec<u8>, Error> {
    let failed = |error: &dyn Display| Error::Failed(format!("a figure cannot be drawn: {error}"));
    // Whatever fonts a text asks for, it gets ours.
    let select_font = Box::new(|_: &_, fonts: &mut Arc<fontdb::Database>| fonts.faces().next().map(|face| face.id));
    let font_resolver = FontResolver { select_font, ..FontResolver::default() };
    let options = Options { fontdb: FONT.clone(), font_resolver, ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|error| failed(&error))?;
    let [width, height] = [tree.size().width(), tree.size().height()].map(|px| (px * PNG_FINE).round() as u32);
    let mut pixels = Pixmap::new(width, height).ok_or_else(|| failed(&"it has no size"))?;
    resvg::render(&tree, Transform::from_scale(PNG_FINE, PNG_FINE), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| failed(&error))
}

/// The part of a text that lies at its place: its left end, its middle or its right end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    Left,
    Centre,
    Right,
}

/// The document so far. Places are pixels as shown, from the left and from the top.
pub(super) struct Canvas(String);

impl Canvas {
    /// White paper of this size.
    pub(super) fn new([width, height]: [f64; 2], title: &str) -> Self {
        let (title, size) = (escaped(title), format!("width=\"{width}\" height=\"{height}\""));
        Self(format!(
            "<svg {size} role=\"img\" viewBox=\"0 0 {width} {height}\" xmlns=\"http://www.w3.org/2000/svg\" \
             font-family=\"{FONTS}\" stroke-linejoin=\"round\">\n<title>{title}</title>\n<rect {size} fill=\"#fff\"/>\n"
        ))
    }

    pub(super) fn finish(self) -> String {
        self.0 + "</svg>\n"
    }

    fn put(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a text does not fail.
        let _ = self.0.write_fmt(element).and_then(|()| self.0.write_char('\n'));
    }

    /// Draws with everything outside left, top, right, bottom cut off.
    pub(super) fn within(&mut self, [left, top, right, bottom]: [f64; 4], draw: impl FnOnce(&mut Self)) {
        // An inner document, unlike a clip path, needs no name, which other figures on a page might have too.
        let place = [left, top, right - left, bottom - top].map(number);
        let [x, y, width, height] = &place;
        let view = place.join(" ");
        self.put(format_args!("<svg x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" viewBox=\"{view}\">"));
        draw(self);
        self.put(format_args!("</svg>"));
    }

    /// Lines through these places.
    pub(super) fn lines(&mut self, lines: &[Vec<[f64; 2]>], width_px: f64, is_dashed: bool, of: Colour) {
        let way: String = lines.iter().filter(|line| line.len() > 1).map(|line| way(line)).collect();
        let dashes = if is_dashed { " stroke-dasharray=\"5\"" } else { "" };
        if !way.is_empty() {
            let paint = paint("stroke", of);
            self.put(format_args!("<path d=\"{way}\" fill=\"none\" {paint} stroke-width=\"{width_px}\"{dashes}/>"));
        }
    }

    /// One line of an axis, straight to the right or down: on whole pixels of any screen.
    pub(super) fn rule(&mut self, from: [f64; 2], to: [f64; 2], of: Colour) {
        let crisp = |place: [f64; 2]| place.map(|px| px.floor() + 0.5);
        self.lines(&[vec![crisp(from), crisp(to)]], 1.0, false, of);
    }

    /// Filled outlines.
    pub(super) fn fill(&mut self, outline: &[[f64; 2]], of: Colour) {
        if outline.len() > 2 {
            self.put(format_args!("<path d=\"{}Z\" {}/>", way(outline), paint("fill", of)));
        }
    }

    /// Filled rectangles, each between two corners, without gaps between neighbours.
    pub(super) fn cells(&mut self, cells: impl Iterator<Item = [[f64; 2]; 2]>, of: Colour) {
        let cell = |corners: [[f64; 2]; 2]| {
            let [[x0, y0], [x1, y1]] = corners.map(|corner| corner.map(number));
            format!("M{x0},{y0}H{x1}V{y1}H{x0}Z")
        };
        let way: String = cells.map(cell).collect();
        if !way.is_empty() {
            self.put(format_args!("<path d=\"{way}\" {} shape-rendering=\"crispEdges\"/>", paint("fill", of)));
        }
    }

    /// A dot, with a rim of the paper's colour that parts it from others.
    pub(super) fn dot(&mut self, [x, y]: [f64; 2], marker: Marker, size_px: f64, of: Colour) {
        let half = size_px / 2.0;
        let corners: &[[f64; 2]] = match marker {
            Marker::Circle => &[],
            Marker::Square => &[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
            Marker::Triangle => &[[0.0, -1.15], [1.05, 0.75], [-1.05, 0.75]],
            Marker::Diamond => &[[0.0, -1.2], [1.2, 0.0], [0.0, 1.2], [-1.2, 0.0]],
            Marker::Down => &[[0.0, 1.15], [1.05, -0.75], [-1.05, -0.75]],
            Marker::Plus => &[[-1.1, 0.0], [1.1, 0.0], [0.0, -1.1], [0.0, 1.1]],
            Marker::Cross => &[[-0.85, -0.85], [0.85, 0.85], [-0.85, 0.85], [0.85, -0.85]],
        };
        let corners: Vec<_> = corners.iter().map(|[right, down]| [x + right * half, y + down * half]).collect();
        if matches!(marker, Marker::Plus | Marker::Cross) {
            return self.lines(&[corners[..2].to_vec(), corners[2..].to_vec()], size_px / 4.0, false, of);
        }
        let rim = if of.opacity == 1.0 { " stroke=\"#fff\" stroke-width=\"1.5\" paint-order=\"stroke\"" } else { "" };
        let paint = paint("fill", of) + rim;
        match marker {
            Marker::Circle => {
                let [x, y, radius] = [x, y, half].map(number);
                self.put(format_args!("<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\" {paint}/>"));
            }
            _ => self.put(format_args!("<path d=\"{}Z\" {paint}/>", way(&corners))),
        }
    }

    /// A text, its middle at the height of the place.
    pub(super) fn text(&mut self, at: [f64; 2], text: &str, size_px: f64, of: Colour, anchor: Anchor) {
        self.write(at, text, (size_px, of), anchor, "");
    }

    /// A text that hides a little of what is around it.
    pub(super) fn text_on_paper(&mut self, at: [f64; 2], text: &str, size_px: f64, of: Colour, anchor: Anchor) {
        let rim = " stroke=\"#fff\" stroke-opacity=\"0.75\" stroke-width=\"4\" paint-order=\"stroke\"";
        self.write(at, text, (size_px, of), anchor, rim);
    }

    /// A text from bottom to top, its middle at the place.
    pub(super) fn text_upwards(&mut self, at: [f64; 2], text: &str, size_px: f64, of: Colour) {
        let [x, y] = at.map(number);
        self.write(at, text, (size_px, of), Anchor::Centre, &format!(" transform=\"rotate(-90 {x} {y})\""));
    }

    fn write(&mut self, [x, y]: [f64; 2], text: &str, (size_px, of): (f64, Colour), anchor: Anchor, more: &str) {
        let (x, y, paint) = (number(x), number(y + LETTER_HEIGHT / 2.0 * size_px), paint("fill", of));
        let anchor = match anchor {
            Anchor::Left => "start",
            Anchor::Centre => "middle",
            Anchor::Right => "end",
        };
        let style = format!("font-size=\"{size_px}\" text-anchor=\"{anchor}\" {paint}{more}");
        self.put(format_args!("<text x=\"{x}\" y=\"{y}\" {style}>{}</text>", escaped(text)));
    }
}

/// With so few decimals that the last bits of a computation do not show.
fn number(px: f64) -> String {
    let text = format!("{px:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

fn paint(what: &str, Colour { rgb: [red, green, blue], opacity }: Colour) -> String {
    let opacity = if opacity < 1.0 { format!(" {what}-opacity=\"{opacity}\"") } else { String::new() };
    format!("{what}=\"#{red:02x}{green:02x}{blue:02x}\"{opacity}")
}

/// From each place to the next.
fn way(line: &[[f64; 2]]) -> String {
    let places = simplified(line).into_iter().map(|place| place.map(number).join(","));
    format!("M{}", places.collect::<Vec<_>>().join(" "))
}

/// The line without points that change nothing to be seen (Ramer, Douglas, Peucker).
fn simplified(line: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut kept = vec![false; line.len()];
    let mut open = vec![(0, line.len().saturating_sub(1))];
    while let Some((first, last)) = open.pop() {
        (kept[first], kept[last]) = (true, true);
        let away = |nth: usize| (nth, distance(line[nth], line[first], line[last]));
        let farthest = (first + 1..last).map(away).max_by(|one, other| one.1.total_cmp(&other.1));
        if let Some((nth, _)) = farthest.filter(|(_, away)| *away > UNSEEN_PX) {
            open.extend([(first, nth), (nth, last)]);
        }
    }
    line.iter().zip(kept).filter_map(|(point, kept)| kept.then_some(*point)).collect()
}

/// The distance of a point from a segment.
fn distance(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let way = [to[0] - from[0], to[1] - from[1]];
    let off = [point[0] - from[0], point[1] - from[1]];
    let square = way[0] * way[0] + way[1] * way[1];
    let share = if square > 0.0 { ((off[0] * way[0] + off[1] * way[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    math::hypot(off[0] - share * way[0], off[1] - share * way[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_invisible_points_are_left_out() {
        let straight: Vec<_> = (0..1000).map(|nth| [f64::from(nth), 3.0]).collect();
        assert_eq!(way(&straight), "M0,3 999,3");
        let mut bent = straight;
        bent[500][1] = 4.04;
        assert!(way(&bent).contains(" 500,4 "));
        assert_eq!(way(&[[-0.04, 0.0], [9.25, 0.0], [0.0, 0.0]]), "M0,0 9.2,0 0,0");
    }

    #[test]
    fn the_font_that_comes_with_the_program_has_every_letter_of_a_png() {
        let blank = Canvas::new([60.0, 20.0], "").finish();
        let drawn = |text: &str| {
            let mut canvas = Canvas::new([60.0, 20.0], "");
            canvas.text([0.0, 10.0], text, 12.0, Colour::BLACK, Anchor::Left);
            png(&canvas.finish()).unwrap()
        };
        assert_ne!(drawn("12 s"), png(&blank).unwrap());
        for letter in "azAZ09*|_%°·–\u{2212}".chars() {
            assert_ne!(drawn(&letter.to_string()), drawn("\u{10ffff}"), "{letter}");
        }
        assert!(text_width("mm", 12.0) > text_width("ll", 12.0) && text_width("ll", 12.0) > 0.0);
    }
}
