mod written;

use std::fmt;

use proptest::prelude::*;

use super::super::Sugeno;
use super::*;

/// A file as written by hand or by Octave: two inputs, all kinds of sets, a weight, and a rule that ignores an input.
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

fn literal(set: usize) -> Option<Literal> {
    Some(Literal { set, is_negated: false })
}

#[test]
fn a_file_is_read() {
    let fis = Fis::parse("tip.fis", TEXT).unwrap();
    assert_eq!(fis.name, "tip");
    assert_eq!(fis.inputs[0].name, "food quality");
    assert_eq!(fis.inputs[0].terms[1].value, Membership::new("trimf", &[3.0, 10.0, 17.0]).unwrap());
    assert_eq!(fis.inputs[1].terms[0].value, Membership::new("gaussmf", &[4.0, 5.0]).unwrap());
    assert_eq!(fis.outputs[0].terms[1], Term { name: "high".into(), value: Consequent::constant(20.5) });
    let rule = Rule { antecedent: vec![literal(0), None], is_or: false, consequents: vec![Some(0)], weight: 1.0 };
    assert_eq!(fis.rules[0], rule);
    assert_eq!(
        fis.rules[1],
        Rule { antecedent: vec![literal(1), literal(0)], consequents: vec![Some(1)], weight: 0.5, ..rule }
    );
}

/// Each replaced line changes nothing: the file is read as before.
#[test]
fn what_changes_nothing_is_read_as_if_it_were_not_there() {
    let expected = Fis::parse("tip.fis", TEXT).unwrap();
    let same = |text: &str, why: &str| match Fis::parse("tip.fis", text) {
        Ok(mut fis) => {
            // The name and the range of the output have no meaning.
            fis.name.clone_from(&expected.name);
            fis.outputs[0].range = expected.outputs[0].range;
            assert_eq!(fis, expected, "{why}");
        }
        Err(error) => panic!("{why}: {error}"),
    };
    for (line, replaced_by) in [
        (4, "[SYSTEM]"),
        (4, "  [ System ]  % of tips"),
        (5, ""),
        (5, "Name=tip"),
        (5, "Name=\"tip\""),
        (5, "Name='the owner's tip'"),
        (5, "Name='50 % # of it'"),
        (6, "Type=\"Sugeno\""),
        (6, "type = sugeno"),
        (7, ""),
        (7, "Version=4.0"),
        (7, "Version=2.0.1 of 2024"),
        (8, ""),
        (8, "NumInputs=2.000"),
        (9, ""),
        (10, ""),
        (10, "num rules = 3 % three"),
        (12, "OrMethod=''"),
        (12, ""),
        (12, "OrMethod='einstein_sum'"),
        (13, "ImpMethod='min'"),
        (13, ""),
        (14, "AggMethod='max'"),
        (14, ""),
        (16, "Colour='red'"),
        (16, "Version=3.0"),
        (16, "AndMethod='prod'"),
        (20, ""),
        (20, "Enabled=1\nLockValueInRange=0"),
        (20, "Default=nan\nNumMFs=2\nLockPrevious=1"),
        (21, "MF2='good':'trimf',[3 10 17]\nmf1=\"bad\":\"TRAPMF\",[-1 0 3 7] # first"),
        (24, "[Input 2]"),
        (32, ""),
        (32, "Range=[0 0]"),
        (32, "Range=[-Inf Inf]"),
        (32, "Range=[-pi/4 pi]"),
        (34, "MF1='low':'constant',[10 0 0]"),
        (38, "1.000 0 , 1.000 (1.000) : 1  "),
        (38, "\t1\t0,\t1\t(1)\t:\t1"),
        (38, "+1 -0, 1 (1) : 1 % bad"),
        (38, "1 0, 1 (1) : 2"),
    ] {
        let mut lines: Vec<&str> = TEXT.lines().collect();
        let first = lines[20];
        lines[line - 1] = replaced_by;
        let mut text = lines.join("\n");
        if replaced_by.contains("mf1=") {
            text = text.replacen("MF2 = 'good' : 'trimf', [3, 10, 17]\n", "", 1);
        } else {
            assert!(line == 21 || text.contains(first), "the line numbers of this test are those of the text");
        }
        if line == 38 && replaced_by.ends_with(": 2") {
            // With one set "or" and "and" are the same; only the rule says which it is.
            let mut fis = Fis::parse("tip.fis", &text).unwrap();
            fis.rules[0].is_or = false;
            assert_eq!(fis, expected);
            continue;
        }
        if replaced_by.contains("owner") || replaced_by.contains("50 %") {
            assert!(Fis::parse("tip.fis", &text).unwrap().name.len() > 10, "{replaced_by}");
        }
        same(&text, replaced_by);
    }
    let text = TEXT.replace("\r\n", "\n").replace('\u{feff}', "");
    same(&text.replace('\n', "\r\n"), "lines end as in DOS");
    same(&text.replace('\n', "\r"), "lines end as on old Macs");
    same(&(text.clone() + "\u{1a}"), "the file ends as in DOS");
    let (inputs, rest) = text.split_once("[Output1]").unwrap();
    let (system, inputs) = inputs.split_once("[Input1]").unwrap();
    same(&format!("[Output1]{rest}\n[Notes]\nAuthor=me\n[Input1]{inputs}\n{system}"), "sections in another order");
}

/// Each replaced line gives an error that names its line and column (from 1) and its fault.
#[test]
fn what_is_wrong_is_refused_by_name() {
    for (line, replaced_by, column, expected) in [
        (5, "Name='tip", 6, "a text in quotes was expected"),
        (6, "Type='mamdani'", 6, "this is a Mamdani system"),
        (6, "Type='tsukamoto'", 6, "Type='tsukamoto' is not supported"),
        (6, "Kind='sugeno'", 1, "section [System] lacks Type="),
        (8, "NumInputs=0", 11, "NumInputs=0 is not supported"),
        (8, "NumInputs=two", 11, "'two' is not such a number"),
        (9, "NumOutputs=1.5", 12, "NumOutputs=1.5 is not supported"),
        (11, "AndMethod='einstein_product'", 11, "is not supported; prod and min"),
        (15, "DefuzzMethod='centroid'", 14, "DefuzzMethod='centroid' is not supported; wtaver and wtsum are"),
        (16, "DefuzzMethod='wtsum'", 14, "[System] has two values of DefuzzMethod"),
        (16, "TypeReductionMethod='karnikmendel'", 21, "a type-2 system is not supported"),
        (16, "no key", 1, "a line KEY=VALUE was expected"),
        (19, "Range=[10 0]", 7, "Range needs low < high"),
        (19, "Range=[0 10 20]", 7, "Range needs [low high]"),
        (19, "Range=[-Inf 10]", 7, "Range needs two finite numbers"),
        (19, "Range=0 10", 7, "numbers in [ ] were expected"),
        (19, "Range=[0 nan]", 10, "'nan' is not a number"),
        (20, "NumMFs=1", 1, "has no use for 'MF2 ="),
        (20, "NumMFs=1.5", 8, "NumMFs is not within"),
        (20, "Enabled=0", 9, "a disabled variable is not supported"),
        (21, "MF1='bad':'trapmf',[0 3 2 7]", 12, "a <= b <= c <= d"),
        (21, "MF1='bad':'trapmf',[0 3 7]", 12, "takes 4 parameters, not 3"),
        (21, "MF1='bad':'cosmf',[1 2 3]", 12, "'cosmf' is not supported"),
        (21, "MF1='bad'", 5, "'name':'kind',[parameters] was expected"),
        (21, "MF1='bad':'trapmf',[0 3 x 7]", 25, "'x' is not a number"),
        (33, "LockRange=1\nNumMFs=2", 11, "an output that is cut to its range"),
        (34, "MF1='low':'linear',[1 2]", 12, "'linear' needs 3 numbers"),
        (34, "MF1='low':'constant',[1 2]", 12, "'constant' needs one number"),
        (34, "MF1='low':'constant',[1e13]", 12, "'constant' needs one number"),
        (34, "MF1='low':'function',[]", 12, "'function' is not supported"),
        (38, "1 1.2, 1 (1) : 1", 3, "a hedge (1.2 of 'service')"),
        (38, "3 1, 1 (1) : 1", 1, "'food quality' has sets 1 to 2, not 3"),
        (38, "1 -2, 1 (1) : 1", 3, "'service' has sets 1 to 1, not -2"),
        (38, "1 1, 3 (1) : 1", 6, "'tip' has sets 1 to 2, not 3"),
        (38, "1 1, 0 (1) : 1", 6, "'tip' has terms 1 to 2, not 0"),
        (38, "1 1, -1 (1) : 1", 6, "a negated consequent"),
        (38, "1 1, 1 2 (1) : 1", 6, "the rule names 2 terms for 1 outputs"),
        (38, "1, 1 (1) : 1", 1, "the rule names 1 sets for 2 inputs"),
        (38, "1 1, 1 (2) : 1", 9, "a rule's weight is within 0 to 1"),
        (38, "1 1, 1 (nan) : 1", 9, "a rule's weight is within 0 to 1"),
        (38, "0 0, 1 (1) : 2", 1, "a rule joined by 'or' (2) needs a set"),
        (38, "1 1, 1 (1) : 2", 12, "is not supported; probor and max"),
        (38, "1 1, 1 (1) : 3", 1, "a rule reads like '1 1, 1 (1) : 1'"),
        (38, "if good then high", 1, "a rule reads like '1 1, 1 (1) : 1'"),
    ] {
        let mut lines: Vec<&str> = TEXT.lines().collect();
        lines[line - 1] = replaced_by;
        let text = lines.join("\n").replacen("OrMethod = 'max'", "OrMethod = 'drastic_sum'", 1);
        let error = Fis::parse("tip.fis", &text).unwrap_err();
        assert!(error.what.contains(expected), "{replaced_by}: {error}");
        // What is missing or surplus is elsewhere.
        let line = match replaced_by {
            "Kind='sugeno'" => 4,
            "NumMFs=1" => 22,
            "DefuzzMethod='wtsum'" => 15,
            "1 1, 1 (1) : 2" => 12,
            _ => line,
        };
        let column = match replaced_by {
            "DefuzzMethod='wtsum'" => 16,
            _ => column,
        };
        assert_eq!(
            (error.file.as_str(), error.line, error.column),
            ("tip.fis", line, column),
            "{replaced_by}: {error}"
        );
    }
}

#[test]
fn missing_and_surplus_parts_are_named() {
    for (from, to, line, expected) in [
        ("[System]", "", 5, "a section, beginning with [System], was expected"),
        ("[Input2]", "[Input3]", 1, "section [Input2] is missing"),
        ("[Rules]", "[Input3]\n[Rules]", 37, "section [Input3] is one too many"),
        ("[Rules]", "[Rules]\n[Rules]", 38, "section [Rules] is one too many"),
        ("NumRules = 3", "NumRules = 4", 37, "NumRules=4, but 3 rules follow"),
        ("NumMFs=1", "NumMFs=2", 24, "section [Input2] lacks MF2="),
        ("AndMethod", "AndMethods", 4, "section [System] lacks AndMethod="),
        ("Range = [0 10]", "", 17, "section [Input1] lacks Range="),
    ] {
        let error = Fis::parse("tip.fis", &TEXT.replacen(from, to, 1)).unwrap_err();
        assert_eq!(error.line, line, "{from}: {error}");
        assert!(error.what.contains(expected), "{from}: {error}");
    }
    assert_eq!(Fis::parse("empty.fis", "").unwrap_err().to_string(), "empty.fis:1:1: section [System] is missing");
}

fn set() -> impl Strategy<Value = Membership> {
    let corners = prop::collection::vec(-1e3..1e3f64, 4).prop_map(|mut corners| {
        corners.sort_by(f64::total_cmp);
        corners
    });
    let kinds = [("trimf", 3), ("trapmf", 4), ("gaussmf", 2), ("zmf", 2), ("pimf", 4), ("gbellmf", 3), ("linsmf", 2)];
    (corners, 0..kinds.len())
        .prop_filter_map("distinct corners", move |(p, kind)| Membership::new(kinds[kind].0, &p[..kinds[kind].1]).ok())
}

fn variable<T: fmt::Debug>(value: impl Strategy<Value = T>) -> impl Strategy<Value = Variable<T>> {
    let terms = prop::collection::vec(("[a-zA-Z0-9 _=,:-]{0,6}", value), 3);
    ("[a-zA-Z0-9 _=-]{0,9}", -1e9..0.0, 1e-3..1e9, terms).prop_map(|(name, low, width, terms)| Variable {
        name,
        range: [low, low + width],
        terms: terms.into_iter().map(|(name, value)| Term { name, value }).collect(),
    })
}

fn consequent() -> impl Strategy<Value = Consequent> {
    (prop::option::of(prop::array::uniform2(-1e9..1e9f64)), -1e9..1e9f64)
        .prop_map(|(slopes, constant)| Consequent { slopes: slopes.map(Vec::from).unwrap_or_default(), constant })
}

fn system() -> impl Strategy<Value = Fis> {
    let literal =
        prop::option::of((0..3usize, any::<bool>()).prop_map(|(set, is_negated)| Literal { set, is_negated }));
    let rule = (prop::collection::vec(literal, 2), any::<bool>(), 0..3usize, prop::option::of(0..3usize), 0.0..=1.0)
        .prop_map(|(antecedent, is_or, first, second, weight)| Rule {
            is_or: is_or && antecedent.iter().any(Option::is_some),
            antecedent,
            consequents: vec![Some(first), second],
            weight,
        });
    let inputs = prop::collection::vec(variable(set()), 2);
    let outputs = prop::collection::vec(variable(consequent()), 2);
    let methods = (any::<bool>(), any::<bool>(), any::<bool>());
    ("[a-z' ]{0,9}", inputs, outputs, prop::collection::vec(rule, 1..9), methods).prop_map(
        |(name, inputs, outputs, rules, (and, or, sum))| {
            // A method that joins nothing is not kept.
            let joins = |is_or: bool| {
                rules.iter().any(|rule| rule.is_or == is_or && rule.antecedent.iter().flatten().count() > 1)
            };
            Fis {
                name: name.replace('\'', ""),
                and: if and && joins(false) { And::Least } else { And::Product },
                or: if or && joins(true) { Or::Greatest } else { Or::ProbabilisticSum },
                output_by: if sum { OutputBy::WeightedSum } else { OutputBy::WeightedAverage },
                inputs,
                outputs,
                rules,
            }
        },
    )
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

    /// Almost valid files: a valid one with one line overwritten and its end cut off.
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
                let answer = system.evaluate(&[1.0, 2.0]);
                if fis.outputs[0].terms.iter().all(|term| term.value.is_constant()) && system.inputs() == 2 {
                    let constants: Vec<f64> = fis.outputs[0].terms.iter().map(|term| term.value.constant).collect();
                    let [least, most] = [constants.iter().copied().fold(f64::INFINITY, f64::min),
                        constants.iter().copied().fold(f64::NEG_INFINITY, f64::max)];
                    let answer = answer.unwrap();
                    let is_mean = (least - 1e-9 * least.abs()..=most + 1e-9 * most.abs()).contains(&answer);
                    prop_assert!(is_mean || fis.output_by == OutputBy::WeightedSum, "{answer}");
                }
            }
            Err(error) => {
                let lines = 1..=text.lines().count().max(1);
                prop_assert!(error.file == "file" && lines.contains(&error.line), "{error}");
            }
        }
    }
}
