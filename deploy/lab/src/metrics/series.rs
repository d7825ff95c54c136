//! Accumulators for the samples of a run.

use std::collections::VecDeque;

use skein_common::id::{VehicleId, VehicleSet};

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
    /// Level ρ: the distance from the centre in the metric of the formation's ellipse, m.
    pub(super) rho_m: f64,
    pub(super) altitude_error_m: Option<f64>,
    /// The vehicle's step of the mission.
    pub(super) step: u16,
    /// Whether the vehicle is in the region of the formation: in the band, or inside the area.
    pub(super) inside: bool,
}

/// The samples of all vehicles in their formation over the last [`STEADY_S`].
///
/// The samples of one instant are neighbours in memory, and their time is kept once: a long run writes and drops them
/// at every step.
#[derive(Clone, Debug)]
pub(super) struct FormationSeries {
    vehicles: usize,
    times_s: VecDeque<f64>,
    /// One place for each vehicle and time.
    samples: VecDeque<Packed>,
}

/// A sample of an instant, or none.
#[derive(Clone, Copy, Debug, Default)]
struct Packed {
    rho_m: f32,
    /// Not a number if the formation has no altitude.
    altitude_error_m: f32,
    step: u16,
    exists: bool,
    inside: bool,
}

impl Packed {
    fn unpack(&self) -> Option<InFormation> {
        let Self { rho_m, altitude_error_m, step, exists, inside } = *self;
        let altitude_error_m = Some(f64::from(altitude_error_m)).filter(|error_m| !error_m.is_nan());
        exists.then_some(InFormation { rho_m: rho_m.into(), altitude_error_m, step, inside })
    }
}

/// Largest number of instants for which memory is reserved at once.
const LARGEST_RESERVE: f64 = 10_000.0;

impl FormationSeries {
    pub(super) fn new(vehicles: usize) -> Self {
        Self { vehicles, times_s: VecDeque::new(), samples: VecDeque::new() }
    }

    /// Begins the next instant, without a sample of any vehicle.
    pub(super) fn begin(&mut self, t_s: f64) {
        self.fill_up(self.vehicles);
        while self.times_s.front().is_some_and(|first_s| *first_s < t_s - STEADY_S) {
            self.times_s.pop_front();
            self.samples.drain(..self.vehicles);
        }
        if let (Some(last_s), true) = (self.times_s.back(), self.times_s.len() == self.times_s.capacity()) {
            // Room for a whole window, and not twice as much.
            let window = (STEADY_S / (t_s - last_s)).min(LARGEST_RESERVE) as usize + 8;
            let more = window.saturating_sub(self.times_s.len());
            self.times_s.reserve_exact(more);
            self.samples.reserve_exact(more * self.vehicles);
        }
        self.times_s.push_back(t_s);
    }

    /// Fills the places of the present instant up to that of this vehicle with none.
    fn fill_up(&mut self, vehicle: usize) {
        let Some(before) = self.times_s.len().checked_sub(1) else { return };
        while self.samples.len() < before * self.vehicles + vehicle.min(self.vehicles) {
            self.samples.push_back(Packed::default());
        }
    }

    /// Adds the sample of a vehicle, counted from 0, at the present instant; vehicles come in ascending order.
    pub(super) fn add(&mut self, vehicle: usize, sample: InFormation) {
        let InFormation { rho_m, altitude_error_m, step, inside } = sample;
        let altitude_error_m = altitude_error_m.unwrap_or(f64::NAN) as f32;
        self.fill_up(vehicle);
        if vehicle < self.vehicles {
            self.samples.push_back(Packed { rho_m: rho_m as f32, altitude_error_m, step, exists: true, inside });
        }
    }

    /// The samples of a vehicle since `since_s`, each with its time, s. A vehicle that had left before `since_s`
    /// has none.
    pub(super) fn samples(&self, vehicle: usize, since_s: f64) -> impl Iterator<Item = (f64, InFormation)> + Clone {
        let times_s = self.times_s.iter().enumerate().filter(move |(_, t_s)| **t_s >= since_s);
        times_s.filter_map(move |(nth, t_s)| {
            let sample = self.samples.get(nth * self.vehicles + vehicle)?;
            Some((*t_s, sample.unpack()?))
        })
    }

    /// Half the peak-to-peak value of a vehicle's ρ after the removal of its quadratic trend, m.
    pub(super) fn oscillation_m(&self, vehicle: usize, since_s: f64) -> Option<f64> {
        let samples = self.samples(vehicle, since_s);
        let (first_s, last_s) = (samples.clone().next()?.0, samples.clone().last()?.0);
        let middle_s = (first_s + last_s) / 2.0;
        let scale_s = ((last_s - first_s) / 2.0).max(f64::MIN_POSITIVE);
        // Abscissae from −1 to 1 keep the normal equations well conditioned.
        let points: Vec<_> = samples.map(|(t_s, sample)| ((t_s - middle_s) / scale_s, sample.rho_m)).collect();
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

/// Chooses the peers of which ages are sampled: about four at each step, each of them again after a number of steps that
/// is a prime. Two states of a vehicle are ten steps apart or another number that the prime does not divide, so that all
/// ages occur in turn.
#[derive(Clone, Debug)]
pub(super) struct AgeSampling {
    groups: Vec<VehicleSet>,
    now: usize,
}

/// Numbers of steps between two samples of one peer's age, all primes.
const SAMPLING_STEPS: [usize; 6] = [7, 11, 17, 29, 43, 61];
/// Number of peers that are sampled at one step, unless even the largest number of steps makes it more.
const SAMPLED_PEERS: usize = 4;

impl AgeSampling {
    pub(super) fn new(vehicles: usize) -> Self {
        let is_enough = |steps: &usize| steps * SAMPLED_PEERS >= vehicles;
        let steps = SAMPLING_STEPS.into_iter().find(is_enough).unwrap_or(SAMPLING_STEPS[SAMPLING_STEPS.len() - 1]);
        let group = |nth| VehicleId::first(vehicles).skip(nth).step_by(steps).collect();
        Self { groups: (0..steps).map(group).collect(), now: 0 }
    }

    /// The peers of which the age is sampled at this step.
    pub(super) fn now(&self) -> VehicleSet {
        self.groups[self.now]
    }

    pub(super) fn next_step(&mut self) {
        self.now = (self.now + 1) % self.groups.len();
    }
}

/// A histogram of ages in bins of 1 ms: its result is independent of the order of samples, and its size of their
/// number.
#[derive(Clone, Debug)]
pub(super) struct AgeHistogram {
    bins: Vec<u64>,
}

/// Age from which on all samples count as equal, ms.
const LARGEST_AGE_MS: usize = 10_000;

impl Default for AgeHistogram {
    fn default() -> Self {
        Self { bins: vec![0; LARGEST_AGE_MS + 1] }
    }
}

impl AgeHistogram {
    pub(super) fn add(&mut self, age_s: f64) {
        self.bins[bin(age_s * 1e3)] += 1;
    }

    /// Age below which this share of the samples lies, ms, by the definition of [`skein_common::statistics::quantile`].
    pub(super) fn quantile_ms(&self, share: f64) -> Option<f64> {
        let count: u64 = self.bins.iter().sum();
        let place = share * count.checked_sub(1)? as f64;
        let (low, high) = (self.sample_ms(place.floor() as u64)?, self.sample_ms(place.ceil() as u64)?);
        Some(low + (high - low) * (place - place.floor()))
    }

    /// The sample of this rank, counted from 0, ms.
    fn sample_ms(&self, rank: u64) -> Option<f64> {
        let mut below = 0;
        let bin = self.bins.iter().position(|samples| {
            below += samples;
            below > rank
        })?;
        Some(bin as f64)
    }
}

/// The bin of an age: the nearest whole number of milliseconds, half a millisecond rounded up, as `round` does it with a
/// call of the C library.
fn bin(age_ms: f64) -> usize {
    let age_ms = age_ms.clamp(0.0, LARGEST_AGE_MS as f64);
    let whole = age_ms as i32;
    whole as usize + usize::from(age_ms - f64::from(whole) >= 0.5)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_fall_into_the_nearest_bin() {
        for (age_ms, expected) in [
            (-7.0, 0),
            (-0.4, 0),
            (0.499_999_999_999_999_94, 0),
            (0.5, 1),
            (1.5, 2),
            (20.499_999, 20),
            (9_999.5, 10_000),
            (1e12, 10_000),
            (f64::NAN, 0),
        ] {
            assert_eq!(bin(age_ms), expected, "{age_ms}");
        }
    }
}
