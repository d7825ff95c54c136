//! Converts the dimensionless formation field to the velocity that the vehicle controller flies. Garcia & Barnes 2010
//! (equations 10 and 11) convert the field to a position error and name a non-linear conversion as future work. The
//! gains are metres of that error, and the controller flies 0.5 m/s per metre.

use nalgebra::Vector2;
use skein_common::scenario::{self, Formation};

use crate::setpoint::VELOCITY_PER_ERROR_PER_S;

/// Conversion c0 v + (c1 − c0) v³ / (v² + v_b²) from the length of the field to metres: gain c0 near the setpoint, c1 far
/// from it. With c1 = c0 it is linear. The direction never changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conversion {
    /// Near gain c0, m.
    gain_m: f64,
    /// Far gain c1, m, not below c0.
    far_gain_m: f64,
    /// Field length v_b at the transition between the gains, dimensionless.
    knee: f64,
}

impl Conversion {
    /// The conversion configured by a scenario.
    pub fn of(settings: &Formation) -> Self {
        let &Formation { gain_m, far_gain_m, gain_knee: knee, .. } = settings;
        match settings.conversion {
            scenario::Conversion::Linear => Self { gain_m, far_gain_m: gain_m, knee },
            scenario::Conversion::Nonlinear => Self { gain_m, far_gain_m, knee },
        }
    }

    /// Metres of position error per unit of field, for the square of the field's length `v`: f(v)/v.
    #[inline]
    fn gain_m(&self, v_squared: f64) -> f64 {
        let &Self { gain_m, far_gain_m, knee } = self;
        gain_m + (far_gain_m - gain_m) * v_squared / (v_squared + knee * knee)
    }

    /// The velocity relative to the centre for a field vector, both north and east, m/s. A zero field gives zero
    /// velocity.
    #[inline]
    pub fn velocity_ne_m_s(&self, field_ne: Vector2<f64>) -> Vector2<f64> {
        field_ne * self.gain_m(field_ne.norm_squared()) * VELOCITY_PER_ERROR_PER_S
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use skein_common::math;

    use super::*;

    const DEFAULT: Conversion = Conversion { gain_m: 7.0, far_gain_m: 28.0, knee: 0.3 };

    fn length(conversion: Conversion, v: f64) -> f64 {
        conversion.velocity_ne_m_s(Vector2::new(v, 0.0)).x / VELOCITY_PER_ERROR_PER_S
    }

    #[test]
    fn far_and_near_gains() {
        assert!((length(DEFAULT, 1.0) - 26.27).abs() < 0.01);
        assert!((length(DEFAULT, 1e-4) / 1e-4 - 7.0).abs() < 1e-3, "slope c0 at zero");
        assert!((length(DEFAULT, 1e4) / 1e4 - 28.0).abs() < 1e-3, "slope c1 far away");
        assert_eq!(length(DEFAULT, 0.0), 0.0);
        assert_eq!(length(Conversion { far_gain_m: 7.0, ..DEFAULT }, -0.5), -3.5);
    }

    proptest! {
        #[test]
        fn the_conversion_is_odd_monotone_and_keeps_the_direction(
            v in 0.0..5.0, more in 1e-6..1.0, c0 in 0.1..20.0, extra in 0.0..60.0, knee in 0.05..2.0, angle in -3.0..3.0,
        ) {
            let conversion = Conversion { gain_m: c0, far_gain_m: c0 + extra, knee };
            prop_assert!(length(conversion, v + more) > length(conversion, v));
            prop_assert!(length(conversion, v) >= c0 * v - 1e-12);
            prop_assert!((length(conversion, -v) + length(conversion, v)).abs() < 1e-12);
            let field = Vector2::new(math::cos(angle), math::sin(angle)) * v;
            prop_assert!(conversion.velocity_ne_m_s(field).perp(&field).abs() < 1e-9);
            let linear = Conversion { gain_m: c0, far_gain_m: c0, knee };
            prop_assert!((length(linear, v) - c0 * v).abs() < 1e-12);
        }
    }
}
