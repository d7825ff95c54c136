//! What `fly` itself does to the swarm: the scenario's events, and orders.

use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::message::{Heartbeat, Order, Verb};

use super::Flight;
use crate::fly::children::ProcessRole;
use crate::fly::script::ScriptedAction;
use crate::fly::status::Stage;
use crate::order;
use skein_lab::faults::FROZEN;
use skein_lab::faults::InjectedFault;

/// Between two sayings of an order.
const AGAIN: Duration = Duration::from_millis(200);

/// An order under way, with the time of its next saying.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnderWay {
    order: Order,
    again: Instant,
}

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
            ScriptedAction::Order(verb) => {
                self.order(now, *verb);
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
    pub(super) fn order(&mut self, now: Instant, verb: Verb) {
        let order = order::new_order(&self.observer, verb);
        let epoch = self.order.map_or(0, |before| before.order.epoch.saturating_add(1)).max(order.epoch);
        self.order = Some(UnderWay { order: Order { epoch, ..order }, again: now });
    }

    /// Repeats the newest order until every vehicle has taken it.
    pub(super) fn repeat_order(&mut self, now: Instant) {
        let Some(UnderWay { order, again }) = self.order.filter(|order| now >= order.again) else { return };
        self.order = Some(UnderWay { order, again: again.max(now) + AGAIN });
        let has_taken = |mission: Heartbeat| mission.order >= Some(order);
        if self.live().all(|(_, seen)| seen.and_then(|seen| seen.mission).is_some_and(has_taken)) {
            return;
        }
        if self.observer.order(&order).is_err() && self.stage == Stage::Landing {
            // The other way to say it: each agent lands before it ends.
            self.children.ask_agents_to_end();
        }
    }
}
