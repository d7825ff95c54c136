//! A fleet: teams that share the air. Each has a scenario of its own, which is the file's with the changes of its
//! `[[team]]` tables, and its own place.

use std::collections::{BTreeMap, BTreeSet};

use super::error::ScenarioError;
use super::key::{COORDINATES_M, Key};
use super::model::TeamInFleet;
use super::tree::{Node, Part, Place, Table, Texts, Value, shown};
use super::{FileKind, KEYS, Loaded, Source, finish};
use crate::frame::{Origin, PositionNed};
use crate::id::TeamId;

/// The keys of a fleet. All other keys of the file are those of a scenario and apply to every team.
#[rustfmt::skip]
pub const FLEET_KEYS: &[Key] = {
    use super::key::declare::*;
    &[
        Key::new("fleet.teams", Integer(1, TeamId::MAX as i64), Required,
            "number of teams; each flies the scenario with as many vehicles as `swarm.vehicles` says"),
        Key::new("fleet.pattern", OneOf(&["grid", "line", "list"]), text("grid"),
            "places of the teams: a square grid filled from the south-west, a line to the east, or `fleet.places_ne_m`"),
        Key::new("fleet.spacing_m", above_zero(1e5), number(500.0),
            "distance of neighbouring places of a grid or a line; 500 m leave air between two rings of 100 m"),
        Key::new("fleet.places_ne_m", Points, Nothing,
            "place of each team, north and east of the origin, for `pattern = \"list\"`"),
        Key::new("fleet.record_hz", from(0.01, 10.0), number(1.0),
            "rate at which the recording of a fleet has the places of all vehicles; 1 Hz keeps ten minutes of ten thousand vehicles below 200 MB"),
    ]
};

/// The content of a file: the teams of a fleet by number, each with its place as origin; or one swarm, which is of no team.
#[derive(Clone, Debug)]
pub struct Described(Vec<Loaded>);

impl Described {
    /// The swarm, or the first team of the fleet.
    ///
    /// # Panics
    /// Never: a fleet has at least one team.
    pub fn first(&self) -> &Loaded {
        &self.0[0]
    }

    /// The swarm, or the teams of the fleet in order.
    pub fn all(&self) -> &[Loaded] {
        &self.0
    }

    /// Takes the swarm, or the team with this number, out of it; `None` if the file describes no such team.
    pub fn into_team(self, team: Option<TeamId>) -> Option<Loaded> {
        self.0.into_iter().find(|loaded| loaded.scenario.team.map(|own| own.id) == team)
    }

    /// Whether it is a fleet, of one team or more.
    pub fn is_fleet(&self) -> bool {
        self.first().scenario.team.is_some()
    }

    /// The seed that the file gives: that of the swarm, or of the fleet.
    pub fn seed(&self) -> u64 {
        let scenario = &self.first().scenario;
        scenario.team.map_or(scenario.seed, |team| team.seed)
    }

    /// The complete file, as [`Loaded::to_toml`]. That of a fleet has the values of team 1 for all teams, and what differs
    /// in `[[team]]` tables.
    pub fn to_toml(&self) -> String {
        if self.is_fleet() { fleet_to_toml(self.first(), &self.0) } else { self.first().to_toml() }
    }
}

/// The complete file of a fleet.
fn fleet_to_toml(first: &Loaded, teams: &[Loaded]) -> String {
    let written = |team: &Loaded| {
        let mut team = team.clone();
        if let Some(TeamInFleet { origin, seed, .. }) = team.scenario.team {
            team.override_with("origin.latitude_deg", origin.latitude_deg.into());
            team.override_with("origin.longitude_deg", origin.longitude_deg.into());
            team.override_with("seed", toml::Value::Integer(seed as i64));
        }
        team
    };
    let first = written(first);
    let places: Vec<String> = teams
        .iter()
        .filter_map(|team| team.scenario.team)
        .map(|team| format!("[{:?}, {:?}]", team.place_ne_m[0], team.place_ne_m[1]))
        .collect();
    let record_hz = first.scenario.team.map_or(1.0, |team| team.record_hz);
    let mut file = first.to_toml();
    file += &format!(
        "\n[fleet]\nteams = {}\npattern = \"list\"\nrecord_hz = {record_hz:?}\nplaces_ne_m = [{}]\n",
        teams.len(),
        places.join(", ")
    );
    let common = first.values();
    // Teams with the same changes share a table.
    let mut changed: Vec<(Vec<String>, Vec<usize>)> = Vec::new();
    for (nth, team) in teams.iter().enumerate() {
        let own = written(team).values();
        let is_own = |(key, value): &(&String, &String)| common.get(*key) != Some(*value);
        let recorded = team.scenario.team.filter(|team| team.is_recorded).map(|_| "recorded = true".to_owned());
        let changes = own.iter().filter(is_own).map(|(key, value)| format!("{key} = {value}"));
        let changes: Vec<String> = recorded.into_iter().chain(changes).collect();
        match changed.iter_mut().find(|(known, _)| *known == changes) {
            _ if changes.is_empty() => {}
            Some((_, ids)) => ids.push(nth + 1),
            None => changed.push((changes, vec![nth + 1])),
        }
    }
    for (changes, ids) in changed {
        file += &format!("\n[[team]]\nids = {ids:?}\n{}\n", changes.join("\n"));
    }
    file
}

/// Reads a scenario with or without a `[fleet]`; otherwise as [`load`](super::load). A `[[team]]` table has the numbers of
/// its teams, `ids`, whether they have a full recording each, `recorded`, and any keys of a scenario that these teams change; a later table overrides an earlier one. In
/// `sets`, `team.3.formation.radius_m=50` is for team 3 alone.
///
/// # Errors
/// The errors of [`load`](super::load), for the file and for each team.
pub fn load_any(source: &Source<'_>, sets: &[String]) -> Result<Described, ScenarioError> {
    let whole = Texts { kind: FileKind::Scenario, keys: KEYS, source, sets, part: Part::Whole };
    let mut root = whole.parse()?;
    whole.check_kind(&root)?;
    let texts = Texts { part: Part::Common, ..whole };
    let Some(file) = FleetFile::take(&texts, &mut root)? else {
        return finish(&whole, root).map(|loaded| Described(vec![loaded]));
    };
    let places = file.places(&texts)?;
    let record_hz = file.number("fleet.record_hz").unwrap_or(1.0);
    let mut own_sets = BTreeSet::new();
    for (index, team) in (0..sets.len()).filter_map(|index| Some((index, texts.team_of(index)?))) {
        let id = team.parse::<TeamId>().ok().filter(|id| usize::from(id.get()) <= file.teams);
        let message = format!("the fleet has teams 1 to {}, not {}", file.teams, shown(team));
        own_sets.insert(id.ok_or_else(|| texts.fault(&Place::Set(index), "team", message))?);
    }
    // Teams without changes of their own differ only in their place and seed.
    let unchanged = finish(&texts, root.clone())?;
    let origin = unchanged.scenario.origin;
    let teams = TeamId::first(file.teams).zip(&places).map(|(id, place_ne_m)| {
        let texts = Texts { part: Part::Team(id), ..texts };
        let changes = file.changes.iter().filter(|change| change.ids.contains(&id)).collect::<Vec<_>>();
        let is_recorded = changes.iter().rev().find_map(|change| change.is_recorded).unwrap_or(false);
        let changes: Vec<_> = changes.into_iter().filter(|change| !change.table.is_empty()).collect();
        let mut loaded = if changes.is_empty() && !own_sets.contains(&id) {
            unchanged.clone()
        } else {
            let mut own = root.clone();
            changes.into_iter().for_each(|change| overlay(&mut own, &change.table));
            finish(&texts, own)?
        };
        let [north_m, east_m] = *place_ne_m;
        let place = Origin::new(origin.geodetic()).geodetic_from_ned(PositionNed::new(north_m, east_m, 0.0));
        let (latitude_deg, longitude_deg) = (place.latitude_rad.to_degrees(), place.longitude_rad.to_degrees());
        loaded.override_with("origin.latitude_deg", latitude_deg.into());
        loaded.override_with("origin.longitude_deg", longitude_deg.into());
        let written_seed = loaded.scenario.seed;
        let seed = id.seed(written_seed);
        loaded.override_with("seed", toml::Value::Integer(seed as i64));
        let scenario = &mut loaded.scenario;
        (scenario.origin.latitude_deg, scenario.origin.longitude_deg) = (latitude_deg, longitude_deg);
        scenario.seed = seed;
        let (teams, place_ne_m) = (file.teams as u16, *place_ne_m);
        scenario.team = Some(TeamInFleet { id, teams, place_ne_m, origin, seed: written_seed, record_hz, is_recorded });
        Ok(loaded)
    });
    teams.collect::<Result<_, _>>().map(Described)
}

/// The part of a file that is about the fleet.
struct FleetFile {
    fleet: Node,
    teams: usize,
    changes: Vec<Changes>,
}

/// One `[[team]]` table.
struct Changes {
    ids: Vec<TeamId>,
    /// `recorded`, if the table has it.
    is_recorded: Option<bool>,
    table: Table,
}

impl FleetFile {
    /// Takes the fleet's keys out of the file; `None` if it has none.
    fn take(texts: &Texts<'_>, root: &mut Node) -> Result<Option<Self>, ScenarioError> {
        let Value::Table(table) = &mut root.value else { return Ok(None) };
        let (fleet, team) = (table.remove("fleet"), table.remove("team"));
        let Some((place, node)) = fleet else {
            return match team {
                None => Ok(None),
                Some((place, _)) => Err(ScenarioError {
                    help: Some("add `[fleet]`, `teams = 4`".into()),
                    ..texts.fault(&place, "team", "`[[team]]` without `[fleet]`")
                }),
            };
        };
        let texts = Texts { keys: FLEET_KEYS, ..*texts };
        let mut fleet =
            Node { place: place.clone(), value: Value::Table([("fleet".to_owned(), (place, node))].into()) };
        texts.complete(&mut fleet, |index| texts.path_of(index).is_some_and(|path| path.starts_with("fleet.")))?;
        let Some(teams) = fleet.at("fleet.teams").and_then(|node| node.plain().as_integer()) else {
            return Err(ScenarioError {
                help: Some("add the number of teams: `teams = 4`".into()),
                ..texts.fault(&fleet.place, "fleet.teams", "`fleet.teams` is missing")
            });
        };
        let teams = teams as usize;
        let changes = team.map(|(place, node)| changes(&texts, &place, node, teams)).transpose()?.unwrap_or_default();
        Ok(Some(Self { fleet, teams, changes }))
    }

    fn number(&self, path: &str) -> Option<f64> {
        self.fleet.at(path).and_then(|node| node.plain().as_float())
    }

    /// The place of each team, north and east of the origin, m: within the range of points, and no two the same.
    fn places(&self, texts: &Texts<'_>) -> Result<Vec<[f64; 2]>, ScenarioError> {
        let places = self.listed_places(texts)?;
        let fault = |message: String| {
            let written = |key| self.fleet.at(key).map(|node| (key, node));
            let by_default = ("fleet.teams", &self.fleet);
            let (key, node) = written("fleet.places_ne_m").or_else(|| written("fleet.spacing_m")).unwrap_or(by_default);
            texts.fault(&node.place, key, message)
        };
        let mut taken = BTreeMap::new();
        for (nth, [north_m, east_m]) in places.iter().enumerate() {
            let team = nth + 1;
            if !(COORDINATES_M.contains(*north_m) && COORDINATES_M.contains(*east_m)) {
                let message =
                    format!("team {team} would be at [{north_m}, {east_m}]; points have the range {COORDINATES_M}");
                return Err(fault(message));
            }
            // Adding 0 makes -0 and 0 the same.
            if let Some(other) = taken.insert([north_m, east_m].map(|along_m| (along_m + 0.0).to_bits()), team) {
                return Err(fault(format!("teams {other} and {team} would have the same place")));
            }
        }
        Ok(places)
    }

    /// The places as the pattern gives them.
    fn listed_places(&self, texts: &Texts<'_>) -> Result<Vec<[f64; 2]>, ScenarioError> {
        let text = |path| self.fleet.at(path).and_then(|node| node.plain().as_str().map(str::to_owned));
        let pattern = text("fleet.pattern").unwrap_or_else(|| "grid".to_owned());
        let spacing_m = self.number("fleet.spacing_m").unwrap_or(500.0);
        let listed = self.fleet.at("fleet.places_ne_m");
        if let Some(node) = listed.filter(|_| pattern != "list") {
            let message = format!("`fleet.places_ne_m` has no effect: `fleet.pattern` is \"{pattern}\"");
            return Err(texts.fault(&node.place, "fleet.places_ne_m", message));
        }
        let columns = match pattern.as_str() {
            "grid" => (1..).find(|side| side * side >= self.teams).unwrap_or(1),
            "line" => self.teams,
            _ => {
                let places: Vec<[f64; 2]> = listed.and_then(|node| node.plain().try_into().ok()).unwrap_or_default();
                if places.len() == self.teams {
                    return Ok(places);
                }
                let place = listed.map_or(&self.fleet.place, |node| &node.place);
                let message = format!("`fleet.places_ne_m` has {} places for {} teams", places.len(), self.teams);
                return Err(texts.fault(place, "fleet.places_ne_m", message));
            }
        };
        let rows = self.teams.div_ceil(columns);
        let from_middle_m = |nth: usize, count: usize| (nth as f64 - (count as f64 - 1.0) / 2.0) * spacing_m;
        let place = |nth| [from_middle_m(nth / columns, rows), from_middle_m(nth % columns, columns)];
        Ok((0..self.teams).map(place).collect())
    }
}

/// The `[[team]]` tables.
fn changes(texts: &Texts<'_>, place: &Place, node: Node, teams: usize) -> Result<Vec<Changes>, ScenarioError> {
    let Value::List(tables) = node.value else {
        return Err(texts.fault(place, "team", "`team` has to be a list of tables: `[[team]]`"));
    };
    let take = |node: Node| {
        let Value::Table(mut table) = node.value else {
            return Err(texts.fault(&node.place, "team", "`team` has to be a list of tables: `[[team]]`"));
        };
        let Some((_, ids)) = table.remove("ids") else {
            return Err(ScenarioError {
                help: Some("add the numbers of the teams: `ids = [1]`".into()),
                ..texts.fault(&node.place, "team.ids", "`team.ids` is missing")
            });
        };
        let team = |node: &Node| {
            let number = node.plain().as_integer().and_then(|number| u16::try_from(number).ok());
            let id = number.and_then(|number| TeamId::new(number).ok()).filter(|id| usize::from(id.get()) <= teams);
            let message = format!("`team.ids` has to be a list of numbers of teams, 1 to {teams}");
            id.ok_or_else(|| texts.fault(&node.place, "team.ids", message))
        };
        let numbers = if ids.list().is_empty() { std::slice::from_ref(&ids) } else { ids.list() };
        let ids = numbers.iter().map(team).collect::<Result<_, _>>()?;
        for key in ["origin", "name", "record"] {
            if let Some((place, _)) = table.get(key) {
                return Err(texts.fault(place, key, format!("`{key}` is the same for all teams of a fleet")));
            }
        }
        if let Some((place, _)) = table.get("swarm").and_then(|(_, swarm)| swarm.table()?.get("name")) {
            return Err(texts.fault(place, "swarm.name", "`swarm.name` is the same for all teams of a fleet"));
        }
        let is_recorded = table.remove("recorded").map(|(_, node)| {
            let message = "`team.recorded` has to be true or false";
            node.plain().as_bool().ok_or_else(|| texts.fault(&node.place, "team.recorded", message))
        });
        Ok(Changes { ids, is_recorded: is_recorded.transpose()?, table })
    };
    tables.into_iter().map(take).collect()
}

/// Lays a table over another: tables are merged, all other values replaced.
fn overlay(under: &mut Node, over: &Table) {
    let Value::Table(table) = &mut under.value else { return };
    for (name, (place, node)) in over {
        match (table.get_mut(name), &node.value) {
            (Some((_, below)), Value::Table(inner)) if below.table().is_some() => overlay(below, inner),
            _ => drop(table.insert(name.clone(), (place.clone(), node.clone()))),
        }
    }
}
