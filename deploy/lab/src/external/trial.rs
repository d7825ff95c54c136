//! External laws before anything flies.

use std::net::{TcpListener, UdpSocket};

use skein_common::scenario::Scenario;
use skein_host::external::protocol::Time;
use skein_host::external::{ExternalError, Way, port_of};

use super::{LawError, Laws};

/// Shows whether external laws can be reached: the law of the first vehicle is started and stands for all. A law that connects
/// or sends datagrams may be started later than the flight: only its ports are taken, for a moment.
#[derive(Debug, Default)]
pub struct Trial(Option<Laws>);

impl Trial {
    /// Makes sure that this scenario's law can be reached in this kind of time. A program starts and gets ready; it is that of
    /// the last scenario, if the command is the same.
    ///
    /// # Errors
    /// A law that cannot be reached, or does not get ready.
    pub fn of(&mut self, scenario: &Scenario, time: Time) -> Result<(), LawError> {
        let last = self.0.take();
        let Some(way) = Way::of(scenario)? else { return Ok(()) };
        match &way {
            Way::Command(_) => {
                let mut laws = match last.filter(|last| last.way == way) {
                    Some(laws) => laws,
                    None => Laws::start(way, scenario.ids().take(1))?,
                };
                laws.begin(scenario)?;
                self.0 = Some(laws);
            }
            Way::Listen(host, first) => {
                let ports: Vec<u16> = match time {
                    // One law serves all vehicles.
                    Time::Virtual => vec![*first],
                    Time::Real => scenario.ids().map(|id| port_of(*first, id)).collect::<Result<_, _>>()?,
                };
                ports.into_iter().try_for_each(|port| {
                    let taken = TcpListener::bind((host.as_str(), port)).map(drop);
                    taken.map_err(|error| ExternalError::Port(format!("{host}:{port}"), error))
                })?;
            }
            Way::Udp { ask, answer } => scenario.ids().try_for_each(|id| {
                port_of(ask.1, id)?;
                let port = port_of(answer.1, id)?;
                let taken = UdpSocket::bind((answer.0.as_str(), port)).map(drop);
                taken.map_err(|error| ExternalError::Port(format!("{}:{port}", answer.0), error))
            })?,
        }
        Ok(())
    }
}
