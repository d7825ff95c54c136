//! The progress of a study: a bar on a terminal, a line now and then elsewhere.

use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::planned::Progress;
use skein_host::clock::now;

/// Between two lines.
const LINE: Duration = Duration::from_secs(10);

/// Shows on stderr how far a study is, until it is dropped.
#[derive(Debug, Default)]
pub(super) struct Shown(OnceLock<Display>);

#[derive(Debug)]
enum Display {
    Bar(ProgressBar),
    Lines(Mutex<Lines>),
}

#[derive(Debug)]
struct Lines {
    runs: usize,
    done: usize,
    /// Since this start.
    begun: Instant,
    done_before: usize,
    last: Instant,
}

impl Progress for Shown {
    fn begin(&self, runs: usize, done: usize) {
        if done > 0 {
            eprintln!("{done} of {runs} runs are there already");
        }
        self.0.get_or_init(|| Display::new(runs, done));
    }

    fn inc(&self) {
        match self.0.get() {
            Some(Display::Bar(bar)) => bar.inc(1),
            Some(Display::Lines(lines)) => {
                let line = lines.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).inc(now());
                line.into_iter().for_each(|line| eprintln!("{line}"));
            }
            None => {}
        }
    }
}

impl Display {
    fn new(runs: usize, done: usize) -> Self {
        if !crate::terminal::obeys_escapes(&std::io::stderr()) {
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
}

impl Drop for Shown {
    fn drop(&mut self) {
        if let Some(Display::Bar(bar)) = self.0.get() {
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
