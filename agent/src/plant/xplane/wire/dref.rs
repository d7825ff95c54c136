//! DREF: writes a dataref. X-Plane sends no reply and ignores an unknown or read-only dataref.

use super::{Packed, Tag, WireError, begin, body_of_size, path, put_text};

/// Tag of the message.
pub const TAG: Tag = *b"DREF";
/// Length of the message, bytes.
pub const SIZE: usize = 509;
/// Length of the field of a path, bytes.
const PATH: usize = 500;

/// A write to a dataref. X-Plane converts the number to the dataref's own type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Write<'a> {
    /// The value, in the dataref's unit.
    pub value: f32,
    /// Path of the dataref; an array element is `path[n]`.
    pub path: &'a str,
}

impl<'a> Write<'a> {
    /// Decodes a write; its path ends at the first NUL, and padding after it is ignored.
    ///
    /// # Errors
    /// If the datagram is not a write.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &TAG, SIZE)?;
        Ok(Self { value: fields.next()?, path: path(fields.text())? })
    }

    /// Encodes the write; the path has at most 499 bytes.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        begin(out, &TAG);
        self.value.write(out);
        put_text(out, self.path, PATH - 1, PATH)
    }
}
