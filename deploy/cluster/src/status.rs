//! The status of a swarm on this PC or on a cluster, as the vehicles report it: `skein status` and `skein cluster status`.
//! Any computer with the observers' keys can ask: the operator's PC, or a node with its own cluster file.

mod table;

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use crate::display::screen::columns;
use crate::keys::Role;
use serde::Serialize;
use skein_common::id::{SwarmName, TeamId, VehicleName};
use skein_common::message::{Health, SimulatorFault};
use skein_common::printable::printable;
use skein_common::state::{Activity, PeerStatus};

use super::clocks::{CLOCK_S, ahead_of_swarm};
use super::nodes;
use crate::FileArgs;
use crate::inventory::Inventory;
use crate::mesh::observe::Observers;
use crate::mesh::reach::{Place, SwarmArgs};
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::terminal::wrapped;

/// Time to wait for health reports: agents send one a second, and a new link takes some time.
const LISTEN: Duration = Duration::from_millis(2500);
/// Interval at which received messages are read.
const POLL_PERIOD: Duration = Duration::from_millis(20);
/// Interval between two tables of `--watch`.
const REFRESH: Duration = Duration::from_secs(1);
/// Age from which a health report is ignored.
const SILENT: Duration = Duration::from_millis(3500);

/// `skein cluster status`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein cluster status\n  skein cluster status -f cluster.toml --watch")]
pub struct ClusterStatusArgs {
    /// The cluster.
    #[command(flatten)]
    pub file: FileArgs,
    /// The form in which its status is shown.
    #[command(flatten)]
    pub shown: ShownArgs,
}

/// `skein status`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein status\n  skein status -w\n  skein status -f cluster.toml --json")]
pub struct StatusArgs {
    /// The swarm.
    #[command(flatten)]
    pub swarm: SwarmArgs,
    /// The form in which its status is shown.
    #[command(flatten)]
    pub shown: ShownArgs,
}

/// Options of a command that shows the status.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ShownArgs {
    /// Show it again every second, until Ctrl-C
    #[arg(short, long)]
    pub watch: bool,
    /// Print the result as JSON; with --watch a line a second
    #[arg(long)]
    pub json: bool,
}

/// The nodes that a swarm should have, in the order of ids, without reports.
fn listed(place: &Place) -> Vec<NodeStatus> {
    let node = |id: &VehicleName, host: Option<&String>, endpoint: String| NodeStatus {
        id: *id,
        team: id.team,
        host: host.cloned(),
        endpoint,
        report: None,
        why: None,
    };
    match place {
        Place::Here(there) => there.agents.iter().map(|(id, endpoint)| node(id, None, endpoint.clone())).collect(),
        Place::Cluster(inventory) => {
            let nodes = inventory.nodes.values();
            nodes.map(|own| node(&own.id, own.host.as_ref(), own.endpoint(inventory.security))).collect()
        }
    }
}

/// Status of the nodes of a swarm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SwarmStatus {
    /// Name of the swarm or fleet.
    pub swarm: String,
    /// Status of every node, in the order of ids, in a fleet by team.
    pub nodes: Vec<NodeStatus>,
}

/// Status of one node.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NodeStatus {
    /// Its vehicle: the id, in a fleet with the team.
    pub id: VehicleName,
    /// The team of the fleet that it flies in, if it flies in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub team: Option<TeamId>,
    /// Its host as given to `ssh`, if any.
    pub host: Option<String>,
    /// Endpoint of its agent.
    pub endpoint: String,
    /// Its health report; `None` if no valid one was received.
    #[serde(rename = "said")]
    pub report: Option<HealthReport>,
    /// If it is in contact and its reports are rejected: why.
    pub why: Option<String>,
}

/// Contents of a node's health report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HealthReport {
    /// The release that it runs.
    pub version: String,
    /// The plant that it flies.
    pub plant: String,
    /// Its present activity.
    pub phase: String,
    /// Time for which it has been in formation without interruption, s; `None` while it is not.
    pub in_place_s: Option<f64>,
    /// Frame rate of its simulator, Hz.
    pub frame_rate_hz: f64,
    /// Largest distance between two frames beyond their period over the last second, ms.
    pub jitter_ms: f64,
    /// Number of peers of its swarm or team that it receives.
    pub peers_seen: usize,
    /// Number of peers that there should be.
    pub peers: usize,
    /// Upper bound of the age of the oldest state of the received peers, ms; delays are included where they are known.
    pub peer_age_ms: Option<f64>,
    /// Upper bound of the longest delay of these, ms; `None` while the delay of one of them is not known.
    pub peer_delay_ms: Option<f64>,
    /// Time by which its clock is ahead of the swarm's, ms, once measured.
    pub clock_offset_ms: Option<f64>,
    /// Bound of the error of the offset, ms.
    pub clock_bound_ms: Option<f64>,
    /// Whether the offset exceeds 20 ms by more than its bound.
    pub clock_is_off: bool,
    /// Failures of the vehicle, and faults of its simulator's set-up.
    pub faults: Vec<String>,
    /// Properties of its simulator's set-up that would be faults if the scenario did not ask for them.
    pub wanted: Vec<String>,
    /// Number of its links with other agents, and on plain links with observers.
    pub links: u32,
    /// Messages that it publishes, a second, on average since its start.
    pub sent_per_s: f64,
    /// Messages that it receives, a second, on average since its start.
    pub received_per_s: f64,
    /// Bytes that it publishes and receives, a second, on average since its start.
    pub bytes_per_s: [f64; 2],
    /// Number of own messages that it did not send because the network was too slow, since its start.
    pub unsent: u64,
    /// Number of messages that it has rejected since its start.
    pub refused: u64,
    /// The latest kinds of rejected messages.
    pub refusals: Vec<Refusal>,
    /// Time since its start, s.
    pub uptime_s: f64,
}

/// A kind of rejected message.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Refusal {
    /// The reason of the rejection.
    pub reason: String,
    /// The Zenoh key that it was received under.
    pub key: String,
    /// Number of such messages.
    pub count: u64,
}

impl SwarmStatus {
    /// Whether every node reports and none is faulty.
    pub fn is_good(&self) -> bool {
        self.nodes.iter().all(|node| node.report.as_ref().is_some_and(|report| report.faults.is_empty()))
    }

    /// Determines the status of these nodes from the received messages.
    fn of(swarm: &SwarmName, listed: &[NodeStatus], observer: &Observers, now: Instant) -> Self {
        let node = |node: &NodeStatus| {
            let peers = listed.iter().filter(|other| other.team == node.team).count() - 1;
            let health = observer.health_of(node.id).filter(|(_, at)| now.saturating_duration_since(*at) < SILENT);
            NodeStatus {
                report: health.map(|(health, _)| HealthReport::of(health, peers)),
                why: if health.is_some() { None } else { stray(observer, node.id) },
                ..node.clone()
            }
        };
        Self { swarm: swarm.to_string(), nodes: listed.iter().map(node).collect() }
    }
}

/// Returns why the reports of a vehicle in contact are rejected, if that is because of its run.
fn stray(observer: &Observers, id: VehicleName) -> Option<String> {
    let run = observer.view(id).filter(|view| view.alive)?.run?;
    match observer.run() {
        Some(flown) if flown == run => None,
        Some(flown) => Some(format!("flies in run {run}, and the swarm in run {flown}")),
        None => Some(format!("flies in run {run}, and no run has a majority of the vehicles in contact")),
    }
}

impl HealthReport {
    fn of(health: &Health, peers: usize) -> Self {
        let received = health.peers.iter().filter(|peer| peer.standing != PeerStatus::Lost);
        let delays_ms: Option<Vec<f64>> = received.clone().map(|peer| Some(peer.delay_s? * 1e3)).collect();
        let clock = ahead_of_swarm(&health.peers);
        let per_s = |count: u64| count as f64 / health.uptime_s.max(1.0);
        let failures = health.failures.iter().map(ToString::to_string);
        let (wanted, simulator): (Vec<SimulatorFault>, Vec<_>) =
            health.simulator_faults.iter().partition(|fault| fault.is_wanted());
        let text = |fault: SimulatorFault| fault.to_string();
        let blind = (health.activity == Activity::Blind).then(|| "receives no data from its simulator".to_owned());
        Self {
            version: printable(&health.version, Health::MAX_VERSION),
            plant: printable(&health.plant, Health::MAX_VERSION),
            phase: health.activity.to_string(),
            in_place_s: health.in_place_s,
            frame_rate_hz: health.frame_rate_hz,
            jitter_ms: health.jitter_ms,
            peers_seen: received.clone().count(),
            peers,
            peer_age_ms: received.map(|peer| peer.age_s * 1e3).max_by(f64::total_cmp),
            peer_delay_ms: delays_ms.and_then(|delays_ms| delays_ms.into_iter().max_by(f64::total_cmp)),
            clock_offset_ms: clock.map(|clock| clock.offset_s * 1e3),
            clock_bound_ms: clock.map(|clock| clock.bound_s * 1e3),
            clock_is_off: clock.is_some_and(|clock| clock.offset_s.abs() - clock.bound_s > CLOCK_S),
            faults: failures.chain(simulator.into_iter().map(text)).chain(blind).collect(),
            wanted: wanted.into_iter().map(text).collect(),
            links: health.links,
            sent_per_s: per_s(health.sent.messages),
            received_per_s: per_s(health.received.messages),
            bytes_per_s: [per_s(health.sent.bytes), per_s(health.received.bytes)],
            unsent: health.unsent,
            refused: health.drops.refused(),
            refusals: health
                .refused
                .iter()
                .map(|refused| Refusal {
                    reason: refused.reason.to_string(),
                    key: refused.key.clone(),
                    count: refused.count,
                })
                .collect(),
            uptime_s: health.uptime_s,
        }
    }
}

/// Prints the status of every node of a cluster.
///
/// # Errors
/// The errors of [`status`].
pub fn run(args: &ClusterStatusArgs) -> Result<(), Error> {
    status(&Place::Cluster(Box::new(Inventory::read(&args.file.path())?)), args.shown)
}

/// Prints the status of every node.
///
/// # Errors
/// If the swarm cannot be observed, a node does not report, or one is faulty.
pub fn status(place: &Place, args: ShownArgs) -> Result<(), Error> {
    let mut observer = Observers::open(&place.reach_teams(Role::Observer, &[])?)?;
    let listed = listed(place);
    let remedy = remedy(place);
    let mut until = clock::now() + LISTEN;
    let mut is_first = true;
    loop {
        let early = !args.watch || std::mem::take(&mut is_first);
        listen(&mut observer, &listed, until, early);
        let status = SwarmStatus::of(place.swarm(), &listed, &observer, clock::now());
        show(&status, &remedy, args);
        if !args.watch {
            return verdict(&status);
        }
        until = clock::now() + REFRESH;
    }
}

/// Names the logs or commands that show why a node is not in contact.
fn remedy(place: &Place) -> String {
    match place {
        Place::Here(there) => {
            let logs =
                there.branches().into_iter().map(|branch| there.folder(branch).join("agents").display().to_string());
            format!("the logs of the agents: {}", logs.collect::<Vec<_>>().join(", "))
        }
        Place::Cluster(inventory) => {
            let file = inventory.path.display();
            format!("`skein check -f {file}` looks why not, `skein cluster logs -f {file}` shows what was written")
        }
    }
}

/// Receives messages until `until`, or if `early` until every node has reported.
fn listen(observer: &mut Observers, listed: &[NodeStatus], until: Instant, early: bool) {
    loop {
        observer.poll();
        let all = listed.iter().all(|node| observer.health_of(node.id).is_some());
        if clock::now() >= until || early && all {
            return;
        }
        clock::sleep(POLL_PERIOD);
    }
}

fn show(status: &SwarmStatus, remedy: &str, args: ShownArgs) {
    let is_screen = args.watch && skein_lab::terminal::obeys_escapes(&std::io::stdout());
    let text = match (args.json, args.watch) {
        (true, true) => format!("{}\n", serde_json::to_string(status).unwrap_or_default()),
        (true, false) => skein_lab::terminal::json(status),
        (false, _) => fitted(&table::of(status, remedy)),
    };
    if is_screen && !args.json {
        // Clear the screen before the new table.
        skein_lab::terminal::draw("\x1b[H\x1b[2J");
    }
    skein_lab::terminal::say(&text);
}

/// Wraps the text at spaces if stdout is a narrower terminal. The lines of the table fit already.
fn fitted(text: &str) -> String {
    if !std::io::stdout().is_terminal() {
        return text.to_owned();
    }
    let columns = columns();
    let line = |line: &str| match line.chars().count() > columns {
        true => wrapped(line, columns).join("\n") + "\n",
        false => format!("{line}\n"),
    };
    text.lines().map(line).collect()
}

fn verdict(status: &SwarmStatus) -> Result<(), Error> {
    let ids = |wanted: fn(&NodeStatus) -> bool| {
        nodes::list(status.nodes.iter().filter(|node| wanted(node)).map(|node| &node.id))
    };
    let silent = ids(|node| node.report.is_none());
    let faulty = ids(|node| node.report.as_ref().is_some_and(|report| !report.faults.is_empty()));
    if status.is_good() {
        return Ok(());
    }
    let why = [("not in contact: node", silent), ("faulty: node", faulty)].into_iter();
    let why = why.filter(|(_, ids)| !ids.is_empty()).map(|(what, ids)| format!("{what} {ids}"));
    Err(Error::Failed(why.collect::<Vec<_>>().join("; ")))
}

#[cfg(test)]
mod tests;
