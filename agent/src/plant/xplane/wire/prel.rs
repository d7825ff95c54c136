//! PREL: places an aircraft. Of its start types only type 6 is supported: latitude, longitude and elevation, with empty
//! airport fields.

use super::{Fields, Tag, WireError, begin, body_of_size};

/// Tag of the message.
pub const TAG: Tag = *b"PREL";
/// Length of the message, bytes.
pub const SIZE: usize = 69;

/// Start type: latitude, longitude, elevation.
const AT_A_PLACE: i32 = 6;
/// Number of aircraft in X-Plane; the user's is number 0.
pub(super) const AIRCRAFT: i32 = 20;

/// Placement of an aircraft, in flight or on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Number of the aircraft: 0 is the user's own, 19 the last.
    pub aircraft: u8,
    /// Latitude, −90 to 90, north positive.
    pub latitude_deg: f64,
    /// Longitude, −180 to 180, east positive.
    pub longitude_deg: f64,
    /// Elevation above mean sea level.
    pub elevation_m: f64,
    /// Heading, clockwise from true north.
    pub heading_deg: f64,
    /// Speed along the heading.
    pub speed_m_s: f64,
}

impl Placement {
    /// Decodes a placement; the airport fields are ignored.
    ///
    /// # Errors
    /// If the datagram is not a placement, has another start type, or has a number out of range.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        Self::read(&mut body_of_size(datagram, &TAG, SIZE)?)
    }

    /// Reads the fields of a placement.
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, WireError> {
        let (start, aircraft) = (fields.i32()?, fields.i32()?);
        let _airport: [u8; 16] = fields.array()?;
        let placement = Self {
            aircraft: u8::try_from(aircraft).map_err(|_| WireError::OutOfRange)?,
            latitude_deg: fields.finite_f64()?,
            longitude_deg: fields.finite_f64()?,
            elevation_m: fields.finite_f64()?,
            heading_deg: fields.finite_f64()?,
            speed_m_s: fields.finite_f64()?,
        };
        let on_the_globe = placement.latitude_deg.abs() <= 90.0 && placement.longitude_deg.abs() <= 180.0;
        let known = start == AT_A_PLACE && aircraft < AIRCRAFT;
        if on_the_globe && known { Ok(placement) } else { Err(WireError::OutOfRange) }
    }

    /// Encodes the placement.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &TAG, 0);
        self.write(out);
    }

    /// Appends the fields of the placement.
    pub(super) fn write(&self, out: &mut Vec<u8>) {
        out.extend(AT_A_PLACE.to_le_bytes());
        out.extend(i32::from(self.aircraft).to_le_bytes());
        out.extend([0; 16]);
        for value in [self.latitude_deg, self.longitude_deg, self.elevation_m, self.heading_deg, self.speed_m_s] {
            out.extend(value.to_le_bytes());
        }
    }
}
