use proptest::prelude::*;

use super::super::fis::{Consequent, Literal, Or, Rule, Term, Variable};
use super::*;
use crate::random::{self, Purpose};

impl Sugeno {
    /// Compiles a described system with one output.
    fn new(fis: &Fis) -> Result<Self, String> {
        Self::of_output(fis, fis.output_named(&[])?)
    }
}

fn variable(sets: &[(&str, &[f64])], range: [f64; 2]) -> Variable<Membership> {
    let terms = sets
        .iter()
        .map(|(kind, parameters)| Term { name: "set".into(), value: Membership::new(kind, parameters).unwrap() });
    Variable { name: "x".into(), range, terms: terms.collect() }
}

fn rule(antecedent: &[Option<usize>], consequent: usize, weight: f64) -> Rule {
    let literal = |set: &Option<usize>| set.map(|set| Literal { set, is_negated: false });
    Rule {
        antecedent: antecedent.iter().map(literal).collect(),
        is_or: false,
        consequents: vec![Some(consequent)],
        weight,
    }
}

fn system(inputs: Vec<Variable<Membership>>, constants: &[f64], rules: Vec<Rule>) -> Fis {
    let term = |&constant: &f64| Term { name: "u".into(), value: Consequent::constant(constant) };
    Fis {
        name: "test".into(),
        and: And::Product,
        or: Or::ProbabilisticSum,
        output_by: OutputBy::WeightedAverage,
        inputs,
        outputs: vec![Variable { name: "u".into(), range: [0.0, 1.0], terms: constants.iter().map(term).collect() }],
        rules,
    }
}

/// The constant of a rule of a system with one output.
fn constant_of(fis: &Fis, rule: &Rule) -> f64 {
    fis.outputs[0].terms[rule.consequents[0].unwrap()].value.constant
}

/// The output by the definition, rule by rule.
fn by_definition(fis: &Fis, x: &[f64]) -> f64 {
    let mut sums = [0.0; 2];
    for rule in &fis.rules {
        let mut weight = rule.weight;
        for ((set, input), x) in rule.antecedent.iter().zip(&fis.inputs).zip(x) {
            let x = x.max(input.range[0]).min(input.range[1]);
            weight *= set.map_or(1.0, |literal| input.terms[literal.set].value.degree(x));
        }
        sums[0] += weight;
        sums[1] += weight * constant_of(fis, rule);
    }
    sums[1] / sums[0]
}

/// Σ w and Σ w u of the rules that begin with these sets, set by set and segment by segment: the order and rounding of
/// every operation of the compiled system, without its tables.
fn sums(fis: &Fis, x: &[f64], sets: &mut Vec<Option<usize>>) -> [f64; 2] {
    let Some(input) = fis.inputs.get(sets.len()) else {
        let of =
            |rule: &Rule| rule.antecedent.iter().map(|literal| literal.map(|literal| literal.set)).collect::<Vec<_>>();
        let rules = fis.rules.iter().filter(|rule| of(rule) == *sets);
        return rules.fold([0.0; 2], |[weight, weighted], rule| {
            [weight + rule.weight, weighted + rule.weight * constant_of(fis, rule)]
        });
    };
    let x_here = x[sets.len()].clamp(input.range[0], input.range[1]);
    let corners = input.terms.iter().flat_map(|set| set.value.corners());
    let within = corners.filter(|corner| input.range[0] < *corner && *corner < input.range[1]);
    let from = within.clone().filter(|corner| *corner <= x_here).fold(input.range[0], f64::max);
    let to = within.filter(|corner| *corner > x_here).fold(input.range[1], f64::min);
    let degree = |set: &Membership| match (set, set.degree(from), set.degree(to)) {
        (_, 0.0, 0.0) => None,
        (Membership::Gaussian(_), ..) => Some(set.degree(x_here)),
        (_, value, end) => Some(value + (x_here - from) * ((end - value) / (to - from))),
    };
    let is_any = fis.rules.iter().any(|rule| rule.antecedent[sets.len()].is_none());
    let degrees = input.terms.iter().enumerate().map(|(set, term)| (Some(set), degree(&term.value)));
    let degrees: Vec<_> = degrees.chain(is_any.then_some((None, Some(1.0)))).collect();
    let mut sum = [0.0; 2];
    for (set, degree) in degrees.into_iter().filter_map(|(set, degree)| Some((set, degree?))) {
        sets.push(set);
        let [weight, weighted] = sums(fis, x, sets);
        sets.pop();
        sum = [sum[0] + degree * weight, sum[1] + degree * weighted];
    }
    sum
}

/// Four inputs, the last with three sets at once and one that no rule ignores.
fn wide() -> Fis {
    let two = || variable(&[("trimf", &[-1.0, 0.0, 1.0]), ("trimf", &[0.0, 1.0, 2.0])], [0.0, 1.0]);
    let three = variable(
        &[("trimf", &[-1.0, 0.0, 1.0]), ("trapmf", &[-2.0, 0.3, 0.3, 2.0]), ("trimf", &[0.0, 1.0, 2.0])],
        [0.0, 1.0],
    );
    let rules = (0..24).map(|nth| {
        let sets = [nth & 1, nth >> 1 & 1, nth >> 2 & 1, nth >> 3].map(Some);
        rule(&sets, nth % 5, 1.0 / (1 + nth % 3) as f64)
    });
    system(vec![two(), two(), two(), three], &[-1.0, 2.0, 7.0, -0.3, 0.7], rules.collect())
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
        format!("my.fis:{line}:1: no rule fires at heading_error_rad = -2, yaw_rate_rad_s = -2")
    );
}

#[test]
fn the_compiled_system_has_the_bits_of_the_sums_by_segments() {
    let texts = [
        include_str!("../../../../../deploy/controllers/roll.fis"),
        include_str!("../../../../../deploy/controllers/heading.fis"),
        include_str!("../../../../../deploy/controllers/collective.fis"),
    ];
    let systems = texts.into_iter().map(|text| Fis::parse("shipped", text).unwrap()).chain([awkward(), wide()]);
    let mut rng = random::generator(1, None, Purpose::Study);
    for fis in systems {
        let compiled = Sugeno::new(&fis).unwrap();
        // Corners, their neighbours, and points between and beyond.
        let mut draw = |input: &Variable<Membership>| {
            let corners: Vec<f64> = input.terms.iter().flat_map(|set| set.value.corners()).collect();
            let corner = corners[(random::uniform(&mut rng) * corners.len() as f64) as usize];
            let [low, high] = input.range.map(|end| 1.2 * end);
            let between = low + (high - low) * random::uniform(&mut rng);
            [corner, corner.next_up(), corner.next_down(), between][(random::uniform(&mut rng) * 4.0) as usize]
        };
        for _ in 0..4_000 {
            let x: Vec<f64> = fis.inputs.iter().map(&mut draw).collect();
            let [weight, weighted] = sums(&fis, &x, &mut Vec::new());
            assert_eq!(
                compiled.evaluate(&x).unwrap().to_bits(),
                (weighted / weight).to_bits(),
                "{} at {x:?}",
                fis.name
            );
        }
    }
}

#[test]
fn a_vertical_edge_at_zero_has_an_output_at_zero_and_beside_it() {
    for zero in [0.0, -0.0] {
        let rising =
            variable(&[("trimf", &[-10.0, zero, 0.0]), ("trapmf", &[-12.0, -11.0, 11.0, 12.0])], [-10.0, 10.0]);
        let rules = vec![rule(&[Some(0)], 0, 1.0), rule(&[Some(1)], 1, 1.0)];
        let system = Sugeno::new(&system(vec![rising], &[0.0, 1.0], rules)).unwrap();
        for (x, output) in
            [(0.0, 0.5), (-0.0, 0.5), (f64::from_bits(1), 1.0), (1.0, 1.0), (-10.0, 1.0), (-5.0, 1.0 / 1.5)]
        {
            assert_eq!(system.evaluate(&[x]), Some(output), "at {x}, the edge at {zero}");
        }
    }
}

/// Every system of `tests/golden/sugeno`, with the values of Octave's fuzzy-logic-toolkit in `tests/golden/sugeno.csv`, which
/// `tests/src/sugeno.m` makes.
#[test]
fn systems_of_every_set_and_method_have_the_values_of_octave() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden");
    let values = std::fs::read_to_string(folder.join("sugeno.csv")).unwrap();
    let (mut systems, mut kinds, mut rows) = (std::collections::BTreeMap::new(), std::collections::BTreeSet::new(), 0);
    for row in values.lines().skip(1) {
        let cells: Vec<&str> = row.split(',').collect();
        let [file, output, x1, x2, value] = cells[..] else { panic!("{row}") };
        let (fis, compiled) = systems.entry((file, output)).or_insert_with(|| {
            let fis = Fis::parse(file, &std::fs::read_to_string(folder.join("sugeno").join(file)).unwrap()).unwrap();
            let nth = output.parse::<usize>().unwrap() - 1;
            (fis.clone(), Sugeno::of_output(&fis, nth).unwrap())
        });
        kinds.extend(fis.inputs.iter().flat_map(|input| &input.terms).map(|term| term.value.kind()));
        let inputs = [x1, x2].map(|x| x.parse::<f64>().unwrap());
        let (got, octave) = (compiled.evaluate(&inputs[..compiled.inputs()]).unwrap(), value.parse::<f64>().unwrap());
        assert!((got - octave).abs() < 1e-12 * octave.abs().max(1.0), "{file} at {inputs:?}: {got}, Octave {octave}");
        rows += 1;
    }
    assert_eq!((kinds.len(), rows > 3_000), (11, true), "{kinds:?}");
    let methods: Vec<_> = systems.values().map(|(fis, _)| (fis.and, fis.or, fis.output_by)).collect();
    for and in [And::Product, And::Least] {
        for output_by in [OutputBy::WeightedAverage, OutputBy::WeightedSum] {
            assert!(methods.iter().any(|of| (of.0, of.2) == (and, output_by)), "{and:?} {output_by:?}");
        }
    }
    for or in [Or::ProbabilisticSum, Or::Greatest] {
        assert!(methods.iter().any(|of| of.1 == or), "{or:?}");
    }
}

#[test]
fn of_several_outputs_the_named_one_is_used() {
    let text = include_str!("../../../../../tests/golden/sugeno/several-outputs.fis");
    let (named, ..) = Sugeno::parse_output("several.fis", text, &["stick", "yaw"]).unwrap();
    let fis = Fis::parse("several.fis", text).unwrap();
    let second = Sugeno::of_output(&fis, 1).unwrap();
    for x in [[-1.0, 0.5], [0.3, 2.0], [1.9, -3.0]] {
        assert_eq!(named.evaluate(&x), second.evaluate(&x));
    }
    let why = Sugeno::parse_output("several.fis", text, &["yaw"]).unwrap_err().to_string();
    let expected = "the file has 3 outputs (first, stick, third), and one is needed: name the one to use 'yaw'";
    assert!(why.ends_with(expected) && why.starts_with("several.fis:30:6: "), "{why}");
}

#[test]
fn a_system_of_any_form_that_leaves_inputs_uncovered_is_refused_unless_it_sums() {
    let text = |and: &str, sums: &str| {
        format!(
            "[System]\nType='sugeno'\nAndMethod='{and}'\nDefuzzMethod='{sums}'\n\
             [Input1]\nRange=[0 10]\nMF1='low':'trimf',[-5 0 5]\n\
             [Input2]\nRange=[0 10]\nMF1='low':'zmf',[2 8]\n\
             [Output1]\nMF1='u':'linear',[1 2 3]\n[Rules]\n1 1, 1 (1) : 1\n-1 0, 1 (1) : 1\n"
        )
    };
    let why = Sugeno::parse("x.fis", &text("min", "wtaver")).unwrap_err().to_string();
    assert_eq!(why, "x.fis:13:1: no rule fires at Input1 = 0, Input2 = 8");
    assert!(Sugeno::parse("x.fis", &text("prod", "wtaver")).is_err());
    let sum = Sugeno::parse("x.fis", &text("min", "wtsum")).unwrap();
    assert_eq!((sum.evaluate(&[0.0, 9.0]), sum.evaluate(&[0.0, 0.0])), (Some(0.0), Some(3.0)));
    // Inputs beyond the range count as its ends, in the consequents too.
    assert_eq!(sum.evaluate(&[1e9, 1e9]), Some(10.0 + 20.0 + 3.0));
}

proptest! {
    #[test]
    fn the_compiled_system_matches_the_definition(x in -9.0..9.0f64, y in -9.0..9.0f64) {
        let fis = awkward();
        let (compiled, defined) = (Sugeno::new(&fis).unwrap().evaluate(&[x, y]).unwrap(), by_definition(&fis, &[x, y]));
        prop_assert!((compiled - defined).abs() < 1e-12, "{compiled} {defined}");
        // A table and the rules one by one are the same system.
        let by_rules = RuleByRule::new(&fis, 0).evaluate(&[x, y]).unwrap();
        prop_assert!((compiled - by_rules).abs() < 1e-12, "{compiled} {by_rules}");
    }

    /// A system that passed the coverage check has an output everywhere.
    #[test]
    fn a_checked_system_always_has_an_output(
        sets in prop::collection::vec((0..11usize, prop::array::uniform4(-3.0..3.0f64)), 2..6),
        x in prop::num::f64::NORMAL,
        near in -3.0..3.0f64,
    ) {
        let sets = sets.into_iter().filter_map(|(kind, mut p)| {
            p.sort_by(f64::total_cmp);
            let kinds = [("trimf", 3), ("trapmf", 4), ("gaussmf", 2), ("zmf", 2), ("smf", 2), ("pimf", 4), ("sigmf", 2),
                ("gbellmf", 3), ("gauss2mf", 4), ("dsigmf", 4), ("psigmf", 4)];
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
