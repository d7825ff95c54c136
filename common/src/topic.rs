//! Key expressions of all messages, built and parsed here. They are relative to the swarm's name, which is the Zenoh
//! namespace of its sessions.
//!
//! The key begins with the vehicle's id: one key expression covers all messages that one vehicle may send. In a fleet
//! the keys of a team have its number in front ([`Branch`]).

mod branch;
mod described;

use std::str::FromStr;

use crate::frame::PositionNed;
use crate::id::VehicleId;

pub use branch::{Branch, all_in};
pub use described::{TOPIC_DESCRIPTIONS, TopicDescription};

/// Kind of a message and its author.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// State of a vehicle, published under the cell that the vehicle is in.
    State(VehicleId, Cell),
    /// Intent of a vehicle's team, published under the cell of each area that it names.
    Intent(VehicleId, Cell),
    /// Liveliness token of a vehicle.
    Alive(VehicleId),
    /// Health report of a vehicle's agent, once a second.
    Health(VehicleId),
    /// Heartbeat of a vehicle's agent with its agreement state.
    Mission(VehicleId),
    /// Event of a vehicle.
    Event(VehicleId),
    /// Trace of every step of a vehicle's agent.
    Trace(VehicleId),
    /// Summary of a vehicle's agent for pages, ground stations and scripts.
    Summary(VehicleId),
    /// Answer of a vehicle's agent to a clock query.
    Clock(VehicleId),
    /// Order of an operator's process, by the random number of that process.
    Order(u64),
}

/// Sender that may publish under a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Author {
    /// A vehicle.
    Vehicle(VehicleId),
    /// An operator's process, by its random number.
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
    /// Heartbeats of all vehicles.
    pub const MISSIONS: &str = "vehicle/*/mission";
    /// Events of all vehicles.
    pub const EVENTS: &str = "vehicle/*/event";
    /// Traces of all vehicles.
    pub const TRACES: &str = "vehicle/*/trace";
    /// Summaries of all vehicles.
    pub const SUMMARIES: &str = "vehicle/*/summary";
    /// Orders of all issuers.
    pub const ORDERS: &str = "order/*";
}

/// Square cell of the swarm's horizontal plane, counted from the origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cell {
    /// Number of cells north of the origin.
    pub x: i32,
    /// Number of cells east of the origin.
    pub y: i32,
}

impl Cell {
    /// Side of a cell, m: much more than the distance at which vehicles influence each other.
    pub const SIDE_M: f64 = 1000.0;

    /// The cell that contains a position.
    pub fn of(position: PositionNed) -> Self {
        let count = |metres: f64| (metres / Self::SIDE_M).floor() as i32;
        Self { x: count(position.north_m()), y: count(position.east_m()) }
    }

    /// This cell and the eight around it.
    pub fn with_neighbours(self) -> impl Iterator<Item = Self> {
        let around = |x: i32| (-1..=1).map(move |y| (x, y));
        (-1..=1).flat_map(around).map(move |(x, y)| Self { x: self.x.saturating_add(x), y: self.y.saturating_add(y) })
    }
}

impl Topic {
    /// The key, relative to the swarm's branch.
    pub fn key(&self) -> String {
        match self {
            Self::State(id, cell) => format!("vehicle/{id}/cell/{}/{}/state", cell.x, cell.y),
            Self::Intent(id, cell) => format!("vehicle/{id}/cell/{}/{}/intent", cell.x, cell.y),
            Self::Alive(id) => format!("vehicle/{id}/alive"),
            Self::Health(id) => format!("vehicle/{id}/health"),
            Self::Mission(id) => format!("vehicle/{id}/mission"),
            Self::Event(id) => format!("vehicle/{id}/event"),
            Self::Trace(id) => format!("vehicle/{id}/trace"),
            Self::Summary(id) => format!("vehicle/{id}/summary"),
            Self::Clock(id) => format!("vehicle/{id}/clock"),
            Self::Order(issuer) => format!("order/{issuer}"),
        }
    }

    /// Parses a key relative to the swarm's branch; `None` if it is not a key of Skein. Every topic has one key only:
    /// a number with a plus sign or leading zeros is refused.
    pub fn parse(key: &str) -> Option<Self> {
        let Some(rest) = key.strip_prefix("vehicle/") else {
            return number(key.strip_prefix("order/")?).map(Self::Order);
        };
        let (id, rest) = rest.split_once('/')?;
        let id = number(id)?;
        Some(match rest {
            "alive" => Self::Alive(id),
            "health" => Self::Health(id),
            "mission" => Self::Mission(id),
            "event" => Self::Event(id),
            "trace" => Self::Trace(id),
            "summary" => Self::Summary(id),
            "clock" => Self::Clock(id),
            _ => {
                let (x, rest) = rest.strip_prefix("cell/")?.split_once('/')?;
                let (y, what) = rest.split_once('/')?;
                let cell = Cell { x: number(x)?, y: number(y)? };
                match what {
                    "state" => Self::State(id, cell),
                    "intent" => Self::Intent(id, cell),
                    _ => return None,
                }
            }
        })
    }

    /// The only sender that may publish under this key.
    pub fn author(&self) -> Author {
        match *self {
            Self::State(id, _)
            | Self::Intent(id, _)
            | Self::Alive(id)
            | Self::Health(id)
            | Self::Mission(id)
            | Self::Event(id)
            | Self::Trace(id)
            | Self::Summary(id)
            | Self::Clock(id) => Author::Vehicle(id),
            Self::Order(issuer) => Author::Issuer(issuer),
        }
    }
}

/// Parses a number in the spelling that [`Topic::key`] writes.
fn number<T: FromStr>(text: &str) -> Option<T> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    let is_canonical = text == "0" || digits.starts_with(|first| matches!(first, '1'..='9'));
    is_canonical.then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_parsed_back() {
        let id = VehicleId::new(7).unwrap();
        let cell = Cell::of(PositionNed::new(-0.1, 1000.0, -30.0));
        assert_eq!(cell, Cell { x: -1, y: 1 });
        let topics = [
            (Topic::State(id, cell), "vehicle/7/cell/-1/1/state"),
            (Topic::Intent(id, cell), "vehicle/7/cell/-1/1/intent"),
            (Topic::Alive(id), "vehicle/7/alive"),
            (Topic::Health(id), "vehicle/7/health"),
            (Topic::Mission(id), "vehicle/7/mission"),
            (Topic::Event(id), "vehicle/7/event"),
            (Topic::Trace(id), "vehicle/7/trace"),
            (Topic::Summary(id), "vehicle/7/summary"),
            (Topic::Clock(id), "vehicle/7/clock"),
            (Topic::Order(12), "order/12"),
        ];
        for (topic, key) in topics {
            assert_eq!(topic.key(), key);
            assert_eq!(Topic::parse(key), Some(topic));
        }
    }

    #[test]
    fn foreign_keys_are_refused() {
        for key in ["", "vehicle", "vehicle/0/alive", "vehicle/7/alive/x", "vehicle/7/cell/1/state", "order/x", "a/b"] {
            assert_eq!(Topic::parse(key), None, "{key}");
        }
    }

    #[test]
    fn a_number_has_one_spelling() {
        for key in [
            "vehicle/+3/alive",
            "vehicle/03/health",
            "vehicle/3/cell/-0/1/state",
            "vehicle/3/cell/0/+1/state",
            "vehicle/3/cell/00/1/intent",
            "vehicle/3/cell/-01/1/intent",
            "order/+1",
            "order/01",
            "order/-1",
        ] {
            assert_eq!(Topic::parse(key), None, "{key}");
        }
        assert_eq!(Topic::parse("order/0"), Some(Topic::Order(0)));
    }
}
