//! Publishes the poses of cameras on moving objects with each snapshot.
//!
//! A pose that becomes known or unknown is an event. At the edge of the cameras' view, objects are lost and recovered
//! within a few frames, so a lost pose is reported only if it stays unknown.

use roundel_core::{
    id::CameraId,
    time::Timestamp,
    world::{CameraPlacement, Fusion, Unplaced},
};

use crate::model::hub::{CameraPoseState, EventKind, Hub, MountInfo, PoseStatus};

/// A pose unknown for this long is reported, seconds.
const LOST_AFTER_S: f64 = 1.0;

#[derive(Debug)]
struct MountedCamera {
    camera: CameraId,
    mount: MountInfo,
    /// Since when its pose is unknown although it delivers frames.
    lost_since: Option<Timestamp>,
    /// Whether the pose was known according to the last event.
    reported: Option<bool>,
}

#[derive(Debug, Default)]
pub(super) struct MountedCameras {
    cameras: Vec<MountedCamera>,
}

impl MountedCameras {
    pub(super) fn set(&mut self, camera: CameraId, mount: MountInfo) {
        self.remove(camera);
        self.cameras.push(MountedCamera { camera, mount, lost_since: None, reported: None });
    }

    pub(super) fn remove(&mut self, camera: CameraId) {
        self.cameras.retain(|mounted| mounted.camera != camera);
    }

    /// Publishes the poses at `time`. A camera that has not delivered frames yet is not reported as lost.
    pub(super) fn publish(
        &mut self,
        fusion: &mut Fusion,
        hub: &Hub,
        time: Timestamp,
        gives_frames: impl Fn(CameraId) -> bool,
    ) {
        for mounted in &mut self.cameras {
            let camera = mounted.camera;
            let pose = pose_state(&mounted.mount, fusion.camera_placement(camera, time), time);
            let is_placed = pose.placement.is_some();
            if mounted.is_news(is_placed, time, gives_frames(camera)) {
                let installation = hub.installation();
                let name = installation.camera_name(camera);
                let (kind, message) = if is_placed {
                    let carrier = &mounted.mount.carrier;
                    let message = format!("The pose of camera {name} on \"{carrier}\" is known.");
                    (EventKind::CameraPlaced, message)
                } else {
                    let message = format!("The pose of camera {name} is unknown: {}.", pose.reason);
                    (EventKind::CameraUnplaced, message)
                };
                tracing::info!(camera = name, "{message}");
                hub.publish_camera_event(time, kind, camera, message);
            }
            hub.update_camera(camera, |state| state.pose = pose);
        }
    }
}

impl MountedCamera {
    /// Whether an event must report that the pose is known or unknown.
    fn is_news(&mut self, is_placed: bool, now: Timestamp, gives_frames: bool) -> bool {
        if is_placed {
            self.lost_since = None;
        } else if !gives_frames
            || now.seconds_since(*self.lost_since.get_or_insert(now)) < LOST_AFTER_S
        {
            return false;
        }
        self.reported.replace(is_placed) != Some(is_placed)
    }
}

fn pose_state(
    mount: &MountInfo,
    placement: Result<CameraPlacement, Unplaced>,
    time: Timestamp,
) -> CameraPoseState {
    let unplaced = match placement {
        Ok(placement) => {
            let time = Some(time);
            return CameraPoseState {
                time,
                ..CameraPoseState::fixed(PoseStatus::Riding, placement)
            };
        }
        Err(unplaced) => unplaced,
    };
    let carrier = &mount.carrier;
    let (status, reason) = match unplaced {
        Unplaced::Unknown | Unplaced::CarrierUnseen if mount.localizes => (
            PoseStatus::CarrierUnseen,
            format!(
                "its object \"{carrier}\" is not tracked; the camera must see one reference roundel with code and \
                 orientation, or three"
            ),
        ),
        Unplaced::Unknown | Unplaced::CarrierUnseen => (
            PoseStatus::CarrierUnseen,
            format!(
                "its object \"{carrier}\" is not tracked; fixed cameras must see it and read its code"
            ),
        ),
        Unplaced::CarrierWithoutYaw => (
            PoseStatus::CarrierWithoutYaw,
            format!(
                "the orientation of its object \"{carrier}\" is not observed; its code, or several of its roundels, \
                 must be visible"
            ),
        ),
        Unplaced::CarrierUncertain => (
            PoseStatus::CarrierUncertain,
            format!(
                "the orientation of its object \"{carrier}\" is too uncertain; it must appear larger, or in more \
                 cameras, or have more roundels"
            ),
        ),
    };
    CameraPoseState { status, ..CameraPoseState::searching(reason) }
}

#[cfg(test)]
mod tests {
    use roundel_core::rigid::Rigid;

    use super::*;

    fn mount(localizes: bool) -> MountInfo {
        let object_from_camera = Rigid::identity();
        MountInfo { carrier: "drone".into(), object_from_camera, localizes }
    }

    #[test]
    fn only_a_pose_that_stays_unknown_is_reported() {
        let (camera, mount) = (CameraId(0), mount(false));
        let mut mounted = MountedCamera { camera, mount, lost_since: None, reported: None };
        let mut reported = Vec::new();
        for tenth in 0..100 {
            let time = Timestamp::default().plus_seconds(f64::from(tenth) * 0.1);
            // It delivers frames from 1 s on, and has a pose from 3.5 to 5 s with a gap, and after 8 s.
            let has_place = matches!(tenth, 35..40 | 45..50 | 80..);
            if mounted.is_news(has_place, time, tenth >= 10) {
                reported.push((tenth, has_place));
            }
        }
        assert_eq!(reported, [(20, false), (35, true), (60, false), (80, true)]);
    }

    #[test]
    fn each_reason_names_the_object_and_what_to_do() {
        let all = [
            Unplaced::Unknown,
            Unplaced::CarrierUnseen,
            Unplaced::CarrierWithoutYaw,
            Unplaced::CarrierUncertain,
        ];
        for (unplaced, localizes) in all.into_iter().flat_map(|it| [(it, false), (it, true)]) {
            let text = pose_state(&mount(localizes), Err(unplaced), Timestamp::default()).reason;
            assert!(text.contains("\"drone\"") && text.contains("must"), "{text}");
        }
    }
}
