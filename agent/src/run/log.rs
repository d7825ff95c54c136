//! Writes log lines to standard error from a thread of its own, so that a stopped terminal or an unread pipe never
//! delays the control thread.

use std::io::{self, Write};
use std::sync::mpsc::{self, Sender, SyncSender};
use std::thread;
use std::time::Duration;

use skein_common::printable::printable;
use tracing_subscriber::EnvFilter;

/// Number of lines that may wait; further lines are dropped.
const QUEUE: usize = 1024;
/// Longest line, characters; the rest is cut.
const MAX_LINE: usize = 4000;
/// Time to write the last lines when the process ends.
const FLUSH_TIMEOUT: Duration = Duration::from_millis(500);

/// Default log levels. Zenoh's warnings are suppressed: it warns of every session without gossip and of every peer that
/// is not up yet, and the agent itself logs which peers appear, vanish and are refused.
const FILTER: &str = "warn,skein_agent=info,zenoh=error";

/// Writes the log while it exists; dropping it writes the lines that still wait.
pub(super) struct Log(SyncSender<Item>);

enum Item {
    Line(Vec<u8>),
    Flush(Sender<()>),
}

/// Starts logging at the levels in `RUST_LOG`, or else [`FILTER`]. A subscriber that is already installed is kept.
pub(super) fn start() -> Log {
    let (sender, queue) = mpsc::sync_channel(QUEUE);
    thread::spawn(move || {
        for item in queue {
            match item {
                // Logging must not end because standard error was closed.
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
        // Colours are escape sequences, and the log lets none through.
        .with_ansi(false)
        .with_writer(move || Lines(lines.clone()));
    let _ = subscriber.try_init();
    Log(sender)
}

impl Drop for Log {
    fn drop(&mut self) {
        let (done, is_done) = mpsc::channel();
        if self.0.try_send(Item::Flush(done)).is_ok() {
            let _ = is_done.recv_timeout(FLUSH_TIMEOUT);
        }
    }
}

/// Makes one printable line of a log event: text from peers, laws and simulators can neither break the line nor send
/// control characters to the terminal.
fn line(event: &[u8]) -> Vec<u8> {
    let text = String::from_utf8_lossy(event);
    (printable(text.trim_end_matches('\n'), MAX_LINE) + "\n").into_bytes()
}

struct Lines(SyncSender<Item>);

impl Write for Lines {
    /// Queues one whole event per call.
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
    fn text_of_a_law_or_a_peer_stays_one_printable_line() {
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
