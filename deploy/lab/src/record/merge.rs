//! Merges recordings, for example of several hosts.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::Channel;
use mcap::records::MessageHeader;

use super::RecordError;
use super::copy::Copy;
use super::scan::{Piece, scan};

/// A message with the index of its file.
struct FileMessage {
    file: usize,
    channel: Arc<Channel<'static>>,
    header: MessageHeader,
    data: Vec<u8>,
}

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
        let bytes = fs::read(path).map_err(|error| RecordError::Io { path: path.clone(), error })?;
        let found = scan(&bytes, |piece| match piece {
            Piece::Message(channel, header, data) => {
                messages.push(FileMessage { file, channel: channel.clone(), header, data: data.to_vec() });
                Ok(())
            }
            Piece::Attachment(header, data) => copy.attachment(header, data),
            Piece::Metadata(metadata) => copy.metadata(metadata),
        })
        .map_err(|error| error.reading(path))?;
        copy.found(file, &found)?;
    }
    // A stable sort: messages of one instant stay in the order of the files.
    messages.sort_by_key(|one| one.header.log_time);
    for FileMessage { file, channel, header, data } in &messages {
        copy.message(*file, channel, *header, data)?;
    }
    copy.finish()?;
    Ok(messages.len() as u64)
}
