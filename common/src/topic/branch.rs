//! The part of the key space that belongs to one swarm.
//!
//! A swarm that flies alone has all of it. A team of a fleet has the keys below `team/N/`, so that one key expression
//! covers all messages of a team, one all messages of a vehicle, and one all states of a cell, whatever the team.

use super::{Cell, Topic, number};
use crate::id::{TeamId, VehicleId, VehicleName};

/// First part of the keys of a team.
const TEAM: &str = "team/";

/// The part of the key space that belongs to one swarm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Branch(Option<TeamId>);

impl Branch {
    /// The branch of a swarm that flies alone.
    pub const SWARM: Self = Self(None);

    /// The branch of this team, or of a swarm without teams.
    pub const fn of(team: Option<TeamId>) -> Self {
        Self(team)
    }

    /// The team; `None` for a swarm that flies alone.
    pub const fn team(self) -> Option<TeamId> {
        self.0
    }

    /// The name of a vehicle of this swarm.
    pub const fn name(self, vehicle: VehicleId) -> VehicleName {
        VehicleName { team: self.0, vehicle }
    }

    /// The key of a message of this swarm, relative to the namespace.
    pub fn key(self, topic: &Topic) -> String {
        self.all(&topic.key())
    }

    /// A key expression such as [`all::STATES`](super::all::STATES), for this swarm alone.
    pub fn all(self, keys: &str) -> String {
        match self.0 {
            Some(team) => format!("{TEAM}{team}/{keys}"),
            None => keys.to_owned(),
        }
    }

    /// Parses a key relative to the namespace: the swarm that it belongs to, and the kind of message; `None` if it is
    /// not a key of Skein.
    pub fn parse(key: &str) -> Option<(Self, Topic)> {
        let Some(rest) = key.strip_prefix(TEAM) else { return Some((Self::SWARM, Topic::parse(key)?)) };
        let (team, rest) = rest.split_once('/')?;
        Some((Self(Some(number(team)?)), Topic::parse(rest)?))
    }

    /// Parses a key of this swarm; `None` if it belongs to another one.
    pub fn own(self, key: &str) -> Option<Topic> {
        Self::parse(key).filter(|(branch, _)| *branch == self).map(|(_, topic)| topic)
    }
}

/// Key expression of the states and intents in a cell, of the vehicles of all teams of a fleet.
pub fn all_in(cell: Cell) -> String {
    format!("{TEAM}*/vehicle/*/cell/{}/{}/*", cell.x, cell.y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topic::all;

    #[test]
    fn the_keys_of_a_team_are_those_of_a_swarm_below_its_number() {
        let team = TeamId::new(3).unwrap();
        let (branch, id) = (Branch::of(Some(team)), VehicleId::new(7).unwrap());
        for topic in [Topic::Alive(id), Topic::Order(12), Topic::State(id, Cell { x: -1, y: 2 })] {
            assert_eq!(Branch::SWARM.key(&topic), topic.key());
            let key = branch.key(&topic);
            assert_eq!(key, format!("team/3/{}", topic.key()));
            assert_eq!(Branch::parse(&key), Some((branch, topic)));
            assert_eq!((branch.own(&key), Branch::SWARM.own(&key)), (Some(topic), None));
            assert_eq!((branch.own(&topic.key()), Branch::SWARM.own(&topic.key())), (None, Some(topic)));
        }
        assert_eq!(branch.all(all::MISSIONS), "team/3/vehicle/*/mission");
        assert_eq!(all_in(Cell { x: -1, y: 2 }), "team/*/vehicle/*/cell/-1/2/*");
        assert_eq!(branch.name(id).to_string(), "3/7");
        for key in [
            "team",
            "team/3",
            "team/0/vehicle/7/alive",
            "team/x/vehicle/7/alive",
            "team/3/team/3/order/1",
            "team/+3/order/1",
        ] {
            assert_eq!(Branch::parse(key), None, "{key}");
        }
    }
}
