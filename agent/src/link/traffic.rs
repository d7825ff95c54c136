//! Counts the messages of one agent.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use skein_common::message;

/// Messages that an agent has sent and received, and their bytes without Zenoh's framing. A message that goes out on
/// several links counts once.
#[derive(Debug, Default)]
pub(super) struct Traffic {
    pub(super) sent: Counter,
    /// Those that were refused included.
    pub(super) received: Counter,
}

/// Messages in one direction.
#[derive(Debug, Default)]
pub(super) struct Counter {
    messages: AtomicU64,
    bytes: AtomicU64,
}

impl Counter {
    fn count(&self) -> message::Traffic {
        let (messages, bytes) = (self.messages.load(Relaxed), self.bytes.load(Relaxed));
        message::Traffic { messages, bytes }
    }

    /// Counts a message of this size.
    pub(super) fn add(&self, bytes: usize) {
        self.messages.fetch_add(1, Relaxed);
        self.bytes.fetch_add(bytes as u64, Relaxed);
    }
}

impl Traffic {
    /// The messages sent and received so far.
    pub(super) fn counts(&self) -> (message::Traffic, message::Traffic) {
        (self.sent.count(), self.received.count())
    }
}
