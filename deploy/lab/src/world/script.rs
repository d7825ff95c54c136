//! What the scenario does to each vehicle of a world, and what its operator orders.

use std::ops::Range;

use skein_common::id::VehicleId;
use skein_common::message::{Order, Verb};
use skein_common::scenario::{Event, EventAction, Fault, Scenario};
use skein_core::impairments::lasting;

use crate::faults::{Agenda, LinkChange, failing, kills, link_changes, orders};

/// Between two sayings of an order, s.
const REPEAT_S: f64 = 0.2;
/// The operator's number.
const ISSUER: u64 = 1;

/// What is done to one vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Deed {
    /// Its agent ends.
    Kill,
    /// Its agent begins a new life.
    Restart,
    /// Something of it fails; the plant's script knows what that means.
    Fail(&'static str),
    /// Its clock jumps, s.
    Jump(f64),
    /// A direction of a link changes: from this vehicle to it.
    Link(LinkChange, VehicleId),
}

/// What is done to vehicle `own`, s after its take-off.
pub(super) fn deeds(scenario: &Scenario, own: VehicleId) -> Agenda<Deed> {
    let events = &scenario.mission.events;
    let mut deeds: Vec<_> = events.iter().flat_map(|event| faults(event, own)).collect();
    let mut span = |from, until, lasts: Range<f64>| deeds.extend([(lasts.start, from), (lasts.end, until)]);
    kills(events, own).into_iter().for_each(|dead| span(Deed::Kill, Deed::Restart, dead));
    for speaker in scenario.ids() {
        let changes = link_changes(events, speaker, own).into_iter();
        deeds.extend(changes.map(|(at_s, change)| (at_s, Deed::Link(change, speaker))));
    }
    Agenda::new(deeds)
}

/// What the event does to vehicle `own` besides killing and cutting.
fn faults(event: &Event, own: VehicleId) -> Vec<(f64, Deed)> {
    let EventAction::Fault(fault) = &event.what else { return Vec::new() };
    let Some((vehicle, name)) = failing(fault) else { return Vec::new() };
    let mut deeds = vec![(event.at_s, Deed::Fail(name))];
    if let Fault::ClockJump { by_s, .. } = fault {
        deeds.extend([(event.at_s, Deed::Jump(*by_s)), (lasting(event).end, Deed::Jump(-by_s))]);
    }
    deeds.retain(|_| vehicle == own);
    deeds
}

/// How far the clock of vehicle `own` jumps back in all, s: where it has to begin, or it would come to its zero.
pub(super) fn clock_begins_s(scenario: &Scenario, own: VehicleId) -> f64 {
    let back_s = |event: &Event| match event.what {
        EventAction::Fault(Fault::ClockJump { vehicle, by_s }) if vehicle == own => (-by_s).max(0.0),
        _ => 0.0,
    };
    scenario.mission.events.iter().map(back_s).sum()
}

/// Gives the scenario's orders as an operator does: says the newest until everybody repeats it.
#[derive(Debug)]
pub(super) struct Operator {
    agenda: Agenda<Verb>,
    epoch: u64,
    /// With the time of its next saying, s.
    order: Option<(Order, f64)>,
}

impl Operator {
    pub(super) fn new(scenario: &Scenario) -> Self {
        Self { agenda: Agenda::new(orders(&scenario.mission.events)), epoch: 0, order: None }
    }

    /// What the operator says at `t_s`; `has_taken_all` tells whether everybody repeats an order.
    pub(super) fn says(&mut self, t_s: f64, has_taken_all: impl Fn(&Order) -> bool) -> Option<Order> {
        while let Some(verb) = self.agenda.due(t_s) {
            self.epoch += 1;
            self.order = Some((Order { epoch: self.epoch, issuer: ISSUER, verb, seal: None }, t_s));
        }
        self.order = self.order.filter(|(order, _)| !has_taken_all(order));
        let (order, next_s) = self.order.as_mut().filter(|(_, next_s)| *next_s <= t_s)?;
        *next_s += REPEAT_S;
        Some(*order)
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    fn scenario(events: &str) -> Scenario {
        let text = format!("swarm.vehicles = 3\n[mission]\nsteps = [{{ centre_ne_m = [0, 0] }}]\nevents = [{events}]");
        load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario
    }

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    /// What is done to vehicle `own`, looked at once a second.
    fn done(events: &str, own: u8) -> Vec<(u32, Deed)> {
        let mut deeds = deeds(&scenario(events), id(own));
        (0..100)
            .flat_map(|t_s| std::iter::from_fn(|| deeds.due(t_s.into()).map(|deed| (t_s, deed))).collect::<Vec<_>>())
            .collect()
    }

    #[test]
    fn everybody_has_what_concerns_it_in_the_order_of_time() {
        let events = "{ at_s = 50, for_s = 5, fault = 'kill', vehicle = 2 }, \
                      { at_s = 10, for_s = 5, fault = 'clock_jump', vehicle = 2, by_s = -7 }, \
                      { at_s = 20, for_s = 3, fault = 'cut', from = [1, 2], to = [2, 3] }, \
                      { at_s = 2, fault = 'servo_stuck', vehicle = 1 }";
        let of_2 = [
            (10, Deed::Fail("clock_jump")),
            (10, Deed::Jump(-7.0)),
            (15, Deed::Jump(7.0)),
            (20, Deed::Link(LinkChange::Cut, id(1))),
            (23, Deed::Link(LinkChange::Healed, id(1))),
            (50, Deed::Kill),
            (55, Deed::Restart),
        ];
        assert_eq!(done(events, 2), of_2);
        assert_eq!(done(events, 1), [(2, Deed::Fail("servo_stuck"))]);
        assert_eq!(clock_begins_s(&scenario(events), id(2)), 7.0);
        assert_eq!(clock_begins_s(&scenario(events), id(1)), 0.0);
    }

    #[test]
    fn a_death_within_a_death_is_one() {
        let events =
            "{ at_s = 10, for_s = 20, fault = 'kill', vehicle = 1 }, { at_s = 20, fault = 'kill', vehicle = 1 }";
        assert_eq!(done(events, 1), [(10, Deed::Kill)]);
    }

    #[test]
    fn the_operator_repeats_an_order_until_everybody_has_it_and_ends_a_hold() {
        let events = "{ at_s = 1, for_s = 2, order = 'hold' }, { at_s = 5, order = 'goto', step = 0 }";
        let mut operator = Operator::new(&scenario(events));
        let order = |epoch, verb| Order { epoch, issuer: ISSUER, verb, seal: None };
        assert_eq!(operator.says(0.9, |_| true), None);
        for t_s in [1.0, 1.2] {
            assert_eq!(operator.says(t_s, |_| false), Some(order(1, Verb::Hold)));
            assert_eq!(operator.says(t_s + 0.1, |_| false), None);
        }
        assert_eq!(operator.says(1.5, |said| *said == order(1, Verb::Hold)), None);
        assert_eq!(operator.says(2.9, |_| false), None, "everybody had it");
        assert_eq!(operator.says(3.0, |_| false), Some(order(2, Verb::Goto(0))));
        assert_eq!(operator.says(5.0, |_| false), Some(order(3, Verb::Goto(0))), "the newest only");
    }
}
