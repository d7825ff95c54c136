//! What is told once a second, by a thread that may wait: health as the control thread sees it, and what only the edge knows.

use std::sync::Arc;

use skein_common::id::VehicleId;
use skein_common::message::{Health, Refused};

use super::clocks::{Clocks, live};
use super::{Ear, Line};

/// The line for health.
pub struct HealthLine {
    pub(super) line: Line<Health>,
    pub(super) ear: Arc<Ear>,
    pub(super) clocks: Clocks,
    /// The others that were heard at the last telling.
    pub(super) live: Vec<VehicleId>,
}

impl HealthLine {
    /// Says it, with what was refused at the edge and with how far the others' clocks are apart.
    pub fn say(&mut self, mut health: Health) {
        let of_core = std::mem::take(&mut health.refused);
        health.refused = self.ear.refused();
        health.refused.extend(of_core);
        health.refused.truncate(Refused::MAX_COUNT);
        self.live = live(&health.peers);
        self.clocks.tell(&mut health.peers);
        self.line.say(&health);
    }

    /// Asks the next of the others for its time; meant for every [`ASK_EVERY`](super::ASK_EVERY). Never waits.
    pub fn ask_a_clock(&mut self) {
        self.clocks.ask_next(&self.live);
    }
}
