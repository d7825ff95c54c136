//! Chooses the folder that a run writes into, and claims it.

use std::env;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Component, Path, PathBuf, Prefix};

use crate::error::Error;
use crate::terminal::of_writing;
use skein_common::printable::printable;
use skein_host::atomic_file::{self, Durability};
use skein_host::clock;

/// The environment variable that names the folder of runs without an `--out`.
const RUNS_VARIABLE: &str = "SKEIN_RUNS";

/// The absolute path of `out`, or of a new folder named after `name` and the UTC time in the folder that `SKEIN_RUNS`
/// names, without it in `skein-runs`. Creates nothing.
///
/// # Errors
/// The folder contains files, or the path is not a folder: a command never overwrites the output of a run.
pub fn folder(out: Option<&Path>, name: &str) -> Result<PathBuf, Error> {
    let out = match out {
        Some(out) => out.to_owned(),
        None => fresh(&runs().join(format!("{name}-{}", clock::utc_name()))),
    };
    let out = std::path::absolute(&out).map_err(|error| Error::Refused(format!("{}: {error}", out.display())))?;
    let refused = |why: &str| Err(Error::Refused(format!("--out {}: {why}", out.display())));
    // The path that Windows makes of a name like CON or NUL.
    let device =
        |part: Component<'_>| matches!(part, Component::Prefix(prefix) if matches!(prefix.kind(), Prefix::DeviceNS(_)));
    if out.components().any(device) {
        return refused("Windows keeps this name for a device; choose another folder");
    }
    let is_content = |entry: io::Result<fs::DirEntry>| entry.is_ok_and(|entry| entry.file_name() != CLAIM);
    match fs::read_dir(&out).map(|mut entries| entries.any(is_content)) {
        Ok(true) => refused("the folder already contains files; choose another folder"),
        Ok(false) => Ok(out),
        Err(_) if out.exists() => refused("not a folder that can be written to"),
        Err(_) => Ok(out),
    }
}

/// Name of the file by which a command claims a folder. It stays there, empty.
const CLAIM: &str = ".skein-lock";
/// Longest text of a claim that is shown.
const MOST_CLAIM: usize = 300;

/// A claim on a folder: no other command writes into it until this is dropped or its process ends, however it ends.
#[derive(Debug)]
#[must_use]
pub struct Claim(Option<File>);

impl Drop for Claim {
    fn drop(&mut self) {
        // The lock is released with the file; a text that stays is no claim.
        self.0.iter().for_each(|file| drop(file.set_len(0)));
    }
}

/// Creates a folder for what is written, and claims it. On a file system without locks the claim keeps no other command away.
///
/// # Errors
/// If it cannot be created: the reason, and how to choose another. Or if another command has claimed it: its process, PC and
/// begin.
pub fn claim(out: &Path) -> Result<Claim, Error> {
    fs::create_dir_all(out).map_err(|error| {
        Error::Failed(format!(
            "{}: the folder cannot be created: {error}; choose another with --out, or with the environment variable {RUNS_VARIABLE}",
            out.display()
        ))
    })?;
    let path = out.join(CLAIM);
    let failed = |error: io::Error| Error::Failed(format!("{}: {}", path.display(), of_writing(&error)));
    let mut file =
        OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path).map_err(failed)?;
    match file.try_lock() {
        Ok(()) => {
            let own = format!("process {} on {} since {}", std::process::id(), host(), clock::utc_stamp());
            file.set_len(0)
                .and_then(|()| file.rewind())
                .and_then(|()| file.write_all(own.as_bytes()))
                .map_err(failed)?;
            Ok(Claim(Some(file)))
        }
        Err(TryLockError::WouldBlock) => {
            let mut other = String::new();
            // A text that cannot be read is left out: the lock decides.
            let _ = file.take(MOST_CLAIM as u64).read_to_string(&mut other);
            let other = if other.is_empty() { "another command".to_owned() } else { printable(&other, MOST_CLAIM) };
            let out = out.display();
            Err(Error::Refused(format!(
                "--out {out}: {other} writes there; wait for its end, or choose another folder"
            )))
        }
        Err(TryLockError::Error(_)) => Ok(Claim(None)),
    }
}

/// Writes a file that is there whole or not at all, with the folders above it: on a full disk no part of it is left.
///
/// # Errors
/// A failure that names the file.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<(), Error> {
    let written = || {
        path.parent().map_or(Ok(()), fs::create_dir_all)?;
        atomic_file::write(path, content.as_ref(), Durability::Atomic)
    };
    written().map_err(|error| Error::Failed(format!("{}: {}", path.display(), of_writing(&error))))
}

/// Room on a disk for figures that are written at the end, so that a recording that fills the disk leaves it to them. It is
/// free when this is dropped.
#[derive(Debug)]
#[must_use]
pub struct Room(PathBuf);

impl Room {
    /// Occupies this many bytes in the folder. Where that fails, there is no room to keep.
    pub fn keep(folder: &Path, bytes: usize) -> Self {
        let path = folder.join(".skein-room");
        // The content differs from nothing, so that no file system leaves it out.
        let _ = fs::write(&path, vec![b' '; bytes]);
        Self(path)
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        // A file that stays is only in the way of nothing.
        let _ = fs::remove_file(&self.0);
    }
}

/// Name of this PC, for people.
fn host() -> String {
    let named = fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let variable = || ["HOSTNAME", "COMPUTERNAME"].iter().find_map(|name| env::var(name).ok());
    named.or_else(variable).map_or_else(|| "a PC".to_owned(), |name| name.trim().to_owned())
}

/// The folder of the runs without an `--out`: the one that `SKEIN_RUNS` names, without it `skein-runs`.
pub fn runs() -> PathBuf {
    let runs = env::var_os(RUNS_VARIABLE).filter(|runs| !runs.is_empty());
    runs.map_or_else(|| PathBuf::from("skein-runs"), PathBuf::from)
}

/// The path itself if it is free, otherwise the path with the first number behind it that makes it new.
fn fresh(path: &Path) -> PathBuf {
    let numbered = |number: u32| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!("-{number}"));
        PathBuf::from(name)
    };
    if path.exists() { (2..).map(numbered).find(|path| !path.exists()).unwrap_or_default() } else { path.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_with_files_is_refused() {
        let temporary = tempfile::tempdir().unwrap();
        assert_eq!(folder(Some(temporary.path()), "x").unwrap(), temporary.path(), "an empty folder is accepted");
        let file = temporary.path().join("x");
        fs::write(&file, "").unwrap();
        assert_eq!(folder(Some(temporary.path()), "x").unwrap_err().exit_code(), 2);
        assert_eq!(folder(Some(&file), "x").unwrap_err().exit_code(), 2);
    }

    #[test]
    fn two_runs_in_a_second_have_two_folders() {
        let temporary = tempfile::tempdir().unwrap();
        let path = temporary.path().join("hover-1");
        assert_eq!(fresh(&path), path);
        fs::create_dir(&path).unwrap();
        assert_eq!(fresh(&path), temporary.path().join("hover-1-2"));
    }
}
