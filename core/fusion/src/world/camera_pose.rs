//! Camera poses and how their error acts at the end of a lever arm.

use nalgebra::{Matrix6, Vector3};

use roundel_vision::rigid::{Covariance6, Rigid};

/// Pose of a stationary camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPlacement {
    /// Transforms camera coordinates into world coordinates.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation; zero when exact.
    pub covariance: Covariance6,
}

/// Pose of a camera during one exposure, with its error split into a systematic and a fresh part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::world) struct ExposurePose {
    pub(in crate::world) world_from_camera: Rigid,
    pub(in crate::world) systematic: Covariance6,
    pub(in crate::world) fresh: Covariance6,
}

/// Covariance of a pose carried to a point at the end of a lever arm fixed to it.
pub(in crate::world) fn with_lever_arm(
    covariance: &Covariance6,
    arm_m: &Vector3<f64>,
) -> Covariance6 {
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    jacobian * covariance * jacobian.transpose()
}
