//! An object state with realistic numbers.

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    id::{CameraId, KindId, ObjectId},
    rigid::Covariance6,
    time::Timestamp,
    world::{LifeStage, ObjectState, ProcessNoise},
};

/// An object with this ID. Its numbers vary with the phase and have full precision, so that encodings are as long as
/// real ones.
pub fn object(id: u64, phase: f64, now: Timestamp) -> ObjectState {
    let phase = phase + id as f64 * 0.7;
    let factor = Covariance6::from_fn(|row, column| {
        ((row * 6 + column) as f64 + phase).sin() * 1e-3 + f64::from(u8::from(row == column)) * 1e-2
    });
    let covariance = factor * factor.transpose();
    ObjectState {
        id: ObjectId(id),
        kind: Some(KindId(0)),
        body: None,
        code: None,
        stage: LifeStage::Tracked,
        position_m: Vector3::new(5.0 * phase.sin(), 4.0 * phase.cos(), 0.3),
        orientation: UnitQuaternion::from_euler_angles(0.1 * phase.sin(), 0.2, phase),
        yaw_observed: false,
        yaw_symmetry: 1,
        velocity_m_s: Vector3::new(phase.cos(), -phase.sin(), 0.01 * phase.cos()),
        acceleration_m_s2: Vector3::new(0.1, 0.2, 0.3) * phase.cos(),
        angular_velocity_rad_s: Vector3::new(0.1, 0.2, 0.3) * phase.sin(),
        covariance,
        motion_covariance: covariance,
        rotation_covariance: covariance,
        process_noise: ProcessNoise {
            acceleration_density_m2_s3: Vector3::repeat(0.1),
            angular_density_rad2_s3: Vector3::repeat(0.1),
        },
        cameras: vec![CameraId(0), CameraId(2)],
        trust: 1,
        newest_observation: now,
        residual: 0.9 + 0.1 * phase.sin(),
        first_observation: now,
        observations: 1000,
    }
}
