//! Measures on this PC what messages between agents, datagrams and steps cost, and how often vehicles send states.

use std::net::{Ipv4Addr, UdpSocket};
use std::num::NonZeroUsize;

use serde::Serialize;
use skein_common::scenario::{Source, load};
use skein_core::deadlines::HEARTBEAT_PERIOD_S;

use super::message_cost::{self, FRAME_HZ, MessageSize, MessageTime};
use super::wire::data_output_bytes;
use crate::os::{cores, cpu_s};
use skein_host::clock::utc_name;
use skein_lab::error::Error;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::shipped::{FLOCK, HOVER};
use skein_lab::study::Study;

/// Rate at which an agent sends heartbeats, Hz.
pub(super) const HEARTBEAT_HZ: f64 = 1.0 / HEARTBEAT_PERIOD_S;

/// The effort of the measurements: a smaller one is less accurate.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Number of messages of each kind whose bytes are counted.
    pub messages: u32,
    /// Time for which the sessions are silent, and the equal time for which they send, s.
    pub sending_s: f64,
    /// Number of batches of datagrams that are sent and received; a socket's buffer holds a batch.
    pub batches: u32,
    /// Longest duration of each flight, s of virtual time.
    pub flight_s: f64,
}

impl Effort {
    /// The effort of `skein report --capacity`: about ten seconds.
    pub const FULL: Self = Self { messages: 200, sending_s: 3.0, batches: 200, flight_s: 400.0 };
}

/// The measurements, with where and when they were made.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Processors and operating system of this PC.
    pub machine: String,
    /// Time of the measurement, UTC, in the format of file names.
    pub when: String,
    /// Size of a state.
    pub state: MessageSize,
    /// Size of a heartbeat, which carries the agreement state.
    #[serde(rename = "register")]
    pub heartbeat: MessageSize,
    /// Rate at which an agent sends heartbeats, Hz: a constant of the agents.
    #[serde(rename = "register_hz")]
    pub heartbeat_hz: f64,
    /// Processor time of a state.
    pub time: MessageTime,
    /// Processor time to send and to receive a datagram of seven rows over loopback, µs.
    pub datagram_us: Option<[f64; 2]>,
    /// The rate at which vehicles send their states, for each flight.
    #[serde(rename = "talk")]
    pub state_rates: Vec<StateRate>,
    /// Processor time of a vehicle's step.
    pub step: Option<StepTime>,
}

impl Measured {
    /// The highest rate of states of all measured flights, Hz.
    pub fn states_hz(&self) -> f64 {
        self.state_rates.iter().map(|rate| rate.states_hz).fold(0.0, f64::max)
    }
}

/// The rate at which a vehicle sends its state on need, in a flight in virtual time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StateRate {
    /// Name of the flight.
    pub flight: &'static str,
    /// Number of vehicles.
    pub vehicles: usize,
    /// States sent by one vehicle, Hz.
    pub states_hz: f64,
    /// Distance between the nearest two vehicles at the end, m.
    pub nearest_pair_m: Option<f64>,
}

/// Processor time of one step of one agent in virtual time, its flight model included: a line through two sizes of
/// fleet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepTime {
    /// Processor time without peers, µs.
    pub alone_us: f64,
    /// Additional processor time for each peer, µs.
    pub per_peer_us: f64,
}

/// Runs all measurements.
///
/// # Errors
/// If sockets or sessions cannot be opened, or no message arrives.
pub fn measure(effort: Effort) -> Result<Measured, Error> {
    let failed = |why: String| Error::Failed(format!("capacity: {why}"));
    let [state, heartbeat] = message_cost::sizes(effort.messages).map_err(failed)?;
    let time = message_cost::time(effort.sending_s).map_err(failed)?;
    let datagram_us = datagram_us(effort.batches).map_err(|error| failed(error.to_string()))?;
    let (state_rates, step) = flights(effort.flight_s).map_err(failed)?;
    Ok(Measured {
        machine: machine(),
        when: utc_name(),
        state,
        heartbeat,
        heartbeat_hz: HEARTBEAT_HZ,
        time,
        datagram_us,
        state_rates,
        step,
    })
}

fn machine() -> String {
    let known = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = known.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let name = name.map_or(std::env::consts::ARCH, |(_, name)| name.trim());
    format!("{} × {name}, {}", cores(), std::env::consts::OS)
}

/// Processor time to send and to receive a datagram as X-Plane's data output has it, µs.
fn datagram_us(batches: u32) -> std::io::Result<Option<[f64; 2]>> {
    /// Datagrams in a batch: as many as any socket's buffer holds.
    const BATCH: u32 = 64;
    let (one, other) = (UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?, UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?);
    let to = other.local_addr()?;
    let (datagram, mut buffer) = ([0; data_output_bytes(7)], [0; 512]);
    let mut times_s = Some([0.0; 2]);
    for _ in 0..batches {
        let begin_s = cpu_s();
        for _ in 0..BATCH {
            one.send_to(&datagram, to)?;
        }
        let sent_s = cpu_s();
        for _ in 0..BATCH {
            other.recv_from(&mut buffer)?;
        }
        let received_s = cpu_s();
        times_s = times_s
            .and_then(|[send_s, receive_s]| Some([send_s + (sent_s? - begin_s?), receive_s + (received_s? - sent_s?)]));
    }
    Ok(times_s.map(|times_s| times_s.map(|time_s| time_s * 1e6 / f64::from(batches * BATCH))))
}

/// Measures in short flights how often vehicles send states and what their steps cost.
pub(super) fn flights(flight_s: f64) -> Result<(Vec<StateRate>, Option<StepTime>), String> {
    let gusts = ["world.wind_m_s=5", "world.gust_w20_m_s=5"];
    let (hover, step_us) = flight("hover", HOVER, &[], flight_s)?;
    let (windy, _) = flight("hover in wind and gusts", HOVER, &gusts, flight_s)?;
    let (flock, _) = flight("flock", FLOCK, &[], flight_s)?;
    let (many, many_us) = flight("hover of many", HOVER, &["swarm.vehicles=16"], flight_s / 4.0)?;
    let step = step_us.zip(many_us).map(|(few_us, many_us)| {
        let (few, more) = (hover.vehicles as f64 - 1.0, many.vehicles as f64 - 1.0);
        let per_peer_us = ((many_us - few_us) / (more - few)).max(0.0);
        StepTime { alone_us: (few_us - few * per_peer_us).max(0.0), per_peer_us }
    });
    Ok((vec![hover, windy, flock], step))
}

/// Flies one flight; returns its rate of states and the processor time of one step of one vehicle, µs.
fn flight(
    name: &'static str,
    source: Source<'_>,
    sets: &[&str],
    flight_s: f64,
) -> Result<(StateRate, Option<f64>), String> {
    let sets: Vec<_> = sets.iter().map(|set| (*set).to_owned()).chain([format!("duration_s={flight_s}")]).collect();
    let scenario = load(&source, &sets).map_err(|fault| fault.to_string())?.scenario;
    let ready = ScenarioArgs::default().ready(&scenario).map_err(|error| error.to_string())?;
    let (vehicles, seed) = (scenario.swarm.vehicles, scenario.seed);
    let study = Study { scenario, aircraft: ready.aircraft, rules: ready.rules, laws: Default::default() };
    let begin_s = cpu_s();
    let reports = study.fly_all(seed..seed + 1, NonZeroUsize::MIN, |_| {}).map_err(|error| error.to_string())?;
    let spent_s = cpu_s().zip(begin_s).map(|(end_s, begin_s)| end_s - begin_s);
    let report = reports.first().ok_or("nothing flew")?;
    // The time of joining is included, and so are the messages sent meanwhile.
    let vehicle_seconds = vehicles as f64 * report.real_time_factor * report.wall_s;
    let states_hz = report.state_messages as f64 / vehicle_seconds;
    let step_us = spent_s.map(|spent_s| spent_s * 1e6 / (vehicle_seconds * FRAME_HZ));
    Ok((StateRate { flight: name, vehicles, states_hz, nearest_pair_m: report.nearest_pair_end_m }, step_us))
}
