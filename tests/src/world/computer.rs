//! One simulated PC: its clocks, its disk, its supervisor, its helicopter, and the process of its agent.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use skein_agent::link::Trust;
use skein_agent::run::simulated::SimulatedAgent;
use skein_cluster::host::supervision::{AgentEnd, Supervised, Supervision, note_agent};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::scenario::Scenario;
use skein_core::aircraft::Aircraft;
use skein_core::builtin::BuiltInPlant;
use skein_core::control::Rules;
use skein_core::helicopter::{Failures, TICK_S};
use skein_core::plant::{Command, Frame, Plant, Wake};
use skein_host::clock::{incarnation_after, incarnation_text};

use super::plan::PcPlan;

/// UTC at the begin of every flight, s since 1970.
const BEGIN_UTC_S: f64 = 1.8e9;

/// What all agents of a swarm are made of.
pub(super) struct Parts {
    pub(super) scenario: Scenario,
    pub(super) aircraft: Aircraft,
    pub(super) rules: Rules,
    /// The instant from which all clocks count.
    pub(super) zero: Instant,
}

/// A helicopter that flies whether its agent runs or not.
pub(super) struct Helicopter {
    pub(super) plant: BuiltInPlant,
    command: Option<Command>,
}

/// What the control loop of an agent holds of the helicopter.
struct Cockpit(Arc<Mutex<Helicopter>>);

impl Helicopter {
    /// Flies for one tick and returns the frame.
    fn advance(&mut self) -> Frame {
        self.plant.advance(self.command);
        self.plant.frame()
    }
}

impl Plant for Cockpit {
    fn wait(&mut self, _timeout: Duration) -> Wake {
        Wake::default()
    }

    fn command(&mut self, command: Command) {
        lock(&self.0).command = Some(command);
    }

    fn release(&mut self) {}

    fn frame_period_s(&self) -> f64 {
        TICK_S
    }
}

fn lock(helicopter: &Mutex<Helicopter>) -> std::sync::MutexGuard<'_, Helicopter> {
    helicopter.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the disk of a node keeps, as the agent writes it.
#[derive(Clone, Debug, Default)]
pub(super) struct Disk {
    /// The file of the incarnation number.
    life: Option<String>,
    /// The file of the agent's process.
    process: Option<u64>,
    /// Whether no file can grow.
    pub(super) is_full: bool,
    /// Whether nothing can be read or written.
    pub(super) is_dead: bool,
}

impl Disk {
    /// Writes a new file in place of the old one.
    fn replace(&self) -> Result<(), String> {
        if self.is_full || self.is_dead { Err("no room".to_owned()) } else { Ok(()) }
    }

    /// Writes over the content of a file, which needs no room.
    fn overwrite(&self, exists: bool) -> Result<(), String> {
        if self.is_dead || !exists { Err("no file".to_owned()) } else { Ok(()) }
    }

    /// Keeps the text of an incarnation, as the agent does.
    fn keep_life(&mut self, text: String) {
        if self.is_dead {
            return;
        }
        // Without room no more can be written over a file than it holds already.
        let room = if self.is_full { self.life.as_ref().map_or(0, String::len) } else { text.len() };
        self.life = Some(text.chars().take(room).collect());
    }
}

/// The process of an agent.
pub(super) struct Process {
    pub(super) agent: SimulatedAgent,
    /// Whether it has reported to its supervisor: then ten seconds without a report are a hang, before that a minute.
    pub(super) has_reported: bool,
    /// Since when it hangs, ns.
    pub(super) hangs_since_ns: Option<u64>,
    /// Whether the operating system has stopped the process.
    pub(super) is_stopped: bool,
    /// Whether the control thread alone hangs.
    pub(super) control_hangs: bool,
}

/// One PC.
pub(super) struct Computer {
    pub(super) id: VehicleId,
    pub(super) plan: PcPlan,
    pub(super) disk: Disk,
    pub(super) process: Option<Process>,
    pub(super) is_suspended: bool,
    pub(super) publisher_is_blocked: bool,
    pub(super) simulator_is_frozen: bool,
    /// How far the UTC clock was set, s.
    pub(super) utc_set_s: f64,
    /// For how long the monotonic clock stood still, ns.
    pub(super) stood_still_ns: u64,
    helicopter: Arc<Mutex<Helicopter>>,
    supervision: Supervision,
    has_reported: bool,
    /// How the last process ended, until the supervisor has looked.
    ended: Option<AgentEnd>,
    /// When an agent was started first, ns.
    first_start_ns: Option<u64>,
    /// The supervisor's and the operating system's lines for the log.
    pub(super) notes: Vec<String>,
    /// When the disk or a suspension last kept an agent from starting, ns.
    pub(super) held_up_ns: u64,
    /// Since when no process has run, ns.
    pub(super) without_agent_since_ns: Option<u64>,
}

impl Computer {
    /// The PC of a vehicle before its supervisor is started.
    pub(super) fn new(id: VehicleId, plan: PcPlan, plant: BuiltInPlant) -> Self {
        Self {
            id,
            plan,
            disk: Disk::default(),
            process: None,
            is_suspended: false,
            publisher_is_blocked: false,
            simulator_is_frozen: false,
            utc_set_s: 0.0,
            stood_still_ns: 0,
            helicopter: Arc::new(Mutex::new(Helicopter { plant, command: None })),
            supervision: Supervision::default(),
            has_reported: false,
            ended: None,
            first_start_ns: None,
            notes: Vec::new(),
            held_up_ns: 0,
            without_agent_since_ns: None,
        }
    }

    /// The monotonic clock of this PC at a true time.
    pub(super) fn now(&self, zero: Instant, t_ns: u64) -> Instant {
        let own_ns = t_ns.saturating_sub(self.stood_still_ns) as f64 * self.plan.rate;
        // Different PCs have been up for different times.
        zero + Duration::from_secs(10 * u64::from(self.id.get())) + Duration::from_nanos(own_ns as u64)
    }

    fn utc_ns(&self, t_ns: u64) -> u64 {
        ((BEGIN_UTC_S + self.plan.utc_error_s + self.utc_set_s) * 1e9 + t_ns as f64) as u64
    }

    /// Whether the threads of the agent's link run.
    pub(super) fn has_link(&self) -> bool {
        !self.is_suspended && self.process.as_ref().is_some_and(|process| !process.is_stopped)
    }

    /// Whether nothing is wrong with this PC and its agent.
    pub(super) fn is_healthy(&self) -> bool {
        let runs = self.process.as_ref().is_some_and(|process| !process.is_stopped && !process.control_hangs);
        runs && !self.is_suspended && !self.publisher_is_blocked && !self.simulator_is_frozen
    }

    /// The process whose link runs.
    pub(super) fn linked_process(&mut self) -> Option<&mut Process> {
        if self.is_suspended { None } else { self.process.as_mut().filter(|process| !process.is_stopped) }
    }

    /// Ends the process, as `kill -9` does.
    pub(super) fn kill(&mut self, t_ns: u64) -> Option<Process> {
        let process = self.process.take()?;
        self.ended = Some(AgentEnd { is_success: false, how: "was killed by signal 9".to_owned() });
        self.without_agent_since_ns = Some(t_ns);
        Some(process)
    }

    /// The next frame of the helicopter; `None` while its simulator is frozen.
    pub(super) fn next_frame(&mut self) -> Option<Frame> {
        if self.simulator_is_frozen { None } else { Some(lock(&self.helicopter).advance()) }
    }

    /// From now on the measured position does not change.
    pub(super) fn freeze_position(&mut self) {
        lock(&self.helicopter).plant.fail(Failures { position_frozen: true, ..Failures::default() });
    }

    /// The helicopter's height above the ground, m.
    pub(super) fn height_m(&self) -> f64 {
        lock(&self.helicopter).plant.frame().measurement.height_m
    }

    /// The control loop's report to the supervisor.
    pub(super) fn report(&mut self) {
        self.process.iter_mut().for_each(|process| process.has_reported = true);
        self.has_reported = true;
    }

    /// Lets the supervisor look. Returns the process that it has killed.
    pub(super) fn supervise(&mut self, parts: &Parts, trust: impl Fn() -> Trust, t_ns: u64) -> Option<Process> {
        let mut supervision = std::mem::take(&mut self.supervision);
        let now = self.now(parts.zero, t_ns);
        let mut node = Node { computer: self, parts, trust: &trust, t_ns, now, killed: None };
        // The supervisor's work is over only if an agent ends by itself.
        let _ = supervision.poll(&mut node, now);
        let killed = node.killed;
        self.supervision = supervision;
        killed
    }

    /// Starts the agent's process as `skein node --fly` does.
    fn start(&mut self, parts: &Parts, trust: Trust, t_ns: u64, now: Instant) -> Result<(), String> {
        let has_note = self.disk.process.is_some();
        let noted = note_agent(|| self.disk.replace(), || self.disk.overwrite(has_note))?;
        self.notes.extend(noted.map(|error| format!("the agent's process is noted over the last one: {error}")));
        self.disk.process = Some(t_ns);
        let kept = self.disk.life.clone().filter(|_| !self.disk.is_dead);
        let incarnation = incarnation_after(kept.as_deref(), Incarnation(self.utc_ns(t_ns)));
        self.disk.keep_life(incarnation_text(incarnation));
        let flown_s = self.first_start_ns.map(|first| (t_ns - first) as f64 * 1e-9);
        self.first_start_ns.get_or_insert(t_ns);
        let plant = Box::new(Cockpit(self.helicopter.clone()));
        let craft = (&parts.aircraft, parts.rules.clone());
        let agent = SimulatedAgent::start(&parts.scenario, (self.id, incarnation), craft, (plant, flown_s), trust, now)
            .map_err(|error| error.to_string())?;
        self.process =
            Some(Process { agent, has_reported: false, hangs_since_ns: None, is_stopped: false, control_hangs: false });
        self.notes.push(format!("agent starts, incarnation {}", incarnation.0));
        self.without_agent_since_ns = None;
        Ok(())
    }
}

/// The agent of a PC, as its supervisor sees it.
struct Node<'a, F> {
    computer: &'a mut Computer,
    parts: &'a Parts,
    trust: &'a F,
    t_ns: u64,
    now: Instant,
    killed: Option<Process>,
}

impl<F: Fn() -> Trust> Supervised for Node<'_, F> {
    fn listen(&mut self) -> Result<(), String> {
        self.computer.has_reported = false;
        // A socket is an entry of a folder.
        if self.computer.disk.is_dead { Err("the disk fails".to_owned()) } else { Ok(()) }
    }

    fn start(&mut self) -> Result<(), String> {
        self.computer.ended = None;
        if let Err(error) = self.computer.start(self.parts, (self.trust)(), self.t_ns, self.now) {
            // The process has started, and has ended by itself.
            self.computer.ended = Some(AgentEnd { is_success: false, how: format!("ended: {error}") });
        }
        Ok(())
    }

    fn ended(&mut self) -> Option<AgentEnd> {
        if self.computer.process.is_some() { None } else { self.computer.ended.clone() }
    }

    fn has_reported(&mut self) -> bool {
        std::mem::take(&mut self.computer.has_reported)
    }

    fn kill(&mut self) {
        self.killed = self.computer.kill(self.t_ns);
    }

    fn ask_to_end(&mut self) {}

    fn requests(&self) -> u32 {
        0
    }

    fn note(&mut self, what: &str) {
        self.computer.notes.push(what.to_owned());
    }
}
