//! `xplane-standin` is a headless X-Plane. All of its code is in the library.

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use clap::Parser;
use skein_agent::plant::xplane::standin::{Standin, StandinOptions};
use tracing_subscriber::EnvFilter;

/// A headless helicopter simulator with X-Plane's UDP protocol on this computer's loopback.
#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    options: StandinOptions,
}

fn main() -> ExitCode {
    let Cli { options } = Cli::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false).with_writer(std::io::stderr).init();
    match Standin::open(&options).map(|mut standin| standin.run(&AtomicBool::new(false))) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error}");
            ExitCode::from(2)
        }
    }
}
