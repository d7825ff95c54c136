//! The default hover formation, flown by real processes in each plant. The module's name puts these tests before the shorter ones.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use clap::{Args, FromArgMatches};
use skein_agent::plant::xplane::standin::{Standin, StandinOptions, WebPort};
use skein_common::id::VehicleId;
use skein_tests::share::Share;

use crate::fly::Place;

/// Flies fifty seconds of the default hover formation and checks its limits. At the end the ring is already spaced
/// evenly. Gives what was written on stderr.
fn flies_the_default_formation(name: &'static str, plant: &[&str]) -> String {
    let place = Place::new(name);
    let mut command = place.command();
    command.args(["fly", "--json", "--duration", "50", "--plant"]).args(plant).arg("--out").arg(place.out());
    let flown = command.arg("--set").arg(format!("swarm.name={name}")).output().unwrap();
    assert!(flown.status.success(), "{}", String::from_utf8_lossy(&flown.stderr));
    assert_eq!(place.processes(), []);
    let metrics = place.metrics();
    let figure = |key: &str| metrics[key].as_f64().unwrap_or_else(|| panic!("{key} in {metrics:#}"));
    println!(
        "{plant:?}: at altitude {:.1} s, in band {:.1} s, least separation {:.1} m, tilt {:.1} deg, step p99 {:.0} us",
        figure("at_altitude_s"),
        figure("in_band_s"),
        figure("min_separation_m"),
        figure("max_tilt_deg"),
        figure("step_p99_us"),
    );
    assert!(figure("at_altitude_s") <= 20.0 && figure("in_band_s") <= 30.0, "{metrics:#}");
    assert!(figure("min_separation_m") >= 10.0 && figure("max_tilt_deg") <= 25.0, "{metrics:#}");
    assert!(figure("nearest_pair_end_m") >= 100.0 && figure("collisions") == 0.0, "{metrics:#}");
    String::from_utf8_lossy(&flown.stderr).into_owned()
}

#[test]
fn a_default_formation_is_flown_by_four_processes_on_the_built_in_model() {
    let _share = Share::of_flight(4);
    flies_the_default_formation("default-builtin", &["builtin"]);
}

#[test]
fn a_default_formation_is_flown_by_four_processes_over_the_simulators_protocol() {
    let _share = Share::of_flight(8);
    flies_the_default_formation("default-standin", &["standin"]);
}

/// Two of the simulators have a Web API, which places their aircraft.
#[test]
fn a_default_formation_is_flown_over_slow_irregular_simulators_that_lose_datagrams() {
    let _share = Share::of_flight(8);
    let stop = Arc::new(AtomicBool::new(false));
    let simulators: Vec<_> = (1..=4_u8).map(|id| slow_simulator(id, stop.clone())).collect();
    let web = [1, 3].map(|id| format!("vehicle.{id}.web=127.0.0.1:{}", WEB_PORT + 10 * (id - 1)));
    let xplane = format!("127.0.0.1:{SLOW_PORT}");
    let arguments = ["xplane", "--xplane", &xplane, "--set", &web[0], "--set", &web[1]];
    let stderr = flies_the_default_formation("default-slow", &arguments);
    let placed: Vec<_> = stderr.lines().filter(|line| line.contains("from its start")).collect();
    assert!(placed.iter().all(|line| line.contains(" ok ")), "{stderr}");
    let by_web: Vec<_> = placed.iter().map(|line| line.contains("by its Web API")).collect();
    assert_eq!(by_web, [true, false, true, false], "{stderr}");
    stop.store(true, Ordering::Relaxed);
    simulators.into_iter().for_each(|simulator| simulator.join().unwrap());
}

/// Port of the first slow simulator, outside the range from which the system chooses ports.
const SLOW_PORT: u16 = 17_300;
/// Port of the first Web API.
const WEB_PORT: u16 = 17_400;

/// A simulator of 30 irregular frames a second that loses a datagram in twenty. One with an odd number has a Web API.
fn slow_simulator(id: u8, stop: Arc<AtomicBool>) -> JoinHandle<()> {
    let defaults = StandinOptions::augment_args(clap::Command::new("standin")).get_matches_from(["standin"]);
    let options = StandinOptions {
        port: SLOW_PORT,
        id: VehicleId::new(id).unwrap(),
        rate: 30,
        jitter: 0.5,
        drop: 0.05,
        web: WebPort((id % 2 == 1).then_some(WEB_PORT)),
        beacon: false,
        ..StandinOptions::from_arg_matches(&defaults).unwrap()
    };
    let mut simulator = Standin::open(&options).unwrap();
    std::thread::spawn(move || simulator.run(&stop))
}
