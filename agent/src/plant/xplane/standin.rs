//! A headless X-Plane: the built-in helicopter behind X-Plane's protocol, on one thread at a simulator's pace.
//!
//! In each frame it reads the received datagrams, moves the aircraft and sends what is due, as X-Plane does. Frames have any
//! rate and may be irregular. On a slow computer simulated time falls behind, as in X-Plane.
//! The ground is flat, at the height given in the options. A placement puts the helicopter on the ground at rest,
//! whatever elevation and speed it asks for; a reset puts it back to its start. While it is paused, it stands still, in
//! the air as well.

mod options;
mod simulator;
mod web;

use std::collections::VecDeque;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use skein_host::clock::{now, sleep_until};
use socket2::SockRef;

use super::socket::{Port, Received, is_receiver_down, is_this_host, own_address_towards};
use super::wire::{becn, rpos};
pub use options::{StandinError, StandinOptions, WebPort};
use options::{port_of, web_port};
pub use simulator::{RunState, Simulator};
use web::Web;

/// Largest number of datagrams that wait for a frame; more are lost.
const MAX_QUEUED: usize = 4096;
/// The system's queue holds few datagrams (166 requests for datarefs on Linux), so that it is emptied while a frame is waited for:
/// as soon as one comes, and close to the end, where a wait for one would be too long, this often.
const LOOK_PERIOD: Duration = Duration::from_micros(500);
/// Size of the system's queue of datagrams that is asked for, bytes.
const RECEIVE_BUFFER: usize = 1 << 20;
/// Beyond what a wait for a datagram may last too long.
const CLOSE: Duration = Duration::from_millis(5);
/// Number of frames by which a simulator may be late before it skips them.
const MAX_LATE_FRAMES: u32 = 5;
/// Time without subscribers after which a stand-in with `--until-unused` ends.
const UNUSED_TIMEOUT: Duration = Duration::from_secs(5);

/// A stand-in that is ready to run.
pub struct Standin {
    options: StandinOptions,
    simulator: Simulator,
    port: Port,
    /// Datagrams that wait for the next frame.
    waiting: VecDeque<(Box<[u8]>, SocketAddr)>,
    /// Sending ports of positions and values, if not `port`.
    split: Option<[Port; 2]>,
    /// Address for clients on this computer.
    pub address: SocketAddr,
    /// The Web API, if it has one.
    web: Option<Web>,
    beacons: Vec<UdpSocket>,
    computer: String,
}

impl Standin {
    /// Checks the options and binds the port.
    ///
    /// # Errors
    /// If an option is outside its range, the aircraft file is not valid, or the port is in use.
    pub fn open(options: &StandinOptions) -> Result<Self, StandinError> {
        let simulator = Simulator::new(options)?;
        // The beacon carries no address, so the stand-in must be reachable on every interface that the beacon is sent
        // to.
        let listen = if options.beacon { Ipv4Addr::UNSPECIFIED } else { Ipv4Addr::LOCALHOST };
        let wanted = SocketAddrV4::new(listen, port_of("port", options.port, options.id)?).into();
        let bind = |source| StandinError::Bind(wanted, source);
        let port = UdpSocket::bind(wanted).and_then(Port::new).map_err(bind)?;
        // As much as the system allows: more requests fit while this thread does not run.
        let _ = SockRef::from(&port.socket).set_recv_buffer_size(RECEIVE_BUFFER);
        let sending = || UdpSocket::bind((listen, 0)).and_then(Port::new).map_err(bind);
        let open =
            |port| Web::open(port, &options.acf, options.incoming).map_err(|source| StandinError::Web(port, source));
        Ok(Self {
            simulator,
            web: web_port(options)?.map(open).transpose()?,
            options: options.clone(),
            split: if options.split_ports { Some([sending()?, sending()?]) } else { None },
            address: (Ipv4Addr::LOCALHOST, port.socket.local_addr().map_err(bind)?.port()).into(),
            port,
            waiting: VecDeque::new(),
            beacons: if options.beacon { beacon_sockets() } else { Vec::new() },
            computer: format!("xplane-standin-{}", options.id),
        })
    }

    /// Address of its Web API, if it has one.
    pub fn web_address(&self) -> Option<SocketAddr> {
        self.web.as_ref().map(|web| web.address)
    }

    /// Runs until `stop` becomes true, or until it is unused if the options ask for that.
    pub fn run(&mut self, stop: &AtomicBool) {
        tracing::info!(address = %self.address, id = %self.options.id, "the stand-in for X-Plane is running");
        let launcher_gone = self.options.until_unused.then(watch_stdin);
        let mut last_used = now();
        let mut deadline = now();
        while !stop.load(Relaxed) {
            self.wait(deadline);
            let period = Duration::from_secs_f64(self.frame());
            let now = now();
            deadline = next_deadline(deadline, period, now);
            let is_needed =
                launcher_gone.as_ref().is_none_or(|gone| !gone.load(Relaxed)) || self.simulator.server.is_used();
            if is_needed {
                last_used = now;
            } else if now >= last_used + UNUSED_TIMEOUT {
                tracing::info!("no subscriber for {} s: the stand-in ends", UNUSED_TIMEOUT.as_secs());
                return;
            }
        }
    }

    /// Runs a frame and returns its length, s.
    fn frame(&mut self) -> f64 {
        let (frame_s, presence) = self.simulator.begin_frame();
        match presence {
            RunState::Running => {
                self.announce();
                self.receive();
                let Self { simulator, web, .. } = self;
                // What clients of the Web API ask for waits until the simulator has values, after its first frame.
                if let Some(web) = web.as_mut().filter(|_| simulator.server.has_values()) {
                    web.serve(simulator.starts, |task| simulator.serve(task));
                }
                self.simulate(frame_s);
            }
            RunState::Frozen => {}
            RunState::Gone => self.discard(),
        }
        frame_s
    }

    /// Loses the waiting requests, as a computer does on which no simulator listens.
    fn discard(&mut self) {
        if let Some(web) = &mut self.web {
            web.discard();
        }
        self.collect();
        self.waiting.clear();
    }

    fn simulate(&mut self, frame_s: f64) {
        let mut gone = None;
        let Self { simulator, port, split, .. } = self;
        simulator.end_frame(frame_s, |to, datagram| {
            let port = match split {
                Some([positions, _]) if datagram.starts_with(&rpos::TAG) => positions,
                Some([_, values]) => values,
                None => &mut *port,
            };
            if port.send(datagram, to).is_err_and(|error| is_receiver_down(&error)) {
                gone = Some(to);
            }
        });
        if let Some(client) = gone {
            self.simulator.server.forget(client);
        }
    }

    fn announce(&mut self) {
        if let Some(beacon) = self.simulator.server.beacon(self.address.port(), &self.computer) {
            for socket in &self.beacons {
                // Without a network the beacon has no receiver.
                let _ = socket.send_to(beacon, (Ipv4Addr::from(becn::GROUP), becn::PORT));
            }
        }
    }

    /// Waits for the next frame, and collects datagrams meanwhile.
    fn wait(&mut self, deadline: Instant) {
        while now() + CLOSE < deadline {
            let received = self.port.receive(Some(deadline - CLOSE));
            self.keep(&received);
        }
        while now() < deadline {
            self.collect();
            sleep_until(deadline.min(now() + LOOK_PERIOD));
        }
    }

    /// Keeps the datagrams that the system has.
    fn collect(&mut self) {
        for _ in 0..MAX_QUEUED {
            let received = self.port.receive(None);
            if matches!(received, Received::Nothing) {
                return;
            }
            self.keep(&received);
        }
    }

    /// Keeps a datagram. Of an error in its place a subscriber that has gone may be the cause, but it does not say which; the
    /// bound of the server's table covers that.
    fn keep(&mut self, received: &Received) {
        if let Received::Datagram(size, from) = *received
            && self.waiting.len() < MAX_QUEUED
        {
            self.waiting.push_back((self.port.datagram(size).into(), from));
        }
    }

    /// Processes the datagrams received since the last frame.
    fn receive(&mut self) {
        self.collect();
        while let Some((datagram, from)) = self.waiting.pop_front() {
            // Like its beacon, the stand-in is for this computer only.
            if is_this_host(from.ip()) && self.options.incoming && !self.simulator.receive(&datagram, from) {
                return;
            }
        }
    }
}

/// The next deadline on a fixed grid, so that small delays do not add up; a loop that is far behind starts a new grid.
fn next_deadline(deadline: Instant, period: Duration, now: Instant) -> Instant {
    let next = deadline + period;
    if now > next + MAX_LATE_FRAMES * period { now } else { next }
}

/// Sockets for multicast that stays on this computer: over the loopback, and over the interface of the default route,
/// which is the one that clients use by default.
fn beacon_sockets() -> Vec<UdpSocket> {
    let over = |interface: Ipv4Addr| -> io::Result<UdpSocket> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_multicast_ttl_v4(0)?;
        socket.set_multicast_loop_v4(true)?;
        socket.set_nonblocking(true)?;
        SockRef::from(&socket).set_multicast_if_v4(&interface)?;
        Ok(socket)
    };
    let interfaces = [Some(Ipv4Addr::LOCALHOST), default_interface()];
    interfaces.into_iter().flatten().filter_map(|interface| over(interface).ok()).collect()
}

/// Address of the interface over which the beacon's group is reached.
fn default_interface() -> Option<Ipv4Addr> {
    match own_address_towards((becn::GROUP, becn::PORT).into())? {
        IpAddr::V4(own) if !own.is_loopback() && !own.is_unspecified() => Some(own),
        _ => None,
    }
}

/// Returns a flag that becomes true when standard input is closed, because the parent process has ended.
fn watch_stdin() -> Arc<AtomicBool> {
    let is_closed = Arc::new(AtomicBool::new(false));
    let flag = is_closed.clone();
    std::thread::spawn(move || {
        let _ = io::copy(&mut io::stdin().lock(), &mut io::sink());
        flag.store(true, Relaxed);
    });
    is_closed
}

#[cfg(test)]
mod tests;
