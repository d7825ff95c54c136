//! RADR: the weather radar. X-Plane serves one client only. Versions 11 and 12 reply in different layouts, which only
//! the version distinguishes.

use super::{Packed, Tag, WireError, begin, layout, parts};

/// Tag of the points, and of the request for a number of them a second.
pub const TAG: Tag = *b"RADR";

layout! {
    /// A point of X-Plane 12.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct RadarPoint {
        /// Longitude, east positive.
        pub longitude_deg: f32,
        /// Latitude, north positive.
        pub latitude_deg: f32,
        /// Base of the clouds above mean sea level.
        pub base_m: f32,
        /// Top of the clouds above mean sea level.
        pub top_m: f32,
        /// Share of the sky with clouds, 0 to 1.
        pub clouds: f32,
        /// Precipitation, 0 to 1.
        pub precipitation: f32,
    }
}

layout! {
    /// A point of X-Plane 11.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct RadarPoint11 {
        /// Longitude, east positive.
        pub longitude_deg: f32,
        /// Latitude, north positive.
        pub latitude_deg: f32,
        /// Precipitation in percent.
        pub level: u8,
        /// Height of the storm's top above mean sea level.
        pub height_m: f32,
    }
}

macro_rules! points {
    ($($point:ident, $length:expr;)*) => {
        $(impl $point {
            /// Decodes the points of a reply of this version.
            ///
            /// # Errors
            /// If the datagram has another tag or length, or a number is not finite.
            pub fn decode(datagram: &[u8]) -> Result<Vec<Self>, WireError> {
                parts(datagram, &TAG, $length)
            }

            /// Encodes points.
            pub fn encode(points: &[Self], out: &mut Vec<u8>) {
                begin(out, &TAG);
                points.iter().for_each(|point| point.write(out));
            }
        })*
    };
}

// Lengths in bytes.
points! {
    RadarPoint, 24;
    RadarPoint11, 13;
}
