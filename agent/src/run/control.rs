//! The control thread: frame in, step, controls out; everything else after that.

use std::sync::Arc;
use std::time::{Duration, Instant};

use skein_common::frame::Origin;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{Drops, Event, Header, Health, PeerHealth, Reason, Refused, Trace};
use skein_common::state::Activity;
use skein_common::time::{LocalTime, PlantTime};
use skein_common::topic::Cell;
use tokio::sync::mpsc;

use super::Stop;
use super::silence::Silence;
use super::timing::{Summary, Timing};
use crate::external::LiveLaw;
use crate::link::{Link, Messages};
use skein_core::agent::Outputs;
use skein_core::outbox::Outbox;
use skein_core::peers::Heard;
use skein_core::plant::{Frame, Plant, Wake};
use skein_core::station::Station;
use skein_host::clock::{LocalClock, now, sleep_until};

/// The plant's frame is given up for this step after so many of its periods.
const PATIENCE_PERIODS: f64 = 1.5;

/// A simulator that was there and sends no frame for so long does not come back. One on a PC that does not keep up pauses for
/// seconds, and its vehicle is still to be landed then.
const SIMULATOR_GONE_AFTER: Duration = Duration::from_secs(10);

/// What the control thread alone holds.
pub(super) struct Control {
    pub(super) station: Station,
    pub(super) plant: Box<dyn Plant>,
    pub(super) plant_name: &'static str,
    /// What runs here.
    pub(super) release: String,
    pub(super) link: Link,
    /// The law that is another program.
    pub(super) law: Option<LiveLaw>,
    pub(super) clock: LocalClock,
    pub(super) origin: Origin,
    pub(super) own: VehicleId,
    pub(super) incarnation: Incarnation,
    pub(super) stop: Arc<Stop>,
    /// Health goes to a thread that may wait.
    pub(super) health: mpsc::Sender<Health>,
}

/// What one loop leaves to the next.
struct Since {
    timing: Timing,
    silence: Silence,
    plant_time: PlantTime,
    arriving: Vec<Heard>,
    events: u64,
    healths: u64,
}

impl Control {
    /// Flies until it is over, and hands the link back to be closed.
    pub(super) fn run(mut self) -> Link {
        let period = Duration::from_secs_f64(self.plant.frame_period_s());
        let patience = period.mul_f64(PATIENCE_PERIODS);
        let mut since = Since {
            timing: Timing::new(period, now()),
            silence: Silence::new(),
            plant_time: PlantTime::ZERO,
            arriving: Vec::new(),
            events: 0,
            healths: 0,
        };
        let mut deadline = now() + patience;
        loop {
            let wake = self.plant.wait(deadline.saturating_duration_since(now()));
            if wake == Wake::Deadline {
                // A plant that comes back early must not make a real-time thread spin.
                sleep_until(deadline);
            }
            let woken = now();
            deadline = woken + patience;
            self.turn(&wake, woken, &mut since);
            if self.is_over(&since.timing) {
                break;
            }
        }
        self.plant.release();
        if let Some(tally) = self.station.delivery_counts() {
            tracing::info!("vehicle {} heard over the scenario's network: {tally:?}", self.own);
        }
        self.link
    }

    /// Once round the loop.
    fn turn(&mut self, wake: &Wake, woken: Instant, since: &mut Since) {
        let frame = match wake {
            Wake::Frame(frame) => Some(frame),
            Wake::Deadline => None,
        };
        since.plant_time = frame.map_or(since.plant_time, |frame| frame.time);
        let right = self.clock.at(woken);
        self.hear(right, since);
        let answer = self.law.as_ref().and_then(LiveLaw::answer);
        let plant = (since.plant_time, frame.map(|frame| &frame.measurement));
        let Outputs { command, outbox, ask } = self.station.step(right, plant, self.stop.is_asked(), answer.as_ref());
        if let Some(sticks) = command {
            self.plant.command(sticks);
        }
        let done = now();

        if let Some((law, ask)) = self.law.as_ref().zip(ask) {
            law.ask(ask);
        }

        let trace = frame.and_then(|frame| self.trace(right, frame, since));
        if frame.is_some() {
            since.timing.frame(woken, self.plant.skipped_frames());
            since.timing.step(woken, done);
        }
        let shown = self.station.clocks().local_time(right);
        self.send(shown, outbox, trace, since);
        if let Some(summary) = since.timing.summary(done) {
            since.healths += 1;
            let health = self.health(shown, right.seconds(), summary, since);
            // Whoever is behind with the last one does not need this one.
            let _ = self.health.try_send(health);
        }
    }

    /// Hands over what the link has brought.
    fn hear(&mut self, right: LocalTime, since: &mut Since) {
        self.link.drain(&mut since.arriving);
        if let Some(late_s) = since.silence.watch(right, &mut since.arriving) {
            self.station.did_not_run(late_s);
        }
        self.station.receive(right, since.arriving.drain(..));
    }

    /// Hands over what this step sends: another thread sends it.
    fn send(&mut self, now: LocalTime, outbox: Outbox, trace: Option<Trace>, since: &mut Since) {
        let state = outbox.state.map(|state| (state, Cell::of(self.origin.ned_from_geodetic(&state.state.position))));
        let event = |what| {
            since.events += 1;
            tracing::info!("vehicle {} {what}", self.own);
            Event { header: self.header(now, since.events), what }
        };
        let events: Vec<Event> = outbox.happened.into_iter().map(event).collect();
        if state.is_some() || outbox.mission.is_some() || !events.is_empty() || trace.is_some() {
            self.link.send(Messages { state, mission: outbox.mission, events, trace });
        }
    }

    /// If somebody listens to it. The timing in it is the previous step's.
    fn trace(&mut self, right: LocalTime, frame: &Frame, since: &Since) -> Option<Trace> {
        self.link.trace_is_wanted().then(|| {
            let mut trace = self.station.trace(right, frame.time, &frame.truth);
            trace.step_us = since.timing.last_step_us();
            trace.frame_overruns = since.timing.overruns();
            trace
        })
    }

    fn health(&self, now: LocalTime, uptime_s: f64, summary: Summary, since: &Since) -> Health {
        let agent = self.station.agent();
        let (state_messages, state_bytes) = agent.states_sent();
        let peer = |peer: &skein_core::peers::Seen| PeerHealth {
            id: peer.id,
            standing: peer.standing,
            age_s: peer.age_s,
            delay_s: peer.delay_s,
            clock: None,
        };
        let old = |(id, count)| Refused { reason: Reason::Old, key: format!("vehicle/{id}"), count };
        Health {
            header: self.header(now, since.healths),
            uptime_s,
            activity: agent.activity(),
            plant: self.plant_name.to_owned(),
            version: self.release.clone(),
            failures: agent.failures(),
            frame_rate_hz: summary.frame_rate_hz,
            jitter_ms: summary.jitter_ms,
            step_p50_us: summary.step_p50_us,
            step_p99_us: summary.step_p99_us,
            frame_overruns: since.timing.overruns(),
            drops: self.drops(),
            refused: agent.old_messages().map(old).take(Refused::MAX_COUNT).collect(),
            state_messages,
            state_bytes,
            peers: agent.peers().iter().map(peer).collect(),
        }
    }

    /// What the core, the link and the plant have dropped.
    fn drops(&self) -> Drops {
        let (core, link) = (self.station.agent().drops(), self.link.drops());
        Drops {
            plant_malformed: self.plant.malformed(),
            plant_foreign: self.plant.foreign(),
            undecodable: link.undecodable,
            other_version: link.other_version,
            forged: core.forged + link.forged,
            old: core.old + link.old,
            measurement: core.measurement,
            unsealed: link.unsealed,
            other_plan: link.other_plan,
            links: link.links,
        }
    }

    fn header(&self, now: LocalTime, sequence: u64) -> Header {
        Header { sender: self.own, incarnation: self.incarnation, sequence, stamp: now.into() }
    }

    /// Whether this agent's flight has ended. Without a simulator there is nothing to land.
    fn is_over(&self, timing: &Timing) -> bool {
        let is_flying = timing.last_frame().is_some_and(|last| now() < last + SIMULATOR_GONE_AFTER);
        let is_down = self.station.agent().activity() == Activity::Landed;
        self.stop.is_urgent() || self.stop.is_asked() && (is_down || !is_flying) || self.stop.is_forsaken() && is_down
    }
}
