//! `skein report`: draws what was flown as figures and tables on one page, and measures how many vehicles fit.

use std::path::PathBuf;

use skein_lab::error::Error;
use skein_lab::report::ReportArgs as Report;

use crate::capacity;

/// `skein report`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein report my-study\n  skein report my-study/seed-3/run.mcap --csv\n  skein report --capacity\n  skein report --capacity my-fleet"
)]
pub struct ReportArgs {
    /// Folder of a run or a study, a folder of scenarios (these are flown in virtual time), or a recording
    #[arg(value_name = "DIR|FILE.mcap", required_unless_present = "capacity")]
    pub of: Option<PathBuf>,
    /// Measure here what messages between agents cost, and print how many vehicles fit, and what the vehicles of a fleet
    /// receive: the one flown in DIR, or else one flown for it; without --out it is only printed
    #[arg(long, conflicts_with = "csv")]
    pub capacity: bool,
    /// Print the capacity as JSON
    #[arg(long, requires = "capacity")]
    pub json: bool,
    /// Folder for what is written, new or empty; without it a new one in skein-runs
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write the recordings as tables too
    #[arg(long)]
    pub csv: bool,
}

/// Writes the report of a folder or recording, or of the capacity of this PC.
///
/// # Errors
/// If there is nothing to report on, or the report cannot be written.
pub fn run(args: &ReportArgs) -> Result<(), Error> {
    match &args.of {
        Some(of) if !args.capacity => {
            skein_lab::report::run(&Report { of: of.clone(), out: args.out.clone(), csv: args.csv })
        }
        flown => capacity::run(flown.as_deref(), args.out.as_deref(), args.json),
    }
}
