//! The picture that `fly` shows on a terminal: of a [`FlightStatus`] and of nothing else.

use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span, Text};
use ratatui::widgets::{Block, Borders, Cell, Padding, Paragraph, Row as TableRow, Table};
use skein_lab::terminal::{shortened, wrapped};

use super::columns::{Column, NARROW, WIDE, WIDE_COLUMNS};
use super::status::{EVENT_TIME as EVENT_INDENT, FlightStatus, Row, Stage};

/// Lines kept for events, if there is room for them.
const EVENT_LINES: u16 = 3;
/// The columns of a terminal with events beside the table.
const EVENTS_BESIDE: u16 = WIDE_COLUMNS + 50;
/// The most space between two columns of the table.
const MAX_SPACING: u16 = 3;

/// Draws all of it, or the explanation of the columns.
pub fn draw(frame: &mut Frame<'_>, status: &FlightStatus, explains: bool) {
    let [title, summary, body, bottom] =
        Layout::vertical([Constraint::Length(1), Constraint::Length(1), Constraint::Min(0), Constraint::Length(1)])
            .areas(frame.area());
    let width = usize::from(frame.area().width);
    let columns = if title.width >= WIDE_COLUMNS { &WIDE[..] } else { &NARROW[..] };
    frame.render_widget(Paragraph::new(headline(status)), title);
    frame.render_widget(Paragraph::new(status.summary(width)), summary);
    if explains {
        frame.render_widget(Paragraph::new(explanation(columns, width)), body);
    } else if body.width >= EVENTS_BESIDE {
        let [left, right] = Layout::horizontal([Constraint::Length(WIDE_COLUMNS), Constraint::Min(0)]).areas(body);
        let rest = draw_vehicles(frame, left, status.shown(), columns, 0);
        frame.render_widget(Paragraph::new(legend(columns, usize::from(rest.width))).style(dim()), rest);
        let block = Block::new().borders(Borders::LEFT).border_style(dim()).padding(Padding::horizontal(1));
        let inner = block.inner(right);
        frame.render_widget(block, right);
        draw_events(frame, inner, status);
    } else {
        let legend = legend(columns, width);
        let wanted = u16::try_from(status.shown().len() + legend.len()).unwrap_or(u16::MAX).saturating_add(3);
        let has_legend = body.width >= WIDE_COLUMNS && body.height >= wanted.saturating_add(EVENT_LINES);
        let rest = draw_vehicles(frame, body, status.shown(), columns, EVENT_LINES);
        let height = if has_legend { u16::try_from(legend.len()).unwrap_or(0) + 1 } else { 0 };
        let [keys, events] = Layout::vertical([Constraint::Length(height), Constraint::Min(0)]).areas(rest);
        frame.render_widget(Paragraph::new(legend).style(dim()), keys);
        draw_events(frame, events, status);
    }
    let bottom_line = if explains { "? or Esc: back to the flight".to_owned() } else { keys(status, width) };
    frame.render_widget(Paragraph::new(bottom_line).style(dim()), bottom);
}

fn dim() -> Style {
    Style::new().fg(Color::DarkGray)
}

/// The table and the rule below it; `kept` lines stay free if possible. Gives the area that is left.
fn draw_vehicles(frame: &mut Frame<'_>, area: Rect, rows: &[Row], columns: &[Column], kept: u16) -> Rect {
    let height = u16::try_from(rows.len()).unwrap_or(u16::MAX).saturating_add(1);
    let room = area.height.saturating_sub(1 + kept).max(2);
    let [table, rule, rest] =
        Layout::vertical([Constraint::Length(height.min(room)), Constraint::Length(1), Constraint::Min(0)]).areas(area);
    frame.render_widget(vehicles(rows, columns, table.width), table);
    let hidden = rows.len().saturating_sub(usize::from(table.height.saturating_sub(1)));
    frame.render_widget(divider(rule, hidden), rule);
    rest
}

/// The newest events that fit, with lines wrapped at spaces.
fn draw_events(frame: &mut Frame<'_>, area: Rect, status: &FlightStatus) {
    let room = usize::from(area.width).saturating_sub(EVENT_INDENT).max(1);
    let mut lines: Vec<String> = Vec::new();
    for event in &status.events {
        let at = event.char_indices().nth(EVENT_INDENT).map_or(event.len(), |(at, _)| at);
        let (time, what) = event.split_at(at);
        for (nth, line) in wrapped(what, room).into_iter().enumerate() {
            let time = if nth == 0 { time } else { "" };
            lines.push(format!("{time:<EVENT_INDENT$}{}", shortened(&line, room)));
        }
    }
    let newest = lines.len().saturating_sub(usize::from(area.height));
    frame.render_widget(Paragraph::new(lines.split_off(newest).join("\n")), area);
}

fn headline(status: &FlightStatus) -> Line<'_> {
    let bold = Style::new().add_modifier(Modifier::BOLD);
    Line::from(vec![
        Span::styled(status.swarm.as_str(), bold),
        Span::raw(match status.teams.len() {
            0 => format!("  {} vehicles, {}  ", status.rows.len(), status.plant),
            teams => format!("  {} vehicles in {teams} teams, {}  ", status.rows.len(), status.plant),
        }),
        Span::styled(stage(status), bold),
    ])
}

/// The stage of the flight as text; plain progress lines begin with it too.
pub fn stage(status: &FlightStatus) -> String {
    let flown = minutes(status.flown_s);
    match (status.stage, status.duration_s) {
        (Stage::Gathering, _) => "gathering".to_owned(),
        (Stage::Flying, Some(duration_s)) => format!("{flown} of {}", minutes(duration_s)),
        (Stage::Flying, None) => flown,
        (Stage::Landing, _) => format!("landing after {flown}"),
        (Stage::Watched, _) => flown,
        (Stage::Ending, _) => format!("ending after {flown}"),
    }
}

/// The small addition keeps a clock that ran to its end from standing a second before it.
fn minutes(seconds: f64) -> String {
    let whole = (seconds + 0.01).max(0.0) as u64;
    format!("{:02}:{:02}", whole / 60, whole % 60)
}

fn vehicles<'a>(rows: &[Row], columns: &[Column], width: u16) -> Table<'a> {
    let cell = |column: &Column, text: String| match column.title {
        "phase" => Cell::from(text),
        _ => Cell::from(Text::from(text).alignment(Alignment::Right)),
    };
    let row = |row: &Row| {
        let cells = columns.iter().map(|column| cell(column, (column.cell)(row)));
        TableRow::new(cells).style(if row.bad { Style::new().fg(Color::Red) } else { Style::new() })
    };
    let titles = columns.iter().map(|column| cell(column, column.title.to_owned()));
    let header = TableRow::new(titles).style(Style::new().add_modifier(Modifier::UNDERLINED));
    let gaps = u16::try_from(columns.len()).unwrap_or(u16::MAX).saturating_sub(1).max(1);
    let spare = width.saturating_sub(columns.iter().map(|column| column.width).sum());
    let widths = columns.iter().map(|column| Constraint::Length(column.width));
    let spacing = (spare / gaps).clamp(1, MAX_SPACING);
    Table::new(rows.iter().map(row), widths).header(header).column_spacing(spacing)
}

/// A line or more for each column: what it shows, its unit, and which values are bad.
fn legend(columns: &[Column], width: usize) -> Vec<Line<'static>> {
    let indent = columns.iter().map(|column| column.title.chars().count()).max().unwrap_or(0) + 2;
    let mut lines = Vec::new();
    for column in columns {
        for (nth, line) in wrapped(column.about, width.saturating_sub(indent).max(1)).into_iter().enumerate() {
            let title = if nth == 0 { column.title } else { "" };
            lines.push(Line::raw(format!("{title:<indent$}{line}")));
        }
    }
    lines
}

fn explanation(columns: &[Column], width: usize) -> Vec<Line<'static>> {
    let mut lines = vec![Line::raw("What the columns mean:")];
    lines.extend(legend(columns, width));
    lines
}

/// A horizontal rule with the number of rows that did not fit.
fn divider(area: Rect, hidden: usize) -> Paragraph<'static> {
    let note = if hidden > 0 { format!(" {hidden} more, make the window taller ") } else { String::new() };
    let rule = "─".repeat(usize::from(area.width).saturating_sub(note.chars().count()));
    Paragraph::new(note + &rule).style(dim())
}

/// The keys that can be pressed, and where the files are if there is room.
fn keys(status: &FlightStatus, width: usize) -> String {
    let stop = match status.stage {
        Stage::Gathering | Stage::Flying => "Ctrl-C or q: land and end",
        Stage::Landing => "Ctrl-C or q: end at once, in the air",
        Stage::Ending => "Ctrl-C or q: end at once",
        Stage::Watched => "Ctrl-C or q: end the view, the swarm flies on",
    };
    let keys = format!("{stop}   ?: what the columns mean");
    let folder = status.out.rsplit('/').next().unwrap_or_default();
    let files = [format!("{keys}   files: {}", status.out), format!("{keys}   files: …/{folder}")];
    if status.out.is_empty() {
        return shortened(&keys, width);
    }
    let fits = files.into_iter().find(|line| line.chars().count() <= width);
    fits.unwrap_or_else(|| shortened(&keys, width))
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;

    fn row(id: u8) -> Row {
        Row {
            name: id.to_string(),
            phase: "formation".to_owned(),
            in_place_s: Some(60.0),
            bad: false,
            altitude_m: Some(30.04),
            step: Some(2),
            from_centre_m: Some(101.26),
            gap_deg: Some((92.14, 2.14)),
            nearest_m: Some(141.4),
            frame_rate_hz: Some(50.0),
            peer_age_ms: Some(187.4),
            step_p99_us: Some(84.2),
            late_dropped: Some((0, 3)),
        }
    }

    fn status(rows: Vec<Row>) -> FlightStatus {
        FlightStatus {
            swarm: "hover".to_owned(),
            plant: "builtin".to_owned(),
            stage: Stage::Flying,
            flown_s: 83.2,
            duration_s: Some(400.0),
            out: "skein-runs/hover".to_owned(),
            rows,
            teams: Vec::new(),
            team: None,
            has_gaps: true,
            events: (1..=9).map(|nth| format!("{:6.1} s  event {nth}", f64::from(nth))).collect(),
        }
    }

    fn drawn(status: &FlightStatus, width: u16, height: u16) -> Vec<String> {
        drawn_as(status, width, height, false)
    }

    fn drawn_as(status: &FlightStatus, width: u16, height: u16, explains: bool) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, status, explains)).unwrap();
        let buffer = terminal.backend().buffer();
        let line = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>().trim_end().to_owned();
        (0..height).map(line).collect()
    }

    #[test]
    fn a_flight_fits_a_terminal_of_eighty_columns() {
        let mut status = status(vec![row(1), row(2), row(3)]);
        let lost = Row { phase: "lost".to_owned(), bad: true, ..row(2) };
        status.rows[1] = Row { gap_deg: None, late_dropped: None, altitude_m: None, ..lost };
        let expected = [
            "hover  3 vehicles, builtin  01:23 of 06:40",
            "2/3 in formation, 1 lost, worst gap 2.1°, nearest 141.4 m, altitude 30.0 m",
            " id phase       step alt m   ρ m       gap ° near m   Hz peer ms p99 µs late/dr",
            "  1 formation      2  30.0 101.3   92.1 +2.1  141.4 50.0     187     84     0/3",
            "  2 lost           2     - 101.3           -  141.4 50.0     187     84       -",
            "  3 formation      2  30.0 101.3   92.1 +2.1  141.4 50.0     187     84     0/3",
            &"─".repeat(80),
            "   6.0 s  event 6",
            "   7.0 s  event 7",
            "   8.0 s  event 8",
            "   9.0 s  event 9",
            "Ctrl-C or q: land and end   ?: what the columns mean   files: skein-runs/hover",
        ];
        assert_eq!(drawn(&status, 80, 12), expected);
    }

    #[test]
    fn long_events_are_wrapped_at_spaces() {
        let mut status = status(vec![row(1)]);
        status.events = vec![format!("  16.2 s  the vehicle {}has landed", "far away ".repeat(8))];
        let lines = drawn(&status, 80, 12);
        assert_eq!(lines[5].chars().take(30).collect::<String>(), "  16.2 s  the vehicle far away");
        assert_eq!(lines[6], "          away far away has landed");
    }

    #[test]
    fn a_key_press_explains_every_column() {
        let status = status((1..=16).map(row).collect());
        let lines = drawn_as(&status, 80, 24, true);
        assert!(lines[2].starts_with("What the columns mean"), "{lines:#?}");
        for column in NARROW {
            assert!(lines.iter().any(|line| line.starts_with(column.title)), "{}: {lines:#?}", column.title);
        }
        assert_eq!(lines[23], "? or Esc: back to the flight");
        assert!(lines[22].is_empty(), "all of it is shown: {lines:#?}");
    }

    #[test]
    fn a_wide_terminal_has_full_names_a_legend_and_events_beside_the_table() {
        let status = status((1..=16).map(row).collect());
        let lines = drawn(&status, 120, 44);
        assert!(lines[2].starts_with("vehicle phase") && lines[2].ends_with(" dropped"), "{lines:#?}");
        assert!(lines.iter().any(|line| line.starts_with("off even °   by how much")), "{lines:#?}");
        assert!(lines[42].ends_with("event 9"), "{lines:#?}");
        let lines = drawn(&status, 200, 50);
        assert!(lines[2].contains("dropped  │    1.0 s  event 1"), "{lines:#?}");
        assert!(lines.iter().any(|line| line.starts_with("off even °   by how much")), "{lines:#?}");
    }

    #[test]
    fn rows_that_do_not_fit_are_counted() {
        let lines = drawn(&status((1..=30).map(row).collect()), 80, 12);
        assert!(lines[7].starts_with(" 26 more, make the window taller ─"), "{lines:#?}");
        assert_eq!(lines[10], "   9.0 s  event 9");
        let sixteen = drawn(&status((1..=16).map(row).collect()), 80, 24);
        assert!(sixteen.iter().any(|line| line.starts_with(" 16 formation")), "{sixteen:#?}");
    }

    #[test]
    fn no_size_is_too_small() {
        for (width, height) in [(1, 1), (5, 2), (20, 3), (200, 1), (1, 50)] {
            drawn(&status(vec![row(1), row(2)]), width, height);
            drawn_as(&status(vec![row(1), row(2)]), width, height, true);
        }
    }

    #[test]
    fn the_stage_shows_what_is_left_to_do() {
        let mut status = status(Vec::new());
        assert_eq!(stage(&status), "01:23 of 06:40");
        status.duration_s = None;
        assert_eq!(stage(&status), "01:23");
        status.stage = Stage::Landing;
        assert_eq!(stage(&status), "landing after 01:23");
        assert!(keys(&status, 80).contains("in the air"));
    }
}
