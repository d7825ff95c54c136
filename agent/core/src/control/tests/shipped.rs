//! The shipped rules: generated here from their laws, compared with the files, and examined.

use proptest::prelude::*;

use super::super::fis::{And, Consequent, Fis, Literal, Or, OutputBy, Rule, Term, Variable};
use super::super::membership::Membership;
use super::*;

const E: [f64; 5] = [-15.0, -5.0, 0.0, 5.0, 15.0];
const V: [f64; 5] = [-8.0, -3.0, 0.0, 3.0, 8.0];
const A: [f64; 3] = [-0.6, 0.0, 0.6];
const PSI: [f64; 5] = [-1.0, -0.3, 0.0, 0.3, 1.0];
const R: [f64; 3] = [-1.5, 0.0, 1.5];
const H: [f64; 5] = [-10.0, -3.0, 0.0, 3.0, 10.0];
const C: [f64; 5] = [-4.0, -1.5, 0.0, 1.5, 4.0];
const CLIMB_COMMAND: [f64; 5] = [-2.5, -1.5, 0.0, 1.5, 2.5];

/// Beyond every input in flight: the plateaus extend past the ranges, and Octave's `trapmf` requires a < b.
const FAR: f64 = 1000.0;

fn tilt(e: f64, v: f64) -> f64 {
    (0.05 * e - 0.10 * v).clamp(-0.30, 0.30)
}

fn lateral(x: &[f64]) -> f64 {
    tilt(x[0], x[1]) - x[2]
}

fn heading(x: &[f64]) -> f64 {
    0.75 * x[0].clamp(-0.8, 0.8) - 0.2 * x[1]
}

fn collective(x: &[f64]) -> f64 {
    let row = H.iter().position(|h| *h == x[0]).unwrap();
    (0.045 * (CLIMB_COMMAND[row] - x[1])).clamp(-0.2, 0.2)
}

/// Sets that form a partition of unity: triangles between neighbouring centres, shoulders at the ends.
fn input(name: &str, half_range: f64, centres: &[f64]) -> Variable<Membership> {
    let names: &[&str] = if centres.len() == 3 { &["N", "Z", "P"] } else { &["NB", "NS", "Z", "PS", "PB"] };
    let last = centres.len() - 1;
    let set = |i: usize| match i {
        0 => Membership::new("trapmf", &[-FAR - 1.0, -FAR, centres[0], centres[1]]),
        i if i == last => Membership::new("trapmf", &[centres[last - 1], centres[last], FAR, FAR + 1.0]),
        i => Membership::new("trimf", &centres[i - 1..=i + 1]),
    };
    let terms = (0..=last).map(|i| Term { name: names[i].into(), value: set(i).unwrap() }).collect();
    Variable { name: name.into(), range: [-half_range, half_range], terms }
}

/// The rule base of all combinations of sets, last input fastest, with the law's values at the sets' centres.
fn generate(name: &str, inputs: &[(&str, f64, &[f64])], law: fn(&[f64]) -> f64) -> Fis {
    let combinations = inputs.iter().fold(vec![vec![]], |done: Vec<Vec<usize>>, (_, _, centres)| {
        done.iter().flat_map(|c| (0..centres.len()).map(move |set| [&c[..], &[set]].concat())).collect()
    });
    // Decimals as written by hand, without the rounding of binary fractions and without −0.
    let constants: Vec<f64> =
        combinations.iter().map(|sets| (law(&centres_of(inputs, sets)) * 1e6).round() / 1e6 + 0.0).collect();
    let mut distinct = constants.clone();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    let rule = |(sets, constant): (&Vec<usize>, &f64)| Rule {
        antecedent: sets.iter().map(|&set| Some(Literal { set, is_negated: false })).collect(),
        is_or: false,
        consequents: vec![distinct.iter().position(|value| value == constant)],
        weight: 1.0,
    };
    Fis {
        name: name.into(),
        and: And::Product,
        or: Or::ProbabilisticSum,
        output_by: OutputBy::WeightedAverage,
        inputs: inputs.iter().map(|(name, half_range, centres)| input(name, *half_range, centres)).collect(),
        rules: combinations.iter().zip(&constants).map(rule).collect(),
        outputs: vec![Variable {
            name: if name == "collective" { "collective".into() } else { "stick".into() },
            range: [-1.0, 1.0],
            terms: (1..)
                .zip(&distinct)
                .map(|(i, &value)| Term { name: format!("u{i}"), value: Consequent::constant(value) })
                .collect(),
        }],
    }
}

fn centres_of(inputs: &[(&str, f64, &[f64])], sets: &[usize]) -> Vec<f64> {
    inputs.iter().zip(sets).map(|((_, _, centres), set)| centres[*set]).collect()
}

fn generated() -> [Fis; 4] {
    [
        generate(
            "roll",
            &[("error_right_m", 20.0, &E), ("velocity_right_m_s", 10.0, &V), ("bank_above_trim_rad", 0.8, &A)],
            lateral,
        ),
        generate(
            "pitch",
            &[("error_backwards_m", 20.0, &E), ("velocity_backwards_m_s", 10.0, &V), ("pitch_above_trim_rad", 0.8, &A)],
            lateral,
        ),
        generate("heading", &[("heading_error_rad", 2.0, &PSI), ("yaw_rate_rad_s", 2.0, &R)], heading),
        generate("collective", &[("altitude_error_m", 15.0, &H), ("climb_rate_m_s", 5.0, &C)], collective),
    ]
}

fn shipped() -> [(&'static str, &'static str); 4] {
    [
        ("roll.fis", include_str!("../../../../../deploy/controllers/roll.fis")),
        ("pitch.fis", include_str!("../../../../../deploy/controllers/pitch.fis")),
        ("heading.fis", include_str!("../../../../../deploy/controllers/heading.fis")),
        ("collective.fis", include_str!("../../../../../deploy/controllers/collective.fis")),
    ]
}

#[test]
fn the_files_are_what_the_laws_generate() {
    for ((file, text), fis) in shipped().into_iter().zip(generated()) {
        assert!(text == fis.to_string(), "{file} should read\n{fis}");
        assert_eq!(Fis::parse(file, text), Ok(fis));
    }
}

/// The published tables, written out.
#[test]
fn the_rule_tables_read_as_published() {
    #[rustfmt::skip]
    let tilt = [
        [ 0.05, -0.30, -0.30, -0.30, -0.30],
        [ 0.30,  0.05, -0.25, -0.30, -0.30],
        [ 0.30,  0.30,  0.00, -0.30, -0.30],
        [ 0.30,  0.30,  0.25, -0.05, -0.30],
        [ 0.30,  0.30,  0.30,  0.30, -0.05],
    ];
    #[rustfmt::skip]
    let climb = [
        [0.0675, -0.045, -0.1125, -0.18,   -0.2   ],
        [0.1125,  0.0,   -0.0675, -0.135,  -0.2   ],
        [0.18,    0.0675, 0.0,    -0.0675, -0.18  ],
        [0.2,     0.135,  0.0675,  0.0,    -0.1125],
        [0.2,     0.18,   0.1125,  0.045,  -0.0675],
    ];
    let yaw = [-0.60, -0.225, 0.0, 0.225, 0.60];
    let rules = Rules::shipped();
    let same = |rules: &Sugeno, inputs: &[f64], expected: f64| {
        let got = rules.evaluate(inputs).unwrap();
        assert!((got - expected).abs() < 1e-12, "{inputs:?}: {got}, not {expected}");
    };
    for i in 0..5 {
        for j in 0..5 {
            for a in A {
                same(&rules.roll, &[E[i], V[j], a], tilt[i][j] - a);
                same(&rules.pitch, &[E[i], V[j], a], tilt[i][j] - a);
            }
            same(&rules.collective, &[H[i], C[j]], climb[i][j]);
        }
        for (r, added) in R.into_iter().zip([0.30, 0.0, -0.30]) {
            same(&rules.heading, &[PSI[i], r], yaw[i] + added);
        }
    }
}

/// The attitude correction can outweigh position and velocity; otherwise the tilt would be unbounded.
#[test]
fn the_largest_tilt_command_is_below_the_largest_attitude_correction() {
    let rules = Rules::shipped();
    for axis in [&rules.roll, &rules.pitch] {
        assert!(axis.evaluate(&[1e6, -1e6, 0.6]).unwrap() < 0.0);
        assert!(axis.evaluate(&[-1e6, 1e6, -0.6]).unwrap() > 0.0);
    }
}

/// A shipped system, compiled and as described by its file.
fn system(which: usize) -> (Sugeno, Fis) {
    let (file, text) = shipped()[which];
    (Sugeno::parse(file, text).unwrap(), Fis::parse(file, text).unwrap())
}

/// A point in and around the ranges of a system's inputs.
fn inputs(fis: &Fis, unit: [f64; 3]) -> Vec<f64> {
    fis.inputs.iter().zip(unit).map(|(input, unit)| 1.5 * input.range[1] * unit).collect()
}

fn point() -> impl Strategy<Value = [f64; 3]> {
    [-1.0..1.0, -1.0..1.0, -1.0..1.0]
}

proptest! {
    #[test]
    fn memberships_sum_to_one(which in 0..4usize, x in -1e3..1e3f64) {
        for input in &system(which).1.inputs {
            let degrees: Vec<f64> = input.terms.iter().map(|set| set.value.degree(x)).collect();
            prop_assert!((degrees.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            prop_assert!(degrees.iter().filter(|degree| **degree > 0.0).count() <= 2);
        }
    }

    #[test]
    fn output_is_within_the_constants(which in 0..4usize, unit in point()) {
        let (system, fis) = system(which);
        let constants = fis.outputs[0].terms.iter().map(|term| term.value.constant);
        let (least, most) = constants.fold((f64::MAX, f64::MIN), |(low, high), u| (low.min(u), high.max(u)));
        let output = system.evaluate(&inputs(&fis, unit)).unwrap();
        prop_assert!(least - 1e-12 <= output && output <= most + 1e-12);
    }

    /// Slopes are at most 0.25 per m, 0.7 per m/s, 1 per rad, …: a small step of the inputs gives a small step of the
    /// output.
    #[test]
    fn output_is_continuous(which in 0..4usize, unit in point(), step in point()) {
        let (system, fis) = system(which);
        let near = core::array::from_fn(|i| unit[i] + 1e-9 * step[i]);
        let difference = system.evaluate(&inputs(&fis, unit)).unwrap() - system.evaluate(&inputs(&fis, near)).unwrap();
        prop_assert!(difference.abs() < 1e-7, "{difference}");
    }

    /// The output rises with the first input, an error, and falls with the others, which damp.
    #[test]
    fn output_is_monotone(which in 0..4usize, unit in point(), input in 0..3usize, more in 0.0..1.0) {
        let (system, fis) = system(which);
        let mut further = unit;
        further[input] += more;
        let difference = system.evaluate(&inputs(&fis, further)).unwrap() - system.evaluate(&inputs(&fis, unit)).unwrap();
        if input == 0 { prop_assert!(difference >= -1e-12) } else { prop_assert!(difference <= 1e-12) }
    }

    #[test]
    fn output_is_antisymmetric(which in 0..4usize, unit in point()) {
        let (system, fis) = system(which);
        let (there, back) = (inputs(&fis, unit), inputs(&fis, unit.map(|x| -x)));
        prop_assert!((system.evaluate(&there).unwrap() + system.evaluate(&back).unwrap()).abs() < 1e-12);
    }

    #[test]
    fn shoulders_hold_for_every_finite_input(which in 0..4usize, unit in point(), input in 0..3usize, far in 1.5..1e300f64) {
        let (system, fis) = system(which);
        let mut at_end = inputs(&fis, unit);
        prop_assume!(input < at_end.len());
        for side in [0, 1] {
            at_end[input] = fis.inputs[input].range[side];
            let mut beyond = at_end.clone();
            beyond[input] *= far;
            prop_assert_eq!(system.evaluate(&beyond), system.evaluate(&at_end));
        }
    }
}
