//! Two fleets of 64 vehicles, in teams of eight, that fly through each other over a lossy network.

use std::num::NonZeroUsize;

use skein_common::statistics::median;
use skein_lab::metrics::Measured;
use skein_lab::study::fly_fleet;

use crate::{fleet, in_parallel};

/// Number of teams of each fleet.
const TEAMS: usize = 8;

/// The file of both fleets, with this change of the second one.
fn file(change: &str) -> String {
    let places = (0..2 * TEAMS).map(|nth| {
        let (fleet, row, column) = (nth / TEAMS, nth % TEAMS / 4, nth % 4);
        format!("[{}, {}]", 1200 * fleet + 220 * row, 220 * column)
    });
    let second: Vec<String> = (TEAMS + 1..=2 * TEAMS).map(|team| team.to_string()).collect();
    format!(
        "name = \"meeting\"\nduration_s = 500\n[fleet]\nteams = 16\npattern = \"list\"\nplaces_ne_m = [{}]\n\
         [swarm]\nvehicles = 8\n[formation]\nradius_m = 60\n[start]\nsquare_m = 100\nseparation_m = 12\n\
         [network]\nloss = 0.2\ndelay_s = 0.2\n[mission]\nsteps = [{{ centre_ne_m = [0, 0], dwell_s = 5 }}, \
         {{ centre_ne_m = [1200, 0] }}, {{ land = true }}]\n[[team]]\nids = [{}]\nmission.steps = [{{ centre_ne_m = \
         [0, 0], dwell_s = 5 }}, {{ centre_ne_m = [-1200, 0] }}, {{ land = true }}]\n{change}",
        places.collect::<Vec<_>>().join(", "),
        second.join(", "),
    )
}

/// The cases: a name, and what changes of the second fleet.
fn cases() -> [(&'static str, String); 3] {
    let isolate = "mission.events = [{ at_s = 0, fault = \"isolate\" }]\n";
    let straight = format!(
        "[[team]]\nids = [16]\nswarm.vehicles = 1\nformation.law = \"virtual-structure\"\n{isolate}mission.steps = \
         [{{ centre_ne_m = [0, 0], dwell_s = 40 }}, {{ path_ne_m = [[0, 0], [-1600, -500]], speed_m_s = 5 }}, \
         {{ land = true }}]\n"
    );
    let isolated = format!("[[team]]\nids = [9, 10, 11, 12, 13, 14, 15, 16]\n{isolate}");
    [
        ("as they are", String::new()),
        ("one vehicle of the second receives nothing and flies straight on", straight),
        ("the second fleet receives nothing", isolated),
    ]
}

/// The table, with this many flights a row.
///
/// # Panics
/// If a fleet cannot be flown.
pub fn table(seeds: u64) -> String {
    let mut table =
        format!("{:<66}{:>8}{:>12}{:>12}{:>22}\n", "fleets", "flights", "collisions", "arrived", "least separation m");
    for (name, change) in cases() {
        let text = file(&change);
        let flown = in_parallel(0..seeds, |seed| {
            let teams = fleet(&text, &[format!("seed={seed}")]);
            let (report, _) = fly_fleet(&teams, NonZeroUsize::MIN, None).expect("a fleet that flies");
            let measured = Measured::of(&report);
            ["collisions", "setpoints_reached", "across_separation_m"]
                .map(|key| measured.value(key).unwrap_or(f64::NAN))
        });
        let of = |nth: usize| flown.iter().map(move |figures| figures[nth]);
        let mut apart_m: Vec<f64> = of(2).collect();
        let least_m = apart_m.iter().copied().fold(f64::INFINITY, f64::min);
        let median_m = median(&mut apart_m).unwrap_or(f64::NAN);
        let arrived = of(1).filter(|steps| *steps >= 2.0).count();
        let separation = format!("{median_m:.1} [{least_m:.1}]");
        table += &format!("{name:<66}{:>8}{:>12}{arrived:>12}{separation:>22}\n", flown.len(), of(0).sum::<f64>());
    }
    table
        + "\nSeparation across teams: median of the flights [least]. Collisions: pairs nearer than 2 m, of all flights.\n"
}
