//! Runs a check of something that reads bytes of others on very many inputs.
//!
//! `cargo test` damages valid examples at random. Built with the feature `guided` and with counters of edges, as `.ci/fuzz` does,
//! the same test starts from the same examples and looks for inputs that reach code which no input has reached before.

#[cfg(feature = "guided")]
mod guided;
#[cfg(not(feature = "guided"))]
mod random;

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
