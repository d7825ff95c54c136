//! Accumulators for the samples of a run.

/// Finds the first time after which a condition holds to the end.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Settling {
    pub(super) since_s: Option<f64>,
}

impl Settling {
    pub(super) fn observe(&mut self, t_s: f64, holds: bool) {
        self.since_s = if holds { self.since_s.or(Some(t_s)) } else { None };
    }
}

/// The longest of several delays; a reaction that never came ranks above all.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Worst {
    longest_s: Option<f64>,
    /// Whether a reaction never came, although it had enough time.
    pub(super) is_never: bool,
}

impl Worst {
    /// Adds a reaction that came after this delay, s.
    pub(super) fn add_time(&mut self, took_s: f64) {
        self.longest_s = Some(self.longest_s.map_or(took_s, |longest_s| longest_s.max(took_s)));
    }

    /// Longest delay, s; `None` if a reaction never came.
    pub(super) fn s(&self) -> Option<f64> {
        self.longest_s.filter(|_| !self.is_never)
    }
}

/// A running mean.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    pub(super) fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    /// Number of values.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    pub(super) fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

/// Mean of the values; `None` without values.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut mean = Mean::default();
    values.for_each(|value| mean.add(value));
    mean.mean()
}

/// Least and largest of the values; `None` without values.
pub(super) fn extremes<T: PartialOrd + Copy>(values: impl Iterator<Item = T>) -> Option<(T, T)> {
    values.fold(None, |extremes, value| match extremes {
        None => Some((value, value)),
        Some((low, high)) => Some((if value < low { value } else { low }, if value > high { value } else { high })),
    })
}
