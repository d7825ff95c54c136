//! Files on a node's host: written whole or not at all, and there after a power cut.

use std::ffi::OsString;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::os;
use skein_host::atomic_file::{self, Promise};
use skein_host::clock;

/// A draft's ending: nobody reads what has it.
const DRAFT: &str = "draft";
/// Between two looks at a lock.
const LOOK: Duration = Duration::from_millis(20);

/// An error with the path it is about, as one sentence.
pub(super) fn at(path: &Path) -> impl FnOnce(io::Error) -> String + '_ {
    move |error| format!("{}: {error}", path.display())
}

/// The path with `.draft` behind it.
pub(super) fn draft(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".");
    name.push(DRAFT);
    name.into()
}

/// Whether it is one.
pub(super) fn is_draft(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == DRAFT)
}

/// Before everything that changes something on disk: where a test breaks off.
fn step() -> io::Result<()> {
    #[cfg(test)]
    tests::step()?;
    Ok(())
}

/// Gives a file or folder another name; what has it so far goes, unless it is a folder with something in it.
pub(super) fn rename(from: &Path, to: &Path) -> io::Result<()> {
    step()?;
    fs::rename(from, to)
}

/// Makes a link that nobody follows yet.
pub(super) fn symlink(to: &Path, link: &Path) -> io::Result<()> {
    step()?;
    os::symlink(to, link)
}

/// Writes a file, and makes it last; readers see the old one or the new one.
pub(super) fn write(path: &Path, content: &[u8], is_secret: bool) -> Result<(), String> {
    let done =
        step().and_then(|()| atomic_file::write(path, content, Promise::of(is_secret))).and_then(|()| sync(path));
    done.map_err(at(path))
}

/// Writes a file that nobody reads yet, down to the disk.
pub(super) fn write_through(path: &Path, content: &[u8], mode: u32) -> io::Result<()> {
    remove(path)?;
    step()?;
    let mut file = File::options().write(true).create_new(true).open(path)?;
    // Before there is anything in it to read.
    os::set_mode(path, mode)?;
    step()?;
    file.write_all(content)?;
    file.sync_all()
}

/// Makes the entry of a path in its folder last.
pub(super) fn sync(path: &Path) -> io::Result<()> {
    path.parent().map_or(Ok(()), |folder| File::open(folder)?.sync_all())
}

/// Lets a link point there; readers see the old one or the new one.
pub(super) fn link(link: &Path, to: &Path) -> Result<(), String> {
    let draft = draft(link);
    let done = remove(&draft).and_then(|()| symlink(to, &draft)).and_then(|()| rename(&draft, link));
    done.and_then(|()| sync(link)).map_err(at(link))
}

/// Takes away a file, a link or a whole folder; what is not there is gone.
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

/// Paths in a folder, sorted; none if there is no such folder.
pub(super) fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).map(|entries| entries.filter_map(|entry| Some(entry.ok()?.path())).collect());
    let mut entries: Vec<_> = entries.unwrap_or_default();
    entries.sort();
    entries
}

/// The last name of a path as text.
pub(super) fn name(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()
}

/// Held by one process at a time, and by nobody once that one has ended however it may.
#[derive(Debug)]
pub(super) struct Lock(File);

impl Lock {
    /// `None` if another holds it for so long. The folder has to be there.
    pub(super) fn take(path: &Path, within: Duration) -> Result<Option<Self>, String> {
        let until = clock::now() + within;
        loop {
            let file = File::options().create(true).truncate(false).write(true).open(path).map_err(at(path))?;
            match file.try_lock() {
                // Who held it may have taken the file away.
                Ok(()) if os::is_file_at(&file, path) => return Ok(Some(Self(file))),
                Ok(()) => continue,
                Err(TryLockError::WouldBlock) if clock::now() < until => clock::sleep(LOOK),
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(error)) => return Err(at(path)(error)),
            }
        }
    }

    /// Whether anybody holds it. Nothing is written.
    pub(super) fn is_held(path: &Path) -> bool {
        let tried = File::open(path).map(|file| file.try_lock_shared());
        matches!(tried, Ok(Err(TryLockError::WouldBlock)))
    }

    /// Leaves a word for others in the locked file.
    pub(super) fn say(&mut self, word: &str) -> io::Result<()> {
        self.0.set_len(0)?;
        self.0.write_all(word.as_bytes())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::cell::Cell;

    use super::*;

    thread_local! {
        /// So many changes are made on this thread, and the next one is where it breaks off.
        static CHANGES: Cell<u32> = const { Cell::new(u32::MAX) };
    }

    /// From now on as many changes are made on this thread, and then none.
    pub(in crate::cluster::host) fn break_off_after(changes: u32) {
        CHANGES.set(changes);
    }

    pub(super) fn step() -> io::Result<()> {
        let left = CHANGES.get();
        CHANGES.set(left.saturating_sub(u32::from(left != u32::MAX)));
        if left == 0 { Err(io::Error::other("broken off")) } else { Ok(()) }
    }

    #[test]
    #[cfg(unix)]
    fn a_link_is_replaced_and_a_draft_left_behind_is_no_obstacle() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("current");
        fs::create_dir(draft(&path)).unwrap();
        for to in ["one", "two"] {
            link(&path, Path::new(to)).unwrap();
            assert_eq!(fs::read_link(&path).unwrap(), Path::new(to));
        }
        assert_eq!(entries(folder.path()), [path]);
    }

    #[test]
    fn a_lock_is_one_holders_and_outlives_its_files_removal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        assert!(!Lock::is_held(&path) && !path.exists());
        let mut first = Lock::take(&path, Duration::ZERO).unwrap().unwrap();
        first.say("7").unwrap();
        assert!(Lock::is_held(&path) && Lock::take(&path, Duration::ZERO).unwrap().is_none());
        fs::remove_file(&path).unwrap();
        let second = Lock::take(&path, Duration::ZERO).unwrap().unwrap();
        assert!(os::is_file_at(&second.0, &path));
        drop(first);
        assert!(Lock::is_held(&path), "the second holds it");
        drop(second);
        assert!(!Lock::is_held(&path));
    }
}
