//! States and intents of the vehicles of other teams, received by cells: the newest of each vehicle, for the control
//! thread.

use std::collections::BTreeMap;
use std::mem::take;
use std::sync::Arc;

use parking_lot::Mutex;
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
#[derive(Debug, Default)]
pub(super) struct StrangerInbox {
    states: Newest<StrangerState>,
    intents: Newest<ReceivedIntent>,
}

/// The newest message of each stranger.
type Newest<M> = Mutex<BTreeMap<FleetVehicle, (MessageOrder, M)>>;

impl StrangerInbox {
    /// Moves all states and intents to the ends of these lists.
    pub(super) fn drain(&self, states: &mut Vec<StrangerState>, intents: &mut Vec<ReceivedIntent>) {
        let (new_states, new_intents) = (take(&mut *self.states.lock()), take(&mut *self.intents.lock()));
        states.extend(new_states.into_values().map(|(_, state)| state));
        intents.extend(new_intents.into_values().map(|(_, intent)| intent));
    }
}

/// Keeps a message if it is newer than the one of its sender that waits. False if it is not, or too many wait.
fn store<M>(messages: &Newest<M>, id: FleetVehicle, order: MessageOrder, new: M) -> bool {
    let mut messages = messages.lock();
    let is_newer = match messages.get(&id) {
        Some((kept, _)) => *kept < order,
        None => messages.len() < MAX_STRANGERS,
    };
    if is_newer {
        messages.insert(id, (order, new));
    }
    is_newer
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
                let (position, convergence) = self.trust.origin.locate(&state.position);
                let (order, velocity) = (header.order(), convergence.velocity_from_local(state.velocity));
                store(&strangers.states, id, order, StrangerState { id, order, position, velocity, at })
            }),
            // An agent publishes the same intent in several cells: it counts once.
            Topic::Intent(..) => self.receive_stranger(key, bytes, id, |message: Intent| {
                let order = message.header.order();
                let intent = ReceivedIntent::new(team, &message, &self.trust.origin, at);
                store(&strangers.intents, id, order, intent)
                    || strangers.intents.lock().get(&id).is_some_and(|(kept, _)| *kept == order)
            }),
            _ => {}
        }
    }

    /// Verifies a message of a stranger and stores it with `store`, which is false for an old message.
    fn receive_stranger<M: Message>(&self, key: &str, bytes: &[u8], id: FleetVehicle, store: impl Fn(M) -> bool) {
        let Some(verified) = self.verified::<M>(key, bytes, Some(id.into())) else { return };
        if let Some(reason) = self.refusal_of_stranger(id.team, verified.run) {
            return self.inbox.refusals.refuse(reason, key, &reason);
        }
        if !store(verified.message) {
            self.inbox.refusals.count(Reason::Old, key);
        }
    }
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
    use skein_common::frame::{PositionNed, VelocityNed};
    use skein_common::id::Incarnation;
    use skein_common::message::MessageOrder;
    use skein_common::time::LocalTime;

    use super::*;

    #[test]
    fn the_newest_state_of_each_stranger_waits_for_the_control_thread() {
        let inbox = StrangerInbox::default();
        let state = |name: &str, sequence| StrangerState {
            id: name.parse().unwrap(),
            order: MessageOrder { incarnation: Incarnation(1), sequence },
            position: PositionNed::new(sequence as f64, 0.0, -30.0),
            velocity: VelocityNed::new(0.0, 0.0, 0.0),
            at: LocalTime::ZERO,
        };
        let news = [("2/1", 4, true), ("1/9", 1, true), ("2/1", 3, false), ("2/1", 4, false), ("2/1", 5, true)];
        for (name, sequence, is_new) in news {
            let state = state(name, sequence);
            assert_eq!(store(&inbox.states, state.id, state.order, state), is_new, "{name} {sequence}");
        }
        let mut received = Vec::new();
        inbox.drain(&mut received, &mut Vec::new());
        assert_eq!(received, [state("1/9", 1), state("2/1", 5)]);
        inbox.drain(&mut received, &mut Vec::new());
        assert_eq!(received.len(), 2, "each state is taken once");
    }
}
