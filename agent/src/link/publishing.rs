//! The work of the publisher's thread on the messages of the control thread: it signs and encodes them, keeps the last
//! heartbeat for agents that start late, and sends.

use skein_common::message::Message;
use skein_common::topic::Topic;

use super::LinkReceiver;
use super::outgoing::Messages;

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
