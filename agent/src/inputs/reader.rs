//! Reads a file of inputs, step by step.

use skein_core::agent::Outputs;
use skein_core::station::StepInputs;

use super::{CHECKSUM, Flown, InputsError, MAGIC, VERSION, checksum, encoded};

/// One step of a file of inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedStep {
    /// The inputs that entered the station.
    pub inputs: StepInputs,
    /// The outputs that left it; `None` if the core panicked in this step, or if the file ends here.
    pub outputs: Option<Outputs>,
}

/// A file of inputs.
#[derive(Clone, Debug)]
pub struct InputsReader<'a> {
    /// The first chunk: what flies.
    pub flown: Flown,
    file: &'a [u8],
    /// The first byte after the current chunk.
    next: usize,
    /// The rest of the current chunk.
    content: &'a [u8],
    /// Whether the file ends within a chunk. Known when the last step was read.
    pub is_cut_off: bool,
}

impl<'a> InputsReader<'a> {
    /// Begins to read a file.
    ///
    /// # Errors
    /// The file is of another kind or version, or what flies is damaged.
    pub fn new(file: &'a [u8]) -> Result<Self, InputsError> {
        let after_magic = file.strip_prefix(&MAGIC).ok_or(InputsError::OtherKind)?;
        let (version, _) = after_magic.split_first_chunk().ok_or(InputsError::Empty)?;
        match u16::from_le_bytes(*version) {
            VERSION => {}
            other => return Err(InputsError::OtherVersion(other)),
        }
        let begin = MAGIC.len() + version.len();
        let (content, next) = chunk_at(file, begin)?.ok_or(InputsError::Empty)?;
        let flown = postcard::from_bytes(content).map_err(|_| InputsError::Undecodable(begin))?;
        Ok(Self { flown, file, next, content: &[], is_cut_off: false })
    }

    /// The next step; `None` at the end of the file, wherever it was cut off.
    ///
    /// # Errors
    /// The file is damaged here.
    pub fn next_step(&mut self) -> Result<Option<RecordedStep>, InputsError> {
        let Some(inputs) = self.next_value()? else { return Ok(None) };
        // A step's outputs stand in the same chunk as its inputs, unless the core panicked.
        let outputs = if self.content.is_empty() { None } else { self.next_value()? };
        Ok(Some(RecordedStep { inputs, outputs }))
    }

    fn next_value<T: serde::de::DeserializeOwned>(&mut self) -> Result<Option<T>, InputsError> {
        if self.content.is_empty() {
            let Some((content, next)) = chunk_at(self.file, self.next)? else {
                self.is_cut_off = self.next < self.file.len();
                return Ok(None);
            };
            (self.content, self.next) = (content, next);
        }
        let at = self.next - self.content.len();
        let (value, rest) = postcard::take_from_bytes(self.content).map_err(|_| InputsError::Undecodable(at))?;
        self.content = rest;
        Ok(Some(value))
    }
}

impl RecordedStep {
    /// Whether the station gave exactly these outputs: compared as bytes, so that every bit of every number counts.
    pub fn has_outputs(&self, outputs: &Outputs) -> bool {
        self.outputs.as_ref().is_some_and(|recorded| encoded(recorded) == encoded(outputs))
    }
}

/// The content of the chunk that begins at this byte, and the first byte after it; `None` if the file ends before that.
fn chunk_at(file: &[u8], begin: usize) -> Result<Option<(&[u8], usize)>, InputsError> {
    let rest = file.get(begin..).unwrap_or_default();
    let Some((length, rest)) = rest.split_first_chunk() else { return Ok(None) };
    let Some((expected, rest)) = rest.split_first_chunk::<CHECKSUM>() else { return Ok(None) };
    let Some(content) = rest.get(..u32::from_le_bytes(*length) as usize) else { return Ok(None) };
    let end = begin + length.len() + CHECKSUM + content.len();
    if checksum(content) != *expected {
        return Err(InputsError::Damaged(begin, end));
    }
    Ok(Some((content, end)))
}
