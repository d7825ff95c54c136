//! What a fleet costs in virtual time over the network that it ships with, against a perfect one.

use std::num::NonZeroUsize;

use skein_lab::study::fly_fleet;
use skein_tests::fleet;

use crate::virtual_time::{SEED, peak_kb_of, print_peak_kb};
use crate::{print_table, processor_time_s, row};

/// Argument with which the bench starts itself, to measure the memory of one flight in a process of its own.
pub(super) const FLY_FLEET_ONCE: &str = "fly-fleet-once";
/// Numbers of teams.
const TEAMS: [usize; 2] = [64, 608];
/// How long the flights last, s.
const FLIGHT_S: f64 = 20.0;
/// The networks, the perfect one first: name and keys.
const NETWORKS: [(&str, &[&str]); 2] =
    [("perfect", &["network.loss=0", "network.delay_s=0"]), ("loss 5 %, delay 0.1 s", &[])];

fn keys(teams: usize, network: &[&str]) -> Vec<String> {
    let of_size = [format!("fleet.teams={teams}"), format!("duration_s={FLIGHT_S}"), format!("seed={SEED}")];
    of_size.into_iter().chain(network.iter().map(|&key| key.to_owned())).collect()
}

/// Flies `fleet.toml` with these keys, in one thread and without a recording; the number of vehicles.
fn fly(sets: &[String]) -> usize {
    let teams = fleet(include_str!("../../../deploy/scenarios/fleet.toml"), sets);
    let (_, recorded) = fly_fleet(&teams, NonZeroUsize::MIN, None).expect("the fleet flies");
    recorded.expect("nothing is recorded");
    teams.iter().map(|team| team.scenario.swarm.vehicles).sum()
}

/// Flies with these keys and prints the peak resident memory of this process, kB.
pub(super) fn fly_once(sets: &[String]) {
    fly(sets);
    print_peak_kb();
}

/// Prints the table.
pub(super) fn print() {
    println!("Fleets: {FLIGHT_S} s of fleet.toml, one thread, processor time.\n");
    let mut rows = vec![row(["", "vehicles", "vehicle-s per CPU-s", "times perfect", "kB per vehicle"])];
    for teams in TEAMS {
        eprintln!("a fleet of {teams} teams");
        let flown = NETWORKS.map(|(_, network)| processor_time_s(|| fly(&keys(teams, network))));
        for ((name, network), (time_s, vehicles)) in NETWORKS.into_iter().zip(flown) {
            let memory_kb = peak_kb_of(FLY_FLEET_ONCE, &keys(teams, network));
            rows.push(vec![
                name.to_owned(),
                vehicles.to_string(),
                format!("{:.0}", vehicles as f64 * FLIGHT_S / time_s),
                format!("{:.2}", time_s / flown[0].0),
                format!("{:.1}", memory_kb / vehicles as f64),
            ]);
        }
    }
    print_table(&rows);
    println!("kB per vehicle: peak resident memory of the process.\n");
}
