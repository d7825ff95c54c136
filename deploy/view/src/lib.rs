//! `skein view`: a live swarm, or a recording, on a page in the browser or on the terminal. The swarm flies the same with and
//! without it; only with `--orders` a page or a ground station can order something.
//!
//! | module | what it does |
//! | --- | --- |
//! | `live` | watches a swarm, ten snapshots a second |
//! | `playback` | plays a recording |
//! | `hello`, `snapshot`, `events`, `field` | what the page receives |
//! | `orders` | orders from the page, if they are allowed |
//! | `verdict` | how the swarm is, in one line |
//! | `server`, `socket`, `page` | HTTP, the WebSocket, the page's files |
//! | `names`, `code` | the server's names and addresses, the QR code of its address |
//! | `foxglove` | the server for Foxglove |
//! | `mavlink` | messages to ground stations, and their commands |
//! | `terminal` | the table of `skein fly` |

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use skein_agent::link::{ZENOH_ON_TWO_THREADS, ZENOH_RUNTIME};
use skein_agent::unix;
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::record::Player;
use skein_lab::terminal::{complain, say};
use tokio::sync::watch;

use skein_cluster::keys::Role;
use skein_cluster::mesh::reach::SwarmArgs;
use skein_cluster::os::Interrupts;

mod code;
mod events;
mod field;
mod foxglove;
mod hello;
mod live;
mod mavlink;
mod names;
mod orders;
mod page;
mod playback;
mod server;
mod snapshot;
mod socket;
mod terminal;
mod verdict;

use live::{Frame, Watcher};
pub use mavlink::MavlinkArgs;
pub use names::NameArgs;
use names::Names;
pub use orders::OrdersArgs;
use orders::Rule;
use server::{Shared, Source};

/// Port of the page, or the first of those that are tried.
const PORT: u16 = 7480;
/// Number of ports that are tried without `--listen`.
const PORTS: u16 = 20;
/// Time between two looks at whether Ctrl-C was pressed.
const TICK: Duration = Duration::from_millis(100);

/// `skein view`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein view\n  skein view --foxglove 8765\n  skein view --mavlink 127.0.0.1:14550 --orders\n  skein view -f cluster.toml --listen 0.0.0.0:7480\n  skein view --listen 0.0.0.0:7480 --name swarm.example.com\n  skein view skein-runs/hover/run.mcap"
)]
pub struct ViewArgs {
    /// A recording, or a folder with one, to play instead of a live swarm
    #[arg(value_name = "FILE.mcap|DIR", conflicts_with_all = ["swarm", "file", "terminal", "orders"])]
    pub recording: Option<PathBuf>,
    /// The swarm to watch.
    #[command(flatten)]
    pub swarm: SwarmArgs,
    /// Address of the page; without it 127.0.0.1:7480, or the next free port. Another address than the loopback shows the page
    /// on every PC that can reach it
    #[arg(long, value_name = "ADDR:PORT")]
    pub listen: Option<SocketAddr>,
    /// Names of the page's server.
    #[command(flatten)]
    pub names: NameArgs,
    /// Serve Foxglove too, live or from the recording, at this port of the loopback or at this address
    #[arg(long, value_name = "[ADDR:]PORT", value_parser = foxglove::address)]
    pub foxglove: Option<SocketAddr>,
    /// Show the table of skein fly on the terminal instead of a page
    #[arg(long, conflicts_with_all = ["listen", "names", "orders", "foxglove", "mavlink"])]
    pub terminal: bool,
    /// Ground stations.
    #[command(flatten)]
    pub mavlink: MavlinkArgs,
    /// Orders from the page and from ground stations.
    #[command(flatten)]
    pub orders: OrdersArgs,
}

/// Serves the page until Ctrl-C.
///
/// # Errors
/// If the address is not free, or the recording cannot be read.
pub fn run(args: &ViewArgs) -> Result<(), Error> {
    if args.recording.is_none() {
        unix::restart_with((ZENOH_RUNTIME, ZENOH_ON_TWO_THREADS));
    }
    if args.terminal {
        return terminal::show(&args.swarm);
    }
    let interrupts = Interrupts::listen()?;
    let (address, foxglove) = match &args.recording {
        Some(path) => {
            let path = recording(path)?;
            let listener = listen(args.listen, LISTEN)?;
            let foxglove = args.foxglove.map(|foxglove| foxglove::play(&path, foxglove)).transpose()?;
            (begin(listener, None, &args.names, |_| Source::Recording(path))?, foxglove)
        }
        None => {
            let (foxglove, at) = args.foxglove.map(foxglove::Live::start).transpose()?.unzip();
            let served = Served { address: args.listen, option: LISTEN, names: &args.names, orders: &args.orders };
            (begin_live(args.swarm.clone(), served, foxglove, &args.mavlink)?, at)
        }
    };
    let addresses = names::addresses(address);
    addresses.iter().for_each(|address| say(&format!("http://{address}\n")));
    code::of(&addresses).iter().for_each(|code| code::show(code));
    let foxglove = foxglove.into_iter().flat_map(names::addresses);
    foxglove.for_each(|address| say(&format!("ws://{address}\n")));
    complain(match args.orders.orders {
        true => "the page is served until Ctrl-C; it can order the swarm",
        false => "the page is served until Ctrl-C; the swarm flies the same with and without it",
    });
    while interrupts.count() == 0 {
        clock::sleep(TICK);
    }
    Ok(())
}

/// The option of `skein view` with the page's address.
const LISTEN: &str = "--listen";

/// The settings with which the page of a live swarm is served.
#[derive(Clone, Copy, Debug)]
pub struct Served<'a> {
    /// Address of the page; without it the first free port of the loopback.
    pub address: Option<SocketAddr>,
    /// The option that gave the address.
    pub option: &'static str,
    /// Names of the server.
    pub names: &'a NameArgs,
    /// The options that permit orders from the page.
    pub orders: &'a OrdersArgs,
}

/// Serves the page of a live swarm that this process flies, for as long as the process runs. Returns the addresses to open it at,
/// the most useful first, and the QR code of its address, if another device can open it.
///
/// # Errors
/// If the address is not free, or orders are wanted and cannot be allowed.
pub fn beside(swarm: SwarmArgs, served: Served<'_>) -> Result<(Vec<SocketAddr>, Option<String>), Error> {
    let addresses = names::addresses(begin_live(swarm, served, None, &MavlinkArgs::default())?);
    let code = code::of(&addresses);
    Ok((addresses, code))
}

/// Serves the page of a live swarm, Foxglove and a ground station.
fn begin_live(
    swarm: SwarmArgs,
    Served { address, option, names, orders }: Served<'_>,
    foxglove: Option<foxglove::Live>,
    mavlink: &MavlinkArgs,
) -> Result<SocketAddr, Error> {
    let rule = orders.rule(address.map_or(Ipv4Addr::LOCALHOST.into(), |address| address.ip()))?;
    if rule.is_some() && swarm.file.is_some() {
        // An operator without the keys of a cluster learns it now, not with the first order.
        swarm.choose()?.reach_teams(Role::Operator, &[])?;
    }
    let station = mavlink.station(rule.as_deref())?;
    let needs_token = rule.as_ref().map(|rule| rule.needs_token());
    begin(listen(address, option)?, rule, names, |frames| {
        if let Some(station) = station {
            station.serve(frames.subscribe());
        }
        let (watcher, of_thread) = (Watcher::new(swarm, needs_token, foxglove, option == LISTEN), frames.clone());
        thread::spawn(move || watcher.watch(&of_thread));
        Source::Live(frames)
    })
}

/// The recording that this path means, checked that it can be played.
fn recording(path: &Path) -> Result<PathBuf, Error> {
    let found = match path.is_dir() {
        true => playback::in_folder(path).ok_or_else(|| {
            let why = "no run.mcap and no fleet.mcap in this folder; give the folder of one run, or a file";
            Error::Refused(format!("{}: {why}", path.display()))
        })?,
        false => path.to_owned(),
    };
    Player::open(&found).map_err(|error| Error::Refused(error.to_string()))?;
    Ok(found)
}

/// Takes the address that this option gave; without one the first free port of the loopback.
fn listen(address: Option<SocketAddr>, option: &str) -> Result<TcpListener, Error> {
    let last = PORT + PORTS - 1;
    let in_use = || Error::Refused(format!("ports {PORT} to {last} are in use; choose one with {option} ADDR:PORT"));
    let bound = match address {
        Some(address) => TcpListener::bind(address)
            .map_err(|error| Error::Refused(format!("{option} {address}: {error}; choose another port"))),
        None => (PORT..=last).find_map(|port| TcpListener::bind((Ipv4Addr::LOCALHOST, port)).ok()).ok_or_else(in_use),
    }?;
    let failed = |error: std::io::Error| Error::Failed(format!("the page cannot be served: {error}"));
    bound.set_nonblocking(true).map_err(failed)?;
    Ok(bound)
}

/// Serves on threads of its own, until the process ends, and returns the address.
fn begin(
    listener: TcpListener,
    rule: Option<Arc<Rule>>,
    names: &NameArgs,
    source: impl FnOnce(watch::Sender<Arc<Frame>>) -> Source,
) -> Result<SocketAddr, Error> {
    let failed = |error: std::io::Error| Error::Failed(format!("the page cannot be served: {error}"));
    let address = listener.local_addr().map_err(failed)?;
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(1).thread_name("view").enable_all().build();
    let runtime = runtime.map_err(failed)?;
    let (frames, _) = watch::channel(Arc::default());
    let shared = Arc::new(Shared { source: source(frames), orders: rule, names: Names::new(address, names) });
    let serve = move || runtime.block_on(server::serve(listener, shared));
    thread::Builder::new().name("page".to_owned()).spawn(serve).map_err(failed)?;
    Ok(address)
}

#[cfg(test)]
mod tests;
