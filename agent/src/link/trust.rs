//! Decides which received messages reach the inbox.

use std::sync::Arc;

use skein_common::frame::Origin;
use skein_common::id::{SwarmName, TeamId};
use skein_common::message::{Heartbeat, Order, Reason};
use skein_common::scenario::{Scenario, TeamInFleet};
use skein_common::topic::Branch;

use super::LinkReceiver;
use super::signature::messages::KeyRing;
use super::signature::orders::Checker;
use super::signature::{SigningKey, VerificationKey};
use skein_core::peers::PeerMessage;

/// The peers that an agent believes, and the operator whose orders it accepts.
#[derive(Clone, Debug)]
pub struct Trust {
    /// Name of the swarm.
    pub swarm: SwarmName,
    /// The team of the fleet that the swarm is, if it is one.
    pub team: Option<TeamInFleet>,
    /// Origin of the swarm's frame, in which positions are used.
    pub origin: Origin,
    /// Number of its vehicles; their ids are 1 to `vehicles`.
    pub vehicles: usize,
    /// Hash of the plan that the swarm flies.
    pub plan: u64,
    /// Key of the operator, which must have signed every order. Without it any order is accepted.
    pub orders: Option<VerificationKey>,
    /// Run of the swarm that the agent was started in; 0 where runs have no number. It is never learnt from peers. A
    /// signed order is accepted in a numbered run only, because one for run 0 would be valid again tomorrow.
    pub run: u64,
    /// Verifies the sender of each message.
    pub key_ring: KeyRing,
    /// Signs the own messages, where messages are signed.
    pub signing_key: Option<Arc<SigningKey>>,
}

impl Trust {
    /// The trust of a plain swarm with this scenario: no certificates, no signatures, no runs.
    pub fn of(scenario: &Scenario) -> Self {
        let (swarm, vehicles) = (scenario.swarm.name.clone(), scenario.swarm.vehicles);
        let (plan, key_ring) = (scenario.plan_hash(), KeyRing::plain(swarm.clone()));
        let origin = Origin::new(scenario.origin.geodetic());
        Self { swarm, team: scenario.team, origin, vehicles, plan, orders: None, run: 0, key_ring, signing_key: None }
    }

    /// The part of the key space that belongs to the swarm.
    pub fn branch(&self) -> Branch {
        Branch::of(self.team.map(|team| team.id))
    }
}

impl LinkReceiver {
    /// Number of orders of which it is known whether the operator signed them.
    pub(super) fn checked_orders(&self) -> usize {
        self.orders.as_ref().map_or(0, Checker::known)
    }

    /// Returns the part of a message under this key that is accepted; counts each part that is not. `run` is the run in its
    /// signature, if it has one.
    pub(super) fn accept(&self, key: &str, message: PeerMessage, run: Option<u64>) -> Option<PeerMessage> {
        let refused = |reason: Reason| self.inbox.refusals.refuse(reason, key, &reason);
        let reason = match (message.sender(), message) {
            (Some(id), _) if id == self.own => Reason::Forged,
            (Some(id), _) if usize::from(id.get()) > self.trust.vehicles => Reason::UnknownVehicle,
            (Some(_), _) if run.is_some_and(|run| run != self.trust.run) => Reason::OtherRun,
            (_, PeerMessage::Mission(content)) => {
                if content.plan != self.trust.plan {
                    refused(Reason::OtherPlan);
                }
                let order = content.order.filter(|order| self.is_signed(order));
                if order != content.order {
                    refused(Reason::Unsealed);
                }
                // The heartbeat itself is still the sender's: even with another plan it shows that the sender is up.
                return Some(PeerMessage::Mission(Heartbeat { order, ..content }));
            }
            (_, PeerMessage::Order(order)) if !self.is_signed(&order) => Reason::Unsealed,
            _ => return Some(message),
        };
        refused(reason);
        None
    }

    /// The reason why a state of another team's vehicle is refused, if it is. `run` is the run in its signature, if it has one. The
    /// number of vehicles of another team is not known here; where messages are signed, only a vehicle of the fleet has a key.
    pub(super) fn refusal_of_stranger(&self, team: TeamId, run: Option<u64>) -> Option<Reason> {
        match run {
            _ if Some(team) == self.branch.team() => Some(Reason::Forged),
            _ if team.get() > self.trust.team.map_or(0, |team| team.teams) => Some(Reason::UnknownVehicle),
            Some(run) if run != self.trust.run => Some(Reason::OtherRun),
            _ => None,
        }
    }

    fn is_signed(&self, order: &Order) -> bool {
        let run = self.trust.run;
        self.orders.as_ref().is_none_or(|orders| run != 0 && orders.is_signed(run, order))
    }
}
