//! What is measured on this machine, together: words between agents, datagrams, what vehicles have to say, steps.

use std::net::{Ipv4Addr, UdpSocket};
use std::num::NonZeroUsize;

use serde::Serialize;
use skein_common::scenario::{Source, load};
use skein_core::deadlines::HEARTBEAT_PERIOD_S;

use super::message_cost::{self, FRAME_HZ, MessageSize, MessageTime};
use super::wire::data_output_bytes;
use crate::os::cpu_s;
use skein_host::clock::utc_name;
use skein_lab::error::Error;
use skein_lab::scenario::{FLOCK, HOVER, ScenarioArgs};
use skein_lab::study::Study;

/// How often an agent sends its part in the agreement, Hz.
pub(super) const HEARTBEAT_HZ: f64 = 1.0 / HEARTBEAT_PERIOD_S;

/// How much to measure; less is less exact.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Words of each kind whose bytes are counted.
    pub words: u32,
    /// How long sessions are silent, and how long they talk, s.
    pub sending_s: f64,
    /// Datagrams that are sent and received, in batches that a socket holds.
    pub batches: u32,
    /// Each flight's length at most, in virtual time, s.
    pub flight_s: f64,
}

impl Effort {
    /// What `skein report --capacity` takes: some ten seconds.
    pub const FULL: Self = Self { words: 200, sending_s: 3.0, batches: 200, flight_s: 400.0 };
}

/// What was measured, where and when.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Processors and operating system.
    pub machine: String,
    /// UTC, as files are named.
    pub when: String,
    /// A vehicle's state.
    pub state: MessageSize,
    /// Its part in the agreement.
    pub register: MessageSize,
    /// How often that is repeated to everybody, Hz: the agents' constant.
    pub heartbeat_hz: f64,
    /// What a state costs the processor.
    pub time: MessageTime,
    /// Processor time to send and to receive a datagram of seven rows over loopback, µs.
    pub datagram_us: Option<[f64; 2]>,
    /// How often vehicles say their state.
    pub talk: Vec<StateRate>,
    /// What a vehicle's step costs.
    pub step: Option<StepTime>,
}

/// How often a vehicle says its state on need, in virtual time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StateRate {
    /// What flew.
    pub flight: &'static str,
    /// How many flew.
    pub vehicles: usize,
    /// States of one vehicle a second.
    pub states_hz: f64,
    /// Distance of the nearest pair at the end, m.
    pub nearest_pair_m: Option<f64>,
}

/// Processor time of one step of one agent in virtual time, its flight model included: a line through two fleets.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepTime {
    /// Without peers, µs.
    pub alone_us: f64,
    /// More for each peer, µs.
    pub per_peer_us: f64,
}

/// Measures everything.
///
/// # Errors
/// If sockets or sessions cannot be opened, or nothing comes through.
pub fn measure(effort: Effort) -> Result<Measured, Error> {
    let failed = |why: String| Error::Failed(format!("capacity: {why}"));
    let [state, register] = message_cost::sizes(effort.words).map_err(failed)?;
    let time = message_cost::time(effort.sending_s).map_err(failed)?;
    let datagram_us = datagram_us(effort.batches).map_err(|error| failed(error.to_string()))?;
    let (talk, step) = flights(effort.flight_s).map_err(failed)?;
    Ok(Measured {
        machine: machine(),
        when: utc_name(),
        state,
        register,
        heartbeat_hz: HEARTBEAT_HZ,
        time,
        datagram_us,
        talk,
        step,
    })
}

fn machine() -> String {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let known = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = known.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let name = name.map_or(std::env::consts::ARCH, |(_, name)| name.trim());
    format!("{processors} × {name}, {}", std::env::consts::OS)
}

/// Processor time to send and to receive a datagram as X-Plane's data output has it, µs.
fn datagram_us(batches: u32) -> std::io::Result<Option<[f64; 2]>> {
    /// As many as any socket's buffer holds.
    const BATCH: u32 = 64;
    let (one, other) = (UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?, UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?);
    let to = other.local_addr()?;
    let (said, mut heard) = ([0; data_output_bytes(7)], [0; 512]);
    let mut times_s = Some([0.0; 2]);
    for _ in 0..batches {
        let begin_s = cpu_s();
        for _ in 0..BATCH {
            one.send_to(&said, to)?;
        }
        let sent_s = cpu_s();
        for _ in 0..BATCH {
            other.recv_from(&mut heard)?;
        }
        let received_s = cpu_s();
        times_s = times_s
            .and_then(|[send_s, receive_s]| Some([send_s + (sent_s? - begin_s?), receive_s + (received_s? - sent_s?)]));
    }
    Ok(times_s.map(|times_s| times_s.map(|time_s| time_s * 1e6 / f64::from(batches * BATCH))))
}

/// What vehicles say in short flights, and what their steps cost.
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

/// One flight, and the processor time of one step of one of its vehicles, µs.
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
    // Joining included, as are the words said meanwhile.
    let vehicle_seconds = vehicles as f64 * report.real_time_factor * report.wall_s;
    let states_hz = report.state_messages as f64 / vehicle_seconds;
    let step_us = spent_s.map(|spent_s| spent_s * 1e6 / (vehicle_seconds * FRAME_HZ));
    Ok((StateRate { flight: name, vehicles, states_hz, nearest_pair_m: report.nearest_pair_end_m }, step_us))
}
