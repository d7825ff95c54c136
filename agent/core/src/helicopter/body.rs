//! The airframe: drag, fin, stabiliser and rigid-body motion.

use core::ops::AddAssign;

use nalgebra::{Matrix3, Vector3};

use super::parameters::Parameters;

/// Force (N) and moment about the centre of gravity (N m) in body axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wrench {
    pub(super) force: Vector3<f64>,
    pub(super) moment: Vector3<f64>,
}

impl AddAssign for Wrench {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        self.force += other.force;
        self.moment += other.moment;
    }
}

/// The constants of the airframe.
#[derive(Clone, Debug)]
pub(super) struct Body {
    mass_kg: f64,
    inverse_mass: f64,
    gravity_m_s2: f64,
    inertia: Vector3<f64>,
    inverse_inertia: Vector3<f64>,
    /// Drag coefficients ½ρ S_x, ½ρ S_y, ½ρ S_z, kg/m.
    drag: Vector3<f64>,
    /// The wake's skew χ_i at which it reaches the tail rotor, and 1.5/(χ_f − χ_i).
    wake_start: f64,
    wake_slope: f64,
    /// Horizontal stabiliser: ½ρ S_ht (kg/m), C_Lα,ht (1/rad) and l_ht (m).
    stabiliser: (f64, f64, f64),
}

/// Largest ratio of the wake's speed at the tail to the main rotor's induced speed.
const WAKE_SHARE: f64 = 1.5;

impl Body {
    pub(super) fn new(parameters: &Parameters) -> Self {
        let Parameters { fuselage, stabiliser, tail, tail_rotor, .. } = parameters;
        let half_density = 0.5 * parameters.air_density_kg_m3;
        let inertia = &parameters.inertia;
        let inertia = Vector3::new(inertia.roll_kg_m2, inertia.pitch_kg_m2, inertia.yaw_kg_m2);
        let behind_m = tail.arm_m - parameters.main_rotor.radius_m;
        let wake_start = (behind_m - tail_rotor.radius_m) / tail_rotor.height_m;
        let wake_end = (behind_m + tail_rotor.radius_m) / tail_rotor.height_m;
        Self {
            mass_kg: parameters.mass_kg,
            inverse_mass: 1.0 / parameters.mass_kg,
            gravity_m_s2: parameters.gravity_m_s2,
            inertia,
            inverse_inertia: inertia.map(|moment| 1.0 / moment),
            drag: half_density
                * Vector3::new(fuselage.forward_area_m2, fuselage.side_area_m2, fuselage.vertical_area_m2),
            wake_start,
            wake_slope: WAKE_SHARE / (wake_end - wake_start),
            stabiliser: (half_density * stabiliser.area_m2, stabiliser.lift_slope_per_rad, stabiliser.arm_m),
        }
    }

    /// Downward speed of the main rotor's wake at the tail, K_λ v_i, m/s. K_λ grows from 0 to 1.5 while the skew of the
    /// wake χ = u/(v_i − w) grows from χ_i to χ_f and moves the wake over the tail rotor. An upward wake misses the
    /// tail.
    #[inline]
    pub(super) fn wake_at_tail_m_s(&self, air: &Vector3<f64>, induced_m_s: f64) -> f64 {
        let down_m_s = induced_m_s - air.z;
        if down_m_s <= 0.0 || air.x <= self.wake_start * down_m_s {
            return 0.0;
        }
        let chi = air.x / down_m_s;
        (self.wake_slope * (chi - self.wake_start)).min(WAKE_SHARE) * induced_m_s
    }

    /// Drag of the fuselage in the airflow and the main rotor's wake, N, body axes: X = −½ρ S_x V∞ u; Y and Z alike,
    /// with w − v_i in place of w.
    #[inline]
    pub(super) fn fuselage(&self, air: &Vector3<f64>, induced_m_s: f64) -> Vector3<f64> {
        let through = Vector3::new(air.x, air.y, air.z - induced_m_s);
        -self.drag.component_mul(&through) * through.norm()
    }

    /// Lift Z_h of the stabiliser and its moment M = Z_h l, for the speed |u| along and w_h = w + l q − K_λ v_i across.
    #[inline]
    pub(super) fn stabiliser(&self, air: &Vector3<f64>, pitch_rate: f64, wake_m_s: f64) -> Wrench {
        let (half_density_area, lift_slope, arm_m) = self.stabiliser;
        let w_h = air.z + arm_m * pitch_rate - wake_m_s;
        let z_h = lift_n(half_density_area, lift_slope, air.x.abs(), w_h);
        Wrench { force: Vector3::new(0.0, 0.0, z_h), moment: Vector3::new(0.0, z_h * arm_m, 0.0) }
    }

    /// Acceleration in body axes, m/s²: v̇ = −ω×v + F/m + Rᵀg.
    #[inline]
    pub(super) fn acceleration(
        &self,
        force: &Vector3<f64>,
        velocity: &Vector3<f64>,
        rates: &Vector3<f64>,
        ned_from_body: &Matrix3<f64>,
    ) -> Vector3<f64> {
        let down_in_body = ned_from_body.row(2).transpose();
        velocity.cross(rates) + force * self.inverse_mass + down_in_body * self.gravity_m_s2
    }

    /// Angular acceleration in body axes, rad/s², from I ω̇ = M − ω×Iω.
    #[inline]
    pub(super) fn angular_acceleration(&self, moment: &Vector3<f64>, rates: &Vector3<f64>) -> Vector3<f64> {
        let momentum = self.inertia.component_mul(rates);
        (moment + momentum.cross(rates)).component_mul(&self.inverse_inertia)
    }

    /// Vertical drag coefficient of the fuselage ½ρ S_z, kg/m.
    pub(super) fn vertical_drag(&self) -> f64 {
        self.drag.z
    }

    /// Weight m g, N.
    pub(super) fn weight_n(&self) -> f64 {
        self.mass_kg * self.gravity_m_s2
    }
}

/// Lift of a fin or stabiliser, N, against the flow across it: −½ρ S (C_Lα V + |v|) v for speeds V along and v across.
/// The stall limits it to ±½ρ S (V² + v²).
#[inline]
pub(super) fn lift_n(half_density_area: f64, lift_slope: f64, along_m_s: f64, across_m_s: f64) -> f64 {
    let attached = (lift_slope * along_m_s + across_m_s.abs()) * across_m_s.abs();
    let stalled = along_m_s * along_m_s + across_m_s * across_m_s;
    (half_density_area * attached.min(stalled)).copysign(-across_m_s)
}

/// The rotation matrix from body axes to NED for the unit quaternion (w, x, y, z).
#[inline]
pub(super) fn ned_from_body([w, x, y, z]: [f64; 4]) -> Matrix3<f64> {
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, yy, zz) = (x * x2, y * y2, z * z2);
    let (xy, xz, yz) = (x * y2, x * z2, y * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    #[rustfmt::skip]
    let matrix = Matrix3::new(
        1.0 - (yy + zz), xy - wz,         xz + wy,
        xy + wz,         1.0 - (xx + zz), yz - wx,
        xz - wy,         yz + wx,         1.0 - (xx + yy),
    );
    matrix
}

/// Rate of change of the quaternion, q̇ = ½ q⊗(0, ω).
#[inline]
pub(super) fn quaternion_rate([w, x, y, z]: [f64; 4], rates: &Vector3<f64>) -> [f64; 4] {
    let half = 0.5 * rates;
    let (p, q, r) = (half.x, half.y, half.z);
    [-x * p - y * q - z * r, w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p]
}
