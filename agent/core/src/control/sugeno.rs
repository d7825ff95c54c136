//! Zero-order Sugeno inference (Takagi & Sugeno 1985), compiled from its description for use in a control loop.

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;

use super::fis::{Fis, FisError, Variable};
use super::membership::Membership;

/// Largest number of inputs: the active sets of each are on the stack.
const MAX_INPUTS: usize = 8;
/// Largest number of sets of one input.
const MAX_SETS: usize = 100;
/// Largest number of combinations of one set per input.
const MAX_COMBINATIONS: usize = 1 << 16;
/// Largest number of multiplications in the coverage check: a fraction of a second.
const MAX_COVERAGE_WORK: f64 = 5e7;
/// A point is uncovered if its rules' total weight is below this. A single Gaussian reaches it at 5.3 σ.
const MIN_WEIGHT: f64 = 1e-6;

/// A Sugeno system with constant consequents, product "and" and weighted-average output.
///
/// Σ_r w_r Π_i μ_ri(x_i) u_r / Σ_r w_r Π_i μ_ri(x_i). Inputs are first clamped to their `Range`, so that a shoulder
/// that is 1 at the end of its range stays 1 for every finite input (Octave refuses inputs beyond it, Matlab warns).
#[derive(Clone, Debug)]
pub struct Sugeno {
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
    /// The corners within the range, ascending, which separate the segments.
    corners: Vec<f64>,
    /// The sets of each segment that are not 0 throughout it.
    segments: Vec<Vec<Active>>,
}

/// A set in a segment where it is not 0 throughout.
#[derive(Clone, Copy, Debug)]
struct Active {
    /// Index of the set's first table entry.
    offset: usize,
    degree: Degree,
}

#[derive(Clone, Copy, Debug)]
enum Degree {
    /// `value` at `from`, linear with this slope: every side of a triangle or trapezoid, and "any".
    Line { from: f64, value: f64, slope: f64 },
    /// The degree of the set itself.
    Curve(Membership),
}

impl Degree {
    /// The degree of a set between two neighbouring corners; `None` if it is 0 there.
    fn between(set: &Membership, from: f64, to: f64) -> Option<Self> {
        let (value, end) = (set.degree(from), set.degree(to));
        match set {
            // A set does not both rise and fall within a segment.
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
    /// An input of the system; `any` states that some rule ignores it.
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

    /// The sets that may be above 0 at `x`, and `x` clamped to the range.
    #[inline]
    fn active(&self, x: f64) -> (&[Active], f64) {
        let x = x.clamp(self.range[0], self.range[1]);
        (&self.segments[self.corners.partition_point(|corner| *corner <= x)], x)
    }
}

impl Sugeno {
    /// Reads and compiles a `.fis` text. `file` is its name for errors.
    ///
    /// # Errors
    ///
    /// The first fault of the text, with its line.
    pub fn parse(file: &str, text: &str) -> Result<Self, FisError> {
        let fis = Fis::parse(file, text)?;
        Self::new(&fis).map_err(|what| {
            let line = 1 + text.lines().position(|line| line.trim() == "[Rules]").unwrap_or_default();
            FisError { file: file.to_owned(), line, what }
        })
    }

    /// Compiles a described system.
    ///
    /// # Errors
    ///
    /// A sentence, if the system is too large or its rules leave a combination of inputs inside their ranges uncovered.
    pub fn new(fis: &Fis) -> Result<Self, String> {
        if fis.inputs.len() > MAX_INPUTS {
            return Err(format!("{} inputs are too many: {MAX_INPUTS} are supported", fis.inputs.len()));
        }
        if let Some(input) = fis.inputs.iter().find(|input| input.terms.len() > MAX_SETS) {
            return Err(format!("'{}' has too many sets: {MAX_SETS} are supported", input.name));
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
        let mut active: [(&[Active], f64); MAX_INPUTS] = Default::default();
        for ((active, input), x) in active.iter_mut().zip(&self.inputs).zip(inputs) {
            *active = input.active(*x);
        }
        let [weight, weighted] = fire(&active[..inputs.len()], &self.table);
        (weight > 0.0).then(|| weighted / weight)
    }

    /// A point at which Σ w is too small. Σ w is linear in every input between the corners of its sets, so its minimum
    /// lies on the grid of corners; near Gaussians this holds to within the change over one σ.
    fn uncovered(&self) -> Result<Option<Vec<f64>>, String> {
        let grid = |input: &Input| [&[input.range[0]], &input.corners[..], &[input.range[1]]].concat();
        let grids: Vec<Vec<f64>> = self.inputs.iter().map(grid).collect();
        let (mut points, mut work) = (1.0, 0.0);
        for (input, grid) in self.inputs.iter().zip(&grids) {
            points *= grid.len() as f64;
            work += points * (input.width * input.stride) as f64;
        }
        if work > MAX_COVERAGE_WORK {
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
            // The last input's sums are table entries: this saves a call.
            let [weight, weighted] = if rest.is_empty() { table[0] } else { fire(rest, table) };
            sums[0] += degree * weight;
            sums[1] += degree * weighted;
        }
    }
    sums
}

/// Whether the sum of `weights`, a table over `inputs`, is too small somewhere on the grids; `place` is then extended
/// by that point.
fn find_uncovered(inputs: &[Input], grids: &[Vec<f64>], weights: &[f64], place: &mut Vec<f64>) -> bool {
    let ([input, inputs @ ..], [grid, grids @ ..]) = (inputs, grids) else {
        return weights[0] < MIN_WEIGHT;
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
