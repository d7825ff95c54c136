//! Making a whole file of one that is cut off or damaged.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use super::RecordError;
use super::copy::Copy;
use super::scan::{Found, Piece, scan};

/// What became of a file that was to be repaired.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repaired {
    /// Where the whole file is: beside the other. `None` if that was whole.
    pub to: Option<PathBuf>,
    /// Messages that are in it.
    pub messages: u64,
    /// From the first to the last, ns of log time.
    pub span_ns: u64,
    /// Chunks and records left out, because damaged.
    pub damaged: usize,
    /// Bytes at the end that are no whole chunk, left out.
    pub left_over: usize,
}

/// Writes everything that is whole in `path` into a new file beside it: `run.mcap` becomes `run.repaired.mcap`. The other is
/// left as it is. Every message of every chunk that is all there and undamaged is kept.
///
/// # Errors
/// If it is no MCAP file, cannot be read, or the other one cannot be written.
pub fn repair(path: &Path) -> Result<Repaired, RecordError> {
    let bytes = fs::read(path).map_err(|error| RecordError::Io { path: path.to_owned(), error })?;
    // Nothing is written for a file that needs nothing.
    let (mut messages, mut first_ns, mut last_ns) = (0, u64::MAX, 0);
    let count = |piece: Piece<'_>| {
        if let Piece::Message(_, header, _) = piece {
            messages += 1;
            (first_ns, last_ns) = (header.log_time.min(first_ns), header.log_time.max(last_ns));
        }
        Ok(())
    };
    let Found { is_whole, damaged, left_over, .. } = scan(&bytes, count).map_err(|error| error.reading(path))?;
    let to = match is_whole {
        true => None,
        false => Some(write(&bytes, path)?),
    };
    Ok(Repaired { to, messages, span_ns: last_ns.saturating_sub(first_ns), damaged, left_over })
}

fn write(bytes: &[u8], path: &Path) -> Result<PathBuf, RecordError> {
    let to = path.with_extension("repaired.mcap");
    let mut copy = Copy::new(&to)?;
    let found = scan(bytes, |piece| match piece {
        Piece::Message(channel, header, data) => copy.message(0, channel, header, data),
        Piece::Attachment(header, data) => copy.attachment(header, data),
        Piece::Metadata(metadata) => copy.metadata(metadata),
    })?;
    copy.found(&found)?;
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
