//! The air that the teams of a fleet share: each state reaches the vehicles of other teams that receive from its cell.
//!
//! The teams fly a round of a few frames each by itself, and then exchange the states of that round. So a state from
//! another team is under way until the round ends, or for `network.delay_s` if that is longer.

use std::collections::{BTreeSet, HashMap, HashSet};

use skein_common::frame::{Geodetic, Origin, VelocityNed};
use skein_common::id::{FleetVehicle, TeamId, VehicleId, VehicleSet};
use skein_common::message::{Intent, MessageOrder};
use skein_common::time::LocalTime;
use skein_common::topic::Cell;
use skein_core::intent::ReceivedIntent;
use skein_core::neighbourhood::Homes;
use skein_core::peers::ReceivedState;
use skein_core::strangers::StrangerState;

/// A state that is in the air.
#[derive(Clone, Copy, Debug)]
struct InAir {
    id: FleetVehicle,
    order: MessageOrder,
    position: Geodetic,
    /// Velocity over the ground, local.
    velocity: VelocityNed,
    /// Time at which an ideal network delivers it.
    at: LocalTime,
    bytes: u32,
}

/// States of the last round, by the cell of their sender.
#[derive(Debug, Default)]
pub(super) struct Sky {
    cells: HashMap<Cell, Vec<InAir>>,
    /// Intents, by the cells of their areas, with their team and the time at which an ideal network delivers them.
    intents: HashMap<Cell, Vec<(TeamId, Intent, LocalTime)>>,
    /// The cells with a vehicle.
    occupied: HashSet<Cell>,
}

/// The states and intents that a team sends in a round, each with its cell.
#[derive(Debug, Default)]
pub(super) struct Sent {
    states: Vec<(Cell, InAir)>,
    intents: Vec<(Cell, (TeamId, Intent, LocalTime))>,
}

impl Sent {
    /// Adds a state that an ideal network delivers at this time. `map` is the origin of the cells, `team` that of the sender's
    /// frame.
    pub(super) fn add(&mut self, [map, team]: [&Origin; 2], id: FleetVehicle, state: &ReceivedState, at: LocalTime) {
        let &ReceivedState { header, geodetic: position, velocity, .. } = state;
        let velocity = team.convergence_at(&position).velocity_to_local(velocity);
        let in_air = InAir { id, order: header.order(), position, velocity, at, bytes: state.message_len() as u32 };
        self.states.push((Cell::of(map.ned_from_geodetic(&position)), in_air));
    }

    /// Adds a team's intent, as [`Self::add`] adds a state: it is sent in the cell of each of its areas.
    pub(super) fn add_intent(&mut self, map: &Origin, team: TeamId, intent: &Intent, at: LocalTime) {
        self.intents.extend(intent.cells(map).map(|cell| (cell, (team, *intent, at))));
    }
}

/// The messages of other teams that the vehicles of a team receive in a round.
#[derive(Debug, Default)]
pub(super) struct FromOthers {
    /// Each state with its receivers.
    pub(super) states: Vec<(StrangerState, VehicleSet)>,
    /// Each intent with the receivers that need it: a vehicle that waits for no area needs none.
    pub(super) intents: Vec<(ReceivedIntent, VehicleSet)>,
    /// The counts of the vehicles with the same cells.
    groups: Vec<Group>,
    /// The group of each vehicle.
    group_of: Vec<usize>,
}

/// The counts of what the vehicles with the same cells receive in a round.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Group {
    /// Number of states, and their size, bytes.
    pub(super) states: (u64, u64),
    /// Number of intents, and their size, bytes.
    pub(super) intents: (u64, u64),
    /// Whether a vehicle is in each of the nine cells around.
    pub(super) is_surrounded: bool,
}

impl FromOthers {
    /// The counts of each vehicle, in order.
    pub(super) fn counts(&self) -> impl Iterator<Item = &Group> {
        self.group_of.iter().filter_map(|&group| self.groups.get(group))
    }
}

impl Sky {
    /// Replaces the states and intents by those of the round that has ended, of all teams in order. `places` are the cells of all
    /// vehicles.
    pub(super) fn exchange<'a>(
        &mut self,
        rounds: impl Iterator<Item = &'a mut Sent>,
        places: impl Iterator<Item = Cell>,
    ) {
        self.occupied.clear();
        self.occupied.extend(places);
        self.cells.values_mut().for_each(Vec::clear);
        self.intents.clear();
        for sent in rounds {
            sent.states.drain(..).for_each(|(cell, state)| self.cells.entry(cell).or_default().push(state));
            sent.intents.drain(..).for_each(|(cell, intent)| self.intents.entry(cell).or_default().push(intent));
        }
    }

    /// The messages of other teams that a team receives whose vehicles have these cells. `origin` is that of the team's frame.
    pub(super) fn received(&self, origin: &Origin, homes: &[Homes], own: TeamId) -> FromOthers {
        let mut distinct: Vec<(&Homes, VehicleSet)> = Vec::new();
        let mut received = FromOthers::default();
        for (homes, id) in homes.iter().zip(VehicleId::first(homes.len())) {
            let known = distinct.iter().position(|(known, _)| *known == homes);
            let group = known.unwrap_or_else(|| {
                distinct.push((homes, VehicleSet::default()));
                distinct.len() - 1
            });
            distinct[group].1.insert(id);
            received.group_of.push(group);
        }
        let cells: Vec<Vec<Cell>> = distinct.iter().map(|(homes, _)| homes.cells()).collect();
        received.groups.extend(distinct.iter().map(|(homes, _)| Group {
            is_surrounded: homes.here.with_neighbours().all(|cell| self.occupied.contains(&cell)),
            ..Group::default()
        }));
        // A message is converted once, whatever the number of groups that receive it.
        let all: BTreeSet<Cell> = cells.iter().flatten().copied().collect();
        for cell in all {
            let receiving = || (0..distinct.len()).filter(|&group| cells[group].binary_search(&cell).is_ok());
            let union = |all: VehicleSet, group: usize| all.either(distinct[group].1);
            let receivers = receiving().fold(VehicleSet::default(), union);
            let waiting = receiving().filter(|&group| distinct[group].0.wanted.is_some());
            let waiting = waiting.fold(VehicleSet::default(), union);
            let states = self.cells.get(&cell).into_iter().flatten().filter(|sent| sent.id.team != own);
            for &InAir { id, order, position, velocity, at, bytes } in states {
                let (position, convergence) = origin.locate(&position);
                let velocity = convergence.velocity_from_local(velocity);
                received.states.push((StrangerState { id, order, position, velocity, at }, receivers));
                receiving().for_each(|group| add(&mut received.groups[group].states, bytes.into()));
            }
            for (team, intent, at) in self.intents.get(&cell).into_iter().flatten().filter(|(team, ..)| *team != own) {
                let bytes = skein_common::message::encoded_len(intent) as u64;
                receiving().for_each(|group| add(&mut received.groups[group].intents, bytes));
                if !waiting.is_empty() {
                    received.intents.push((ReceivedIntent::new(*team, intent, origin, *at), waiting));
                }
            }
        }
        received
    }
}

/// Counts one message of this size.
fn add(counts: &mut (u64, u64), bytes: u64) {
    *counts = (counts.0 + 1, counts.1 + bytes);
}

#[cfg(test)]
mod tests {
    use skein_common::frame::PositionNed;

    use super::*;

    fn at_home(cell: Cell) -> Homes {
        Homes { here: cell, ahead: cell, wanted: None }
    }

    fn sent(states: Vec<(Cell, InAir)>) -> Sent {
        Sent { states, ..Sent::default() }
    }

    #[test]
    fn a_state_reaches_the_other_teams_in_its_cell_and_the_eight_around_once() {
        let map = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let place = |north_m: f64| map.geodetic_from_ned(PositionNed::new(north_m, 10.0, -30.0));
        let id = |text: &str| text.parse::<FleetVehicle>().unwrap();
        let in_air = |text: &str, north_m: f64| {
            let velocity = VelocityNed::new(1.0, 2.0, 0.0);
            let (order, at) = (MessageOrder::default(), LocalTime::ZERO);
            let state = InAir { id: id(text), order, position: place(north_m), velocity, at, bytes: 70 };
            (Cell::of(PositionNed::new(north_m, 10.0, -30.0)), state)
        };
        let mut first = sent(vec![in_air("1/1", 100.0), in_air("1/2", 2900.0)]);
        let mut second = sent(vec![in_air("2/1", 1990.0), in_air("2/2", 3100.0)]);
        let mut sky = Sky::default();
        sky.exchange([&mut first, &mut second].into_iter(), [].into_iter());
        let received = sky.received(&map, &[0, 2].map(|x| at_home(Cell { x, y: 0 })), id("1/1").team);
        let names = |vehicle: &str| -> Vec<String> {
            let vehicle = vehicle.parse().unwrap();
            let its = received.states.iter().filter(|(_, receivers)| receivers.contains(vehicle));
            its.map(|(state, _)| state.id.to_string()).collect()
        };
        assert_eq!(names("1"), ["2/1"], "1,990 m is in the next cell, 3,100 m beyond it");
        assert_eq!(names("2"), ["2/1", "2/2"]);
        let (nearest, _) = received.states[0];
        assert!((nearest.position.north_m() - 1990.0).abs() < 1e-3, "{nearest:?}");
        let counts: Vec<_> = received.counts().map(|group| (group.states, group.is_surrounded)).collect();
        assert_eq!(counts, [((1, 70), false), ((2, 140), false)]);
        sky.exchange([&mut first, &mut second].into_iter(), [].into_iter());
        assert!(
            sky.received(&map, &[at_home(Cell { x: 0, y: 0 })], TeamId::FIRST).states.is_empty(),
            "a round is received once"
        );
    }

    #[test]
    fn a_vehicle_is_surrounded_when_all_nine_cells_are_occupied() {
        let map = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let mut sky = Sky::default();
        let state = |x: i32, y: i32| {
            let at = PositionNed::new(f64::from(x) * 1000.0 + 500.0, f64::from(y) * 1000.0 + 500.0, -30.0);
            let velocity = VelocityNed::new(0.0, 0.0, 0.0);
            let id = "2/1".parse().unwrap();
            let position = map.geodetic_from_ned(at);
            let (order, at) = (MessageOrder::default(), LocalTime::ZERO);
            (Cell { x, y }, InAir { id, order, position, velocity, at, bytes: 1 })
        };
        let mut sent = sent((-1..=1).flat_map(|x| (-1..=1).map(move |y| (x, y))).map(|(x, y)| state(x, y)).collect());
        sky.exchange([&mut sent].into_iter(), (-1..=1).flat_map(|x| (-1..=1).map(move |y| Cell { x, y })));
        let received = sky.received(&map, &[0, 1, 0].map(|x| at_home(Cell { x, y: 0 })), TeamId::FIRST);
        let counts: Vec<_> = received.counts().map(|group| (group.is_surrounded, group.states.0)).collect();
        assert_eq!(counts, [(true, 9), (false, 6), (true, 9)]);
    }
}
