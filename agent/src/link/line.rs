//! One kind of message of one vehicle, on its way out.

use std::marker::PhantomData;
use std::sync::Arc;

use skein_common::message::{Message, encode};
use skein_common::topic::Topic;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;
use zenoh::{Session, Wait};

use super::{LinkError, Sessions, declaring};

/// A declared publisher of one kind of message, in each session. What it says is dropped rather than waited for.
pub struct Line<M> {
    pub(super) publishers: Vec<Publisher<'static>>,
    kind: PhantomData<fn(M)>,
}

impl<M: Message> Line<M> {
    /// A line to all who subscribe to this topic.
    ///
    /// # Errors
    /// If the session is closed.
    pub(super) fn open(sessions: &Sessions, topic: Topic, priority: Priority) -> Result<Self, LinkError> {
        let key = topic.key();
        let declare = |session: &Arc<Session>| {
            session
                .declare_publisher(key.clone())
                .congestion_control(CongestionControl::Drop)
                .priority(priority)
                .allowed_destination(Locality::Remote)
                .wait()
                .map_err(declaring(&key))
        };
        let publishers = sessions.0.iter().map(declare).collect::<Result<_, _>>()?;
        Ok(Self { publishers, kind: PhantomData })
    }

    /// Says it to whoever listens.
    pub fn say(&self, message: &M) {
        let said = ZBytes::from(encode(message));
        for publisher in &self.publishers {
            // It fails only on a closed session, and then nobody is there to hear.
            let _ = publisher.put(said.clone()).wait();
        }
    }
}
