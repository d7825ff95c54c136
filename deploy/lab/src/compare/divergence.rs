//! Difference between runs of the same scenario and seed in virtual and in real time, or with different plants, without a
//! verdict. Every figure that both sides have is shown; wall-clock figures come from the run in real time.

use serde::Serialize;
use skein_common::statistics::median;

use super::folder::Folder;
use super::pairs::Paired;
use super::statistics::difference;
use super::table::with_head;
use crate::study::rounded;

/// Two targets or plants.
#[derive(Clone, Debug, Serialize)]
pub struct Divergence {
    /// Target and plant of A, such as `study builtin`.
    pub a: String,
    /// Target and plant of B.
    pub b: String,
    /// Pairs of runs.
    pub pairs: usize,
    /// Every figure that applies on both sides.
    pub figures: Vec<FigureDifference>,
    /// Keys of figures that only one side has, A's and B's.
    pub one_sided: [Vec<String>; 2],
}

/// One figure.
#[derive(Clone, Debug, Serialize)]
pub struct FigureDifference {
    /// Its key in `metrics.json`.
    pub key: String,
    /// Median of A; `null` for never.
    pub a: Option<f64>,
    /// Median of B.
    pub b: Option<f64>,
    /// Median of B minus A in each pair.
    pub difference: Option<f64>,
    /// That as a share of A's median; `null` if this is 0.
    pub relative: Option<f64>,
    /// The pair that is farthest apart.
    pub farthest: ComparedPair,
    /// Each pair.
    pub each: Vec<ComparedPair>,
}

/// One pair.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ComparedPair {
    /// Seed of both runs.
    pub seed: u64,
    /// Value of A; `null` for never.
    pub a: Option<f64>,
    /// Value of B; `null` for never.
    pub b: Option<f64>,
}

/// They are not measured of what flew.
const OF_THE_PC: [&str; 2] = ["wall_s", "real_time_factor"];

/// Sets the two sides against each other in all figures, or in those named.
pub fn divergence(paired: &Paired<'_>, only: &[String]) -> Divergence {
    let is_asked = |key: &&String| !OF_THE_PC.contains(&key.as_str()) && (only.is_empty() || only.contains(key));
    let (mut figures, mut one_sided) = (Vec::new(), [Vec::new(), Vec::new()]);
    let first = paired.pairs().next();
    for key in first.iter().flat_map(|pair| pair[0].measured.figures.keys()).filter(is_asked) {
        let outcomes = paired.pairs().map(|pair| (pair[0].measured.seed, pair.map(|run| run.measured.outcome(key))));
        let outcomes: Vec<_> = outcomes.collect();
        let each: Vec<(u64, [f64; 2])> = outcomes
            .iter()
            .filter_map(|(seed, [a, b])| Some((*seed, [(*a)?, (*b)?].map(|outcome| outcome.or(f64::INFINITY)))))
            .collect();
        match apart(key, &each) {
            Some(apart) => figures.push(apart),
            None => (0..2)
                .filter(|&side| outcomes.iter().any(|(_, both)| both[side].is_some()))
                .for_each(|side| one_sided[side].push(key.clone())),
        }
    }
    let name = |folder: &Folder| {
        ["target", "plant"].map(|key| folder.texts(key).into_iter().collect::<Vec<_>>().join("/")).join(" ")
    };
    Divergence { a: name(paired.a), b: name(paired.b), pairs: paired.pairs().count(), figures, one_sided }
}

fn apart(key: &str, each: &[(u64, [f64; 2])]) -> Option<FigureDifference> {
    let finite = |value: f64| value.is_finite().then_some(value);
    let middle = |of: fn(&[f64; 2]) -> f64| {
        median(&mut each.iter().map(|(_, both)| of(both)).collect::<Vec<_>>()).unwrap_or(f64::NAN)
    };
    let size = |both: &[f64; 2]| difference(*both).abs();
    let both = |&(seed, [a, b]): &(u64, [f64; 2])| ComparedPair { seed, a: finite(a), b: finite(b) };
    let farthest = each.iter().reduce(|most, next| if size(&next.1) > size(&most.1) { next } else { most })?;
    let (a, difference) = (middle(|both| both[0]), middle(|both| difference(*both)));
    Some(FigureDifference {
        key: key.to_owned(),
        a: finite(a),
        b: finite(middle(|both| both[1])),
        difference: finite(difference),
        relative: finite(difference / a.abs()),
        farthest: both(farthest),
        each: each.iter().map(both).collect(),
    })
}

/// The table for people.
pub fn table(divergence: &Divergence) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "never".to_owned(), rounded);
    let mut table = with_head(["", &divergence.a, &divergence.b, "difference", "", "farthest", "seed"]);
    for figure in &divergence.figures {
        let relative = figure.relative.map(|share| format!("{:+.1} %", 100.0 * share)).unwrap_or_default();
        let ComparedPair { seed, a, b } = figure.farthest;
        let farthest =
            if a == b { "0".to_owned() } else { a.zip(b).map_or("never".to_owned(), |(a, b)| rounded(b - a)) };
        let difference =
            if figure.a == figure.b && figure.a.is_none() { String::new() } else { number(figure.difference) };
        let cells = [number(figure.a), number(figure.b), difference, relative, farthest, seed.to_string()];
        table.add_row([figure.key.clone()].into_iter().chain(cells));
    }
    let mut text =
        format!("{table}\nmedians of {} pairs of equal seeds, and the pair that is farthest apart\n", divergence.pairs);
    for (keys, name) in
        divergence.one_sided.iter().zip([&divergence.a, &divergence.b]).filter(|(keys, _)| !keys.is_empty())
    {
        text += &format!("only of {name}: {}\n", keys.join(", "));
    }
    text
}
