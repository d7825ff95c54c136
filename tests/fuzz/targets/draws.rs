//! Makes sequences of steps out of the bytes of an input.

use arbitrary::{Result, Unstructured};
use skein_fuzz::NUMBERS;

/// True in this share of the inputs.
pub(super) fn sometimes(from: &mut Unstructured, share: f64) -> Result<bool> {
    Ok(f64::from(from.arbitrary::<u8>()?) + 0.5 < 256.0 * share && !from.is_empty())
}

/// A number of the usual size, one of those that are often treated wrongly, or any.
pub(super) fn number(from: &mut Unstructured) -> Result<f64> {
    match from.int_in_range(0..=3)? {
        0 => Ok(*from.choose(&NUMBERS)?),
        1 => from.arbitrary(),
        _ => between(from, -100.0, 100.0),
    }
}

/// A number between these.
pub(super) fn between(from: &mut Unstructured, least: f64, most: f64) -> Result<f64> {
    Ok(least + (most - least) * f64::from(from.arbitrary::<u16>()?) / f64::from(u16::MAX))
}

/// The part, or none in the remaining cases.
pub(super) fn option<T>(
    from: &mut Unstructured,
    share: f64,
    part: impl FnOnce(&mut Unstructured) -> Result<T>,
) -> Result<Option<T>> {
    if sometimes(from, share)? { part(from).map(Some) } else { Ok(None) }
}

/// As many parts as the bytes are enough for, up to a number. A part that its bytes do not make is left out.
pub(super) fn parts<T>(from: &mut Unstructured, most: usize, part: impl Fn(&mut Unstructured) -> Result<T>) -> Vec<T> {
    let mut parts = Vec::new();
    while !from.is_empty() && parts.len() < most {
        parts.extend(part(from));
    }
    parts
}

/// Up to so many parts.
pub(super) fn several<T>(
    from: &mut Unstructured,
    most: usize,
    part: impl Fn(&mut Unstructured) -> Result<T>,
) -> Result<Vec<T>> {
    (0..from.int_in_range(0..=most)?).map(|_| part(from)).collect()
}
