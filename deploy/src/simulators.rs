//! Finds the X-Planes that a flight on this PC uses, and asks whether each answers.

mod probe;
pub(crate) mod survey;
pub(crate) mod web;

use std::net::ToSocketAddrs;
use std::thread;

use skein_agent::plant::xplane::wire;
use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;

use crate::ports;
use skein_lab::error::Error;

/// A host and a UDP port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HostPort {
    /// Name or address of the host.
    pub host: String,
    /// UDP port.
    pub port: u16,
}

impl std::str::FromStr for HostPort {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let (host, port) = text.rsplit_once(':').unwrap_or((text, ""));
        let port = if port.is_empty() && !text.contains(':') { Ok(wire::PORT) } else { port.parse() };
        match port {
            Ok(port) if port > 0 && !host.is_empty() => Ok(Self { host: host.to_owned(), port }),
            _ => Err("has to be HOST or HOST:PORT, such as 10.0.0.7:49000".to_owned()),
        }
    }
}

/// Returns HOST:PORT of each vehicle's X-Plane, in the order of ids: from the command line, else from the scenario,
/// else on this PC.
///
/// # Errors
/// If a port exceeds the largest one or a host is unknown.
pub fn addresses(scenario: &Scenario, first: Option<&HostPort>) -> Result<Vec<String>, Error> {
    let here = HostPort { host: "127.0.0.1".to_owned(), port: wire::PORT };
    let address = |id: VehicleId| match (first, scenario.vehicle(id).and_then(|vehicle| vehicle.xplane.clone())) {
        (None, Some(own)) => Ok(own),
        (first, _) => {
            let HostPort { host, port } = first.unwrap_or(&here);
            let own = ports::simulator(*port, id)
                .ok_or_else(|| Error::Refused(format!("--xplane: no port is left for vehicle {id}")))?;
            Ok(format!("{host}:{own}"))
        }
    };
    let addresses = scenario.ids().map(address).collect::<Result<Vec<_>, Error>>()?;
    for address in &addresses {
        address.to_socket_addrs().map_err(|error| Error::Refused(format!("X-Plane at {address}: {error}")))?;
    }
    Ok(addresses)
}

/// Asks the X-Plane at this address and describes its answer.
///
/// # Errors
/// If it does not answer: a sentence with the reason and the remedy.
pub fn ask(address: &str) -> Result<String, Error> {
    probe::simulator_at(address).map_err(Error::Failed)
}

/// Asks all X-Planes at once. This takes 2 s if one does not answer.
///
/// # Errors
/// If any does not answer: the error of [`ask`] for each, one a line.
pub fn ask_all(addresses: &[String]) -> Result<(), Error> {
    let asking = addresses.iter().cloned().map(|address| thread::spawn(move || ask(&address)));
    let asking: Vec<_> = asking.collect();
    // A thread that panicked has printed the reason.
    let answers = asking.into_iter().filter_map(|asking| asking.join().ok());
    let silent: Vec<String> = answers.filter_map(Result::err).map(|error| error.to_string()).collect();
    if silent.is_empty() { Ok(()) } else { Err(Error::Failed(silent.join("\n"))) }
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
        let of = |sets: &[&str], first: Option<&str>| {
            let sets = sets.iter().map(|set| (*set).to_owned()).collect();
            let scenario = ScenarioArgs { scenario: None, sets }.read(Vec::new()).unwrap().scenario;
            addresses(&scenario, first.map(|text| text.parse().unwrap()).as_ref())
        };
        let four = of(&[], Some("127.0.0.2:50000")).unwrap();
        assert_eq!(four, ["127.0.0.2:50000", "127.0.0.2:50010", "127.0.0.2:50020", "127.0.0.2:50030"]);
        let own = of(&["vehicle.2.xplane=127.0.0.3:49000"], None).unwrap();
        assert_eq!(own[..2], ["127.0.0.1:49000", "127.0.0.3:49000"]);
        let beyond = of(&[], Some("127.0.0.2:65530")).unwrap_err();
        assert_eq!(beyond.to_string(), "--xplane: no port is left for vehicle 2");
        assert!(of(&["vehicle.2.xplane=no host:49000"], None).is_err());
    }

    #[test]
    fn a_host_may_have_a_port() {
        let parse = |text: &str| text.parse::<HostPort>().map(|parsed| (parsed.host, parsed.port)).ok();
        assert_eq!(parse("heli"), Some(("heli".to_owned(), 49_000)));
        assert_eq!(parse("10.0.0.7:49010"), Some(("10.0.0.7".to_owned(), 49_010)));
        for bad in ["", ":", ":1", "heli:", "heli:x", "heli:0", "heli:70000"] {
            assert_eq!(parse(bad), None, "{bad:?}");
        }
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
