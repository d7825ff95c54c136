//! Writes files on a node's host atomically and durably: they survive a power cut.

use std::ffi::OsString;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::os;
use skein_host::atomic_file::{self, Durability};
use skein_host::clock;

/// Extension of a draft: files and folders with it are ignored.
const DRAFT: &str = "draft";
/// Interval at which a lock is tried.
const POLL_PERIOD: Duration = Duration::from_millis(20);

/// Makes an error text that names the path.
pub(super) fn at(path: &Path) -> impl FnOnce(io::Error) -> String + '_ {
    move |error| format!("{}: {error}", path.display())
}

/// Returns the path with `.draft` appended.
pub(super) fn draft(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".");
    name.push(DRAFT);
    name.into()
}

/// Whether the path is a draft.
pub(super) fn is_draft(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == DRAFT)
}

/// Called before every change on disk: a test can make it fail to simulate an interruption.
fn step() -> io::Result<()> {
    #[cfg(test)]
    tests::step()?;
    Ok(())
}

/// Renames a file or folder. An existing target is replaced, unless it is a folder that is not empty.
pub(super) fn rename(from: &Path, to: &Path) -> io::Result<()> {
    step()?;
    fs::rename(from, to)
}

/// Creates a link that is not used yet.
pub(super) fn new_link(to: &Path, link: &Path) -> io::Result<()> {
    step()?;
    os::link(to, link)
}

/// The path that a link leads to.
pub(super) fn target(link: &Path) -> io::Result<PathBuf> {
    let to = os::read_link(link)?;
    Ok(link.parent().unwrap_or(Path::new("")).join(to))
}

/// Writes a file durably; readers see the old or the new one.
pub(super) fn write(path: &Path, content: &[u8], is_secret: bool) -> Result<(), String> {
    let done =
        step().and_then(|()| atomic_file::write(path, content, Durability::of(is_secret))).and_then(|()| sync(path));
    done.map_err(at(path))
}

/// Writes a file that is not used yet, durably.
pub(super) fn write_through(path: &Path, content: &[u8], mode: u32) -> io::Result<()> {
    remove(path)?;
    step()?;
    let mut file = File::options().write(true).create_new(true).open(path)?;
    // Set the mode before there are contents to protect.
    os::set_mode(path, mode)?;
    step()?;
    file.write_all(content)?;
    file.sync_all()
}

/// Makes the directory entry of a path durable.
pub(super) fn sync(path: &Path) -> io::Result<()> {
    path.parent().map_or(Ok(()), os::sync_folder)
}

/// Points a link to another target; readers see the old or the new one.
pub(super) fn link(link: &Path, to: &Path) -> Result<(), String> {
    let draft = draft(link);
    let done = remove(&draft).and_then(|()| new_link(to, &draft)).and_then(|()| rename(&draft, link));
    done.and_then(|()| sync(link)).map_err(at(link))
}

/// Removes a file, a link or a whole folder, if it exists.
pub(super) fn remove(path: &Path) -> io::Result<()> {
    step()?;
    let gone = match fs::symlink_metadata(path) {
        Ok(found) if found.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
        Err(error) => Err(error),
    };
    match gone {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Returns the paths in a folder, sorted; none if the folder does not exist.
pub(super) fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).map(|entries| entries.filter_map(|entry| Some(entry.ok()?.path())).collect());
    let mut entries: Vec<_> = entries.unwrap_or_default();
    entries.sort();
    entries
}

/// Returns the last component of a path as text.
pub(super) fn name(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()
}

/// A file lock, held by one process at a time and released when that process ends in any way.
#[derive(Debug)]
pub(super) struct Lock(File);

impl Lock {
    /// Takes the lock; `None` if another process holds it for longer than `within`. The folder must exist.
    pub(super) fn take(path: &Path, within: Duration) -> Result<Option<Self>, String> {
        let until = clock::now() + within;
        loop {
            let file = File::options().create(true).truncate(false).write(true).open(path).map_err(at(path))?;
            match file.try_lock() {
                // The previous holder may have removed the file.
                Ok(()) if os::is_file_at(&file, path) => return Ok(Some(Self(file))),
                Ok(()) => continue,
                Err(TryLockError::WouldBlock) if clock::now() < until => clock::sleep(POLL_PERIOD),
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(error)) => return Err(at(path)(error)),
            }
        }
    }

    /// Whether a process holds the lock. Writes nothing.
    pub(super) fn is_held(path: &Path) -> bool {
        let tried = File::open(path).map(|file| file.try_lock_shared());
        matches!(tried, Ok(Err(TryLockError::WouldBlock)))
    }

    /// Replaces the text in the locked file, for other processes to read.
    pub(super) fn set_text(&mut self, text: &str) -> io::Result<()> {
        self.0.set_len(0)?;
        self.0.write_all(text.as_bytes())
    }
}

#[cfg(test)]
pub(super) mod tests;
