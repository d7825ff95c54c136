//! The controller's expectations of the rule base of each axis, and the comparison of a file with them.
//!
//! A file that contradicts what the controller does is refused. A file that may be right is accepted with a warning: other
//! names, a range of an unusual size.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::fis::{Fis, FisError, Places};
use super::sugeno::Sugeno;

/// An axis of control, with what its rules get and give.
#[derive(Debug)]
pub(super) struct AxisSpec {
    /// Name of the axis and of its file.
    pub(super) name: &'static str,
    /// The inputs: first the error, which the command reduces, then what damps it.
    pub(super) inputs: &'static [Quantity],
    /// Names that mark the axis's output among several; the first is the shipped one.
    pub(super) outputs: &'static [&'static str],
}

/// An input of an axis.
#[derive(Debug)]
pub(super) struct Quantity {
    /// Its name in the shipped rules, with its unit.
    name: &'static str,
    what: &'static str,
    unit: &'static str,
    /// Largest usual magnitude.
    usual: f64,
    /// Magnitudes at which the sign of the response is examined.
    at: [f64; 3],
}

const fn quantity(name: &'static str, what: &'static str, unit: &'static str, usual: f64, at: [f64; 3]) -> Quantity {
    Quantity { name, what, unit, usual, at }
}

/// The axes in the order of [`Rules::from_texts`](super::Rules::from_texts).
pub(super) const AXES: [AxisSpec; 4] = [
    AxisSpec {
        name: "roll",
        inputs: &[
            quantity("error_right_m", "position error to the right", "m", 20.0, [1.0, 5.0, 15.0]),
            quantity("velocity_right_m_s", "velocity to the right", "m/s", 10.0, [0.5, 3.0, 8.0]),
            quantity("bank_above_trim_rad", "bank above trim", "rad", 0.8, [0.05, 0.3, 0.6]),
        ],
        outputs: &["stick", "roll", "roll_stick"],
    },
    AxisSpec {
        name: "pitch",
        inputs: &[
            quantity("error_backwards_m", "position error backwards", "m", 20.0, [1.0, 5.0, 15.0]),
            quantity("velocity_backwards_m_s", "velocity backwards", "m/s", 10.0, [0.5, 3.0, 8.0]),
            quantity("pitch_above_trim_rad", "pitch above trim", "rad", 0.8, [0.05, 0.3, 0.6]),
        ],
        outputs: &["stick", "pitch", "pitch_stick"],
    },
    AxisSpec {
        name: "heading",
        inputs: &[
            quantity("heading_error_rad", "heading error", "rad", 3.2, [0.05, 0.3, 1.0]),
            quantity("yaw_rate_rad_s", "yaw rate", "rad/s", 3.0, [0.1, 0.5, 1.5]),
        ],
        outputs: &["stick", "heading", "yaw", "yaw_stick"],
    },
    AxisSpec {
        name: "collective",
        inputs: &[
            quantity("altitude_error_m", "altitude error", "m", 20.0, [0.5, 3.0, 10.0]),
            quantity("climb_rate_m_s", "climb rate", "m/s", 5.0, [0.3, 1.5, 4.0]),
        ],
        outputs: &["collective", "collective_stick"],
    },
];

/// A range is of an unusual size if it is larger than the usual magnitude by this factor.
const UNUSUAL: f64 = 12.0;
/// The travel of a control to one side: a larger command has no further effect at a gain of 1.
const TRAVEL: f64 = 1.0;
/// A command above this is at the end of the travel even at the least gain that an aircraft file may have, 0.05.
const BEYOND_ANY_GAIN: f64 = 20.0;
/// A smaller change of the command counts as no change.
const NO_CHANGE: f64 = 1e-9;

/// Parts of the name of an input that are other units.
const OTHER_UNITS: [(&str, &[&str]); 3] = [
    ("rad", &["deg", "degree", "degrees", "grad", "°"]),
    ("m", &["ft", "feet", "foot", "km", "cm", "mm", "inch"]),
    ("s", &["kt", "kts", "knots", "knot", "mph", "fpm", "kmh", "rpm"]),
];

/// Compares a file with what the controller expects of this axis. Gives the warnings.
///
/// # Errors
///
/// A contradiction to the controller, with its place.
pub(super) fn check(
    axis: &AxisSpec,
    file: &str,
    (fis, places, output): (&Fis, &Places, usize),
    system: &Sugeno,
) -> Result<Vec<FisError>, FisError> {
    let mut warnings = Vec::new();
    warnings.extend(check_names(axis, file, fis, places)?);
    for (nth, quantity) in axis.inputs.iter().enumerate() {
        warnings.extend(check_range(quantity, file, fis, places, nth)?);
    }
    let at_output = places.outputs[output];
    let largest = largest_output(fis, system);
    if largest > BEYOND_ANY_GAIN {
        let what = format!(
            "the output reaches {largest:.4}, but the {} control has a travel of 1 to each side: is this rule base for something \
             else, or for another unit?",
            axis.name
        );
        return Err(at_output.error(file, what));
    }
    if largest > TRAVEL {
        let what = format!("the output reaches {largest:.4}; the {} control ends at 1", axis.name);
        warnings.push(at_output.error(file, what));
    }
    for (nth, quantity) in axis.inputs.iter().enumerate() {
        let place = places.inputs[nth];
        let (what, is_error) = (quantity.what, nth == 0);
        // A positive error asks for a larger command, and motion in its direction for a smaller one.
        let sign = if is_error { 1.0 } else { -1.0 };
        let changes = quantity.at.map(|at| sign * change(system, axis.inputs.len(), nth, at));
        let right = changes.iter().filter(|change| **change > NO_CHANGE).count();
        let wrong = changes.iter().filter(|change| **change < -NO_CHANGE).count();
        let needs = if is_error {
            "a positive one needs a larger command"
        } else {
            "it has to damp: more of it needs a smaller command"
        };
        match (right, wrong, is_error) {
            (0, 1.., _) => {
                let falls = if is_error { "falls" } else { "rises" };
                let what = format!(
                    "the command {falls} as input {}, the {what}, rises, but {needs}: are signs or inputs exchanged?",
                    nth + 1
                );
                return Err(place.error(file, what));
            }
            (0, 0, true) => {
                let what = format!("the command does not depend on input {}, the {what}", nth + 1);
                return Err(place.error(file, what));
            }
            (0, 0, false) => {
                let what = format!("the command does not depend on input {}, the {what}: nothing damps it", nth + 1);
                warnings.push(place.error(file, what));
            }
            (_, 1.., _) => {
                let what =
                    format!("the command has the wrong sign at some values of input {}, the {what}: {needs}", nth + 1);
                warnings.push(place.error(file, what));
            }
            _ => {}
        }
    }
    Ok(warnings)
}

/// The name in small letters, its parts separated by `_`.
fn parts(name: &str) -> Vec<String> {
    let parts = name.split(|letter: char| !letter.is_alphanumeric() && letter != '°');
    parts.filter(|part| !part.is_empty()).map(str::to_lowercase).collect()
}

impl Quantity {
    /// Whether this is the quantity's name, with or without its unit.
    fn is_named(&self, name: &str) -> bool {
        let (parts, own) = (parts(name).join("_"), self.name);
        !parts.is_empty()
            && (parts == own
                || own
                    .strip_prefix(parts.as_str())
                    .is_some_and(|unit| matches!(unit, "_m" | "_m_s" | "_rad" | "_rad_s")))
    }

    /// The part of a name that is another unit.
    fn other_unit(&self, name: &str) -> Option<String> {
        let is_other = |part: &String| {
            let mine = OTHER_UNITS.iter().filter(|(unit, _)| self.unit.split('/').any(|own| own == *unit));
            mine.flat_map(|(_, others)| others.iter()).any(|other| part == other || part.ends_with('°'))
        };
        parts(name).into_iter().find(is_other)
    }
}

/// Compares the names of the inputs.
fn check_names(axis: &AxisSpec, file: &str, fis: &Fis, places: &Places) -> Result<Option<FisError>, FisError> {
    let names: Vec<&str> = fis.inputs.iter().map(|input| input.name.as_str()).collect();
    let is_in = |other: &AxisSpec, in_order: bool| {
        let is = |(nth, name): (usize, &&str)| match in_order {
            true => other.inputs.get(nth).is_some_and(|quantity| quantity.is_named(name)),
            false => other.inputs.iter().any(|quantity| quantity.is_named(name)),
        };
        names.iter().enumerate().all(is)
    };
    let expected = || {
        let of_one = |quantity: &Quantity| format!("the {} ({})", quantity.what, quantity.unit);
        axis.inputs.iter().map(of_one).collect::<Vec<_>>().join(", ")
    };
    let place = places.inputs[0];
    if is_in(axis, true) {
        return Ok(None);
    }
    if is_in(axis, false) {
        let what = format!("the inputs are in another order: the controller gives {}", expected());
        return Err(place.error(file, what));
    }
    let Some(other) = AXES.iter().find(|other| is_in(other, false)) else {
        let what =
            format!("the inputs are called {}; the controller gives {}, in this order", names.join(", "), expected());
        return Ok(Some(place.error(file, what)));
    };
    let what =
        format!("by its inputs this is the rule base of {}; that of {} gets {}", other.name, axis.name, expected());
    // Roll and pitch have the same form: one rule base can serve both.
    let may_serve =
        ["roll", "pitch"].contains(&other.name) && ["roll", "pitch"].contains(&axis.name) && is_in(other, true);
    if may_serve { Ok(Some(place.error(file, what))) } else { Err(place.error(file, what)) }
}

/// Compares unit and range of an input.
fn check_range(
    quantity: &Quantity,
    file: &str,
    fis: &Fis,
    places: &Places,
    nth: usize,
) -> Result<Option<FisError>, FisError> {
    let (input, place) = (&fis.inputs[nth], places.ranges[nth]);
    let Quantity { what, unit, usual, .. } = *quantity;
    let [low, high] = input.range;
    if low >= 0.0 || high <= 0.0 {
        let what = format!("Range=[{low} {high}] has one sign only, but input {}, the {what}, has both", nth + 1);
        return Err(place.error(file, what));
    }
    let is_large = low.abs().max(high) > UNUSUAL * usual;
    if let Some(other) = quantity.other_unit(&input.name) {
        let what =
            format!("'{}' is named in another unit ({other}); the controller gives the {what} in {unit}", input.name);
        let fault = places.inputs[nth].error(file, what);
        return if is_large { Err(fault) } else { Ok(Some(fault)) };
    }
    let is_small = low.abs().max(high) * UNUSUAL < quantity.at[2];
    Ok((is_large || is_small).then(|| {
        let what = format!(
            "Range=[{low} {high}] is of an unusual size: the controller gives the {what} in {unit}, usually within ±{usual}"
        );
        place.error(file, what)
    }))
}

/// The largest magnitude of the output on a grid of the inputs' ranges.
fn largest_output(fis: &Fis, system: &Sugeno) -> f64 {
    const STEPS: usize = 7;
    let points = STEPS.pow(fis.inputs.len() as u32);
    let output = |nth: usize| {
        let at = |(i, [low, high]): (usize, [f64; 2])| {
            let step = nth / STEPS.pow(i as u32) % STEPS;
            low + (high - low) * step as f64 / (STEPS - 1) as f64
        };
        let inputs: Vec<f64> = fis.inputs.iter().map(|input| input.range).enumerate().map(at).collect();
        system.evaluate(&inputs).unwrap_or_default().abs()
    };
    (0..points).map(output).fold(0.0, f64::max)
}

/// The rise of the command while one input goes from this magnitude below zero to the same above, the others at zero.
fn change(system: &Sugeno, inputs: usize, nth: usize, at: f64) -> f64 {
    let command = |value: f64| {
        let inputs: Vec<f64> = (0..inputs).map(|input| if input == nth { value } else { 0.0 }).collect();
        system.evaluate(&inputs).unwrap_or_default()
    };
    command(at) - command(-at)
}
