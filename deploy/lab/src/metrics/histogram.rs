//! Quantiles of many samples in little memory.

/// A histogram with bins of one unit: its result is independent of the order of samples, and its size of their number.
#[derive(Clone, Debug)]
pub(super) struct Histogram {
    /// Sample from which on all count as equal.
    largest: u32,
    /// Number of samples in each bin, up to the largest sample so far.
    bins: Vec<u64>,
}

impl Histogram {
    /// A histogram in which all samples from `largest` on count as equal.
    pub(super) fn new(largest: u32) -> Self {
        Self { largest, bins: Vec::new() }
    }

    pub(super) fn add(&mut self, sample: f64) {
        let bin = self.bin(sample);
        if bin >= self.bins.len() {
            self.bins.resize(bin + 1, 0);
        }
        self.bins[bin] += 1;
    }

    pub(super) fn is_empty(&self) -> bool {
        self.bins.is_empty()
    }

    /// Value below which this share of the samples lies, by the definition of [`skein_common::statistics::quantile`].
    pub(super) fn quantile(&self, share: f64) -> Option<f64> {
        let count: u64 = self.bins.iter().sum();
        let place = share * count.checked_sub(1)? as f64;
        let (low, high) = (self.sample(place.floor() as u64)?, self.sample(place.ceil() as u64)?);
        Some(low + (high - low) * (place - place.floor()))
    }

    /// The sample of this rank, counted from 0.
    fn sample(&self, rank: u64) -> Option<f64> {
        let mut below = 0;
        let bin = self.bins.iter().position(|samples| {
            below += samples;
            below > rank
        })?;
        Some(bin as f64)
    }

    /// The bin of a sample: the nearest whole number, a half rounded up, as `round` does it with a call of the C library.
    fn bin(&self, sample: f64) -> usize {
        let sample = sample.clamp(0.0, f64::from(self.largest));
        let whole = sample as u32;
        whole as usize + usize::from(sample - f64::from(whole) >= 0.5)
    }
}

#[cfg(test)]
mod tests {
    use skein_common::statistics;

    use super::*;

    #[test]
    fn samples_fall_into_the_nearest_bin() {
        let ages_ms = Histogram::new(10_000);
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
            assert_eq!(ages_ms.bin(age_ms), expected, "{age_ms}");
        }
    }

    #[test]
    fn quantiles_are_those_of_the_samples_and_memory_does_not_grow_with_their_number() {
        let mut steps_us = Histogram::new(100_000);
        assert_eq!((steps_us.is_empty(), steps_us.quantile(0.5)), (true, None));
        let mut samples: Vec<f64> = (0..100_000_u32).map(|nth| f64::from(nth * 7_919 % 1_009)).collect();
        samples.iter().for_each(|sample| steps_us.add(*sample));
        for share in [0.0, 0.5, 0.99, 1.0] {
            assert_eq!(steps_us.quantile(share), statistics::quantile(&mut samples, share), "{share}");
        }
        assert_eq!(steps_us.bins.len(), 1_009);
    }
}
