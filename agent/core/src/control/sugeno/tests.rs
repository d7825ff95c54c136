use proptest::prelude::*;

use super::super::fis::{Rule, Term, Variable};
use super::*;

fn variable(sets: &[(&str, &[f64])], range: [f64; 2]) -> Variable<Membership> {
    let terms = sets
        .iter()
        .map(|(kind, parameters)| Term { name: "set".into(), value: Membership::new(kind, parameters).unwrap() });
    Variable { name: "x".into(), range, terms: terms.collect() }
}

fn rule(antecedent: &[Option<usize>], consequent: usize, weight: f64) -> Rule {
    Rule { antecedent: antecedent.into(), consequent, weight }
}

fn system(inputs: Vec<Variable<Membership>>, constants: &[f64], rules: Vec<Rule>) -> Fis {
    let terms = constants.iter().map(|&value| Term { name: "u".into(), value }).collect();
    Fis { name: "test".into(), inputs, output: Variable { name: "u".into(), range: [0.0, 1.0], terms }, rules }
}

/// The output by the definition, rule by rule.
fn by_definition(fis: &Fis, x: &[f64]) -> f64 {
    let mut sums = [0.0; 2];
    for rule in &fis.rules {
        let mut weight = rule.weight;
        for ((set, input), x) in rule.antecedent.iter().zip(&fis.inputs).zip(x) {
            let x = x.max(input.range[0]).min(input.range[1]);
            weight *= set.map_or(1.0, |set| input.terms[set].value.degree(x));
        }
        sums[0] += weight;
        sums[1] += weight * fis.output.terms[rule.consequent].value;
    }
    sums[1] / sums[0]
}

/// Overlapping sets of all kinds, weights, an "any" for each input, two rules for one combination.
fn awkward() -> Fis {
    let first = variable(
        &[("trapmf", &[-9.0, -8.0, 0.0, 2.0]), ("trimf", &[0.0, 2.0, 4.0]), ("gaussmf", &[1.0, 4.0])],
        [-2.0, 5.0],
    );
    let second = variable(&[("gaussmf", &[2.0, -1.0]), ("gaussmf", &[1.0, 3.0])], [-3.0, 3.0]);
    let rules = vec![
        rule(&[Some(0), Some(0)], 0, 1.0),
        rule(&[Some(1), Some(1)], 1, 0.5),
        rule(&[Some(1), Some(1)], 2, 0.25),
        rule(&[Some(2), None], 2, 1.0),
        rule(&[None, Some(0)], 1, 0.125),
        rule(&[None, None], 0, 0.01),
    ];
    system(vec![first, second], &[-1.0, 2.0, 7.0], rules)
}

#[test]
fn the_output_matches_an_example_worked_by_hand() {
    // x = 1: memberships 0.5 and 0.5; weights 1 and 0.5; (0.5·10 + 0.25·20) / 0.75.
    let fis = system(
        vec![variable(&[("trimf", &[-2.0, 0.0, 2.0]), ("trimf", &[0.0, 2.0, 4.0])], [0.0, 2.0])],
        &[10.0, 20.0],
        vec![rule(&[Some(0)], 0, 1.0), rule(&[Some(1)], 1, 0.5)],
    );
    let output = Sugeno::new(&fis).unwrap().evaluate(&[1.0]).unwrap();
    assert!((output - 40.0 / 3.0).abs() < 1e-12, "{output}");
}

#[test]
fn unusable_inputs_have_no_output() {
    let system = Sugeno::new(&awkward()).unwrap();
    assert_eq!(system.inputs(), 2);
    for inputs in [&[][..], &[0.0], &[0.0; 3], &[f64::NAN, 0.0], &[0.0, f64::INFINITY]] {
        assert_eq!(system.evaluate(inputs), None, "{inputs:?}");
    }
    assert!(system.evaluate(&[1e300, -1e300]).is_some());
}

#[test]
fn uncovered_inputs_are_found() {
    let two = || variable(&[("trimf", &[-1.0, 0.0, 1.0]), ("trimf", &[0.0, 1.0, 2.0])], [0.0, 1.0]);
    let all = |hole: Option<usize>, weight: f64| {
        let combinations = [[0, 0], [0, 1], [1, 0], [1, 1]];
        let weight = move |i: usize| if Some(i) == hole { weight } else { 1.0 };
        let rules = combinations.iter().enumerate().map(|(i, sets)| rule(&sets.map(Some), 0, weight(i)));
        Sugeno::new(&system(vec![two(), two()], &[1.0], rules.collect())).map(|_| ())
    };
    assert_eq!(all(None, 1.0), Ok(()));
    // The rule for set 1 of the first input and set 2 of the second has zero weight.
    assert_eq!(all(Some(1), 0.0), Err("no rule fires at x = 0, x = 1".into()));
    assert_eq!(all(Some(2), 1e-9), Err("no rule fires at x = 1, x = 0".into()));
    assert_eq!(all(Some(2), 1e-3), Ok(()));

    let one = |sets: &[(&str, &[f64])], range| {
        let rules = (0..sets.len()).map(|set| rule(&[Some(set)], 0, 1.0)).collect();
        Sugeno::new(&system(vec![variable(sets, range)], &[1.0], rules)).map(|_| ())
    };
    // Two triangles that touch at a point, sets that end before the range, a gap, edges that leave a slit.
    assert!(one(&[("trimf", &[-1.0, 0.0, 1.0]), ("trimf", &[1.0, 2.0, 3.0])], [0.0, 2.0]).is_err());
    assert!(one(&[("trimf", &[-1.0, 0.0, 1.0])], [0.0, 2.0]).is_err());
    assert!(one(&[("trapmf", &[0.0, 0.0, 1.0, 1.0]), ("trapmf", &[1.5, 1.5, 2.0, 2.0])], [0.0, 2.0]).is_err());
    assert!(one(&[("trapmf", &[0.0, 0.0, 1.0, 1.0]), ("trimf", &[1.0, 2.0, 3.0])], [0.0, 2.0]).is_err());
    assert!(one(&[("trapmf", &[0.0, 0.0, 1.0, 1.0]), ("trapmf", &[1.0, 1.0, 2.0, 2.0])], [0.0, 2.0]).is_ok());
    // Gaussians reach far, but not infinitely far.
    assert!(one(&[("gaussmf", &[1.0, 0.0]), ("gaussmf", &[1.0, 8.0])], [0.0, 8.0]).is_ok());
    assert!(one(&[("gaussmf", &[1.0, 0.0]), ("gaussmf", &[1.0, 12.0])], [0.0, 12.0]).is_err());
}

#[test]
fn systems_that_are_too_large_are_refused() {
    let sets: Vec<(&str, &[f64])> = vec![("gaussmf", &[1.0, 0.0]); 9];
    let large = |inputs: usize| {
        let inputs = vec![variable(&sets, [-1.0, 1.0]); inputs];
        let any = vec![rule(&vec![Some(0); inputs.len()], 0, 1.0)];
        Sugeno::new(&system(inputs, &[1.0], any)).map(|_| ()).unwrap_err()
    };
    let crowded = variable(&vec![("gaussmf", &[1.0, 0.0][..]); 101], [-1.0, 1.0]);
    let fis = system(vec![crowded], &[1.0], vec![rule(&[None], 0, 1.0)]);
    assert_eq!(Sugeno::new(&fis).map(|_| ()), Err("'x' has too many sets: 100 are supported".into()));
    assert_eq!(large(9), "9 inputs are too many: 8 are supported");
    assert_eq!(large(7), "more than 65536 combinations of sets are too many");
    let sets: Vec<Vec<f64>> = (0..21).map(|c| vec![0.07, f64::from(c)]).collect();
    let sets: Vec<(&str, &[f64])> = sets.iter().map(|p| ("gaussmf", &p[..])).collect();
    let any = vec![rule(&[Some(0), Some(0), Some(0)], 0, 1.0)];
    let fis = system(vec![variable(&sets, [0.0, 20.0]); 3], &[1.0], any);
    assert!(Sugeno::new(&fis).unwrap_err().starts_with("the system is too large to check"));
}

#[test]
fn an_uncovered_file_names_the_line_of_its_rules() {
    let text = include_str!("../../../../../deploy/controllers/heading.fis");
    let error = Sugeno::parse("my.fis", &text.replacen("1 1, ", "1 2, ", 1)).unwrap_err();
    let line = 1 + text.lines().position(|line| line == "[Rules]").unwrap();
    assert_eq!(
        error.to_string(),
        format!("my.fis:{line}: no rule fires at heading_error_rad = -2, yaw_rate_rad_s = -2")
    );
}

proptest! {
    #[test]
    fn the_compiled_system_matches_the_definition(x in -9.0..9.0f64, y in -9.0..9.0f64) {
        let fis = awkward();
        let (compiled, defined) = (Sugeno::new(&fis).unwrap().evaluate(&[x, y]).unwrap(), by_definition(&fis, &[x, y]));
        prop_assert!((compiled - defined).abs() < 1e-12, "{compiled} {defined}");
    }

    /// A system that passed the coverage check has an output everywhere.
    #[test]
    fn a_checked_system_always_has_an_output(
        sets in prop::collection::vec((0..3usize, prop::array::uniform4(-3.0..3.0f64)), 2..6),
        x in prop::num::f64::NORMAL,
        near in -3.0..3.0f64,
    ) {
        let sets = sets.into_iter().filter_map(|(kind, mut p)| {
            p.sort_by(f64::total_cmp);
            let kinds = [("trimf", 3), ("trapmf", 4), ("gaussmf", 2)];
            let value = Membership::new(kinds[kind].0, &p[..kinds[kind].1]).ok()?;
            Some(Term { name: "set".into(), value })
        });
        let input = Variable { name: "x".into(), range: [-1.0, 1.0], terms: sets.collect() };
        let rules = (0..input.terms.len()).map(|set| rule(&[Some(set)], 0, 1.0)).collect();
        if let Ok(system) = Sugeno::new(&system(vec![input], &[1.0], rules)) {
            prop_assert!((system.evaluate(&[near]).unwrap() - 1.0).abs() < 1e-9);
            prop_assert!((system.evaluate(&[x]).unwrap() - 1.0).abs() < 1e-9);
        }
    }
}
