//! DATA: rows of eight numbers as on X-Plane's Data Output screen, both ways; DSEL, USEL, DCOC and UCOC: which rows it
//! puts out; ISE4 and ISE6: where it sends them.
//!
//! Rows are numbered from 0. X-Plane never sends rows to the program that selected them, but to the address of target
//! [`DATA_OUTPUT`] only.

use std::net::IpAddr;

use super::{Fields, Packed, Tag, WireError, begin, body, body_of_size, layout, parts, text};

/// Tag of the rows.
pub const TAG: Tag = *b"DATA";
/// Largest number of rows in a datagram that is not split on an Ethernet.
pub const MAX_ROWS: usize = 40;
/// The number that stands for "no value".
const NO_VALUE: f32 = -999.0;
/// Length of a row, bytes.
const ROW_SIZE: usize = 36;

layout! {
    /// A row: its number on the Data Output screen, and up to eight numbers, whose meaning and units depend on the row.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Row {
        /// Number of the row, from 0.
        pub index: i32,
        /// `None`: this row has no number there. To X-Plane: do not change it.
        pub values: [Option<f32>; 8],
    }
}

impl Packed for [Option<f32>; 8] {
    fn read(fields: &mut Fields<'_>) -> Result<Self, WireError> {
        let mut values = [None; 8];
        for value in &mut values {
            *value = Some(fields.next()?).filter(|&number| number != NO_VALUE);
        }
        Ok(values)
    }

    fn write(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|value| value.unwrap_or(NO_VALUE).write(out));
    }
}

/// Decodes the rows of a datagram.
///
/// # Errors
/// If the datagram has no rows, a part of one, or a number that is not finite.
pub fn decode_rows(datagram: &[u8]) -> Result<Vec<Row>, WireError> {
    parts(datagram, &TAG, ROW_SIZE)
}

/// Encodes one to [`MAX_ROWS`] rows.
///
/// # Errors
/// If there are none, or more.
pub fn encode_rows(rows: &[Row], out: &mut Vec<u8>) -> Result<(), WireError> {
    if !(1..=MAX_ROWS).contains(&rows.len()) {
        return Err(WireError::WrongSize);
    }
    begin(out, &TAG);
    rows.iter().for_each(|row| row.write(out));
    Ok(())
}

/// Tags of the selections: send the rows by UDP, send them no longer, show them in the cockpit, show them no longer.
pub const SELECTIONS: [Tag; 4] = [*b"DSEL", *b"USEL", *b"DCOC", *b"UCOC"];

/// A selection of rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// The change for the rows, one of [`SELECTIONS`].
    pub tag: Tag,
    /// Numbers of the rows; unknown and repeated ones do no harm.
    pub rows: Vec<i32>,
}

impl Selection {
    /// Decodes a selection.
    ///
    /// # Errors
    /// If the datagram is another message, or ends within a number.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let tag = SELECTIONS.into_iter().find(|tag| datagram.starts_with(tag)).ok_or(WireError::WrongTag)?;
        let (numbers, rest) = body(datagram, &tag)?.as_chunks::<4>();
        if !rest.is_empty() {
            return Err(WireError::WrongSize);
        }
        Ok(Self { tag, rows: numbers.iter().map(|number| i32::from_le_bytes(*number)).collect() })
    }
}

/// Target of [`Destination`]: the receiver of the rows.
pub const DATA_OUTPUT: i32 = 64;
/// Tag of a destination with an IPv4 address.
pub const ISE4: Tag = *b"ISE4";
/// Tag of a destination with an address of either kind.
pub const ISE6: Tag = *b"ISE6";
/// Lengths of a destination in the shorter and the longer form: of all, of the address, and of the port, which has a byte of
/// padding behind it in the longer form.
const LENGTHS_4: [usize; 3] = [37, 16, 8];
const LENGTHS_6: [usize; 3] = [85, 65, 7];

/// The destination of something that X-Plane sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Destination {
    /// The things sent there: [`DATA_OUTPUT`], or another PC of an X-Plane network.
    pub target: i32,
    /// Address of the receiver.
    pub address: IpAddr,
    /// UDP port of the receiver.
    pub port: u16,
    /// Whether it is sent.
    pub is_on: bool,
}

impl Destination {
    /// Decodes a destination in either form; address and port are text.
    ///
    /// # Errors
    /// If the datagram is not a destination, or holds no address or port.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let is_4 = datagram.starts_with(&ISE4);
        let (tag, [total, address, port]) = if is_4 { (ISE4, LENGTHS_4) } else { (ISE6, LENGTHS_6) };
        let mut fields = body_of_size(datagram, &tag, total)?;
        let target = fields.next()?;
        let address: IpAddr = text(fields.field(address)?)?.trim().parse().map_err(|_| WireError::NotText)?;
        let port = text(fields.field(port)?)?.trim().parse().map_err(|_| WireError::OutOfRange)?;
        if is_4 && address.is_ipv6() {
            return Err(WireError::OutOfRange);
        }
        Ok(Self { target, address, port, is_on: fields.next::<i32>()? != 0 })
    }
}
