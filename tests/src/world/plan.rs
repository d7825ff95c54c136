//! The plan of one seed's world: which node lies, how wrong the clocks are, how bad the network is, and when faults and orders come.

use std::fmt;

use rand_chacha::ChaCha8Rng;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::Verb;
use skein_core::random::{self, Purpose};

/// Number of honest nodes.
pub(super) const HONEST: usize = 4;
/// Number of vehicles: the honest ones and the liar.
pub(super) const VEHICLES: usize = HONEST + 1;
/// Length of a flight, s; one that flies its mission to the end is longer.
pub(super) const FLIGHT_S: f64 = 60.0;
/// Every mission that is flown to its end has ended by then, s: a vehicle that comes no nearer to its place leaves after a minute, and
/// the few steps that remain take ten seconds each.
pub(super) const MISSION_S: f64 = FLIGHT_S + 200.0;
/// One world of so many flies its mission to the end.
const TO_THE_END: u64 = 10;
/// From then on no fault lasts and no order is given, s.
pub(super) const QUIET_FROM_S: f64 = 42.0;
/// From then on the liar is silent, s: it can keep all others at their step, as the model check shows.
pub(super) const SILENT_FROM_S: f64 = 52.0;
/// Least and largest number of faults.
const FAULTS: [u8; 2] = [5, 8];
/// Number of mission steps.
pub(super) const STEPS: u32 = 8;

/// Random numbers of one purpose.
#[derive(Clone, Debug)]
pub(super) struct Chance(ChaCha8Rng);

impl Chance {
    /// The random numbers of this seed for a vehicle, or for the world.
    pub(super) fn new(seed: u64, vehicle: Option<VehicleId>, purpose: Purpose) -> Self {
        Self(random::generator(seed, vehicle, purpose))
    }

    /// A number of this range.
    pub(super) fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * random::uniform(&mut self.0)
    }

    /// A whole number of this range, both ends included.
    pub(super) fn whole(&mut self, from: u32, to: u32) -> u32 {
        self.between(f64::from(from), f64::from(to) + 1.0) as u32
    }

    /// One of these.
    pub(super) fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.between(0.0, all.len() as f64) as usize]
    }

    /// True in this share of cases.
    pub(super) fn is_so(&mut self, share: f64) -> bool {
        self.between(0.0, 1.0) < share
    }
}

/// Kinds of faults, in the order of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FaultKind {
    /// The agent is killed.
    Kill,
    /// The whole agent stops, as by SIGSTOP, until its supervisor kills it.
    Stop,
    /// The control thread hangs until the supervisor kills the agent; the threads of the link run on.
    Hang,
    /// The PC is suspended.
    Suspend,
    /// The publisher's thread is blocked by a slow peer.
    Block,
    /// The links between two groups carry nothing, in one or both directions.
    Cut,
    /// Every second message of a node is lost or late.
    Weak,
    /// The disk has no room.
    FullDisk,
    /// The disk can be neither read nor written.
    DeadDisk,
    /// The UTC clock of a PC is set.
    SetClock,
    /// The simulator delivers no frames.
    Freeze,
    /// The measured position does not change any more, to the end.
    PositionFrozen,
}

impl FaultKind {
    /// All kinds.
    pub const ALL: [Self; 12] = [
        Self::Kill,
        Self::Stop,
        Self::Hang,
        Self::Suspend,
        Self::Block,
        Self::Cut,
        Self::Weak,
        Self::FullDisk,
        Self::DeadDisk,
        Self::SetClock,
        Self::Freeze,
        Self::PositionFrozen,
    ];

    /// The kinds that pass, in every world.
    const PASSING: [Self; 11] = {
        let [passing @ .., Self::PositionFrozen] = Self::ALL else { panic!("the last kind remains") };
        passing
    };

    /// Its name in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Kill => "agent killed",
            Self::Stop => "agent stopped",
            Self::Hang => "control thread hangs",
            Self::Suspend => "PC suspended",
            Self::Block => "publisher blocked",
            Self::Cut => "links cut",
            Self::Weak => "weak network",
            Self::FullDisk => "disk full",
            Self::DeadDisk => "disk fails",
            Self::SetClock => "UTC set",
            Self::Freeze => "simulator freezes",
            Self::PositionFrozen => "position frozen",
        }
    }
}

/// A fault at one node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlannedFault {
    /// When it begins, s.
    pub(super) at_s: f64,
    /// When it ends, s; a fault without a duration ends when it begins.
    pub(super) until_s: f64,
    /// What fails.
    pub(super) kind: FaultKind,
    /// The node.
    pub(super) node: VehicleId,
    /// Of a cut: the nodes on the other side. The links with the liar are cut like others.
    pub(super) others: VehicleSet,
    /// Of a cut: whether messages of the node and to the node are lost.
    pub(super) ways: [bool; 2],
    /// Of a set clock: by how much, s.
    pub(super) by_s: f64,
    /// Of a suspended PC: whether its monotonic clock counts the time.
    pub(super) clock_runs: bool,
}

impl fmt::Display for PlannedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { at_s, until_s, kind, node, others, ways, by_s, clock_runs } = self;
        write!(f, "{at_s:.2} s: {} at node {node}", kind.name())?;
        match kind {
            FaultKind::Cut => write!(f, ", from it to {others}: {}, to it: {}", ways[0], ways[1])?,
            FaultKind::SetClock => write!(f, " by {by_s:.0} s")?,
            FaultKind::Suspend => write!(f, ", its clock runs: {clock_runs}")?,
            _ => {}
        }
        if until_s > at_s { write!(f, ", until {until_s:.2} s") } else { Ok(()) }
    }
}

/// An order that the operator gives to one node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlannedOrder {
    /// When, s.
    pub(super) at_s: f64,
    /// The node that gets it.
    pub(super) node: VehicleId,
    /// The action.
    pub(super) verb: Verb,
    /// The vehicles that it names.
    pub(super) vehicles: Option<VehicleSet>,
    /// Whether its operator had not received the order before it.
    pub(super) is_concurrent: bool,
}

/// The clocks and the start of one PC.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PcPlan {
    /// When its supervisor is started, s.
    pub(super) starts_s: f64,
    /// Rate of its monotonic clock.
    pub(super) rate: f64,
    /// Error of its UTC clock, s.
    pub(super) utc_error_s: f64,
    /// Phase of its simulator's frames, s.
    pub(super) phase_s: f64,
}

/// The world of one seed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    /// The seed.
    pub(super) seed: u64,
    /// The vehicle whose node lies.
    pub(super) liar: VehicleId,
    /// The PCs of vehicles 1, 2, ...
    pub(super) pcs: Vec<PcPlan>,
    /// Whether the larger part of a cut swarm alone flies on.
    pub(super) has_quorum_policy: bool,
    /// Usual share of states that are lost, and that arrive twice.
    pub(super) loss: f64,
    /// Usual one-way delay of a link, s, and how much longer a message may take, s.
    pub(super) delay_s: f64,
    pub(super) jitter_s: f64,
    /// Number of actions of the liar in a second.
    pub(super) lies_hz: f64,
    /// When the observer of a trace is there, s.
    pub(super) traced_s: [f64; 2],
    /// The faults by their begin.
    pub(super) faults: Vec<PlannedFault>,
    /// The orders by time.
    pub(super) orders: Vec<PlannedOrder>,
    /// Whether the mission is flown to its end.
    pub(super) is_to_the_end: bool,
}

impl Plan {
    /// The world of this seed.
    pub(super) fn of(seed: u64) -> Self {
        let mut chance = Chance::new(seed, None, Purpose::Study);
        let ids: Vec<VehicleId> = VehicleId::first(VEHICLES).collect();
        let liar = chance.one_of(&ids);
        let honest: Vec<VehicleId> = ids.iter().copied().filter(|id| *id != liar).collect();
        let pcs = ids.iter().map(|_| pc(&mut chance)).collect();
        let begins_s = chance.between(5.0, QUIET_FROM_S - 5.0);
        let count = chance.whole(FAULTS[0].into(), FAULTS[1].into());
        let mut faults: Vec<_> = (0..count).map(|_| fault(&mut chance, &honest, &ids)).collect();
        // An agent that starts again shows what the disk has kept.
        let disks: Vec<_> = faults.iter().copied().filter(|fault| is_of_disk(fault.kind)).collect();
        faults.extend(disks.into_iter().map(|disk| {
            let at_s = chance.between(disk.at_s, disk.until_s);
            PlannedFault { at_s, until_s: at_s, kind: FaultKind::Kill, ..disk }
        }));
        faults.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
        let count = chance.whole(3, 6);
        let mut orders: Vec<_> = (0..count).map(|_| order(&mut chance, &honest, &ids)).collect();
        if chance.is_so(0.3) {
            // Two operators at the same moment.
            let first = orders[0];
            let second = order(&mut chance, &honest, &ids);
            orders.push(PlannedOrder { at_s: first.at_s, node: first.node, is_concurrent: true, ..second });
        }
        orders.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
        let mut plan = Self {
            seed,
            liar,
            pcs,
            has_quorum_policy: chance.is_so(0.3),
            loss: chance.between(0.0, 0.1),
            delay_s: chance.between(0.0005, 0.05),
            jitter_s: chance.between(0.0, 0.05),
            lies_hz: chance.between(2.0, 6.0),
            traced_s: [begins_s, begins_s + 2.0],
            faults,
            orders,
            is_to_the_end: seed % TO_THE_END == TO_THE_END - 1,
        };
        if chance.is_so(0.3) {
            let halves = halves(&mut chance, &honest, &ids);
            plan.has_quorum_policy = chance.is_so(0.5);
            // The two sides need all of the cut to fly to their places and advance from there: no order disturbs them.
            plan.orders.iter_mut().for_each(|order| order.at_s = chance.between(halves[0].until_s, QUIET_FROM_S - 1.0));
            plan.orders.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
            plan.faults.extend(halves);
            plan.faults.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
        }
        if plan.is_to_the_end {
            plan.fly_to_the_end(&mut chance, &honest);
        }
        plan
    }

    /// No order keeps a vehicle from the end of the mission, and in every second world a position freezes for ever.
    fn fly_to_the_end(&mut self, chance: &mut Chance, honest: &[VehicleId]) {
        self.orders.retain(|order| order.vehicles.is_none());
        let node = chance.one_of(honest);
        let verb = Verb::Goto(STEPS - 4);
        self.orders.push(PlannedOrder { at_s: FLIGHT_S, node, verb, vehicles: None, is_concurrent: false });
        if chance.is_so(0.5) {
            let (at_s, node, kind) =
                (chance.between(10.0, QUIET_FROM_S), chance.one_of(honest), FaultKind::PositionFrozen);
            let (until_s, others) = (f64::INFINITY, VehicleSet::default());
            let frozen =
                PlannedFault { at_s, until_s, kind, node, others, ways: [true; 2], by_s: 0.0, clock_runs: true };
            self.faults.push(frozen);
            self.faults.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
        }
    }
}

/// A cut between two honest nodes and the other three. Only the three are a majority.
fn halves(chance: &mut Chance, honest: &[VehicleId], ids: &[VehicleId]) -> [PlannedFault; 2] {
    let one = chance.one_of(honest);
    let pair = [one, chance.one_of(&honest.iter().copied().filter(|id| *id != one).collect::<Vec<_>>())];
    let at_s = chance.between(8.0, 16.0);
    let until_s = at_s + chance.between(18.0, 24.0);
    let others = ids.iter().copied().filter(|id| !pair.contains(id)).collect();
    let ways = [true, true];
    pair.map(|node| PlannedFault {
        at_s,
        until_s,
        kind: FaultKind::Cut,
        node,
        others,
        ways,
        by_s: 0.0,
        clock_runs: true,
    })
}

fn is_of_disk(kind: FaultKind) -> bool {
    matches!(kind, FaultKind::FullDisk | FaultKind::DeadDisk)
}

fn pc(chance: &mut Chance) -> PcPlan {
    PcPlan {
        starts_s: chance.between(0.0, 1.5),
        // A quartz may be off by 100 ppm.
        rate: 1.0 + chance.between(-100e-6, 100e-6),
        utc_error_s: chance.between(-7200.0, 7200.0),
        phase_s: chance.between(0.0, 0.02),
    }
}

fn fault(chance: &mut Chance, honest: &[VehicleId], ids: &[VehicleId]) -> PlannedFault {
    let kind = chance.one_of(&FaultKind::PASSING);
    let node = chance.one_of(honest);
    // A supervisor needs eleven seconds to notice a hang.
    let latest_s = if matches!(kind, FaultKind::Stop | FaultKind::Hang) { 27.0 } else { 36.0 };
    let at_s = chance.between(3.0, latest_s);
    let for_s = match kind {
        FaultKind::Kill | FaultKind::SetClock => 0.0,
        FaultKind::Stop | FaultKind::Hang => chance.one_of(&[chance.clone().between(0.5, 9.0), 60.0]),
        FaultKind::FullDisk | FaultKind::DeadDisk => chance.between(5.0, 25.0),
        FaultKind::Freeze => chance.between(0.1, 5.0),
        _ => chance.between(0.5, 12.0),
    };
    let mut others: VehicleSet = ids.iter().copied().filter(|id| *id != node && chance.is_so(0.6)).collect();
    if others.is_empty() {
        others = ids.iter().copied().filter(|id| *id != node).collect();
    }
    let by_s = chance.between(-7200.0, 7200.0);
    let ways = chance.one_of(&[[true, true], [true, false], [false, true]]);
    // A hang of a minute is ended by the supervisor.
    let until_s = if for_s >= 60.0 { f64::INFINITY } else { (at_s + for_s).min(QUIET_FROM_S) };
    PlannedFault { at_s, until_s, kind, node, others, ways, by_s, clock_runs: chance.is_so(0.5) }
}

fn order(chance: &mut Chance, honest: &[VehicleId], ids: &[VehicleId]) -> PlannedOrder {
    let radius = format!("formation.radius_m={}", chance.whole(25, 45));
    let altitude = format!("formation.altitude_m={}", chance.whole(20, 40));
    let set = |text: &str| Verb::Set(text.parse().expect("a setting"));
    let step = chance.whole(0, STEPS - 2);
    let (verb, is_named) = match chance.whole(0, 19) {
        0..=4 => (Verb::Goto(step), false),
        5..=7 => (Verb::Hold, false),
        8..=10 => (set(&radius), false),
        11..=13 => (set(&altitude), false),
        14..=15 => (Verb::Hold, true),
        16..=17 => (Verb::Goto(step), true),
        18 => (Verb::Land, true),
        _ => (chance.one_of(&[Verb::Abort, Verb::Land]), false),
    };
    let mut vehicles: VehicleSet = ids.iter().copied().filter(|_| chance.is_so(0.4)).collect();
    if vehicles.is_empty() {
        vehicles.insert(chance.one_of(honest));
    }
    PlannedOrder {
        at_s: chance.between(2.0, QUIET_FROM_S - 1.0),
        node: chance.one_of(honest),
        verb,
        vehicles: is_named.then_some(vehicles),
        is_concurrent: chance.is_so(0.1),
    }
}
