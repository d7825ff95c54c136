//! Asks whether an X-Plane answers, through the same socket code that an agent uses.

use std::time::Duration;

use skein_agent::plant::xplane::XPlane;
use skein_agent::plant::xplane::{listen_for, simulator};
use skein_common::frame::{Geodetic, Origin};
use skein_core::aircraft::Profile;
use skein_core::helicopter::TICK_S;
use skein_core::plant::Plant;
use skein_host::clock;

use super::survey::version_text;

/// Time to wait for the simulator.
const SIMULATOR: Duration = Duration::from_secs(2);
/// Longest duration of one wait for a position.
const ATTEMPT: Duration = Duration::from_millis(100);

/// Connects to the X-Plane at `HOST[:PORT]` as an agent does. The origin of its frame is arbitrary.
///
/// # Errors
/// If the address is unknown, or no socket can be opened.
pub fn link(address: &str, profile: &Profile) -> Result<XPlane, String> {
    let simulator = simulator(address).map_err(|error| error.to_string())?;
    let anywhere = Origin::new(Geodetic::from_degrees(0.0, 0.0, 0.0));
    let rate_hz = (1.0 / TICK_S).round() as u32;
    let link = XPlane::new(&anywhere, Some(simulator), profile, rate_hz, listen_for(simulator.ip()));
    link.map_err(|error| error.to_string())
}

/// Asks the X-Plane at `HOST[:PORT]` and describes its answer: version, position, paused or not. Its controls are not
/// touched.
///
/// # Errors
/// If it does not answer: a sentence with the reason and the remedy.
pub fn ask(address: &str) -> Result<String, String> {
    let mut link = link(address, &Profile::default())?;
    let until = clock::now() + SIMULATOR;
    let mut place = None;
    while clock::now() < until && (place.is_none() || link.client.version().is_none()) {
        // Each wait renews the subscription if nothing arrives.
        if let Some(frame) = link.wait(ATTEMPT.min(until.saturating_duration_since(clock::now()))).frame {
            place = Some(frame.measurement.position);
        }
    }
    let received = link.counters();
    let version = link.client.version().map(|version| format!("X-Plane {}", version_text(version)));
    let name = version.unwrap_or_else(|| "an X-Plane of unknown version".to_owned());
    match place {
        Some(place) => Ok(format!(
            "{name}, aircraft at {:.5}°, {:.5}°, {:.0} m",
            place.latitude_deg(),
            place.longitude_deg(),
            place.altitude_m
        )),
        None if received.frozen_frames > 0 => Ok(format!("{name}, paused")),
        // Its positions come from another port than its values, and the time was too short to verify that port.
        None if received.unproven > 0 && received.foreign == 0 && link.client.version().is_some() => {
            Ok(format!("{name}, its positions not yet verified"))
        }
        None if received.foreign > 0 => Err(format!(
            "{address}: positions arrive that may come from another program; does a program beside X-Plane send to its clients?"
        )),
        None if received.malformed > 0 => Err(format!("{address}: the program that answers is not X-Plane")),
        None => Err(format!(
            "{address}: no answer within {} s; is X-Plane running with a flight loaded, its network setting \"Accept \
             incoming connections\" on, and UDP let through both ways?",
            SIMULATOR.as_secs()
        )),
    }
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;
    use std::thread;

    use super::*;

    #[test]
    fn a_simulator_reports_its_version_and_position() {
        use std::sync::Arc;
        use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

        use clap::Parser;
        use skein_agent::plant::xplane::standin::{Standin, StandinOptions};

        #[derive(Parser)]
        struct Cli {
            #[command(flatten)]
            options: StandinOptions,
        }
        let place = ["standin", "--port", "0", "--beacon", "false", "--lat", "28.5", "--lon", "-82.25"];
        for more in [&[][..], &["--split-ports"]] {
            let options = Cli::parse_from(place.iter().chain(more)).options;
            let mut standin = Standin::open(&options).unwrap();
            let address = standin.address;
            let stop = Arc::new(AtomicBool::new(false));
            let of_thread = stop.clone();
            let standin = thread::spawn(move || standin.run(&of_thread));
            let received = ask(&address.to_string());
            stop.store(true, Relaxed);
            standin.join().unwrap();
            let received = received.unwrap();
            assert!(
                received.starts_with("X-Plane 12.4.0, aircraft at 28.50000°, -82.25000°, "),
                "{more:?}: {received}"
            );
        }
    }

    #[test]
    fn a_simulator_that_does_not_answer_is_an_error() {
        let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = silent.local_addr().unwrap().to_string();
        let error = ask(&address).unwrap_err();
        assert!(error.contains(&address) && error.contains("no answer within 2 s"), "{error}");
        assert!(ask("127.0.0.1:x").is_err());
    }

    #[test]
    fn versions_have_three_parts() {
        assert_eq!([121_400, 115_501].map(version_text), ["12.1.4", "11.5.5"]);
    }
}
