//! Plays a recording to a page: snapshots of any time of it, at any speed. Each page plays for itself.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use skein_common::id::VehicleId;
use skein_common::message::EventKind;
use skein_common::scenario::RecordRate;
use skein_host::clock;
use skein_lab::record::{FILE, FLEET_FILE, PlayedEvent, Player, RecordError};
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::events::{Event, EventMessage};
use super::field;
use super::hello;
use super::live::{Problem, problem_message};
use super::orders;
use super::snapshot::{Snapshot, Status, Team, Vehicle, add_nearest, team_place, vehicles};
use super::socket::{Ask, Wishes, next, send};
use super::verdict::{self, Judged};
use skein_cluster::display::status::Known;

/// Time between two snapshots.
const PERIOD: Duration = Duration::from_millis(100);
/// Fastest play, seconds of the recording in a second.
const FASTEST: f64 = 64.0;

/// The recording in a folder: of a swarm or of a fleet.
pub(super) fn in_folder(folder: &Path) -> Option<PathBuf> {
    [FLEET_FILE, FILE].into_iter().map(|name| folder.join(name)).find(|path| path.is_file())
}

/// Plays a recording to a page until that ends or is too slow: then `None`.
pub(super) async fn serve(mut socket: WebSocket, path: PathBuf) -> Option<()> {
    let opened = blocking(move || Recording::open(&path)).await;
    let mut recording = match opened {
        Ok(recording) => recording,
        Err(error) => {
            let remedy = "give `skein view` another file; this page tries again when it is loaded again";
            send(&mut socket, problem(&error, remedy)).await;
            // The page would connect again at once.
            while socket.recv().await.is_some_and(|message| message.is_ok()) {}
            return None;
        }
    };
    let past = EventMessage::Events { events: recording.events.iter().map(Event::from).collect() }.to_json();
    for message in [recording.hello.clone(), past] {
        send(&mut socket, Message::text(message)).await?;
    }
    let mut page = PlayingPage { wishes: Wishes::default(), position: None, is_due: false };
    let mut ticks = interval(PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = ticks.tick() => {
                let Some(at_s) = page.due(recording.span_s) else { continue };
                let (shown, messages) = show(recording, page.wishes, at_s).await;
                (recording, page.wishes) = shown;
                for message in messages {
                    send(&mut socket, message).await?;
                }
            }
            ask = next(&mut socket) => match ask? {
                Ask::Order(_) => {
                    let answer = orders::answer("a recording takes no orders", false);
                    send(&mut socket, Message::text(answer)).await?;
                }
                ask => page.take(ask, recording.span_s),
            },
        }
    }
}

/// The message about a recording that cannot be shown.
fn problem(error: &RecordError, remedy: &str) -> Message {
    let problem = Problem { text: error.to_string(), remedy: remedy.to_owned() };
    Message::text(problem_message(Some(&problem)))
}

/// Reads the recording on a thread that may wait for the disk.
async fn show(mut recording: Recording, mut wishes: Wishes, at_s: f64) -> ((Recording, Wishes), Vec<Message>) {
    blocking(move || {
        let messages = recording.messages(at_s, &mut wishes);
        ((recording, wishes), messages)
    })
    .await
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        Err(panicked) => std::panic::resume_unwind(panicked.into_panic()),
    }
}

/// The playback of one page.
struct PlayingPage {
    wishes: Wishes,
    /// The place of the playback: from this time on, since this instant, at this speed; `None` before its first request.
    position: Option<(f64, Instant, f64)>,
    /// Whether a page that shows one instant is to receive it again.
    is_due: bool,
}

impl PlayingPage {
    /// Takes in a request of the page.
    fn take(&mut self, ask: Ask, span_s: (f64, f64)) {
        match ask {
            Ask::Play { at_s, speed } if at_s.is_finite() && speed.is_finite() => {
                let at_s = at_s.clamp(span_s.0, span_s.1);
                self.position = Some((at_s, Instant::now(), speed.clamp(0.0, FASTEST)));
            }
            ask => self.wishes.take(ask),
        }
        self.is_due = true;
    }

    /// The time of the recording to show now; `None` if the page has it already.
    fn due(&mut self, span_s: (f64, f64)) -> Option<f64> {
        let (from_s, since, speed) = self.position?;
        let at_s = from_s + since.elapsed().as_secs_f64() * speed;
        let is_due = std::mem::replace(&mut self.is_due, speed > 0.0);
        if at_s >= span_s.1 {
            // It stays at the end.
            self.position = Some((span_s.1, Instant::now(), 0.0));
        }
        is_due.then(|| at_s.clamp(span_s.0, span_s.1))
    }
}

/// A recording that is played to a page.
struct Recording {
    player: Player,
    teams: Vec<Team>,
    events: Vec<PlayedEvent>,
    hello: String,
    /// First and last time, s.
    span_s: (f64, f64),
    /// A vehicle makes a step at least this often.
    period: Duration,
}

impl Recording {
    fn open(path: &Path) -> Result<Self, RecordError> {
        let mut player = Player::open(path)?;
        let teams: Vec<Team> = player.described().all().iter().map(|loaded| Team::new(&loaded.scenario)).collect();
        let span_s = player.span_s();
        let title = path.display().to_string();
        let hello = hello::hello(&teams, &title, Some(span_s), None);
        let events = player.events()?;
        let slowest_hz = match teams.first().map(|team| team.scenario.record.hz) {
            Some(RecordRate::Hz(hz)) => hz,
            _ => 10.0,
        };
        Ok(Self { player, teams, events, hello, span_s, period: Duration::from_secs_f64(1.0 / slowest_hz) })
    }

    /// The messages that show this time.
    fn messages(&mut self, at_s: f64, wishes: &mut Wishes) -> Vec<Message> {
        let shown = if self.player.is_fleet() { self.places(at_s) } else { self.traces(at_s) };
        let (snapshot, observed) = match shown {
            Ok(shown) => shown,
            Err(error) => return vec![problem(&error, "`skein record --repair`")],
        };
        let detail = wishes.detail.clone();
        let field = wishes.field(|of| {
            let id = observed.iter().map(|vehicle| vehicle.id).find(|id| id.to_string() == of);
            field::field(self.teams.first()?, &observed, id?)
        });
        let json = Message::text(snapshot.to_json(&detail, field));
        snapshot.places().map(|places| Message::Binary(places.into())).into_iter().chain([json]).collect()
    }

    /// A swarm at this time, from its traces.
    fn traces(&mut self, at_s: f64) -> Result<(Snapshot, Vec<Known>), RecordError> {
        let Some(team) = self.teams.first() else { return Ok((empty(at_s), Vec::new())) };
        let failures = failures(&self.events, at_s);
        let period = self.period;
        let traces = self.player.traces(at_s)?;
        let observed = |id: VehicleId| {
            let newest = traces.get(&id).map(|(t_s, trace)| {
                let mut sample = trace.facts(None);
                sample.failures = failures.get(&id).cloned().unwrap_or_default();
                (sample, Duration::from_secs_f64((at_s - t_s).max(0.0)).saturating_sub(period))
            });
            Known { id, newest, is_healthy: false, ended: None, order: None }
        };
        let observed: Vec<_> = team.scenario.ids().map(observed).collect();
        let (rows, mut all) = vehicles(team, &observed);
        add_nearest(&mut all);
        let status = verdict::status(&[Judged { team, observed: &observed, rows: &rows, vehicles: &all }]);
        Ok((Snapshot { status, vehicles: all, ..empty(at_s) }, observed))
    }

    /// A fleet at this time, from the places of its vehicles.
    fn places(&mut self, at_s: f64) -> Result<(Snapshot, Vec<Known>), RecordError> {
        let places = self.player.places(at_s)?;
        let (mut all, mut teams, mut there) = (Vec::new(), Vec::new(), 0);
        for team in &self.teams {
            let played = team.id().and_then(|id| places.get(&id));
            let own: Vec<Vehicle> = team
                .scenario
                .ids()
                .map(|id| {
                    let place = played.and_then(|played| played.iter().find(|played| played.place.id == id));
                    Vehicle::of_place(team.name(id), place)
                })
                .collect();
            there += played.map_or(0, Vec::len);
            teams.extend(team_place(team, &own));
            all.extend(own);
        }
        add_nearest(&mut all);
        let text = format!("{there} of {} vehicles in {} teams", all.len(), self.teams.len());
        Ok((Snapshot { status: Status::plain(text), vehicles: all, teams, ..empty(at_s) }, Vec::new()))
    }
}

fn empty(at_s: f64) -> Snapshot {
    let at_ms = clock::utc_nanoseconds() / 1_000_000;
    Snapshot { t_s: Some(at_s), at_ms, status: Status::plain(String::new()), vehicles: Vec::new(), teams: Vec::new() }
}

/// The failures that vehicles had reported of themselves by this time.
fn failures(events: &[PlayedEvent], at_s: f64) -> BTreeMap<VehicleId, Vec<skein_common::message::Failure>> {
    let mut failures: BTreeMap<VehicleId, Vec<_>> = BTreeMap::new();
    for event in events.iter().take_while(|event| event.t_s <= at_s) {
        if let (Some(EventKind::Failed(failure)), Some(name)) = (event.what, event.vehicle) {
            failures.entry(name.vehicle).or_default().push(failure);
        }
    }
    failures
}
