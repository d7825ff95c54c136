//! The scenario's network between all vehicles of a simulated swarm at once.
//!
//! It delivers what the [`Impairments`] of all receivers would, to the bit. But a message in flight lies here
//! once, with the set of its receivers, and its fate is drawn for all of them together. What arrives goes to the inbox of the
//! swarm ([`SwarmInbox`]).

mod flight;
mod graph;
mod places;
mod receiver;
mod sender;

use alloc::collections::VecDeque;
use alloc::sync::Arc;
use alloc::vec::Vec;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::{ControlMode, EventAction, Fault, Graph, Quality, Scenario};
use skein_common::time::LocalTime;

use super::channel::{Channel, Direction, delivery, size_bytes};
use super::channels::{Range, quality_of};
use super::draw::{Draw, Draws, MessageKey};
use super::link::SessionChange;
use super::numbers::{self, Numbers};
use super::{Delivery, Impairments, ReceiverPosition};
use crate::peers::{Arrival, Parcel, PeerMessage, Spread, SwarmInbox};
use crate::skew::{Skew, StepClock};
use flight::{Arrivals, Batch, Content, OnItsWay, received_twice};
use graph::SwarmGraph;
use places::Places;
use receiver::{EventEffect, SwarmReceiver};
use sender::SwarmSender;

/// The network between all vehicles of a swarm.
#[derive(Debug)]
pub struct SwarmNetwork {
    inbox: Arc<SwarmInbox>,
    draws: Draws,
    /// The settings of all links that `network.links` does not change.
    everywhere: Quality,
    range: Option<Range>,
    graph: SwarmGraph,
    /// All vehicles as senders and as receivers, by id.
    senders: Vec<SwarmSender>,
    receivers: Vec<SwarmReceiver>,
    places: Places,
    /// The receivers with an agent.
    present: VehicleSet,
    frame_ns: u64,
    /// Deliveries by the frame in which they are due, the next one first, and the number of that frame.
    in_flight: VecDeque<Vec<OnItsWay>>,
    next_frame: u64,
    /// Number of deliveries so far.
    serial: u64,
    /// Whether a message can arrive before an earlier one of its sender, or twice.
    may_overtake: bool,
    /// Whether it depends on the senders' places what arrives.
    uses_places: bool,
    /// Whether messages wait for the bandwidth of any link.
    has_queues: bool,
    has_wrong_clocks: bool,
    batch: Batch,
    numbers: Numbers,
}

/// A message that a vehicle sends now.
#[derive(Clone, Copy, Debug)]
struct Sent<'a> {
    now: LocalTime,
    from: VehicleId,
    message: &'a PeerMessage,
    parcel: Parcel,
}

/// The receivers of a message by distance.
struct Reach {
    /// Those out of range.
    out: VehicleSet,
    /// Those between `fade_m` and `range_m`, each with the share of messages that it loses.
    fading: Vec<(VehicleId, f64)>,
}

impl Reach {
    /// Share of messages to this receiver that are lost by distance.
    fn lost_share(&self, receiver: VehicleId) -> f64 {
        if self.out.contains(receiver) {
            return 1.0;
        }
        let listed = self.fading.binary_search_by_key(&receiver, |(id, _)| *id).ok();
        listed.and_then(|nth| self.fading.get(nth)).map_or(0.0, |(_, share)| *share)
    }
}

impl SwarmNetwork {
    /// The network of a scenario that flies in frames of this length, ns. `None` if every message arrives at once by correct
    /// clocks, and under a central controller, whose agents exchange their messages within one computer.
    pub fn new(scenario: &Scenario, frame_ns: u64) -> Option<Self> {
        let first = scenario.ids().next()?;
        let has_event = |is_it: fn(&Fault) -> bool| {
            scenario.mission.events.iter().any(|event| matches!(&event.what, EventAction::Fault(fault) if is_it(fault)))
        };
        let has_events = has_event(|fault| matches!(fault, Fault::Cut { .. } | Fault::Delay { .. }));
        let has_jumps = has_event(|fault| matches!(fault, Fault::ClockJump { .. }));
        let has_wrong_clocks = has_jumps || scenario.ids().any(|id| !Skew::new(scenario, id).is_zero());
        let is_perfect = !has_events && !has_wrong_clocks && Impairments::new(scenario, first).is_perfect();
        if is_perfect || scenario.control.mode == ControlMode::Central {
            return None;
        }
        let everywhere = scenario.network.quality();
        let count = usize::from(scenario.roster());
        let sender = |from: VehicleId| {
            let others = scenario.ids().filter(|&id| id != from);
            let with_quality = others.map(|id| (id, scenario.network.link(from, id)));
            let particular: Vec<_> = with_quality.filter(|(_, quality)| *quality != everywhere).collect();
            SwarmSender::new(particular)
        };
        let mut senders: Vec<SwarmSender> = scenario.ids().map(sender).collect();
        let receivers: Vec<_> = scenario.ids().map(|id| SwarmReceiver::new(scenario, id, has_events)).collect();
        for (id, receiver) in scenario.ids().zip(&receivers) {
            receiver.senders_with_events().for_each(|sender| senders[nth(sender)].with_events.insert(id));
        }
        let qualities = || senders.iter().flat_map(|sender| sender.particular.iter().map(|(_, quality)| quality));
        let any = |has: fn(&Quality) -> bool| has(&everywhere) || qualities().any(has);
        let has_queues = any(|quality| quality.bandwidth_bit_s.is_some());
        let remembers = has_queues || any(|quality| quality.burst_s.is_some());
        let needed = numbers::needed(any);
        let is_spread = any(|quality| quality.jitter_s > 0.0 || quality.reorder > 0.0 || quality.duplicate > 0.0);
        if remembers {
            senders.iter_mut().for_each(|sender| sender.remember_links(count));
        }
        let inbox = Arc::new(SwarmInbox::new(count as u8, scenario.plan_hash()));
        let draws = Draws::new(scenario.seed);
        let numbers = Numbers::new(draws.clone(), needed, count);
        Some(Self {
            inbox,
            draws,
            everywhere,
            range: Range::of(&scenario.network),
            graph: SwarmGraph::new(scenario),
            senders,
            receivers,
            places: Places::default(),
            present: VehicleSet::default(),
            frame_ns,
            in_flight: VecDeque::new(),
            next_frame: 0,
            serial: 0,
            may_overtake: is_spread || has_events,
            uses_places: scenario.network.range_m.is_some() || scenario.network.graph == Graph::Nearest,
            has_queues,
            has_wrong_clocks,
            batch: Batch::new(frame_ns),
            numbers,
        })
    }

    /// The inbox with what has arrived by now.
    pub fn inbox(&self) -> &Arc<SwarmInbox> {
        &self.inbox
    }

    /// Begins the agent of a vehicle: nothing is on its way to it.
    pub fn begin(&mut self, vehicle: VehicleId) {
        self.end(vehicle);
        self.present.insert(vehicle);
    }

    /// Ends the agent of a vehicle: what is on its way to it is lost.
    pub fn end(&mut self, vehicle: VehicleId) {
        self.present.remove(vehicle);
        self.in_flight.iter_mut().flatten().for_each(|message| message.remove(vehicle));
        self.receivers[nth(vehicle)].begin_again();
        for sender in &mut self.senders {
            sender.note_effect(vehicle, EventEffect::default());
            sender.forget_place([vehicle].into_iter().collect());
            sender.forget_link(vehicle);
        }
        self.graph.forget(vehicle);
        self.graph.placed_changed();
        Arc::make_mut(&mut self.inbox).forget(vehicle);
    }

    /// Sets the position and the time of flight of each vehicle by its own agent, by id.
    pub fn set_receivers(&mut self, receivers: impl Iterator<Item = ReceiverPosition> + Clone) {
        self.places.set(receivers.clone().map(|own| own.position));
        self.receivers.iter_mut().zip(receivers).for_each(|(receiver, own)| receiver.flown_s = own.flown_s);
    }

    /// Sets the vehicles' clocks, by id. `now` is the correct time.
    pub fn set_clocks(&mut self, now: LocalTime, clocks: impl Iterator<Item = StepClock>) {
        if self.has_wrong_clocks {
            Arc::make_mut(&mut self.inbox).set_clocks(now, clocks);
        }
    }

    /// Sends these messages, which an ideal network would deliver now, and delivers to the inbox what arrives by now.
    /// Messages to one vehicle go to it alone, before the others.
    pub fn deliver(&mut self, now: LocalTime, to_one: &[(VehicleId, PeerMessage)], to_all: &[PeerMessage]) {
        self.next_frame = now.nanoseconds() / self.frame_ns;
        Arc::make_mut(&mut self.inbox).begin_frame();
        self.graph.update(now, self.places.all(), &self.senders);
        for id in self.present.iter() {
            self.repeat_held(now, id);
        }
        for (receiver, message) in to_one {
            let only = [*receiver].into_iter().collect();
            self.send(now, message, self.present.both(only));
        }
        for message in to_all {
            self.send(now, message, self.present);
        }
        self.arrive();
    }

    /// Sends a message to these vehicles.
    fn send(&mut self, now: LocalTime, message: &PeerMessage, mut receivers: VehicleSet) {
        let Some(from) = message.sender() else { return self.send_order(now, message, receivers) };
        receivers.remove(from);
        if receivers.is_empty() {
            return;
        }
        let inbox = Arc::make_mut(&mut self.inbox);
        let sender = &mut self.senders[nth(from)];
        match message {
            PeerMessage::Appeared(_) | PeerMessage::Vanished(_) => {
                sender.forget_place(receivers);
                self.graph.placed_changed();
                let is_there = matches!(message, PeerMessage::Appeared(_));
                self.send_token(now, (from, is_there), receivers);
            }
            PeerMessage::State(state) => {
                if self.uses_places
                    && sender.report_place((state.position, now), receivers, sender.dead.both(receivers))
                {
                    self.graph.placed_changed();
                }
                receivers = self.graph.receivers(from, receivers);
                let parcel = inbox.put_state(state, now);
                self.send_parcel(&Sent { now, from, message, parcel }, receivers);
            }
            PeerMessage::Mission(heartbeat) => {
                let parcel = inbox.put_heartbeat(heartbeat, now);
                self.send_parcel(&Sent { now, from, message, parcel }, receivers);
            }
            PeerMessage::Order(_) => {}
        }
    }

    fn send_parcel(&mut self, sent: &Sent<'_>, receivers: VehicleSet) {
        let reach = self.reach(sent.from, receivers);
        self.numbers.draw(&MessageKey::of(sent.message, 0), !reach.fading.is_empty());
        // Messages out of range take up bandwidth, and have no other effect; nor have states to receivers whose session is closed.
        let without_effect = match sent.parcel.is_state() {
            _ if self.has_queues => VehicleSet::default(),
            true => reach.out.either(self.senders[nth(sent.from)].closed),
            false => reach.out,
        };
        let receivers = receivers.without(without_effect);
        let apart = if self.has_queues { receivers } else { receivers.both(self.with_particulars(sent.from)) };
        self.send_together(sent, receivers.without(apart), &reach);
        self.send_to_each(sent, apart, &reach);
    }

    /// The receivers to which links of a sender have settings of their own or are affected by events, or that receive the present
    /// message late or twice.
    fn with_particulars(&self, from: VehicleId) -> VehicleSet {
        let SwarmSender { with_particular, delayed, .. } = &self.senders[nth(from)];
        let Quality { reorder, duplicate, .. } = self.everywhere;
        let [late, twice] = [(Draw::Reorder, reorder), (Draw::Duplicate, duplicate)]
            .map(|(what, share)| if share > 0.0 { self.numbers.below(what, share) } else { VehicleSet::default() });
        with_particular.either(*delayed).either(late).either(twice)
    }

    /// Sends a message to receivers whose links differ in nothing but their random numbers: it is lost, or it arrives after the
    /// same delay and a random one.
    fn send_together(&mut self, sent: &Sent<'_>, receivers: VehicleSet, reach: &Reach) {
        if receivers.is_empty() {
            return;
        }
        let &Sent { now, from, parcel, .. } = sent;
        let mut through = receivers;
        for (id, share) in &reach.fading {
            if self.numbers.of(Draw::Distance, *id) < *share {
                through.remove(*id);
            }
        }
        if self.everywhere.burst_s.is_some() {
            let of_link = |receiver, turn| self.draws.of_link(from.get().into(), turn, receiver);
            through = through.without(self.senders[nth(from)].in_burst(&self.everywhere, now, of_link));
        } else if self.everywhere.loss > 0.0 {
            through = through.without(self.numbers.below(Draw::Loss, self.everywhere.loss));
        }
        let through = self.hold_back(sent, through);
        self.serial += 1;
        let (serial, what) = (self.serial, Content::Parcel(parcel));
        let Quality { delay_s, jitter_s, .. } = self.everywhere;
        if jitter_s > 0.0 {
            let numbers = self.numbers.column(Draw::Jitter).into();
            self.put_spread((serial, &what), through, Spread { sent_at: now, delay_s, jitter_s, numbers });
        } else {
            self.put_alike((serial, what), through, now.plus_seconds(delay_s));
        }
    }

    /// Holds a message back from those of these receivers whose links are cut. Returns the others.
    fn hold_back(&mut self, sent: &Sent<'_>, receivers: VehicleSet) -> VehicleSet {
        let SwarmSender { cut, closed, .. } = self.senders[nth(sent.from)];
        let stopped = receivers.both(cut);
        // TCP retransmits a state while the session lasts. The sender keeps its heartbeat for late joiners.
        let held = if sent.parcel.is_state() { stopped.without(closed) } else { stopped };
        if !held.is_empty() {
            Arc::make_mut(&mut self.inbox).hold(sent.parcel, held);
        }
        receivers.without(stopped)
    }

    /// Puts a message in flight to receivers that it reaches by these random delays. Those that it reaches in one frame are the
    /// ones with a number in a certain range.
    fn put_spread(&mut self, (serial, what): (u64, &Content), mut receivers: VehicleSet, spread: Spread) {
        let [first, last] = spread.limits().map(|at| at.nanoseconds().div_ceil(self.frame_ns));
        for frame in first..=last {
            let end = LocalTime::from_nanoseconds(frame * self.frame_ns);
            let due = if frame == last {
                receivers
            } else {
                receivers.both(self.numbers.below_number(Draw::Jitter, spread.numbers_until(end)))
            };
            receivers = receivers.without(due);
            let at = Arrivals::Together(Arrival::Spread(spread.clone()));
            self.put_in_flight(OnItsWay { serial, what: what.clone(), receivers: due, at }, end);
        }
    }

    /// Sends a message to receivers of which each has a fate of its own.
    fn send_to_each(&mut self, sent: &Sent<'_>, receivers: VehicleSet, reach: &Reach) {
        let &Sent { now, from, message, parcel } = sent;
        let what = Content::Parcel(parcel);
        let mut stopped = VehicleSet::default();
        let Self { senders, receivers: at_receivers, everywhere, draws, numbers, batch, serial, .. } = self;
        let SwarmSender { particular, with_particular, cut, delayed, channels, .. } = &mut senders[nth(from)];
        *serial += 2;
        let (serial, copy_serial) = (*serial - 1, *serial);
        let message_bytes = core::cell::OnceCell::new();
        let size = || *message_bytes.get_or_init(|| size_bytes(message));
        for id in receivers.iter() {
            let has_its_own = with_particular.contains(id);
            let quality = if has_its_own { quality_of(id, particular, everywhere) } else { &*everywhere };
            let mut idle = Channel::default();
            let channel = channels.get_mut(usize::from(id.get())).unwrap_or(&mut idle);
            let Some(sent_at) = channel.through_queue(quality, size, now) else { continue };
            let is_in_burst = channel.is_in_burst(quality, sent_at, |turn| draws.of_link(from.get().into(), turn, id));
            let chance = |what| numbers.of(what, id);
            let fate = delivery(quality, chance, sent_at, is_in_burst, reach.lost_share(id));
            let Delivery::Arrives { at, copy_at } = fate else { continue };
            if cut.contains(id) {
                stopped.insert(id);
                continue;
            }
            let added_s = if delayed.contains(id) { at_receivers[nth(id)].added_s(from) } else { 0.0 };
            batch.add((serial, &what), id, at.plus_seconds(added_s));
            if let Some(copy_at) = copy_at {
                batch.add((copy_serial, &what), id, copy_at.plus_seconds(added_s));
            }
        }
        self.put_batch();
        self.hold_back(sent, stopped);
    }

    /// Sends to a vehicle what its links have held back in a cut and deliver now.
    fn repeat_held(&mut self, now: LocalTime, to: VehicleId) {
        let receiver = &mut self.receivers[nth(to)];
        if !receiver.has_changes() {
            return;
        }
        let mut changes = Vec::new();
        receiver.pass_time(|from, change| changes.push((from, change)));
        for from in receiver.senders_with_delays().chain(changes.iter().map(|(from, _)| *from)) {
            self.senders[nth(from)].note_effect(to, receiver.effect(from));
        }
        for (from, change) in changes {
            let inbox = Arc::make_mut(&mut self.inbox);
            let held = match change {
                SessionChange::Keeps => continue,
                SessionChange::Closed { has_vanished } => {
                    inbox.take_held_state(from, to);
                    [has_vanished.then_some(Content::Token(from, false)), None, None]
                }
                SessionChange::CatchesUp { token } => {
                    let [state, heartbeat] = [inbox.take_held_state(from, to), inbox.take_held_heartbeat(from, to)];
                    [
                        token.map(|is_there| Content::Token(from, is_there)),
                        state.map(Content::Parcel),
                        heartbeat.map(Content::Parcel),
                    ]
                }
            };
            let delay_s = quality_of(to, &self.senders[nth(from)].particular, &self.everywhere).delay_s;
            let at = now.plus_seconds(delay_s + self.receivers[nth(to)].added_s(from));
            for what in held.into_iter().flatten() {
                self.serial += 1;
                self.put_alike((self.serial, what), [to].into_iter().collect(), at);
            }
        }
    }

    /// The receivers out of range of a sender, and those near that limit.
    fn reach(&self, from: VehicleId, receivers: VehicleSet) -> Reach {
        let mut reach = Reach { out: VehicleSet::default(), fading: Vec::new() };
        let sender = &self.senders[nth(from)];
        let (Some(range), Some((place, _))) = (self.range, sender.place) else { return reach };
        let receivers = receivers.both(sender.placed);
        let (older, placed) = (receivers.both(sender.with_older_place), receivers.without(sender.with_older_place));
        let (near, far) = self.places.near_and_far(place, range);
        reach.out = placed.both(far);
        for id in placed.without(near).without(far).either(older).iter() {
            let Some((own, (place, _))) = self.places.of(nth(id)).zip(sender.place_known_to(id)) else { continue };
            let share = range.loss_at((own - place).norm());
            if share >= 1.0 {
                reach.out.insert(id);
            } else if share > 0.0 {
                reach.fading.push((id, share));
            }
        }
        reach
    }

    fn send_token(&mut self, now: LocalTime, (of, is_there): (VehicleId, bool), receivers: VehicleSet) {
        self.serial += 1;
        let (sender, what) = (&mut self.senders[nth(of)], Content::Token(of, is_there));
        let special = receivers.both(sender.with_particular.either(sender.with_events));
        for id in special.iter() {
            let mut added_s = 0.0;
            if sender.with_events.contains(id) {
                let receiver = &mut self.receivers[nth(id)];
                if !is_there {
                    // Messages of a vehicle that has gone are dropped.
                    let inbox = Arc::make_mut(&mut self.inbox);
                    inbox.take_held_state(of, id);
                    inbox.take_held_heartbeat(of, id);
                }
                let is_received = receiver.note_token(of, is_there);
                sender.note_effect(id, receiver.effect(of));
                if !is_received {
                    continue;
                }
                added_s = receiver.added_s(of);
            }
            let delay_s = quality_of(id, &sender.particular, &self.everywhere).delay_s;
            self.batch.add((self.serial, &what), id, now.plus_seconds(delay_s).plus_seconds(added_s));
        }
        self.put_batch();
        let at = now.plus_seconds(self.everywhere.delay_s);
        self.put_alike((self.serial, what), receivers.without(special), at);
    }

    fn send_order(&mut self, now: LocalTime, message: &PeerMessage, receivers: VehicleSet) {
        let PeerMessage::Order(order) = message else { return };
        let what = Content::Order(Arc::new(*order));
        self.serial += 2;
        for id in receivers.iter() {
            let SwarmReceiver { operator, orders, .. } = &mut self.receivers[nth(id)];
            let key = MessageKey::of(message, *orders);
            *orders += 1;
            let direction = Direction { sender: 0, receiver: id, quality: &self.everywhere };
            let fate = operator.fate(&self.draws, &direction, (&key, || size_bytes(message)), now, 0.0);
            let Delivery::Arrives { at, copy_at } = fate else { continue };
            self.batch.add((self.serial - 1, &what), id, at);
            if let Some(copy_at) = copy_at {
                self.batch.add((self.serial, &what), id, copy_at);
            }
        }
        self.put_batch();
    }

    /// The frame in which a message that arrives at this time is due, counted from the next one.
    fn frame_of(&self, at: LocalTime) -> usize {
        (at.nanoseconds().div_ceil(self.frame_ns)).saturating_sub(self.next_frame) as usize
    }

    /// Puts a message in flight that reaches all of these receivers at this time.
    fn put_alike(&mut self, (serial, what): (u64, Content), receivers: VehicleSet, at: LocalTime) {
        self.put_in_flight(OnItsWay { serial, what, receivers, at: Arrivals::Together(Arrival::Alike(at)) }, at);
    }

    /// Puts a message in flight that is due at this time.
    fn put_in_flight(&mut self, message: OnItsWay, at: LocalTime) {
        if message.receivers.is_empty() {
            return;
        }
        if let Content::Parcel(parcel) = message.what {
            Arc::make_mut(&mut self.inbox).expect(parcel, 1);
        }
        let frame = self.frame_of(at);
        if self.in_flight.len() <= frame {
            self.in_flight.resize_with(frame + 1, Vec::new);
        }
        self.in_flight[frame].push(message);
    }

    /// Puts the deliveries of the batch in flight.
    fn put_batch(&mut self) {
        let mut due = core::mem::take(&mut self.batch.due);
        for (message, end_ns) in due.drain(..) {
            self.put_in_flight(message, LocalTime::from_nanoseconds(end_ns));
        }
        self.batch.due = due;
    }

    /// Delivers what is due in the next frame.
    fn arrive(&mut self) {
        let inbox = Arc::make_mut(&mut self.inbox);
        let Some(due) = self.in_flight.pop_front() else { return };
        let twice = if self.may_overtake { received_twice(&due, inbox, self.receivers.len()) } else { Vec::new() };
        let mut in_turn: Vec<(VehicleId, LocalTime, u64, Parcel)> = Vec::new();
        for message in &due {
            let OnItsWay { serial, ref what, mut receivers, .. } = *message;
            match *what {
                Content::Parcel(parcel) => {
                    inbox.expect(parcel, -1);
                    inbox.note_delay(parcel, message.last_at());
                    let all = receivers.iter();
                    if let Some(twice) = twice.get(inbox.place(parcel)) {
                        let twice = twice.both(receivers);
                        in_turn.extend(twice.iter().map(|id| (id, message.at(id), serial, parcel)));
                        receivers = receivers.without(twice);
                    }
                    match &message.at {
                        Arrivals::Together(arrival) => inbox.deliver_together(parcel, receivers, arrival, serial),
                        Arrivals::Each(each) if receivers == message.receivers => {
                            inbox.deliver(parcel, all.zip(each.iter().copied()), serial);
                        }
                        Arrivals::Each(each) => {
                            let arrivals = all.zip(each.iter().copied());
                            inbox.deliver(parcel, arrivals.filter(|(id, _)| receivers.contains(*id)), serial);
                        }
                    }
                }
                Content::Token(of, is_there) => {
                    receivers.iter().for_each(|id| inbox.deliver_token((of, is_there), id, serial, message.at(id)));
                }
                Content::Order(ref order) => {
                    receivers.iter().for_each(|id| inbox.deliver_order(**order, id, serial, message.at(id)));
                }
            }
        }
        self.batch.recycle(due);
        in_turn.sort_by_key(|(id, at, serial, _)| (*id, *at, *serial));
        for (id, at, serial, parcel) in in_turn {
            inbox.deliver(parcel, core::iter::once((id, at)), serial);
        }
        inbox.sort_news();
        self.next_frame += 1;
    }
}

/// Index of the vehicle in tables in the order of ids.
fn nth(id: VehicleId) -> usize {
    usize::from(id.get()) - 1
}
