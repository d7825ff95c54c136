//! Types for times of three clocks. The compiler refuses to mix them.
//!
//! * [`PlantTime`] is the simulator's time. It stops when the simulator pauses. Control and missions use it.
//! * [`LocalTime`] is the monotonic time of this process. The ages of peers' states are measured with it.
//! * [`SenderStamp`] is the [`LocalTime`] of another process, written into its message. It orders the messages of that
//!   sender. A stamp that is echoed gives its sender the round trip. The difference of two stamps of one sender gives
//!   the receiver the difference of two delays. Skein never assumes synchronised clocks.
//!
//! ```compile_fail
//! use skein_common::time::{LocalTime, PlantTime};
//! let age = LocalTime::from_seconds(2.0).seconds_since(PlantTime::from_seconds(1.0)); // two different clocks
//! ```

use serde::{Deserialize, Serialize};

macro_rules! timeline {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub struct $name(u64);

        impl $name {
            /// The clock's zero.
            pub const ZERO: Self = Self(0);

            /// The latest time.
            pub const MAX: Self = Self(u64::MAX);

            /// The time `nanoseconds` after the clock's zero.
            #[inline]
            pub const fn from_nanoseconds(nanoseconds: u64) -> Self {
                Self(nanoseconds)
            }

            /// The time `seconds` after the clock's zero; negative or non-finite values become zero.
            #[inline]
            pub fn from_seconds(seconds: f64) -> Self {
                Self((seconds * 1e9).round() as u64)
            }

            /// Nanoseconds since the clock's zero.
            #[inline]
            pub const fn nanoseconds(self) -> u64 {
                self.0
            }

            /// Seconds since the clock's zero.
            #[inline]
            pub fn seconds(self) -> f64 {
                self.0 as f64 * 1e-9
            }

            /// Seconds from `earlier` to `self`; negative if `earlier` is the later one.
            #[inline]
            pub fn seconds_since(self, earlier: Self) -> f64 {
                self.0.wrapping_sub(earlier.0) as i64 as f64 * 1e-9
            }

            /// The instant `seconds` later (earlier, if negative), never before the clock's zero.
            #[inline]
            pub fn plus_seconds(self, seconds: f64) -> Self {
                Self(self.0.saturating_add_signed(rounded(seconds * 1e9)))
            }
        }
    };
}

/// The nearest whole number, halves away from zero, as `f64::round` gives it, but without a call.
#[inline]
fn rounded(number: f64) -> i64 {
    /// From this number on, numbers have no digits after the point: a sum with it is whole.
    const WHOLE: f64 = (1_u64 << 52) as f64;
    let size = number.abs();
    if size < WHOLE / 2.0 {
        let nearest = (size + WHOLE) - WHOLE;
        let away = if size - nearest >= 0.5 { nearest + 1.0 } else { nearest };
        let whole = ((away + WHOLE).to_bits() - WHOLE.to_bits()) as i64;
        return if number < 0.0 { -whole } else { whole };
    }
    let whole = number as i64;
    let rest = number - whole as f64;
    whole.saturating_add(i64::from(rest >= 0.5)).saturating_sub(i64::from(rest <= -0.5))
}

timeline! {
    /// Time of the simulator. It stops while the simulator is paused.
    PlantTime
}
timeline! {
    /// Monotonic time of this process.
    LocalTime
}
timeline! {
    /// [`LocalTime`] of the process that sent a message, by the sender's clock.
    SenderStamp
}

impl From<LocalTime> for SenderStamp {
    /// Makes the stamp that the sender writes into a message from its local time.
    fn from(time: LocalTime) -> Self {
        Self(time.0)
    }
}

/// One instant by the two clocks of an agent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Now {
    /// Simulator time of the newest frame.
    pub plant: PlantTime,
    /// Monotonic time of the agent's process.
    pub local: LocalTime,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_have_a_sign_and_no_wrap() {
        let early = PlantTime::from_seconds(1.5);
        let late = early.plus_seconds(2.25);
        assert_eq!(late.seconds_since(early), 2.25);
        assert_eq!(early.seconds_since(late), -2.25);
        assert_eq!(early.plus_seconds(-10.0), PlantTime::ZERO);
        assert_eq!(PlantTime::from_seconds(f64::NAN), PlantTime::ZERO);
    }

    #[test]
    fn numbers_are_rounded_as_by_the_standard_library() {
        let halves = (-40..=40).map(|half| f64::from(half) / 2.0);
        let edges = [0.49999999999999994, 4503599627370495.5, 9007199254740993.0, 9.3e18, f64::INFINITY, f64::NAN];
        let spread = (0..10_000).map(|nth| f64::from(nth) * 123_456.789);
        for number in halves.chain(edges).chain(spread).flat_map(|number| [number, -number]) {
            assert_eq!(rounded(number), number.round() as i64, "{number}");
        }
    }
}
