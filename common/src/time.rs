//! Three clocks that never mix.
//!
//! * [`PlantTime`] is the simulator's: it stops when the simulator pauses. Control and missions run on it.
//! * [`LocalTime`] is this process's own monotonic clock: the age of a peer's word is judged by it.
//! * [`SenderStamp`] is another process's [`LocalTime`], which it wrote into its message. It orders that sender's
//!   messages. Sent back, it gives its sender the round trip. The difference of two stamps of one sender gives the
//!   receiver the difference of two delays. No synchronisation of clocks is assumed anywhere.
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

            /// `nanoseconds` after the clock's zero.
            #[inline]
            pub const fn from_nanoseconds(nanoseconds: u64) -> Self {
                Self(nanoseconds)
            }

            /// `seconds` after the clock's zero; negative or non-finite values become zero.
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
                Self(self.0.saturating_add_signed((seconds * 1e9).round() as i64))
            }
        }
    };
}

timeline! {
    /// The simulator's time. It stands still while the simulator is paused.
    PlantTime
}
timeline! {
    /// This process's monotonic time.
    LocalTime
}
timeline! {
    /// The [`LocalTime`] of whoever wrote a message, by its own clock.
    SenderStamp
}

impl From<LocalTime> for SenderStamp {
    /// What the sender writes into a message: its own time, from now on only a stamp.
    fn from(time: LocalTime) -> Self {
        Self(time.0)
    }
}

/// One instant as an agent sees it: on its simulator's clock and on its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Now {
    /// Of the newest frame.
    pub plant: PlantTime,
    /// Of this process.
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
}
