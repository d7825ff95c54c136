//! Key expressions, built and parsed in this one place. All of them stand below the swarm's name, which is the Zenoh
//! namespace of its sessions.
//!
//! The vehicle's id stands first: all that one vehicle may say is one branch.

mod described;

use crate::frame::PositionNed;
use crate::id::VehicleId;

pub use described::{DESCRIBED, Described};

/// What is said, and by whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// A vehicle's state, filed under the cell it is in.
    State(VehicleId, Cell),
    /// A vehicle's liveliness token.
    Alive(VehicleId),
    /// How well it does, once a second.
    Health(VehicleId),
    /// Its part in the agreement.
    Mission(VehicleId),
    /// What happened.
    Event(VehicleId),
    /// Every step.
    Trace(VehicleId),
    /// What its clock shows, for whoever asks.
    Clock(VehicleId),
    /// An operator's order.
    Order(u64),
}

/// Who speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Author {
    /// A vehicle.
    Vehicle(VehicleId),
    /// An operator's process, by its number.
    Issuer(u64),
}

/// Key expressions that match one kind of message of every vehicle.
pub mod all {
    /// States of all vehicles in all cells.
    pub const STATES: &str = "vehicle/*/cell/*/*/state";
    /// Liveliness tokens of all vehicles.
    pub const ALIVE: &str = "vehicle/*/alive";
    /// Health of all vehicles.
    pub const HEALTH: &str = "vehicle/*/health";
    /// Agreement registers of all vehicles.
    pub const MISSIONS: &str = "vehicle/*/mission";
    /// Events of all vehicles.
    pub const EVENTS: &str = "vehicle/*/event";
    /// Traces of all vehicles.
    pub const TRACES: &str = "vehicle/*/trace";
    /// Orders of all issuers.
    pub const ORDERS: &str = "order/*";
}

/// A square of the swarm's plane, counted from the origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Cell {
    /// Northward count.
    pub x: i32,
    /// Eastward count.
    pub y: i32,
}

impl Cell {
    /// Side of a cell, m: well above the distance at which vehicles matter to each other.
    pub const SIDE_M: f64 = 1000.0;

    /// The cell that holds a position.
    pub fn of(position: PositionNed) -> Self {
        let count = |metres: f64| (metres / Self::SIDE_M).floor() as i32;
        Self { x: count(position.north_m()), y: count(position.east_m()) }
    }
}

impl Topic {
    /// The key below the swarm's namespace.
    pub fn key(&self) -> String {
        match self {
            Self::State(id, cell) => format!("vehicle/{id}/cell/{}/{}/state", cell.x, cell.y),
            Self::Alive(id) => format!("vehicle/{id}/alive"),
            Self::Health(id) => format!("vehicle/{id}/health"),
            Self::Mission(id) => format!("vehicle/{id}/mission"),
            Self::Event(id) => format!("vehicle/{id}/event"),
            Self::Trace(id) => format!("vehicle/{id}/trace"),
            Self::Clock(id) => format!("vehicle/{id}/clock"),
            Self::Order(issuer) => format!("order/{issuer}"),
        }
    }

    /// The topic of a key, if it is one of ours.
    pub fn parse(key: &str) -> Option<Self> {
        let mut parts = key.split('/');
        let topic = match parts.next()? {
            "order" => Self::Order(parts.next()?.parse().ok()?),
            "vehicle" => {
                let id = parts.next()?.parse().ok()?;
                match parts.next()? {
                    "alive" => Self::Alive(id),
                    "health" => Self::Health(id),
                    "mission" => Self::Mission(id),
                    "event" => Self::Event(id),
                    "trace" => Self::Trace(id),
                    "clock" => Self::Clock(id),
                    "cell" => {
                        let cell = Cell { x: parts.next()?.parse().ok()?, y: parts.next()?.parse().ok()? };
                        (parts.next()? == "state").then_some(Self::State(id, cell))?
                    }
                    _ => return None,
                }
            }
            _ => return None,
        };
        parts.next().is_none().then_some(topic)
    }

    /// Who alone may speak under this key.
    pub fn author(&self) -> Author {
        match *self {
            Self::State(id, _)
            | Self::Alive(id)
            | Self::Health(id)
            | Self::Mission(id)
            | Self::Event(id)
            | Self::Trace(id)
            | Self::Clock(id) => Author::Vehicle(id),
            Self::Order(issuer) => Author::Issuer(issuer),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_read_back() {
        let id = VehicleId::new(7).unwrap();
        let cell = Cell::of(PositionNed::new(-0.1, 1000.0, -30.0));
        assert_eq!(cell, Cell { x: -1, y: 1 });
        let topics = [
            (Topic::State(id, cell), "vehicle/7/cell/-1/1/state"),
            (Topic::Alive(id), "vehicle/7/alive"),
            (Topic::Health(id), "vehicle/7/health"),
            (Topic::Mission(id), "vehicle/7/mission"),
            (Topic::Event(id), "vehicle/7/event"),
            (Topic::Trace(id), "vehicle/7/trace"),
            (Topic::Clock(id), "vehicle/7/clock"),
            (Topic::Order(12), "order/12"),
        ];
        for (topic, key) in topics {
            assert_eq!(topic.key(), key);
            assert_eq!(Topic::parse(key), Some(topic));
        }
    }

    #[test]
    fn other_keys_are_not_ours() {
        for key in ["", "vehicle", "vehicle/0/alive", "vehicle/7/alive/x", "vehicle/7/cell/1/state", "order/x", "a/b"] {
            assert_eq!(Topic::parse(key), None, "{key}");
        }
    }
}
