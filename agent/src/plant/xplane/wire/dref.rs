//! DREF: writes a dataref. Nothing answers: an unknown or read-only dataref is passed over in silence.

use super::{Tag, WireError, begin, body_of_size, finish_with_text, path};

/// The message's letters.
pub const TAG: Tag = *b"DREF";
/// Length on the wire.
pub const SIZE: usize = 509;
/// Where the value stands: a message once written is sent again with another value.
const VALUE: std::ops::Range<usize> = 5..9;

/// Sets a dataref. X-Plane converts the number to the dataref's own type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Write<'a> {
    /// In the dataref's unit.
    pub value: f32,
    /// The dataref, an array's element as `path[n]`.
    pub path: &'a str,
}

impl<'a> Write<'a> {
    /// Reads a write; its path ends at the first NUL, and whatever pads the field is ignored.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &TAG, SIZE)?;
        Ok(Self { value: fields.finite_f32()?, path: path(fields.text())? })
    }

    /// Writes it; the path has at most 499 bytes.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        begin(out, &TAG, 0);
        out.extend(self.value.to_le_bytes());
        finish_with_text(out, self.path, SIZE)
    }
}

/// A write of one dataref that is sent again and again: only four bytes change.
#[derive(Clone, Debug)]
pub struct Template(Vec<u8>);

impl Template {
    /// For this dataref, of at most 499 bytes.
    pub fn new(path: &str) -> Result<Self, WireError> {
        let mut datagram = Vec::with_capacity(SIZE);
        Write { value: 0.0, path }.encode(&mut datagram)?;
        Ok(Self(datagram))
    }

    /// The datagram that writes `value`.
    pub fn with_value(&mut self, value: f32) -> &[u8] {
        // A template has SIZE bytes, so the field is there.
        if let Some(field) = self.0.get_mut(VALUE) {
            field.copy_from_slice(&value.to_le_bytes());
        }
        &self.0
    }
}
