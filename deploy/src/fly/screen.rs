//! Where a flight is shown: a table on a terminal, lines elsewhere.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};

use super::status::{Row, Status};
use super::table;

/// Between two pictures of the table.
const PICTURE: Duration = Duration::from_millis(200);
/// Between two lines of figures.
const LINE: Duration = Duration::from_secs(10);

/// Shows a flight; gives the terminal back when it goes.
#[derive(Debug)]
pub struct Screen {
    face: Face,
    next: Option<Instant>,
}

#[derive(Debug)]
enum Face {
    Table(DefaultTerminal),
    Lines {
        /// stdout is for the result.
        on_stderr: bool,
        /// Events already written.
        written: usize,
    },
}

impl Screen {
    /// A table if stdout is a terminal and is not needed for the result, else lines.
    pub fn open(result_on_stdout: bool) -> Self {
        let terminal = (!result_on_stdout && io::stdout().is_terminal()).then(ratatui::try_init);
        let face = match terminal {
            Some(Ok(terminal)) => Face::Table(terminal),
            _ => Face::Lines { on_stderr: result_on_stdout, written: 0 },
        };
        Self { face, next: None }
    }

    /// Whether it is time for [`Self::show`], if so many events have happened so far.
    pub fn is_due(&self, now: Instant, events: usize) -> bool {
        let has_news = matches!(self.face, Face::Lines { written, .. } if written < events);
        has_news || self.next.is_none_or(|next| now >= next)
    }

    /// Shows the flight as it is. What cannot be shown is not: nobody may be looking any more.
    pub fn show(&mut self, status: &Status, now: Instant) {
        match &mut self.face {
            Face::Table(terminal) => {
                self.next = Some(now + PICTURE);
                let _ = terminal.draw(|frame| table::draw(frame, status));
            }
            Face::Lines { on_stderr, written } => {
                for event in &status.events[(*written).min(status.events.len())..] {
                    say(*on_stderr, event);
                }
                *written = status.events.len();
                if self.next.is_none_or(|next| now >= next) {
                    self.next = Some(now + LINE);
                    say(*on_stderr, &line(status));
                }
            }
        }
    }

    /// How often Ctrl-C or q was pressed since the last call: a terminal that shows a table hands out keys, not signals.
    pub fn asked_to_end(&self) -> u32 {
        let mut count = 0;
        while matches!(self.face, Face::Table(_)) && event::poll(Duration::ZERO).unwrap_or(false) {
            match event::read() {
                Ok(Event::Key(key)) if key.kind != KeyEventKind::Release => {
                    let control = key.modifiers.contains(KeyModifiers::CONTROL);
                    count += u32::from(key.code == KeyCode::Char('q') || (control && key.code == KeyCode::Char('c')));
                }
                Ok(_) => {}
                Err(_) => break,
            }
        }
        count
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        if matches!(self.face, Face::Table(_)) {
            ratatui::restore();
        }
    }
}

fn say(on_stderr: bool, line: &str) {
    if on_stderr { skein_lab::terminal::complain(line) } else { skein_lab::terminal::say(&format!("{line}\n")) }
}

/// The essential figures in one line.
fn line(status: &Status) -> String {
    let values = |of: fn(&Row) -> Option<f64>| status.rows.iter().filter_map(of);
    let span = |name: &str, of: fn(&Row) -> Option<f64>, unit: &str| {
        let (least, most) = (values(of).reduce(f64::min)?, values(of).reduce(f64::max)?);
        Some(format!(", {name} {least:.1} to {most:.1} {unit}"))
    };
    let parts = [
        span("altitude", |row| row.altitude_m, "m"),
        span("from centre", |row| row.from_centre_m, "m"),
        values(|row| row.gap_deg.map(|(_, excess)| excess.abs()))
            .reduce(f64::max)
            .map(|off| format!(", gaps {off:.1}° off")),
        values(|row| row.nearest_m).reduce(f64::min).map(|nearest| format!(", nearest {nearest:.1} m")),
        values(|row| row.step_p99_us).reduce(f64::max).map(|step| format!(", step p99 {step:.0} µs")),
    ];
    let heard = status.rows.iter().filter(|row| row.altitude_m.is_some()).count();
    let figures: String = parts.into_iter().flatten().collect();
    format!("{}: {heard} of {} vehicles{figures}", table::stage(status), status.rows.len())
}

#[cfg(test)]
mod tests {
    use skein_common::id::VehicleId;

    use super::*;
    use crate::fly::status::Stage;

    #[test]
    fn a_line_has_the_essential_figures() {
        let row = |id, altitude_m: Option<f64>| Row {
            id: VehicleId::new(id).unwrap(),
            phase: String::new(),
            bad: false,
            altitude_m,
            step: altitude_m.map(|_| 0),
            from_centre_m: altitude_m.map(|_| 100.0 + f64::from(id)),
            gap_deg: altitude_m.map(|_| (90.0, -1.5)),
            nearest_m: altitude_m.map(|_| 141.0),
            frame_rate_hz: None,
            peer_age_ms: None,
            step_p99_us: altitude_m.map(|_| 80.0),
            late_dropped: None,
        };
        let mut status = Status {
            swarm: "hover".to_owned(),
            plant: "builtin".to_owned(),
            stage: Stage::Flying,
            flown_s: 10.0,
            duration_s: None,
            out: String::new(),
            rows: vec![row(1, Some(29.5)), row(2, Some(30.0)), row(3, None)],
            events: Vec::new(),
        };
        let expected = "00:10: 2 of 3 vehicles, altitude 29.5 to 30.0 m, from centre 101.0 to 102.0 m, gaps 1.5° off, \
                        nearest 141.0 m, step p99 80 µs";
        assert_eq!(line(&status), expected);
        status.rows = vec![row(1, None)];
        assert_eq!(line(&status), "00:10: 0 of 1 vehicles");
    }
}
