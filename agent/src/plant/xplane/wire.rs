//! Encodes and decodes X-Plane's datagrams, and does nothing else.
//!
//! All numbers are little-endian, structs are packed, the first four bytes are the tag. The fifth byte differs between
//! versions and clients and is ignored on input. Decoders accept arbitrary bytes and return a [`WireError`].
//!
//! | module | to X-Plane | from X-Plane |
//! | --- | --- | --- |
//! | [`becn`] | – | announce an X-Plane |
//! | [`rpos`] | send me the position | the position |
//! | [`rref`] | send me a dataref | values of datarefs |
//! | [`dref`] | write a dataref | – |
//! | [`prel`] | place an aircraft | – |
//! | [`aircraft`] | set its pose, load it, load and place it | – |
//! | [`rows`] | write rows of numbers, select rows, name their receiver | rows of numbers |
//! | [`operation`] | run a command, save or load a situation, show a message, end X-Plane | – |
//! | [`radr`] | send me the weather radar | its points |
//!
//! Layouts: Laminar Research, "Exchanging Data with X-Plane". Where X-Plane deviates from that text (the beacon's name,
//! the padding of paths), the code follows what clients receive.

pub mod aircraft;
pub mod becn;
pub mod dref;
pub mod operation;
pub mod prel;
pub mod radr;
pub mod rows;
pub mod rpos;
pub mod rref;

#[cfg(test)]
mod tests;

/// UDP port on which X-Plane receives everything, unless its user has changed it.
pub const PORT: u16 = 49000;

/// Largest possible datagram, bytes. Those of this protocol are far smaller, but Windows reports an error instead of a
/// datagram that does not fit into the buffer.
pub const MAX_DATAGRAM: usize = 65_536;

/// Why a datagram was refused, or could not be encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The first four bytes are those of another message.
    #[error("the tag of another message")]
    WrongTag,
    /// The message never has this length.
    #[error("wrong length")]
    WrongSize,
    /// A text field holds other bytes.
    #[error("not the text expected here")]
    NotText,
    /// A number is infinite or not a number.
    #[error("a number that is not finite")]
    NonFinite,
    /// A number is outside the range of its field.
    #[error("a number out of range")]
    OutOfRange,
    /// A text does not fit into its field.
    #[error("a text too long for its field")]
    TooLong,
    /// The message has a version with an unknown layout.
    #[error("an unknown version of this message")]
    Incompatible,
}

/// The four letters that identify a message, without the fifth byte.
pub type Tag = [u8; 4];

/// The bytes after the tag and the fifth byte.
fn body<'a>(datagram: &'a [u8], tag: &Tag) -> Result<&'a [u8], WireError> {
    let (found, rest) = datagram.split_first_chunk::<4>().ok_or(WireError::WrongSize)?;
    if found != tag {
        return Err(WireError::WrongTag);
    }
    rest.get(1..).ok_or(WireError::WrongSize)
}

/// The bytes after the tag and the fifth byte of a message with a fixed length of `total` bytes.
fn body_of_size<'a>(datagram: &'a [u8], tag: &Tag, total: usize) -> Result<Fields<'a>, WireError> {
    let body = body(datagram, tag)?;
    if datagram.len() == total { Ok(Fields(body)) } else { Err(WireError::WrongSize) }
}

/// Reads fields from the front of a message.
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

    /// The next bytes up to the first NUL among them, of a text field of this length.
    fn field(&mut self, length: usize) -> Result<&'a [u8], WireError> {
        let (field, rest) = self.0.split_at_checked(length).ok_or(WireError::WrongSize)?;
        self.0 = rest;
        Ok(Fields(field).text())
    }

    /// The remaining bytes up to the first NUL; padding after it is ignored.
    fn text(self) -> &'a [u8] {
        self.0.split(|&byte| byte == 0).next().unwrap_or_default()
    }
}

/// Starts a message in a buffer that is used repeatedly.
fn begin(out: &mut Vec<u8>, tag: &Tag, fifth_byte: u8) {
    out.clear();
    out.extend_from_slice(tag);
    out.push(fifth_byte);
}

/// Appends a text and NULs up to the `total` length of the message; at least one NUL follows the text.
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

/// Refuses a text that is longer than `max` bytes or contains a NUL.
fn fits(text: &str, max: usize) -> Result<(), WireError> {
    match text {
        _ if text.contains('\0') => Err(WireError::NotText),
        _ if text.len() > max => Err(WireError::TooLong),
        _ => Ok(()),
    }
}

/// Appends a text field of this length, padded with NULs. A longer text is cut: callers check it by [`fits`].
fn put_text(out: &mut Vec<u8>, text: &str, length: usize) {
    let end = out.len() + length;
    out.extend(text.bytes().take(length));
    out.resize(end, 0);
}

/// Checks a text: UTF-8 without control characters.
fn text(bytes: &[u8]) -> Result<&str, WireError> {
    match std::str::from_utf8(bytes) {
        Ok(text) if !text.contains(char::is_control) => Ok(text),
        _ => Err(WireError::NotText),
    }
}

/// Reads a rate: decimal digits up to a NUL or to the end; padding after the NUL is ignored.
fn decimal(body: &[u8]) -> Result<u32, WireError> {
    let digits = Fields(body).text();
    if digits.is_empty() || !digits.iter().all(u8::is_ascii_digit) {
        return Err(WireError::NotText);
    }
    std::str::from_utf8(digits).map_err(|_| WireError::NotText)?.parse().map_err(|_| WireError::OutOfRange)
}

/// Appends a rate as digits and a NUL.
fn put_decimal(out: &mut Vec<u8>, rate_hz: u32) {
    out.extend_from_slice(rate_hz.to_string().as_bytes());
    out.push(0);
}

/// Checks a dataref's path, which is printable ASCII.
fn path(text: &[u8]) -> Result<&str, WireError> {
    match std::str::from_utf8(text) {
        Ok(path) if path.bytes().all(|byte| byte.is_ascii_graphic()) => Ok(path),
        _ => Err(WireError::NotText),
    }
}
