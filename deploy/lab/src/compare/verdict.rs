//! One figure of one point: better, the same, or worse.

use serde::Serialize;
use skein_common::statistics::median;

use super::pairs::Pair;
use super::statistics::{ALPHA, Estimate, difference, estimate, notable, sign_test};
use crate::metrics::{Direction, Outcome, figures};

/// Differences up to this share of the larger of the two medians do not count.
pub const NEGLIGIBLE: f64 = 0.01;
/// Fewer pairs can agree by chance: 2 · 0.5⁵ is more than 5 %.
const FEWEST: usize = 6;

/// The verdict on B against A, in the order in which a table has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Shown to be worse.
    Worse,
    /// They differ, and there are too few pairs to say more.
    Unclear,
    /// Shown to be better.
    Better,
    /// No difference is shown.
    Same,
}

/// One figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Compared {
    /// Its key in `metrics.json`.
    pub key: &'static str,
    /// Pairs in which it applies.
    pub pairs: usize,
    /// Median of A.
    pub a: Estimate,
    /// Median of B.
    pub b: Estimate,
    /// Runs of A and of B in which it never came.
    pub never: [usize; 2],
    /// Median of B minus A in each pair.
    pub difference: Estimate,
    /// Share of pairs in which B is notably better, minus share in which it is notably worse; with its interval.
    pub effect: Estimate,
    /// Pairs in which B is notably better.
    pub better: usize,
    /// Pairs in which B is notably worse.
    pub worse: usize,
    /// The verdict that follows.
    pub verdict: Verdict,
    /// Seed of the pair in which B lost most; none if it did nowhere.
    pub worst_seed: Option<u64>,
    /// The command that flies B's run of this pair again.
    pub replay: Option<String>,
}

impl Compared {
    /// Compares a figure that can be better or worse; `None` if no pair has it.
    pub fn new(key: &'static str, pairs: &[Pair<'_>]) -> Option<Self> {
        let (key, direction) = figures::judged().find(|(known, _)| *known == key)?;
        let outcome = |run: usize, pair: &Pair<'_>| pair[run].measured.outcome(key);
        // The pairs of runs that both have the figure.
        let both = pairs.iter().filter_map(|pair| Some((pair, [outcome(0, pair)?, outcome(1, pair)?])));
        let (applies, outcomes): (Vec<&Pair<'_>>, Vec<[Outcome; 2]>) = both.unzip();
        if applies.is_empty() {
            return None;
        }
        let bad = if direction == Direction::Less { -1.0 } else { 1.0 };
        let values: Vec<[f64; 2]> =
            outcomes.iter().map(|both| both.map(|outcome| outcome.or(bad * f64::INFINITY))).collect();
        let negligible = NEGLIGIBLE * scale(&values);
        let estimates = estimate(&values, negligible);
        let count = |sign: f64| values.iter().filter(|&&pair| notable(pair, negligible) == sign).count();
        let (worse, better) = (count(bad), count(-bad));
        let lost = |pair: &[f64; 2]| bad * difference(*pair);
        let worst = (0..values.len()).max_by(|&one, &other| {
            // Of equal ones the first.
            lost(&values[one]).total_cmp(&lost(&values[other])).then(other.cmp(&one))
        });
        let worst = worst.filter(|&nth| lost(&values[nth]) > 0.0).map(|nth| applies[nth][1]);
        let never = [0, 1].map(|side| outcomes.iter().filter(|both| both[side] == Outcome::Never).count());
        Some(Self {
            key,
            pairs: values.len(),
            a: estimates.one,
            b: estimates.other,
            never,
            difference: estimates.difference,
            effect: estimates.dominance.turned(-bad),
            better,
            worse,
            verdict: verdict(estimates.difference.turned(bad), negligible, [better, worse], values.len()),
            worst_seed: worst.map(|run| run.measured.seed),
            replay: worst.map(super::folder::Flown::replay),
        })
    }

    /// Every pair is equal to the last bit.
    pub fn is_equal(&self) -> bool {
        self.difference == Estimate { value: 0.0, low: 0.0, high: 0.0 }
            && self.better + self.worse == 0
            && self.worst_seed.is_none()
    }
}

/// `lost` is how much B lost on A.
fn verdict(lost: Estimate, negligible: f64, [better, worse]: [usize; 2], pairs: usize) -> Verdict {
    if pairs < FEWEST {
        return if better + worse == 0 { Verdict::Same } else { Verdict::Unclear };
    }
    let is_shown = lost.is_off_zero() && lost.value.abs() > negligible;
    let is_frequent = sign_test(worse, better) < ALPHA;
    match () {
        () if is_shown && lost.value > 0.0 || is_frequent && worse > better => Verdict::Worse,
        () if is_shown || is_frequent => Verdict::Better,
        () => Verdict::Same,
    }
}

/// The larger magnitude of the two medians; a side in which the event never happened does not count.
fn scale(values: &[[f64; 2]]) -> f64 {
    let size =
        |side: usize| median(&mut values.iter().map(|pair| pair[side]).collect::<Vec<_>>()).unwrap_or(f64::NAN).abs();
    [size(0), size(1)].into_iter().filter(|size| size.is_finite()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use std::collections::{BTreeMap, BTreeSet};

    use skein_core::random::{self, Purpose};

    use super::super::folder::Flown;
    use super::*;
    use crate::metrics::Measured;

    /// A run of a seed with one figure; none is never.
    fn run(seed: u64, key: &str, value: Option<f64>) -> Flown {
        let never = if value.is_none() { BTreeSet::from([key.to_owned()]) } else { BTreeSet::new() };
        let figures = BTreeMap::from([(key.to_owned(), value)]);
        let measured = Measured { seed, texts: BTreeMap::new(), figures, never, uncontrolled: Vec::new() };
        Flown { folder: format!("b/seed-{seed}").into(), measured, scenario: BTreeMap::new() }
    }

    fn compared(key: &'static str, values: &[[Option<f64>; 2]]) -> Compared {
        let both = |(seed, both): (usize, &[Option<f64>; 2])| both.map(|value| run(seed as u64, key, value));
        let runs: Vec<[Flown; 2]> = values.iter().enumerate().map(both).collect();
        let pairs: Vec<Pair<'_>> = runs.iter().map(|[a, b]| [a, b]).collect();
        Compared::new(key, &pairs).unwrap()
    }

    fn some(values: &[[f64; 2]]) -> Vec<[Option<f64>; 2]> {
        values.iter().map(|both| both.map(Some)).collect()
    }

    #[test]
    fn a_shift_is_better_or_worse_as_the_figure_has_it() {
        let larger: Vec<[f64; 2]> = (0..10).map(|n| [f64::from(n), f64::from(n) + 1.0 + f64::from(n % 3)]).collect();
        let error = compared("radial_rms_m", &some(&larger));
        assert_eq!((error.verdict, error.worse, error.better), (Verdict::Worse, 10, 0));
        assert_eq!((error.effect.value, error.worst_seed), (-1.0, Some(2)), "of equal losses the first");
        assert_eq!(error.replay.as_deref(), Some("skein study b/seed-2/scenario.toml"));
        let separation = compared("min_separation_m", &some(&larger));
        assert_eq!((separation.verdict, separation.effect.value), (Verdict::Better, 1.0));
        assert_eq!((separation.worst_seed, separation.replay), (None, None));
        assert_eq!(error.difference, separation.difference, "always B minus A");
        let few = compared("radial_rms_m", &some(&larger[..5]));
        assert_eq!(few.verdict, Verdict::Unclear);
    }

    #[test]
    fn what_is_negligible_or_equal_is_the_same() {
        let hardly: Vec<[f64; 2]> = (0..20).map(|n| [100.0 + f64::from(n), 100.5 + f64::from(n)]).collect();
        let figure = compared("radial_rms_m", &some(&hardly));
        assert_eq!((figure.verdict, figure.is_equal(), figure.worst_seed), (Verdict::Same, false, Some(0)));
        let equal = compared("radial_rms_m", &some(&[[3.0, 3.0]; 4]));
        assert!(equal.is_equal() && equal.verdict == Verdict::Same);
    }

    #[test]
    fn never_ranks_worst() {
        let mut values: Vec<[Option<f64>; 2]> = some(&[[50.0, 50.0]; 12]);
        values.iter_mut().take(6).for_each(|both| both[1] = None);
        let figure = compared("even_10deg_s", &values);
        assert_eq!((figure.verdict, figure.worse, figure.never), (Verdict::Worse, 6, [0, 6]));
        assert_eq!(
            serde_json::to_string(&figure.b).unwrap(),
            r#"{"median":null,"low":50.0,"high":null}"#,
            "half of them never"
        );
        values.iter_mut().for_each(|both| both.swap(0, 1));
        assert_eq!(compared("even_10deg_s", &values).verdict, Verdict::Better);
        let always = compared("even_10deg_s", &[[None, None]; 7]);
        assert!(always.is_equal() && always.never == [7, 7]);
        // Less is worse: nothing is worse than no separation at all.
        let separation = compared("min_separation_m", &[[Some(10.0), None]; 7]);
        assert_eq!(separation.verdict, Verdict::Worse);
    }

    #[test]
    fn what_happens_to_a_few_runs_is_found() {
        let collided =
            |of: usize| -> Vec<[f64; 2]> { (0..50).map(|n| [0.0, if n < of { 1.0 } else { 0.0 }]).collect() };
        let figure = compared("collisions", &some(&collided(7)));
        assert_eq!((figure.verdict, figure.difference.value), (Verdict::Worse, 0.0));
        assert_eq!(compared("collisions", &some(&collided(3))).verdict, Verdict::Same, "three may be chance");
    }

    #[test]
    fn chance_alone_is_seldom_worse() {
        let mut rng = random::generator(3, None, Purpose::Wind);
        for n in [7, 8, 13, 23, 25] {
            let mut worse = 0;
            for _ in 0..400 {
                let pairs: Vec<[f64; 2]> =
                    (0..n).map(|_| [0, 1].map(|_| 10.0 + random::standard_normal(&mut rng))).collect();
                worse += usize::from(compared("radial_rms_m", &some(&pairs)).verdict == Verdict::Worse);
            }
            println!("{n} pairs: {worse} of 400 worse");
            // 2.5 % on either side is 10, with a standard deviation of 3.1, and of few pairs less.
            assert!((1..=15).contains(&worse), "{n} pairs: {worse} of 400");
        }
    }

    /// Values that are exact in every order of sums: a figure of A and of B, or never.
    fn any_pairs() -> impl Strategy<Value = Vec<[Option<f64>; 2]>> {
        let value = || prop::option::weighted(0.9, (0_u8..40).prop_map(|quarters| f64::from(quarters) / 4.0));
        prop::collection::vec([value(), value()], 1..20)
    }

    fn swapped(verdict: Verdict) -> Verdict {
        match verdict {
            Verdict::Better => Verdict::Worse,
            Verdict::Worse => Verdict::Better,
            other => other,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn the_same_runs_on_both_sides_are_equal(pairs in any_pairs(), less_is_worse: bool) {
            let key = if less_is_worse { "min_separation_m" } else { "even_10deg_s" };
            let same: Vec<_> = pairs.iter().map(|[a, _]| [*a; 2]).collect();
            let figure = compared(key, &same);
            prop_assert!(figure.is_equal() && figure.verdict == Verdict::Same && figure.replay.is_none());
        }

        #[test]
        fn the_sides_exchanged_give_the_opposite(pairs in any_pairs(), less_is_worse: bool) {
            let key = if less_is_worse { "min_separation_m" } else { "even_10deg_s" };
            let (one, other) = (compared(key, &pairs), compared(key, &pairs.iter().map(|[a, b]| [*b, *a]).collect::<Vec<_>>()));
            prop_assert_eq!((one.a, one.b, one.never), (other.b, other.a, [other.never[1], other.never[0]]));
            prop_assert_eq!((one.better, one.worse, one.pairs), (other.worse, other.better, other.pairs));
            prop_assert_eq!(one.difference, other.difference.turned(-1.0));
            // What the median and the frequency of differences contradict each other on is worse from either side.
            let both = (one.verdict, other.verdict);
            prop_assert!(both.0 == swapped(both.1) || both == (Verdict::Worse, Verdict::Worse), "{:?}", both);
            prop_assert_eq!(one.is_equal(), other.is_equal());
        }
    }
}
