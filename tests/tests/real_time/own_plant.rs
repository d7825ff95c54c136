//! A plant that Skein does not have, flown by an agent's station through the same trait as every other plant.

// As in the agent's `plant.rs`, the module above a plant has these.
use skein_agent::plant::{PlantError, PlantVehicle};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::scenario::{Source, load};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::formation::Workspace;
use skein_core::plant::Plant;
use skein_core::station::{Clocks, Station, StepInputs};
use skein_host::clock::LocalClock;
use skein_tests::share::Share;

#[path = "../../own-plant/kite.rs"]
mod kite;

#[test]
fn a_kite_takes_off_and_climbs_to_the_formations_altitude() {
    let _share = Share::of(10);
    let text = "swarm.vehicles = 1\nplant.model = \"point_mass\"\nformation.altitude_m = 20";
    let scenario = load(&Source { name: "kite.toml", text }, &[]).unwrap().scenario;
    let (id, aircraft, rules) =
        (VehicleId::new(1).unwrap(), Aircraft::shipped("xcell60").unwrap().unwrap(), Rules::shipped());
    let vehicle = PlantVehicle { scenario: &scenario, id, aircraft: &aircraft, rules: &rules, flown_s: None };
    let mut plant: Box<dyn Plant> = Box::new(kite::open(&vehicle).unwrap());
    let clocks = Clocks::new(&scenario, id);
    let mut station = Station::new(&scenario, id, Incarnation(1), (&aircraft, rules.clone()), clocks).unwrap();
    let (clock, mut inputs, mut workspace) = (LocalClock::start(), StepInputs::default(), Workspace::default());
    let timeout = std::time::Duration::from_secs_f64(1.5 * plant.frame_period_s());
    let mut height_m: f64 = 0.0;
    while (height_m - 20.0).abs() > 1.0 {
        let wake = plant.wait(timeout);
        let now = clock.now();
        assert!(now.seconds() < 60.0, "at {height_m} m");
        height_m = wake.frame.map_or(height_m, |frame| frame.truth.height_m);
        inputs.plant_time = wake.frame.map_or(inputs.plant_time, |frame| frame.time);
        inputs.measurement = wake.frame.map(|frame| frame.measurement);
        (inputs.right, inputs.status) = (now, wake.status);
        if let Some(command) = station.step_with(&mut inputs, &mut workspace).command {
            plant.command(command);
        }
    }
}
