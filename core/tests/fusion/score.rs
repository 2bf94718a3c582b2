//! Runs a world through fusion and scores the snapshots against the truth.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};
use roundel_core::{
    id::{CameraId, ObjectId},
    rigid::mahalanobis_squared,
    world::{FrameObservations, Fusion, FusionParams, LifeStage, Snapshot},
};

use super::arena::{Arena, START};

/// χ² of 3 and 2 degrees of freedom at 95 %.
const CHI3: f64 = 7.815;
const CHI2: f64 = 5.991;

/// Rate of scored snapshots.
const SNAPSHOT_RATE_HZ: f64 = 60.0;

/// Largest distance of a state from its object.
const NEAR_M: f64 = 0.12;

/// Scores of all snapshots.
#[derive(Clone, Debug, Default)]
pub struct Score {
    /// Scored states of tracked objects.
    pub states: usize,
    position_inside: usize,
    velocity_inside: usize,
    normal_inside: usize,
    square_error_m2: f64,
    square_normal_rad2: f64,
    /// States far from the object that their id was first assigned to.
    pub swaps: usize,
    /// States far from every object.
    pub ghosts: usize,
    /// Ids of confirmed tracks.
    pub ids: BTreeSet<ObjectId>,
    owner: BTreeMap<ObjectId, usize>,
}

impl Score {
    pub fn add(&mut self, arena: &Arena, snapshot: &Snapshot) {
        for object in &snapshot.objects {
            if matches!(object.stage, LifeStage::Tentative | LifeStage::Lost) {
                continue;
            }
            let truth = |index: usize| arena.truth(index, snapshot.pose_time);
            let distance = |index: &usize| (truth(*index).position_m - object.position_m).norm();
            let nearest = (0..arena.setting.objects)
                .min_by(|a, b| distance(a).total_cmp(&distance(b)))
                .unwrap();
            self.ids.insert(object.id);
            // A predicted object may be anywhere within its covariance.
            if object.stage != LifeStage::Tracked {
                continue;
            }
            if distance(&nearest) > NEAR_M {
                self.ghosts += 1;
                continue;
            }
            let owner = *self.owner.entry(object.id).or_insert(nearest);
            if distance(&owner) > NEAR_M {
                self.swaps += 1;
                continue;
            }
            self.states += 1;
            let truth = truth(owner);
            let error_m = object.position_m - truth.position_m;
            let speed_error = object.velocity_m_s - truth.velocity_m_s;
            let block = |from: usize, of: &nalgebra::Matrix6<f64>| -> Matrix3<f64> {
                of.fixed_view::<3, 3>(from, from).into_owned()
            };
            let normal = object.orientation * Vector3::z();
            let cross = normal.cross(&truth.normal);
            let turn =
                cross * (cross.norm().atan2(normal.dot(&truth.normal)) / cross.norm().max(1e-15));
            let inside = |error: &Vector3<f64>, covariance: &Matrix3<f64>, limit: f64| {
                usize::from(mahalanobis_squared(error, covariance).unwrap() <= limit)
            };
            self.position_inside += inside(&error_m, &block(0, &object.covariance), CHI3);
            self.velocity_inside +=
                inside(&speed_error, &block(3, &object.motion_covariance), CHI3);
            self.normal_inside += inside(&turn, &block(3, &object.covariance), CHI2);
            self.square_error_m2 += error_m.norm_squared();
            self.square_normal_rad2 += turn.norm_squared();
        }
    }

    /// Shares of position, velocity and normal inside their 95 % ellipsoids.
    pub fn shares(&self) -> [f64; 3] {
        [self.position_inside, self.velocity_inside, self.normal_inside]
            .map(|inside| inside as f64 / self.states as f64)
    }

    pub fn rms_mm(&self) -> f64 {
        (self.square_error_m2 / self.states as f64).sqrt() * 1e3
    }

    pub fn summary(&self) -> String {
        format!(
            "{} states, inside 95 % (position, velocity, normal) {:.3?}, rms {:.2} mm and {:.2}°, \
             {} ids, {} swaps, {} ghosts",
            self.states,
            self.shares(),
            self.rms_mm(),
            (self.square_normal_rad2 / self.states as f64).sqrt().to_degrees(),
            self.ids.len(),
            self.swaps,
            self.ghosts
        )
    }
}

/// A machine with the arena's cameras.
pub fn fusion_of(arena: &Arena, params: FusionParams) -> Fusion {
    let mut fusion = Fusion::new(params);
    for (index, placement) in arena.placements.iter().enumerate() {
        fusion.set_camera(CameraId(index as u32), Some(*placement));
    }
    fusion
}

/// Processes the frames as they arrive, with scored snapshots from `from_s` on.
pub fn run(arena: &Arena, fusion: &mut Fusion, frames: &[FrameObservations], from_s: f64) -> Score {
    let mut score = Score::default();
    let mut next = START.plus_seconds(from_s);
    for frame in frames {
        while frame.received_time > next {
            score.add(arena, &fusion.snapshot(next));
            next = next.plus_seconds(1.0 / SNAPSHOT_RATE_HZ);
        }
        fusion.observe(frame);
    }
    score
}
