//! States and intents of the vehicles of other teams, received by cells: the newest of each vehicle, for the control
//! thread.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;
use skein_common::frame::Origin;
use skein_common::id::FleetVehicle;
use skein_common::message::{Intent, Message, MessageOrder, Reason, State};
use skein_common::time::LocalTime;
use skein_common::topic::{Author, Branch, Cell, Topic, all_in};
use skein_core::intent::ReceivedIntent;
use skein_core::strangers::StrangerState;
use skein_host::clock::LocalClock;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Locality, Sample};
use zenoh::{Session, Wait};

use super::LinkReceiver;

/// Largest number of strangers kept between two steps: many times as many as fly in eighteen cells.
const MAX_STRANGERS: usize = 4096;

/// Filled by Zenoh's threads, emptied by the control thread.
#[derive(Debug)]
pub(super) struct StrangerInbox {
    /// Origin of the own team's frame.
    origin: Origin,
    /// The newest state of each stranger, by team and id.
    states: Mutex<Vec<StrangerState>>,
    /// The newest intent of each, alike.
    intents: Mutex<Vec<ReceivedIntent>>,
}

/// A message of a stranger.
trait FromStranger {
    fn place(&self) -> (FleetVehicle, MessageOrder);
}

impl FromStranger for StrangerState {
    fn place(&self) -> (FleetVehicle, MessageOrder) {
        (self.id, self.order)
    }
}

impl FromStranger for ReceivedIntent {
    fn place(&self) -> (FleetVehicle, MessageOrder) {
        (self.id, self.order)
    }
}

impl StrangerInbox {
    pub(super) fn new(origin: Origin) -> Self {
        Self { origin, states: Mutex::default(), intents: Mutex::default() }
    }

    /// Moves all states and intents to the ends of these lists.
    pub(super) fn drain(&self, states: &mut Vec<StrangerState>, intents: &mut Vec<ReceivedIntent>) {
        states.append(&mut self.states.lock());
        intents.append(&mut self.intents.lock());
    }
}

/// Keeps a message if it is newer than the one of its sender that waits. False if it is not, or too many wait.
fn store<M: FromStranger>(messages: &Mutex<Vec<M>>, new: M) -> bool {
    let (mut messages, (id, order)) = (messages.lock(), new.place());
    match messages.binary_search_by_key(&id, |kept| kept.place().0) {
        Ok(place) if messages[place].place().1 < order => messages[place] = new,
        Err(place) if messages.len() < MAX_STRANGERS => messages.insert(place, new),
        _ => return false,
    }
    true
}

impl LinkReceiver {
    /// Takes a state or intent that was published in a subscribed cell, if its sender is of another team. The own team's
    /// states are received by their own key expression, wherever the members are.
    fn receive_in_cell(&self, key: &str, bytes: &[u8], at: LocalTime) {
        let Some((branch, topic)) = Branch::parse(key) else { return };
        let (Some(team), Author::Vehicle(vehicle)) = (branch.team(), topic.author()) else { return };
        if branch == self.branch {
            return;
        }
        let (id, strangers) = (FleetVehicle { team, vehicle }, &self.strangers);
        match topic {
            Topic::State(..) => self.receive_stranger(key, bytes, id, |State { header, state }| {
                let (position, convergence) = strangers.origin.locate(&state.position);
                let (order, velocity) = (header.order(), convergence.velocity_from_local(state.velocity));
                store(&strangers.states, StrangerState { id, order, position, velocity, at })
            }),
            // An agent publishes the same intent in several cells: it counts once.
            Topic::Intent(..) => self.receive_stranger(key, bytes, id, |message: Intent| {
                let order = message.header.order();
                let intent = ReceivedIntent::new(team, &message, &strangers.origin, at);
                store(&strangers.intents, intent) || is_kept(&strangers.intents, id, order)
            }),
            _ => {}
        }
    }

    /// Verifies a message of a stranger and stores it with `store`, which is false for an old message.
    fn receive_stranger<M: Message>(&self, key: &str, bytes: &[u8], id: FleetVehicle, store: impl Fn(M) -> bool) {
        self.traffic.received.add(bytes.len());
        if !self.presence.may_send(id.into()) {
            self.inbox.refusals.refuse(Reason::Old, key, &"its sender has no link");
            return;
        }
        let verified = match self.key_ring.read::<M>(key, bytes) {
            Ok(verified) => verified,
            Err(error) => return self.inbox.refusals.refuse(error.reason(), key, &error),
        };
        if let Err(reason) = self.verifier.accept_stranger(id.team, verified.run) {
            return self.inbox.refusals.refuse(reason, key, &reason);
        }
        if !store(verified.message) {
            self.inbox.refusals.count(Reason::Old, key);
        }
    }
}

/// Whether this message waits already.
fn is_kept<M: FromStranger>(messages: &Mutex<Vec<M>>, id: FleetVehicle, order: MessageOrder) -> bool {
    messages.lock().iter().any(|kept| kept.place() == (id, order))
}

/// The subscribed cells, on the publisher's thread.
#[derive(Default)]
pub(super) struct SubscribedCells(BTreeMap<Cell, Vec<Subscriber<()>>>);

impl SubscribedCells {
    /// Subscribes to these cells, and then drops the subscriptions to all others: a vehicle that flies from one cell to
    /// the next stays in sight. One key expression covers a cell.
    pub(super) fn set(
        &mut self,
        cells: &[Cell],
        sessions: &[Arc<Session>],
        receiver: &Arc<LinkReceiver>,
        clock: LocalClock,
    ) {
        for cell in cells {
            self.0.entry(*cell).or_insert_with(|| {
                let key = all_in(*cell);
                let subscribe = |session: &Arc<Session>| {
                    let receiver = receiver.clone();
                    let subscriber = session.declare_subscriber(&key).allowed_origin(Locality::Remote);
                    // It fails only on a closed session.
                    let receive = move |sample: Sample| {
                        let (key, bytes) = (sample.key_expr().as_str(), sample.payload().to_bytes());
                        receiver.receive_in_cell(key, &bytes, clock.now());
                    };
                    subscriber.callback(receive).wait().ok()
                };
                sessions.iter().filter_map(subscribe).collect()
            });
        }
        self.0.retain(|cell, _| cells.contains(cell));
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{Geodetic, PositionNed, VelocityNed};
    use skein_common::id::Incarnation;
    use skein_common::message::MessageOrder;
    use skein_common::time::LocalTime;

    use super::*;

    #[test]
    fn the_newest_state_of_each_stranger_waits_for_the_control_thread() {
        let inbox = StrangerInbox::new(Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0)));
        let state = |name: &str, sequence| StrangerState {
            id: name.parse().unwrap(),
            order: MessageOrder { incarnation: Incarnation(1), sequence },
            position: PositionNed::new(sequence as f64, 0.0, -30.0),
            velocity: VelocityNed::new(0.0, 0.0, 0.0),
            at: LocalTime::ZERO,
        };
        let news = [("2/1", 4, true), ("1/9", 1, true), ("2/1", 3, false), ("2/1", 4, false), ("2/1", 5, true)];
        for (name, sequence, is_new) in news {
            assert_eq!(store(&inbox.states, state(name, sequence)), is_new, "{name} {sequence}");
        }
        let mut received = Vec::new();
        inbox.drain(&mut received, &mut Vec::new());
        assert_eq!(received, [state("1/9", 1), state("2/1", 5)]);
        inbox.drain(&mut received, &mut Vec::new());
        assert_eq!(received.len(), 2, "each state is taken once");
    }
}
