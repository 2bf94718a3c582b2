//! Time of the supervision of camera poses: `cargo bench -p roundel-core --bench watch`.
//!
//! An iteration is one second of 16 cameras at 60 Hz. Each camera sees about 50 of 200 robots on circles, and each robot
//! is seen by four cameras; no camera moves. 10 ms per iteration are 1 % of a core.

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use roundel_core::{
    calib::watch::{Watch, WatchParams},
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::{Code, CodeReading, Ring},
    pose::{Detection, RoundelPose},
    rigid::{Covariance6, Rigid},
    time::Timestamp,
    world::{CameraPlacement, FrameObservations},
};

const CAMERAS: usize = 16;
const ROBOTS: usize = 200;
const RATE_HZ: f64 = 60.0;
/// Duration before the measurement, and of the recorded detections, seconds.
const WARM_S: usize = 70;
const TIMED_S: usize = 10;
/// Half of a camera's field of view, metres.
const HALF_M: [f64; 2] = [6.0, 4.5];
const SIGMA_M: f64 = 3e-4;

fn watch(criterion: &mut Criterion) {
    for (name, is_coded) in [("coded", true), ("plain", false)] {
        let mut watch = Watch::new(WatchParams::default());
        for camera in 0..CAMERAS {
            let covariance = Covariance6::zeros();
            let placement = CameraPlacement { world_from_camera: camera_pose(camera), covariance };
            watch.set_camera(CameraId(camera as u32), placement);
        }
        // Detections repeat every ten seconds.
        let seconds: Vec<Vec<FrameObservations>> =
            (0..TIMED_S).map(|second| frames(second, is_coded)).collect();
        let mut run = |second: usize| {
            let late_ns = ((second / TIMED_S * TIMED_S) as i64) * 1_000_000_000;
            let mut frames = seconds[second % TIMED_S].clone();
            let start = std::time::Instant::now();
            for frame in &mut frames {
                frame.capture_time = frame.capture_time.plus_ns(late_ns);
                for seen in &mut frame.detections {
                    seen.capture_time = frame.capture_time;
                }
                watch.observe(frame, 0.0);
                assert_eq!(watch.advance(frame.capture_time), []);
            }
            start.elapsed()
        };
        (0..WARM_S).for_each(|second| {
            run(second);
        });
        let mut next = WARM_S;
        criterion.bench_function(&format!("watch, a second, {name}"), |bencher| {
            bencher.iter_custom(|count| {
                let from = next;
                next += count as usize;
                (from..next).map(&mut run).sum()
            });
        });
    }
}

/// Nine metres up in four rows of four, looking down.
fn camera_pose(camera: usize) -> Rigid {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let [x, y] = [camera % 4, camera / 4].map(|it| it as f64 - 1.5);
    Rigid::from_parts(Vector3::new(6.0 * x, 4.5 * y, 9.0).into(), down)
}

/// Circles of ten seconds, in ten rows of twenty.
fn robot(index: usize, t: f64) -> Vector3<f64> {
    let [x, y] = [index % 20, index / 20].map(|it| it as f64);
    let (sin, cos) = (std::f64::consts::TAU * t / 10.0 + index as f64).sin_cos();
    let middle = Vector3::new(1.2 * (x - 9.5), 1.8 * (y - 4.5), 0.3);
    middle + Vector3::new(0.4 * cos, 0.4 * sin, 0.0)
}

/// Frames of all cameras in one second, ordered by exposure.
fn frames(second: usize, is_coded: bool) -> Vec<FrameObservations> {
    let mut noise = Noise(second as u64 + 1);
    let mut frames = Vec::new();
    for number in 0..RATE_HZ as usize {
        for camera in 0..CAMERAS {
            let t = second as f64 + (number as f64 + camera as f64 / CAMERAS as f64) / RATE_HZ;
            let time = Timestamp::from_ns((t * 1e9) as i64);
            let seen = |index: usize| {
                let position_m = camera_pose(camera).inverse() * Point3::from(robot(index, t));
                let is_visible = position_m.x.abs() < HALF_M[0] && position_m.y.abs() < HALF_M[1];
                is_visible.then_some((index, position_m.coords))
            };
            let detections = (0..ROBOTS).filter_map(seen).map(|(index, position_m)| {
                let error = Vector3::from_fn(|_, _| noise.next() * SIGMA_M);
                detection(index, is_coded, position_m + error, time)
            });
            frames.push(FrameObservations {
                camera: CameraId(camera as u32),
                frame: 1,
                capture_time: time,
                received_time: time,
                calibration_version: 0,
                detections: detections.collect(),
            });
        }
    }
    frames
}

fn detection(index: usize, is_coded: bool, position_m: Vector3<f64>, time: Timestamp) -> Detection {
    let rim = Ellipse {
        center: PixelPoint { u: 0.0, v: 0.0 },
        semi_major_px: 1.0,
        semi_minor_px: 1.0,
        angle_rad: 0.0,
    };
    let mut ring = Ring { kind: Some(KindId(0)), ..Ring::of_rims(rim, rim) };
    let code = Code { bits: 12, number: index as u16 };
    ring.code = is_coded.then_some(CodeReading::certain(code, rim.center));
    let normal = -Vector3::z();
    let pose = RoundelPose {
        position_m,
        normal,
        normal_likelihood: 1.0,
        other_normal: normal,
        yaw_rad: None,
        yaw_symmetry: 1,
        covariance: Covariance6::identity() * SIGMA_M.powi(2),
    };
    Detection { track: TrackNumber(index as u64), ring, capture_time: time, pose: Some(pose) }
}

/// Uniform, with unit variance.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        ((self.0 >> 32) as f64 / f64::from(1u32 << 31) - 1.0) * 3f64.sqrt()
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(std::time::Duration::from_secs(4));
    targets = watch
}
criterion_main!(benches);
