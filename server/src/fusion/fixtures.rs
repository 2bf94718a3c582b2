//! An installation and frames for the tests of fusion; the cameras look straight down.

use nalgebra::Vector3;
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::Ring,
    pose::{Detection, RoundelPose},
    rigid::Covariance6,
    time::Timestamp,
    world::FrameObservations,
};

use crate::model::hub::{CameraInfo, Hub, Installation};

/// Distance of the roundel below the cameras, metres.
pub(super) const DEPTH_M: f64 = 3.0;
/// Its place in an image of 640 x 480 pixels.
pub(super) const MIDDLE: PixelPoint = PixelPoint { u: 319.5, v: 239.5 };

pub(super) fn hub(cameras: &[&str], started: Timestamp) -> Hub {
    let camera = |name: &&str| CameraInfo { name: (*name).into(), ..CameraInfo::default() };
    Hub::new(Installation {
        name: "lab".into(),
        source_id: "s".into(),
        started,
        snapshot_rate_hz: 100.0,
        cameras: Installation::number_cameras(cameras.iter().map(camera)),
        kinds: vec!["robot".into()],
        object_names: [(KindId(0), "robot one".into())].into(),
        body_names: vec!["carrier".into()],
    })
}

/// A frame with a roundel in its middle.
pub(super) fn frame(camera: CameraId, number: u64, time: Timestamp) -> FrameObservations {
    let (semi_major_px, semi_minor_px) = (20.0, 20.0);
    let rim = Ellipse { center: MIDDLE, semi_major_px, semi_minor_px, angle_rad: 0.0 };
    let pose = RoundelPose {
        position_m: Vector3::new(0.0, 0.0, DEPTH_M),
        normal: -Vector3::z(),
        normal_likelihood: 1.0,
        other_normal: -Vector3::z(),
        yaw_rad: None,
        yaw_symmetry: 1,
        covariance: Covariance6::identity() * 1e-4,
    };
    let detection = Detection {
        track: TrackNumber(1),
        ring: Ring { kind: Some(KindId(0)), ..Ring::of_rims(rim, rim) },
        capture_time: time,
        pose: Some(pose),
    };
    FrameObservations {
        camera,
        frame: number,
        capture_time: time,
        received_time: time,
        calibration_version: 1,
        detections: vec![detection],
    }
}
