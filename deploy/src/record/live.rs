//! Records a live swarm in a thread of its own, behind a bounded queue, so that the caller never blocks. Entries that
//! find the queue full are dropped and counted.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use skein_common::id::{TeamId, VehicleId, VehicleName};
use skein_common::message::{Event, EventKind, Header, Severity, Trace};

use skein_host::clock::{self, Utc};
use skein_lab::faults::InjectedFault;
use skein_lab::record::{FLUSH, RecordError, RecordingInfo, TeamPlaces, Writer};

/// Capacity of the queue of entries to be written: two seconds of 250 vehicles.
const QUEUE: usize = 25_000;
/// Interval at which the file is synchronised to the disk: the most that a power cut can lose.
const SYNC: Duration = Duration::from_secs(1);
/// The clock of the log times, as the recording states it.
const CLOCK: &str = "UTC when the recorder received it";

/// Records a swarm or a fleet until it is finished. Log times are UTC.
pub struct Recorder {
    queue: SyncSender<(u64, Entry)>,
    writing: JoinHandle<Result<(), RecordError>>,
    utc: Utc,
    rate: Rate,
    dropped: u64,
    steps: u64,
}

/// An entry of the recording, to be written by the thread.
enum Entry {
    Step(Box<Trace>),
    Places(TeamPlaces),
    Happened(VehicleName, Option<Header>, EventKind),
    InjectedFault(Option<TeamId>, InjectedFault),
    Note {
        severity: Severity,
        who: String,
        what: String,
    },
    Begins,
    Ends,
    /// The last entry: the number of entries dropped.
    Dropped(u64),
}

impl Recorder {
    /// Creates the file at `path` and records each vehicle `hz` times a second of its simulator's time, or at every
    /// step if it steps less often.
    ///
    /// # Errors
    /// If the file exists already or cannot be written.
    pub fn begin(path: &Path, about: &RecordingInfo<'_>, hz: f64) -> Result<Self, RecordError> {
        Self::with(path, about, hz, false)
    }

    /// Creates the file of a fleet at `path`, which has places, events and faults.
    ///
    /// # Errors
    /// As [`Self::begin`].
    pub(super) fn of_fleet(path: &Path, about: &RecordingInfo<'_>) -> Result<Self, RecordError> {
        Self::with(path, about, f64::INFINITY, true)
    }

    fn with(path: &Path, about: &RecordingInfo<'_>, hz: f64, is_fleet: bool) -> Result<Self, RecordError> {
        let io = |error: io::Error| RecordError::Io { path: path.to_owned(), error };
        let file = File::options().write(true).create_new(true).open(path).map_err(io)?;
        let synced = file.try_clone().map_err(io)?;
        let utc = Utc::read();
        let about = RecordingInfo { clock: CLOCK, ..*about };
        let (to, now_ns) = (BufWriter::new(file), utc.nanoseconds(clock::now()));
        let writer =
            if is_fleet { Writer::begin_fleet(to, &about, now_ns)? } else { Writer::begin(to, &about, now_ns)? };
        let (queue, entries) = sync_channel(QUEUE);
        let thread = thread::Builder::new().name("record".to_owned());
        let path = path.to_owned();
        let writing = thread
            .spawn(move || write(writer, &entries, synced, path))
            .map_err(|error| RecordError::Io { path: PathBuf::from("thread"), error })?;
        Ok(Self { queue, writing, utc, rate: Rate::new(hz), dropped: 0, steps: 0 })
    }

    /// Records a trace that was received at this instant, if the rate limit lets it through.
    pub fn step(&mut self, at: Instant, trace: &Trace) {
        if self.rate.is_due(trace) {
            self.steps += 1;
            self.enqueue(at, Entry::Step(Box::new(trace.clone())));
        }
    }

    /// Records an event that a vehicle reported.
    pub fn happened(&mut self, at: Instant, event: &Event) {
        self.enqueue(at, Entry::Happened(event.header.sender.into(), Some(event.header), event.what));
    }

    /// Records an event of a vehicle of a fleet.
    pub(super) fn event(&mut self, at: Instant, sender: VehicleName, what: EventKind) {
        self.enqueue(at, Entry::Happened(sender, None, what));
    }

    /// Records a fault that was injected into the swarm, or into this team of a fleet.
    pub fn fault(&mut self, at: Instant, team: Option<TeamId>, fault: &InjectedFault) {
        self.enqueue(at, Entry::InjectedFault(team, fault.clone()));
    }

    /// Records where the vehicles of a team of a fleet are.
    pub(super) fn places(&mut self, at: Instant, places: TeamPlaces) {
        self.enqueue(at, Entry::Places(places));
    }

    /// Records a note for human readers.
    pub fn note(&mut self, at: Instant, severity: Severity, who: &str, what: &str) {
        self.enqueue(at, Entry::Note { severity, who: who.to_owned(), what: what.to_owned() });
    }

    /// Marks the beginning of the measurement window.
    pub fn window_begins(&mut self, at: Instant) {
        self.enqueue(at, Entry::Begins);
    }

    /// Marks the end of the measurement window.
    pub fn window_ends(&mut self, at: Instant) {
        self.enqueue(at, Entry::Ends);
    }

    /// Number of steps recorded so far.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Whether writing has failed and nothing more is recorded. [`Self::finish`] returns the error.
    pub fn has_failed(&self) -> bool {
        self.writing.is_finished()
    }

    /// Closes the file and returns the number of entries dropped.
    ///
    /// # Errors
    /// If writing has failed since the beginning: the first error.
    pub fn finish(self) -> Result<u64, RecordError> {
        let Self { queue, writing, utc, dropped, .. } = self;
        // The flight is over, so waiting is allowed. If the thread is gone, joining it below returns its error.
        let _ = queue.send((utc.nanoseconds(clock::now()), Entry::Dropped(dropped)));
        drop(queue);
        writing.join().unwrap_or(Err(RecordError::Missing("the thread that writes")))?;
        Ok(dropped)
    }

    fn enqueue(&mut self, at: Instant, entry: Entry) {
        if self.queue.try_send((self.utc.nanoseconds(at), entry)).is_err() {
            self.dropped += 1;
        }
    }
}

/// What the operator of a flight is to know of its recording, which was closed with this result. A flight is not to blame for
/// it.
pub fn told(closed: Result<u64, RecordError>) -> Option<String> {
    match closed {
        Ok(0) => None,
        Ok(dropped) => Some(format!("recording: {dropped} entries came faster than they could be written")),
        Err(error) => Some(format!("the recording is not complete: {error}")),
    }
}

/// Runs in the thread: writes entries until the queue closes or writing fails.
fn write(
    mut writer: Writer<BufWriter<File>>,
    entries: &Receiver<(u64, Entry)>,
    file: File,
    path: PathBuf,
) -> Result<(), RecordError> {
    let io = |error: io::Error| RecordError::Io { path: path.clone(), error };
    let (stop, stopped) = channel();
    // Synchronising can be slow: it has a thread of its own, so that writing continues meanwhile.
    let syncing =
        thread::Builder::new().name("record-sync".to_owned()).spawn(move || sync(&file, &stopped)).map_err(io)?;
    let mut dropped = 0;
    let mut flush_at = clock::now() + FLUSH;
    while writer.failed().is_none() {
        match entries.recv_timeout(flush_at.saturating_duration_since(clock::now())) {
            Ok((_, Entry::Dropped(count))) => dropped = count,
            Ok((log_time_ns, entry)) => put(&mut writer, log_time_ns, entry),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        let now = clock::now();
        if now >= flush_at {
            writer.flush();
            flush_at = now + FLUSH;
        }
    }
    drop(stop);
    let _ = syncing.join();
    let file = writer.finish(dropped)?.into_inner().map_err(|error| io(error.into_error()))?;
    file.sync_all().map_err(io)
}

fn put(writer: &mut Writer<BufWriter<File>>, log_time_ns: u64, entry: Entry) {
    match entry {
        Entry::Step(trace) => writer.step(log_time_ns, &trace),
        Entry::Places(places) => writer.places(log_time_ns, &places),
        Entry::Happened(sender, header, what) => writer.event(log_time_ns, sender, header.as_ref(), &what),
        Entry::InjectedFault(team, fault) => writer.fault(log_time_ns, team, &fault),
        Entry::Note { severity, who, what } => writer.note(log_time_ns, severity, who, what),
        Entry::Begins => writer.window_begins(log_time_ns),
        Entry::Ends => writer.window_ends(log_time_ns),
        Entry::Dropped(_) => {}
    }
}

/// Synchronises the file to the disk at every [`SYNC`], until stopped. Errors are ignored, because some file systems
/// cannot do it.
fn sync(file: &File, stopped: &Receiver<()>) {
    while let Err(RecvTimeoutError::Timeout) = stopped.recv_timeout(SYNC) {
        let _ = file.sync_data();
    }
}

/// Limits the steps recorded a second, by the simulator's clock, so that a delayed queue loses no steps.
#[derive(Debug)]
pub(crate) struct Rate {
    period_s: f64,
    /// Each vehicle's last time and the time when its next step is due, s of its simulator's clock.
    due_s: BTreeMap<VehicleId, (f64, f64)>,
}

impl Rate {
    /// At most so many steps a second, Hz.
    pub(crate) fn new(hz: f64) -> Self {
        Self { period_s: 1.0 / hz, due_s: BTreeMap::new() }
    }

    /// Whether this step is to be recorded. Answers once for each step.
    pub(crate) fn is_due(&mut self, trace: &Trace) -> bool {
        let t_s = trace.plant_time.seconds();
        let (last_s, due_s) = self.due_s.get(&trace.header.sender).copied().unwrap_or((t_s, t_s));
        // A restarted simulator has a restarted clock.
        let due_s = if t_s < last_s { t_s } else { due_s };
        // Frame times are irregular: record the frame nearest to the deadline, assuming that the next frame takes as
        // long as this one.
        let frame_s = (t_s - last_s).max(0.0);
        let is_due = t_s >= due_s - 0.5 * frame_s;
        let next_s = if is_due { (due_s + self.period_s).max(t_s + 0.5 * self.period_s) } else { due_s };
        self.due_s.insert(trace.header.sender, (t_s, next_s));
        is_due
    }
}

#[cfg(test)]
mod tests {
    use skein_common::time::PlantTime;
    use skein_lab::scenario::ScenarioArgs;
    use skein_lab::world::World;

    use super::*;

    /// Number of steps recorded in 10 s of frames every `frame_s`; halfway through, the simulator's clock jumps back.
    fn recorded_steps(hz: f64, frame_s: f64) -> usize {
        let mut rate = Rate::new(hz);
        let args = ScenarioArgs::default();
        let scenario = args.read(Vec::new()).unwrap().scenario;
        let ready = args.ready(&scenario).unwrap();
        let mut world = World::new(&scenario, &ready.aircraft, &ready.rules).unwrap();
        world.tick();
        let mut step = world.traces().next().unwrap();
        let frames = (10.0 / frame_s).round() as usize;
        let mut is_due = |nth: usize| {
            let t_s = if nth < frames / 2 { 100.0 + nth as f64 * frame_s } else { nth as f64 * frame_s };
            step.plant_time = PlantTime::from_seconds(t_s);
            rate.is_due(&step)
        };
        (0..frames).filter(|nth| is_due(*nth)).count()
    }

    #[test]
    fn the_recording_rate_holds_at_any_frame_rate() {
        assert_eq!(recorded_steps(50.0, 0.02), 500, "every one");
        assert_eq!(recorded_steps(10.0, 0.02), 100);
        assert_eq!(recorded_steps(50.0, 0.01), 500);
        assert_eq!(recorded_steps(1000.0, 0.02), 500, "no more than there are");
        let uneven = recorded_steps(50.0, 1.0 / 60.0);
        assert!((480..=510).contains(&uneven), "{uneven}");
    }

    #[test]
    fn an_entry_that_finds_the_queue_full_is_dropped_and_counted() {
        let (queue, entries) = sync_channel(2);
        let writing = thread::spawn(|| Ok(()));
        let rate = Rate::new(50.0);
        let mut recorder = Recorder { queue, writing, utc: Utc::read(), rate, dropped: 0, steps: 0 };
        (0..5).for_each(|_| recorder.note(clock::now(), Severity::Info, "fly", "again"));
        assert_eq!(entries.try_iter().count(), 2);
        recorder.note(clock::now(), Severity::Info, "fly", "there is room again");
        assert_eq!(entries.try_iter().count(), 1);
        drop(entries);
        assert_eq!(recorder.finish().unwrap(), 3);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_recording_that_cannot_be_written_fails_at_once() {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let loaded = ScenarioArgs::default().read(Vec::new()).unwrap();
        let run = skein_lab::metrics::Run::new(&loaded.scenario, "fly");
        let about = RecordingInfo { scenario: &loaded.scenario, scenario_toml: "", run: &run, clock: "" };
        let synced = full.try_clone().unwrap();
        // Everything before the first entries fits into memory.
        let to = BufWriter::with_capacity(1 << 20, full);
        let writer = Writer::begin(to, &about, 0);
        let (queue, entries) = sync_channel(QUEUE);
        let writing = thread::spawn(move || write(writer?, &entries, synced, "/dev/full".into()));
        let mut recorder = Recorder { queue, writing, utc: Utc::read(), rate: Rate::new(50.0), dropped: 0, steps: 0 };
        recorder.note(clock::now(), Severity::Info, "fly", "this is never written");
        let until = clock::now() + Duration::from_secs(30);
        while !recorder.has_failed() {
            assert!(clock::now() < until);
            clock::sleep(Duration::from_millis(10));
        }
        recorder.note(clock::now(), Severity::Info, "fly", "nor this");
        let why = recorder.finish().unwrap_err().to_string();
        assert!(why.starts_with("cannot write: No space left on device"), "{why}");
    }

    #[test]
    fn a_recording_is_never_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        std::fs::write(&path, "precious").unwrap();
        let loaded = ScenarioArgs::default().read(Vec::new()).unwrap();
        let run = skein_lab::metrics::Run::new(&loaded.scenario, "fly");
        let about = RecordingInfo { scenario: &loaded.scenario, scenario_toml: "", run: &run, clock: "" };
        assert!(matches!(Recorder::begin(&path, &about, 50.0), Err(RecordError::Io { .. })));
        assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    }
}
