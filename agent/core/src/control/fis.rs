//! The `.fis` text format of fuzzy inference systems, as written by the fuzzy toolboxes of Matlab and Octave.
//!
//! ```text
//! [System]
//! Name='heading'
//! Type='sugeno'
//! Version=2.0
//! NumInputs=2
//! NumOutputs=1
//! NumRules=15
//! AndMethod='prod'
//! OrMethod='probor'
//! ImpMethod='prod'
//! AggMethod='sum'
//! DefuzzMethod='wtaver'
//!
//! [Input1]
//! Name='heading_error_rad'
//! Range=[-2 2]
//! NumMFs=5
//! MF1='NB':'trapmf',[-1001 -1000 -1 -0.3]
//! ...
//! [Rules]
//! 1 1, 4 (1) : 1
//! ```
//!
//! A rule names one set per input (0: any), then the output's constant, its weight, and 1 for "and". The reader accepts
//! zero-order Sugeno systems with one output and names every other feature that it refuses. Lines that begin with
//! `%` or `#` are comments.

use alloc::borrow::ToOwned;
use alloc::collections::VecDeque;
use alloc::format;
use alloc::string::String;
use alloc::string::ToString;
use alloc::vec;
use alloc::vec::Vec;
use core::fmt;
use core::str::FromStr;

use super::membership::{LARGEST, Membership};

/// Largest number of sets or rules in a section: far above any published controller.
const LARGEST_COUNT: usize = 10_000;

/// A fault in a `.fis` file, with its place.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}:{line}: {what}")]
pub struct FisError {
    /// The file's name, as given by the caller.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// Description of the fault, one sentence.
    pub what: String,
}

/// A zero-order Sugeno system as described by its file. Its `Display` writes the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Fis {
    pub(super) name: String,
    pub(super) inputs: Vec<Variable<Membership>>,
    pub(super) output: Variable<f64>,
    pub(super) rules: Vec<Rule>,
}

/// An input with its fuzzy sets, or the output with its constants.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Variable<T> {
    pub(super) name: String,
    /// Lower and upper end of the range.
    pub(super) range: [f64; 2],
    pub(super) terms: Vec<Term<T>>,
}

/// A set or a constant with its name.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Term<T> {
    pub(super) name: String,
    pub(super) value: T,
}

/// A rule: if every named input belongs to its set, the output is this constant.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Rule {
    /// Index of each input's set, from 0; `None` for any.
    pub(super) antecedent: Vec<Option<usize>>,
    /// Index of the constant, from 0.
    pub(super) consequent: usize,
    /// Weight, 0 to 1.
    pub(super) weight: f64,
}

impl Fis {
    /// Parses the text of a file. `file` is its name for errors.
    ///
    /// # Errors
    ///
    /// The first fault of the text, with its line.
    pub fn parse(file: &str, text: &str) -> Result<Self, FisError> {
        let mut sections = sections(file, text)?;
        let mut system = take_section(&mut sections, file, "System")?;
        let name = system.take("Name")?.quoted()?.to_owned();
        let [inputs, rules] = read_system(system)?;
        let inputs = (1..=inputs)
            .map(|i| read_variable(take_section(&mut sections, file, &format!("Input{i}"))?, membership))
            .collect::<Result<Vec<_>, _>>()?;
        let output = read_variable(take_section(&mut sections, file, "Output1")?, constant)?;
        let rules = read_rules(take_section(&mut sections, file, "Rules")?, rules, &inputs, &output)?;
        match sections.first() {
            Some(extra) => Err(error(file, extra.line, format!("section [{}] is one too many", extra.name))),
            None => Ok(Self { name, inputs, output, rules }),
        }
    }
}

/// Checks the methods and returns the numbers of inputs and rules.
fn read_system(mut system: Section<'_>) -> Result<[usize; 2], FisError> {
    system.take("Version")?.number::<f64>()?;
    // Rules joined by "or" are refused, so the method of "or" is irrelevant.
    system.take("OrMethod")?.quoted()?;
    for (key, only, why) in [
        ("Type", "sugeno", "only 'sugeno' is"),
        ("AndMethod", "prod", "memberships are multiplied: 'prod'"),
        ("ImpMethod", "prod", "a rule scales its constant: 'prod'"),
        ("AggMethod", "sum", "a weighted average sums its rules: 'sum'"),
        ("DefuzzMethod", "wtaver", "the output is the weighted average: 'wtaver'"),
    ] {
        let value = system.take(key)?;
        if value.quoted()? != only {
            return Err(value.error(format!("{key}={} is not supported; {why}", value.text)));
        }
    }
    let mut count = |key: &str, most: usize| {
        let value = system.take(key)?;
        match value.number()? {
            count if (1..=most).contains(&count) => Ok(count),
            count => Err(value.error(format!("{key}={count} is not supported: it is within 1 to {most}"))),
        }
    };
    count("NumOutputs", 1)?;
    let counts = [count("NumInputs", LARGEST_COUNT)?, count("NumRules", LARGEST_COUNT)?];
    system.finish()?;
    Ok(counts)
}

/// Reads an `[Input]` or `[Output]` section; `term` builds a term from its kind and parameters.
fn read_variable<T>(
    mut section: Section<'_>,
    term: fn(&str, &[f64]) -> Result<T, String>,
) -> Result<Variable<T>, FisError> {
    let name = section.take("Name")?.quoted()?.to_owned();
    let range = section.take("Range")?;
    let &[low, high] = range.numbers(range.text)?.as_slice() else {
        return Err(range.error("Range needs [low high]"));
    };
    if !(low < high && -LARGEST <= low && high <= LARGEST) {
        return Err(range.error(format!("Range needs low < high, both within ±{LARGEST:e}")));
    }
    let count = section.take("NumMFs")?;
    let terms = (1..=count.number::<usize>()?.min(LARGEST_COUNT + 1))
        .map(|i| {
            let value = section.take(&format!("MF{i}"))?;
            let (name, kind, parameters) = value.membership()?;
            let parameters = value.numbers(parameters)?;
            Ok(Term { name: name.to_owned(), value: term(kind, &parameters).map_err(|what| value.error(what))? })
        })
        .collect::<Result<Vec<_>, FisError>>()?;
    if !(1..=LARGEST_COUNT).contains(&terms.len()) {
        return Err(count.error(format!("NumMFs is not within 1 to {LARGEST_COUNT}")));
    }
    section.finish()?;
    Ok(Variable { name, range: [low, high], terms })
}

fn membership(kind: &str, parameters: &[f64]) -> Result<Membership, String> {
    Membership::new(kind, parameters)
}

fn constant(kind: &str, parameters: &[f64]) -> Result<f64, String> {
    match (kind, parameters) {
        ("constant", &[value]) if value.abs() <= LARGEST => Ok(value),
        ("constant", _) => Err(format!("'constant' needs one number within ±{LARGEST:e}")),
        _ => Err(format!("'{kind}' is not supported: a consequent is a 'constant'")),
    }
}

fn read_rules(
    section: Section<'_>,
    count: usize,
    inputs: &[Variable<Membership>],
    output: &Variable<f64>,
) -> Result<Vec<Rule>, FisError> {
    if section.lines.len() != count {
        let found = section.lines.len();
        return Err(error(section.file, section.line, format!("NumRules={count}, but {found} rules follow")));
    }
    let rule =
        |&(line, text): &(usize, &str)| read_rule(text, inputs, output).map_err(|what| error(section.file, line, what));
    section.lines.iter().map(rule).collect()
}

/// Reads a rule such as `1 0 3, 2 (1) : 1`.
fn read_rule(text: &str, inputs: &[Variable<Membership>], output: &Variable<f64>) -> Result<Rule, String> {
    let form = || format!("a rule reads like '{}, 1 (1) : 1', not '{text}'", vec!["1"; inputs.len()].join(" "));
    let (antecedent, rest) = text.split_once(',').ok_or_else(form)?;
    let (consequent, rest) = rest.split_once('(').ok_or_else(form)?;
    let (weight, connection) = rest.split_once(')').ok_or_else(form)?;
    let connection = connection.trim_start().strip_prefix(':').ok_or_else(form)?.trim();
    match connection {
        "1" => (),
        "2" => return Err("a rule joined by 'or' (2) is not supported: only 'and' (1) is".into()),
        _ => return Err(form()),
    }
    let sets: Vec<&str> = antecedent.split_whitespace().collect();
    if sets.len() != inputs.len() {
        return Err(format!("the rule names {} sets for {} inputs", sets.len(), inputs.len()));
    }
    let antecedent = sets
        .iter()
        .zip(inputs)
        .map(|(set, input)| if *set == "0" { Ok(None) } else { index(set, &input.name, input.terms.len()).map(Some) })
        .collect::<Result<Vec<_>, _>>()?;
    let consequent = index(consequent.trim(), &output.name, output.terms.len())?;
    let weight = weight.trim().parse().map_err(|_| form())?;
    if !(0.0..=1.0).contains(&weight) {
        return Err(format!("a rule's weight is within 0 to 1, not {weight}"));
    }
    Ok(Rule { antecedent, consequent, weight })
}

/// The index from 0 of the term whose number from 1 is `text`.
fn index(text: &str, variable: &str, terms: usize) -> Result<usize, String> {
    match text.parse::<f64>() {
        Ok(number) if number < 0.0 => Err(format!("a negated set ({text} of '{variable}') is not supported")),
        Ok(number) if number.fract() != 0.0 => Err(format!("a hedge ({text} of '{variable}') is not supported")),
        Ok(number) if (1.0..=terms as f64).contains(&number) => Ok(number as usize - 1),
        _ => Err(format!("'{variable}' has sets 1 to {terms}, not {text}")),
    }
}

/// A section of the file, from its `[heading]` to the next.
struct Section<'a> {
    file: &'a str,
    name: &'a str,
    line: usize,
    /// Line numbers and trimmed texts, without comments and empty lines.
    lines: VecDeque<(usize, &'a str)>,
}

fn sections<'a>(file: &'a str, text: &'a str) -> Result<Vec<Section<'a>>, FisError> {
    let mut sections: Vec<Section<'_>> = Vec::new();
    for (line, text) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let text = text.trim();
        if text.is_empty() || text.starts_with(['%', '#']) {
            continue;
        }
        if let Some(name) = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            sections.push(Section { file, name, line, lines: VecDeque::new() });
        } else if let Some(section) = sections.last_mut().filter(|section| section.lines.len() <= LARGEST_COUNT + 3) {
            section.lines.push_back((line, text));
        } else {
            return Err(error(file, line, "a section, beginning with [System], was expected"));
        }
    }
    Ok(sections)
}

fn take_section<'a>(sections: &mut Vec<Section<'a>>, file: &str, name: &str) -> Result<Section<'a>, FisError> {
    match sections.iter().position(|section| section.name == name) {
        Some(place) => Ok(sections.remove(place)),
        None => Err(error(file, 1, format!("section [{name}] is missing"))),
    }
}

impl<'a> Section<'a> {
    /// Takes the line `key=…` out of the section.
    fn take(&mut self, key: &str) -> Result<Value<'a>, FisError> {
        let place = self.lines.iter().position(|(_, text)| text.split('=').next().map(str::trim_end) == Some(key));
        match place.and_then(|place| self.lines.remove(place)) {
            Some((line, text)) => {
                Ok(Value { file: self.file, line, text: text.split_once('=').map_or("", |(_, value)| value).trim() })
            }
            None => Err(error(self.file, self.line, format!("section [{}] lacks {key}=", self.name))),
        }
    }

    /// Checks that no line is left.
    fn finish(self) -> Result<(), FisError> {
        match self.lines.front() {
            Some((line, text)) => Err(error(self.file, *line, format!("[{}] has no use for '{text}'", self.name))),
            None => Ok(()),
        }
    }
}

/// The value to the right of a key.
struct Value<'a> {
    file: &'a str,
    line: usize,
    text: &'a str,
}

impl<'a> Value<'a> {
    fn error(&self, what: impl Into<String>) -> FisError {
        error(self.file, self.line, what)
    }

    fn number<T: FromStr>(&self) -> Result<T, FisError> {
        self.text.parse().map_err(|_| self.error(format!("'{}' is not such a number", self.text)))
    }

    /// The text between single quotes, as in `'…'`.
    fn quoted(&self) -> Result<&'a str, FisError> {
        unquote(self.text).ok_or_else(|| self.error(format!("a text in single quotes was expected, not {}", self.text)))
    }

    /// The numbers of a list such as `[1 2 3]`; commas count as white space.
    fn numbers(&self, text: &str) -> Result<Vec<f64>, FisError> {
        let inner = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        let inner = inner.ok_or_else(|| self.error(format!("numbers in [ ] were expected, not {text}")))?;
        inner
            .split(|c: char| c.is_whitespace() || c == ',')
            .filter(|item| !item.is_empty())
            .map(|item| match item.parse::<f64>() {
                Ok(number) if number.is_finite() => Ok(number),
                _ => Err(self.error(format!("'{item}' is not a finite number"))),
            })
            .collect()
    }

    /// Name, kind and parameters of `'name':'kind',[parameters]`.
    fn membership(&self) -> Result<(&'a str, &'a str, &'a str), FisError> {
        // A name may hold colons and commas.
        let parts: Vec<&str> = self.text.splitn(5, '\'').collect();
        let parameters = parts.last().and_then(|last| last.trim_start().strip_prefix(','));
        match (&parts[..], parameters) {
            (&["", name, colon, kind, _], Some(parameters)) if colon.trim() == ":" => {
                Ok((name, kind, parameters.trim_start()))
            }
            _ => Err(self.error(format!("'name':'kind',[parameters] was expected, not {}", self.text))),
        }
    }
}

fn unquote(text: &str) -> Option<&str> {
    text.strip_prefix('\'')?.strip_suffix('\'').filter(|inner| !inner.contains('\''))
}

fn error(file: &str, line: usize, what: impl Into<String>) -> FisError {
    FisError { file: file.to_owned(), line, what: what.into() }
}

impl fmt::Display for Fis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "[System]\nName='{}'\nType='sugeno'\nVersion=2.0", self.name)?;
        writeln!(f, "NumInputs={}\nNumOutputs=1\nNumRules={}", self.inputs.len(), self.rules.len())?;
        writeln!(f, "AndMethod='prod'\nOrMethod='probor'\nImpMethod='prod'\nAggMethod='sum'\nDefuzzMethod='wtaver'")?;
        for (number, input) in (1..).zip(&self.inputs) {
            writeln!(f, "\n[Input{number}]")?;
            write_variable(f, input, |set| (set.kind(), set.parameters()))?;
        }
        writeln!(f, "\n[Output1]")?;
        write_variable(f, &self.output, |constant| ("constant", core::slice::from_ref(constant)))?;
        writeln!(f, "\n[Rules]")?;
        for Rule { antecedent, consequent, weight } in &self.rules {
            let sets: Vec<String> = antecedent.iter().map(|set| set.map_or(0, |set| set + 1).to_string()).collect();
            writeln!(f, "{}, {} ({weight}) : 1", sets.join(" "), consequent + 1)?;
        }
        Ok(())
    }
}

fn write_variable<T>(
    f: &mut fmt::Formatter<'_>,
    variable: &Variable<T>,
    describe: fn(&T) -> (&str, &[f64]),
) -> fmt::Result {
    let [low, high] = variable.range;
    writeln!(f, "Name='{}'\nRange=[{low} {high}]\nNumMFs={}", variable.name, variable.terms.len())?;
    for (number, Term { name, value }) in (1..).zip(&variable.terms) {
        let (kind, parameters) = describe(value);
        let parameters: Vec<String> = parameters.iter().map(f64::to_string).collect();
        writeln!(f, "MF{number}='{name}':'{kind}',[{}]", parameters.join(" "))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
