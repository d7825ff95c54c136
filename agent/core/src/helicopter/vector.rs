//! Vectors and rotations of the flight model, for one helicopter or for eight (see [`crate::lanes`]).

use core::ops::{Add, AddAssign, Mul, Neg, Sub};

use nalgebra::Vector3;

use crate::lanes::{Real, numbers};

numbers! {
    /// A vector in body or NED axes.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub(super) struct Vector<R> {
        pub(super) x: R,
        pub(super) y: R,
        pub(super) z: R,
    }
}

impl<R> Vector<R> {
    #[inline(always)]
    pub(super) const fn new(x: R, y: R, z: R) -> Self {
        Self { x, y, z }
    }
}

impl<R: Real> Vector<R> {
    /// Scalar product.
    #[inline(always)]
    pub(super) fn dot(self, other: Self) -> R {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Vector product.
    #[inline(always)]
    pub(super) fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// The products of the components.
    #[inline(always)]
    pub(super) fn component_mul(self, other: Self) -> Self {
        Self::new(self.x * other.x, self.y * other.y, self.z * other.z)
    }

    /// Length.
    #[inline(always)]
    pub(super) fn norm(self) -> R {
        self.dot(self).sqrt()
    }

    /// `yes` where the mask is set, `no` elsewhere.
    #[inline(always)]
    pub(super) fn select(mask: R::Mask, yes: Self, no: Self) -> Self {
        Self::new(R::select(mask, yes.x, no.x), R::select(mask, yes.y, no.y), R::select(mask, yes.z, no.z))
    }
}

impl<R: Real> Add for Vector<R> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y, self.z + other.z)
    }
}

impl<R: Real> AddAssign for Vector<R> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<R: Real> Sub for Vector<R> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y, self.z - other.z)
    }
}

impl<R: Real> Neg for Vector<R> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}

impl<R: Real> Mul<R> for Vector<R> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: R) -> Self {
        Self::new(self.x * factor, self.y * factor, self.z * factor)
    }
}

impl From<Vector3<f64>> for Vector<f64> {
    fn from(vector: Vector3<f64>) -> Self {
        Self::new(vector.x, vector.y, vector.z)
    }
}

impl From<Vector<f64>> for Vector3<f64> {
    fn from(vector: Vector<f64>) -> Self {
        Self::new(vector.x, vector.y, vector.z)
    }
}

/// A rotation matrix from body axes to NED, by its rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rotation<R> {
    /// The north axis in body axes.
    pub(super) north: Vector<R>,
    /// The east axis in body axes.
    pub(super) east: Vector<R>,
    /// The down axis in body axes.
    pub(super) down: Vector<R>,
}

impl<R: Real> Rotation<R> {
    /// A vector in NED from its body axes.
    #[inline(always)]
    pub(super) fn to_ned(self, body: Vector<R>) -> Vector<R> {
        Vector::new(self.north.dot(body), self.east.dot(body), self.down.dot(body))
    }

    /// A vector in body axes from its NED components.
    #[inline(always)]
    pub(super) fn to_body(self, ned: Vector<R>) -> Vector<R> {
        let Self { north, east, down } = self;
        Vector::new(
            north.x * ned.x + east.x * ned.y + down.x * ned.z,
            north.y * ned.x + east.y * ned.y + down.y * ned.z,
            north.z * ned.x + east.z * ned.y + down.z * ned.z,
        )
    }
}
