//! The airspace of a scenario, `[airspace]`.

use serde::{Deserialize, Serialize};

/// The volume that the swarm may fly in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Airspace {
    /// Corners of a convex polygon that the vehicles stay inside, each north and east of the origin, m; empty: no fence.
    #[serde(default)]
    pub fence_ne_m: Vec<[f64; 2]>,
    /// Greatest altitude setpoint above the origin, m; `None`: no ceiling.
    pub ceiling_m: Option<f64>,
    /// Least altitude setpoint above the origin of a vehicle that does not land, m; `None`: no floor.
    pub floor_m: Option<f64>,
    /// Least altitude setpoint above the ground below a vehicle that does not land, m, as its height is measured; `None`: no
    /// such floor.
    pub floor_above_ground_m: Option<f64>,
    /// Horizontal distance that the vehicles keep from the fence and from obstacles, m.
    pub margin_m: f64,
    /// Things that stand in the airspace.
    pub obstacles: Vec<StaticObstacle>,
}

/// A cylinder or a box that stands on the ground, an entry of `airspace.obstacles`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StaticObstacle {
    /// Its middle, north and east of the origin, m.
    pub centre_ne_m: [f64; 2],
    /// Radius of a cylinder, m.
    pub radius_m: Option<f64>,
    /// Lengths of a box to the north and to the east, m.
    pub size_ne_m: Option<[f64; 2]>,
    /// Altitude of its top above the origin, m; `None`: no vehicle flies over it.
    pub top_m: Option<f64>,
}

impl Default for Airspace {
    fn default() -> Self {
        Self {
            fence_ne_m: Vec::new(),
            ceiling_m: None,
            floor_m: None,
            floor_above_ground_m: None,
            margin_m: 10.0,
            obstacles: Vec::new(),
        }
    }
}

impl Airspace {
    /// Whether it limits nothing.
    pub fn is_unlimited(&self) -> bool {
        let is_open = self.ceiling_m.is_none() && self.floor_m.is_none() && self.floor_above_ground_m.is_none();
        is_open && self.fence_ne_m.is_empty() && self.obstacles.is_empty()
    }
}
