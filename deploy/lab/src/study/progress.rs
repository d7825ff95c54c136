//! How far a study is: a bar on a terminal, a line now and then elsewhere.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use skein_host::clock::now;

/// Between two lines.
const LINE: Duration = Duration::from_secs(10);

/// Shown on stderr until it is dropped.
#[derive(Debug)]
pub(super) enum Progress {
    Bar(ProgressBar),
    Lines(Mutex<Lines>),
}

#[derive(Debug)]
pub(super) struct Lines {
    runs: usize,
    done: usize,
    /// Since this start.
    begun: Instant,
    done_before: usize,
    last: Instant,
}

impl Progress {
    /// `done` of `runs` were there already.
    pub(super) fn new(runs: usize, done: usize) -> Self {
        if !std::io::stderr().is_terminal() {
            let begun = now();
            return Self::Lines(Mutex::new(Lines { runs, done, begun, done_before: done, last: begun }));
        }
        let bar = ProgressBar::new(runs as u64);
        let style = ProgressStyle::with_template("{bar:40} {pos} of {len} runs, {elapsed} gone, {eta} left");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.set_position(done as u64);
        bar.reset_eta();
        Self::Bar(bar)
    }

    /// One more run is done.
    pub(super) fn inc(&self) {
        match self {
            Self::Bar(bar) => bar.inc(1),
            Self::Lines(lines) => {
                let line = lines.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).inc(now());
                line.into_iter().for_each(|line| eprintln!("{line}"));
            }
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

impl Lines {
    fn inc(&mut self, now: Instant) -> Option<String> {
        self.done += 1;
        if now.duration_since(self.last) < LINE {
            return None;
        }
        self.last = now;
        let gone_s = now.duration_since(self.begun).as_secs_f64();
        let left_s = gone_s / (self.done - self.done_before) as f64 * (self.runs - self.done) as f64;
        Some(format!("{} of {} runs, {gone_s:.0} s gone, about {left_s:.0} s left", self.done, self.runs))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_counts_what_was_there_but_not_its_time() {
        let begun = now();
        let mut lines = Lines { runs: 100, done: 60, begun, done_before: 60, last: begun };
        let at = |s| begun + Duration::from_secs(s);
        assert_eq!(lines.inc(at(5)), None);
        assert_eq!(lines.inc(at(20)).as_deref(), Some("62 of 100 runs, 20 s gone, about 380 s left"));
        assert_eq!(lines.inc(at(25)), None);
    }
}
