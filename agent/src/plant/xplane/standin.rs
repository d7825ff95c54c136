//! A headless X-Plane: the built-in helicopter behind X-Plane's protocol, on one thread at a simulator's pace.
//!
//! In each frame it reads the received datagrams, moves the aircraft and sends what is due, as X-Plane does. Frames have any
//! rate and may be irregular. On a slow computer simulated time falls behind, as in X-Plane.
//! The ground is flat, at the height given in the options. A placement puts the helicopter on the ground at rest,
//! whatever elevation and speed it asks for; a reset puts it back to its start. While it is paused, it stands still, in
//! the air as well.

mod aircraft;
mod options;

use std::f64::consts::PI;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use skein_common::frame::{Geodetic, Origin};
use skein_common::math;
use skein_host::clock::{now, sleep_until};
use socket2::SockRef;

use super::server::{Order, Server, Surroundings};
use super::socket::{Port, Received, is_receiver_down, is_this_host};
use super::wire::{becn, prel::Placement, rpos};
use aircraft::Aircraft;
pub use options::{StandinError, StandinOptions};
use options::{check_frames, parameters, start, udp_port, weather};
use rand_chacha::ChaCha8Rng;
use skein_core::helicopter::{BuiltInVehicle, Parameters, Start, Weather};
use skein_core::random::{Purpose, generator, uniform};

/// Largest number of queued datagrams read in one frame.
const MAX_QUEUED: u32 = 4096;
/// Number of frames by which a simulator may be late before it skips them.
const MAX_LATE_FRAMES: u32 = 5;
/// Time without subscribers after which a stand-in with `--until-unused` ends.
const UNUSED_TIMEOUT: Duration = Duration::from_secs(5);

/// Runs a stand-in until `stop` becomes true, or until it is unused if the options say so.
///
/// # Errors
/// If an option is outside its range, the aircraft file is not valid, or the port is in use.
pub fn run_standin(options: &StandinOptions, stop: &AtomicBool) -> Result<(), StandinError> {
    Standin::open(options)?.run(stop);
    Ok(())
}

/// Separate sending ports for positions and for values.
struct Split {
    positions: Port,
    values: Port,
}

impl Split {
    fn open(listen: Ipv4Addr) -> io::Result<Self> {
        let port = || UdpSocket::bind((listen, 0)).and_then(Port::new);
        Ok(Self { positions: port()?, values: port()? })
    }

    fn port_of(&mut self, datagram: &[u8]) -> &mut Port {
        if datagram.starts_with(&rpos::TAG) { &mut self.positions } else { &mut self.values }
    }
}

/// A time without frames, s.
#[derive(Clone, Copy)]
enum Absence {
    /// It hangs: datagrams wait in the queue.
    Frozen(f64),
    /// It has ended: datagrams are lost, and it starts anew afterwards.
    Gone(f64),
}

/// A stand-in that is ready to run.
pub struct Standin {
    options: StandinOptions,
    parameters: Parameters,
    weather: Weather,
    /// Place and heading, rad, to which a reset returns.
    start: (Geodetic, f64),
    aircraft: Aircraft,
    server: Server,
    random: ChaCha8Rng,
    /// What it does instead of frames, if anything.
    absence: Option<Absence>,
    port: Port,
    /// Sending ports of positions and values, if not `port`.
    split: Option<Split>,
    address: SocketAddr,
    beacons: Vec<UdpSocket>,
    computer: String,
}

impl Standin {
    /// Checks the options and binds the port.
    ///
    /// # Errors
    /// If an option is outside its range, the aircraft file is not valid, or the port is in use.
    pub fn open(options: &StandinOptions) -> Result<Self, StandinError> {
        check_frames(options)?;
        let weather = weather(options)?;
        let parameters = parameters(options)?;
        let start = start(options)?;
        // The beacon carries no address, so the stand-in must be reachable on every interface that the beacon is sent
        // to.
        let listen = if options.beacon { Ipv4Addr::UNSPECIFIED } else { Ipv4Addr::LOCALHOST };
        let wanted = SocketAddrV4::new(listen, udp_port(options)?).into();
        let bind = |source| StandinError::Bind { address: wanted, source };
        let port = UdpSocket::bind(wanted).and_then(Port::new).map_err(bind)?;
        Ok(Self {
            aircraft: Aircraft::new(vehicle(options, &parameters, &weather, start)),
            server: server(options, &weather),
            random: generator(options.seed, Some(options.id), Purpose::Simulator),
            absence: None,
            options: options.clone(),
            parameters,
            weather,
            start,
            split: options.split_ports.then(|| Split::open(listen)).transpose().map_err(bind)?,
            address: (Ipv4Addr::LOCALHOST, port.local_addr().map_err(bind)?.port()).into(),
            port,
            beacons: if options.beacon { beacon_sockets() } else { Vec::new() },
            computer: format!("xplane-standin-{}", options.id),
        })
    }

    /// Address for clients on this computer.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Runs until `stop` becomes true, or until it is unused if the options ask for that.
    pub fn run(&mut self, stop: &AtomicBool) {
        tracing::info!(address = %self.address, id = %self.options.id, "the stand-in for X-Plane is running");
        let launcher_gone = self.options.until_unused.then(watch_stdin);
        let mut last_used = now();
        let mut deadline = now();
        while !stop.load(Relaxed) {
            sleep_until(deadline);
            let period = Duration::from_secs_f64(self.frame());
            let now = now();
            deadline = next_deadline(deadline, period, now);
            let is_needed = launcher_gone.as_ref().is_none_or(|gone| !gone.load(Relaxed)) || self.server.is_used();
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
        let deviation = self.options.jitter * (2.0 * uniform(&mut self.random) - 1.0);
        let frame_s = (1.0 + deviation) / f64::from(self.options.rate);
        if !self.is_absent(frame_s) {
            self.announce();
            self.receive();
            self.simulate(frame_s);
        }
        frame_s
    }

    /// Whether this frame does not take place; ends an absence that is over.
    fn is_absent(&mut self, frame_s: f64) -> bool {
        match &mut self.absence {
            None => return false,
            Some(Absence::Frozen(left_s)) if *left_s > frame_s => *left_s -= frame_s,
            Some(Absence::Frozen(_)) => self.absence = None,
            Some(Absence::Gone(left_s)) => {
                *left_s -= frame_s;
                if *left_s <= 0.0 {
                    self.absence = None;
                }
                self.discard();
            }
        }
        true
    }

    /// Loses the waiting datagrams, as a computer does on which no simulator listens.
    fn discard(&mut self) {
        for _ in 0..MAX_QUEUED {
            if matches!(self.port.receive(None), Received::Nothing) {
                return;
            }
        }
    }

    fn simulate(&mut self, frame_s: f64) {
        let controls = self.server.take_controls();
        let simulated_s = self.server.simulated_s(frame_s);
        if simulated_s > 0.0 && !self.server.has_crashed() {
            self.aircraft.advance(controls, simulated_s);
        }
        let shown = if self.server.is_in_replay() { self.aircraft.replay() } else { self.aircraft.frame() };
        let drop_share = self.server.drop_share();
        let mut gone = None;
        let Self { server, port, split, random, .. } = self;
        server.publish(&shown, frame_s, |to, datagram| {
            if drop_share > 0.0 && uniform(random) < drop_share {
                return;
            }
            let port = split.as_mut().map_or(&mut *port, |split| split.port_of(datagram));
            if port.send(datagram, to).is_err_and(|error| is_receiver_down(&error)) {
                gone = Some(to);
            }
        });
        if let Some(client) = gone {
            self.server.forget(client);
        }
    }

    fn announce(&mut self) {
        if let Some(beacon) = self.server.beacon(self.address.port(), &self.computer) {
            for socket in &self.beacons {
                // Without a network the beacon has no receiver.
                let _ = socket.send_to(beacon, (Ipv4Addr::from(becn::GROUP), becn::PORT));
            }
        }
    }

    /// Processes the datagrams received since the last frame.
    fn receive(&mut self) {
        for _ in 0..MAX_QUEUED {
            match self.port.receive(None) {
                // Like its beacon, the stand-in is for this computer only.
                Received::Datagram(_, from) if !is_this_host(from.ip()) => {}
                Received::Datagram(..) if self.is_lost() => {}
                Received::Datagram(size, from) => match self.server.handle(self.port.datagram(size), from) {
                    Some(Order::Place(placement)) => self.place(&placement),
                    Some(Order::Reset) => self.reset(),
                    Some(Order::Freeze(seconds)) => self.absence = Some(Absence::Frozen(seconds.into())),
                    Some(Order::Restart(seconds)) => {
                        self.server = server(&self.options, &self.weather);
                        self.reset();
                        self.absence = Some(Absence::Gone(seconds.into()));
                        return;
                    }
                    None => {}
                },
                // A subscriber has gone, but the error does not say which; the table's bound covers it.
                Received::Fault => {}
                Received::Nothing => return,
            }
        }
    }

    fn is_lost(&mut self) -> bool {
        let share = self.server.drop_share();
        share > 0.0 && uniform(&mut self.random) < share
    }

    fn reset(&mut self) {
        self.aircraft = Aircraft::new(vehicle(&self.options, &self.parameters, &self.weather, self.start));
    }

    fn place(&mut self, placement: &Placement) {
        let Placement { latitude_deg, longitude_deg, heading_deg, .. } = *placement;
        let place = Geodetic::from_degrees(latitude_deg, longitude_deg, self.options.alt_m);
        let start = (place, heading_deg.to_radians());
        self.aircraft = Aircraft::new(vehicle(&self.options, &self.parameters, &self.weather, start));
    }
}

/// The helicopter at rest at this place, with this heading, rad.
fn vehicle(
    options: &StandinOptions,
    parameters: &Parameters,
    weather: &Weather,
    (place, heading_rad): (Geodetic, f64),
) -> BuiltInVehicle {
    let start = Start { heading_rad, ..Start::default() };
    BuiltInVehicle::new(&Origin::new(place), parameters, &start, weather, options.seed, options.id)
}

/// A simulator that has just started.
fn server(options: &StandinOptions, weather: &Weather) -> Server {
    let to_rad = weather.wind_from_rad + PI;
    let wind_m_s = [weather.wind_m_s * math::sin(to_rad), 0.0, -weather.wind_m_s * math::cos(to_rad)];
    let surroundings = Surroundings { acf: options.acf.as_str().into(), wind_m_s };
    let mut server = Server::new(options.version, options.rate, surroundings);
    server.set_drop_share(options.drop);
    server
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

/// Address of the interface over which the beacon's group is reached, found without sending anything.
fn default_interface() -> Option<Ipv4Addr> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
    socket.connect((Ipv4Addr::from(becn::GROUP), becn::PORT)).ok()?;
    match socket.local_addr().ok()? {
        SocketAddr::V4(local) if !local.ip().is_loopback() && !local.ip().is_unspecified() => Some(*local.ip()),
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
