//! Prints the tables that the book quotes: `cargo run --release -p skein-tests --bin tables -- faults`.

use std::fs;
use std::process::ExitCode;

use clap::Parser;
use skein_core::formation::laws::built_in;
use skein_tests::{
    central, central_summary, conversion, divergence, faults, fit, fleets, formation_error, golden, halves, laws,
    missions, tour, variants, wind, wire, world,
};

/// Flies many swarms in virtual time and prints their figures
#[derive(Parser)]
struct Tables {
    /// The table to print
    #[command(subcommand)]
    table: Table,
    /// Flights a cell
    #[arg(long, global = true, default_value_t = 20)]
    seeds: u64,
}

/// The tables.
#[derive(clap::Subcommand)]
enum Table {
    /// Central control compared with a controller on each vehicle, with 4 to 32 vehicles and 0 to 30 % loss; below, the
    /// same in short, in Markdown
    Central,
    /// Central control over longer and longer delays, and with slower and slower computers
    CentralLimits,
    /// Linear and nonlinear conversions in ten situations, in Markdown
    Conversion,
    /// Every fault in a small mission, with four and with eight vehicles
    Faults,
    /// Twenty random helicopters: what `skein xplane fit` found for each, and the ring that they flew then
    Fit,
    /// Two fleets of 64 vehicles that fly through each other over a lossy network
    Fleets,
    /// A swarm that a cut splits for 20 s, under both policies
    Halves,
    /// Flies the flights of the golden files again, writes the files and prints which medians changed
    Golden,
    /// Ten agents on one PC in real time, over ten stand-ins: what they take of it, and the ring
    #[cfg(target_os = "linux")]
    OnePc,
    /// Every law with 4, 8 and 16 vehicles behind a moving centre, in Markdown
    Laws,
    /// Random missions with up to four faults; below, every mission that failed, as small as it can be
    Missions {
        /// The first seed
        #[arg(long, default_value_t = 0)]
        first: u64,
    },
    /// The ring's error with 4 to 32 vehicles, 0 to 50 % loss and 0 to 2 s delay, from the golden file
    Network,
    /// The same flight in virtual time, in real time, and in real time behind X-Plane's protocol, one seed after the
    /// other
    Divergence,
    /// The tour with 2 to 16 vehicles, 0 to 30 % loss and 0 to 1 s delay
    Tour,
    /// The shipped hover with imperfect sensors, and with point masses, in Markdown
    Variants,
    /// Flights without faults of every kind in up to 10 m/s of wind with gusts: which vehicles reported a failure
    Wind,
    /// The shipped hover in 0 to 18 m/s of wind
    WindHover,
    /// The shipped hover over X-Plane's protocol in virtual time, at 15 to 100 frames a second, with irregular frames and
    /// lost datagrams
    Wire,
    /// Real nodes in a simulated world of faults and one liar; below, every seed that broke an invariant
    World {
        /// The first seed
        #[arg(long, default_value_t = 0)]
        first: u64,
        /// Print what happened in every flight
        #[arg(long)]
        log: bool,
    },
}

fn main() -> ExitCode {
    if std::env::args().nth(1).is_some_and(|command| divergence::SKEIN_COMMANDS.contains(&command.as_str())) {
        return skein::cli::main();
    }
    let Tables { table, seeds } = Tables::parse();
    println!(
        "{}",
        match table {
            Table::Central => {
                let networks = [(0.0, 0.0), (0.1, 0.0), (0.3, 0.0), (0.3, 0.05)];
                let cells = central::cells(&[4, 8, 16, 32], &networks, seeds);
                format!("{}\n\n{}", central::table(&cells), central_summary::markdown(&cells))
            }
            Table::CentralLimits => {
                let delays_s = [0.0, 0.02, 0.04, 0.06, 0.08, 0.09, 0.1, 0.12, 0.15, 0.2];
                let steps_s = [0.001, 0.002, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.05];
                central::limits(8, &delays_s, &steps_s, seeds)
            }
            Table::Conversion => conversion::markdown(seeds),
            Table::Fit => fit::table(20, seeds),
            Table::Fleets => fleets::table(seeds),
            Table::Wire => wire::table(seeds),
            Table::Faults => faults::table(&[4, 8], seeds),
            Table::Halves => halves::table(seeds),
            Table::Golden => write_golden(),
            Table::Laws => laws::markdown(&built_in(), &laws::VEHICLES, seeds),
            #[cfg(target_os = "linux")]
            Table::OnePc => skein_tests::one_pc::table(),
            Table::Missions { first } => missions::table(first..first + seeds),
            Table::Network => formation_error::markdown(&formation_error::golden()),
            Table::Divergence => divergence::table(seeds),
            Table::Tour => tour::table(&[2, 4, 8, 16], &[0.0, 0.1, 0.2, 0.3], &[0.0, 0.2, 0.5, 1.0], seeds),
            Table::Variants => variants::markdown(&variants::VARIANTS, seeds),
            Table::Wind => wind::table(seeds),
            Table::WindHover => wind::hovers(seeds),
            Table::World { first, log } => world::table(first..first + seeds, log),
        }
    );
    ExitCode::SUCCESS
}

/// Writes every golden file and returns the medians that changed.
fn write_golden() -> String {
    let mut text = String::new();
    for file in golden::FILES {
        let (path, new) = (file.path(), (file.make)());
        let old = fs::read_to_string(&path).unwrap_or_default();
        text += &format!("{}: medians old, new\n{}", file.name, golden::moved(&old, &new));
        if let Err(error) = fs::write(&path, new) {
            text += &format!("{}: {error}\n", path.display());
        }
    }
    text
}
