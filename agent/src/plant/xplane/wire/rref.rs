//! RREF: values of datarefs, one subscription each, told apart by an index of the client's choice.

use super::{Tag, WireError, begin, body, body_of_size, finish_with_text, path};

/// The message's letters.
pub const TAG: Tag = *b"RREF";
/// Length of [`Request`] on the wire.
pub const REQUEST_SIZE: usize = 413;
/// X-Plane puts no more values into one datagram.
pub const MAX_VALUES: usize = 183;

/// Bytes of one value.
const PAIR: usize = 8;

/// Asks for a dataref this many times a second; 0 ends it, whatever the path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request<'a> {
    /// Values a second.
    pub frequency_hz: u32,
    /// Stands in every answer. The same index again replaces the subscription.
    pub index: i32,
    /// The dataref, an array's element as `path[n]`.
    pub path: &'a str,
}

impl<'a> Request<'a> {
    /// Reads a request; its path ends at the first NUL.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &TAG, REQUEST_SIZE)?;
        let frequency_hz = u32::try_from(fields.i32()?).map_err(|_| WireError::OutOfRange)?;
        Ok(Self { frequency_hz, index: fields.i32()?, path: path(fields.text())? })
    }

    /// Writes the request; the path has at most 399 bytes.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        begin(out, &TAG, 0);
        let frequency_hz = i32::try_from(self.frequency_hz).map_err(|_| WireError::OutOfRange)?;
        out.extend(frequency_hz.to_le_bytes());
        out.extend(self.index.to_le_bytes());
        finish_with_text(out, self.path, REQUEST_SIZE)
    }
}

/// Reads X-Plane's answer: pairs of index and value, in any order. The values are as sent, NaN included: one bad dataref
/// does not spoil the others.
pub fn decode_values(datagram: &[u8]) -> Result<impl ExactSizeIterator<Item = (i32, f32)> + '_, WireError> {
    let (pairs, rest) = body(datagram, &TAG)?.as_chunks::<PAIR>();
    if !rest.is_empty() || pairs.len() > MAX_VALUES {
        return Err(WireError::WrongSize);
    }
    Ok(pairs
        .iter()
        .map(|&[a, b, c, d, e, f, g, h]| (i32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h]))))
}

/// Writes an answer of at most [`MAX_VALUES`] pairs. The comma is the fifth byte that clients of X-Plane 11 and 12 check.
pub fn encode_values(pairs: &[(i32, f32)], out: &mut Vec<u8>) -> Result<(), WireError> {
    if pairs.len() > MAX_VALUES {
        return Err(WireError::WrongSize);
    }
    begin(out, &TAG, b',');
    for (index, value) in pairs {
        out.extend(index.to_le_bytes());
        out.extend(value.to_le_bytes());
    }
    Ok(())
}
