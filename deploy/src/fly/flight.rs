//! One flight, from the first sign of life to the last process's end.
//!
//! ```text
//!   Gathering ---- all vehicles active -----> Flying ---- time or mission over, -----> Landing ---- all down ----> Ending
//!       |                                               Ctrl-C, an order to land         ^
//!       +------------------ Ctrl-C, or the time-out is over -----------------------------+
//! ```
//!
//! The window of the figures is the stage Flying; the scenario's events happen in it.
//!
//! An agent whose vehicle is in the air is killed only by the scenario or by a second Ctrl-C. A vehicle that is not
//! in contact, or does not land in time, may be one that this PC is too slow for: its agent is ordered to land, and left
//! to do so.

mod events;
mod figures;
mod news;
mod recorded;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use skein_common::frame::PositionNed;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Order, StandingOrders, Trace, Verb};
use skein_common::scenario::{Described, Scenario, Target};
use skein_common::state::{Activity, Membership};
use skein_common::topic::Branch;

use super::children::{Children, ProcessRole};
use super::ground::Ground;
use super::launch::launch;
use super::plan::Plan;
use super::script::{self, ScriptedAction};
use super::stream::{Happened, Line};
use crate::record::{Recorder, told};
use figures::summary;
use skein_cluster::display::journal::Journal;
use skein_cluster::display::status::{Ending, FlightStatus, Known, Stage};
use skein_cluster::endpoints::Endpoints;
use skein_cluster::landing;
use skein_cluster::mesh::observe::{Observer, SwarmMessage, VehicleView};
use skein_cluster::mesh::reach::Reach;
use skein_cluster::os;
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::faults::{OperatorOrder, Schedule};
use skein_lab::metrics::{AIRBORNE_ABOVE_M, Measured, Metrics, Report, Run, Totals, VehicleTraffic};
use skein_lab::out::Room;
use skein_lab::study;

/// The last known state of a vehicle silent for this long is out of date.
const SILENT: Duration = Duration::from_secs(1);
/// A vehicle that was asked to land and has no data of its own, or is silent, is waited for this long.
const HELPLESS: Duration = Duration::from_secs(10);
/// A flight whose others have finished is not prolonged for a vehicle that is silent for this long.
const GIVEN_UP: Duration = Duration::from_secs(60);
/// An agent that was ordered to end does so within this time; a vehicle without control tries to land within it.
const END: Duration = Duration::from_secs(15);
/// Size of the figures, bytes, and of those of each vehicle, with room to spare.
const FIGURES_BYTES: usize = 64 << 10;
const FIGURES_BYTES_EACH: usize = 1 << 10;
/// Above this height a vehicle has left the ground, m.
const LIFTED_M: f64 = 0.5;

/// The screen has room for no more events.
const MAX_EVENTS: usize = 200;

/// The flight of one swarm or team under way.
pub struct Flight {
    plan: Plan,
    /// The swarm gathers within this time, or does not fly.
    gather_within: Duration,
    /// Number of times that this process has been asked to end.
    asked: u32,
    children: Children,
    observer: Observer,
    ground: Ground,
    metrics: Metrics,
    /// Room for the figures, until they are written.
    room: Option<Room>,
    /// Absent if the scenario wants no recording.
    recorder: Option<Recorder>,
    /// The recording has failed, and the operator was informed.
    recording_failed: bool,
    stage: Stage,
    /// The time at which the stage began, and the number of requests to end that this process had received by then.
    since: Instant,
    asked_before: u32,
    /// The beginning of the window by both clocks; `None` before.
    zero: Option<Zero>,
    report: Option<Report>,
    /// The messages that each vehicle of a team had received when the figures ended.
    traffic: Vec<VehicleTraffic>,
    /// The scenario's actions that are still to come.
    schedule: Schedule<ScriptedAction>,
    /// Vehicles whose agents it has ended.
    killed: VehicleSet,
    /// The counts of agents that have ended.
    ended: Totals,
    /// The orders that are to be repeated, each with the time of its next repetition.
    orders: Vec<(Order, Instant)>,
    /// The orders that were given from here.
    given: StandingOrders,
    /// The events as people read them.
    pub(super) journal: Journal,
    lost: Vec<String>,
    /// Events that are not yet in the stream of `--json`, and in the recording of a fleet.
    pub(super) happened: Vec<Happened>,
    /// The reason why the flight failed, though it came to its end.
    failure: Option<String>,
    /// Its user has asked before the window was over.
    is_interrupted: bool,
    /// Its user has asked twice: everything ends at once.
    is_broken_off: bool,
}

/// The result of a flight that is over.
pub struct FlightResult {
    /// The plan that was flown.
    pub plan: Plan,
    /// The figures, if the clock of the flight has run.
    pub report: Option<Report>,
    /// The messages that each vehicle of a team received.
    pub traffic: Vec<VehicleTraffic>,
    /// Notes for its operator: lost vehicles, a recording that is not complete.
    pub notes: Vec<String>,
    /// Whether agents of vehicles in the air were left to land by themselves.
    pub leaves: bool,
    /// Whether its user ended it before its window was over, or before all vehicles were down.
    pub is_interrupted: bool,
    /// Whether any agent sent a message.
    pub has_answered: bool,
    all_are_lost: bool,
    failure: Option<String>,
}

impl FlightResult {
    /// The figures that a reader looks for first, and what to do next.
    pub fn summary(&self) -> Option<String> {
        self.report.as_ref().map(|report| summary(report, &self.plan))
    }

    /// Whether it was a flight.
    ///
    /// # Errors
    /// A flight that never began, lost all its vehicles, did not end on the ground, or had a vehicle out of control.
    pub fn verdict(&self) -> Result<(), String> {
        match (&self.failure, &self.report) {
            (Some(why), _) => Err(why.clone()),
            (None, None) => Err("stopped before all vehicles were active".to_owned()),
            (None, Some(_)) if self.all_are_lost => Err("every vehicle was lost".to_owned()),
            (None, Some(report)) => study::under_control(&Measured::of(report)),
        }
    }
}

/// The beginning of the window.
#[derive(Clone, Debug)]
struct Zero {
    at: Instant,
    /// On each simulator's clock, s.
    plant_s: BTreeMap<VehicleId, f64>,
}

impl Flight {
    /// Starts everything.
    ///
    /// # Errors
    /// If something cannot be started; then nothing is left running.
    pub fn begin(
        plan: Plan,
        described: &Described,
        endpoints: &Endpoints,
        gather_within: Duration,
    ) -> Result<Self, Error> {
        let scenario = plan.scenario();
        let children = launch(&plan, described, endpoints)?;
        let branch = Branch::of(scenario.team.map(|team| team.id));
        let observer = Observer::open(&Reach::here(endpoints, branch));
        let room = Room::keep(&plan.out, FIGURES_BYTES + FIGURES_BYTES_EACH * scenario.swarm.vehicles);
        let recorder = recorded::recorder(&plan)?;
        let now = clock::now();
        let mut flight = Self {
            gather_within,
            asked: 0,
            children,
            observer: observer?,
            ground: Ground::new(scenario),
            metrics: Metrics::new(scenario, Run::new(scenario, "fly")),
            room: Some(room),
            recorder,
            recording_failed: false,
            stage: Stage::Gathering,
            since: now,
            asked_before: 0,
            zero: None,
            report: None,
            traffic: Vec::new(),
            schedule: script::schedule(scenario),
            killed: VehicleSet::default(),
            ended: Totals::default(),
            orders: Vec::new(),
            given: StandingOrders::default(),
            journal: Journal::default(),
            lost: Vec::new(),
            happened: Vec::new(),
            failure: None,
            is_interrupted: false,
            is_broken_off: false,
            plan,
        };
        flight.observer.subscribe_to_traces(true)?;
        flight.show(now, format!("the swarm gathers, within {} s", gather_within.as_secs()));
        Ok(flight)
    }

    /// Takes in what has happened, and decides. True when the flight is over. `asked` is how often this process has been
    /// asked to end.
    pub fn advance(&mut self, now: Instant, asked: u32) -> bool {
        self.asked = asked;
        self.look(now);
        self.decide(now)
    }

    /// Ends the processes of a flight that is over, except those of vehicles in the air.
    pub fn end(mut self) -> FlightResult {
        let is_lost = |id| self.ending(id).is_some_and(|ending| ending != Ending::Asked);
        let all_are_lost = self.plan.scenario().ids().all(is_lost);
        let left = if self.is_broken_off { VehicleSet::default() } else { self.in_the_air() };
        self.children.leave(left);
        self.children.kill();
        let has_answered = !self.observer.vehicles().is_empty();
        let is_interrupted = self.is_interrupted || self.is_broken_off;
        let Self { report, traffic, mut lost, failure, plan, recorder, .. } = self;
        if !left.is_empty() {
            let swarm = &plan.scenario().swarm.name;
            lost.push(format!(
                "vehicle {left}: still in the air as far as is known; each agent lands and ends by itself (`skein order \
                 land --swarm {swarm}` asks again)"
            ));
        }
        let notes = recorder.and_then(|recorder| told(recorder.finish())).into_iter().chain(lost).collect();
        let leaves = !left.is_empty();
        FlightResult { plan, report, traffic, notes, leaves, is_interrupted, has_answered, all_are_lost, failure }
    }

    /// Takes in what has happened since the last time.
    fn look(&mut self, now: Instant) {
        for (received, at) in self.observer.poll_timed() {
            match received {
                SwarmMessage::Trace(trace) => {
                    self.record(|recorder| recorder.step(at, &trace));
                    self.take_step(now, &trace);
                }
                SwarmMessage::Event(event) => {
                    if self.stage == Stage::Flying {
                        self.metrics.observe_event(self.flown_s(now), event.header.sender, &event.what);
                    }
                    self.record(|recorder| recorder.happened(at, &event));
                    self.stream(at, Line::of_event(event.header.sender, event.what));
                    self.show_event(now, &event);
                }
                _ => {}
            }
        }
        for ended in self.children.reap() {
            self.take_leave(now, &ended);
        }
        let has_failed = self.recorder.as_ref().is_some_and(Recorder::has_failed);
        if has_failed && !std::mem::replace(&mut self.recording_failed, true) {
            self.show(now, "the recording cannot be written, the flight continues without".to_owned());
        }
    }

    /// One step of the stages' picture. True when the flight is over.
    fn decide(&mut self, now: Instant) -> bool {
        let asked = self.asked > self.asked_before;
        if self.stage == Stage::Flying {
            self.play(now);
        }
        self.repeat_orders(now);
        let agents = self.children.any(ProcessRole::Agent);
        match self.stage {
            Stage::Gathering if !agents => {
                self.fail(format!("every agent ended before the flight began; logs: {}", self.logs()));
                return true;
            }
            Stage::Gathering if asked => {
                self.is_interrupted = true;
                self.enter_landing(now);
            }
            Stage::Gathering if self.all_are_active() => {
                self.zero = Some(Zero { at: now, plant_s: self.plant_s(now).collect() });
                self.record(|recorder| recorder.window_begins(now));
                self.enter(Stage::Flying, now);
                self.stream(now, Line::Window);
                self.report_news(now, "all vehicles active, the clock runs".to_owned());
            }
            Stage::Gathering if now.duration_since(self.since) > self.gather_within => {
                self.fail(self.why_not_gathered());
                self.enter_landing(now);
            }
            Stage::Gathering => {}
            Stage::Flying => {
                self.measure(now);
                let is_over = self.is_over(now);
                if !agents && !self.awaits_a_restart() || asked || is_over {
                    self.is_interrupted = asked && !is_over;
                    self.end_window(now);
                    self.enter_landing(now);
                }
            }
            // The first request lets a landing that has begun by itself go to its end.
            Stage::Landing => return self.bring_down(now, asked && self.asked > 1),
            Stage::Ending if !agents => return true,
            Stage::Ending if asked || now.duration_since(self.since) > END => {
                self.is_broken_off = asked;
                let hanging: VehicleSet = self.live().map(|(id, _)| id).collect();
                self.fail(format!("vehicle {hanging}: the agent did not end within {} s", END.as_secs()));
                return true;
            }
            Stage::Ending | Stage::Watched => {}
        }
        false
    }

    /// Keeps the first failure, which is the one to report.
    fn fail(&mut self, why: String) {
        self.failure.get_or_insert(why);
    }

    /// Whether every vehicle that can be active is: an agent whose stand-in has ended never will be.
    fn all_are_active(&self) -> bool {
        let can = |id| self.children.how_ended(ProcessRole::Standin, id).is_none();
        let mut awaited = self.live().filter(|(id, _)| can(*id)).peekable();
        awaited.peek().is_some() && awaited.all(|(_, seen)| seen.is_some_and(VehicleView::is_active))
    }

    /// Whether the duration is over, an operator has ordered a landing, or all vehicles have only the landing left.
    fn is_over(&self, now: Instant) -> bool {
        let is_late = self.plan.scenario().duration_s.is_some_and(|duration_s| self.since_zero_s(now) >= duration_s);
        let orders = self.live().filter_map(|(_, seen)| seen?.orders.to_swarm());
        let is_down = |verb| matches!(verb, Verb::Land | Verb::Abort);
        is_late || orders.map(|order| order.verb).any(is_down) || self.has_finished(now)
    }

    /// Whether every vehicle is at the mission's landing by its last known step, or has left. A vehicle that is silent for
    /// a while does not count as finished: its agent or this process may get no time from this PC.
    fn has_finished(&self, now: Instant) -> bool {
        let steps = &self.plan.scenario().mission.steps;
        let landing = steps.iter().position(|step| matches!(step.target, Target::Land(_)));
        let mut known = self.live().filter_map(|(_, seen)| received_within(GIVEN_UP, seen?, now)).peekable();
        let has_finished = |step: &Trace| landing == Some(step.step as usize) || step.membership == Membership::Left;
        known.peek().is_some() && known.all(has_finished)
    }

    /// Vehicles whose agents run and which, as far as is known, have left the ground and have not landed.
    fn in_the_air(&self) -> VehicleSet {
        let is_flown = |step: &Trace| !matches!(step.activity, Activity::Landed | Activity::Released);
        let is_up = |step: &Trace| is_flown(step) && step.height_m > LIFTED_M;
        let up = self.live().filter(|(_, seen)| seen.and_then(|seen| seen.trace.as_ref()).is_some_and(is_up));
        up.map(|(id, _)| id).collect()
    }

    fn why_not_gathered(&self) -> String {
        let (all, within_s) = (self.plan.scenario().swarm.vehicles, self.gather_within.as_secs());
        let is_active = |(_, seen): &(VehicleId, Option<&VehicleView>)| seen.is_some_and(VehicleView::is_active);
        let ready = self.live().filter(is_active).count();
        let missing: Vec<String> =
            self.live().filter(|known| !is_active(known)).take(8).map(|(id, _)| id.to_string()).collect();
        let more = if all - ready > missing.len() { ", ..." } else { "" };
        let load = os::load().map(|load| format!("; this PC's load is {load:.0} on {} cores", os::cores()));
        format!(
            "only {ready} of {all} vehicles became active within {within_s} s (not vehicle {}{more}){}; more time: \
             --timeout S; logs: {}",
            missing.join(", "),
            load.unwrap_or_default(),
            self.logs()
        )
    }

    fn enter(&mut self, stage: Stage, now: Instant) {
        (self.stage, self.since, self.asked_before) = (stage, now, self.asked);
    }

    fn enter_landing(&mut self, now: Instant) {
        self.enter(Stage::Landing, now);
        self.end_events(now);
        self.order(now, OperatorOrder { verb: Verb::Land, vehicles: None });
        self.stream(now, Line::Landing);
        self.report_news(now, "all vehicles are ordered to land".to_owned());
        self.announce_landing(now);
    }

    /// Waits until every vehicle has landed, or cannot be landed. True when the flight is over.
    fn bring_down(&mut self, now: Instant, asked: bool) -> bool {
        let waited = now.duration_since(self.since);
        let flying = self.flying(now, waited);
        if flying.is_empty() {
            self.children.ask_agents_to_end();
            self.enter(Stage::Ending, now);
            return false;
        }
        if asked || waited > self.landing_limit() {
            self.is_broken_off = asked;
            let why = if asked { "ended by Ctrl-C" } else { "did not land in time" };
            self.fail(format!("vehicle {flying}: {why}"));
            return true;
        }
        false
    }

    /// Vehicles that have not landed yet, `waited` after the order to land.
    fn flying(&self, now: Instant, waited: Duration) -> VehicleSet {
        let flying = self.live().filter(|(_, seen)| seen.is_some_and(|seen| !is_down(seen, now, waited)));
        flying.map(|(id, _)| id).collect()
    }

    fn landing_limit(&self) -> Duration {
        let heights_m = self.observer.vehicles().values().filter_map(|seen| Some(seen.trace.as_ref()?.height_m));
        landing::limit(heights_m.fold(0.0, f64::max))
    }

    /// Vehicles whose agents run, with what is known of them.
    fn live(&self) -> impl Iterator<Item = (VehicleId, Option<&VehicleView>)> {
        let running =
            self.plan.scenario().ids().filter(|id| self.children.how_ended(ProcessRole::Agent, *id).is_none());
        running.map(|id| (id, self.observer.vehicles().get(&id)))
    }

    /// Into the window, never beyond its end, s.
    fn flown_s(&self, now: Instant) -> f64 {
        self.since_zero_s(now).min(self.plan.scenario().duration_s.unwrap_or(f64::INFINITY))
    }

    fn since_zero_s(&self, now: Instant) -> f64 {
        self.zero.as_ref().map_or(0.0, |zero| now.saturating_duration_since(zero.at).as_secs_f64())
    }

    fn logs(&self) -> String {
        self.plan.out.join("agents").display().to_string()
    }

    fn ending(&self, id: VehicleId) -> Option<Ending> {
        let status = self.children.how_ended(ProcessRole::Agent, id)?;
        Some(match status.success() {
            true => Ending::Asked,
            false if self.killed.contains(id) => Ending::Killed,
            false => Ending::Lost,
        })
    }

    /// The scenario in flight.
    pub fn scenario(&self) -> &Scenario {
        self.plan.scenario()
    }

    /// The vehicles in the air while the clock of the flight runs, as far as is known, with their newest positions.
    pub fn airborne(&self, now: Instant) -> impl Iterator<Item = (VehicleId, PositionNed)> {
        let flies = self.stage == Stage::Flying;
        let up = self.steps(now).filter(move |step| flies && step.height_m > AIRBORNE_ABOVE_M);
        up.map(|step| (step.header.sender, step.position))
    }

    /// The flight as people look at it.
    pub fn status(&self, now: Instant) -> FlightStatus {
        let scenario = self.plan.scenario();
        let known: Vec<Known> =
            scenario.ids().map(|id| Known::new(id, self.observer.vehicles().get(&id), self.ending(id), now)).collect();
        FlightStatus {
            stage: self.stage,
            flown_s: self.report.as_ref().map_or_else(|| self.flown_s(now), |report| report.duration_s),
            duration_s: scenario.duration_s,
            out: self.plan.out.display().to_string(),
            events: self.journal.newest(MAX_EVENTS),
            ..FlightStatus::new(scenario, &known)
        }
    }
}

/// The newest step, if it is new enough to be true.
fn fresh(seen: &VehicleView, now: Instant) -> Option<&Trace> {
    received_within(SILENT, seen, now)
}

/// The newest step, if it is younger than this.
fn received_within(age: Duration, seen: &VehicleView, now: Instant) -> Option<&Trace> {
    seen.trace.as_ref().filter(|_| seen.trace_at.is_some_and(|at| now.duration_since(at) < age))
}

/// Whether the vehicle has landed, never took off, is a pilot's to land, or is given up, without data or not in contact.
fn is_down(seen: &VehicleView, now: Instant, waited: Duration) -> bool {
    match fresh(seen, now).map(|trace| trace.activity) {
        Some(Activity::Landed | Activity::Released) => true,
        None if seen.trace.is_none() => true,
        Some(Activity::Blind) | None => waited > HELPLESS,
        Some(_) => false,
    }
}
