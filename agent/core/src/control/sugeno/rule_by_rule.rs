//! A Sugeno system of any form, evaluated rule by rule; and the search for inputs that no rule covers.

use alloc::vec::Vec;

use super::{MAX_INPUTS, MAX_SETS};
use crate::control::fis::{And, Fis, Literal, Or, OutputBy, Variable};
use crate::control::membership::Membership;

/// Largest number of points at which the coverage is examined: a fraction of a second.
const MAX_POINTS: f64 = 4e6;
/// A point is uncovered if its rules' total strength is below this. A single Gaussian reaches it at 5.3 σ.
const MIN_STRENGTH: f64 = 1e-6;
/// A rule below this strength is left out of the search.
const NEGLIGIBLE: f64 = 1e-12;

/// A system with its rules as they are written.
#[derive(Clone, Debug)]
pub(super) struct RuleByRule {
    inputs: Vec<Variable<Membership>>,
    and: And,
    or: Or,
    output_by: OutputBy,
    rules: Vec<EffectiveRule>,
}

/// A rule with an effect on the output.
#[derive(Clone, Debug)]
struct EffectiveRule {
    /// Each input's set; `None` for any.
    antecedent: Vec<Option<Literal>>,
    is_or: bool,
    weight: f64,
    /// Factor of each input; empty for a constant.
    slopes: Vec<f64>,
    constant: f64,
}

/// A rule during the search, with its strength as far as the inputs are known.
type Alive<'a> = (&'a EffectiveRule, f64);

impl Variable<Membership> {
    fn clamped(&self, x: f64) -> f64 {
        x.max(self.range[0]).min(self.range[1])
    }

    /// The ends of the range and the corners of the sets in between, ascending.
    fn grid(&self) -> Vec<f64> {
        let [low, high] = self.range;
        let corners = self.terms.iter().flat_map(|set| set.value.corners()).filter(|x| low < *x && *x < high);
        let mut grid: Vec<f64> = corners.chain([low, high]).collect();
        grid.sort_by(f64::total_cmp);
        grid.dedup();
        grid
    }
}

impl RuleByRule {
    /// The rules for this output.
    pub(super) fn new(fis: &Fis, output: usize) -> Self {
        let terms = &fis.outputs[output].terms;
        let rules = fis.rules.iter().filter_map(|rule| {
            let consequent = &terms[rule.consequents[output]?].value;
            Some(EffectiveRule {
                antecedent: rule.antecedent.clone(),
                is_or: rule.is_or,
                weight: rule.weight,
                slopes: if consequent.is_constant() { Vec::new() } else { consequent.slopes.clone() },
                constant: consequent.constant,
            })
        });
        let rules = rules.collect();
        Self { inputs: fis.inputs.clone(), and: fis.and, or: fis.or, output_by: fis.output_by, rules }
    }

    /// Number of inputs.
    pub(super) fn inputs(&self) -> usize {
        self.inputs.len()
    }

    /// The output for as many finite inputs as the system has; `None` if no rule fires.
    pub(super) fn evaluate(&self, inputs: &[f64]) -> Option<f64> {
        // The degree of each set is computed once.
        let mut x = [0.0; MAX_INPUTS];
        let mut degrees = [[0.0; MAX_SETS]; MAX_INPUTS];
        for (nth, (input, at)) in self.inputs.iter().zip(inputs).enumerate() {
            x[nth] = input.clamped(*at);
            input.terms.iter().zip(&mut degrees[nth]).for_each(|(set, degree)| *degree = set.value.degree(x[nth]));
        }
        let (mut strengths, mut weighted) = (0.0, 0.0);
        for rule in &self.rules {
            let literals = rule.antecedent.iter().enumerate();
            let strength = literals.fold(rule.none(), |strength, (input, literal)| match literal {
                Some(literal) => self.join(rule, strength, of_literal(degrees[input][literal.set], *literal)),
                None => strength,
            });
            let strength = rule.weight * strength;
            let linear = rule.slopes.iter().zip(&x).map(|(slope, x)| slope * x).sum::<f64>();
            strengths += strength;
            weighted += strength * (linear + rule.constant);
        }
        match self.output_by {
            OutputBy::WeightedAverage => (strengths > 0.0).then(|| weighted / strengths),
            OutputBy::WeightedSum => Some(weighted),
        }
    }

    /// The strength of a rule with one more degree.
    #[inline]
    fn join(&self, rule: &EffectiveRule, strength: f64, degree: f64) -> f64 {
        match (rule.is_or, self.and, self.or) {
            (false, And::Product, _) => strength * degree,
            (false, And::Least, _) => strength.min(degree),
            (true, _, Or::ProbabilisticSum) => strength + degree - strength * degree,
            (true, _, Or::Greatest) => strength.max(degree),
        }
    }

    /// A point at which the total strength of the rules is too small. Between neighbouring points of the grid a rule is
    /// without strength only if it is at one of them, and its strength is monotone in each degree; near curves the least
    /// value is found to within its change between two levels.
    ///
    /// # Errors
    ///
    /// A sentence, if the grid is too large.
    pub(super) fn uncovered(&self) -> Result<Option<Vec<f64>>, &'static str> {
        let grids: Vec<Vec<f64>> = self.inputs.iter().map(|input| input.grid()).collect();
        if grids.iter().map(|grid| grid.len() as f64).product::<f64>() > MAX_POINTS {
            return Err("the system is too large to check that its rules cover all inputs");
        }
        let of_point =
            |input: &Variable<Membership>, x: &f64| (*x, input.terms.iter().map(|set| set.value.degree(*x)).collect());
        let of_input =
            |(input, grid): (&Variable<Membership>, &Vec<f64>)| grid.iter().map(|x| of_point(input, x)).collect();
        let degrees: Vec<Vec<(f64, Vec<f64>)>> = self.inputs.iter().zip(&grids).map(of_input).collect();
        let mut alive: Vec<Alive<'_>> = self.rules.iter().map(|rule| (rule, rule.none())).collect();
        let mut place = Vec::new();
        Ok(self.find_uncovered(&degrees, &mut alive, &mut place).then_some(place))
    }

    /// Whether the rules are too weak somewhere on the grids of the inputs from `place.len()` on; `place` is then completed
    /// to that point.
    fn find_uncovered(&self, degrees: &[Vec<(f64, Vec<f64>)>], alive: &mut [Alive<'_>], place: &mut Vec<f64>) -> bool {
        let nth = place.len();
        let Some(points) = degrees.get(nth) else {
            return alive.iter().map(|(rule, s)| rule.weight * s).sum::<f64>() < MIN_STRENGTH;
        };
        // The strongest rules first, so that few have to be looked at.
        alive.sort_by(|one, other| other.1.total_cmp(&one.1));
        let is_last = nth + 1 == degrees.len();
        for (x, of_sets) in points {
            let joined = |(rule, strength): &Alive<'_>| match rule.antecedent[nth] {
                Some(literal) => self.join(rule, *strength, of_literal(of_sets[literal.set], literal)),
                None => *strength,
            };
            place.push(*x);
            let found = if is_last {
                let mut total = 0.0;
                !alive.iter().any(|one| {
                    total += one.0.weight * joined(one);
                    total >= MIN_STRENGTH
                })
            } else {
                let next = alive.iter().map(|one| (one.0, joined(one)));
                let mut next: Vec<Alive<'_>> = next.filter(|(rule, s)| rule.is_or || *s > NEGLIGIBLE).collect();
                self.find_uncovered(degrees, &mut next, place)
            };
            if found {
                place.extend(degrees[place.len()..].iter().filter_map(|points| points.first()).map(|(x, _)| *x));
                return true;
            }
            place.pop();
        }
        false
    }
}

impl EffectiveRule {
    /// The strength of a rule before its first set.
    fn none(&self) -> f64 {
        if self.is_or && self.antecedent.iter().any(Option::is_some) { 0.0 } else { 1.0 }
    }
}

/// The degree to which a number belongs to a set of a rule.
#[inline]
fn of_literal(degree: f64, literal: Literal) -> f64 {
    if literal.is_negated { 1.0 - degree } else { degree }
}
