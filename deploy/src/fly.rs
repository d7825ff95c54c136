//! `skein fly`: a swarm on this PC, in real time. One process for each vehicle; this one starts them, observes, measures,
//! and at the end orders all vehicles to land. It is never in the control loop: if it is killed, the swarm keeps flying.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`plan`] | reads and checks everything before anything is begun |
//! | [`launch`] | files and processes |
//! | [`children`] | the processes while they run |
//! | [`fleet`] | one flight, or those of all teams of a fleet side by side |
//! | [`flight`] | from the first sign of life to the last process's end |
//! | [`ground`] | ground truth of the swarm: agents that ended or restarted, links that are cut |
//! | [`script`] | the scenario's events that this process performs |
//! | [`status`] | figures of every vehicle |
//! | [`journal`] | what happened, equal events of several vehicles in one line |
//! | [`table`], [`columns`], [`screen`] | what people see |
//! | [`stream`] | what programs read: `--json` |

use std::path::PathBuf;
use std::time::Duration;

use skein_agent::link::{ZENOH_ON_TWO_THREADS, ZENOH_RUNTIME};
use skein_agent::unix;

use crate::capacity;
use crate::cluster::nodes::is_seconds;
use crate::os::Interrupts;
use crate::simulators::HostPort;
use skein_lab::error::Error;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::study::seed;

pub mod children;
pub mod columns;
pub mod fleet;
pub mod flight;
pub mod ground;
pub mod journal;
pub mod launch;
pub mod plan;
pub mod screen;
pub mod script;
pub mod status;
pub mod stream;
pub mod table;

use fleet::Flights;
use plan::Plans;

/// `skein fly`
#[derive(Clone, Debug, Default, clap::Args)]
#[command(
    after_help = "Examples:\n  skein fly\n  skein fly --duration 100 --seed 7 --set swarm.vehicles=6 --set formation.radius_m=60\n  skein fly --plant standin --out my-flight"
)]
pub struct FlyArgs {
    /// The scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// What moves; the same as --set swarm.plant=...
    #[arg(long, value_enum)]
    pub plant: Option<PlantArg>,
    /// The X-Plane of vehicle 1; that of vehicle i is at PORT + 10·(i − 1). Without PORT 49000
    #[arg(long, value_name = "HOST[:PORT]")]
    pub xplane: Option<HostPort>,
    /// How long to fly, seconds; the same as --set duration_s=S. Without it in the scenario either: until stopped
    #[arg(long = "duration", value_name = "S", value_parser = duration, allow_negative_numbers = true)]
    pub duration_s: Option<f64>,
    /// Where all randomness comes from; the same as --set seed=N
    #[arg(long, value_name = "N", value_parser = seed, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Folder for what is written, new or empty; without it a new one in skein-runs
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Address of the live page. Not implemented yet: without effect
    #[arg(long, value_name = "ADDR", conflicts_with = "no_view")]
    pub view: Option<String>,
    /// Do not serve the live page. Not implemented yet: without effect
    #[arg(long)]
    pub no_view: bool,
    /// How long the vehicles may take to find each other, s; without it 60
    #[arg(long = "timeout", value_name = "S", value_parser = is_seconds)]
    pub timeout_s: Option<f64>,
    /// Fly more vehicles than this PC carries
    #[arg(long)]
    pub anyway: bool,
    /// Print what happens as JSON on stdout, an object a line, the last one with the figures; everything else on stderr
    #[arg(long)]
    pub json: bool,
}

/// A duration; its range is that of the scenario's key.
fn duration(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "a number of seconds, without a unit".to_owned())
}

/// Default of `--timeout`, s: all vehicles become active within this time.
const GATHER_WITHIN_S: f64 = 60.0;

/// `--plant`
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PlantArg {
    /// The helicopter inside the agent
    Builtin,
    /// The same helicopter behind X-Plane's UDP protocol
    Standin,
    /// X-Plane
    Xplane,
}

impl PlantArg {
    /// The value of `swarm.plant` in the scenario.
    fn name(self) -> &'static str {
        match self {
            Self::Builtin => "builtin",
            Self::Standin => "standin",
            Self::Xplane => "xplane",
        }
    }
}

/// Flies until the duration is over, until the mission has come to its landing, until an order to land, or until Ctrl-C;
/// then lands all vehicles and ends every process. A vehicle lost in flight is named; the flight of the others still
/// counts.
///
/// # Errors
/// What stands against the flight, such as a PC that does not carry so many agents; or a flight that never began, lost all its
/// vehicles, or did not end on the ground.
pub fn run(args: &FlyArgs) -> Result<(), Error> {
    let plans = Plans::new(args)?;
    // As agents run, and once for all of them.
    unix::restart_with((ZENOH_RUNTIME, ZENOH_ON_TWO_THREADS));
    let mut notes: Vec<String> = Vec::new();
    for plan in &plans.plans {
        let said = plan.loaded.notes.iter().cloned().chain(script::skipped(plan.scenario()));
        // What holds for several teams is written once.
        notes.extend(said.filter(|note| !notes.contains(note)).collect::<Vec<_>>());
    }
    notes.iter().for_each(|note| eprintln!("{note}"));
    if args.view.is_some() {
        eprintln!("--view: the live page is not implemented yet; the flight continues without it");
    }
    let interrupts = Interrupts::listen().map_err(|error| Error::Failed(format!("signals: {error}")))?;
    let vehicles: Vec<usize> = plans.plans.iter().map(|plan| plan.scenario().swarm.vehicles).collect();
    capacity::ask_for(&vehicles, args.anyway)?;
    let gather_within = Duration::from_secs_f64(args.timeout_s.unwrap_or(GATHER_WITHIN_S));
    Flights::begin(plans, interrupts, gather_within, args.json)?.fly()
}
