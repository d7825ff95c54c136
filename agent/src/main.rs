//! `skein-agent` flies one vehicle. All of its code is in the library.

use std::process::ExitCode;

use clap::Parser;
use skein_agent::config::AgentOptions;

/// Flies one vehicle of a swarm without a central computer.
#[derive(Parser)]
#[command(version)]
struct Cli {
    #[command(flatten)]
    options: AgentOptions,
}

fn main() -> ExitCode {
    skein_agent::run::program(&Cli::parse().options)
}
