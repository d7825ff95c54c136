//! Zero-order Sugeno inference (Takagi & Sugeno 1985), compiled from its description for use in a control loop.

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;
use core::array;

use super::fis::{Fis, FisError, Term, Variable};
use super::membership::Membership;

/// Largest number of inputs.
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
            // A set does not both rise and fall within a segment.
            _ if value == 0.0 && end == 0.0 => None,
            Membership::Gaussian(_) => Some(Self::Curve(*set, offset)),
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

    /// A point at which Σ w is too small. Σ w is linear in every input between the corners of its sets, so its minimum
    /// lies on the grid of corners; near Gaussians this holds to within the change over one σ.
    fn uncovered(&self) -> Result<Option<Vec<f64>>, String> {
        let grid = |input: &Input| input.segments.iter().map(|segment| segment.from).chain([input.range[1]]).collect();
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

/// Whether the sum of `weights`, a table over `inputs`, is too small somewhere on the grids; `place` is then extended
/// by that point.
fn find_uncovered(inputs: &[Input], grids: &[Vec<f64>], weights: &[f64], place: &mut Vec<f64>) -> bool {
    let ([input, inputs @ ..], [grid, grids @ ..]) = (inputs, grids) else {
        return weights[0] < MIN_WEIGHT;
    };
    grid.iter().any(|&x| {
        let mut remaining = vec![0.0; input.stride];
        input.at(x).for_each(|degree, offset| {
            let row = &weights[offset..offset + input.stride];
            remaining.iter_mut().zip(row).for_each(|(sum, weight)| *sum += degree * weight);
        });
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
