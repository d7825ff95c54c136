//! Files that appear when they are whole.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::RecordError;

/// A file under another name until it is whole; given up, nothing is left of it.
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

    /// It is whole.
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
        // Gone already if it was finished.
        let _ = fs::remove_file(&self.path);
    }
}
