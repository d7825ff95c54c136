//! Merges recordings, for example of several hosts.

use std::path::{Path, PathBuf};

use super::RecordError;
use super::copy::Copy;
use super::scan::{Piece, scan_file};

/// Merges files into `to` and returns the number of messages.
///
/// Messages are in the order of log time, and those of one instant in the order of the files. Equal schemas, channels,
/// attachments and metadata records are written once. A file that is cut off is read up to its end. All messages are
/// held in memory.
///
/// # Errors
/// A file is not an MCAP file or cannot be read, or `to` cannot be written.
pub fn merge(files: &[PathBuf], to: &Path) -> Result<u64, RecordError> {
    let mut copy = Copy::new(to)?;
    let mut messages = Vec::new();
    for (file, path) in files.iter().enumerate() {
        let found = scan_file(path, |piece| match piece {
            Piece::Message(channel, header, data) => {
                messages.push((file, channel.clone(), header, data.to_vec()));
                Ok(())
            }
            piece => copy.piece(file, piece),
        })
        .map_err(|error| error.reading(path))?;
        copy.found(file, &found)?;
    }
    // A stable sort: messages of one instant stay in the order of the files.
    messages.sort_by_key(|(_, _, header, _)| header.log_time);
    for (file, channel, header, data) in &messages {
        copy.message(*file, channel, *header, data)?;
    }
    copy.finish()?;
    Ok(messages.len() as u64)
}
