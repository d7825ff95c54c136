//! Prints the tables that the README quotes: `cargo run --release -p skein-tests --bin tables -- faults`.

use clap::Parser;
use skein_tests::{faults, halves, tour};

/// Flies many swarms in virtual time and prints what became of them
#[derive(Parser)]
struct Tables {
    /// Which table
    #[command(subcommand)]
    table: Table,
    /// Flights a cell
    #[arg(long, global = true, default_value_t = 20)]
    seeds: u64,
}

/// The tables.
#[derive(clap::Subcommand)]
enum Table {
    /// Every fault against a small mission, with four and with eight vehicles
    Faults,
    /// A swarm cut in two for 20 s, under both policies
    Halves,
    /// The tour with 2 to 16 vehicles, 0 to 30 % loss and 0 to 1 s delay
    Tour,
}

fn main() {
    let Tables { table, seeds } = Tables::parse();
    println!(
        "{}",
        match table {
            Table::Faults => faults::table(&[4, 8], seeds),
            Table::Halves => halves::table(seeds),
            Table::Tour => tour::table(&[2, 4, 8, 16], &[0.0, 0.1, 0.2, 0.3], &[0.0, 0.2, 0.5, 1.0], seeds),
        }
    );
}
