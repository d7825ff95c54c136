//! Draws a flight of a fleet, and lists its teams.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use skein_common::id::{TeamId, VehicleId};

use super::figure::{Colour, Drawing, Item, Marker, Panel, Shape, WIDTH_PX};
use super::page::{Part, Section};
use super::{flight, tables, verdict};
use crate::error::Error;
use crate::record::{self, FleetPlaces, TeamPlaces};
use crate::study::rounded;

/// Most points of all trails of a panel.
const MOST_POINTS: usize = 40_000;
/// Number of teams whose vehicles are drawn one by one beside a large fleet.
const CLOSE_TEAMS: usize = 9;
/// Most vehicles whose trails are drawn one by one.
const MOST_TRAILS: usize = 300;
/// Most teams in the table.
const MOST_TEAMS: usize = 32;
/// Most teams for which the page shows which vehicle receives which.
const MOST_CONTACTS: usize = 4;
/// Most teams whose numbers are beside their vehicles.
const MOST_NUMBERS: usize = 40;
/// A vehicle whose places end this long before the last ones of its team has ended, s.
const ENDED_S: f64 = 5.0;
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
    let recording = record::read_fleet(&path).map_err(|error| Error::Failed(error.to_string()))?;
    let mut parts: Vec<Part> = missing(&recording).into_iter().collect();
    parts.extend(drawing(&recording.places, subject).map(Part::Drawing));
    parts.extend(contacts(folder)?.into_iter().map(Part::Drawing));
    if let Ok(text) = fs::read_to_string(folder.join("teams.csv")) {
        parts.extend(table(&text));
        parts.push(tables::definitions(SHOWN.into_iter()));
    }
    Ok(Some(Section { title, name, parts }))
}

/// Draws which vehicle receives which in the teams of this fleet that were recorded in full, up to [`MOST_CONTACTS`] of
/// them.
fn contacts(folder: &Path) -> Result<Vec<Drawing>, Error> {
    // A study writes `teams/3`, a flight in real time `team-3`.
    let inside = |path: &Path| fs::read_dir(path).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
    let number = |path: &Path| path.file_name()?.to_str()?.trim_start_matches("team-").parse::<u16>().ok();
    let teams = inside(&folder.join("teams")).chain(inside(folder));
    let mut teams: Vec<_> = teams.filter_map(|path| Some((number(&path)?, path.join(record::FILE)))).collect();
    teams.retain(|(_, path)| path.is_file());
    teams.sort();
    let draw = |(team, path): (u16, PathBuf)| {
        let recording = record::read(&path).map_err(|error| Error::Failed(error.to_string()))?;
        let drawing = flight::contact(&recording);
        Ok(drawing.map(|drawing| Drawing {
            name: format!("{}-team-{team}", drawing.name),
            title: format!("{} in team {team}", drawing.title),
            ..drawing
        }))
    };
    teams.into_iter().take(MOST_CONTACTS).filter_map(|team| draw(team).transpose()).collect()
}

/// The sentences about what the recording of a fleet lacks; `None` if it is whole.
fn missing(FleetPlaces { places, lacks }: &FleetPlaces) -> Option<Part> {
    let last_s = places.last().map(|places| places.t_s);
    let lines = verdict::missing(lacks, "The recording of the fleet", last_s, None);
    (!lines.is_empty()).then_some(Part::Verdict(lines))
}

/// The section about the recording of a fleet in this file; `None` if it is not one.
///
/// # Errors
/// If the file cannot be read.
pub(super) fn of_file(path: &Path, name: String) -> Result<Option<Section>, Error> {
    let recording = record::read_fleet(path).map_err(|error| Error::Refused(error.to_string()))?;
    let drawing = drawing(&recording.places, &path.display().to_string());
    Ok(drawing.map(|drawing| {
        let parts = missing(&recording).into_iter().chain([Part::Drawing(drawing)]).collect();
        Section { title: "The flight".to_owned(), name, parts }
    }))
}

/// The places of each vehicle, east and north, m, in the order of time.
type Trails = BTreeMap<(TeamId, VehicleId), Vec<[f64; 2]>>;

/// The last places of the vehicles whose agents ended before the others of their team.
fn ended(places: &[TeamPlaces]) -> BTreeMap<(TeamId, VehicleId), [f64; 2]> {
    // The last time of each team, and the last time and place of each vehicle.
    let mut team_s: BTreeMap<TeamId, f64> = BTreeMap::new();
    let mut last: BTreeMap<(TeamId, VehicleId), (f64, [f64; 2])> = BTreeMap::new();
    for places in places {
        team_s.insert(places.team, places.t_s);
        let at = places.vehicles.iter().map(|vehicle| (vehicle.id, [vehicle.east_m, vehicle.north_m]));
        last.extend(at.map(|(id, at)| ((places.team, id), (places.t_s, at))));
    }
    let is_ended = |((team, _), (t_s, _)): &(_, (f64, _))| team_s.get(team).is_some_and(|end_s| end_s - t_s > ENDED_S);
    last.into_iter().filter(is_ended).map(|(id, (_, at))| (id, at)).collect()
}

fn drawing(places: &[TeamPlaces], subject: &str) -> Option<Drawing> {
    let mut trails = Trails::new();
    for places in places {
        for vehicle in &places.vehicles {
            trails.entry((places.team, vehicle.id)).or_default().push([vehicle.east_m, vehicle.north_m]);
        }
    }
    let duration_s = places.last()?.t_s;
    let ended = ended(places);
    let (panels, caption) = if trails.len() <= MOST_TRAILS {
        (vec![vehicles_panel(&trails, &ended)], "The fleet from above, a colour for each team.")
    } else {
        let mut whole = teams_panel(&trails);
        whole.place = [0.0, 0.0, 0.49, 1.0];
        whole.title = "all teams".to_owned();
        let mut close = vehicles_panel(&close(&trails), &ended);
        close.place = [0.53, 0.0, 1.0, 1.0];
        close.title = "some teams, vehicle by vehicle".to_owned();
        let caption = "The fleet from above, a colour for each team. Left: all teams. Right: some neighbouring teams.";
        (vec![whole, close], caption)
    };
    Some(Drawing {
        name: "fleet".to_owned(),
        title: "The fleet from above".to_owned(),
        subject: subject.to_owned(),
        caption: format!("{caption} {} vehicles, {duration_s:.0} s.", trails.len()),
        size_px: if panels.len() == 1 { [720.0; 2] } else { [WIDTH_PX, 500.0] },
        panels,
    })
}

/// The mean of these places; zero without places.
fn mean<'a>(places: impl Iterator<Item = &'a [f64; 2]>) -> [f64; 2] {
    let add = |(sum, count): ([f64; 2], f64), at: &[f64; 2]| ([sum[0] + at[0], sum[1] + at[1]], count + 1.0);
    let (sum, count) = places.fold(([0.0; 2], 0.0), add);
    sum.map(|sum| sum / f64::max(count, 1.0))
}

/// A panel with the trail of each vehicle, and the number of each team.
fn vehicles_panel(trails: &Trails, ended: &BTreeMap<(TeamId, VehicleId), [f64; 2]>) -> Panel {
    let every = trails.values().map(Vec::len).sum::<usize>().div_ceil(MOST_POINTS).max(1);
    let mut panel = flight::map();
    let colour = |team: TeamId| Colour::nth(usize::from(team.get()) - 1);
    let mut teams: BTreeMap<TeamId, Vec<[f64; 2]>> = BTreeMap::new();
    for ((team, _), trail) in trails {
        let line = Item::line(vec![thinned(trail, every)], colour(*team).faint(0.45)).wide(0.8);
        panel.items.push(line.meaning("Thin lines: the paths of the vehicles"));
    }
    for (id, trail) in trails {
        let Some(last) = trail.last().copied().filter(|_| !ended.contains_key(id)) else { continue };
        let dot = Shape::Dots { at: vec![last], marker: Marker::Circle, size_px: 5.0 };
        panel.items.push(Item::new(dot, colour(id.0)).meaning("Dots: the last places of the vehicles"));
        teams.entry(id.0).or_default().push(last);
    }
    for (id, at) in ended.iter().filter(|(id, _)| trails.contains_key(*id)) {
        let cross = Shape::Dots { at: vec![*at], marker: Marker::Cross, size_px: 11.0 };
        panel
            .items
            .push(Item::new(cross, Colour::BLACK).meaning("Crosses: the agent of the vehicle, team/id, ended here"));
        let text = format!("{}/{}", id.0, id.1);
        panel.items.push(Item::new(Shape::Note { at: *at, text, side: [1.0, 1.0] }, Colour::BLACK));
    }
    if teams.len() <= MOST_NUMBERS {
        for (team, last) in &teams {
            let number = Shape::Note { at: mean(last.iter()), text: team.to_string(), side: [0.0, 0.0] };
            panel.items.push(Item::new(number, Colour::BLACK).meaning("Numbers: the teams"));
        }
    }
    panel
}

/// A panel with the trail of each team's mean place, and a dot for each vehicle.
fn teams_panel(trails: &Trails) -> Panel {
    let mut teams: BTreeMap<TeamId, Vec<&Vec<[f64; 2]>>> = BTreeMap::new();
    trails.iter().for_each(|((team, _), trail)| teams.entry(*team).or_default().push(trail));
    let longest = trails.values().map(Vec::len).max().unwrap_or(0);
    let every = (teams.len() * longest).div_ceil(MOST_POINTS).max(1);
    let mut panel = flight::map();
    for (team, trails) in &teams {
        let longest = trails.iter().map(|trail| trail.len()).max().unwrap_or(0);
        let centre = |nth: usize| mean(trails.iter().filter_map(|trail| trail.get(nth)));
        let centres: Vec<_> = (0..longest).map(centre).collect();
        let colour = Colour::nth(usize::from(team.get()) - 1);
        let line = Item::line(vec![thinned(&centres, every)], colour.faint(0.6)).wide(0.8);
        panel.items.push(line.meaning("Lines on the left: the paths of the teams' centres"));
        let at = trails.iter().filter_map(|trail| trail.last().copied()).collect();
        let dots = Shape::Dots { at, marker: Marker::Circle, size_px: 1.2 };
        panel.items.push(Item::new(dots, colour).meaning("Small dots on the left: the last places of all vehicles"));
    }
    panel
}

/// The teams that began nearest to the middle of the fleet.
fn close(trails: &Trails) -> Trails {
    let middle = mean(trails.values().filter_map(|trail| trail.first()));
    let mut nearest: BTreeMap<TeamId, f64> = BTreeMap::new();
    for ((team, _), trail) in trails {
        let Some(at) = trail.first() else { continue };
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
                let place =
                    |id| VehiclePlace { id, step: 0, north_m: at(), east_m: at(), altitude_m: 30.0, in_place: true };
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
        assert_eq!((small.panels.len(), small.panels[0].items.len()), (1, 2 * 32 + 4));
        let large = drawing(&places(40, 16), "subject").unwrap();
        let items: Vec<_> = large.panels.iter().map(|panel| panel.items.len()).collect();
        assert_eq!(items, [2 * 40, (2 * 16 + 1) * CLOSE_TEAMS]);
        assert!(drawing(&[], "subject").is_none());
    }

    #[test]
    fn the_trail_of_a_vehicle_whose_agent_ended_ends_with_a_cross_and_its_number() {
        let mut places = places(2, 3);
        for (nth, places) in places.iter_mut().enumerate() {
            places.t_s *= 10.0;
            if nth > 5 {
                places.vehicles.retain(|vehicle| (places.team.get(), vehicle.id.get()) != (2, 3));
            }
        }
        let drawing = drawing(&places, "subject").unwrap();
        let notes = |text: &str| {
            let is_it = |item: &&Item| matches!(&item.shape, Shape::Note { text: note, .. } if note == text);
            drawing.panels[0].items.iter().filter(is_it).count()
        };
        assert_eq!((notes("2/3"), notes("1"), notes("2")), (1, 1, 1));
        assert!(drawing.full_caption().contains("Crosses"), "{}", drawing.full_caption());
        let whole = super::drawing(&tests::places(2, 3), "subject").unwrap();
        assert!(!whole.full_caption().contains("Crosses"), "{}", whole.full_caption());
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
