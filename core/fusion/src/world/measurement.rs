//! Transformation of a detection from the camera frame into a measurement in the world frame.
//!
//! With the camera's pose (R, t), detection p and covariance Σ: p_w = R p + t. Its covariance is diag(R, R) Σ diag(R,
//! R)ᵀ plus that of the camera's pose, J Σ_camera Jᵀ with J = [I -[R p]×; 0 I], since a small rotation δθ of the camera
//! moves the point by δθ × R p. The pose error of a stationary camera is the same in every frame, so it is wholly
//! systematic; that of a mobile camera is in part ([`super::mobile_camera`]); Σ is to a configured share. p is first
//! scaled by the size of the print ([`super::print_size`]), whose error is wholly systematic too, as are those of a print
//! that is not flat, along its normal, and of a focal length, along the optical axis.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use super::FusionParams;
use crate::track::{AttitudeMeasurement, Measurement, Noise, cholesky_lower};
use roundel_vision::{
    id::CameraId,
    pose::{Detection, RoundelPose},
    rigid::{
        Covariance6, Rigid, is_positive_definite, orientation_of_normal, turn_about_z,
        turned_covariance,
    },
    time::Timestamp,
};

/// Smallest variance of a measurement, (10 µm)² and (10 µrad)²; keeps the filter's arithmetic well within the
/// digits of `f64`.
pub(super) const FLOOR_VARIANCE: f64 = 1e-10;
/// Largest variances of a measurement; larger ones carry no information and only cost digits.
const CEILING_POSITION_M2: f64 = 1e4;
const CEILING_ROTATION_RAD2: f64 = 1e4;
/// Tolerance of a unit normal's length.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Smallest cosine between a normal and the direction to the camera.
const MIN_FACING: f64 = 1e-3;

/// Pose of a stationary camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPlacement {
    /// Transforms camera coordinates into world coordinates.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation; zero when exact.
    pub covariance: Covariance6,
}

/// Size of a kind's prints relative to the configured size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintSize {
    /// True size over configured size.
    pub factor: f64,
    /// Relative standard deviation.
    pub deviation: f64,
    /// Standard deviation of the centre along the normal, metres, since paper is not flat.
    pub flatness_m: f64,
}

impl PrintSize {
    /// As configured, without error.
    pub const EXACT: Self = Self { factor: 1.0, deviation: 0.0, flatness_m: 0.0 };

    /// Covariance of a position relative to the camera by the errors of the print.
    pub(super) fn position_error(
        &self,
        arm_m: &Vector3<f64>,
        normal: &Vector3<f64>,
    ) -> Matrix3<f64> {
        let (along_m, up_m) = (arm_m * self.deviation, normal * self.flatness_m);
        along_m * along_m.transpose() + up_m * up_m.transpose()
    }
}

/// Pose of a camera during one exposure, with its error split into a systematic and a fresh part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ExposurePose {
    pub(super) world_from_camera: Rigid,
    pub(super) systematic: Covariance6,
    pub(super) fresh: Covariance6,
}

impl From<&CameraPlacement> for ExposurePose {
    fn from(placement: &CameraPlacement) -> Self {
        Self {
            world_from_camera: placement.world_from_camera,
            systematic: placement.covariance,
            fresh: Covariance6::zeros(),
        }
    }
}

/// Correction of a camera's stamps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct StampCorrection {
    /// Offset of its epoch, nanoseconds.
    pub(super) base_ns: i64,
    /// Remaining offset of its clock, seconds.
    pub(super) offset_s: f64,
}

impl StampCorrection {
    /// The stamp in the server's epoch, without correction of the clock offset.
    pub(super) fn based(&self, stamp: Timestamp) -> Timestamp {
        stamp.plus_ns(self.base_ns.saturating_neg())
    }

    /// The stamp on the server's time scale.
    pub(super) fn corrected(&self, stamp: Timestamp) -> Timestamp {
        self.based(stamp).plus_seconds(-self.offset_s)
    }
}

/// Frame of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FrameId {
    pub(super) camera: CameraId,
    pub(super) number: u64,
}

/// Reason why a detection gives no measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MeasurementReject {
    /// No pose.
    NoPose,
    /// A number is not finite, a normal is no unit vector or does not face the camera, or the covariance is out of
    /// range or not positive definite.
    Invalid,
}

/// Transforms a detection into the world frame.
pub(super) fn measure(
    detection: &Detection,
    frame: FrameId,
    camera_pose: &ExposurePose,
    correction: StampCorrection,
    size: PrintSize,
    params: &FusionParams,
) -> Result<Measurement, MeasurementReject> {
    let pose = detection.pose.as_ref().ok_or(MeasurementReject::NoPose)?;
    if !is_valid_pose(pose) {
        return Err(MeasurementReject::Invalid);
    }
    let place = &camera_pose.world_from_camera;
    let turn = place.rotation.to_rotation_matrix().into_inner();
    let arm_m = place.rotation * pose.position_m * size.factor;
    let measurement = |corner: usize| {
        let own = pose.covariance.fixed_view::<3, 3>(corner, corner).into_owned();
        turned_covariance(&turn, &own)
    };
    let (mut position_total, mut rotation_total) =
        (measurement(0) * (size.factor * size.factor), measurement(3));
    // Covariances of the whole error, and of its systematic part.
    let share = params.systematic_share.clamp(0.0, 1.0);
    let mut position_systematic = position_total * share;
    let mut rotation_systematic = rotation_total * share;
    let along_m =
        place.rotation * Vector3::z() * (pose.position_m.z * size.factor * params.focal_deviation);
    let common = size.position_error(&arm_m, &(turn * pose.normal)) + along_m * along_m.transpose();
    position_total += common;
    position_systematic += common;
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
        clock_correction_s: correction.offset_s,
        camera: frame.camera,
        frame: frame.number,
        number: detection.track,
        position_m: arm_m + place.translation.vector,
        position_noise: Noise::from_covariances(position_total, &position_systematic),
        attitude: AttitudeMeasurement::from_covariances(
            orientations(pose).map(|turned| place.rotation * turned),
            pose.normal_likelihood,
            pose.yaw_rad.map(|_| pose.yaw_symmetry),
            &rotation_total,
            &rotation_systematic,
        ),
    })
}

/// Position and covariance (metres²) that fusion would use for a detection by a stationary camera, world frame;
/// `None` where fusion would reject it.
pub fn seen_in_world(
    detection: &Detection,
    place: &CameraPlacement,
    params: &FusionParams,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let measurement = measure(
        detection,
        FrameId { camera: CameraId(0), number: 0 },
        &ExposurePose::from(place),
        StampCorrection::default(),
        PrintSize::EXACT,
        params,
    )
    .ok()?;
    Some((measurement.position_m, measurement.position_noise.total))
}

/// Adds the camera's pose error to a measurement that was made with an exact pose.
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

/// Orientations of the roundel in the camera frame by both normals; the print's x axis points the same way in the
/// image.
pub(super) fn orientations(pose: &RoundelPose) -> [UnitQuaternion<f64>; 2] {
    let first = orientation(&pose.normal, pose.yaw_rad);
    let level = orientation_of_normal(&pose.other_normal);
    if pose.yaw_rad.is_none() {
        return [first, level];
    }
    let x = level.inverse() * pose.other_x(&(first * Vector3::x()));
    [first, level * turn_about_z(x.x, x.y)]
}

/// Orientation of the roundel in the camera frame: that of its normal, rotated by the yaw about it.
pub(super) fn orientation(normal: &Vector3<f64>, yaw_rad: Option<f64>) -> UnitQuaternion<f64> {
    let level = orientation_of_normal(normal);
    yaw_rad.map_or(level, |yaw_rad| {
        level * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad)
    })
}

/// Covariance of a pose carried to a point at the end of a lever arm fixed to it.
pub(super) fn with_lever_arm(covariance: &Covariance6, arm_m: &Vector3<f64>) -> Covariance6 {
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    jacobian * covariance * jacobian.transpose()
}

/// Covariances that the camera's pose error adds to position and rotation; `None` if the pose is exact.
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
    let distance_m = pose.position_m.norm();
    // A print that is seen from the side or from behind has no image, so its other normal has no yaw.
    let faces_camera = |normal: &Vector3<f64>| {
        (normal.norm() - 1.0).abs() < UNIT_TOLERANCE
            && normal.dot(&pose.position_m) < -MIN_FACING * distance_m
    };
    let variances = pose.covariance.diagonal();
    // Without a branch for each number.
    let are_finite = |numbers: &[f64]| numbers.iter().fold(true, |all, one| all & one.is_finite());
    are_finite(pose.position_m.as_slice())
        && are_finite(pose.covariance.as_slice())
        && faces_camera(&pose.normal)
        && faces_camera(&pose.other_normal)
        && (0.0..=1.0).contains(&pose.normal_likelihood)
        && pose.yaw_rad.is_none_or(f64::is_finite)
        && pose.yaw_symmetry >= 1
        && (0..3).all(|axis| (0.0..=CEILING_POSITION_M2).contains(&variances[axis]))
        && (3..6).all(|axis| (0.0..=CEILING_ROTATION_RAD2).contains(&variances[axis]))
        && is_positive_definite(&pose.covariance)
}
