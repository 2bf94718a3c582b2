//! A camera as the configuration says it.

use roundel_proto::v1;

use crate::{
    config::edit::{WrittenCamera, WrittenPose},
    source::without_credentials,
};

/// For clients, whom passwords are no business of.
pub fn setup(camera: &WrittenCamera) -> v1::CameraSetup {
    let corner = |[u, v]: &[f64; 2]| v1::PixelPoint { u: *u, v: *v };
    let polygon =
        |corners: &Vec<[f64; 2]>| v1::MaskPolygon { corners: corners.iter().map(corner).collect() };
    v1::CameraSetup {
        name: camera.name.clone(),
        source: without_credentials(&camera.source),
        calibration: camera.calibration.clone().unwrap_or_default(),
        pose: camera.pose.as_ref().map(pose),
        line_time_us: camera.line_time_us,
        clock_uncertainty_ms: camera.clock_uncertainty_ms,
        rate_hz: camera.rate_hz,
        mode: camera.mode.clone().unwrap_or_default(),
        mask: camera.mask.iter().map(polygon).collect(),
    }
}

fn pose(pose: &WrittenPose) -> v1::CameraPoseSetup {
    let WrittenPose::At { position_m, orientation_xyzw, object, localizes } = pose else {
        return v1::CameraPoseSetup { unknown: true, ..v1::CameraPoseSetup::default() };
    };
    let ([x, y, z], [i, j, k, w]) = (*position_m, *orientation_xyzw);
    v1::CameraPoseSetup {
        unknown: false,
        pose: Some(v1::Pose {
            position: Some(v1::Vector3 { x, y, z }),
            orientation: Some(v1::Quaternion { x: i, y: j, z: k, w }),
        }),
        object: object.clone().unwrap_or_default(),
        localizes: *localizes,
    }
}

/// As a client has it written. Whether it makes sense is for the configuration to say.
pub fn written(camera: v1::CameraSetup) -> WrittenCamera {
    let text = |text: String| (!text.is_empty()).then_some(text);
    let corners = |polygon: v1::MaskPolygon| {
        polygon.corners.iter().map(|corner| [corner.u, corner.v]).collect()
    };
    WrittenCamera {
        name: camera.name,
        source: camera.source,
        calibration: text(camera.calibration),
        pose: camera.pose.map(written_pose),
        line_time_us: camera.line_time_us,
        clock_uncertainty_ms: camera.clock_uncertainty_ms,
        rate_hz: camera.rate_hz,
        mode: text(camera.mode),
        mask: camera.mask.into_iter().map(corners).collect(),
    }
}

fn written_pose(pose: v1::CameraPoseSetup) -> WrittenPose {
    if pose.unknown {
        return WrittenPose::Unknown;
    }
    let v1::Pose { position, orientation } = pose.pose.unwrap_or_default();
    let (position, turn) = (position.unwrap_or_default(), orientation.unwrap_or_default());
    WrittenPose::At {
        position_m: [position.x, position.y, position.z],
        orientation_xyzw: [turn.x, turn.y, turn.z, turn.w],
        object: (!pose.object.is_empty()).then_some(pose.object),
        localizes: pose.localizes,
    }
}
