//! Distortion models, with the coefficients that are estimated.

use roundel_vision::camera::Lens;

/// A distortion model with the coefficients that are estimated; the others are zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// `plumb_bob` with k1.
    Radial1,
    /// `plumb_bob` with k1 and k2.
    Radial2,
    /// `plumb_bob` with k1, k2, p1 and p2.
    Tangential,
    /// `plumb_bob` with all five.
    PlumbBob,
    /// `rational_polynomial` with all eight.
    Rational,
    /// `equidistant` with two coefficients.
    Equidistant2,
    /// `equidistant` with all four.
    Equidistant,
}

impl Model {
    /// All of them, simple ones first.
    pub const ALL: [Self; 7] = [
        Self::Radial1,
        Self::Radial2,
        Self::Tangential,
        Self::PlumbBob,
        Self::Rational,
        Self::Equidistant2,
        Self::Equidistant,
    ];

    /// Coefficients of the lens in ROS' order.
    pub(crate) fn coefficients(self) -> usize {
        match self {
            Self::Radial1 | Self::Radial2 | Self::Tangential | Self::PlumbBob => 5,
            Self::Rational => 8,
            Self::Equidistant2 | Self::Equidistant => 4,
        }
    }

    /// Those that are estimated, in ROS' order.
    pub fn free(self) -> &'static [usize] {
        match self {
            Self::Radial1 => &[0],
            Self::Radial2 | Self::Equidistant2 => &[0, 1],
            Self::Tangential | Self::Equidistant => &[0, 1, 2, 3],
            Self::PlumbBob => &[0, 1, 2, 3, 4],
            Self::Rational => &[0, 1, 2, 3, 4, 5, 6, 7],
        }
    }

    /// Names of the estimated coefficients.
    pub fn names(self) -> Vec<&'static str> {
        let all: &[&str] = match self {
            Self::Equidistant2 | Self::Equidistant => &["k1", "k2", "k3", "k4"],
            _ => &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
        };
        self.free().iter().map(|&index| all[index]).collect()
    }

    /// ROS' name of the lens model.
    pub fn ros_name(self) -> &'static str {
        match self {
            Self::Rational => "rational_polynomial",
            Self::Equidistant2 | Self::Equidistant => "equidistant",
            _ => "plumb_bob",
        }
    }

    pub(crate) fn lens(self, coefficients: &[f64]) -> Option<Lens> {
        Lens::from_ros(self.ros_name(), coefficients)
    }
}
