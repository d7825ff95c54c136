//! Files that appear under their name only when they are complete.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::RecordError;

/// A file with a temporary name until it is complete; a draft that is dropped before is deleted.
#[derive(Debug)]
pub(crate) struct Draft {
    path: PathBuf,
    target: PathBuf,
}

impl Draft {
    pub(crate) fn new(target: &Path) -> Self {
        Self { path: target.with_extension("draft"), target: target.to_owned() }
    }

    pub(crate) fn create(&self) -> Result<File, RecordError> {
        File::create(&self.path).map_err(|error| RecordError::Io { path: self.path.clone(), error })
    }

    /// Flushes the complete file to disk and renames it to its target.
    pub(crate) fn finish(self, file: &File) -> Result<(), RecordError> {
        let finished = file.sync_all().and_then(|()| fs::rename(&self.path, &self.target));
        finished.map_err(|error| self.error(error))
    }

    pub(crate) fn error(&self, error: io::Error) -> RecordError {
        RecordError::Io { path: self.target.clone(), error }
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        // A finished draft is already renamed.
        let _ = fs::remove_file(&self.path);
    }
}
