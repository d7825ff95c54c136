//! DREF: writes a dataref. X-Plane sends no reply and ignores an unknown or read-only dataref.

use super::{Packed, Tag, WireError, begin, body_of_size, path, put_text};

/// Tag of the message.
pub const TAG: Tag = *b"DREF";
/// Length of the message, bytes.
pub const SIZE: usize = 509;
/// Position of the value in the message, so that a message can be sent again with another value.
const VALUE: std::ops::Range<usize> = 5..9;

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
        put_text(out, self.path, SIZE - VALUE.end - 1, SIZE - VALUE.end)
    }
}

/// An encoded write that is sent repeatedly with different values.
#[derive(Clone, Debug)]
pub struct Template(Vec<u8>);

impl Template {
    /// Encodes a write for this dataref, whose path has at most 499 bytes.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL.
    pub fn new(path: &str) -> Result<Self, WireError> {
        let mut datagram = Vec::with_capacity(SIZE);
        Write { value: 0.0, path }.encode(&mut datagram)?;
        Ok(Self(datagram))
    }

    /// The datagram that writes `value`.
    pub fn with_value(&mut self, value: f32) -> &[u8] {
        // A template has SIZE bytes, so the field exists.
        if let Some(field) = self.0.get_mut(VALUE) {
            field.copy_from_slice(&value.to_le_bytes());
        }
        &self.0
    }
}
