//! Strategies for damaged inputs.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::Config;

/// Numbers that are often treated wrongly.
const NUMBERS: [f64; 8] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -0.0, f64::MAX, f64::MIN_POSITIVE, 1e9, -1.0];
/// Longest noise, bytes.
const LONGEST_NOISE: usize = 600;

/// Runs this many cases in CI, and a multiple of them by hand.
pub(super) fn cases(ci: u32) -> Config {
    let times = std::env::var("SKEIN_FUZZ").map_or(1, |times| times.parse().expect("SKEIN_FUZZ is a whole number"));
    // Most numbers are not plausible, and a strategy then draws again.
    Config { cases: ci * times, failure_persistence: None, max_local_rejects: u32::MAX, ..Config::default() }
}

/// A change of some bytes.
#[derive(Clone, Debug)]
enum Damage {
    Byte(Index, u8),
    Single(Index, f32),
    Double(Index, f64),
    Cut(Index),
    Append(Vec<u8>),
    /// Repeats the bytes between two places.
    Repeat(Index, Index),
    Remove(Index, Index),
}

impl Damage {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let between = |one: &Index, other: &Index, bytes: &[u8]| {
            let (one, other) = (one.index(bytes.len() + 1), other.index(bytes.len() + 1));
            one.min(other)..one.max(other)
        };
        let write = |at: &Index, new: &[u8], bytes: &mut Vec<u8>| {
            let at = at.index(bytes.len() + 1);
            bytes.iter_mut().skip(at).zip(new).for_each(|(old, new)| *old = *new);
        };
        match self {
            Self::Byte(at, byte) => write(at, &[*byte], bytes),
            Self::Single(at, number) => write(at, &number.to_le_bytes(), bytes),
            Self::Double(at, number) => write(at, &number.to_le_bytes(), bytes),
            Self::Cut(at) => bytes.truncate(at.index(bytes.len() + 1)),
            Self::Append(more) => bytes.extend(more),
            Self::Repeat(from, to) => {
                let again = bytes[between(from, to, bytes)].to_vec();
                bytes.extend(again.into_iter().take(LONGEST_NOISE));
            }
            Self::Remove(from, to) => drop(bytes.drain(between(from, to, bytes))),
        }
    }
}

fn damage() -> impl Strategy<Value = Damage> {
    prop_oneof![
        4 => (any::<Index>(), any::<u8>()).prop_map(|(at, byte)| Damage::Byte(at, byte)),
        1 => (any::<Index>(), select(&NUMBERS[..])).prop_map(|(at, number)| Damage::Single(at, number as f32)),
        1 => (any::<Index>(), select(&NUMBERS[..])).prop_map(|(at, number)| Damage::Double(at, number)),
        1 => any::<Index>().prop_map(Damage::Cut),
        1 => noise(20).prop_map(Damage::Append),
        1 => any::<(Index, Index)>().prop_map(|(from, to)| Damage::Repeat(from, to)),
        1 => any::<(Index, Index)>().prop_map(|(from, to)| Damage::Remove(from, to)),
    ]
}

fn noise(most: usize) -> impl Strategy<Value = Vec<u8>> {
    vec(any::<u8>(), 0..most)
}

/// One of these examples with some damage, or noise.
pub(super) fn damaged(examples: Vec<Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    let near = (select(examples), vec(damage(), 0..5)).prop_map(|(mut bytes, damages)| {
        damages.iter().for_each(|damage| damage.apply(&mut bytes));
        bytes
    });
    prop_oneof![9 => near, 1 => noise(LONGEST_NOISE)]
}

/// One of these texts with some damage, or noise.
pub(super) fn damaged_text(examples: &[&str]) -> impl Strategy<Value = String> {
    damaged(examples.iter().map(|example| example.as_bytes().to_vec()).collect())
        .prop_map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
}

/// Any number, often one of those that are treated wrongly or one of the usual size.
pub(super) fn number() -> impl Strategy<Value = f64> {
    prop_oneof![2 => -100.0..100.0, 1 => any::<f64>(), 1 => select(&NUMBERS[..])]
}
