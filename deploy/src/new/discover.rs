//! Finds the X-Planes of a network by their beacons.

use std::time::Duration;

use skein_agent::plant::xplane::discovery;
use skein_common::printable::printable;
use skein_lab::error::Error;

use skein_cluster::simulators::survey::version_text;

/// Most bytes of a computer's name that are shown.
const MAX_NAME: usize = 60;

/// An X-Plane that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct FoundXPlane {
    /// Address of its computer.
    pub(crate) address: String,
    /// UDP port on which it receives.
    pub(crate) port: u16,
    /// Its version, `12.1.4`.
    pub(crate) version: String,
    /// Name of its computer, without control characters.
    pub(crate) computer: String,
    /// Name of this computer's interface over which it is reached, if that is known.
    pub(crate) interface: Option<String>,
}

impl FoundXPlane {
    /// The interface, for the end of a line.
    pub(crate) fn over(&self) -> String {
        self.interface.as_ref().map(|name| format!(" over {}", printable(name, MAX_NAME))).unwrap_or_default()
    }
}

/// Listens for this long, s, and returns every X-Plane that flies its own aircraft, in the order of addresses.
///
/// # Errors
/// If the beacons cannot be received, or none was.
pub(super) fn listen(for_s: f64) -> Result<Vec<FoundXPlane>, Error> {
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

/// Listens for this time and returns every X-Plane that flies its own aircraft, in the order of addresses.
///
/// # Errors
/// If the beacons cannot be received.
pub(crate) fn heard(time: Duration) -> Result<Vec<FoundXPlane>, Error> {
    let found = discovery::listen(time)
        .map_err(|error| Error::Failed(format!("the beacons of X-Planes cannot be received: {error}")))?;
    let shown = |found: discovery::FoundSimulator| FoundXPlane {
        address: found.address.to_string(),
        port: found.port,
        version: version_text(found.version),
        computer: printable(&found.computer, MAX_NAME),
        interface: found.interface,
    };
    Ok(found.into_iter().map(shown).collect())
}
