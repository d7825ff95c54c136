//! Eight numbers side by side ([`Lanes`]): of eight helicopters in the flight model, of eight neighbours in a law.
//!
//! The equations of the flight model are written once, for any [`Real`], and used for one helicopter (`f64`) too. A lane of [`Lanes`] has exactly the bits that `f64` has: every
//! operation is one of IEEE 754's correctly rounded ones (+ − × ÷ √), a comparison or a selection, and none mixes
//! lanes. A branch of the equations is therefore a [`Real::select`]; a part of them may be skipped when no lane needs
//! it.
//!
//! Everything here is inlined into its caller, so that one caller compiled for AVX-512 or AVX2 and another compiled for
//! any processor both get vector instructions of their own kind. For the same reason the vectors of the flight model
//! (`helicopter/vector.rs`) are not nalgebra's, whose functions are too large for the compiler to inline with eight lanes.

use core::f64::consts::LOG2_E;
use core::fmt::Debug;
use core::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

/// Number of lanes.
pub(crate) const LANES: usize = 8;

/// A number: `f64`, or [`Lanes`] of them.
pub(crate) trait Real:
    Copy
    + Debug
    + Default
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
{
    /// The result of a comparison.
    type Mask: Mask;

    /// This constant in every lane.
    fn splat(value: f64) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// The magnitude of `self` with the sign of `sign`.
    fn copysign(self, sign: Self) -> Self;
    /// Whether `self` is less than `other`.
    fn lt(self, other: Self) -> Self::Mask;
    /// Whether `self` is at most `other`.
    fn le(self, other: Self) -> Self::Mask;
    /// `yes` where the mask is set, `no` elsewhere.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// The larger number; `other` where `self` is not a number.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select(other.lt(self), self, other)
    }

    /// The smaller number; `other` where `self` is not a number.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select(self.lt(other), self, other)
    }

    /// The nearest number between `least` and `greatest`.
    #[inline(always)]
    fn clamp(self, least: Self, greatest: Self) -> Self {
        let raised = Self::select(self.lt(least), least, self);
        Self::select(greatest.lt(raised), greatest, raised)
    }
}

/// The result of a comparison in every lane.
pub(crate) trait Mask: Copy + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self> {
    /// Whether it holds in at least one lane.
    fn any(self) -> bool;

    /// Whether it holds in all lanes.
    #[inline(always)]
    fn all(self) -> bool {
        !(!self).any()
    }
}

impl Real for f64 {
    type Mask = bool;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        self.copysign(sign)
    }

    #[inline(always)]
    fn lt(self, other: Self) -> bool {
        self < other
    }

    #[inline(always)]
    fn le(self, other: Self) -> bool {
        self <= other
    }

    #[inline(always)]
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
}

impl Mask for bool {
    #[inline(always)]
    fn any(self) -> bool {
        self
    }
}

/// Eight numbers.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Lanes(pub(crate) [f64; LANES]);

/// The result of a comparison of [`Lanes`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct LaneMask([bool; LANES]);

/// Applies an expression to every lane. No closure: one that is not inlined is compiled for any processor.
macro_rules! each_lane {
    ($lane:ident => $value:expr; $empty:expr) => {{
        let mut lanes = [$empty; LANES];
        let mut $lane = 0;
        while $lane < LANES {
            lanes[$lane] = $value;
            $lane += 1;
        }
        lanes
    }};
}

macro_rules! operators {
    ($($trait:ident::$method:ident $operator:tt),*) => {$(
        impl $trait for Lanes {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(each_lane!(i => self.0[i] $operator other.0[i]; 0.0))
            }
        }

        impl $trait<f64> for Lanes {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: f64) -> Self {
                Self(each_lane!(i => self.0[i] $operator other; 0.0))
            }
        }
    )*};
}

operators!(Add::add +, Sub::sub -, Mul::mul *, Div::div /);

impl Neg for Lanes {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self(each_lane!(i => -self.0[i]; 0.0))
    }
}

impl Real for Lanes {
    type Mask = LaneMask;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(each_lane!(i => self.0[i].abs(); 0.0))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(each_lane!(i => self.0[i].sqrt(); 0.0))
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        Self(each_lane!(i => self.0[i].copysign(sign.0[i]); 0.0))
    }

    #[inline(always)]
    fn lt(self, other: Self) -> LaneMask {
        LaneMask(each_lane!(i => self.0[i] < other.0[i]; false))
    }

    #[inline(always)]
    fn le(self, other: Self) -> LaneMask {
        LaneMask(each_lane!(i => self.0[i] <= other.0[i]; false))
    }

    #[inline(always)]
    fn select(mask: LaneMask, yes: Self, no: Self) -> Self {
        Self(each_lane!(i => if mask.0[i] { yes.0[i] } else { no.0[i] }; 0.0))
    }
}

impl Lanes {
    /// e to the power of each number, which counts as at most 700 and at least −700; within two units in the last place.
    #[inline(always)]
    pub(crate) fn exp(self) -> Self {
        // e^x = 2^k e^r with the whole number k nearest to x/ln 2, so that |r| is at most ln 2/2. Adding 1.5·2^52 rounds to
        // a whole number, and leaves it in the lowest bits. The first part of ln 2 is short: k times it is exact.
        const ROUND: f64 = 1.5 * (1_u64 << 52) as f64;
        const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
        const BIAS: u64 = 1023;
        // 1/13! to 1/0!: the next term of the series is below 10^-17.
        const SERIES: [f64; 14] = [
            1.0 / 6_227_020_800.0,
            1.0 / 479_001_600.0,
            1.0 / 39_916_800.0,
            1.0 / 3_628_800.0,
            1.0 / 362_880.0,
            1.0 / 40_320.0,
            1.0 / 5_040.0,
            1.0 / 720.0,
            1.0 / 120.0,
            1.0 / 24.0,
            1.0 / 6.0,
            0.5,
            1.0,
            1.0,
        ];
        let x = self.clamp(Self::splat(-700.0), Self::splat(700.0));
        let rounded = x * LOG2_E + ROUND;
        let k = rounded - ROUND;
        let r = x - k * LN_2[0] - k * LN_2[1];
        let mut sum = Self::splat(SERIES[0]);
        for factor in &SERIES[1..] {
            sum = sum * r + *factor;
        }
        sum * Self(each_lane!(i => f64::from_bits(rounded.0[i].to_bits().wrapping_add(BIAS) << 52); 0.0))
    }

    /// The sum of the numbers.
    #[inline(always)]
    pub(crate) fn sum(self) -> f64 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + b) + (c + d)) + ((e + f) + (g + h))
    }
}

impl BitAnd for LaneMask {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(each_lane!(i => self.0[i] & other.0[i]; false))
    }
}

impl BitOr for LaneMask {
    type Output = Self;

    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(each_lane!(i => self.0[i] | other.0[i]; false))
    }
}

impl Not for LaneMask {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        Self(each_lane!(i => !self.0[i]; false))
    }
}

impl Mask for LaneMask {
    #[inline(always)]
    fn any(self) -> bool {
        let mut any = false;
        for lane in self.0 {
            any |= lane;
        }
        any
    }
}

/// A holder of the numbers of eight helicopters, of which one lane at a time is set from one helicopter's.
pub(crate) trait SetLane<One> {
    /// Sets one lane.
    fn set_lane(&mut self, lane: usize, one: &One);
}

impl SetLane<f64> for Lanes {
    fn set_lane(&mut self, lane: usize, one: &f64) {
        self.0[lane] = *one;
    }
}

impl<One, L: SetLane<One>, const N: usize> SetLane<[One; N]> for [L; N] {
    fn set_lane(&mut self, lane: usize, one: &[One; N]) {
        for (lanes, one) in self.iter_mut().zip(one) {
            lanes.set_lane(lane, one);
        }
    }
}

/// Declares a struct of numbers that one helicopter has (`f64`) or eight have ([`Lanes`]).
macro_rules! numbers {
    ($(#[$about:meta])* $seen:vis struct $name:ident<R> {
        $($(#[$field_about:meta])* $field_seen:vis $field:ident: $type:ty,)*
    }) => {
        $(#[$about])*
        $seen struct $name<R = f64> {
            $($(#[$field_about])* $field_seen $field: $type,)*
        }

        impl crate::lanes::SetLane<$name<f64>> for $name<crate::lanes::Lanes> {
            fn set_lane(&mut self, lane: usize, one: &$name<f64>) {
                $(crate::lanes::SetLane::set_lane(&mut self.$field, lane, &one.$field);)*
            }
        }
    };
}
pub(crate) use numbers;

#[cfg(test)]
mod tests {
    use skein_common::math;

    use super::*;

    #[test]
    fn exp_is_that_of_the_library_to_the_last_digits() {
        for nth in -70_000..=70_000 {
            let x = f64::from(nth) * 0.01 + 1e-5;
            let (lanes, expected) = (Lanes::splat(x).exp().0, math::exp(x.clamp(-700.0, 700.0)));
            assert!(((lanes[3] - expected) / expected).abs() < 5e-16, "e^{x}: {} instead of {expected}", lanes[3]);
        }
        assert_eq!(Lanes::splat(0.0).exp().0, [1.0; LANES]);
        assert_eq!(Lanes::splat(1e300).exp().0, Lanes::splat(700.0).exp().0);
        assert!(Lanes::splat(f64::NAN).exp().0[0].is_nan());
    }
}
