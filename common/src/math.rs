//! Elementary functions that give the same bits on every computer.
//!
//! The standard library calls the C library for `sin`, `exp` and the like. Those results differ between releases and
//! between processors: glibc chooses another routine on processors with AVX2 and FMA. The functions here call the crate
//! `libm`, the Rust port of musl's mathematics. It is compiled into the program, so that a study gives the same results
//! with any C library. Clippy refuses the functions of the standard library. Exactly rounded operations (`+ - * /`,
//! `sqrt`, `abs`, `floor`, `round`, `mul_add`, `rem_euclid`) need no replacement.

/// The sine of an angle in radians.
#[inline]
pub fn sin(angle_rad: f64) -> f64 {
    libm::sin(angle_rad)
}

/// The cosine of an angle in radians.
#[inline]
pub fn cos(angle_rad: f64) -> f64 {
    libm::cos(angle_rad)
}

/// The sine and the cosine of an angle in radians.
#[inline]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    libm::sincos(angle_rad)
}

/// The arc sine in radians, from -π/2 to π/2; NaN for arguments outside [-1, 1].
#[inline]
pub fn asin(sine: f64) -> f64 {
    libm::asin(sine)
}

/// The angle in radians, from -π to π, of the direction `(x, y)` counted from the x axis towards the y axis.
#[inline]
pub fn atan2(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

/// The length of the vector `(x, y)`; no intermediate result overflows.
#[inline]
pub fn hypot(x: f64, y: f64) -> f64 {
    libm::hypot(x, y)
}

/// e to the power of `x`.
#[inline]
pub fn exp(x: f64) -> f64 {
    libm::exp(x)
}

/// The natural logarithm.
#[inline]
pub fn ln(x: f64) -> f64 {
    libm::log(x)
}

/// The logarithm to the base ten.
#[inline]
pub fn log10(x: f64) -> f64 {
    libm::log10(x)
}

/// `x` to the power of `exponent`.
#[inline]
pub fn pow(x: f64, exponent: f64) -> f64 {
    libm::pow(x, exponent)
}

/// `x · x`.
#[inline]
pub fn square(x: f64) -> f64 {
    x * x
}

/// `x · x · x`.
#[inline]
pub fn cube(x: f64) -> f64 {
    x * x * x
}
