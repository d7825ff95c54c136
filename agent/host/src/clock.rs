//! Clocks of a running process. No other place of the workspace reads a clock; the core gets the time as an argument.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use skein_common::id::Incarnation;
use skein_common::time::LocalTime;
use time::OffsetDateTime;

/// Monotonic clock of this process.
#[derive(Clone, Copy, Debug)]
pub struct LocalClock {
    zero: Instant,
}

impl LocalClock {
    /// Starts a clock at zero.
    pub fn start() -> Self {
        Self::zero_at(now())
    }

    /// A clock that reads zero at this instant.
    pub fn zero_at(zero: Instant) -> Self {
        Self { zero }
    }

    /// Current time of this clock.
    pub fn now(&self) -> LocalTime {
        self.at(now())
    }

    /// Time of this clock at an instant.
    pub fn at(&self, instant: Instant) -> LocalTime {
        LocalTime::from_nanoseconds(nanoseconds(instant.saturating_duration_since(self.zero)))
    }
}

/// Reads the system's monotonic clock.
#[expect(clippy::disallowed_methods, reason = "an edge: deadlines and arrival times")]
pub fn now() -> Instant {
    Instant::now()
}

/// Blocks this thread until the instant.
#[expect(clippy::disallowed_methods, reason = "an edge: a thread of its own that waits for its time")]
pub fn sleep_until(instant: Instant) {
    thread::sleep(instant.saturating_duration_since(now()));
}

/// Incarnation number of an agent that starts now, larger than that of an earlier start.
pub fn new_incarnation() -> Incarnation {
    Incarnation(utc_nanoseconds())
}

/// Incarnation number of an agent that starts now, larger than the last one even if the clock was set back. The last
/// number is read from `file`, and the new one is saved there. The second value describes why it could not be saved.
pub fn next_incarnation(file: &Path) -> (Incarnation, Option<String>) {
    let new = incarnation_after(fs::read_to_string(file).ok().as_deref(), new_incarnation());
    let fault = overwrite(file, &incarnation_text(new)).err();
    (new, fault.map(|fault| format!("{}: {fault}", file.display())))
}

/// The incarnation number of an agent that starts when a new one would have the number `new`. `kept` is the text that the
/// last agent has kept, if it can be read: the number is larger than that one.
pub fn incarnation_after(kept: Option<&str>, new: Incarnation) -> Incarnation {
    let last = kept.and_then(|text| text.trim().parse::<u64>().ok());
    last.map_or(new, |last| new.max(Incarnation(last.saturating_add(1))))
}

/// The text that an agent keeps of its incarnation number. Every number has the same length.
pub fn incarnation_text(incarnation: Incarnation) -> String {
    format!("{:020}\n", incarnation.0)
}

/// Writes over the content of a file. A file that has this length already needs no room on the disk: on a full disk, a file
/// that is emptied first would remain empty, and the number in it would be lost.
fn overwrite(file: &Path, text: &str) -> io::Result<()> {
    let mut file = File::options().write(true).create(true).truncate(false).open(file)?;
    file.write_all(text.as_bytes())?;
    file.set_len(text.len() as u64)
}

/// UTC by the system's clock, ns since 1970. Other hosts' clocks differ, and nothing in flight relies on it.
#[expect(clippy::disallowed_methods, reason = "an edge: new lives, and how far clocks are apart")]
pub fn utc_nanoseconds() -> u64 {
    nanoseconds(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

/// Blocks this thread for a duration.
pub fn sleep(duration: Duration) {
    sleep_until(now() + duration);
}

/// Converts instants to UTC, ns since 1970. UTC is read once and then advances with the monotonic clock, so that
/// setting the system's clock never changes the order of two instants.
#[derive(Clone, Copy, Debug)]
pub struct Utc {
    at: Instant,
    unix_ns: u64,
}

impl Utc {
    /// Reads UTC now.
    pub fn read() -> Self {
        Self { at: now(), unix_ns: utc_nanoseconds() }
    }

    /// UTC of an instant, ns since 1970.
    pub fn nanoseconds(&self, at: Instant) -> u64 {
        match at.checked_duration_since(self.at) {
            Some(since) => self.unix_ns.saturating_add(nanoseconds(since)),
            None => self.unix_ns.saturating_sub(nanoseconds(self.at.duration_since(at))),
        }
    }
}

/// Current UTC to the second, as in certificates.
pub fn utc() -> OffsetDateTime {
    let now = utc_now();
    now.replace_nanosecond(0).unwrap_or(now)
}

fn utc_now() -> OffsetDateTime {
    // Nanoseconds since 1970 in 64 bits end in 2554.
    OffsetDateTime::from_unix_timestamp_nanos(utc_nanoseconds().into()).unwrap_or(OffsetDateTime::UNIX_EPOCH)
}

/// Current UTC as part of a file name, `20261121T081502Z`: it sorts by time and has no colon.
pub fn utc_name() -> String {
    name_of(utc())
}

/// Current UTC for the start of a log line, `2026-11-21T08:15:02.123456Z`.
pub fn utc_stamp() -> String {
    let utc = utc_now();
    let (hour, minute, second, us) = (utc.hour(), utc.minute(), utc.second(), utc.microsecond());
    format!("{}T{hour:02}:{minute:02}:{second:02}.{us:06}Z", utc.date())
}

fn name_of(utc: OffsetDateTime) -> String {
    let (year, month, day) = (utc.year(), u8::from(utc.month()), utc.day());
    format!("{year:04}{month:02}{day:02}T{:02}{:02}{:02}Z", utc.hour(), utc.minute(), utc.second())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_incarnation_is_larger_than_the_last_whatever_the_clock() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("life");
        let now = utc_nanoseconds();
        let (first, fault) = next_incarnation(&file);
        assert!(first >= Incarnation(now) && fault.is_none(), "{first:?}, {fault:?}");
        // The clock was an hour fast at the last start.
        let ahead = utc_nanoseconds() + 3_600_000_000_000;
        fs::write(&file, ahead.to_string()).unwrap();
        let lives = [(); 3].map(|()| next_incarnation(&file).0);
        assert_eq!(lives, [1, 2, 3].map(|nth| Incarnation(ahead + nth)));
        fs::write(&file, "half a num").unwrap();
        let now = utc_nanoseconds();
        assert!((now..ahead).contains(&next_incarnation(&file).0.0), "a damaged file is ignored");
        fs::write(&file, "longer than any number that an agent keeps").unwrap();
        let (kept, _) = next_incarnation(&file);
        assert_eq!(fs::read_to_string(&file).unwrap(), incarnation_text(kept));
        let (life, fault) = next_incarnation(&folder.path().join("nowhere/life"));
        assert!(life >= Incarnation(now) && fault.is_some());
    }

    #[test]
    fn a_full_disk_has_room_for_the_next_incarnation_in_the_file_of_the_last_one() {
        let texts = [0, 1_800_000_000_000_000_000, u64::MAX].map(|number| incarnation_text(Incarnation(number)));
        assert!(texts.iter().all(|text| text.len() == 21), "{texts:?}");
        let last = Incarnation(1_800_000_000_000_000_000);
        let next = incarnation_after(Some(&incarnation_text(last)), Incarnation(5));
        assert_eq!(next, Incarnation(last.0 + 1), "after the clock was set back");
        // Overwriting keeps the blocks of the file: what was there is never gone.
        let folder = tempfile::tempdir().unwrap();
        let (file, same) = (folder.path().join("life"), folder.path().join("same"));
        fs::write(&file, incarnation_text(last)).unwrap();
        fs::hard_link(&file, &same).unwrap();
        let (new, _) = next_incarnation(&file);
        assert_eq!(fs::read_to_string(&same).unwrap(), incarnation_text(new));
    }

    #[test]
    fn instants_have_their_calendar_names() {
        // From `date -u -d @SECONDS +%Y%m%dT%H%M%SZ`.
        for (unix_s, name) in [
            (0, "19700101T000000Z"),
            (951_782_399, "20000228T235959Z"),
            (951_782_400, "20000229T000000Z"),
            (1_772_323_199, "20260228T235959Z"),
            (1_795_248_902, "20261121T081502Z"),
            (4_107_542_400, "21000301T000000Z"),
        ] {
            assert_eq!(name_of(OffsetDateTime::from_unix_timestamp(unix_s).unwrap()), name);
        }
    }
}
