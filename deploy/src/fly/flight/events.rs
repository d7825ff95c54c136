//! The actions of `fly` itself on the swarm: the scenario's events, and orders.

use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::message::Order;

use super::Flight;
use crate::fly::children::ProcessRole;
use crate::fly::script::ScriptedAction;
use skein_cluster::display::status::Stage;
use skein_cluster::mesh::order;
use skein_lab::faults::{FROZEN, InjectedFault, OperatorOrder};

/// Between two sayings of an order.
const AGAIN: Duration = Duration::from_millis(200);

impl Flight {
    /// Does what the scenario has for now.
    pub(super) fn play(&mut self, now: Instant) {
        while let Some(action) = self.schedule.due(self.since_zero_s(now)) {
            self.report_news(now, format!("event: {action}"));
            self.carry_out(now, &action);
        }
    }

    /// Cancels the events that are still to come, but resumes frozen simulators, so that their vehicles can land.
    pub(super) fn end_events(&mut self, now: Instant) {
        let thaws: Vec<ScriptedAction> =
            self.schedule.remaining().filter(|action| matches!(action, ScriptedAction::Thaw(_))).cloned().collect();
        while self.schedule.due(f64::INFINITY).is_some() {}
        thaws.iter().for_each(|action| self.carry_out(now, action));
    }

    /// Whether a killed agent is still to be restarted.
    pub(super) fn awaits_a_restart(&self) -> bool {
        self.schedule.remaining().any(|action| matches!(action, ScriptedAction::Restart(_)))
    }

    fn carry_out(&mut self, now: Instant, action: &ScriptedAction) {
        let failed = match action {
            ScriptedAction::Kill(id) => {
                self.killed.insert(*id);
                if let Some(ended) = self.children.kill_one(ProcessRole::Agent, *id) {
                    self.take_leave(now, &ended);
                }
                None
            }
            ScriptedAction::Restart(id) => self.restart(now, *id).err(),
            ScriptedAction::Freeze(id) => {
                self.record_fault(now, &InjectedFault::Failed(*id, FROZEN));
                self.children.freeze(ProcessRole::Standin, *id, true).err()
            }
            ScriptedAction::Thaw(id) => self.children.freeze(ProcessRole::Standin, *id, false).err(),
            ScriptedAction::Order(order) => {
                self.order(now, *order);
                None
            }
            ScriptedAction::Report(_, failed) => {
                failed.iter().for_each(|failed| self.record_fault(now, failed));
                None
            }
        };
        if let Some(error) = failed {
            self.report_news(now, format!("event: {action}: {error}"));
        }
    }

    /// Starts an agent with the same files, which resumes the scenario where the previous one was.
    fn restart(&mut self, now: Instant, id: VehicleId) -> std::io::Result<()> {
        let flown_s = self.ground.since_take_off_s(now, id).unwrap_or_else(|| self.since_zero_s(now));
        self.children.restart(ProcessRole::Agent, id, ["--flown-s".into(), flown_s.to_string().into()])?;
        self.killed.remove(id);
        self.count_in(now, id);
        Ok(())
    }

    /// Gives an order, with a number larger than all that were received or given from here.
    pub(super) fn order(&mut self, now: Instant, OperatorOrder { verb, vehicles }: OperatorOrder) {
        let order = order::new_order(&self.observer, verb);
        let before = self.given.iter().map(|before| before.epoch.saturating_add(1)).max();
        let order = Order { epoch: before.unwrap_or(0).max(order.epoch), vehicles, ..order };
        self.given.merge(order);
        self.orders.push((order, now));
        let given = &self.given;
        self.orders.retain(|(order, _)| given.iter().any(|known| known == *order));
    }

    /// Repeats each order that no newer one has replaced until every vehicle has taken it.
    pub(super) fn repeat_orders(&mut self, now: Instant) {
        let mut due = Vec::new();
        for (order, again) in self.orders.iter_mut().filter(|(_, again)| now >= *again) {
            *again = now.max(*again) + AGAIN;
            due.push(*order);
        }
        for order in due {
            if self.live().all(|(_, seen)| seen.is_some_and(|seen| seen.orders.contain(&order))) {
                continue;
            }
            if self.observer.order(&order).is_err() && self.stage == Stage::Landing {
                // The other way to end the flight: each agent lands before it ends.
                self.children.ask_agents_to_end();
            }
        }
    }
}
