//! Live fleets of up to 64 agents for five minutes each; `.ci/long` flies them.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;

use serde_json::Value;
use skein_lab::record::{self, TeamPlaces};

use super::{Fleet, last_line};

/// Duration of each flight, s.
const FLOWN_S: u32 = 300;
/// When the agents of team 2 are killed, s.
const KILLED_S: f64 = 150.0;
/// From here on the rings are formed, s.
const FORMED_S: f64 = 60.0;
/// Vehicles below this height are not in the air, m.
const AIRBORNE_M: f64 = 2.0;

/// Teams of eight in a grid.
fn grid(teams: u8, spacing_m: u32) -> String {
    format!(
        "fleet = {{ teams = {teams}, spacing_m = {spacing_m}, record_hz = 5 }}\nswarm.vehicles = 8\nformation.radius_m = 60\n"
    )
}

/// Kills all agents of team 2.
fn kill() -> String {
    let events = (1..=8).map(|vehicle| format!("{{ at_s = {KILLED_S}, fault = \"kill\", vehicle = {vehicle} }}"));
    format!("[[team]]\nids = [2]\nmission.events = [{}]\n", events.collect::<Vec<_>>().join(", "))
}

/// Two teams that fly through each other, there and back, again and again.
fn crossing() -> String {
    let tour = |east_m: i32| {
        let steps = (0..8)
            .map(|nth| format!("{{ centre_ne_m = [0, {}], dwell_s = 3 }}", if nth % 2 == 0 { 0 } else { east_m }));
        steps.collect::<Vec<_>>().join(", ")
    };
    format!(
        "fleet = {{ teams = 2, pattern = \"list\", places_ne_m = [[0, 0], [0, 200]], record_hz = 5 }}\nswarm.vehicles = 8\n\
         formation.radius_m = 60\n[[team]]\nids = [1]\nmission.steps = [{}]\n[[team]]\nids = [2]\nmission.steps = [{}]\n",
        tour(400),
        tour(-400)
    )
}

/// The least distance of two vehicles of these teams in the air, m, within a team or, if `across`, of different teams.
fn least_m(places: &[TeamPlaces], is_chosen: impl Fn(u16) -> bool, (from_s, to_s): (f64, f64), across: bool) -> f64 {
    let mut samples: BTreeMap<i64, Vec<(u16, [f64; 3])>> = BTreeMap::new();
    for its in places.iter().filter(|its| is_chosen(its.team.get()) && (from_s..to_s).contains(&its.t_s)) {
        let high = its.vehicles.iter().filter(|vehicle| vehicle.altitude_m > AIRBORNE_M);
        let place = high.map(|it| (its.team.get(), [it.north_m, it.east_m, it.altitude_m]));
        samples.entry((its.t_s * 1e3).round() as i64).or_default().extend(place);
    }
    let mut least_m = f64::INFINITY;
    for places in samples.values() {
        for (nth, (team, one)) in places.iter().enumerate() {
            for (_, other) in places[..nth].iter().filter(|(other, _)| (other != team) == across) {
                let apart_m: f64 = one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum();
                least_m = least_m.min(apart_m.sqrt());
            }
        }
    }
    least_m
}

/// Flies one fleet, and adds a row to the table.
fn fly(table: &mut String, title: &str, name: &'static str, text: &str) {
    let fleet = Fleet::new(name, text);
    let output = fleet.fly(FLOWN_S).wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    let killed = text.contains("kill");
    let is_whole = |team: u16| !killed || team != 2;
    assert!(output.status.success() || killed, "{stderr}");
    let out = fleet.folder.path().join("out");
    let (mut late, mut p99_us, mut collisions, mut teams) = (0.0, 0.0_f64, 0.0, 0_u16);
    while let Ok(text) = fs::read_to_string(out.join(format!("team-{}", teams + 1)).join("metrics.json")) {
        teams += 1;
        let metrics: Value = serde_json::from_str(&text).unwrap();
        let figure = |key: &str| metrics[key].as_f64().unwrap_or(0.0);
        late += figure("frame_overruns");
        p99_us = p99_us.max(figure("step_p99_us"));
        collisions += figure("collisions");
    }
    let report = last_line(&output.stdout);
    let across = report["across_collisions"].as_f64().unwrap();
    let own = |team: u16| format!("team {team}: ");
    let lost = stderr.lines().filter(|line| line.contains("lost contact"));
    let lost = lost.filter(|line| (1..=teams).any(|team| is_whole(team) && line.starts_with(&own(team)))).count();
    let places = record::read_fleet(&out.join(record::FLEET_FILE)).unwrap().places;
    let whole_s = (FORMED_S, f64::from(FLOWN_S));
    let separation = match killed {
        true => {
            let [before, after] = [(FORMED_S, KILLED_S), (KILLED_S, whole_s.1)];
            let [before, after] = [before, after].map(|time| least_m(&places, is_whole, time, false));
            format!("{before:.1}, {after:.1}")
        }
        false => format!("{:.1}", least_m(&places, is_whole, whole_s, false)),
    };
    let across_m = least_m(&places, is_whole, whole_s, true);
    writeln!(
        table,
        "{title:<44}{late:>12}{p99_us:>10.0}{lost:>12}{:>12}{separation:>16}{across_m:>12.1}",
        collisions + across
    )
    .unwrap();
    assert!(lost == 0 && collisions + across == 0.0, "{table}\n{stderr}");
}

/// All shows, one after the other.
pub(super) fn table() -> String {
    let mut table = format!(
        "{:<44}{:>12}{:>10}{:>12}{:>12}{:>16}{:>12}\n",
        "five minutes", "late frames", "p99 us", "peers lost", "collisions", "least in teams", "across"
    );
    fly(&mut table, "4 teams of 8, team 2 killed after 150 s", "show-killed", &(grid(4, 1000) + &kill()));
    fly(&mut table, "2 teams of 8 that cross again and again", "show-crossing", &crossing());
    fly(&mut table, "8 teams of 8, 1 km apart", "show-64", &grid(8, 1000));
    table
        + "\nLate frames of all agents, the largest p99 of frame to controls, and of the teams that were not killed: peers lost, \
             and least distances in m (killed: before and after)\n"
}
