//! Watches a live swarm for the page, on a thread of its own, and never gives up: a swarm that does not answer yet, or has ended,
//! is looked for again and again.
//!
//! The vehicles compute and send their summaries only while a page is open. Events are kept from the start of the server on.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use serde_json::json;
use skein_common::id::VehicleId;
use skein_common::message::Severity;
use skein_common::scenario::Described;
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::terminal::complain;
use tokio::sync::watch;

use super::events::EventLog;
use super::field::{self, Field};
use super::foxglove;
use super::hello;
use super::snapshot::{Snapshot, Team, add_nearest, team_place, vehicles};
use super::verdict::{self, Judged};
use skein_cluster::display::status::Known;
use skein_cluster::endpoints;
use skein_cluster::keys::Role;
use skein_cluster::mesh::observe::{Observer, Observers, SwarmMessage};
use skein_cluster::mesh::reach::{Place, Reach, SwarmArgs};

/// Time between two snapshots.
const PERIOD: Duration = Duration::from_millis(100);
/// Time between two attempts to find the swarm, and between two looks at whether it is still the same.
const RETRY: Duration = Duration::from_secs(1);
/// A swarm of which no agent has answered for this long is reported.
const SILENT_AFTER: Duration = Duration::from_secs(3);
/// The vehicles' summaries may take this long after a page has opened: only then a vehicle without one is shown without.
const SUMMARIES_WITHIN: Duration = Duration::from_secs(2);

/// The reason why nothing can be shown, and its remedy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Problem {
    pub(super) text: String,
    pub(super) remedy: String,
}

/// The message about a problem, or about its end.
pub(super) fn problem_message(problem: Option<&Problem>) -> String {
    match problem {
        Some(Problem { text, remedy }) => json!({ "type": "problem", "text": text, "remedy": remedy }).to_string(),
        None => json!({ "type": "problem", "text": null }).to_string(),
    }
}

/// Everything that there is to show.
#[derive(Default)]
pub(super) struct Frame {
    /// The first message to a page, and its number: another swarm has another one.
    pub(super) hello: Option<(Utf8Bytes, u64)>,
    pub(super) problem: Option<Problem>,
    pub(super) events: Arc<EventLog>,
    /// The time at which the flight began, if that is known.
    pub(super) zero: Option<Instant>,
    pub(super) snapshot: Option<Snapshot>,
    /// The message with the whole snapshot, made once for all pages.
    pub(super) json: Option<Utf8Bytes>,
    /// The places of a large swarm.
    pub(super) places: Option<Bytes>,
    /// The swarm that is shown, and that an order of the page is to.
    pub(super) place: Option<Arc<Place>>,
    /// The sources of the snapshot, for the fields.
    swarm: Option<Arc<Vec<Team>>>,
    observed: Vec<Vec<Known>>,
}

impl Frame {
    /// The field of the vehicle with this name.
    pub(super) fn field(&self, name: &str) -> Option<Field> {
        let mut teams = self.swarm.iter().flat_map(|teams| teams.iter()).zip(&self.observed);
        let (team, observed, id) = teams.find_map(|(team, observed)| {
            let id = observed.iter().map(|vehicle| vehicle.id).find(|id| team.name(*id).to_string() == name);
            Some((team, observed, id?))
        })?;
        field::field(team, observed, id)
    }

    /// The swarm, or the teams of the fleet, with what was observed of each.
    pub(super) fn observed(&self) -> Option<(&[Team], &[Vec<Known>])> {
        Some((self.swarm.as_ref()?.as_slice(), self.observed.as_slice()))
    }
}

/// Watches a swarm for pages and for Foxglove.
pub(super) struct Watcher {
    /// Chooses the swarm.
    swarm: SwarmArgs,
    /// Whether orders of the pages need a token; `None` if they may give none.
    needs_token: Option<bool>,
    events: Arc<EventLog>,
    /// Number of the swarms that were found.
    number: u64,
    watched: Option<Watched>,
    problem: Option<Problem>,
    next_try: Instant,
    foxglove: Option<foxglove::Live>,
    /// The log of problems on stderr, if there is to be one.
    report: Option<ProblemLog>,
}

/// The problems of which the operator at the terminal knows.
#[derive(Debug, Default)]
struct ProblemLog {
    /// The present problem, and since when.
    present: Option<(Problem, Instant)>,
    /// The problem was written.
    is_written: bool,
}

impl ProblemLog {
    /// Takes in the present problem. Returns what is to be written: a problem that lasts, and its end.
    fn take(&mut self, problem: Option<&Problem>, now: Instant) -> Option<String> {
        let Some(problem) = problem else {
            self.present = None;
            return std::mem::take(&mut self.is_written).then(|| "the swarm answers".to_owned());
        };
        match &self.present {
            Some((present, since)) if present == problem => {
                let is_due = !self.is_written && now.saturating_duration_since(*since) >= SILENT_AFTER;
                self.is_written |= is_due;
                is_due.then(|| format!("{}; {}", problem.text, problem.remedy))
            }
            _ => {
                (self.present, self.is_written) = (Some((problem.clone(), now)), false);
                None
            }
        }
    }
}

/// A swarm that was found.
struct Watched {
    place: Arc<Place>,
    reaches: Vec<Reach>,
    observers: Observers,
    teams: Arc<Vec<Team>>,
    hello: Utf8Bytes,
    /// The time at which an agent was last in contact, or the swarm was found.
    answered: Instant,
    zero: Option<Instant>,
    /// Since when pages want pictures, if they do.
    wanted: Option<Instant>,
    /// Since then enough has arrived for the first picture.
    is_complete: bool,
    /// Other swarms of this PC, looked for while no agent of this one answers.
    others: Option<String>,
}

impl Watcher {
    /// Nothing is watched yet. If `is_reported`, the reason why the pages are empty is written to stderr too.
    pub(super) fn new(
        swarm: SwarmArgs,
        needs_token: Option<bool>,
        foxglove: Option<foxglove::Live>,
        is_reported: bool,
    ) -> Self {
        let (events, next_try) = (Arc::default(), clock::now());
        let report = is_reported.then(ProblemLog::default);
        Self { swarm, needs_token, events, number: 0, watched: None, problem: None, next_try, foxglove, report }
    }

    /// Watches for what receives the `frames`, until the process ends.
    pub(super) fn watch(mut self, frames: &watch::Sender<Arc<Frame>>) {
        let mut next = clock::now();
        loop {
            let now = clock::now();
            self.look(now);
            frames.send_replace(Arc::new(self.frame(now, frames.receiver_count() > 0)));
            next = (next + PERIOD).max(now);
            clock::sleep(next.saturating_duration_since(clock::now()));
        }
    }

    /// Finds the swarm, or takes in what it has sent.
    fn look(&mut self, now: Instant) {
        if now >= self.next_try {
            self.next_try = now + RETRY;
            let is_other = self.watched.as_ref().is_none_or(|watched| watched.place.is_replaced());
            if is_other {
                self.find(now);
            }
            if let (Some(watched), Some(_)) = (&mut self.watched, &self.problem)
                && let Place::Here(there) = &*watched.place
            {
                // The operator may have meant another swarm of this PC.
                watched.others = endpoints::others(&endpoints::folder(), &there.swarm);
            }
        }
        self.take(now);
        let news = self.report.as_mut().and_then(|report| report.take(self.problem.as_ref(), now));
        news.iter().for_each(|line| complain(line));
        if let Some(foxglove) = &mut self.foxglove {
            foxglove.look(now, self.problem.as_ref().map(|Problem { text, remedy }| format!("{text}: {remedy}")));
        }
    }

    fn take(&mut self, now: Instant) {
        let Some(watched) = &mut self.watched else { return };
        watched.take(&self.events, self.foxglove.as_mut());
        let is_alive = watched.observers.views().any(|(_, view)| view.alive);
        if is_alive {
            watched.answered = now;
        }
        let is_silent = now.saturating_duration_since(watched.answered) >= SILENT_AFTER;
        self.problem = is_silent.then(|| watched.silence());
    }

    fn find(&mut self, now: Instant) {
        match Watched::open(&self.swarm, self.needs_token, now) {
            Ok((watched, described)) => {
                if let Some(foxglove) = &mut self.foxglove {
                    foxglove.found(&described);
                }
                // From now on this swarm is meant, even if another one begins to fly here.
                if let Place::Here(there) = &*watched.place {
                    self.swarm.swarm = Some(there.swarm.clone());
                }
                self.number += 1;
                (self.watched, self.problem) = (Some(watched), None);
            }
            // What was found before stays on the page.
            Err(_) if self.watched.is_some() => {}
            Err(error) => {
                let remedy =
                    "start a swarm with `skein fly`, or name a cluster with -f CLUSTER.toml; this page keeps looking";
                self.problem = Some(Problem { text: error.to_string(), remedy: remedy.to_owned() });
            }
        }
    }

    /// Makes the frame of this moment; a snapshot only for a page.
    fn frame(&mut self, now: Instant, is_wanted: bool) -> Frame {
        let (events, problem) = (Arc::clone(&self.events), self.problem.clone());
        let frame = Frame { events, problem, ..Frame::default() };
        let Some(watched) = &mut self.watched else { return frame };
        watched.wanted = watched.wanted.filter(|_| is_wanted).or(is_wanted.then_some(now));
        for observer in watched.observers.each() {
            if let Err(error) = observer.subscribe_to_summaries(is_wanted) {
                tracing::warn!("cannot subscribe to the summaries: {error}");
            }
        }
        let shown = watched.has_summaries(now).then(|| watched.snapshot(now));
        let hello = Some((watched.hello.clone(), self.number));
        let frame = Frame { hello, zero: watched.zero, place: Some(Arc::clone(&watched.place)), ..frame };
        let Some((snapshot, observed)) = shown else { return frame };
        let json = Some(snapshot.to_json(&BTreeSet::new(), None::<&Field>).into());
        let (places, swarm) = (snapshot.places().map(Bytes::from), Some(Arc::clone(&watched.teams)));
        Frame { json, places, snapshot: Some(snapshot), swarm, observed, ..frame }
    }
}

impl Watched {
    fn open(swarm: &SwarmArgs, needs_token: Option<bool>, now: Instant) -> Result<(Self, Described), Error> {
        let place = Arc::new(swarm.choose()?);
        let reaches = place.reach_teams(Role::Observer, &[])?;
        let described = place.described()?;
        let teams: Vec<Team> = described.all().iter().map(|loaded| Team::new(&loaded.scenario)).collect();
        let observers = Observers::open(&reaches)?;
        let hello = hello::hello(&teams, place.swarm().as_str(), None, needs_token).into();
        let (teams, zero, wanted) = (Arc::new(teams), None, None);
        let (answered, is_complete, others) = (now, false, None);
        let watched = Self { place, reaches, observers, teams, hello, answered, zero, wanted, is_complete, others };
        Ok((watched, described))
    }

    /// Whether every vehicle in contact has sent its summary since pages want pictures, or had the time to: a vehicle that was not
    /// asked before is not silent.
    fn has_summaries(&mut self, now: Instant) -> bool {
        let Some(wanted) = self.wanted else {
            self.is_complete = false;
            return false;
        };
        let mut there = self.observers.views().filter(|(_, view)| view.alive).peekable();
        let have_all = there.peek().is_some() && there.all(|(_, view)| view.newest().is_some());
        self.is_complete |= have_all || now.saturating_duration_since(wanted) >= SUMMARIES_WITHIN;
        self.is_complete
    }

    /// Takes in what the vehicles have sent, and keeps what happened to them.
    fn take(&mut self, log: &EventLog, mut foxglove: Option<&mut foxglove::Live>) {
        for observer in self.observers.each() {
            let branch = observer.branch();
            let name = |id: VehicleId| branch.name(id);
            if let Err(error) = observer.subscribe_to_traces(foxglove.as_ref().is_some_and(|live| live.is_read())) {
                tracing::warn!("cannot subscribe to the traces: {error}");
            }
            for (received, at) in observer.poll_timed() {
                if let Some(foxglove) = &mut foxglove {
                    foxglove.take(&received, at);
                }
                match received {
                    SwarmMessage::Event(event) => {
                        log.add(at, name(event.header.sender), event.what.to_string(), event.what.severity());
                    }
                    SwarmMessage::Appeared(id) => {
                        log.add(at, name(id), "appeared".to_owned(), Severity::Info);
                    }
                    SwarmMessage::Vanished(id) => {
                        log.add(at, name(id), "disappeared".to_owned(), Severity::Error);
                    }
                    SwarmMessage::Trace(_)
                    | SwarmMessage::Summary(_)
                    | SwarmMessage::Health(_)
                    | SwarmMessage::Mission(_) => {}
                }
            }
        }
    }

    /// The reason why no agent answers, and its remedy.
    fn silence(&self) -> Problem {
        let title = match self.reaches.as_slice() {
            [only] => only.title(),
            _ => format!("fleet {}", self.place.swarm()),
        };
        let refused: u64 = self.observers.all().iter().map(Observer::refused_links).sum();
        if refused > 0 {
            let text = format!("the agents of {title} refuse the certificate of this PC, or this PC refuses theirs");
            return Problem { text, remedy: "copy the cluster's keys of the role observer to this PC".to_owned() };
        }
        let first = self.reaches.iter().find_map(|reach| reach.agents.values().next());
        let at = first.map_or_else(String::new, |first| format!(" at {first} and its other addresses"));
        let remedy = match &*self.place {
            Place::Here(there) => {
                let others = self.others.as_ref().map_or_else(String::new, |others| format!("; {others}"));
                format!("start it with `skein fly`, or see what became of it in {}{others}", there.out.display())
            }
            Place::Cluster(_) => "`skein cluster status` shows which nodes run".to_owned(),
        };
        Problem { text: format!("no agent of {title} answers{at}"), remedy }
    }

    /// The swarm now, and what that was made of.
    fn snapshot(&mut self, now: Instant) -> (Snapshot, Vec<Vec<Known>>) {
        let observed: Vec<Vec<Known>> =
            self.teams.iter().zip(self.observers.all()).map(|(team, observer)| observe(team, observer, now)).collect();
        let shown: Vec<_> = self.teams.iter().zip(&observed).map(|(team, observed)| vehicles(team, observed)).collect();
        let mut all: Vec<_> = shown.iter().flat_map(|(_, vehicles)| vehicles.iter().cloned()).collect();
        add_nearest(&mut all);
        // The nearest vehicle may be of another team: the list of all is divided again only afterwards.
        let mut rest = all.as_slice();
        let mut judged = Vec::new();
        for ((team, observed), (rows, own)) in self.teams.iter().zip(&observed).zip(&shown) {
            let (vehicles, behind) = rest.split_at(own.len());
            rest = behind;
            judged.push(Judged { team, observed, rows, vehicles });
        }
        let status = verdict::status(&judged);
        let teams = judged.iter().filter_map(|judged| team_place(judged.team, judged.vehicles)).collect();
        if let Some(flown_s) = flown_s(&observed) {
            let zero = now.checked_sub(Duration::from_secs_f64(flown_s));
            // Between two steps of an agent its time of flight stands still: the beginning that was found first is kept.
            let is_other = |known: Instant| zero.is_some_and(|zero| zero.max(known) - zero.min(known) > RETRY);
            self.zero = self.zero.filter(|known| !is_other(*known)).or(zero);
        }
        let t_s = self.zero.map(|zero| now.saturating_duration_since(zero).as_secs_f64());
        (Snapshot { t_s, at_ms: clock::utc_nanoseconds() / 1_000_000, status, vehicles: all, teams }, observed)
    }
}

/// The newest data of each vehicle of a team.
fn observe(team: &Team, observer: &Observer, now: Instant) -> Vec<Known> {
    team.scenario.ids().map(|id| Known::new(id, observer.vehicles().get(&id), None, now)).collect()
}

/// Time of flight by the vehicles' own clocks, s: the median, which a restarted vehicle does not change.
fn flown_s(observed: &[Vec<Known>]) -> Option<f64> {
    let flown = |vehicle: &Known| {
        let (sample, silent) = vehicle.newest.as_ref()?;
        Some(sample.flown_s? + silent.as_secs_f64())
    };
    let mut all: Vec<f64> = observed.iter().flatten().filter_map(flown).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_problem_that_lasts_is_reported_once_and_its_end_too() {
        let mut report = ProblemLog::default();
        let zero = clock::now();
        let at = |s: u64| zero + Duration::from_secs(s);
        let problem = |text: &str| Some(Problem { text: text.to_owned(), remedy: "start it".to_owned() });
        let mut take = |problem: Option<Problem>, s: u64| report.take(problem.as_ref(), at(s));
        assert_eq!(take(None, 0), None);
        assert_eq!(take(problem("no swarm"), 1), None);
        assert_eq!(take(problem("no swarm"), 3), None, "it may be about to begin");
        assert_eq!(take(problem("no swarm"), 4).as_deref(), Some("no swarm; start it"));
        assert_eq!(take(problem("no swarm"), 60), None, "once");
        assert_eq!(take(problem("no agent"), 61), None);
        assert_eq!(take(problem("no agent"), 64).as_deref(), Some("no agent; start it"));
        assert_eq!(take(None, 65).as_deref(), Some("the swarm answers"));
        assert_eq!(take(None, 66), None);
        assert_eq!(take(problem("no agent"), 67), None);
        assert_eq!(take(None, 68), None, "a problem that was not reported ends unreported");
    }
}
