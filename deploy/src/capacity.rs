//! How many vehicles fit: into a gigabit, into a core, at one central machine and in a mesh.
//!
//! The paper counts payload alone and one direction ([`PaperEquation`]). Here `wire` adds what Ethernet, IP, UDP and TCP
//! take, `measure` finds out on this machine what a word costs in bytes and processor time, and `fleet` multiplies.

mod fleet;
mod here;
mod measure;
mod picture;
mod relay;
mod wire;
mod words;

use std::fs;
use std::path::Path;

use comfy_table::{CellAlignment, Table, presets};
use serde::Serialize;
use skein_agent::link::{ZENOH_ON_TWO_THREADS, ZENOH_RUNTIME};
use skein_agent::unix;
use skein_common::id::VehicleId;

pub use fleet::{Load, Scheme};
pub use here::{Demand, agrees, ask_for, exceeded_by};
pub use measure::{Effort, Measured, StepTime, Talk, measure};
use skein_lab::error::Error;
use skein_lab::out;
pub use wire::{PaperEquation, data_output_bytes, of_datagram_bytes, of_segment_bytes};
pub use words::{WordSize, WordTime};

/// A machine's link, and the network that all share where they do, bit/s.
pub const GIGABIT_S: f64 = 1e9;
/// The largest fleet that is drawn.
const LARGEST_FLEET: u32 = 10_000;
/// The fleets whose loads stand in the table.
const FLEETS: [u32; 6] = [4, 16, 50, 100, 250, 1000];

/// The whole answer.
#[derive(Clone, Debug, Serialize)]
pub struct Capacity {
    /// The paper's equation with the paper's numbers.
    pub paper: PaperEquation,
    /// What comes out of it.
    pub paper_vehicles: f64,
    /// What was measured here.
    pub measured: Measured,
    /// Each way to share what vehicles know.
    pub schemes: Vec<Fits>,
}

/// How many vehicles fit, one way.
#[derive(Clone, Debug, Serialize)]
pub struct Fits {
    /// Which way.
    pub scheme: String,
    /// Into a port of 1 Gbit/s each way at the busiest machine.
    pub port_1_gbit: u32,
    /// Into one core of the busiest machine; `None` where the system does not tell processor time.
    pub one_core: Option<u32>,
    /// Into 1 Gbit/s that all of them share.
    pub shared_1_gbit: u32,
    /// What fleets ask for, by their size.
    pub loads: Vec<(u32, Load)>,
}

/// `skein report --capacity`: measures, prints the tables, writes them and the picture into a folder if there is one.
///
/// # Errors
/// If nothing can be measured here, or the folder not be written to.
pub fn run(out: Option<&Path>, json: bool) -> Result<(), Error> {
    let out = out.map(|out| out::folder(Some(out), "")).transpose()?;
    // As agents run.
    unix::restart_with((ZENOH_RUNTIME, ZENOH_ON_TWO_THREADS));
    eprintln!("measuring for some ten seconds; what else this machine does is in the figures");
    let capacity = Capacity::of(measure(Effort::FULL)?);
    let text = capacity.to_text();
    skein_lab::terminal::say(&if json { skein_lab::terminal::json(&capacity) } else { text.clone() });
    let Some(out) = out else { return Ok(()) };
    let figure = picture::figure(&capacity.measured);
    let failed = |error: std::io::Error| Error::Failed(format!("{}: {error}", out.display()));
    fs::create_dir_all(&out).map_err(failed)?;
    fs::write(out.join("capacity.json"), skein_lab::terminal::json(&capacity)).map_err(failed)?;
    fs::write(out.join("capacity.txt"), text).map_err(failed)?;
    fs::write(out.join("capacity.svg"), figure.svg()).map_err(failed)?;
    figure.write_png(&out.join("capacity.png"))?;
    eprintln!("written to {}", out.display());
    Ok(())
}

impl Capacity {
    /// What follows from what was measured.
    pub fn of(measured: Measured) -> Self {
        let fits = |scheme: &Scheme| Fits {
            scheme: scheme.name(),
            port_1_gbit: scheme.most(&measured, |load| load.port_bit_s.iter().all(|bit_s| *bit_s <= GIGABIT_S)),
            one_core: scheme
                .load(&measured, 1)
                .cores
                .map(|_| scheme.most(&measured, |load| load.cores.is_none_or(|cores| cores <= 1.0))),
            shared_1_gbit: scheme.most(&measured, |load| load.network_bit_s <= GIGABIT_S),
            loads: FLEETS.map(|vehicles| (vehicles, scheme.load(&measured, vehicles))).to_vec(),
        };
        let schemes = Scheme::all(&measured).iter().map(fits).collect();
        Self { paper: PaperEquation::PAPER, paper_vehicles: PaperEquation::PAPER.vehicles(), measured, schemes }
    }

    /// For people.
    pub fn to_text(&self) -> String {
        let [paper, measured] = [self.paper_in_words(), self.measured_in_words()];
        let limit = VehicleId::MAX;
        format!(
            "{paper}\n{measured}\nHow many vehicles fit (Skein numbers them up to {limit}; more is arithmetic)\n\n{}\n\
             Mbit/s at the busiest port, the fuller way · cores of the busiest machine · Mbit/s in the whole network\n\n{}",
            self.fits_table(),
            self.loads_table()
        )
    }

    fn paper_in_words(&self) -> String {
        let PaperEquation { network_bit_s, head_bit, messages, message_bit, rate_hz } = self.paper;
        let payload_bytes = data_output_bytes(messages as usize);
        format!(
            "Garcia & Barnes 2010: {:.0} Mbit/s / (({head_bit} + {messages} x {message_bit}) bit x {rate_hz} Hz) = {} \
             vehicles at one central machine.\nWith Ethernet, IP and UDP its datagram of {payload_bytes} bytes takes {} bytes of \
             wire.\n",
            network_bit_s / 1e6,
            self.paper_vehicles,
            of_datagram_bytes(payload_bytes)
        )
    }

    fn measured_in_words(&self) -> String {
        let Measured { machine, when, state, register, register_hz, time, datagram_us, talk, step } = &self.measured;
        let mut lines = vec![format!("Measured on {machine}, at {when}:")];
        for (what, word) in [("state", state), ("part in the agreement", register)] {
            let segment = word.segment_bytes.ceil();
            let wire = of_segment_bytes(segment as usize);
            let encoded = word.encoded_bytes;
            lines.push(format!("a {what}: {encoded} bytes, {segment} as Zenoh sends it over TCP, {wire} of wire"));
        }
        lines.push(format!("the agreement is repeated {register_hz:.0} times a second"));
        if let Some(word_us) = time.word_us {
            let deliveries = time.deliveries;
            lines.push(format!("a state delivered: {word_us:.1} us of processor, both ends ({deliveries} deliveries)"));
        }
        if let Some([send_us, receive_us]) = datagram_us {
            lines.push(format!("a datagram over loopback: {send_us:.2} us to send, {receive_us:.2} us to receive"));
        }
        if let Some(StepTime { alone_us, per_peer_us }) = step {
            lines
                .push(format!("a step with its flight model: {alone_us:.2} us, and {per_peer_us:.3} us for each peer"));
        }
        for Talk { flight, vehicles, states_hz, nearest_pair_m } in talk {
            let near = nearest_pair_m.map(|near_m| format!(", nearest pair {near_m:.0} m")).unwrap_or_default();
            lines.push(format!("{flight}, {vehicles} vehicles: {states_hz:.1} states a second of each{near}"));
        }
        lines.join("\n  ") + "\n"
    }

    fn fits_table(&self) -> String {
        let mut table =
            table(&["", "1 Gbit/s at the busiest port", "one core of the busiest machine", "1 Gbit/s in all"]);
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
}

fn table(head: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(head);
    table.column_iter_mut().skip(1).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    table
}

/// Two digits that say something.
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
