//! Compares a host's clock with this PC's, over one ssh channel: the host is asked for its time and answers at once.

use std::io::{BufRead, BufReader, Write};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Duration;

use skein_common::message::ClockOffset;

use crate::inventory::{Node, System};
use crate::protocol::Ask;
use crate::remote::Remote;
use crate::ssh::{Host, Ssh};
use skein_host::clock::{self, Utc};

/// Number of exchanges; the one with the shortest round trip is used.
const EXCHANGES: usize = 8;
/// Time limit of all exchanges.
const WITHIN: Duration = Duration::from_secs(5);
/// Command that answers each line with the time, available on every Linux.
const ANSWERS: &str = "sh -c 'while read x; do date +%s.%N; done'";

/// The offset as a person would say it, with its bound while that matters.
pub(super) fn to_text(ClockOffset { offset_s, bound_s }: ClockOffset) -> String {
    let (sign, size_s) = (if offset_s < 0.0 { '-' } else { '+' }, offset_s.abs());
    let whole = size_s.round() as u64;
    let (days, hours, minutes, seconds) = (whole / 86_400, whole / 3600 % 24, whole / 60 % 60, whole % 60);
    match (size_s < 1.0, size_s < 59.95, days, hours) {
        (true, ..) => format!("{sign}{:.1} ±{:.1} ms", size_s * 1e3, bound_s * 1e3),
        (false, true, ..) => format!("{sign}{size_s:.1} s"),
        (_, _, 0, 0) => format!("{sign}{minutes} min {seconds} s"),
        (_, _, 0, _) => format!("{sign}{hours} h {minutes} min"),
        _ => format!("{sign}{days} d {hours} h"),
    }
}

/// The dialogue that asks a host for its time: the command, and what it reads before the first question.
pub(super) struct Dialogue {
    command: String,
    first: Arc<[u8]>,
}

impl Dialogue {
    /// That with the node's host; on Windows its program has to be installed.
    pub(super) fn with(remote: &Remote<'_>, node: &Node) -> Self {
        match node.system {
            System::Unix => Self { command: ANSWERS.to_owned(), first: Arc::default() },
            System::Windows => Self { command: remote.installed(node), first: remote.request(node, Ask::Clock) },
        }
    }
}

/// Measures how far a host's clock is ahead of this PC's. The bound of the error is half of the round trip, because it is unknown
/// when within it the clock was read.
pub(super) fn measure(ssh: &Ssh, host: &Host, dialogue: &Dialogue) -> Result<ClockOffset, String> {
    let (mut child, marks) = ssh.spawn(host, &dialogue.command)?;
    let first = dialogue.first.clone();
    let pipes = child.stdin.take().zip(child.stdout.take());
    let (sender, received) = mpsc::channel();
    if let Some((mut ask, answer)) = pipes {
        thread::spawn(move || {
            let utc = Utc::read();
            // If this fails, so does the first question.
            let _ = ask.write_all(&first);
            let mut answers = BufReader::new(answer);
            let mut answers = marks.skip(&mut answers).then(|| answers.lines()).into_iter().flatten();
            let exchanges = (0..EXCHANGES).map_while(|_| {
                let asked = clock::now();
                ask.write_all(b"\n").ok()?;
                let theirs = answers.next()?.ok()?;
                let answered = clock::now();
                Some(offset(utc.nanoseconds(asked), &theirs, utc.nanoseconds(answered)))
            });
            let _ = sender.send(exchanges.collect::<Option<Vec<ClockOffset>>>());
        });
    }
    let exchanges = received.recv_timeout(WITHIN);
    // The command ends with its input, but a host that hangs does not.
    let _ = child.kill();
    let _ = child.wait();
    let best = exchanges.ok().flatten().unwrap_or_default().into_iter().min_by(|a, b| a.bound_s.total_cmp(&b.bound_s));
    best.ok_or_else(|| format!("{host}: did not report its time (`date +%s.%N`)"))
}

/// Offset from one exchange: the question and the answer by this PC's clock, ns since 1970, and the host's time in
/// between.
fn offset(asked_ns: u64, theirs: &str, answered_ns: u64) -> Option<ClockOffset> {
    let (seconds, fraction) = theirs.trim().split_once('.')?;
    let nanoseconds: u64 = fraction.parse().ok().filter(|_| fraction.len() == 9)?;
    let theirs_ns = seconds.parse::<u64>().ok()?.checked_mul(1_000_000_000)?.checked_add(nanoseconds)?;
    let bound_s = answered_ns.checked_sub(asked_ns)? as f64 / 2.0 * 1e-9;
    // Subtract the integers, because the times as floating-point numbers would be inexact.
    let since_asked_s = (i128::from(theirs_ns) - i128::from(asked_ns)) as f64 * 1e-9;
    Some(ClockOffset { offset_s: since_asked_s - bound_s, bound_s })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offset_has_the_units_that_a_person_uses() {
        let text = |offset_s: f64| to_text(ClockOffset { offset_s, bound_s: 0.0005 });
        assert_eq!(text(0.0003), "+0.3 ±0.5 ms");
        assert_eq!(text(-0.25), "-250.0 ±0.5 ms");
        assert_eq!(text(2.51), "+2.5 s");
        assert_eq!(text(90.0), "+1 min 30 s");
        assert_eq!(text(-7_199.999_7), "-2 h 0 min");
        assert_eq!(text(59.97), "+1 min 0 s");
        assert_eq!(text(200_000.0), "+2 d 7 h");
    }

    #[test]
    fn the_offset_is_measured_at_the_middle_of_an_exchange() {
        let asked_ns = 1_795_248_902_000_000_000;
        let read = |theirs: &str| offset(asked_ns, theirs, asked_ns + 4_000_000);
        let near = |offset: Option<ClockOffset>, wanted_s: f64| {
            let ClockOffset { offset_s, bound_s } = offset.unwrap();
            assert!((offset_s - wanted_s).abs() < 1e-9 && (bound_s - 0.002).abs() < 1e-12, "{offset_s} {bound_s}");
        };
        near(read("1795248902.002000000"), 0.0);
        near(read("1795248902.252000000\r"), 0.25);
        near(read("1795248842.002000000"), -60.0);
        for bad in ["", "1795248902", "1795248902.N", "1795248902.25", "x.000000000"] {
            assert_eq!(read(bad), None, "{bad:?}");
        }
    }
}
