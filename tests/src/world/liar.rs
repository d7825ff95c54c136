//! The liar: a node with a valid certificate and key of its own vehicle, which sends anything else that it likes.

use std::collections::VecDeque;

use skein_agent::link::signature::SigningKey;
use skein_agent::link::signature::messages::{ADDED_BYTES, KeyRing};
use skein_agent::link::signature::orders::sign;
use skein_common::frame::{Geodetic, VelocityNed};
use skein_common::id::{Incarnation, SwarmName, VehicleId, VehicleSet};
use skein_common::message::{Header, Heartbeat, MAX_STEP, Order, Signature, State, Verb, decode, encode};
use skein_common::state::{Membership, VehicleState};
use skein_common::time::SenderStamp;
use skein_common::topic::{Branch, Cell, Topic};

use super::RUN;
use super::plan::Chance;

/// Number of received messages that the liar keeps to send them again.
const KEPT: usize = 200;

/// A message of the liar: its key and its bytes.
pub(super) type Lie = (String, Vec<u8>);

/// The liar's node.
pub(super) struct Liar {
    pub(super) id: VehicleId,
    ids: Vec<VehicleId>,
    swarm: SwarmName,
    plan: u64,
    key_ring: KeyRing,
    own_key: SigningKey,
    /// Messages of the other nodes.
    captured: VecDeque<Lie>,
    /// Orders of the operator that it has received.
    orders: Vec<Order>,
    sequence: u64,
    incarnation: u64,
    chance: Chance,
    /// Whether it sends nothing for now.
    is_silent: bool,
    /// How many messages it has sent.
    pub(super) lies: u64,
}

impl Liar {
    pub(super) fn new(
        id: VehicleId,
        ids: Vec<VehicleId>,
        (swarm, plan): (SwarmName, u64),
        (key_ring, own_key): (KeyRing, SigningKey),
        captured: VecDeque<Lie>,
        chance: Chance,
    ) -> Self {
        let (orders, sequence, incarnation, is_silent, lies) = Default::default();
        Self {
            id,
            ids,
            swarm,
            plan,
            key_ring,
            own_key,
            captured,
            orders,
            sequence,
            incarnation,
            chance,
            is_silent,
            lies,
        }
    }

    /// Keeps a received message.
    pub(super) fn receive(&mut self, key: &str, bytes: &[u8]) {
        if self.captured.len() == KEPT {
            let nth = self.chance.whole(0, KEPT as u32 - 1) as usize;
            self.captured.remove(nth);
        }
        self.captured.push_back((key.to_owned(), bytes.to_vec()));
        if let Ok(Heartbeat { order: Some(order), .. }) = decode(&bytes[..bytes.len().saturating_sub(ADDED_BYTES)])
            && !self.orders.contains(&order)
        {
            self.orders.push(order);
        }
    }

    /// What it sends now to one node or to all.
    pub(super) fn act(&mut self, t_s: f64) -> Vec<Lie> {
        if self.chance.is_so(0.02) {
            self.is_silent = !self.is_silent;
        }
        if self.is_silent && !self.chance.is_so(0.1) {
            return Vec::new();
        }
        let victim = self.chance.one_of(&self.ids);
        let lies = match self.chance.whole(0, 15) {
            0..=3 => self.own(t_s),
            4 => vec![self.forged_state(victim, t_s, true), self.forged_heartbeat(victim, t_s)],
            5 => vec![self.forged_state(victim, t_s, false)],
            6..=7 => self.replayed(),
            8 => self.of_another_run(t_s),
            9 => {
                let heartbeat = Heartbeat { plan: self.plan ^ 1, ..self.absurd_heartbeat(t_s) };
                vec![self.heartbeat(heartbeat, RUN)]
            }
            10 => self.absurd(t_s),
            11 => vec![self.own_order(t_s)],
            12 => (0..40).map(|_| self.unsigned_order()).collect(),
            13 => vec![self.sent_order(), self.changed(), self.changed()],
            14 => vec![self.garbage(victim), self.garbage(victim)],
            _ => (0..10).flat_map(|_| self.own(t_s)).collect(),
        };
        self.lies += lies.len() as u64;
        lies
    }

    /// Its reply to a query for its last heartbeat.
    pub(super) fn reply(&mut self, t_s: f64) -> Option<Lie> {
        let victim = self.chance.one_of(&self.ids);
        match self.chance.whole(0, 3) {
            0 => None,
            1 => Some(self.forged_heartbeat(victim, t_s)),
            2 => self.replayed().pop(),
            _ => self.own(t_s).pop(),
        }
    }

    fn header(&mut self, t_s: f64) -> Header {
        self.sequence += 1;
        let (incarnation, stamp) = (Incarnation(self.incarnation), SenderStamp::from_seconds(t_s));
        Header { sender: self.id, incarnation, sequence: self.sequence, stamp }
    }

    fn signed(&self, key: String, message: &impl skein_common::message::Message, run: u64) -> Lie {
        let bytes = self.key_ring.write(Some(&self.own_key), run, &key, message);
        (key, bytes)
    }

    fn state_of(&mut self, header: Header) -> State {
        let position = Geodetic::from_degrees(
            28.0 + self.chance.between(-0.001, 0.001),
            -82.0 + self.chance.between(-0.001, 0.001),
            self.chance.between(0.0, 60.0),
        );
        let mut speed = || self.chance.between(-8.0, 8.0);
        let velocity = VelocityNed::new(speed(), speed(), speed());
        State { header, state: VehicleState { position, velocity, heading_rad: self.chance.between(0.0, 6.0) } }
    }

    fn heartbeat_of(&mut self, header: Header) -> Heartbeat {
        let step = self.chance.whole(0, 14).min(MAX_STEP);
        Heartbeat {
            header,
            plan: self.plan,
            membership: self.chance.one_of(&[Membership::Joining, Membership::Active, Membership::Left]),
            step,
            vouched: self.chance.whole(0, step),
            reached: self.chance.one_of(&[None, Some(step), Some(MAX_STEP)]),
            progress_m: self.chance.between(-50.0, 500.0),
            order: None,
            orders: 0,
            echo: None,
            lost: self.ids.iter().copied().filter(|_| self.chance.is_so(0.2)).collect(),
        }
    }

    fn absurd_heartbeat(&mut self, t_s: f64) -> Heartbeat {
        let header = self.header(t_s);
        Heartbeat {
            step: MAX_STEP,
            vouched: MAX_STEP,
            reached: Some(MAX_STEP),
            progress_m: 9.9e8,
            orders: u16::MAX,
            lost: VehicleId::first(255).collect(),
            membership: Membership::Active,
            ..self.heartbeat_of(header)
        }
    }

    fn heartbeat(&self, heartbeat: Heartbeat, run: u64) -> Lie {
        self.signed(Topic::Mission(heartbeat.header.sender).key(), &heartbeat, run)
    }

    fn state(&self, state: &State, run: u64) -> Lie {
        self.signed(Topic::State(state.header.sender, Cell::default()).key(), state, run)
    }

    /// Its own state and heartbeat, with any content.
    fn own(&mut self, t_s: f64) -> Vec<Lie> {
        let (one, other) = (self.header(t_s), self.header(t_s));
        let (state, heartbeat) = (self.state_of(one), self.heartbeat_of(other));
        vec![self.state(&state, RUN), self.heartbeat(heartbeat, RUN)]
    }

    /// A state of another vehicle with its own signature, or with none.
    fn forged_state(&mut self, victim: VehicleId, t_s: f64, is_signed: bool) -> Lie {
        let header = Header {
            sender: victim,
            incarnation: Incarnation(self.chance.one_of(&[0, u64::MAX])),
            sequence: 1 << 40,
            ..self.header(t_s)
        };
        let state = self.state_of(header);
        let (key, bytes) = self.state(&state, RUN);
        (key, if is_signed { bytes } else { encode(&state) })
    }

    fn forged_heartbeat(&mut self, victim: VehicleId, t_s: f64) -> Lie {
        let header = Header { sender: victim, incarnation: Incarnation(u64::MAX), ..self.header(t_s) };
        let heartbeat = self.heartbeat_of(header);
        self.heartbeat(heartbeat, RUN)
    }

    /// Messages of others, as they were.
    fn replayed(&mut self) -> Vec<Lie> {
        let count = self.chance.whole(1, 5);
        let mut nth = || self.chance.whole(0, self.captured.len().saturating_sub(1) as u32) as usize;
        (0..count).filter_map(|_| self.captured.get(nth()).cloned()).collect()
    }

    /// A message of another vehicle with one changed byte.
    fn changed(&mut self) -> Lie {
        let Some((key, mut bytes)) = self.replayed().pop() else { return self.garbage(self.id) };
        let nth = self.chance.whole(0, bytes.len().saturating_sub(1) as u32) as usize;
        if let Some(byte) = bytes.get_mut(nth) {
            *byte ^= 1 << self.chance.whole(0, 7);
        }
        (key, bytes)
    }

    /// Its own messages, signed for another run.
    fn of_another_run(&mut self, t_s: f64) -> Vec<Lie> {
        let (one, other) = (self.header(t_s), self.header(t_s));
        let (state, heartbeat) = (self.state_of(one), self.heartbeat_of(other));
        vec![self.state(&state, RUN - 1), self.heartbeat(heartbeat, RUN + 1)]
    }

    /// Its own messages with values that no vehicle has.
    fn absurd(&mut self, t_s: f64) -> Vec<Lie> {
        let header = self.header(t_s);
        let mut state = self.state_of(header);
        match self.chance.whole(0, 3) {
            0 => state.state.velocity = VelocityNed::new(f64::NAN, 0.0, 0.0),
            1 => state.state.velocity = VelocityNed::new(0.0, 299.0, 0.0),
            2 => state.state.position = Geodetic::from_degrees(-28.0, 98.0, 8000.0),
            _ => state.state.heading_rad = f64::INFINITY,
        }
        if self.chance.is_so(0.1) {
            // A later life: it can never be taken back.
            self.incarnation += 1;
            self.sequence = 0;
        }
        let heartbeat = self.absurd_heartbeat(t_s);
        vec![self.state(&state, RUN), self.heartbeat(heartbeat, RUN)]
    }

    /// An order that the operator did not give.
    fn false_order(&mut self) -> Order {
        let order = Order {
            epoch: self.chance.one_of(&[1, 50, u64::MAX]),
            issuer: u64::from(self.chance.whole(0, u32::MAX - 1)),
            verb: self.chance.one_of(&[Verb::Abort, Verb::Land, Verb::Hold, Verb::Goto(MAX_STEP)]),
            vehicles: None,
            signature: None,
        };
        match self.chance.whole(0, 3) {
            0 => order,
            1 => Order { signature: Some(Signature::from_bytes([7; Signature::BYTES])), ..order },
            2 => sign(&self.own_key, &self.swarm, Branch::SWARM, RUN, order),
            _ => match self.orders.last() {
                Some(known) => Order { epoch: known.epoch + 1, vehicles: Some(self.all()), ..*known },
                None => order,
            },
        }
    }

    fn all(&self) -> VehicleSet {
        self.ids.iter().copied().collect()
    }

    /// One of many orders without a signature.
    fn unsigned_order(&mut self) -> Lie {
        let order = Order { signature: None, ..self.false_order() };
        (Topic::Order(order.issuer).key(), encode(&order))
    }

    /// A false order in its own heartbeat.
    fn own_order(&mut self, t_s: f64) -> Lie {
        let header = self.header(t_s);
        let order = Some(self.false_order());
        let heartbeat = Heartbeat { order, orders: 1, ..self.heartbeat_of(header) };
        self.heartbeat(heartbeat, RUN)
    }

    /// A false order, as an operator sends one; or a true one that it repeats.
    fn sent_order(&mut self) -> Lie {
        let order = match self.orders.first() {
            Some(known) if self.chance.is_so(0.1) => *known,
            _ => self.false_order(),
        };
        (Topic::Order(order.issuer).key(), encode(&order))
    }

    /// Bytes that are no message, under any key.
    fn garbage(&mut self, victim: VehicleId) -> Lie {
        let count = self.chance.whole(0, 300);
        let bytes = (0..count).map(|_| self.chance.whole(0, 255) as u8).collect();
        let keys = [
            Topic::State(victim, Cell::default()).key(),
            Topic::Mission(victim).key(),
            Topic::Order(7).key(),
            Topic::Mission(self.id).key(),
            "vehicle/200/mission".to_owned(),
            "vehicle/0/cell/0/0/state".to_owned(),
        ];
        let nth = self.chance.whole(0, keys.len() as u32 - 1) as usize;
        (keys[nth].clone(), bytes)
    }
}

/// A heartbeat of an honest vehicle from an earlier run, which the liar has kept.
pub(super) fn of_earlier_run(id: VehicleId, plan: u64, key_ring: &KeyRing, key: &SigningKey) -> Lie {
    let heartbeat = Heartbeat {
        header: Header {
            sender: id,
            incarnation: Incarnation(u64::MAX - 1),
            sequence: 9,
            stamp: SenderStamp::from_seconds(1.0),
        },
        plan,
        membership: Membership::Active,
        step: MAX_STEP,
        vouched: MAX_STEP,
        reached: Some(MAX_STEP),
        progress_m: 0.0,
        order: None,
        orders: 0,
        echo: None,
        lost: VehicleSet::default(),
    };
    let topic = Topic::Mission(id).key();
    let bytes = key_ring.write(Some(key), RUN - 1, &topic, &heartbeat);
    (topic, bytes)
}
