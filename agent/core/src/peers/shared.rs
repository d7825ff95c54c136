//! Records that several agents share.
//!
//! In virtual time over a perfect network all agents have received the same. Then the records exist once for all of them: a
//! message is filed once, not once per receiver. An agent that has received anything else, after a restart for example, has
//! records of its own from then on.

use alloc::sync::Arc;

use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

use super::inbox::SwarmInbox;
use super::message::PeerMessage;
use super::records::Records;

/// Messages that every vehicle of a swarm receives alike at the time of its step. A vehicle ignores its own.
#[derive(Clone, Copy, Debug, Default)]
pub struct Broadcast<'a> {
    /// The messages.
    pub messages: &'a [PeerMessage],
    /// The records that follow from the messages, for the vehicles that have received nothing else so far.
    pub records: Option<&'a SharedRecords>,
    /// The inbox that has all messages to all vehicles, for agents that share it ([`super::Peers::share_inbox`]).
    pub inbox: Option<&'a Arc<SwarmInbox>>,
}

/// The records of all agents that have received the same since their start, before and after the newest messages. They are
/// kept where the messages are delivered.
#[derive(Debug)]
pub struct SharedRecords {
    before: Arc<Records>,
    after: Arc<Records>,
}

impl SharedRecords {
    /// The records of a swarm before any message.
    pub fn new(scenario: &Scenario) -> Self {
        Self::starting_with(Records::of(scenario))
    }

    pub(super) fn starting_with(records: Records) -> Self {
        let records = Arc::new(records);
        Self { before: Arc::clone(&records), after: records }
    }

    /// Takes the messages that arrive now at all agents.
    pub fn update(&mut self, now: LocalTime, messages: &[PeerMessage]) {
        core::mem::swap(&mut self.before, &mut self.after);
        // Every agent that shares the records has continued from the ones of two updates ago.
        if let Some(after) = Arc::get_mut(&mut self.after) {
            after.copy_from(&self.before);
        } else {
            self.after = Arc::new(Records::clone(&self.before));
        }
        if let Some(after) = Arc::get_mut(&mut self.after) {
            after.update(now, messages.iter().map(|message| (message, now)));
        }
    }

    /// The records after the newest messages at this time, if an agent has these records before them.
    pub(super) fn following(&self, records: &Arc<Records>, now: LocalTime) -> Option<&Arc<Records>> {
        let has_same = Arc::ptr_eq(records, &self.before) || records.begins_like(&self.before);
        (has_same && self.after.now == now).then_some(&self.after)
    }
}
