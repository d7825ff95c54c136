//! `skein cluster up`: starts every agent in one run of the swarm, then waits until every vehicle has reported over the
//! mesh that it is an active member. The command may end at any moment: nothing depends on it.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::keys::{self, Role};
use crate::mesh::reach::Reach;
use serde::Serialize;
use skein_agent::link::signature::runs::RunNote;
use skein_common::id::VehicleName;

use super::flown::Evidence;
use super::install::owner;
use super::nodes::{self, ChosenNodes, NodesArgs, Progress, is_seconds};
use super::protocol::{Answer, Ask, RunningAgent};
use super::remote::{Fault, Remote, unexpected};
use super::ssh::{at_once, by_host};
use crate::capacity::{self, Demand};
use crate::findings;
use crate::inventory::{Inventory, Node, SecurityKind};
use crate::keys::run::Record;
use crate::mesh::ready::{CONTACT_TIMEOUT, POLL_PERIOD, Watch};
use crate::os;
use skein_host::clock;
use skein_lab::error::Error;

/// Upper limit of run numbers: they can be typed, and every JSON reader can represent them.
const RUNS: u64 = 1 << 48;

/// `skein cluster up`
#[derive(Clone, Debug, clap::Args)]
#[command(
    long_about = "Starts every agent in one run of the swarm, and waits until every vehicle is ready. Before that each host puts the \
                  aircraft of its X-Plane to the vehicle's start, in the scenario's wind, as `skein fly` does; an aircraft that flies \
                  stays where it is, and with start.pattern = \"as_is\" each does. An agent that runs already is not affected.",
    after_help = "Examples:\n  skein cluster up\n  skein cluster up -f cluster.toml --timeout 120"
)]
pub struct UpArgs {
    /// The nodes.
    #[command(flatten)]
    pub nodes: NodesArgs,
    /// Time limit for the vehicles to be ready, s
    #[arg(long = "timeout", value_name = "S", default_value_t = 60.0, value_parser = is_seconds)]
    pub timeout_s: f64,
    /// Start the agents though a host carries fewer
    #[arg(long)]
    pub anyway: bool,
}

/// Result of the command.
#[derive(Debug, Serialize)]
struct StartReport {
    swarm: String,
    run: u64,
    /// Time until every host had reported what it runs, s.
    asked_s: f64,
    /// Time until every agent was started, s.
    started_s: f64,
    /// Total duration, s.
    seconds: f64,
    nodes: Vec<StartedNode>,
}

#[derive(Clone, Debug, Serialize)]
struct StartedNode {
    node: VehicleName,
    host: String,
    state: Readiness,
    /// Whether it flew before.
    ran: bool,
    /// Time until its host reported that it was started, s.
    started_s: Option<f64>,
    /// Time until it reported itself that it is an active member, s.
    ready_s: Option<f64>,
    why: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Readiness {
    Ready,
    Missing,
}

/// Runs the command.
///
/// # Errors
/// If the cluster file or the keys are wrong, or not every vehicle is ready in time; the others fly then.
pub fn run(args: &UpArgs) -> Result<(), Error> {
    let (chosen, ssh, progress) = args.nodes.begin()?;
    keys::check_for_flight(&chosen.inventory, clock::utc())?;
    let reaches = chosen.inventory.reaches(Role::Operator)?;
    // Receive from the beginning, so that the vehicles in flight are known when the last host has answered.
    let mut watch = Watch::open(&reaches, 0)?;
    let contact_deadline = clock::now() + CONTACT_TIMEOUT;
    let up = Up { remote: Remote { ssh: &ssh, swarm: &chosen.inventory.swarm }, chosen: &chosen, progress: &progress };

    let mut rows: BTreeMap<VehicleName, StartedNode> =
        chosen.nodes().map(|node| (node.id, StartedNode::new(node))).collect();
    let (running, notes, owned) = up.ask(&mut rows);
    let asked_s = progress.seconds();
    if !owned.is_empty() {
        drop(progress);
        return Err(Error::Refused(format!(
            "node {} belongs to another authority than the keys of this PC; start it with that authority's keys, or take it \
             over with `skein cluster install --take-over` while no vehicle flies",
            nodes::list(&owned)
        )));
    }
    if !args.anyway {
        let full = up.full(&running, &rows);
        if !full.is_empty() && !capacity::agrees(&full.join("\n")) {
            drop(progress);
            let all = full.join("; ");
            return Err(Error::Refused(format!(
                "{all}; give some of its nodes to other hosts, or start them with --anyway"
            )));
        }
    }
    let until = if may_fly_unasked(&chosen.inventory, &running) { contact_deadline } else { clock::now() };
    let note;
    (watch.run, note) = run_of(&mut watch, &reaches, &running, &notes, until)?;
    up.place(&running);
    up.start((watch.run, note), &running, &mut rows);
    let started_s = progress.seconds();
    up.wait(&mut watch, Duration::from_secs_f64(args.timeout_s), &mut rows);

    let seconds = progress.seconds();
    drop(progress);
    let swarm = chosen.inventory.swarm.to_string();
    let report =
        StartReport { swarm, run: watch.run, asked_s, started_s, seconds, nodes: rows.into_values().collect() };
    args.nodes.show(&report, || report.to_text());
    nodes::fail_if_any(report.nodes.iter().map(|row| (row.node, row.state == Readiness::Missing)), "not ready")
}

/// The running agent of each node whose host could be asked; `None` if none is running.
type RunningAgents = BTreeMap<VehicleName, Option<RunningAgent>>;

/// Whether a vehicle may fly of which no host has reported: it is installed by hand, was not chosen, or its host cannot
/// be asked. A new run must not be begun beside its run. Where messages are not signed, they name no run, so this does
/// not matter.
fn may_fly_unasked(inventory: &Inventory, running: &RunningAgents) -> bool {
    inventory.security == SecurityKind::Tls && inventory.nodes.keys().any(|id| !running.contains_key(id))
}

/// Determines the run that the vehicles are to fly in, and the operator's note of it: the run in flight, or else a new
/// one.
fn run_of(
    watch: &mut Watch,
    reaches: &[Reach],
    running: &RunningAgents,
    notes: &[RunNote],
    until: Instant,
) -> Result<(u64, Option<RunNote>), Error> {
    let by_hosts: BTreeMap<VehicleName, u64> =
        running.iter().filter_map(|(id, agent)| Some((*id, agent.as_ref()?.run))).collect();
    // All teams of a fleet fly in one run, with the same keys.
    let signed = |reach: &'_ Reach| Some((reach.orders_key?, reach.signing_key.clone()?, reach.run_file.clone()?));
    let vehicles = reaches.iter().map(|reach| reach.agents.len()).sum();
    let Some((swarm, (key, signing_key, file))) =
        reaches.first().and_then(|reach| Some((&reach.swarm, signed(reach)?)))
    else {
        // Messages are not signed for a run here, so any run will do.
        return Ok((by_hosts.into_values().next().map_or_else(draw, Ok)?, None));
    };
    let own = file.read()?;
    let evidence = loop {
        let mut reported = by_hosts.clone();
        reported.extend(watch.reported_runs());
        let evidence = Evidence { vehicles, reported, own, notes };
        if evidence.majority().is_some() || clock::now() >= until {
            break evidence;
        }
        clock::sleep(POLL_PERIOD);
    };
    let joined = evidence.run(&key, swarm).map_err(Error::Refused)?;
    if let Some(own) = own.filter(|own| joined == Some(own.note.run) && own.note.is_signed(&key, swarm)) {
        return Ok((own.note.run, Some(own.note)));
    }
    let run = joined.map_or_else(draw, Ok)?;
    let now_ms = clock::Utc::read().nanoseconds(clock::now()) / 1_000_000;
    let signed = notes.iter().filter(|note| note.is_signed(&key, swarm));
    let latest_ms = signed.chain(own.iter().map(|own| &own.note)).map(|note| note.began_ms).max();
    let began_ms = latest_ms.map_or(now_ms, |latest_ms| now_ms.max(latest_ms.saturating_add(1)));
    let note = RunNote::new(&signing_key, swarm, run, began_ms);
    // Record the run before anything is started in it.
    file.keep(&Record::of(note))?;
    Ok((run, Some(note)))
}

struct Up<'a> {
    remote: Remote<'a>,
    chosen: &'a ChosenNodes,
    progress: &'a Progress,
}

impl Up<'_> {
    /// Asks what is running already, and for the notes of runs that hosts keep. A host that cannot be asked is noted in
    /// its rows. The last of the results are the nodes that belong to another authority.
    fn ask(&self, rows: &mut BTreeMap<VehicleName, StartedNode>) -> (RunningAgents, Vec<RunNote>, Vec<VehicleName>) {
        let own = owner::of(&self.chosen.inventory);
        let asked =
            nodes::at_each(&self.chosen.hosts(), self.progress, Some("asking what runs"), |host, node, line| {
                let facts = self.remote.facts(host, node);
                let installed =
                    facts.and_then(|facts| facts.current.is_some().then_some(facts).ok_or(Fault::NotInstalled));
                installed.map_err(|fault| fault.sentence(host)).inspect_err(|why| line.say(why))
            });
        let (mut running, mut notes, mut owned) = (RunningAgents::new(), Vec::new(), Vec::new());
        for (id, facts) in asked {
            match facts {
                Ok(facts) => {
                    owned.extend(owner::another(&facts, own.as_deref()).map(|_| id));
                    running.insert(id, facts.agent);
                    notes.extend(facts.note);
                }
                Err(why) => {
                    rows.entry(id).and_modify(|row| row.why = Some(why));
                }
            }
        }
        (running, notes, owned)
    }

    /// Returns a text for each host that would have to run more agents than it can, measured there. A host that cannot
    /// be measured is reported and left to its operator.
    fn full(&self, running: &RunningAgents, rows: &BTreeMap<VehicleName, StartedNode>) -> Vec<String> {
        let swarm = self.chosen.inventory.nodes.len();
        let starts = |node: &&Node| rows[&node.id].why.is_none() && running.get(&node.id).is_none_or(Option::is_none);
        let hosts = self.chosen.hosts();
        // Of each host that is to start an agent the first such node, and the number of its agents, unless any host runs so few.
        let asked: Vec<_> = hosts
            .iter()
            .filter_map(|(host, nodes)| Some((host, *nodes.iter().find(|node| starts(node))?, nodes.len())))
            .filter(|(_, _, agents)| !Demand { agents: *agents, swarm, traces: false }.is_small(1))
            .collect();
        let running = at_once(&asked, |(host, node, agents)| {
            let line = self.progress.line(host);
            line.say("measuring what it carries");
            let measured = match self.remote.ask(host, node, Ask::Carries { agents: *agents, swarm }) {
                Ok(Answer::Carries(finding)) => Ok(finding),
                Ok(other) => Err(unexpected(host, &other)),
                Err(fault) => Err(fault),
            };
            let answered =
                measured.inspect_err(|fault| line.say(&format!("not measured: {}", fault.clone().sentence(host))));
            answered.ok().flatten().map(|finding| format!("{host}: {finding}"))
        });
        running.into_iter().flatten().collect()
    }

    /// Lets each host whose agent is not running yet put its X-Plane's aircraft to the start, in the scenario's weather, as
    /// `skein fly` does. A fault does not stand against the start: the agents place by UDP.
    fn place(&self, running: &RunningAgents) {
        let is_down = |node: &Node| running.get(&node.id).is_some_and(Option::is_none);
        let hosts = self.chosen.hosts();
        let nodes = hosts.iter().flat_map(|(host, nodes)| nodes.iter().map(move |node| (host, *node)));
        let asked: Vec<_> = nodes
            .filter(|(_, node)| is_down(node))
            .filter_map(|(host, node)| Some((host, node, node.xplane.clone()?)))
            .collect();
        at_once(&asked, |(host, node, address)| {
            let line = self.progress.line(host);
            line.say(&format!("node {}: placing the aircraft of {address}", node.id));
            let lines = match self.remote.ask(host, node, Ask::Place { address: address.clone() }) {
                Ok(Answer::Placed(lines)) => lines,
                Ok(other) => vec![format!("not placed: answers {other:?}")],
                Err(fault) => vec![format!("not placed: {}", fault.sentence(host))],
            };
            lines.iter().for_each(|found| line.say(&format!("node {}: {found}", node.id)));
        });
    }

    /// Starts the agents that are not running yet, where the host could be asked; and the supervisor of a running
    /// agent, if it has died.
    fn start(
        &self,
        (run, note): (u64, Option<RunNote>),
        running: &RunningAgents,
        rows: &mut BTreeMap<VehicleName, StartedNode>,
    ) {
        let was_asked = |node: &&Node| rows[&node.id].why.is_none();
        let asked = by_host(self.chosen.over_ssh().filter(was_asked));
        let started = nodes::at_each(&asked, self.progress, None, |host, node, line| {
            let ran = running.get(&node.id).is_some_and(Option::is_some);
            let done = self.remote.ask(host, node, Ask::Start { run, note });
            let done = done.map(|_| self.progress.seconds()).map_err(|why| why.sentence(host));
            line.say(&match &done {
                Ok(_) if ran => format!("node {} flies already", node.id),
                Ok(_) => format!("node {} started", node.id),
                Err(why) => why.clone(),
            });
            (ran, done)
        });
        for (id, (ran, done)) in started {
            rows.entry(id).and_modify(|row| {
                row.ran = ran;
                match done {
                    Ok(at_s) => row.started_s = Some(at_s),
                    Err(why) => row.why = Some(why),
                }
            });
        }
        for node in self.chosen.manual() {
            let command = format!("skein agent --config agent.toml --run {run}");
            self.progress.line(&format!("node {}", node.id)).say(&format!("start it by hand there: {command}"));
        }
    }

    /// Waits until every vehicle has reported that it is ready, or until the timeout; then adds the reasons for the
    /// missing ones.
    fn wait(&self, watch: &mut Watch, timeout: Duration, rows: &mut BTreeMap<VehicleName, StartedNode>) {
        let begun = clock::now();
        let line = self.progress.line(&"swarm");
        let all = rows.len();
        let awaited = rows.values().filter(|row| row.why.is_none()).count();
        line.say(&format!("waiting for {awaited} vehicles to say that they are ready"));
        let wanted = rows.keys().map(|id| (*id, None)).collect();
        let out: Vec<VehicleName> = rows.values().filter(|row| row.why.is_some()).map(|row| row.node).collect();
        if !out.is_empty() {
            line.say(&format!("node {} is out: not waited for", nodes::list(&out)));
        }
        // A vehicle that flew before and whose host cannot be asked has been in contact by now.
        let until = |id| if out.contains(&id) { begun } else { begun + timeout };
        let mut ready = 0;
        let missing = watch.ready(&wanted, until, |id| {
            ready += 1;
            line.say(&format!("node {id} ready, {ready} of {all}"));
            rows.entry(id).and_modify(|row| {
                row.state = Readiness::Ready;
                row.ready_s = Some(self.progress.seconds());
            });
        });
        for id in &missing {
            let lacks = watch.lacks(*id, None).unwrap_or_default();
            rows.entry(*id).and_modify(|row| {
                row.why = Some(row.why.take().map_or_else(|| lacks.clone(), |why| format!("{why}; {lacks}")));
            });
        }
        self.last_lines(rows);
    }

    /// Adds the last log line of each agent that was started but is not ready.
    fn last_lines(&self, rows: &mut BTreeMap<VehicleName, StartedNode>) {
        let silent = |node: &&Node| rows[&node.id].state == Readiness::Missing && rows[&node.id].started_s.is_some();
        let last_lines = at_once(&by_host(self.chosen.over_ssh().filter(silent)), |(host, nodes)| {
            let last = |node: &&Node| {
                let mut last = None;
                // If this fails, the rest of the reason is still shown.
                let _ = self.remote.log(host, node, (1, false), |line| last = Some(line.to_owned()));
                (node.id, last)
            };
            nodes.iter().map(last).collect::<Vec<_>>()
        });
        for (id, last) in last_lines.into_iter().flatten() {
            let Some((row, last)) = rows.get_mut(&id).zip(last) else { continue };
            row.why = Some(format!("{}; wrote last: {last}", row.why.take().unwrap_or_default()));
        }
    }
}

impl StartedNode {
    fn new(node: &Node) -> Self {
        let host = nodes::place(node);
        Self { node: node.id, host, state: Readiness::Missing, ran: false, started_s: None, ready_s: None, why: None }
    }
}

impl StartReport {
    fn to_text(&self) -> String {
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.1}"));
        let rows = self.nodes.iter().map(|row| {
            let state = match (row.state, row.ran) {
                (Readiness::Ready, true) => "ready, flew before",
                (Readiness::Ready, false) => "ready",
                (Readiness::Missing, _) => "missing",
            };
            let times = [number(row.started_s), number(row.ready_s)];
            let why = row.why.clone().unwrap_or_default();
            [row.node.to_string(), row.host.clone(), state.to_owned()].into_iter().chain(times).chain([why]).collect()
        });
        let ready = self.nodes.iter().filter(|row| row.state == Readiness::Ready).count();
        let table = findings::table(&["node", "host", "state", "started s", "ready s", ""], rows);
        let (all, swarm, run) = (self.nodes.len(), &self.swarm, self.run);
        format!("{table}{ready} of {all} vehicles of {swarm} are ready after {:.1} s (run {run})\n", self.seconds)
    }
}

/// Draws the number of a new run: random, so that it is never used twice, and not 0.
fn draw() -> Result<u64, Error> {
    let bytes = os::random_bytes().ok_or_else(|| Error::Failed("the system gives no random numbers".to_owned()))?;
    Ok(u64::from_le_bytes(bytes) % (RUNS - 1) + 1)
}

#[cfg(test)]
mod tests {
    #[cfg(unix)]
    use std::fs;

    use skein_common::id::VehicleId;

    use super::*;
    use crate::inventory::tests::lab;
    #[cfg(unix)]
    use crate::protocol::{Change, Facts, Installed};
    #[cfg(unix)]
    use crate::ssh::tests::{local, write_script};

    #[test]
    fn run_numbers_are_unique() {
        let drawn: std::collections::BTreeSet<u64> = (0..100).map(|_| draw().unwrap()).collect();
        assert_eq!(drawn.len(), 100);
        assert!(drawn.iter().all(|run| (1..RUNS).contains(run)));
    }

    #[test]
    fn a_vehicle_whose_host_was_not_asked_may_be_flying() {
        let folder = tempfile::tempdir().unwrap();
        let manual = "[defaults]\ninstall = 'manual'";
        for (more, hosts, may) in [("", 2, false), ("", 1, true), (manual, 0, true), ("security = 'none'", 1, false)] {
            let running: RunningAgents = VehicleId::first(hosts).map(|id| (id.into(), None)).collect();
            assert_eq!(may_fly_unasked(&lab(folder.path(), 2, more), &running), may, "{more} {running:?}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_running_agent_is_started_too_because_its_supervisor_may_have_died() {
        let folder = tempfile::tempdir().unwrap();
        let (ssh, inventory) = (local(folder.path()), lab(folder.path(), 1, ""));
        let installed = Installed { release: "r1".to_owned(), bundle: "00".to_owned() };
        let agent = RunningAgent { pid: 7, installed, run: 5, restarts: 0, landing_s: 0.0 };
        let facts = Facts { agent: Some(agent.clone()), ..Facts::default() };
        let answer = serde_json::to_string(&Answer::Done(Change { changed: false, forced: false, facts })).unwrap();
        let program = folder.path().join("home/.skein/lab/releases/r1/skein");
        fs::create_dir_all(program.parent().unwrap()).unwrap();
        write_script(&program, &format!("read -r asked\necho \"$asked\" >asked\necho '{answer}'"));
        let chosen = ChosenNodes { ids: inventory.nodes.keys().copied().collect(), inventory };
        let mut rows: BTreeMap<_, _> = chosen.nodes().map(|node| (node.id, StartedNode::new(node))).collect();
        let remote = Remote { ssh: &ssh, swarm: &chosen.inventory.swarm };
        let up = Up { remote, chosen: &chosen, progress: &Progress::new(true) };
        let running: RunningAgents = chosen.ids.iter().map(|id| (*id, Some(agent.clone()))).collect();
        up.start((5, None), &running, &mut rows);
        let asked = fs::read_to_string(folder.path().join("home/asked")).unwrap();
        assert!(asked.contains(r#""Start":{"run":5,"note":null}"#), "{asked}");
        assert!(rows.values().all(|row| row.ran && row.started_s.is_some() && row.why.is_none()), "{rows:?}");
    }

    #[test]
    #[cfg(unix)]
    fn every_x_plane_whose_agent_is_down_is_placed_by_its_host() {
        let folder = tempfile::tempdir().unwrap();
        let ssh = local(folder.path());
        let program = folder.path().join("home/.skein/lab/releases/r1/skein");
        fs::create_dir_all(program.parent().unwrap()).unwrap();
        let answer =
            serde_json::to_string(&Answer::Placed(vec!["place ok: 0 m from its start, by UDP".to_owned()])).unwrap();
        write_script(&program, &format!("read -r asked\necho \"$asked\" >>asked\necho '{answer}'"));
        let xplanes = "[defaults]\nplant = 'xplane'\nxplane = '127.0.0.1:49000'";
        let inventory = lab(folder.path(), 3, xplanes);
        let chosen = ChosenNodes { ids: inventory.nodes.keys().copied().collect(), inventory };
        let up = Up {
            remote: Remote { ssh: &ssh, swarm: &chosen.inventory.swarm },
            chosen: &chosen,
            progress: &Progress::new(true),
        };
        let installed = Installed { release: "r1".to_owned(), bundle: "00".to_owned() };
        let agent = RunningAgent { pid: 7, installed, run: 5, restarts: 0, landing_s: 0.0 };
        // Vehicle 1 flies, vehicle 2 does not, and the host of vehicle 3 could not be asked.
        let ids: Vec<VehicleName> = chosen.ids.iter().copied().collect();
        up.place(&[(ids[0], Some(agent)), (ids[1], None)].into());
        let asked = fs::read_to_string(folder.path().join("home/asked")).unwrap();
        let asked: Vec<&str> = asked.lines().collect();
        assert!(matches!(&asked[..], [one] if one.contains(r#""id":"2""#) || one.contains(r#""id":2"#)), "{asked:?}");
        assert!(asked[0].contains(r#""Place":{"address":"127.0.0.1:49000"}"#), "{asked:?}");
    }

    #[test]
    #[cfg(unix)]
    fn a_host_with_more_agents_than_it_can_run_is_listed_with_figures() {
        let folder = tempfile::tempdir().unwrap();
        let ssh = local(folder.path());
        let program = folder.path().join("home/.skein/lab/releases/r1/skein");
        fs::create_dir_all(program.parent().unwrap()).unwrap();
        let answer = serde_json::to_string(&Answer::Carries(Some("1 agent asks for 1.2 cores".to_owned()))).unwrap();
        write_script(&program, &format!("read -r asked\necho \"$asked\" >>asked\necho '{answer}'"));
        let full_of = |vehicles: usize, runs: bool| {
            let inventory = lab(folder.path(), vehicles, "");
            let chosen = ChosenNodes { ids: inventory.nodes.keys().copied().collect(), inventory };
            let rows: BTreeMap<_, _> = chosen.nodes().map(|node| (node.id, StartedNode::new(node))).collect();
            let remote = Remote { ssh: &ssh, swarm: &chosen.inventory.swarm };
            let up = Up { remote, chosen: &chosen, progress: &Progress::new(true) };
            let installed = Installed { release: "r1".to_owned(), bundle: "00".to_owned() };
            let agent = runs.then_some(RunningAgent { pid: 7, installed, run: 5, restarts: 0, landing_s: 0.0 });
            let running: RunningAgents = chosen.ids.iter().map(|id| (*id, agent.clone())).collect();
            up.full(&running, &rows)
        };
        let full = full_of(20, false);
        assert_eq!(full.len(), 20);
        assert_eq!(full[0], "10.0.0.11: 1 agent asks for 1.2 cores");
        let asked = fs::read_to_string(folder.path().join("home/asked")).unwrap();
        assert!(asked.contains(r#""Carries":{"agents":1,"swarm":20}"#), "{asked}");
        assert_eq!(full_of(4, false), [""; 0], "so few fit anywhere");
        assert_eq!(full_of(20, true), [""; 0], "they run already");
        assert_eq!(fs::read_to_string(folder.path().join("home/asked")).unwrap(), asked, "no host was asked again");
    }

    #[test]
    fn the_table_shows_why_a_vehicle_is_missing() {
        let row = |id: u8, state, why: Option<&str>| StartedNode {
            node: VehicleId::new(id).unwrap().into(),
            host: format!("heli{id}"),
            state,
            ran: id == 2,
            started_s: Some(0.5),
            ready_s: (state == Readiness::Ready).then_some(1.25),
            why: why.map(str::to_owned),
        };
        let nodes = vec![
            row(1, Readiness::Ready, None),
            row(2, Readiness::Ready, None),
            row(10, Readiness::Missing, Some("not in contact")),
        ];
        let report =
            StartReport { swarm: "lab".to_owned(), run: 42, asked_s: 0.3, started_s: 0.6, seconds: 60.04, nodes };
        let wanted = " node  host    state               started s  ready s
    1  heli1   ready                     0.5      1.2
    2  heli2   ready, flew before        0.5      1.2
   10  heli10  missing                   0.5           not in contact
2 of 3 vehicles of lab are ready after 60.0 s (run 42)\n";
        assert_eq!(report.to_text(), wanted);
    }
}
