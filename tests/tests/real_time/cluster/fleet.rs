//! The simulators on the hosts, a helicopter in each X-Plane, and the operator's files that describe them.

use std::fmt::Write;
use std::fs;
use std::process::{Child, Stdio};

use skein_common::frame::{Geodetic, Origin, PositionNed};
use skein_common::math;
use skein_common::scenario::{Source, load};

use super::host::Host;
use super::lab::{HOSTS, Lab};

/// Radius of the ring, m.
pub(super) const RADIUS_M: f64 = 40.0;
/// Half the width of the ring's band, m.
pub(super) const BAND_M: f64 = 10.0;
/// Altitude of the formation, m.
pub(super) const ALTITUDE_M: f64 = 5.0;
/// Port of every X-Plane.
const PORT: u16 = 49_000;

/// The running simulators; dropping the value ends them.
pub(super) struct Fleet {
    simulators: Vec<Child>,
}

impl Fleet {
    /// Starts the X-Plane of each of these vehicles.
    pub(super) fn start(lab: &Lab, vehicles: impl IntoIterator<Item = u8>) -> Self {
        let mut fleet = Self { simulators: Vec::new() };
        vehicles.into_iter().for_each(|id| fleet.add(lab, id));
        fleet
    }

    /// Starts one more simulator, with the helicopter of vehicle `id`.
    pub(super) fn add(&mut self, lab: &Lab, id: u8) {
        let pc = lab.pc(id);
        pc.put_program(&lab.operator().path("/opt/skein"), "/opt/x-plane");
        let place = start(id);
        let mut command = pc.command("/opt/x-plane");
        let beacon = is_elsewhere(id).to_string();
        if is_elsewhere(id) {
            // X-Plane accepts packets from every PC. The stand-in does so only with its beacon, and if it can bind
            // every address, because it answers only on its own.
            pc.sh("echo 1 >/proc/sys/net/ipv4/ip_nonlocal_bind").succeeded();
        }
        command.args(["xplane", "standin", "--beacon", &beacon, "--port", &PORT.to_string()]);
        command.args(["--lat", &place.latitude_deg().to_string(), "--lon", &place.longitude_deg().to_string()]);
        command.args(["--alt", &place.altitude_m.to_string()]);
        let silent = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        self.simulators.push(silent.spawn().unwrap());
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        for simulator in &mut self.simulators {
            let _ = simulator.kill();
            let _ = simulator.wait();
        }
    }
}

/// Position of the helicopter of vehicle `id` before take-off.
fn start(id: u8) -> Geodetic {
    let scenario = load(&Source { name: "fleet", text: &scenario(id) }, &[]).unwrap().scenario;
    let [north_m, east_m] = start_ne_m(id);
    let on_ellipsoid =
        Origin::new(scenario.origin.geodetic()).geodetic_from_ned(PositionNed::new(north_m, east_m, 0.0));
    Geodetic { altitude_m: scenario.origin.elevation_m, ..on_ellipsoid }
}

/// The position before take-off in the format of `skein check`.
pub(super) fn place(id: u8) -> String {
    let start = start(id);
    format!("{:.5}°, {:.5}°", start.latitude_deg(), start.longitude_deg())
}

/// Start positions alternate between inside and outside of the ring's band: every vehicle has to fly to the ring, and
/// no two paths meet.
fn start_ne_m(id: u8) -> [f64; 2] {
    let (east, north) = math::sin_cos((f64::from(id) * 40.0).to_radians());
    let from_centre_m = RADIUS_M + if id.is_multiple_of(2) { BAND_M + 6.0 } else { -BAND_M - 6.0 };
    [from_centre_m * north, from_centre_m * east]
}

/// The scenario of a ring. All steps have the same place, so that each takes only its dwell time.
pub(super) fn scenario(vehicles: u8) -> String {
    let step = "{ centre_ne_m = [0, 0] }, ".repeat(400);
    let mut text = format!(
        "name = \"ring\"\n[swarm]\nvehicles = {vehicles}\nplant = \"xplane\"\n[formation]\nradius_m = {RADIUS_M:?}\n\
         inner_width_m = {BAND_M:?}\nouter_width_m = {BAND_M:?}\naltitude_m = {ALTITUDE_M:?}\n\
         [mission]\ndwell_s = 2\nsteps = [{step}]\n"
    );
    for id in 1..=vehicles {
        let [north_m, east_m] = start_ne_m(id);
        write!(text, "[vehicle.{id}]\nstart_ne_m = [{north_m:?}, {east_m:?}]\n").unwrap();
    }
    text
}

/// Whether this vehicle's X-Plane runs on another PC than its agent.
fn is_elsewhere(id: u8) -> bool {
    id >= HOSTS
}

/// The cluster file of these eight hosts; the agent of a ninth vehicle runs on the eighth.
fn inventory(lab: &Lab, vehicles: u8) -> String {
    let mut text =
        "swarm = \"lab\"\nscenario = \"ring.toml\"\nkeys = \"keys\"\n[defaults]\nplant = \"xplane\"\n".to_owned();
    for id in 1..=vehicles {
        let Host { name, address, .. } = lab.host(id.min(HOSTS));
        let xplane = if is_elsewhere(id) { &lab.pc(id).address } else { "127.0.0.1" };
        writeln!(text, "[node.{id}]\nhost = \"{name}\"\naddress = \"{address}\"\nxplane = \"{xplane}:{PORT}\"")
            .unwrap();
    }
    text
}

/// Writes the scenario and the cluster file into the folder `lab` on the operator's PC.
pub(super) fn describe(lab: &Lab, vehicles: u8) {
    let folder = lab.operator().path("/root/lab");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("ring.toml"), scenario(vehicles)).unwrap();
    fs::write(folder.join("cluster.toml"), inventory(lab, vehicles)).unwrap();
}
