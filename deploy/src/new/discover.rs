//! Finds the X-Planes of a network by their beacons.

use std::time::Duration;

use skein_agent::plant::xplane::discovery::{self, FoundSimulator};
use skein_common::printable::printable;
use skein_lab::error::Error;

/// Most bytes of a computer's name that are shown.
const MAX_NAME: usize = 60;

/// The interface over which an X-Plane is reached, for the end of a line.
pub(crate) fn over(found: &FoundSimulator) -> String {
    found.interface.as_ref().map(|name| format!(" over {}", printable(name, MAX_NAME))).unwrap_or_default()
}

/// Listens for this long, s, and returns every X-Plane that flies its own aircraft, in the order of addresses.
///
/// # Errors
/// If the beacons cannot be received, or none was.
pub(super) fn listen(for_s: f64) -> Result<Vec<FoundSimulator>, Error> {
    let time = Duration::try_from_secs_f64(for_s).map_err(|_| Error::Refused(format!("--wait {for_s}: not a time")))?;
    let found = heard(time)?;
    if found.is_empty() {
        return Err(Error::Failed(format!(
            "no X-Plane was found within {for_s} s: beacons are UDP multicast to 239.255.1.1:49707, which a firewall or a \
             router may hold back; `skein files new cluster` without --discover writes a file to fill in"
        )));
    }
    Ok(found)
}

/// Listens for this time and returns every X-Plane that flies its own aircraft, in the order of addresses, with the name of its
/// computer safe for a terminal.
///
/// # Errors
/// If the beacons cannot be received.
pub(crate) fn heard(time: Duration) -> Result<Vec<FoundSimulator>, Error> {
    let mut found = discovery::listen(time)
        .map_err(|error| Error::Failed(format!("the beacons of X-Planes cannot be received: {error}")))?;
    found.iter_mut().for_each(|found| found.computer = printable(&found.computer, MAX_NAME));
    Ok(found)
}
