//! RADR: the weather radar. X-Plane serves one client only. Versions 11 and 12 reply in different layouts, which only
//! the version distinguishes.

use super::{Fields, Tag, WireError, begin, body, decimal, put_decimal};

/// Tag of the message.
pub const TAG: Tag = *b"RADR";
/// Length of a point of X-Plane 12, bytes.
const POINT: usize = 24;
/// Length of a point of X-Plane 11, bytes.
const POINT_11: usize = 13;

/// Subscription to the points of the radar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RadarRequest {
    /// Points per second; 0 ends the subscription.
    pub rate_hz: u32,
}

impl RadarRequest {
    /// Decodes the rate: decimal digits up to a NUL or to the end.
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

fn decode<T>(
    datagram: &[u8],
    size: usize,
    read: impl Fn(&mut Fields<'_>) -> Result<T, WireError>,
) -> Result<Vec<T>, WireError> {
    let body = body(datagram, &TAG)?;
    if body.is_empty() || !body.len().is_multiple_of(size) {
        return Err(WireError::WrongSize);
    }
    body.chunks(size).map(|point| read(&mut Fields(point))).collect()
}

impl RadarPoint {
    /// Decodes the points of a reply of X-Plane 12.
    ///
    /// # Errors
    /// If the datagram has another tag or length, or a number is not finite.
    pub fn decode(datagram: &[u8]) -> Result<Vec<Self>, WireError> {
        decode(datagram, POINT, |fields| {
            Ok(Self {
                longitude_deg: fields.finite_f32()?,
                latitude_deg: fields.finite_f32()?,
                base_m: fields.finite_f32()?,
                top_m: fields.finite_f32()?,
                clouds: fields.finite_f32()?,
                precipitation: fields.finite_f32()?,
            })
        })
    }

    /// Encodes points.
    pub fn encode(points: &[Self], out: &mut Vec<u8>) {
        begin(out, &TAG, 0);
        for Self { longitude_deg, latitude_deg, base_m, top_m, clouds, precipitation } in points {
            for value in [longitude_deg, latitude_deg, base_m, top_m, clouds, precipitation] {
                out.extend(value.to_le_bytes());
            }
        }
    }
}

impl RadarPoint11 {
    /// Decodes the points of a reply of X-Plane 11.
    ///
    /// # Errors
    /// If the datagram has another tag or length, or a number is not finite.
    pub fn decode(datagram: &[u8]) -> Result<Vec<Self>, WireError> {
        decode(datagram, POINT_11, |fields| {
            Ok(Self {
                longitude_deg: fields.finite_f32()?,
                latitude_deg: fields.finite_f32()?,
                level: fields.u8()?,
                height_m: fields.finite_f32()?,
            })
        })
    }

    /// Encodes points.
    pub fn encode(points: &[Self], out: &mut Vec<u8>) {
        begin(out, &TAG, 0);
        for point in points {
            out.extend(point.longitude_deg.to_le_bytes());
            out.extend(point.latitude_deg.to_le_bytes());
            out.push(point.level);
            out.extend(point.height_m.to_le_bytes());
        }
    }
}
