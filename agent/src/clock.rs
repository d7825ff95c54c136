//! The clocks of a running process, and how far a scenario sets one wrong. The core has none: it is told the time.

use std::fs;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use skein_common::id::{Incarnation, VehicleId};
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

/// This process's monotonic clock.
#[derive(Clone, Copy, Debug)]
pub struct LocalClock {
    zero: Instant,
}

impl LocalClock {
    /// A clock that shows zero now.
    pub fn start() -> Self {
        Self { zero: now() }
    }

    /// What it shows now.
    pub fn now(&self) -> LocalTime {
        self.at(now())
    }

    /// What it showed at an instant.
    pub fn at(&self, instant: Instant) -> LocalTime {
        LocalTime::from_nanoseconds(nanoseconds(instant.saturating_duration_since(self.zero)))
    }
}

/// How far a vehicle's clock is wrong by the scenario: `clock_offset_s` and `clock_drift_ppm` of `[vehicle.N]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Skew {
    /// Where the clock begins.
    zero: LocalTime,
    /// How much too fast it runs.
    drift: f64,
}

impl Skew {
    /// The clock of vehicle `own`. No clock shows less than its zero, so the last of the swarm begins there and the others ahead
    /// of it.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        let Some(vehicle) = scenario.vehicle(own) else { return Self::default() };
        let last_s = scenario.vehicle.iter().map(|vehicle| vehicle.clock_offset_s).fold(0.0, f64::min);
        Self { zero: LocalTime::from_seconds(vehicle.clock_offset_s - last_s), drift: vehicle.clock_drift_ppm * 1e-6 }
    }

    /// What the clock shows when one that is right shows `right`.
    pub fn shown(self, right: LocalTime) -> LocalTime {
        let drifted = right.plus_seconds(right.seconds() * self.drift);
        LocalTime::from_nanoseconds(drifted.nanoseconds() + self.zero.nanoseconds())
    }

    /// Whether the clock is right.
    pub fn is_none(self) -> bool {
        self == Self::default()
    }
}

/// The monotonic clock as the system has it.
#[expect(clippy::disallowed_methods, reason = "an edge: deadlines and arrival times")]
pub fn now() -> Instant {
    Instant::now()
}

/// Blocks this thread until the instant.
#[expect(clippy::disallowed_methods, reason = "an edge: a thread of its own that waits for its time")]
pub fn sleep_until(instant: Instant) {
    thread::sleep(instant.saturating_duration_since(now()));
}

/// A life that begins now: a restarted agent has a larger incarnation.
pub fn new_incarnation() -> Incarnation {
    Incarnation(utc_nanoseconds())
}

/// The same where the clock may have been set back since the last life: that is in `file`, and from now on this one is. What
/// cannot be kept is told in words.
pub fn next_incarnation(file: &Path) -> (Incarnation, Option<String>) {
    let last = fs::read_to_string(file).ok().and_then(|text| text.trim().parse::<u64>().ok());
    let Incarnation(new) = new_incarnation();
    let new = last.map_or(new, |last| new.max(last.saturating_add(1)));
    let fault = fs::write(file, format!("{new}\n")).err();
    (Incarnation(new), fault.map(|fault| format!("{}: {fault}", file.display())))
}

/// What the system takes UTC to be, ns since 1970. Other systems' differ, and nothing in flight relies on it.
#[expect(clippy::disallowed_methods, reason = "an edge: new lives, and how far clocks are apart")]
pub fn utc_nanoseconds() -> u64 {
    nanoseconds(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    #[test]
    fn every_life_is_larger_than_the_last_whatever_the_clock_says() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("life");
        let now = utc_nanoseconds();
        let (first, fault) = next_incarnation(&file);
        assert!(first >= Incarnation(now) && fault.is_none(), "{first:?}, {fault:?}");
        // The clock was an hour ahead at the last start.
        let ahead = utc_nanoseconds() + 3_600_000_000_000;
        fs::write(&file, ahead.to_string()).unwrap();
        let lives = [(); 3].map(|()| next_incarnation(&file).0);
        assert_eq!(lives, [1, 2, 3].map(|nth| Incarnation(ahead + nth)));
        fs::write(&file, "half a num").unwrap();
        let now = utc_nanoseconds();
        assert!((now..ahead).contains(&next_incarnation(&file).0.0), "a file that is none says nothing");
        let (life, fault) = next_incarnation(&folder.path().join("nowhere/life"));
        assert!(life >= Incarnation(now) && fault.is_some());
    }

    #[test]
    fn a_skewed_clock_begins_elsewhere_and_runs_at_its_own_rate() {
        let text = "swarm.vehicles = 3\n[vehicle]\n1.clock_drift_ppm = 100\n\
                    2 = { clock_offset_s = -7200, clock_drift_ppm = -50 }\n3.clock_offset_s = 3600";
        let scenario = load(&Source { name: "test.toml", text }, &[]).unwrap().scenario;
        let hour = LocalTime::from_seconds(3600.0);
        let shown = scenario.ids().map(|id| {
            let skew = Skew::new(&scenario, id);
            assert!(!skew.is_none());
            (skew.shown(LocalTime::ZERO).seconds(), skew.shown(hour).nanoseconds())
        });
        let expected = [(7200.0, 10_800_360_000_000), (0.0, 3_599_820_000_000), (10_800.0, 14_400_000_000_000)];
        assert_eq!(shown.collect::<Vec<_>>(), expected);
        let plain = load(&Source { name: "test.toml", text: "swarm.vehicles = 3" }, &[]).unwrap().scenario;
        assert!(plain.ids().all(|id| Skew::new(&plain, id).is_none() && Skew::new(&plain, id).shown(hour) == hour));
    }
}
