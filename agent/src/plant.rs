//! Plants in real time: the built-in helicopter, paced by this PC's clock, and X-Plane over UDP.

pub mod builtin;
pub mod xplane;
