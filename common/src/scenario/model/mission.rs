//! What the swarm does, and what happens to it on the way.

use serde::{Deserialize, Serialize};

use super::Formation;
use crate::id::VehicleId;

/// `[mission]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mission {
    /// Never empty. The last is never left: without a landing there the swarm stays.
    pub steps: Vec<Step>,
    /// What happens to the run, in the file's order.
    pub events: Vec<Event>,
    /// Of a centre on a path, where the step says nothing else.
    pub speed_m_s: f64,
    /// How long "reached" has to hold, where the step says nothing else.
    pub dwell_s: f64,
    /// What a split swarm does.
    pub partition: Partition,
}

/// One step of the mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// For people.
    pub name: Option<String>,
    /// Where to.
    #[serde(flatten)]
    pub target: Target,
    /// How long "reached" has to hold.
    pub dwell_s: f64,
    /// Of the centre on a path.
    pub speed_m_s: f64,
    /// The formation of this step: all of it, `[formation]` with what the step changes.
    pub formation: Formation,
}

/// What a step wants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Target {
    /// The centre is here (north, east); left when everybody has reached it.
    #[serde(rename = "centre_ne_m")]
    Centre([f64; 2]),
    /// The centre stays where the step before left it, `[0, 0]` at first, for this long on each agent's own clock.
    #[serde(rename = "hold_s")]
    Hold(f64),
    /// The centre moves along this line (north, east), two points at least, no two equal in a row.
    #[serde(rename = "path_ne_m")]
    Path(Vec<[f64; 2]>),
    /// Land where they are; always `true`, only as the last step.
    #[serde(rename = "land")]
    Land(bool),
}

/// Something that happens at a set time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Counted from each vehicle's own take-off.
    pub at_s: f64,
    /// Without it, for good.
    pub for_s: Option<f64>,
    /// What happens.
    #[serde(flatten)]
    pub what: What,
}

/// What an event is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum What {
    /// Something breaks.
    Fault(Fault),
    /// Somebody orders.
    Order(Order),
}

/// `fault`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "fault", rename_all = "snake_case")]
pub enum Fault {
    /// The agent's process dies; it is restarted after `for_s`.
    Kill {
        /// Whose.
        vehicle: VehicleId,
    },
    /// The link from some to others is dead.
    Cut {
        /// Speakers.
        from: Vec<VehicleId>,
        /// Hearers.
        to: Vec<VehicleId>,
        /// And the other way round.
        both_ways: bool,
    },
    /// Every message from some to others takes longer.
    Delay {
        /// Senders.
        from: Vec<VehicleId>,
        /// Receivers.
        to: Vec<VehicleId>,
        /// And the other way round.
        both_ways: bool,
        /// By this much, s, on top of what the link takes already.
        delay_s: f64,
    },
    /// No power.
    EngineOut {
        /// Whose.
        vehicle: VehicleId,
    },
    /// No frames from the simulator.
    SimulatorFreeze {
        /// Whose.
        vehicle: VehicleId,
    },
    /// A servo keeps its place.
    ServoStuck {
        /// Whose.
        vehicle: VehicleId,
        /// Which.
        servo: Servo,
    },
    /// The yaw gyro does nothing.
    GyroOff {
        /// Whose.
        vehicle: VehicleId,
    },
    /// The position repeats.
    GpsFrozen {
        /// Whose.
        vehicle: VehicleId,
    },
    /// The machine's clock jumps.
    ClockJump {
        /// Whose.
        vehicle: VehicleId,
        /// Forward, if positive.
        by_s: f64,
    },
    /// The one machine of `control.mode = "central"` dies, and with it everybody's control; it is restarted after `for_s`.
    /// Its time counts from the swarm's first take-off.
    KillControl,
}

/// `servo`
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

/// `order`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "snake_case")]
pub enum Order {
    /// Stay; on after `for_s`.
    Hold,
    /// To this step or a later one.
    Goto {
        /// Counted from 0.
        step: usize,
    },
    /// Land now.
    Land,
    /// Give up.
    Abort,
}

/// `mission.partition`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Partition {
    /// Each part goes on.
    Continue,
    /// Only the larger part goes on.
    Quorum,
}
