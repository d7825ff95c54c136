//! Elementary functions that give the same bits on every computer.
//!
//! The standard library calls the C library for `sin`, `exp` and the like. Those results differ between releases and
//! between processors: glibc chooses another routine on processors with AVX2 and FMA. The functions here call the crate
//! `libm`, the Rust port of musl's mathematics. It is compiled into the program, so that a study gives the same results
//! with any C library. Clippy refuses the functions of the standard library. Exactly rounded operations (`+ - * /`,
//! `sqrt`, `abs`, `floor`, `round`, `mul_add`, `rem_euclid`) need no replacement.

/// Angles are in radians. [`asin`] is NaN for arguments outside [-1, 1], [`atan2`] counts from the x axis towards the y
/// axis, and no intermediate result of [`hypot`] overflows.
pub use libm::{asin, atan2, cos, exp, hypot, log as ln, log10, pow, sin, sincos as sin_cos};

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
