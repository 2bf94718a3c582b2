//! Distortion models and their estimated coefficients.

use roundel_vision::camera::Lens;

/// A distortion model with its estimated coefficients; all others are zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DistortionModel {
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

impl DistortionModel {
    /// All models, simplest first.
    pub const ALL: [Self; 7] = [
        Self::Radial1,
        Self::Radial2,
        Self::Tangential,
        Self::PlumbBob,
        Self::Rational,
        Self::Equidistant2,
        Self::Equidistant,
    ];

    /// Number of coefficients of the ROS model.
    pub(crate) fn coefficients(self) -> usize {
        match self {
            Self::Radial1 | Self::Radial2 | Self::Tangential | Self::PlumbBob => 5,
            Self::Rational => 8,
            Self::Equidistant2 | Self::Equidistant => 4,
        }
    }

    /// Indices of the estimated coefficients in ROS order.
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

    /// Name of the model in ROS.
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
