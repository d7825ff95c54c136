//! Records a live swarm in a thread of its own, behind a bounded queue, so that the caller never blocks. Entries that
//! find the queue full are dropped and counted.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use skein_common::id::{TeamId, VehicleName};
use skein_common::message::{Event, EventKind, Header, Severity, Trace};

use skein_cluster::mesh::observe::Rate;
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
    queue: SyncSender<WriteEntry>,
    writing: JoinHandle<Result<(), RecordError>>,
    utc: Utc,
    rate: Rate,
    /// Number of entries that found the queue full.
    dropped: Arc<AtomicU64>,
    /// Number of steps recorded so far.
    pub(super) steps: u64,
}

/// Writes one entry of the recording, in the thread.
type WriteEntry = Box<dyn FnOnce(&mut FileWriter) + Send>;
type FileWriter = Writer<BufWriter<File>>;

impl Recorder {
    /// Creates the file at `path` and records each vehicle `hz` times a second of its simulator's time, or at every
    /// step if it steps less often. The file of a fleet, which has no steps, needs no `hz`.
    ///
    /// # Errors
    /// If the file exists already or cannot be written.
    pub fn begin(path: &Path, about: &RecordingInfo<'_>, hz: Option<f64>) -> Result<Self, RecordError> {
        let io = |error: io::Error| RecordError::Io { path: path.to_owned(), error };
        let file = File::options().write(true).create_new(true).open(path).map_err(io)?;
        let synced = file.try_clone().map_err(io)?;
        let utc = Utc::read();
        let writer = Writer::begin(BufWriter::new(file), about, CLOCK, utc.nanoseconds(clock::now()))?;
        let (queue, entries) = sync_channel(QUEUE);
        let thread = thread::Builder::new().name("record".to_owned());
        let (path, dropped) = (path.to_owned(), Arc::new(AtomicU64::new(0)));
        let of_thread = dropped.clone();
        let writing = thread
            .spawn(move || write(writer, &entries, &of_thread, synced, path))
            .map_err(|error| RecordError::Io { path: PathBuf::from("thread"), error })?;
        Ok(Self { queue, writing, utc, rate: Rate::new(hz.unwrap_or(f64::INFINITY)), dropped, steps: 0 })
    }

    /// Records a trace that was received at this instant, if the rate limit lets it through.
    pub fn step(&mut self, at: Instant, trace: &Trace) {
        if self.rate.is_due(trace) {
            self.steps += 1;
            let trace = trace.clone();
            self.enqueue(at, move |writer, log_time_ns| writer.step(log_time_ns, &trace));
        }
    }

    /// Records an event that a vehicle reported.
    pub fn happened(&mut self, at: Instant, event: &Event) {
        self.event(at, event.header.sender.into(), Some(event.header), event.what);
    }

    /// Records an event of this vehicle.
    pub(super) fn event(&mut self, at: Instant, sender: VehicleName, header: Option<Header>, what: EventKind) {
        self.enqueue(at, move |writer, log_time_ns| writer.event(log_time_ns, sender, header.as_ref(), &what));
    }

    /// Records a fault that was injected into the swarm, or into this team of a fleet.
    pub fn fault(&mut self, at: Instant, team: Option<TeamId>, fault: &InjectedFault) {
        let fault = fault.clone();
        self.enqueue(at, move |writer, log_time_ns| writer.fault(log_time_ns, team, &fault));
    }

    /// Records where the vehicles of a team of a fleet are.
    pub(super) fn places(&mut self, at: Instant, places: TeamPlaces) {
        self.enqueue(at, move |writer, log_time_ns| writer.places(log_time_ns, &places));
    }

    /// Records a note for human readers.
    pub fn note(&mut self, at: Instant, severity: Severity, who: &str, what: &str) {
        let (who, what) = (who.to_owned(), what.to_owned());
        self.enqueue(at, move |writer, log_time_ns| writer.note(log_time_ns, severity, who, what));
    }

    /// Marks the beginning of the measurement window.
    pub fn window_begins(&mut self, at: Instant) {
        self.enqueue(at, FileWriter::window_begins);
    }

    /// Marks the end of the measurement window.
    pub fn window_ends(&mut self, at: Instant) {
        self.enqueue(at, FileWriter::window_ends);
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
        let Self { queue, writing, dropped, .. } = self;
        // The flight is over, so waiting for what is still in the queue is allowed.
        drop(queue);
        writing.join().unwrap_or(Err(RecordError::Missing("the thread that writes")))?;
        Ok(dropped.load(Relaxed))
    }

    fn enqueue(&mut self, at: Instant, write: impl FnOnce(&mut FileWriter, u64) + Send + 'static) {
        let log_time_ns = self.utc.nanoseconds(at);
        if self.queue.try_send(Box::new(move |writer| write(writer, log_time_ns))).is_err() {
            self.dropped.fetch_add(1, Relaxed);
        }
    }
}

/// The note for the operator of a flight about its recording, which was closed with this result. A flight is not to blame for
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
    mut writer: FileWriter,
    entries: &Receiver<WriteEntry>,
    dropped: &AtomicU64,
    file: File,
    path: PathBuf,
) -> Result<(), RecordError> {
    let io = |error: io::Error| RecordError::Io { path: path.clone(), error };
    let (stop, stopped) = channel();
    // Synchronising can be slow: it has a thread of its own, so that writing continues meanwhile.
    let syncing =
        thread::Builder::new().name("record-sync".to_owned()).spawn(move || sync(&file, &stopped)).map_err(io)?;
    let mut flush_at = clock::now() + FLUSH;
    while writer.failed().is_none() {
        match entries.recv_timeout(flush_at.saturating_duration_since(clock::now())) {
            Ok(write_entry) => write_entry(&mut writer),
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
    let file = writer.finish(dropped.load(Relaxed))?.into_inner().map_err(|error| io(error.into_error()))?;
    file.sync_all().map_err(io)
}

/// Synchronises the file to the disk at every [`SYNC`], until stopped. Errors are ignored, because some file systems
/// cannot do it.
fn sync(file: &File, stopped: &Receiver<()>) {
    while let Err(RecvTimeoutError::Timeout) = stopped.recv_timeout(SYNC) {
        let _ = file.sync_data();
    }
}

#[cfg(test)]
mod tests {
    use skein_lab::scenario::ScenarioArgs;

    use super::*;

    #[test]
    fn an_entry_that_finds_the_queue_full_is_dropped_and_counted() {
        let (queue, entries) = sync_channel(2);
        let writing = thread::spawn(|| Ok(()));
        let (rate, dropped) = (Rate::new(50.0), Arc::default());
        let mut recorder = Recorder { queue, writing, utc: Utc::read(), rate, dropped, steps: 0 };
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
        let about = RecordingInfo { scenario: &loaded.scenario, scenario_toml: "", run: &run, is_fleet: false };
        let synced = full.try_clone().unwrap();
        // Everything before the first entries fits into memory.
        let to = BufWriter::with_capacity(1 << 20, full);
        let writer = Writer::begin(to, &about, CLOCK, 0);
        let (queue, entries) = sync_channel(QUEUE);
        let writing = thread::spawn(move || write(writer?, &entries, &AtomicU64::new(0), synced, "/dev/full".into()));
        let (rate, dropped) = (Rate::new(50.0), Arc::default());
        let mut recorder = Recorder { queue, writing, utc: Utc::read(), rate, dropped, steps: 0 };
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
        let about = RecordingInfo { scenario: &loaded.scenario, scenario_toml: "", run: &run, is_fleet: false };
        assert!(matches!(Recorder::begin(&path, &about, Some(50.0)), Err(RecordError::Io { .. })));
        assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    }
}
