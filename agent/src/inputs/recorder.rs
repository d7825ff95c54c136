//! Keeps the inputs of an agent while it flies.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, Write};
use std::mem;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::thread;
use std::time::Duration;

use skein_common::time::LocalTime;
use skein_core::agent::Outputs;
use skein_core::station::StepInputs;

use crate::config::InputsFolder;

use super::{EXTENSION, FILE_BYTES, Flown, MEMORY_BYTES, beginning, chunk, encoded_after, is_fault};

/// Time that a chunk covers, s.
const CHUNK_S: f64 = 1.0;
/// Chunks that may wait for a slow disk.
const QUEUE: usize = 64;
/// Files of earlier agents of a vehicle that stay.
const OLD_FILES: usize = 7;
/// Time to write the last chunk when the agent ends: not long for a disk that does not answer.
pub const FINISH_TIMEOUT: Duration = Duration::from_secs(2);

/// Encodes what enters and leaves the station. The control thread owns it, and it never makes that thread wait.
#[derive(Debug)]
pub struct Recorder {
    content: Vec<u8>,
    /// The time at which the chunk began; `None` before the first step.
    began: Option<LocalTime>,
    is_fault: bool,
    /// `None` after a chunk was lost: a replay could not pass the gap.
    chunks: Option<SyncSender<Chunk>>,
}

/// The steps of about a second, and whether something went wrong in them.
type Chunk = (Vec<u8>, bool);

impl Recorder {
    /// Begins to keep the inputs of an agent; with `all` they are written from the start, whatever happens. The
    /// receiver gets a message when the last chunk is written after the recorder was dropped.
    ///
    /// # Errors
    /// The thread that keeps them cannot be started.
    pub fn start(folder: &InputsFolder, flown: &Flown, all: bool) -> io::Result<(Self, Receiver<()>)> {
        let name = format!("{}-{}.{EXTENSION}", folder.vehicle.vehicle, flown.incarnation.0);
        let mut kept = Kept {
            path: folder.path.join(name),
            held: vec![beginning(flown)],
            held_bytes: 0,
            file: None,
            written: 0,
            is_wanted: all,
        };
        let (chunks, queue) = mpsc::sync_channel::<Chunk>(QUEUE);
        let (finished, done) = mpsc::sync_channel(1);
        thread::Builder::new().name("inputs".to_owned()).spawn(move || {
            for (content, is_fault) in queue {
                if let Err(error) = kept.take(&content, is_fault) {
                    let path = kept.path.display();
                    tracing::warn!("the inputs are kept no longer: {path}: {error}; the flight is not affected");
                    break;
                }
            }
            kept.finish();
            let _ = finished.try_send(());
        })?;
        let recorder = Self { content: Vec::new(), began: None, is_fault: false, chunks: Some(chunks) };
        Ok((recorder, done))
    }

    /// Takes what enters the station, before the step: if the core panics, it is known by what.
    pub fn inputs(&mut self, inputs: &StepInputs) {
        if self.chunks.is_some() {
            self.content = encoded_after(mem::take(&mut self.content), inputs);
        }
    }

    /// Takes what left the station in the step at this time.
    pub fn outputs(&mut self, right: LocalTime, outputs: &Outputs) {
        if self.chunks.is_none() {
            return;
        }
        self.content = encoded_after(mem::take(&mut self.content), outputs);
        self.is_fault |= outputs.outbox.happened.iter().any(is_fault);
        let began = *self.began.get_or_insert(right);
        if self.is_fault || right.seconds_since(began) >= CHUNK_S {
            self.began = Some(right);
            self.hand_over();
        }
    }

    fn hand_over(&mut self) {
        let content = mem::take(&mut self.content);
        self.content.reserve(content.len());
        let chunk = (content, mem::take(&mut self.is_fault));
        if self.chunks.as_ref().is_some_and(|chunks| chunks.try_send(chunk).is_err()) {
            self.chunks = None;
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.is_fault |= thread::panicking();
        if !self.content.is_empty() {
            self.hand_over();
        }
    }
}

/// The chunks that the thread keeps.
struct Kept {
    path: PathBuf,
    /// Chunks that wait in memory until there is a file.
    held: Vec<Vec<u8>>,
    held_bytes: usize,
    file: Option<File>,
    written: u64,
    /// Whether the file stays after the flight.
    is_wanted: bool,
}

impl Kept {
    fn take(&mut self, content: &[u8], is_fault: bool) -> io::Result<()> {
        let chunk = chunk(content);
        if is_fault && !self.is_wanted {
            self.is_wanted = true;
            let path = self.path.display();
            tracing::info!("the inputs since the start are in {path}; `skein replay {path}` runs them again");
        }
        self.held_bytes += chunk.len();
        self.held.push(chunk);
        if self.file.is_none() && !self.is_wanted && self.held_bytes <= MEMORY_BYTES {
            return Ok(());
        }
        let file = match &mut self.file {
            Some(file) => file,
            None => {
                remove_old(&self.path);
                self.file.insert(File::create(&self.path)?)
            }
        };
        for chunk in mem::take(&mut self.held) {
            self.written += chunk.len() as u64;
            if self.written > FILE_BYTES {
                return Err(io::Error::other(format!("the file has {FILE_BYTES} bytes, and more are not written")));
            }
            file.write_all(&chunk)?;
        }
        Ok(())
    }

    /// Removes the file of a flight without a fault.
    fn finish(&mut self) {
        if self.file.take().is_some() && !self.is_wanted {
            // What stays of a flight without a fault takes room and does no harm.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Removes all but the newest files of this vehicle's earlier agents, so that an agent that fails again and again does not
/// fill the disk.
fn remove_old(path: &Path) {
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or_default();
    let Some((vehicle, _)) = name.split_once('-') else { return };
    let incarnation = |path: &PathBuf| {
        let (of, rest) = path.file_name()?.to_str()?.split_once('-')?;
        let number: u64 = rest.strip_suffix(EXTENSION)?.strip_suffix('.')?.parse().ok()?;
        (of == vehicle).then_some(number)
    };
    let Some(entries) = path.parent().and_then(|folder| fs::read_dir(folder).ok()) else { return };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut files: Vec<_> = paths.filter_map(|path| Some((incarnation(&path)?, path))).collect();
    files.sort();
    for (_, old) in files.iter().rev().skip(OLD_FILES) {
        // The next agent tries again.
        let _ = fs::remove_file(old);
    }
}
