//! Tests of the recording of a fleet.

use std::fs::File;

use skein_common::id::FleetVehicle;
use skein_common::message::EventKind;
use skein_common::scenario::{Source, load_any};

use super::super::{RecordingInfo, Writer, log_time_ns};
use super::*;
use crate::metrics::Run;

/// Begins the recording of this fleet at `path`.
pub(in super::super) fn fleet_writer(path: &Path, text: &str) -> Writer<File> {
    let described = load_any(&Source { name: "fleet.toml", text }, &[]).unwrap();
    let scenario = &described.first().scenario;
    let about = RecordingInfo { scenario, scenario_toml: text, run: &Run::default(), is_fleet: true };
    Writer::begin(File::create_new(path).unwrap(), &about, "", 0).unwrap()
}

#[test]
fn what_is_recorded_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FLEET_FILE);
    let mut writer = fleet_writer(&path, "[fleet]\nteams = 2\n[swarm]\nvehicles = 2\n");
    let place = |number: u8, north_m: f64| VehiclePlace {
        id: VehicleId::new(number).unwrap(),
        step: 1,
        north_m,
        east_m: -12.3,
        altitude_m: 30.0,
        in_place: true,
    };
    let team = |team: u16, t_s: f64| TeamPlaces {
        team: TeamId::new(team).unwrap(),
        t_s,
        vehicles: vec![place(1, 24_000.1), place(2, t_s)],
    };
    let written = [team(1, 0.0), team(2, 0.0), team(1, 1.0)];
    written.iter().for_each(|places| writer.places(log_time_ns(0, places.t_s), places));
    let sender = FleetVehicle { team: TeamId::FIRST, vehicle: VehicleId::new(1).unwrap() };
    writer.event(1_000_000_000, sender, None, &EventKind::Landed);
    writer.finish(2).unwrap();
    let lacks = Lacks { unrecorded: 2, ..Lacks::default() };
    assert_eq!(read_fleet(&path).unwrap(), FleetPlaces { places: written.to_vec(), lacks });
}
