//! What stands on the hosts before Skein comes: a helicopter in each one's X-Plane. And what Skein is told of it.

use std::fmt::Write;
use std::fs;
use std::process::{Child, Stdio};

use skein_common::frame::{Origin, PositionNed};
use skein_common::scenario::{Source, load};

use super::host::Host;
use super::lab::{HOSTS, Lab};

/// The ring, m.
pub(super) const RADIUS_M: f64 = 40.0;
/// Half the width of its band, m.
pub(super) const BAND_M: f64 = 10.0;
/// How high, m.
pub(super) const ALTITUDE_M: f64 = 5.0;
/// Where its X-Plane is, as each host sees it.
const PORT: u16 = 49_000;
/// Another helicopter, on host 8 too.
pub(super) const SECOND_PORT: u16 = 49_100;

/// Simulators: they end with their value, as with their host.
pub(super) struct Fleet {
    simulators: Vec<Child>,
}

impl Fleet {
    /// Starts X-Plane on every host, but on those in `without`.
    pub(super) fn start(lab: &Lab, without: &[u8]) -> Self {
        let mut fleet = Self { simulators: Vec::new() };
        for id in (1..=HOSTS).filter(|id| !without.contains(id)) {
            fleet.add(lab, lab.host(id), id, PORT);
        }
        fleet
    }

    /// Starts one more, with the helicopter of vehicle `id` in it.
    pub(super) fn add(&mut self, lab: &Lab, host: &Host, id: u8, port: u16) {
        if !host.path("/opt/x-plane").exists() {
            host.put_program(&lab.operator().path("/opt/skein"), "/opt/x-plane");
        }
        let scenario = load(&Source { name: "fleet", text: &scenario(id) }, &[]).unwrap().scenario;
        let [north_m, east_m] = start_ne_m(id);
        let place = Origin::new(scenario.origin.geodetic()).geodetic_from_ned(PositionNed::new(north_m, east_m, 0.0));
        let mut command = host.command("/opt/x-plane");
        command.args(["standin", "--beacon", "false", "--port", &port.to_string()]);
        command.args(["--lat", &place.latitude_deg().to_string(), "--lon", &place.longitude_deg().to_string()]);
        command.args(["--alt", &scenario.origin.elevation_m.to_string()]);
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

/// Inside the ring's band or outside of it, by turns: all have some way to go, and nobody meets anybody.
fn start_ne_m(id: u8) -> [f64; 2] {
    let (east, north) = (f64::from(id) * 40.0).to_radians().sin_cos();
    let from_centre_m = RADIUS_M + if id.is_multiple_of(2) { BAND_M + 6.0 } else { -BAND_M - 6.0 };
    [from_centre_m * north, from_centre_m * east]
}

/// A ring; each step is the same place, so that it takes no flight but a dwell.
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

/// `cluster.toml` of these eight hosts; a ninth agent flies from the eighth.
fn inventory(hosts: &[Host], vehicles: u8) -> String {
    let mut text =
        "swarm = \"lab\"\nscenario = \"ring.toml\"\nkeys = \"keys\"\n[defaults]\nplant = \"xplane\"\n".to_owned();
    for id in 1..=vehicles {
        let Host { name, address, .. } = &hosts[usize::from(id.min(HOSTS)) - 1];
        let port = if id > HOSTS { SECOND_PORT } else { PORT };
        writeln!(text, "[node.{id}]\nhost = \"{name}\"\naddress = \"{address}\"\nxplane = \"127.0.0.1:{port}\"")
            .unwrap();
    }
    text
}

/// Writes both into the folder `lab` on the operator's PC.
pub(super) fn describe(lab: &Lab, vehicles: u8) {
    let folder = lab.operator().path("/root/lab");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("ring.toml"), scenario(vehicles)).unwrap();
    fs::write(folder.join("cluster.toml"), inventory(&lab.hosts, vehicles)).unwrap();
}
