//! Cameras that no longer stand where they did: left out, found again, and told.
//!
//! `core::calib::watch` says who; here it is put into effect. A camera that was bumped is taken from fusion, so
//! that it poisons nothing. Its new place goes the way of every calibration: through the calibrator, which
//! keeps it, to its worker, which hands it to fusion with the next frame.

use std::{collections::BTreeMap, sync::Arc};

use roundel_core::{
    calib::watch::{Watch, WatchEvent, WatchParams},
    id::CameraId,
    time::Timestamp,
    world::{CameraPlacement, FrameObservations, Fusion, HeldBack, HeldStep, Landmark},
};

use super::monitor_thread::{Findings, MonitorInput, MonitorThread};
use crate::{
    fusion::calibration::Calibrator,
    model::{
        command::{CameraChange, CameraUpdate},
        hub::{CameraPoseState, EventKind, Hub, Installation, PoseStatus},
    },
};

/// What the watch needs beside cameras.
pub struct CameraMonitorParts {
    pub landmarks: Vec<Landmark>,
    /// Keeps what is found out.
    pub calibrator: Arc<Calibrator>,
}

pub(super) struct CameraMonitor {
    monitor_thread: MonitorThread,
    calibrator: Arc<Calibrator>,
    cameras: BTreeMap<CameraId, MonitoredCamera>,
}

/// A camera, as the watch has it as far as is known.
#[derive(Clone, Copy, Debug)]
struct MonitoredCamera {
    placement: CameraPlacement,
    is_exempt: bool,
}

impl CameraMonitor {
    pub(super) fn new(parts: CameraMonitorParts) -> Self {
        let mut watch = Watch::new(WatchParams::default());
        watch.set_landmarks(&parts.landmarks);
        let monitor_thread = MonitorThread::new(watch);
        Self { monitor_thread, calibrator: parts.calibrator, cameras: BTreeMap::new() }
    }

    /// Where a camera stands was said; if a person has written it, it may be rough.
    pub(super) fn set(
        &mut self,
        camera: CameraId,
        placement: CameraPlacement,
        is_configured: bool,
    ) {
        let known = self.cameras.get(&camera);
        let is_new = known.is_none_or(|monitored| monitored.placement != placement);
        let is_exempt =
            is_configured || !is_new && known.is_some_and(|monitored| monitored.is_exempt);
        self.cameras.insert(camera, MonitoredCamera { placement, is_exempt });
        let placement = Box::new(placement);
        self.monitor_thread.note(MonitorInput::Placed { camera, placement, is_configured, is_new });
    }

    /// A camera is gone, or does not stand where that is known.
    pub(super) fn remove(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
        self.monitor_thread.note(MonitorInput::Removed(camera));
    }

    /// A camera's place is known anew.
    pub(super) fn place(&mut self, camera: CameraId, placement: CameraPlacement) {
        self.set(camera, placement, false);
    }

    pub(super) fn observe(&mut self, frame: &Arc<FrameObservations>, fusion: &Fusion) {
        let offset_s = fusion.clock(frame.camera).map_or(0.0, |clock| clock.offset_s);
        self.monitor_thread.note(MonitorInput::Detections(frame.clone(), offset_s));
    }

    /// Puts into effect what has become known, and lets the watch's time pass until `now`.
    pub(super) fn advance(&mut self, now: Timestamp, fusion: &mut Fusion, hub: &Hub) {
        for held in fusion.drain_held_back() {
            log_held_back(&held, &hub.installation());
            self.monitor_thread.note(MonitorInput::Held(held.camera, held.step == HeldStep::Begun));
        }
        if let Some(findings) = self.monitor_thread.findings() {
            self.apply_findings(findings, now, (fusion, hub));
        }
        self.monitor_thread.send(now);
        for (&camera, &MonitoredCamera { is_exempt, .. }) in &self.cameras {
            hub.tap().update_camera(CameraUpdate {
                camera,
                change: CameraChange::HoldBackExempt(is_exempt),
            });
            fusion.spare(camera, is_exempt);
        }
    }

    /// What was found of a camera that was placed elsewhere meanwhile is not true any more; the watch hears of
    /// that place next.
    fn apply_findings(
        &mut self,
        findings: Findings,
        now: Timestamp,
        (fusion, hub): (&mut Fusion, &Hub),
    ) {
        for event in findings.events {
            let found = match event {
                WatchEvent::Bumped { camera, .. } => Some((camera, None)),
                WatchEvent::Returned { camera, placement }
                | WatchEvent::Drifted { camera, placement, .. } => Some((camera, Some(placement))),
                WatchEvent::Contradiction { .. }
                | WatchEvent::Misplaced { .. }
                | WatchEvent::Agreed { .. } => None,
            };
            if let Some((camera, placement)) = found {
                let Some(monitored) = self.cameras.get_mut(&camera) else { continue };
                if self.monitor_thread.is_outdated(camera) {
                    continue;
                }
                monitored.placement = placement.unwrap_or(monitored.placement);
            }
            let (kind, message) = self.handle_event(&event, fusion, hub);
            tracing::warn!("{message}");
            hub.publish_event(now, kind, message);
        }
        for (camera, is_exempt, health) in findings.cameras {
            let Some(monitored) = self.cameras.get_mut(&camera) else { continue };
            if !self.monitor_thread.is_outdated(camera) {
                monitored.is_exempt = is_exempt;
                hub.update_camera(camera, |state| state.health = health);
            }
        }
    }

    fn handle_event(
        &self,
        event: &WatchEvent,
        fusion: &mut Fusion,
        hub: &Hub,
    ) -> (EventKind, String) {
        let name = |camera: &CameraId| hub.installation().camera_name(*camera).to_owned();
        match event {
            WatchEvent::Bumped { camera, moved_m, turned_rad } => {
                hub.tap().update_camera(CameraUpdate {
                    camera: *camera,
                    change: CameraChange::Quarantined,
                });
                fusion.quarantine(*camera);
                let reason = "it was bumped; it is left out until its new place is known, which others that see \
                              the same roundels tell";
                let place = CameraPoseState {
                    status: PoseStatus::Quarantined,
                    ..CameraPoseState::searching(reason)
                };
                hub.update_camera(*camera, |state| state.pose = place);
                let message = format!(
                    "Camera {} was bumped, by about {:.0} mm and {:.1}°: it is left out until its new place is \
                     known.",
                    name(camera),
                    moved_m * 1e3,
                    turned_rad.to_degrees()
                );
                (EventKind::CameraBumped(*camera), message)
            }
            WatchEvent::Returned { camera, placement } => {
                self.calibrator.apply_pose(*camera, *placement);
                let message =
                    format!("Camera {} is used again: its new place is known.", name(camera));
                (EventKind::CameraReturned(*camera), message)
            }
            WatchEvent::Drifted { camera, placement, moved_m } => {
                self.calibrator.apply_pose(*camera, *placement);
                let message = format!(
                    "Camera {} has drifted: what it sees moves by {:.2} mm.",
                    name(camera),
                    moved_m * 1e3
                );
                (EventKind::CameraDrifted(*camera), message)
            }
            WatchEvent::Contradiction { cameras } => {
                let names: Vec<String> = cameras.iter().map(name).collect();
                let message = format!(
                    "Cameras {} contradict one another, and nothing tells which of them has moved: a third \
                     camera that sees the same, or a reference roundel, would. Places may be wrong until then.",
                    names.join(" and ")
                );
                (EventKind::CamerasContradict, message)
            }
            WatchEvent::Misplaced { cameras } => {
                let names: Vec<String> = cameras.iter().map(name).collect();
                let message = format!(
                    "Cameras {} have not agreed since the start about where roundels are: their poses in the \
                     configuration are not exact enough. Run `roundel calibrate arena`. Until then objects are \
                     not where they are said to be, and a camera that is bumped is not noticed.",
                    names.join(" and ")
                );
                (EventKind::CamerasMisplaced, message)
            }
            WatchEvent::Agreed { cameras } => {
                let names: Vec<String> = cameras.iter().map(name).collect();
                (EventKind::CamerasAgree, format!("Cameras {} agree again.", names.join(" and ")))
            }
        }
    }
}

/// Cameras are held back for moments; what matters of it becomes an event once the watch is sure.
fn log_held_back(held: &HeldBack, installation: &Installation) {
    let camera = installation.camera_name(held.camera);
    match held.step {
        HeldStep::Begun => tracing::info!(
            camera,
            "seems to have moved all of a sudden: it is held back until that is sure"
        ),
        HeldStep::Agreed => tracing::info!(camera, "agrees with the others again, and is used"),
        HeldStep::InVain => tracing::warn!(
            camera,
            "still disagrees with the others, by too little to be taken for bumped: it is used again"
        ),
    }
}

#[cfg(test)]
mod tests {
    use std::{
        thread::sleep,
        time::{Duration, Instant},
    };

    use roundel_core::{
        rigid::{Covariance6, Rigid},
        world::FusionParams,
    };

    use super::*;
    use crate::{
        capture::worker::calibration_update::CalibrationMailbox,
        fusion::calibration::{CalibratorCamera, CalibratorParts, file::CalibrationFile},
        model::{clock::Clock, hub::CameraInfo},
    };

    const NORTH: CameraId = CameraId(0);
    const SOUTH: CameraId = CameraId(1);

    fn placement(x: f64) -> CameraPlacement {
        CameraPlacement {
            world_from_camera: Rigid::translation(x, 0.0, 5.0),
            covariance: Covariance6::identity() * 1e-8,
        }
    }

    fn hub(clock: &Clock) -> Arc<Hub> {
        let camera = |name: &str| CameraInfo { name: name.into(), ..CameraInfo::default() };
        Arc::new(Hub::new(Installation {
            name: "lab".into(),
            source_id: "s".into(),
            started: clock.now(),
            snapshot_rate_hz: 60.0,
            cameras: Installation::number_cameras([camera("north"), camera("south")]),
            kinds: Vec::new(),
            object_names: BTreeMap::new(),
            body_names: Vec::new(),
        }))
    }

    fn camera_monitor(hub: &Arc<Hub>, clock: Clock) -> CameraMonitor {
        let camera = |name: &str| CalibratorCamera {
            name: name.into(),
            configured: None,
            mailbox: CalibrationMailbox::default(),
        };
        let calibrator = Arc::new(Calibrator::new(CalibratorParts {
            hub: hub.clone(),
            clock,
            cameras: [(NORTH, camera("north")), (SOUTH, camera("south"))].into(),
            landmarks: Vec::new(),
            path: None,
            file: CalibrationFile::default(),
        }));
        let mut camera_monitor =
            CameraMonitor::new(CameraMonitorParts { landmarks: Vec::new(), calibrator });
        camera_monitor.set(NORTH, placement(0.0), true);
        camera_monitor.set(SOUTH, placement(1.0), false);
        camera_monitor
    }

    #[test]
    fn a_bumped_camera_is_left_out_and_everybody_hears_of_it() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let camera_monitor = camera_monitor(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        fusion.set_camera(NORTH, Some(placement(0.0)));
        let bumped = WatchEvent::Bumped { camera: NORTH, moved_m: 0.0213, turned_rad: 0.02 };
        let (kind, message) = camera_monitor.handle_event(&bumped, &mut fusion, &hub);
        assert_eq!(kind, EventKind::CameraBumped(NORTH));
        assert!(
            message.starts_with("Camera north was bumped, by about 21 mm and 1.1°"),
            "{message}"
        );
        assert!(fusion.camera_place(NORTH, clock.now()).is_err(), "it is not used");
        let place = hub.camera(NORTH).unwrap().pose;
        assert_eq!((place.status, place.placement), (PoseStatus::Quarantined, None));
        assert!(place.reason.contains("bumped"), "{}", place.reason);
    }

    #[test]
    fn who_moved_is_not_guessed() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let camera_monitor = camera_monitor(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        fusion.set_camera(NORTH, Some(placement(0.0)));
        let cameras = vec![NORTH, SOUTH];
        let contradiction = WatchEvent::Contradiction { cameras: cameras.clone() };
        let (kind, message) = camera_monitor.handle_event(&contradiction, &mut fusion, &hub);
        assert_eq!(kind, EventKind::CamerasContradict);
        assert!(message.starts_with("Cameras north and south contradict one another"), "{message}");
        assert!(fusion.camera_place(NORTH, clock.now()).is_ok(), "nobody is left out");
        let (kind, message) =
            camera_monitor.handle_event(&WatchEvent::Agreed { cameras }, &mut fusion, &hub);
        assert_eq!(
            (kind, message.as_str()),
            (EventKind::CamerasAgree, "Cameras north and south agree again.")
        );
    }

    #[test]
    fn rough_places_ask_for_a_calibration() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let camera_monitor = camera_monitor(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        fusion.set_camera(NORTH, Some(placement(0.0)));
        let misplaced = WatchEvent::Misplaced { cameras: vec![NORTH, SOUTH] };
        let (kind, message) = camera_monitor.handle_event(&misplaced, &mut fusion, &hub);
        assert_eq!(kind, EventKind::CamerasMisplaced);
        assert!(message.starts_with("Cameras north and south have not agreed"), "{message}");
        assert!(message.contains("`roundel calibrate arena`"), "{message}");
        assert!(fusion.camera_place(NORTH, clock.now()).is_ok(), "nobody is left out");
    }

    #[test]
    fn health_is_shown() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let mut camera_monitor = camera_monitor(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        let is_shown = |hub: &Hub| hub.cameras().values().all(|state| state.health.is_some());
        let begun = Instant::now();
        while !is_shown(&hub) && begun.elapsed() < Duration::from_secs(30) {
            camera_monitor.advance(clock.now(), &mut fusion, &hub);
            sleep(Duration::from_millis(5));
        }
        assert!(is_shown(&hub), "{:?}", hub.cameras());
    }

    #[test]
    fn what_was_found_of_another_place_is_left_out() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let mut camera_monitor = camera_monitor(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        let bumped = |camera| Findings {
            events: vec![WatchEvent::Bumped { camera, moved_m: 0.02, turned_rad: 0.02 }],
            cameras: vec![(camera, true, None)],
        };
        let status = |camera| hub.camera(camera).unwrap().pose.status;
        // The watch hears where both stand.
        camera_monitor.advance(clock.now(), &mut fusion, &hub);
        camera_monitor.place(NORTH, placement(0.5));
        camera_monitor.place(SOUTH, placement(1.0));
        for camera in [NORTH, SOUTH] {
            camera_monitor.apply_findings(bumped(camera), clock.now(), (&mut fusion, &hub));
        }
        assert_ne!(status(NORTH), PoseStatus::Quarantined, "it was placed elsewhere");
        assert_eq!(status(SOUTH), PoseStatus::Quarantined, "it was said once more where it stands");
        assert!(
            !camera_monitor.cameras[&NORTH].is_exempt && camera_monitor.cameras[&SOUTH].is_exempt
        );
        camera_monitor.remove(SOUTH);
        camera_monitor.apply_findings(bumped(SOUTH), clock.now(), (&mut fusion, &hub));
        assert!(!camera_monitor.cameras.contains_key(&SOUTH));
    }
}
