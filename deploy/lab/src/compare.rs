//! `skein compare`: two folders of runs, seed by seed.
//!
//! Runs are **paired**: equal seed, and equal in every key that varies within both folders (a sweep's point). Of each figure
//! that can be worse ([`figures`]) and that both of a pair have, or that came in one and never in the other, the median of either
//! side, the median of the differences and the effect size are estimated with 95 % intervals, see [`statistics`]. What never came ranks worst.
//!
//! **Verdict** on B against A, of one figure:
//!
//! * A difference is *notable* if it is more than [`NEGLIGIBLE`] of the larger of the two medians.
//! * *worse*: the interval of the median difference lies on the bad side of zero, and that median is notable; or among the pairs
//!   that differ notably so many are worse that chance has less than 5 % of it (sign test). The second finds what happens to a few runs only,
//!   such as collisions: there the median shows no difference. Both need six pairs at least; with fewer the verdict
//!   is *unclear*.
//! * *better* likewise, unless something is worse; *same*: no difference is shown.
//!
//! One of forty figures that differ by chance alone looks worse. A test that has to decide names its figures
//! (`--only`).
//!
//! If the two sides are different targets (`study`, `fly`) or plants, neither is better or worse: see [`divergence`].

pub mod divergence;
pub mod folder;
pub mod pairs;
pub mod statistics;
mod table;
mod verdict;

use std::path::PathBuf;

use serde::Serialize;
use serde_json::{Map, Value};
use skein_common::scenario::nearest_of;

use crate::error::Error;
use crate::metrics::{figures, is_worse};
use crate::terminal::{json, say};
use folder::Folder;
use pairs::{Paired, PairedPoint};
pub use verdict::{Compared, NEGLIGIBLE, Verdict};

/// `skein compare`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein study --seeds 0..10 --out a\n  skein study --seeds 0..10 --set network.loss=0.3 --out b\n  skein compare a b --only collisions,even_10deg_s"
)]
pub struct CompareArgs {
    /// Runs to compare with: the folder of a study or of a flight, or any folder of such folders
    #[arg(value_name = "DIR_A")]
    pub a: PathBuf,
    /// Runs to judge
    #[arg(value_name = "DIR_B")]
    pub b: PathBuf,
    /// Compare these figures only, such as collisions,radial_rms_m
    #[arg(long, value_name = "KEY,...", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Print everything as JSON on stdout, everything else on stderr
    #[arg(long)]
    pub json: bool,
}

/// Compares and prints. Exit status: 0 nothing is worse, 1 something is, 2 an argument at fault.
///
/// # Errors
/// The figures that are worse, by name; or folders that cannot be compared.
pub fn run(args: &CompareArgs) -> Result<(), Error> {
    check_figures(&args.only)?;
    let (a, b) = (Folder::read(&args.a)?, Folder::read(&args.b)?);
    for folder in [&a, &b].into_iter().filter(|folder| folder.is_unfinished) {
        eprintln!("{}: this study is not finished; the runs that are there are compared", folder.path.display());
    }
    let paired = Paired::new(&a, &b)?;
    if ["target", "plant"].iter().any(|key| a.texts(key) != b.texts(key)) {
        let divergence = divergence::divergence(&paired, &args.only);
        say(&if args.json { json(&divergence) } else { paired.heading() + "\n" + &divergence::table(&divergence) });
        return Ok(());
    }
    let comparison = Comparison::new(&paired, &args.only);
    say(&if args.json { json(&comparison) } else { paired.heading() + &table::of(&comparison) });
    match comparison.worse.as_slice() {
        [] => Ok(()),
        worse => Err(Error::Failed(format!("worse: {}", worse.join(", ")))),
    }
}

/// Checks that each of these figures can be compared.
///
/// # Errors
/// The first one that cannot, with the figure that was probably meant.
pub fn check_figures(only: &[String]) -> Result<(), Error> {
    match only.iter().find(|key| is_worse(key).is_none()) {
        Some(unknown) => Err(Error::Refused(refusal(unknown))),
        None => Ok(()),
    }
}

/// Explains why this figure cannot be compared, and suggests the figure that was probably meant.
fn refusal(unknown: &str) -> String {
    let known = || figures::judged().map(|(key, _)| key);
    let why = match figures::of(unknown) {
        Some(_) => "this figure is neither good nor bad".to_owned(),
        None => "no figure that can be worse".to_owned(),
    };
    let meant = nearest_of(known(), unknown).map(|key| format!("; did you mean {key}?")).unwrap_or_default();
    let all = known().collect::<Vec<_>>().join(", ");
    format!("--only {unknown}: {why}{meant}\nThe figures are {all}")
}

/// The complete result of a comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// The runs to compare with.
    pub a: PathBuf,
    /// The runs that are judged.
    pub b: PathBuf,
    /// Keys of the scenario in which they differ, with the value in A and in B.
    pub differ: Map<String, Value>,
    /// Runs without a partner, in A and in B.
    pub unpaired: [usize; 2],
    /// Confidence of the intervals.
    pub confidence: f64,
    /// Figures that are worse at some point.
    pub worse: Vec<String>,
    /// The points at each of which the scenarios are the same within a side; a single one without a sweep.
    pub points: Vec<ComparedPoint>,
}

/// One point of a sweep, or the only one.
#[derive(Clone, Debug, Serialize)]
pub struct ComparedPoint {
    /// The keys that are set there, as `--set` takes them; empty without a sweep.
    pub set: Vec<String>,
    /// Pairs of runs.
    pub pairs: usize,
    /// Every figure that some pair has, by its key.
    pub figures: Vec<Compared>,
}

impl Comparison {
    /// Compares all figures, or those named.
    pub fn new(paired: &Paired<'_>, only: &[String]) -> Self {
        let keys = || figures::judged().map(|(key, _)| key);
        let is_asked = |key: &&str| only.is_empty() || only.iter().any(|asked| asked == key);
        let point = |point: &PairedPoint<'_>| ComparedPoint {
            set: point.set.clone(),
            pairs: point.pairs.len(),
            figures: keys().filter(is_asked).filter_map(|key| Compared::new(key, &point.pairs)).collect(),
        };
        let points: Vec<ComparedPoint> = paired.points.iter().map(point).collect();
        let is_worse = |key: &&str| {
            let mut figures = points.iter().flat_map(|point| &point.figures);
            figures.any(|figure| figure.key == *key && figure.verdict == Verdict::Worse)
        };
        Self {
            a: paired.a.path.clone(),
            b: paired.b.path.clone(),
            differ: paired.differ(),
            unpaired: paired.unpaired,
            confidence: 1.0 - statistics::ALPHA,
            worse: keys().filter(is_worse).map(str::to_owned).collect(),
            points,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_figure_is_refused_with_the_nearest_one() {
        let start = |unknown| refusal(unknown).lines().next().unwrap_or_default().to_owned();
        assert_eq!(start("colisions"), "--only colisions: no figure that can be worse; did you mean collisions?");
        assert_eq!(start("qqqqqqqqqqq"), "--only qqqqqqqqqqq: no figure that can be worse");
        assert!(start("duration_s").starts_with("--only duration_s: this figure is neither good nor bad"));
        let keys = |keys: &[&str]| keys.iter().map(|key| (*key).to_owned()).collect::<Vec<_>>();
        assert!(check_figures(&keys(&["collisions"])).is_ok());
        let refused = check_figures(&keys(&["collisions", "colisions"])).unwrap_err();
        assert!(matches!(&refused, Error::Refused(why) if why.starts_with("--only colisions")), "{refused}");
    }
}
