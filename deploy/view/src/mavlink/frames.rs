//! Frames of MAVLink 2 in datagrams, with signatures if there is a key.

use std::fs;
use std::path::Path;

use mavlink::dialects::common::MavMessage;
use mavlink::error::MessageReadError;
use mavlink::{MavHeader, MavlinkReader, SigningConfig, SigningData, write_v2_msg_signed};
use skein_lab::error::Error;

use skein_cluster::os;

/// Component of all our messages: an autopilot.
pub(super) const COMPONENT: u8 = 1;
/// Number of messages that are read from one datagram.
const MOST: usize = 64;

/// Writes and reads frames.
pub(super) struct Frames {
    /// Number of the next message of each system.
    sequences: [u8; 256],
    signing: Option<SigningData>,
}

impl Frames {
    /// Frames that are signed with this key, and received only if they are; without a key neither.
    pub(super) fn new(key: Option<[u8; 32]>) -> Self {
        let signing = key.map(|key| SigningData::from_config(SigningConfig::new(key, 0, true, false)));
        Self { sequences: [0; 256], signing }
    }

    /// The frame of a message of this system.
    pub(super) fn write(&mut self, system: u8, message: &MavMessage) -> Vec<u8> {
        let next = &mut self.sequences[usize::from(system)];
        let sequence = std::mem::replace(next, next.wrapping_add(1));
        let header = MavHeader { system_id: system.into(), component_id: COMPONENT, sequence };
        let mut frame = Vec::new();
        // Writing into growing memory cannot fail.
        let _ = write_v2_msg_signed(&mut frame, header, message, self.signing.as_ref());
        frame
    }

    /// The messages in a datagram: those that are whole, of this dialect, and signed if they have to be.
    pub(super) fn read(&self, datagram: &[u8]) -> Vec<(MavHeader, MavMessage)> {
        let mut reader = MavlinkReader::new(datagram);
        let mut messages = Vec::new();
        for _ in 0..MOST {
            match reader.read_any_message_signed(self.signing.as_ref()) {
                Ok(message) => messages.push(message),
                Err(MessageReadError::Parse(_)) => {}
                Err(_) => break,
            }
        }
        messages
    }
}

/// Reads the key of a file: 32 bytes that no other user can read.
///
/// # Errors
/// If the file cannot be read, has another length, or is open to other users.
pub(super) fn key(path: &Path) -> Result<[u8; 32], Error> {
    let name = path.display();
    let refused = |why: String| Error::Refused(format!("--mavlink-key {name}: {why}"));
    let bytes = fs::read(path).map_err(|error| refused(error.to_string()))?;
    let count = bytes.len();
    let key = bytes.try_into().map_err(|_| {
        refused(format!("{count} bytes, not 32; `openssl rand -out FILE 32` makes a key in a new file"))
    })?;
    match os::is_private(path) {
        Ok(true) => Ok(key),
        Ok(false) => Err(refused(format!("other users can read it: `chmod 600 {name}`"))),
        Err(error) => Err(refused(error.to_string())),
    }
}
