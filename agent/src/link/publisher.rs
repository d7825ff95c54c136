//! Publishes one kind of message of one vehicle.

use std::sync::Arc;

use skein_common::message::Message;
use skein_common::topic::Topic;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;
use zenoh::{Session, Wait};

use super::{LinkError, LinkReceiver, Sessions, count, declaring};

/// A declared publisher of one kind of message, in each session. Its messages are dropped rather than waited for.
pub struct MessagePublisher {
    pub(super) publishers: Vec<Publisher<'static>>,
    key: String,
    receiver: Arc<LinkReceiver>,
}

impl MessagePublisher {
    /// Declares a publisher for this topic.
    ///
    /// # Errors
    /// If a session is closed.
    pub(super) fn open(
        sessions: &Sessions,
        receiver: &Arc<LinkReceiver>,
        topic: &Topic,
        priority: Priority,
    ) -> Result<Self, LinkError> {
        let key = receiver.branch.key(topic);
        let declare = |session: &Arc<Session>| {
            session
                .declare_publisher(key.clone())
                .congestion_control(CongestionControl::Drop)
                .priority(priority)
                .allowed_destination(Locality::Remote)
                .wait()
                .map_err(declaring(&key))
        };
        let publishers = sessions.published().map(declare).collect::<Result<_, _>>()?;
        Ok(Self { publishers, key, receiver: receiver.clone() })
    }

    /// Publishes a message, with a signature where messages are signed.
    pub fn publish(&self, message: &impl Message) {
        self.put(self.receiver.write(&self.key, message));
    }

    /// Publishes an encoded message.
    pub(super) fn put(&self, bytes: Vec<u8>) {
        count(&self.receiver.sent, bytes.len());
        let bytes = ZBytes::from(bytes);
        for publisher in &self.publishers {
            // It fails only on a closed session, which has no subscribers.
            let _ = publisher.put(bytes.clone()).wait();
        }
    }
}
