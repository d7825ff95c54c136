//! Whose words are taken up, and which of them are not.

use std::sync::Arc;

use skein_common::id::{SwarmName, VehicleId};
use skein_common::message::{Mission, Order, Reason};
use skein_common::scenario::Scenario;

use super::seal::orders::Checker;
use super::seal::words::Voices;
use super::seal::{SealKey, Sealer};
use skein_core::peers::Word;

/// Whom an agent believes, and whose orders it takes.
#[derive(Clone, Debug)]
pub struct Trust {
    /// Its swarm: vehicles 1 to `vehicles` of this name.
    pub swarm: SwarmName,
    /// How many there are.
    pub vehicles: usize,
    /// Hash of the plan that they fly.
    pub plan: u64,
    /// Known for an operator's are the orders that this key has sealed; without a key, any.
    pub orders: Option<SealKey>,
    /// The run of the swarm that the agent was started in; 0 where runs have no number. Peers are never asked for it. An order
    /// with a seal is taken in a numbered run only: one for run 0 would hold again tomorrow.
    pub run: u64,
    /// By what one tells whose a word is.
    pub voices: Voices,
    /// What seals the own words, where words are sealed.
    pub sealer: Option<Arc<Sealer>>,
}

impl Trust {
    /// In the swarm of this scenario: plain links, no seals, no runs.
    pub fn of(scenario: &Scenario) -> Self {
        let (swarm, vehicles) = (scenario.swarm.name.clone(), scenario.swarm.vehicles);
        let (plan, voices) = (scenario.plan_hash(), Voices::plain(swarm.clone()));
        Self { swarm, vehicles, plan, orders: None, run: 0, voices, sealer: None }
    }
}

/// What stands between the network and the inbox.
#[derive(Debug)]
pub(super) struct Judge {
    own: VehicleId,
    vehicles: usize,
    plan: u64,
    orders: Option<Checker>,
    run: u64,
}

impl Judge {
    pub(super) fn new(own: VehicleId, trust: Trust) -> Self {
        let Trust { swarm, vehicles, plan, orders, run, .. } = trust;
        let orders = orders.map(|key| Checker::new(key, swarm));
        Self { own, vehicles, plan, orders, run }
    }

    /// The run that this agent is in.
    pub(super) fn run(&self) -> u64 {
        self.run
    }

    /// What is left of a word to take up; its speaker has said it in this run, if it is sealed. `refused` is told what is not
    /// believed of it, and why.
    pub(super) fn hear(&self, word: Word, run: Option<u64>, mut refused: impl FnMut(Reason)) -> Option<Word> {
        let stranger = |id: VehicleId| usize::from(id.get()) > self.vehicles;
        match (word.speaker(), word) {
            (Some(id), _) if id == self.own => {
                refused(Reason::Forged);
                None
            }
            (Some(id), _) if stranger(id) => {
                refused(Reason::Stranger);
                None
            }
            (Some(_), _) if run.is_some_and(|run| run != self.run) => {
                refused(Reason::OtherRun);
                None
            }
            (_, Word::Mission(said)) => {
                if said.plan != self.plan {
                    refused(Reason::OtherPlan);
                }
                let order = said.order.filter(|order| self.is_sealed(order));
                if order != said.order {
                    refused(Reason::Unsealed);
                }
                // The register itself is its speaker's own; whatever plan it is of, its speaker is there.
                Some(Word::Mission(Mission { order, ..said }))
            }
            (_, Word::Order(order)) if !self.is_sealed(&order) => {
                refused(Reason::Unsealed);
                None
            }
            _ => Some(word),
        }
    }

    fn is_sealed(&self, order: &Order) -> bool {
        self.orders.as_ref().is_none_or(|orders| self.run != 0 && orders.is_sealed(self.run, order))
    }
}
