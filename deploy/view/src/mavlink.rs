//! `--mavlink`: shows the swarm to QGroundControl and every other ground station that uses MAVLink, one system for each vehicle,
//! and passes on the orders that it gives.
//!
//! | module | what it does |
//! | --- | --- |
//! | `telemetry`, `modes` | what a vehicle's summary is in MAVLink |
//! | `commands` | what a ground station's commands mean |
//! | `bridge` | what is sent and answered, without a clock and without a socket |
//! | `frames` | bytes of datagrams, and signatures |
//! | `edge` | the socket, and the thread that gives orders |

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use skein_lab::error::Error;

use super::orders::Rule;

mod bridge;
mod commands;
mod edge;
mod frames;
mod modes;
mod telemetry;

use edge::Station;

/// Number of the message with the autopilot's version.
const AUTOPILOT_VERSION: u32 = 148;

/// Options for ground stations.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct MavlinkArgs {
    /// Send MAVLink to a ground station at this address, such as QGroundControl at 127.0.0.1:14550; with --orders its commands are
    /// passed on
    #[arg(long, value_name = "HOST:PORT", conflicts_with_all = ["terminal", "recording"])]
    pub mavlink: Option<String>,
    /// File with the 32 bytes of a key: MAVLink messages are signed with it, and unsigned ones are dropped
    #[arg(long, value_name = "FILE", requires = "mavlink")]
    pub mavlink_key: Option<PathBuf>,
    /// Added to the system ids of the vehicles: a ground station that sees two swarms needs different ids
    #[arg(long, value_name = "N", requires = "mavlink", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=249))]
    pub mavlink_id_offset: u8,
}

impl MavlinkArgs {
    /// The ground station, if one is wanted; with `orders` it gives orders.
    ///
    /// # Errors
    /// If the address or the key is wrong, or another PC or user could give orders without a key.
    pub(super) fn station(&self, orders: Option<&Rule>) -> Result<Option<Station>, Error> {
        let Some(name) = &self.mavlink else { return Ok(None) };
        let key = self.mavlink_key.as_deref().map(frames::key).transpose()?;
        let address = address(name)?;
        let is_open = key.is_none() && orders.is_some_and(|rule| rule.needs_token() || !address.ip().is_loopback());
        if is_open {
            return Err(Error::Refused(format!(
                "--orders: every program that sends from {name} could order the swarm: sign with a key, --mavlink-key FILE"
            )));
        }
        Station::open(address, frames::Frames::new(key), orders.is_some(), self.mavlink_id_offset).map(Some)
    }
}

/// The address of the ground station.
fn address(name: &str) -> Result<SocketAddr, Error> {
    let refused =
        |why: &str| Error::Refused(format!("--mavlink {name}: {why}; give HOST:PORT, such as 127.0.0.1:14550"));
    let mut found = name.to_socket_addrs().map_err(|error| refused(&error.to_string()))?;
    found.next().filter(|address| address.port() != 0).ok_or_else(|| refused("no such address"))
}

#[cfg(test)]
mod tests;
