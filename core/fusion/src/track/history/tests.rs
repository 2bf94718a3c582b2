//! Retraction of measurements from the rewind buffer.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::*;
use crate::track::{AttitudeMeasurement, Noise};
use roundel_vision::id::TrackNumber;

fn model() -> MotionModel {
    MotionModel {
        acceleration_density_m2_s3: Vector3::repeat(0.2),
        angular_density_rad2_s3: Vector3::repeat(1.0),
        speed_m_s: Vector3::repeat(3.0),
        angular_speed_rad_s: Vector3::repeat(3.0),
        systematic_time_s: 1.0,
        robust_distance_squared: 16.0,
        upright_log_odds: 3.0,
        learns_rotation_density: true,
        ground: None,
    }
}

fn measurement(camera: u32, frame: u64, off_m: f64) -> Measurement {
    let total = Matrix3::identity() * 1e-6;
    let noise = Noise { total, systematic_root: Matrix3::identity() * 5e-4, timing_s: 0.0 };
    let time = Timestamp::from_ns(frame as i64 * 16_000_000 + i64::from(camera) * 5_000_000);
    let turned = [UnitQuaternion::identity(); 2];
    Measurement {
        time,
        clock_correction_s: 0.0,
        camera: CameraId(camera),
        frame,
        number: TrackNumber(1),
        position_m: Vector3::new(time.as_ns() as f64 * 1e-9 + off_m, 0.0, 1.0),
        position_noise: noise,
        attitude: AttitudeMeasurement::new(turned, 0.9, None, noise),
    }
}

/// Frames of two cameras; from frame `spoiled` on the second one is off by `off_m`, or absent.
fn history(frames: u64, disturbed: u64, off_m: Option<f64>) -> History {
    let model = model();
    let mut history = History::begin(measurement(0, 0, 0.0), &model);
    for frame in 0..frames {
        let own = if frame < disturbed { Some(0.0) } else { off_m };
        let both = [
            (frame > 0).then(|| measurement(0, frame, 0.0)),
            own.map(|off| measurement(1, frame, off)),
        ];
        for measurement in both.into_iter().flatten() {
            history.insert(&measurement, &model);
        }
        history.discard_before(Timestamp::from_ns(frame as i64 * 16_000_000 - 300_000_000));
    }
    history
}

#[test]
fn a_retracted_measurement_has_no_effect() {
    let model = model();
    let mut removed = history(60, 55, Some(0.02));
    let since = measurement(1, 55, 0.0).time;
    assert_eq!(removed.retract(CameraId(1), since, &model), Retraction::Removed(5));
    let mut without = history(60, 55, None);
    let time = Timestamp::from_ns(61 * 16_000_000);
    let [one, other] = [&mut removed, &mut without].map(|it| it.state_at(time, &model));
    let agile = |it: &FilterState| (it.motion.agile().position_m, it.motion.agile().kalman.rate);
    let apart_m = (agile(&one).0 - agile(&other).0).norm();
    assert!(apart_m < 1e-12, "{apart_m}");
    assert_eq!(removed.measurements().count(), without.measurements().count());
}

#[test]
fn retraction_reaches_beyond_the_window() {
    let model = model();
    let mut history = history(60, 10, Some(0.02));
    let time = Timestamp::from_ns(60 * 16_000_000);
    let before = history.state_at(time, &model).motion.agile().position_m;
    assert!((before.x - 0.96).abs() > 2e-3, "expected a disturbed state: {before}");
    let removed = history.retract(CameraId(1), Timestamp::from_ns(0), &model);
    assert!(matches!(removed, Retraction::Removed(count) if count > 10), "{removed:?}");
    let after = history.state_at(time, &model).motion.agile().position_m;
    assert!((after.x - 0.96).abs() < 5e-4, "{after}");
}

#[test]
fn the_only_camera_is_not_retracted() {
    let mut history = history(60, 0, Some(0.0));
    let model = model();
    history.retract(CameraId(0), Timestamp::from_ns(0), &model);
    let left = history.retract(CameraId(1), Timestamp::from_ns(0), &model);
    assert_eq!(left, Retraction::NothingLeft);
}
