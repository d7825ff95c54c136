//! The only clocks of this crate.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Monotonic time.
#[expect(clippy::disallowed_methods, reason = "an edge: whoever watches a swarm has a clock")]
pub fn now() -> Instant {
    Instant::now()
}

/// Waits.
#[expect(clippy::disallowed_methods, reason = "an edge: whoever watches a swarm waits for it")]
pub fn sleep(duration: Duration) {
    std::thread::sleep(duration);
}

/// UTC of instants, as nanoseconds since 1970: it is read once and goes on as monotonic time does, so that no setting of the
/// clock turns the order of two instants round.
#[derive(Clone, Copy, Debug)]
pub struct Utc {
    at: Instant,
    unix_ns: u64,
}

impl Utc {
    /// Read now.
    #[expect(clippy::disallowed_methods, reason = "an edge: recordings tell when they were made")]
    pub fn read() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { at: now(), unix_ns: u64::try_from(unix.as_nanos()).unwrap_or(u64::MAX) }
    }

    /// UTC of this instant.
    pub fn nanoseconds(&self, at: Instant) -> u64 {
        let ns = |span: Duration| u64::try_from(span.as_nanos()).unwrap_or(u64::MAX);
        match at.checked_duration_since(self.at) {
            Some(since) => self.unix_ns.saturating_add(ns(since)),
            None => self.unix_ns.saturating_sub(ns(self.at.duration_since(at))),
        }
    }
}

/// The present UTC, to the second.
#[expect(clippy::disallowed_methods, reason = "an edge: certificates end on a date")]
pub fn utc() -> time::OffsetDateTime {
    let unix_s = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    time::OffsetDateTime::UNIX_EPOCH + time::Duration::seconds(i64::try_from(unix_s).unwrap_or(i64::MAX))
}

/// The present UTC as a name for files, `20261121T081502Z`: sorts by time and has no colon.
#[expect(clippy::disallowed_methods, reason = "an edge: runs are named by the time of day")]
pub fn utc_name() -> String {
    name_of(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs())
}

/// The present UTC at the head of a log's line, `2026-11-21T08:15:02.123456Z`, as agents write it too.
#[expect(clippy::disallowed_methods, reason = "an edge: a log's lines have times")]
pub fn utc_stamp() -> String {
    let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let (days, second) = (unix.as_secs() / 86_400, unix.as_secs() % 86_400);
    let (year, month, day) = civil(days);
    let (hour, minute, second, us) = (second / 3600, second / 60 % 60, second % 60, unix.subsec_micros());
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{us:06}Z")
}

fn name_of(unix_s: u64) -> String {
    let (days, second) = (unix_s / 86_400, unix_s % 86_400);
    let (year, month, day) = civil(days);
    format!("{year:04}{month:02}{day:02}T{:02}{:02}{:02}Z", second / 3600, second / 60 % 60, second % 60)
}

/// Year, month and day of a day counted from 1970-01-01. H. Hinnant, "chrono-Compatible Low-Level Date Algorithms".
fn civil(days: u64) -> (u64, u64, u64) {
    let from_march = days + 719_468;
    let (era, day_of_era) = (from_march / 146_097, from_march % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + 400 * era + u64::from(month <= 2);
    (year, month, day_of_year - (153 * month_from_march + 2) / 5 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

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
            assert_eq!(name_of(unix_s), name);
        }
    }
}
