//! PREL: places an aircraft. Of its start types only type 6 is supported: latitude, longitude and elevation, with empty
//! airport fields.

use super::{Packed, Tag, WireError, begin, body_of_size, check_place};

/// Tag of the message.
pub const TAG: Tag = *b"PREL";
/// Length of the message, bytes.
pub const SIZE: usize = 69;

/// Start type: latitude, longitude, elevation.
const AT_A_PLACE: i32 = 6;
/// Length of the fields of an airport, bytes.
const AIRPORT: usize = 16;

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
        let mut fields = body_of_size(datagram, &TAG, SIZE)?;
        if fields.next::<i32>()? != AT_A_PLACE {
            return Err(WireError::OutOfRange);
        }
        let aircraft = fields.aircraft_number()?;
        fields.array::<AIRPORT>()?;
        let placement = Self {
            aircraft,
            latitude_deg: fields.next()?,
            longitude_deg: fields.next()?,
            elevation_m: fields.next()?,
            heading_deg: fields.next()?,
            speed_m_s: fields.next()?,
        };
        check_place(placement.latitude_deg, placement.longitude_deg).map(|()| placement)
    }

    /// Encodes the placement.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &TAG);
        [AT_A_PLACE, self.aircraft.into()].iter().for_each(|number| number.write(out));
        out.extend([0; AIRPORT]);
        let Self { latitude_deg, longitude_deg, elevation_m, heading_deg, speed_m_s, .. } = self;
        [latitude_deg, longitude_deg, elevation_m, heading_deg, speed_m_s].iter().for_each(|value| value.write(out));
    }
}
