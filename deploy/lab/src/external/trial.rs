//! Tries external laws before anything flies.

use std::net::{TcpListener, UdpSocket};

use skein_common::scenario::Scenario;
use skein_host::external::protocol::Time;
use skein_host::external::{ExternalError, LawTransport, port_of};

use super::{LawError, Programs};

/// Checks whether external laws can be reached.
///
/// A law given as a command is started for the first vehicle only, as a sample of all. A law that connects or sends
/// datagrams may start later than the flight: the trial only binds its ports for a moment.
#[derive(Debug, Default)]
pub struct Trial(Option<Programs>);

impl Trial {
    /// Checks that this scenario's law can be reached, in virtual or real time.
    ///
    /// A law given as a command must start and report that it is ready. If the last scenario had the same command, its
    /// law is used again.
    ///
    /// # Errors
    /// The law cannot be reached, or does not report that it is ready.
    pub fn check(&mut self, scenario: &Scenario, time: Time) -> Result<(), LawError> {
        let last = self.0.take();
        let Some(transport) = LawTransport::of(scenario)? else { return Ok(()) };
        match &transport {
            LawTransport::Command(_) => {
                let mut laws = match last.filter(|last| last.transport == transport) {
                    Some(laws) => laws,
                    None => Programs::start(transport, scenario.ids().take(1), Default::default())?,
                };
                laws.begin_run(scenario)?;
                self.0 = Some(laws);
            }
            LawTransport::Listen(host, first) => {
                let ports: Vec<u16> = match time {
                    // In virtual time one law serves all vehicles.
                    Time::Virtual => vec![*first],
                    Time::Real => scenario.ids().map(|id| port_of(*first, id)).collect::<Result<_, _>>()?,
                };
                ports.into_iter().try_for_each(|port| {
                    let taken = TcpListener::bind((host.as_str(), port)).map(drop);
                    taken.map_err(|error| ExternalError::Port(format!("{host}:{port}"), error))
                })?;
            }
            LawTransport::Udp { ask, answer } => scenario.ids().try_for_each(|id| {
                port_of(ask.1, id)?;
                let port = port_of(answer.1, id)?;
                let taken = UdpSocket::bind((answer.0.as_str(), port)).map(drop);
                taken.map_err(|error| ExternalError::Port(format!("{}:{port}", answer.0), error))
            })?,
        }
        Ok(())
    }
}
