//! Quantiles of samples: one definition for every figure, table and report.

/// The quantile of samples: the value below which this share of them lies, interpolated linearly between the two
/// nearest samples. It is definition 7 of R. J. Hyndman and Y. Fan, "Sample Quantiles in Statistical Packages", 1996,
/// which NumPy, R and spreadsheets use. `share` is 0 to 1. The function reorders the samples and takes time
/// proportional to their number. `None` without samples.
///
/// Samples may be infinite ("never happened"). Half-way between the two infinities is 0.
pub fn quantile(samples: &mut [f64], share: f64) -> Option<f64> {
    let position = share * samples.len().checked_sub(1)? as f64;
    let (below, fraction) = (position as usize, position - position.floor());
    let (_, &mut low, above) = samples.select_nth_unstable_by(below, f64::total_cmp);
    if fraction == 0.0 {
        return Some(low);
    }
    let high = above.iter().copied().fold(f64::INFINITY, f64::min);
    Some(match (low.is_finite(), high.is_finite()) {
        (true, true) => low + (high - low) * fraction,
        _ if low == high => low,
        (false, false) => 0.0,
        (false, true) => low,
        (true, false) => high,
    })
}

/// The middle sample, or the mean of the two in the middle: [`quantile`] of one half.
pub fn median(samples: &mut [f64]) -> Option<f64> {
    quantile(samples, 0.5)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn quantiles_equal_those_of_numpy() {
        // numpy.quantile([15, 20, 35, 40, 50], [0, 0.05, 0.25, 0.3, 0.4, 0.5, 0.99, 1])
        let expected = [15.0, 16.0, 20.0, 23.0, 29.0, 35.0, 49.6, 50.0];
        for (share, value) in [0.0, 0.05, 0.25, 0.3, 0.4, 0.5, 0.99, 1.0].into_iter().zip(expected) {
            let quantile = quantile(&mut [40.0, 15.0, 50.0, 35.0, 20.0], share).unwrap();
            assert!((quantile - value).abs() < 1e-12, "{share}: {quantile}");
        }
        assert_eq!(quantile(&mut [], 0.5), None);
        assert_eq!(median(&mut [7.0]), Some(7.0));
    }

    #[test]
    fn samples_may_be_infinite() {
        let inf = f64::INFINITY;
        for (mut samples, expected) in [
            (vec![1.0, inf, inf], inf),
            (vec![1.0, 2.0, inf], 2.0),
            (vec![1.0, inf], inf),
            (vec![-inf, 1.0], -inf),
            (vec![-inf, inf], 0.0),
            (vec![inf, inf], inf),
        ] {
            assert_eq!(median(&mut samples), Some(expected), "{samples:?}");
        }
    }

    proptest! {
        #[test]
        fn a_quantile_splits_the_samples(mut samples in prop::collection::vec(-1e3..1e3, 1..50), share in 0.0..=1.0) {
            let value = quantile(&mut samples, share).unwrap();
            let below = samples.iter().filter(|sample| **sample < value).count() as f64;
            let above = samples.iter().filter(|sample| **sample > value).count() as f64;
            let last = samples.len() as f64 - 1.0;
            prop_assert!(below <= share * last + 1.0 && above <= (1.0 - share) * last + 1.0, "{value} of {samples:?}");
        }
    }
}
