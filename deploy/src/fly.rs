//! `skein fly`: a swarm on this PC, in real time. One process for each vehicle; this one starts them, observes, measures,
//! and at the end orders all vehicles to land. It is never in the control loop: if it is killed, the swarm keeps flying.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`plan`] | reads and checks everything before anything is begun |
//! | [`launch`] | files and processes |
//! | [`children`] | the processes while they run |
//! | [`series`] | flights that follow each other, a seed each: `--runs` |
//! | [`fleet`] | one flight, or those of all teams of a fleet side by side |
//! | [`flight`] | from the first sign of life to the last process's end |
//! | [`ground`] | ground truth of the swarm: agents that ended or restarted, links that are cut |
//! | [`script`] | the scenario's events that this process performs |
//! | [`stream`] | what programs read: `--json` |

use std::io::IsTerminal;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::Duration;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use skein_agent::link::{ZENOH_ON_TWO_THREADS, ZENOH_RUNTIME};
use skein_agent::unix;

use skein_cluster::capacity;
use skein_cluster::mesh::reach::SwarmArgs;
use skein_cluster::nodes::is_seconds;
use skein_cluster::os::Interrupts;
use skein_cluster::ports::HostPort;
use skein_common::id::SwarmName;
use skein_common::scenario::PlantKind;
use skein_core::formation::room;
use skein_lab::error::Error;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::study::seed;
use skein_view::{NameArgs, OrdersArgs, Served};

pub mod children;
pub mod fleet;
pub mod flight;
pub mod ground;
pub mod launch;
pub mod plan;
pub mod script;
pub mod series;
pub mod stream;

use fleet::Flights;
use plan::Plans;

/// `skein fly`
#[derive(Clone, Debug, Default, clap::Args)]
#[command(
    after_help = "Examples:\n  skein fly\n  skein fly --duration 100 --seed 7 --set swarm.vehicles=6 --set formation.radius_m=60\n  skein fly --plant standin --out my-flight\n  skein fly --xplane 10.0.0.21,10.0.0.22,10.0.0.23,10.0.0.24"
)]
pub struct FlyArgs {
    /// The scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// Plant of the vehicles; the same as --set swarm.plant=...
    #[arg(long, value_enum)]
    pub plant: Option<PlantArg>,
    /// The X-Plane of vehicle 1; that of vehicle i is on the same host at PORT + 10·(i − 1). Or one for each vehicle, in the
    /// order of ids. Without PORT 49000
    #[arg(long, value_name = "HOST[:PORT],...", value_delimiter = ',')]
    pub xplane: Vec<HostPort>,
    /// Duration of the flight, seconds; the same as --set duration_s=S. Without it in the scenario either: until stopped
    #[arg(long = "duration", value_name = "S", value_parser = duration, allow_negative_numbers = true)]
    pub duration_s: Option<f64>,
    /// Seed of all random numbers; the same as --set seed=N
    #[arg(long, value_name = "N", value_parser = seed, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Fly N times, one flight after the other, with the seeds from that of the scenario or --seed on. Ctrl-C lands and ends
    /// the series; the same command with the same --out resumes it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub runs: Option<u64>,
    /// Folder for what is written, new or empty, or that of the very same --runs, interrupted; without it a new one in
    /// skein-runs
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Serve the page of skein view beside the flight, at 127.0.0.1:7480 or the next free port, or at this address. On a terminal
    /// it is served without this option
    #[arg(long, value_name = "ADDR:PORT", num_args = 0..=1, conflicts_with = "no_view")]
    pub view: Option<Option<SocketAddr>>,
    /// Do not serve the page
    #[arg(long, conflicts_with = "orders")]
    pub no_view: bool,
    /// Names of the page's server.
    #[command(flatten)]
    pub names: NameArgs,
    /// Orders from the page.
    #[command(flatten)]
    pub orders: OrdersArgs,
    /// Time limit for the vehicles to find each other, s; without it 60
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlantArg(pub PlantKind);

impl ValueEnum for PlantArg {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: LazyLock<Vec<PlantArg>> = LazyLock::new(|| PlantKind::all().map(PlantArg).collect());
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let spec = self.0.spec();
        Some(PossibleValue::new(spec.name).help(spec.help))
    }
}

impl FlyArgs {
    /// The swarm gathers within this time, or does not fly.
    fn gather_within(&self) -> Duration {
        Duration::from_secs_f64(self.timeout_s.unwrap_or(GATHER_WITHIN_S))
    }
}

/// Flies until the duration is over, until the mission has come to its landing, until an order to land, or until Ctrl-C;
/// then lands all vehicles and ends every process. A vehicle lost in flight is named; the flight of the others still
/// counts. With `--runs` it does so again with the next seed.
///
/// # Errors
/// A reason against the flight, such as a PC that does not carry so many agents; or a flight that never began, lost all its
/// vehicles, or did not end on the ground.
pub fn run(args: &FlyArgs) -> Result<(), Error> {
    // A series may have begun in its folder; nothing is written there before all is checked.
    let plans = Plans::new(&FlyArgs { out: args.out.clone().filter(|_| args.runs.is_none()), ..args.clone() })?;
    // As agents run, and once for all of them.
    unix::restart_with((ZENOH_RUNTIME, ZENOH_ON_TWO_THREADS));
    let mut notes: Vec<String> = Vec::new();
    for plan in &plans.plans {
        let said = plan.loaded.notes.iter().cloned().chain(script::skipped(plan.scenario()));
        let said = said.chain(room::crowded_step(plan.scenario()));
        // What holds for several teams is written once.
        notes.extend(said.filter(|note| !notes.contains(note)).collect::<Vec<_>>());
    }
    notes.iter().for_each(|note| eprintln!("{note}"));
    let interrupts = Interrupts::listen()?;
    let vehicles: Vec<usize> = plans.plans.iter().map(|plan| plan.scenario().swarm.vehicles).collect();
    capacity::ask_for(&vehicles, args.anyway)?;
    let (page, code) = serve_page(args, plans.described.first().scenario.swarm.name.clone())?;
    if let Some(runs) = args.runs {
        page.iter().for_each(|page| eprintln!("{page}"));
        return series::fly(args, plans, runs, &interrupts);
    }
    let mut flights = Flights::begin(plans, args.gather_within(), args.json, &interrupts)?;
    flights.tell_of_page(page, code);
    let flown = flights.fly(&interrupts);
    if !args.json {
        skein_lab::terminal::say(&flown.summary());
    }
    flown.verdict
}

/// Serves the live page if it is wanted. Returns the lines about it for the operator, and the QR code of its address.
///
/// # Errors
/// If its address is not free, or orders cannot be allowed, and the page was asked for.
fn serve_page(args: &FlyArgs, swarm: SwarmName) -> Result<(Vec<String>, Option<String>), Error> {
    let is_asked_for = args.view.is_some() || args.orders.orders;
    let is_wanted = is_asked_for || (std::io::stdout().is_terminal() && !args.json);
    if !is_wanted || args.no_view {
        return Ok((Vec::new(), None));
    }
    let served = Served { address: args.view.flatten(), option: "--view", names: &args.names, orders: &args.orders };
    match skein_view::beside(SwarmArgs { swarm: Some(swarm), file: None }, served) {
        Ok((addresses, code)) => {
            Ok((addresses.iter().map(|address| format!("live page: http://{address}")).collect(), code))
        }
        Err(error) if !is_asked_for => Ok((vec![format!("no live page: {error}")], None)),
        Err(error) => Err(error),
    }
}
