//! Gilbert's two-state model of failures in bursts: of a sensor that gives no values.

use skein_common::math;

/// Something that is bad for a share of all time, each time for a random duration: Gilbert's model with transitions in
/// continuous time (Gilbert 1960, "Capacity of a burst-noise channel"; with Elliott's 1963 loss probabilities 0 in the
/// good state and 1 in the bad one).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gilbert {
    /// Share of all time that is bad.
    share: f64,
    /// Mean duration of a bad time, s.
    mean_s: f64,
    /// Whether the last observed instant was bad.
    was_bad: Option<bool>,
}

impl Gilbert {
    /// A state that is bad for this share of all time, for `mean_s` seconds on average.
    pub(crate) fn new(share: f64, mean_s: f64) -> Self {
        Self { share, mean_s, was_bad: None }
    }

    /// Whether this instant, `since_s` seconds after the last one, is bad; `chance` is evenly distributed in [0, 1).
    /// Exact for any time between two instants: with rates 1/`mean_s` out of the bad state and
    /// share / ((1 − share)·`mean_s`) into it, the knowledge of the state decays with the time constant
    /// (1 − share)·`mean_s`.
    pub(crate) fn is_bad(&mut self, since_s: f64, chance: f64) -> bool {
        let known = self.was_bad.map_or(0.0, |was_bad| {
            let fades_s = (1.0 - self.share) * self.mean_s;
            let left = if since_s > 0.0 { math::exp(-since_s / fades_s) } else { 1.0 };
            left * (f64::from(u8::from(was_bad)) - self.share)
        });
        let is_bad = chance < self.share + known;
        self.was_bad = Some(is_bad);
        is_bad
    }
}
