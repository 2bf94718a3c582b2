//! Camera poses and how their error acts at the end of a lever arm.

use nalgebra::{Matrix6, Vector3};

use roundel_vision::rigid::{Covariance6, Rigid};

/// Where a camera stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPlacement {
    /// Turns camera coordinates into world coordinates.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation; zero when exact.
    pub covariance: Covariance6,
}

/// Where a camera is during one exposure, with the part of its error that stays and the one that is fresh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::world) struct ExposurePose {
    pub(in crate::world) world_from_camera: Rigid,
    pub(in crate::world) systematic: Covariance6,
    pub(in crate::world) fresh: Covariance6,
}

/// An error of a body's place, as one of a point at the end of an arm fixed to it.
pub(in crate::world) fn with_lever_arm(
    covariance: &Covariance6,
    arm_m: &Vector3<f64>,
) -> Covariance6 {
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    jacobian * covariance * jacobian.transpose()
}
