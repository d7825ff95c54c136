//! CMND: runs a command; QUIT and SHUT: end X-Plane and the computer.

use super::{Fields, Tag, WireError, begin, body, path, put_text};

/// Tag of a [`Command`].
pub const CMND: Tag = *b"CMND";
/// Tags of the messages that end X-Plane and shut the computer down. Skein never sends them.
pub const ENDS: [Tag; 2] = [*b"QUIT", *b"SHUT"];
/// Longest path, bytes.
const MAX_PATH: usize = 499;

/// Runs a command once, as if a key had been pressed and released.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command<'a> {
    /// Path of the command.
    pub path: &'a str,
}

impl<'a> Command<'a> {
    /// Decodes a command; its path ends at the first NUL or with the datagram.
    ///
    /// # Errors
    /// If the datagram is not a command, or its path is empty or not printable.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let text = Fields(body(datagram, &CMND)?).text();
        if text.is_empty() { Err(WireError::NotText) } else { Ok(Self { path: path(text)? }) }
    }

    /// Encodes the command, with a NUL behind its path of at most 499 bytes.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        begin(out, &CMND);
        put_text(out, self.path, MAX_PATH, self.path.len() + 1)
    }
}
