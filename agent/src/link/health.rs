//! Publishes health once a second, on a thread that may block: the control thread's report, completed by the link's own
//! counts and clock comparison.
use std::sync::Arc;

use skein_common::id::VehicleId;
use skein_common::message::{Health, Refused};

use super::clocks::{Clocks, live};
use super::{Ear, Line};

/// Publisher of health messages.
pub struct HealthLine {
    pub(super) line: Line<Health>,
    pub(super) ear: Arc<Ear>,
    pub(super) clocks: Clocks,
    /// Peers in contact at the last health message.
    pub(super) live: Vec<VehicleId>,
}

impl HealthLine {
    /// Publishes a health message after adding the refused messages and the peers' clock offsets.
    pub fn say(&mut self, mut health: Health) {
        let of_core = std::mem::take(&mut health.refused);
        health.refused = self.ear.refused();
        health.refused.extend(of_core);
        health.refused.truncate(Refused::MAX_COUNT);
        self.live = live(&health.peers);
        self.clocks.tell(&mut health.peers);
        self.line.say(&health);
    }

    /// Queries the next peer for its time. Call it every [`ASK_EVERY`](super::ASK_EVERY). Never waits.
    pub fn ask_a_clock(&mut self) {
        self.clocks.ask_next(&self.live);
    }
}
