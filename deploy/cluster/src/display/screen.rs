//! The display of a flight: a table on a terminal, lines elsewhere.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use ratatui::DefaultTerminal;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::crossterm::terminal;
use ratatui::style::{Color, Modifier};
use skein_lab::terminal::{obeys_escapes, wants_colours};

use super::status::FlightStatus;
use super::table::{self, Shown};

/// Between two pictures of the table.
const PICTURE: Duration = Duration::from_millis(200);
/// Between two lines of figures.
const LINE: Duration = Duration::from_secs(10);

/// Width of text that does not go to a terminal, columns.
const COLUMNS: usize = 100;
/// Narrowest width that text is wrapped to, columns: a narrower terminal breaks the lines itself.
const LEAST_COLUMNS: usize = 40;

/// The width in columns of the terminal that standard output goes to; 100 if it goes elsewhere.
pub fn columns() -> usize {
    let terminal = io::stdout().is_terminal().then(terminal::size).and_then(Result::ok);
    terminal.map_or(COLUMNS, |(columns, _)| usize::from(columns).max(LEAST_COLUMNS))
}

/// Shows a flight; gives the terminal back when it goes.
#[derive(Debug)]
pub struct Screen {
    face: Face,
    next: Option<Instant>,
    shown: Shown,
    /// The QR code of the live page's address, which a key shows, if a phone can open it.
    pub code: Option<String>,
}

#[derive(Debug)]
enum Face {
    Table(DefaultTerminal),
    Lines {
        /// stdout is for the result.
        on_stderr: bool,
    },
}

impl Screen {
    /// A table if stdout is a terminal that obeys escape sequences and is not needed for the result, else lines.
    pub fn open(result_on_stdout: bool) -> Self {
        let terminal = (!result_on_stdout && obeys_escapes(&io::stdout())).then(ratatui::try_init);
        let face = match terminal {
            Some(Ok(terminal)) => Face::Table(terminal),
            _ => Face::Lines { on_stderr: result_on_stdout },
        };
        Self { face, next: None, shown: Shown::Flight, code: None }
    }

    /// Whether it is time for [`Self::show`], if lines about events wait or not.
    pub fn is_due(&self, now: Instant, has_news: bool) -> bool {
        let has_news = has_news && matches!(self.face, Face::Lines { .. });
        has_news || self.next.is_none_or(|next| now >= next)
    }

    /// Shows the state of the flight; without a table the `news`, and now and then the figures. Output errors are ignored:
    /// the terminal may be closed.
    pub fn show(&mut self, status: &FlightStatus, news: &[String], now: Instant) {
        match &mut self.face {
            Face::Table(terminal) => {
                self.next = Some(now + PICTURE);
                let _ = terminal.draw(|frame| {
                    table::draw(frame, status, self.shown, self.code.as_deref());
                    if !wants_colours() {
                        without_colours(frame.buffer_mut());
                    }
                });
            }
            Face::Lines { on_stderr } => {
                news.iter().for_each(|line| say(*on_stderr, line));
                if self.next.is_none_or(|next| now >= next) {
                    self.next = Some(now + LINE);
                    say(*on_stderr, &line(status));
                }
            }
        }
    }

    /// Number of times that Ctrl-C or q was pressed since the last call: a terminal that shows a table hands out keys, not signals.
    /// Other keys show and hide the explanation of the columns and the code of the live page.
    pub fn asked_to_end(&mut self) -> u32 {
        let mut count = 0;
        while matches!(self.face, Face::Table(_)) && event::poll(Duration::ZERO).unwrap_or(false) {
            match event::read() {
                Ok(Event::Key(key)) if key.kind != KeyEventKind::Release => {
                    let control = key.modifiers.contains(KeyModifiers::CONTROL);
                    match key.code {
                        KeyCode::Char('q') => count += 1,
                        KeyCode::Char('c') if control => count += 1,
                        KeyCode::Char('?' | 'h') => self.toggle(Shown::Columns),
                        KeyCode::Char('p') => self.toggle(Shown::Code),
                        KeyCode::Esc => self.toggle(self.shown),
                        _ => {}
                    }
                }
                Ok(_) => {}
                Err(_) => break,
            }
        }
        count
    }

    fn toggle(&mut self, what: Shown) {
        self.shown = if self.shown == what { Shown::Flight } else { what };
        self.next = None;
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        if matches!(self.face, Face::Table(_)) {
            ratatui::restore();
        }
    }
}

/// Takes the colours out of a picture: what was red is bold.
fn without_colours(picture: &mut Buffer) {
    for cell in &mut picture.content {
        if cell.fg == Color::Red {
            cell.modifier |= Modifier::BOLD;
        }
        (cell.fg, cell.bg) = (Color::Reset, Color::Reset);
    }
}

/// Writes a line for people.
pub fn say(on_stderr: bool, line: &str) {
    if on_stderr { skein_lab::terminal::complain(line) } else { skein_lab::terminal::say(&format!("{line}\n")) }
}

/// The stage of the flight and the summary of the swarm, in one line.
fn line(status: &FlightStatus) -> String {
    format!("{}: {}", table::stage(status), status.summary(usize::MAX))
}

#[cfg(test)]
mod tests {
    use ratatui::layout::Rect;
    use ratatui::style::Style;

    use super::*;

    #[test]
    fn a_picture_without_colours_shows_in_bold_what_was_red() {
        let mut picture = Buffer::empty(Rect::new(0, 0, 3, 1));
        picture.set_string(0, 0, "a", Style::new().fg(Color::Red));
        picture.set_string(1, 0, "b", Style::new().fg(Color::White).bg(Color::Black));
        without_colours(&mut picture);
        assert!(picture.content.iter().all(|cell| (cell.fg, cell.bg) == (Color::Reset, Color::Reset)));
        let is_bold: Vec<bool> = picture.content.iter().map(|cell| cell.modifier.contains(Modifier::BOLD)).collect();
        assert_eq!(is_bold, [true, false, false]);
    }
}
