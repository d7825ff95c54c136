//! Zero-order Sugeno inference (Takagi & Sugeno 1985), compiled from its description for a control loop.

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;

use super::fis::{Fis, FisError, Variable};
use super::membership::Membership;

/// Inputs of a system; what is active of each lives on the stack.
const MOST_INPUTS: usize = 8;
/// Sets of one input.
const MOST_SETS: usize = 100;
/// Combinations of one set per input.
const MOST_COMBINATIONS: usize = 1 << 16;
/// Multiplications that the check of coverage may take: a fraction of a second.
const MOST_COVERAGE_WORK: f64 = 5e7;
/// A place where all rules together weigh less than this is not covered. A Gaussian alone reaches it at 5.3 σ.
const LEAST_WEIGHT: f64 = 1e-6;

/// A Sugeno system with constant consequents, product "and" and weighted-average output.
///
/// With memberships μ_ri(x_i), rule weights w_r and constants u_r, the output is
/// Σ_r w_r Π_i μ_ri(x_i) u_r / Σ_r w_r Π_i μ_ri(x_i). Inputs are first brought into their `Range`, so that a shoulder
/// that is 1 at the end of its range stays 1 for every finite input (Octave refuses inputs beyond it, Matlab warns).
#[derive(Clone, Debug)]
pub struct Sugeno {
    inputs: Vec<Input>,
    /// Per combination of one set (or "any") per input, the last input's fastest: Σ w_r and Σ w_r u_r of its rules.
    table: Vec<[f64; 2]>,
}

/// One input, its range cut at the corners of its sets.
#[derive(Clone, Debug)]
struct Input {
    range: [f64; 2],
    /// Entries in its row of the table: its sets, then "any" if some rule does not ask for this input.
    width: usize,
    /// Combinations of the inputs after it.
    stride: usize,
    /// The corners within the range, ascending: where one segment ends and the next begins.
    corners: Vec<f64>,
    /// Per segment, the sets that are not 0 all over it.
    segments: Vec<Vec<Active>>,
}

/// A set within a segment, where it is not 0 everywhere.
#[derive(Clone, Copy, Debug)]
struct Active {
    /// Where its part of the table begins.
    offset: usize,
    degree: Degree,
}

#[derive(Clone, Copy, Debug)]
enum Degree {
    /// `value` at `from`, and so on with this slope: every side of a triangle or trapezoid, and "any".
    Line { from: f64, value: f64, slope: f64 },
    /// As the set itself has it.
    Curve(Membership),
}

impl Degree {
    /// Of a set between two neighbouring corners; `None` if it is 0 there.
    fn between(set: &Membership, from: f64, to: f64) -> Option<Self> {
        let (value, end) = (set.degree(from), set.degree(to));
        match set {
            // No set rises and falls within a segment.
            _ if value == 0.0 && end == 0.0 => None,
            Membership::Gaussian(_) => Some(Self::Curve(*set)),
            _ => Some(Self::Line { from, value, slope: (end - value) / (to - from) }),
        }
    }

    #[inline]
    fn at(&self, x: f64) -> f64 {
        match self {
            Self::Line { from, value, slope } => value + (x - from) * slope,
            Self::Curve(set) => set.degree(x),
        }
    }
}

impl Input {
    /// `any`: some rule does not ask for it.
    fn new(variable: &Variable<Membership>, any: bool, stride: usize) -> Self {
        let [low, high] = variable.range;
        let sets = &variable.terms;
        let corners = sets.iter().flat_map(|set| set.value.corners());
        let mut corners: Vec<f64> = corners.filter(|x| low < *x && *x < high).collect();
        corners.sort_by(f64::total_cmp);
        corners.dedup();
        let segment = |ends: &[f64]| {
            let degrees = sets.iter().map(|set| Degree::between(&set.value, ends[0], ends[1]));
            let any = any.then_some(Some(Degree::Line { from: low, value: 1.0, slope: 0.0 }));
            let active = |(i, degree): (usize, Option<Degree>)| Some(Active { offset: i * stride, degree: degree? });
            degrees.chain(any).enumerate().filter_map(active).collect()
        };
        let segments = [&[low], &corners[..], &[high]].concat().windows(2).map(segment).collect();
        Self { range: variable.range, width: sets.len() + usize::from(any), stride, corners, segments }
    }

    /// The sets that may be above 0 at `x`, and `x` within the range.
    #[inline]
    fn active(&self, x: f64) -> (&[Active], f64) {
        let x = x.clamp(self.range[0], self.range[1]);
        (&self.segments[self.corners.partition_point(|corner| *corner <= x)], x)
    }
}

impl Sugeno {
    /// Reads and compiles a `.fis` text. `file` is its name, for errors only.
    pub fn parse(file: &str, text: &str) -> Result<Self, FisError> {
        let fis = Fis::parse(file, text)?;
        Self::new(&fis).map_err(|what| {
            let line = 1 + text.lines().position(|line| line.trim() == "[Rules]").unwrap_or_default();
            FisError { file: file.to_owned(), line, what }
        })
    }

    /// Compiles a described system. Fails, with a sentence, if it is too large or if its rules leave a combination of
    /// inputs inside their ranges uncovered.
    pub fn new(fis: &Fis) -> Result<Self, String> {
        if fis.inputs.len() > MOST_INPUTS {
            return Err(format!("{} inputs are too many: {MOST_INPUTS} are supported", fis.inputs.len()));
        }
        if let Some(input) = fis.inputs.iter().find(|input| input.terms.len() > MOST_SETS) {
            return Err(format!("'{}' has too many sets: {MOST_SETS} are supported", input.name));
        }
        let mut inputs = Vec::with_capacity(fis.inputs.len());
        let mut stride = 1;
        for (i, variable) in fis.inputs.iter().enumerate().rev() {
            let any = fis.rules.iter().any(|rule| rule.antecedent[i].is_none());
            inputs.insert(0, Input::new(variable, any, stride));
            stride *= inputs[0].width;
            if stride > MOST_COMBINATIONS {
                return Err(format!("more than {MOST_COMBINATIONS} combinations of sets are too many"));
            }
        }
        let mut table = vec![[0.0; 2]; stride];
        for rule in &fis.rules {
            let place = |(input, set): (&Input, &Option<usize>)| set.unwrap_or(input.width - 1) * input.stride;
            let entry = &mut table[inputs.iter().zip(&rule.antecedent).map(place).sum::<usize>()];
            entry[0] += rule.weight;
            entry[1] += rule.weight * fis.output.terms[rule.consequent].value;
        }
        let system = Self { inputs, table };
        match system.uncovered()? {
            None => Ok(system),
            Some(place) => {
                let place = fis.inputs.iter().zip(&place).map(|(input, x)| format!("{} = {x}", input.name));
                Err(format!("no rule fires at {}", place.collect::<Vec<_>>().join(", ")))
            }
        }
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.inputs.len()
    }

    /// The output for these inputs. `None` if their number is wrong, one is not finite, or no rule fires.
    pub fn evaluate(&self, inputs: &[f64]) -> Option<f64> {
        if inputs.len() != self.inputs.len() || inputs.iter().any(|x| !x.is_finite()) {
            return None;
        }
        let mut active: [(&[Active], f64); MOST_INPUTS] = Default::default();
        for ((active, input), x) in active.iter_mut().zip(&self.inputs).zip(inputs) {
            *active = input.active(*x);
        }
        let [weight, weighted] = fire(&active[..inputs.len()], &self.table);
        (weight > 0.0).then(|| weighted / weight)
    }

    /// A point where Σ w is too small. Between corners of its sets every input enters Σ w linearly, so that the least
    /// value lies on the grid of corners; near Gaussians it is right to within the fall of one σ.
    fn uncovered(&self) -> Result<Option<Vec<f64>>, String> {
        let grid = |input: &Input| [&[input.range[0]], &input.corners[..], &[input.range[1]]].concat();
        let grids: Vec<Vec<f64>> = self.inputs.iter().map(grid).collect();
        let (mut points, mut work) = (1.0, 0.0);
        for (input, grid) in self.inputs.iter().zip(&grids) {
            points *= grid.len() as f64;
            work += points * (input.width * input.stride) as f64;
        }
        if work > MOST_COVERAGE_WORK {
            return Err("the system is too large to check that its rules cover all inputs".into());
        }
        let weights: Vec<f64> = self.table.iter().map(|entry| entry[0]).collect();
        let mut place = Vec::new();
        Ok(find_uncovered(&self.inputs, &grids, &weights, &mut place).then_some(place))
    }
}

/// Σ w and Σ w u of `table`, a table over the inputs with these active sets and values.
fn fire(inputs: &[(&[Active], f64)], table: &[[f64; 2]]) -> [f64; 2] {
    let mut sums = [0.0; 2];
    if let [(active, x), rest @ ..] = inputs {
        for set in *active {
            let degree = set.degree.at(*x);
            let table = &table[set.offset..];
            // The last input's sums are the table's own: no call for them.
            let [weight, weighted] = if rest.is_empty() { table[0] } else { fire(rest, table) };
            sums[0] += degree * weight;
            sums[1] += degree * weighted;
        }
    }
    sums
}

/// Whether `weights`, a table over `inputs`, sums to too little somewhere on the grids; `place` is then extended by
/// where.
fn find_uncovered(inputs: &[Input], grids: &[Vec<f64>], weights: &[f64], place: &mut Vec<f64>) -> bool {
    let ([input, inputs @ ..], [grid, grids @ ..]) = (inputs, grids) else {
        return weights[0] < LEAST_WEIGHT;
    };
    grid.iter().any(|&x| {
        let mut remaining = vec![0.0; input.stride];
        for set in input.active(x).0 {
            let (degree, row) = (set.degree.at(x), &weights[set.offset..set.offset + input.stride]);
            remaining.iter_mut().zip(row).for_each(|(sum, weight)| *sum += degree * weight);
        }
        place.push(x);
        let found = find_uncovered(inputs, grids, &remaining, place);
        if !found {
            place.pop();
        }
        found
    })
}

#[cfg(test)]
mod tests;
