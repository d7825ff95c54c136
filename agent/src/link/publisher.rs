//! Signs, encodes and publishes the messages of one vehicle, on the publisher's thread, and keeps the last heartbeat for
//! agents that start late.

use std::sync::Arc;

use skein_common::message::Message;
use skein_common::topic::Topic;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;
use zenoh::{Session, Wait};

use super::outgoing::Messages;
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

impl LinkReceiver {
    /// Publishes all waiting messages: `put` gets the topic, the key and the bytes of each.
    pub(super) fn publish(&self, waiting: &mut Messages, mut put: impl FnMut(Topic, &str, Vec<u8>)) {
        let (own, put) = (self.own, &mut put);
        if let Some((state, cell)) = waiting.state.take() {
            self.publish_one(Topic::State(own, cell), &state, put);
        }
        if let Some((intent, cells)) = waiting.intent.take() {
            cells.into_iter().for_each(|cell| self.publish_one(Topic::Intent(own, cell), &intent, put));
        }
        if let Some(mission) = waiting.mission.take() {
            self.publish_one(Topic::Mission(own), &mission, put);
        }
        waiting.events.drain(..).for_each(|event| self.publish_one(Topic::Event(own), &event, put));
        waiting.traces.drain(..).for_each(|trace| self.publish_one(Topic::Trace(own), &trace, put));
        if let Some(summary) = waiting.summary.take() {
            self.publish_one(Topic::Summary(own), &summary.rounded(), put);
        }
    }

    fn publish_one(&self, topic: Topic, message: &impl Message, put: &mut impl FnMut(Topic, &str, Vec<u8>)) {
        let key = self.branch.key(&topic);
        let bytes = self.write(&key, message);
        if matches!(topic, Topic::Mission(_)) {
            self.last_heartbeat.lock().clone_from(&bytes);
        }
        put(topic, &key, bytes);
    }
}
