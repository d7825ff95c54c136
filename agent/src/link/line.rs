//! One kind of message of one vehicle, on its way out.

use std::marker::PhantomData;

use skein_common::message::{Message, encode};
use skein_common::topic::Topic;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;
use zenoh::{Session, Wait};

use super::LinkError;

/// A declared publisher of one kind of message. What it says is dropped rather than waited for.
pub struct Line<M> {
    pub(super) publisher: Publisher<'static>,
    kind: PhantomData<fn(M)>,
}

impl<M: Message> Line<M> {
    /// A line to all who subscribe to this topic.
    ///
    /// # Errors
    /// If the session is closed.
    pub(super) fn open(session: &Session, topic: Topic, priority: Priority) -> Result<Self, LinkError> {
        let key = topic.key();
        let publisher = session
            .declare_publisher(key.clone())
            .congestion_control(CongestionControl::Drop)
            .priority(priority)
            .allowed_destination(Locality::Remote)
            .wait()
            .map_err(|source| LinkError::Declare { key, source })?;
        Ok(Self { publisher, kind: PhantomData })
    }

    /// Says it to whoever listens.
    pub fn say(&self, message: &M) {
        // It fails only on a closed session, and then nobody is there to hear.
        let _ = self.publisher.put(encode(message)).wait();
    }
}
