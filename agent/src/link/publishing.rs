//! The work of the publisher's thread on the messages of the control thread: it signs and encodes them, keeps the last
//! heartbeat for agents that start late, and sends.

use std::sync::Arc;

use skein_common::id::VehicleId;
use skein_common::message::State;
use skein_common::topic::{Cell, Topic};

use super::LinkReceiver;
use super::outgoing::Messages;
use super::queries::LastHeartbeat;

/// Kind of a published message, on which its quality of service depends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Published {
    State,
    Intent,
    Heartbeat,
    Event,
    Trace,
    Summary,
}

/// Carries the published messages: Zenoh's sessions, or the network that a test simulates.
pub(super) trait Network {
    /// Publishes an encoded message under this key.
    fn put(&mut self, what: Published, key: &str, bytes: Vec<u8>);

    /// Subscribes to the states and intents of other teams in these cells, and in no others.
    fn subscribe(&mut self, cells: &[Cell]);
}

/// Encodes and sends the messages of one vehicle.
pub(super) struct Publishing {
    receiver: Arc<LinkReceiver>,
    own: VehicleId,
    /// The key of the last state, and its cell.
    state_key: Option<(Cell, String)>,
    last_heartbeat: LastHeartbeat,
}

impl Publishing {
    pub(super) fn new(receiver: Arc<LinkReceiver>, own: VehicleId, last_heartbeat: LastHeartbeat) -> Self {
        Self { receiver, own, state_key: None, last_heartbeat }
    }

    /// Sends all waiting messages.
    pub(super) fn send(&mut self, waiting: &mut Messages, network: &mut impl Network) {
        let (receiver, own) = (self.receiver.clone(), self.own);
        let key_of = |topic: Topic| receiver.branch.key(&topic);
        if let Some(cells) = waiting.cells.take() {
            network.subscribe(&cells);
        }
        if let Some((state, cell)) = waiting.state.take() {
            self.send_state(&state, cell, network);
        }
        if let Some((intent, cells)) = waiting.intent.take() {
            for key in cells.into_iter().map(|cell| key_of(Topic::Intent(own, cell))) {
                network.put(Published::Intent, &key, receiver.write(&key, &intent));
            }
        }
        if let Some(mission) = waiting.mission.take() {
            let key = key_of(Topic::Mission(own));
            let bytes = receiver.write(&key, &mission);
            self.last_heartbeat.keep(bytes.clone());
            network.put(Published::Heartbeat, &key, bytes);
        }
        for event in waiting.events.drain(..) {
            let key = key_of(Topic::Event(own));
            network.put(Published::Event, &key, receiver.write(&key, &event));
        }
        for trace in waiting.traces.drain(..) {
            let key = key_of(Topic::Trace(own));
            network.put(Published::Trace, &key, receiver.write(&key, &trace));
        }
        if let Some(summary) = waiting.summary.take() {
            let key = key_of(Topic::Summary(own));
            network.put(Published::Summary, &key, receiver.write(&key, &summary.rounded()));
        }
    }

    fn send_state(&mut self, state: &State, cell: Cell, network: &mut impl Network) {
        let key = match &mut self.state_key {
            Some((of, key)) if *of == cell => key,
            key => &mut key.insert((cell, self.receiver.branch.key(&Topic::State(self.own, cell)))).1,
        };
        network.put(Published::State, key, self.receiver.write(key, state));
    }
}
