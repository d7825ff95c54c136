//! VEHX and VEHS: set the pose of an aircraft; ACFN: load an aircraft.

use super::{Packed, Tag, WireError, begin, body_of_size, check_place, put_text, text};

/// Length of a [`Move`], bytes.
const MOVE_SIZE: usize = 45;
/// Length of a [`Load`], bytes.
const LOAD_SIZE: usize = 165;
/// Tag of a [`Load`].
pub const ACFN: Tag = *b"ACFN";
/// Length of the field of an aircraft's path, and of the two bytes of padding behind it, bytes.
const PATH: usize = 152;
/// Longest path, bytes: a NUL follows it inside its 150 bytes.
const MAX_PATH: usize = 149;

/// Tag of a [`Move`] that stops the flight model: the aircraft stays where it is until the next message.
pub const VEHX: Tag = *b"VEHX";
/// Tag of a [`Move`] from which the flight model continues.
pub const VEHS: Tag = *b"VEHS";

/// A new pose of an aircraft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// The fate of its flight model: [`VEHX`] or [`VEHS`].
    pub tag: Tag,
    /// Number of the aircraft: 0 is the user's own, 19 the last.
    pub aircraft: u8,
    /// Latitude, −90 to 90, north positive.
    pub latitude_deg: f64,
    /// Longitude, −180 to 180, east positive.
    pub longitude_deg: f64,
    /// Elevation above mean sea level.
    pub elevation_m: f64,
    /// Heading ψ, clockwise from true north.
    pub heading_deg: f32,
    /// Pitch θ, nose up positive.
    pub pitch_deg: f32,
    /// Roll φ, right bank positive.
    pub roll_deg: f32,
}

impl Move {
    /// Decodes a new pose.
    ///
    /// # Errors
    /// If the datagram is neither message, or a number is out of range.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let tag = if datagram.starts_with(&VEHX) { VEHX } else { VEHS };
        let mut fields = body_of_size(datagram, &tag, MOVE_SIZE)?;
        let moved = Self {
            tag,
            aircraft: fields.aircraft_number()?,
            latitude_deg: fields.next()?,
            longitude_deg: fields.next()?,
            elevation_m: fields.next()?,
            heading_deg: fields.next()?,
            pitch_deg: fields.next()?,
            roll_deg: fields.next()?,
        };
        check_place(moved.latitude_deg, moved.longitude_deg).map(|()| moved)
    }

    /// Encodes the new pose.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &self.tag);
        i32::from(self.aircraft).write(out);
        [self.latitude_deg, self.longitude_deg, self.elevation_m].iter().for_each(|value| value.write(out));
        [self.heading_deg, self.pitch_deg, self.roll_deg].iter().for_each(|value| value.write(out));
    }
}

/// Loads an aircraft.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load<'a> {
    /// Number of the aircraft that is replaced: 0 is the user's own, 19 the last.
    pub aircraft: u8,
    /// Path of the `.acf` file below X-Plane's folder, with `/` between folders; at most 149 bytes.
    pub path: &'a str,
    /// Number of the livery.
    pub livery: i32,
}

impl<'a> Load<'a> {
    /// Decodes a request to load an aircraft.
    ///
    /// # Errors
    /// If the datagram is not this message, or the aircraft's number is out of range.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &ACFN, LOAD_SIZE)?;
        let aircraft = fields.aircraft_number()?;
        Ok(Self { aircraft, path: text(fields.field(PATH)?)?, livery: fields.next()? })
    }

    /// Encodes the request.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        begin(out, &ACFN);
        i32::from(self.aircraft).write(out);
        put_text(out, self.path, MAX_PATH, PATH)?;
        self.livery.write(out);
        Ok(())
    }
}
