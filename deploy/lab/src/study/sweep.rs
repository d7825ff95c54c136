//! `--sweep`: which points of a scenario's space a study flies.
//!
//! Lists of values span a grid, the first key slowest. Ranges are sampled by a Latin hypercube: of N points each range has
//! exactly one in each of N equal parts, and which part goes with which is drawn. McKay, Beckman and Conover, "A Comparison
//! of Three Methods for Selecting Values of Input Variables", Technometrics 21 (1979). With both, every point of the grid
//! has all points of the hypercube.

use skein_common::math;
use skein_common::scenario::takes_whole_numbers;
use skein_core::random::{self, Purpose};

/// One `--sweep`: a key and what it is to be.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Dotted, as `--set` takes it.
    pub key: String,
    values: Values,
    /// The text of the option.
    text: String,
}

#[derive(Clone, Debug, PartialEq)]
enum Values {
    /// Each as `--set` takes it.
    List(Vec<String>),
    /// To be sampled, both ends included.
    Range { low: f64, high: f64, log: bool },
}

/// One point of a sweep: what is set there, in the order of the `--sweep`s. Without a sweep there is one, with nothing set.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Point(pub Vec<(String, String)>);

impl Point {
    /// The keys that are set here, as `--set` takes them.
    pub fn sets(&self) -> impl Iterator<Item = String> {
        self.0.iter().map(|(key, value)| format!("{key}={value}"))
    }
}

impl std::fmt::Display for Point {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.sets().collect::<Vec<_>>().join(", "))
    }
}

impl std::fmt::Display for Sweep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::str::FromStr for Sweep {
    type Err = String;

    /// Reads `key=v1,v2,...`, `key=lo..hi` or `key=lo..hi:log`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (key, values) = text.split_once('=').ok_or("key=v1,v2,... or key=lo..hi")?;
        let (key, values) = (key.trim().to_owned(), values.trim());
        if key == "seed" {
            return Err("seeds are not swept, they are --seeds A..B at every point".to_owned());
        }
        let values = match range(values) {
            Some(range) => range?,
            None => Values::List(list(values)?),
        };
        Ok(Self { key, values, text: text.to_owned() })
    }
}

/// `lo..hi` or `lo..hi:log`; `None` if it is spelled otherwise.
fn range(text: &str) -> Option<Result<Values, String>> {
    let (ends, log) = text.strip_suffix(":log").map_or((text, false), |ends| (ends, true));
    let (low, high) = ends.split_once("..")?;
    let (low, high): (f64, f64) = (low.trim().parse().ok()?, high.trim().parse().ok()?);
    Some(match () {
        () if !(low.is_finite() && high.is_finite() && low < high) => Err(format!("{ends}: the lower end comes first")),
        () if log && low <= 0.0 => Err(format!("{text}: a logarithm needs ends above zero")),
        () => Ok(Values::Range { low, high, log }),
    })
}

/// Splits at the commas outside brackets and quotes.
fn list(text: &str) -> Result<Vec<String>, String> {
    let (mut values, mut value) = (Vec::new(), String::new());
    let (mut depth, mut quote, mut is_escaped) = (0_i32, None, false);
    for c in text.chars() {
        match (quote, c) {
            (Some(_), _) if is_escaped => is_escaped = false,
            (Some('"'), '\\') => is_escaped = true,
            (Some(open), _) if c == open => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '[' | '{') => depth += 1,
            (None, ']' | '}') => depth -= 1,
            (None, ',') if depth == 0 => {
                values.push(std::mem::take(&mut value));
                continue;
            }
            (None, _) => {}
        }
        value.push(c);
    }
    values.push(value);
    let values: Vec<_> = values.iter().map(|value| value.trim().to_owned()).collect();
    match values.iter().enumerate().find(|(nth, value)| value.is_empty() || values[..*nth].contains(value)) {
        None => Ok(values),
        Some((_, value)) if value.is_empty() => Err("a value is missing".to_owned()),
        Some((_, value)) => Err(format!("{value} is listed twice")),
    }
}

/// All points of these sweeps, `samples` of the hypercube; `seed` selects them.
///
/// # Errors
/// A sentence about what does not go together.
pub fn points(sweeps: &[Sweep], samples: Option<usize>, seed: u64) -> Result<Vec<Point>, String> {
    if let Some((_, twice)) = sweeps.iter().enumerate().find(|(nth, it)| sweeps[..*nth].iter().any(|e| e.key == it.key))
    {
        return Err(format!("--sweep {}: this key is swept already", twice.key));
    }
    let range = sweeps.iter().find(|sweep| matches!(sweep.values, Values::Range { .. }));
    let samples = match (range, samples) {
        (Some(range), None) => return Err(format!("--sweep {range}: a range needs --points N")),
        (None, Some(_)) => return Err("--points: no --sweep has a range LO..HI to take them from".to_owned()),
        (_, samples) => samples.unwrap_or(1),
    };
    let mut generator = random::generator(seed, None, Purpose::Study);
    let columns: Vec<Vec<String>> = sweeps.iter().map(|sweep| sweep.column(samples, &mut generator)).collect();
    let combinations = sweeps.iter().map(Sweep::choices).try_fold(samples, usize::checked_mul);
    let combinations = combinations.filter(|&count| count <= MOST).ok_or(format!("more than {MOST} points"))?;
    let point = |nth: usize| {
        let (sample, mut rest) = (nth % samples, nth / samples);
        // The last list turns fastest.
        let mut values: Vec<(String, String)> = Vec::with_capacity(sweeps.len());
        for (sweep, column) in sweeps.iter().zip(&columns).rev() {
            let place = match sweep.values {
                Values::Range { .. } => sample,
                Values::List(_) => {
                    let place = rest % column.len();
                    rest /= column.len();
                    place
                }
            };
            values.push((sweep.key.clone(), column[place].clone()));
        }
        values.reverse();
        Point(values)
    };
    Ok((0..combinations).map(point).collect())
}

/// A sweep has at most this many points: more would take too long.
const MOST: usize = 100_000;

impl Sweep {
    /// The number of its values in the grid.
    fn choices(&self) -> usize {
        match &self.values {
            Values::List(values) => values.len(),
            Values::Range { .. } => 1,
        }
    }

    /// Its values: those of the list, or one for each sample.
    fn column(&self, samples: usize, generator: &mut impl rand::Rng) -> Vec<String> {
        let (low, high, log) = match &self.values {
            Values::List(values) => return values.clone(),
            Values::Range { low, high, log } => (*low, *high, *log),
        };
        let whole = takes_whole_numbers(&self.key);
        // Whole numbers have parts of the same size if the last one reaches to where the next number would begin.
        let end = if whole { high + 1.0 } else { high };
        let at = |share: f64| {
            let value = if log { low * math::exp(share * math::ln(end / low)) } else { low + share * (end - low) };
            let value = value.clamp(low, end);
            if whole { value.floor().min(high) } else { value }
        };
        strata(samples, generator).into_iter().map(|share| at(share).to_string()).collect()
    }
}

/// One number in each of n equal parts of [0, 1), in an order that is drawn (Fisher and Yates).
fn strata(n: usize, generator: &mut impl rand::Rng) -> Vec<f64> {
    let mut parts: Vec<usize> = (0..n).collect();
    for last in (1..n).rev() {
        parts.swap(last, (random::uniform(generator) * (last + 1) as f64) as usize);
    }
    parts.iter().map(|&part| (part as f64 + random::uniform(generator)) / n as f64).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    fn parse(text: &str) -> Result<Sweep, String> {
        text.parse()
    }

    fn sweeps(texts: &[&str]) -> Vec<Sweep> {
        texts.iter().map(|text| text.parse().unwrap()).collect()
    }

    fn column(points: &[Point], nth: usize) -> Vec<f64> {
        points.iter().map(|point| point.0[nth].1.parse().unwrap()).collect()
    }

    #[test]
    fn lists_span_a_grid_the_first_key_slowest() {
        let sweeps = sweeps(&["network.loss=0, 0.5", "preset=default,paper", "swarm.vehicles=4"]);
        let points: Vec<String> = points(&sweeps, None, 1).unwrap().iter().map(Point::to_string).collect();
        assert_eq!(
            points,
            [
                "network.loss=0, preset=default, swarm.vehicles=4",
                "network.loss=0, preset=paper, swarm.vehicles=4",
                "network.loss=0.5, preset=default, swarm.vehicles=4",
                "network.loss=0.5, preset=paper, swarm.vehicles=4",
            ]
        );
        assert_eq!(super::points(&[], None, 1).unwrap(), [Point::default()], "without a sweep there is one point");
    }

    #[test]
    fn commas_inside_brackets_and_quotes_divide_nothing() {
        let sweep = parse(r#"mission.steps[1]={ centre_ne_m = [0, 5] },{ name = "a,b", land = true }"#).unwrap();
        let Values::List(values) = sweep.values else { panic!("a list") };
        assert_eq!(values, ["{ centre_ne_m = [0, 5] }", r#"{ name = "a,b", land = true }"#]);
        assert_eq!(list(r#""a\",b",'c"',d"#).unwrap(), [r#""a\",b""#, r#"'c"'"#, "d"]);
        // `../` in a path does not make a range.
        assert!(matches!(parse("control.rules=../a,../b").unwrap().values, Values::List(values) if values.len() == 2));
    }

    #[test]
    fn a_hypercube_has_exactly_one_point_in_each_part_of_each_range() {
        let sweeps = sweeps(&["network.delay_s=0..2", "formation.gain_m=1..100:log", "network.loss=-0.5..0.5"]);
        for n in [1, 2, 7, 64] {
            let points = points(&sweeps, Some(n), 42).unwrap();
            assert_eq!(points.len(), n);
            let scales: [fn(f64) -> f64; 3] = [|x| x / 2.0, |x| math::ln(x) / math::ln(100_f64), |x| x + 0.5];
            for (nth, share) in scales.iter().enumerate() {
                let mut parts: Vec<usize> =
                    column(&points, nth).iter().map(|&x| (share(x) * n as f64) as usize).collect();
                parts.sort_unstable();
                assert_eq!(parts, (0..n).collect::<Vec<_>>(), "range {nth} of {n} points");
            }
        }
        let [one, same, other] = [42, 42, 43].map(|seed| points(&sweeps, Some(20), seed).unwrap());
        assert_eq!(one, same);
        assert_ne!(one, other, "another seed samples elsewhere");
        assert_ne!(
            column(&one, 0).iter().map(|x| (x * 10.0) as u32).collect::<Vec<_>>(),
            (0..20).collect::<Vec<_>>(),
            "the parts are mixed"
        );
    }

    #[test]
    fn whole_numbers_are_sampled_evenly_with_both_ends() {
        for (text, numbers) in [("swarm.vehicles=3..6", 4), ("swarm.vehicles=4..11:log", 8)] {
            let points = points(&sweeps(&[text]), Some(400), 1).unwrap();
            let mut counts = std::collections::BTreeMap::new();
            points.iter().for_each(|point| *counts.entry(point.0[0].1.parse::<u32>().unwrap()).or_insert(0) += 1);
            assert_eq!(counts.len(), numbers, "{counts:?}");
            assert!(text.ends_with("log") || counts.values().all(|&count| count == 100), "{counts:?}");
        }
    }

    #[test]
    fn a_grid_of_hypercubes_repeats_the_same_samples() {
        let points = points(&sweeps(&["network.delay_s=0..1", "swarm.vehicles=4,8"]), Some(3), 5).unwrap();
        assert_eq!(points.len(), 6);
        assert_eq!(column(&points, 1), [4.0, 4.0, 4.0, 8.0, 8.0, 8.0]);
        let delays = column(&points, 0);
        assert_eq!(delays[..3], delays[3..]);
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        for (text, why) in [
            ("network.loss", "key=v1,v2"),
            ("network.loss=", "missing"),
            ("network.loss=0,,1", "missing"),
            ("network.loss=0,0.1,0", "0 is listed twice"),
            ("network.loss=0.5..0.1", "the lower end comes first"),
            ("network.loss=0..1:log", "above zero"),
            ("seed=1,2", "--seeds"),
        ] {
            let refused = parse(text).unwrap_err();
            assert!(refused.contains(why), "{text}: {refused}");
        }
        let refused = |texts: &[&str], n| points(&sweeps(texts), n, 0).unwrap_err();
        assert!(refused(&["network.loss=0..1"], None).contains("needs --points"));
        assert!(refused(&["network.loss=0,1"], Some(5)).contains("no --sweep has a range"));
        assert!(refused(&["network.loss=0,1", "network.loss=0..1"], Some(5)).contains("swept already"));
        assert!(refused(&["network.loss=0..1", "formation.gain_m=1,2"], Some(60_000)).contains("more than 100000"));
    }

    /// Sweeps of different keys: of each how many values it has, or none for a range.
    fn grid(choices: &[Option<usize>]) -> Vec<Sweep> {
        let sweep = |(key, choices): (usize, &Option<usize>)| match choices {
            Some(count) => format!("key{key}={}", (0..*count).map(|n| n.to_string()).collect::<Vec<_>>().join(",")),
            None => format!("key{key}=0..1"),
        };
        choices.iter().enumerate().map(|choices| sweep(choices).parse().unwrap()).collect()
    }

    proptest! {
        #[test]
        fn a_grid_has_every_combination_once_in_order(counts in prop::collection::vec(1_usize..5, 0..5)) {
            let points = points(&grid(&counts.iter().copied().map(Some).collect::<Vec<_>>()), None, 1).unwrap();
            prop_assert_eq!(points.len(), counts.iter().product::<usize>());
            let numbers: Vec<Vec<usize>> =
                points.iter().map(|point| point.0.iter().map(|(_, value)| value.parse().unwrap()).collect()).collect();
            prop_assert!(numbers.is_sorted() && numbers.iter().collect::<BTreeSet<_>>().len() == numbers.len());
            let keys: Vec<String> = (0..counts.len()).map(|key| format!("key{key}")).collect();
            prop_assert!(points.iter().all(|point| point.0.iter().map(|(key, _)| key).eq(&keys)));
        }

        #[test]
        fn the_text_of_a_point_gives_back_what_is_set(values in prop::collection::vec("[a-z0-9=.\\[\\]{} ]{1,9}", 1..4)) {
            let set: Vec<_> = values.iter().enumerate().map(|(nth, value)| (format!("a.k{nth}"), value.clone())).collect();
            let point = Point(set.clone());
            let read: Vec<_> = point.sets().map(|set| set.split_once('=').map(|(key, value)| (key.to_owned(), value.to_owned()))).collect();
            prop_assert_eq!(read, set.into_iter().map(Some).collect::<Vec<_>>());
        }

        #[test]
        fn a_list_gives_back_its_values(values in prop::collection::btree_set("[a-z0-9]{1,4}|\\[[0-9, ]{1,6}\\]|\"[a-z,]{1,4}\"", 1..6)) {
            let values: Vec<String> = values.into_iter().collect();
            let text = format!("key={}", values.join(","));
            let sweep = parse(&text).unwrap();
            prop_assert_eq!((sweep.to_string(), sweep.values), (text, Values::List(values)));
        }

        #[test]
        fn samples_of_a_range_are_inside_it_and_one_in_each_part(
            low in -1e3..1e3, width in 0.1..1e3, n in 1_usize..40, seed in 0_u64..9,
        ) {
            let points = points(&[parse(&format!("network.delay_s={low}..{}", low + width)).unwrap()], Some(n), seed).unwrap();
            let mut shares: Vec<f64> = column(&points, 0).iter().map(|value| (value - low) / width * n as f64).collect();
            shares.sort_by(f64::total_cmp);
            let is_in_part = |(nth, share): (usize, &f64)| (nth as f64 - 1e-9..=nth as f64 + 1.0 + 1e-9).contains(share);
            prop_assert!(shares.len() == n && shares.iter().enumerate().all(is_in_part), "{:?}", shares);
        }

        #[test]
        fn every_point_of_a_grid_has_all_points_of_the_hypercube(
            choices in prop::collection::vec(prop::option::of(1_usize..4), 1..5), n in 1_usize..6,
        ) {
            let has_range = choices.contains(&None);
            let points = points(&grid(&choices), has_range.then_some(n), 3).unwrap();
            let samples = if has_range { n } else { 1 };
            prop_assert_eq!(points.len(), samples * choices.iter().flatten().product::<usize>());
            let sampled = |point: &Point| -> Vec<String> {
                let ranges = point.0.iter().zip(&choices).filter(|(_, choices)| choices.is_none());
                ranges.map(|((_, value), _)| value.clone()).collect()
            };
            let first: Vec<_> = points[..samples].iter().map(sampled).collect();
            prop_assert!(points.chunks(samples).all(|chunk| chunk.iter().map(sampled).eq(first.iter().cloned())));
        }
    }
}
