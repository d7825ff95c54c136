//! PREL: places an aircraft. Of its start types only type 6 is supported: latitude, longitude and elevation, with empty
//! airport fields.

use super::{Packed, Tag, WireError, begin, body_of_size, check_place, layout};

/// Tag of the message.
pub const TAG: Tag = *b"PREL";
/// Length of the message, bytes.
pub const SIZE: usize = 69;

/// Start type: latitude, longitude, elevation.
const AT_A_PLACE: i32 = 6;

/// How the number of an aircraft is packed here: behind the start type, and before the fields of an airport, which are ignored.
mod at_a_place {
    use super::AT_A_PLACE;
    use crate::plant::xplane::wire::{Fields, Packed, WireError, aircraft_number};

    pub(super) fn read(fields: &mut Fields<'_>) -> Result<u8, WireError> {
        if fields.next::<i32>()? != AT_A_PLACE {
            return Err(WireError::OutOfRange);
        }
        let number = aircraft_number::read(fields)?;
        fields.array::<16>().map(|_airport| number)
    }

    pub(super) fn write(number: &u8, out: &mut Vec<u8>) {
        AT_A_PLACE.write(out);
        aircraft_number::write(number, out);
        out.extend([0; 16]);
    }
}

layout! {
    /// Placement of an aircraft, in flight or on the ground.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Placement {
        /// Number of the aircraft: 0 is the user's own, 19 the last.
        pub aircraft: u8 as at_a_place,
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
}

impl Placement {
    /// Decodes a placement; the airport fields are ignored.
    ///
    /// # Errors
    /// If the datagram is not a placement, has another start type, or has a number out of range.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let placement: Self = body_of_size(datagram, &TAG, SIZE)?.next()?;
        check_place(placement.latitude_deg, placement.longitude_deg).map(|()| placement)
    }

    /// Encodes the placement.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &TAG);
        self.write(out);
    }
}
