//! Log lines to standard error by way of a thread of their own: a terminal that was stopped or a pipe that nobody reads
//! delays nobody else, least of all the control thread.

use std::io::{self, Write};
use std::sync::mpsc::{self, Sender, SyncSender};
use std::thread;
use std::time::Duration;

use skein_common::printable::printable;
use tracing_subscriber::EnvFilter;

/// Lines that may wait; what is beyond is lost.
const QUEUE: usize = 1024;
/// A longer line is cut, characters.
const MAX_LINE: usize = 4000;
/// At the end of the process the last lines get this long.
const FLUSH_WITHIN: Duration = Duration::from_millis(500);

/// What we say ourselves and what others warn of. Zenoh warns of every session without gossip and of every peer that is
/// not there yet; who comes, goes and is refused we tell ourselves.
const FILTER: &str = "warn,skein_agent=info,zenoh=error";

/// While it lives, lines are written; when dropped, the last ones were.
pub(super) struct Log(SyncSender<Item>);

enum Item {
    Line(Vec<u8>),
    Flush(Sender<()>),
}

/// Starts to log what `RUST_LOG` says, or else [`FILTER`]. Where the process logs already, that stays.
pub(super) fn start() -> Log {
    let (sender, queue) = mpsc::sync_channel(QUEUE);
    thread::spawn(move || {
        for item in queue {
            match item {
                // A reader that is gone is no reason to end.
                Item::Line(line) => drop(io::stderr().write_all(&line)),
                Item::Flush(done) => drop(done.send(())),
            }
        }
    });
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(FILTER));
    let lines = sender.clone();
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_target(false)
        // Colours are escape sequences, and none is let through.
        .with_ansi(false)
        .with_writer(move || Lines(lines.clone()));
    let _ = subscriber.try_init();
    Log(sender)
}

impl Drop for Log {
    fn drop(&mut self) {
        let (done, is_done) = mpsc::channel();
        if self.0.try_send(Item::Flush(done)).is_ok() {
            let _ = is_done.recv_timeout(FLUSH_WITHIN);
        }
    }
}

/// An event as a line: what peers, laws and simulators have put into it can neither end the line nor reach the terminal as
/// anything but text.
fn line(event: &[u8]) -> Vec<u8> {
    let text = String::from_utf8_lossy(event);
    (printable(text.trim_end_matches('\n'), MAX_LINE) + "\n").into_bytes()
}

struct Lines(SyncSender<Item>);

impl Write for Lines {
    /// Takes one event at a time, whole.
    fn write(&mut self, event: &[u8]) -> io::Result<usize> {
        let _ = self.0.try_send(Item::Line(line(event)));
        Ok(event.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_law_or_a_peer_writes_stays_one_line_of_text() {
        let (sender, queue) = mpsc::sync_channel(QUEUE);
        let subscriber = tracing_subscriber::fmt()
            .without_time()
            .with_target(false)
            .with_ansi(false)
            .with_writer(move || Lines(sender.clone()))
            .finish();
        let line = "ready\u{1b}[2J\r\nINFO vehicle 2 landed \u{202e}txt";
        tracing::subscriber::with_default(subscriber, || tracing::warn!("vehicle 3's law: {line}"));
        let Ok(Item::Line(written)) = queue.recv() else { panic!("a line") };
        let shown = " WARN vehicle 3's law: ready\\x1b[2J\\u000d\\u000aINFO vehicle 2 landed \\u202etxt\n";
        assert_eq!(String::from_utf8_lossy(&written), shown);
        assert!(queue.try_recv().is_err(), "one line");
    }
}
