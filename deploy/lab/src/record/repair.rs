//! Repairs a recording that is cut off or damaged.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use super::RecordError;
use super::copy::Copy;
use super::scan::{Found, Piece, scan};

/// The result of a repair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repaired {
    /// Path of the repaired file; `None` if the file was intact.
    pub to: Option<PathBuf>,
    /// Number of intact messages.
    pub messages: u64,
    /// Log time from the first to the last message, ns.
    pub span_ns: u64,
    /// Number of damaged chunks and records, which are left out.
    pub damaged: usize,
    /// Number of bytes of an incomplete chunk at the end, which are left out.
    pub left_over: usize,
}

/// Copies every message of every intact chunk of `path` into a new file beside it: `run.mcap` becomes
/// `run.repaired.mcap`.
///
/// Does not change `path`, and writes no file if `path` is intact.
///
/// # Errors
/// The file is not an MCAP file or cannot be read, or the new file cannot be written.
pub fn repair(path: &Path) -> Result<Repaired, RecordError> {
    let bytes = fs::read(path).map_err(|error| RecordError::Io { path: path.to_owned(), error })?;
    // The first pass only counts: an intact file needs no repaired copy.
    let (mut messages, mut first_ns, mut last_ns) = (0, u64::MAX, 0);
    let count = |piece: Piece<'_>| {
        if let Piece::Message(_, header, _) = piece {
            messages += 1;
            (first_ns, last_ns) = (header.log_time.min(first_ns), header.log_time.max(last_ns));
        }
        Ok(())
    };
    let Found { is_whole, damaged, left_over, .. } = scan(&bytes, count).map_err(|error| error.reading(path))?;
    let to = (!is_whole).then(|| write(&bytes, path)).transpose()?;
    Ok(Repaired { to, messages, span_ns: last_ns.saturating_sub(first_ns), damaged, left_over })
}

fn write(bytes: &[u8], path: &Path) -> Result<PathBuf, RecordError> {
    let to = path.with_extension("repaired.mcap");
    let mut copy = Copy::new(&to)?;
    let found = scan(bytes, |piece| copy.piece(0, piece))?;
    copy.found(0, &found)?;
    copy.finish()?;
    Ok(to)
}

impl fmt::Display for Repaired {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { to, messages, span_ns, damaged, left_over } = self;
        let kept = format!("{messages} messages over {:.2} s", *span_ns as f64 / 1e9);
        match to {
            None => write!(f, "nothing to repair: {kept}"),
            Some(to) => {
                let to = to.display();
                write!(f, "{to}: {kept}; left out: {damaged} damaged chunks or records, {left_over} bytes at the end")
            }
        }
    }
}
