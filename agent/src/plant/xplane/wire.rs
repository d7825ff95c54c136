//! X-Plane's datagrams, byte for byte: each is read into a value and written from one, and nothing else happens here.
//!
//! All numbers are little-endian, structs are packed, the first four bytes are the tag. The fifth byte differs between
//! versions and clients: it is ignored on input. Decoders take any bytes whatever and answer with a [`WireError`].
//!
//! | module | to X-Plane | from X-Plane |
//! | --- | --- | --- |
//! | [`becn`] | – | here is an X-Plane |
//! | [`rpos`] | send me the position | the position |
//! | [`rref`] | send me a dataref | values of datarefs |
//! | [`dref`] | write a dataref | – |
//! | [`prel`] | place an aircraft | – |
//!
//! Layouts: Laminar Research, "Exchanging Data with X-Plane"; where the wire differs from that text (the beacon's name,
//! the padding of paths), what clients in the field see.

pub mod becn;
pub mod dref;
pub mod prel;
pub mod rpos;
pub mod rref;

#[cfg(test)]
mod tests;

/// The UDP port on which X-Plane receives everything, unless its user changed it.
pub const PORT: u16 = 49000;

/// The largest datagram there can be. Those of this protocol are far smaller, but where a buffer is too small Windows
/// reports a fault instead of a datagram to refuse.
pub const MAX_DATAGRAM: usize = 65_536;

/// Why a datagram was refused, or could not be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The first four bytes are another message's.
    #[error("another message's tag")]
    WrongTag,
    /// The message never has this length.
    #[error("wrong length")]
    WrongSize,
    /// A text field holds something else.
    #[error("not the text expected here")]
    NotText,
    /// A number is infinite or not a number.
    #[error("a number that is not finite")]
    NonFinite,
    /// A number outside what the field can mean.
    #[error("a number out of range")]
    OutOfRange,
    /// A text that its field cannot hold.
    #[error("a text too long for its field")]
    TooLong,
    /// A version of the message whose layout is unknown.
    #[error("a version of this message that is not known")]
    Incompatible,
}

/// A message's four letters, without the fifth byte.
pub type Tag = [u8; 4];

/// What follows the tag and its fifth byte.
fn body<'a>(datagram: &'a [u8], tag: &Tag) -> Result<&'a [u8], WireError> {
    let (found, rest) = datagram.split_first_chunk::<4>().ok_or(WireError::WrongSize)?;
    if found != tag {
        return Err(WireError::WrongTag);
    }
    rest.get(1..).ok_or(WireError::WrongSize)
}

/// The same for a message that has one length only, `total` bytes.
fn body_of_size<'a>(datagram: &'a [u8], tag: &Tag, total: usize) -> Result<Fields<'a>, WireError> {
    let body = body(datagram, tag)?;
    if datagram.len() == total { Ok(Fields(body)) } else { Err(WireError::WrongSize) }
}

/// Takes fields off the front.
struct Fields<'a>(&'a [u8]);

macro_rules! little_endian {
    ($($number:ident)*) => {
        $(fn $number(&mut self) -> Result<$number, WireError> {
            Ok($number::from_le_bytes(self.array()?))
        })*
    };
}

impl<'a> Fields<'a> {
    little_endian! { u8 u16 u32 i32 }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let (field, rest) = self.0.split_first_chunk::<N>().ok_or(WireError::WrongSize)?;
        self.0 = rest;
        Ok(*field)
    }

    fn finite_f32(&mut self) -> Result<f32, WireError> {
        let value = f32::from_le_bytes(self.array()?);
        if value.is_finite() { Ok(value) } else { Err(WireError::NonFinite) }
    }

    fn finite_f64(&mut self) -> Result<f64, WireError> {
        let value = f64::from_le_bytes(self.array()?);
        if value.is_finite() { Ok(value) } else { Err(WireError::NonFinite) }
    }

    /// The rest, up to its first NUL; whatever pads the field after it is of no interest.
    fn text(self) -> &'a [u8] {
        self.0.split(|&byte| byte == 0).next().unwrap_or_default()
    }
}

/// Starts a message in a buffer that is used again and again.
fn begin(out: &mut Vec<u8>, tag: &Tag, fifth_byte: u8) {
    out.clear();
    out.extend_from_slice(tag);
    out.push(fifth_byte);
}

/// Appends a text, and NULs up to the `total` length of the message; at least one NUL follows the text.
fn finish_with_text(out: &mut Vec<u8>, text: &str, total: usize) -> Result<(), WireError> {
    if text.contains('\0') {
        return Err(WireError::NotText);
    }
    if out.len() + text.len() >= total {
        return Err(WireError::TooLong);
    }
    out.extend_from_slice(text.as_bytes());
    out.resize(total, 0);
    Ok(())
}

/// A dataref's path as it stands in a message: printable ASCII.
fn path(text: &[u8]) -> Result<&str, WireError> {
    match std::str::from_utf8(text) {
        Ok(path) if path.bytes().all(|byte| byte.is_ascii_graphic()) => Ok(path),
        _ => Err(WireError::NotText),
    }
}
