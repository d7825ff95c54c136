//! Processor, clock, limits of this user, disk and Python.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::thread;

use skein_agent::unix;
use skein_lab::out;

use super::{line, printed, remedy, windows};
use skein_cluster::endpoints;
use skein_cluster::findings::Line;
use skein_cluster::os;

/// Below this free space a recording may not fit, bytes.
const LITTLE_SPACE: u64 = 1 << 30;
/// Below this free space no flight is recorded to its end, bytes.
const NO_SPACE: u64 = 64 << 20;
/// So many open files are enough for every swarm that fits onto one PC.
const ENOUGH_FILES: u64 = 1024;
/// With fewer open files not even a small swarm flies.
const FEW_FILES: u64 = 128;
/// The file that gives this user the limits that an agent wants.
const LIMITS_FILE: &str = "/etc/security/limits.d/skein.conf";

/// All lines.
pub(super) fn lines() -> Vec<Line> {
    let version = format!("skein {}, revision {}", skein_lab::VERSION, skein_lab::REVISION);
    let mut lines = vec![line("program", version), processor(os::cores(), os::load())];
    lines.extend(if cfg!(windows) { windows::lines() } else { vec![clock(&timedatectl())] });
    lines.extend(limits());
    lines.extend([open_files(os::most_open_files()), runs(&out::runs()), runtime_folder(), python()]);
    lines
}

fn processor(cores: usize, load: Option<f64>) -> Line {
    let found = format!("{cores} core{}", if cores == 1 { "" } else { "s" });
    match load {
        Some(load) if load > cores as f64 => line("processor", format!("{found}, and a load of {load:.1}"))
            .warning("end other programs: agents that wait for the processor control late"),
        Some(load) => {
            line("processor", format!("{found}, load {load:.1}; `skein report --capacity` measures how many vehicles"))
        }
        None => line("processor", found),
    }
}

/// Whether systemd keeps the clock synchronised: `yes`, `no`, or nothing where it does not run.
fn timedatectl() -> Option<String> {
    printed("timedatectl", &["show", "--property=NTPSynchronized", "--value"])
}

fn clock(synchronised: &Option<String>) -> Line {
    match synchronised.as_deref() {
        Some("yes") => line("clock", "synchronised"),
        Some("no") => line("clock", "not synchronised; no flight depends on it, recordings of several PCs do")
            .warning("`sudo timedatectl set-ntp true`; or chrony, on a network without internet"),
        _ => line("clock", "whether it is synchronised cannot be seen: no answer of timedatectl").unknown(),
    }
}

/// Asks the system for priority and memory in the way of an agent. Windows locks no memory and asks for no permission.
fn limits() -> Vec<Line> {
    // The priority of this thread alone is raised.
    let priority = thread::spawn(unix::raise_thread_priority).join().unwrap_or_default();
    if cfg!(windows) {
        return vec![line("priority", priority)];
    }
    let memory = unix::lock_memory();
    let limit = |what, found: String, good: &str, rare: &str, entry: &str| match found.starts_with(good) {
        true => line(what, found),
        false => line(what, found).warning(format!(
            "steps may be late while {rare}; `* - {entry}` in {LIMITS_FILE} permits it from the next login on"
        )),
    };
    vec![
        limit("priority", priority, "real-time", "other programs work", "rtprio 50"),
        limit("memory", memory, "memory locked", "memory is short", "memlock unlimited"),
    ]
}

fn open_files(most: io::Result<Option<u64>>) -> Line {
    match most {
        Ok(None) => line("open files", "no limit"),
        Ok(Some(most)) if most >= ENOUGH_FILES => line("open files", format!("at most {most}")),
        Ok(Some(most)) => {
            let line = line("open files", format!("at most {most}, too few for a large swarm"));
            let remedy = format!("`ulimit -n {ENOUGH_FILES}` in this shell");
            if most < FEW_FILES { line.fault(remedy) } else { line.warning(remedy) }
        }
        Err(error) => line("open files", format!("the limit cannot be read: {error}")).unknown(),
    }
}

/// Whether runs can be written.
fn runs(folder: &Path) -> Line {
    let shown = folder.display();
    let remedy = remedy(
        "name a folder that you can write to: `export SKEIN_RUNS=FOLDER`, or --out",
        "name a folder that you can write to: `setx SKEIN_RUNS FOLDER` and a new window, or --out",
    );
    let there = match existing(folder) {
        Ok(there) => there,
        Err(error) => return line("runs", format!("{shown}: {error}")).fault(remedy),
    };
    // Only an attempt shows whether the folder can be written to: its file system may be read-only.
    let probe = there.join(format!(".skein-check-{}", std::process::id()));
    if let Err(error) = File::create_new(&probe).and_then(|_| fs::remove_file(&probe)) {
        return line("runs", format!("{shown} cannot be written to: {error}")).fault(remedy);
    }
    match os::free_bytes(&there) {
        Err(error) => line("runs", format!("{shown}: free space unknown: {error}")).unknown(),
        Ok(free) => space(&shown.to_string(), free),
    }
}

fn space(folder: &str, free: u64) -> Line {
    let line = line("runs", format!("{folder}: {} MiB free", free >> 20));
    let remedy = remedy(
        "make room, or name a folder on another disk: `export SKEIN_RUNS=FOLDER`",
        "make room, or name a folder on another disk: `setx SKEIN_RUNS FOLDER` and a new window",
    );
    match free {
        0..NO_SPACE => line.fault(remedy),
        NO_SPACE..LITTLE_SPACE => line.warning(remedy),
        _ => line,
    }
}

/// The folder itself, or the nearest one above it that exists.
fn existing(folder: &Path) -> io::Result<PathBuf> {
    let folder = std::path::absolute(folder)?;
    for above in folder.ancestors() {
        match fs::metadata(above) {
            Ok(about) if about.is_dir() => return Ok(above.to_owned()),
            Ok(_) => return Err(io::Error::other(format!("{} is not a folder", above.display()))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
    }
    Err(io::ErrorKind::NotFound.into())
}

/// The folder through which other commands find a swarm of this PC.
fn runtime_folder() -> Line {
    let folder = endpoints::folder();
    match os::check_own_folder(&folder) {
        // It is another user's, as after `su` or `sudo -E`: that user needs it.
        Err(error) if error.kind() != io::ErrorKind::NotFound => line("swarms", error.to_string()).fault(
            "name a folder of your own: `export XDG_RUNTIME_DIR=FOLDER`, or `unset XDG_RUNTIME_DIR` after `su` or `sudo -E`",
        ),
        _ => match endpoints::flying(&folder).as_slice() {
            [] => line("swarms", "none flies on this PC"),
            flying => {
                let names: Vec<&str> = flying.iter().map(|name| name.as_str()).collect();
                line("swarms", format!("on this PC: {}; `skein order land --swarm NAME` lands one", names.join(", ")))
            }
        },
    }
}

fn python() -> Line {
    let program = remedy("python3", "python");
    match printed(program, &["--version"]) {
        Some(version) => line("python", version),
        None => line("python", format!("no {program} on the PATH; only laws in Python need it")).unknown(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use skein_cluster::findings::State;

    #[test]
    fn a_busy_processor_and_an_unsynchronised_clock_are_warnings() {
        assert_eq!(processor(4, Some(0.5)).state, State::Good);
        let busy = processor(2, Some(6.0));
        assert!(busy.state == State::Warning && busy.remedy.is_some(), "{busy:?}");
        let states = [Some("yes"), Some("no"), None].map(|said| clock(&said.map(str::to_owned)).state);
        assert_eq!(states, [State::Good, State::Warning, State::Unknown]);
    }

    #[test]
    fn few_open_files_are_a_warning_and_very_few_a_fault() {
        let state = |most| open_files(Ok(most)).state;
        assert_eq!([state(None), state(Some(4096))], [State::Good; 2]);
        assert_eq!([state(Some(256)), state(Some(64))], [State::Warning, State::Fault]);
    }

    #[test]
    fn a_folder_of_runs_that_cannot_be_written_or_is_full_is_a_fault() {
        let folder = tempfile::tempdir().unwrap();
        assert_ne!(runs(&folder.path().join("a/b")).state, State::Fault);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let below = runs(&file.join("runs"));
        assert!(below.state == State::Fault && below.remedy.unwrap().contains("SKEIN_RUNS"));
        let states = [0, NO_SPACE, LITTLE_SPACE].map(|free| space("runs", free).state);
        assert_eq!(states, [State::Fault, State::Warning, State::Good]);
    }
}
