//! The faults and orders that a scenario schedules, and the faults that were really injected into a swarm.
//!
//! Flights, studies, figures, recordings and reports share these types.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;

use schemars::JsonSchema;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::Verb;
use skein_common::scenario::{EventAction, Fault, ScriptedEvent, ScriptedVerb};
use skein_core::impairments::{delays, lasting, silences, union};

/// The scenario's name of a failure, such as `engine_out`.
// An alias, because serde would borrow a field of type `&'static str` from its input, and could then not read it back.
pub type FailureName = &'static str;

/// A fault that was injected into the swarm, whether an agent noticed it or not.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum InjectedFault {
    /// A vehicle's agent ended without a message. The helicopter flies on with its last controls.
    Died(VehicleId),
    /// A vehicle's agent started again, in the air or on the ground.
    Restarted(VehicleId),
    /// A part of a vehicle failed, under the scenario's name of the failure.
    Failed(VehicleId, #[serde(deserialize_with = "deserialize_failure")] FailureName),
    /// Links that carry no messages from now on, each in one direction.
    Cut {
        /// Sender and receiver.
        links: Vec<(VehicleId, VehicleId)>,
    },
    /// Links that carry messages again, each in one direction; sessions may take a while longer.
    Healed {
        /// Sender and receiver.
        links: Vec<(VehicleId, VehicleId)>,
    },
    /// Links on which messages take longer from now on, each in one direction.
    Delayed {
        /// Sender and receiver.
        links: Vec<(VehicleId, VehicleId)>,
    },
    /// Links on which an added delay has ended, each in one direction.
    DelayOver {
        /// Sender and receiver.
        links: Vec<(VehicleId, VehicleId)>,
    },
}

impl fmt::Display for InjectedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |links: &[(VehicleId, VehicleId)]| {
            let link = |(sender, receiver): &(VehicleId, VehicleId)| format!("{sender} to {receiver}");
            links.iter().map(link).collect::<Vec<_>>().join(", ")
        };
        match self {
            Self::Died(id) => write!(f, "the agent of vehicle {id} ended"),
            Self::Restarted(id) => write!(f, "vehicle {id} has a new agent"),
            Self::Failed(id, what) => write!(f, "{what} of vehicle {id}"),
            Self::Cut { links } => write!(f, "cut: vehicle {}", list(links)),
            Self::Healed { links } => write!(f, "healed: vehicle {}", list(links)),
            Self::Delayed { links } => write!(f, "delayed: vehicle {}", list(links)),
            Self::DelayOver { links } => write!(f, "delay over: vehicle {}", list(links)),
        }
    }
}

/// Entries that become due one after the other, each at its time.
#[derive(Debug)]
pub struct Schedule<T> {
    /// The entries that are not due yet, the latest first.
    remaining: Vec<(f64, T)>,
}

impl<T> Schedule<T> {
    /// A schedule of these entries, each with its time, s. An entry at an infinite time is dropped.
    pub fn new(mut entries: Vec<(f64, T)>) -> Self {
        // The end of a fault without an end is at infinity: it never comes.
        entries.retain(|(at_s, _)| at_s.is_finite());
        entries.sort_by(|(one_s, _), (other_s, _)| one_s.total_cmp(other_s));
        entries.reverse();
        Self { remaining: entries }
    }

    /// Takes the next entry that is due at `t_s`, s.
    pub fn due(&mut self, t_s: f64) -> Option<T> {
        self.remaining.pop_if(|(at_s, _)| *at_s <= t_s).map(|(_, what)| what)
    }

    /// The entries that are not due yet, the latest first.
    pub fn remaining(&self) -> impl Iterator<Item = &T> {
        self.remaining.iter().map(|(_, what)| what)
    }
}

/// A change that the scenario makes to one direction of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LinkChange {
    /// Messages pass again after a cut.
    Healed,
    /// No message passes from now on.
    Cut,
    /// An added delay has ended.
    DelayOver,
    /// Messages take longer from now on.
    Delayed,
}

impl LinkChange {
    fn fault(self, links: Vec<(VehicleId, VehicleId)>) -> InjectedFault {
        match self {
            Self::Healed => InjectedFault::Healed { links },
            Self::Cut => InjectedFault::Cut { links },
            Self::DelayOver => InjectedFault::DelayOver { links },
            Self::Delayed => InjectedFault::Delayed { links },
        }
    }
}

/// The changes of links at one instant, grouped by kind.
#[derive(Debug, Default)]
pub struct LinkChanges(BTreeMap<LinkChange, Vec<(VehicleId, VehicleId)>>);

impl LinkChanges {
    /// Adds a change of one direction of a link; `link` is its sender and receiver.
    pub fn add(&mut self, change: LinkChange, link: (VehicleId, VehicleId)) {
        self.0.entry(change).or_default().push(link);
    }

    /// One injected fault for each kind of change, ends before beginnings.
    pub fn faults(self) -> impl Iterator<Item = InjectedFault> {
        self.0.into_iter().map(|(change, links)| change.fault(links))
    }
}

/// The changes that the scenario makes to the link from `sender` to `receiver`, each at its time, s after the
/// receiver's take-off. The time of a change that never comes is infinite.
pub fn link_changes(events: &[ScriptedEvent], sender: VehicleId, receiver: VehicleId) -> Vec<(f64, LinkChange)> {
    let cuts = silences(events, sender, receiver).into_iter();
    let cuts = cuts.flat_map(|lasts| [(lasts.start, LinkChange::Cut), (lasts.end, LinkChange::Healed)]);
    let delays = union(delays(events, sender, receiver).into_iter().map(|(lasts, _)| lasts)).into_iter();
    let delays = delays.flat_map(|lasts| [(lasts.start, LinkChange::Delayed), (lasts.end, LinkChange::DelayOver)]);
    cuts.chain(delays).collect()
}

/// The spans in which this fault lasts, s after the take-off from which its time counts.
pub fn spans(events: &[ScriptedEvent], fault: &Fault) -> Vec<Range<f64>> {
    let its = events.iter().filter(|event| matches!(&event.what, EventAction::Fault(other) if other == fault));
    union(its.map(lasting))
}

/// An order of the scenario's operator: the action, and the vehicles that it names; `None` for the whole swarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OperatorOrder {
    /// The action.
    pub verb: Verb,
    /// The vehicles that the order names.
    pub vehicles: Option<VehicleSet>,
}

/// The operator's orders, each at its time, s after the first take-off. An order that lasts for a time ends with a `goto`
/// to the same vehicles; one without a duration has no end.
pub fn orders(events: &[ScriptedEvent]) -> Vec<(f64, OperatorOrder)> {
    let orders = events.iter().filter_map(|event| match &event.what {
        EventAction::Order(order) => {
            let vehicles = order.vehicles.as_ref().map(|ids| ids.iter().copied().collect());
            let given = |verb| OperatorOrder { verb, vehicles };
            Some([(event.at_s, given(verb(order.verb))), (lasting(event).end, given(Verb::Goto(0)))])
        }
        EventAction::Fault(_) => None,
    });
    orders.flatten().collect()
}

/// The scenario's name of a simulator that freezes.
pub const FROZEN: FailureName = "simulator_freeze";
/// The scenario's names of all failures of a vehicle.
const FAILURES: [FailureName; 6] = ["engine_out", FROZEN, "servo_stuck", "gyro_off", "gps_frozen", "clock_jump"];

/// Deserialises the name of a failure.
fn deserialize_failure<'de, D: Deserializer<'de>>(from: D) -> Result<FailureName, D::Error> {
    let name = Cow::<str>::deserialize(from)?;
    let known = FAILURES.into_iter().find(|known| *known == name);
    known.ok_or_else(|| D::Error::custom(format!("unknown failure {name:?}")))
}

/// The vehicle that fails by this fault and the scenario's name of the failure; `None` if the fault is not a failure.
pub fn failure_of(fault: &Fault) -> Option<(VehicleId, FailureName)> {
    let name = match fault {
        Fault::EngineOut { .. } => "engine_out",
        Fault::SimulatorFreeze { .. } => FROZEN,
        Fault::ServoStuck { .. } => "servo_stuck",
        Fault::GyroOff { .. } => "gyro_off",
        Fault::GpsFrozen { .. } => "gps_frozen",
        Fault::ClockJump { .. } => "clock_jump",
        Fault::Kill { .. } | Fault::KillControl | Fault::Isolate { .. } | Fault::Cut { .. } | Fault::Delay { .. } => {
            return None;
        }
    };
    Some((fault.vehicle()?, name))
}

fn verb(order: ScriptedVerb) -> Verb {
    match order {
        ScriptedVerb::Hold => Verb::Hold,
        ScriptedVerb::Goto { step } => Verb::Goto(u32::try_from(step).unwrap_or(u32::MAX)),
        ScriptedVerb::Land => Verb::Land,
        ScriptedVerb::Abort => Verb::Abort,
        ScriptedVerb::Release => Verb::Release,
        ScriptedVerb::Set(setting) => Verb::Set(setting),
    }
}

/// Describes the fault in a line of text, with the vehicles that it affects.
pub fn describe(fault: &Fault) -> String {
    let list = |ids: &[VehicleId]| ids.iter().map(VehicleId::to_string).collect::<Vec<_>>().join(", ");
    let ways = |both_ways: bool| if both_ways { "both ways" } else { "one way" };
    match fault {
        Fault::Kill { vehicle } => format!("kill of vehicle {vehicle}"),
        Fault::Cut { from, to, both_ways } => {
            format!("cut from vehicle {} to vehicle {}, {}", list(from), list(to), ways(*both_ways))
        }
        Fault::Delay { from, to, both_ways, delay_s } => {
            format!("delay of {delay_s} s from vehicle {} to vehicle {}, {}", list(from), list(to), ways(*both_ways))
        }
        Fault::ServoStuck { vehicle, servo } => {
            format!("servo_stuck ({}) of vehicle {vehicle}", format!("{servo:?}").to_lowercase())
        }
        Fault::ClockJump { vehicle, by_s } => format!("clock_jump of vehicle {vehicle} by {by_s} s"),
        Fault::EngineOut { vehicle }
        | Fault::SimulatorFreeze { vehicle }
        | Fault::GyroOff { vehicle }
        | Fault::GpsFrozen { vehicle } => {
            format!("{} of vehicle {vehicle}", failure_of(fault).map_or("failure", |(_, name)| name))
        }
        Fault::KillControl => "kill_control".to_owned(),
        Fault::Isolate { both_ways: false } => "isolate: the team receives nothing of the others".to_owned(),
        Fault::Isolate { both_ways: true } => {
            "isolate: the team and the others receive nothing of each other".to_owned()
        }
    }
}
