//! Damages examples at random.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{Config, TestError, TestRunner};

use super::NUMBERS;

/// Longest noise beside examples, bytes.
const LONGEST_NOISE: usize = 600;
/// Longest noise where there are no examples, bytes: a sequence of many steps is made of it.
const LONGEST_SEQUENCE: usize = 12_000;

/// Checks each example, and as many damaged ones as CI has time for. Without examples every input is noise. The environment
/// variable `SKEIN_FUZZ` multiplies the number of inputs.
///
/// # Panics
/// If the check panics; the message shows the smallest input that is found to do so.
pub fn explore(inputs_in_ci: u32, examples: &[Vec<u8>], check: impl Fn(&[u8])) {
    let times = std::env::var("SKEIN_FUZZ").map_or(1, |times| times.parse().expect("SKEIN_FUZZ is a whole number"));
    let config = Config { cases: inputs_in_ci * times, failure_persistence: None, ..Config::default() };
    examples.iter().for_each(|example| check(example));
    let ran = TestRunner::new(config).run(&inputs(examples), |input| {
        check(&input);
        Ok(())
    });
    match ran {
        Err(TestError::Fail(why, input)) => {
            panic!("{why}\nsmallest input: {input:?}\nas text: {:?}", String::from_utf8_lossy(&input))
        }
        ran => ran.unwrap_or_else(|error| panic!("{error}")),
    }
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

/// One of these examples with some damage, or noise; long noise if there are no examples.
fn inputs(examples: &[Vec<u8>]) -> BoxedStrategy<Vec<u8>> {
    if examples.is_empty() {
        return noise(LONGEST_SEQUENCE).boxed();
    }
    let near = (select(examples.to_vec()), vec(damage(), 0..5)).prop_map(|(mut bytes, damages)| {
        damages.iter().for_each(|damage| damage.apply(&mut bytes));
        bytes
    });
    prop_oneof![9 => near, 1 => noise(LONGEST_NOISE)].boxed()
}
