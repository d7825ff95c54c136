//! X-Plane as a [`Plant`]: a [`Client`] behind one unconnected UDP socket on the control thread. While positions make no
//! frames, [`Plant::wait`] ends at its deadline.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use ring::rand::{SecureRandom, SystemRandom};
use skein_common::frame::Origin;
use skein_common::scenario::VehicleModel;
use skein_host::clock::now;

use super::client::{Client, Counters, Indices};
use super::discovery::Search;
use super::socket::{Port, Received};
use super::wire::prel::Placement;
use super::wire::{PORT, WireError};
use skein_core::aircraft::Profile;
use skein_core::plant::{Command, Frame, PeerPose, Plant, PlantDrops, Wake};

/// Largest number of queued datagrams read without waiting: a flood must not delay the newest position.
const MAX_QUEUED: u32 = 1024;

/// The reason why the link to the simulator could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum XPlaneLinkError {
    /// The socket for the simulator could not be opened.
    #[error("cannot open a UDP socket on {0}: {1}")]
    Bind(IpAddr, #[source] io::Error),
    /// The socket for the beacon could not be opened, and the scenario gives no address.
    #[error("cannot listen for X-Plane's beacon: {0}; give the simulator's address instead")]
    Beacon(io::Error),
    /// The simulator and the local address are of different families.
    #[error("an X-Plane at {0} cannot be reached from {1}: one is IPv4, the other IPv6")]
    AddressFamily(SocketAddr, IpAddr),
    /// The path of the aircraft file for peers does not fit into a message.
    #[error("`plant.peer_acf` of the scenario cannot be encoded: {0}")]
    PeerAircraft(WireError),
    /// The system cannot generate indices that other programs cannot guess.
    #[error("this system provides no random numbers, which are needed to recognise X-Plane's replies")]
    NoRandomness,
}

/// Link to one X-Plane, real or a stand-in.
pub struct XPlane {
    /// The client, which holds what was received so far.
    pub client: Client,
    port: Port,
    listen: IpAddr,
    simulator: Option<SocketAddr>,
    search: Option<Search>,
    /// Number of malformed beacons.
    malformed_beacons: u64,
    /// The peers to draw, with room that is used again.
    poses: Vec<PeerPose>,
}

impl XPlane {
    /// Prepares a link to the X-Plane at `address`, or to the one on this host that announces itself by its beacon. It
    /// will ask for `rate_hz` positions a second at a free port of `listen`. It sends nothing before the first
    /// [`Plant::wait`] and does not touch the controls before the first [`Plant::command`].
    ///
    /// # Errors
    /// If a socket cannot be opened, or the system provides no random numbers.
    pub fn new(
        origin: &Origin,
        address: Option<SocketAddr>,
        profile: &Profile,
        rate_hz: u32,
        listen: IpAddr,
    ) -> Result<Self, XPlaneLinkError> {
        let simulator = address.unwrap_or((Ipv4Addr::LOCALHOST, PORT).into());
        if simulator.is_ipv4() != listen.is_ipv4() {
            return Err(XPlaneLinkError::AddressFamily(simulator, listen));
        }
        let search = if address.is_none() { Some(Search::new().map_err(XPlaneLinkError::Beacon)?) } else { None };
        let port = UdpSocket::bind((listen, 0)).and_then(Port::new);
        let system = SystemRandom::new();
        let indices = Indices::draw(|bytes| system.fill(bytes).is_ok()).ok_or(XPlaneLinkError::NoRandomness)?;
        let mut client = Client::new(origin, profile, rate_hz, indices);
        client.inquire();
        Ok(Self {
            client,
            port: port.map_err(|source| XPlaneLinkError::Bind(listen, source))?,
            listen,
            simulator: address,
            search,
            malformed_beacons: 0,
            poses: Vec::new(),
        })
    }

    /// Takes over what the scenario says ([`Client::set_up`]).
    ///
    /// # Errors
    /// If the path of the aircraft file for peers does not fit into a message.
    pub fn set_up(&mut self, start: Option<Placement>, plant: &VehicleModel) -> Result<(), XPlaneLinkError> {
        self.client.set_up(start, plant).map_err(XPlaneLinkError::PeerAircraft)
    }

    /// Counts so far.
    pub fn counters(&self) -> Counters {
        let received = self.client.counters;
        Counters { faults: self.port.faults, malformed: received.malformed + self.malformed_beacons, ..received }
    }

    /// Address of the simulator; searches for its beacon if none was given.
    fn find(&mut self, deadline: Instant) -> Option<SocketAddr> {
        if let (None, Some(search)) = (self.simulator, &mut self.search) {
            let port = search.find(deadline, &mut self.malformed_beacons)?;
            // The simulator is on this host and replies from the address at which it was asked.
            let host = if self.listen.is_unspecified() { Ipv4Addr::LOCALHOST.into() } else { self.listen };
            self.simulator = Some(SocketAddr::new(host, port));
            self.search = None;
        }
        self.simulator
    }

    /// Reads all queued datagrams; waits for a position until the deadline if none is queued.
    fn read(&mut self, simulator: IpAddr, deadline: Instant) {
        let mut may_take = MAX_QUEUED;
        while may_take > 0 {
            let at_once = self.client.position.is_some() || now() >= deadline;
            match self.port.receive((!at_once).then_some(deadline)) {
                Received::Datagram(size, from) => {
                    self.client.receive(self.port.datagram(size), from, simulator, now());
                }
                Received::Fault => {}
                Received::Nothing => break,
            }
            may_take -= u32::from(at_once);
        }
    }

    /// The simulator's next frame; `None` if the deadline comes first, or at once without a simulator.
    fn next_frame(&mut self, deadline: Instant) -> Option<Frame> {
        let simulator = self.find(deadline)?;
        self.client.renew(now(), &mut sender(&mut self.port, simulator));
        loop {
            self.read(simulator.ip(), deadline);
            let frame = self.client.frame();
            if frame.is_some() || now() >= deadline {
                return frame;
            }
        }
    }
}

impl Plant for XPlane {
    fn wait(&mut self, timeout: Duration) -> Wake {
        let frame = self.next_frame(now() + timeout);
        Wake { frame, status: self.client.status(now()) }
    }

    fn command(&mut self, command: Command) {
        if let Some(simulator) = self.simulator {
            self.client.command(command, now(), &mut sender(&mut self.port, simulator));
        }
    }

    fn release(&mut self) {
        if let Some(simulator) = self.simulator {
            self.client.release(&mut sender(&mut self.port, simulator));
        }
    }

    fn frame_period_s(&self) -> f64 {
        self.client.frame_period_s()
    }

    fn drops(&self) -> PlantDrops {
        let Counters { skipped_frames, malformed, foreign, .. } = self.counters();
        PlantDrops { skipped_frames, malformed, foreign }
    }

    fn show_peers(&mut self, peers: &mut dyn Iterator<Item = PeerPose>) {
        if let Some(simulator) = self.simulator.filter(|_| self.client.shows_peers()) {
            self.poses.clear();
            self.poses.extend(peers);
            self.client.show_peers(&self.poses, now(), &mut sender(&mut self.port, simulator));
        }
    }
}

/// Sends datagrams over this port. The protocol confirms nothing and repeats what matters; the port counts errors.
fn sender(port: &mut Port, to: SocketAddr) -> impl FnMut(&[u8]) {
    move |datagram| {
        let _ = port.send(datagram, to);
    }
}

impl Drop for XPlane {
    /// Releases the controls however the agent ends, so that the pilot gets them back.
    fn drop(&mut self) {
        self.release();
    }
}

#[cfg(test)]
mod tests;
