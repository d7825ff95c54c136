//! Writes files atomically: a reader sees the old content or the new one, never a mixture.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::process;

/// The guarantee with which a file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// A concurrent reader sees the old content or the new one.
    Atomic,
    /// Also, the new content is on the disk when the call returns.
    Synced,
    /// Also, only the owner can ever read the file.
    Secret,
}

impl Durability {
    /// [`Durability::Secret`] for a secret file, else [`Durability::Synced`].
    pub fn of(is_secret: bool) -> Self {
        if is_secret { Self::Secret } else { Self::Synced }
    }
}

/// Writes a file under another name and then renames it.
///
/// # Errors
/// If it cannot be written; the old file is then unchanged.
pub fn write(path: &Path, content: &[u8], promise: Durability) -> io::Result<()> {
    let mut name = path.file_name().ok_or(io::ErrorKind::InvalidInput)?.to_owned();
    name.push(format!(".{}.draft", process::id()));
    let draft = path.with_file_name(name);
    let written = create(&draft, promise).and_then(|mut file| {
        file.write_all(content)?;
        if promise != Durability::Atomic {
            file.sync_all()?;
        }
        fs::rename(&draft, path)
    });
    if written.is_err() {
        // A leftover draft is never mistaken for the file.
        let _ = fs::remove_file(&draft);
    }
    written
}

fn create(path: &Path, promise: Durability) -> io::Result<File> {
    // A draft left by an earlier process with this id may have another mode.
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, if promise == Durability::Secret { 0o600 } else { 0o644 });
    #[cfg(not(unix))]
    let _ = promise;
    options.open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_atomically_and_leaves_no_draft() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        for (content, promise) in
            [("one", Durability::Atomic), ("two", Durability::Synced), ("three", Durability::Secret)]
        {
            write(&path, content.as_bytes(), promise).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), content);
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt;
                let mode = fs::metadata(&path).unwrap().permissions().mode() & 0o777;
                assert_eq!(mode & 0o077 == 0, promise == Durability::Secret, "{mode:o}");
            }
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(write(&folder.path().join("no/such/folder"), b"", Durability::Atomic).is_err());
    }
}
