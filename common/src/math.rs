//! Elementary functions that give the same bits on every machine.
//!
//! The standard library hands `sin`, `exp` and the like to the C library, whose results differ between releases and between
//! processors (glibc chooses another routine where it finds AVX2 and FMA). These come from the Rust port of musl's
//! mathematics, the crate `libm`, which is compiled into the program: a study is repeatable on any C library.
//! Clippy refuses the standard library's own. Exactly rounded operations (`+ - * /`, `sqrt`, `abs`, `floor`, `round`,
//! `mul_add`, `rem_euclid`) need no replacement.

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

/// The angle in radians, from -π/2 to π/2, of which this is the sine. Outside [-1, 1] it is not a number.
#[inline]
pub fn asin(sine: f64) -> f64 {
    libm::asin(sine)
}

/// The angle in radians, from -π to π, of the direction `(x, y)` counted from the x axis towards the y axis.
#[inline]
pub fn atan2(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

/// The length of the vector `(x, y)`, without overflow on the way.
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
