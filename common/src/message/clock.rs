//! Measurement of the offset between the clocks of two agents.

use serde::{Deserialize, Serialize};

use super::{Message, message};
use crate::id::VehicleId;
use crate::topic::{Author, Topic};

/// Answer of an agent to a clock query: its UTC when the query arrived and when the answer left, ns since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockAnswer {
    /// The vehicle whose clock this is.
    pub sender: VehicleId,
    /// The number of the query.
    pub question: u64,
    /// Arrival of the query by the answering clock, ns since 1970.
    pub received_ns: u64,
    /// Departure of the answer by the answering clock, ns since 1970.
    pub answered_ns: u64,
}

message!(ClockAnswer, 40, |answer| Author::Vehicle(answer.sender), |answer| answer.received_ns <= answer.answered_ns);

/// Measured offset of a peer's clock, with its error bound.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockOffset {
    /// The peer's UTC minus the own UTC, s.
    pub offset_s: f64,
    /// Largest possible error of [`Self::offset_s`], s, if the peer reported its clock correctly.
    pub bound_s: f64,
}

impl ClockOffset {
    /// Computes the offset from one exchange, as NTP does (RFC 5905, 8): the query left at `asked_ns` of the own UTC,
    /// and the answer arrived `round_trip_ns` later. `None` if the peer reports more time between query and answer than
    /// passed here.
    pub fn of_exchange(asked_ns: u64, answer: &ClockAnswer, round_trip_ns: u64) -> Option<Self> {
        let spent_ns = answer.answered_ns.checked_sub(answer.received_ns)?;
        let travel_ns = round_trip_ns.checked_sub(spent_ns)?;
        let [t1, t2, t3] = [asked_ns, answer.received_ns, answer.answered_ns].map(i128::from);
        let t4 = t1 + i128::from(round_trip_ns);
        let twice_ns = (t2 - t1) + (t3 - t4);
        Some(Self { offset_s: twice_ns as f64 * 0.5e-9, bound_s: travel_ns as f64 * 0.5e-9 })
    }

    /// Whether the error bounds of both measurements overlap.
    pub fn agrees_with(&self, other: &Self) -> bool {
        (self.offset_s - other.offset_s).abs() <= self.bound_s + other.bound_s
    }

    pub(super) fn is_plausible(&self) -> bool {
        self.offset_s.is_finite() && self.bound_s.is_finite() && self.bound_s >= 0.0
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn answer(received_ns: u64, answered_ns: u64) -> ClockAnswer {
        ClockAnswer { sender: VehicleId::new(1).unwrap(), question: 0, received_ns, answered_ns }
    }

    #[test]
    fn an_exchange_gives_the_offset_and_its_bound() {
        // The peer is five seconds ahead; query 3 ms, processing 2 ms, answer 1 ms.
        let second = 1_000_000_000;
        let offset = ClockOffset::of_exchange(100 * second, &answer(105_003_000_000, 105_005_000_000), 6_000_000);
        assert_eq!(offset, Some(ClockOffset { offset_s: 5.001, bound_s: 0.002 }));
        let behind = ClockOffset::of_exchange(100 * second, &answer(99 * second, 99 * second), 0);
        assert_eq!(behind, Some(ClockOffset { offset_s: -1.0, bound_s: 0.0 }));
        assert_eq!(
            ClockOffset::of_exchange(0, &answer(0, 2), 1),
            None,
            "the peer reports more time than the round trip took"
        );
        assert_eq!(ClockOffset::of_exchange(0, &answer(2, 1), 9), None, "the peer reports an answer before the query");
    }

    proptest! {
        #[test]
        fn the_true_offset_is_within_the_bound(
            asked_ns in 1_u64 << 60..1_u64 << 61, ahead_ns in -(1_i64 << 40)..1_i64 << 40,
            there_ns in 0_u64..1 << 30, spent_ns in 0_u64..1 << 30, back_ns in 0_u64..1 << 30,
        ) {
            let there = |right_ns: u64| right_ns.checked_add_signed(ahead_ns).unwrap();
            let answer = answer(there(asked_ns + there_ns), there(asked_ns + there_ns + spent_ns));
            let found = ClockOffset::of_exchange(asked_ns, &answer, there_ns + spent_ns + back_ns).unwrap();
            prop_assert!((found.offset_s - ahead_ns as f64 * 1e-9).abs() <= found.bound_s + 1e-9);
        }

        #[test]
        fn any_answer_gives_a_finite_offset(asked_ns: u64, received_ns: u64, answered_ns: u64, round_trip_ns: u64) {
            let found = ClockOffset::of_exchange(asked_ns, &answer(received_ns, answered_ns), round_trip_ns);
            prop_assert!(found.is_none_or(|found| found.is_plausible()));
        }
    }
}
