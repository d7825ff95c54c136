//! Copies messages, attachments and metadata of MCAP files into a new file, with each channel and schema once.
//!
//! Repairing and merging use it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use mcap::records::{AttachmentHeader, MessageHeader, Metadata};
use mcap::{Attachment, Channel};

use super::draft::Draft;
use super::scan::{Found, Piece};
use super::writer::options;
use super::{RecordError, format};

/// A new MCAP file that is written piece by piece and appears under its name when it is complete.
pub(super) struct Copy {
    mcap: mcap::Writer<BufWriter<File>>,
    /// Channel ids in the new file, by source file and channel id there.
    channels: BTreeMap<(usize, u16), u16>,
    attachments: Vec<(AttachmentHeader, Vec<u8>)>,
    metadata: Vec<Metadata>,
    draft: Draft,
}

impl Copy {
    pub(super) fn new(path: &Path) -> Result<Self, RecordError> {
        let draft = Draft::new(path);
        Ok(Self {
            mcap: options().create(BufWriter::new(draft.create()?))?,
            channels: BTreeMap::new(),
            attachments: Vec::new(),
            metadata: Vec::new(),
            draft,
        })
    }

    /// Copies a part of the source file with this index.
    pub(super) fn piece(&mut self, file: usize, piece: Piece<'_>) -> Result<(), RecordError> {
        match piece {
            Piece::Message(channel, header, data) => self.message(file, channel, header, data),
            Piece::Attachment(header, data) => self.attachment(header, data),
            Piece::Metadata(metadata) => self.metadata(metadata),
        }
    }

    /// Copies a message of the source file with this index.
    pub(super) fn message(
        &mut self,
        file: usize,
        channel: &Channel<'_>,
        header: MessageHeader,
        data: &[u8],
    ) -> Result<(), RecordError> {
        let channel_id = match self.channels.get(&(file, channel.id)) {
            Some(known) => *known,
            None => {
                let schema = channel.schema.as_ref();
                let schema = schema.map(|schema| self.mcap.add_schema(&schema.name, &schema.encoding, &schema.data));
                let schema = schema.transpose()?.unwrap_or(0);
                let Channel { topic, message_encoding, metadata, .. } = channel;
                let new = self.mcap.add_channel(schema, topic, message_encoding, metadata)?;
                self.channels.insert((file, channel.id), new);
                new
            }
        };
        Ok(self.mcap.write_to_known_channel(&MessageHeader { channel_id, ..header }, data)?)
    }

    /// Copies an attachment, unless the new file already has the same.
    fn attachment(&mut self, header: AttachmentHeader, data: &[u8]) -> Result<(), RecordError> {
        let is_same = |(other, theirs): &(AttachmentHeader, Vec<u8>)| other.name == header.name && theirs == data;
        if self.attachments.iter().any(is_same) {
            return Ok(());
        }
        let AttachmentHeader { log_time, create_time, name, media_type } = header.clone();
        self.mcap.attach(&Attachment { log_time, create_time, name, media_type, data: data.into() })?;
        self.attachments.push((header, data.to_vec()));
        Ok(())
    }

    /// Copies a metadata record, unless the new file already has the same.
    fn metadata(&mut self, metadata: Metadata) -> Result<(), RecordError> {
        if !self.metadata.contains(&metadata) {
            self.mcap.write_metadata(&metadata)?;
            self.metadata.push(metadata);
        }
        Ok(())
    }

    /// Adds metadata records about what the copied file with this index lacks, because a reader has to know.
    pub(super) fn found(&mut self, file: usize, found: &Found) -> Result<(), RecordError> {
        if found.is_cut || found.damaged > 0 {
            let entries = [
                ("file".to_owned(), file.to_string()),
                (format::PIECES.to_owned(), found.damaged.to_string()),
                (format::CUT.to_owned(), found.is_cut.to_string()),
            ];
            self.metadata(format::record(format::LACKS, entries.into()))?;
        }
        if found.damaged_outside_chunks == 0 {
            return Ok(());
        }
        let count = ("records".to_owned(), found.damaged_outside_chunks.to_string());
        self.metadata(format::record(format::DAMAGED, [count].into()))
    }

    pub(super) fn finish(mut self) -> Result<(), RecordError> {
        self.mcap.finish()?;
        let file = self.mcap.into_inner().into_inner().map_err(|error| self.draft.error(error.into_error()))?;
        self.draft.finish(&file)
    }
}
