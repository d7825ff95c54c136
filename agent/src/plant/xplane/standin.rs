//! A headless X-Plane: the built-in helicopter behind X-Plane's protocol, on one thread at a simulator's pace.
//!
//! In each frame it reads the received datagrams, moves the aircraft and sends what is due, as X-Plane does. A frame is
//! one or more ticks of the model, which are 20 ms long. On a slow computer simulated time falls behind, as in X-Plane.
//! The ground is flat, at the height given in the options. A placement puts the helicopter on the ground at rest,
//! whatever elevation and speed it asks for; a reset puts it back to its start. While it is paused, it stands still, in
//! the air as well.

use std::fs;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use serde::Deserialize;
use skein_common::frame::{Geodetic, Origin};
use skein_common::id::VehicleId;
use skein_host::clock::{now, sleep_until};
use socket2::SockRef;

use super::server::{Order, Server, Version};
use super::socket::{Port, Received, is_receiver_down, is_this_host};
use super::wire::{self, becn, prel::Placement, rpos};
use skein_core::helicopter::{BuiltInVehicle, ParameterError, Parameters, Start, TICK_S, Weather};

/// Distance between the ports of neighbouring vehicles on one computer.
const PORT_STEP: u16 = 10;
/// Largest number of queued datagrams read in one frame.
const MAX_QUEUED: u32 = 4096;
/// Number of frames by which a simulator may be late before it skips them.
const MAX_LATE_FRAMES: u32 = 5;
/// Time without subscribers after which a stand-in with `--until-unused` ends.
const UNUSED_TIMEOUT: Duration = Duration::from_secs(5);
/// The default aircraft file.
const XCELL60: &str = include_str!("../../../../deploy/aircraft/xcell60.toml");

/// Command-line options of a stand-in.
#[derive(Clone, Debug, PartialEq, clap::Args)]
pub struct StandinOptions {
    /// UDP port of vehicle 1; vehicle i listens on PORT + 10·(i − 1). With 0 the system chooses
    #[arg(long, default_value_t = wire::PORT)]
    pub port: u16,
    /// The vehicle's number, 1 to 250
    #[arg(long, default_value = "1")]
    pub id: VehicleId,
    /// Latitude of its start, degrees
    #[arg(long = "lat", default_value_t = 28.0, allow_negative_numbers = true)]
    pub lat_deg: f64,
    /// Longitude of its start, degrees
    #[arg(long = "lon", default_value_t = -82.0, allow_negative_numbers = true)]
    pub lon_deg: f64,
    /// Height of the ground, metres above sea level
    #[arg(long = "alt", default_value_t = 0.0, allow_negative_numbers = true)]
    pub alt_m: f64,
    /// Heading at its start, degrees clockwise from true north
    #[arg(long = "heading", default_value_t = 0.0, allow_negative_numbers = true)]
    pub heading_deg: f64,
    /// The X-Plane to behave like
    #[arg(long, value_enum, default_value = "12")]
    pub version: Version,
    /// Frames a second: 50, or a divisor of it
    #[arg(long, default_value_t = 50)]
    pub rate: u32,
    /// Whether to announce itself by multicast on this computer
    #[arg(long, default_value_t = true, action = clap::ArgAction::Set)]
    pub beacon: bool,
    /// Send values from one port and positions from another, because X-Plane does not document its sending port
    #[arg(long)]
    pub split_ports: bool,
    /// End when standard input is closed and there has been no subscriber for five seconds
    #[arg(long, hide = true)]
    pub until_unused: bool,
    /// Seed of the gusts
    #[arg(long, default_value_t = 1, hide = true)]
    pub seed: u64,
    /// Mean wind speed, m/s
    #[arg(long, default_value_t = 0.0, hide = true)]
    pub wind_m_s: f64,
    /// Where the mean wind comes from, degrees clockwise from true north
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, hide = true)]
    pub wind_from_deg: f64,
    /// Wind speed 20 ft above the ground that sets the strength of the gusts, m/s
    #[arg(long, default_value_t = 0.0, hide = true)]
    pub gust_w20_m_s: f64,
    /// An aircraft file, for its `[helicopter]` table
    #[arg(long, hide = true)]
    pub aircraft: Option<PathBuf>,
}

/// Why a stand-in cannot run.
#[derive(Debug, thiserror::Error)]
pub enum StandinError {
    /// The port is in use, most often by a simulator.
    #[error("cannot listen on UDP {address}: {source}; another program may have this port: choose another with --port")]
    Bind {
        /// Address to listen on.
        address: SocketAddr,
        /// The system's error.
        source: io::Error,
    },
    /// An option is outside its range.
    #[error("--{option} {value}: must be {rule}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// Value given.
        value: String,
        /// Permitted values.
        rule: &'static str,
    },
    /// The aircraft file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The aircraft file has no valid `[helicopter]` table.
    #[error("the aircraft file has no usable [helicopter] table: {0}")]
    Aircraft(toml::de::Error),
    /// A parameter of the aircraft is outside its range.
    #[error("the aircraft file: {0}")]
    Parameters(ParameterError),
}

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

/// A stand-in that is ready to run.
pub struct Standin {
    options: StandinOptions,
    parameters: Parameters,
    weather: Weather,
    /// Place and heading, rad, to which a reset returns.
    start: (Geodetic, f64),
    ticks_per_frame: u32,
    vehicle: BuiltInVehicle,
    server: Server,
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
        let ticks_per_frame = ticks_per_frame(options.rate)?;
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
            vehicle: vehicle(options, &parameters, &weather, start),
            options: options.clone(),
            parameters,
            weather,
            start,
            ticks_per_frame,
            server: Server::new(options.version, options.rate),
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
        let period = Duration::from_secs_f64(f64::from(self.ticks_per_frame) * TICK_S);
        let launcher_gone = self.options.until_unused.then(watch_stdin);
        let mut last_used = now();
        let mut deadline = now() + period;
        while !stop.load(Relaxed) {
            sleep_until(deadline);
            self.frame();
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

    fn frame(&mut self) {
        self.announce();
        self.receive();
        let controls = self.server.take_controls();
        let ticks = if self.server.is_paused() { 0 } else { self.ticks_per_frame };
        for _ in 0..ticks {
            self.vehicle.advance(controls);
        }
        let mut gone = None;
        let Self { server, port, split, vehicle, .. } = self;
        server.publish(&vehicle.frame(), |to, datagram| {
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
                Received::Datagram(size, from) => match self.server.handle(self.port.datagram(size), from) {
                    Some(Order::Place(placement)) => self.place(&placement),
                    Some(Order::Reset) => self.reset(),
                    None => {}
                },
                // A subscriber has gone, but the error does not say which; the table's bound covers it.
                Received::Fault => {}
                Received::Nothing => return,
            }
        }
    }

    fn reset(&mut self) {
        self.vehicle = vehicle(&self.options, &self.parameters, &self.weather, self.start);
    }

    fn place(&mut self, placement: &Placement) {
        let Placement { latitude_deg, longitude_deg, heading_deg, .. } = *placement;
        let place = Geodetic::from_degrees(latitude_deg, longitude_deg, self.options.alt_m);
        self.vehicle = vehicle(&self.options, &self.parameters, &self.weather, (place, heading_deg.to_radians()));
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

fn refuse(option: &'static str, value: impl ToString, rule: &'static str) -> StandinError {
    StandinError::Option { option, value: value.to_string(), rule }
}

fn ticks_per_frame(rate_hz: u32) -> Result<u32, StandinError> {
    let ticks_a_second = (1.0 / TICK_S).round() as u32;
    match ticks_a_second.checked_rem(rate_hz) {
        Some(0) => Ok(ticks_a_second / rate_hz),
        _ => Err(refuse("rate", rate_hz, "50, 25, 10, 5, 2 or 1, because the model's tick is 20 ms")),
    }
}

fn udp_port(options: &StandinOptions) -> Result<u16, StandinError> {
    if options.port == 0 {
        return Ok(0);
    }
    let offset = PORT_STEP * u16::from(options.id.get() - 1);
    options
        .port
        .checked_add(offset)
        .ok_or_else(|| refuse("port", options.port, "small enough for PORT + 10·(id − 1) to be a port"))
}

fn start(options: &StandinOptions) -> Result<(Geodetic, f64), StandinError> {
    let place = Geodetic::from_degrees(options.lat_deg, options.lon_deg, options.alt_m);
    for (option, value, limit) in
        [("lat", options.lat_deg, 90.0), ("lon", options.lon_deg, 180.0), ("heading", options.heading_deg, 360.0)]
    {
        if !(-limit..=limit).contains(&value) {
            return Err(refuse(option, value, "within a circle, in degrees"));
        }
    }
    if !place.is_plausible() {
        return Err(refuse("alt", options.alt_m, "a height of the ground in metres"));
    }
    Ok((place, options.heading_deg.to_radians()))
}

fn weather(options: &StandinOptions) -> Result<Weather, StandinError> {
    for (option, value) in [("wind-m-s", options.wind_m_s), ("gust-w20-m-s", options.gust_w20_m_s)] {
        if !(0.0..=100.0).contains(&value) {
            return Err(refuse(option, value, "0 to 100"));
        }
    }
    if !(-360.0..=360.0).contains(&options.wind_from_deg) {
        return Err(refuse("wind-from-deg", options.wind_from_deg, "within a circle, in degrees"));
    }
    Ok(Weather {
        wind_m_s: options.wind_m_s,
        wind_from_rad: options.wind_from_deg.to_radians(),
        gust_w20_m_s: options.gust_w20_m_s,
    })
}

fn parameters(options: &StandinOptions) -> Result<Parameters, StandinError> {
    #[derive(Deserialize)]
    struct Aircraft {
        helicopter: Parameters,
    }
    let text = match &options.aircraft {
        Some(path) => &fs::read_to_string(path).map_err(|source| StandinError::Read { path: path.clone(), source })?,
        None => XCELL60,
    };
    let Aircraft { helicopter } = toml::from_str(text).map_err(StandinError::Aircraft)?;
    helicopter.check().map_err(StandinError::Parameters)?;
    Ok(helicopter)
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
