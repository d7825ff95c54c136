//! PREL: places an aircraft. Of its many kinds of start only type 6 is here: latitude, longitude and elevation, with the
//! airport's fields zero.

use super::{Tag, WireError, begin, body_of_size};

/// The message's letters.
pub const TAG: Tag = *b"PREL";
/// Length on the wire.
pub const SIZE: usize = 69;

/// Start type: latitude, longitude, elevation.
const AT_A_PLACE: i32 = 6;
/// X-Plane has this many aircraft, the user's first.
const AIRCRAFT: i32 = 20;

/// Puts an aircraft at a place, in flight or on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// 0 is the user's own aircraft, up to 19.
    pub aircraft: u8,
    /// −90 to 90, north positive.
    pub latitude_deg: f64,
    /// −180 to 180, east positive.
    pub longitude_deg: f64,
    /// Above mean sea level.
    pub elevation_m: f64,
    /// Clockwise from true north.
    pub heading_deg: f64,
    /// Along the heading.
    pub speed_m_s: f64,
}

impl Placement {
    /// Reads a placement; another start type is out of range. What the airport's fields hold is ignored.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &TAG, SIZE)?;
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

    /// Writes the placement.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &TAG, 0);
        out.extend(AT_A_PLACE.to_le_bytes());
        out.extend(i32::from(self.aircraft).to_le_bytes());
        out.extend([0; 16]);
        for value in [self.latitude_deg, self.longitude_deg, self.elevation_m, self.heading_deg, self.speed_m_s] {
            out.extend(value.to_le_bytes());
        }
    }
}
