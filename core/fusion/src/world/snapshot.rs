//! Object states at one time: predicted tracks, moved to the tracked point of each object.
//!
//! The filter estimates a roundel's centre c. The tracked point is p = c + R o with the configured offset o. With r = R
//! o, δp = δc - [r]× δθ and δv = δv_c - [ω]×[r]× δθ - [r]× δω, which transforms the covariances. For a plain roundel
//! only the component of o along the normal has a known direction; the rest, of length l, lies on a circle: its centre
//! is reported with variance l²/2 along each of the circle's axes. For an elliptical disc the rest points to one side
//! or the other: the middle is reported, with variance l² along that direction.

use nalgebra::{Matrix3, Matrix6, Vector3};

use super::{ObjectState, ProcessNoise, Snapshot, lifecycle::Track};
use crate::track::{
    AttitudeEstimate, BlockCovariance, Estimate, decay_acceleration, integrate_acceleration,
};
use roundel_vision::{id::CameraId, rigid::orientation_of_normal, time::Timestamp};

/// Cameras with a detection within this time are listed.
const CONTRIBUTING_NS: i64 = 200_000_000;

impl Snapshot {
    /// The same objects `seconds` later, with decaying accelerations (earlier if negative, by constant velocity).
    /// The covariances grow by the same process noise as within fusion. Unchanged if `seconds` is not finite.
    pub fn predicted(&self, seconds: f64) -> Snapshot {
        let mut snapshot = self.clone();
        if seconds.is_finite() && seconds != 0.0 {
            snapshot.pose_time = self.pose_time.plus_seconds(seconds);
            for object in &mut snapshot.objects {
                object.predict(seconds);
            }
        }
        snapshot
    }
}

impl ObjectState {
    fn predict(&mut self, seconds: f64) {
        let (moved_m, gained_m_s) = integrate_acceleration(&self.acceleration_m_s2, seconds);
        self.position_m += self.velocity_m_s * seconds + moved_m;
        self.velocity_m_s += gained_m_s;
        self.acceleration_m_s2 = decay_acceleration(&self.acceleration_m_s2, seconds);
        let turn =
            nalgebra::UnitQuaternion::from_scaled_axis(self.angular_velocity_rad_s * seconds);
        self.orientation = turn * self.orientation;
        let mut motion = BlockCovariance::from_matrix(&self.motion_covariance);
        motion.predict(seconds, &self.process_noise.acceleration_density_m2_s3);
        let mut rotation = BlockCovariance::from_matrix(&self.rotation_covariance);
        rotation.predict(seconds, &self.process_noise.angular_density_rad2_s3);
        if !self.yaw_observed {
            let normal = self.orientation * Vector3::z();
            self.orientation = orientation_of_normal(&normal);
            rotation = crate::track::without_yaw(&rotation, &normal);
        }
        self.motion_covariance = motion.matrix();
        self.rotation_covariance = rotation.matrix();
        self.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&motion.value);
        self.covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation.value);
    }
}

/// State of a track at `time`; `offset_m` is the tracked point in the roundel's frame.
pub(super) fn object_state(
    track: &mut Track,
    time: Timestamp,
    offset_m: &Vector3<f64>,
) -> ObjectState {
    let model = track.model;
    let Estimate { motion, attitude, residual } = track.history.estimate(time, &model);
    track.refresh();
    let mut state = ObjectState {
        id: track.id,
        kind: track.subject.kind,
        body: track.subject.body,
        code: track.codes.leader(),
        stage: track.stage,
        position_m: motion.position_m,
        orientation: attitude.orientation,
        yaw_observed: attitude.yaw_symmetry.is_some(),
        yaw_symmetry: attitude.yaw_symmetry.unwrap_or(1),
        velocity_m_s: motion.velocity_m_s,
        acceleration_m_s2: motion.acceleration_m_s2,
        angular_velocity_rad_s: attitude.angular_velocity_rad_s,
        covariance: Matrix6::zeros(),
        motion_covariance: motion.covariance.matrix(),
        rotation_covariance: attitude.covariance,
        process_noise: ProcessNoise {
            acceleration_density_m2_s3: motion.density_m2_s3,
            angular_density_rad2_s3: attitude.density_rad2_s3,
        },
        cameras: contributing_cameras(track, time),
        trust: 0,
        newest_observation: track.newest,
        residual,
        first_observation: track.first,
        observations: track.observations,
    };
    let cross = shift_to_tracked_point(&mut state, &attitude, offset_m);
    let (moved, turned) = (&state.motion_covariance, &attitude.covariance);
    state.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&moved.fixed_view::<3, 3>(0, 0));
    state.covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned.fixed_view::<3, 3>(0, 0));
    state.covariance.fixed_view_mut::<3, 3>(0, 3).copy_from(&cross);
    state.covariance.fixed_view_mut::<3, 3>(3, 0).copy_from(&cross.transpose());
    state
}

/// Moves position, velocity and their covariance from the roundel's centre to the tracked point; returns the
/// covariance of position and rotation.
fn shift_to_tracked_point(
    state: &mut ObjectState,
    attitude: &AttitudeEstimate,
    offset_m: &Vector3<f64>,
) -> Matrix3<f64> {
    if *offset_m == Vector3::zeros() {
        return Matrix3::zeros();
    }
    let mut known_m = *offset_m;
    if attitude.yaw_symmetry != Some(1) {
        known_m = Vector3::new(0.0, 0.0, offset_m.z);
        let level_m = offset_m - known_m;
        let spread = if attitude.yaw_symmetry == Some(2) {
            let level_m = attitude.orientation * level_m;
            level_m * level_m.transpose()
        } else {
            let normal = attitude.orientation * Vector3::z();
            let across = Matrix3::identity() - normal * normal.transpose();
            across * (0.5 * level_m.norm_squared())
        };
        let mut position = state.motion_covariance.fixed_view_mut::<3, 3>(0, 0);
        position += spread;
    }
    let arm_m = attitude.orientation * known_m;
    let omega = attitude.angular_velocity_rad_s;
    state.position_m += arm_m;
    state.velocity_m_s += omega.cross(&arm_m);
    let arm = -arm_m.cross_matrix();
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&arm);
    jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&(omega.cross_matrix() * arm));
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&arm);
    state.motion_covariance += jacobian * attitude.covariance * jacobian.transpose();
    arm * attitude.covariance.fixed_view::<3, 3>(0, 0)
}

fn contributing_cameras(track: &Track, time: Timestamp) -> Vec<CameraId> {
    track
        .views
        .iter()
        .filter(|view| time.ns_since(view.time).saturating_abs() <= CONTRIBUTING_NS)
        .map(|view| view.camera)
        .collect()
}
