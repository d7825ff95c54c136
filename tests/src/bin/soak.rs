//! Flies eight agents over stand-ins for hours under random faults and prints what grew:
//! `cargo run --release -p skein-tests --bin soak -- --hours 8`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
#[cfg(unix)]
use skein_tests::soak;

/// Flies eight agents over stand-ins for hours, with kills, cuts, frozen simulators, orders and observers, and prints what grew
#[cfg_attr(not(unix), allow(dead_code))]
#[derive(Parser)]
struct Arguments {
    /// Time of the flight, h
    #[arg(long, default_value_t = 8.0)]
    hours: f64,
    /// Where the faults come from
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// New folder for the flight's files
    #[arg(long, default_value = "soak")]
    out: PathBuf,
}

#[cfg(not(unix))]
fn main() -> ExitCode {
    eprintln!("soak: measures only under Linux");
    ExitCode::FAILURE
}

#[cfg(unix)]
fn main() -> ExitCode {
    if std::env::args().nth(1).is_some_and(|command| soak::SKEIN_COMMANDS.contains(&command.as_str())) {
        return skein::cli::main();
    }
    let Arguments { hours, seed, out } = Arguments::parse();
    let folder = std::fs::create_dir(&out).and_then(|()| out.canonicalize());
    let (program, folder) = match (std::env::current_exe(), folder) {
        (Ok(program), Ok(folder)) => (program, folder),
        (Err(error), _) | (_, Err(error)) => {
            eprintln!("soak: {}: {error}", out.display());
            return ExitCode::FAILURE;
        }
    };
    let (table, is_constant) = soak::fly(&program, &folder, hours, seed);
    println!("{table}");
    if is_constant { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
