use std::fs;

use super::*;
use skein_common::math;

fn figure() -> Drawing {
    let mut panel = Panel::new(Axis::new("time", "s"), Axis::new("distance", "m"));
    panel.title = "a < b & c".to_owned();
    let line =
        |height: f64| vec![(0..100).map(|nth| [f64::from(nth), height + math::sin(f64::from(nth) * 0.3)]).collect()];
    panel.items = vec![
        Item::line(line(3.0), Colour::BLUE).marked(0).at_end("1"),
        Item::line(line(3.1), Colour::VERMILLION).marked(1).at_end("2"),
        Item::line(line(2.0), Colour::GREY).dashed().in_legend("limit"),
        Item::new(Shape::Area(vec![vec![[0.0, 1.0], [99.0, 1.0], [99.0, 2.0], [0.0, 2.0]]]), Colour::PALE)
            .in_legend("band"),
        Item::new(Shape::Bars(vec![([10.0, 0.0], [30.0, 0.5], "3".to_owned())]), Colour::SKY),
        Item::new(Shape::Arrows(vec![([50.0, 0.0], [60.0, 0.5]), ([5.0, 0.1], [5.0, 0.1])]), Colour::GREEN),
        Item::new(
            Shape::Dots { at: vec![[1.0, 1.0], [1e9, 1.0]], marker: Marker::Cross, size_px: 6.0 },
            Colour::PURPLE,
        ),
        Item::new(Shape::Note { at: [40.0, 1.0], text: "here".to_owned(), side: [1.0, 1.0] }, Colour::BLACK),
    ];
    panel.x = panel.x.within(0.0, 99.0);
    panel.marks = vec![Mark { x: 20.0, text: "one".to_owned() }, Mark { x: 22.0, text: "two".to_owned() }];
    Drawing {
        name: "it".to_owned(),
        title: "It \"is\" what it is".to_owned(),
        subject: "test".to_owned(),
        caption: String::new(),
        size_px: [600.0, 300.0],
        panels: vec![panel],
    }
}

#[test]
fn the_same_figure_is_the_same_bytes() {
    let svg = figure().svg();
    assert_eq!(svg, figure().svg());
    assert!(
        svg.starts_with("<svg width=\"600\" height=\"300\" role=\"img\" viewBox=\"0 0 600 300\" xmlns="),
        "{svg:.200}"
    );
    assert!(svg.contains("<title>It &quot;is&quot; what it is. test</title>"));
    assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());
    for text in ["time, s", "distance, m", "a &lt; b &amp; c", "limit", "band", "one", "two", "here"] {
        assert!(svg.contains(text), "{text} is missing");
    }
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn a_png_has_two_pixels_for_each_shown() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("it.png");
    figure().write_png(&path).unwrap();
    let bytes = fs::read(&path).unwrap();
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    let size = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!((size(16), size(20)), (1200, 600));
}

#[test]
fn what_has_nothing_or_one_point_is_drawn_too() {
    let mut empty = figure();
    empty.panels[0].items.clear();
    assert!(empty.svg().contains("time, s"));
    let mut map = figure();
    map.panels[0].is_map = true;
    map.panels[0].items = vec![Item::line(vec![vec![[3.0, 4.0]], Vec::new()], Colour::BLUE).at_end("1").marked(2)];
    assert!(!map.svg().contains("NaN"));
}

#[test]
fn what_lies_outside_is_cut_off_and_what_is_no_number_interrupts_a_line() {
    let mut figure = figure();
    let panel = &mut figure.panels[0];
    panel.y = Axis::new("traffic", "Mbit/s").log().within(1.0, 100.0);
    panel.items =
        vec![Item::line(vec![vec![[0.0, 1.0], [20.0, 10.0], [40.0, 0.0], [60.0, 10.0], [99.0, 1.0]]], Colour::BLUE)];
    let inside = figure.svg();
    assert_eq!(inside.matches("<svg").count(), 1);
    let line = inside.lines().find(|line| line.contains("#0072b2")).unwrap();
    assert_eq!(line.matches('M').count(), 2, "{line}");
    figure.panels[0].items.push(Item::line(vec![vec![[0.0, 10.0], [1e12, 1e300]]], Colour::GREEN));
    assert_eq!(figure.svg().matches("<svg").count(), 2);
}
