//! Detects bumped and drifted cameras, quarantines and recovers them.
//!
//! [`roundel_core::calib::watch`] decides on a thread of its own ([`MonitorThread`]); this module applies its events.
//! A bumped camera is removed from fusion at once. Its new pose takes the path of every calibration: the calibrator
//! stores it and passes it to the worker, which sends it to fusion with the next frame.

use std::{collections::BTreeMap, sync::Arc};

use roundel_core::{
    calib::watch::{Watch, WatchEvent, WatchParams},
    id::CameraId,
    time::Timestamp,
    world::{CameraPlacement, FrameObservations, Fusion, HeldStep, Landmark},
};

use super::monitor_thread::{Findings, MonitorInput, MonitorThread};
use crate::{
    fusion::calibration::Calibrator,
    model::{
        command::{CameraChange, CameraUpdate},
        hub::{CameraPoseState, EventKind, Hub, Installation, PoseStatus},
    },
};

pub(super) struct CameraMonitor {
    monitor_thread: MonitorThread,
    calibrator: Arc<Calibrator>,
    cameras: BTreeMap<CameraId, MonitoredCamera>,
    trust: BTreeMap<CameraId, u8>,
}

#[derive(Clone, Copy, Debug)]
struct MonitoredCamera {
    placement: CameraPlacement,
    is_exempt: bool,
}

impl CameraMonitor {
    pub(super) fn new(landmarks: &[Landmark], calibrator: Arc<Calibrator>) -> Self {
        let mut watch = Watch::new(WatchParams::default());
        watch.set_landmarks(landmarks);
        Self {
            monitor_thread: MonitorThread::new(watch),
            calibrator,
            cameras: BTreeMap::new(),
            trust: BTreeMap::new(),
        }
    }

    /// Adds a camera or changes its pose; a configured pose may be inexact.
    pub(super) fn set(
        &mut self,
        camera: CameraId,
        placement: CameraPlacement,
        is_configured: bool,
    ) {
        let known = self.cameras.get(&camera).filter(|known| known.placement == placement);
        let is_new = known.is_none();
        let is_exempt = is_configured || known.is_some_and(|known| known.is_exempt);
        self.cameras.insert(camera, MonitoredCamera { placement, is_exempt });
        let placement = Box::new(placement);
        self.monitor_thread.note(MonitorInput::Placed { camera, placement, is_configured, is_new });
    }

    /// Sets the rank of a camera. While a monitored camera has a higher rank, cameras of a lower one do not testify against
    /// it and are not monitored themselves.
    pub(super) fn set_trust(&mut self, camera: CameraId, trust: u8) {
        self.trust.insert(camera, trust);
    }

    /// Removes a camera from the installation.
    pub(super) fn forget(&mut self, camera: CameraId) {
        self.trust.remove(&camera);
        self.remove(camera);
    }

    /// Removes a camera whose pose is not known any more.
    pub(super) fn remove(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
        self.monitor_thread.note(MonitorInput::Removed(camera));
    }

    pub(super) fn observe(&mut self, frame: &Arc<FrameObservations>, fusion: &Fusion) {
        let highest = self.cameras.keys().filter_map(|camera| self.trust.get(camera)).max();
        if self.trust.get(&frame.camera) < highest {
            return;
        }
        let offset_s = fusion.clock(frame.camera).map_or(0.0, |clock| clock.offset_s);
        let resized = fusion.resized(frame).map_or_else(|| frame.clone(), Arc::new);
        self.monitor_thread.note(MonitorInput::Detections(resized, offset_s));
    }

    /// Applies new findings and lets the watch advance to `now`.
    pub(super) fn advance(&mut self, now: Timestamp, fusion: &mut Fusion, hub: &Hub) {
        for held in fusion.drain_held_back() {
            log_held_back(hub.installation().camera_name(held.camera), held.step);
            self.monitor_thread
                .note(MonitorInput::Held(held.camera, held.step == HeldStep::Started));
        }
        if let Some(findings) = self.monitor_thread.findings() {
            self.apply_findings(findings, now, (fusion, hub));
        }
        self.monitor_thread.send(now);
        for (&camera, &MonitoredCamera { is_exempt, .. }) in &self.cameras {
            let change = CameraChange::HoldBackExempt(is_exempt);
            hub.tap().update_camera(CameraUpdate { camera, change });
            fusion.set_hold_back_exempt(camera, is_exempt);
        }
    }

    /// Findings about a camera whose pose changed in the meantime are outdated; the next batch reports the new pose.
    fn apply_findings(
        &mut self,
        findings: Findings,
        now: Timestamp,
        (fusion, hub): (&mut Fusion, &Hub),
    ) {
        for event in findings.events {
            let (kind, message) = describe(&event, &hub.installation());
            let camera = match event {
                WatchEvent::Bumped { camera, .. }
                | WatchEvent::Returned { camera, .. }
                | WatchEvent::Drifted { camera, .. } => camera,
                WatchEvent::Contradiction { .. }
                | WatchEvent::Misplaced { .. }
                | WatchEvent::Agreed { .. } => {
                    tracing::warn!("{message}");
                    hub.publish_event(now, kind, message);
                    continue;
                }
            };
            let Some(monitored) = self.cameras.get_mut(&camera) else { continue };
            if self.monitor_thread.is_outdated(camera) {
                continue;
            }
            match event {
                WatchEvent::Returned { placement, .. } | WatchEvent::Drifted { placement, .. } => {
                    monitored.placement = placement;
                    self.calibrator.apply_pose(camera, placement);
                }
                _ => quarantine(camera, fusion, hub),
            }
            tracing::warn!("{message}");
            hub.publish_camera_event(now, kind, camera, message);
        }
        for (camera, is_exempt, health) in findings.cameras {
            let Some(monitored) = self.cameras.get_mut(&camera) else { continue };
            if !self.monitor_thread.is_outdated(camera) {
                monitored.is_exempt = is_exempt;
                hub.update_camera(camera, |state| state.health = health);
            }
        }
    }
}

fn quarantine(camera: CameraId, fusion: &mut Fusion, hub: &Hub) {
    hub.tap().update_camera(CameraUpdate { camera, change: CameraChange::Quarantined });
    fusion.quarantine(camera);
    let reason = "it was bumped; it is excluded until its new pose is known from other cameras that see the same \
                  roundels";
    let pose =
        CameraPoseState { status: PoseStatus::Quarantined, ..CameraPoseState::searching(reason) };
    hub.update_camera(camera, |state| state.pose = pose);
}

fn describe(event: &WatchEvent, installation: &Installation) -> (EventKind, String) {
    let name = |camera: &CameraId| installation.camera_name(*camera).to_owned();
    let names = |cameras: &[CameraId]| cameras.iter().map(name).collect::<Vec<_>>().join(" and ");
    match event {
        WatchEvent::Bumped { camera, moved_m, turned_rad } => {
            let message = format!(
                "Camera {} was bumped, by about {:.0} mm and {:.1}°: it is excluded until its new pose is known.",
                name(camera),
                moved_m * 1e3,
                turned_rad.to_degrees()
            );
            (EventKind::CameraBumped, message)
        }
        WatchEvent::Returned { camera, .. } => {
            let message = format!("Camera {} is used again: its new pose is known.", name(camera));
            (EventKind::CameraReturned, message)
        }
        WatchEvent::Drifted { camera, moved_m, .. } => {
            let (name, moved_mm) = (name(camera), moved_m * 1e3);
            let message =
                format!("Camera {name} has drifted: its observations move by {moved_mm:.2} mm.");
            (EventKind::CameraDrifted, message)
        }
        WatchEvent::Contradiction { cameras } => {
            let message = format!(
                "Cameras {} contradict one another, and it is not known which of them has moved. A third camera with \
                 the same view, or a reference roundel, would decide it. Positions may be wrong until then.",
                names(cameras)
            );
            (EventKind::CamerasContradict, message)
        }
        WatchEvent::Misplaced { cameras } => {
            let message = format!(
                "Cameras {} have not agreed since the start: their poses in the configuration are not exact enough. \
                 Run `roundel calibrate arena`. Until then positions are wrong, and bumped cameras are not detected.",
                names(cameras)
            );
            (EventKind::CamerasMisplaced, message)
        }
        WatchEvent::Agreed { cameras } => {
            (EventKind::CamerasAgree, format!("Cameras {} agree again.", names(cameras)))
        }
    }
}

/// Cameras are held back only for moments; a confirmed movement becomes an event.
fn log_held_back(camera: &str, step: HeldStep) {
    match step {
        HeldStep::Started => tracing::info!(
            camera,
            "seems to have moved suddenly: it is held back until that is certain"
        ),
        HeldStep::Agreed => tracing::info!(camera, "agrees with the others again and is used"),
        HeldStep::TimedOut => tracing::warn!(
            camera,
            "still disagrees with the others, but too little for a bump: it is used again"
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
        fusion::{
            calibration::{CalibratorCamera, file::CalibrationFile},
            fixtures,
        },
        model::clock::Clock,
    };

    const NORTH: CameraId = CameraId(0);
    const SOUTH: CameraId = CameraId(1);

    fn placement(x: f64) -> CameraPlacement {
        CameraPlacement {
            world_from_camera: Rigid::translation(x, 0.0, 5.0),
            covariance: Covariance6::identity() * 1e-8,
        }
    }

    /// Two cameras, of which the first has a configured pose.
    fn rig() -> (Clock, Arc<Hub>, CameraMonitor, Fusion) {
        let clock = Clock::anchored_now();
        let hub = Arc::new(fixtures::hub(&["north", "south"], clock.now()));
        let camera = |name: &str| CalibratorCamera {
            name: name.into(),
            configured: None,
            mailbox: CalibrationMailbox::default(),
        };
        let cameras = [(NORTH, camera("north")), (SOUTH, camera("south"))].into();
        let file = CalibrationFile::default();
        let calibrator = Calibrator::new(hub.clone(), clock, cameras, Vec::new(), None, file);
        let mut camera_monitor = CameraMonitor::new(&[], Arc::new(calibrator));
        camera_monitor.set(NORTH, placement(0.0), true);
        camera_monitor.set(SOUTH, placement(1.0), false);
        let mut fusion = Fusion::new(FusionParams::default());
        fusion.set_camera(NORTH, Some(placement(0.0)));
        (clock, hub, camera_monitor, fusion)
    }

    fn bumped(camera: CameraId) -> Findings {
        Findings {
            events: vec![WatchEvent::Bumped { camera, moved_m: 0.0213, turned_rad: 0.02 }],
            cameras: vec![(camera, true, None)],
        }
    }

    #[test]
    fn only_a_bumped_camera_is_quarantined() {
        let (clock, hub, mut camera_monitor, mut fusion) = rig();
        // Sends both poses to the watch.
        camera_monitor.advance(clock.now(), &mut fusion, &hub);
        let cameras = vec![NORTH, SOUTH];
        let undecided = [
            WatchEvent::Contradiction { cameras: cameras.clone() },
            WatchEvent::Misplaced { cameras: cameras.clone() },
            WatchEvent::Agreed { cameras },
        ];
        let findings = Findings { events: undecided.into(), cameras: Vec::new() };
        camera_monitor.apply_findings(findings, clock.now(), (&mut fusion, &hub));
        assert!(fusion.camera_placement(NORTH, clock.now()).is_ok());
        camera_monitor.apply_findings(bumped(NORTH), clock.now(), (&mut fusion, &hub));
        assert!(fusion.camera_placement(NORTH, clock.now()).is_err());
        let pose = hub.camera(NORTH).unwrap().pose;
        assert_eq!((pose.status, pose.placement), (PoseStatus::Quarantined, None));
        assert!(pose.reason.contains("bumped"), "{}", pose.reason);
        let expected = [
            (EventKind::CamerasContradict, "Cameras north and south contradict one another"),
            (EventKind::CamerasMisplaced, "Cameras north and south have not agreed"),
            (EventKind::CamerasAgree, "Cameras north and south agree again."),
            (EventKind::CameraBumped, "Camera north was bumped, by about 21 mm and 1.1°"),
        ];
        let (events, _) = hub.events(10);
        assert_eq!(events.len(), expected.len());
        for (event, (kind, message)) in events.iter().zip(expected) {
            assert_eq!(event.kind(), kind);
            assert!(event.message.starts_with(message), "{}", event.message);
        }
        assert!(events[1].message.contains("`roundel calibrate arena`"), "{}", events[1].message);
    }

    #[test]
    fn health_is_shown() {
        let (clock, hub, mut camera_monitor, mut fusion) = rig();
        let is_shown = |hub: &Hub| hub.cameras().values().all(|state| state.health.is_some());
        let begun = Instant::now();
        while !is_shown(&hub) && begun.elapsed() < Duration::from_secs(30) {
            camera_monitor.advance(clock.now(), &mut fusion, &hub);
            sleep(Duration::from_millis(5));
        }
        assert!(is_shown(&hub), "{:?}", hub.cameras());
    }

    #[test]
    fn findings_about_an_earlier_pose_are_ignored() {
        let (clock, hub, mut camera_monitor, mut fusion) = rig();
        let status = |camera| hub.camera(camera).unwrap().pose.status;
        camera_monitor.advance(clock.now(), &mut fusion, &hub);
        camera_monitor.set(NORTH, placement(0.5), false);
        camera_monitor.set(SOUTH, placement(1.0), false);
        for camera in [NORTH, SOUTH] {
            camera_monitor.apply_findings(bumped(camera), clock.now(), (&mut fusion, &hub));
        }
        assert_ne!(status(NORTH), PoseStatus::Quarantined, "its pose has changed");
        assert_eq!(status(SOUTH), PoseStatus::Quarantined, "its pose was only repeated");
        assert!(
            !camera_monitor.cameras[&NORTH].is_exempt && camera_monitor.cameras[&SOUTH].is_exempt
        );
        camera_monitor.remove(SOUTH);
        camera_monitor.apply_findings(bumped(SOUTH), clock.now(), (&mut fusion, &hub));
        assert!(!camera_monitor.cameras.contains_key(&SOUTH));
    }
}
