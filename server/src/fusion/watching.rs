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

use super::watchman::{Findings, Note, Watchman};
use crate::{
    fusion::calibration::Calibrator,
    model::{
        command::{Change, Told},
        hub::{CameraPlace, Happening, Hub, Installation, PoseStatus},
    },
};

/// What the watch needs beside cameras.
pub struct WatchingParts {
    /// The reference roundels.
    pub landmarks: Vec<Landmark>,
    /// Keeps what is found out.
    pub calibrator: Arc<Calibrator>,
}

pub(super) struct Watching {
    watchman: Watchman,
    calibrator: Arc<Calibrator>,
    posts: BTreeMap<CameraId, Post>,
}

/// A camera, as the watch has it as far as is known.
#[derive(Clone, Copy, Debug)]
struct Post {
    placement: CameraPlacement,
    is_spared: bool,
}

impl Watching {
    pub(super) fn new(parts: WatchingParts) -> Self {
        let mut watch = Watch::new(WatchParams::default());
        watch.set_landmarks(&parts.landmarks);
        let watchman = Watchman::new(watch);
        Self { watchman, calibrator: parts.calibrator, posts: BTreeMap::new() }
    }

    /// Where a camera stands was said; if a person has written it, it may be rough.
    pub(super) fn set(&mut self, camera: CameraId, placement: CameraPlacement, is_written: bool) {
        let known = self.posts.get(&camera);
        let is_new = known.is_none_or(|post| post.placement != placement);
        let is_spared = is_written || !is_new && known.is_some_and(|post| post.is_spared);
        self.posts.insert(camera, Post { placement, is_spared });
        let placement = Box::new(placement);
        self.watchman.note(Note::Placed { camera, placement, is_written, is_new });
    }

    /// A camera is gone, or does not stand where that is known.
    pub(super) fn remove(&mut self, camera: CameraId) {
        self.posts.remove(&camera);
        self.watchman.note(Note::Removed(camera));
    }

    /// A camera's place is known anew.
    pub(super) fn place(&mut self, camera: CameraId, placement: CameraPlacement) {
        self.set(camera, placement, false);
    }

    pub(super) fn observe(&mut self, frame: &Arc<FrameObservations>, fusion: &Fusion) {
        let offset_s = fusion.clock(frame.camera).map_or(0.0, |clock| clock.offset_s);
        self.watchman.note(Note::Seen(frame.clone(), offset_s));
    }

    /// Puts into effect what has become known, and lets the watch's time pass until `now`.
    pub(super) fn advance(&mut self, now: Timestamp, fusion: &mut Fusion, hub: &Hub) {
        for held in fusion.drain_held_back() {
            log_held(&held, &hub.installation());
            self.watchman.note(Note::Held(held.camera, held.step == HeldStep::Begun));
        }
        if let Some(findings) = self.watchman.findings() {
            self.heed(findings, now, (fusion, hub));
        }
        self.watchman.send(now);
        for (&camera, &Post { is_spared, .. }) in &self.posts {
            hub.tap().tell(Told { camera, change: Change::Spared(is_spared) });
            fusion.spare(camera, is_spared);
        }
    }

    /// What was found of a camera that was placed elsewhere meanwhile is not true any more; the watch hears of
    /// that place next.
    fn heed(&mut self, findings: Findings, now: Timestamp, (fusion, hub): (&mut Fusion, &Hub)) {
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
                let Some(post) = self.posts.get_mut(&camera) else { continue };
                if self.watchman.is_overtaken(camera) {
                    continue;
                }
                post.placement = placement.unwrap_or(post.placement);
            }
            let (happening, message) = self.effect(&event, fusion, hub);
            tracing::warn!("{message}");
            hub.publish_event(now, happening, message);
        }
        for (camera, is_spared, health) in findings.cameras {
            let Some(post) = self.posts.get_mut(&camera) else { continue };
            if !self.watchman.is_overtaken(camera) {
                post.is_spared = is_spared;
                hub.update_camera(camera, |state| state.health = health);
            }
        }
    }

    fn effect(&self, event: &WatchEvent, fusion: &mut Fusion, hub: &Hub) -> (Happening, String) {
        let name = |camera: &CameraId| hub.installation().camera_name(*camera).to_owned();
        match event {
            WatchEvent::Bumped { camera, moved_m, turned_rad } => {
                hub.tap().tell(Told { camera: *camera, change: Change::Quarantined });
                fusion.quarantine(*camera);
                let reason = "it was bumped; it is left out until its new place is known, which others that see \
                              the same roundels tell";
                let place = CameraPlace {
                    status: PoseStatus::Quarantined,
                    ..CameraPlace::searching(reason)
                };
                hub.update_camera(*camera, |state| state.place = place);
                let message = format!(
                    "Camera {} was bumped, by about {:.0} mm and {:.1}°: it is left out until its new place is \
                     known.",
                    name(camera),
                    moved_m * 1e3,
                    turned_rad.to_degrees()
                );
                (Happening::Bumped(*camera), message)
            }
            WatchEvent::Returned { camera, placement } => {
                self.calibrator.adopt(*camera, *placement);
                let message =
                    format!("Camera {} is used again: its new place is known.", name(camera));
                (Happening::Returned(*camera), message)
            }
            WatchEvent::Drifted { camera, placement, moved_m } => {
                self.calibrator.adopt(*camera, *placement);
                let message = format!(
                    "Camera {} has drifted: what it sees moves by {:.2} mm.",
                    name(camera),
                    moved_m * 1e3
                );
                (Happening::Drifted(*camera), message)
            }
            WatchEvent::Contradiction { cameras } => {
                let names: Vec<String> = cameras.iter().map(name).collect();
                let message = format!(
                    "Cameras {} contradict one another, and nothing tells which of them has moved: a third \
                     camera that sees the same, or a reference roundel, would. Places may be wrong until then.",
                    names.join(" and ")
                );
                (Happening::Contradicted, message)
            }
            WatchEvent::Misplaced { cameras } => {
                let names: Vec<String> = cameras.iter().map(name).collect();
                let message = format!(
                    "Cameras {} have not agreed since the start about where roundels are: their poses in the \
                     configuration are not exact enough. Run `roundel calibrate arena`. Until then objects are \
                     not where they are said to be, and a camera that is bumped is not noticed.",
                    names.join(" and ")
                );
                (Happening::Misplaced, message)
            }
            WatchEvent::Agreed { cameras } => {
                let names: Vec<String> = cameras.iter().map(name).collect();
                (Happening::Agreed, format!("Cameras {} agree again.", names.join(" and ")))
            }
        }
    }
}

/// Cameras are held back for moments; what matters of it becomes an event once the watch is sure.
fn log_held(held: &HeldBack, installation: &Installation) {
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
        capture::worker::adoption::Inbox,
        fusion::calibration::{Calibrated, CalibratorParts, file::CalibrationFile},
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
            cameras: Installation::numbered([camera("north"), camera("south")]),
            kinds: Vec::new(),
            object_names: BTreeMap::new(),
            body_names: Vec::new(),
        }))
    }

    fn watching(hub: &Arc<Hub>, clock: Clock) -> Watching {
        let camera = |name: &str| Calibrated {
            name: name.into(),
            configured: None,
            inbox: Inbox::default(),
        };
        let calibrator = Arc::new(Calibrator::new(CalibratorParts {
            hub: hub.clone(),
            clock,
            cameras: [(NORTH, camera("north")), (SOUTH, camera("south"))].into(),
            landmarks: Vec::new(),
            path: None,
            file: CalibrationFile::default(),
        }));
        let mut watching = Watching::new(WatchingParts { landmarks: Vec::new(), calibrator });
        watching.set(NORTH, placement(0.0), true);
        watching.set(SOUTH, placement(1.0), false);
        watching
    }

    #[test]
    fn a_bumped_camera_is_left_out_and_everybody_hears_of_it() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let watching = watching(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        fusion.set_camera(NORTH, Some(placement(0.0)));
        let bumped = WatchEvent::Bumped { camera: NORTH, moved_m: 0.0213, turned_rad: 0.02 };
        let (happening, message) = watching.effect(&bumped, &mut fusion, &hub);
        assert_eq!(happening, Happening::Bumped(NORTH));
        assert!(
            message.starts_with("Camera north was bumped, by about 21 mm and 1.1°"),
            "{message}"
        );
        assert!(fusion.camera_place(NORTH, clock.now()).is_err(), "it is not used");
        let place = hub.camera(NORTH).unwrap().place;
        assert_eq!((place.status, place.placement), (PoseStatus::Quarantined, None));
        assert!(place.reason.contains("bumped"), "{}", place.reason);
    }

    #[test]
    fn who_moved_is_not_guessed() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let watching = watching(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        fusion.set_camera(NORTH, Some(placement(0.0)));
        let cameras = vec![NORTH, SOUTH];
        let contradiction = WatchEvent::Contradiction { cameras: cameras.clone() };
        let (happening, message) = watching.effect(&contradiction, &mut fusion, &hub);
        assert_eq!(happening, Happening::Contradicted);
        assert!(message.starts_with("Cameras north and south contradict one another"), "{message}");
        assert!(fusion.camera_place(NORTH, clock.now()).is_ok(), "nobody is left out");
        let (happening, message) =
            watching.effect(&WatchEvent::Agreed { cameras }, &mut fusion, &hub);
        assert_eq!(
            (happening, message.as_str()),
            (Happening::Agreed, "Cameras north and south agree again.")
        );
    }

    #[test]
    fn rough_places_ask_for_a_calibration() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let watching = watching(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        fusion.set_camera(NORTH, Some(placement(0.0)));
        let misplaced = WatchEvent::Misplaced { cameras: vec![NORTH, SOUTH] };
        let (happening, message) = watching.effect(&misplaced, &mut fusion, &hub);
        assert_eq!(happening, Happening::Misplaced);
        assert!(message.starts_with("Cameras north and south have not agreed"), "{message}");
        assert!(message.contains("`roundel calibrate arena`"), "{message}");
        assert!(fusion.camera_place(NORTH, clock.now()).is_ok(), "nobody is left out");
    }

    #[test]
    fn health_is_shown() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let mut watching = watching(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        let is_shown = |hub: &Hub| hub.cameras().values().all(|state| state.health.is_some());
        let begun = Instant::now();
        while !is_shown(&hub) && begun.elapsed() < Duration::from_secs(30) {
            watching.advance(clock.now(), &mut fusion, &hub);
            sleep(Duration::from_millis(5));
        }
        assert!(is_shown(&hub), "{:?}", hub.cameras());
    }

    #[test]
    fn what_was_found_of_another_place_is_left_out() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let mut watching = watching(&hub, clock);
        let mut fusion = Fusion::new(FusionParams::default());
        let bumped = |camera| Findings {
            events: vec![WatchEvent::Bumped { camera, moved_m: 0.02, turned_rad: 0.02 }],
            cameras: vec![(camera, true, None)],
        };
        let status = |camera| hub.camera(camera).unwrap().place.status;
        // The watch hears where both stand.
        watching.advance(clock.now(), &mut fusion, &hub);
        watching.place(NORTH, placement(0.5));
        watching.place(SOUTH, placement(1.0));
        for camera in [NORTH, SOUTH] {
            watching.heed(bumped(camera), clock.now(), (&mut fusion, &hub));
        }
        assert_ne!(status(NORTH), PoseStatus::Quarantined, "it was placed elsewhere");
        assert_eq!(status(SOUTH), PoseStatus::Quarantined, "it was said once more where it stands");
        assert!(!watching.posts[&NORTH].is_spared && watching.posts[&SOUTH].is_spared);
        watching.remove(SOUTH);
        watching.heed(bumped(SOUTH), clock.now(), (&mut fusion, &hub));
        assert!(!watching.posts.contains_key(&SOUTH));
    }
}
