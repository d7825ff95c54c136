//! Draws a flight of a fleet, and lists its teams.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use nalgebra::Vector2;
use skein_common::id::{TeamId, VehicleId};

use super::figure::{Axis, Colour, Drawing, Item, Marker, Panel, Shape, WIDTH_PX};
use super::page::{Part, Section};
use crate::error::Error;
use crate::record::{self, TeamPlaces};
use crate::study::rounded;

/// Most points of all trails of a panel.
const MOST_POINTS: usize = 40_000;
/// Number of teams whose vehicles are drawn one by one beside a large fleet.
const CLOSE_TEAMS: usize = 9;
/// Most vehicles whose trails are drawn one by one.
const MOST_TRAILS: usize = 300;
/// Most teams in the table.
const MOST_TEAMS: usize = 32;
/// Columns of the table of teams.
const SHOWN: [&str; 8] = [
    "duration_s",
    "setpoints_reached",
    "even_10deg_s",
    "in_band_s",
    "min_separation_m",
    "collisions",
    "crashes",
    "safety_activations",
];

/// The section about a fleet's flight in this folder; `None` if no fleet was recorded there.
///
/// # Errors
/// If the recording cannot be read.
pub(super) fn section(folder: &Path, title: String, name: String, subject: &str) -> Result<Option<Section>, Error> {
    let path = folder.join(record::FLEET_FILE);
    if !path.exists() {
        return Ok(None);
    }
    let places = record::read_fleet(&path).map_err(|error| Error::Failed(error.to_string()))?;
    let mut parts: Vec<Part> = drawing(&places, subject).map(Part::Drawing).into_iter().collect();
    parts.extend(fs::read_to_string(folder.join("teams.csv")).ok().and_then(|text| table(&text)));
    Ok(Some(Section { title, name, parts }))
}

/// The section about the recording of a fleet in this file; `None` if it is not one.
///
/// # Errors
/// If the file cannot be read.
pub(super) fn of_file(path: &Path, name: String) -> Result<Option<Section>, Error> {
    let places = record::read_fleet(path).map_err(|error| Error::Refused(error.to_string()))?;
    let drawing = drawing(&places, &path.display().to_string());
    Ok(drawing.map(|drawing| Section { title: "The flight".to_owned(), name, parts: vec![Part::Drawing(drawing)] }))
}

/// The places of each vehicle, east and north, m, in the order of time.
type Trails = BTreeMap<(TeamId, VehicleId), Vec<[f64; 2]>>;

fn drawing(places: &[TeamPlaces], subject: &str) -> Option<Drawing> {
    let mut trails = Trails::new();
    for places in places {
        for vehicle in &places.vehicles {
            trails.entry((places.team, vehicle.id)).or_default().push([vehicle.east_m, vehicle.north_m]);
        }
    }
    let duration_s = places.last()?.t_s;
    let (mut panels, caption) = if trails.len() <= MOST_TRAILS {
        (vec![vehicles_panel(&trails)], "Paths of all vehicles, a colour for each team; dots: the last places.")
    } else {
        let mut whole = teams_panel(&trails);
        whole.place = [0.0, 0.0, 0.49, 1.0];
        whole.title = "all teams".to_owned();
        let mut close = vehicles_panel(&close(&trails));
        close.place = [0.53, 0.0, 1.0, 1.0];
        close.title = "some teams, vehicle by vehicle".to_owned();
        let caption = "Left: paths of the teams' centres, and the last places of all vehicles. Right: paths of the vehicles of \
                       some neighbouring teams.";
        (vec![whole, close], caption)
    };
    panels.iter_mut().for_each(|panel| panel.is_map = true);
    let height_px = if panels.len() == 1 { 720.0 } else { 500.0 };
    let width_px = if panels.len() == 1 { 720.0 } else { WIDTH_PX };
    Some(Drawing {
        name: "fleet".to_owned(),
        title: "The fleet from above".to_owned(),
        subject: subject.to_owned(),
        caption: format!("{caption} {} vehicles, {duration_s:.0} s.", trails.len()),
        size_px: [width_px, height_px],
        panels,
    })
}

fn map() -> Panel {
    Panel::new(Axis::new("east", "m"), Axis::new("north", "m"))
}

/// A panel with the trail of each vehicle.
fn vehicles_panel(trails: &Trails) -> Panel {
    let every = trails.values().map(Vec::len).sum::<usize>().div_ceil(MOST_POINTS).max(1);
    let mut panel = map();
    for ((team, _), trail) in trails {
        let colour = Colour::nth(usize::from(team.get()) - 1);
        panel.items.push(Item::line(vec![thinned(trail, every)], colour.faint(0.45)).wide(0.8));
    }
    for ((team, _), trail) in trails {
        let at = trail.last().copied().into_iter().collect();
        let dot = Shape::Dots { at, marker: Marker::Circle, size_px: 4.0 };
        panel.items.push(Item::new(dot, Colour::nth(usize::from(team.get()) - 1)));
    }
    panel
}

/// A panel with the trail of each team's mean place, and a dot for each vehicle.
fn teams_panel(trails: &Trails) -> Panel {
    let mut teams: BTreeMap<TeamId, Vec<&Vec<[f64; 2]>>> = BTreeMap::new();
    trails.iter().for_each(|((team, _), trail)| teams.entry(*team).or_default().push(trail));
    let longest = trails.values().map(Vec::len).max().unwrap_or(0);
    let every = (teams.len() * longest).div_ceil(MOST_POINTS).max(1);
    let mut panel = map();
    for (team, trails) in &teams {
        let mean = |nth: usize| {
            let at = trails.iter().filter_map(|trail| trail.get(nth));
            let count = at.clone().count().max(1) as f64;
            let sum = at.fold([0.0; 2], |sum, place| [sum[0] + place[0], sum[1] + place[1]]);
            [sum[0] / count, sum[1] / count]
        };
        let mean: Vec<_> = (0..trails.iter().map(|trail| trail.len()).max().unwrap_or(0)).map(mean).collect();
        let colour = Colour::nth(usize::from(team.get()) - 1);
        panel.items.push(Item::line(vec![thinned(&mean, every)], colour.faint(0.6)).wide(0.8));
        let at = trails.iter().filter_map(|trail| trail.last().copied()).collect();
        let dots = Shape::Dots { at, marker: Marker::Circle, size_px: 1.2 };
        panel.items.push(Item::new(dots, colour));
    }
    panel
}

/// The teams that began nearest to the middle of the fleet.
fn close(trails: &Trails) -> Trails {
    let first = |trail: &Vec<[f64; 2]>| trail.first().copied().unwrap_or_default();
    let count = trails.len().max(1) as f64;
    let sum = trails.values().map(first).fold([0.0; 2], |sum, at| [sum[0] + at[0], sum[1] + at[1]]);
    let middle = [sum[0] / count, sum[1] / count];
    let mut nearest: BTreeMap<TeamId, f64> = BTreeMap::new();
    for ((team, _), trail) in trails {
        let at = first(trail);
        let away_m = Vector2::new(at[0] - middle[0], at[1] - middle[1]).norm();
        nearest.entry(*team).and_modify(|least_m| *least_m = least_m.min(away_m)).or_insert(away_m);
    }
    let mut order: Vec<_> = nearest.into_iter().collect();
    order.sort_by(|one, other| one.1.total_cmp(&other.1));
    let chosen: Vec<TeamId> = order.into_iter().take(CLOSE_TEAMS).map(|(team, _)| team).collect();
    trails.iter().filter(|((team, _), _)| chosen.contains(team)).map(|(id, trail)| (*id, trail.clone())).collect()
}

/// Every `every`-th place, and the last one.
fn thinned(trail: &[[f64; 2]], every: usize) -> Vec<[f64; 2]> {
    trail.iter().step_by(every).chain(trail.last()).copied().collect()
}

/// A table of the teams, from `teams.csv`: of a large fleet those with the least separations.
fn table(text: &str) -> Option<Part> {
    let mut lines = csv::Reader::from_reader(text.as_bytes());
    let head = lines.headers().ok()?.clone();
    let column = |key: &str| head.iter().position(|name| name == key);
    let separation = column("min_separation_m")?;
    let mut rows: Vec<csv::StringRecord> = lines.records().filter_map(Result::ok).collect();
    let teams = rows.len();
    let least_m = |row: &csv::StringRecord| row.get(separation).and_then(|cell| cell.parse::<f64>().ok());
    if teams > MOST_TEAMS {
        rows.sort_by(|one, other| {
            least_m(one).unwrap_or(f64::INFINITY).total_cmp(&least_m(other).unwrap_or(f64::INFINITY))
        });
        rows.truncate(MOST_TEAMS);
    }
    let cell = |row: &csv::StringRecord, key: &str| {
        let text = column(key).and_then(|nth| row.get(nth)).unwrap_or_default();
        text.parse().map_or_else(|_| "–".to_owned(), rounded)
    };
    let team = |row: &csv::StringRecord| row.get(0).unwrap_or_default().to_owned();
    let row = |row: &csv::StringRecord| [team(row)].into_iter().chain(SHOWN.map(|key| cell(row, key))).collect();
    let caption = match teams > MOST_TEAMS {
        true => format!("The {MOST_TEAMS} of {teams} teams with the least separations; teams.csv has all of them."),
        false => "The teams.".to_owned(),
    };
    let head = ["team"].into_iter().chain(SHOWN).map(str::to_owned).collect();
    Some(Part::Table { caption, head, rows: rows.iter().map(row).collect() })
}

#[cfg(test)]
mod tests {
    use skein_core::random::{self, Purpose};

    use super::*;
    use crate::record::VehiclePlace;

    fn places(teams: usize, vehicles: usize) -> Vec<TeamPlaces> {
        let mut rng = random::generator(1, None, Purpose::Study);
        let mut at = || (random::uniform(&mut rng) - 0.5) * 1000.0;
        let mut all = Vec::new();
        for t_s in 0..5 {
            for team in TeamId::first(teams) {
                let place = |id| VehiclePlace { id, step: 0, north_m: at(), east_m: at(), altitude_m: 30.0 };
                all.push(TeamPlaces {
                    team,
                    t_s: f64::from(t_s),
                    vehicles: VehicleId::first(vehicles).map(place).collect(),
                });
            }
        }
        all
    }

    #[test]
    fn a_large_fleet_is_drawn_by_teams_and_a_small_one_by_vehicles() {
        let small = drawing(&places(4, 8), "subject").unwrap();
        assert_eq!((small.panels.len(), small.panels[0].items.len()), (1, 2 * 32));
        let large = drawing(&places(40, 16), "subject").unwrap();
        let items: Vec<_> = large.panels.iter().map(|panel| panel.items.len()).collect();
        assert_eq!(items, [2 * 40, 2 * CLOSE_TEAMS * 16]);
        assert!(drawing(&[], "subject").is_none());
    }

    #[test]
    fn the_table_has_the_teams_with_the_least_separations() {
        let rows: String = (1..=40).map(|team| format!("{team},{},0\n", 50 - team)).collect();
        let Some(Part::Table { rows, .. }) = table(&format!("team,min_separation_m,collisions\n{rows}")) else {
            panic!("a table")
        };
        assert_eq!((rows.len(), rows[0][0].as_str(), rows[0][5].as_str()), (MOST_TEAMS, "40", "10.00"));
    }
}
