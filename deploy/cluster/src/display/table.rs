//! The picture that `fly` shows on a terminal: of a [`FlightStatus`] and of nothing else.

use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span, Text};
use ratatui::widgets::{Block, Borders, Cell, Padding, Paragraph, Row as TableRow, Table};
use skein_lab::terminal::{shortened, wrapped};

use super::columns::{Column, WIDE_COLUMNS, fitting, needed, set};
use super::status::{EVENT_TIME as EVENT_INDENT, FlightStatus, Row, Stage};

/// Lines kept for events, if there is room for them.
const EVENT_LINES: u16 = 3;
/// The columns that events beside the table need, and the border between.
const EVENTS_BESIDE: u16 = 50;
/// The most space between two columns of the table.
const MAX_SPACING: u16 = 3;
/// The least columns of the text beside a heading; a narrower text is below it.
const TEXT_BESIDE: usize = 24;

/// The content of the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// The flight.
    Flight,
    /// The meanings of the columns.
    Columns,
    /// The QR code of the live page's address, if there is one.
    Code,
}

/// Draws the flight, or what is shown instead of it. `code` is the QR code of the live page's address, which a key shows.
pub fn draw(frame: &mut Frame<'_>, status: &FlightStatus, shown: Shown, code: Option<&str>) {
    let [title, summary, body, bottom] =
        Layout::vertical([Constraint::Length(1), Constraint::Length(1), Constraint::Min(0), Constraint::Length(1)])
            .areas(frame.area());
    let width = usize::from(frame.area().width);
    let fitted = |set: Vec<Column>| (fitting(&set, status.shown(), body.width), set);
    let (columns, set) = match fitted(set(true)) {
        (columns, wide) if body.width >= WIDE_COLUMNS && columns.len() == wide.len() => (columns, wide),
        _ => fitted(set(false)),
    };
    let hidden = set.len() - columns.len();
    let beside = u16::try_from(needed(&columns)).unwrap_or(u16::MAX).max(WIDE_COLUMNS);
    frame.render_widget(Paragraph::new(headline(status, width)), title);
    frame.render_widget(Paragraph::new(status.summary(width)), summary);
    if shown == Shown::Columns {
        let lines = [Line::raw(shortened("What the columns mean:", width))].into_iter().chain(legend(&set, width));
        frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()), body);
    } else if let (Shown::Code, Some(code)) = (shown, code) {
        draw_code(frame, body, code);
    } else if body.width >= beside.saturating_add(EVENTS_BESIDE) {
        let [left, right] = Layout::horizontal([Constraint::Length(beside), Constraint::Min(0)]).areas(body);
        let rest = draw_vehicles(frame, left, status.shown(), &columns, (hidden, 0));
        frame.render_widget(Paragraph::new(legend(&set, usize::from(rest.width))).style(dim()), rest);
        let block = Block::new().borders(Borders::LEFT).border_style(dim()).padding(Padding::horizontal(1));
        let inner = block.inner(right);
        frame.render_widget(block, right);
        draw_events(frame, inner, status);
    } else {
        let legend = legend(&set, width);
        let wanted = u16::try_from(status.shown().len() + legend.len()).unwrap_or(u16::MAX).saturating_add(3);
        let has_legend = body.width >= WIDE_COLUMNS && body.height >= wanted.saturating_add(EVENT_LINES);
        let rest = draw_vehicles(frame, body, status.shown(), &columns, (hidden, EVENT_LINES));
        let height = if has_legend { u16::try_from(legend.len()).unwrap_or(0) + 1 } else { 0 };
        let [keys, events] = Layout::vertical([Constraint::Length(height), Constraint::Min(0)]).areas(rest);
        frame.render_widget(Paragraph::new(legend).style(dim()), keys);
        draw_events(frame, events, status);
    }
    let bottom_line = match (shown, code) {
        (Shown::Columns, _) => shortened("? or Esc: back to the flight", width),
        (Shown::Code, Some(_)) => shortened("p or Esc: back to the flight", width),
        _ => keys(status, code.is_some(), width),
    };
    frame.render_widget(Paragraph::new(bottom_line).style(dim()), bottom);
}

/// A code in white on black, whatever the terminal's colours are: not every camera reads a code with exchanged colours.
fn draw_code(frame: &mut Frame<'_>, body: Rect, code: &str) {
    let width = code.lines().map(|line| line.chars().count()).max().unwrap_or(0);
    let fits = usize::from(body.height) >= code.lines().count() && usize::from(body.width) >= width;
    let area = Rect { width: body.width.min(u16::try_from(width).unwrap_or(u16::MAX)), ..body };
    match fits {
        true => frame.render_widget(Paragraph::new(code).style(Style::new().fg(Color::White).bg(Color::Black)), area),
        false => {
            let lines = wrapped("make the window larger to see the code of the live page", usize::from(body.width));
            frame.render_widget(Paragraph::new(lines.join("\n")), body);
        }
    }
}

fn dim() -> Style {
    Style::new().fg(Color::DarkGray)
}

/// The table and the rule below it; `kept` lines stay free if possible. Gives the area that is left.
fn draw_vehicles(
    frame: &mut Frame<'_>,
    area: Rect,
    rows: &[Row],
    columns: &[Column],
    (hidden_columns, kept): (usize, u16),
) -> Rect {
    let height = u16::try_from(rows.len()).unwrap_or(u16::MAX).saturating_add(1);
    let room = area.height.saturating_sub(1 + kept).max(2);
    let [table, rule, rest] =
        Layout::vertical([Constraint::Length(height.min(room)), Constraint::Length(1), Constraint::Min(0)]).areas(area);
    frame.render_widget(vehicles(rows, columns, table.width), table);
    let hidden_rows = rows.len().saturating_sub(usize::from(table.height.saturating_sub(1)));
    frame.render_widget(divider(rule, hidden_rows, hidden_columns), rule);
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

/// The swarm's name and the stage, and between them as much about the vehicles as fits.
fn headline(status: &FlightStatus, width: usize) -> Line<'static> {
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let vehicles = match status.teams.len() {
        0 => format!("{} vehicles", status.rows.len()),
        teams => format!("{} vehicles in {teams} teams", status.rows.len()),
    };
    let stage = stage(status);
    let room = width.saturating_sub(stage.chars().count());
    let between = [format!("  {vehicles}, {}  ", status.plant), format!("  {vehicles}  "), "  ".to_owned()];
    let name = status.swarm.chars().count();
    let between = between.into_iter().find(|between| name + between.chars().count() <= room);
    match between {
        Some(between) => {
            Line::from(vec![Span::styled(status.swarm.clone(), bold), Span::raw(between), Span::styled(stage, bold)])
        }
        // The stage is of more use than a name that is cut off.
        None => Line::styled(shortened(&stage, width), bold),
    }
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
        let cells = columns.iter().map(|column| cell(column, column.cell(row)));
        TableRow::new(cells).style(if row.bad { Style::new().fg(Color::Red) } else { Style::new() })
    };
    let titles = columns.iter().map(|column| cell(column, column.title.to_owned()));
    let header = TableRow::new(titles).style(Style::new().add_modifier(Modifier::UNDERLINED));
    let gaps = columns.len().saturating_sub(1).max(1);
    let spare = usize::from(width).saturating_sub(needed(columns));
    let widths = columns.iter().map(|column| Constraint::Length(column.width));
    let spacing = u16::try_from(1 + spare / gaps).unwrap_or(MAX_SPACING).min(MAX_SPACING);
    Table::new(rows.iter().map(row), widths).header(header).column_spacing(spacing)
}

/// A line or more for each column: what it shows, its unit, and which values are bad. In a narrow window the text is below the
/// heading.
fn legend(columns: &[Column], width: usize) -> Vec<Line<'static>> {
    let beside = columns.iter().map(|column| column.title.chars().count()).max().unwrap_or(0) + 2;
    let (indent, is_beside) = if width >= beside + TEXT_BESIDE { (beside, true) } else { (2, false) };
    let mut lines = Vec::new();
    for column in columns {
        let mut title = column.title;
        if !is_beside {
            lines.push(Line::raw(std::mem::take(&mut title)));
        }
        let room = width.saturating_sub(indent).max(1);
        for line in wrapped(column.about, room) {
            let line = shortened(&line, room);
            lines.push(Line::raw(format!("{:<indent$}{line}", std::mem::take(&mut title))));
        }
    }
    lines
}

/// A horizontal rule with the number of rows and columns that did not fit.
fn divider(area: Rect, rows: usize, columns: usize) -> Paragraph<'static> {
    let width = usize::from(area.width);
    let columns_text = if columns == 1 { "1 column".to_owned() } else { format!("{columns} columns") };
    let notes = match (rows, columns) {
        (0, 0) => vec![],
        (_, 0) => vec![format!(" {rows} more, make the window taller "), format!(" {rows} more ")],
        (0, _) => vec![format!(" {columns_text} hidden, make the window wider "), format!(" {columns_text} hidden ")],
        (..) => vec![
            format!(" {rows} more and {columns_text} hidden, make the window larger "),
            format!(" {rows} more, {columns_text} hidden "),
            format!(" {rows} more "),
        ],
    };
    let note = notes.into_iter().find(|note| note.chars().count() <= width).unwrap_or_default();
    let rule = "─".repeat(width.saturating_sub(note.chars().count()));
    Paragraph::new(note + &rule).style(dim())
}

/// The keys that can be pressed, and where the files are if there is room.
fn keys(status: &FlightStatus, has_code: bool, width: usize) -> String {
    let stop = match status.stage {
        Stage::Gathering | Stage::Flying => "q: land and end",
        Stage::Landing => "q: end at once, in the air",
        Stage::Ending => "q: end at once",
        Stage::Watched => "q: end the view, the swarm flies on",
    };
    let code = if has_code { "   p: page on a phone" } else { "" };
    let keys = format!("Ctrl-C or {stop}   ?: what the columns mean{code}");
    let mut lines = match status.out.rsplit_once('/').map_or(status.out.as_str(), |(_, folder)| folder) {
        "" => Vec::new(),
        folder => vec![format!("{keys}   files: {}", status.out), format!("{keys}   files: …/{folder}")],
    };
    lines.extend([keys, format!("{stop}   ?: columns{code}"), format!("{stop}   ?: columns"), stop.to_owned()]);
    let fits = lines.into_iter().find(|line| line.chars().count() <= width);
    fits.unwrap_or_else(|| shortened(stop, width))
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use skein_common::id::VehicleId;
    use skein_common::message::{FactValues, PeerContact, ProcessFigures, VehicleFacts};
    use skein_common::state::PeerStatus;

    use super::*;

    fn facts(age_ms: u32, step_p99_us: f64) -> FactValues {
        let process = ProcessFigures { frame_rate_hz: 50.0, step_p99_us, ..ProcessFigures::default() };
        let peer = PeerContact { id: VehicleId::new(9).unwrap(), age_ms, standing: PeerStatus::Fresh };
        FactValues::of(&VehicleFacts { process: Some(process), peers: vec![peer], ..VehicleFacts::default() })
    }

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
            facts: facts(187, 84.2),
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
        drawn_as(status, width, height, Shown::Flight, None)
    }

    fn drawn_as(status: &FlightStatus, width: u16, height: u16, shown: Shown, code: Option<&str>) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, status, shown, code)).unwrap();
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
        let lines = drawn_as(&status, 80, 24, Shown::Columns, None);
        assert!(lines[2].starts_with("What the columns mean"), "{lines:#?}");
        for column in set(false) {
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
    fn a_key_shows_the_code_of_the_live_page_where_it_fits() {
        let status = status(vec![row(1)]);
        let code = "██████\n█ ▄▄ █\n██████";
        let lines = drawn_as(&status, 80, 12, Shown::Code, Some(code));
        assert_eq!(lines[2..5], code.lines().collect::<Vec<_>>());
        assert_eq!(lines[11], "p or Esc: back to the flight");
        let small = drawn_as(&status, 80, 5, Shown::Code, Some(code));
        assert_eq!(small[2], "make the window larger to see the code of the live page");
        let flight = drawn_as(&status, 120, 12, Shown::Flight, Some(code));
        assert!(flight[11].contains("p: page on a phone"), "{flight:#?}");
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
            for shown in [Shown::Columns, Shown::Code] {
                drawn_as(&status(vec![row(1), row(2)]), width, height, shown, Some("█▀▄ █"));
            }
        }
    }

    /// The columns of which a line has the headings, and nothing else.
    fn columns_of(header: &str, set: &[Column]) -> Vec<Column> {
        let mut words = header.split_whitespace().peekable();
        let is_next = |column: &&Column| {
            let mut ahead = words.clone();
            let is_there = column.title.split_whitespace().all(|word| ahead.next() == Some(word));
            if is_there {
                words = ahead;
            }
            is_there
        };
        let found = set.iter().filter(is_next).copied().collect();
        assert_eq!(words.next(), None, "no other heading and no part of one: {header}");
        found
    }

    #[test]
    fn every_width_shows_whole_headings_and_numbers_and_leaves_out_the_least_important_columns() {
        let far = Row {
            name: "12/16".to_owned(),
            phase: "9/16 in formation".to_owned(),
            altitude_m: Some(-12_345.67),
            from_centre_m: Some(1_234_567.8),
            gap_deg: Some((359.96, -123.4)),
            nearest_m: Some(123_456.7),
            facts: facts(12_345_678, 123_456_789.0),
            late_dropped: Some((1_234_567, 7_654_321)),
            ..row(3)
        };
        for rows in [vec![row(1), row(2)], vec![row(1), far]] {
            let status = status(rows.clone());
            let mut shown = 0;
            for width in 20..=200 {
                let lines = drawn(&status, width, 14);
                let at = lines.iter().position(|line| line.contains("phase") || line.trim() == "id");
                let table: Vec<String> = lines[at.unwrap()..][..3]
                    .iter()
                    .map(|line| line.split('│').next().unwrap_or_default().to_owned())
                    .collect();
                let set = set(table[0].starts_with("vehicle"));
                let columns = columns_of(&table[0], &set);
                for (row, line) in rows.iter().zip(&table[1..]) {
                    let cells: Vec<String> = columns.iter().map(|column| column.cell(row)).collect();
                    let words = line.split_whitespace().collect::<Vec<_>>().join(" ");
                    assert_eq!(words, cells.join(" "), "{width} columns: {lines:#?}");
                }
                let ranks: Vec<u8> = columns.iter().map(|column| column.rank).collect();
                let rest = set.iter().map(|column| column.rank).filter(|rank| !ranks.contains(rank));
                assert!(
                    rest.min().is_none_or(|least| Some(least) > ranks.iter().max().copied()),
                    "{width}: {lines:#?}"
                );
                assert!(columns.len() >= shown, "{width} columns: {lines:#?}");
                shown = columns.len();
                assert!(lines[0].ends_with("01:23 of 06:40"), "{width} columns: {lines:#?}");
                let summary = status.summary(1000);
                assert!(summary.split(", ").collect::<Vec<_>>().starts_with(&lines[1].split(", ").collect::<Vec<_>>()));
                assert!(lines[13].starts_with("q: land and end") || lines[13].starts_with("Ctrl-C or q: land and end"));
            }
            assert_eq!(shown, set(true).len(), "a wide window has room for all");
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
        assert!(keys(&status, false, 80).contains("in the air"));
    }
}
