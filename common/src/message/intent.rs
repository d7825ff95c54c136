//! The place that a team of a fleet occupies and the one that it wants, for the other teams.

use serde::{Deserialize, Serialize};

use super::{Header, Message, message};
use crate::frame::{Geodetic, Origin};
use crate::topic::{Author, Cell, Topic};

/// A circular area at one altitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Area {
    /// Its centre, at the formation's altitude.
    pub centre: Geodetic,
    /// Its radius, m: no vehicle of the team's formation is farther from the centre.
    pub radius_m: f32,
}

impl Area {
    /// Largest plausible radius, m.
    pub const MAX_RADIUS_M: f32 = 20_000.0;

    fn is_plausible(&self) -> bool {
        self.centre.is_plausible() && (0.0..=Self::MAX_RADIUS_M).contains(&self.radius_m)
    }
}

/// Operational intent of a vehicle's team, as that vehicle knows it. Sent once a second and at every change, under the cell of
/// each area.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intent {
    /// Sender, number and time of the message.
    pub header: Header,
    /// The area of the step that the team flies.
    pub occupied: Area,
    /// The area of the next step, once this vehicle has completed its step and waits for that area; else `None`.
    pub wanted: Option<Area>,
}

impl Intent {
    /// The cells under which the message is sent: those of its areas. `map` is the origin of the cells.
    pub fn cells(&self, map: &Origin) -> impl Iterator<Item = Cell> {
        let cell = |area: &Area| Cell::of(map.ned_from_geodetic(&area.centre));
        let occupied = cell(&self.occupied);
        let wanted = self.wanted.as_ref().map(cell).filter(|wanted| *wanted != occupied);
        [Some(occupied), wanted].into_iter().flatten()
    }
}

message!(Intent, 128, |message| Author::Vehicle(message.header.sender), |message| {
    message.occupied.is_plausible() && message.wanted.is_none_or(|area| area.is_plausible())
});
