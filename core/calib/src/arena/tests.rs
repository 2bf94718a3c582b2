use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::*;
use crate::test_world::{KIND, Random, SIGMA_M, at, camera, detection, frame};
use roundel_fusion::world::FrameObservations;
use roundel_vision::{camera::Lens, marker::Code};

const SECONDS: f64 = 15.0;
const RATE_HZ: f64 = 25.0;
/// Delays of the cameras' clocks.
const OFFSETS_S: [f64; 3] = [0.0, 0.03, -0.02];

/// Three cameras 4 m up that look down obliquely; the first one sees the references.
fn camera_poses() -> [Rigid; 3] {
    [0, 1, 2].map(|index| {
        let turn = UnitQuaternion::from_euler_angles(
            std::f64::consts::PI - 0.1 * index as f64,
            0.05,
            0.3 * index as f64,
        );
        Rigid::from_parts(Vector3::new(0.7 * index as f64, 0.2, 4.0).into(), turn)
    })
}

fn lens() -> Camera {
    let lens = Lens::PlumbBob([-0.08, 0.02, 0.0, 0.0, 0.0]);
    camera((1920, 1080), [1100.0, 1100.0, 959.5, 539.5], lens)
}

fn landmarks() -> Vec<Landmark> {
    [(-0.8, -0.6), (0.9, -0.5), (0.8, 0.9), (-0.7, 0.8)]
        .into_iter()
        .zip(100..)
        .map(|((x, y), number)| {
            Landmark::new(KIND, Some(Code { bits: 8, number }), Vector3::new(x, y, 0.0))
        })
        .collect()
}

fn robot(index: usize, t: f64) -> Vector3<f64> {
    let (sin, cos) = ((0.7 + 0.1 * index as f64) * t + 1.7 * index as f64).sin_cos();
    let center = Vector3::new(0.5 * (index % 3) as f64, 0.4 * (index / 3) as f64, 0.2);
    center + Vector3::new(0.6 * cos, 0.5 * sin, 0.1 * sin * cos)
}

fn recording() -> Recording {
    let mut random = Random(7);
    let mut recording = Recording::new(100.0);
    for number in 0..(SECONDS * RATE_HZ) as u64 {
        for (camera, pose) in camera_poses().iter().enumerate() {
            let t = (number as f64 + 0.3 * camera as f64) / RATE_HZ;
            let references = landmarks().into_iter().filter(|_| camera == 0);
            let points = references
                .map(|landmark| (landmark.code.unwrap().number, landmark.position_m))
                .chain((0..6).map(|index| (index as u16 + 1, robot(index, t))));
            let capture_time = at(t + OFFSETS_S[camera]);
            let detections = points
                .map(|(number, world_m)| {
                    let noise = Vector3::from_fn(|_, _| random.next() * 3f64.sqrt() * SIGMA_M);
                    let position_m = (pose.inverse() * Point3::from(world_m)).coords + noise;
                    let code = Some(Code { bits: 8, number });
                    detection(u64::from(number), code, position_m, capture_time)
                })
                .collect();
            recording.add(&FrameObservations {
                received_time: at(t + 0.05),
                ..frame(camera, number, capture_time, detections)
            });
        }
    }
    recording
}

fn cameras(lens_deviation: Option<LensDeviation>) -> Vec<ArenaCamera> {
    [0, 1, 2].map(|index| ArenaCamera { id: CameraId(index), lens: lens(), lens_deviation }).into()
}

#[test]
fn poses_and_clocks_of_three_cameras_are_found() {
    let recording = recording();
    for lens_deviation in [None, Some(LensDeviation::default())] {
        let mut last = f64::INFINITY;
        let found = calibrate(
            &recording,
            &cameras(lens_deviation),
            &landmarks(),
            &ArenaParams::default(),
            |progress| {
                last = progress.length;
                true
            },
        )
        .unwrap();
        assert_eq!((found.cameras.len(), found.roundels), (3, 6));
        assert!(found.steps < 20 && last < 1.0, "{} steps, {last}", found.steps);
        for (index, camera) in found.cameras.iter().enumerate() {
            let truth = camera_poses()[index];
            let off = camera.world_from_camera.translation.vector - truth.translation.vector;
            let turned = camera.world_from_camera.rotation.angle_to(&truth.rotation);
            let deviation = camera.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
            assert!(off.norm() < 0.01 && off.norm() < 4.0 * deviation, "{off} {deviation}");
            assert!(turned < 3e-3, "{turned}");
            let clock_s = camera.clock_offset_s - OFFSETS_S[index];
            assert!(clock_s.abs() < 1e-3, "{clock_s}");
            assert!((0.7..1.4).contains(&camera.error_ratio), "{}", camera.error_ratio);
        }
        assert!(!found.findings.iter().any(Finding::is_grave), "{:?}", found.findings);
    }
}

#[test]
fn a_calibration_stops_on_request() {
    let params = ArenaParams::default();
    let error = calibrate(&recording(), &cameras(None), &landmarks(), &params, |progress| {
        progress.step < 1
    });
    assert_eq!(error.unwrap_err(), ArenaError::Cancelled);
}
