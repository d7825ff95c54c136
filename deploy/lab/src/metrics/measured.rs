//! The figures of one run as in its `metrics.json`, just flown or read back: the basis of summaries, comparisons and the
//! choice of runs to look at.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use super::{Direction, figures, limits};

/// The figures of one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// Seed of all randomness.
    pub seed: u64,
    /// The texts about the run, by key: the scenario's name, `target`, `plant`, `version` and so on.
    pub texts: BTreeMap<String, String>,
    /// Every figure by its key; `None` where it does not apply or never came.
    pub figures: BTreeMap<String, Option<f64>>,
    /// Keys of what could have happened and never did.
    pub never: BTreeSet<String>,
    /// The vehicles that were not under control or not flown by their law: id, key and value of a figure beyond
    /// [`limits::OF_EVERY_RUN`].
    pub uncontrolled: Vec<(String, &'static str, f64)>,
}

/// A figure that one run has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// It has this value.
    Value(f64),
    /// It never came to one.
    Never,
}

impl Outcome {
    /// The value, or this number in its place if the figure never came to one.
    pub fn or(self, never: f64) -> f64 {
        match self {
            Self::Value(value) => value,
            Self::Never => never,
        }
    }
}

impl Measured {
    /// The figures of a report as [`Measured::read`] gives them back once it is written.
    pub fn of(report: &impl Serialize) -> Self {
        #[expect(clippy::expect_used, reason = "what we write we can read")]
        Self::read(&crate::terminal::json(report)).expect("a report is a metrics.json")
    }

    /// Reads a `metrics.json`. Every number is the very one that was written: serde_json's own reading may miss by a bit.
    ///
    /// # Errors
    /// A sentence about what the text is not.
    pub fn read(text: &str) -> Result<Self, String> {
        let Ok(Value::Object(keys)) = serde_json::from_str(text) else {
            return Err("not a JSON object".to_owned());
        };
        let seed = keys.get("seed").and_then(Value::as_u64).ok_or("it has no seed")?;
        let exact: BTreeMap<&str, f64> = text.lines().filter_map(exact).collect();
        let mut measured =
            Self { seed, uncontrolled: keys.get("vehicle").map(uncontrolled).unwrap_or_default(), ..Self::default() };
        for (key, value) in keys {
            match value {
                Value::String(message) => _ = measured.texts.insert(key, message),
                Value::Array(never) if key == "never" => {
                    measured.never = never.iter().filter_map(|key| key.as_str().map(str::to_owned)).collect();
                }
                Value::Number(_) | Value::Null if key != "seed" && key != "vehicles" => {
                    let number = exact.get(key.as_str()).copied().or(value.as_f64());
                    measured.figures.insert(key, number);
                }
                _ => {}
            }
        }
        Ok(measured)
    }

    /// The value of a figure; `None` if it does not apply to the run or never came.
    pub fn value(&self, key: &str) -> Option<f64> {
        self.figures.get(key).copied().flatten()
    }

    /// A figure, if it applies to the run.
    pub fn outcome(&self, key: &str) -> Option<Outcome> {
        match self.value(key) {
            Some(value) => Some(Outcome::Value(value)),
            None => self.never.contains(key).then_some(Outcome::Never),
        }
    }

    /// The badness of a figure, to be compared with that of other runs: more is worse, and an event that never came is worst.
    fn badness(&self, key: &str) -> f64 {
        let sign = if is_worse(key) == Some(Direction::Less) { -1.0 } else { 1.0 };
        self.outcome(key).map_or(f64::NEG_INFINITY, |outcome| sign * outcome.or(sign * f64::INFINITY))
    }
}

/// The figures of vehicles that are beyond the limits of every run.
fn uncontrolled(vehicles: &Value) -> Vec<(String, &'static str, f64)> {
    let mut all: Vec<(u32, &'static str, f64)> = Vec::new();
    for (id, figures) in vehicles.as_object().into_iter().flatten() {
        for (key, limit) in limits::OF_EVERY_RUN {
            let value = figures.get(key).and_then(Value::as_f64).filter(|value| *value > limit);
            all.extend(id.parse().ok().zip(value).map(|(id, value)| (id, key, value)));
        }
    }
    all.sort_by_key(|(id, ..)| *id);
    all.into_iter().map(|(id, key, value)| (id.to_string(), key, value)).collect()
}

/// A line of a `metrics.json` that holds a figure of the swarm.
fn exact(line: &str) -> Option<(&str, f64)> {
    let (key, value) = line.strip_prefix("  \"")?.split_once("\": ")?;
    Some((key, value.trim_end_matches(',').parse().ok()?))
}

/// Whether more or less of a figure is worse; `None` for what is neither good nor bad.
pub fn is_worse(key: &str) -> Option<Direction> {
    figures::of(key)?.worse
}

/// The figures that decide which of two runs is the worse one when neither has more collisions and crashes, nor more
/// that never happened: the first of these that differs. A mission's progress and length, how soon the formation stood,
/// how well.
const TELLING: [&str; 8] = [
    "setpoints_reached",
    "duration_s",
    "even_10deg_s",
    "in_band_s",
    "transient_s",
    "max_centre_distance_m",
    "radial_rms_m",
    "min_separation_m",
];

/// The better of two runs of the same scenario first; of equal ones the lower seed.
fn by_worth(one: &Measured, other: &Measured) -> Ordering {
    let wrecks = |run: &Measured| ["collisions", "crashes"].map(|key| run.badness(key).max(0.0)).iter().sum::<f64>();
    let by = |key: &str| one.badness(key).total_cmp(&other.badness(key));
    let telling = || TELLING.iter().map(|key| by(key)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal);
    let never = one.never.len().cmp(&other.never.len());
    wrecks(one).total_cmp(&wrecks(other)).then(never).then_with(telling).then(one.seed.cmp(&other.seed))
}

/// The seeds of the runs to look at among those of one scenario: the worst, and the middle one of all from best to worst
/// (of an even number the better of the two). `None` without runs.
pub fn worst_and_median(runs: &[Measured]) -> Option<(u64, u64)> {
    let mut ranked: Vec<&Measured> = runs.iter().collect();
    ranked.sort_by(|one, other| by_worth(one, other));
    Some((ranked.last()?.seed, ranked[(ranked.len() - 1) / 2].seed))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(seed: u64, figures: &[(&str, f64)], never: &[&str]) -> Measured {
        Measured {
            seed,
            texts: BTreeMap::new(),
            figures: figures.iter().map(|(key, value)| ((*key).to_owned(), Some(*value))).collect(),
            never: never.iter().map(|key| (*key).to_owned()).collect(),
            uncontrolled: Vec::new(),
        }
    }

    #[test]
    fn numbers_are_read_to_the_last_bit() {
        // serde_json without its feature `float_roundtrip` reads some of these a bit off.
        let mut rng = skein_core::random::generator(1, None, skein_core::random::Purpose::Start);
        for _ in 0..2_000 {
            let value = skein_core::random::standard_normal(&mut rng) * 1e3;
            let text = crate::terminal::json(
                &serde_json::json!({ "seed": 1, "a_m": value, "vehicle": { "1": { "a_m": 7.5 } } }),
            );
            assert_eq!(Measured::read(&text).unwrap().figures["a_m"], Some(value), "{text}");
        }
        let spread =
            Measured::read("{\"seed\":3,\"never\":[\"b_s\"],\"b_s\":null,\"a\":[1,\n2],\"target\":\"fly\"}").unwrap();
        assert_eq!((spread.seed, spread.outcome("b_s"), spread.outcome("c")), (3, Some(Outcome::Never), None));
        assert_eq!((spread.texts["target"].as_str(), spread.figures.len()), ("fly", 1));
        assert!(Measured::read("[]").is_err() && Measured::read("{}").is_err() && Measured::read("{").is_err());
    }

    #[test]
    fn a_crash_is_as_bad_as_a_collision() {
        let wrecks = |seed, collisions, crashes| run(seed, &[("collisions", collisions), ("crashes", crashes)], &[]);
        let whole = [wrecks(1, 0.0, 0.0), run(2, &[("collisions", 0.0)], &["even_10deg_s"])];
        let crashed = [wrecks(3, 0.0, 2.0), wrecks(4, 1.0, 0.0)];
        let runs = [&whole[..], &crashed].concat();
        assert_eq!(worst_and_median(&runs), Some((3, 2)));
        assert_eq!(worst_and_median(&runs[1..]), Some((3, 4)));
    }

    #[test]
    fn the_worst_run_has_collided_then_never_settled_then_settled_late() {
        let runs = [
            run(1, &[("collisions", 0.0), ("even_10deg_s", 50.0)], &[]),
            run(2, &[("collisions", 1.0), ("even_10deg_s", 10.0)], &[]),
            run(3, &[("collisions", 0.0), ("even_10deg_s", 90.0)], &[]),
            run(4, &[("collisions", 0.0)], &["even_10deg_s"]),
            run(5, &[("collisions", 0.0), ("even_10deg_s", 50.0), ("min_separation_m", 9.0)], &[]),
        ];
        // From best to worst: 1 (a separation that was not measured ranks first), 5, 3, 4, 2.
        assert_eq!(worst_and_median(&runs), Some((2, 3)));
        assert_eq!(worst_and_median(&runs[..1]), Some((1, 1)));
        let without_collision = [runs[0].clone(), runs[2].clone(), runs[3].clone(), runs[4].clone()];
        assert_eq!(worst_and_median(&without_collision), Some((4, 5)));
        assert_eq!(worst_and_median(&[]), None);
        let far = |seed, reached| run(seed, &[("setpoints_reached", reached)], &[]);
        assert_eq!(worst_and_median(&[far(1, 5.0), far(2, 6.0), far(3, 6.0)]), Some((1, 3)), "less is worse");
    }
}
