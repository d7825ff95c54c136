//! RREF: subscriptions to values of datarefs, each identified by an index that the client chooses.

use super::{Packed, Tag, WireError, begin, body, body_of_size, path, put_text};

/// Tag of the message.
pub const TAG: Tag = *b"RREF";
/// Length of an encoded [`DatarefRequest`], bytes.
pub const REQUEST_SIZE: usize = 413;
/// Largest number of values in one datagram.
pub const MAX_VALUES: usize = 183;

/// Length of the field of a path, bytes.
const PATH: usize = 400;
/// Length of an encoded pair of index and value, bytes.
const PAIR: usize = 8;

/// Subscription to a dataref.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DatarefRequest<'a> {
    /// Values per second; 0 ends the subscription, whatever the path.
    pub frequency_hz: u32,
    /// Index that X-Plane returns with every value. A request with the same index replaces the subscription.
    pub index: i32,
    /// Path of the dataref; an array element is `path[n]`.
    pub path: &'a str,
}

impl<'a> DatarefRequest<'a> {
    /// Decodes a request; its path ends at the first NUL.
    ///
    /// # Errors
    /// If the datagram is not a request.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &TAG, REQUEST_SIZE)?;
        let frequency_hz = u32::try_from(fields.next::<i32>()?).map_err(|_| WireError::OutOfRange)?;
        Ok(Self { frequency_hz, index: fields.next()?, path: path(fields.text())? })
    }

    /// Encodes the request; the path has at most 399 bytes.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL, or the rate is out of range.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        begin(out, &TAG);
        i32::try_from(self.frequency_hz).map_err(|_| WireError::OutOfRange)?.write(out);
        self.index.write(out);
        put_text(out, self.path, PATH - 1, PATH)
    }
}

/// Decodes X-Plane's reply: pairs of index and value, in any order. A NaN is returned as it was sent, so that one bad
/// dataref does not affect the others.
///
/// # Errors
/// If the datagram is not a reply, or has a wrong length.
pub fn decode_values(datagram: &[u8]) -> Result<impl ExactSizeIterator<Item = (i32, f32)> + '_, WireError> {
    let (pairs, rest) = body(datagram, &TAG)?.as_chunks::<PAIR>();
    if !rest.is_empty() || pairs.len() > MAX_VALUES {
        return Err(WireError::WrongSize);
    }
    Ok(pairs
        .iter()
        .map(|&[a, b, c, d, e, f, g, h]| (i32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h]))))
}

/// Encodes a reply of at most [`MAX_VALUES`] pairs. The comma is the fifth byte that clients of X-Plane 11 and 12
/// check.
///
/// # Errors
/// If there are more pairs.
pub fn encode_values(pairs: &[(i32, f32)], out: &mut Vec<u8>) -> Result<(), WireError> {
    if pairs.len() > MAX_VALUES {
        return Err(WireError::WrongSize);
    }
    begin(out, &TAG);
    out[TAG.len()] = b',';
    for (index, value) in pairs {
        index.write(out);
        value.write(out);
    }
    Ok(())
}
