//! Detects an agent that hangs: it runs, and its control thread does nothing. The agent reports to the supervisor once a
//! second, in the way of systemd's services, so that both supervise it by the same reports.

use std::time::{Duration, Instant};

/// An agent that has reported, and then does not for this long, hangs. The unit of systemd has the same.
const SILENT: Duration = Duration::from_secs(10);
/// Time limit for the first report. The unit of systemd has the same.
const START: Duration = Duration::from_secs(60);
/// After a pause of this length this process itself did not run, and the agent gets its time again.
const OWN_PAUSE: Duration = Duration::from_secs(2);

/// Watches one agent.
#[derive(Debug)]
pub(super) struct Watchdog {
    /// Time of the newest report, or of the begin.
    since: Instant,
    has_reported: bool,
    /// Time of the last look.
    looked: Instant,
}

impl Watchdog {
    /// Watches an agent from now on.
    pub(super) fn new(now: Instant) -> Self {
        Self { since: now, has_reported: false, looked: now }
    }

    /// Whether the agent hangs, and for how long it was silent. `reports` is whether it has reported since the last call.
    pub(super) fn silent_for(&mut self, now: Instant, reports: bool) -> Option<Duration> {
        let own_pause = now.duration_since(self.looked);
        self.looked = now;
        if reports {
            (self.since, self.has_reported) = (now, true);
        } else if own_pause > OWN_PAUSE {
            self.since = now;
        }
        let silent = now.duration_since(self.since);
        let limit = if self.has_reported { SILENT } else { START };
        (silent > limit).then_some(silent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use skein_host::clock;

    /// Looks ten times a second for so long; returns how long the agent was silent when it hung.
    fn watch(dog: &mut Watchdog, now: &mut Instant, seconds: u64, reports: bool) -> Option<Duration> {
        let until = *now + Duration::from_secs(seconds);
        while *now < until {
            *now += Duration::from_millis(100);
            if let Some(silent) = dog.silent_for(*now, reports) {
                return Some(silent);
            }
        }
        None
    }

    #[test]
    fn an_agent_that_stops_reporting_hangs() {
        let mut now = clock::now();
        let mut dog = Watchdog::new(now);
        assert_eq!(watch(&mut dog, &mut now, 59, false), None, "it starts");
        assert_eq!(watch(&mut dog, &mut now, 300, true), None);
        let silent = watch(&mut dog, &mut now, 60, false).unwrap();
        assert!(silent > SILENT && silent < SILENT + Duration::from_secs(1), "{silent:?}");
    }

    #[test]
    fn an_agent_that_never_reports_hangs() {
        let mut now = clock::now();
        let mut dog = Watchdog::new(now);
        assert!(watch(&mut dog, &mut now, 70, false).unwrap() > START);
    }

    #[test]
    fn an_agent_that_was_suspended_with_its_supervisor_is_not_killed_when_both_resume() {
        // Whatever the agent was doing: flying, starting, or silent for almost too long already.
        for (starts, silent_s) in [(false, 0), (false, 9), (true, 59)] {
            let mut now = clock::now();
            let mut dog = Watchdog::new(now);
            assert_eq!(watch(&mut dog, &mut now, 30, !starts), None);
            assert_eq!(watch(&mut dog, &mut now, if starts { silent_s - 30 } else { silent_s }, false), None);
            now += Duration::from_secs(600);
            // The supervisor runs first, and the agent reports a second after it.
            assert_eq!(watch(&mut dog, &mut now, 1, false), None, "starts: {starts}, silent for {silent_s} s");
            assert_eq!(watch(&mut dog, &mut now, 60, true), None);
            assert!(watch(&mut dog, &mut now, 60, false).is_some(), "it still watches");
        }
    }

    #[test]
    fn a_supervisor_that_was_stopped_itself_gives_the_agent_its_time_again() {
        let mut now = clock::now();
        let mut dog = Watchdog::new(now);
        assert_eq!(watch(&mut dog, &mut now, 5, true), None);
        now += Duration::from_secs(3600);
        assert_eq!(watch(&mut dog, &mut now, 9, false), None);
        assert!(watch(&mut dog, &mut now, 9, false).is_some());
    }
}
