//! A study's verdict: how many runs did what they should, and which ones did not.

use super::summary::FAILURE;
use super::sweep::Point;
use crate::metrics::{Measured, Outcome, limits};
use crate::scenario::ScenarioArgs;

/// The verdict names at most this many seeds of one kind of failure.
const MAX_SEEDS: usize = 8;
/// The figures that have a value when every vehicle is in formation at the end of the run: at its altitude, in the band, and at an
/// even gap.
const IN_FORMATION: [&str; 3] = ["at_altitude_s", "in_band_s", "even_10deg_s"];
/// Beside each of them a figure that has a value only if the formation has such a thing as an altitude, a band or gaps.
const HAS: [&str; 3] = ["altitude_rms_m", "in_band_s", "spacing_error_deg"];

/// A way in which a run can fail: the text after "4 of 100 runs", and whether a run has failed so.
type Failure = (&'static str, fn(&Measured) -> bool);

const FAILURES: [Failure; 11] = [
    ("not flown to the end", |run| run.texts.contains_key(FAILURE)),
    ("with a collision", |run| is_above(run, "collisions", Some(0.0))),
    ("with a crash", |run| is_above(run, "crashes", Some(0.0))),
    ("with a vehicle out of formation at the end", |run| IN_FORMATION.iter().any(|key| never(run, key))),
    (HEADING_LOST, |run| is_uncontrolled(run, "heading_error_rms_deg")),
    (AT_STOPS, |run| is_uncontrolled(run, "stick_saturation")),
    (FALLBACK, |run| is_uncontrolled(run, "fallback_share")),
    ("with a lost peer that was not detected within 30 s", |run| never(run, "detection_s")),
    ("with a returned peer that was not rejoined within 30 s", |run| never(run, "rejoin_s")),
    ("with a failure that its vehicle did not report", |run| never(run, "response_s")),
    ("not back in formation 120 s after a change", |run| never(run, "transient_s")),
];

/// The texts of runs with a vehicle that is not under control, or not flown by its law.
const HEADING_LOST: &str = "with a vehicle that does not keep its heading";
const AT_STOPS: &str = "with controls at their stops";
const FALLBACK: &str = "with the fallback in the place of the external law";

fn is_uncontrolled(run: &Measured, key: &str) -> bool {
    is_above(run, key, limits::of_every_run(key))
}

fn is_above(run: &Measured, key: &str, limit: Option<f64>) -> bool {
    run.value(key).zip(limit).is_some_and(|(value, limit)| value > limit)
}

/// The details of a failure with this text: which vehicles, how far they were beyond which limit; empty for other
/// failures.
pub(crate) fn detail(run: &Measured, text: &str) -> String {
    let (key, shown): (_, fn(f64) -> String) = match text {
        HEADING_LOST => ("heading_error_rms_deg", |value| format!("{value:.0}° root mean square")),
        AT_STOPS => ("stick_saturation", |value| format!("{:.0} % of the time", 100.0 * value)),
        FALLBACK => ("fallback_share", |value| format!("{:.0} % of the time", 100.0 * value)),
        _ => return String::new(),
    };
    let Some((limit, worst)) = limits::of_every_run(key).zip(run.value(key)) else { return String::new() };
    let vehicles: Vec<String> =
        run.uncontrolled.iter().filter(|(_, its, _)| *its == key).map(|(id, ..)| id.clone()).collect();
    let who = match vehicles.as_slice() {
        [] => String::new(),
        [one] => format!("vehicle {one}: "),
        many => format!("vehicles {}: up to ", list(many)),
    };
    format!(" ({who}{}, at most {})", shown(worst), shown(limit).trim_end_matches(" root mean square"))
}

/// Whether every vehicle kept its heading, had travel left in its controls and was flown by its law.
///
/// # Errors
/// The vehicles that did not, by how much, and the limit.
pub fn under_control(run: &Measured) -> Result<(), String> {
    let lost = failures(run).filter(|text| [HEADING_LOST, AT_STOPS, FALLBACK].contains(text));
    let lost: Vec<String> = lost.map(|text| format!("a flight {text}{}", detail(run, text))).collect();
    if lost.is_empty() { Ok(()) } else { Err(lost.join("; ")) }
}

/// The ways in which a run has failed, each as a text such as "with a collision".
pub(crate) fn failures(run: &Measured) -> impl Iterator<Item = &'static str> + '_ {
    FAILURES.iter().filter(|(_, is_it)| is_it(run)).map(|(text, _)| *text)
}

fn never(run: &Measured, key: &str) -> bool {
    run.outcome(key) == Some(Outcome::Never)
}

/// The verdict in a line, then a line for each kind of failure with its seeds and the command that flies the first one live.
/// `runs` are those of the first point, then those of the next.
pub(super) fn verdict(scenario: &ScenarioArgs, points: &[Point], runs: &[Measured]) -> String {
    let good = |run: &&Measured| failures(run).next().is_none();
    let all_good: Vec<&Measured> = runs.iter().filter(good).collect();
    let results = || achievements(&all_good).join(", ");
    let mut text = match runs {
        [_] if all_good.is_empty() => String::new(),
        [run] => format!("seed {}: {}\n", run.seed, results()),
        runs if all_good.is_empty() => format!("every one of the {} runs has failed\n", runs.len()),
        runs => format!("{} of {} runs: {}\n", all_good.len(), runs.len(), results()),
    };
    for (failure, is_it) in &FAILURES {
        let failed: Vec<usize> = (0..runs.len()).filter(|&nth| is_it(&runs[nth])).collect();
        let Some(first) = failed.first() else { continue };
        let point_of = |nth: usize| nth * points.len() / runs.len();
        let seeds = if points.len() > 1 {
            let place = |nth: usize| format!("point {} seed {}", point_of(nth) + 1, runs[nth].seed);
            list(&failed.iter().map(|&nth| place(nth)).collect::<Vec<_>>())
        } else {
            let plural = if failed.len() > 1 { "s" } else { "" };
            let seeds: Vec<String> = failed.iter().map(|&nth| runs[nth].seed.to_string()).collect();
            format!("seed{plural} {}", list(&seeds))
        };
        let set = points.get(point_of(*first)).map(|point| point.0.as_slice()).unwrap_or_default();
        let command = scenario.command("fly", set, Some(runs[*first].seed));
        let detail = detail(&runs[*first], failure);
        text += &match runs {
            [run] => format!("seed {} failed, {failure}{detail}: {command}\n", run.seed),
            runs => format!("{} of {} runs {failure}, {seeds}{detail}: {command}\n", failed.len(), runs.len()),
        };
    }
    text
}

/// The things that all of these runs have achieved, as far as their figures show it.
pub(crate) fn achievements(runs: &[&Measured]) -> Vec<String> {
    let mut results = Vec::new();
    let all_have = |key: &str| runs.iter().all(|run| run.value(key).is_some());
    for (key, what) in [("collisions", "no collision"), ("crashes", "no crash")] {
        results.extend(all_have(key).then(|| what.to_owned()));
    }
    let none_has = |key: &str| runs.iter().all(|run| run.outcome(key).is_none());
    let is_in_band = all_have("in_band_s");
    let is_in_formation = is_in_band && IN_FORMATION.iter().zip(HAS).all(|(key, has)| all_have(key) || none_has(has));
    if is_in_formation {
        results.push("every vehicle in formation".to_owned());
    } else if all_have("at_altitude_s") {
        results.push("every vehicle at its altitude".to_owned());
    }
    let steps = runs.iter().filter_map(|run| run.value("setpoints_reached"));
    let mut steps: Vec<f64> = steps.collect();
    steps.sort_by(f64::total_cmp);
    // A mission of one step is over when the formation is there.
    let has_mission = steps.len() == runs.len() && steps.last() > Some(&1.0);
    if let (Some(first), Some(last), true) = (steps.first(), steps.last(), has_mission) {
        let steps = if first == last { format!("{first}") } else { format!("{first} to {last}") };
        results.push(format!("{steps} mission steps reached"));
    }
    if results.is_empty() {
        results.push("without a measured failure".to_owned());
    }
    results
}

/// `1, 2 and 5`; of many the first ones.
pub(crate) fn list(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [only] => only.clone(),
        items if items.len() > MAX_SEEDS => {
            format!("{} and {} more", items[..MAX_SEEDS].join(", "), items.len() - MAX_SEEDS)
        }
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
pub(crate) mod tests;
