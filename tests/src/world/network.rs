//! The simulated network: links between nodes, which form and end as TCP connections do, and the messages in flight.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use skein_common::id::VehicleId;

use super::plan::{Chance, Plan};

/// A link end that has received nothing for this long closes: Zenoh's lease.
const LEASE_NS: u64 = 4_000_000_000;
/// Largest number of messages that wait in front of a cut or in a stopped process.
const MOST_HELD: usize = 64;

/// A message on a link.
#[derive(Clone, Debug)]
pub(super) struct Packet {
    pub(super) from: VehicleId,
    pub(super) to: VehicleId,
    /// The link's number.
    pub(super) link: u64,
    pub(super) key: String,
    pub(super) bytes: Vec<u8>,
}

/// One end of a link.
#[derive(Clone, Copy, Debug)]
struct End {
    peer: VehicleId,
    received_ns: u64,
}

/// The links and the quality of the network.
#[derive(Debug)]
pub(super) struct Network {
    /// The ends of the links by their node and the link's number.
    ends: BTreeMap<(VehicleId, u64), End>,
    links: u64,
    /// Directions in which nothing passes, with the number of cuts.
    cuts: BTreeMap<(VehicleId, VehicleId), u32>,
    /// Nodes with a weak network.
    weak: BTreeMap<VehicleId, u32>,
    /// Pairs that are being linked.
    dialling: BTreeSet<(VehicleId, VehicleId)>,
    /// When the last message that may not overtake another arrives.
    last_ns: BTreeMap<(VehicleId, VehicleId), u64>,
    /// Messages that wait for the end of a cut.
    held: BTreeMap<(VehicleId, VehicleId), VecDeque<Packet>>,
    chance: Chance,
    delay_ns: f64,
    jitter_ns: f64,
    loss: f64,
}

/// Which nodes can use their links now.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct NodeState {
    /// Whether its link's threads run.
    pub(super) runs: bool,
    /// Whether the PC is suspended.
    pub(super) is_suspended: bool,
}

impl Network {
    pub(super) fn new(plan: &Plan, chance: Chance) -> Self {
        Self {
            ends: BTreeMap::new(),
            links: 0,
            cuts: BTreeMap::new(),
            weak: BTreeMap::new(),
            dialling: BTreeSet::new(),
            last_ns: BTreeMap::new(),
            held: BTreeMap::new(),
            chance,
            delay_ns: plan.delay_s * 1e9,
            jitter_ns: plan.jitter_s * 1e9,
            loss: plan.loss,
        }
    }

    /// Cuts a direction.
    pub(super) fn cut(&mut self, from: VehicleId, to: VehicleId) {
        *self.cuts.entry((from, to)).or_default() += 1;
    }

    /// Ends a cut of a direction. Returns the messages that TCP sends again.
    pub(super) fn heal(&mut self, from: VehicleId, to: VehicleId) -> VecDeque<Packet> {
        if let Some(count) = self.cuts.get_mut(&(from, to)) {
            *count -= 1;
            if *count == 0 {
                self.cuts.remove(&(from, to));
                return self.held.remove(&(from, to)).unwrap_or_default();
            }
        }
        VecDeque::new()
    }

    /// Makes the network of a node weak, or normal again.
    pub(super) fn set_weak(&mut self, node: VehicleId, is_weak: bool) {
        let count = self.weak.entry(node).or_default();
        *count = if is_weak { *count + 1 } else { count.saturating_sub(1) };
    }

    pub(super) fn is_cut(&self, from: VehicleId, to: VehicleId) -> bool {
        self.cuts.contains_key(&(from, to))
    }

    /// Whether the network between two nodes is as usual.
    pub(super) fn is_usual(&self, one: VehicleId, other: VehicleId) -> bool {
        let is_weak = |node| self.weak.get(&node).is_some_and(|count| *count > 0);
        !(self.is_cut(one, other) || self.is_cut(other, one) || is_weak(one) || is_weak(other))
    }

    /// Whether a node has an end of this link.
    pub(super) fn has_end(&self, node: VehicleId, link: u64) -> bool {
        self.ends.contains_key(&(node, link))
    }

    /// Number of ends that a node has of links with a peer.
    pub(super) fn ends_with(&self, node: VehicleId, peer: VehicleId) -> usize {
        self.ends_of(node).filter(|(_, with)| *with == peer).count()
    }

    /// The links of a node with their peers, the newest last.
    pub(super) fn ends_of(&self, node: VehicleId) -> impl Iterator<Item = (u64, VehicleId)> {
        self.ends.range((node, 0)..=(node, u64::MAX)).map(|((_, link), end)| (*link, end.peer))
    }

    /// The newest link of a node with each peer.
    pub(super) fn peers_of(&self, node: VehicleId) -> BTreeMap<VehicleId, u64> {
        self.ends_of(node).map(|(link, peer)| (peer, link)).collect()
    }

    /// Removes all ends of a process that has ended.
    pub(super) fn process_ended(&mut self, node: VehicleId) {
        self.ends.retain(|(of, _), _| *of != node);
    }

    /// Removes the end of a link.
    pub(super) fn close(&mut self, node: VehicleId, link: u64) {
        self.ends.remove(&(node, link));
    }

    /// Adds an end of a link that has formed.
    pub(super) fn open(&mut self, node: VehicleId, peer: VehicleId, link: u64, t_ns: u64) {
        self.ends.insert((node, link), End { peer, received_ns: t_ns });
    }

    /// The ends that close now: nothing has come for the lease, or the other side has closed.
    pub(super) fn closing(
        &mut self,
        t_ns: u64,
        state: impl Fn(VehicleId) -> NodeState,
    ) -> Vec<(VehicleId, u64, VehicleId)> {
        let mut closing = Vec::new();
        let links: BTreeSet<(VehicleId, u64)> = self.ends.keys().copied().collect();
        for ((node, link), end) in &mut self.ends {
            let peer = state(end.peer);
            let reaches = !self.cuts.contains_key(&(end.peer, *node)) && !peer.is_suspended;
            let is_open = links.contains(&(end.peer, *link));
            if reaches && is_open && peer.runs {
                end.received_ns = t_ns;
            }
            let is_over = t_ns.saturating_sub(end.received_ns) > LEASE_NS || reaches && !is_open;
            if is_over && state(*node).runs {
                closing.push((*node, *link, end.peer));
            }
        }
        closing
    }

    /// The pairs that begin to dial now, each with the time until the link forms, ns. The second node dials.
    pub(super) fn dialling(
        &mut self,
        nodes: &[VehicleId],
        state: impl Fn(VehicleId) -> NodeState,
    ) -> Vec<(VehicleId, VehicleId, u64)> {
        let mut begun = Vec::new();
        for (nth, &one) in nodes.iter().enumerate() {
            for &other in &nodes[nth + 1..] {
                let is_linked = self.ends_with(other, one) > 0;
                if !is_linked && self.may_form(one, other, &state) && self.dialling.insert((one, other)) {
                    let after_s = self.chance.between(0.1, 1.0);
                    begun.push((one, other, (after_s * 1e9 + 3.0 * self.delay_ns) as u64));
                }
            }
        }
        begun
    }

    /// The number of the link of a pair that has dialled; `None` if it does not form.
    pub(super) fn dialled(
        &mut self,
        one: VehicleId,
        other: VehicleId,
        state: impl Fn(VehicleId) -> NodeState,
    ) -> Option<u64> {
        self.dialling.remove(&(one, other));
        let forms = self.ends_with(other, one) == 0 && self.may_form(one, other, &state);
        forms.then(|| {
            self.links += 1;
            self.links
        })
    }

    fn may_form(&self, one: VehicleId, other: VehicleId, state: &impl Fn(VehicleId) -> NodeState) -> bool {
        !self.is_cut(one, other) && !self.is_cut(other, one) && state(one).runs && state(other).runs
    }

    /// When the copies of a message arrive: none if it is lost. A message that waits for the end of a cut is kept.
    pub(super) fn send(&mut self, packet: &Packet, is_best_effort: bool, t_ns: u64) -> Vec<u64> {
        let pair = (packet.from, packet.to);
        if self.is_cut(pair.0, pair.1) {
            let held = self.held.entry(pair).or_default();
            if !is_best_effort && held.len() < MOST_HELD {
                held.push_back(packet.clone());
            }
            return Vec::new();
        }
        let is_weak = [pair.0, pair.1].iter().any(|node| self.weak.get(node).is_some_and(|count| *count > 0));
        let (loss, late_ns) = if is_weak { (0.4, 4e8) } else { (self.loss, 0.0) };
        let arrival = |chance: &mut Chance| {
            let late_ns = self.delay_ns + chance.between(0.0, self.jitter_ns) + chance.between(0.0, late_ns);
            t_ns + late_ns as u64 + 1
        };
        if is_best_effort {
            let copies = if self.chance.is_so(loss) { 0 } else { 1 + usize::from(self.chance.is_so(self.loss / 2.0)) };
            return (0..copies).map(|_| arrival(&mut self.chance)).collect();
        }
        // A lost segment is sent again, and later ones wait for it.
        let again_ns = if self.chance.is_so(loss) { 200_000_000 } else { 0 };
        let at_ns = arrival(&mut self.chance) + again_ns;
        let last_ns = self.last_ns.entry(pair).or_default();
        *last_ns = at_ns.max(*last_ns + 1000);
        vec![*last_ns]
    }

    /// Time for a message one way, ns.
    pub(super) fn delay_ns(&self) -> u64 {
        self.delay_ns as u64 + 1
    }
}

/// Messages that wait in a stopped process or a suspended PC.
#[derive(Debug, Default)]
pub(super) struct Backlog(BTreeMap<VehicleId, VecDeque<Packet>>);

impl Backlog {
    pub(super) fn add(&mut self, packet: Packet) {
        let waiting = self.0.entry(packet.to).or_default();
        if waiting.len() < MOST_HELD {
            waiting.push_back(packet);
        }
    }

    /// Takes all that wait for a node.
    pub(super) fn take(&mut self, node: VehicleId) -> VecDeque<Packet> {
        self.0.remove(&node).unwrap_or_default()
    }
}
