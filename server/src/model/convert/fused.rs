//! Converts camera updates and configurations to and from recordings.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use roundel_core::{
    id::{BodyId, CameraId},
    rigid::{Covariance6, Rigid, from_upper_triangle, upper_triangle},
    world::{CameraMount, CameraPlacement, Carrier, ClockPrior},
};
use roundel_proto::v1;

use super::pose;
use crate::model::{
    command::{AppliedConfig, CameraChange, CameraModel, CameraPose, CameraUpdate, ClockModel},
    hub::{Installation, MountInfo},
};

/// The configuration at the start of a recording.
pub fn recorded_configuration(
    installation: &Installation,
    text: &str,
) -> v1::RecordedConfiguration {
    v1::RecordedConfiguration {
        text: text.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        source_id: installation.source_id.clone(),
        name: installation.name.clone(),
        snapshot_rate_hz: installation.snapshot_rate_hz,
        roundels: installation.kinds.clone(),
        ..v1::RecordedConfiguration::default()
    }
}

/// A configuration that fusion applied during the recording.
pub fn fused_configuration(
    installation: &Installation,
    written: &AppliedConfig,
) -> v1::RecordedConfiguration {
    let (renamed_from, renamed_to) = written.renamed.clone().unwrap_or_default();
    v1::RecordedConfiguration {
        fused: true,
        renamed_from,
        renamed_to,
        ..recorded_configuration(installation, &written.text)
    }
}

pub fn fused_camera(installation: &Installation, update: &CameraUpdate) -> v1::FusedCamera {
    let mut message = v1::FusedCamera {
        camera: installation.camera_name(update.camera).to_owned(),
        number: update.camera.0,
        ..v1::FusedCamera::default()
    };
    match &update.change {
        CameraChange::Removed => message.removed = true,
        CameraChange::Quarantined => message.place = v1::FusedPlace::Quarantined.into(),
        CameraChange::HoldBackExempt(is_exempt) => message.spared = Some(*is_exempt),
        CameraChange::Localized(placement) => write_fixed_pose(&mut message, placement),
        CameraChange::Set(known) => {
            message.trust = known.trust.map(u32::from);
            match &known.pose {
                None => {}
                Some(CameraPose::Fixed { placement, .. }) => {
                    write_fixed_pose(&mut message, placement)
                }
                Some(CameraPose::Unknown) => message.place = v1::FusedPlace::Unknown.into(),
                Some(CameraPose::Mounted(mount, ride)) => {
                    write_mounted_pose(&mut message, mount.as_ref(), ride)
                }
            }
            match known.clock {
                None => {}
                Some(ClockModel::Exact) => message.clock = v1::FusedClock::Exact.into(),
                Some(ClockModel::Estimated(prior)) => {
                    message.clock = v1::FusedClock::Estimated.into();
                    (message.clock_offset_s, message.clock_skew) = (prior.offset_s, prior.skew);
                }
            }
        }
    }
    message
}

fn write_fixed_pose(message: &mut v1::FusedCamera, placement: &CameraPlacement) {
    message.place = v1::FusedPlace::Stands.into();
    message.pose = Some(pose(&placement.world_from_camera));
    message.covariance = upper_triangle(&placement.covariance);
}

fn write_mounted_pose(
    message: &mut v1::FusedCamera,
    mount: Option<&CameraMount>,
    ride: &MountInfo,
) {
    message.place = v1::FusedPlace::Rides.into();
    message.pose = Some(pose(&ride.object_from_camera));
    message.carrier = ride.carrier.clone();
    message.localizes = ride.localizes;
    if let Some(CameraMount { carrier: Carrier::Body(body), .. }) = mount {
        message.carrier_body = body.0 + 1;
    }
}

/// `None` if this version does not understand the message.
pub fn read_fused_camera(message: &v1::FusedCamera) -> Option<CameraUpdate> {
    let update = |change| Some(CameraUpdate { camera: CameraId(message.number), change });
    if message.removed {
        return update(CameraChange::Removed);
    }
    if let Some(is_exempt) = message.spared {
        return update(CameraChange::HoldBackExempt(is_exempt));
    }
    let place = match message.place() {
        v1::FusedPlace::Unspecified => None,
        v1::FusedPlace::Quarantined => return update(CameraChange::Quarantined),
        v1::FusedPlace::Unknown => Some(CameraPose::Unknown),
        v1::FusedPlace::Stands => {
            let covariance = read_covariance(&message.covariance);
            let world_from_camera = read_pose(message.pose.as_ref()?)?;
            let placement = CameraPlacement { world_from_camera, covariance };
            Some(CameraPose::Fixed { placement, is_configured: false })
        }
        v1::FusedPlace::Rides => {
            let object_from_camera = read_pose(message.pose.as_ref()?)?;
            let localizes = message.localizes;
            let mount = message.carrier_body.checked_sub(1).map(|body| CameraMount {
                carrier: Carrier::Body(BodyId(body)),
                object_from_camera,
                covariance: Covariance6::zeros(),
                localizes,
            });
            let carrier = message.carrier.clone();
            Some(CameraPose::Mounted(mount, MountInfo { carrier, object_from_camera, localizes }))
        }
    };
    let clock = match message.clock() {
        v1::FusedClock::Unspecified => None,
        v1::FusedClock::Exact => Some(ClockModel::Exact),
        v1::FusedClock::Estimated => Some(ClockModel::Estimated(ClockPrior {
            offset_s: message.clock_offset_s,
            skew: message.clock_skew,
        })),
    };
    let trust = message.trust.and_then(|trust| u8::try_from(trust).ok());
    if place.is_none() && clock.is_none() && trust.is_none() {
        return None;
    }
    update(CameraChange::Set(Box::new(CameraModel { pose: place, clock, trust })))
}

/// A recorded pose, exactly; `None` if something is missing or not finite.
pub fn read_pose(pose: &v1::Pose) -> Option<Rigid> {
    let (position, turn) = (pose.position.as_ref()?, pose.orientation.as_ref()?);
    let numbers = [position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w];
    let turn = Quaternion::new(turn.w, turn.x, turn.y, turn.z);
    let is_sound = numbers.iter().all(|it| it.is_finite()) && (turn.norm() - 1.0).abs() < 1e-6;
    is_sound.then(|| {
        let place = Vector3::new(position.x, position.y, position.z);
        Rigid::from_parts(place.into(), UnitQuaternion::new_unchecked(turn))
    })
}

/// Zeros unless there are 21 numbers.
pub fn read_covariance(triangle: &[f64]) -> Covariance6 {
    from_upper_triangle(triangle).unwrap_or_else(Covariance6::zeros)
}
