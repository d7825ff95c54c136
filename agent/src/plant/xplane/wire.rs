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
//! | [`aircraft`] | set its pose, load it | – |
//! | [`rows`] | write rows of numbers, select rows, name their receiver | rows of numbers |
//! | [`operation`] | run a command, end X-Plane | – |
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

/// Number of aircraft in X-Plane; the user's is number 0.
const AIRCRAFT: u8 = 20;

/// The reason why a datagram was refused, or could not be encoded.
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

impl<'a> Fields<'a> {
    /// The next field of this type.
    fn next<T: Packed>(&mut self) -> Result<T, WireError> {
        T::read(self)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let (field, rest) = self.0.split_first_chunk::<N>().ok_or(WireError::WrongSize)?;
        self.0 = rest;
        Ok(*field)
    }

    /// The number of an aircraft.
    fn aircraft_number(&mut self) -> Result<u8, WireError> {
        u8::try_from(self.next::<i32>()?).ok().filter(|number| *number < AIRCRAFT).ok_or(WireError::OutOfRange)
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

/// A part of a message that is packed the same way in both directions.
trait Packed: Sized {
    /// Reads it from the front of the fields.
    fn read(fields: &mut Fields<'_>) -> Result<Self, WireError>;

    /// Appends it.
    fn write(&self, out: &mut Vec<u8>);
}

macro_rules! little_endian {
    ($($number:ident, $is_valid:expr;)*) => {
        $(impl Packed for $number {
            fn read(fields: &mut Fields<'_>) -> Result<Self, WireError> {
                Some(Self::from_le_bytes(fields.array()?)).filter($is_valid).ok_or(WireError::NonFinite)
            }

            fn write(&self, out: &mut Vec<u8>) {
                out.extend(self.to_le_bytes());
            }
        })*
    };
}

little_endian! {
    u8, |_| true;
    u16, |_| true;
    u32, |_| true;
    i32, |_| true;
    f32, |number| number.is_finite();
    f64, |number| number.is_finite();
}

/// Declares a part of a message: its fields follow each other as they stand here, each packed as its type is.
macro_rules! layout {
    (
        $(#[$about:meta])*
        pub struct $name:ident { $($(#[$meaning:meta])* pub $field:ident: $type:ty,)* }
    ) => {
        $(#[$about])*
        pub struct $name { $($(#[$meaning])* pub $field: $type,)* }

        impl $crate::plant::xplane::wire::Packed for $name {
            fn read(fields: &mut $crate::plant::xplane::wire::Fields<'_>) -> Result<Self, WireError> {
                Ok(Self { $($field: fields.next()?,)* })
            }

            fn write(&self, out: &mut Vec<u8>) {
                $(self.$field.write(out);)*
            }
        }
    };
}
use layout;

/// The parts of a message that consists of parts of this length, bytes, at least one.
fn parts<T: Packed>(datagram: &[u8], tag: &Tag, length: usize) -> Result<Vec<T>, WireError> {
    let body = body(datagram, tag)?;
    if body.is_empty() || !body.len().is_multiple_of(length) {
        return Err(WireError::WrongSize);
    }
    body.chunks(length).map(|part| Fields(part).next()).collect()
}

/// Refuses a place that is not on the globe.
fn check_place(latitude_deg: f64, longitude_deg: f64) -> Result<(), WireError> {
    let is_on_it = latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 180.0;
    if is_on_it { Ok(()) } else { Err(WireError::OutOfRange) }
}

/// Starts a message in a buffer that is used repeatedly.
fn begin(out: &mut Vec<u8>, tag: &Tag) {
    out.clear();
    out.extend_from_slice(tag);
    out.push(0);
}

/// Appends a text of at most `longest` bytes, and NULs up to the length of its field.
fn put_text(out: &mut Vec<u8>, text: &str, longest: usize, field: usize) -> Result<(), WireError> {
    match text {
        _ if text.contains('\0') => return Err(WireError::NotText),
        _ if text.len() > longest => return Err(WireError::TooLong),
        _ => {}
    }
    let end = out.len() + field;
    out.extend_from_slice(text.as_bytes());
    out.resize(end, 0);
    Ok(())
}

/// Checks a text: UTF-8 without control characters.
fn text(bytes: &[u8]) -> Result<&str, WireError> {
    std::str::from_utf8(bytes).ok().filter(|text| !text.contains(char::is_control)).ok_or(WireError::NotText)
}

/// Decodes the request for something at a rate, a second, of which 0 ends the subscription: decimal digits up to a NUL or to the
/// end; padding after the NUL is ignored.
///
/// # Errors
/// If the datagram has another tag, or no rate.
pub fn decode_rate(datagram: &[u8], tag: &Tag) -> Result<u32, WireError> {
    let digits = Fields(body(datagram, tag)?).text();
    if digits.is_empty() || !digits.iter().all(u8::is_ascii_digit) {
        return Err(WireError::NotText);
    }
    text(digits)?.parse().map_err(|_| WireError::OutOfRange)
}

/// Encodes the request for something at a rate as digits and a NUL.
pub fn encode_rate(tag: &Tag, rate_hz: u32, out: &mut Vec<u8>) {
    begin(out, tag);
    out.extend_from_slice(rate_hz.to_string().as_bytes());
    out.push(0);
}

/// Checks a dataref's path, which is printable ASCII.
fn path(text: &[u8]) -> Result<&str, WireError> {
    std::str::from_utf8(text)
        .ok()
        .filter(|path| path.bytes().all(|byte| byte.is_ascii_graphic()))
        .ok_or(WireError::NotText)
}
