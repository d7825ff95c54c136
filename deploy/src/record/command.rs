//! The command `skein record`: records a live swarm, or repairs or merges recordings.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use skein_cluster::keys::Role;
use skein_common::id::TeamId;
use skein_common::scenario::{Described, Scenario, Source, load};

use super::{FleetRecorder, Recorder};
use skein_cluster::mesh::observe::{Observer, SwarmMessage, VehicleView};
use skein_cluster::mesh::reach::{Reach, SwarmArgs};
use skein_cluster::os::Interrupts;
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::metrics::Run;
use skein_lab::record::{self, RecordError, RecordingInfo, merge, repair};
use skein_lab::terminal::say;

/// Interval at which received messages are read.
const TICK: Duration = Duration::from_millis(20);
/// A vehicle whose newest step is older than this is at an unknown place.
const NEW: Duration = Duration::from_secs(1);
/// Time to wait for the first message of the swarm.
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

/// Records, repairs or merges.
///
/// # Errors
/// If a file cannot be read or written, or no vehicle of the swarm answers.
pub fn run(args: &RecordArgs) -> Result<(), Error> {
    // The object for programs, and the sentence for people.
    let (object, text) = match (&args.repair, &args.out) {
        (Some(broken), _) => {
            let whole = broken.with_extension("repaired.mcap");
            refuse_existing(&whole)?;
            let repaired = repair(broken).map_err(|error| about_file(broken, std::slice::from_ref(broken), error))?;
            let object = json!({ "file": whole, "repaired": broken, "result": repaired.to_string() });
            (object, format!("{}: {repaired}", broken.display()))
        }
        (None, Some(out)) if args.merge.is_empty() => record(&args.swarm, args.team, out)?,
        (None, Some(out)) => {
            refuse_existing(out)?;
            let messages = merge(&args.merge, out).map_err(|error| about_file(out, &args.merge, error))?;
            let object = json!({ "file": out, "merged": args.merge, "messages": messages });
            (object, format!("{}: {messages} messages of {} files", out.display(), args.merge.len()))
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

/// Records until Ctrl-C: a swarm or one team in full, or a fleet with its chosen teams beside it. Returns what was recorded,
/// as an object and as a sentence.
fn record(swarm: &SwarmArgs, team: Option<TeamId>, out: &Path) -> Result<(Value, String), Error> {
    refuse_existing(out)?;
    let place = swarm.choose()?;
    let reaches = place.reach_teams(Role::Observer, team.as_slice())?;
    let interrupts = Interrupts::listen()?;
    let described = if reaches.len() > 1 { Some(place.described()?) } else { None };
    let mut scenarios = described.iter().flat_map(Described::all).map(|team| &team.scenario);
    let mut teams = Vec::new();
    for reach in &reaches {
        teams.push(RecordedTeam::begin(reach, scenarios.next(), out)?);
    }
    let mut fleet = described.as_ref().map(|described| FleetRecorder::begin(out, described)).transpose()?;
    let title = match reaches.as_slice() {
        [only] => only.title(),
        _ => format!("fleet {}", place.swarm()),
    };
    eprintln!("recording {title} into {}; Ctrl-C ends the recording", out.display());
    while interrupts.count() == 0 {
        let now = clock::now();
        let has_failed = |team: &RecordedTeam<'_>| team.full.as_ref().is_some_and(Recorder::has_failed);
        if fleet.as_ref().map_or_else(|| teams.iter().any(has_failed), |fleet| fleet.file.has_failed()) {
            break;
        }
        let is_due = fleet.as_mut().is_some_and(|fleet| fleet.is_due(now, || teams.iter().all(|team| team.has_begun)));
        teams.iter_mut().for_each(|team| team.record(fleet.as_mut(), now, is_due));
        clock::sleep(TICK);
    }
    let steps = || teams.iter().filter_map(|team| Some(team.full.as_ref()?.steps)).sum();
    let (counted, count) = fleet.as_ref().map_or_else(|| ("steps", steps()), |fleet| ("samples", fleet.samples));
    let is_fleet = fleet.is_some();
    let seen = |team: &RecordedTeam<'_>| team.observer.vehicles().values().filter(|view| view.trace.is_some()).count();
    let vehicles: usize = teams.iter().map(seen).sum();
    let rejected: u64 = teams.iter().map(|team| team.observer.dropped()).sum();
    let files = teams.into_iter().filter_map(|team| team.full).map(Recorder::finish);
    let dropped: Result<Vec<u64>, _> = fleet.map(|fleet| fleet.file.finish()).into_iter().chain(files).collect();
    let dropped: u64 = dropped.map_err(|error| about_file(out, &[], error))?.iter().sum();
    let recorded = match is_fleet {
        true => format!("{vehicles} vehicles at {count} times"),
        false => format!("{count} steps of {vehicles} vehicles"),
    };
    let text = format!("{}: {recorded}; dropped: {dropped}, not understood: {rejected}", out.display());
    let object = json!({
        "file": out, "swarm": place.swarm(), "vehicles": vehicles, counted: count, "dropped": dropped, "not_understood": rejected,
    });
    Ok((object, text))
}

/// A swarm or a team that is being recorded.
struct RecordedTeam<'a> {
    reach: &'a Reach,
    /// The scenario of a team.
    scenario: Option<&'a Scenario>,
    observer: Observer,
    /// The full recording, unless it is a team that the scenario does not choose.
    full: Option<Recorder>,
    /// The window of the figures has begun: every vehicle in contact was an active member, as in `fly`. A recording that starts later
    /// begins its window as soon as that can be observed.
    has_begun: bool,
}

impl<'a> RecordedTeam<'a> {
    /// Waits for the first messages of the swarm, or of the team with this scenario.
    fn begin(reach: &'a Reach, scenario: Option<&'a Scenario>, out: &Path) -> Result<Self, Error> {
        let mut observer = Observer::open(reach)?;
        observer.subscribe_to_traces(true)?;
        let received = first_messages(&mut observer, reach)?;
        let mut full = match scenario.and_then(|scenario| scenario.team) {
            None => Some(begin(reach, out)?),
            Some(team) if team.is_recorded => {
                let folder = out.with_file_name("teams").join(team.id.to_string());
                let failed = |error: std::io::Error| Error::Failed(format!("{}: {error}", folder.display()));
                std::fs::create_dir_all(&folder).map_err(failed)?;
                Some(begin(reach, &folder.join(record::FILE))?)
            }
            Some(_) => None,
        };
        if let Some(full) = &mut full {
            received.iter().for_each(|(received, at)| put(full, received, *at));
        }
        Ok(Self { reach, scenario, observer, full, has_begun: false })
    }

    /// Records what has arrived, in the recording of the fleet too; if it `is_due`, also the places.
    fn record(&mut self, mut fleet: Option<&mut FleetRecorder>, now: Instant, is_due: bool) {
        for (received, at) in self.observer.poll_timed() {
            if let (Some(fleet), SwarmMessage::Event(event), Some(team)) =
                (&mut fleet, &received, self.reach.branch.team())
            {
                fleet.event(at, team, event.header.sender, event.what);
            }
            self.full.iter_mut().for_each(|full| put(full, &received, at));
        }
        let mut alive = self.observer.vehicles().values().filter(|view| view.alive).peekable();
        if !self.has_begun && alive.peek().is_some() && alive.all(VehicleView::is_active) {
            self.has_begun = true;
            self.full.iter_mut().for_each(|full| full.window_begins(now));
        }
        if let (Some(fleet), Some(scenario), true) = (fleet, self.scenario, is_due) {
            let is_new = |at: Instant| now.saturating_duration_since(at) < NEW;
            let views =
                self.observer.vehicles().values().filter(|view| view.alive && view.trace_at.is_some_and(is_new));
            fleet.places(now, scenario, views.filter_map(|view| view.trace.as_ref()));
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
    let about = RecordingInfo { scenario, scenario_toml: &text, run: &Run::new(scenario, "fly"), is_fleet: false };
    Recorder::begin(out, &about, Some(scenario.record.hz.live_hz())).map_err(|error| about_file(out, &[], error))
}

fn put(recorder: &mut Recorder, received: &SwarmMessage, at: Instant) {
    match received {
        SwarmMessage::Trace(trace) => recorder.step(at, trace),
        SwarmMessage::Event(event) => recorder.happened(at, event),
        other => other.note().iter().for_each(|(severity, who, what)| recorder.note(at, *severity, who, what)),
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
