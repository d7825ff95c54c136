//! The scenario's events that the launcher performs: it kills, restarts and freezes processes and gives orders. The
//! agents themselves produce the faults of links and of plants inside them.

use std::fmt;
use std::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::{EventAction, Fault, PlantKind, PlayedFailures, Scenario, ScriptedEvent};
use skein_core::impairments::{lasting, union};

use skein_cluster::os;
use skein_lab::faults::{InjectedFault, OperatorOrder, Schedule, describe, failure_of, orders, spans};

/// An action of the launcher, or an event to report.
#[derive(Clone, Debug, PartialEq)]
pub enum ScriptedAction {
    /// End this vehicle's agent at once.
    Kill(VehicleId),
    /// Give it an agent again.
    Restart(VehicleId),
    /// Stop its stand-in.
    Freeze(VehicleId),
    /// Resume its stand-in.
    Thaw(VehicleId),
    /// Give an order.
    Order(OperatorOrder),
    /// Report an event that an agent performs: its text, and the fault that it injects.
    Report(String, Option<InjectedFault>),
}

impl fmt::Display for ScriptedAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kill(id) => write!(f, "kills vehicle {id}"),
            Self::Restart(id) => write!(f, "restarts vehicle {id}"),
            Self::Freeze(id) => write!(f, "freezes the simulator of vehicle {id}"),
            Self::Thaw(id) => write!(f, "resumes the simulator of vehicle {id}"),
            Self::Order(OperatorOrder { verb, vehicles: Some(vehicles) }) => {
                write!(f, "orders {verb}, vehicle {vehicles}")
            }
            Self::Order(OperatorOrder { verb, vehicles: None }) => write!(f, "orders {verb}"),
            Self::Report(what, _) => f.write_str(what),
        }
    }
}

/// The process that plays the fault of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Player {
    Launcher,
    Agent,
    /// None: a flight in real time cannot produce it, for this reason.
    Unsupported(&'static str),
    /// None: the plant cannot simulate it.
    UnknownToPlant,
}

impl Player {
    fn of(fault: &Fault, plant: PlantKind) -> Self {
        match (fault, plant.spec().failures) {
            (Fault::Kill { .. }, _) => Self::Launcher,
            (Fault::Cut { .. } | Fault::Delay { .. }, _) => Self::Agent,
            (Fault::ClockJump { .. }, _) => Self::Unsupported("agents in real time use a clock that cannot be set"),
            (Fault::KillControl, _) => Self::Unsupported("only a study has a central controller"),
            // A live agent publishes each state once, for its own team and for the others.
            (Fault::Isolate { .. }, _) => Self::Unsupported("only a study can withhold states from other teams alone"),
            (_, PlayedFailures::All) => Self::Agent,
            (Fault::SimulatorFreeze { .. }, PlayedFailures::Freeze) if os::CAN_FREEZE => Self::Launcher,
            _ => Self::UnknownToPlant,
        }
    }
}

/// Everything that `fly` does or reports, in order of time. The times count from the beginning of the flight's window.
pub(super) fn schedule(scenario: &Scenario) -> Schedule<ScriptedAction> {
    let events = &scenario.mission.events;
    let mut actions: Vec<_> =
        orders(events).into_iter().map(|(at_s, order)| (at_s, ScriptedAction::Order(order))).collect();
    let mut span = |Range { start, end }: Range<f64>, from, until| actions.extend([(start, from), (end, until)]);
    for id in scenario.ids() {
        let kills = spans(events, &Fault::Kill { vehicle: id });
        kills.into_iter().for_each(|dead| span(dead, ScriptedAction::Kill(id), ScriptedAction::Restart(id)));
        let is_its = |fault: &Fault| *fault == Fault::SimulatorFreeze { vehicle: id };
        let frozen = faults(scenario).filter(|(_, fault, player)| *player == Player::Launcher && is_its(fault));
        let frozen = union(frozen.map(|(event, ..)| lasting(event)));
        frozen.into_iter().for_each(|frozen| span(frozen, ScriptedAction::Freeze(id), ScriptedAction::Thaw(id)));
    }
    for (event, fault, _) in faults(scenario).filter(|(.., player)| *player == Player::Agent) {
        let what = describe(fault);
        let failed = failure_of(fault).map(|(id, message)| InjectedFault::Failed(id, message));
        span(
            lasting(event),
            ScriptedAction::Report(what.clone(), failed),
            ScriptedAction::Report(format!("{what}: over"), None),
        );
    }
    Schedule::new(actions)
}

/// Events that `fly` cannot produce on the scenario's plant, a sentence each.
pub fn skipped(scenario: &Scenario) -> Vec<String> {
    let plant = scenario.swarm.plant.spec().title;
    let sentence = |(event, fault, player): (&ScriptedEvent, &Fault, Player)| {
        let why = match player {
            Player::Launcher | Player::Agent => return None,
            Player::Unsupported(why) => why.to_owned(),
            Player::UnknownToPlant => format!("{plant} cannot simulate this failure"),
        };
        Some(format!("at {} s: {}: skipped by `fly`: {why}", event.at_s, describe(fault)))
    };
    faults(scenario).filter_map(sentence).collect()
}

/// The faults among the scenario's events, with the process that plays each.
fn faults(scenario: &Scenario) -> impl Iterator<Item = (&ScriptedEvent, &Fault, Player)> {
    scenario.mission.events.iter().filter_map(move |event| match &event.what {
        EventAction::Fault(fault) => Some((event, fault, Player::of(fault, scenario.swarm.plant))),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use skein_lab::scenario::ScenarioArgs;

    const EVENTS: &str = r#"mission.events=[
        { at_s = 60, fault = "kill", vehicle = 3, for_s = 20 },
        { at_s = 70, fault = "kill", vehicle = 3, for_s = 30 },
        { at_s = 90, fault = "kill", vehicle = 1 },
        { at_s = 50, fault = "cut", from = [1, 2], to = [3, 4], both_ways = true, for_s = 20 },
        { at_s = 10, fault = "simulator_freeze", vehicle = 2, for_s = 1.5 },
        { at_s = 20, fault = "engine_out", vehicle = 2 },
        { at_s = 30, fault = "clock_jump", vehicle = 4, by_s = -5 },
        { at_s = 55, order = "hold", for_s = 15 },
        { at_s = 200, order = "land" },
    ]"#;

    fn scenario(plant: &str) -> Scenario {
        let sets = vec![EVENTS.replace('\n', " "), format!("swarm.plant={plant}")];
        ScenarioArgs::default().read(sets).unwrap().scenario
    }

    fn reported(plant: &str) -> Vec<(f64, String)> {
        let mut schedule = schedule(&scenario(plant));
        let mut reported = Vec::new();
        for at_s in (0..600).map(|half_seconds| f64::from(half_seconds) / 2.0) {
            while let Some(action) = schedule.due(at_s) {
                reported.push((at_s, action.to_string()));
            }
        }
        reported
    }

    #[test]
    fn the_launcher_performs_its_events_and_reports_the_others() {
        let cut = "cut from vehicle 1, 2 to vehicle 3, 4, both ways";
        let always = [
            (50.0, cut),
            (55.0, "orders hold"),
            (60.0, "kills vehicle 3"),
            (70.0, "orders goto 0"),
            (70.0, &format!("{cut}: over")),
            (90.0, "kills vehicle 1"),
            (100.0, "restarts vehicle 3"),
            (200.0, "orders land"),
        ]
        .map(|(at_s, what)| (at_s, what.to_owned()));
        let with = |first: &[(f64, &str)]| -> Vec<_> {
            let first = first.iter().map(|(at_s, what)| (*at_s, (*what).to_owned()));
            first.chain(always.iter().cloned()).collect()
        };
        let frozen = [(10.0, "freezes the simulator of vehicle 2"), (11.5, "resumes the simulator of vehicle 2")];
        let inside = [
            (10.0, "simulator_freeze of vehicle 2"),
            (11.5, "simulator_freeze of vehicle 2: over"),
            (20.0, "engine_out of vehicle 2"),
        ];
        assert_eq!(reported("builtin"), with(&inside));
        assert_eq!(reported("standin"), with(if os::CAN_FREEZE { &frozen } else { &[] }));
        assert_eq!(reported("xplane"), with(&[]));
    }

    #[test]
    fn every_skipped_event_is_reported_once() {
        let clock = "at 30 s: clock_jump of vehicle 4 by -5 s: skipped by `fly`: agents in real time use a clock that \
                     cannot be set";
        assert_eq!(skipped(&scenario("builtin")), [clock]);
        let engine =
            |plant| format!("at 20 s: engine_out of vehicle 2: skipped by `fly`: {plant} cannot simulate this failure");
        let standin = skipped(&scenario("standin"));
        assert_eq!(standin[standin.len() - 2..], [engine("the stand-in"), clock.to_owned()]);
        assert_eq!(standin.len(), if os::CAN_FREEZE { 2 } else { 3 });
        assert_eq!(skipped(&scenario("xplane"))[1], engine("X-Plane"));
        assert_eq!(skipped(&scenario("xplane")).len(), 3);
    }
}
