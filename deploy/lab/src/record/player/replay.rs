//! Replays the messages of a recording: every channel with its own schema, every message with its own log time.

use std::collections::BTreeMap;

use mcap::sans_io::indexed_reader::ReadOrder;

use super::{Player, RecordError};
use crate::record::channels::Sink;
use crate::record::format;

/// An instant is shown by the messages of this time before it, ns: every vehicle makes a step, 10 times a second or
/// more.
const SHOWN_NS: u64 = 500_000_000;

/// Replays a recording into a sink.
pub struct Replay<S> {
    player: Player,
    sink: S,
    /// The sink's number of each topic.
    channels: BTreeMap<String, u16>,
}

impl<S: Sink> Replay<S> {
    /// Adds the recording's channels to the sink.
    ///
    /// # Errors
    /// A schema of the recording is missing, or the sink does not take a channel.
    pub fn new(player: Player, mut sink: S) -> Result<Self, RecordError> {
        let mut channels = BTreeMap::new();
        let mut recorded: Vec<_> = player.summary.channels.values().cloned().collect();
        recorded.sort_by_key(|channel| channel.id);
        for channel in recorded {
            let schema = channel.schema.as_ref().ok_or(RecordError::Missing("a schema"))?;
            let schema = sink.add_schema(&schema.name, &schema.encoding, &schema.data)?;
            let number = sink.add_channel(&channel.topic, schema, &channel.message_encoding)?;
            channels.insert(channel.topic.clone(), number);
        }
        Ok(Self { player, sink, channels })
    }

    /// Puts every message after the first of these log times, up to the second, into the sink, in the order of time, ns.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn play(&mut self, after_ns: u64, to_ns: u64) -> Result<(), RecordError> {
        let topics: Vec<String> = self.read().map(|(topic, _)| topic.clone()).collect();
        self.put(&topics, (after_ns.saturating_add(1), to_ns), ReadOrder::LogTime, usize::MAX)
    }

    /// Puts into the sink what shows this log time, ns: what is drawn then, and what was recorded just before.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn show(&mut self, at_ns: u64) -> Result<(), RecordError> {
        for topic in [format::VEHICLES, format::FORMATION] {
            self.put(&[topic.to_owned()], (0, at_ns), ReadOrder::ReverseLogTime, 1)?;
        }
        let is_state = |topic: &&String| ![format::VEHICLES, format::FORMATION].contains(&topic.as_str());
        let topics: Vec<String> = self.read().map(|(topic, _)| topic).filter(is_state).cloned().collect();
        self.put(&topics, (at_ns.saturating_sub(SHOWN_NS), at_ns), ReadOrder::LogTime, usize::MAX)
    }

    /// The topics that have a reader.
    fn read(&self) -> impl Iterator<Item = (&String, &u16)> {
        self.channels.iter().filter(|(_, channel)| self.sink.is_read(**channel))
    }

    /// Puts at most so many messages on these topics, between two log times, into the sink.
    fn put(
        &mut self,
        topics: &[String],
        within_ns: (u64, u64),
        order: ReadOrder,
        most: usize,
    ) -> Result<(), RecordError> {
        let Self { player, sink, channels } = self;
        let mut count = 0;
        player.visit(topics, within_ns, order, |topic, log_time_ns, data| {
            if let Some(channel) = channels.get(topic) {
                sink.put(*channel, log_time_ns, data);
            }
            count += 1;
            Ok(count < most)
        })
    }
}
