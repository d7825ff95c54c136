//! Reads the intact parts of an MCAP file, in the order in which they were written.
//!
//! The file may be cut off anywhere, or damaged. A chunk, an attachment or a metadata record with a wrong checksum is skipped, and
//! reading continues behind it. Messages are in chunks: a message outside a chunk has no checksum and is skipped. A record whose
//! length leads beyond the end of the file ends the reading.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use mcap::read::ChannelAccumulator;
use mcap::records::{AttachmentHeader, MessageHeader, Metadata, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Channel, MAGIC, McapError, parse_record};

use super::{RecordError, format};

/// Size of the largest plausible chunk, bytes: a damaged length must not allocate all memory.
const LARGEST_CHUNK: usize = 1 << 28;
/// Size of the prefix of a record, bytes: its kind and its length.
pub(super) const PREFIX: usize = 9;
/// Size of the record behind the last chunk, bytes.
const DATA_END: usize = 4;
/// Size of a checksum, bytes.
const CHECKSUM: usize = 4;
/// Offset of a chunk's uncompressed size, which its checksum follows, bytes.
const CHUNK_SIZE: usize = 16;

/// One intact part of a file.
pub(super) enum Piece<'a> {
    /// A message with its channel.
    Message(&'a Arc<Channel<'static>>, MessageHeader, &'a [u8]),
    /// A file within the file.
    Attachment(AttachmentHeader, &'a [u8]),
    /// A metadata record about the whole file.
    Metadata(Metadata),
}

/// The condition of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Found {
    /// Whether the file is complete and undamaged.
    pub(super) is_whole: bool,
    /// Whether the file ends before its end: it was cut off, or it is still being written.
    pub(super) is_cut: bool,
    /// Number of damaged chunks and records, which were skipped.
    pub(super) damaged: usize,
    /// Number of damaged records outside chunks, which may have been metadata.
    pub(super) damaged_outside_chunks: usize,
    /// Number of bytes of an incomplete record at the end.
    pub(super) left_over: usize,
}

/// Hands every intact part of the file at `path` to `take` and returns the condition of the file.
///
/// # Errors
/// The file cannot be read, it is not an MCAP file, or `take` fails.
pub(super) fn scan_file(
    path: &Path,
    take: impl FnMut(Piece<'_>) -> Result<(), RecordError>,
) -> Result<Found, RecordError> {
    let bytes = fs::read(path).map_err(|error| RecordError::Io { path: path.to_owned(), error })?;
    scan(&bytes, take)
}

/// Hands every intact part of these bytes to `take`, as [`scan_file`] does.
pub(super) fn scan(bytes: &[u8], take: impl FnMut(Piece<'_>) -> Result<(), RecordError>) -> Result<Found, RecordError> {
    let mut rest = bytes.strip_prefix(MAGIC).ok_or(RecordError::NoMcap)?;
    let mut scanner = Scanner { take, channels: ChannelAccumulator::default(), have_checksums: false };
    let mut found = Found::default();
    while let Some((kind, content, behind)) = split_record(rest) {
        let taken = match kind {
            op::DATA_END if content.len() == DATA_END => {
                let ends_well = behind.ends_with(MAGIC);
                return Ok(Found { is_whole: ends_well && found.damaged == 0, is_cut: !ends_well, ..found });
            }
            op::CHUNK => has_checksum(content) && scanner.read_chunk(&rest[..PREFIX + content.len()])?,
            op::METADATA => scanner.read_metadata(content)?,
            op::MESSAGE => false,
            _ => scanner.read_record(kind, content)?,
        };
        found.damaged += usize::from(!taken);
        found.damaged_outside_chunks += usize::from(!taken && kind != op::CHUNK);
        rest = behind;
    }
    Ok(Found { left_over: rest.len(), is_cut: true, ..found })
}

/// Splits the first record off: its kind, its content and the bytes behind it; `None` if the record is incomplete.
fn split_record(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (prefix, rest) = bytes.split_at_checked(PREFIX)?;
    let length = u64::from_le_bytes(prefix[1..].try_into().ok()?);
    let (content, behind) = rest.split_at_checked(usize::try_from(length).ok()?)?;
    Some((prefix[0], content, behind))
}

/// Whether a chunk has a checksum. The checksum of an empty chunk is 0.
fn has_checksum(chunk: &[u8]) -> bool {
    let is_nonzero =
        |range: std::ops::Range<usize>| chunk.get(range).is_some_and(|bytes| bytes.iter().any(|byte| *byte != 0));
    let is_empty = !is_nonzero(CHUNK_SIZE..CHUNK_SIZE + 8);
    is_empty || is_nonzero(CHUNK_SIZE + 8..CHUNK_SIZE + 12)
}

/// Parses the content of a record of this kind.
///
/// # Errors
/// If the content is not such a record.
pub(super) fn parse_content(kind: u8, content: &[u8]) -> Result<Record<'_>, McapError> {
    // The crate `mcap` does not check that an attachment has room for its checksum.
    if kind == op::ATTACHMENT && attachment_fields(content).is_none_or(|length| content.len() < length + CHECKSUM) {
        return Err(McapError::UnexpectedEof);
    }
    parse_record(kind, content)
}

/// Length of the fields before an attachment's data, bytes: two times, two texts with their lengths, and the length of the data.
fn attachment_fields(content: &[u8]) -> Option<usize> {
    let behind_text = |at: usize| {
        let length = content.get(at..)?.first_chunk().copied().map(u32::from_le_bytes)?;
        at.checked_add(4)?.checked_add(usize::try_from(length).ok()?)
    };
    behind_text(behind_text(2 * 8)?)?.checked_add(8)
}

/// Hands what it reads to `take`.
struct Scanner<Take> {
    take: Take,
    channels: ChannelAccumulator<'static>,
    /// Whether a metadata record had a checksum.
    have_checksums: bool,
}

impl<Take: FnMut(Piece<'_>) -> Result<(), RecordError>> Scanner<Take> {
    /// Hands a metadata record to `take`. Returns false if the record is damaged: its checksum is wrong, or it has none although an
    /// earlier record has one.
    fn read_metadata(&mut self, content: &[u8]) -> Result<bool, RecordError> {
        let Ok(Record::Metadata(metadata)) = parse_content(op::METADATA, content) else { return Ok(false) };
        let is_intact = format::is_intact(&metadata);
        self.have_checksums |= is_intact.is_some();
        if !is_intact.unwrap_or(!self.have_checksums) {
            return Ok(false);
        }
        (self.take)(Piece::Metadata(metadata))?;
        Ok(true)
    }

    /// Hands the contents of a chunk to `take`. Returns false if the chunk is damaged.
    fn read_chunk(&mut self, record: &[u8]) -> Result<bool, RecordError> {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(LARGEST_CHUNK);
        let mut reader = LinearReader::new_with_options(options);
        let (mut rest, mut is_good) = (record, true);
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(_)) if rest.is_empty() => break,
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let (next, behind) = rest.split_at(wanted.min(rest.len()));
                    reader.insert(next.len()).copy_from_slice(next);
                    reader.notify_read(next.len());
                    rest = behind;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => is_good &= self.read_record(opcode, data)?,
                Err(_) => return Ok(false),
            }
        }
        Ok(is_good)
    }

    /// Hands one record that is neither a chunk nor metadata to `take`. Returns false if the record is damaged or of an unknown kind.
    fn read_record(&mut self, kind: u8, content: &[u8]) -> Result<bool, RecordError> {
        let Ok(record) = parse_content(kind, content) else { return Ok(false) };
        match record {
            Record::Schema { header, data } => {
                return Ok(self.channels.add_schema(header, data.into_owned().into()).is_ok());
            }
            Record::Channel(channel) => return Ok(self.channels.add_channel(channel).is_ok()),
            Record::Message { header, data } => match self.channels.get(header.channel_id) {
                Some(channel) => (self.take)(Piece::Message(&channel, header, &data))?,
                None => return Ok(false),
            },
            Record::Attachment { crc: 0, .. } | Record::Unknown { .. } => return Ok(false),
            Record::Attachment { header, data, .. } => (self.take)(Piece::Attachment(header, &data))?,
            _ => {}
        }
        Ok(true)
    }
}
