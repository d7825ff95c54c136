//! Finds the X-Planes that a flight on this PC uses, and asks whether each answers.

mod probe;
pub mod reset;
pub mod survey;
pub mod web;

use std::collections::BTreeMap;
use std::net::ToSocketAddrs;

use skein_agent::plant::xplane::wire;
use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;

use crate::ports::{self, HostPort};
pub use probe::{ask, link};
use skein_host::parallel::at_once;
use skein_lab::error::Error;

/// Returns HOST:PORT of each vehicle's X-Plane, in the order of ids: from the command line, else from the scenario,
/// else on this PC. One `named` X-Plane is that of vehicle 1, and the others are on its host; several are one for each
/// vehicle.
///
/// # Errors
/// If several are named but not one for each vehicle, two vehicles have the same, a port exceeds the largest one, or a
/// host is unknown.
pub fn addresses(scenario: &Scenario, named: &[HostPort]) -> Result<Vec<String>, Error> {
    let vehicles = scenario.swarm.vehicles;
    let in_a_row = |first: &HostPort, id: VehicleId| {
        let port = ports::simulator(first.port, id);
        let port = port.ok_or_else(|| Error::Refused(format!("--xplane: no port is left for vehicle {id}")))?;
        Ok(HostPort { host: first.host.clone(), port }.to_string())
    };
    let addresses = match named {
        [] => {
            let here = HostPort { host: "127.0.0.1".to_owned(), port: wire::PORT };
            let own = |id| scenario.vehicle(id).and_then(|vehicle| vehicle.xplane.clone());
            let each = scenario.ids().map(|id| own(id).map_or_else(|| in_a_row(&here, id), Ok));
            each.collect::<Result<Vec<_>, Error>>()?
        }
        [first] => scenario.ids().map(|id| in_a_row(first, id)).collect::<Result<Vec<_>, Error>>()?,
        named if named.len() == vehicles => named.iter().map(HostPort::to_string).collect(),
        named => {
            return Err(Error::Refused(format!(
                "--xplane names {} X-Planes for {vehicles} vehicles: name one for each vehicle, or only that of vehicle 1",
                named.len()
            )));
        }
    };
    let mut users = BTreeMap::new();
    for (id, address) in scenario.ids().zip(&addresses) {
        if let Some(other) = users.insert(address, id) {
            return Err(Error::Refused(format!(
                "X-Plane at {address}: vehicles {other} and {id} would share it; give each an X-Plane of its own"
            )));
        }
    }
    for address in &addresses {
        address.to_socket_addrs().map_err(|error| Error::Refused(format!("X-Plane at {address}: {error}")))?;
    }
    Ok(addresses)
}

/// Asks all X-Planes at once. This takes 2 s if one does not answer.
///
/// # Errors
/// If any does not answer: the error of [`ask`] for each, one a line.
pub fn ask_all(addresses: &[String]) -> Result<(), Error> {
    let answers = at_once(addresses.iter().map(|address| || ask(address))).into_iter();
    let silent: Vec<String> = answers.filter_map(Result::err).collect();
    if silent.is_empty() { Ok(()) } else { Err(Error::Failed(silent.join("\n"))) }
}

/// Whether at least one of these X-Planes answers.
pub fn any_answers(addresses: &[String]) -> bool {
    at_once(addresses.iter().map(|address| || ask(address).is_ok())).contains(&true)
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;
    use std::time::Duration;

    use super::*;
    use skein_host::clock;
    use skein_lab::scenario::ScenarioArgs;

    #[test]
    fn every_vehicle_has_its_own_x_plane() {
        let of = |sets: &[&str], named: &[&str]| {
            let sets = sets.iter().map(|set| (*set).to_owned()).collect();
            let scenario = ScenarioArgs { scenario: None, sets }.read(Vec::new()).unwrap().scenario;
            let named: Vec<HostPort> = named.iter().map(|text| text.parse().unwrap()).collect();
            addresses(&scenario, &named).map_err(|error| error.to_string())
        };
        let four = of(&[], &["127.0.0.2:50000"]).unwrap();
        assert_eq!(four, ["127.0.0.2:50000", "127.0.0.2:50010", "127.0.0.2:50020", "127.0.0.2:50030"]);
        let own = of(&["vehicle.2.xplane=127.0.0.3:49000"], &[]).unwrap();
        assert_eq!(own[..2], ["127.0.0.1:49000", "127.0.0.3:49000"]);
        let beyond = of(&[], &["127.0.0.2:65530"]).unwrap_err();
        assert_eq!(beyond, "--xplane: no port is left for vehicle 2");
        assert!(of(&["vehicle.2.xplane=no host:49000"], &[]).is_err());
        let each =
            of(&["vehicle.2.xplane=127.0.0.3:49000"], &["127.0.0.21", "127.0.0.22", "127.0.0.23:50000", "127.0.0.24"]);
        assert_eq!(each.unwrap(), ["127.0.0.21:49000", "127.0.0.22:49000", "127.0.0.23:50000", "127.0.0.24:49000"]);
        let few = of(&[], &["127.0.0.21", "127.0.0.22"]).unwrap_err();
        let one_for_each =
            "--xplane names 2 X-Planes for 4 vehicles: name one for each vehicle, or only that of vehicle 1";
        assert_eq!(few, one_for_each);
        let shared = of(&[], &["127.0.0.21", "127.0.0.22", "127.0.0.21:49000", "127.0.0.24"]).unwrap_err();
        let own = "X-Plane at 127.0.0.21:49000: vehicles 1 and 3 would share it; give each an X-Plane of its own";
        assert_eq!(shared, own);
    }

    #[test]
    fn all_silent_x_planes_are_reported_together() {
        let silent = [(); 8].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        let addresses = silent.each_ref().map(|socket| socket.local_addr().unwrap().to_string());
        let begin = clock::now();
        let error = ask_all(&addresses).unwrap_err();
        assert!(clock::now() < begin + Duration::from_secs(3), "one after the other would be 16 s");
        let lines: Vec<_> = error.to_string().lines().map(str::to_owned).collect();
        assert_eq!(lines, addresses.map(|address| ask(&address).unwrap_err().to_string()));
        assert_eq!(error.exit_code(), 1);
    }
}
