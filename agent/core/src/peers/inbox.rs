//! The newest messages that all vehicles of a simulated swarm have received, in one place.
//!
//! A message lies here once, however many vehicles receive it. What differs between receivers is in columns, one for each
//! sender: the message that is the newest at each receiver, and its arrival. An arrival writes a column and marks the sender at the
//! receiver; most receivers need nothing more, because most messages change only what their senders' columns hold. The others
//! get an item of news: an echo for them, a changed agreement state, an order, a token, a new incarnation.
//!
//! Agents read the inbox, each its own place of every column, and the network fills it between two frames
//! ([`crate::impairments::SwarmNetwork`]).

use alloc::vec;
use alloc::vec::Vec;

use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{Header, Heartbeat, Order};
use skein_common::time::{LocalTime, SenderStamp};

use super::arrival::Arrival;
use super::column::{Column, Parcel, ParcelKind, Slot, SlotIndex};
use super::index;
use super::message::ReceivedState;
use super::news::{AllNews, Arriving, Item, News, NewsItem};
use super::peer::{Agreed, AgreementChange, KeptHeartbeat, Motion, Newest, StateArrival};
use crate::delay::{Excess, since_stamp_s};
use crate::skew::StepClock;

/// The newest messages of all senders at all receivers.
#[derive(Clone, Debug, Default)]
pub struct SwarmInbox {
    plan: u64,
    everyone: VehicleSet,
    senders: Vec<FromSender>,
    /// All that receivers have received in this frame.
    news: AllNews,
    /// The operators' orders that have arrived in this frame.
    orders: Vec<Order>,
    /// A length that no vehicle's position has exceeded on its way through the states it had sent before this frame, horizontally,
    /// m: the sum over the frames of the longest way in each.
    travelled_m: f64,
    /// The longest way to a state that was sent in this frame, m.
    longest_way_m: f64,
    /// Largest horizontal speed of a state so far, m/s.
    fastest_m_s: f64,
    /// Largest excess of a state's delay so far, by a correct clock.
    largest_excess: Option<Excess>,
    /// The receivers' clocks; empty if all are correct.
    clocks: Vec<ReceiverClock>,
    /// The correct time at which the clocks were set last.
    clocks_set_at: LocalTime,
}

/// The clock of a receiver.
#[derive(Clone, Copy, Debug)]
struct ReceiverClock {
    now: StepClock,
    /// The most by which an arrival has been ahead of a correct clock so far, s.
    ahead_s: f64,
}

/// The messages of one sender.
#[derive(Clone, Debug)]
struct FromSender {
    states: Column<SentMotion>,
    heartbeats: Column<SentHeartbeat>,
    /// The incarnation of its newest message, and whether there was an earlier one.
    incarnation: Option<Incarnation>,
    has_restarted: bool,
    /// Its position in its newest state, and when that was sent.
    place: Option<(PositionNed, LocalTime)>,
    /// The time at which each receiver last saw a gap in the numbers of the heartbeats; zero if never.
    gaps_at: Vec<LocalTime>,
    /// The time at which each receiver's newest state arrived, by a correct clock; empty if all clocks are correct.
    states_right_at: Vec<LocalTime>,
}

/// The part of a state that receivers use.
#[derive(Clone, Copy, Debug)]
struct SentMotion {
    position: PositionNed,
    velocity: VelocityNed,
    heading_rad: f64,
    stamp: SenderStamp,
}

#[derive(Clone, Copy, Debug)]
struct SentHeartbeat {
    message: Heartbeat,
    /// Whether every receiver has to look at it: it repeats an order, or its sender flies another plan.
    needs_all: bool,
}

impl FromSender {
    fn new(receivers: usize) -> Self {
        let (states, heartbeats) = (Column::new(receivers), Column::new(receivers));
        Self {
            states,
            heartbeats,
            incarnation: None,
            has_restarted: false,
            place: None,
            gaps_at: vec![LocalTime::ZERO; receivers],
            states_right_at: Vec::new(),
        }
    }

    /// Notes the incarnation of a message that the vehicle sends.
    fn note_incarnation(&mut self, header: &Header) {
        let before = self.incarnation.replace(header.incarnation);
        self.has_restarted |= before.is_some_and(|before| before != header.incarnation);
    }

    /// Whether a receiver may accept a message by its incarnation. The first one of a new incarnation makes the earlier ones
    /// void.
    fn accepts_incarnation(
        &mut self,
        sender: VehicleId,
        new: Incarnation,
        arrival: Arriving,
        news: &mut AllNews,
    ) -> bool {
        let Self { states, heartbeats, .. } = self;
        let receiver = arrival.receiver;
        let of_state = states.newest(receiver).map(|(slot, _)| slot.order.incarnation);
        let before = of_state.max(heartbeats.newest(receiver).map(|(slot, _)| slot.order.incarnation));
        if before.is_some_and(|before| before < new) {
            states.forget(receiver);
            heartbeats.forget(receiver);
            news.add(arrival, Item::Restarted(sender));
        }
        before.is_none_or(|before| before <= new)
    }

    fn deliver_state(&mut self, parcel: Parcel, arrivals: impl Iterator<Item = Arriving>, news: &mut AllNews) {
        let order = self.states.slot(parcel.slot).order;
        self.states.note_delivery(parcel.slot);
        // Most receivers have the same message before this one.
        let mut compared = (None, true);
        for arrival in arrivals {
            let Arriving { receiver, nth, turn, at } = arrival;
            let is_current =
                !self.has_restarted || self.accepts_incarnation(parcel.sender, order.incarnation, arrival, news);
            let before = self.states.newest_slot(receiver);
            if before != compared.0 {
                let is_newer = before.is_none_or(|last| self.states.slot(last).order < order);
                compared = (before, is_newer);
            }
            if !is_current || !compared.1 {
                news.add(arrival, Item::Old(parcel.sender));
                continue;
            }
            self.states.receive(receiver, parcel.slot, at);
            if let Some(right_at) = self.states_right_at.get_mut(nth) {
                *right_at = turn.0;
            }
            news.states[nth].insert(parcel.sender);
        }
    }

    /// Delivers a message by correct clocks to those of these receivers that need no more than their places in its column: most
    /// messages reach nearly all, and most receivers have the same message before. Returns the receivers that have not got it.
    fn fill(&mut self, parcel: Parcel, receivers: VehicleSet, arrival: &Arrival, news: &mut AllNews) -> VehicleSet {
        let Parcel { sender, kind, slot } = parcel;
        if self.has_restarted {
            return receivers;
        }
        match kind {
            ParcelKind::State => {
                if !self.states.note_delivery(slot) {
                    return receivers;
                }
                self.states.fill(receivers, arrival);
                AllNews::note_all(&mut news.states, sender, receivers);
                VehicleSet::default()
            }
            ParcelKind::Heartbeat => {
                let is_newest = self.heartbeats.note_delivery(slot);
                let SentHeartbeat { message, needs_all } = &self.heartbeats.slot(slot).message;
                let Some(before) = self.heartbeats.before().filter(|_| is_newest && !needs_all) else {
                    return receivers;
                };
                let after = self.after(Some(before), slot);
                if !matches!(after, After::Newer { has_gap: false, change: AgreementChange::Nothing, .. }) {
                    return receivers;
                }
                let mut alike = receivers.both(self.heartbeats.with_before());
                message.echo.iter().for_each(|echo| alike.remove(echo.of));
                self.heartbeats.fill(alike, arrival);
                AllNews::note_all(&mut news.heartbeats, sender, alike);
                receivers.without(alike)
            }
        }
    }

    fn deliver_heartbeat(&mut self, parcel: Parcel, arrivals: impl Iterator<Item = Arriving>, news: &mut AllNews) {
        self.heartbeats.note_delivery(parcel.slot);
        let SentHeartbeat { message, needs_all } = &self.heartbeats.slot(parcel.slot).message;
        let (incarnation, needs_all) = (message.header.incarnation, *needs_all);
        let echoed = message.echo.map(|echo| index(echo.of));
        let mut compared = (None, After::first());
        for arrival in arrivals {
            let Arriving { receiver, nth, at, .. } = arrival;
            if self.has_restarted && !self.accepts_incarnation(parcel.sender, incarnation, arrival, news) {
                news.add(arrival, Item::Old(parcel.sender));
                continue;
            }
            let before = self.heartbeats.newest_slot(receiver);
            if before != compared.0 {
                compared = (before, self.after(before, parcel.slot));
            }
            match compared.1 {
                After::Newer { has_gap, change, concerned } => {
                    if has_gap {
                        self.gaps_at[nth] = at;
                    }
                    self.heartbeats.receive(receiver, parcel.slot, at);
                    news.heartbeats[nth].insert(parcel.sender);
                    let is_concerned = match change {
                        AgreementChange::Nothing => false,
                        AgreementChange::Lost => concerned.contains(receiver),
                        AgreementChange::Steps => true,
                    };
                    if needs_all || echoed == Some(nth) || is_concerned {
                        news.add(arrival, Item::Heartbeat(parcel, change));
                    }
                }
                After::Same => {}
                After::Older => news.add(arrival, Item::Old(parcel.sender)),
            }
        }
    }

    /// Compares a heartbeat with the one in slot `before`, the newest of a receiver.
    fn after(&self, before: Option<SlotIndex>, slot: SlotIndex) -> After {
        let Some(before) = before else { return After::first() };
        let [last, new] = [self.heartbeats.slot(before), self.heartbeats.slot(slot)];
        if last.order >= new.order {
            // A heartbeat is repeated to every agent that asks for it.
            return if last.order == new.order { After::Same } else { After::Older };
        }
        let [last_agreed, new_agreed] = [last, new].map(|slot| agreed(&slot.message.message));
        let change = last_agreed.change_to(&new_agreed);
        let (before, now) = (last_agreed.lost, new_agreed.lost);
        let concerned = before.without(now).either(now.without(before));
        After::Newer { has_gap: last.order.sequence + 1 < new.order.sequence, change, concerned }
    }
}

fn state_slot(state: &ReceivedState, sent_at: LocalTime, travelled_m: f64) -> Slot<SentMotion> {
    let &ReceivedState { header, position, velocity, heading_rad, .. } = state;
    let message = SentMotion { position, velocity, heading_rad, stamp: header.stamp };
    Slot::new(message, header.order(), sent_at, travelled_m)
}

/// An arrival at a receiver at this correct time.
#[inline]
fn arriving(clocks: &[ReceiverClock], receiver: VehicleId, at: LocalTime, serial: u64) -> Arriving {
    let nth = index(receiver);
    let local_at = clocks.get(nth).map_or(at, |clock| clock.now.at_arrival(at));
    Arriving { receiver, nth, turn: (at, serial), at: local_at }
}

/// A heartbeat compared with the newest one of a receiver.
#[derive(Clone, Copy, Debug)]
enum After {
    /// It is newer. If only the vehicles that its sender has lost change, this concerns those that were added or left out.
    Newer {
        has_gap: bool,
        change: AgreementChange,
        concerned: VehicleSet,
    },
    Same,
    Older,
}

impl After {
    /// The first one of its sender.
    fn first() -> Self {
        Self::Newer { has_gap: false, change: AgreementChange::Steps, concerned: VehicleSet::default() }
    }
}

/// The agreement state of a sender, whose plan stays the same.
fn agreed(heartbeat: &Heartbeat) -> Agreed {
    Agreed::new(heartbeat, heartbeat.plan)
}

impl SwarmInbox {
    /// The inbox of a swarm of vehicles 1 to `roster` that fly the plan with this hash, before any message.
    pub fn new(roster: u8, plan: u64) -> Self {
        let count = usize::from(roster);
        let senders = (0..count).map(|_| FromSender::new(count)).collect();
        Self {
            plan,
            everyone: VehicleId::first(count).collect(),
            senders,
            news: AllNews::new(count),
            ..Self::default()
        }
    }

    /// Sets the clocks of the receivers, by id, of which any may be wrong. `now` is the correct time, by which everything is
    /// delivered until the next call.
    pub fn set_clocks(&mut self, now: LocalTime, clocks: impl Iterator<Item = StepClock>) {
        let count = self.senders.len();
        if self.clocks.is_empty() {
            self.clocks = vec![ReceiverClock { now: StepClock::default(), ahead_s: f64::NEG_INFINITY }; count];
            self.senders.iter_mut().for_each(|from| from.states_right_at = vec![LocalTime::ZERO; count]);
        }
        let earliest = core::mem::replace(&mut self.clocks_set_at, now);
        for (clock, now) in self.clocks.iter_mut().zip(clocks) {
            *clock = ReceiverClock { now, ahead_s: now.ahead_at_most_s(earliest).max(clock.ahead_s) };
        }
    }

    /// Begins a frame.
    pub fn begin_frame(&mut self) {
        self.travelled_m += core::mem::take(&mut self.longest_way_m);
        self.orders.clear();
        self.news.begin_frame();
    }

    /// Orders the news of the frame by receiver and arrival.
    pub fn sort_news(&mut self) {
        self.news.sort();
    }

    /// Puts a state into the inbox, before any receiver has it.
    pub fn put_state(&mut self, state: &ReceivedState, sent_at: LocalTime) -> Parcel {
        let sender = state.header.sender;
        let from = &mut self.senders[index(sender)];
        from.note_incarnation(&state.header);
        if let Some((before, before_at)) = from.place.replace((state.position, sent_at)) {
            let way_m = (state.position - before).xy().norm();
            if before_at == sent_at {
                self.travelled_m += way_m;
            } else {
                self.longest_way_m = self.longest_way_m.max(way_m);
            }
        }
        self.fastest_m_s = self.fastest_m_s.max(state.velocity.horizontal().norm());
        let slot = from.states.put(state_slot(state, sent_at, self.travelled_m));
        Parcel { sender, kind: ParcelKind::State, slot }
    }

    /// Puts a heartbeat into the inbox, before any receiver has it.
    pub fn put_heartbeat(&mut self, heartbeat: &Heartbeat, sent_at: LocalTime) -> Parcel {
        let sender = heartbeat.header.sender;
        let needs_all = heartbeat.order.is_some() || heartbeat.plan != self.plan;
        let from = &mut self.senders[index(sender)];
        from.note_incarnation(&heartbeat.header);
        let message = SentHeartbeat { message: *heartbeat, needs_all };
        let slot = from.heartbeats.put(Slot::new(message, heartbeat.header.order(), sent_at, self.travelled_m));
        Parcel { sender, kind: ParcelKind::Heartbeat, slot }
    }

    /// Counts deliveries of a message that are still to come, or fewer of them.
    pub fn expect(&mut self, parcel: Parcel, deliveries: i16) {
        let from = &mut self.senders[index(parcel.sender)];
        let in_flight = match parcel.kind {
            ParcelKind::State => &mut from.states.slot_mut(parcel.slot).in_flight,
            ParcelKind::Heartbeat => &mut from.heartbeats.slot_mut(parcel.slot).in_flight,
        };
        *in_flight = in_flight.wrapping_add_signed(deliveries);
    }

    /// Holds a message back from these receivers, in the place of an earlier one of its kind.
    pub fn hold(&mut self, parcel: Parcel, receivers: VehicleSet) {
        let from = &mut self.senders[index(parcel.sender)];
        match parcel.kind {
            ParcelKind::State => from.states.hold(parcel.slot, receivers),
            ParcelKind::Heartbeat => from.heartbeats.hold(parcel.slot, receivers),
        }
    }

    /// Takes out the state of a sender that is held back from a receiver.
    pub fn take_held_state(&mut self, sender: VehicleId, receiver: VehicleId) -> Option<Parcel> {
        let slot = self.senders[index(sender)].states.take_held(receiver)?;
        Some(Parcel { sender, kind: ParcelKind::State, slot })
    }

    /// Takes out the heartbeat of a sender that is held back from a receiver.
    pub fn take_held_heartbeat(&mut self, sender: VehicleId, receiver: VehicleId) -> Option<Parcel> {
        let slot = self.senders[index(sender)].heartbeats.take_held(receiver)?;
        Some(Parcel { sender, kind: ParcelKind::Heartbeat, slot })
    }

    /// Delivers a message to receivers, to each at its time. `serial` is the number of the delivery.
    #[inline]
    pub fn deliver(&mut self, parcel: Parcel, arrivals: impl Iterator<Item = (VehicleId, LocalTime)>, serial: u64) {
        let Self { senders, news, clocks, .. } = self;
        let from = &mut senders[index(parcel.sender)];
        let arrivals = arrivals.map(|(id, at)| arriving(clocks, id, at, serial));
        match parcel.kind {
            ParcelKind::State => from.deliver_state(parcel, arrivals, news),
            ParcelKind::Heartbeat => from.deliver_heartbeat(parcel, arrivals, news),
        }
    }

    /// Delivers a message to receivers whose links differ in their random delays alone, as [`Self::deliver`] does.
    pub fn deliver_together(&mut self, parcel: Parcel, receivers: VehicleSet, arrival: &Arrival, serial: u64) {
        let mut rest = receivers;
        if self.clocks.is_empty() {
            let from = &mut self.senders[index(parcel.sender)];
            match parcel.kind {
                ParcelKind::State => from.states.note_arrival(parcel.slot, arrival),
                ParcelKind::Heartbeat => from.heartbeats.note_arrival(parcel.slot, arrival),
            }
            // With jitter a message reaches only a part of its receivers in each frame.
            if 4 * receivers.len() > self.everyone.len() {
                rest = from.fill(parcel, receivers, arrival, &mut self.news);
            }
        }
        self.deliver(parcel, rest.iter().map(|id| (id, arrival.at(index(id)))), serial);
    }

    /// The place of a message in a table of so many places for each vehicle: at one receiver, the order of arrival matters
    /// between messages of one place alone.
    pub fn place(&self, parcel: Parcel) -> usize {
        // The first message of a new incarnation makes those of the earlier one void, whatever their kind.
        let by_kind = !self.senders[index(parcel.sender)].has_restarted;
        Self::PLACES * index(parcel.sender) + if by_kind { parcel.kind as usize } else { 0 }
    }

    /// Number of places for each vehicle in a table by [`Self::place`].
    pub const PLACES: usize = 2;

    /// Reports to a receiver whether the token of a vehicle is there.
    pub fn deliver_token(&mut self, (of, is_there): (VehicleId, bool), to: VehicleId, serial: u64, at: LocalTime) {
        self.news.add(arriving(&self.clocks, to, at, serial), Item::Token(of, is_there));
    }

    /// Delivers an operator's order.
    pub fn deliver_order(&mut self, order: Order, to: VehicleId, serial: u64, at: LocalTime) {
        // The same order to all receivers lies here once.
        if self.orders.last() != Some(&order) {
            self.orders.push(order);
        }
        let nth = (self.orders.len() - 1) as u16;
        self.news.add(arriving(&self.clocks, to, at, serial), Item::Order(nth));
    }

    /// Forgets all that a receiver has received: its agent has ended.
    pub fn forget(&mut self, receiver: VehicleId) {
        let nth = index(receiver);
        for from in &mut self.senders {
            from.states.forget(receiver);
            from.heartbeats.forget(receiver);
            from.states.take_held(receiver);
            from.heartbeats.take_held(receiver);
            from.gaps_at[nth] = LocalTime::ZERO;
        }
        self.news.forget(nth);
    }

    /// Notes that a state arrives at its last receiver at this time.
    pub fn note_delay(&mut self, parcel: Parcel, last_at: LocalTime) {
        if parcel.kind == ParcelKind::State {
            let stamp = self.senders[index(parcel.sender)].states.slot(parcel.slot).message.stamp;
            let excess = Excess::new(last_at, since_stamp_s(last_at, stamp));
            self.largest_excess = Some(self.largest_excess.map_or(excess, |largest| largest.max(excess)));
        }
    }

    /// The heartbeat of an item of news.
    pub(super) fn heartbeat_of(&self, parcel: Parcel) -> &Heartbeat {
        &self.senders[index(parcel.sender)].heartbeats.slot(parcel.slot).message.message
    }

    /// The order of an item of news.
    pub(super) fn order(&self, nth: u16) -> Option<&Order> {
        self.orders.get(usize::from(nth))
    }

    /// The time of an item's arrival by the receiver's clock.
    pub(super) fn arrival(&self, news: &NewsItem) -> LocalTime {
        let (at, _) = news.turn;
        self.clocks.get(usize::from(news.receiver)).map_or(at, |clock| clock.now.at_arrival(at))
    }

    /// Bounds for all states sent so far: the length that no vehicle's position has exceeded on its way, m, the largest horizontal
    /// speed, m/s, and a bound of the excess of their delays at this receiver.
    pub(super) fn travel(&self, receiver: usize) -> (f64, f64, Option<Excess>) {
        /// More than the rounding errors of times, s.
        const ROUNDING_S: f64 = 1e-6;
        let ahead_s = self.clocks.get(receiver).map_or(0.0, |clock| clock.ahead_s + ROUNDING_S);
        let largest_excess = self.largest_excess.map(|excess| excess.by_clock_ahead(ahead_s));
        (self.travelled_m + self.longest_way_m, self.fastest_m_s, largest_excess)
    }

    /// The length in [`Self::travel`] that counts for the newest state of a sender at a receiver, m.
    pub(super) fn travelled_m(&self, sender: usize, receiver: VehicleId) -> f64 {
        self.senders.get(sender).and_then(|from| from.states.newest(receiver)).map_or(0.0, |(slot, _)| slot.travelled_m)
    }

    /// All that this vehicle has received in this frame.
    pub(super) fn news(&self, receiver: usize) -> News<'_> {
        self.news.of(receiver)
    }

    /// The newest state of a sender at a receiver.
    #[inline]
    pub(super) fn motion(&self, sender: usize, receiver: VehicleId) -> Option<Motion> {
        let (slot, at) = self.senders.get(sender)?.states.newest(receiver)?;
        let SentMotion { position, velocity, heading_rad, stamp } = slot.message;
        let excess = Excess::new(at, since_stamp_s(at, stamp));
        Some(Motion { position, velocity, heading_rad, at, excess })
    }

    /// The position and the velocity in the newest state of a sender at a receiver.
    #[inline]
    pub(super) fn reported(&self, sender: usize, receiver: VehicleId) -> Option<(PositionNed, VelocityNed)> {
        let states = &self.senders.get(sender)?.states;
        let SentMotion { position, velocity, .. } = states.slot(states.newest_slot(receiver)?).message;
        Some((position, velocity))
    }

    /// Time from the sending of a sender's newest state to its arrival at a receiver, s.
    pub(super) fn latency_s(&self, sender: usize, receiver: VehicleId) -> Option<f64> {
        let from = self.senders.get(sender)?;
        let (slot, at) = from.states.newest(receiver)?;
        let right_at = from.states_right_at.get(index(receiver)).copied().unwrap_or(at);
        Some(right_at.seconds_since(slot.sent_at))
    }

    /// The newest messages of a sender at a receiver.
    pub(super) fn newest(&self, sender: usize, receiver: VehicleId) -> Newest {
        let Some(from) = self.senders.get(sender) else { return Newest::default() };
        let state = from.states.newest(receiver).map(|(slot, at)| StateArrival { sequence: slot.order.sequence, at });
        let heartbeat = self.heartbeat(sender, receiver);
        let received_at = state.map(|state| state.at).max(heartbeat.map(|heartbeat| heartbeat.at));
        Newest {
            incarnation: from.incarnation.unwrap_or_default(),
            state,
            heartbeat,
            received_at,
            gap_at: Some(from.gaps_at[index(receiver)]).filter(|at| *at > LocalTime::ZERO),
        }
    }

    /// The newest heartbeat of a sender at a receiver.
    pub(super) fn heartbeat(&self, sender: usize, receiver: VehicleId) -> Option<KeptHeartbeat> {
        let (slot, at) = self.senders.get(sender)?.heartbeats.newest(receiver)?;
        let message = &slot.message.message;
        let agreement = Agreed::new(message, self.plan);
        let (sequence, stamp, progress_m) = (slot.order.sequence, message.header.stamp, message.progress_m);
        Some(KeptHeartbeat { sequence, stamp, at, progress_m, agreement })
    }
}
