//! The airspace of a scenario, `[airspace]`.

use serde::{Deserialize, Serialize};

use super::super::key::keys;

keys! {
    /// The volume that the swarm may fly in.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Airspace at "airspace." {
        #[serde(default)]
        fence_ne_m: Vec<[f64; 2]> = Path, Nothing,
            "corners of a convex polygon that the vehicles stay inside; without it there is no fence";
        ceiling_m: Option<f64> = above_zero_or("none", 1e5), text("none"),
            "greatest altitude above the origin that a vehicle is sent to";
        floor_m: Option<f64> = above_zero_or("none", 1e5), text("none"),
            "least altitude above the origin that a vehicle is sent to unless it lands";
        floor_above_ground_m: Option<f64> = above_zero_or("none", 1e5), text("none"),
            "least height above the ground below it that a vehicle is sent to unless it lands, as it measures its height; it outranks the ceiling";
        margin_m: f64 = from(0.0, 1e3), number(10.0),
            "horizontal distance that the vehicles keep from the fence and from obstacles; 10 m is for wind and for the lag of a vehicle";
        obstacles: Vec<StaticObstacle> = Tables, Nothing,
            "cylinders and boxes that stand on the ground and that the vehicles fly around";
    }

    /// A cylinder or a box that stands on the ground, an entry of `airspace.obstacles`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct StaticObstacle at "airspace.obstacles[N]." {
        centre_ne_m: [f64; 2] = Point, Required,
            "middle of the obstacle";
        radius_m: Option<f64> = above_zero(1e5), Nothing,
            "radius of a cylinder; an obstacle has this or size_ne_m";
        size_ne_m: Option<[f64; 2]> = Point, Nothing,
            "lengths of a box to the north and to the east; an obstacle has this or radius_m";
        top_m: Option<f64> = above_zero(1e5), Nothing,
            "altitude of the top above the origin; vehicles 5 m above it fly over the obstacle. Without it none does";
    }
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
