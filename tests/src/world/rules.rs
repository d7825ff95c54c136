//! The invariants of the world, checked while it runs. The first violation ends the flight.

use std::collections::BTreeMap;

use skein_agent::run::simulated::{LinkSizes, SimulatedAgent};
use skein_common::frame::Origin;
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{Heartbeat, MessageOrder, Order, Refused, StandingOrders, Verb};
use skein_common::scenario::TunableKey;
use skein_common::state::Membership;
use skein_core::agent::Outputs;
use skein_core::peers::{PeerMessage, ReceivedState};
use skein_core::plant::Command;

use super::plan::VEHICLES;

/// No honest vehicle's view of another honest vehicle holds what that vehicle did not send, and no order is in force that
/// the operator did not sign for this run.
pub(super) const FORGED: &str = "no forged change";
/// An order that an agent receives is in force there at once, stays in force, and reaches every linked agent.
pub(super) const LOST_ORDER: &str = "no lost order";
/// The number of entries in the memory of an agent never exceeds its bound.
pub(super) const MEMORY: &str = "bounded memory";
/// A link counts exactly while it exists.
pub(super) const PRESENCE: &str = "presence is that of the links";
/// Two healthy nodes with a usual network are in contact within [`REJOIN_S`], with fresh states, and remain so.
pub(super) const REJOIN: &str = "rejoin within the limit";
/// A peer that cannot be received is not in contact after [`NOTICED_S`], and a peer without a link after [`UNLINKED_S`].
pub(super) const NOTICED: &str = "a lost peer is noticed";
/// An agent that hangs is killed within [`HANG_S`], and one that has ended runs again within [`RESTART_S`].
pub(super) const RESTART: &str = "restart within the limit";
/// Controls are finite and within their travel.
pub(super) const CONTROLS: &str = "controls within limits";
/// As in the model check of the agreement.
pub(super) const P1: &str = "P1: neither step nor reached nor vouched decreases in one incarnation";
/// As in the model check of the agreement.
pub(super) const P2: &str = "P2: an agent that advances has received from every peer in view that it reached the step";
/// As in the model check of the agreement; a settled agent is one that no honest agent has doubted since.
pub(super) const P3: &str = "P3: no agent passes a step before all settled agents reached it";
/// As in the model check of the agreement.
pub(super) const P4: &str = "P4: no step begins before an agent reached the one before";
/// As in the model check of the agreement: any two sides that advance under the policy `quorum` have a vehicle in common.
pub(super) const P7: &str = "P7: the two sides of a cut never both advance without the other";
/// As in the model check of the agreement.
pub(super) const VOUCHED: &str = "no agent vouches for a step that no honest agent has earned";
/// As in the model check of the agreement: rule (b) and the end of P5.
pub(super) const AGREED: &str = "all honest agents agree in the end";

/// When faults and lies are over, every mission ends: each honest vehicle reaches the last step, or leaves; where only a
/// majority may advance, fewer than a majority may hold instead.
pub(super) const ENDS: &str = "every mission ends";

/// Limit for two healthy nodes to be in contact again, s.
pub(super) const REJOIN_S: f64 = 5.0;
/// Limit for a node to notice that it does not receive a peer, s.
pub(super) const NOTICED_S: f64 = 6.5;
/// Limit for an agent to run again: the longest pause and the time of two looks, s.
pub(super) const RESTART_S: f64 = 10.2;
/// Limit for a node to act on the end of its link with a peer, s.
pub(super) const UNLINKED_S: f64 = 0.2;
/// Limit for an agent that hangs to be killed: ten seconds after its last report, which come once a second, s.
pub(super) const HANG_S: f64 = 11.2;
/// Limit for an order to be in force at a linked agent, s.
pub(super) const SPREAD_S: f64 = 2.5;
/// Number of steps within which an order that was received is in force.
const STEPS_TO_OBEY: u32 = 2;
/// Largest number of checked orders that the link remembers.
const CHECKED_ORDERS: usize = 255 + TunableKey::ALL.len() + 6;

/// A broken invariant.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// When, s.
    pub t_s: f64,
    /// The invariant.
    pub invariant: &'static str,
    /// What was found.
    pub what: String,
}

/// What an honest vehicle has sent, by incarnation and number; states in the swarm's frame.
#[derive(Default)]
struct Sent {
    states: Vec<ReceivedState>,
    place_of: BTreeMap<(Incarnation, u64), usize>,
    heartbeats: BTreeMap<(Incarnation, u64), Heartbeat>,
}

/// What is known of one agent, from its start to its end.
#[derive(Default)]
struct Known {
    orders: StandingOrders,
    step: u32,
    reached: Option<u32>,
    vouched: u32,
    /// Whether it followed the liar while no honest agent was in contact.
    is_misled: bool,
    /// Whether an order to this vehicle alone has sent it to a later step than the others.
    was_sent_ahead: bool,
    /// The newest state that its view of a peer can hold.
    views: BTreeMap<VehicleId, usize>,
    /// Number of the newest state of each peer, and its newest heartbeat.
    newest: BTreeMap<VehicleId, MessageOrder>,
    heartbeats: BTreeMap<VehicleId, Heartbeat>,
    /// Orders that have arrived, with the number of steps since.
    arrived: Vec<(Order, u32)>,
}

/// Watches all honest agents.
pub(super) struct Rules {
    origin: Origin,
    /// Hash of the plan.
    plan: u64,
    honest: VehicleSet,
    sent: BTreeMap<VehicleId, Sent>,
    known: BTreeMap<VehicleId, Known>,
    /// The orders that the operator has signed.
    given: Vec<Order>,
    /// The latest step that an honest agent has earned.
    earned: u32,
    /// The step that was earned when an honest agent doubted a vehicle the last time: it was not in contact, or not yet an active
    /// member.
    doubted: BTreeMap<VehicleId, u32>,
    /// Whether only a majority may advance, and the sides that have: an agent with those in contact with it.
    has_quorum_policy: bool,
    sides: Vec<VehicleSet>,
    /// Number of times that an agent entered a step and another one had to be there too.
    pub(super) awaited: u64,
    /// Largest numbers of entries so far.
    pub(super) largest: LinkSizes,
    /// The first violation.
    pub(super) violation: Option<Violation>,
}

impl Rules {
    pub(super) fn new(origin: Origin, plan: u64, honest: VehicleSet, has_quorum_policy: bool) -> Self {
        let (sent, known, given, earned, largest, violation) = Default::default();
        let (doubted, sides, awaited) = Default::default();
        Self {
            origin,
            plan,
            honest,
            sent,
            known,
            given,
            earned,
            doubted,
            has_quorum_policy,
            sides,
            awaited,
            largest,
            violation,
        }
    }

    /// Number of times that a side advanced where only a majority may.
    pub(super) fn advances_of_majorities(&self) -> u64 {
        self.sides.len() as u64
    }

    /// Notes a violation, unless there is one already.
    pub(super) fn broken(&mut self, t_s: f64, invariant: &'static str, what: String) {
        self.violation.get_or_insert(Violation { t_s, invariant, what });
    }

    /// Notes that an agent starts: what the last one knew is forgotten.
    pub(super) fn agent_starts(&mut self, id: VehicleId) {
        self.known.insert(id, Known::default());
        self.doubted.insert(id, self.earned);
    }

    /// Notes an order that the operator signs.
    pub(super) fn order_signed(&mut self, order: Order) {
        self.given.push(order);
        // Such an order moves all vehicles forward: the step counts as earned.
        let step = step_of(&order).filter(|_| order.vehicles.is_none());
        self.earned = self.earned.max(step.unwrap_or(0));
    }

    /// The largest epoch so far.
    pub(super) fn epoch(&self) -> u64 {
        self.given.iter().map(|order| order.epoch).max().unwrap_or(0)
    }

    /// Notes that an order has arrived at an agent.
    pub(super) fn order_arrives(&mut self, id: VehicleId, order: Order) {
        if let Some(known) = self.known.get_mut(&id) {
            known.arrived.push((order, 0));
        }
    }

    /// Checks an agent right after its step. Returns the peers of which it has received something new, late or not, from
    /// them or from a node that has kept it.
    pub(super) fn check_step(
        &mut self,
        t_s: f64,
        id: VehicleId,
        agent: &SimulatedAgent,
        outputs: &Outputs,
    ) -> VehicleSet {
        self.note_sent(id, outputs);
        let news = self.news_of_peers(id, agent);
        self.check_received(t_s, id, agent);
        self.check_view(t_s, id, agent);
        self.check_orders(t_s, id, agent);
        self.check_agreement(t_s, id, agent, outputs);
        if let Some(Command::Controls(controls)) = outputs.command
            && !controls.is_within_limits()
        {
            self.broken(t_s, CONTROLS, format!("vehicle {id} commands {controls:?}"));
        }
        news
    }

    fn note_sent(&mut self, id: VehicleId, outputs: &Outputs) {
        let sent = self.sent.entry(id).or_default();
        if let Some(state) = &outputs.outbox.state {
            let place = (state.header.incarnation, state.header.sequence);
            sent.place_of.insert(place, sent.states.len());
            sent.states.push(ReceivedState::new(**state, &self.origin));
        }
        if let Some(mission) = &outputs.outbox.mission {
            sent.heartbeats.insert((mission.header.incarnation, mission.header.sequence), **mission);
        }
    }

    /// What enters the station was sent by its honest sender, or signed by the operator.
    fn check_received(&mut self, t_s: f64, id: VehicleId, agent: &SimulatedAgent) {
        for received in &agent.received {
            let message = received.message;
            let of = |id: VehicleId| self.honest.contains(id).then(|| self.sent.get(&id));
            let is_true = match message {
                PeerMessage::State(state) => of(state.header.sender).is_none_or(|sent| {
                    let sent = sent.and_then(|sent| {
                        let place = sent.place_of.get(&(state.header.incarnation, state.header.sequence))?;
                        Some(sent.states[*place])
                    });
                    sent == Some(state)
                }),
                PeerMessage::Mission(mission) => of(mission.header.sender).is_none_or(|sent| {
                    let place = (mission.header.incarnation, mission.header.sequence);
                    let sent = sent.and_then(|sent| sent.heartbeats.get(&place));
                    sent.is_some_and(|sent| *sent == mission)
                }),
                PeerMessage::Order(order) => self.given.contains(&order),
                PeerMessage::Appeared(_) | PeerMessage::Vanished(_) => true,
            };
            let has_true_order = match message {
                PeerMessage::Mission(Heartbeat { order: Some(order), .. }) => self.given.contains(&order),
                _ => true,
            };
            if !is_true || !has_true_order {
                self.broken(t_s, FORGED, format!("vehicle {id} takes {message:?}"));
            }
        }
    }

    fn news_of_peers(&mut self, id: VehicleId, agent: &SimulatedAgent) -> VehicleSet {
        let Some(known) = self.known.get_mut(&id) else { return VehicleSet::default() };
        let mut news = VehicleSet::default();
        for received in &agent.received {
            let (sender, is_new) = match received.message {
                PeerMessage::State(state) => {
                    let (sender, order) = (state.header.sender, state.header.order());
                    let is_new = known.newest.get(&sender).is_none_or(|newest| *newest < order);
                    if is_new {
                        known.newest.insert(sender, order);
                    }
                    (sender, is_new)
                }
                PeerMessage::Mission(mission) => {
                    let (sender, order) = (mission.header.sender, mission.header.order());
                    let is_new = known.heartbeats.get(&sender).is_none_or(|newest| newest.header.order() < order);
                    if is_new {
                        known.heartbeats.insert(sender, mission);
                    }
                    (sender, is_new)
                }
                _ => continue,
            };
            if is_new {
                news.insert(sender);
            }
        }
        news
    }

    /// The agent's view of every honest peer is a state that the peer has sent, and never an older one than before.
    fn check_view(&mut self, t_s: f64, id: VehicleId, agent: &SimulatedAgent) {
        let Some(known) = self.known.get_mut(&id) else { return };
        let mut wrong = None;
        for peer in agent.agent().peers().filter(|peer| self.honest.contains(peer.id)) {
            let from = known.views.entry(peer.id).or_default();
            let reported = peer.position.0 - peer.velocity.0 * peer.carried_s;
            let is_it = |sent: &ReceivedState| {
                let &ReceivedState { position, velocity, heading_rad, .. } = sent;
                velocity == peer.velocity && heading_rad == peer.heading_rad && (position.0 - reported).norm() < 1e-5
            };
            let states = self.sent.get(&peer.id).map_or(&[][..], |sent| &sent.states);
            match states.get(*from..).and_then(|states| states.iter().position(is_it)) {
                Some(further) => *from += further,
                None => wrong = Some(format!("vehicle {id} sees {peer:?}, which it did not send, or no longer")),
            }
        }
        wrong.into_iter().for_each(|what| self.broken(t_s, FORGED, what));
    }

    fn check_orders(&mut self, t_s: f64, id: VehicleId, agent: &SimulatedAgent) {
        let Some(known) = self.known.get_mut(&id) else { return };
        let orders = agent.agent().orders();
        let mut lost = Vec::new();
        if known.orders != *orders {
            lost.extend(known.orders.iter().filter(|order| !orders.contain(order)));
            known.orders = orders.clone();
        }
        known.arrived.iter_mut().for_each(|(_, steps)| *steps += 1);
        for (order, _) in known.arrived.extract_if(.., |(_, steps)| *steps > STEPS_TO_OBEY) {
            lost.extend(Some(order).filter(|order| !orders.contain(order)));
        }
        let false_order = orders.iter().find(|order| !self.given.contains(order));
        lost.iter().for_each(|order| self.broken(t_s, LOST_ORDER, format!("vehicle {id} does not keep {order:?}")));
        false_order.iter().for_each(|order| self.broken(t_s, FORGED, format!("vehicle {id} obeys {order:?}")));
    }

    fn check_agreement(&mut self, t_s: f64, id: VehicleId, agent: &SimulatedAgent, outputs: &Outputs) {
        let agent = agent.agent();
        let (step, reached) = (agent.at_step(), agent.reached());
        let in_contact = agent.peers_in_contact();
        // An order to one vehicle sends it to a later step. The others stay at theirs.
        let ahead = self.given.iter().filter(|order| order.vehicles.is_some() && order.is_to(id));
        let ahead = ahead.filter_map(step_of).max();
        let sees_honest = !in_contact.both(self.honest).is_empty();
        let Some(known) = self.known.get_mut(&id) else { return };
        let mut broken = Vec::new();
        if step < known.step || reached < known.reached {
            broken.push((
                P1,
                format!("vehicle {id}: step {} to {step}, reached {:?} to {reached:?}", known.step, known.reached),
            ));
        }
        if !known.is_misled {
            self.earned = self.earned.max(reached.map_or(0, |reached| reached + 1));
        }
        let named = agent.orders().naming(id);
        known.was_sent_ahead |= named.is_some_and(|order| step_of(&order).is_some());
        let earned = self.earned;
        if step > known.step {
            if Some(step) <= ahead.max(Some(earned)) {
                known.is_misled = false;
            } else if !sees_honest {
                known.is_misled = true;
            } else if !known.is_misled {
                broken.push((
                    P4,
                    format!("vehicle {id} is at step {step}, earned are {earned}, in contact: {in_contact}"),
                ));
            }
        }
        if step <= earned {
            known.is_misled = false;
        }
        // Two peers that vouch, a single peer, or an order move a vehicle forward without the others.
        // A later incarnation may have sent a state and no heartbeat yet.
        let is_valid = |of: &&Heartbeat| {
            let sender = of.header.sender;
            let newest = known.newest.get(&sender).map(|newest| newest.incarnation);
            in_contact.contains(sender) && newest <= Some(of.header.incarnation)
        };
        let in_view = || known.heartbeats.values().filter(is_valid);
        let vouching = in_view().filter(|of| of.vouched >= step).count();
        let is_ordered = self.given.iter().filter_map(step_of).any(|ordered| ordered >= step);
        if step == known.step + 1 && vouching < 2 && in_contact.len() > 1 && !is_ordered {
            let is_late = |of: &&Heartbeat| {
                of.membership == Membership::Active
                    && of.plan == self.plan
                    && of.step < step
                    && of.reached < Some(step - 1)
            };
            if let Some(late) = in_view().find(is_late) {
                broken.push((P2, format!("vehicle {id} enters step {step} before {late:?}")));
            }
        }
        if let Some(Heartbeat { vouched, .. }) = outputs.outbox.mission.as_deref() {
            if *vouched < known.vouched {
                broken.push((P1, format!("vehicle {id}: vouched {} to {vouched}", known.vouched)));
            }
            if *vouched > earned {
                broken.push((VOUCHED, format!("vehicle {id} vouches for {vouched}, earned are {earned}")));
            }
            known.vouched = *vouched;
        }
        let passes =
            step > known.step && !known.is_misled && !self.given.iter().filter_map(step_of).any(|to| to >= step);
        (known.step, known.reached) = (step, reached);
        self.doubt(id, in_contact, agent.membership());
        if passes {
            broken.extend(self.check_passing(id, step));
            if self.has_quorum_policy && vouching < 2 {
                broken.extend(self.check_side(id, in_contact));
            }
        }
        broken.into_iter().for_each(|(invariant, what)| self.broken(t_s, invariant, what));
    }

    /// Notes which vehicles an agent does not know as active members in contact, and itself while it is not active.
    fn doubt(&mut self, id: VehicleId, in_contact: VehicleSet, membership: Membership) {
        let Some(known) = self.known.get(&id) else { return };
        let is_member = |other: VehicleId| {
            let newest = known.newest.get(&other).map(|newest| newest.incarnation);
            // The last heartbeat may be that of an incarnation before, whose agent was killed.
            let heartbeat = known.heartbeats.get(&other).filter(|of| newest <= Some(of.header.incarnation));
            in_contact.contains(other) && heartbeat.is_some_and(|of| of.membership == Membership::Active)
        };
        for other in self.honest.iter() {
            let is_sure = if other == id { membership == Membership::Active } else { is_member(other) };
            if !is_sure {
                self.doubted.insert(other, self.earned);
            }
        }
    }

    /// Of an agent that enters a step: the vehicles that no agent has doubted since the step before was earned have reached it too.
    fn check_passing(&mut self, id: VehicleId, step: u32) -> Option<(&'static str, String)> {
        let settled = |other: &VehicleId| *other != id && self.doubted.get(other).is_some_and(|at| *at < step);
        let settled: Vec<_> = self.honest.iter().filter(settled).collect();
        self.awaited += settled.len() as u64;
        let is_late = |other: &VehicleId| {
            let known = self.known.get(other);
            known.is_some_and(|of| of.reached < Some(step - 1) && of.step < step)
        };
        let late = settled.into_iter().find(is_late)?;
        Some((P3, format!("vehicle {id} enters step {step} before vehicle {late} has reached the one before")))
    }

    /// Notes the side of an agent that advances.
    fn check_side(&mut self, id: VehicleId, in_contact: VehicleSet) -> Option<(&'static str, String)> {
        let mut side = in_contact;
        side.insert(id);
        let other = self.sides.iter().find(|other| other.both(side).is_empty()).copied();
        self.sides.push(side);
        other.map(|other| (P7, format!("vehicle {id} advances with {side}, others had with {other}")))
    }

    /// Checks the memory of an agent's link.
    pub(super) fn check_memory(&mut self, t_s: f64, id: VehicleId, agent: &SimulatedAgent) {
        let sizes = agent.network.sizes();
        let orders = agent.agent().orders().len();
        let most_orders = VEHICLES + 1 + TunableKey::ALL.len();
        let most = LinkSizes {
            inbox: 3 * (VEHICLES - 1) + most_orders,
            linked: VEHICLES - 1,
            events: 64,
            traces: 16,
            refusals: Refused::MAX_COUNT,
            checked_orders: CHECKED_ORDERS,
        };
        let is_within = sizes.inbox <= most.inbox
            && sizes.linked <= most.linked
            && sizes.events <= most.events
            && sizes.traces <= most.traces
            && sizes.refusals <= most.refusals
            && sizes.checked_orders <= most.checked_orders;
        if !is_within || orders > most_orders {
            self.broken(t_s, MEMORY, format!("vehicle {id} keeps {sizes:?} and {orders} orders"));
        }
        let largest = &mut self.largest;
        *largest = LinkSizes {
            inbox: largest.inbox.max(sizes.inbox),
            linked: largest.linked.max(sizes.linked),
            events: largest.events.max(sizes.events),
            traces: largest.traces.max(sizes.traces),
            refusals: largest.refusals.max(sizes.refusals),
            checked_orders: largest.checked_orders.max(sizes.checked_orders),
        };
    }

    /// Checks at the end of the quiet period that the agents agree, as far as this instant shows it. Returns how they
    /// differ.
    pub(super) fn difference<'a>(
        &self,
        agents: impl Iterator<Item = (VehicleId, &'a SimulatedAgent)> + Clone,
    ) -> Option<String> {
        let orders: StandingOrders = agents.clone().flat_map(|(_, agent)| agent.agent().orders().iter()).collect();
        for (id, agent) in agents.clone() {
            if let Some(missing) = orders.iter().find(|order| !agent.agent().orders().contain(order)) {
                return Some(format!("vehicle {id} does not have {missing:?}"));
            }
        }
        let vouched = |id: VehicleId| self.known.get(&id).map_or(0, |known| known.vouched);
        for (id, agent) in agents.clone() {
            let mut others: Vec<u32> =
                agents.clone().filter(|(other, _)| *other != id).map(|(id, _)| vouched(id)).collect();
            others.sort_unstable();
            if others.iter().rev().nth(1).is_some_and(|second| agent.agent().at_step() < *second) {
                return Some(format!("vehicle {id} is behind a step that two vehicles vouch for: {others:?}"));
            }
        }
        // An order to the swarm to stay keeps every vehicle at its step.
        if orders.to_swarm().is_some_and(|order| step_of(&order).is_none()) {
            return None;
        }
        let is_member = |agent: &SimulatedAgent| agent.agent().membership() == Membership::Active;
        let is_misled = |id: VehicleId| self.known.get(&id).is_some_and(|known| known.is_misled);
        let was_sent_ahead = |id: VehicleId| self.known.get(&id).is_some_and(|known| known.was_sent_ahead);
        let members = agents.filter(|(id, agent)| is_member(agent) && !is_misled(*id));
        let all: Vec<_> = members.map(|(id, agent)| (id, agent.agent().at_step(), agent.agent().reached())).collect();
        let steps: Vec<_> = all.iter().filter(|(id, ..)| !was_sent_ahead(*id)).collect();
        let least = steps.iter().map(|(_, step, _)| *step).min()?;
        // A vehicle that ran ahead waits for the others while they fly to the step, also for one that was sent ahead to it.
        let waits = all.iter().any(|(_, step, reached)| *step == least && *reached < Some(least));
        let differs = steps.iter().any(|(_, step, _)| *step > least);
        (differs && !waits).then(|| format!("steps {all:?}, orders {orders:?}"))
    }

    /// Whether an agent has an order or a larger one for the same vehicles.
    pub(super) fn has(agent: &SimulatedAgent, order: &Order) -> bool {
        agent.agent().orders().contain(order)
    }

    /// The latest step that an honest agent has earned.
    pub(super) fn earned(&self) -> u32 {
        self.earned
    }
}

/// The step to which an order sends vehicles.
fn step_of(order: &Order) -> Option<u32> {
    match order.verb {
        Verb::Goto(step) => Some(step),
        _ => None,
    }
}
