//! Where cameras that ride on objects are, told with each snapshot.
//!
//! A place that comes or goes is an event. Objects are lost and seen again within a few frames at the edge of
//! what cameras see, so a place that has gone is told only when it stays away.

use roundel_core::{
    id::CameraId,
    time::Timestamp,
    world::{CameraPlacement, Fusion, Unplaced},
};

use crate::model::hub::{CameraPoseState, EventKind, Hub, MountInfo, PoseStatus};

/// Unknown for so long: told.
const LOST_AFTER_S: f64 = 1.0;

#[derive(Debug)]
struct MountedCamera {
    camera: CameraId,
    ride: MountInfo,
    /// Since when its place is not known, while it gives frames.
    lost_since: Option<Timestamp>,
    /// What was told last: whether its place is known.
    reported: Option<bool>,
}

#[derive(Debug, Default)]
pub(super) struct MountedCameras {
    cameras: Vec<MountedCamera>,
}

impl MountedCameras {
    /// A camera rides from now on.
    pub(super) fn set(&mut self, camera: CameraId, ride: MountInfo) {
        self.remove(camera);
        self.cameras.push(MountedCamera { camera, ride, lost_since: None, reported: None });
    }

    /// It rides no more.
    pub(super) fn remove(&mut self, camera: CameraId) {
        self.cameras.retain(|mounted| mounted.camera != camera);
    }

    /// Shows where each of them is at an instant. `gives_frames` says of a camera whether it has shown
    /// anything yet: before, nobody misses its place.
    pub(super) fn publish(
        &mut self,
        fusion: &mut Fusion,
        hub: &Hub,
        time: Timestamp,
        gives_frames: impl Fn(CameraId) -> bool,
    ) {
        for mounted in &mut self.cameras {
            let camera = mounted.camera;
            let place = place(&mounted.ride, fusion.camera_place(camera, time), time);
            if let Some(is_placed) = mounted.state_change(&place, time, gives_frames(camera)) {
                let installation = hub.installation();
                let name = installation.camera_name(camera);
                let (kind, message) = if is_placed {
                    let carrier = &mounted.ride.carrier;
                    let message = format!("Camera {name} has its place, on \"{carrier}\".");
                    (EventKind::CameraPlaced(camera), message)
                } else {
                    let message = format!("Camera {name} has no place: {}.", place.reason);
                    (EventKind::CameraUnplaced(camera), message)
                };
                tracing::info!(camera = name, "{message}");
                hub.publish_event(time, kind, message);
            }
            hub.update_camera(camera, |state| state.pose = place);
        }
    }
}

impl MountedCamera {
    /// Whether its place is known, if that is to be told.
    fn state_change(
        &mut self,
        place: &CameraPoseState,
        now: Timestamp,
        gives_frames: bool,
    ) -> Option<bool> {
        let is_placed = place.placement.is_some();
        if is_placed {
            self.lost_since = None;
        } else if gives_frames {
            let since = *self.lost_since.get_or_insert(now);
            if now.seconds_since(since) < LOST_AFTER_S {
                return None;
            }
        } else {
            return None;
        }
        (self.reported.replace(is_placed) != Some(is_placed)).then_some(is_placed)
    }
}

fn place(
    ride: &MountInfo,
    placement: Result<CameraPlacement, Unplaced>,
    time: Timestamp,
) -> CameraPoseState {
    match placement {
        Ok(placement) => CameraPoseState {
            status: PoseStatus::Riding,
            placement: Some(placement),
            time: Some(time),
            reason: String::new(),
        },
        Err(unplaced) => CameraPoseState {
            status: PoseStatus::Without(unplaced),
            placement: None,
            time: None,
            reason: reason(ride, unplaced),
        },
    }
}

/// Why there is no place, and what to do.
fn reason(ride: &MountInfo, unplaced: Unplaced) -> String {
    let carrier = &ride.carrier;
    match (unplaced, ride.localizes) {
        (Unplaced::Unknown | Unplaced::CarrierUnseen, false) => format!(
            "\"{carrier}\", which it rides on, is not followed now; cameras that stand must see it and \
             read its code"
        ),
        (Unplaced::Unknown | Unplaced::CarrierUnseen, true) => format!(
            "\"{carrier}\", which it rides on, is not followed now; the camera must see one reference \
             roundel with code and orientation, or three"
        ),
        (Unplaced::CarrierWithoutYaw, _) => format!(
            "how \"{carrier}\", which it rides on, is turned is not seen; its code, or several of its \
             roundels, must be in view"
        ),
        (Unplaced::CarrierUncertain, _) => format!(
            "how \"{carrier}\", which it rides on, is turned is too uncertain; it must be seen larger, \
             by more cameras, or by more roundels"
        ),
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::rigid::Rigid;

    use super::*;

    fn ride() -> MountInfo {
        let object_from_camera = Rigid::identity();
        MountInfo { carrier: "drone".into(), object_from_camera, localizes: false }
    }

    #[test]
    fn only_a_place_that_stays_away_is_told() {
        let mut mounted =
            MountedCamera { camera: CameraId(0), ride: ride(), lost_since: None, reported: None };
        let placement = CameraPlacement {
            world_from_camera: Rigid::identity(),
            covariance: Default::default(),
        };
        let mut told = Vec::new();
        for tenth in 0..100 {
            let time = Timestamp::default().plus_seconds(f64::from(tenth) * 0.1);
            // It gives frames from 1 s on, has a place from 3.5 to 5 s with a gap, and after 8 s.
            let has_place = matches!(tenth, 35..40 | 45..50 | 80..);
            let placement = if has_place { Ok(placement) } else { Err(Unplaced::CarrierUnseen) };
            let place = place(&ride(), placement, time);
            told.extend(
                mounted.state_change(&place, time, tenth >= 10).map(|is_placed| (tenth, is_placed)),
            );
        }
        assert_eq!(told, [(20, false), (35, true), (60, false), (80, true)]);
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
            let text = reason(&MountInfo { localizes, ..ride() }, unplaced);
            assert!(text.contains("\"drone\"") && text.contains("must"), "{text}");
        }
    }
}
