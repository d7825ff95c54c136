//! Coordinate frames and the conversions between them.
//!
//! * **Geodetic**: WGS84 latitude and longitude in radians, height above the ellipsoid in metres. Positions are shared
//!   in this frame, because every simulator has its own local origin.
//! * **The swarm's frame**: north, east, down metres about the swarm's [`Origin`]. Down is the height above the ellipsoid
//!   below the origin's: a vehicle that keeps its altitude keeps its height above the ellipsoid, however far away it
//!   flies. North and east are those of the vehicle's footprint, the point with its latitude and longitude at the
//!   origin's height, in the plane that touches the Earth at the origin: a vehicle that climbs does not move sideways.
//!   Horizontal distances are shorter than on the Earth by d²/2R², which is 1.2e-4 at 100 km from the origin.
//! * **Local NED**: north, east, down along the meridian, the parallel and the vertical at a vehicle's own position. Away
//!   from the origin its north differs from the swarm's by the [`Convergence`] of the meridians.
//! * **Body**: forward, right, down.
//!
//! `altitude` is minus down, height above the origin; `height` is above the ground below the vehicle.
//!
//! Velocities and headings are local where they stand beside a geodetic position (measurements, states, positions for
//! maps and simulators), and in the swarm's frame where they stand beside a position in that frame (estimates, ground
//! truth, traces, summaries).

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

    /// Converts the position to Earth-centred, Earth-fixed coordinates, m.
    fn to_ecef(self) -> Vector3<f64> {
        let (sin_lat, cos_lat) = math::sin_cos(self.latitude_rad);
        let (sin_lon, cos_lon) = math::sin_cos(self.longitude_rad);
        let prime_vertical_m = A / (1.0 - E2 * sin_lat * sin_lat).sqrt();
        let across_m = (prime_vertical_m + self.altitude_m) * cos_lat;
        Vector3::new(
            across_m * cos_lon,
            across_m * sin_lon,
            (prime_vertical_m * (1.0 - E2) + self.altitude_m) * sin_lat,
        )
    }
}

/// Tangent of the latitude of a point at this distance from the Earth's axis and above the equator's plane, m, as numerator
/// and denominator, with Bowring's method of 1976. One pass is exact to a quarter of a micrometre up to a height of 5 km and to
/// a micrometre up to 10 km, poles included: sine and cosine of the reduced latitude come from a normalised pair, never from
/// a tangent.
#[inline]
fn latitude_tangent(across_m: f64, along_m: f64) -> (f64, f64) {
    let (sin_u, cos_u) = unit(A * along_m, B * across_m);
    (along_m + EP2 * B * math::cube(sin_u), across_m - E2 * A * math::cube(cos_u))
}

/// Height above the ellipsoid of that point, with sine and cosine of its latitude, m.
#[inline]
fn height_m(across_m: f64, along_m: f64, sin_lat: f64, cos_lat: f64) -> f64 {
    across_m * cos_lat + along_m * sin_lat - A * (1.0 - E2 * sin_lat * sin_lat).sqrt()
}

/// Scales the pair to length one.
#[inline]
fn unit(sine: f64, cosine: f64) -> (f64, f64) {
    let length = (sine * sine + cosine * cosine).sqrt();
    (sine / length, cosine / length)
}

/// Distance from the origin's vertical up to which a footprint is found, m. A position that is given further away has the
/// place at this distance in the same direction.
const FARTHEST_M: f64 = 5e6;
/// Drop below the origin's plane beyond which distances are those of the chord, m: 1130 km away.
const FAR_DROP_M: f64 = 1e5;
/// Error of a footprint along the ground at which the search ends, m.
const FOOTPRINT_ERROR_M: f64 = 1e-7;
/// Most passes of the search for a footprint: two are needed at 150 km.
const MOST_PASSES: u32 = 8;

/// Origin of the swarm's north-east-down frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Origin {
    geodetic: Geodetic,
    sin_lat: f64,
    cos_lat: f64,
    /// Distance of the origin from the Earth's axis, and height above the equator's plane, m.
    across_m: f64,
    along_m: f64,
    /// Half the curvature of the Earth at the origin, north and east, 1/m.
    half_curvature: [f64; 2],
}

impl Origin {
    /// Makes the frame with its origin at this position.
    pub fn new(geodetic: Geodetic) -> Self {
        let (sin_lat, cos_lat) = math::sin_cos(geodetic.latitude_rad);
        let flat = 1.0 - E2 * sin_lat * sin_lat;
        let prime_vertical_m = A / flat.sqrt();
        let meridian_m = prime_vertical_m * (1.0 - E2) / flat;
        let height_m = geodetic.altitude_m;
        Self {
            geodetic,
            sin_lat,
            cos_lat,
            across_m: (prime_vertical_m + height_m) * cos_lat,
            along_m: (prime_vertical_m * (1.0 - E2) + height_m) * sin_lat,
            half_curvature: [meridian_m, prime_vertical_m].map(|radius_m| 0.5 / (radius_m + height_m)),
        }
    }

    /// Geodetic position of the origin.
    #[inline]
    pub fn geodetic(&self) -> Geodetic {
        self.geodetic
    }

    /// Converts a geodetic position to the swarm's frame.
    #[inline]
    pub fn ned_from_geodetic(&self, place: &Geodetic) -> PositionNed {
        self.locate(place).0
    }

    /// Converts a position in the swarm's frame to a geodetic position.
    #[inline]
    pub fn geodetic_from_ned(&self, position: PositionNed) -> Geodetic {
        self.place(position).0
    }

    /// Converts a geodetic position to the swarm's frame, and gives the convergence there.
    ///
    /// A position so far away that its footprint is near the plane's horizon or behind it has the distance of the straight
    /// line through the Earth: none on the other side of the Earth appears near.
    #[inline]
    pub fn locate(&self, place: &Geodetic) -> (PositionNed, Convergence) {
        let &Self { geodetic, sin_lat: sin_0, cos_lat: cos_0, .. } = self;
        // About the origin's meridian, so that the date line is a place like any other.
        let (sin_lon, cos_lon) = math::sin_cos(place.longitude_rad - geodetic.longitude_rad);
        let (sin_lat, cos_lat) = math::sin_cos(place.latitude_rad);
        let prime_vertical_m = A / (1.0 - E2 * sin_lat * sin_lat).sqrt();
        let across_m = (prime_vertical_m + geodetic.altitude_m) * cos_lat;
        let out_m = across_m * cos_lon - self.across_m;
        let up_m = (prime_vertical_m * (1.0 - E2) + geodetic.altitude_m) * sin_lat - self.along_m;
        let (mut north_m, mut east_m) = (cos_0 * up_m - sin_0 * out_m, across_m * sin_lon);
        let drop_m = -(cos_0 * out_m + sin_0 * up_m);
        if drop_m > FAR_DROP_M {
            let flat_m = math::hypot(north_m, east_m);
            let chord_m = math::hypot(flat_m, drop_m);
            (north_m, east_m) =
                if flat_m > 0.0 { (north_m * chord_m / flat_m, east_m * chord_m / flat_m) } else { (chord_m, 0.0) };
        }
        let position = PositionNed::new(north_m, east_m, geodetic.altitude_m - place.altitude_m);
        (position, self.convergence((sin_lat, cos_lat), (sin_lon, cos_lon)))
    }

    /// Converts a position in the swarm's frame to a geodetic position, and gives the convergence there. Within 1000 km it
    /// is the inverse of [`Self::locate`].
    #[inline]
    pub fn place(&self, position: PositionNed) -> (Geodetic, Convergence) {
        let &Self { geodetic, sin_lat: sin_0, cos_lat: cos_0, half_curvature, .. } = self;
        let [mut north_m, mut east_m, down_m] = <[f64; 3]>::from(position);
        let mut square = north_m * north_m + east_m * east_m;
        if square > FARTHEST_M * FARTHEST_M {
            let share = FARTHEST_M / square.sqrt();
            (north_m, east_m, square) = (north_m * share, east_m * share, FARTHEST_M * FARTHEST_M);
        }
        // The drop of a paraboloid with the Earth's two radii at the origin, and of the sphere beyond it.
        let flat_m = north_m * north_m * half_curvature[0] + east_m * east_m * half_curvature[1];
        let mut drop_m = flat_m + flat_m * flat_m * half_curvature[1];
        let mut passes = 0;
        loop {
            let out_m = self.across_m - sin_0 * north_m - cos_0 * drop_m;
            let along_m = self.along_m + cos_0 * north_m - sin_0 * drop_m;
            let across_m = (out_m * out_m + east_m * east_m).sqrt();
            let (tan_num, tan_den) = latitude_tangent(across_m, along_m);
            let (sin_lat, cos_lat) = unit(tan_num, tan_den);
            let (sin_lon, cos_lon) = if across_m > 0.0 { (east_m / across_m, out_m / across_m) } else { (0.0, 1.0) };
            let above_m = height_m(across_m, along_m, sin_lat, cos_lat) - geodetic.altitude_m;
            passes += 1;
            // The footprint is off along the ground by the error of its height times the tilt, distance/radius.
            let off_m2 = above_m * above_m * square;
            if off_m2 > math::square(FOOTPRINT_ERROR_M * A) && passes < MOST_PASSES {
                let upright = cos_0 * cos_lat * cos_lon + sin_0 * sin_lat;
                drop_m += above_m / upright.max(0.1);
                continue;
            }
            let place = Geodetic {
                latitude_rad: math::atan2(tan_num, tan_den),
                longitude_rad: wrap_rad(geodetic.longitude_rad + math::atan2(east_m, out_m)),
                altitude_m: geodetic.altitude_m - down_m,
            };
            return (place, self.convergence((sin_lat, cos_lat), (sin_lon, cos_lon)));
        }
    }

    /// The convergence at a geodetic position.
    #[inline]
    pub fn convergence_at(&self, place: &Geodetic) -> Convergence {
        self.locate(place).1
    }

    /// The convergence at the place with this sine and cosine of its latitude, and of its longitude from the origin's: the
    /// turn about the vertical that is left when the local axes are tilted to the origin's along the shortest way.
    #[inline]
    fn convergence(&self, (sin_lat, cos_lat): (f64, f64), (sin_lon, cos_lon): (f64, f64)) -> Convergence {
        let &Self { sin_lat: sin_0, cos_lat: cos_0, .. } = self;
        let sin = -(sin_0 + sin_lat) * sin_lon;
        let cos = (1.0 + sin_0 * sin_lat) * cos_lon + cos_0 * cos_lat;
        // On the other side of the Earth every direction is north.
        let (sin, cos) = if sin == 0.0 && cos == 0.0 { (0.0, 1.0) } else { unit(sin, cos) };
        Convergence { sin, cos }
    }
}

/// Convergence of the meridians at a place: the angle by which its local north is turned clockwise from the north of the
/// swarm's frame. At a pole it is as large as the difference of the longitudes; at the equator it vanishes.
///
/// It turns what is horizontal. The verticals differ too, by 0.16 mrad a kilometre, but heights are counted along the local
/// one, so that climb rate, roll and pitch are the same in both frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Convergence {
    sin: f64,
    cos: f64,
}

impl Convergence {
    /// The angle, rad, from −π to π.
    #[inline]
    pub fn angle_rad(&self) -> f64 {
        let Self { sin, cos } = *self;
        if cos > 0.0 && sin.abs() < SMALL_SINE {
            // The series of the arc sine: the next term is below the last bit.
            let square = sin * sin;
            return sin + sin * square * (1.0 / 6.0 + square * (3.0 / 40.0 + square * (15.0 / 336.0)));
        }
        math::atan2(sin, cos)
    }

    /// Converts a local velocity to the swarm's frame.
    #[inline]
    pub fn velocity_from_local(&self, local: VelocityNed) -> VelocityNed {
        let (Self { sin, cos }, [north_m_s, east_m_s, down_m_s]) = (*self, <[f64; 3]>::from(local));
        VelocityNed::new(north_m_s * cos - east_m_s * sin, north_m_s * sin + east_m_s * cos, down_m_s)
    }

    /// Converts a velocity in the swarm's frame to a local one.
    #[inline]
    pub fn velocity_to_local(&self, velocity: VelocityNed) -> VelocityNed {
        let (Self { sin, cos }, [north_m_s, east_m_s, down_m_s]) = (*self, <[f64; 3]>::from(velocity));
        VelocityNed::new(north_m_s * cos + east_m_s * sin, east_m_s * cos - north_m_s * sin, down_m_s)
    }

    /// Converts a heading from the local north to one in the swarm's frame, rad.
    #[inline]
    pub fn heading_from_local(&self, local_rad: f64) -> f64 {
        wrap_rad(local_rad + self.angle_rad())
    }

    /// Converts a heading in the swarm's frame to one from the local north, rad.
    #[inline]
    pub fn heading_to_local(&self, heading_rad: f64) -> f64 {
        wrap_rad(heading_rad - self.angle_rad())
    }

    /// Converts a local attitude to the swarm's frame.
    #[inline]
    pub fn attitude_from_local(&self, local: Attitude) -> Attitude {
        Attitude { heading_rad: self.heading_from_local(local.heading_rad), ..local }
    }

    /// Converts an attitude in the swarm's frame to a local one.
    #[inline]
    pub fn attitude_to_local(&self, attitude: Attitude) -> Attitude {
        Attitude { heading_rad: self.heading_to_local(attitude.heading_rad), ..attitude }
    }
}

/// Sine below which the series of the arc sine is exact.
const SMALL_SINE: f64 = 0.01;

/// A plane that touches the ellipsoid, with axes north, east and down at that point: the local frame of X-Plane. Away from
/// the point its down is not the local one, and its altitude no height above the ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TangentPlane {
    geodetic: Geodetic,
    ecef: Vector3<f64>,
    ned_from_ecef: Matrix3<f64>,
}

impl TangentPlane {
    /// The plane that touches the ellipsoid, or a surface at this height above it, in this position.
    pub fn new(geodetic: Geodetic) -> Self {
        Self { geodetic, ecef: geodetic.to_ecef(), ned_from_ecef: ned_from_ecef(&geodetic) }
    }

    /// The point in which it touches.
    pub fn geodetic(&self) -> Geodetic {
        self.geodetic
    }

    /// Place in the plane's axes, from the point in which it touches: north, east, down, m.
    pub fn ned_from_geodetic(&self, place: &Geodetic) -> Vector3<f64> {
        self.ned_from_ecef * (place.to_ecef() - self.ecef)
    }

    /// Rotation that converts components in the plane's axes to local NED at a position.
    pub fn local_from_plane(&self, place: &Geodetic) -> Rotation3<f64> {
        Rotation3::from_matrix_unchecked(ned_from_ecef(place) * self.ned_from_ecef.transpose())
    }
}

/// Rotation from Earth-centred axes to north, east and down at a position.
fn ned_from_ecef(place: &Geodetic) -> Matrix3<f64> {
    let (sin_lat, cos_lat) = math::sin_cos(place.latitude_rad);
    let (sin_lon, cos_lon) = math::sin_cos(place.longitude_rad);
    #[rustfmt::skip]
    let rotation = Matrix3::new(
        -sin_lat * cos_lon, -sin_lat * sin_lon,  cos_lat,
        -sin_lon,            cos_lon,            0.0,
        -cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat,
    );
    rotation
}

macro_rules! ned_vector {
    ($(#[$doc:meta])* $name:ident, $north:ident, $east:ident, $down:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
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
    /// Position in the swarm's frame, m.
    PositionNed, north_m, east_m, down_m
}
ned_vector! {
    /// Velocity over the ground, m/s: in the swarm's frame, or local, as what holds it says.
    VelocityNed, north_m_s, east_m_s, down_m_s
}

impl PositionNed {
    /// Height above the origin, m: the difference of the heights above the ellipsoid.
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
    /// Heading ψ, rad, clockwise from the north of the swarm's frame, or from the local true north, as what holds it says.
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
