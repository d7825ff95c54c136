//! The `.fis` text format of fuzzy inference systems, as written by people and by the fuzzy toolboxes of Matlab and Octave.
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
//! MF1='NB':'trapmf',[-Inf -Inf -1 -0.3]
//! ...
//! [Rules]
//! 1 -2, 4 (1) : 1
//! ```
//!
//! A rule names one set per input (0: any, negative: not in the set), then one term per output (0: none), its weight, and 1
//! for "and" or 2 for "or". The reader accepts Sugeno systems. It ignores what does not change the output of one: `Version`,
//! `ImpMethod` and `AggMethod` (a Sugeno system sums its rules), methods that no rule uses, the range of an output, keys and
//! sections that it does not know. It names every feature that it refuses, and every contradiction, with its place.
//! Lines that begin with `%` or `#` are comments, and so is the rest of a line from there on.

mod read;

use alloc::format;
use alloc::string::String;
use alloc::string::ToString;
use alloc::vec::Vec;

use super::membership::Membership;
pub(super) use read::{Places, read};

/// A fault in a `.fis` file, with its place.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}:{line}:{column}: {what}")]
pub struct FisError {
    /// The file's name, as given by the caller.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1, in characters.
    pub column: usize,
    /// Description of the fault, one sentence.
    pub what: String,
}

/// A Sugeno system as described by its file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fis {
    pub(super) name: String,
    pub(super) and: And,
    pub(super) or: Or,
    pub(super) output_by: OutputBy,
    pub(super) inputs: Vec<Variable<Membership>>,
    pub(super) outputs: Vec<Variable<Consequent>>,
    pub(super) rules: Vec<Rule>,
}

/// The operation by which "and" joins degrees, `AndMethod`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum And {
    Product,
    Least,
}

/// The operation by which "or" joins degrees, `OrMethod`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Or {
    /// a + b − a b, `probor`.
    ProbabilisticSum,
    Greatest,
}

/// The method by which the rules give an output, `DefuzzMethod`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OutputBy {
    /// `wtaver`.
    WeightedAverage,
    /// `wtsum`.
    WeightedSum,
}

/// An input with its fuzzy sets, or an output with its consequents.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Variable<T> {
    pub(super) name: String,
    /// Lower and upper end of the range; that of an output has no meaning.
    pub(super) range: [f64; 2],
    pub(super) terms: Vec<Term<T>>,
}

/// A set or a consequent with its name.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Term<T> {
    pub(super) name: String,
    pub(super) value: T,
}

/// The output of a rule: a constant, plus a multiple of each input.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Consequent {
    /// A factor for each input (`linear`); empty for a `constant`.
    pub(super) slopes: Vec<f64>,
    pub(super) constant: f64,
}

/// A rule: as far as the named inputs belong to their sets, the outputs are these consequents.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Rule {
    /// Each input's set; `None` for any.
    pub(super) antecedent: Vec<Option<Literal>>,
    /// Whether one of the sets is enough ("or").
    pub(super) is_or: bool,
    /// Index of each output's consequent, from 0; `None` if the rule says nothing about it.
    pub(super) consequents: Vec<Option<usize>>,
    /// Weight, 0 to 1.
    pub(super) weight: f64,
}

/// A set in a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Literal {
    /// Index of the set, from 0.
    pub(super) set: usize,
    /// Whether the input must not belong to it.
    pub(super) is_negated: bool,
}

impl Consequent {
    /// Whether the inputs do not change it.
    pub(super) fn is_constant(&self) -> bool {
        self.slopes.iter().all(|slope| *slope == 0.0)
    }
}

impl Fis {
    /// Index of the only output, or of several the only one that has one of these names.
    ///
    /// # Errors
    ///
    /// A sentence with the names of the outputs, if none or more than one has such a name.
    pub(super) fn output_named(&self, names: &[&str]) -> Result<usize, String> {
        let is_meant = |output: &Variable<Consequent>| names.iter().any(|name| output.name.eq_ignore_ascii_case(name));
        let meant: Vec<usize> = (0..self.outputs.len()).filter(|&nth| is_meant(&self.outputs[nth])).collect();
        match (self.outputs.len(), meant.as_slice()) {
            (1, _) => Ok(0),
            (_, &[only]) => Ok(only),
            (count, _) => {
                let outputs: Vec<&str> = self.outputs.iter().map(|output| output.name.as_str()).collect();
                let remedy = match names {
                    [] => "leave one".to_string(),
                    [first, ..] => format!("name the one to use '{first}'"),
                };
                Err(format!("the file has {count} outputs ({}), and one is needed: {remedy}", outputs.join(", ")))
            }
        }
    }
}

#[cfg(test)]
mod tests;
