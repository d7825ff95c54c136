//! Recording a live swarm: a thread of its own behind a bounded queue, so that whoever hands over never waits. What finds the
//! queue full is dropped and counted.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::message::{Event, Trace};

use skein_host::clock::{self, Utc};
use skein_lab::faults::Incident;
use skein_lab::record::{About, FLUSH, RecordError, Writer};

/// What waits to be written; two seconds of 250 vehicles.
const QUEUE: usize = 25_000;
/// Between two requests to put what was written onto the disk itself: what a power cut can cost.
const SYNC: Duration = Duration::from_secs(1);
/// What log times count from.
const CLOCK: &str = "UTC when the recorder heard of it";

/// Records while it lives. Log times are UTC.
pub struct Recorder {
    queue: SyncSender<(u64, Word)>,
    writing: JoinHandle<Result<(), RecordError>>,
    utc: Utc,
    rate: Rate,
    dropped: u64,
    steps: u64,
}

/// What is to be written.
enum Word {
    Step(Box<Trace>),
    Happened(Event),
    Incident(Incident),
    Note {
        is_bad: bool,
        who: String,
        what: String,
    },
    Begins,
    Ends,
    /// The last word: so many were dropped.
    Dropped(u64),
}

impl Recorder {
    /// Begins a new file at `path`, and records each vehicle `hz` times a second of its own simulator's time, or as often as it
    /// steps.
    ///
    /// # Errors
    /// If the file is there already, or cannot be written.
    pub fn begin(path: &Path, about: &About<'_>, hz: f64) -> Result<Self, RecordError> {
        let io = |error: io::Error| RecordError::Io { path: path.to_owned(), error };
        let file = File::options().write(true).create_new(true).open(path).map_err(io)?;
        let synced = file.try_clone().map_err(io)?;
        let utc = Utc::read();
        let about = About { clock: CLOCK, ..*about };
        let writer = Writer::new(BufWriter::new(file), &about, utc.nanoseconds(clock::now()))?;
        let (queue, words) = sync_channel(QUEUE);
        let thread = thread::Builder::new().name("record".to_owned());
        let path = path.to_owned();
        let writing = thread
            .spawn(move || write(writer, &words, synced, path))
            .map_err(|error| RecordError::Io { path: PathBuf::from("thread"), error })?;
        Ok(Self { queue, writing, utc, rate: Rate::new(hz), dropped: 0, steps: 0 })
    }

    /// A step that was heard at this instant.
    pub fn step(&mut self, at: Instant, trace: &Trace) {
        if self.rate.is_due(trace) {
            self.steps += 1;
            self.hand_over(at, Word::Step(Box::new(trace.clone())));
        }
    }

    /// Something that a vehicle said of itself.
    pub fn happened(&mut self, at: Instant, event: &Event) {
        self.hand_over(at, Word::Happened(*event));
    }

    /// Something that was done to the swarm.
    pub fn incident(&mut self, at: Instant, incident: &Incident) {
        self.hand_over(at, Word::Incident(incident.clone()));
    }

    /// Something that only people read.
    pub fn note(&mut self, at: Instant, is_bad: bool, who: &str, what: &str) {
        self.hand_over(at, Word::Note { is_bad, who: who.to_owned(), what: what.to_owned() });
    }

    /// The window of the figures begins.
    pub fn window_begins(&mut self, at: Instant) {
        self.hand_over(at, Word::Begins);
    }

    /// It ends.
    pub fn window_ends(&mut self, at: Instant) {
        self.hand_over(at, Word::Ends);
    }

    /// Steps recorded so far.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Nothing is written any more: what went wrong is told by [`Self::finish`].
    pub fn has_failed(&self) -> bool {
        self.writing.is_finished()
    }

    /// Closes the file; gives how much was dropped.
    ///
    /// # Errors
    /// The first thing that went wrong since the beginning.
    pub fn finish(self) -> Result<u64, RecordError> {
        let Self { queue, writing, utc, dropped, .. } = self;
        // The flight is over: now there is time to wait. A thread that is gone tells why below.
        let _ = queue.send((utc.nanoseconds(clock::now()), Word::Dropped(dropped)));
        drop(queue);
        writing.join().unwrap_or(Err(RecordError::Missing("the thread that writes")))?;
        Ok(dropped)
    }

    fn hand_over(&mut self, at: Instant, word: Word) {
        if self.queue.try_send((self.utc.nanoseconds(at), word)).is_err() {
            self.dropped += 1;
        }
    }
}

/// What the thread does, to the end or to the first thing that cannot be written.
fn write(
    mut writer: Writer<BufWriter<File>>,
    words: &Receiver<(u64, Word)>,
    file: File,
    path: PathBuf,
) -> Result<(), RecordError> {
    let io = |error: io::Error| RecordError::Io { path: path.clone(), error };
    let (stop, stopped) = channel();
    // A disk may take its time; what comes meanwhile is written all the same.
    let syncing =
        thread::Builder::new().name("record-sync".to_owned()).spawn(move || sync(&file, &stopped)).map_err(io)?;
    let mut dropped = 0;
    let mut flush_at = clock::now() + FLUSH;
    while writer.failed().is_none() {
        match words.recv_timeout(flush_at.saturating_duration_since(clock::now())) {
            Ok((_, Word::Dropped(count))) => dropped = count,
            Ok((log_time_ns, word)) => put(&mut writer, log_time_ns, word),
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

fn put(writer: &mut Writer<BufWriter<File>>, log_time_ns: u64, word: Word) {
    match word {
        Word::Step(trace) => writer.step(log_time_ns, &trace),
        Word::Happened(Event { header, what }) => writer.event(log_time_ns, header.sender, Some(&header), &what),
        Word::Incident(incident) => writer.incident(log_time_ns, &incident),
        Word::Note { is_bad, who, what } => writer.note(log_time_ns, is_bad, who, what),
        Word::Begins => writer.window_begins(log_time_ns),
        Word::Ends => writer.window_ends(log_time_ns),
        Word::Dropped(_) => {}
    }
}

/// Puts what was written onto the disk itself, until told to stop. A file system that cannot keeps what it can.
fn sync(file: &File, stopped: &Receiver<()>) {
    while let Err(RecvTimeoutError::Timeout) = stopped.recv_timeout(SYNC) {
        let _ = file.sync_data();
    }
}

/// Lets so many steps a second through, by the simulator's clock: a queue that was held up costs none.
#[derive(Debug)]
struct Rate {
    period_s: f64,
    /// Of each vehicle's last step, and when the next one is due.
    due_s: BTreeMap<VehicleId, (f64, f64)>,
}

impl Rate {
    fn new(hz: f64) -> Self {
        Self { period_s: 1.0 / hz, due_s: BTreeMap::new() }
    }

    fn is_due(&mut self, trace: &Trace) -> bool {
        let t_s = trace.plant_time.seconds();
        let (last_s, due_s) = self.due_s.get(&trace.header.sender).copied().unwrap_or((t_s, t_s));
        // A simulator that begins anew has a clock that begins anew.
        let due_s = if t_s < last_s { t_s } else { due_s };
        // Frames come when they come: the nearest one is taken, if the next comes as this one did.
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

    /// Times of one vehicle's simulator that come through, of those every `frame_s`, the simulator's clock turned back by
    /// half after half of them.
    fn through(hz: f64, frame_s: f64) -> usize {
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
    fn the_rate_holds_whatever_the_frames_are() {
        assert_eq!(through(50.0, 0.02), 500, "every one");
        assert_eq!(through(10.0, 0.02), 100);
        assert_eq!(through(50.0, 0.01), 500);
        assert_eq!(through(1000.0, 0.02), 500, "no more than there are");
        let uneven = through(50.0, 1.0 / 60.0);
        assert!((480..=510).contains(&uneven), "{uneven}");
    }

    #[test]
    fn what_finds_the_queue_full_is_dropped_and_counted() {
        let (queue, words) = sync_channel(2);
        let writing = thread::spawn(|| Ok(()));
        let rate = Rate::new(50.0);
        let mut recorder = Recorder { queue, writing, utc: Utc::read(), rate, dropped: 0, steps: 0 };
        (0..5).for_each(|_| recorder.note(clock::now(), false, "fly", "again"));
        assert_eq!(words.try_iter().count(), 2);
        recorder.note(clock::now(), false, "fly", "there is room again");
        assert_eq!(words.try_iter().count(), 1);
        drop(words);
        assert_eq!(recorder.finish().unwrap(), 3);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_recording_that_cannot_be_written_says_so_at_once() {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let loaded = ScenarioArgs::default().read(Vec::new()).unwrap();
        let run = skein_lab::metrics::Run::new(&loaded.scenario, "fly");
        let about = About { scenario: &loaded.scenario, scenario_toml: "", run: &run, clock: "" };
        let synced = full.try_clone().unwrap();
        // All that comes before the first words finds room in memory.
        let to = BufWriter::with_capacity(1 << 20, full);
        let writer = Writer::new(to, &about, 0);
        let (queue, words) = sync_channel(QUEUE);
        let writing = thread::spawn(move || write(writer?, &words, synced, "/dev/full".into()));
        let mut recorder = Recorder { queue, writing, utc: Utc::read(), rate: Rate::new(50.0), dropped: 0, steps: 0 };
        recorder.note(clock::now(), false, "fly", "nobody will read this");
        let until = clock::now() + Duration::from_secs(30);
        while !recorder.has_failed() {
            assert!(clock::now() < until);
            clock::sleep(Duration::from_millis(10));
        }
        recorder.note(clock::now(), false, "fly", "nor this");
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
        let about = About { scenario: &loaded.scenario, scenario_toml: "", run: &run, clock: "" };
        assert!(matches!(Recorder::begin(&path, &about, 50.0), Err(RecordError::Io { .. })));
        assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    }
}
