//! Where a roundel is in the camera frame.

use nalgebra::Vector3;

use crate::{id::TrackNumber, marker::Ring, rigid::Covariance6, time::Timestamp};

/// Pose of a roundel in the camera frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RoundelPose {
    /// Centre, metres.
    pub position_m: Vector3<f64>,
    /// Unit normal out of the printed face, the more likely one.
    pub normal: Vector3<f64>,
    /// Likelihood of `normal` against `other_normal`, 0.5 to 1.
    pub normal_likelihood: f64,
    /// The other normal that the same ellipse allows.
    pub other_normal: Vector3<f64>,
    /// Angle of the code's zero about the normal; `None` for a plain roundel.
    pub yaw_rad: Option<f64>,
    /// Over (position, rotation), camera frame, left perturbation.
    pub covariance: Covariance6,
}

/// One roundel found in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// The camera's own number for it.
    pub track: TrackNumber,
    /// As imaged.
    pub ring: Ring,
    /// Middle of the exposure at its own row.
    pub capture_time: Timestamp,
    /// `None` without a camera model or a known diameter.
    pub pose: Option<RoundelPose>,
}
