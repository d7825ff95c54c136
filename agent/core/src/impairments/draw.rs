//! The random numbers of the network: each is a function of the seed, of the message and its receiver, and of what it
//! decides.
//!
//! No number depends on another message or on another vehicle. So an impairment does not change the effect of another one,
//! one more vehicle changes nothing for the others, and the numbers of one message for all receivers can be computed
//! together. They lie side by side in a stream of ChaCha8 that belongs to the sender and to what they decide: one block
//! serves sixteen receivers.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use skein_common::id::{FleetVehicle, VehicleId};
use skein_common::message::MessageOrder;

use crate::peers::PeerMessage;
use crate::random::{self, share};

/// The decision of a random number. The discriminants are part of the meaning of a seed: never reuse one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Draw {
    /// Whether the message is lost.
    Loss = 0,
    /// Whether it is lost by distance.
    Distance = 1,
    /// Its random delay.
    Jitter = 2,
    /// Whether it is held back.
    Reorder = 3,
    /// Whether it arrives twice.
    Duplicate = 4,
    /// The random delay of its copy.
    Copy = 5,
    /// Whether the link begins in a burst, and how long it is in a burst and without one.
    Burst = 6,
}

impl Draw {
    /// Number of the draws of a message.
    pub(super) const COUNT: usize = 6;
}

/// The kind of a message. The discriminants are part of the meaning of a seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum MessageKind {
    State = 0,
    Heartbeat = 1,
    Order = 2,
    Intent = 3,
    /// All messages of a link.
    Link = 15,
}

/// The place of a message in the random numbers of its sender.
#[derive(Clone, Copy, Debug)]
pub(super) struct MessageKey {
    /// Team and id of the sender; the team is zero for a vehicle of the receiver's team, the id for an operator.
    sender: u32,
    kind: MessageKind,
    order: MessageOrder,
}

impl MessageKey {
    /// The key of a message of the own team or of an operator. `orders` is the number of the operators' messages before.
    pub(super) fn of(message: &PeerMessage, orders: u64) -> Self {
        let sender = message.sender().map_or(0, VehicleId::get).into();
        let (kind, order) = match message {
            PeerMessage::State(state) => (MessageKind::State, state.header.order()),
            PeerMessage::Mission(heartbeat) => (MessageKind::Heartbeat, heartbeat.header.order()),
            PeerMessage::Order(_) => (MessageKind::Order, MessageOrder { sequence: orders, ..MessageOrder::default() }),
            // Tokens draw no numbers.
            PeerMessage::Appeared(_) | PeerMessage::Vanished(_) => (MessageKind::Link, MessageOrder::default()),
        };
        Self { sender, kind, order }
    }

    /// The key of a state that a vehicle of another team has sent.
    pub(super) fn of_state(sender: FleetVehicle, order: MessageOrder) -> Self {
        Self { sender: number(sender), kind: MessageKind::State, order }
    }

    /// The key of an intent that a vehicle of another team has sent.
    pub(super) fn of_intent(sender: FleetVehicle, order: MessageOrder) -> Self {
        Self { sender: number(sender), kind: MessageKind::Intent, order }
    }

    /// The key of the `nth` number of the link from this sender.
    fn of_link(sender: u32, nth: u64) -> Self {
        Self { sender, kind: MessageKind::Link, order: MessageOrder { sequence: nth, ..MessageOrder::default() } }
    }
}

/// The number of a vehicle of another team.
fn number(vehicle: FleetVehicle) -> u32 {
    u32::from(vehicle.team.get()) << 8 | u32::from(vehicle.vehicle.get())
}

/// The number of the sender at the other end of the link that carries the messages of all other teams.
pub(super) const STRANGERS: u32 = (1 << 21) - 1;

/// The random numbers of one seed.
#[derive(Clone, Debug)]
pub(super) struct Draws {
    /// A generator with the key of the seed, which gives no number itself.
    of_seed: ChaCha8Rng,
}

impl Draws {
    pub(super) fn new(seed: u64) -> Self {
        Self { of_seed: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// The number that decides this of a message at this receiver, evenly distributed in [0, 1).
    pub(super) fn of(&self, what: Draw, key: &MessageKey, receiver: VehicleId) -> f64 {
        share(self.generator(what, key, receiver.get()).next_u32())
    }

    /// The `nth` number of the bursts of a link.
    pub(super) fn of_link(&self, sender: u32, nth: u64, receiver: VehicleId) -> f64 {
        self.of(Draw::Burst, &MessageKey::of_link(sender, nth), receiver)
    }

    /// Fills `out` with the numbers of all receivers as [`Self::of`] gives them, each at the place of its id.
    pub(super) fn fill(&self, what: Draw, key: &MessageKey, out: &mut [u32]) {
        let mut generator = self.generator(what, key, 0);
        out.iter_mut().for_each(|number| *number = generator.next_u32());
    }

    fn generator(&self, what: Draw, key: &MessageKey, receiver: u8) -> ChaCha8Rng {
        let MessageKey { sender, kind, order } = *key;
        let draw = (kind as u8) << 4 | what as u8;
        let mut generator = random::network_generator(&self.of_seed, sender, draw, order.incarnation);
        // The numbers of a message for all receivers, 1 to 250, lie side by side.
        generator.set_word_pos(u128::from(order.sequence) << 8 | u128::from(receiver));
        generator
    }
}
