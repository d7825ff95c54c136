//! The table that `fly` shows on a terminal: a picture of a [`Status`] and of nothing else.

use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span, Text};
use ratatui::widgets::{Cell, Paragraph, Row as TableRow, Table};

use super::status::{Row, Stage, Status};

/// Lines kept for what happened, if there is room for them.
const EVENT_LINES: u16 = 4;

/// Title and width of each column.
const COLUMNS: [(&str, u16); 11] = [
    ("id", 3),
    ("phase", 10),
    ("step", 4),
    ("alt m", 5),
    ("ρ m", 6),
    ("gap °", 11),
    ("near m", 6),
    ("Hz", 4),
    ("peer ms", 7),
    ("p99 µs", 6),
    ("late/dr", 7),
];

/// Draws all of it.
pub fn draw(frame: &mut Frame<'_>, status: &Status) {
    let rows = u16::try_from(status.rows.len()).unwrap_or(u16::MAX).saturating_add(1);
    let room = frame.area().height.saturating_sub(3 + EVENT_LINES).max(2);
    let [title, table, rule, events, help] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(rows.min(room)),
        Constraint::Length(1),
        Constraint::Min(0),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    frame.render_widget(Paragraph::new(headline(status)), title);
    frame.render_widget(vehicles(&status.rows), table);
    let hidden = status.rows.len().saturating_sub(usize::from(table.height.saturating_sub(1)));
    frame.render_widget(divider(rule, hidden), rule);
    let newest = status.events.len().saturating_sub(usize::from(events.height));
    let lines: Vec<Line<'_>> = status.events[newest..].iter().map(|event| Line::raw(event.as_str())).collect();
    frame.render_widget(Paragraph::new(lines), events);
    frame.render_widget(Paragraph::new(how_to_stop(status)).style(Style::new().fg(Color::DarkGray)), help);
}

fn headline(status: &Status) -> Line<'_> {
    let bold = Style::new().add_modifier(Modifier::BOLD);
    Line::from(vec![
        Span::styled(status.swarm.as_str(), bold),
        Span::raw(format!("  {} vehicles, {}  ", status.rows.len(), status.plant)),
        Span::styled(stage(status), bold),
    ])
}

/// How far the flight is, in words; plain progress lines begin with it too.
pub fn stage(status: &Status) -> String {
    let flown = minutes(status.flown_s);
    match (status.stage, status.duration_s) {
        (Stage::Gathering, _) => "gathering".to_owned(),
        (Stage::Flying, Some(duration_s)) => format!("{flown} of {}", minutes(duration_s)),
        (Stage::Flying, None) => flown,
        (Stage::Landing, _) => format!("landing after {flown}"),
        (Stage::Ending, _) => format!("ending after {flown}"),
    }
}

/// The small addition keeps a clock that ran to its end from standing a second before it.
fn minutes(seconds: f64) -> String {
    let whole = (seconds + 0.01).max(0.0) as u64;
    format!("{:02}:{:02}", whole / 60, whole % 60)
}

fn vehicles(rows: &[Row]) -> Table<'_> {
    let right = |text: String| Cell::from(Text::from(text).alignment(Alignment::Right));
    let number = |value: Option<f64>, decimals: usize| {
        right(value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}")))
    };
    let row = |row: &Row| {
        let gap = row.gap_deg.map_or_else(|| "-".to_owned(), |(gap, excess)| format!("{gap:.1} {excess:+.1}"));
        let late = row.late_dropped.map_or_else(|| "-".to_owned(), |(late, dropped)| format!("{late}/{dropped}"));
        let cells = [
            right(row.id.to_string()),
            Cell::from(row.phase.clone()),
            right(row.step.map_or_else(|| "-".to_owned(), |step| step.to_string())),
            number(row.altitude_m, 1),
            number(row.from_centre_m, 1),
            right(gap),
            number(row.nearest_m, 1),
            number(row.frame_rate_hz, 1),
            number(row.peer_age_ms, 0),
            number(row.step_p99_us, 0),
            right(late),
        ];
        TableRow::new(cells).style(if row.bad { Style::new().fg(Color::Red) } else { Style::new() })
    };
    let titles = COLUMNS.iter().enumerate().map(
        |(nth, (title, _))| {
            if nth == 1 { Cell::from(*title) } else { right((*title).to_owned()) }
        },
    );
    let header = TableRow::new(titles).style(Style::new().add_modifier(Modifier::UNDERLINED));
    Table::new(rows.iter().map(row), COLUMNS.map(|(_, width)| Constraint::Length(width))).header(header)
}

/// A rule, that says how many rows there was no room for.
fn divider(area: Rect, hidden: usize) -> Paragraph<'static> {
    let note = if hidden > 0 { format!(" {hidden} more, make the window taller ") } else { String::new() };
    let rule = "─".repeat(usize::from(area.width).saturating_sub(note.chars().count()));
    Paragraph::new(note + &rule).style(Style::new().fg(Color::DarkGray))
}

fn how_to_stop(status: &Status) -> String {
    match status.stage {
        Stage::Gathering | Stage::Flying => format!("Ctrl-C or q: land and end   files: {}", status.out),
        Stage::Landing => format!("Ctrl-C or q: end at once, in the air   files: {}", status.out),
        Stage::Ending => format!("Ctrl-C or q: end at once   files: {}", status.out),
    }
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use skein_common::id::VehicleId;

    use super::*;

    fn row(id: u8) -> Row {
        Row {
            id: VehicleId::new(id).unwrap(),
            phase: "formation".to_owned(),
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

    fn status(rows: Vec<Row>) -> Status {
        Status {
            swarm: "hover".to_owned(),
            plant: "builtin".to_owned(),
            stage: Stage::Flying,
            flown_s: 83.2,
            duration_s: Some(400.0),
            out: "skein-runs/hover".to_owned(),
            rows,
            events: (1..=9).map(|nth| format!("event {nth}")).collect(),
        }
    }

    fn drawn(status: &Status, width: u16, height: u16) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, status)).unwrap();
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
            " id phase      step alt m    ρ m       gap ° near m   Hz peer ms p99 µs late/dr",
            "  1 formation     2  30.0  101.3   92.1 +2.1  141.4 50.0     187     84     0/3",
            "  2 lost          2     -  101.3           -  141.4 50.0     187     84       -",
            "  3 formation     2  30.0  101.3   92.1 +2.1  141.4 50.0     187     84     0/3",
            &"─".repeat(80),
            "event 6",
            "event 7",
            "event 8",
            "event 9",
            "Ctrl-C or q: land and end   files: skein-runs/hover",
        ];
        assert_eq!(drawn(&status, 80, 11), expected);
    }

    #[test]
    fn what_has_no_room_is_said() {
        let lines = drawn(&status((1..=30).map(row).collect()), 80, 12);
        assert!(lines[6].starts_with(" 26 more, make the window taller ─"), "{lines:#?}");
        assert_eq!(lines[10], "event 9");
    }

    #[test]
    fn no_size_is_too_small() {
        for (width, height) in [(1, 1), (5, 2), (20, 3), (200, 1), (1, 50)] {
            drawn(&status(vec![row(1), row(2)]), width, height);
        }
    }

    #[test]
    fn the_stage_says_what_is_left_to_do() {
        let mut status = status(Vec::new());
        assert_eq!(stage(&status), "01:23 of 06:40");
        status.duration_s = None;
        assert_eq!(stage(&status), "01:23");
        status.stage = Stage::Landing;
        assert_eq!(stage(&status), "landing after 01:23");
        assert!(how_to_stop(&status).contains("in the air"));
    }
}
