//! Errors of tracks while a bumped camera's observations are still used.
//!
//! Fusion and watch run as in a server. Only observed objects (life stage tracked) with a stated deviation below
//! [`CERTAIN_M`] are compared with the truth. Objects that few cameras see have larger errors without any bump, and
//! larger stated deviations.

use roundel_core::{
    calib::watch::{Watch, WatchEvent, WatchParams},
    id::CameraId,
    rigid::Covariance6,
    time::Timestamp,
    world::{
        CameraPlacement, Fusion, FusionCounts, FusionParams, HeldStep, LifeStage, ObjectState,
        Snapshot,
    },
};

use super::Healing;

/// Largest stated deviation of compared objects: root of the covariance's trace.
pub const CERTAIN_M: f64 = 1.5e-3;
/// Duration of a bump's effect: until it is detected, and until tracks that only that camera observed are dropped.
const AFTERMATH_S: f64 = 3.0;
/// Time until tracks have settled.
const SETTLED_S: f64 = 3.0;
/// Interval of snapshots.
const TICK_S: f64 = 1.0 / 60.0;

/// Errors of tracks in a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tracks {
    /// Largest error within [`AFTERMATH_S`] of a bump.
    pub aftermath_m: f64,
    /// Largest error at other times.
    pub otherwise_m: f64,
    /// Cameras that returned.
    pub returned: usize,
    /// Mean number of tracked objects.
    pub tracked: f64,
    pub counts: FusionCounts,
}

impl Healing {
    /// Runs fusion on the observations for `seconds`, and applies the watch's events.
    pub fn track(&self, params: FusionParams, seconds: f64) -> Tracks {
        let start = Timestamp::from_ns(self.arena.start_ns);
        let (mut fusion, mut watch) = (Fusion::new(params), Watch::new(WatchParams::default()));
        for (index, (&world_from_camera, _)) in
            self.initial_poses.iter().zip(&self.arena.sites).enumerate()
        {
            let id = CameraId(index as u32);
            let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
            fusion.set_camera(id, Some(placement));
            watch.set_camera(id, placement);
            if self.is_rough {
                watch.distrust(id);
            }
        }
        let (mut next_s, mut tracks) = (SETTLED_S, Tracks::default());
        let (mut tracked, mut ticks) = (0, 0);
        for frame in self.frames(seconds) {
            watch.observe(&frame, 0.0);
            fusion.observe(&frame);
            let now = frame.received_time;
            for held in fusion.drain_held_back() {
                watch.hold(held.camera, held.step == HeldStep::Started);
            }
            for camera in (0..self.initial_poses.len()).map(|index| CameraId(index as u32)) {
                fusion.set_hold_back_exempt(camera, !watch.is_trusted(camera));
            }
            for event in watch.advance(now) {
                match event {
                    WatchEvent::Bumped { camera, .. } => fusion.quarantine(camera),
                    WatchEvent::Returned { camera, placement } => {
                        tracks.returned += 1;
                        fusion.set_camera(camera, Some(placement));
                    }
                    WatchEvent::Drifted { camera, placement, .. } => {
                        fusion.set_camera(camera, Some(placement));
                    }
                    WatchEvent::Contradiction { .. }
                    | WatchEvent::Misplaced { .. }
                    | WatchEvent::Agreed { .. } => {}
                }
            }
            let t = now.seconds_since(start);
            if t >= next_s {
                next_s += TICK_S;
                let bumps = self.moves.iter();
                let is_meanwhile =
                    bumps.clone().any(|it| (it.at_s..it.at_s + AFTERMATH_S).contains(&t));
                let worst_m =
                    if is_meanwhile { &mut tracks.aftermath_m } else { &mut tracks.otherwise_m };
                let snapshot = fusion.snapshot(now);
                *worst_m = worst_m.max(self.worst_m(&snapshot));
                tracked += snapshot.objects.iter().filter(|it| is_tracked(it)).count();
                ticks += 1;
            }
        }
        tracks.tracked = f64::from(tracked as u32) / f64::from(ticks.max(1));
        tracks.counts = fusion.counts();
        tracks
    }

    fn worst_m(&self, snapshot: &Snapshot) -> f64 {
        let truth = self.arena.truth(snapshot.pose_time.as_ns());
        let is_sure = |it: &&ObjectState| {
            let variance = it.covariance.fixed_view::<3, 3>(0, 0).trace();
            is_tracked(it) && variance < CERTAIN_M * CERTAIN_M
        };
        let off_m = |object: &ObjectState| {
            let number = object.code?.number;
            let robot = truth.iter().find(|robot| robot.code == Some(number))?;
            Some((robot.pose.translation.vector - object.position_m).norm())
        };
        snapshot.objects.iter().filter(is_sure).filter_map(off_m).fold(0.0, f64::max)
    }
}

fn is_tracked(object: &ObjectState) -> bool {
    object.stage == LifeStage::Tracked
}
