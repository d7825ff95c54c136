//! Tests of the verdict on a study.

use proptest::prelude::*;

use super::*;

fn run(seed: u64, figures: &str) -> Measured {
    Measured::read(&format!("{{\"seed\":{seed},{figures}}}")).unwrap()
}

const GOOD: &str = r#""collisions":0,"crashes":0,"at_altitude_s":17.5,"in_band_s":20,"even_10deg_s":60"#;
const COLLIDED: &str = r#""collisions":1,"crashes":0,"at_altitude_s":17.5,"in_band_s":20,"even_10deg_s":60"#;
const NEVER: &str = r#""collisions":0,"crashes":2,"in_band_s":null,"never":["in_band_s"]"#;

fn of(runs: &[Measured]) -> String {
    let scenario = ScenarioArgs { scenario: Some("my tour.toml".into()), sets: vec!["network.loss=0.3".to_owned()] };
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
        let vehicle =
            |heading: f64, stops: f64| format!(r#"{{"heading_error_rms_deg":{heading},"stick_saturation":{stops}}}"#);
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
    assert_eq!(failures(&run(1, &format!(r#"{GOOD},"heading_error_rms_deg":30,"stick_saturation":0.5"#))).count(), 0);
}

#[test]
fn a_verdict_claims_only_what_was_measured() {
    assert_eq!(of(&[run(1, r#""max_tilt_deg":3.5"#)]), "seed 1: without a measured failure\n");
    // A mission of several places names no figure that never came: even gaps without the band are no formation, nor is a band
    // that is not kept at the altitude.
    for (figures, claim) in [
        (r#""at_altitude_s":9,"in_band_s":null,"even_10deg_s":30"#, "every vehicle at its altitude"),
        (r#""at_altitude_s":null,"altitude_rms_m":40,"in_band_s":9,"even_10deg_s":30"#, "without a measured failure"),
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

/// Any run: each of these figures has a value, never came or does not apply.
pub(crate) fn any_run() -> impl Strategy<Value = Measured> {
    let keys = [
        "collisions",
        "crashes",
        "at_altitude_s",
        "in_band_s",
        "even_10deg_s",
        "fallback_share",
        "detection_s",
        "transient_s",
    ];
    let figure = prop_oneof![3 => (0.0..3.0).prop_map(Some), 3 => Just(Some(0.0)), 2 => Just(None)];
    (0_u64..1000, prop::collection::vec((figure, any::<bool>()), keys.len())).prop_map(move |(seed, figures)| {
        let mut run = Measured { seed, ..Measured::default() };
        for (key, (value, is_never)) in keys.iter().zip(figures) {
            run.figures.insert((*key).to_owned(), value);
            if value.is_none() && is_never {
                run.never.insert((*key).to_owned());
            }
        }
        run
    })
}

/// The number of good runs, as the first line of a verdict on several runs states it.
fn good(text: &str) -> usize {
    text.split_once(" of ").and_then(|(good, _)| good.parse().ok()).unwrap_or(0)
}

proptest! {
    #[test]
    fn one_more_failed_run_never_improves_a_verdict(runs in prop::collection::vec(any_run(), 2..12), failed in any_run()) {
        prop_assume!(failures(&failed).next().is_some());
        let with_it: Vec<Measured> = runs.iter().cloned().chain([failed]).collect();
        let (before, after) = (of(&runs), of(&with_it));
        let first = |text: &str| text.lines().next().unwrap_or_default().to_owned();
        let is_good = |run: &&Measured| failures(run).next().is_none();
        prop_assert_eq!(good(&first(&after)), runs.iter().filter(is_good).count());
        for (failure, is_it) in FAILURES {
            let count = |runs: &[Measured]| runs.iter().filter(|run| is_it(run)).count();
            prop_assert!(count(&with_it) >= count(&runs) && (count(&runs) == 0 || after.contains(failure)));
        }
        // The claims are those about the good runs.
        let claims = |text: &str| first(text).split_once(": ").map(|(_, claims)| claims.to_owned());
        prop_assert_eq!(claims(&before), claims(&after));
    }

    #[test]
    fn a_run_that_gets_worse_keeps_its_failures(run in any_run(), by in 0.0..2.0) {
        let before: Vec<&str> = failures(&run).collect();
        let mut worse = run.clone();
        for key in ["collisions", "crashes", "fallback_share"] {
            worse.figures.entry(key.to_owned()).and_modify(|value| *value = value.map(|value| value + by));
        }
        for key in ["in_band_s", "detection_s"] {
            worse.figures.insert(key.to_owned(), None);
            worse.never.insert(key.to_owned());
        }
        let after: Vec<&str> = failures(&worse).collect();
        prop_assert!(before.iter().all(|failure| after.contains(failure)), "{:?}, then {:?}", before, after);
    }

    #[test]
    fn a_list_names_all_or_the_first_and_how_many_more(count in 0_usize..30) {
        let items: Vec<String> = (0..count).map(|nth| format!("item{nth};")).collect();
        let text = list(&items);
        let named = items.iter().filter(|item| text.contains(item.as_str())).count();
        let more = text.rsplit_once(" and ").and_then(|(_, end)| end.strip_suffix(" more")?.parse::<usize>().ok());
        prop_assert_eq!(named + more.unwrap_or(0), count);
    }
}
