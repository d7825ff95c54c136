//! The airframe: drag, fin, stabiliser and rigid-body motion.

use core::ops::AddAssign;

use super::parameters::Parameters;
use super::vector::{Rotation, Vector};
use crate::lanes::{Mask, Real, numbers};

/// Force (N) and moment about the centre of gravity (N m) in body axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wrench<R> {
    pub(super) force: Vector<R>,
    pub(super) moment: Vector<R>,
}

impl<R: Real> AddAssign for Wrench<R> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.force += other.force;
        self.moment += other.moment;
    }
}

numbers! {
    /// The constants of the airframe.
    #[derive(Clone, Debug, Default)]
    pub(super) struct Body<R> {
        mass_kg: R,
        inverse_mass: R,
        gravity_m_s2: R,
        inertia: Vector<R>,
        inverse_inertia: Vector<R>,
        /// Drag coefficients ½ρ S_x, ½ρ S_y, ½ρ S_z, kg/m.
        pub(super) drag: Vector<R>,
        /// The wake's skew χ_i at which it reaches the tail rotor, and 1.5/(χ_f − χ_i).
        wake_start: R,
        wake_slope: R,
        /// Horizontal stabiliser: ½ρ S_ht (kg/m), C_Lα,ht (1/rad) and l_ht (m).
        stabiliser: [R; 3],
    }
}

/// Largest ratio of the wake's speed at the tail to the main rotor's induced speed.
const WAKE_SHARE: f64 = 1.5;

impl Body<f64> {
    pub(super) fn new(parameters: &Parameters) -> Self {
        let Parameters { fuselage, stabiliser, tail, tail_rotor, .. } = parameters;
        let half_density = 0.5 * parameters.air_density_kg_m3;
        let inertia = &parameters.inertia;
        let inertia = Vector::new(inertia.roll_kg_m2, inertia.pitch_kg_m2, inertia.yaw_kg_m2);
        let behind_m = tail.arm_m - parameters.main_rotor.radius_m;
        let wake_start = (behind_m - tail_rotor.radius_m) / tail_rotor.height_m;
        let wake_end = (behind_m + tail_rotor.radius_m) / tail_rotor.height_m;
        Self {
            mass_kg: parameters.mass_kg,
            inverse_mass: 1.0 / parameters.mass_kg,
            gravity_m_s2: parameters.gravity_m_s2,
            inertia,
            inverse_inertia: Vector::new(1.0 / inertia.x, 1.0 / inertia.y, 1.0 / inertia.z),
            drag: Vector::new(fuselage.forward_area_m2, fuselage.side_area_m2, fuselage.vertical_area_m2)
                * half_density,
            wake_start,
            wake_slope: WAKE_SHARE / (wake_end - wake_start),
            stabiliser: [half_density * stabiliser.area_m2, stabiliser.lift_slope_per_rad, stabiliser.arm_m],
        }
    }

    /// Weight m g, N.
    pub(super) fn weight_n(&self) -> f64 {
        self.mass_kg * self.gravity_m_s2
    }
}

impl<R: Real> Body<R> {
    /// Downward speed of the main rotor's wake at the tail, K_λ v_i, m/s. K_λ grows from 0 to 1.5 while the skew of the
    /// wake χ = u/(v_i − w) grows from χ_i to χ_f and moves the wake over the tail rotor. An upward wake misses the
    /// tail.
    #[inline(always)]
    pub(super) fn wake_at_tail_m_s(&self, air: Vector<R>, induced_m_s: R) -> R {
        let down_m_s = induced_m_s - air.z;
        let missed = down_m_s.le(R::splat(0.0)) | air.x.le(self.wake_start * down_m_s);
        if missed.all() {
            return R::splat(0.0);
        }
        let chi = air.x / down_m_s;
        let share = (self.wake_slope * (chi - self.wake_start)).min(R::splat(WAKE_SHARE));
        R::select(missed, R::splat(0.0), share * induced_m_s)
    }

    /// Drag of the fuselage in the airflow and the main rotor's wake, N, body axes: X = −½ρ S_x V∞ u; Y and Z alike,
    /// with w − v_i in place of w.
    #[inline(always)]
    pub(super) fn fuselage(&self, air: Vector<R>, induced_m_s: R) -> Vector<R> {
        let through = Vector::new(air.x, air.y, air.z - induced_m_s);
        -self.drag.component_mul(through) * through.norm()
    }

    /// Lift Z_h of the stabiliser and its moment M = Z_h l, for the speed |u| along and w_h = w + l q − K_λ v_i across.
    #[inline(always)]
    pub(super) fn stabiliser(&self, air: Vector<R>, pitch_rate: R, wake_m_s: R) -> Wrench<R> {
        let [half_density_area, lift_slope, arm_m] = self.stabiliser;
        let w_h = air.z + arm_m * pitch_rate - wake_m_s;
        let z_h = lift_n(half_density_area, lift_slope, air.x.abs(), w_h);
        let zero = R::splat(0.0);
        Wrench { force: Vector::new(zero, zero, z_h), moment: Vector::new(zero, z_h * arm_m, zero) }
    }

    /// Acceleration in body axes, m/s²: v̇ = −ω×v + F/m + Rᵀg.
    #[inline(always)]
    pub(super) fn acceleration(
        &self,
        force: Vector<R>,
        velocity: Vector<R>,
        rates: Vector<R>,
        ned_from_body: &Rotation<R>,
    ) -> Vector<R> {
        velocity.cross(rates) + force * self.inverse_mass + ned_from_body.down * self.gravity_m_s2
    }

    /// Angular acceleration in body axes, rad/s², from I ω̇ = M − ω×Iω.
    #[inline(always)]
    pub(super) fn angular_acceleration(&self, moment: Vector<R>, rates: Vector<R>) -> Vector<R> {
        let momentum = self.inertia.component_mul(rates);
        (moment + momentum.cross(rates)).component_mul(self.inverse_inertia)
    }
}

/// Lift of a fin or stabiliser, N, against the flow across it: −½ρ S (C_Lα V + |v|) v for speeds V along and v across.
/// The stall limits it to ±½ρ S (V² + v²).
#[inline(always)]
pub(super) fn lift_n<R: Real>(half_density_area: R, lift_slope: R, along_m_s: R, across_m_s: R) -> R {
    let attached = (lift_slope * along_m_s + across_m_s.abs()) * across_m_s.abs();
    let stalled = along_m_s * along_m_s + across_m_s * across_m_s;
    (half_density_area * attached.min(stalled)).copysign(-across_m_s)
}

/// The rotation matrix from body axes to NED for the unit quaternion (w, x, y, z).
#[inline(always)]
pub(super) fn ned_from_body<R: Real>([w, x, y, z]: [R; 4]) -> Rotation<R> {
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, yy, zz) = (x * x2, y * y2, z * z2);
    let (xy, xz, yz) = (x * y2, x * z2, y * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    let one = R::splat(1.0);
    Rotation {
        north: Vector::new(one - (yy + zz), xy - wz, xz + wy),
        east: Vector::new(xy + wz, one - (xx + zz), yz - wx),
        down: Vector::new(xz - wy, yz + wx, one - (xx + yy)),
    }
}

/// Rate of change of the quaternion, q̇ = ½ q⊗(0, ω).
#[inline(always)]
pub(super) fn quaternion_rate<R: Real>([w, x, y, z]: [R; 4], rates: Vector<R>) -> [R; 4] {
    let Vector { x: p, y: q, z: r } = rates * R::splat(0.5);
    [-x * p - y * q - z * r, w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p]
}
