//! The mission: its steps, and the scheduled faults and orders.

use serde::{Deserialize, Serialize};

use super::{Formation, Setting};
use crate::id::VehicleId;

/// The mission, `[mission]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mission {
    /// The steps; there is at least one. The swarm stays in the last one, unless that is a landing.
    pub steps: Vec<Step>,
    /// Scheduled faults and orders, in the order of the file.
    pub events: Vec<ScriptedEvent>,
    /// Speed of the centre on a path, m/s, unless the step sets another.
    pub speed_m_s: f64,
    /// Time for which a vehicle has to be in place to report "reached", s, unless the step sets another.
    pub dwell_s: f64,
    /// Time after which a vehicle that comes no nearer to its step leaves and lands, s.
    pub progress_timeout_s: f64,
    /// Behaviour of a swarm that the network splits.
    pub partition: Partition,
}

/// One step of the mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Name of the step for operators.
    pub name: Option<String>,
    /// Goal of the step.
    #[serde(flatten)]
    pub target: Target,
    /// Time for which a vehicle has to be in place to report "reached", s.
    pub dwell_s: f64,
    /// Speed of the centre on a path, m/s.
    pub speed_m_s: f64,
    /// The complete formation of this step: `[formation]` with the changes of the step.
    pub formation: Formation,
}

/// Goal of a step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Target {
    /// The centre is here (north, east, m). The step ends when every active member has reached its place.
    #[serde(rename = "centre_ne_m")]
    Centre([f64; 2]),
    /// The centre stays where the step before left it (`[0, 0]` at first) for this time on each agent's own clock, s.
    #[serde(rename = "hold_s")]
    Hold(f64),
    /// The centre moves along this line (north, east, m) of at least two points; two points in a row are never equal.
    #[serde(rename = "path_ne_m")]
    Path(Vec<[f64; 2]>),
    /// Each vehicle lands where it is. Always `true`; only the last step.
    #[serde(rename = "land")]
    Land(bool),
}

/// A fault or an order at a scheduled time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScriptedEvent {
    /// Time of the event, s, counted from each vehicle's own take-off.
    pub at_s: f64,
    /// Duration, s; `None`: until the end.
    pub for_s: Option<f64>,
    /// The fault or the order.
    #[serde(flatten)]
    pub what: EventAction,
}

/// Fault or order of an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum EventAction {
    /// A fault is injected.
    Fault(Fault),
    /// An order is given.
    Order(ScriptedOrder),
}

/// Kind of an injected fault, `fault`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "fault", rename_all = "snake_case")]
pub enum Fault {
    /// The agent's process is killed; it is restarted after `for_s`.
    Kill {
        /// The vehicle that the fault affects.
        vehicle: VehicleId,
    },
    /// The links from some vehicles to others carry no messages.
    Cut {
        /// Senders.
        from: Vec<VehicleId>,
        /// Receivers.
        to: Vec<VehicleId>,
        /// Whether the opposite direction is affected too.
        both_ways: bool,
    },
    /// The messages from some vehicles to others are delayed.
    Delay {
        /// Senders.
        from: Vec<VehicleId>,
        /// Receivers.
        to: Vec<VehicleId>,
        /// Whether the opposite direction is affected too.
        both_ways: bool,
        /// Additional delay, s, on top of the delay of the link.
        delay_s: f64,
    },
    /// The engine has no power.
    EngineOut {
        /// The vehicle that the fault affects.
        vehicle: VehicleId,
    },
    /// The simulator sends no frames.
    SimulatorFreeze {
        /// The vehicle that the fault affects.
        vehicle: VehicleId,
    },
    /// A servo keeps its position.
    ServoStuck {
        /// The vehicle that the fault affects.
        vehicle: VehicleId,
        /// The servo.
        servo: Servo,
    },
    /// The yaw gyro has no effect.
    GyroOff {
        /// The vehicle that the fault affects.
        vehicle: VehicleId,
    },
    /// The measured position is frozen.
    GpsFrozen {
        /// The vehicle that the fault affects.
        vehicle: VehicleId,
    },
    /// The clock of the vehicle's computer jumps.
    ClockJump {
        /// The vehicle that the fault affects.
        vehicle: VehicleId,
        /// Size of the jump, s; positive is forward.
        by_s: f64,
    },
    /// The central controller of `control.mode = "central"` is killed, and every vehicle loses control. It is restarted
    /// after `for_s`. The time counts from the swarm's first take-off.
    KillControl,
    /// The team receives no state of the other teams of its fleet, in virtual time. The time counts from the team's first
    /// take-off.
    Isolate {
        /// Whether the other teams receive nothing from this team either.
        both_ways: bool,
    },
}

/// Servo of a fault, `servo`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Servo {
    /// Lateral cyclic.
    Roll,
    /// Longitudinal cyclic.
    Pitch,
    /// Collective.
    Collective,
}

/// A scheduled order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScriptedOrder {
    /// The action.
    #[serde(flatten)]
    pub verb: ScriptedVerb,
    /// The vehicles that the order names; `None` for the whole swarm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vehicles: Option<Vec<VehicleId>>,
}

/// Kind of a scheduled order, `order`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "snake_case")]
pub enum ScriptedVerb {
    /// Hold position; after `for_s` the mission continues.
    Hold,
    /// Continue the mission at this step or a later one.
    Goto {
        /// The step, counted from 0.
        step: usize,
    },
    /// Land at the present position.
    Land,
    /// Abort the mission: land, and ignore all later orders.
    Abort,
    /// Give the controls to human pilots; after `for_s` the agents take them back.
    Release,
    /// Change a key in flight.
    Set(Setting),
}

/// Behaviour of a swarm that the network splits, `mission.partition`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Partition {
    /// Every partition continues the mission.
    Continue,
    /// Only a partition with more than half of the vehicles continues the mission.
    Quorum,
}
