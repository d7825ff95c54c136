//! The random numbers of one message at all its receivers.

use alloc::vec;
use alloc::vec::Vec;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::Quality;

use super::draw::{Draw, Draws, MessageKey};
use crate::random::share;

/// The random numbers of one message at all receivers, by what they decide.
#[derive(Clone, Debug)]
pub(super) struct Numbers {
    source: Draws,
    /// The decisions that any link needs.
    needed: Vec<Draw>,
    columns: [Vec<u32>; Draw::COUNT],
}

/// The decisions about a message that links need: `any` is whether one of them has a setting.
pub(super) fn needed(any: impl Fn(fn(&Quality) -> bool) -> bool) -> Vec<Draw> {
    let has = [
        (Draw::Loss, any(|quality| quality.loss > 0.0 && quality.burst_s.is_none())),
        (Draw::Jitter, any(|quality| quality.jitter_s > 0.0)),
        (Draw::Reorder, any(|quality| quality.reorder > 0.0)),
        (Draw::Duplicate, any(|quality| quality.duplicate > 0.0)),
        (Draw::Copy, any(|quality| quality.duplicate > 0.0 && quality.jitter_s > 0.0)),
    ];
    has.into_iter().filter(|(_, is_needed)| *is_needed).map(|(what, _)| what).collect()
}

impl Numbers {
    /// The numbers at vehicles 1 to `count`, of which links need those that decide `needed`.
    pub(super) fn new(source: Draws, needed: Vec<Draw>, count: usize) -> Self {
        Self { source, needed, columns: core::array::from_fn(|_| vec![0; count + 1]) }
    }

    /// Draws the numbers of a message. Those that decide a loss by distance are seldom needed.
    pub(super) fn draw(&mut self, key: &MessageKey, with_distance: bool) {
        let Self { source, needed, columns } = self;
        for what in needed.iter().copied().chain(with_distance.then_some(Draw::Distance)) {
            source.fill(what, key, &mut columns[what as usize]);
        }
    }

    /// The number that decides this at a receiver, in [0, 1).
    #[inline]
    pub(super) fn of(&self, what: Draw, receiver: VehicleId) -> f64 {
        share(self.columns[what as usize][usize::from(receiver.get())])
    }

    /// The whole numbers that decide this, by receiver.
    pub(super) fn column(&self, what: Draw) -> &[u32] {
        &self.columns[what as usize][1..]
    }

    /// The receivers whose number is below this share.
    pub(super) fn below(&self, what: Draw, below: f64) -> VehicleSet {
        // A whole number is below another number if it is below that one rounded up.
        let exact = below / share(1);
        self.below_number(what, exact as u64 + u64::from(((exact as u64) as f64) < exact))
    }

    /// The receivers whose whole number is below this one, which is 2³² at most.
    pub(super) fn below_number(&self, what: Draw, limit: u64) -> VehicleSet {
        let by_id = self.columns[what as usize].get(1..).unwrap_or_default();
        let mut blocks = [0; 4];
        for (block, numbers) in blocks.iter_mut().zip(by_id.chunks(64)) {
            let bits = numbers.iter().enumerate().map(|(nth, number)| u64::from(u64::from(*number) < limit) << nth);
            *block = bits.fold(0, |all, bit| all | bit);
        }
        VehicleSet::try_from(blocks).unwrap_or_default()
    }
}
