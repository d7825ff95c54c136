//! Membership functions: the degree, 0 to 1, to which a number belongs to a fuzzy set.

use alloc::format;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;

use skein_common::math;

/// Largest magnitude of a parameter in a `.fis` file: differences and products stay far from overflow.
pub(super) const LARGEST: f64 = 1e12;

/// One fuzzy set, with the parameters of the toolboxes' function of the same name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Membership {
    /// `trimf [a b c]`: 1 at b, 0 at a and c.
    Triangle([f64; 3]),
    /// `trapmf [a b c d]`: 1 from b to c, 0 at a and d. An infinite end is a shoulder.
    Trapezoid([f64; 4]),
    /// `gaussmf [sigma c]`: exp(−(x − c)² / 2σ²).
    Gaussian([f64; 2]),
    /// `gauss2mf [sigma1 c1 sigma2 c2]`: the rising half of the first Gaussian times the falling half of the second.
    TwoGaussians([f64; 4]),
    /// `gbellmf [a b c]`: 1 / (1 + |(x − c) / a|^2b).
    Bell([f64; 3]),
    /// `sigmf [a c]`: 1 / (1 + exp(−a (x − c))).
    Sigmoid([f64; 2]),
    /// `dsigmf [a1 c1 a2 c2]`: the first sigmoid minus the second, at least 0.
    SigmoidDifference([f64; 4]),
    /// `psigmf [a1 c1 a2 c2]`: the product of two sigmoids.
    SigmoidProduct([f64; 4]),
    /// `zmf [a b]`: falls from 1 at a to 0 at b, along two parabolas.
    Z([f64; 2]),
    /// `smf [a b]`: rises from 0 at a to 1 at b, along two parabolas.
    S([f64; 2]),
    /// `pimf [a b c d]`: an S from a to b, then a Z from c to d.
    Pi([f64; 4]),
}

/// Name of each function, and what its parameters have to be.
const KINDS: [(&str, usize, &str); 13] = [
    ("trimf", 3, "[a b c] with a <= b <= c, a < c and a finite b"),
    ("trapmf", 4, "[a b c d] with a <= b <= c <= d and a < d"),
    ("gaussmf", 2, "[sigma c] with sigma other than 0"),
    ("gauss2mf", 4, "[sigma1 c1 sigma2 c2] with sigmas other than 0"),
    ("gbellmf", 3, "[a b c] with a other than 0"),
    ("sigmf", 2, "[a c]"),
    ("dsigmf", 4, "[a1 c1 a2 c2]"),
    ("psigmf", 4, "[a1 c1 a2 c2]"),
    ("zmf", 2, "[a b] with a <= b"),
    ("smf", 2, "[a b] with a <= b"),
    ("pimf", 4, "[a b c d] with a <= b <= c <= d and a < d"),
    ("linzmf", 2, "[a b] with a <= b"),
    ("linsmf", 2, "[a b] with a <= b"),
];

/// Degrees at which the coverage of a smooth curve is examined.
const LEVELS: [f64; 8] = [1e-7, 1e-4, 0.01, 0.15, 0.5, 0.85, 0.99, 0.9999];

impl Membership {
    /// The function of this name. Corners must be in ascending order; they may coincide (a vertical edge), and the outer
    /// ones of a triangle or trapezoid may be infinite (a shoulder). Zeros after the parameters are left out: old
    /// versions of Matlab fill up with them. The error is a sentence without a file and line.
    pub(super) fn new(kind: &str, parameters: &[f64]) -> Result<Self, String> {
        let Some(&(kind, count, form)) = KINDS.iter().find(|(name, ..)| *name == kind) else {
            let names: Vec<&str> = KINDS.iter().map(|(name, ..)| *name).collect();
            return Err(format!("'{kind}' is not supported: an input's set is a {}", names.join(", ")));
        };
        let p = match parameters.get(count..) {
            Some(surplus) if surplus.iter().all(|surplus| *surplus == 0.0) => &parameters[..count],
            _ => return Err(format!("'{kind}' takes {count} parameters, not {}", parameters.len())),
        };
        let is_piecewise = matches!(kind, "trimf" | "trapmf");
        if !p.iter().all(|p| p.abs() <= LARGEST || (is_piecewise && p.is_infinite())) {
            return Err(format!("a parameter of '{kind}' is not a number within ±{LARGEST:e}"));
        }
        let ascends = p.is_sorted();
        let ordered = ascends && p.first() < p.last();
        let (low, high) = (f64::NEG_INFINITY, f64::INFINITY);
        let set = match (kind, p) {
            ("trimf", &[a, b, c]) if ordered && b.is_finite() => Some(Self::Triangle([a, b, c])),
            ("trapmf", &[a, b, c, d]) if ordered && b < high && c > low => Some(Self::Trapezoid([a, b, c, d])),
            ("gaussmf", &[sigma, c]) if sigma != 0.0 => Some(Self::Gaussian([sigma, c])),
            ("gauss2mf", &[s, c, t, d]) if s != 0.0 && t != 0.0 => Some(Self::TwoGaussians([s, c, t, d])),
            ("gbellmf", &[a, b, c]) if a != 0.0 => Some(Self::Bell([a, b, c])),
            ("sigmf", &[a, c]) => Some(Self::Sigmoid([a, c])),
            ("dsigmf", &[a, c, b, d]) => Some(Self::SigmoidDifference([a, c, b, d])),
            ("psigmf", &[a, c, b, d]) => Some(Self::SigmoidProduct([a, c, b, d])),
            ("zmf", &[a, b]) if ascends => Some(Self::Z([a, b])),
            ("smf", &[a, b]) if ascends => Some(Self::S([a, b])),
            ("pimf", &[a, b, c, d]) if ordered => Some(Self::Pi([a, b, c, d])),
            ("linzmf", &[a, b]) if ascends => Some(Self::Trapezoid([low, low, a, b])),
            ("linsmf", &[a, b]) if ascends => Some(Self::Trapezoid([a, b, high, high])),
            _ => None,
        };
        set.ok_or_else(|| format!("'{kind}' needs {form}"))
    }

    /// Whether the degree is linear between the corners.
    pub(super) fn is_piecewise_linear(&self) -> bool {
        matches!(self, Self::Triangle(_) | Self::Trapezoid(_))
    }

    /// Whether the degree is a product or difference of curves, which may have a maximum anywhere.
    pub(super) fn is_smooth_product(&self) -> bool {
        matches!(self, Self::TwoGaussians(_) | Self::SigmoidDifference(_) | Self::SigmoidProduct(_))
    }

    /// The degree to which the finite number `x` belongs to the set, 0 to 1.
    #[inline]
    pub(super) fn degree(&self, x: f64) -> f64 {
        match *self {
            Self::Triangle([a, b, c]) => trapezoid([a, b, b, c], x),
            Self::Trapezoid(corners) => trapezoid(corners, x),
            Self::Gaussian([sigma, c]) => gaussian(sigma, c, x),
            Self::TwoGaussians([left, c, right, d]) => {
                let rises = if x <= c { gaussian(left, c, x) } else { 1.0 };
                let falls = if x > d { gaussian(right, d, x) } else { 1.0 };
                rises * falls
            }
            Self::Bell([a, b, c]) => 1.0 / (1.0 + math::pow(((x - c) / a).abs(), 2.0 * b)),
            Self::Sigmoid([a, c]) => sigmoid(a, c, x),
            Self::SigmoidDifference([a, c, b, d]) => (sigmoid(a, c, x) - sigmoid(b, d, x)).clamp(0.0, 1.0),
            Self::SigmoidProduct([a, c, b, d]) => sigmoid(a, c, x) * sigmoid(b, d, x),
            Self::Z([a, b]) => falling(a, b, x),
            Self::S([a, b]) => rising(a, b, x),
            Self::Pi([a, b, c, d]) => {
                if x < b {
                    rising(a, b, x)
                } else {
                    falling(c, d, x)
                }
            }
        }
    }

    /// Points between which the degree is linear; for a curve, points at which the degree passes some levels, as far as it
    /// exceeds 10⁻⁷. A vertical edge also gives the point on its other side.
    pub(super) fn corners(&self) -> Vec<f64> {
        let [a, b, c, d] = match *self {
            Self::Triangle([a, b, c]) => [a, b, b, c],
            Self::Trapezoid(corners) => corners,
            Self::Gaussian([sigma, c]) => return around(sigma, c),
            Self::TwoGaussians([left, c, right, d]) => return [around(left, c), around(right, d)].concat(),
            Self::Bell([a, b, c]) => {
                let away = |level: f64| a * math::pow(1.0 / level - 1.0, 0.5 / b);
                let away = LEVELS.map(away).into_iter().filter(|away| away.is_finite());
                return away.flat_map(|away| [c - away, c + away]).chain([c]).collect();
            }
            Self::Sigmoid(p) => return levels(p),
            Self::SigmoidDifference([a, c, b, d]) | Self::SigmoidProduct([a, c, b, d]) => {
                return [levels([a, c]), levels([b, d]), vec![0.5 * (c + d)]].concat();
            }
            Self::Z([a, b]) | Self::S([a, b]) => return bends(a, b),
            Self::Pi([a, b, c, d]) => return [bends(a, b), bends(c, d)].concat(),
        };
        let (before, after) = (if a < b { a } else { a.next_down() }, if c < d { d } else { d.next_up() });
        vec![before, a, b, c, d, after]
    }
}

#[inline]
fn trapezoid([a, b, c, d]: [f64; 4], x: f64) -> f64 {
    if x < b {
        if x <= a {
            0.0
        } else if a == f64::NEG_INFINITY {
            1.0
        } else {
            (x - a) / (b - a)
        }
    } else if x <= c || d == f64::INFINITY {
        1.0
    } else if x < d {
        (d - x) / (d - c)
    } else {
        0.0
    }
}

#[inline]
fn gaussian(sigma: f64, c: f64, x: f64) -> f64 {
    let z = (x - c) / sigma;
    math::exp(-0.5 * z * z)
}

#[inline]
fn sigmoid(a: f64, c: f64, x: f64) -> f64 {
    1.0 / (1.0 + math::exp(-a * (x - c)))
}

/// Two parabolas from 0 at `a` to 1 at `b`.
fn rising(a: f64, b: f64, x: f64) -> f64 {
    falling(-b, -a, -x)
}

/// Two parabolas from 1 at `a` to 0 at `b`.
fn falling(a: f64, b: f64, x: f64) -> f64 {
    if x <= a {
        1.0
    } else if x <= 0.5 * (a + b) {
        1.0 - 2.0 * math::square((x - a) / (b - a))
    } else if x < b {
        2.0 * math::square((x - b) / (b - a))
    } else {
        0.0
    }
}

/// Points one σ apart about a Gaussian, as far as its degree exceeds 2·10⁻⁸.
fn around(sigma: f64, c: f64) -> Vec<f64> {
    (-6..=6).map(|k| c + sigma * f64::from(k)).collect()
}

/// The points at which a sigmoid passes the levels, and its centre.
fn levels([a, c]: [f64; 2]) -> Vec<f64> {
    let at = |level: f64| c + math::ln(level / (1.0 - level)) / a;
    LEVELS.map(at).into_iter().chain([c]).filter(|x| x.is_finite()).collect()
}

/// Ends, middle and quarters of two parabolas from `a` to `b`, with the points beside a vertical edge.
fn bends(a: f64, b: f64) -> Vec<f64> {
    let inside = [0.05, 0.25, 0.5, 0.75, 0.95].map(|share| a + share * (b - a));
    [&[a.next_down(), a][..], &inside, &[b, b.next_up()]].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_at_the_corners_and_between() {
        let triangle = Membership::new("trimf", &[-2.0, 0.0, 4.0]).unwrap();
        let trapezoid = Membership::new("trapmf", &[-2.0, -1.0, 1.0, 4.0]).unwrap();
        let gaussian = Membership::new("gaussmf", &[2.0, 1.0]).unwrap();
        let step = Membership::new("trapmf", &[0.0, 0.0, 1.0, 1.0]).unwrap();
        for (set, x, degree) in [
            (triangle, -2.0, 0.0),
            (triangle, -1.0, 0.5),
            (triangle, 0.0, 1.0),
            (triangle, 3.0, 0.25),
            (triangle, 4.0, 0.0),
            (triangle, 1e300, 0.0),
            (trapezoid, -1.5, 0.5),
            (trapezoid, -1.0, 1.0),
            (trapezoid, 1.0, 1.0),
            (trapezoid, 2.5, 0.5),
            (trapezoid, -9.0, 0.0),
            (gaussian, 1.0, 1.0),
            (gaussian, 3.0, 0.606_530_659_712_633_4),
            (gaussian, -1.0, 0.606_530_659_712_633_4),
            (gaussian, 1e300, 0.0),
            (step, -0.1, 0.0),
            (step, 0.0, 1.0),
            (step, 1.0, 1.0),
            (step, 1.1, 0.0),
        ] {
            assert!((set.degree(x) - degree).abs() < 1e-15, "{set:?} at {x}: {}", set.degree(x));
        }
    }

    #[test]
    fn an_infinite_end_is_a_shoulder_and_coinciding_ends_are_a_vertical_edge() {
        let (low, high) = (f64::NEG_INFINITY, f64::INFINITY);
        for (kind, parameters, values) in [
            ("trapmf", &[low, low, -1.0, 1.0][..], [1.0, 1.0, 0.5, 0.0, 0.0]),
            ("trapmf", &[low, -1.0, 0.0, 2.0], [1.0, 1.0, 1.0, 0.5, 0.0]),
            ("trapmf", &[-1.0, 1.0, high, high], [0.0, 0.0, 0.5, 1.0, 1.0]),
            ("trapmf", &[-1.0, 1.0, 5.0, high], [0.0, 0.0, 0.5, 1.0, 1.0]),
            ("trimf", &[low, 0.0, 2.0], [1.0, 1.0, 1.0, 0.5, 0.0]),
            ("trimf", &[-2.0, 0.0, high], [0.0, 0.5, 1.0, 1.0, 1.0]),
            ("linzmf", &[-1.0, 1.0], [1.0, 1.0, 0.5, 0.0, 0.0]),
            ("linsmf", &[-1.0, 1.0], [0.0, 0.0, 0.5, 1.0, 1.0]),
            ("zmf", &[0.0, 0.0], [1.0, 1.0, 1.0, 0.0, 0.0]),
            ("smf", &[0.0, 0.0], [0.0, 0.0, 1.0, 1.0, 1.0]),
            ("pimf", &[-1.0, -1.0, 1.0, 1.0], [0.0, 1.0, 1.0, 1.0, 0.0]),
        ] {
            let set = Membership::new(kind, parameters).unwrap();
            let got = [-1e9, -1.0, 0.0, 1.0, 1e9].map(|x| set.degree(x));
            assert_eq!(got, values, "{kind} {parameters:?}");
        }
    }

    #[test]
    fn zeros_after_the_parameters_are_left_out_and_a_sign_of_a_width_does_not_matter() {
        let of = |kind: &str, parameters: &[f64]| Membership::new(kind, parameters).unwrap();
        assert_eq!(of("gbellmf", &[2.0, 4.0, -4.0, 0.0]), of("gbellmf", &[2.0, 4.0, -4.0]));
        assert_eq!(of("zmf", &[1.0, 2.0, 0.0, 0.0]), of("zmf", &[1.0, 2.0]));
        for (kind, one, other) in [
            ("gaussmf", &[-2.0, 1.0][..], &[2.0, 1.0][..]),
            ("gbellmf", &[-2.0, 1.5, 1.0], &[2.0, 1.5, 1.0]),
            ("gauss2mf", &[-1.0, 0.0, -2.0, 1.0], &[1.0, 0.0, 2.0, 1.0]),
        ] {
            for x in [-3.0, 0.2, 1.0, 4.0] {
                assert_eq!(of(kind, one).degree(x), of(kind, other).degree(x), "{kind} at {x}");
            }
        }
    }

    #[test]
    fn disordered_parameters_are_refused() {
        let infinity = f64::INFINITY;
        for (kind, parameters) in [
            ("trimf", &[1.0, 0.0, 2.0][..]),
            ("trimf", &[1.0, 1.0, 1.0]),
            ("trimf", &[0.0, 1.0]),
            ("trimf", &[0.0, 1.0, 2.0, 3.0]),
            ("trimf", &[-infinity, -infinity, 1.0]),
            ("trimf", &[-1e13, 0.0, 1.0]),
            ("trapmf", &[0.0, 1.0, 3.0, 2.0]),
            ("trapmf", &[0.0, 1.0, 2.0]),
            ("trapmf", &[-infinity, -infinity, -infinity, 0.0]),
            ("trapmf", &[0.0, infinity, infinity, infinity]),
            ("gaussmf", &[0.0, 1.0]),
            ("gaussmf", &[1.0, f64::NAN]),
            ("gaussmf", &[1.0, infinity]),
            ("gauss2mf", &[1.0, 0.0, 0.0, 1.0]),
            ("gbellmf", &[0.0, 2.0, 3.0]),
            ("gbellmf", &[1.0, 2.0]),
            ("sigmf", &[1.0]),
            ("zmf", &[2.0, 1.0]),
            ("smf", &[2.0, 1.0]),
            ("pimf", &[0.0, 2.0, 1.0, 3.0]),
            ("cosmf", &[1.0, 2.0, 3.0]),
        ] {
            assert!(Membership::new(kind, parameters).is_err(), "{kind} {parameters:?}");
        }
    }

    #[test]
    fn every_degree_is_from_0_to_1_between_and_beyond_the_corners() {
        for (kind, parameters) in [
            ("gauss2mf", &[1.0, 2.0, 0.5, -1.0][..]),
            ("gbellmf", &[2.0, -1.5, 0.0]),
            ("gbellmf", &[1e-9, 1e9, 0.0]),
            ("sigmf", &[-1e9, 1.0]),
            ("sigmf", &[0.0, 1.0]),
            ("dsigmf", &[5.0, 2.0, 5.0, 7.0]),
            ("dsigmf", &[5.0, 7.0, 5.0, 2.0]),
            ("psigmf", &[2.0, 3.0, -5.0, 8.0]),
            ("pimf", &[1.0, 4.0, 5.0, 10.0]),
        ] {
            let set = Membership::new(kind, parameters).unwrap();
            for x in set.corners().into_iter().chain([0.0, -1e12, 1e12, 1e300]) {
                assert!((0.0..=1.0).contains(&set.degree(x)), "{kind} {parameters:?} at {x}: {}", set.degree(x));
            }
        }
    }
}
