//! The scripted actions of a scenario on each vehicle of a world, and the orders of its operator.

use skein_common::id::VehicleId;
use skein_common::message::{Order, StandingOrders};
use skein_common::scenario::{EventAction, Fault, Scenario, ScriptedEvent};
use skein_core::impairments::lasting;

use crate::faults::{LinkChange, OperatorOrder, Schedule, failure_of, link_changes, orders, spans};

/// Time between two transmissions of an order, s.
const RESEND_PERIOD_S: f64 = 0.2;
/// Number of the operator in its orders.
const ISSUER: u64 = 1;

/// An action of the scenario on one vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ScriptedAction {
    /// The vehicle's agent ends.
    Kill,
    /// The vehicle's agent starts again.
    Restart,
    /// A part of the vehicle fails; the plant's script carries it out.
    Fail(&'static str),
    /// The link from this sender to the vehicle changes.
    Link(LinkChange, VehicleId),
}

/// The schedule of actions on vehicle `own`, s after its take-off.
pub(super) fn actions(scenario: &Scenario, own: VehicleId) -> Schedule<ScriptedAction> {
    let events = &scenario.mission.events;
    let mut actions: Vec<_> = events.iter().filter_map(|event| failure(event, own)).collect();
    actions.extend(outages(events, &Fault::Kill { vehicle: own }));
    for sender in scenario.ids() {
        let changes = link_changes(events, sender, own).into_iter();
        actions.extend(changes.map(|(at_s, change)| (at_s, ScriptedAction::Link(change, sender))));
    }
    Schedule::new(actions)
}

/// The ends and restarts of agents by this fault, each at its time, s.
pub(super) fn outages(events: &[ScriptedEvent], fault: &Fault) -> impl Iterator<Item = (f64, ScriptedAction)> {
    let dead = spans(events, fault).into_iter();
    dead.flat_map(|dead| [(dead.start, ScriptedAction::Kill), (dead.end, ScriptedAction::Restart)])
}

/// The failure that the event causes on vehicle `own`.
fn failure(event: &ScriptedEvent, own: VehicleId) -> Option<(f64, ScriptedAction)> {
    let EventAction::Fault(fault) = &event.what else { return None };
    let (_, name) = failure_of(fault).filter(|(vehicle, _)| *vehicle == own)?;
    Some((event.at_s, ScriptedAction::Fail(name)))
}

/// The events in which vehicle `own`'s clock jumps, each with the size of the jump, s.
fn jumps(scenario: &Scenario, own: VehicleId) -> impl Iterator<Item = (&ScriptedEvent, f64)> {
    scenario.mission.events.iter().filter_map(move |event| match event.what {
        EventAction::Fault(Fault::ClockJump { vehicle, by_s }) if vehicle == own => Some((event, by_s)),
        _ => None,
    })
}

/// The schedule of the jumps of vehicle `own`'s clock, s after its take-off, each with its size, s.
pub(super) fn clock_jumps(scenario: &Scenario, own: VehicleId) -> Schedule<f64> {
    let there_and_back = |(event, by_s): (&ScriptedEvent, f64)| [(event.at_s, by_s), (lasting(event).end, -by_s)];
    Schedule::new(jumps(scenario, own).flat_map(there_and_back).collect())
}

/// Total backward jump of vehicle `own`'s clock, s. The clock starts at this time, or it would become negative.
pub(super) fn clock_begins_s(scenario: &Scenario, own: VehicleId) -> f64 {
    jumps(scenario, own).map(|(_, by_s)| (-by_s).max(0.0)).sum()
}

/// Sends the scenario's orders as an operator does: each until all agents acknowledge it or newer orders replace it.
#[derive(Debug)]
pub(super) struct Operator {
    schedule: Schedule<OperatorOrder>,
    epoch: u64,
    given: StandingOrders,
    /// The orders that are not acknowledged yet, each with the time of its next transmission, s.
    waiting: Vec<(Order, f64)>,
}

impl Operator {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let (schedule, given) = (Schedule::new(orders(&scenario.mission.events)), StandingOrders::default());
        Self { schedule, epoch: 0, given, waiting: Vec::new() }
    }

    /// The orders that the operator sends at `t_s`, s; `all_acknowledge` returns whether every agent knows an order.
    pub(super) fn orders_to_send(&mut self, t_s: f64, all_acknowledge: impl Fn(&Order) -> bool) -> Vec<Order> {
        while let Some(OperatorOrder { verb, vehicles }) = self.schedule.due(t_s) {
            self.epoch += 1;
            let order = Order { epoch: self.epoch, issuer: ISSUER, verb, vehicles, signature: None };
            self.given.merge(order);
            self.waiting.push((order, t_s));
        }
        let given = &self.given;
        self.waiting.retain(|(order, _)| given.iter().any(|known| known == *order) && !all_acknowledge(order));
        let due = self.waiting.iter_mut().filter(|(_, next_s)| *next_s <= t_s);
        due.map(|(order, next_s)| {
            *next_s += RESEND_PERIOD_S;
            *order
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use skein_common::message::Verb;
    use skein_common::scenario::{Source, load};

    use super::*;

    fn scenario(events: &str) -> Scenario {
        let text = format!("swarm.vehicles = 3\n[mission]\nsteps = [{{ centre_ne_m = [0, 0] }}]\nevents = [{events}]");
        load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario
    }

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    /// The actions on vehicle `own`, polled once a second.
    fn done(events: &str, own: u8) -> Vec<(u32, ScriptedAction)> {
        let mut actions = actions(&scenario(events), id(own));
        (0..100)
            .flat_map(|t_s| {
                std::iter::from_fn(|| actions.due(t_s.into()).map(|action| (t_s, action))).collect::<Vec<_>>()
            })
            .collect()
    }

    #[test]
    fn each_vehicle_gets_its_own_actions_in_the_order_of_time() {
        let events = "{ at_s = 50, for_s = 5, fault = 'kill', vehicle = 2 }, \
                      { at_s = 10, for_s = 5, fault = 'clock_jump', vehicle = 2, by_s = -7 }, \
                      { at_s = 20, for_s = 3, fault = 'cut', from = [1, 2], to = [2, 3] }, \
                      { at_s = 2, fault = 'servo_stuck', vehicle = 1 }";
        let of_2 = [
            (10, ScriptedAction::Fail("clock_jump")),
            (20, ScriptedAction::Link(LinkChange::Cut, id(1))),
            (23, ScriptedAction::Link(LinkChange::Healed, id(1))),
            (50, ScriptedAction::Kill),
            (55, ScriptedAction::Restart),
        ];
        assert_eq!(done(events, 2), of_2);
        assert_eq!(done(events, 1), [(2, ScriptedAction::Fail("servo_stuck"))]);
        let mut jumps = clock_jumps(&scenario(events), id(2));
        assert_eq!([9.9, 10.0, 10.1, 14.9, 15.0].map(|t_s| jumps.due(t_s)), [None, Some(-7.0), None, None, Some(7.0)]);
        let mut of_1 = clock_jumps(&scenario(events), id(1));
        assert_eq!([jumps.due(100.0), of_1.due(100.0)], [None, None]);
        assert_eq!(clock_begins_s(&scenario(events), id(2)), 7.0);
        assert_eq!(clock_begins_s(&scenario(events), id(1)), 0.0);
    }

    #[test]
    fn overlapping_kills_of_an_agent_are_one_kill() {
        let events =
            "{ at_s = 10, for_s = 20, fault = 'kill', vehicle = 1 }, { at_s = 20, fault = 'kill', vehicle = 1 }";
        assert_eq!(done(events, 1), [(10, ScriptedAction::Kill)]);
    }

    #[test]
    fn the_operator_repeats_an_order_until_all_acknowledge_it_and_ends_a_hold() {
        let events = "{ at_s = 1, for_s = 2, order = 'hold' }, { at_s = 5, order = 'goto', step = 0 }, \
                      { at_s = 5, order = 'release', vehicles = [3] }";
        let mut operator = Operator::new(&scenario(events));
        let order = |epoch, verb| Order { epoch, issuer: ISSUER, verb, vehicles: None, signature: None };
        assert_eq!(operator.orders_to_send(0.9, |_| true), []);
        for t_s in [1.0, 1.2] {
            assert_eq!(operator.orders_to_send(t_s, |_| false), [order(1, Verb::Hold)]);
            assert_eq!(operator.orders_to_send(t_s + 0.1, |_| false), []);
        }
        assert_eq!(operator.orders_to_send(1.5, |newest| *newest == order(1, Verb::Hold)), []);
        assert_eq!(operator.orders_to_send(2.9, |_| false), [], "all agents had acknowledged it");
        assert_eq!(operator.orders_to_send(3.0, |_| false), [order(2, Verb::Goto(0))]);
        let release = Order { vehicles: Some([id(3)].into_iter().collect()), ..order(4, Verb::Release) };
        let newest = [order(3, Verb::Goto(0)), release];
        assert_eq!(operator.orders_to_send(5.0, |_| false), newest, "the newest of the swarm and of each vehicle");
    }
}
