//! Runs a check of something that reads bytes of others on very many inputs.
//!
//! `cargo test` damages valid examples at random. Built with the feature `guided` and with counters of edges, as `.ci/fuzz` does,
//! the same test starts from the same examples and looks for inputs that reach code which no input has reached before.

#[cfg(feature = "guided")]
mod guided;
#[cfg(not(feature = "guided"))]
mod random;

use serde_json::Value;

#[cfg(feature = "guided")]
pub use guided::explore;
#[cfg(not(feature = "guided"))]
pub use random::explore;

/// Numbers that are often treated wrongly.
pub const NUMBERS: [f64; 8] =
    [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -0.0, f64::MAX, f64::MIN_POSITIVE, 1e9, -1.0];

/// The same for a reader of text.
pub fn explore_text(inputs_in_ci: u32, examples: &[&str], check: impl Fn(&str)) {
    let examples: Vec<_> = examples.iter().map(|example| example.as_bytes().to_vec()).collect();
    explore(inputs_in_ci, &examples, |bytes| check(&String::from_utf8_lossy(bytes)));
}

/// The two are the same but for the last digit of a number, which `serde_json` may read differently.
///
/// # Panics
/// They are not.
pub fn assert_same(one: &Value, other: &Value) {
    match (one, other) {
        (Value::Object(one), Value::Object(other)) => {
            assert!(one.keys().eq(other.keys()));
            one.values().zip(other.values()).for_each(|(one, other)| assert_same(one, other));
        }
        (Value::Array(one), Value::Array(other)) => {
            assert_eq!(one.len(), other.len());
            one.iter().zip(other).for_each(|(one, other)| assert_same(one, other));
        }
        (Value::Number(one), Value::Number(other)) if one.is_f64() && other.is_f64() => {
            let is_near = |(one, other): (f64, f64)| (one - other).abs() <= 1e-14 * one.abs() + f64::MIN_POSITIVE;
            assert!(one.as_f64().zip(other.as_f64()).is_some_and(is_near), "{one} and {other}");
        }
        _ => assert_eq!(one, other),
    }
}
