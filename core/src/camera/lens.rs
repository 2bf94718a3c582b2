//! Lens distortion.

/// A distortion model with its coefficients, named and ordered as in ROS' `camera_info`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// `plumb_bob`: k1 k2 p1 p2 k3.
    PlumbBob([f64; 5]),
    /// `rational_polynomial`: k1 k2 p1 p2 k3 k4 k5 k6.
    Rational([f64; 8]),
    /// `equidistant`: k1 k2 k3 k4 (Kannala-Brandt).
    Equidistant([f64; 4]),
}
