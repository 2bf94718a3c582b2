use nalgebra::{Matrix6, Point3, UnitQuaternion, Vector3};

use super::*;
use roundel_fusion::world::FrameObservations;
use roundel_vision::{
    camera::{Intrinsics, Lens, PixelPoint},
    ellipse::Ellipse,
    id::{KindId, TrackNumber},
    marker::{Code, CodeReading, Ring},
    pose::{Detection, RoundelPose},
    time::Timestamp,
};

const KIND: KindId = KindId(0);
const SIGMA_M: f64 = 3e-4;
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
    Camera::new(Intrinsics {
        width: 1920,
        height: 1080,
        fx_px: 1100.0,
        fy_px: 1100.0,
        cx_px: 959.5,
        cy_px: 539.5,
        lens: Lens::PlumbBob([-0.08, 0.02, 0.0, 0.0, 0.0]),
    })
    .unwrap()
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
    let mut seed = 7u64;
    let mut random = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        ((seed >> 32) as f64 / f64::from(1u32 << 31) - 1.0) * 3f64.sqrt()
    };
    let epoch = Timestamp::from_ns(1_800_000_000_000_000_000);
    let mut recording = Recording::new(100.0);
    for frame in 0..(SECONDS * RATE_HZ) as u64 {
        for (camera, pose) in camera_poses().iter().enumerate() {
            let t = (frame as f64 + 0.3 * camera as f64) / RATE_HZ;
            let references = landmarks().into_iter().filter(|_| camera == 0);
            let points = references
                .map(|landmark| (landmark.code.unwrap().number, landmark.position_m))
                .chain((0..6).map(|index| (index as u16 + 1, robot(index, t))));
            let detections = points
                .map(|(number, world_m)| {
                    let noise = Vector3::from_fn(|_, _| random() * SIGMA_M);
                    let position_m = (pose.inverse() * Point3::from(world_m)).coords + noise;
                    detection(number, position_m, epoch.plus_seconds(t + OFFSETS_S[camera]))
                })
                .collect();
            let capture_time = epoch.plus_seconds(t + OFFSETS_S[camera]);
            recording.add(&FrameObservations {
                camera: CameraId(camera as u32),
                frame,
                capture_time,
                received_time: epoch.plus_seconds(t + 0.05),
                calibration_version: 1,
                detections,
            });
        }
    }
    recording
}

fn detection(number: u16, position_m: Vector3<f64>, capture_time: Timestamp) -> Detection {
    let center = PixelPoint { u: 0.0, v: 0.0 };
    let rim = |semi_px| Ellipse {
        center,
        semi_major_px: semi_px,
        semi_minor_px: semi_px,
        angle_rad: 0.0,
    };
    let code = Some(CodeReading::certain(Code { bits: 8, number }, center));
    let normal = Vector3::new(0.0, 0.0, -1.0);
    Detection {
        track: TrackNumber(u64::from(number)),
        ring: Ring { kind: Some(KIND), code, ..Ring::of_rims(rim(15.0), rim(6.0)) },
        capture_time,
        pose: Some(RoundelPose {
            position_m,
            normal,
            normal_likelihood: 1.0,
            other_normal: normal,
            yaw_rad: None,
            yaw_symmetry: 1,
            covariance: Matrix6::from_diagonal_element(SIGMA_M * SIGMA_M),
        }),
    }
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
