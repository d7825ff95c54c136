//! Coordinate frames and the conversions between them.
//!
//! * **Geodetic**: WGS84 latitude and longitude in radians, height above the ellipsoid in metres. Positions are shared
//!   in this frame, because every simulator has its own local origin.
//! * **ECEF**: Earth-centred, Earth-fixed Cartesian metres.
//! * **NED**: north, east, down metres in the plane that touches the ellipsoid at the swarm's [`Origin`].
//! * **Body**: forward, right, down.
//!
//! `altitude` is minus down, height above the origin; `height` is above the ground below the vehicle.

use crate::math;
use std::f64::consts::PI;
use std::ops::{Add, Sub};

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// WGS84 semi-major axis, m.
const A: f64 = 6_378_137.0;
/// WGS84 flattening.
const F: f64 = 1.0 / 298.257_223_563;
/// Semi-minor axis, m.
const B: f64 = A * (1.0 - F);
/// First eccentricity squared.
const E2: f64 = F * (2.0 - F);
/// Second eccentricity squared.
const EP2: f64 = E2 / (1.0 - E2);

/// Position on or above the WGS84 ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geodetic {
    /// Latitude, rad, positive north, −π/2 to π/2.
    pub latitude_rad: f64,
    /// Longitude, rad, positive east, −π to π.
    pub longitude_rad: f64,
    /// Height above the ellipsoid, m.
    pub altitude_m: f64,
}

impl Geodetic {
    /// Makes a position from degrees and metres.
    #[inline]
    pub fn from_degrees(latitude_deg: f64, longitude_deg: f64, altitude_m: f64) -> Self {
        Self { latitude_rad: latitude_deg.to_radians(), longitude_rad: longitude_deg.to_radians(), altitude_m }
    }

    /// Latitude in degrees.
    #[inline]
    pub fn latitude_deg(&self) -> f64 {
        self.latitude_rad.to_degrees()
    }

    /// Longitude in degrees.
    #[inline]
    pub fn longitude_deg(&self) -> f64 {
        self.longitude_rad.to_degrees()
    }

    /// Whether the position is finite, on the globe, and between 1 km below and 100 km above the ellipsoid.
    #[inline]
    pub fn is_plausible(&self) -> bool {
        self.latitude_rad.abs() <= PI / 2.0
            && self.longitude_rad.abs() <= PI + 1e-9
            && (-1_000.0..=100_000.0).contains(&self.altitude_m)
    }

    /// Converts the position to Earth-centred coordinates.
    #[inline]
    pub fn to_ecef(&self) -> Ecef {
        let (sin_lat, cos_lat) = math::sin_cos(self.latitude_rad);
        let (sin_lon, cos_lon) = math::sin_cos(self.longitude_rad);
        let prime_vertical_m = A / (1.0 - E2 * sin_lat * sin_lat).sqrt();
        let across_m = (prime_vertical_m + self.altitude_m) * cos_lat;
        Ecef(Vector3::new(
            across_m * cos_lon,
            across_m * sin_lon,
            (prime_vertical_m * (1.0 - E2) + self.altitude_m) * sin_lat,
        ))
    }
}

/// Earth-centred, Earth-fixed position, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ecef(pub Vector3<f64>);

impl Ecef {
    /// Converts the position to latitude, longitude and height with Bowring's method of 1985. One pass is exact to
    /// micrometres up to a height of 10 km, poles included: sine and cosine of the reduced latitude come from a
    /// normalised pair, never from a tangent.
    #[inline]
    pub fn to_geodetic(self) -> Geodetic {
        let (x, y, z) = (self.0.x, self.0.y, self.0.z);
        let across_m = math::hypot(x, y);
        let from_centre_m = math::hypot(across_m, z);
        let (sin_u, cos_u) = unit(B * z * (1.0 + EP2 * B / from_centre_m), A * across_m);
        let (tan_num, tan_den) = (z + EP2 * B * math::cube(sin_u), across_m - E2 * A * math::cube(cos_u));
        let (sin_lat, cos_lat) = unit(tan_num, tan_den);
        Geodetic {
            latitude_rad: math::atan2(tan_num, tan_den),
            longitude_rad: math::atan2(y, x),
            altitude_m: across_m * cos_lat + z * sin_lat - A * (1.0 - E2 * sin_lat * sin_lat).sqrt(),
        }
    }
}

/// Scales the pair to length one.
#[inline]
fn unit(sine: f64, cosine: f64) -> (f64, f64) {
    let length = (sine * sine + cosine * cosine).sqrt();
    (sine / length, cosine / length)
}

/// Origin of the swarm's local north-east-down frame: the point where the frame touches the ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Origin {
    geodetic: Geodetic,
    ecef: Vector3<f64>,
    ned_from_ecef: Matrix3<f64>,
}

impl Origin {
    /// Makes the frame with its origin at this position.
    pub fn new(geodetic: Geodetic) -> Self {
        let (sin_lat, cos_lat) = math::sin_cos(geodetic.latitude_rad);
        let (sin_lon, cos_lon) = math::sin_cos(geodetic.longitude_rad);
        #[rustfmt::skip]
        let ned_from_ecef = Matrix3::new(
            -sin_lat * cos_lon, -sin_lat * sin_lon,  cos_lat,
            -sin_lon,            cos_lon,            0.0,
            -cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat,
        );
        Self { geodetic, ecef: geodetic.to_ecef().0, ned_from_ecef }
    }

    /// Geodetic position of the origin.
    #[inline]
    pub fn geodetic(&self) -> Geodetic {
        self.geodetic
    }

    /// Converts a geodetic position to the local frame.
    #[inline]
    pub fn ned_from_geodetic(&self, place: &Geodetic) -> PositionNed {
        PositionNed(self.ned_from_ecef * (place.to_ecef().0 - self.ecef))
    }

    /// Converts a position in the local frame to a geodetic position.
    #[inline]
    pub fn geodetic_from_ned(&self, position: PositionNed) -> Geodetic {
        Ecef(self.ecef + self.ned_from_ecef.tr_mul(&position.0)).to_geodetic()
    }
}

macro_rules! ned_vector {
    ($(#[$doc:meta])* $name:ident, $north:ident, $east:ident, $down:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(from = "[f64; 3]", into = "[f64; 3]")]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub struct $name(pub Vector3<f64>);

        impl $name {
            /// Makes a vector from its components.
            #[inline]
            pub fn new($north: f64, $east: f64, $down: f64) -> Self {
                Self(Vector3::new($north, $east, $down))
            }

            /// Northward component.
            #[inline]
            pub fn $north(&self) -> f64 {
                self.0.x
            }

            /// Eastward component.
            #[inline]
            pub fn $east(&self) -> f64 {
                self.0.y
            }

            /// Downward component.
            #[inline]
            pub fn $down(&self) -> f64 {
                self.0.z
            }

            /// North and east components.
            #[inline]
            pub fn horizontal(&self) -> Vector2<f64> {
                self.0.xy()
            }

            /// Whether every component is finite.
            #[inline]
            pub fn is_finite(&self) -> bool {
                self.0.iter().all(|component| component.is_finite())
            }
        }

        impl From<[f64; 3]> for $name {
            fn from(components: [f64; 3]) -> Self {
                Self(components.into())
            }
        }

        impl From<$name> for [f64; 3] {
            fn from(vector: $name) -> Self {
                vector.0.into()
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self(Vector3::zeros())
            }
        }

        impl Add<Vector3<f64>> for $name {
            type Output = Self;
            #[inline]
            fn add(self, difference: Vector3<f64>) -> Self {
                Self(self.0 + difference)
            }
        }

        impl Sub for $name {
            type Output = Vector3<f64>;
            #[inline]
            fn sub(self, other: Self) -> Vector3<f64> {
                self.0 - other.0
            }
        }
    };
}

ned_vector! {
    /// Position in the swarm's local frame, m.
    PositionNed, north_m, east_m, down_m
}
ned_vector! {
    /// Velocity over the ground in the swarm's local frame, m/s.
    VelocityNed, north_m_s, east_m_s, down_m_s
}

impl PositionNed {
    /// Height above the origin, m.
    #[inline]
    pub fn altitude_m(&self) -> f64 {
        -self.0.z
    }
}

/// Attitude as Euler angles 3-2-1: heading, then pitch, then roll.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Attitude {
    /// Roll angle φ, rad, right bank positive, −π to π.
    pub roll_rad: f64,
    /// Pitch angle θ, rad, nose up positive, −π/2 to π/2.
    pub pitch_rad: f64,
    /// Heading ψ, rad, clockwise from true north.
    pub heading_rad: f64,
}

impl Attitude {
    /// Whether every angle is finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        self.roll_rad.is_finite() && self.pitch_rad.is_finite() && self.heading_rad.is_finite()
    }

    /// Rotation that converts body components to NED components.
    pub fn ned_from_body(&self) -> Rotation3<f64> {
        Rotation3::from_euler_angles(self.roll_rad, self.pitch_rad, self.heading_rad)
    }
}

/// Angular velocity of the body over the ground in body axes, rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BodyRates {
    /// Roll rate p, rad/s, right side down positive.
    pub roll_rad_s: f64,
    /// Pitch rate q, rad/s, nose up positive.
    pub pitch_rad_s: f64,
    /// Yaw rate r, rad/s, nose right positive.
    pub yaw_rad_s: f64,
}

impl BodyRates {
    /// Whether every rate is finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        self.roll_rad_s.is_finite() && self.pitch_rad_s.is_finite() && self.yaw_rad_s.is_finite()
    }
}

/// Wraps an angle to −π..π.
#[inline]
pub fn wrap_rad(angle_rad: f64) -> f64 {
    // The common case costs two comparisons.
    if angle_rad.abs() <= PI { angle_rad } else { angle_rad - 2.0 * PI * (angle_rad / (2.0 * PI)).round() }
}

/// The level frame along a heading: forward and right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingFrame {
    sin: f64,
    cos: f64,
}

impl HeadingFrame {
    /// The frame along this heading, clockwise from north, rad.
    #[inline]
    pub fn new(heading_rad: f64) -> Self {
        let (sin, cos) = math::sin_cos(heading_rad);
        Self { sin, cos }
    }

    /// Converts a horizontal north-east vector to its components forward and right.
    #[inline]
    pub fn from_ne(&self, north_east: Vector2<f64>) -> Vector2<f64> {
        let Self { sin, cos } = *self;
        Vector2::new(north_east.x * cos + north_east.y * sin, -north_east.x * sin + north_east.y * cos)
    }

    /// Converts components forward and right to a horizontal north-east vector.
    #[inline]
    pub fn to_ne(&self, forward_right: Vector2<f64>) -> Vector2<f64> {
        let Self { sin, cos } = *self;
        Vector2::new(forward_right.x * cos - forward_right.y * sin, forward_right.x * sin + forward_right.y * cos)
    }
}

#[cfg(test)]
mod tests;
