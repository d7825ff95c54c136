//! Reads a `.fis` text: its sections, then what they say.

use alloc::borrow::{Cow, ToOwned};
use alloc::collections::BTreeMap;
use alloc::format;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;
use core::f64::consts::PI;

use super::{And, Consequent, Fis, FisError, Literal, Or, OutputBy, Rule, Term, Variable};
use crate::control::membership::{LARGEST, Membership};

/// Largest number of variables, sets or rules: far above any published controller.
const LARGEST_COUNT: usize = 10_000;

/// A place in a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::control) struct Place {
    /// Line and column, from 1.
    pub(in crate::control) line: usize,
    pub(in crate::control) column: usize,
}

impl Place {
    /// A fault at this place.
    pub(in crate::control) fn error(self, file: &str, what: impl Into<String>) -> FisError {
        FisError { file: file.to_owned(), line: self.line, column: self.column, what: what.into() }
    }
}

/// The places of a file's parts: its inputs, their ranges, its outputs and its rules.
#[derive(Clone, Debug)]
pub(in crate::control) struct Places {
    /// The name of each input, or its section.
    pub(in crate::control) inputs: Vec<Place>,
    /// The range of each input.
    pub(in crate::control) ranges: Vec<Place>,
    /// The name of each output, or its section.
    pub(in crate::control) outputs: Vec<Place>,
    /// The heading of the rules.
    pub(in crate::control) rules: Place,
}

/// Reads a text, with the places of its parts. `file` is its name for errors.
///
/// # Errors
///
/// The first fault of the text, with its place.
pub(in crate::control) fn read(file: &str, text: &str) -> Result<(Fis, Places), FisError> {
    let text = one_kind_of_line_end(text);
    let mut sections = Sections::of(file, &text)?;
    let system = sections.take("System")?;
    let name = system.text("Name")?.unwrap_or_default().to_owned();
    check_kind(&system)?;
    let inputs = sections.numbered("Input", &system)?;
    let outputs = sections.numbered("Output", &system)?;
    let rules = sections.take("Rules")?;
    sections.finish()?;

    let (mut input_places, mut ranges) = (Vec::new(), Vec::new());
    let mut input = |section: &Section<'_>| {
        let range = section.needed("Range")?;
        let [low, high] = range.pair(true)?;
        if !(low < high && -LARGEST <= low && high <= LARGEST) {
            return Err(range.error(format!("Range needs low < high, both within ±{LARGEST:e}")));
        }
        input_places.push(section.name_place());
        ranges.push(range.place());
        section.variable([low, high], Membership::new)
    };
    let inputs = inputs.iter().map(&mut input).collect::<Result<Vec<_>, _>>()?;
    let output_places = outputs.iter().map(Section::name_place).collect();
    let output = |section: &Section<'_>| {
        let range = section.value("Range")?.map_or(Ok([0.0, 1.0]), |range| range.pair(false))?;
        section.variable(range, |kind, parameters| consequent(kind, parameters, inputs.len()))
    };
    let outputs = outputs.iter().map(output).collect::<Result<Vec<_>, _>>()?;
    let places =
        Places { inputs: input_places, ranges, outputs: output_places, rules: rules.heading.place(rules.heading.text) };
    let rules = read_rules(&rules, system.count("NumRules")?, &inputs, &outputs)?;
    // A method that joins nothing has no meaning.
    let joins =
        |is_or: bool| rules.iter().any(|rule| rule.is_or == is_or && rule.antecedent.iter().flatten().count() > 1);
    let (product, probor) = (And::Product, Or::ProbabilisticSum);
    let ands = [("prod", product), ("min", And::Least), ("algebraic_product", product)];
    let ors = [("probor", probor), ("max", Or::Greatest), ("algebraic_sum", probor)];
    let and = if joins(false) { system.choice("AndMethod", &ands)? } else { product };
    let or = if joins(true) { system.choice("OrMethod", &ors)? } else { probor };
    let output_by = [("wtaver", OutputBy::WeightedAverage), ("wtsum", OutputBy::WeightedSum)];
    let output_by = system.choice("DefuzzMethod", &output_by)?;
    Ok((Fis { name, and, or, output_by, inputs, outputs, rules }, places))
}

/// The text with `\n` between its lines, whatever wrote it; without a byte order mark and an end-of-file character of DOS.
fn one_kind_of_line_end(text: &str) -> Cow<'_, str> {
    let text = text.trim_start_matches('\u{feff}').trim_end_matches(['\u{1a}', '\0']);
    if text.contains('\r') { text.replace("\r\n", "\n").replace('\r', "\n").into() } else { text.into() }
}

/// Checks that the system is a Sugeno system of the ordinary kind.
fn check_kind(system: &Section<'_>) -> Result<(), FisError> {
    let kind = system.needed("Type")?;
    let name = kind.unquoted()?.to_ascii_lowercase();
    if name == "mamdani" {
        return Err(kind.error(
            "this is a Mamdani system; a controller is a Sugeno system (Type='sugeno'), because it needs a number at every \
             step: convert it, in Matlab by convertToSugeno",
        ));
    }
    if name != "sugeno" {
        return Err(kind.error(format!("Type={} is not supported; only 'sugeno' is", kind.text)));
    }
    match system.value("TypeReductionMethod")? {
        Some(reduction) => Err(reduction.error("a type-2 system is not supported: a controller's sets are of type 1")),
        None => Ok(()),
    }
}

fn consequent(kind: &str, parameters: &[f64], inputs: usize) -> Result<Consequent, String> {
    let bounded = parameters.iter().all(|parameter| parameter.abs() <= LARGEST);
    match (kind, parameters) {
        ("constant", &[constant, ref surplus @ ..]) if bounded && surplus.iter().all(|surplus| *surplus == 0.0) => {
            Ok(Consequent { slopes: Vec::new(), constant })
        }
        ("constant", _) => Err(format!("'constant' needs one number within ±{LARGEST:e}")),
        ("linear", &[ref slopes @ .., constant]) if bounded && slopes.len() == inputs => {
            Ok(Consequent { slopes: slopes.to_vec(), constant })
        }
        ("linear", _) => Err(format!(
            "'linear' needs {} numbers within ±{LARGEST:e}: a factor for each of the {inputs} inputs, then a constant",
            inputs + 1
        )),
        _ => Err(format!("'{kind}' is not supported: a consequent is 'constant' or 'linear'")),
    }
}

fn read_rules(
    section: &Section<'_>,
    count: Option<usize>,
    inputs: &[Variable<Membership>],
    outputs: &[Variable<Consequent>],
) -> Result<Vec<Rule>, FisError> {
    let found = section.lines.len();
    if let Some(count) = count.filter(|count| *count != found) {
        return Err(section.error(format!("NumRules={count}, but {found} rules follow")));
    }
    if !(1..=LARGEST_COUNT).contains(&found) {
        return Err(section.error(format!("{found} rules are not supported: 1 to {LARGEST_COUNT} are")));
    }
    section.lines.iter().map(|line| read_rule(section.file, line, inputs, outputs)).collect()
}

/// Reads a rule such as `1 0 3, 2 (1) : 1`.
fn read_rule(
    file: &str,
    line: &Line<'_>,
    inputs: &[Variable<Membership>],
    outputs: &[Variable<Consequent>],
) -> Result<Rule, FisError> {
    let text = line.text.trim();
    let ones = |count: usize| vec!["1"; count].join(" ");
    let form = || {
        let what = format!("a rule reads like '{}, {} (1) : 1', not '{text}'", ones(inputs.len()), ones(outputs.len()));
        line.place(text).error(file, what)
    };
    let (antecedent, rest) = text.split_once(',').ok_or_else(form)?;
    let (consequents, rest) = rest.split_once('(').ok_or_else(form)?;
    let (weight, join) = rest.split_once(')').ok_or_else(form)?;
    let join = join.trim_start().strip_prefix(':').ok_or_else(form)?.trim();
    let is_or = match join.parse::<f64>() {
        Ok(1.0) => false,
        Ok(2.0) => true,
        _ => return Err(form()),
    };
    let sets: Vec<&str> = antecedent.split_whitespace().collect();
    let terms = consequents.split(|c: char| c.is_whitespace() || c == ',').filter(|term| !term.is_empty());
    let terms: Vec<&str> = terms.collect();
    let at = |part: &str, what: String| line.place(part).error(file, what);
    if sets.len() != inputs.len() {
        return Err(at(antecedent, format!("the rule names {} sets for {} inputs", sets.len(), inputs.len())));
    }
    if terms.len() != outputs.len() {
        return Err(at(consequents, format!("the rule names {} terms for {} outputs", terms.len(), outputs.len())));
    }
    let literal = |(set, input): (&&str, &Variable<Membership>)| {
        index(set, &input.name, input.terms.len()).map_err(|what| at(set, what))
    };
    let antecedent_read = sets.iter().zip(inputs).map(literal).collect::<Result<Vec<_>, _>>()?;
    let term = |(term, output): (&&str, &Variable<Consequent>)| match index(term, &output.name, output.terms.len())
        .map_err(|what| at(term, what))?
    {
        Some(Literal { is_negated: true, .. }) => {
            Err(at(term, format!("a negated consequent ({term} of '{}') is not supported", output.name)))
        }
        None if outputs.len() == 1 => {
            Err(at(term, format!("'{}' has terms 1 to {}, not 0", output.name, output.terms.len())))
        }
        literal => Ok(literal.map(|literal| literal.set)),
    };
    let consequents = terms.iter().zip(outputs).map(term).collect::<Result<Vec<_>, _>>()?;
    if is_or && antecedent_read.iter().flatten().count() == 0 {
        return Err(at(antecedent, "a rule joined by 'or' (2) needs a set".to_owned()));
    }
    let weight_text = weight.trim();
    let weight = weight_text.parse().map_err(|_| form())?;
    if !(0.0..=1.0).contains(&weight) {
        return Err(at(weight_text, format!("a rule's weight is within 0 to 1, not {weight}")));
    }
    Ok(Rule { antecedent: antecedent_read, is_or, consequents, weight })
}

/// The set whose number from 1 is `text`, negated if that is negative; `None` for 0.
fn index(text: &str, variable: &str, terms: usize) -> Result<Option<Literal>, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    match number {
        Some(0.0) => Ok(None),
        Some(number) if number.fract() != 0.0 => Err(format!("a hedge ({text} of '{variable}') is not supported")),
        Some(number) if number.abs() <= terms as f64 => {
            Ok(Some(Literal { set: number.abs() as usize - 1, is_negated: number < 0.0 }))
        }
        _ => Err(format!("'{variable}' has sets 1 to {terms}, not {text}")),
    }
}

/// Place of a part within a text, bytes; 0 if it is no part of it.
fn offset(text: &str, part: &str) -> usize {
    let offset = (part.as_ptr() as usize).wrapping_sub(text.as_ptr() as usize);
    if offset <= text.len() { offset } else { 0 }
}

/// A line of the file, without its comment.
#[derive(Clone, Copy, Debug)]
struct Line<'a> {
    number: usize,
    text: &'a str,
}

impl Line<'_> {
    /// The place of a part of this line.
    fn place(&self, part: &str) -> Place {
        let part = part.trim_start();
        let before = self.text.get(..offset(self.text, part)).unwrap_or_default();
        Place { line: self.number, column: 1 + before.chars().count() }
    }
}

/// The line without a comment. A `%` or `#` in quotes begins none.
fn without_comment(line: &str) -> &str {
    let mut quoted_by = None;
    for (at, letter) in line.char_indices() {
        match (letter, quoted_by) {
            ('%' | '#', None) => return &line[..at],
            ('\'' | '"', None) => quoted_by = Some(letter),
            (letter, Some(quote)) if letter == quote => quoted_by = None,
            _ => {}
        }
    }
    line
}

/// A name of a section or key for comparison: in small letters, without spaces.
fn normal(name: &str) -> String {
    name.chars().filter(|letter| !letter.is_whitespace()).map(|letter| letter.to_ascii_lowercase()).collect()
}

/// A section of the file, from its `[heading]` to the next.
#[derive(Debug)]
struct Section<'a> {
    file: &'a str,
    name: &'a str,
    heading: Line<'a>,
    /// Lines that are not empty.
    lines: Vec<Line<'a>>,
    /// The values of its keys.
    keys: BTreeMap<String, Value<'a>>,
}

/// The sections of a file.
struct Sections<'a> {
    file: &'a str,
    all: Vec<Section<'a>>,
}

impl<'a> Sections<'a> {
    fn of(file: &'a str, text: &'a str) -> Result<Self, FisError> {
        let mut all: Vec<Section<'_>> = Vec::new();
        for (number, text) in (1..).zip(text.split('\n')) {
            let line = Line { number, text: without_comment(text) };
            let text = line.text.trim();
            if text.is_empty() {
                continue;
            }
            if let Some(name) = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
                all.push(Section { file, name, heading: line, lines: Vec::new(), keys: BTreeMap::new() });
            } else if let Some(section) = all.last_mut() {
                section.lines.push(line);
            } else {
                return Err(line.place(text).error(file, "a section, beginning with [System], was expected"));
            }
        }
        for section in all.iter_mut().filter(|section| normal(section.name) != "rules") {
            section.read_keys()?;
        }
        Ok(Self { file, all })
    }

    /// Takes this section out.
    fn take(&mut self, name: &str) -> Result<Section<'a>, FisError> {
        match self.all.iter().position(|section| normal(section.name) == normal(name)) {
            Some(place) => Ok(self.all.remove(place)),
            None => Err(Place { line: 1, column: 1 }.error(self.file, format!("section [{name}] is missing"))),
        }
    }

    /// Takes the sections of all variables of a kind out: as many as the system says, or as there are.
    fn numbered(&mut self, kind: &str, system: &Section<'_>) -> Result<Vec<Section<'a>>, FisError> {
        let has = |nth: usize| {
            let name = normal(&format!("{kind}{nth}"));
            self.all.iter().any(|section| normal(section.name) == name)
        };
        let count = match system.count(&format!("Num{kind}s"))? {
            Some(count) => count,
            None => (1..).take_while(|nth| has(*nth)).count().max(1),
        };
        (1..=count).map(|nth| self.take(&format!("{kind}{nth}"))).collect()
    }

    /// Checks that no section is left that should have been used.
    fn finish(&self) -> Result<(), FisError> {
        let is_ours = |section: &&Section<'_>| {
            let name = normal(section.name);
            let number = ["input", "output"].iter().find_map(|kind| name.strip_prefix(kind));
            name == "system" || name == "rules" || number.is_some_and(|number| number.parse::<u32>().is_ok())
        };
        match self.all.iter().find(is_ours) {
            Some(extra) => Err(extra.error(format!("section [{}] is one too many", extra.name))),
            None => Ok(()),
        }
    }
}

impl<'a> Section<'a> {
    fn error(&self, what: impl Into<String>) -> FisError {
        self.heading.place(self.heading.text).error(self.file, what)
    }

    /// Finds the keys of the section.
    fn read_keys(&mut self) -> Result<(), FisError> {
        for line in &self.lines {
            let Some((key, text)) = line.text.split_once('=') else {
                let text = line.text.trim();
                return Err(line.place(text).error(self.file, format!("a line KEY=VALUE was expected, not '{text}'")));
            };
            let value = Value { file: self.file, line: *line, text: text.trim(), is_repeated: false };
            self.keys
                .entry(normal(key))
                .and_modify(|known| known.is_repeated |= known.text != value.text)
                .or_insert(value);
        }
        Ok(())
    }

    /// The value of a key, if it has one.
    fn value(&self, key: &str) -> Result<Option<Value<'a>>, FisError> {
        match self.keys.get(&normal(key)) {
            Some(value) if value.is_repeated => {
                Err(value.error(format!("[{}] has two values of {key}; leave one out", self.name)))
            }
            value => Ok(value.copied()),
        }
    }

    /// The value of a key that the section must have.
    fn needed(&self, key: &str) -> Result<Value<'a>, FisError> {
        self.value(key)?.ok_or_else(|| self.error(format!("section [{}] lacks {key}=", self.name)))
    }

    /// The text of a key, without its quotes.
    fn text(&self, key: &str) -> Result<Option<&'a str>, FisError> {
        self.value(key)?.map(|value| value.unquoted()).transpose()
    }

    /// A count from 1, if it is given.
    fn count(&self, key: &str) -> Result<Option<usize>, FisError> {
        let Some(value) = self.value(key)? else { return Ok(None) };
        match value.number()? {
            count if (1.0..=LARGEST_COUNT as f64).contains(&count) && count.fract() == 0.0 => Ok(Some(count as usize)),
            count => Err(value.error(format!("{key}={count} is not supported: it is within 1 to {LARGEST_COUNT}"))),
        }
    }

    /// One of these choices, which this key names.
    fn choice<T: Copy>(&self, key: &str, choices: &[(&str, T)]) -> Result<T, FisError> {
        let value = self.needed(key)?;
        let name = value.unquoted()?.to_ascii_lowercase();
        let chosen = choices.iter().find(|(choice, _)| *choice == name);
        chosen.map(|(_, choice)| *choice).ok_or_else(|| {
            let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
            value.error(format!("{key}={} is not supported; {} are", value.text, names.join(" and ")))
        })
    }

    /// The place of a variable's name, or of its section's heading if it has no name.
    fn name_place(&self) -> Place {
        self.keys.get("name").map_or_else(|| self.heading.place(self.heading.text), Value::place)
    }

    /// Reads an `[Input]` or `[Output]` section; `term` builds a term from its kind and parameters.
    fn variable<T>(
        &self,
        range: [f64; 2],
        term: impl Fn(&str, &[f64]) -> Result<T, String>,
    ) -> Result<Variable<T>, FisError> {
        self.check_switches()?;
        let name = self.text("Name")?.unwrap_or(self.name).to_owned();
        let number = |key: &str| key.strip_prefix("mf").and_then(|number| number.parse::<usize>().ok());
        let numbers = || self.keys.keys().filter_map(|key| number(key));
        let count = match self.value("NumMFs")? {
            None => numbers().max().unwrap_or_default(),
            Some(count) => {
                let number = count.number()?;
                if !(0.0..=LARGEST_COUNT as f64).contains(&number) || number.fract() != 0.0 {
                    return Err(count.error(format!("NumMFs is not within 0 to {LARGEST_COUNT}")));
                }
                number as usize
            }
        };
        let read = |nth: usize| {
            let value = self.needed(&format!("MF{nth}"))?;
            let (name, kind, parameters) = value.membership()?;
            let numbers = value.numbers(parameters)?;
            let term = term(&kind.to_ascii_lowercase(), &numbers).map_err(|what| value.error_at(kind, what))?;
            Ok(Term { name: name.to_owned(), value: term })
        };
        let terms = (1..=count.min(LARGEST_COUNT)).map(read).collect::<Result<Vec<_>, FisError>>()?;
        match self.keys.iter().find(|(key, _)| number(key).is_some_and(|number| number == 0 || number > count)) {
            Some((_, extra)) => {
                let what = format!("[{}] has no use for '{}': NumMFs={count}", self.name, extra.line.text.trim());
                Err(extra.line.place(extra.line.text).error(self.file, what))
            }
            None => Ok(Variable { name, range, terms }),
        }
    }

    /// Checks that no switch of other programs changes the value of the variable.
    fn check_switches(&self) -> Result<(), FisError> {
        let is_output = normal(self.name).starts_with("output");
        for (key, harmful, applies, why) in [
            ("Enabled", ["0", "false"], true, "a disabled variable is not supported: leave it out"),
            ("LockRange", ["1", "true"], is_output, "an output that is cut to its range is not supported"),
            ("LockValueInRange", ["1", "true"], is_output, "an output that is cut to its range is not supported"),
        ] {
            let Some(value) = self.value(key)?.filter(|_| applies) else { continue };
            if harmful.contains(&value.unquoted()?.to_ascii_lowercase().as_str()) {
                return Err(value.error(format!("{key}={}: {why}", value.text)));
            }
        }
        Ok(())
    }
}

/// The value to the right of a key.
#[derive(Clone, Copy, Debug)]
struct Value<'a> {
    file: &'a str,
    line: Line<'a>,
    text: &'a str,
    /// Whether the key has another value further down.
    is_repeated: bool,
}

impl<'a> Value<'a> {
    fn place(&self) -> Place {
        self.line.place(self.text)
    }

    fn error(&self, what: impl Into<String>) -> FisError {
        self.place().error(self.file, what)
    }

    /// A fault of a part of the value.
    fn error_at(&self, part: &str, what: impl Into<String>) -> FisError {
        self.line.place(part).error(self.file, what)
    }

    fn number(&self) -> Result<f64, FisError> {
        let number = number(self.text).filter(|number| number.is_finite());
        number.ok_or_else(|| self.error(format!("'{}' is not such a number", self.text)))
    }

    /// The text without its quotes.
    fn unquoted(&self) -> Result<&'a str, FisError> {
        let is_quote = |letter: char| letter == '\'' || letter == '"';
        match self.text.chars().next().filter(|first| is_quote(*first)) {
            None if !self.text.ends_with(is_quote) => Ok(self.text),
            Some(quote) if self.text.len() > 1 && self.text.ends_with(quote) => Ok(&self.text[1..self.text.len() - 1]),
            _ => Err(self.error(format!("a text in quotes was expected, not {}", self.text))),
        }
    }

    /// The two numbers of a range.
    fn pair(&self, is_finite: bool) -> Result<[f64; 2], FisError> {
        match *self.numbers(self.text)?.as_slice() {
            [low, high] if !is_finite || (low.is_finite() && high.is_finite()) => Ok([low, high]),
            [_, _] => Err(self.error("Range needs two finite numbers")),
            _ => Err(self.error("Range needs [low high]")),
        }
    }

    /// The numbers of a list such as `[1 2 3]`; commas count as white space.
    fn numbers(&self, text: &str) -> Result<Vec<f64>, FisError> {
        let inner = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        let inner = inner.ok_or_else(|| self.error_at(text, format!("numbers in [ ] were expected, not {text}")))?;
        inner
            .split(|c: char| c.is_whitespace() || c == ',')
            .filter(|item| !item.is_empty())
            .map(|item| number(item).ok_or_else(|| self.error_at(item, format!("'{item}' is not a number"))))
            .collect()
    }

    /// Name, kind and parameters of `'name':'kind',[parameters]`. The name may hold anything.
    fn membership(&self) -> Result<(&'a str, &'a str, &'a str), FisError> {
        let parts = || {
            let (before, parameters) = self.text.split_at(self.text.rfind('[')?);
            let before = before.trim_end().strip_suffix(',')?.trim_end();
            let quote = before.chars().next_back().filter(|quote| matches!(quote, '\'' | '"'))?;
            let (name, kind) = before.strip_suffix(quote)?.rsplit_once(quote)?;
            let name = name.trim_end().strip_suffix(':')?.trim_end();
            let quote = name.chars().next().filter(|quote| matches!(quote, '\'' | '"'))?;
            Some((name.strip_prefix(quote)?.strip_suffix(quote)?, kind, parameters))
        };
        parts().ok_or_else(|| self.error(format!("'name':'kind',[parameters] was expected, not {}", self.text)))
    }
}

/// A number, or a product or quotient of numbers and `pi`. It may be infinite, but never NaN.
fn number(text: &str) -> Option<f64> {
    let (sign, size) = match text.strip_prefix('-') {
        Some(size) => (-1.0, size),
        None => (1.0, text.strip_prefix('+').unwrap_or(text)),
    };
    let factor = |text: &str| if text.eq_ignore_ascii_case("pi") { Some(PI) } else { text.parse::<f64>().ok() };
    if size.starts_with(['+', '-']) {
        return None;
    }
    let mut value = sign;
    let (mut divides, mut rest) = (false, size);
    loop {
        let end = rest.find(['*', '/']).unwrap_or(rest.len());
        let factor = factor(&rest[..end])?;
        value = if divides { value / factor } else { value * factor };
        let Some(operator) = rest[end..].chars().next() else { break };
        (divides, rest) = (operator == '/', &rest[end + 1..]);
    }
    (!value.is_nan()).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_with_pi_and_infinity() {
        for (text, value) in [
            ("1.", 1.0),
            ("-.5", -0.5),
            ("+2e3", 2000.0),
            ("-pi/4", -PI / 4.0),
            ("2*pi", 2.0 * PI),
            ("-Inf", f64::NEG_INFINITY),
            ("inf", f64::INFINITY),
        ] {
            assert_eq!(number(text), Some(value), "{text}");
        }
        for text in ["", "-", "--1", "nan", "pi/", "*2", "1,5", "0/0", "two", "pie"] {
            assert_eq!(number(text), None, "{text}");
        }
    }

    #[test]
    fn a_comment_ends_a_line_but_not_in_quotes() {
        assert_eq!(without_comment("1 1, 1 (1) : 1 % one"), "1 1, 1 (1) : 1 ");
        assert_eq!(without_comment("Name='50 % # full' # yes"), "Name='50 % # full' ");
        assert_eq!(without_comment("# a comment"), "");
        let text = "abc";
        assert_eq!(offset(text, &text[2..]), 2);
    }
}
