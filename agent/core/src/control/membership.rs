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
    /// `trapmf [a b c d]`: 1 from b to c, 0 at a and d.
    Trapezoid([f64; 4]),
    /// `gaussmf [sigma c]`: exp(−(x − c)² / 2σ²).
    Gaussian([f64; 2]),
}

impl Membership {
    /// The function of this name. Corners must be in ascending order and may coincide (a vertical edge); σ must be
    /// positive. The error is a sentence without a file and line.
    pub(super) fn new(kind: &str, parameters: &[f64]) -> Result<Self, String> {
        let ordered = parameters.is_sorted() && parameters.first() < parameters.last();
        match (kind, parameters) {
            ("trimf" | "trapmf" | "gaussmf", p) if !p.iter().all(|p| p.abs() <= LARGEST) => {
                Err(format!("a parameter of '{kind}' is not a number within ±{LARGEST:e}"))
            }
            ("trimf", &[a, b, c]) if ordered => Ok(Self::Triangle([a, b, c])),
            ("trapmf", &[a, b, c, d]) if ordered => Ok(Self::Trapezoid([a, b, c, d])),
            ("gaussmf", &[sigma, c]) if sigma > 0.0 => Ok(Self::Gaussian([sigma, c])),
            ("trimf", [_, _, _]) => Err("'trimf' needs [a b c] with a <= b <= c and a < c".into()),
            ("trapmf", [_, _, _, _]) => Err("'trapmf' needs [a b c d] with a <= b <= c <= d and a < d".into()),
            ("gaussmf", [_, _]) => Err("'gaussmf' needs [sigma c] with sigma > 0".into()),
            ("trimf", _) => Err(format!("'trimf' takes 3 parameters, not {}", parameters.len())),
            ("trapmf", _) => Err(format!("'trapmf' takes 4 parameters, not {}", parameters.len())),
            ("gaussmf", _) => Err(format!("'gaussmf' takes 2 parameters, not {}", parameters.len())),
            _ => Err(format!("'{kind}' is not supported: an input's set is a trimf, trapmf or gaussmf")),
        }
    }

    /// The toolboxes' name of the function.
    pub(super) fn kind(&self) -> &'static str {
        match self {
            Self::Triangle(_) => "trimf",
            Self::Trapezoid(_) => "trapmf",
            Self::Gaussian(_) => "gaussmf",
        }
    }

    /// The parameters in the order of the file.
    pub(super) fn parameters(&self) -> &[f64] {
        match self {
            Self::Triangle(p) => p,
            Self::Trapezoid(p) => p,
            Self::Gaussian(p) => p,
        }
    }

    /// The degree to which the finite number `x` belongs to the set, 0 to 1.
    #[inline]
    pub(super) fn degree(&self, x: f64) -> f64 {
        match *self {
            Self::Triangle([a, b, c]) => trapezoid([a, b, b, c], x),
            Self::Trapezoid(corners) => trapezoid(corners, x),
            Self::Gaussian([sigma, c]) => {
                let z = (x - c) / sigma;
                math::exp(-0.5 * z * z)
            }
        }
    }

    /// Points between which the degree is linear; for a Gaussian, points one σ apart as far as the degree exceeds
    /// 2·10⁻⁸. A vertical edge also gives the last point outside.
    pub(super) fn corners(&self) -> Vec<f64> {
        let [a, b, c, d] = match *self {
            Self::Triangle([a, b, c]) => [a, b, b, c],
            Self::Trapezoid(corners) => corners,
            Self::Gaussian([sigma, c]) => return (-6..=6).map(|k| c + sigma * f64::from(k)).collect(),
        };
        let (before, after) = (if a < b { a } else { a.next_down() }, if c < d { d } else { d.next_up() });
        vec![before, a, b, c, d, after]
    }
}

#[inline]
fn trapezoid([a, b, c, d]: [f64; 4], x: f64) -> f64 {
    if x < b {
        if x > a { (x - a) / (b - a) } else { 0.0 }
    } else if x <= c {
        1.0
    } else if x < d {
        (d - x) / (d - c)
    } else {
        0.0
    }
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
    fn disordered_parameters_are_refused() {
        for (kind, parameters) in [
            ("trimf", &[1.0, 0.0, 2.0][..]),
            ("trimf", &[1.0, 1.0, 1.0]),
            ("trimf", &[0.0, 1.0]),
            ("trapmf", &[0.0, 1.0, 3.0, 2.0]),
            ("trapmf", &[0.0, 1.0, 2.0]),
            ("gaussmf", &[0.0, 1.0]),
            ("gaussmf", &[-1.0, 1.0]),
            ("gaussmf", &[1.0, f64::NAN]),
            ("trimf", &[f64::NEG_INFINITY, 0.0, 1.0]),
            ("trimf", &[-1e13, 0.0, 1.0]),
            ("gbellmf", &[1.0, 2.0, 3.0]),
        ] {
            assert!(Membership::new(kind, parameters).is_err(), "{kind} {parameters:?}");
        }
    }
}
