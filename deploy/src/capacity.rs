//! Calculates how many vehicles fit into 1 Gbit/s and into one processor core, with a central controller and in a mesh.
//!
//! The paper counts the payload in one direction only ([`PaperEquation`]). Here [`skein_cluster::capacity`] measures
//! on this PC what a message costs in bytes, with the overhead of Ethernet, IP, UDP and TCP, and in processor time, and
//! `fleet` multiplies. What a fleet of teams receives by cells was flown: `flown`.

mod fleet;
mod flown;
mod picture;

use std::fs;
use std::path::Path;

use comfy_table::{CellAlignment, Table, presets};
use serde::Serialize;
use skein_agent::link::{ZENOH_ON_TWO_THREADS, ZENOH_RUNTIME};
use skein_agent::unix;
use skein_common::id::VehicleId;

pub use fleet::{Load, Scheme};
pub use flown::{FlownFleet, OverVehicles, Received};
use skein_cluster::capacity::{
    Effort, Measured, PaperEquation, StateRate, StepTime, data_output_bytes, measure, of_datagram_bytes,
    of_segment_bytes,
};
use skein_lab::error::Error;
use skein_lab::out;

/// Capacity of a computer's link, and of a network that all computers share, bit/s.
pub const GIGABIT_S: f64 = 1e9;
/// Largest fleet in the figure, vehicles.
const LARGEST_FLEET: u32 = 10_000;
/// Fleets in the table of loads, vehicles.
const FLEETS: [u32; 6] = [4, 16, 50, 100, 250, 1000];

/// The result: what was measured, and how many vehicles fit.
#[derive(Clone, Debug, Serialize)]
pub struct Capacity {
    /// The paper's equation with the paper's numbers.
    pub paper: PaperEquation,
    /// The number of vehicles that the paper's equation gives.
    pub paper_vehicles: f64,
    /// The measurements on this PC.
    pub measured: Measured,
    /// The capacity of each communication scheme.
    pub schemes: Vec<Fits>,
    /// The messages that the vehicles of a fleet received by cells.
    pub fleet: FlownFleet,
}

/// The numbers of vehicles that fit with one communication scheme.
#[derive(Clone, Debug, Serialize)]
pub struct Fits {
    /// Name of the scheme.
    pub scheme: String,
    /// Vehicles that fit into a full-duplex port of 1 Gbit/s at the busiest computer.
    pub port_1_gbit: u32,
    /// Vehicles that fit into one core of the busiest computer; `None` where the system does not report processor time.
    pub one_core: Option<u32>,
    /// Vehicles that fit into a shared network of 1 Gbit/s.
    pub shared_1_gbit: u32,
    /// Load of fleets, each with its number of vehicles.
    pub loads: Vec<(u32, Load)>,
}

/// Duration of the flight of the fleet of `skein report --capacity`, s.
const FLEET_S: f64 = 40.0;

/// Runs `skein report --capacity`: measures, prints the tables, and writes them with the figure into the folder `out`, if
/// given. `flown` is the folder of a flight of a fleet; without it a fleet is flown.
///
/// # Errors
/// If the measurement fails, `flown` has no flight of a fleet, or the folder cannot be written.
pub fn run(flown: Option<&Path>, out: Option<&Path>, json: bool) -> Result<(), Error> {
    let flown = flown.map(FlownFleet::read).transpose()?;
    let out = out.map(|out| out::folder(Some(out), "")).transpose()?;
    // Use the same number of Zenoh threads as agents do.
    unix::restart_with((ZENOH_RUNTIME, ZENOH_ON_TWO_THREADS));
    eprintln!("measuring for about ten seconds; other programs on this PC affect the figures");
    let measured = measure(Effort::FULL)?;
    let fleet = flown.map_or_else(|| FlownFleet::fly(FLEET_S), Ok)?;
    let capacity = Capacity::of(measured, fleet);
    let text = capacity.to_text();
    skein_lab::terminal::say(&if json { skein_lab::terminal::json(&capacity) } else { text.clone() });
    let Some(out) = out else { return Ok(()) };
    let figure = picture::figure(&capacity.measured);
    let failed = |error: std::io::Error| Error::Failed(format!("{}: {error}", out.display()));
    fs::create_dir_all(&out).map_err(failed)?;
    out::write(&out.join("capacity.json"), skein_lab::terminal::json(&capacity))?;
    out::write(&out.join("capacity.txt"), text)?;
    out::write(&out.join("capacity.svg"), figure.svg())?;
    figure.write_png(&out.join("capacity.png"))?;
    eprintln!("written to {}", out.display());
    Ok(())
}

impl Capacity {
    /// Calculates the capacity of every scheme from the measurements.
    pub fn of(measured: Measured, fleet: FlownFleet) -> Self {
        let fits = |scheme: &Scheme| Fits {
            scheme: scheme.name.to_owned(),
            port_1_gbit: scheme.most(&measured, |load| load.port_bit_s.iter().all(|bit_s| *bit_s <= GIGABIT_S)),
            one_core: scheme
                .load(&measured, 1)
                .cores
                .map(|_| scheme.most(&measured, |load| load.cores.is_none_or(|cores| cores <= 1.0))),
            shared_1_gbit: scheme.most(&measured, |load| load.network_bit_s <= GIGABIT_S),
            loads: FLEETS.map(|vehicles| (vehicles, scheme.load(&measured, vehicles))).to_vec(),
        };
        let schemes = Scheme::all(&measured).iter().map(fits).collect();
        Self { paper: PaperEquation::PAPER, paper_vehicles: PaperEquation::PAPER.vehicles(), measured, schemes, fleet }
    }

    /// Formats the result as text.
    pub fn to_text(&self) -> String {
        let [paper, measured] = [self.paper_text(), self.measured_text()];
        let limit = VehicleId::MAX;
        format!(
            "{paper}\n{measured}\nHow many vehicles fit (Skein numbers them up to {limit}; more is arithmetic)\n\n{}\n\
             Mbit/s at the busiest port, the busier direction · cores of the busiest computer · Mbit/s in the whole network\n\n{}\n\
             By cells, as flown: {}\n\n{}\n\
             What one vehicle receives: mean of the {} vehicles [most of one]. Cores: at the processor time of a message above.\n",
            self.fits_table(),
            self.loads_table(),
            self.fleet.flight,
            self.fleet_table(),
            self.fleet.vehicles
        )
    }

    fn paper_text(&self) -> String {
        let PaperEquation { network_bit_s, head_bit, messages, message_bit, rate_hz } = self.paper;
        let payload_bytes = data_output_bytes(messages as usize);
        format!(
            "Garcia & Barnes 2010: {:.0} Mbit/s / (({head_bit} + {messages} x {message_bit}) bit x {rate_hz} Hz) = {} \
             vehicles at one central controller.\nWith Ethernet, IP and UDP its datagram of {payload_bytes} bytes takes {} bytes of \
             wire.\n",
            network_bit_s / 1e6,
            self.paper_vehicles,
            of_datagram_bytes(payload_bytes)
        )
    }

    fn measured_text(&self) -> String {
        let Measured { machine, when, state, heartbeat, heartbeat_hz, time, datagram_us, state_rates, step } =
            &self.measured;
        let mut lines = vec![format!("Measured on {machine}, at {when}:")];
        for (what, size) in [("state", state), ("heartbeat", heartbeat)] {
            let segment = size.segment_bytes.ceil();
            let wire = of_segment_bytes(segment as usize);
            let encoded = size.encoded_bytes;
            lines.push(format!("a {what}: {encoded} bytes, {segment} as Zenoh sends it over TCP, {wire} of wire"));
        }
        lines.push(format!("each agent sends {heartbeat_hz:.0} heartbeats a second"));
        if let Some(message_us) = time.message_us {
            let deliveries = time.deliveries;
            lines.push(format!(
                "a state delivered: {message_us:.1} us of processor time, both ends ({deliveries} deliveries)"
            ));
        }
        if let Some([send_us, receive_us]) = datagram_us {
            lines.push(format!("a datagram over loopback: {send_us:.2} us to send, {receive_us:.2} us to receive"));
        }
        if let Some(StepTime { alone_us, per_peer_us }) = step {
            lines
                .push(format!("a step with its flight model: {alone_us:.2} us, and {per_peer_us:.3} us for each peer"));
        }
        for StateRate { flight, vehicles, states_hz, nearest_pair_m } in state_rates {
            let near = nearest_pair_m.map(|near_m| format!(", nearest pair {near_m:.0} m")).unwrap_or_default();
            lines.push(format!("{flight}, {vehicles} vehicles: {states_hz:.1} states a second from each{near}"));
        }
        lines.join("\n  ") + "\n"
    }

    fn fits_table(&self) -> String {
        let mut table =
            table(&["", "1 Gbit/s at the busiest port", "one core of the busiest computer", "1 Gbit/s in all"]);
        for fits in &self.schemes {
            let core = fits.one_core.map_or_else(|| "–".to_owned(), |most| most.to_string());
            table.add_row([fits.scheme.clone(), fits.port_1_gbit.to_string(), core, fits.shared_1_gbit.to_string()]);
        }
        format!("{table}\n")
    }

    fn loads_table(&self) -> String {
        let fleets = FLEETS.map(|vehicles| format!("N = {vehicles}"));
        let head: Vec<_> = [""].into_iter().chain(fleets.iter().map(String::as_str)).collect();
        let mut table = table(&head);
        for fits in &self.schemes {
            let cell = |(_, load): &(u32, Load)| {
                let port = load.port_bit_s[0].max(load.port_bit_s[1]);
                let cores = load.cores.map_or_else(|| "–".to_owned(), digits);
                format!("{} · {cores} · {}", digits(port / 1e6), digits(load.network_bit_s / 1e6))
            };
            table.add_row([fits.scheme.clone()].into_iter().chain(fits.loads.iter().map(cell)));
        }
        format!("{table}\n")
    }

    /// The table of what a vehicle of the flown fleet receives, beside the same number of vehicles all to all.
    fn fleet_table(&self) -> String {
        let Measured { time, state, heartbeat, heartbeat_hz, .. } = &self.measured;
        let FlownFleet { vehicles, own_team, other_teams, all, links, .. } = &self.fleet;
        let cores = |messages_per_s: f64| {
            time.message_us.map_or_else(|| "–".to_owned(), |message_us| digits(messages_per_s * message_us * 1e-6))
        };
        let both = |figure: &OverVehicles, unit: f64| {
            format!("{} [{}]", digits(figure.mean / unit), digits(figure.most / unit))
        };
        let row = |name: &str, received: &Received, links: Option<&OverVehicles>| {
            let (messages, bytes) = (both(&received.messages_per_s, 1.0), both(&received.bytes_per_s, 1e3));
            let links = links.map_or_else(|| "–".to_owned(), |links| both(links, 1.0));
            [name.to_owned(), messages, bytes, links, cores(received.messages_per_s.mean)]
        };
        let mut table = table(&["", "messages/s", "payload kB/s", "links", "cores"]);
        own_team.iter().for_each(|received| _ = table.add_row(row("from the own team", received, None)));
        other_teams.iter().for_each(|received| _ = table.add_row(row("from other teams, by cells", received, None)));
        table.add_row(row("together", all, links.as_ref()));
        let (others, states_hz) = (vehicles.saturating_sub(1) as f64, self.measured.states_hz());
        let messages_per_s = others * (states_hz + heartbeat_hz);
        let payload = states_hz * state.encoded_bytes as f64 + heartbeat_hz * heartbeat.encoded_bytes as f64;
        let bytes_per_s = others * payload;
        let name = "mesh, on need, all to all: computed".to_owned();
        let bytes = digits(bytes_per_s / 1e3);
        table.add_row([name, digits(messages_per_s), bytes, format!("{others}"), cores(messages_per_s)]);
        format!("{table}\n")
    }
}

fn table(head: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(head);
    table.column_iter_mut().skip(1).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    table
}

/// Formats a number with two significant digits.
fn digits(value: f64) -> String {
    match value {
        value if value >= 10.0 => format!("{value:.0}"),
        value if value >= 1.0 => format!("{value:.1}"),
        value if value >= 0.1 => format!("{value:.2}"),
        value => format!("{value:.3}"),
    }
}

#[cfg(test)]
mod tests;
