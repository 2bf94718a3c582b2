//! R4 under lab realism: rendered frames through detection, pose estimation and fusion in virtual time. Scores what
//! detections leave, as if the size of the prints were known, and what fusion makes of them.

use std::fmt;

use nalgebra::{Isometry3, Matrix2x3, Vector2, Vector3};
use rayon::prelude::*;
use roundel_core::{
    id::KindId,
    marker::{Mode, Params},
    pose::{self, Detection},
    time::Timestamp,
    world::{FrameObservations, FusionParams, PrintSize},
};

use crate::{
    arena::{Arena, Kind, Site, realism::LabCondition},
    clutter::Clutter,
    export::Studio,
    optics::Pinhole,
    pipeline::{Observer, core_kinds, fusion, observations},
    random::Random,
    scenario::run::{Run, Ticks},
    score::{CHI2_95_1, CHI2_95_2, Errors, Score, normal_error},
};

/// Share of frames at which a burst of lost frames begins, and its length.
const BURSTS: (f64, usize) = (0.0167, 3);
/// A server's defaults.
const TOLERANCE: f64 = 0.03;
const FOCAL_DEVIATION: f64 = 5e-4;
/// Grey level of the floor.
const FLOOR: f64 = 120.0;
/// Largest distance of a detection from its robot.
const GATE_PX: f64 = 8.0;

/// What a run simulates.
#[derive(Clone, Debug, PartialEq)]
pub struct Lab {
    pub seconds: f64,
    pub rate_hz: f64,
    /// Size of the prints over the configured one.
    pub scale: f64,
    /// Whether fusion knows the size of the prints.
    pub knows_scale: bool,
    pub is_plain: bool,
    pub mode: Mode,
    /// Relative error of the focal lengths in lens files, of alternating sign.
    pub lens_error: f64,
    /// Conditions that are left out.
    pub without: Vec<LabCondition>,
    pub seed: u64,
}

/// What became of a run.
pub struct LabOutcome {
    pub detections: DetectionScore,
    /// Estimated by fusion, unless it knows the size.
    pub print_size: PrintSize,
    pub tracks: Score,
}

impl Lab {
    pub fn run(&self) -> anyhow::Result<LabOutcome> {
        let arena = self.arena();
        let cameras: Vec<Vec<FrameObservations>> = (0..arena.sites.len())
            .into_par_iter()
            .map(|camera| self.watch(&arena, camera))
            .collect::<anyhow::Result<_>>()?;
        let scale = if self.knows_scale { 1.0 } else { self.scale };
        let detections = DetectionScore::new(&arena, &cameras, scale);
        let mut frames: Vec<_> = cameras.into_iter().flatten().collect();
        frames.sort_by_key(|frame| frame.received_time);
        let ticks = Ticks { rate_hz: self.rate_hz, judged_from_s: 1.0 };
        let params = FusionParams { focal_deviation: FOCAL_DEVIATION, ..FusionParams::default() };
        let flatness_m = pose::flatness_m(&core_kinds(&arena.kinds)[0]);
        let mut fusion = fusion(&arena, params);
        if !self.knows_scale {
            fusion.set_print_tolerance(KindId(0), TOLERANCE, flatness_m);
        }
        let run = Run::with(&arena, ticks, fusion).take_all(frames);
        let print_size = run.fusion().print_size(KindId(0));
        Ok(LabOutcome { detections, print_size, tracks: run.finish().score })
    }

    fn arena(&self) -> Arena {
        let mut arena = Arena::r4(self.seed);
        if self.is_plain {
            let paths = arena.robots.into_iter().map(|robot| robot.path).collect();
            arena = Arena::under_r4(self.seed, Kind::robot(), paths);
        }
        if self.knows_scale {
            arena.kinds[0].outer_diameter_m *= self.scale;
            arena.kinds[0].inner_diameter_m *= self.scale;
        }
        let scale = if self.knows_scale { 1.0 } else { self.scale };
        arena.make_real(scale, &self.without);
        arena.sites.iter_mut().for_each(|site| site.rate_hz = self.rate_hz);
        arena
    }

    /// The frames of a camera whose lens file is off.
    fn watch(&self, arena: &Arena, camera: usize) -> anyhow::Result<Vec<FrameObservations>> {
        let site = &arena.sites[camera];
        let studio = Studio::new(arena, camera, FLOOR, &Clutter::LAB);
        let sign = if camera.is_multiple_of(2) { 1.0 } else { -1.0 };
        let focal_px = site.optics.focal_px.map(|px| px * (1.0 + sign * self.lens_error));
        let optics = Pinhole { focal_px, ..site.optics };
        let params = Params { mode: self.mode, ..Params::default() };
        let line_time_s = site.imaging.line_time_s;
        let mut observer = Observer::with_params(&optics, &arena.kinds, line_time_s, params)?;
        let mut random = Random::new(self.seed, 1000 + camera as u64);
        let mut lost = 0;
        let mut seen = Vec::new();
        for frame in 0..(self.seconds * self.rate_hz) as usize {
            if lost == 0 && random.uniform(0.0, 1.0) < BURSTS.0 {
                lost = BURSTS.1;
            }
            if lost > 0 {
                lost -= 1;
                continue;
            }
            let capture_ns = arena.capture_time_ns(site, frame);
            let found = observer.observe(&studio.frame(frame), capture_ns)?;
            let mut observations = observations(camera, frame, capture_ns, found);
            observations.received_time =
                observations.capture_time.plus_seconds(random.uniform(0.015, 0.025));
            seen.push(observations);
        }
        Ok(seen)
    }
}

/// Poses compared with the truth in the camera frame, as if the size of the prints were known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DetectionScore {
    /// Robots in view, and those of them that were detected.
    pub visible: usize,
    pub found: usize,
    /// Detections without a robot, and those without a pose.
    pub strays: usize,
    pub unlocated: usize,
    /// Along and across the line of sight, metres.
    pub depth: Errors,
    pub across: Errors,
    pub normal: Errors,
    /// Sum of the depth errors.
    depth_sum_m: f64,
}

impl DetectionScore {
    fn new(arena: &Arena, cameras: &[Vec<FrameObservations>], scale: f64) -> Self {
        let mut score = Self::default();
        for frame in cameras.iter().flatten() {
            let site = &arena.sites[frame.camera.0 as usize];
            let camera_from_world = site.world_from_camera.inverse();
            let poses = |time: Timestamp| -> Vec<_> {
                let truth = arena.truth(time.as_ns());
                truth.iter().map(|robot| camera_from_world * robot.pose).collect()
            };
            let mut is_found = vec![false; arena.robots.len()];
            for detection in &frame.detections {
                let poses = poses(detection.capture_time);
                score.take(detection, site, &poses, scale, &mut is_found);
            }
            for (pose, is_found) in std::iter::zip(poses(frame.capture_time), is_found) {
                let is_visible = is_in_view(site, &pose);
                score.visible += usize::from(is_visible);
                score.found += usize::from(is_visible && is_found);
            }
        }
        score
    }

    fn take(
        &mut self,
        detection: &Detection,
        site: &Site,
        poses: &[Isometry3<f64>],
        scale: f64,
        is_found: &mut [bool],
    ) {
        let center = detection.ring.outer.center;
        let distance_px = |pose: &Isometry3<f64>| {
            let projected = site.optics.project(&pose.translation.vector.into());
            projected.map_or(f64::INFINITY, |p| (p - Vector2::new(center.u, center.v)).norm())
        };
        let nearest = (0..poses.len())
            .map(|robot| (robot, distance_px(&poses[robot])))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((robot, _)) = nearest.filter(|(_, px)| *px < GATE_PX) else {
            self.strays += 1;
            return;
        };
        is_found[robot] = true;
        let Some(pose) = &detection.pose else {
            self.unlocated += 1;
            return;
        };
        let true_position_m = poses[robot].translation.vector / scale;
        let covariance = pose.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let sight = true_position_m.normalize();
        let error = pose.position_m - true_position_m;
        let depth_m = error.dot(&sight);
        self.depth.push(depth_m.abs(), depth_m * depth_m / sight.dot(&(covariance * sight)));
        self.depth_sum_m += depth_m;
        let right = sight.cross(&Vector3::y()).normalize();
        let axes = Matrix2x3::from_rows(&[right.transpose(), sight.cross(&right).transpose()]);
        let (across, covariance) = (axes * error, axes * covariance * axes.transpose());
        if let Some(inverse) = covariance.try_inverse() {
            self.across.push(across.norm(), across.dot(&(inverse * across)));
        }
        let rotation = pose.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        let true_normal = poses[robot].rotation * Vector3::z();
        if let Some((length, normalized)) = normal_error(&pose.normal, &true_normal, &rotation) {
            self.normal.push(length, normalized);
        }
    }
}

/// The whole roundel is in the picture, seen from its front.
fn is_in_view(site: &Site, pose: &Isometry3<f64>) -> bool {
    let normal = pose.rotation * Vector3::z();
    let position = pose.translation.vector;
    let Some(px) = site.optics.project(&position.into()) else {
        return false;
    };
    let border_px = 0.6 * 0.16 * site.optics.focal_px[0] / position.z;
    let (width, height) = (site.optics.width as f64, site.optics.height as f64);
    normal.dot(&position) < 0.0
        && px.x > border_px
        && px.y > border_px
        && px.x < width - border_px
        && px.y < height - border_px
}

impl fmt::Display for DetectionScore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { visible, found, strays, unlocated, .. } = self;
        writeln!(
            f,
            "{:.2} % of {visible} found, {strays} strays, {unlocated} without pose",
            100.0 * *found as f64 / *visible as f64,
        )?;
        writeln!(f, "mean depth error {:.5} m", self.depth_sum_m / self.depth.count() as f64)?;
        let rows = [
            ("depth", &self.depth, CHI2_95_1, "m"),
            ("across", &self.across, CHI2_95_2, "m"),
            ("normal", &self.normal, CHI2_95_2, "rad"),
        ];
        for (name, errors, bound, unit) in rows {
            writeln!(
                f,
                "{name:8} {:7} {:9.5} {unit:3} max {:8.5} {:6.1} % inside 95 %",
                errors.count(),
                errors.rms(),
                errors.max(),
                100.0 * errors.share_within(bound),
            )?;
        }
        Ok(())
    }
}
