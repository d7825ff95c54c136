//! RPOS: the position stream. Positions are in double precision and carry no time stamp.

use super::{Tag, WireError, begin, body, body_of_size, decimal, put_decimal};

/// Tag of the message.
pub const TAG: Tag = *b"RPOS";
/// Length of an encoded [`Position`], bytes.
pub const SIZE: usize = 69;

/// Subscription to [`Position`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PositionRequest {
    /// Positions per second; 0 ends the subscription. X-Plane never sends more than one position per frame.
    pub rate_hz: u32,
}

impl PositionRequest {
    /// Decodes the rate: decimal digits up to a NUL or to the end; padding after the NUL is ignored.
    ///
    /// # Errors
    /// If the datagram is not a subscription.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        Ok(Self { rate_hz: decimal(body(datagram, &TAG)?)? })
    }

    /// Encodes the rate as digits and a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &TAG, 0);
        put_decimal(out, self.rate_hz);
    }
}

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

impl Position {
    /// Decodes a position.
    ///
    /// # Errors
    /// If the datagram is not a position, a number is not finite, or the place is not on the globe.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &TAG, SIZE)?;
        let position = Self {
            longitude_deg: fields.finite_f64()?,
            latitude_deg: fields.finite_f64()?,
            elevation_m: fields.finite_f64()?,
            height_m: fields.finite_f32()?,
            pitch_deg: fields.finite_f32()?,
            heading_deg: fields.finite_f32()?,
            roll_deg: fields.finite_f32()?,
            velocity_east_m_s: fields.finite_f32()?,
            velocity_up_m_s: fields.finite_f32()?,
            velocity_south_m_s: fields.finite_f32()?,
            roll_rate_rad_s: fields.finite_f32()?,
            pitch_rate_rad_s: fields.finite_f32()?,
            yaw_rate_rad_s: fields.finite_f32()?,
        };
        let on_the_globe = position.latitude_deg.abs() <= 90.0 && position.longitude_deg.abs() <= 180.0;
        if on_the_globe { Ok(position) } else { Err(WireError::OutOfRange) }
    }

    /// Encodes the position.
    pub fn encode(&self, out: &mut Vec<u8>) {
        begin(out, &TAG, 0);
        for value in [self.longitude_deg, self.latitude_deg, self.elevation_m] {
            out.extend(value.to_le_bytes());
        }
        for value in [
            self.height_m,
            self.pitch_deg,
            self.heading_deg,
            self.roll_deg,
            self.velocity_east_m_s,
            self.velocity_up_m_s,
            self.velocity_south_m_s,
            self.roll_rate_rad_s,
            self.pitch_rate_rad_s,
            self.yaw_rate_rad_s,
        ] {
            out.extend(value.to_le_bytes());
        }
    }
}
