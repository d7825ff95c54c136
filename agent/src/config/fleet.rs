//! Links of a live fleet: within each team, and between teams that may come near each other.

use std::collections::BTreeSet;

use skein_common::frame::PositionNed;
use skein_common::id::VehicleName;
use skein_common::math;
use skein_common::scenario::{Loaded, Scenario, Target};
use skein_common::topic::Cell;
use skein_core::formation;

/// Largest number of agents in a fleet that flies in real time: all of them may be linked with each other.
pub const MAX_AGENTS: usize = 64;
/// Port of the first vehicle's agent.
const FIRST_PORT: u16 = 7447;
/// Two teams are linked if their plans come within this number of cells. A vehicle subscribes to the cells around it and
/// to those around the place a cell ahead: one more cell covers a vehicle that drifts off its plan.
const LINKED_WITHIN_CELLS: u32 = 3;
/// Distance of the samples of a planned path, m: a path leaves no cell out.
const SAMPLE_M: f64 = 0.25 * Cell::SIDE_M;

/// A fleet that is too large to fly in real time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the fleet has {0} vehicles: fleets larger than {MAX_AGENTS} agents fly in virtual time (`skein study`), because \
     every agent may need a link with every other"
)]
pub struct TooManyAgents(pub usize);

/// Checks that a fleet is small enough to fly in real time. A swarm that flies alone always is.
///
/// # Errors
/// If several teams have more than [`MAX_AGENTS`] vehicles in all.
pub fn check_size(teams: &[Loaded]) -> Result<(), TooManyAgents> {
    let vehicles = teams.iter().map(|team| team.scenario.swarm.vehicles).sum();
    let is_fleet = teams.iter().any(|team| team.scenario.team.is_some());
    if is_fleet && vehicles > MAX_AGENTS { Err(TooManyAgents(vehicles)) } else { Ok(()) }
}

/// The vehicles that this one dials: those of its team and of the teams that may come near, with lower names, so that
/// one vehicle of each pair dials the other.
pub fn dialled(name: VehicleName, teams: &[Loaded]) -> impl Iterator<Item = VehicleName> + '_ {
    let is_own = move |team: &Scenario| team.team.map(|team| team.id) == name.team;
    let teams = teams.iter().map(|team| &team.scenario);
    let own = teams.clone().find(|team| is_own(team)).map(Airspace::of);
    let is_linked = move |team: &Scenario| own.as_ref().is_some_and(|own| own.may_meet(&Airspace::of(team)));
    teams.filter(move |team| is_own(team) || is_linked(team)).flat_map(names).filter(move |other| *other < name)
}

/// Every vehicle with the TCP port of its agent, wherever ports are not chosen at the start of a flight: 7446 and its
/// number among the vehicles of all teams, so that agents on one computer have different ports and a fleet has a row of
/// them.
pub fn ports(teams: &[Loaded]) -> impl Iterator<Item = (VehicleName, u16)> + '_ {
    teams.iter().flat_map(|team| names(&team.scenario)).zip(FIRST_PORT..)
}

/// The names of a team's vehicles.
pub fn names(scenario: &Scenario) -> impl Iterator<Item = VehicleName> + '_ {
    let team = scenario.team.map(|team| team.id);
    scenario.ids().map(move |vehicle| VehicleName { team, vehicle })
}

/// The cells that a team's plan leads through.
#[derive(Clone, Debug)]
struct Airspace(BTreeSet<Cell>);

impl Airspace {
    fn of(scenario: &Scenario) -> Self {
        let place_ne_m = scenario.team.map_or([0.0; 2], |team| team.place_ne_m);
        let mut cells = BTreeSet::new();
        let mut add = |[north_m, east_m]: [f64; 2], around_m: f64| {
            for (north, east) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
                let (north_m, east_m) = (north_m + north * around_m, east_m + east * around_m);
                cells.insert(Cell::of(PositionNed::new(place_ne_m[0] + north_m, place_ne_m[1] + east_m, 0.0)));
            }
        };
        let mut at = [0.0; 2];
        add(at, scenario.start.square_m / 2.0);
        for step in &scenario.mission.steps {
            let around_m = formation::extent_m(&step.formation, scenario.swarm.vehicles);
            let points = match &step.target {
                Target::Centre(point) => std::slice::from_ref(point),
                Target::Path(points) => points,
                Target::Hold(_) | Target::Land(_) => std::slice::from_ref(&at),
            };
            let mut from = at;
            for to in points {
                let way = [to[0] - from[0], to[1] - from[1]];
                let samples = (math::hypot(way[0], way[1]) / SAMPLE_M).ceil().max(1.0);
                for nth in 0..=samples as u32 {
                    let share = f64::from(nth) / samples;
                    add([from[0] + share * way[0], from[1] + share * way[1]], around_m);
                }
                from = *to;
            }
            at = from;
        }
        Self(cells)
    }

    /// Whether vehicles of the two teams may come into each other's sight.
    fn may_meet(&self, other: &Self) -> bool {
        let is_near = |one: &Cell, two: &Cell| {
            one.x.abs_diff(two.x) <= LINKED_WITHIN_CELLS && one.y.abs_diff(two.y) <= LINKED_WITHIN_CELLS
        };
        self.0.iter().any(|one| other.0.iter().any(|two| is_near(one, two)))
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load_any};

    use super::*;

    fn fleet(text: &str) -> Vec<Loaded> {
        load_any(&Source { name: "fleet.toml", text }, &[]).unwrap().all().to_vec()
    }

    fn dialled_by(fleet: &[Loaded], name: &str) -> Vec<String> {
        dialled(name.parse().unwrap(), fleet).map(|name| name.to_string()).collect()
    }

    #[test]
    fn agents_are_linked_within_a_team_and_with_teams_that_may_come_near() {
        let far = "fleet = { teams = 2, pattern = \"line\", spacing_m = 8000 }\nswarm.vehicles = 2\n";
        assert_eq!(dialled_by(&fleet(far), "2/2"), ["2/1"]);
        let near = far.replace("8000", "3000");
        assert_eq!(dialled_by(&fleet(&near), "2/2"), ["1/1", "1/2", "2/1"]);
        assert_eq!(dialled_by(&fleet(&near), "2/1"), ["1/1", "1/2"]);
        assert!(dialled_by(&fleet(&near), "1/1").is_empty(), "one of each pair dials");
        let towards = format!("{far}[[team]]\nids = [1]\nmission.steps = [{{ centre_ne_m = [0, 5500] }}]\n");
        assert_eq!(dialled_by(&fleet(&towards), "2/2"), ["1/1", "1/2", "2/1"]);
    }

    #[test]
    fn the_agents_of_a_fleet_have_a_row_of_ports() {
        let fleet = fleet("fleet.teams = 3\nswarm.vehicles = 2\n[[team]]\nids = [2]\nswarm.vehicles = 3\n");
        let ports: Vec<String> = ports(&fleet).map(|(name, port)| format!("{name}:{port}")).collect();
        assert_eq!(ports, ["1/1:7447", "1/2:7448", "2/1:7449", "2/2:7450", "2/3:7451", "3/1:7452", "3/2:7453"]);
    }

    #[test]
    fn more_than_64_agents_are_refused() {
        let fleet = |vehicles: usize| fleet(&format!("fleet.teams = 2\nswarm.vehicles = {vehicles}\n"));
        assert_eq!(check_size(&fleet(32)), Ok(()));
        let why = check_size(&fleet(33)).unwrap_err().to_string();
        assert!(
            why.starts_with("the fleet has 66 vehicles: fleets larger than 64 agents fly in virtual time"),
            "{why}"
        );
    }
}
