//! How faults begin and end, and the invariants that take time.

use skein_common::id::VehicleId;
use skein_common::state::Membership;
use skein_core::agent::Agent;

use super::World;
use super::plan::FaultKind;
use super::rules::{self, Rules};
use super::{AGREE_S, FLIGHT_S, STEPS, VEHICLES};

impl World {
    pub(super) fn fault_begins(&mut self, nth: usize) {
        let fault = self.plan.faults[nth];
        self.note(|| format!("fault {nth} begins: {fault}"));
        let (id, t_ns) = (fault.node, self.schedule.now_ns);
        let Some(computer) = self.computers.get_mut(&id) else { return };
        match fault.kind {
            FaultKind::Kill => {
                let killed = computer.kill(t_ns);
                killed.iter().for_each(|process| self.process_ended(id, process));
            }
            FaultKind::Stop | FaultKind::Hang => {
                // An agent that has not reported yet has a minute to start.
                if let Some(process) = computer.process.as_mut().filter(|process| process.has_reported) {
                    process.is_stopped |= fault.kind == FaultKind::Stop;
                    process.control_hangs |= fault.kind == FaultKind::Hang;
                    process.hangs_since_ns.get_or_insert(t_ns);
                }
            }
            FaultKind::Suspend => computer.is_suspended = true,
            FaultKind::Block => computer.publisher_is_blocked = true,
            FaultKind::Freeze => computer.simulator_is_frozen = true,
            FaultKind::PositionFrozen => computer.freeze_position(),
            FaultKind::FullDisk => computer.disk.is_full = true,
            FaultKind::DeadDisk => computer.disk.is_dead = true,
            FaultKind::SetClock => computer.utc_set_s += fault.by_s,
            FaultKind::Weak => self.network.set_weak(id, true),
            FaultKind::Cut => self.cut_directions(nth).into_iter().for_each(|(from, to)| self.network.cut(from, to)),
        }
    }

    pub(super) fn fault_ends(&mut self, nth: usize) {
        let fault = self.plan.faults[nth];
        if fault.until_s <= fault.at_s {
            return;
        }
        self.note(|| format!("fault {nth} ends: {}", fault.kind.name()));
        let id = fault.node;
        // Of two faults of a kind at one node, the later end counts.
        let lasts = |other: &super::plan::PlannedFault| {
            (other.node, other.kind) == (id, fault.kind) && other.at_s <= fault.until_s && fault.until_s < other.until_s
        };
        if !matches!(fault.kind, FaultKind::Cut | FaultKind::Weak) && self.plan.faults.iter().any(lasts) {
            return;
        }
        let t_ns = self.schedule.now_ns;
        let Some(computer) = self.computers.get_mut(&id) else { return };
        match fault.kind {
            FaultKind::Stop | FaultKind::Hang => {
                if let Some(process) = &mut computer.process {
                    process.is_stopped &= fault.kind != FaultKind::Stop;
                    process.control_hangs &= fault.kind != FaultKind::Hang;
                    if !process.is_stopped && !process.control_hangs {
                        process.hangs_since_ns = None;
                    }
                }
            }
            FaultKind::Suspend => {
                computer.is_suspended = false;
                if !fault.clock_runs {
                    computer.stood_still_ns += t_ns - super::ns(fault.at_s);
                }
            }
            FaultKind::Block => computer.publisher_is_blocked = false,
            FaultKind::Freeze => computer.simulator_is_frozen = false,
            FaultKind::FullDisk => computer.disk.is_full = false,
            FaultKind::DeadDisk => computer.disk.is_dead = false,
            FaultKind::Weak => self.network.set_weak(id, false),
            FaultKind::Cut => {
                for (from, to) in self.cut_directions(nth) {
                    // TCP sends again what was not acknowledged.
                    self.network.heal(from, to).into_iter().for_each(|packet| self.send(packet, false));
                }
            }
            FaultKind::Kill | FaultKind::SetClock | FaultKind::PositionFrozen => {}
        }
        if matches!(fault.kind, FaultKind::Stop | FaultKind::Suspend) {
            // What the operating system has received meanwhile.
            self.backlog.take(id).into_iter().for_each(|packet| self.arrive(packet));
        }
    }

    fn cut_directions(&self, nth: usize) -> Vec<(VehicleId, VehicleId)> {
        let fault = self.plan.faults[nth];
        let [from_it, to_it] = fault.ways;
        let others = || fault.others.iter();
        let from = others().filter(|_| from_it).map(|other| (fault.node, other));
        from.chain(others().filter(|_| to_it).map(|other| (other, fault.node))).collect()
    }
}

/// Checks the invariants that take time.
pub(super) fn check(world: &mut World) {
    check_presence(world);
    check_restarts(world);
    check_contact(world);
    check_silence(world);
    check_spreading(world);
    let t_s = world.t_s();
    if world.plan.is_to_the_end && t_s > FLIGHT_S {
        let agents = || world.computers.values().filter_map(|computer| Some(computer.process.as_ref()?.agent.agent()));
        let has_ended = |agent: &Agent| agent.has_finished() || agent.reached() == Some(STEPS - 1);
        let active = agents().filter(|agent| agent.membership() == Membership::Active).count();
        // Where only a majority may advance, fewer than a majority hold.
        let is_held = world.plan.has_quorum_policy && active <= VEHICLES / 2;
        let all_run = agents().count() == world.computers.len();
        world.flight.has_ended = all_run && (is_held || agents().all(has_ended));
    } else if t_s > FLIGHT_S - AGREE_S && !world.has_agreed {
        let agents = world.computers.iter().filter_map(|(id, computer)| Some((*id, &computer.process.as_ref()?.agent)));
        let all_run = agents.clone().count() == world.computers.len();
        world.difference = world.rules.difference(agents);
        world.has_agreed = all_run && world.difference.is_none();
    }
}

/// A node counts a peer as linked exactly while it has a link.
fn check_presence(world: &mut World) {
    let t_s = world.t_s();
    let ids: Vec<VehicleId> = world.parts.scenario.ids().collect();
    for (id, computer) in &world.computers {
        let Some(process) = &computer.process else { continue };
        world.rules.check_memory(t_s, *id, &process.agent);
        for peer in ids.iter().filter(|peer| *peer != id) {
            let has_link = world.network.ends_with(*id, *peer) > 0;
            if process.agent.network.is_linked(*peer) != has_link {
                let what = format!("node {id} has a link with {peer}: {has_link}, and counts the contrary");
                world.rules.broken(t_s, rules::PRESENCE, what);
            }
        }
    }
}

fn check_restarts(world: &mut World) {
    let (t_ns, t_s) = (world.schedule.now_ns, world.t_s());
    for (id, computer) in &mut world.computers {
        // A disk that fails keeps an agent on the ground: its supervisor tries again and again.
        if computer.disk.is_dead || computer.is_suspended {
            computer.held_up_ns = t_ns;
        }
        let since_ns = computer.without_agent_since_ns.map_or(t_ns, |since_ns| since_ns.max(computer.held_up_ns));
        let hangs = computer.process.as_ref().and_then(|process| process.hangs_since_ns);
        let hangs_since_ns = hangs.map_or(t_ns, |since_ns| since_ns.max(computer.held_up_ns));
        if (t_ns - hangs_since_ns) as f64 * 1e-9 > rules::HANG_S {
            world.rules.broken(t_s, rules::RESTART, format!("node {id} hangs and is not killed"));
        }
        if (t_ns - since_ns) as f64 * 1e-9 > rules::RESTART_S {
            world.rules.broken(
                t_s,
                rules::RESTART,
                format!("node {id} has no agent since {:.1} s", since_ns as f64 * 1e-9),
            );
        }
    }
}

fn honest_pairs(world: &World) -> Vec<(VehicleId, VehicleId)> {
    let ids: Vec<VehicleId> = world.computers.keys().copied().collect();
    ids.iter().flat_map(|one| ids.iter().filter(move |other| one < *other).map(move |other| (*one, *other))).collect()
}

/// Two healthy nodes come into contact, and remain in contact.
fn check_contact(world: &mut World) {
    let (t_ns, t_s) = (world.schedule.now_ns, world.t_s());
    for pair in honest_pairs(world) {
        let (one, other) = (&world.computers[&pair.0], &world.computers[&pair.1]);
        if !(one.is_healthy() && other.is_healthy() && world.network.is_usual(pair.0, pair.1)) {
            world.pairs.remove(&pair);
            continue;
        }
        let (Some(of_one), Some(of_other)) = (&one.process, &other.process) else { continue };
        let (of_one, of_other) = (of_one.agent.agent(), of_other.agent.agent());
        let (since_ns, was_in_contact) = world.pairs.entry(pair).or_insert((t_ns, false));
        let after_s = (t_ns - *since_ns) as f64 * 1e-9;
        let in_contact = of_one.peers_in_contact().contains(pair.1) && of_other.peers_in_contact().contains(pair.0);
        let is_fresh = of_one.fresh_peers().contains(pair.1) && of_other.fresh_peers().contains(pair.0);
        if !*was_in_contact && in_contact && is_fresh {
            *was_in_contact = true;
            world.flight.longest_rejoin_s = world.flight.longest_rejoin_s.max(after_s);
        }
        if after_s > rules::REJOIN_S && (!*was_in_contact || !in_contact) {
            let what = format!("vehicles {} and {}, healthy for {after_s:.1} s, are not in contact", pair.0, pair.1);
            world.rules.broken(t_s, rules::REJOIN, what);
        }
    }
}

/// A healthy node notices that it does not receive a peer.
fn check_silence(world: &mut World) {
    let (t_ns, t_s) = (world.schedule.now_ns, world.t_s());
    for (one, other) in honest_pairs(world) {
        for (node, peer) in [(one, other), (other, one)] {
            let (computer, of_peer) = (&world.computers[&node], &world.computers[&peer]);
            let is_unlinked = computer.is_healthy() && world.network.ends_with(node, peer) == 0;
            if let Some(process) = computer.process.as_ref().filter(|_| is_unlinked) {
                let since_ns = *world.unlinked_since.entry((node, peer)).or_insert(t_ns);
                let unlinked_s = (t_ns - since_ns) as f64 * 1e-9;
                if unlinked_s > rules::UNLINKED_S && process.agent.agent().peers_in_contact().contains(peer) {
                    let what = format!("vehicle {node} counts {peer}, with which it has no link for {unlinked_s:.2} s");
                    world.rules.broken(t_s, rules::NOTICED, what);
                }
            } else {
                world.unlinked_since.remove(&(node, peer));
            }
            let sends = of_peer.process.as_ref().is_some_and(|process| !process.is_stopped && !process.control_hangs)
                && !of_peer.is_suspended
                && !of_peer.publisher_is_blocked;
            let is_silent = !sends || world.network.is_cut(peer, node);
            let Some(process) = computer.process.as_ref().filter(|_| is_silent && computer.is_healthy()) else {
                world.silent_since.remove(&(node, peer));
                continue;
            };
            let since_ns = *world.silent_since.entry((node, peer)).or_insert(t_ns);
            let silent_s = (t_ns - since_ns) as f64 * 1e-9;
            if silent_s > rules::NOTICED_S && process.agent.agent().peers_in_contact().contains(peer) {
                let what = format!("vehicle {node} counts {peer}, which it has not received for {silent_s:.1} s");
                world.rules.broken(t_s, rules::NOTICED, what);
            }
        }
    }
}

/// An order that a node has received reaches all nodes that were in contact with it all the time.
fn check_spreading(world: &mut World) {
    let (t_ns, t_s) = (world.schedule.now_ns, world.t_s());
    let is_due = |since_ns: u64| t_ns - since_ns > super::ns(rules::SPREAD_S);
    for spreading in world.spreading.extract_if(.., |spreading| is_due(spreading.since_ns)) {
        let (node, order) = (spreading.node, spreading.order);
        for (peer, computer) in world.computers.iter().filter(|(peer, _)| **peer != node) {
            let pair = (node.min(*peer), node.max(*peer));
            let was_linked = world.pairs.get(&pair).is_some_and(|(since_ns, was_in_contact)| {
                *was_in_contact && since_ns + super::ns(rules::REJOIN_S) < spreading.since_ns
            });
            let Some(process) = computer.process.as_ref().filter(|_| was_linked) else { continue };
            if !Rules::has(&process.agent, &order) {
                let what = format!("node {node} received {order:?}, and vehicle {peer} does not have it");
                world.rules.broken(t_s, rules::LOST_ORDER, what);
            }
        }
    }
}
