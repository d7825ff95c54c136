//! The control thread: receives a frame, steps the agent, writes the command, then does everything else.

use std::sync::Arc;
use std::time::{Duration, Instant};

use skein_common::frame::{Origin, PositionNed};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{
    Drops, Event, EventKind, Header, Health, PeerHealth, ProcessFigures, Reason, Refused, Severity, ShortText, Summary,
    Trace, Traffic, VehicleFacts,
};
use skein_common::state::Activity;
use skein_common::time::LocalTime;
use skein_common::topic::Cell;
use tokio::sync::mpsc;

use super::Stop;
use super::timing::{Timing, TimingSummary};
use crate::external::LiveLaw;
use crate::inputs::Recorder;
use crate::link::{Link, Messages};
use crate::unix;
use skein_core::agent::Outputs;
use skein_core::energy::Energy;
use skein_core::formation::Workspace;
use skein_core::neighbourhood::Neighbourhood;
use skein_core::outbox::Outbox;
use skein_core::plant::{Frame, Plant, PlantDrops, Wake};
use skein_core::station::{Station, StepInputs};
use skein_host::clock::{LocalClock, now, sleep_until};

/// Longest wait for the plant's frame, in frame periods. The agent then steps without a frame.
const TIMEOUT_PERIODS: f64 = 1.5;

/// Time without a frame after which a simulator counts as ended. A simulator on an overloaded PC pauses for seconds,
/// and its vehicle still has to be landed afterwards.
const SIMULATOR_GONE_AFTER: Duration = Duration::from_secs(10);

/// A pass that begins this long after the one before is late: the computer did not run the agent meanwhile, s.
const LATE_S: f64 = 0.1;

/// Time between two summaries, s.
const SUMMARY_PERIOD_S: f64 = 0.1;

/// Everything that the control thread owns.
pub(super) struct Control {
    pub(super) station: Station,
    pub(super) plant: Box<dyn Plant>,
    pub(super) plant_name: &'static str,
    /// Release that runs here.
    pub(super) release: String,
    pub(super) link: Link,
    /// The external law, if the scenario has one.
    pub(super) law: Option<LiveLaw>,
    pub(super) clock: LocalClock,
    /// Origin from which the cells of the map are counted: the fleet's, or the swarm's own.
    pub(super) origin: Origin,
    /// Origin of the swarm's frame.
    pub(super) own_origin: Origin,
    /// The cells around, if other teams share the air.
    pub(super) neighbourhood: Option<Neighbourhood>,
    pub(super) own: VehicleId,
    pub(super) incarnation: Incarnation,
    pub(super) stop: Arc<Stop>,
    /// Health messages go to a thread that may block.
    pub(super) health: mpsc::Sender<Health>,
    /// Keeps what enters and leaves the station, if there is a folder for it.
    pub(super) recorder: Option<Recorder>,
    /// The vehicle's energy, for the summary.
    pub(super) energy: Energy,
    pub(super) timing: Timing,
    pub(super) kept: LoopState,
}

/// State kept from one pass of the control loop to the next.
#[derive(Default)]
pub(super) struct LoopState {
    /// The inputs of this step, with room that is used again.
    pub(super) inputs: StepInputs,
    /// The reason why something that the external law sent was refused, until it is reported.
    law_refusal: Option<ShortText>,
    workspace: Workspace,
    events: u64,
    healths: u64,
    /// Health messages that were dropped because the publishing thread still had the previous one.
    unsent_healths: u64,
    summaries: u64,
    /// The time at which the next summary is due, and the activity that the last one showed.
    next_summary: LocalTime,
    summarised: Option<Activity>,
    /// Timing of the last full second.
    last_second: TimingSummary,
}

impl Control {
    /// Flies until the flight has ended, and returns the link to be closed.
    pub(super) fn run(mut self) -> Link {
        let period = Duration::from_secs_f64(self.plant.frame_period_s());
        let timeout = period.mul_f64(TIMEOUT_PERIODS);
        let mut deadline = now() + timeout;
        loop {
            let wake = self.plant.wait(deadline.saturating_duration_since(now()));
            if wake.frame.is_none() {
                // A plant that returns early must not make a real-time thread spin.
                sleep_until(deadline);
            }
            let woken = now();
            deadline = woken + timeout;
            self.run_once(wake, woken);
            if self.is_over() {
                break;
            }
        }
        self.plant.release();
        if let Some(delivery_counts) = self.station.delivery_counts() {
            tracing::info!("vehicle {} received over the scenario's network: {delivery_counts:?}", self.own);
        }
        self.link
    }

    /// One pass of the control loop.
    fn run_once(&mut self, Wake { frame, status }: Wake, woken: Instant) {
        let frame = frame.as_ref();
        self.kept.inputs.status = status;
        self.take_inputs(frame, woken);
        let outputs = self.step();
        if let Some(health) = self.report(frame, outputs, (woken, now())) {
            // If the publishing thread still has the previous one, this one is dropped.
            self.kept.unsent_healths += u64::from(self.health.try_send(health).is_err());
            // The service manager watches this thread alone: an agent whose messages do not leave flies on.
            unix::notify_service_manager("WATCHDOG=1");
        }
    }

    /// Steps the agent with its inputs and writes its command.
    pub(super) fn step(&mut self) -> Outputs {
        let kept = &mut self.kept;
        if let Some(recorder) = &mut self.recorder {
            recorder.inputs(&kept.inputs);
        }
        let outputs = self.station.step_with(&mut kept.inputs, &mut kept.workspace);
        if let Some(command) = outputs.command {
            self.plant.command(command);
        }
        outputs
    }

    /// Everything after the command: records the step and hands over its messages. `done` is when the command was
    /// written. Returns a health message once a second.
    pub(super) fn report(
        &mut self,
        frame: Option<&Frame>,
        outputs: Outputs,
        (woken, done): (Instant, Instant),
    ) -> Option<Health> {
        let true_time = self.clock.at(woken);
        if let Some(recorder) = &mut self.recorder {
            recorder.outputs(true_time, &outputs);
        }
        let Outputs { outbox, ask, .. } = outputs;

        if let Some((law, ask)) = self.law.as_ref().zip(ask) {
            law.ask(*ask);
        }
        self.plant.show_peers(&mut self.station.agent().peer_poses(&self.own_origin));

        let trace = frame.and_then(|frame| self.trace(true_time, frame));
        if let Some(frame) = frame {
            self.energy.take(frame.time, frame.truth.power_w);
            self.timing.frame(woken, self.plant.drops().skipped_frames);
            self.timing.step(woken, done);
        }
        let local_time = self.station.clocks().local_time(true_time);
        let summary = self.summary(true_time, frame);
        self.send(local_time, outbox, trace, summary);
        self.kept.last_second = self.timing.summary(done)?;
        self.kept.healths += 1;
        Some(self.health(local_time, true_time.seconds()))
    }

    /// Collects what enters the station in this step: the frame, and what the link and the law received.
    pub(super) fn take_inputs(&mut self, frame: Option<&Frame>, woken: Instant) {
        let (true_time, inputs) = (self.clock.at(woken), &mut self.kept.inputs);
        let before = std::mem::replace(&mut inputs.right, true_time);
        let since_s = true_time.seconds_since(before);
        inputs.did_not_run_s = (before > LocalTime::ZERO && since_s > LATE_S).then_some(since_s);
        self.link.drain(&mut inputs.received);
        if self.neighbourhood.is_some() {
            self.link.drain_strangers(&mut inputs.strangers, &mut inputs.intents);
        }
        inputs.plant_time = frame.map_or(inputs.plant_time, |frame| frame.time);
        inputs.measurement = frame.map(|frame| frame.measurement);
        inputs.leave = self.stop.is_requested();
        (inputs.answer, self.kept.law_refusal) = self.law.as_ref().map(LiveLaw::take).unwrap_or_default();
    }

    /// Hands the messages of this step to the publisher's thread.
    fn send(&mut self, now: LocalTime, outbox: Outbox, trace: Option<Trace>, summary: Option<Summary>) {
        let Outbox { state, mission, intent, mut happened } = outbox;
        // Not the core decides on it: a replay of its inputs gives the same outputs.
        happened.extend(self.kept.law_refusal.take().map(EventKind::LawAnswerRefused));
        let position = state.as_ref().map(|state| self.origin.ned_from_geodetic(&state.state.position));
        let state = state.map(|state| *state).zip(position.map(Cell::of));
        let intent = intent.map(|intent| (*intent, intent.cells(&self.origin).collect()));
        let cells = position.and_then(|position| self.cells_around(position));
        let event = |what| {
            self.kept.events += 1;
            log(self.own, &what);
            Event { header: self.header(now, self.kept.events), what }
        };
        let events = happened.into_iter().map(event).collect();
        let mission = mission.map(|mission| *mission);
        let traces = trace.into_iter().collect();
        let messages = Messages { state, mission, events, traces, summary, intent, cells };
        if !messages.is_empty() {
            self.link.send(messages);
        }
    }

    /// The cells to subscribe to from here, if they have changed.
    fn cells_around(&mut self, position: PositionNed) -> Option<Vec<Cell>> {
        let (neighbourhood, agent) = (self.neighbourhood.as_mut()?, self.station.agent());
        let on_map = |place| self.origin.ned_from_geodetic(&self.own_origin.geodetic_from_ned(place));
        let centre = agent.centre_ne_m();
        let towards = on_map(PositionNed::new(centre.x, centre.y, 0.0));
        neighbourhood.changed(position, towards, agent.wanted_area().map(on_map)).map(|homes| homes.cells())
    }

    /// The trace of this step, if it has a subscriber. Its timing is that of the previous step.
    fn trace(&mut self, true_time: LocalTime, frame: &Frame) -> Option<Trace> {
        self.link.trace_is_wanted().then(|| {
            let mut trace = self.station.trace(true_time, frame.time, &frame.truth);
            trace.step_us = self.timing.last_step_us;
            trace.frame_overruns = self.timing.overruns;
            trace
        })
    }

    /// The summary after this step, if it has a subscriber and is due. A vehicle without frames sends it too. A new activity is
    /// shown at once: an agent that was asked to end does so in the step in which its vehicle has landed.
    fn summary(&mut self, true_time: LocalTime, frame: Option<&Frame>) -> Option<Summary> {
        let kept = &mut self.kept;
        let activity = Some(self.station.agent().activity());
        let is_due = true_time >= kept.next_summary || activity != kept.summarised;
        if !is_due || !self.link.summary_is_wanted() {
            return None;
        }
        kept.summarised = activity;
        // Ten a second on average, and none made up for after a pause.
        kept.next_summary =
            kept.next_summary.max(true_time.plus_seconds(-SUMMARY_PERIOD_S)).plus_seconds(SUMMARY_PERIOD_S);
        kept.summaries += 1;
        let header = self.header(self.station.clocks().local_time(true_time), self.kept.summaries);
        let TimingSummary { frame_rate_hz, jitter_ms, step_p99_us, .. } = self.kept.last_second;
        let facts = VehicleFacts {
            power_w: frame.and_then(|frame| frame.truth.power_w),
            energy_left: self.energy.left(),
            process: Some(ProcessFigures {
                frame_rate_hz,
                jitter_ms,
                step_p99_us,
                frame_overruns: self.timing.overruns,
                dropped: self.drops().total(),
                unsent: self.unsent(),
            }),
            ..self.station.facts(true_time)
        };
        Some(Summary { header, plant_time: self.kept.inputs.plant_time, facts })
    }

    fn health(&self, now: LocalTime, uptime_s: f64) -> Health {
        let TimingSummary { frame_rate_hz, jitter_ms, step_p50_us, step_p99_us } = self.kept.last_second;
        let agent = self.station.agent();
        let (state_messages, state_bytes) = agent.states_sent();
        let peer = |peer: skein_core::peers::PeerEstimate| PeerHealth {
            id: peer.id,
            standing: peer.standing,
            age_s: peer.age_s,
            delay_s: peer.delay_s,
            clock: None,
        };
        let old = |(id, count)| Refused { reason: Reason::Old, key: format!("vehicle/{id}"), count };
        Health {
            header: self.header(now, self.kept.healths),
            uptime_s,
            activity: agent.activity(),
            in_place_s: agent.in_place_s(),
            plant: self.plant_name.to_owned(),
            version: self.release.clone(),
            failures: agent.failures(),
            simulator_faults: self.kept.inputs.status.faults.clone(),
            frame_rate_hz,
            jitter_ms,
            step_p50_us,
            step_p99_us,
            frame_overruns: self.timing.overruns,
            drops: self.drops(),
            unsent: self.unsent(),
            refused: agent.old_messages().map(old).take(Refused::MAX_COUNT).collect(),
            state_messages,
            state_bytes,
            // The link counts them.
            links: 0,
            sent: Traffic::default(),
            received: Traffic::default(),
            peers: agent.peers().map(peer).collect(),
        }
    }

    /// Messages and measurements dropped so far by the core, the link and the plant.
    fn drops(&self) -> Drops {
        let (core, link) = (self.station.agent().drops(), self.link.drops());
        let PlantDrops { malformed, foreign, .. } = self.plant.drops();
        Drops {
            plant_malformed: malformed,
            plant_foreign: foreign,
            forged: core.forged + link.forged,
            old: core.old + link.old,
            measurement: core.measurement,
            ..link
        }
    }

    /// Own messages that were not sent so far.
    fn unsent(&self) -> u64 {
        self.link.unsent() + self.kept.unsent_healths
    }

    fn header(&self, now: LocalTime, sequence: u64) -> Header {
        Header { sender: self.own, incarnation: self.incarnation, sequence, stamp: now.into() }
    }

    /// Whether this agent's flight has ended. Without a simulator no vehicle has to be landed.
    fn is_over(&self) -> bool {
        let is_flying = self.timing.last_frame.is_some_and(|last| now() < last + SIMULATOR_GONE_AFTER);
        let activity = self.station.agent().activity();
        let is_down = activity == Activity::Landed;
        // A vehicle in a pilot's hands is the pilot's to land.
        let has_pilot = activity == Activity::Released;
        self.stop.is_urgent()
            || self.stop.is_requested() && (is_down || has_pilot || !is_flying)
            || self.stop.is_abandoned() && is_down
    }
}

/// Writes an event of the own vehicle to the log, at the level of its severity.
fn log(own: VehicleId, what: &EventKind) {
    match what.severity() {
        Severity::Info => tracing::info!("vehicle {own} {what}"),
        Severity::Warning => tracing::warn!("vehicle {own} {what}"),
        Severity::Error => tracing::error!("vehicle {own} {what}"),
    }
}
