//! Accumulators for the samples of a run.

use std::collections::VecDeque;

use super::STEADY_S;

/// Finds the first time after which a condition holds to the end.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Settling {
    since_s: Option<f64>,
}

impl Settling {
    pub(super) fn observe(&mut self, t_s: f64, holds: bool) {
        self.since_s = if holds { self.since_s.or(Some(t_s)) } else { None };
    }

    pub(super) fn since_s(&self) -> Option<f64> {
        self.since_s
    }
}

/// The longest of several delays; a reaction that never came ranks above all.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Worst {
    longest_s: Option<f64>,
    is_never: bool,
}

impl Worst {
    /// Adds a reaction that came after this delay, s.
    pub(super) fn add_time(&mut self, took_s: f64) {
        self.longest_s = Some(self.longest_s.map_or(took_s, |longest_s| longest_s.max(took_s)));
    }

    /// Adds a reaction that had enough time and never came.
    pub(super) fn add_never(&mut self) {
        self.is_never = true;
    }

    /// Longest delay, s; `None` if a reaction never came.
    pub(super) fn s(&self) -> Option<f64> {
        self.longest_s.filter(|_| !self.is_never)
    }

    /// Whether a reaction never came.
    pub(super) fn is_never(&self) -> bool {
        self.is_never
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

    pub(super) fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

/// The samples of a value over the last [`STEADY_S`].
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    samples: VecDeque<(f64, f64)>,
}

impl Window {
    pub(super) fn add(&mut self, t_s: f64, value: f64) {
        drop_before(&mut self.samples, t_s - STEADY_S, |sample| sample.0);
        self.samples.push_back((t_s, value));
    }

    /// Mean of the values since `since_s`; `None` without values.
    pub(super) fn mean(&self, since_s: f64) -> Option<f64> {
        mean(self.samples.iter().filter(|sample| sample.0 >= since_s).map(|sample| sample.1))
    }
}

/// One vehicle in its formation at one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct InFormation {
    pub(super) t_s: f64,
    /// Level ρ: the distance from the centre in the metric of the formation's ellipse, m.
    pub(super) rho_m: f64,
    /// ρ − R*, m.
    pub(super) radial_error_m: f64,
    pub(super) altitude_error_m: Option<f64>,
    /// Whether the vehicle is in the region of the formation: in the band, or inside the area.
    pub(super) inside: bool,
}

/// The samples of one vehicle in its formation over the last [`STEADY_S`].
#[derive(Clone, Debug, Default)]
pub(super) struct RadialSeries {
    samples: VecDeque<InFormation>,
}

impl RadialSeries {
    pub(super) fn add(&mut self, sample: InFormation) {
        drop_before(&mut self.samples, sample.t_s - STEADY_S, |sample| sample.t_s);
        self.samples.push_back(sample);
    }

    /// The samples since `since_s`; none of a vehicle that left before.
    pub(super) fn samples(&self, since_s: f64) -> impl Iterator<Item = &InFormation> + Clone {
        self.samples.iter().filter(move |sample| sample.t_s >= since_s)
    }

    /// Half the peak-to-peak value of ρ after the removal of its quadratic trend, m.
    pub(super) fn oscillation_m(&self, since_s: f64) -> Option<f64> {
        let (first, last) = (self.samples(since_s).next()?.t_s, self.samples.back()?.t_s);
        let middle_s = (first + last) / 2.0;
        let scale_s = ((last - first) / 2.0).max(f64::MIN_POSITIVE);
        // Abscissae from −1 to 1 keep the normal equations well conditioned.
        let points: Vec<_> =
            self.samples(since_s).map(|sample| ((sample.t_s - middle_s) / scale_s, sample.rho_m)).collect();
        let mut normal = nalgebra::Matrix3::zeros();
        let mut right = nalgebra::Vector3::zeros();
        for &(x, y) in &points {
            let row = nalgebra::Vector3::new(1.0, x, x * x);
            normal += row * row.transpose();
            right += row * y;
        }
        let trend = normal.lu().solve(&right)?;
        let rest = points.iter().map(|&(x, y)| y - (trend.x + trend.y * x + trend.z * x * x));
        let (low, high) = extremes(rest)?;
        Some((high - low) / 2.0)
    }
}

fn drop_before<T>(samples: &mut VecDeque<T>, first_s: f64, time_s: impl Fn(&T) -> f64) {
    while samples.front().is_some_and(|sample| time_s(sample) < first_s) {
        samples.pop_front();
    }
}

/// A histogram of ages in bins of 1 ms: its result is independent of the order of samples, and its size of their
/// number.
#[derive(Clone, Debug)]
pub(super) struct AgeHistogram {
    bins: Vec<u64>,
    count: u64,
}

impl Default for AgeHistogram {
    fn default() -> Self {
        Self { bins: vec![0; 10_001], count: 0 }
    }
}

impl AgeHistogram {
    pub(super) fn add(&mut self, age_s: f64) {
        let bin = ((age_s * 1e3).round().max(0.0) as usize).min(self.bins.len() - 1);
        self.bins[bin] += 1;
        self.count += 1;
    }

    /// Age below which this share of the samples lies, ms, by the definition of [`skein_common::statistics::quantile`].
    pub(super) fn quantile_ms(&self, share: f64) -> Option<f64> {
        let place = share * self.count.checked_sub(1)? as f64;
        let (low, high) = (self.sample_ms(place.floor() as u64)?, self.sample_ms(place.ceil() as u64)?);
        Some(low + (high - low) * (place - place.floor()))
    }

    /// The sample of this rank, counted from 0, ms.
    fn sample_ms(&self, rank: u64) -> Option<f64> {
        let mut below = 0;
        let bin = self.bins.iter().position(|count| {
            below += count;
            below > rank
        })?;
        Some(bin as f64)
    }
}

/// Mean of the values; `None` without values.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut mean = Mean::default();
    values.for_each(|value| mean.add(value));
    mean.mean()
}

/// Root mean square of the values; `None` without values.
pub(super) fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    mean(values.map(|value| value * value)).map(f64::sqrt)
}

/// Least and largest of the values; `None` without values.
pub(super) fn extremes(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |extremes, value| match extremes {
        None => Some((value, value)),
        Some((low, high)) => Some((low.min(value), high.max(value))),
    })
}
