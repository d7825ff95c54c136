//! Samples the ages of peers' states.

use skein_common::id::{VehicleId, VehicleSet};

/// Chooses the peers of which ages are sampled: four at most at each step, one in a swarm of more than 28, each of them again
/// after a number of steps that is a prime. Two states of a vehicle are ten steps apart or another number that the prime does not divide, so that all
/// ages occur in turn.
#[derive(Clone, Debug)]
pub(super) struct AgeSampling {
    groups: Vec<VehicleSet>,
    now: usize,
}

/// Numbers of steps between two samples of one peer's age, all primes: the first for swarms of up to
/// [`LARGEST_SMALL_SWARM`], the least that is not below the number of vehicles for larger ones.
const SAMPLING_STEPS: [usize; 8] = [7, 29, 43, 61, 89, 127, 179, 251];
const LARGEST_SMALL_SWARM: usize = 28;

impl AgeSampling {
    pub(super) fn new(vehicles: usize) -> Self {
        let is_enough = |steps: &usize| *steps >= vehicles || vehicles <= LARGEST_SMALL_SWARM;
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
