//! From a detection in a camera's frame to a measurement in the world.
//!
//! With camera pose (R, t), detection p and covariance Σ: p_w = R p + t, and its error is
//! diag(R, R) Σ diag(R, R)ᵀ plus that of the camera's place, J Σ_camera Jᵀ with
//! J = [I -[R p]×; 0 I], since a small turn δθ of the camera moves the point by δθ × R p. The
//! camera that stands errs in its place in every frame alike, so that part is wholly systematic; of one
//! that rides a part is ([`super::rider`]); of Σ a configured share is.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::{
    CameraPlacement, FusionParams,
    camera_pose::{ExposurePose, with_lever_arm},
};
use crate::track::{AttitudeMeasurement, Measurement, Noise, cholesky_lower};
use roundel_vision::{
    id::CameraId,
    pose::{Detection, RoundelPose},
    rigid::{
        Covariance6, is_positive_definite, orientation_of_normal, turn_about_z, turned_covariance,
    },
    time::Timestamp,
};

/// No measurement is believed to be better than 10 µm and 10 µrad: keeps the filter's arithmetic
/// well within the digits of `f64`.
pub(super) const FLOOR_VARIANCE: f64 = 1e-10;
/// Beyond 100 m and 100 rad a measurement tells nothing and only costs digits.
const CEILING_POSITION_M2: f64 = 1e4;
const CEILING_ROTATION_RAD2: f64 = 1e4;
/// A unit normal's length may be off by so much.
const UNIT_TOLERANCE: f64 = 1e-3;

/// By how much a camera's stamps are late.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct StampCorrection {
    /// Of its clock's epoch, nanoseconds …
    pub(super) base_ns: i64,
    /// … and what its clock is off beside.
    pub(super) offset_s: f64,
}

impl StampCorrection {
    /// On the server's time, but for the clock's offset.
    pub(super) fn based(&self, stamp: Timestamp) -> Timestamp {
        stamp.plus_ns(self.base_ns.saturating_neg())
    }

    /// On the server's time.
    pub(super) fn corrected(&self, stamp: Timestamp) -> Timestamp {
        self.based(stamp).plus_seconds(-self.offset_s)
    }
}

/// Why a detection is no measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MeasurementReject {
    /// It has no pose.
    NoPose,
    /// Something is not finite, a normal is no unit vector, or the covariance is not positive
    /// definite or outlandish.
    Invalid,
}

/// Carries a detection into the world frame.
pub(super) fn measure(
    detection: &Detection,
    (camera, frame): (CameraId, u64),
    camera_pose: &ExposurePose,
    correction: StampCorrection,
    params: &FusionParams,
) -> Result<Measurement, MeasurementReject> {
    let pose = detection.pose.as_ref().ok_or(MeasurementReject::NoPose)?;
    if !is_valid_pose(pose) {
        return Err(MeasurementReject::Invalid);
    }
    let place = &camera_pose.world_from_camera;
    let turn = place.rotation.to_rotation_matrix().into_inner();
    let arm_m = place.rotation * pose.position_m;
    let measurement = |corner: usize| {
        let own = pose.covariance.fixed_view::<3, 3>(corner, corner).into_owned();
        turned_covariance(&turn, &own)
    };
    let (mut position_total, mut rotation_total) = (measurement(0), measurement(3));
    // Of the whole error, and of what stays.
    let share = params.systematic_share.clamp(0.0, 1.0);
    let mut position_systematic = position_total * share;
    let mut rotation_systematic = rotation_total * share;
    if let Some([position, rotation]) = camera_pose_error(&camera_pose.systematic, &arm_m) {
        position_total += position;
        position_systematic += position;
        rotation_total += rotation;
        rotation_systematic += rotation;
    }
    if let Some([position, rotation]) = camera_pose_error(&camera_pose.fresh, &arm_m) {
        position_total += position;
        rotation_total += rotation;
    }
    for axis in 0..3 {
        position_total[(axis, axis)] += FLOOR_VARIANCE;
        rotation_total[(axis, axis)] += FLOOR_VARIANCE;
    }
    if !is_positive_definite(&position_total) || !is_positive_definite(&rotation_total) {
        return Err(MeasurementReject::Invalid);
    }
    Ok(Measurement {
        time: correction.corrected(detection.capture_time),
        late_s: correction.offset_s,
        camera,
        frame,
        number: detection.track,
        position_m: arm_m + place.translation.vector,
        position_noise: Noise::from_covariances(position_total, &position_systematic),
        attitude: AttitudeMeasurement::from_covariances(
            orientations(pose).map(|turned| place.rotation * turned),
            pose.normal_likelihood,
            pose.yaw_rad.map(|_| pose.yaw_symmetry),
            (&rotation_total, &rotation_systematic),
        ),
    })
}

/// Where a camera that stands sees a detection, world frame, with the whole covariance that its measurement has
/// in fusion, metres²; `None` of what fusion would refuse.
pub fn seen_in_world(
    detection: &Detection,
    place: &CameraPlacement,
    params: &FusionParams,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let camera_pose = ExposurePose {
        world_from_camera: place.world_from_camera,
        systematic: place.covariance,
        fresh: Covariance6::zeros(),
    };
    let measurement =
        measure(detection, (CameraId(0), 0), &camera_pose, StampCorrection::default(), params)
            .ok()?;
    Some((measurement.position_m, measurement.position_noise.total))
}

/// A measurement that took its camera's place as exact, with the errors of that.
pub(super) fn add_camera_pose_error(
    mut measurement: Measurement,
    camera_pose: &ExposurePose,
) -> Measurement {
    let arm_m = measurement.position_m - camera_pose.world_from_camera.translation.vector;
    let [systematic, fresh] = [&camera_pose.systematic, &camera_pose.fresh]
        .map(|part| camera_pose_error(part, &arm_m).unwrap_or_else(|| [Matrix3::zeros(); 2]));
    let widen = |noise: &mut Noise, block: usize| {
        let root = &noise.systematic_root;
        let covariance = root * root.transpose() + systematic[block];
        noise.total += systematic[block] + fresh[block];
        noise.systematic_root = cholesky_lower(&covariance).unwrap_or_else(Matrix3::zeros);
    };
    widen(&mut measurement.position_noise, 0);
    measurement.attitude.map_noises(|noise| widen(noise, 1));
    measurement
}

/// The roundel's orientations in the camera frame by both normals; the print's x points the same way in the
/// picture.
pub(super) fn orientations(pose: &RoundelPose) -> [UnitQuaternion<f64>; 2] {
    let first = orientation(&pose.normal, pose.yaw_rad);
    let level = orientation_of_normal(&pose.other_normal);
    if pose.yaw_rad.is_none() {
        return [first, level];
    }
    let x = level.inverse() * pose.other_x(&(first * Vector3::x()));
    [first, level * turn_about_z(x.x, x.y)]
}

/// The roundel's orientation in the camera frame: the normal's, turned by the yaw about it.
pub(super) fn orientation(normal: &Vector3<f64>, yaw_rad: Option<f64>) -> UnitQuaternion<f64> {
    let level = orientation_of_normal(normal);
    yaw_rad.map_or(level, |yaw_rad| {
        level * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad)
    })
}

/// What the camera's place adds to position and rotation; `None` where it is exact.
fn camera_pose_error(covariance: &Covariance6, arm_m: &Vector3<f64>) -> Option<[Matrix3<f64>; 2]> {
    if (0..6).all(|axis| covariance[(axis, axis)] == 0.0) {
        return None;
    }
    let camera_pose_error = with_lever_arm(covariance, arm_m);
    Some(
        [0, 3].map(|corner| {
            symmetric(camera_pose_error.fixed_view::<3, 3>(corner, corner).into_owned())
        }),
    )
}

fn symmetric(matrix: Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}

pub(super) fn is_valid_pose(pose: &RoundelPose) -> bool {
    let is_unit = |vector: &Vector3<f64>| (vector.norm() - 1.0).abs() < UNIT_TOLERANCE;
    let variances = pose.covariance.diagonal();
    // All of them, without a branch for each.
    let are_finite = |numbers: &[f64]| numbers.iter().fold(true, |all, one| all & one.is_finite());
    are_finite(pose.position_m.as_slice())
        && are_finite(pose.covariance.as_slice())
        && is_unit(&pose.normal)
        && is_unit(&pose.other_normal)
        && (0.0..=1.0).contains(&pose.normal_likelihood)
        && pose.yaw_rad.is_none_or(f64::is_finite)
        && pose.yaw_symmetry >= 1
        && (0..3).all(|axis| (0.0..=CEILING_POSITION_M2).contains(&variances[axis]))
        && (3..6).all(|axis| (0.0..=CEILING_ROTATION_RAD2).contains(&variances[axis]))
        && is_positive_definite(&pose.covariance)
}
