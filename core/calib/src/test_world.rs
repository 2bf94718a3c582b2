//! Cameras, detections and random numbers of the tests' simulated worlds.

use nalgebra::{Matrix6, Vector3};

use roundel_fusion::world::FrameObservations;
use roundel_vision::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    ellipse::Ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::{Code, CodeReading, Ring},
    pose::{Detection, RoundelPose},
    time::Timestamp,
};

pub(crate) const KIND: KindId = KindId(0);
/// Standard deviation of each coordinate of a detection.
pub(crate) const SIGMA_M: f64 = 3e-4;

/// `pinhole_px` is fx, fy, cx, cy.
pub(crate) fn camera(size: (usize, usize), pinhole_px: [f64; 4], lens: Lens) -> Camera {
    let (width, height) = size;
    let [fx_px, fy_px, cx_px, cy_px] = pinhole_px;
    Camera::new(Intrinsics { width, height, fx_px, fy_px, cx_px, cy_px, lens }).unwrap()
}

/// Errors of fx, fy, cx, cy, pixels.
pub(crate) fn pinhole_errors(found: &Camera, truth: &Camera) -> [f64; 4] {
    let (is, was) = (found.intrinsics(), truth.intrinsics());
    [is.fx_px - was.fx_px, is.fy_px - was.fy_px, is.cx_px - was.cx_px, is.cy_px - was.cy_px]
}

/// Uniform random numbers between -1 and 1.
pub(crate) struct Random(pub u64);

impl Random {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 32) as f64 / f64::from(1u32 << 31) - 1.0
    }
}

/// `time_s` seconds after the start of a test.
pub(crate) fn at(time_s: f64) -> Timestamp {
    Timestamp::from_ns(1_800_000_000_000_000_000).plus_seconds(time_s)
}

/// A frame that arrives when it is captured.
pub(crate) fn frame(
    camera: usize,
    frame: u64,
    capture_time: Timestamp,
    detections: Vec<Detection>,
) -> FrameObservations {
    FrameObservations {
        camera: CameraId(camera as u32),
        frame,
        capture_time,
        received_time: capture_time,
        calibration_version: 1,
        detections,
    }
}

pub(crate) fn detection(
    number: u64,
    code: Option<Code>,
    position_m: Vector3<f64>,
    capture_time: Timestamp,
) -> Detection {
    let center = PixelPoint { u: 0.0, v: 0.0 };
    let rim = |semi_px| Ellipse {
        center,
        semi_major_px: semi_px,
        semi_minor_px: semi_px,
        angle_rad: 0.0,
    };
    let code = code.map(|code| CodeReading::certain(code, center));
    let normal = Vector3::new(0.0, 0.0, -1.0);
    Detection {
        track: TrackNumber(number),
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
