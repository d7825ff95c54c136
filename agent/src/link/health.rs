//! Publishes health once a second, on a thread that may block: the control thread's report, completed by the link's own
//! counts and clock comparison.
use std::sync::Arc;

use skein_common::id::VehicleId;
use skein_common::message::{Health, Refused};

use super::clocks::{Clocks, live};
use super::{LinkReceiver, MessagePublisher};

/// Publisher of health messages.
pub struct HealthPublisher {
    pub(super) publisher: MessagePublisher<Health>,
    pub(super) receiver: Arc<LinkReceiver>,
    pub(super) clocks: Clocks,
    /// Peers in contact at the last health message.
    pub(super) live: Vec<VehicleId>,
}

impl HealthPublisher {
    /// Publishes a health message after adding the refused messages and the peers' clock offsets.
    pub fn publish(&mut self, mut health: Health) {
        let of_core = std::mem::take(&mut health.refused);
        health.refused = self.receiver.refused();
        health.refused.extend(of_core);
        health.refused.truncate(Refused::MAX_COUNT);
        self.live = live(&health.peers);
        self.clocks.report(&mut health.peers);
        self.publisher.publish(&health);
    }

    /// Queries the next peer for its time. Call it every [`CLOCK_QUERY_PERIOD`](super::CLOCK_QUERY_PERIOD). Never
    /// waits.
    pub fn query_next_clock(&mut self) {
        self.clocks.query_next(&self.live);
    }
}
