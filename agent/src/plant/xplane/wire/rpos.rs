//! RPOS: the position stream. Positions are in double precision and carry no time stamp.

use super::{Packed, Tag, WireError, begin, body_of_size, check_place, layout};

/// Tag of the position, and of the request for a number of them a second: X-Plane never sends more than one per frame.
pub const TAG: Tag = *b"RPOS";
/// Length of an encoded [`Position`], bytes.
pub const SIZE: usize = 69;

layout! {
    /// Position and motion of the aircraft, in X-Plane's units and axes.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct Position {
        /// Longitude, −180 to 180, east positive.
        pub longitude_deg: f64,
        /// Latitude, −90 to 90, north positive.
        pub latitude_deg: f64,
        /// Elevation above mean sea level.
        pub elevation_m: f64,
        /// Height above the terrain.
        pub height_m: f32,
        /// Pitch θ, nose up positive.
        pub pitch_deg: f32,
        /// Heading ψ, clockwise from true north.
        pub heading_deg: f32,
        /// Roll φ, right bank positive.
        pub roll_deg: f32,
        /// Velocity along x of X-Plane's local frame.
        pub velocity_east_m_s: f32,
        /// Velocity along y of X-Plane's local frame.
        pub velocity_up_m_s: f32,
        /// Velocity along z of X-Plane's local frame.
        pub velocity_south_m_s: f32,
        /// Roll rate P, right side down positive.
        pub roll_rate_rad_s: f32,
        /// Pitch rate Q, nose up positive.
        pub pitch_rate_rad_s: f32,
        /// Yaw rate R, nose right positive.
        pub yaw_rate_rad_s: f32,
    }
}

impl Position {
    /// Decodes a position.
    ///
    /// # Errors
    /// If the datagram is not a position, a number is not finite, or the place is not on the globe.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let position: Self = body_of_size(datagram, &TAG, SIZE)?.next()?;
        check_place(position.latitude_deg, position.longitude_deg).map(|()| position)
    }

    /// Encodes the position.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &TAG);
        self.write(out);
    }
}
