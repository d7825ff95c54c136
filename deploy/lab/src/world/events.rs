//! The events of one tick.

use skein_common::id::VehicleId;
use skein_common::message::EventKind;

/// The events that agents reported in one tick, each with its vehicle, encoded: in the first tick of a large swarm every
/// vehicle finds every other.
#[derive(Clone, Debug, Default)]
pub(super) struct Events {
    encoded: Vec<u8>,
}

/// Memory that is kept from one tick to the next, bytes.
const KEPT: usize = 1024;

impl Events {
    pub(super) fn clear(&mut self) {
        self.encoded.clear();
        self.encoded.shrink_to(KEPT);
    }

    /// Adds the events of a vehicle.
    pub(super) fn add(&mut self, of: VehicleId, events: impl IntoIterator<Item = EventKind>) {
        for what in events {
            let encoded = postcard::to_extend(&(of, what), std::mem::take(&mut self.encoded));
            #[expect(clippy::expect_used, reason = "memory that grows takes every event")]
            let encoded = encoded.expect("an event is encoded");
            self.encoded = encoded;
        }
    }

    /// The events in the order in which they were added.
    pub(super) fn iter(&self) -> impl Iterator<Item = (VehicleId, EventKind)> {
        let mut rest = self.encoded.as_slice();
        std::iter::from_fn(move || {
            let event;
            (event, rest) = postcard::take_from_bytes(rest).ok()?;
            Some(event)
        })
    }
}

#[cfg(test)]
mod tests {
    use skein_common::id::VehicleSet;

    use super::*;

    #[test]
    fn events_come_back_as_they_were_added() {
        let id = |number| VehicleId::new(number).unwrap();
        let without: VehicleSet = VehicleId::first(250).collect();
        let kinds = [EventKind::PeerFound(id(250)), EventKind::ForcedAdvance { to: 7, without }, EventKind::Landed];
        let mut events = Events::default();
        events.add(id(1), kinds);
        events.add(id(3), []);
        events.add(id(2), [EventKind::PeerLost(id(1))]);
        let expected = kinds.map(|what| (id(1), what)).into_iter().chain([(id(2), EventKind::PeerLost(id(1)))]);
        assert_eq!(events.iter().collect::<Vec<_>>(), expected.collect::<Vec<_>>());
        events.clear();
        assert_eq!(events.iter().count(), 0);
    }
}
