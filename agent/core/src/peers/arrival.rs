//! The arrivals of one message at its receivers.

use alloc::sync::Arc;

use skein_common::time::LocalTime;

use crate::random::share;

/// The times at which a message arrives at receivers whose links differ in their random delays alone.
#[derive(Clone, Debug)]
pub enum Arrival {
    /// It arrives at all of them at once.
    Alike(LocalTime),
    /// Each has a random delay, which is computed when it is needed: of most arrivals no vehicle ever asks the time.
    Spread(Spread),
}

impl Arrival {
    /// The time of the arrival at the receiver with this index.
    #[inline]
    pub fn at(&self, receiver: usize) -> LocalTime {
        match self {
            Self::Alike(at) => *at,
            Self::Spread(spread) => spread.at_number(spread.numbers[receiver]),
        }
    }

    /// A time by which it has arrived at all receivers.
    pub fn last_at(&self) -> LocalTime {
        match self {
            Self::Alike(at) => *at,
            Self::Spread(spread) => spread.limits()[1],
        }
    }

    /// Whether both are the arrivals of one delivery.
    pub(super) fn is(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Alike(one), Self::Alike(other)) => one == other,
            (Self::Spread(one), Self::Spread(other)) => Arc::ptr_eq(&one.numbers, &other.numbers),
            _ => false,
        }
    }
}

/// The random delays of a message.
#[derive(Clone, Debug)]
pub struct Spread {
    /// The time at which it was sent.
    pub sent_at: LocalTime,
    /// The constant part of the delay, s.
    pub delay_s: f64,
    /// The longest random part, s.
    pub jitter_s: f64,
    /// The random numbers of that part, by receiver.
    pub numbers: Arc<[u32]>,
}

impl Spread {
    /// The time at which the message reaches a receiver with this random number: the larger the number, the later.
    #[inline]
    fn at_number(&self, number: u32) -> LocalTime {
        self.sent_at.plus_seconds(self.delay_s + share(number) * self.jitter_s)
    }

    /// The earliest and the latest time at which it can reach a receiver.
    pub fn limits(&self) -> [LocalTime; 2] {
        [0, u32::MAX].map(|number| self.at_number(number))
    }

    /// The least random number with which it reaches a receiver after this time, or 2³².
    pub fn numbers_until(&self, time: LocalTime) -> u64 {
        let (mut least, mut most) = (0_u64, 1 << 32);
        while least < most {
            let middle = least.midpoint(most);
            if self.at_number(middle as u32) <= time {
                least = middle + 1;
            } else {
                most = middle;
            }
        }
        least
    }
}
