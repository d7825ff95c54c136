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

/// A way in which a run can fail, with the text after "4 of 100 runs".
struct Failure {
    text: &'static str,
    is_it: fn(&Measured) -> bool,
}

const FAILURES: [Failure; 11] = [
    Failure { text: "not flown to the end", is_it: |run| run.texts.contains_key(FAILURE) },
    Failure { text: "with a collision", is_it: |run| is_above_zero(run, "collisions") },
    Failure { text: "with a crash", is_it: |run| is_above_zero(run, "crashes") },
    Failure {
        text: "with a vehicle out of formation at the end",
        is_it: |run| IN_FORMATION.iter().any(|key| run.outcome(key) == Some(Outcome::Never)),
    },
    Failure { text: HEADING_LOST, is_it: |run| is_uncontrolled(run, "heading_error_rms_deg") },
    Failure { text: AT_STOPS, is_it: |run| is_uncontrolled(run, "stick_saturation") },
    Failure { text: FALLBACK, is_it: |run| is_uncontrolled(run, "fallback_share") },
    Failure { text: "with a lost peer that was not detected within 30 s", is_it: |run| never(run, "detection_s") },
    Failure { text: "with a returned peer that was not rejoined within 30 s", is_it: |run| never(run, "rejoin_s") },
    Failure { text: "with a failure that its vehicle did not report", is_it: |run| never(run, "response_s") },
    Failure { text: "not back in formation 120 s after a change", is_it: |run| never(run, "transient_s") },
];

/// The texts of runs with a vehicle that is not under control, or not flown by its law.
const HEADING_LOST: &str = "with a vehicle that does not keep its heading";
const AT_STOPS: &str = "with controls at their stops";
const FALLBACK: &str = "with the fallback in the place of the external law";

fn is_uncontrolled(run: &Measured, key: &str) -> bool {
    let limit = limits::of_every_run(key);
    matches!((run.outcome(key), limit), (Some(Outcome::Value(value)), Some(limit)) if value > limit)
}

/// Of a failure with this text: which vehicles, how far they were beyond which limit; empty for other failures.
pub(crate) fn detail(run: &Measured, text: &str) -> String {
    let (key, shown): (_, fn(f64) -> String) = match text {
        HEADING_LOST => ("heading_error_rms_deg", |value| format!("{value:.0}° root mean square")),
        AT_STOPS => ("stick_saturation", |value| format!("{:.0} % of the time", 100.0 * value)),
        FALLBACK => ("fallback_share", |value| format!("{:.0} % of the time", 100.0 * value)),
        _ => return String::new(),
    };
    let Some((limit, Outcome::Value(worst))) = limits::of_every_run(key).zip(run.outcome(key)) else {
        return String::new();
    };
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
/// Which vehicles did not, by how much, and the limit.
pub fn under_control(run: &Measured) -> Result<(), String> {
    let lost = failures(run).filter(|text| [HEADING_LOST, AT_STOPS, FALLBACK].contains(text));
    let lost: Vec<String> = lost.map(|text| format!("a flight {text}{}", detail(run, text))).collect();
    if lost.is_empty() { Ok(()) } else { Err(lost.join("; ")) }
}

/// The ways in which a run has failed, each as a text such as "with a collision".
pub(crate) fn failures(run: &Measured) -> impl Iterator<Item = &'static str> + '_ {
    FAILURES.iter().filter(|failure| (failure.is_it)(run)).map(|failure| failure.text)
}

fn is_above_zero(run: &Measured, key: &str) -> bool {
    matches!(run.outcome(key), Some(Outcome::Value(value)) if value > 0.0)
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
    for failure in &FAILURES {
        let failed: Vec<usize> = (0..runs.len()).filter(|&nth| (failure.is_it)(&runs[nth])).collect();
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
        let detail = detail(&runs[*first], failure.text);
        text += &match runs {
            [run] => format!("seed {} failed, {}{detail}: {command}\n", run.seed, failure.text),
            runs => format!("{} of {} runs {}, {seeds}{detail}: {command}\n", failed.len(), runs.len(), failure.text),
        };
    }
    text
}

/// What all of these runs have achieved, as far as their figures show it.
pub(crate) fn achievements(runs: &[&Measured]) -> Vec<String> {
    let mut results = Vec::new();
    let all_have = |key: &str| runs.iter().all(|run| matches!(run.outcome(key), Some(Outcome::Value(_))));
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
    let steps = runs.iter().filter_map(|run| run.figures.get("setpoints_reached").copied().flatten());
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
mod tests {
    use super::*;

    fn run(seed: u64, figures: &str) -> Measured {
        Measured::read(&format!("{{\"seed\":{seed},{figures}}}")).unwrap()
    }

    const GOOD: &str = r#""collisions":0,"crashes":0,"at_altitude_s":17.5,"in_band_s":20,"even_10deg_s":60"#;
    const COLLIDED: &str = r#""collisions":1,"crashes":0,"at_altitude_s":17.5,"in_band_s":20,"even_10deg_s":60"#;
    const NEVER: &str = r#""collisions":0,"crashes":2,"in_band_s":null,"never":["in_band_s"]"#;

    fn of(runs: &[Measured]) -> String {
        let scenario =
            ScenarioArgs { scenario: Some("my tour.toml".into()), sets: vec!["network.loss=0.3".to_owned()] };
        verdict(&scenario, &[Point::default()], runs)
    }

    #[test]
    fn a_verdict_of_good_runs_is_one_line() {
        let runs: Vec<Measured> = (0..100).map(|seed| run(seed, GOOD)).collect();
        assert_eq!(of(&runs), "100 of 100 runs: no collision, no crash, every vehicle in formation\n");
        assert_eq!(of(&runs[3..4]), "seed 3: no collision, no crash, every vehicle in formation\n");
    }

    #[test]
    fn a_failed_run_is_named_with_the_command_that_flies_it() {
        let runs = [run(0, GOOD), run(4, COLLIDED), run(5, NEVER), run(17, COLLIDED)];
        let command = "skein fly 'my tour.toml' --set network.loss=0.3 --seed";
        let expected = format!(
            "1 of 4 runs: no collision, no crash, every vehicle in formation\n\
             2 of 4 runs with a collision, seeds 4 and 17: {command} 4\n\
             1 of 4 runs with a crash, seed 5: {command} 5\n\
             1 of 4 runs with a vehicle out of formation at the end, seed 5: {command} 5\n"
        );
        assert_eq!(of(&runs), expected);
        assert_eq!(of(&runs[1..2]), format!("seed 4 failed, with a collision: {command} 4\n"));
    }

    #[test]
    fn a_run_whose_vehicles_spin_or_are_at_their_stops_has_failed_and_names_them() {
        let spinning = |seed: u64| {
            let vehicle = |heading: f64, stops: f64| {
                format!(r#"{{"heading_error_rms_deg":{heading},"stick_saturation":{stops}}}"#)
            };
            let vehicles = [vehicle(2.0, 0.0), vehicle(103.9, 1.0), vehicle(60.0, 0.4)];
            let [one, two, three] = &vehicles;
            let figures = r#""heading_error_rms_deg":103.9,"stick_saturation":1.0"#;
            run(seed, &format!(r#"{GOOD},{figures},"vehicle":{{"1":{one},"10":{two},"3":{three}}}"#))
        };
        let command = "skein fly 'my tour.toml' --set network.loss=0.3 --seed";
        let heading = "with a vehicle that does not keep its heading";
        let expected = format!(
            "seed 7 failed, {heading} (vehicles 3 and 10: up to 104° root mean square, at most 30°): {command} 7\n\
             seed 7 failed, with controls at their stops (vehicle 10: 100 % of the time, at most 50 % of the time): {command} 7\n"
        );
        assert_eq!(of(&[spinning(7)]), expected);
        let several = of(&[run(1, GOOD), spinning(2)]);
        assert!(several.contains(&format!("1 of 2 runs {heading}, seed 2 (vehicles 3 and 10: up to")), "{several}");
        assert_eq!(
            failures(&run(1, &format!(r#"{GOOD},"heading_error_rms_deg":30,"stick_saturation":0.5"#))).count(),
            0
        );
    }

    #[test]
    fn a_verdict_claims_only_what_was_measured() {
        assert_eq!(of(&[run(1, r#""max_tilt_deg":3.5"#)]), "seed 1: without a measured failure\n");
        // A mission of several places names no figure that never came: even gaps without the band are no formation, nor is a band
        // that is not kept at the altitude.
        for (figures, claim) in [
            (r#""at_altitude_s":9,"in_band_s":null,"even_10deg_s":30"#, "every vehicle at its altitude"),
            (
                r#""at_altitude_s":null,"altitude_rms_m":40,"in_band_s":9,"even_10deg_s":30"#,
                "without a measured failure",
            ),
            (
                r#""at_altitude_s":9,"in_band_s":9,"even_10deg_s":null,"spacing_error_deg":50"#,
                "every vehicle at its altitude",
            ),
            (r#""at_altitude_s":null,"in_band_s":9,"even_10deg_s":null"#, "every vehicle in formation"),
        ] {
            assert_eq!(of(&[run(1, figures)]), format!("seed 1: {claim}\n"), "{figures}");
        }
        let tour = [6, 7].map(|steps| run(steps, &format!("\"collisions\":0,\"setpoints_reached\":{steps}")));
        assert_eq!(of(&tour), "2 of 2 runs: no collision, 6 to 7 mission steps reached\n");
    }

    #[test]
    fn a_verdict_on_a_sweep_names_the_point() {
        let points = ["0", "0.5"].map(|loss| Point(vec![("network.loss".to_owned(), loss.to_owned())]));
        let runs = [run(1, GOOD), run(2, GOOD), run(1, GOOD), run(2, COLLIDED)];
        let text = verdict(&ScenarioArgs::default(), &points, &runs);
        let expected = "1 of 4 runs with a collision, point 2 seed 2: skein fly --set network.loss=0.5 --seed 2\n";
        assert!(text.ends_with(expected), "{text}");
    }

    #[test]
    fn many_seeds_are_cut_to_the_first_ones() {
        let runs: Vec<Measured> = (0..20).map(|seed| run(seed, COLLIDED)).collect();
        assert!(of(&runs).contains("20 of 20 runs with a collision, seeds 0, 1, 2, 3, 4, 5, 6, 7 and 12 more: "));
        assert!(of(&runs).starts_with("every one of the 20 runs has failed\n"));
    }
}
