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

/// The present UTC as a name for files, `20261121T081502Z`: sorts by time and has no colon.
#[expect(clippy::disallowed_methods, reason = "an edge: runs are named by the time of day")]
pub fn utc_name() -> String {
    name_of(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs())
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
