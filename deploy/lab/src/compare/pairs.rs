//! Pairs each run of one side with that of the other to which it belongs.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value, json};

use super::folder::{Flown, Folder};
use crate::error::Error;

/// A run of either side, equal in what pairs them.
pub type Pair<'a> = [&'a Flown; 2];

/// Pairs whose scenarios are the same within each side, but for the seed.
#[derive(Clone, Debug)]
pub struct PairedPoint<'a> {
    /// The keys that are set there, as `--set` takes them; empty without a sweep.
    pub set: Vec<String>,
    /// In the order of A's folders.
    pub pairs: Vec<Pair<'a>>,
}

/// Two folders, run by run.
#[derive(Clone, Debug)]
pub struct Paired<'a> {
    /// The runs to compare with.
    pub a: &'a Folder,
    /// The runs that are judged.
    pub b: &'a Folder,
    /// At least one.
    pub points: Vec<PairedPoint<'a>>,
    /// Runs without a partner, in A and in B.
    pub unpaired: [usize; 2],
}

/// The identity by which a run is paired: the values of the keys that vary on both sides, and its seed.
type Identity<'a> = (Vec<Option<&'a str>>, u64);

impl<'a> Paired<'a> {
    /// Pairs the runs.
    ///
    /// # Errors
    /// If runs cannot be paired unambiguously, or the sides have no seed in common.
    pub fn new(a: &'a Folder, b: &'a Folder) -> Result<Self, Error> {
        let varying: BTreeSet<&str> = a.varying().intersection(&b.varying()).copied().collect();
        let [of_a, of_b] = [by_identity(a, &varying)?, by_identity(b, &varying)?];
        let mut points: Vec<(Vec<Option<&str>>, PairedPoint<'a>)> = Vec::new();
        // In the order of A's folders.
        for run in &a.runs {
            let identity = identity(run, &varying);
            let Some(partner) = of_b.get(&identity) else { continue };
            let point = match points.iter().position(|(values, _)| *values == identity.0) {
                Some(point) => point,
                None => {
                    points.push((identity.0, PairedPoint { set: set(run, &varying, &a.swept), pairs: Vec::new() }));
                    points.len() - 1
                }
            };
            points[point].1.pairs.push([run, *partner]);
        }
        let points: Vec<PairedPoint<'_>> = points.into_iter().map(|(_, point)| point).collect();
        let paired: usize = points.iter().map(|point| point.pairs.len()).sum();
        if paired == 0 {
            let why = "no run of one has a partner of equal seed in the other";
            let varying = varying.iter().copied().collect::<Vec<_>>().join(", ");
            let why = if varying.is_empty() { why.to_owned() } else { format!("{why} that is equal in {varying}") };
            return Err(Error::Refused(format!("{} and {}: {why}", a.path.display(), b.path.display())));
        }
        Ok(Self { a, b, points, unpaired: [of_a.len() - paired, of_b.len() - paired] })
    }

    /// All pairs.
    pub fn pairs(&self) -> impl Iterator<Item = Pair<'a>> {
        self.points.iter().flat_map(|point| point.pairs.iter().copied())
    }

    /// Keys that are one thing all over A and another all over B.
    pub fn differ(&self) -> Map<String, Value> {
        let keys = self.a.runs.iter().take(1).chain(self.b.runs.iter().take(1)).flat_map(|run| run.scenario.keys());
        let keys: BTreeSet<&String> = keys.collect();
        let differs = |key: &String| {
            let (a, b) = (self.a.constant(key)?, self.b.constant(key)?);
            (a != b).then(|| (key.clone(), json!([a, b])))
        };
        keys.into_iter().filter_map(differs).collect()
    }

    /// The two sides and how they differ, for people.
    pub fn heading(&self) -> String {
        let side = |name: &str, folder: &Folder| {
            let texts = ["scenario", "target", "plant", "version", "revision"];
            let texts = texts.map(|key| folder.texts(key).into_iter().collect::<Vec<_>>().join("/"));
            format!("{name}  {}: {} runs, {}\n", folder.path.display(), folder.runs.len(), texts.join(" "))
        };
        let mut text = side("A", self.a) + &side("B", self.b);
        let differ = self.differ();
        for (key, values) in differ.iter().take(SHOWN) {
            let [a, b] = [0, 1].map(|nth| values[nth].as_str().unwrap_or("none"));
            text += &format!("   {key}: A {a}, B {b}\n");
        }
        if differ.len() > SHOWN {
            text += &format!("   and {} more\n", differ.len() - SHOWN);
        }
        if self.unpaired != [0, 0] {
            let [a, b] = self.unpaired;
            text += &format!("Left out, without a partner of equal seed: {a} runs of A, {b} of B\n");
        }
        text
    }
}

/// So many differing keys are named.
const SHOWN: usize = 8;

fn identity<'a>(run: &'a Flown, varying: &BTreeSet<&str>) -> Identity<'a> {
    (varying.iter().map(|&key| run.scenario.get(key).map(String::as_str)).collect(), run.measured.seed)
}

fn by_identity<'a>(folder: &'a Folder, varying: &BTreeSet<&str>) -> Result<BTreeMap<Identity<'a>, &'a Flown>, Error> {
    let mut found: BTreeMap<Identity<'a>, &'a Flown> = BTreeMap::new();
    for run in &folder.runs {
        if let Some(other) = found.insert(identity(run, varying), run) {
            let differ = |key: &&String| run.scenario.get(*key) != other.scenario.get(*key);
            let differ: Vec<&str> = run.scenario.keys().filter(differ).map(String::as_str).take(SHOWN).collect();
            let why = match differ.as_slice() {
                [] => "are the same flight; leave one out".to_owned(),
                keys => format!("differ in {}, which the other side does not vary", keys.join(", ")),
            };
            let [one, other] = [other, run].map(|run| run.folder.display().to_string());
            return Err(Error::Refused(format!("two runs of seed {}: {one} and {other} {why}", run.measured.seed)));
        }
    }
    Ok(found)
}

/// The keys that are set at a run's point: the swept ones if a study names them, else all that vary.
fn set(run: &Flown, varying: &BTreeSet<&str>, swept: &[String]) -> Vec<String> {
    let keys = swept.iter().flat_map(|swept| Folder::below(swept, varying.iter().copied()));
    let keys: Vec<&str> = match keys.collect::<Vec<_>>() {
        keys if keys.is_empty() => varying.iter().copied().collect(),
        keys => keys,
    };
    keys.iter().filter_map(|&key| run.scenario.get(key).map(|value| format!("{key}={value}"))).collect()
}
