//! The command `skein record`: records a live swarm, or repairs or merges recordings.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::keys::Role;
use serde_json::{Value, json};
use skein_common::id::TeamId;
use skein_common::message::Severity;
use skein_common::scenario::{Loaded, Scenario, Source, load};
use skein_common::state::Membership;

use super::{FleetRecorder, Recorder};
use crate::observe::{Observer, SwarmMessage, TraceSubscription};
use crate::os::Interrupts;
use crate::reach::{Place, Reach, SwarmArgs};
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::metrics::Run;
use skein_lab::record::{self, RecordError, RecordingInfo, merge, repair};
use skein_lab::terminal::say;

/// Interval at which received messages are read.
const TICK: Duration = Duration::from_millis(20);
/// A vehicle whose newest step is older than this is at an unknown place.
const NEW: Duration = Duration::from_secs(1);
/// How long to wait for the first message of the swarm.
const LISTEN: Duration = Duration::from_secs(5);

/// `skein record`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein record --out mine.mcap\n  skein record -f cluster.toml --out cluster.mcap\n  skein record --repair mine.mcap"
)]
pub struct RecordArgs {
    /// The swarm to record.
    #[command(flatten)]
    pub swarm: SwarmArgs,
    /// The team of a fleet to record in full; without it the whole fleet is recorded as by a study: places at
    /// fleet.record_hz and events of all, and in full the teams with recorded = true, in the folder teams beside FILE
    #[arg(long, value_name = "N", conflicts_with_all = ["repair", "merge"])]
    pub team: Option<TeamId>,
    /// The file to be written; there must be none of that name
    #[arg(long, value_name = "FILE", required_unless_present = "repair")]
    pub out: Option<PathBuf>,
    /// Make a whole file of one that is cut off or damaged, beside it: run.mcap becomes run.repaired.mcap
    #[arg(long, value_name = "FILE", conflicts_with_all = ["swarm", "file", "out", "merge"])]
    pub repair: Option<PathBuf>,
    /// Join these into one, in the order of their times
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["swarm", "file"])]
    pub merge: Vec<PathBuf>,
    /// Print at the end what was written as one JSON object: the file and what is in it
    #[arg(long)]
    pub json: bool,
}

/// What a command has written: the object for programs, and the sentence for people.
struct Written {
    object: Value,
    text: String,
}

/// Records, repairs or merges.
///
/// # Errors
/// If a file cannot be read or written, or no vehicle of the swarm answers.
pub fn run(args: &RecordArgs) -> Result<(), Error> {
    let Written { object, text } = match (&args.repair, &args.out) {
        (Some(broken), _) => {
            let whole = broken.with_extension("repaired.mcap");
            refuse_existing(&whole)?;
            let repaired = repair(broken).map_err(|error| about_file(broken, std::slice::from_ref(broken), error))?;
            Written {
                object: json!({ "file": whole, "repaired": broken, "result": repaired.to_string() }),
                text: format!("{}: {repaired}", broken.display()),
            }
        }
        (None, Some(out)) if args.merge.is_empty() => record(&args.swarm, args.team, out)?,
        (None, Some(out)) => {
            refuse_existing(out)?;
            let messages = merge(&args.merge, out).map_err(|error| about_file(out, &args.merge, error))?;
            Written {
                object: json!({ "file": out, "merged": args.merge, "messages": messages }),
                text: format!("{}: {messages} messages of {} files", out.display(), args.merge.len()),
            }
        }
        (None, None) => return Err(Error::Refused("--out FILE is missing: the file to record into".to_owned())),
    };
    say(&if args.json { skein_lab::terminal::json(&object) } else { text + "\n" });
    Ok(())
}

fn refuse_existing(path: &Path) -> Result<(), Error> {
    match path.exists() {
        true => Err(Error::Refused(format!("{}: the file exists already; choose another name", path.display()))),
        false => Ok(()),
    }
}

/// The error of reading one of `sources` or of writing `path`, with the file's name and the right exit status.
fn about_file(path: &Path, sources: &[PathBuf], error: RecordError) -> Error {
    match error {
        // The text of this error names the file already.
        RecordError::Io { path: ref of, .. } if sources.contains(of) => Error::Refused(error.to_string()),
        RecordError::Io { .. } => Error::Failed(error.to_string()),
        RecordError::File { .. } => Error::Refused(error.to_string()),
        RecordError::Write(_) => Error::Failed(format!("{}: {error}", path.display())),
        _ => Error::Refused(format!("{}: {error}", path.display())),
    }
}

/// Records a live swarm until Ctrl-C, or until the file cannot be written. Recording does not affect the flight.
fn record(swarm: &SwarmArgs, team: Option<TeamId>, out: &Path) -> Result<Written, Error> {
    refuse_existing(out)?;
    let place = swarm.choose()?;
    let reach = match place.reach_teams(Role::Observer, team.as_slice())? {
        teams if teams.len() > 1 => return record_fleet(&place, &teams, out),
        mut one => one.remove(0),
    };
    let interrupts = Interrupts::listen().map_err(|error| Error::Failed(format!("signals: {error}")))?;
    let mut observer = Observer::open(&reach, TraceSubscription::On)?;
    let received = first_messages(&mut observer, &reach)?;
    let mut recorder = begin(&reach, out)?;
    eprintln!("recording {} into {}; Ctrl-C ends the recording", reach.title(), out.display());
    let mut window = Window::default();
    received.iter().for_each(|(received, at)| put(&mut recorder, received, *at));
    while interrupts.count() == 0 && !recorder.has_failed() {
        observer.poll_timed().iter().for_each(|(received, at)| put(&mut recorder, received, *at));
        if window.begins(&observer) {
            recorder.window_begins(clock::now());
        }
        clock::sleep(TICK);
    }
    let (steps, rejected) = (recorder.steps(), observer.dropped());
    let dropped = recorder.finish().map_err(|error| about_file(out, &[], error))?;
    let vehicles = observer.vehicles().values().filter(|view| view.trace.is_some()).count();
    let text = format!(
        "{}: {steps} steps of {vehicles} vehicles; dropped: {dropped}, not understood: {rejected}",
        out.display()
    );
    let object = json!({
        "file": out, "swarm": reach.swarm, "vehicles": vehicles, "steps": steps, "dropped": dropped, "not_understood": rejected,
    });
    Ok(Written { object, text })
}

/// A team of a live fleet that is recorded.
struct RecordedTeam<'a> {
    scenario: &'a Scenario,
    reach: &'a Reach,
    observer: Observer,
    /// The full recording of a chosen team.
    full: Option<Recorder>,
    window: Window,
}

/// Records a live fleet until Ctrl-C, or until the file cannot be written.
fn record_fleet(place: &Place, teams: &[Reach], out: &Path) -> Result<Written, Error> {
    let interrupts = Interrupts::listen().map_err(|error| Error::Failed(format!("signals: {error}")))?;
    let (name, described) = (place.swarm(), place.described()?);
    let team = |(reach, loaded)| RecordedTeam::begin(reach, loaded, out);
    let mut teams = teams.iter().zip(described.all()).map(team).collect::<Result<Vec<_>, _>>()?;
    let mut recorder = FleetRecorder::begin(out, &described)?;
    eprintln!("recording fleet {name} into {}; Ctrl-C ends the recording", out.display());
    while interrupts.count() == 0 && !recorder.has_failed() {
        let now = clock::now();
        if !recorder.has_begun() && teams.iter().all(|team| team.window.has_begun) {
            recorder.window_begins(now);
        }
        let is_due = recorder.is_due(now);
        teams.iter_mut().for_each(|team| team.record(&mut recorder, now, is_due));
        clock::sleep(TICK);
    }
    let samples = recorder.samples();
    let vehicles: usize = teams.iter().map(|team| team.observer.vehicles().len()).sum();
    let mut dropped = recorder.finish().map_err(|error| about_file(out, &[], error))?;
    for full in teams.into_iter().filter_map(|team| team.full) {
        dropped += full.finish().map_err(|error| about_file(out, &[], error))?;
    }
    let text = format!("{}: {vehicles} vehicles at {samples} times; dropped: {dropped}", out.display());
    let object = json!({ "file": out, "swarm": name, "vehicles": vehicles, "samples": samples, "dropped": dropped });
    Ok(Written { object, text })
}

impl<'a> RecordedTeam<'a> {
    /// Connects to a team, and begins its full recording beside `out` if the fleet's scenario chooses it.
    fn begin(reach: &'a Reach, loaded: &'a Loaded, out: &Path) -> Result<Self, Error> {
        let mut observer = Observer::open(reach, TraceSubscription::On)?;
        let received = first_messages(&mut observer, reach)?;
        let chosen = loaded.scenario.team.filter(|team| team.is_recorded);
        let full = chosen.map(|team| {
            let folder = out.with_file_name("teams").join(team.id.to_string());
            let failed = |error: std::io::Error| Error::Failed(format!("{}: {error}", folder.display()));
            std::fs::create_dir_all(&folder).map_err(failed)?;
            begin(reach, &folder.join(record::FILE))
        });
        let mut full = full.transpose()?;
        if let Some(full) = &mut full {
            received.iter().for_each(|(received, at)| put(full, received, *at));
        }
        Ok(Self { scenario: &loaded.scenario, reach, observer, full, window: Window::default() })
    }

    /// Records what has been received, and the places of the vehicles if they are due.
    fn record(&mut self, recorder: &mut FleetRecorder, now: Instant, is_due: bool) {
        for (received, at) in self.observer.poll_timed() {
            if let (SwarmMessage::Event(event), Some(team)) = (&received, self.reach.branch.team()) {
                recorder.event(at, team, event.header.sender, event.what);
            }
            self.full.iter_mut().for_each(|full| put(full, &received, at));
        }
        if self.window.begins(&self.observer) {
            self.full.iter_mut().for_each(|full| full.window_begins(now));
        }
        if is_due {
            let is_new = |at: Instant| now.saturating_duration_since(at) < NEW;
            let views =
                self.observer.vehicles().values().filter(|view| view.alive && view.trace_at.is_some_and(is_new));
            recorder.places(now, self.scenario, views.filter_map(|view| view.trace.as_ref()));
        }
    }
}

/// Waits for the first messages of the swarm.
fn first_messages(observer: &mut Observer, reach: &Reach) -> Result<Vec<(SwarmMessage, Instant)>, Error> {
    let until = clock::now() + LISTEN;
    loop {
        let received = observer.poll_timed();
        if !received.is_empty() {
            return Ok(received);
        }
        if clock::now() >= until {
            return Err(Error::Failed(format!("no vehicle of {} answered", reach.title())));
        }
        clock::sleep(TICK);
    }
}

fn begin(reach: &Reach, out: &Path) -> Result<Recorder, Error> {
    let (name, text) = reach.flown()?;
    let loaded = load(&Source { name: &name, text: &text }, &[])
        .map_err(|fault| Error::Scenario { fault: fault.into(), text: text.clone() })?;
    let scenario = &loaded.scenario;
    let about = RecordingInfo { scenario, scenario_toml: &text, run: &Run::new(scenario, "fly"), clock: "" };
    Recorder::begin(out, &about, scenario.record.hz.live_hz()).map_err(|error| about_file(out, &[], error))
}

fn put(recorder: &mut Recorder, received: &SwarmMessage, at: Instant) {
    match received {
        SwarmMessage::Trace(trace) => recorder.step(at, trace),
        SwarmMessage::Event(event) => recorder.happened(at, event),
        SwarmMessage::Appeared(id) => {
            recorder.note(at, Severity::Info, &format!("vehicle {id}"), "its agent has appeared")
        }
        SwarmMessage::Vanished(id) => {
            recorder.note(at, Severity::Error, &format!("vehicle {id}"), "its agent has disappeared")
        }
        SwarmMessage::Health(_) | SwarmMessage::Mission(_) | SwarmMessage::Summary(_) => {}
    }
}

/// Determines when the measurement window begins: when every vehicle in contact is an active member, as in `fly`. A
/// recording that starts later begins its window as soon as that can be observed.
#[derive(Debug, Default)]
struct Window {
    has_begun: bool,
}

impl Window {
    /// Returns true once, when the window begins.
    fn begins(&mut self, observer: &Observer) -> bool {
        let is_active = |view: &crate::observe::VehicleView| {
            view.trace.as_ref().is_some_and(|trace| trace.membership != Membership::Joining)
        };
        let mut alive = observer.vehicles().values().filter(|view| view.alive).peekable();
        let begins = !self.has_begun && alive.peek().is_some() && alive.all(is_active);
        self.has_begun |= begins;
        begins
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unreadable_source_is_refused_and_an_unwritable_file_is_a_failure() {
        let (source, out) = (PathBuf::from("a.mcap"), PathBuf::from("all.mcap"));
        let io = |path: &Path| RecordError::Io { path: path.to_owned(), error: std::io::ErrorKind::Other.into() };
        let full = || RecordError::Write(std::io::Error::from(std::io::ErrorKind::StorageFull).into());
        for (error, status) in [(io(&source), 2), (io(&out), 1), (full(), 1), (RecordError::NoMcap, 2)] {
            let error = about_file(&out, std::slice::from_ref(&source), error);
            assert_eq!(error.exit_code(), status, "{error}");
        }
    }
}
