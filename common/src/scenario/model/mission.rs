//! The mission: its steps, and the scheduled faults and orders.

use serde::{Deserialize, Serialize};

use super::super::key::declare::*;
use super::super::key::keys;
use super::{Formation, Setting, TunableKey};
use crate::id::VehicleId;

keys! {
    /// The mission, `[mission]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Mission at "mission." {
        /// The steps; there is at least one. The swarm stays in the last one, unless that is a landing.
        steps: Vec<Step>;
        /// Scheduled faults and orders, in the order of the file.
        events: Vec<ScriptedEvent>;
        speed_m_s: f64 = above_zero(20.0), number(2.0),
            "speed of the centre on a path; without feed-forward vehicles can follow only the 1 m/s of Garcia & Barnes 2010",
            paper(number(1.0));
        dwell_s: f64 = from(0.0, 600.0), number(3.0),
            "how long a vehicle has to be in place before it reports \"reached\", so that flying through the place does not count";
        progress_timeout_s: f64 = from(5.0, 1e6), number(60.0),
            "how long a vehicle may come no nearer to a step that others wait to leave, before it reports so, leaves the swarm and lands";
        partition: Partition = OneOf(&["continue", "quorum"]), text("continue"),
            "what a swarm does when the network splits it: every partition continues the mission, or only one with more than half the vehicles";
    }
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

impl Fault {
    /// The vehicle that the fault affects; `None` if it affects links, the central controller or a team.
    pub fn vehicle(&self) -> Option<VehicleId> {
        match *self {
            Self::Kill { vehicle }
            | Self::EngineOut { vehicle }
            | Self::SimulatorFreeze { vehicle }
            | Self::ServoStuck { vehicle, .. }
            | Self::GyroOff { vehicle }
            | Self::GpsFrozen { vehicle }
            | Self::ClockJump { vehicle, .. } => Some(vehicle),
            Self::Cut { .. } | Self::Delay { .. } | Self::KillControl | Self::Isolate { .. } => None,
        }
    }
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

/// The keys of `mission.steps`.
#[rustfmt::skip]
pub(in crate::scenario) const STEP_KEYS: &[Key] = &[
    Key::new("mission.steps", Tables, as_toml("[{ centre_ne_m = [0.0, 0.0] }]"),
        "steps of the mission, flown one after the other; the swarm stays in the last one. By default it gathers at the origin"),
    Key::new("mission.steps[N].name", Text, Nothing,
        "name of the step for people"),
    Key::new("mission.steps[N].centre_ne_m", Point, Nothing,
        "place of the formation's centre; the step ends when every live vehicle has reached its place"),
    Key::new("mission.steps[N].hold_s", above_zero(1e6), Nothing,
        "stay for this time, measured on each agent's own clock"),
    Key::new("mission.steps[N].path_ne_m", Path, Nothing,
        "line along which the formation's centre moves"),
    Key::new("mission.steps[N].land", True, Nothing,
        "land each vehicle where it is; only in the last step"),
    Key::new("mission.steps[N].dwell_s", from(0.0, 600.0), Same("mission.dwell_s"),
        "mission.dwell_s for this step"),
    Key::new("mission.steps[N].speed_m_s", above_zero(20.0), Same("mission.speed_m_s"),
        "mission.speed_m_s for this step"),
];

/// The keys of `mission.events`.
#[rustfmt::skip]
pub(in crate::scenario) const EVENT_KEYS: &[Key] = &[
    Key::new("mission.events", Tables, Nothing,
        "scheduled faults and orders; by default nothing happens"),
    Key::new("mission.events[N].at_s", from(0.0, 1e6), Required,
        "when it happens, counted from each vehicle's own take-off"),
    Key::new("mission.events[N].for_s", above_zero(1e6), Nothing,
        "how long it lasts; without it, to the end"),
    Key::new("mission.events[N].fault", OneOf(FAULTS), Nothing,
        "fault to inject; an event has this or order"),
    Key::new("mission.events[N].order", OneOf(ORDERS), Nothing,
        "order to give; an event has this or fault"),
    Key::new("mission.events[N].vehicle", Id, Nothing,
        "vehicle that the fault affects"),
    Key::new("mission.events[N].from", Ids, Nothing,
        "senders of a cut or delayed link"),
    Key::new("mission.events[N].to", Ids, Nothing,
        "receivers of a cut or delayed link"),
    Key::new("mission.events[N].both_ways", Bool, flag(false),
        "the fault affects the other direction too; a radio often fails in one direction only"),
    Key::new("mission.events[N].delay_s", above_zero(60.0), Nothing,
        "what fault = \"delay\" adds to the delay of the links"),
    Key::new("mission.events[N].servo", OneOf(&["roll", "pitch", "collective"]), text("roll"),
        "servo that is stuck under fault = \"servo_stuck\""),
    Key::new("mission.events[N].by_s", from(-1e9, 1e9), number(3600.0),
        "how far the clock jumps under fault = \"clock_jump\"; an hour, as a wrong time zone makes it"),
    Key::new("mission.events[N].step", Integer(0, 10_000), Nothing,
        "step to which order = \"goto\" sends the swarm, counted from 0").unit_is("1"),
    Key::new("mission.events[N].vehicles", Ids, Nothing,
        "vehicles that the order names; without it the whole swarm"),
    Key::new("mission.events[N].key", OneOf(TunableKey::PATHS), Nothing,
        "key that order = \"set\" changes in flight"),
    Key::new("mission.events[N].value", from(-1e6, 1e6), Nothing,
        "new value of that key, in its range").unit_is("in the key's unit"),
];

/// Keys of an event besides `at_s` and `for_s`: the event's kind, its required keys, its optional keys.
pub(in crate::scenario) type Rule = (&'static str, &'static [&'static str], &'static [&'static str]);

/// Keys of each kind of fault.
pub(in crate::scenario) const FAULT_RULES: [Rule; 11] = [
    ("kill", &["vehicle"], &[]),
    ("cut", &["from", "to"], &["both_ways"]),
    ("delay", &["from", "to", "delay_s"], &["both_ways"]),
    ("engine_out", &["vehicle"], &[]),
    ("simulator_freeze", &["vehicle"], &[]),
    ("servo_stuck", &["vehicle"], &["servo"]),
    ("gyro_off", &["vehicle"], &[]),
    ("gps_frozen", &["vehicle"], &[]),
    ("clock_jump", &["vehicle"], &["by_s"]),
    ("kill_control", &[], &[]),
    ("isolate", &[], &["both_ways"]),
];

/// Keys of each kind of order.
pub(in crate::scenario) const ORDER_RULES: [Rule; 6] = [
    ("hold", &[], &["vehicles"]),
    ("goto", &["step"], &["vehicles"]),
    ("land", &[], &["vehicles"]),
    ("abort", &[], &["vehicles"]),
    ("release", &["vehicles"], &[]),
    ("set", &["key", "value"], &[]),
];

const FAULTS: &[&str] = &kinds(&FAULT_RULES);
const ORDERS: &[&str] = &kinds(&ORDER_RULES);

/// The kinds of these rules.
const fn kinds<const N: usize>(rules: &[Rule; N]) -> [&'static str; N] {
    let mut kinds = [""; N];
    let mut nth = 0;
    while nth < N {
        kinds[nth] = rules[nth].0;
        nth += 1;
    }
    kinds
}
