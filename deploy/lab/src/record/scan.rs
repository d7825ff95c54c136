//! Reading whatever is whole of an MCAP file, in the order in which it was written, up to where it ends.
//!
//! The file is taken as it is: cut off anywhere, or damaged. A chunk counts if its checksum is right, and so does an attachment
//! and a metadata record; a damaged one is left out, and reading goes on behind it. Messages stand in chunks: outside of them
//! nothing shows that they are what was written. A record whose length leads beyond the end is where the file ends.

use std::sync::Arc;

use mcap::read::ChannelAccumulator;
use mcap::records::{AttachmentHeader, MessageHeader, Metadata, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Channel, MAGIC, parse_record};

use super::{RecordError, format};

/// A larger chunk is none of anybody's, bytes: a damaged length must not ask for all memory.
const LARGEST_CHUNK: usize = 1 << 28;
/// Bytes before a record's content: its kind and its length.
const PREFIX: usize = 9;
/// Bytes of the record behind the last chunk.
const DATA_END: usize = 4;
/// Where a chunk says how long it is unpacked, and, after that, its checksum.
const CHUNK_SIZE: usize = 16;

/// One thing in a file.
pub(super) enum Piece<'a> {
    /// A message with its channel.
    Message(&'a Arc<Channel<'static>>, MessageHeader, &'a [u8]),
    /// A file within the file.
    Attachment(AttachmentHeader, &'a [u8]),
    /// Words about the whole.
    Metadata(Metadata),
}

/// What was found besides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Found {
    /// The file ends as it should, and nothing in it is damaged.
    pub(super) is_whole: bool,
    /// Damaged chunks and records, left out.
    pub(super) damaged: usize,
    /// Those of them that may have been anything, also what tells of the whole.
    pub(super) damaged_outside_chunks: usize,
    /// Bytes at the end that are no whole record.
    pub(super) left_over: usize,
}

/// Hands everything that is whole to `take`.
///
/// # Errors
/// If this is no MCAP file at all, or `take` fails.
pub(super) fn scan(
    bytes: &[u8],
    mut take: impl FnMut(Piece<'_>) -> Result<(), RecordError>,
) -> Result<Found, RecordError> {
    let mut rest = bytes.strip_prefix(MAGIC).ok_or(RecordError::NoMcap)?;
    let mut channels = ChannelAccumulator::default();
    let (mut found, mut have_checksums) = (Found::default(), false);
    while let Some((kind, content, behind)) = split(rest) {
        let taken = match kind {
            op::DATA_END if content.len() == DATA_END => {
                let ends_well = behind.ends_with(MAGIC);
                return Ok(Found { is_whole: ends_well && found.damaged == 0, ..found });
            }
            op::CHUNK => has_checksum(content) && unpack(&rest[..PREFIX + content.len()], &mut channels, &mut take)?,
            op::METADATA => pass_on_metadata(content, &mut have_checksums, &mut take)?,
            op::MESSAGE => false,
            _ => pass_on(kind, content, &mut channels, &mut take)?,
        };
        found.damaged += usize::from(!taken);
        found.damaged_outside_chunks += usize::from(!taken && kind != op::CHUNK);
        rest = behind;
    }
    Ok(Found { left_over: rest.len(), ..found })
}

/// The first record's kind and content, and what stands behind it; `None` if it is not all there.
fn split(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (prefix, rest) = bytes.split_at_checked(PREFIX)?;
    let length = u64::from_le_bytes(prefix[1..].try_into().ok()?);
    let (content, behind) = rest.split_at_checked(usize::try_from(length).ok()?)?;
    Some((prefix[0], content, behind))
}

/// Whether a chunk says what its content has to add up to. One that holds nothing adds up to 0.
fn has_checksum(chunk: &[u8]) -> bool {
    let number =
        |range: std::ops::Range<usize>| chunk.get(range).is_some_and(|bytes| bytes.iter().any(|byte| *byte != 0));
    let is_empty = !number(CHUNK_SIZE..CHUNK_SIZE + 8);
    is_empty || number(CHUNK_SIZE + 8..CHUNK_SIZE + 12)
}

/// Hands on a metadata record. False if it is damaged: its checksum is wrong, or it has none where those before it have.
fn pass_on_metadata(
    content: &[u8],
    have_checksums: &mut bool,
    take: &mut impl FnMut(Piece<'_>) -> Result<(), RecordError>,
) -> Result<bool, RecordError> {
    let Ok(Record::Metadata(metadata)) = parse_record(op::METADATA, content) else { return Ok(false) };
    let is_intact = format::is_intact(&metadata);
    *have_checksums |= is_intact.is_some();
    if !is_intact.unwrap_or(!*have_checksums) {
        return Ok(false);
    }
    take(Piece::Metadata(metadata))?;
    Ok(true)
}

/// Hands on what stands in a chunk. False if that is damaged.
fn unpack(
    record: &[u8],
    channels: &mut ChannelAccumulator<'static>,
    take: &mut impl FnMut(Piece<'_>) -> Result<(), RecordError>,
) -> Result<bool, RecordError> {
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
            Ok(LinearReadEvent::Record { data, opcode }) => is_good &= pass_on(opcode, data, channels, take)?,
            Err(_) => return Ok(false),
        }
    }
    Ok(is_good)
}

/// Hands on one record that is neither chunk nor metadata. False if it is damaged or of no known kind.
fn pass_on(
    kind: u8,
    content: &[u8],
    channels: &mut ChannelAccumulator<'static>,
    take: &mut impl FnMut(Piece<'_>) -> Result<(), RecordError>,
) -> Result<bool, RecordError> {
    let Ok(record) = parse_record(kind, content) else { return Ok(false) };
    match record {
        Record::Schema { header, data } => return Ok(channels.add_schema(header, data.into_owned().into()).is_ok()),
        Record::Channel(channel) => return Ok(channels.add_channel(channel).is_ok()),
        Record::Message { header, data } => match channels.get(header.channel_id) {
            Some(channel) => take(Piece::Message(&channel, header, &data))?,
            None => return Ok(false),
        },
        Record::Attachment { crc: 0, .. } => return Ok(false),
        Record::Attachment { header, data, .. } => take(Piece::Attachment(header, &data))?,
        Record::Unknown { .. } => return Ok(false),
        _ => {}
    }
    Ok(true)
}
