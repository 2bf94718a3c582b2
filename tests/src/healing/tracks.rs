//! What tracks suffer while a bumped camera's sightings still count.
//!
//! Fusion and watch run as in a server. Compared with the truth are objects that are seen (life stage tracked)
//! and said to be known to [`SURE_M`]: of what hardly anybody sees, or one camera from afar, the error is larger without
//! any bump, and told.

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

/// Objects that are known to this count, metres: a root of the covariance's trace.
pub const SURE_M: f64 = 1.5e-3;
/// How long a bump may be felt, seconds: until it is noticed, and until what only that camera saw is forgotten.
const MEANWHILE_S: f64 = 3.0;
/// Before this tracks are new, seconds.
const SETTLED_S: f64 = 3.0;
/// Snapshots are taken so often, seconds.
const TICK_S: f64 = 1.0 / 60.0;

/// Errors of tracks of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tracks {
    /// Largest within [`MEANWHILE_S`] of a bump, metres …
    pub meanwhile_m: f64,
    /// … and else.
    pub else_m: f64,
    /// Cameras that came back.
    pub returned: usize,
    /// Objects that are followed, mean.
    pub followed: f64,
    /// What became of all observations.
    pub counts: FusionCounts,
}

impl Healing {
    /// Lets fusion follow the robots for so many seconds, with the watch's events put into effect.
    pub fn follow(&self, params: FusionParams, seconds: f64) -> Tracks {
        let start = Timestamp::from_ns(self.arena.start_ns);
        let (mut fusion, mut watch) = (Fusion::new(params), Watch::new(WatchParams::default()));
        for (index, (&world_from_camera, _)) in
            self.believed.iter().zip(&self.arena.sites).enumerate()
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
        let (mut followed, mut ticks) = (0, 0);
        for frame in self.frames(seconds) {
            watch.observe(&frame, 0.0);
            fusion.observe(&frame);
            let now = frame.received_time;
            for held in fusion.drain_held_back() {
                watch.hold(held.camera, held.step == HeldStep::Started);
            }
            for camera in (0..self.believed.len()).map(|index| CameraId(index as u32)) {
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
                    bumps.clone().any(|it| (it.at_s..it.at_s + MEANWHILE_S).contains(&t));
                let worst_m =
                    if is_meanwhile { &mut tracks.meanwhile_m } else { &mut tracks.else_m };
                let snapshot = fusion.snapshot(now);
                *worst_m = worst_m.max(self.worst_m(&snapshot));
                followed += snapshot.objects.iter().filter(|it| is_followed(it)).count();
                ticks += 1;
            }
        }
        tracks.followed = f64::from(followed as u32) / f64::from(ticks.max(1));
        tracks.counts = fusion.counts();
        tracks
    }

    fn worst_m(&self, snapshot: &Snapshot) -> f64 {
        let truth = self.arena.truth(snapshot.pose_time.as_ns());
        let is_sure = |it: &&ObjectState| {
            let variance = it.covariance.fixed_view::<3, 3>(0, 0).trace();
            is_followed(it) && variance < SURE_M * SURE_M
        };
        let off_m = |object: &ObjectState| {
            let number = object.code?.number;
            let robot = truth.iter().find(|robot| robot.code == Some(number))?;
            Some((robot.pose.translation.vector - object.position_m).norm())
        };
        snapshot.objects.iter().filter(is_sure).filter_map(off_m).fold(0.0, f64::max)
    }
}

fn is_followed(object: &ObjectState) -> bool {
    object.stage == LifeStage::Tracked
}
