//! Gains: how strongly and in which direction an aircraft's controls have to move for what the rules ask.

use serde::Deserialize;

/// Factors on the movement of each control about its trim, the `[gains]` table of an aircraft file. The rules were tuned
/// on the built-in helicopter; a factor of 2 is right for an aircraft that answers half as strongly, a negative one for
/// an aircraft that answers in the opposite direction. Keys missing in a file are 1.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "GainsTable")]
pub struct Gains {
    /// Factor of the roll control.
    pub roll: f64,
    /// Factor of the pitch control.
    pub pitch: f64,
    /// Factor of the yaw control.
    pub yaw: f64,
    /// Factor of the collective; positive, because a collective that works in the opposite direction is not safe to try.
    pub collective: f64,
}

impl Default for Gains {
    fn default() -> Self {
        Self { roll: 1.0, pitch: 1.0, yaw: 1.0, collective: 1.0 }
    }
}

/// The largest factor; its reciprocal is the smallest.
const LARGEST: f64 = 20.0;

/// The `[gains]` table as written.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct GainsTable {
    roll: f64,
    pitch: f64,
    yaw: f64,
    collective: f64,
}

impl Default for GainsTable {
    fn default() -> Self {
        let Gains { roll, pitch, yaw, collective } = Gains::default();
        Self { roll, pitch, yaw, collective }
    }
}

/// A number outside its limits in a `[gains]` or `[trim]` table.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key} is {value}, but has to be within {low} to {high}{or_negative}")]
pub struct OutOfLimits {
    pub(super) key: &'static str,
    pub(super) value: f64,
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) or_negative: &'static str,
}

impl TryFrom<GainsTable> for Gains {
    type Error = OutOfLimits;

    fn try_from(table: GainsTable) -> Result<Self, OutOfLimits> {
        let (low, high) = (1.0 / LARGEST, LARGEST);
        let within = |key, value: f64, size: f64, or_negative| {
            if (low..=high).contains(&size) {
                Ok(value)
            } else {
                Err(OutOfLimits { key, value, low, high, or_negative })
            }
        };
        let signed = |key, value: f64| within(key, value, value.abs(), ", or negative");
        Ok(Self {
            roll: signed("roll", table.roll)?,
            pitch: signed("pitch", table.pitch)?,
            yaw: signed("yaw", table.yaw)?,
            collective: within("collective", table.collective, table.collective, "")?,
        })
    }
}
