//! Estimates a difference from pairs of runs, without assuming anything of how figures are distributed.
//!
//! A figure that never came counts as infinitely bad: it ranks, and medians and intervals may be infinite.

use serde::Serialize;
use skein_common::math;
use skein_common::statistics::median;
use skein_core::random::{self, Purpose};

/// Share of the runs in which an interval misses what it estimates.
pub const ALPHA: f64 = 0.05;
/// Resamples of a bootstrap: so many that both ends of an interval are draws, not between two.
const RESAMPLES: usize = 1_999;
/// So many of the figures of a row are summed up by their median, the others by their mean.
const MEDIANS: usize = 3;

/// A median or a mean with its 95 % interval. JSON has `null` for each number that is never or without end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The median or the mean of the sample.
    #[serde(rename = "median")]
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Estimate {
    /// The interval lies above zero, or below it.
    pub fn is_off_zero(&self) -> bool {
        self.low > 0.0 || self.high < 0.0
    }

    /// Times 1 or -1.
    pub fn turned(self, sign: f64) -> Self {
        let [one, other] = [sign * self.low, sign * self.high];
        // Adding zero turns -0.0 into 0.0.
        Self { value: sign * self.value + 0.0, low: one.min(other) + 0.0, high: one.max(other) + 0.0 }
    }
}

/// The estimates from all pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimates {
    /// Median of the first of each pair.
    pub one: Estimate,
    /// Median of the second.
    pub other: Estimate,
    /// Median of the differences, second minus first.
    pub difference: Estimate,
    /// Share of pairs that rise by more than `negligible`, minus share of those that fall by more: the paired dominance d_w of
    /// N. Cliff, "Dominance statistics: Ordinal analyses to answer ordinal questions", Psychological Bulletin 114 (1993).
    pub dominance: Estimate,
}

/// Estimates with percentile intervals of a bootstrap that draws whole pairs; always the same draws. Percentiles, because
/// the jackknife inside BCa fails for medians: B. Efron and R. Tibshirani, "An Introduction to the Bootstrap" (1993), §11.6 and §13.3.
/// For few pairs such an interval of a median falls short, so it is widened to the exact one between two of the ordered
/// values (W. J. Conover, "Practical Nonparametric Statistics", §3.2), which less than six pairs do not have. `pairs`
/// are not empty.
pub fn estimate(pairs: &[[f64; 2]], negligible: f64) -> Estimates {
    let columns = |pair: [f64; 2]| [pair[0], pair[1], difference(pair), notable(pair, negligible)];
    let rows: Vec<[f64; 4]> = pairs.iter().map(|&pair| columns(pair)).collect();
    let mut room = Vec::with_capacity(rows.len());
    let values = figures(rows.iter(), &mut room);
    let mut generator = random::generator(0, None, Purpose::Study);
    let mut drawn = [const { Vec::new() }; 4];
    for _ in 0..RESAMPLES {
        let sample: Vec<usize> =
            rows.iter().map(|_| (random::uniform(&mut generator) * rows.len() as f64) as usize).collect();
        let figures = figures(sample.iter().map(|&nth| &rows[nth]), &mut room);
        drawn.iter_mut().zip(figures).for_each(|(drawn, figure)| drawn.push(figure));
    }
    let rank = rank(rows.len());
    let [one, other, difference, dominance] = std::array::from_fn(|nth| {
        let drawn = &mut drawn[nth];
        drawn.sort_by(f64::total_cmp);
        let tail = (ALPHA / 2.0 * (RESAMPLES + 1) as f64).round() as usize;
        let (mut low, mut high) = (drawn[tail - 1], drawn[RESAMPLES - tail]);
        if let Some(rank) = rank.filter(|_| nth < MEDIANS) {
            let mut ordered: Vec<f64> = rows.iter().map(|row| row[nth]).collect();
            ordered.sort_by(f64::total_cmp);
            (low, high) = (low.min(ordered[rank - 1]), high.max(ordered[ordered.len() - rank]));
        }
        Estimate { value: values[nth], low, high }
    });
    Estimates { one, other, difference, dominance }
}

/// The rank of those of `n` ordered values, counted from either end, that bound the exact interval of a median,
/// which is as narrow as possible. `None` for fewer than six values, which have no such interval.
fn rank(n: usize) -> Option<usize> {
    // The median lies below the k-th value if fewer than k lie below the median.
    (1..=n / 2).take_while(|k| sign_test(k - 1, n - (k - 1)) <= ALPHA).last()
}

/// Medians of the first three columns, mean of the last.
fn figures<'a>(rows: impl Iterator<Item = &'a [f64; 4]> + Clone, room: &mut Vec<f64>) -> [f64; 4] {
    let mut figures = [0.0; 4];
    for (nth, figure) in figures.iter_mut().enumerate() {
        room.clear();
        room.extend(rows.clone().map(|row| row[nth]));
        *figure =
            if nth < MEDIANS { median(room).unwrap_or(f64::NAN) } else { room.iter().sum::<f64>() / room.len() as f64 };
    }
    figures
}

/// Second minus first; two that never came do not differ.
pub fn difference([one, other]: [f64; 2]) -> f64 {
    if one == other { 0.0 } else { other - one }
}

/// 1 or -1 for a difference that is more than negligible.
pub fn notable(pair: [f64; 2], negligible: f64) -> f64 {
    let difference = difference(pair);
    if difference.abs() > negligible { difference.signum() } else { 0.0 }
}

/// Probability of at most this many of one sign among the pairs that differ, or of as few of the other, if both signs were
/// equally likely: the sign test, exact and two-sided (W. J. Conover, "Practical Nonparametric Statistics", §3.4).
pub fn sign_test(rise: usize, fall: usize) -> f64 {
    let n = rise + fall;
    // ln of the binomial coefficients over 2^n.
    let mut ln_term = -(n as f64) * std::f64::consts::LN_2;
    let mut sum = 0.0;
    for k in 0..=rise.min(fall) {
        sum += math::exp(ln_term);
        ln_term += math::ln((n - k) as f64 / (k + 1) as f64);
    }
    f64::min(1.0, 2.0 * sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sign_test_has_its_known_values() {
        // Binomial tables: 2 · Σ C(n, k) / 2ⁿ.
        for (rise, fall, p) in [
            (6, 0, 0.03125),
            (5, 0, 0.0625),
            (1, 9, 0.021484375),
            (9, 1, 0.021484375),
            (5, 5, 1.0),
            (15, 5, 0.04138947),
        ] {
            let found = sign_test(rise, fall);
            assert!((found - p).abs() < 1e-8, "{rise} against {fall}: {found}");
        }
        assert_eq!(sign_test(0, 0), 1.0);
        assert!(sign_test(2_000, 2_100) > 0.05 && sign_test(2_000, 2_400) < 1e-6);
    }

    #[test]
    fn the_exact_interval_has_its_known_ranks() {
        // Conover, table of the binomial distribution; 0 where no two values are far enough apart.
        for (n, k) in [(1, 0), (5, 0), (6, 1), (7, 1), (8, 1), (9, 2), (13, 3), (20, 6), (23, 7), (50, 18), (100, 40)] {
            assert_eq!(rank(n).unwrap_or(0), k, "{n} pairs");
        }
        let seven: Vec<[f64; 2]> = (0..7).map(|n| [0.0, f64::from(n)]).collect();
        assert_eq!(estimate(&seven, 0.0).difference, Estimate { value: 3.0, low: 0.0, high: 6.0 });
    }

    #[test]
    fn estimates_are_those_of_the_pairs() {
        let pairs: Vec<[f64; 2]> = (0..9).map(|n| [f64::from(n), f64::from(n) * 2.0]).collect();
        let estimates = estimate(&pairs, 2.5);
        assert_eq!((estimates.one.value, estimates.other.value, estimates.difference.value), (4.0, 8.0, 4.0));
        assert_eq!(estimates.dominance.value, 6.0 / 9.0, "3 to 8 rise by more than 2.5");
        assert_eq!(estimates, estimate(&pairs, 2.5), "always the same draws");
        let (low, high) = (estimates.difference.low, estimates.difference.high);
        assert!((1.0..4.0).contains(&low) && (4.0..8.0).contains(&high), "{low} to {high}");
        let constant = estimate(&[[1.0, 3.0]; 5], 0.0);
        assert_eq!(constant.difference, Estimate { value: 2.0, low: 2.0, high: 2.0 });
        assert!(constant.difference.is_off_zero() && !estimate(&[[1.0, 1.0]; 5], 0.0).difference.is_off_zero());
    }

    #[test]
    fn an_interval_contains_the_true_value_as_often_as_its_level() {
        let mut rng = random::generator(7, None, Purpose::Wind);
        let mut normal = || random::standard_normal(&mut rng);
        for n in [7, 12, 13, 23, 40] {
            let trials = 300;
            let (mut median_held, mut difference_held) = (0, 0);
            for _ in 0..trials {
                // Skewed, with a large part common to both of a pair; the true median of the differences is 0.5.
                let pairs: Vec<[f64; 2]> = (0..n)
                    .map(|_| {
                        let common = math::exp(normal()) * 10.0;
                        [common, common + 0.5 + normal()]
                    })
                    .collect();
                let estimates = estimate(&pairs, 0.0);
                median_held += usize::from((estimates.one.low..=estimates.one.high).contains(&10.0));
                difference_held += usize::from((estimates.difference.low..=estimates.difference.high).contains(&0.5));
            }
            let share = |held: usize| held as f64 / f64::from(trials);
            println!("{n} pairs: {} and {}", share(median_held), share(difference_held));
            // 95 % is 285, with a standard deviation of 3.8; of few pairs the exact interval is a wide one.
            assert!((0.93..=0.995).contains(&share(median_held)), "{n} pairs: {}", share(median_held));
            assert!((0.93..=0.995).contains(&share(difference_held)), "{n} pairs: {}", share(difference_held));
        }
    }
}
