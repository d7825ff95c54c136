//! Writes a described system as its file, and reads it without the places.

use core::fmt;

use super::*;

impl Fis {
    /// Parses the text of a file. `file` is its name for errors.
    pub(in crate::control) fn parse(file: &str, text: &str) -> Result<Self, FisError> {
        read(file, text).map(|(fis, _)| fis)
    }
}

impl Consequent {
    /// A `constant`.
    pub(in crate::control) fn constant(constant: f64) -> Self {
        Self { slopes: Vec::new(), constant }
    }
}

impl Membership {
    /// The toolboxes' name of the function.
    pub(in crate::control) fn kind(&self) -> &'static str {
        match self {
            Self::Triangle(_) => "trimf",
            Self::Trapezoid(_) => "trapmf",
            Self::Gaussian(_) => "gaussmf",
            Self::TwoGaussians(_) => "gauss2mf",
            Self::Bell(_) => "gbellmf",
            Self::Sigmoid(_) => "sigmf",
            Self::SigmoidDifference(_) => "dsigmf",
            Self::SigmoidProduct(_) => "psigmf",
            Self::Z(_) => "zmf",
            Self::S(_) => "smf",
            Self::Pi(_) => "pimf",
        }
    }

    /// The parameters in the order of the file.
    pub(in crate::control) fn parameters(&self) -> &[f64] {
        match self {
            Self::Gaussian(p) | Self::Sigmoid(p) | Self::Z(p) | Self::S(p) => p,
            Self::Triangle(p) | Self::Bell(p) => p,
            Self::Trapezoid(p)
            | Self::TwoGaussians(p)
            | Self::SigmoidDifference(p)
            | Self::SigmoidProduct(p)
            | Self::Pi(p) => p,
        }
    }
}

impl fmt::Display for Fis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let and = match self.and {
            And::Product => "prod",
            And::Least => "min",
        };
        let or = match self.or {
            Or::ProbabilisticSum => "probor",
            Or::Greatest => "max",
        };
        let output_by = match self.output_by {
            OutputBy::WeightedAverage => "wtaver",
            OutputBy::WeightedSum => "wtsum",
        };
        let counts = [self.inputs.len(), self.outputs.len(), self.rules.len()];
        writeln!(f, "[System]\nName='{}'\nType='sugeno'\nVersion=2.0", self.name)?;
        writeln!(f, "NumInputs={}\nNumOutputs={}\nNumRules={}", counts[0], counts[1], counts[2])?;
        writeln!(
            f,
            "AndMethod='{and}'\nOrMethod='{or}'\nImpMethod='prod'\nAggMethod='sum'\nDefuzzMethod='{output_by}'"
        )?;
        for (number, input) in (1..).zip(&self.inputs) {
            writeln!(f, "\n[Input{number}]")?;
            write_variable(f, input, |set| (set.kind(), set.parameters().to_vec()))?;
        }
        for (number, output) in (1..).zip(&self.outputs) {
            writeln!(f, "\n[Output{number}]")?;
            write_variable(f, output, |Consequent { slopes, constant }| {
                let kind = if slopes.is_empty() { "constant" } else { "linear" };
                (kind, slopes.iter().chain([constant]).copied().collect())
            })?;
        }
        writeln!(f, "\n[Rules]")?;
        for rule in &self.rules {
            let set = |literal: &Option<Literal>| match literal {
                None => "0".to_string(),
                Some(Literal { set, is_negated }) => {
                    (if *is_negated { "-" } else { "" }).to_string() + &(set + 1).to_string()
                }
            };
            let sets: Vec<String> = rule.antecedent.iter().map(set).collect();
            let terms = rule.consequents.iter().map(|term| term.map_or(0, |term| term + 1).to_string());
            let terms: Vec<String> = terms.collect();
            let join = if rule.is_or { 2 } else { 1 };
            writeln!(f, "{}, {} ({}) : {join}", sets.join(" "), terms.join(" "), rule.weight)?;
        }
        Ok(())
    }
}

fn write_variable<T>(
    f: &mut fmt::Formatter<'_>,
    variable: &Variable<T>,
    describe: fn(&T) -> (&'static str, Vec<f64>),
) -> fmt::Result {
    let [low, high] = variable.range.map(number);
    writeln!(f, "Name='{}'\nRange=[{low} {high}]\nNumMFs={}", variable.name, variable.terms.len())?;
    for (nth, Term { name, value }) in (1..).zip(&variable.terms) {
        let (kind, parameters) = describe(value);
        let parameters: Vec<String> = parameters.into_iter().map(number).collect();
        writeln!(f, "MF{nth}='{name}':'{kind}',[{}]", parameters.join(" "))?;
    }
    Ok(())
}

/// A number as the toolboxes read it.
fn number(value: f64) -> String {
    if value.is_finite() { value.to_string() } else { (if value > 0.0 { "Inf" } else { "-Inf" }).to_string() }
}
