//! The socket of a ground station, and the thread that gives its orders to the swarm.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::terminal::complain;
use tokio::sync::watch;

use super::bridge::{Bridge, LAST_SYSTEM, Outgoing, Requested};
use super::frames::Frames;
use crate::live::Frame;
use skein_cluster::mesh::order::{self, Chosen};
use skein_cluster::mesh::reach::Place;

/// Longest wait for a datagram: then there may be something to send.
const WAIT: Duration = Duration::from_millis(20);
/// Number of datagrams that are read before something is sent.
const MOST_DATAGRAMS: usize = 64;
/// Largest datagram, bytes.
const DATAGRAM: usize = 2048;

/// An order, and the swarm that it is to.
type ToGive = (Arc<Place>, Requested);
/// An order with what became of it.
type Ordered = (Requested, Result<String, String>);

/// The socket of a ground station.
pub(crate) struct Station {
    socket: UdpSocket,
    codec: Frames,
    takes_orders: bool,
    /// The system id of the first vehicle less 1.
    offset: u8,
}

impl Station {
    /// Opens the socket of the ground station at this address.
    pub(super) fn open(address: SocketAddr, codec: Frames, takes_orders: bool, offset: u8) -> Result<Self, Error> {
        let failed = |error: std::io::Error| Error::Failed(format!("--mavlink {address}: {error}"));
        let own: SocketAddr = match address {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let socket = UdpSocket::bind(own).map_err(failed)?;
        // Nothing is received from other addresses.
        socket.connect(address).map_err(failed)?;
        socket.set_read_timeout(Some(WAIT)).map_err(failed)?;
        Ok(Self { socket, codec, takes_orders, offset })
    }

    /// Serves the ground station on threads of its own, until the process ends.
    pub(crate) fn serve(self, frames: watch::Receiver<Arc<Frame>>) {
        let (requests, requested) = channel();
        let (results, ordered) = channel();
        thread::spawn(move || give_orders(&requested, &results));
        let mut edge =
            Edge { station: self, frames, bridge: None, next_event: 0, requests, ordered, began: clock::now() };
        thread::spawn(move || edge.serve());
    }
}

struct Edge {
    station: Station,
    frames: watch::Receiver<Arc<Frame>>,
    /// The swarm with this number, once one was found.
    bridge: Option<(u64, Bridge)>,
    /// Number of the next event that the ground station has not been sent.
    next_event: u64,
    requests: Sender<ToGive>,
    ordered: Receiver<Ordered>,
    began: Instant,
}

impl Edge {
    fn serve(&mut self) {
        let mut datagram = [0; DATAGRAM];
        let (mut dropped, mut has_complained) = (0_u64, false);
        while self.frames.has_changed().is_ok() {
            for _ in 0..MOST_DATAGRAMS {
                match self.station.socket.recv(&mut datagram) {
                    Ok(length) => {
                        dropped += u64::from(self.receive(&datagram[..length]));
                        if dropped > 0 && !std::mem::replace(&mut has_complained, true) {
                            complain(
                                "--mavlink: a datagram of the ground station was dropped: no MAVLink, damaged, or not signed \
                                 with the key of --mavlink-key",
                            );
                        }
                    }
                    Err(error) => {
                        if !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) {
                            // Nothing listens there yet, for example.
                            clock::sleep(WAIT);
                        }
                        break;
                    }
                }
            }
            self.send_news();
        }
        tracing::debug!("{dropped} datagrams of the ground station were dropped");
    }

    /// Takes in a datagram; true if nothing in it could be read.
    fn receive(&mut self, datagram: &[u8]) -> bool {
        let messages = self.station.codec.read(datagram);
        for (header, message) in &messages {
            let Some((_, bridge)) = &mut self.bridge else { continue };
            let reaction = bridge.receive(*header, message);
            if let (Some(order), Some(place)) = (reaction.order, self.frames.borrow().place.clone()) {
                // The thread that gives orders ends with the process.
                let _ = self.requests.send((place, order));
            }
            self.send(reaction.answers);
        }
        messages.is_empty()
    }

    /// Sends what has become of orders, and what the vehicles have sent since the last time.
    fn send_news(&mut self) {
        while let Ok((requested, result)) = self.ordered.try_recv() {
            let Some((_, bridge)) = &mut self.bridge else { continue };
            let messages = bridge.ordered(&requested, result.as_deref().map_err(String::as_str));
            self.send(messages);
        }
        if !self.frames.has_changed().unwrap_or(false) {
            return;
        }
        let frame = Arc::clone(&self.frames.borrow_and_update());
        let (Some((_, number)), Some((teams, observed))) = (&frame.hello, frame.observed()) else { return };
        if self.bridge.as_ref().is_none_or(|(known, _)| known != number) {
            let count: usize = teams.iter().map(|team| team.scenario.ids().count()).sum();
            let offset = self.station.offset;
            let most = LAST_SYSTEM.saturating_sub(offset);
            if count > usize::from(most) {
                complain(&format!(
                    "--mavlink: {most} of {count} vehicles are shown: MAVLink has no system ids above {LAST_SYSTEM} for more"
                ));
            }
            self.bridge = Some((*number, Bridge::new(teams, self.station.takes_orders, offset)));
            // What happened before is past.
            self.next_event = frame.events.count();
        }
        let now = clock::now().saturating_duration_since(self.began);
        let Some((_, bridge)) = &mut self.bridge else { return };
        let mut messages = bridge.step(now, teams, observed);
        let (events, next) = frame.events.logged_since(self.next_event);
        self.next_event = next;
        messages.extend(events.iter().flat_map(|event| bridge.event(event.vehicle, &event.text, event.severity)));
        self.send(messages);
    }

    fn send(&mut self, messages: Vec<Outgoing>) {
        for (system, message) in messages {
            // There may be no ground station, and a datagram that does not fit into the socket's buffer is lost as on any network.
            let _ = self.station.socket.send(&self.station.codec.write(system, &message));
        }
    }
}

/// Gives the orders that wait, those to do the same as one order, until the process ends.
fn give_orders(requested: &Receiver<ToGive>, results: &Sender<Ordered>) {
    while let Ok((place, first)) = requested.recv() {
        let mut waiting: BTreeMap<String, Vec<Requested>> = BTreeMap::new();
        // All orders of one moment are to one swarm.
        for request in std::iter::once(first).chain(requested.try_iter().map(|(_, request)| request)) {
            waiting.entry(request.verb.to_string()).or_default().push(request);
        }
        for requests in waiting.into_values() {
            let Some(verb) = requests.first().map(|request| request.verb) else { continue };
            let chosen = Chosen::Vehicles(requests.iter().map(|request| request.vehicle).collect());
            let result = match order::give_to(&place, verb, &chosen) {
                Ok((text, true)) => Ok(text),
                Ok((text, false)) => Err(text),
                Err(error) => Err(error.to_string()),
            };
            for request in requests {
                let _ = results.send((request, result.clone()));
            }
        }
    }
}
