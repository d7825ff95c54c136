//! The air around the aircraft, and how it moves through it.

use skein_common::math;

use crate::plant::xplane::wire::rpos::Position;

pub(super) const FEET_PER_M: f64 = 1.0 / 0.3048;
pub(super) const KNOTS_PER_M_S: f64 = 3600.0 / 1852.0;
/// Pressure of an inch of mercury, Pa.
const PA_PER_INHG: f64 = 3386.389;
/// Below this speed over the ground a path has no direction, m/s: the aircraft counts as flying where its nose points.
const AT_REST_M_S: f64 = 0.1;

/// The International Standard Atmosphere (ISO 2533) below 11 km.
#[derive(Clone, Copy, Debug)]
pub(super) struct Air {
    pub(super) pressure_pa: f64,
    pub(super) density_kg_m3: f64,
    temperature_k: f64,
}

impl Air {
    /// The air at this elevation above mean sea level, m.
    pub(super) fn at(elevation_m: f64) -> Self {
        let temperature_k = 288.15 - 0.0065 * elevation_m.clamp(-1_000.0, 11_000.0);
        let pressure_pa = 101_325.0 * math::pow(temperature_k / 288.15, 5.255_88);
        Self { pressure_pa, density_kg_m3: pressure_pa / (287.052_87 * temperature_k), temperature_k }
    }

    pub(super) fn pressure_inhg(self) -> f64 {
        self.pressure_pa / PA_PER_INHG
    }

    pub(super) fn temperature_c(self) -> f64 {
        self.temperature_k - 273.15
    }
}

/// The motion over the ground and through the mean wind. Angles in degrees, as X-Plane's: vpath + alpha = theta, and
/// hpath + beta = psi.
#[derive(Clone, Copy, Debug)]
pub(super) struct Flow {
    pub(super) true_airspeed_m_s: f64,
    /// Share of the true airspeed that instruments show in this air: the root of its density against that at sea level.
    shown: f64,
    /// Direction of the path over the ground, clockwise from north, 0 to 360.
    pub(super) hpath_deg: f64,
    /// Angle of the path above the horizontal.
    pub(super) vpath_deg: f64,
    pub(super) alpha_deg: f64,
    pub(super) beta_deg: f64,
}

impl Flow {
    /// In this wind towards east, up and south, m/s.
    pub(super) fn of(position: &Position, wind_m_s: [f64; 3], air: Air) -> Self {
        let velocity = [position.velocity_east_m_s, position.velocity_up_m_s, position.velocity_south_m_s];
        let [east, up, south] = velocity.map(f64::from);
        let [wind_east, wind_up, wind_south] = wind_m_s;
        let level_m_s = math::hypot(east, south);
        let (heading_deg, pitch_deg) = (f64::from(position.heading_deg), f64::from(position.pitch_deg));
        let has_path = math::hypot(level_m_s, up) >= AT_REST_M_S;
        let hpath_deg = if level_m_s >= AT_REST_M_S { math::atan2(east, -south).to_degrees() } else { heading_deg };
        let vpath_deg = if has_path { math::atan2(up, level_m_s).to_degrees() } else { 0.0 };
        Self {
            true_airspeed_m_s: math::hypot(math::hypot(east - wind_east, south - wind_south), up - wind_up),
            shown: (air.density_kg_m3 / Air::at(0.0).density_kg_m3).sqrt(),
            hpath_deg: hpath_deg.rem_euclid(360.0),
            vpath_deg,
            alpha_deg: pitch_deg - vpath_deg,
            beta_deg: (heading_deg - hpath_deg + 180.0).rem_euclid(360.0) - 180.0,
        }
    }

    pub(super) fn true_airspeed_kt(self) -> f64 {
        self.true_airspeed_m_s * KNOTS_PER_M_S
    }

    /// Equivalent airspeed, which at a helicopter's speeds is the indicated one.
    pub(super) fn equivalent_airspeed_kt(self) -> f64 {
        self.true_airspeed_kt() * self.shown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(one: f64, other: f64, within: f64) {
        assert!((one - other).abs() < within, "{one}, not {other}");
    }

    #[test]
    fn the_air_is_that_of_the_standard_atmosphere() {
        let (ground, high) = (Air::at(0.0), Air::at(1_000.0));
        near(ground.pressure_inhg(), 29.92, 0.005);
        near(ground.density_kg_m3, 1.225, 5e-4);
        near(high.pressure_pa, 89_875.0, 5.0);
        near(high.density_kg_m3, 1.1117, 5e-4);
        near(high.temperature_c(), 8.5, 1e-9);
    }

    #[test]
    fn a_path_has_the_angles_of_x_plane() {
        // North-east and climbing at 45°, the nose 10° right of the path and 5° above it.
        let position = Position {
            velocity_east_m_s: 3.0,
            velocity_south_m_s: -3.0,
            velocity_up_m_s: f32::hypot(3.0, 3.0),
            heading_deg: 55.0,
            pitch_deg: 50.0,
            ..Position::default()
        };
        let flow = Flow::of(&position, [0.0; 3], Air::at(0.0));
        for (found, expected) in
            [(flow.hpath_deg, 45.0), (flow.vpath_deg, 45.0), (flow.alpha_deg, 5.0), (flow.beta_deg, 10.0)]
        {
            near(found, expected, 1e-4);
        }
        near(flow.true_airspeed_m_s, 6.0, 1e-5);
        near(flow.equivalent_airspeed_kt(), 6.0 * KNOTS_PER_M_S, 1e-4);
        // At rest in wind from the south.
        let rest = Position { heading_deg: 350.0, ..Position::default() };
        let flow = Flow::of(&rest, [0.0, 0.0, -4.0], Air::at(0.0));
        assert_eq!((flow.hpath_deg, flow.vpath_deg, flow.beta_deg), (350.0, 0.0, 0.0));
        near(flow.true_airspeed_m_s, 4.0, 1e-9);
    }
}
