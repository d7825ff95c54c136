//! Publishes health once a second, on a thread that may block: the control thread's report, completed by the link's own
//! counts and clock comparison.

use std::sync::Weak;

use skein_common::id::VehicleId;
use skein_common::message::{Health, Refused};

use zenoh::Wait;

use super::MessagePublisher;
use super::clocks::{Clocks, live};

/// Publisher of health messages.
pub struct HealthPublisher {
    pub(super) publisher: MessagePublisher,
    pub(super) clocks: Clocks,
    /// Peers in contact at the last health message.
    pub(super) live: Vec<VehicleId>,
}

impl HealthPublisher {
    /// Publishes a health message after adding the refused messages, the traffic and the peers' clock offsets.
    pub fn publish(&mut self, mut health: Health) {
        health.links = self.links();
        let receiver = &self.clocks.receiver;
        (health.sent, health.received) = receiver.traffic.counts();
        let of_core = std::mem::take(&mut health.refused);
        health.refused = receiver.inbox.refusals.latest();
        health.refused.extend(of_core);
        health.refused.truncate(Refused::MAX_COUNT);
        self.live = live(&health.peers);
        self.clocks.report(&mut health.peers);
        self.publisher.publish(&health);
    }

    /// Number of links of all sessions.
    fn links(&self) -> u32 {
        let sessions = self.clocks.sessions.iter().filter_map(Weak::upgrade);
        let links: usize = sessions.map(|session| session.info().peers_zid().wait().count()).sum();
        u32::try_from(links).unwrap_or(u32::MAX)
    }

    /// Queries the next peer for its time. Call it every [`CLOCK_QUERY_PERIOD`](super::CLOCK_QUERY_PERIOD). Never
    /// waits.
    pub fn query_next_clock(&mut self) {
        self.clocks.query_next(&self.live);
    }
}
