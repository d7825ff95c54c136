//! Sugeno inference (Takagi & Sugeno 1985), compiled from its description for use in a control loop.
//!
//! A system with constant consequents, product "and" and weighted-average output is compiled to a table of its sets'
//! combinations ([`Table`]). Every other system is evaluated rule by rule ([`RuleByRule`]).

mod rule_by_rule;

use alloc::format;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;
use core::array;

use super::fis::{And, Fis, FisError, OutputBy, Places, Term, Variable, read};
use super::membership::Membership;
use rule_by_rule::RuleByRule;

/// Largest number of inputs.
const MAX_INPUTS: usize = 8;
/// Largest number of sets of one input.
const MAX_SETS: usize = 100;
/// Largest number of combinations of one set per input in a table.
const MAX_COMBINATIONS: usize = 1 << 16;

/// A Sugeno system with one output.
///
/// Its rules r have the strengths w_r and the consequents u_r(x). The output is Σ w_r u_r / Σ w_r, or Σ w_r u_r with
/// `wtsum`. Inputs are first clamped to their `Range`, so that a shoulder that is 1 at the end of its range stays 1 for every
/// finite input (Octave refuses inputs beyond it, Matlab warns).
#[derive(Clone, Debug)]
pub struct Sugeno(Inference);

/// A system, compiled.
#[derive(Clone, Debug)]
enum Inference {
    Table(Table),
    RuleByRule(RuleByRule),
}

/// A system with constant consequents, product "and" and weighted-average output:
/// Σ_r w_r Π_i μ_ri(x_i) u_r / Σ_r w_r Π_i μ_ri(x_i).
#[derive(Clone, Debug)]
struct Table {
    inputs: Vec<Input>,
    /// Σ w_r and Σ w_r u_r of the rules for each combination of one set (or "any") per input; the last input varies
    /// fastest.
    table: Vec<[f64; 2]>,
}

/// One input, its range split at the corners of its sets.
#[derive(Clone, Debug)]
struct Input {
    range: [f64; 2],
    /// Entries of this input in the table: its sets, then "any" if some rule ignores this input.
    width: usize,
    /// Number of combinations of the following inputs.
    stride: usize,
    /// The corners within the range, ascending, which separate the segments; filled up with infinity.
    corners: Vec<[f64; CORNERS]>,
    segments: Vec<Segment>,
}

/// Number of corners that are compared with an input at once: no branch depends on the input.
const CORNERS: usize = 8;

/// A part of an input's range in which every degree is linear or a Gaussian, with the sets that are not 0 throughout
/// it, in the order of the table.
#[derive(Clone, Debug)]
struct Segment {
    /// Beginning of the segment.
    from: f64,
    /// The first sets, if their degrees are linear. Triangles and trapezoids overlap in pairs, so mostly these are all;
    /// a place without a set has the degree 0 throughout.
    pair: [Side; 2],
    /// The other sets.
    rest: Vec<Active>,
}

/// A set whose degree is linear in a segment: a side of a triangle or trapezoid, or "any".
#[derive(Clone, Copy, Debug, Default)]
struct Side {
    /// Index of the set's first table entry.
    offset: usize,
    /// Degree at the beginning of the segment, and its slope.
    value: f64,
    slope: f64,
}

/// A set in a segment where it is not 0 throughout.
#[derive(Clone, Copy, Debug)]
enum Active {
    /// Its degree is linear.
    Side(Side),
    /// The degree of the set itself, and the index of its first table entry.
    Curve(Membership, usize),
}

/// An input's value, clamped to the range, and its segment.
#[derive(Clone, Copy, Debug)]
struct Point<'a> {
    x: f64,
    segment: &'a Segment,
}

impl Side {
    #[inline]
    fn degree(&self, from: f64, x: f64) -> f64 {
        self.value + (x - from) * self.slope
    }
}

impl Active {
    /// A set between two neighbouring corners; `None` if its degree is 0 there.
    fn between(set: &Membership, offset: usize, from: f64, to: f64) -> Option<Self> {
        let (value, end) = (set.degree(from), set.degree(to));
        match set {
            // A set does not both rise and fall within a segment, but two sigmoids may.
            set if value == 0.0 && end == 0.0 && !set.is_smooth_product() => None,
            set if !set.is_piecewise_linear() => Some(Self::Curve(*set, offset)),
            _ => {
                let slope = (end - value) / (to - from);
                // A vertical edge at 0 falls within 5·10⁻³²⁴: no number lies between its ends.
                Some(Self::Side(Side { offset, value, slope: if slope.is_finite() { slope } else { 0.0 } }))
            }
        }
    }
}

impl Segment {
    fn new(from: f64, active: impl Iterator<Item = Active>) -> Self {
        let (mut pair, mut rest, mut paired) = ([Side::default(); 2], Vec::new(), 0);
        for active in active {
            match active {
                Active::Side(side) if paired < pair.len() && rest.is_empty() => {
                    pair[paired] = side;
                    paired += 1;
                }
                _ => rest.push(active),
            }
        }
        Self { from, pair, rest }
    }
}

impl Input {
    /// An input of the system; `any` states that some rule ignores it.
    fn new(variable: &Variable<Membership>, any: bool, stride: usize) -> Self {
        let [low, high] = variable.range;
        let sets = &variable.terms;
        let corners = sets.iter().flat_map(|set| set.value.corners());
        let mut corners: Vec<f64> = corners.filter(|x| low < *x && *x < high).collect();
        corners.sort_by(f64::total_cmp);
        corners.dedup();
        let any = any.then_some(Active::Side(Side { offset: sets.len() * stride, value: 1.0, slope: 0.0 }));
        let segment = |ends: &[f64]| {
            let between =
                |(i, set): (usize, &Term<Membership>)| Active::between(&set.value, i * stride, ends[0], ends[1]);
            Segment::new(ends[0], sets.iter().enumerate().filter_map(between).chain(any))
        };
        let segments = [&[low], &corners[..], &[high]].concat().windows(2).map(segment).collect();
        let filled_up = |corners: &[f64]| array::from_fn(|i| corners.get(i).copied().unwrap_or(f64::INFINITY));
        let corners = corners.chunks(CORNERS).map(filled_up).collect();
        Self { range: variable.range, width: sets.len() + usize::from(any.is_some()), stride, corners, segments }
    }

    /// The sets that may be above 0 at `x`, which is clamped to the range.
    #[inline]
    fn at(&self, x: f64) -> Point<'_> {
        let x = x.max(self.range[0]).min(self.range[1]);
        let reached = |corners: &[f64; CORNERS]| corners.iter().map(|corner| usize::from(*corner <= x)).sum::<usize>();
        Point { x, segment: &self.segments[self.corners.iter().map(reached).sum::<usize>()] }
    }
}

impl Point<'_> {
    /// Calls `take` with the degree and the first table entry of each set that may be above 0, in the order of the
    /// table.
    fn for_each(&self, mut take: impl FnMut(f64, usize)) {
        let Self { x, segment } = *self;
        let is_set = |side: &&Side| side.value != 0.0 || side.slope != 0.0;
        segment.pair.iter().filter(is_set).for_each(|side| take(side.degree(segment.from, x), side.offset));
        for active in &segment.rest {
            match active {
                Active::Side(side) => take(side.degree(segment.from, x), side.offset),
                Active::Curve(set, offset) => take(set.degree(x), *offset),
            }
        }
    }
}

impl Sugeno {
    /// Reads and compiles a `.fis` text. `file` is its name for errors.
    ///
    /// # Errors
    ///
    /// The first fault of the text, with its place.
    pub fn parse(file: &str, text: &str) -> Result<Self, FisError> {
        Self::parse_output(file, text, &[]).map(|(system, ..)| system)
    }

    /// Reads and compiles the only output of a `.fis` text, or of several the one that has one of these names. Also returns
    /// what the file says and where, and which output it is.
    pub(super) fn parse_output(file: &str, text: &str, names: &[&str]) -> Result<(Self, Fis, Places, usize), FisError> {
        let (fis, places) = read(file, text)?;
        let output = fis.output_named(names).map_err(|what| places.outputs[0].error(file, what))?;
        let system = Self::of_output(&fis, output).map_err(|what| places.rules.error(file, what))?;
        Ok((system, fis, places, output))
    }

    /// Compiles this output of a described system.
    ///
    /// # Errors
    ///
    /// A sentence, if the system is too large, or its rules leave a combination of inputs inside their ranges uncovered.
    fn of_output(fis: &Fis, output: usize) -> Result<Self, String> {
        if fis.inputs.len() > MAX_INPUTS {
            return Err(format!("{} inputs are too many: {MAX_INPUTS} are supported", fis.inputs.len()));
        }
        if let Some(input) = fis.inputs.iter().find(|input| input.terms.len() > MAX_SETS) {
            return Err(format!("'{}' has too many sets: {MAX_SETS} are supported", input.name));
        }
        let rule_by_rule = RuleByRule::new(fis, output);
        let system = match Table::new(fis, output)? {
            Some(table) => Inference::Table(table),
            None => Inference::RuleByRule(rule_by_rule.clone()),
        };
        // The sum of no rules is 0.
        if fis.output_by == OutputBy::WeightedAverage
            && let Some(place) = rule_by_rule.uncovered()?
        {
            let place = fis.inputs.iter().zip(&place).map(|(input, x)| format!("{} = {x}", input.name));
            return Err(format!("no rule fires at {}", place.collect::<Vec<_>>().join(", ")));
        }
        Ok(Self(system))
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        match &self.0 {
            Inference::Table(table) => table.inputs.len(),
            Inference::RuleByRule(rules) => rules.inputs(),
        }
    }

    /// The output for these inputs. `None` if their number is wrong, one is not finite, or no rule fires.
    pub fn evaluate(&self, inputs: &[f64]) -> Option<f64> {
        if inputs.len() != self.inputs() || inputs.iter().any(|x| !x.is_finite()) {
            return None;
        }
        match &self.0 {
            Inference::Table(table) => table.evaluate(inputs),
            Inference::RuleByRule(rules) => rules.evaluate(inputs),
        }
    }
}

impl Table {
    /// The table of this output; `None` if the system is not of this form.
    ///
    /// # Errors
    ///
    /// A sentence, if the table would be too large.
    fn new(fis: &Fis, output: usize) -> Result<Option<Self>, String> {
        let terms = &fis.outputs[output].terms;
        let literals = || fis.rules.iter().flat_map(|rule| rule.antecedent.iter().flatten());
        let is_table = fis.output_by == OutputBy::WeightedAverage
            && fis.and == And::Product
            && !fis.rules.iter().any(|rule| rule.is_or)
            && !literals().any(|literal| literal.is_negated)
            && terms.iter().all(|term| term.value.is_constant());
        if !is_table {
            return Ok(None);
        }
        let mut inputs = Vec::with_capacity(fis.inputs.len());
        let mut stride = 1;
        for (i, variable) in fis.inputs.iter().enumerate().rev() {
            let any = fis.rules.iter().any(|rule| rule.antecedent[i].is_none());
            inputs.insert(0, Input::new(variable, any, stride));
            stride *= inputs[0].width;
            if stride > MAX_COMBINATIONS {
                return Err(format!("more than {MAX_COMBINATIONS} combinations of sets are too many"));
            }
        }
        let mut table = vec![[0.0; 2]; stride];
        for rule in &fis.rules {
            let Some(term) = rule.consequents[output] else { continue };
            let set = |input: &Input, i: usize| rule.antecedent[i].map_or(input.width - 1, |literal| literal.set);
            let place = |(i, input): (usize, &Input)| set(input, i) * input.stride;
            let entry = &mut table[inputs.iter().enumerate().map(place).sum::<usize>()];
            entry[0] += rule.weight;
            entry[1] += rule.weight * terms[term].value.constant;
        }
        Ok(Some(Self { inputs, table }))
    }

    /// The output for as many finite inputs as the table has.
    fn evaluate(&self, inputs: &[f64]) -> Option<f64> {
        let pairs = match *inputs {
            [first, second] => self.fire_pairs([first, second]),
            [first, second, third] => self.fire_pairs([first, second, third]),
            _ => None,
        };
        let [weight, weighted] = pairs.unwrap_or_else(|| fire(&self.inputs, inputs, &self.table));
        (weight > 0.0).then(|| weighted / weight)
    }

    /// Σ w and Σ w u where each input has at most a pair of active sets, as in the shipped rules; `None` elsewhere. The
    /// same operations as in [`fire`], without a loop or a branch that depends on the inputs.
    #[inline]
    fn fire_pairs<const N: usize>(&self, x: [f64; N]) -> Option<[f64; 2]> {
        let inputs: &[Input; N] = self.inputs.as_slice().try_into().ok()?;
        let points: [Point<'_>; N] = array::from_fn(|i| inputs[i].at(x[i]));
        if points.iter().any(|point| !point.segment.rest.is_empty()) {
            return None;
        }
        // The table entries of all combinations of one set per input, the last input varying fastest.
        let mut sums = [[0.0; 2]; 8];
        for (combination, entry) in sums.iter_mut().enumerate().take(1 << N) {
            let offset = |i: usize| points[i].segment.pair[combination >> (N - 1 - i) & 1].offset;
            *entry = self.table[(0..N).map(offset).sum::<usize>()];
        }
        for (i, Point { x, segment }) in points.iter().enumerate().rev() {
            let degrees = segment.pair.map(|side| side.degree(segment.from, *x));
            for place in 0..1 << i {
                let of = |column: usize| {
                    0.0 + degrees[0] * sums[2 * place][column] + degrees[1] * sums[2 * place + 1][column]
                };
                sums[place] = [of(0), of(1)];
            }
        }
        Some(sums[0])
    }
}

/// Σ w and Σ w u of `table`, a table over these inputs, at the point `x`.
fn fire(inputs: &[Input], x: &[f64], table: &[[f64; 2]]) -> [f64; 2] {
    let ([input, inputs @ ..], [at, x @ ..]) = (inputs, x) else { return table[0] };
    let mut sums = [0.0; 2];
    input.at(*at).for_each(|degree, offset| {
        let [weight, weighted] = fire(inputs, x, &table[offset..]);
        sums[0] += degree * weight;
        sums[1] += degree * weighted;
    });
    sums
}

#[cfg(test)]
mod tests;
