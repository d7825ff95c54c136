use proptest::prelude::*;

use super::super::Sugeno;
use super::*;

/// Two inputs, all kinds of set, a weight, and an input that a rule does not ask for. Written by hand, as a person or
/// Octave might.
const TEXT: &str = "\u{feff}% a comment
# another

[System]
Name = 'tip'
Type = 'sugeno'
Version = 1.0
NumInputs = 2
NumOutputs = 1
NumRules = 3
AndMethod = 'prod'
OrMethod = 'max'
ImpMethod = 'prod'
AggMethod = 'sum'
DefuzzMethod = 'wtaver'

[Input1]
Name = 'food quality'
Range = [0 10]
NumMFs = 2
MF1 = 'bad'  : 'trapmf', [-1 0 3 7]
MF2 = 'good' : 'trimf', [3, 10, 17]

[Input2]
Name='service'\r
Range=[0 10]
NumMFs=1
MF1='fair':'gaussmf',[4e0 5]

[Output1]
Name='tip'
Range=[5 25]
NumMFs=2
MF1='low':'constant',[10]
MF2='high':'constant',[20.5]

[Rules]
1 0, 1 (1) : 1
2 1, 2 (0.5) : 1
0 1, 1 (0.25) : 1
";

#[test]
fn a_file_is_read() {
    let fis = Fis::parse("tip.fis", TEXT).unwrap();
    assert_eq!(fis.name, "tip");
    assert_eq!(fis.inputs[0].name, "food quality");
    assert_eq!(fis.inputs[0].terms[1].value, Membership::Triangle([3.0, 10.0, 17.0]));
    assert_eq!(fis.inputs[1].terms[0].value, Membership::Gaussian([4.0, 5.0]));
    assert_eq!(fis.output.terms[1], Term { name: "high".into(), value: 20.5 });
    assert_eq!(fis.rules[0], Rule { antecedent: vec![Some(0), None], consequent: 0, weight: 1.0 });
    assert_eq!(fis.rules[1], Rule { antecedent: vec![Some(1), Some(0)], consequent: 1, weight: 0.5 });
}

/// Each line, replaced, gives an error that names its line (from 1) and says what is the matter.
#[test]
fn what_is_not_supported_is_refused_by_name() {
    for (line, replaced_by, says) in [
        (6, "Type='mamdani'", "Type='mamdani' is not supported"),
        (8, "NumInputs=0", "NumInputs=0 is not supported"),
        (8, "NumInputs=two", "'two' is not such a number"),
        (9, "NumOutputs=2", "NumOutputs=2 is not supported"),
        (11, "AndMethod='min'", "AndMethod='min' is not supported"),
        (13, "ImpMethod='min'", "ImpMethod='min' is not supported"),
        (14, "AggMethod='max'", "AggMethod='max' is not supported"),
        (15, "DefuzzMethod='wtsum'", "DefuzzMethod='wtsum' is not supported"),
        (5, "Name=tip", "a text in single quotes was expected"),
        (5, "Name='t'ip'", "a text in single quotes was expected"),
        (16, "Colour='red'", "[System] has no use for 'Colour='red''"),
        (16, "Version=2.0", "[System] has no use for 'Version=2.0'"),
        (19, "Range=[10 0]", "Range needs low < high"),
        (19, "Range=[0 10 20]", "Range needs [low high]"),
        (19, "Range=0 10", "numbers in [ ] were expected"),
        (19, "Range=[0 nan]", "'nan' is not a finite number"),
        (20, "NumMFs=0", "NumMFs is not within"),
        (21, "MF1='bad':'trapmf',[0 3 2 7]", "a <= b <= c <= d"),
        (21, "MF1='bad':'trapmf',[0 3 7]", "takes 4 parameters, not 3"),
        (21, "MF1='bad':'trapmf',[0 3 7 inf]", "'inf' is not a finite number"),
        (21, "MF1='bad':'gbellmf',[1 2 3]", "'gbellmf' is not supported"),
        (21, "MF1='bad'", "'name':'kind',[parameters] was expected"),
        (34, "MF1='low':'linear',[1 2 3]", "'linear' is not supported"),
        (34, "MF1='low':'constant',[1 2]", "'constant' needs one number"),
        (34, "MF1='low':'constant',[1e13]", "'constant' needs one number"),
        (38, "1 -1, 1 (1) : 1", "a negated set (-1 of 'service')"),
        (38, "1 1.2, 1 (1) : 1", "a hedge (1.2 of 'service')"),
        (38, "3 1, 1 (1) : 1", "'food quality' has sets 1 to 2, not 3"),
        (38, "1 1, 3 (1) : 1", "'tip' has sets 1 to 2, not 3"),
        (38, "1 1, 0 (1) : 1", "'tip' has sets 1 to 2, not 0"),
        (38, "1, 1 (1) : 1", "the rule names 1 sets for 2 inputs"),
        (38, "1 1, 1 (2) : 1", "a rule's weight is within 0 to 1"),
        (38, "1 1, 1 (nan) : 1", "a rule's weight is within 0 to 1"),
        (38, "1 1, 1 (1) : 2", "joined by 'or'"),
        (38, "if good then high", "a rule reads like '1 1, 1 (1) : 1'"),
    ] {
        let mut lines: Vec<&str> = TEXT.lines().collect();
        lines[line - 1] = replaced_by;
        let error = Fis::parse("tip.fis", &lines.join("\n")).unwrap_err();
        assert_eq!((error.file.as_str(), error.line), ("tip.fis", line), "{replaced_by}: {error}");
        assert!(error.what.contains(says), "{replaced_by}: {error}");
    }
}

#[test]
fn missing_and_surplus_parts_are_named() {
    for (from, to, line, says) in [
        ("[System]", "", 5, "a section, beginning with [System], was expected"),
        ("[Input2]", "[Input3]", 1, "section [Input2] is missing"),
        ("[Rules]", "[Input3]\n[Rules]", 37, "section [Input3] is one too many"),
        ("NumRules = 3", "NumRules = 4", 37, "NumRules=4, but 3 rules follow"),
        ("NumMFs=1", "NumMFs=2", 24, "section [Input2] lacks MF2="),
        ("AndMethod", "AndMethods", 4, "section [System] lacks AndMethod="),
    ] {
        let error = Fis::parse("tip.fis", &TEXT.replacen(from, to, 1)).unwrap_err();
        assert_eq!(error.line, line, "{from}: {error}");
        assert!(error.what.contains(says), "{from}: {error}");
    }
    assert_eq!(Fis::parse("empty.fis", "").unwrap_err().to_string(), "empty.fis:1: section [System] is missing");
}

fn set() -> impl Strategy<Value = Membership> {
    let corners = prop::collection::vec(-1e3..1e3f64, 4).prop_map(|mut corners| {
        corners.sort_by(f64::total_cmp);
        corners
    });
    (corners, 0..3).prop_filter_map("distinct corners", |(p, kind)| match kind {
        0 => Membership::new("trimf", &p[..3]).ok(),
        1 => Membership::new("trapmf", &p).ok(),
        _ => Membership::new("gaussmf", &[p[0].abs(), p[1]]).ok(),
    })
}

fn variable<T: fmt::Debug>(value: impl Strategy<Value = T>) -> impl Strategy<Value = Variable<T>> {
    let terms = prop::collection::vec(("[a-zA-Z0-9 _=,:-]{0,6}", value), 3);
    ("[a-zA-Z0-9 _=-]{0,9}", -1e9..0.0, 1e-3..1e9, terms).prop_map(|(name, low, width, terms)| Variable {
        name,
        range: [low, low + width],
        terms: terms.into_iter().map(|(name, value)| Term { name, value }).collect(),
    })
}

fn system() -> impl Strategy<Value = Fis> {
    let rule = (prop::collection::vec(prop::option::of(0..3usize), 2), 0..3usize, 0.0..=1.0)
        .prop_map(|(antecedent, consequent, weight)| Rule { antecedent, consequent, weight });
    let inputs = prop::collection::vec(variable(set()), 2);
    ("[a-z' ]{0,9}", inputs, variable(-1e9..1e9f64), prop::collection::vec(rule, 1..9))
        .prop_map(|(name, inputs, output, rules)| Fis { name: name.replace('\'', ""), inputs, output, rules })
}

proptest! {
    #[test]
    fn what_is_written_is_read_back(fis in system()) {
        prop_assert_eq!(Fis::parse("file", &fis.to_string()), Ok(fis));
    }

    #[test]
    fn text_that_is_no_system_is_refused_with_the_name_of_its_file(text in any::<String>()) {
        let error = Sugeno::parse("file", &text).unwrap_err();
        prop_assert!(error.file == "file" && (1..=text.lines().count().max(1)).contains(&error.line), "{error}");
    }

    /// Nearly right is where a reader breaks: a good file with one line overwritten, and cut somewhere.
    #[test]
    fn a_damaged_file_is_refused_by_line_or_read_as_what_it_says(
        line in 0..42usize,
        with in "[-\\[\\]'=:,.() 0-9a-zA-ZµMF%\\n]{0,24}",
        keep in prop_oneof![0..900usize, Just(usize::MAX)],
    ) {
        let mut lines: Vec<&str> = TEXT.lines().collect();
        if let Some(line) = lines.get_mut(line) {
            *line = &with;
        }
        let text: String = lines.join("\n").chars().take(keep).collect();
        match Sugeno::parse("file", &text) {
            Ok(system) => {
                // Written again it is the same system, and its answer is a mean of its constants.
                let fis = Fis::parse("file", &text).unwrap();
                prop_assert_eq!(Fis::parse("file", &fis.to_string()), Ok(fis.clone()));
                let constants: Vec<f64> = fis.output.terms.iter().map(|term| term.value).collect();
                let [least, most] = [constants.iter().copied().fold(f64::INFINITY, f64::min),
                    constants.iter().copied().fold(f64::NEG_INFINITY, f64::max)];
                let answer = system.evaluate(&[1.0, 2.0]).unwrap();
                prop_assert!((least - 1e-9 * least.abs()..=most + 1e-9 * most.abs()).contains(&answer), "{answer}");
            }
            Err(error) => {
                let lines = 1..=text.lines().count().max(1);
                prop_assert!(error.file == "file" && lines.contains(&error.line), "{error}");
            }
        }
    }
}
