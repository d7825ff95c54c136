//! Swarms of real nodes in a simulated world: four honest nodes and a liar, each on a PC of its own, fly for a minute of
//! virtual time under at least five faults, while an operator gives orders. One seed determines everything.
//!
//! | real | simulated |
//! | --- | --- |
//! | the station and the control loop around it | the simulator's frames (with the built-in helicopter) |
//! | the link: encoding, signatures, verification, inbox, presence, outgoing messages, last heartbeats | Zenoh's sessions: links that form and end, delay, loss, repetition, reordering, cuts |
//! | the supervisor's decisions, the watchdog | processes, clocks, disks |
//!
//! The rules (`rules.rs`) are checked while the world runs; the first one broken ends it.

mod computer;
mod faults;
mod liar;
mod network;
mod plan;
mod rules;
mod table;

use std::collections::{BTreeMap, VecDeque};

use skein_agent::link::Trust;
use skein_agent::link::signature::SigningKey;
use skein_agent::link::signature::messages::KeyRing;
use skein_agent::link::signature::orders::sign;
use skein_agent::run::simulated::{LinkSizes, Put};
use skein_common::frame::Origin;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Drops, Order, encode};
use skein_common::scenario::{Source, load};
use skein_common::state::Membership;
use skein_common::topic::{Branch, Topic};
use skein_core::aircraft::Aircraft;
use skein_core::builtin::BuiltInPlant;
use skein_core::control::Rules as ControlRules;
use skein_core::plant::Wake;
use skein_core::random::Purpose;
use skein_core::start::starts;
use skein_host::clock;

use crate::schedule::Schedule;
use computer::{Computer, Parts, Process};
use liar::Liar;
use network::{Backlog, Network, NodeState, Packet};
pub use plan::FaultKind;
use plan::{Chance, FLIGHT_S, MISSION_S, Plan, SILENT_FROM_S, STEPS, VEHICLES};
use rules::Rules;
pub use rules::Violation;
pub use table::{failure, table};

/// Run of the swarm.
const RUN: u64 = 7;
/// Time between two looks at supervisors, links and invariants, ns: that of the supervisor.
const LOOK_NS: u64 = 50_000_000;
/// Time of a frame, ns.
const FRAME_NS: f64 = 20e6;
/// The agents have to agree at an instant of this time at the end, s.
const AGREE_S: f64 = 5.0;

/// Result of one flight.
#[derive(Clone, Debug, Default)]
pub struct WorldFlight {
    /// The seed.
    pub seed: u64,
    /// Number of faults by kind.
    pub faults: BTreeMap<FaultKind, u32>,
    /// The faults, for people.
    pub fault_list: Vec<String>,
    /// Number of orders given.
    pub orders: u32,
    /// Number of messages that arrived at honest nodes, and of those that the liar sent.
    pub delivered: u64,
    /// Number of messages of the liar.
    pub lies: u64,
    /// Messages that links and agents refused.
    pub refused: Drops,
    /// Number of starts of an agent after the first.
    pub restarts: u32,
    /// Longest time until two healthy nodes were in contact again, s.
    pub longest_rejoin_s: f64,
    /// Longest time without an agent, s.
    pub longest_restart_s: f64,
    /// Largest numbers of entries.
    pub largest: LinkSizes,
    /// Latest mission step that the agents have earned.
    pub steps: u32,
    /// Number of times that an agent entered a step where another one had to be too.
    pub awaited: u64,
    /// Number of times that a side advanced where only a majority may.
    pub majorities: u64,
    /// Whether the mission was flown to its end.
    pub has_ended: bool,
    /// The first broken invariant.
    pub violation: Option<Violation>,
    /// Differs if anything in the flight differs.
    pub fingerprint: u64,
    /// What happened, if a log was wanted.
    pub log: Vec<String>,
}

/// Something that happens at its time.
#[derive(Debug)]
enum Event {
    Look,
    Frame(VehicleId),
    Arrival(Packet),
    FaultBegins(usize),
    FaultEnds(usize),
    OrderGiven(usize),
    Dialled(VehicleId, VehicleId),
    Query { of: VehicleId, by: VehicleId, link: u64 },
    Lie,
}

/// An order on its way to all agents.
struct Spreading {
    order: Order,
    node: VehicleId,
    since_ns: u64,
}

struct World {
    plan: Plan,
    parts: Parts,
    trusts: BTreeMap<VehicleId, Trust>,
    operator: SigningKey,
    computers: BTreeMap<VehicleId, Computer>,
    network: Network,
    backlog: Backlog,
    liar: Liar,
    lies: Chance,
    rules: Rules,
    schedule: Schedule<Event>,
    /// Since when two honest nodes are healthy with a usual network, and whether they have been in contact since.
    pairs: BTreeMap<(VehicleId, VehicleId), (u64, bool)>,
    /// Since when a healthy node cannot receive a peer, and since when it has no link with one.
    silent_since: BTreeMap<(VehicleId, VehicleId), u64>,
    unlinked_since: BTreeMap<(VehicleId, VehicleId), u64>,
    spreading: Vec<Spreading>,
    /// Whether the agents have agreed at an instant near the end, and how they differed last.
    has_agreed: bool,
    difference: Option<String>,
    flight: WorldFlight,
    wants_log: bool,
}

/// Flies the world of this seed; with a log if wanted.
///
/// # Panics
/// If the world's scenario is not valid.
pub fn fly(seed: u64, wants_log: bool) -> WorldFlight {
    let mut world = World::new(Plan::of(seed), wants_log);
    world.run();
    world.end()
}

/// The private key number `nth`, the same in every world.
fn key(nth: u8) -> SigningKey {
    // PKCS#8 version 1: a fixed header and the seed.
    let header = [0x30, 0x2e, 0x02, 0x01, 0x00, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x04, 0x22, 0x04, 0x20];
    SigningKey::from_pkcs8(&[&header[..], &[nth; 32]].concat()).expect("a key")
}

fn scenario_text(plan: &Plan) -> String {
    let partition = if plan.has_quorum_policy { "quorum" } else { "continue" };
    let steps: String =
        (0..STEPS).map(|nth| format!("  {{ centre_ne_m = [{}, 0], dwell_s = 2.0 }},\n", 4 * (nth % 2))).collect();
    format!(
        "name = \"world\"\nseed = {}\nswarm.name = \"world\"\nswarm.vehicles = {VEHICLES}\nformation.radius_m = 30\n\
         formation.altitude_m = 20\nstart.pattern = \"ring\"\nstart.square_m = 60\nnetwork.state_max_period_s = 0.4\n\
         network.state_error_m = 0.4\nnetwork.state_error_m_s = 0.4\n[mission]\n\
         partition = \"{partition}\"\nsteps = [\n{steps}]\n",
        plan.seed
    )
}

fn ns(t_s: f64) -> u64 {
    (t_s * 1e9) as u64
}

impl World {
    fn new(plan: Plan, wants_log: bool) -> Self {
        let text = scenario_text(&plan);
        let scenario = load(&Source { name: "world.toml", text: &text }, &[])
            .unwrap_or_else(|error| panic!("{error}\n{text}"))
            .scenario;
        let aircraft = Aircraft::shipped("xcell60").expect("a shipped aircraft").expect("a well-formed file");
        let ids: Vec<VehicleId> = scenario.ids().collect();
        let keys: BTreeMap<_, _> = ids.iter().map(|id| (*id, key(id.get()))).collect();
        let (swarm, plan_hash) = (scenario.swarm.name.clone(), scenario.plan_hash());
        let public = keys.iter().map(|(id, key)| ((*id).into(), key.key())).collect();
        let key_ring = KeyRing::signed(swarm.clone(), public);
        let operator = key(200);
        let honest: VehicleSet = ids.iter().copied().filter(|id| *id != plan.liar).collect();
        let earlier: VecDeque<_> =
            honest.iter().map(|id| liar::of_earlier_run(id, plan_hash, &key_ring, &keys[&id])).collect();
        let of_liar = Chance::new(plan.seed, Some(plan.liar), Purpose::Study);
        let liar_key = key(plan.liar.get());
        let liar =
            Liar::new(plan.liar, ids.clone(), (swarm, plan_hash), (key_ring.clone(), liar_key), earlier, of_liar);
        let trust = |id: VehicleId| Trust {
            orders: Some(operator.key()),
            run: RUN,
            key_ring: key_ring.clone(),
            signing_key: Some(key(id.get()).into()),
            ..Trust::of(&scenario)
        };
        let trusts = honest.iter().map(|id| (id, trust(id))).collect();
        let starts = starts(&scenario).expect("room for all vehicles");
        let computer = |(id, start): (VehicleId, _)| {
            let plant = BuiltInPlant::new(&scenario, id, &aircraft, start).expect("a flight model");
            (id, Computer::new(id, plan.pcs[usize::from(id.get()) - 1], plant))
        };
        let computers = ids.iter().copied().zip(&starts).filter(|(id, _)| *id != plan.liar).map(computer).collect();
        let network = Network::new(&plan, Chance::new(plan.seed, None, Purpose::Network));
        let rules = Rules::new(Origin::new(scenario.origin.geodetic()), plan_hash, honest, plan.has_quorum_policy);
        let mut flight = WorldFlight { seed: plan.seed, ..WorldFlight::default() };
        for fault in &plan.faults {
            *flight.faults.entry(fault.kind).or_default() += 1;
            flight.fault_list.push(fault.to_string());
        }
        let lies = Chance::new(plan.seed, Some(plan.liar), Purpose::Network);
        let parts = Parts { scenario, aircraft, rules: ControlRules::shipped(), zero: clock::now() };
        Self {
            plan,
            parts,
            trusts,
            operator,
            computers,
            network,
            backlog: Backlog::default(),
            liar,
            lies,
            rules,
            schedule: Schedule::default(),
            pairs: BTreeMap::new(),
            silent_since: BTreeMap::new(),
            unlinked_since: BTreeMap::new(),
            spreading: Vec::new(),
            has_agreed: false,
            difference: None,
            flight,
            wants_log,
        }
    }

    fn t_s(&self) -> f64 {
        self.schedule.now_ns as f64 * 1e-9
    }

    fn note(&mut self, what: impl FnOnce() -> String) {
        if self.wants_log {
            self.flight.log.push(format!("{:9.3} s: {}", self.t_s(), what()));
        }
    }

    fn run(&mut self) {
        self.schedule.at(LOOK_NS, Event::Look);
        self.schedule.at(LOOK_NS, Event::Lie);
        let phases: Vec<_> = self.computers.values().map(|computer| (computer.id, computer.plan.phase_s)).collect();
        phases.into_iter().for_each(|(id, phase_s)| self.schedule.at(ns(phase_s), Event::Frame(id)));
        for nth in 0..self.plan.faults.len() {
            self.schedule.at(ns(self.plan.faults[nth].at_s), Event::FaultBegins(nth));
            if self.plan.faults[nth].until_s < FLIGHT_S {
                self.schedule.at(ns(self.plan.faults[nth].until_s), Event::FaultEnds(nth));
            }
        }
        (0..self.plan.orders.len())
            .for_each(|nth| self.schedule.at(ns(self.plan.orders[nth].at_s), Event::OrderGiven(nth)));
        let end_ns = ns(if self.plan.is_to_the_end { MISSION_S } else { FLIGHT_S });
        while self.rules.violation.is_none() && !self.flight.has_ended {
            let Some(event) = self.schedule.next_until(end_ns) else { return };
            match event {
                Event::Look => self.look(),
                Event::Frame(id) => self.frame(id),
                Event::Arrival(packet) => self.arrive(packet),
                Event::FaultBegins(nth) => self.fault_begins(nth),
                Event::FaultEnds(nth) => self.fault_ends(nth),
                Event::OrderGiven(nth) => self.give_order(nth),
                Event::Dialled(one, other) => self.dialled(one, other),
                Event::Query { of, by, link } => self.query(of, by, link),
                Event::Lie => self.lie(),
            }
        }
    }

    /// One frame of a helicopter, and one pass of its agent's control loop.
    fn frame(&mut self, id: VehicleId) {
        let (t_ns, t_s, zero) = (self.schedule.now_ns, self.t_s(), self.parts.zero);
        let Some(computer) = self.computers.get_mut(&id) else { return };
        let next_ns = t_ns + (FRAME_NS / computer.plan.rate) as u64;
        self.schedule.last_at(next_ns, id.get().into(), Event::Frame(id));
        if computer.is_suspended {
            return;
        }
        let wake = Wake { frame: computer.next_frame(), ..Wake::default() };
        let (now, publisher_is_blocked) = (computer.now(zero, t_ns), computer.publisher_is_blocked);
        let Some(process) = computer.process.as_mut().filter(|process| !process.is_stopped && !process.control_hangs)
        else {
            return;
        };
        let is_traced = self.plan.traced_s[0] < t_s && t_s < self.plan.traced_s[1];
        process.agent.network.set_traced(is_traced);
        let step = process.agent.step(wake, now);
        for peer in self.rules.check_step(t_s, id, &process.agent, &step.outputs).iter() {
            self.silent_since.remove(&(id, peer));
        }
        self.rules.check_memory(t_s, id, &process.agent);
        let puts = if publisher_is_blocked { Vec::new() } else { process.agent.network.publish() };
        if step.reports {
            computer.report();
        }
        if self.wants_log {
            for what in &step.outputs.outbox.happened {
                self.note(|| format!("vehicle {id} {what}"));
            }
        }
        puts.into_iter().for_each(|put| self.send_to_all(id, put));
    }

    /// Sends a message to all peers with a link that subscribe to it. Traces go to an observer.
    fn send_to_all(&mut self, from: VehicleId, put: Put) {
        let topic = Topic::parse(&put.key);
        if !matches!(topic, Some(Topic::State(..) | Topic::Mission(_))) {
            return;
        }
        for (to, link) in self.network.peers_of(from) {
            let packet = Packet { from, to, link, key: put.key.clone(), bytes: put.bytes.clone() };
            self.send(packet, put.is_best_effort);
        }
    }

    fn send(&mut self, packet: Packet, is_best_effort: bool) {
        for at_ns in self.network.send(&packet, is_best_effort, self.schedule.now_ns) {
            self.schedule.at(at_ns, Event::Arrival(packet.clone()));
        }
    }

    fn arrive(&mut self, packet: Packet) {
        let (t_ns, zero, to) = (self.schedule.now_ns, self.parts.zero, packet.to);
        if to == self.liar.id {
            return self.liar.receive(&packet.key, &packet.bytes);
        }
        let Some(computer) = self.computers.get_mut(&to) else { return };
        let now = computer.now(zero, t_ns);
        if computer.process.is_none() || !self.network.has_end(to, packet.link) {
            return;
        }
        let Some(process) = computer.linked_process() else { return self.backlog.add(packet) };
        process.agent.network.receive(&packet.key, &packet.bytes, now);
        self.flight.delivered += 1;
        let bytes = packet.bytes.iter().fold(t_ns ^ packet.link, |sum, byte| sum.wrapping_mul(31) + u64::from(*byte));
        self.flight.fingerprint = self.flight.fingerprint.rotate_left(5) ^ bytes;
    }

    /// An operator gives an order to one node.
    fn give_order(&mut self, nth: usize) {
        let planned = self.plan.orders[nth];
        let (zero, t_ns, t_s) = (self.parts.zero, self.schedule.now_ns, self.t_s());
        let epoch = (self.rules.epoch() + u64::from(!planned.is_concurrent)).max(1);
        let order =
            Order { epoch, issuer: 1000 + nth as u64, verb: planned.verb, vehicles: planned.vehicles, signature: None };
        let order = sign(&self.operator, &self.parts.scenario.swarm.name, Branch::SWARM, RUN, order);
        let Some(computer) = self.computers.get_mut(&planned.node) else { return };
        let now = computer.now(zero, t_ns);
        let Some(process) = computer.linked_process() else { return };
        self.rules.order_signed(order);
        process.agent.network.receive(&Topic::Order(order.issuer).key(), &encode(&order), now);
        self.rules.order_arrives(planned.node, order);
        self.rules.check_memory(t_s, planned.node, &process.agent);
        self.spreading.push(Spreading { order, node: planned.node, since_ns: t_ns });
        self.flight.orders += 1;
        self.note(|| format!("the operator orders node {}: {order}, epoch {epoch}", planned.node));
    }

    fn lie(&mut self) {
        let t_s = self.t_s();
        if t_s > SILENT_FROM_S {
            return;
        }
        let to_one = self.lies.is_so(0.3);
        let peers = self.network.peers_of(self.liar.id);
        let ids: Vec<_> = peers.keys().copied().collect();
        let chosen = if ids.is_empty() { None } else { Some(self.lies.one_of(&ids)) };
        for (key, bytes) in self.liar.act(t_s) {
            for (&to, &link) in peers.iter().filter(|(to, _)| !to_one || Some(**to) == chosen) {
                let packet = Packet { from: self.liar.id, to, link, key: key.clone(), bytes: bytes.clone() };
                self.send(packet, true);
            }
        }
        let pause_s = self.lies.between(0.0, 2.0 / self.plan.lies_hz);
        self.schedule.after(ns(pause_s), Event::Lie);
    }

    fn states(&self) -> BTreeMap<VehicleId, NodeState> {
        let of = |computer: &Computer| NodeState { runs: computer.has_link(), is_suspended: computer.is_suspended };
        let honest = self.computers.iter().map(|(id, computer)| (*id, of(computer)));
        honest.chain([(self.liar.id, NodeState { runs: true, is_suspended: false })]).collect()
    }

    /// Lets supervisors look, links form and end, and checks what takes time.
    fn look(&mut self) {
        self.supervise();
        self.update_links();
        faults::check(self);
        self.schedule.after(LOOK_NS, Event::Look);
    }

    fn supervise(&mut self) {
        let (t_ns, t_s) = (self.schedule.now_ns, self.t_s());
        let mut ended = Vec::new();
        for (id, computer) in &mut self.computers {
            if computer.is_suspended || t_s < computer.plan.starts_s {
                continue;
            }
            let (was_without, trust) = (computer.without_agent_since_ns, &self.trusts[id]);
            let had_process = computer.process.is_some();
            ended.extend(computer.supervise(&self.parts, || trust.clone(), t_ns).map(|process| (*id, process)));
            if !had_process && computer.process.is_some() {
                self.rules.agent_starts(*id);
                if let Some(since_ns) = was_without {
                    self.flight.restarts += 1;
                    let without_s = (t_ns - since_ns) as f64 * 1e-9;
                    self.flight.longest_restart_s = self.flight.longest_restart_s.max(without_s);
                }
            }
        }
        let notes: Vec<_> = self
            .computers
            .iter_mut()
            .flat_map(|(id, computer)| {
                computer.notes.drain(..).map(|note| format!("node {id}: {note}")).collect::<Vec<_>>()
            })
            .collect();
        notes.into_iter().for_each(|note| self.note(|| note));
        ended.into_iter().for_each(|(id, process)| self.process_ended(id, &process));
    }

    fn update_links(&mut self) {
        let (t_ns, zero, states) = (self.schedule.now_ns, self.parts.zero, self.states());
        let state = |id: VehicleId| states.get(&id).copied().unwrap_or_default();
        for (node, link, peer) in self.network.closing(t_ns, state) {
            self.network.close(node, link);
            if let Some(computer) = self.computers.get_mut(&node) {
                let now = computer.now(zero, t_ns);
                computer.process.iter_mut().for_each(|process| process.agent.network.link_ends(link, now));
            }
            self.note(|| format!("node {node}: link {link} with {peer} ends"));
        }
        let ids: Vec<_> = states.keys().copied().collect();
        for (one, other, after_ns) in self.network.dialling(&ids, state) {
            self.schedule.at(t_ns + after_ns, Event::Dialled(one, other));
        }
    }

    fn dialled(&mut self, one: VehicleId, other: VehicleId) {
        let states = self.states();
        if let Some(link) = self.network.dialled(one, other, |id| states.get(&id).copied().unwrap_or_default()) {
            self.network.open(one, other, link, self.schedule.now_ns);
            self.network.open(other, one, link, self.schedule.now_ns);
            self.linked(one, other, link);
            self.linked(other, one, link);
            self.note(|| format!("nodes {one} and {other}: link {link} forms"));
        }
    }

    /// A link has formed at a node: the node counts it, and queries the peer for its last heartbeat.
    fn linked(&mut self, node: VehicleId, peer: VehicleId, link: u64) {
        let (zero, t_ns) = (self.parts.zero, self.schedule.now_ns);
        self.unlinked_since.remove(&(node, peer));
        let Some(computer) = self.computers.get_mut(&node) else { return };
        let now = computer.now(zero, t_ns);
        if let Some(process) = computer.process.as_mut() {
            process.agent.network.link_forms(link, peer, now);
            self.schedule.at(t_ns + self.network.delay_ns(), Event::Query { of: peer, by: node, link });
        }
    }

    fn query(&mut self, of: VehicleId, by: VehicleId, link: u64) {
        let t_s = self.t_s();
        let reply = if of == self.liar.id {
            self.liar.reply(t_s)
        } else {
            let process = self.computers.get_mut(&of).and_then(Computer::linked_process);
            process
                .and_then(|process| process.agent.network.last_heartbeat())
                .map(|bytes| (Topic::Mission(of).key(), bytes))
        };
        if let Some((key, bytes)) = reply.filter(|_| self.network.has_end(of, link)) {
            self.send(Packet { from: of, to: by, link, key, bytes }, false);
        }
    }

    /// The operating system closes what a process had open.
    fn process_ended(&mut self, id: VehicleId, process: &Process) {
        self.network.process_ended(id);
        self.backlog.take(id);
        self.add_refusals(process);
    }

    fn add_refusals(&mut self, process: &Process) {
        let (link, core) = (process.agent.network.drops(), process.agent.agent().drops());
        let sum = &mut self.flight.refused;
        sum.undecodable += link.undecodable;
        sum.other_version += link.other_version;
        sum.forged += link.forged + core.forged;
        sum.old += link.old + core.old;
        sum.unsigned += link.unsigned;
        sum.other_plan += link.other_plan;
    }

    fn end(mut self) -> WorldFlight {
        if self.rules.violation.is_none() {
            let t_s = self.t_s();
            if self.plan.is_to_the_end && !self.flight.has_ended {
                let of = |(id, computer): (&VehicleId, &Computer)| {
                    let agent = computer.process.as_ref()?.agent.agent();
                    let (step, reached, activity) = (agent.at_step(), agent.reached(), agent.activity());
                    let height_m = computer.height_m();
                    Some(format!(
                        "vehicle {id} at step {step}, reached {reached:?}, {activity:?}, {height_m:.1} m above the ground"
                    ))
                };
                let states: Vec<String> = self.computers.iter().filter_map(of).collect();
                self.rules.broken(t_s, rules::ENDS, states.join("; "));
            }
            if !self.has_agreed {
                let difference = self.difference.take().unwrap_or_else(|| "an agent does not run".to_owned());
                self.rules.broken(t_s, rules::AGREED, difference);
            }
            for (id, computer) in &self.computers {
                let Some(process) = computer.process.as_ref() else { continue };
                let is_named = process.agent.agent().orders().naming(*id).is_some();
                if process.agent.agent().membership() == Membership::Joining && !is_named {
                    self.rules.broken(t_s, rules::REJOIN, format!("vehicle {id} is not an active member again"));
                }
            }
        }
        let processes: Vec<_> = self.computers.values_mut().filter_map(|computer| computer.process.take()).collect();
        processes.iter().for_each(|process| self.add_refusals(process));
        self.flight.lies = self.liar.lies;
        self.flight.largest = self.rules.largest;
        self.flight.steps = self.rules.earned();
        self.flight.awaited = self.rules.awaited;
        self.flight.majorities = self.rules.advances_of_majorities();
        self.flight.violation = self.rules.violation;
        self.flight
    }
}
