//! VEHX and VEHS: set the pose of an aircraft; ACFN: load an aircraft; ACPR: load and place it.

use super::prel::{AIRCRAFT, Placement};
use super::{Fields, Tag, WireError, begin, body_of_size, fits, put_text, text};

/// Length of a [`Move`], bytes.
const MOVE_SIZE: usize = 45;
/// Length of a [`Load`], bytes.
const LOAD_SIZE: usize = 165;
/// Length of a [`LoadAndPlace`], bytes.
const LOAD_AND_PLACE_SIZE: usize = 229;
/// Tag of a [`Load`].
pub const ACFN: Tag = *b"ACFN";
/// Tag of a [`LoadAndPlace`].
pub const ACPR: Tag = *b"ACPR";
/// Length of the field of an aircraft's path, and of the two bytes of padding behind it, bytes.
const PATH: usize = 152;
/// Longest path, bytes: a NUL follows it inside its 150 bytes.
const MAX_PATH: usize = 149;

/// What becomes of the aircraft's flight model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Physics {
    /// VEHX: it stops, and the aircraft stays where it is until the next message.
    Stop,
    /// VEHS: it continues from the new pose.
    Continue,
}

impl Physics {
    /// Tag of the message.
    pub fn tag(self) -> Tag {
        match self {
            Self::Stop => *b"VEHX",
            Self::Continue => *b"VEHS",
        }
    }
}

/// A new pose of an aircraft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// What becomes of its flight model.
    pub physics: Physics,
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
        let is_stop = datagram.starts_with(&Physics::Stop.tag());
        let physics = if is_stop { Physics::Stop } else { Physics::Continue };
        let mut fields = body_of_size(datagram, &physics.tag(), MOVE_SIZE)?;
        let moved = Self {
            physics,
            aircraft: aircraft(&mut fields)?,
            latitude_deg: fields.finite_f64()?,
            longitude_deg: fields.finite_f64()?,
            elevation_m: fields.finite_f64()?,
            heading_deg: fields.finite_f32()?,
            pitch_deg: fields.finite_f32()?,
            roll_deg: fields.finite_f32()?,
        };
        let on_the_globe = moved.latitude_deg.abs() <= 90.0 && moved.longitude_deg.abs() <= 180.0;
        if on_the_globe { Ok(moved) } else { Err(WireError::OutOfRange) }
    }

    /// Encodes the new pose.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &self.physics.tag(), 0);
        out.extend(i32::from(self.aircraft).to_le_bytes());
        for value in [self.latitude_deg, self.longitude_deg, self.elevation_m] {
            out.extend(value.to_le_bytes());
        }
        for value in [self.heading_deg, self.pitch_deg, self.roll_deg] {
            out.extend(value.to_le_bytes());
        }
    }
}

/// Number of an aircraft.
fn aircraft(fields: &mut Fields<'_>) -> Result<u8, WireError> {
    let number = fields.i32()?;
    u8::try_from(number).ok().filter(|_| number < AIRCRAFT).ok_or(WireError::OutOfRange)
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
    fn read(fields: &mut Fields<'a>) -> Result<Self, WireError> {
        Ok(Self { aircraft: aircraft(fields)?, path: text(fields.field(PATH)?)?, livery: fields.i32()? })
    }

    fn write(&self, out: &mut Vec<u8>) {
        out.extend(i32::from(self.aircraft).to_le_bytes());
        put_text(out, self.path, PATH);
        out.extend(self.livery.to_le_bytes());
    }

    /// Decodes a request to load an aircraft.
    ///
    /// # Errors
    /// If the datagram is not this message, or the aircraft's number is out of range.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        Self::read(&mut body_of_size(datagram, &ACFN, LOAD_SIZE)?)
    }

    /// Encodes the request.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        fits(self.path, MAX_PATH)?;
        begin(out, &ACFN, 0);
        self.write(out);
        Ok(())
    }
}

/// Loads an aircraft and places it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadAndPlace<'a> {
    /// The aircraft.
    pub load: Load<'a>,
    /// Its place.
    pub placement: Placement,
}

impl<'a> LoadAndPlace<'a> {
    /// Decodes a request to load and place an aircraft.
    ///
    /// # Errors
    /// If the datagram is not this message, or a number is out of range.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &ACPR, LOAD_AND_PLACE_SIZE)?;
        Ok(Self { load: Load::read(&mut fields)?, placement: Placement::read(&mut fields)? })
    }

    /// Encodes the request.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        fits(self.load.path, MAX_PATH)?;
        begin(out, &ACPR, 0);
        self.load.write(out);
        self.placement.write(out);
        Ok(())
    }
}
