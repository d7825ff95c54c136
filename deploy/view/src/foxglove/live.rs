//! Publishes a live swarm to Foxglove: every step, event and position, as a recorder would write them.
//!
//! The vehicles compute and send their traces only while a client reads a channel.

use std::net::SocketAddr;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

use foxglove::websocket::Status;
use skein_common::scenario::Described;
use skein_host::clock::Utc;
use skein_lab::error::Error;
use skein_lab::record::Channels;

use super::{Server, ServerSink};
use skein_cluster::mesh::observe::Rate;
use skein_cluster::mesh::observe::SwarmMessage;

/// Name of the status that says why nothing is shown.
const STATUS: &str = "swarm";

/// The server of a live swarm.
pub(crate) struct Live {
    server: Server,
    /// The channels of the swarm that was found.
    flight: Option<(Channels<ServerSink>, Rate)>,
    utc: Utc,
    /// The reason why the swarm that was found has no channels, if it has none.
    refused: Option<String>,
    /// The reason why nothing is shown, as clients know it.
    problem: Option<String>,
}

impl Live {
    /// Starts the server, without channels until a swarm is found. Returns the address that it listens at, too.
    ///
    /// # Errors
    /// If the address is not free.
    pub(crate) fn start(address: SocketAddr) -> Result<(Self, SocketAddr), Error> {
        let server = Server::start(address, "skein".to_owned(), None)?;
        let listens = SocketAddr::new(address.ip(), server.handle.port());
        Ok((Self { server, flight: None, utc: Utc::read(), refused: None, problem: None }, listens))
    }

    /// Whether a client reads any channel.
    pub(crate) fn is_read(&self) -> bool {
        self.server.readers.are_any()
    }

    /// Offers the channels of this swarm instead of those of the last.
    pub(crate) fn found(&mut self, described: &Described) {
        self.flight = None;
        self.server.handle.clear_session(None);
        self.server.parameters.show(described);
        let flight = match described.all() {
            [only] => Channels::new(self.server.sink(), &only.scenario)
                .map(|channels| (channels, Rate::new(only.scenario.record.hz.live_hz())))
                .map_err(|error| error.to_string()),
            _ => Err("this is a fleet, and Foxglove shows one swarm: the page of `skein view` shows fleets".to_owned()),
        };
        (self.flight, self.refused) = match flight {
            Ok(flight) => (Some(flight), None),
            Err(why) => (None, Some(why)),
        };
    }

    /// Publishes a message of the swarm that arrived at this time.
    pub(crate) fn take(&mut self, received: &SwarmMessage, at: Instant) {
        let Some((channels, rate)) = &mut self.flight else { return };
        let log_time_ns = self.utc.nanoseconds(at);
        match received {
            SwarmMessage::Trace(trace) if rate.is_due(trace) => channels.step(log_time_ns, trace),
            SwarmMessage::Event(event) => {
                channels.event(log_time_ns, event.header.sender, Some(&event.header), &event.what);
            }
            other => {
                let note = other.note();
                note.into_iter().for_each(|(level, who, what)| channels.note(log_time_ns, level, who, what.to_owned()));
            }
        }
    }

    /// Draws for new readers, and says to all clients why nothing is shown; `problem` is why no swarm answers.
    pub(crate) fn look(&mut self, now: Instant, problem: Option<String>) {
        let Self { server, flight, utc, refused, problem: known } = self;
        if server.readers.take_new()
            && let Some((channels, _)) = flight
        {
            channels.draw(utc.nanoseconds(now));
        }
        let problem = problem.or_else(|| refused.clone());
        let has_connected = server.readers.has_connected.swap(false, Relaxed);
        match &problem {
            Some(text) if has_connected || *known != problem => {
                server.handle.publish_status(Status::error(text.as_str()).with_id(STATUS));
            }
            None if known.is_some() => server.handle.remove_status(vec![STATUS.to_owned()]),
            _ => {}
        }
        *known = problem;
    }
}
