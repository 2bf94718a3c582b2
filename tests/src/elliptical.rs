//! Renders roundels with elliptical discs and scores their detection.
//!
//! Three kinds with elliptical discs and a plain kind, whose area is close to the first one's, are rendered one per
//! frame, anywhere in the view of a camera with a mild `plumb_bob` lens, at any heading. The detector knows all four.
//! The prints' diameters are defined here alone. Errors of depth and heading are compared with the Cramér-Rao bound
//! ([`crate::bound`]) of the same print, pose and blur.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use roundel_core::{
    frame::Frame,
    marker::{Detector, Kind, Mode, Params, Pattern, Polarity, Scratch},
    pose::{Locator, RoundelPose},
};

use crate::{
    bound::{Scene, Unknowns, bound},
    optics::{Distortion, Pinhole},
    pipeline::core_camera,
    random::Random,
    render::{Canvas, Imaging, MovingPrint, Print, Renderer},
    score::{CHI2_95_3, normalized3},
};

const OUTER_M: f64 = 0.16;
/// Longer and shorter diameters of the discs; the last one is plain.
const DISCS_M: [(f64, f64); 4] = [(0.096, 0.064), (0.112, 0.072), (0.112, 0.056), (0.08, 0.08)];

/// The kinds that the detector knows.
pub fn kinds(polarity: Polarity) -> Vec<Kind> {
    DISCS_M
        .iter()
        .map(|&(along_m, across_m)| {
            let name = format!("{}x{}", along_m * 1e3, across_m * 1e3);
            let pattern = if along_m > across_m {
                Pattern::Elliptical { minor_diameter_m: across_m }
            } else {
                Pattern::Plain
            };
            Kind { pattern, polarity, ..Kind::plain(name, OUTER_M, along_m) }
        })
        .collect()
}

/// Roundels with blur 0.5 to 1.1 px and noise 1 to 4 grey levels, both unknown to the detector, and contrast 160.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Minimum and maximum outer diameter as seen face-on.
    pub diameters_px: (f64, f64),
    /// Minimum and maximum tilt.
    pub tilts_deg: (f64, f64),
    pub polarity: Polarity,
}

/// Errors of one mode.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// Depth errors over their bounds.
    depths: Vec<f64>,
    /// Heading errors of elliptical discs, radians, over their stated deviations and over their bounds.
    headings: Vec<[f64; 3]>,
    /// Squared Mahalanobis lengths: positions of plain roundels, positions of the others, and their rotations if the
    /// first normal is the right one.
    plain: Vec<f64>,
    positions: Vec<f64>,
    rotations: Vec<f64>,
    /// Angles of the normal, radians.
    normals: Vec<f64>,
    /// Elliptical discs whose second normal was the right one.
    pub wrong_normals: usize,
    /// Roundels that this mode located.
    pub own: usize,
}

impl Errors {
    /// Rms of the depth error over its bound. For white rings the bound counts the sheet's edge too, and is half of
    /// the right value.
    pub fn depth_over_bound(&self) -> f64 {
        rms(self.depths.iter().copied())
    }

    /// Rms error of the heading.
    pub fn heading_deg(&self) -> f64 {
        rms(self.headings.iter().map(|heading| heading[0])).to_degrees()
    }

    /// Rms of the heading error over its stated deviation.
    pub fn heading_over_stated(&self) -> f64 {
        rms(self.headings.iter().map(|heading| heading[1]))
    }

    /// Rms of the heading error over its bound.
    pub fn heading_over_bound(&self) -> f64 {
        rms(self.headings.iter().map(|heading| heading[2]))
    }

    pub fn heading_max_deg(&self) -> f64 {
        self.headings.iter().map(|heading| heading[0].abs()).fold(0.0, f64::max).to_degrees()
    }

    /// Shares of positions and of rotations of elliptical discs inside their stated 95 % ellipsoids.
    pub fn shares(&self) -> (f64, f64) {
        (share(&self.positions), share(&self.rotations))
    }

    /// Share of positions of plain roundels inside their stated 95 % ellipsoids.
    pub fn plain_share(&self) -> f64 {
        share(&self.plain)
    }

    /// Median angle between the first and the true normal.
    pub fn normal_median_deg(&self) -> f64 {
        let mut sorted = self.normals.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN).to_degrees()
    }
}

fn share(squares: &[f64]) -> f64 {
    let inside = squares.iter().filter(|square| **square <= CHI2_95_3).count();
    inside as f64 / squares.len() as f64
}

fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

#[derive(Clone, Debug, Default)]
pub struct Score {
    pub shown: usize,
    /// Found as any kind.
    pub found: usize,
    /// Rings where no roundel is.
    pub false_rings: usize,
    /// Plain roundels detected as elliptical ones, and vice versa.
    pub plain_confused: usize,
    /// Elliptical roundels detected as another elliptical kind.
    pub confused: usize,
    /// Fast and precise mode, for roundels of the right kind.
    pub modes: [Errors; 2],
    /// Reasons of those that were not found.
    pub missed: Vec<String>,
}

/// One rendered roundel.
struct Trial {
    camera: Pinhole,
    imaging: Imaging,
    pose: Isometry3<f64>,
    kind: usize,
    print: Print,
}

impl Trial {
    fn new(case: &Case, index: usize) -> (Self, Random) {
        let mut random = Random::new(index as u64, 4711);
        let diameter_px = random.uniform(case.diameters_px.0, case.diameters_px.1);
        let side = (diameter_px * 1.8) as usize + 24;
        let lens = Distortion::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]);
        let mut camera = Pinhole::centered(side, side, 1100.0, lens);
        let z = camera.focal_px[0] * OUTER_M / diameter_px;
        let at = [random.uniform(-0.7, 0.7), random.uniform(-0.4, 0.4)];
        let position = Vector3::new(at[0] * z, at[1] * z, z);
        let pixel = camera.project(&position.into()).expect("a place in the image");
        let middle = 0.5 * (side as f64 - 1.0);
        for axis in 0..2 {
            camera.center_px[axis] += middle - pixel[axis] + random.uniform(-1.0, 1.0);
        }
        let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-position)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
        let tilt = random.uniform(case.tilts_deg.0, case.tilts_deg.1).to_radians();
        let about = random.uniform(0.0, TAU);
        let lean = Vector3::new(about.cos(), about.sin(), 0.0) * tilt;
        let heading = Vector3::new(0.0, 0.0, random.uniform(0.0, TAU));
        let rotation = facing
            * UnitQuaternion::from_scaled_axis(lean)
            * UnitQuaternion::from_scaled_axis(heading);
        let pose = Isometry3::from_parts(Translation3::from(position), rotation);
        let imaging = Imaging {
            blur_px: random.uniform(0.5, 1.1),
            noise: random.uniform(1.0, 4.0),
            ..Imaging::default()
        };
        let kind = (random.next_u64() % DISCS_M.len() as u64) as usize;
        let print = Print::elliptical(OUTER_M, DISCS_M[kind], 0.25);
        let print = match case.polarity {
            Polarity::BlackRing => print,
            Polarity::WhiteRing => print.inverted(),
        };
        (Self { camera, imaging, pose, kind, print }, random)
    }

    fn is_plain(&self, kind: usize) -> bool {
        DISCS_M[kind].0 == DISCS_M[kind].1
    }

    fn pixels(&self, random: &mut Random) -> Vec<u8> {
        let motion = |_: f64| self.pose;
        let moving = [MovingPrint { print: &self.print, motion: &motion }];
        let background = Canvas::flat(self.camera.width, self.camera.height, 120.0);
        Renderer::new(self.camera, self.imaging).frame(&background, &moving, random).pixels
    }
}

struct Outcome {
    trial: Trial,
    rings: usize,
    kind: Option<usize>,
    poses: [Option<(RoundelPose, bool)>; 2],
    why: String,
}

/// Renders `count` roundels and scores their detection.
pub fn run(case: &Case, count: usize) -> Score {
    let kinds = kinds(case.polarity);
    let detector = Detector::new(kinds.clone(), Params::default()).unwrap();
    let outcomes: Vec<Outcome> = (0..count)
        .into_par_iter()
        .map_init(Scratch::default, |scratch, index| {
            let (trial, mut random) = Trial::new(case, index);
            let pixels = trial.pixels(&mut random);
            let (width, height) = (trial.camera.width, trial.camera.height);
            let frame = Frame::new(&pixels, width, height, width).unwrap();
            let rings = detector.detect(&frame, scratch);
            let ring = rings.first().copied();
            let camera = core_camera(&trial.camera).unwrap();
            let poses = [Mode::Fast, Mode::Precise].map(|mode| {
                let ring = ring?;
                let kind = &kinds[usize::from(ring.kind?.0)];
                let mut locator = Locator::new(camera.clone(), kinds.clone(), mode);
                let located = locator.locate_single(&frame, kind, &ring).ok()?;
                Some((located.pose, located.by == mode))
            });
            let kind = ring.and_then(|ring| ring.kind).map(|kind| usize::from(kind.0));
            let rings = rings.len();
            let why = format!("{index}: {:?} {:?}", scratch.rejects(), trial.imaging);
            Outcome { trial, rings, kind, poses, why }
        })
        .collect();
    let mut score = Score { shown: count, ..Score::default() };
    for outcome in &outcomes {
        score.add(outcome);
    }
    score
}

impl Score {
    fn add(&mut self, outcome: &Outcome) {
        let trial = &outcome.trial;
        self.false_rings += outcome.rings.saturating_sub(1);
        let Some(kind) = outcome.kind else {
            self.missed.push(outcome.why.clone());
            return;
        };
        self.found += 1;
        if trial.is_plain(kind) != trial.is_plain(trial.kind) {
            self.plain_confused += 1;
        } else if kind != trial.kind {
            self.confused += 1;
        } else {
            let scene = Scene {
                motion_px: [0.0; 2],
                camera: trial.camera,
                imaging: trial.imaging,
                print: &trial.print,
                pose: trial.pose,
            };
            let unknowns = Unknowns { yaw: !trial.is_plain(kind), ..Unknowns::default() };
            let Some(bound) = bound(&scene, unknowns) else { return };
            for (errors, pose) in self.modes.iter_mut().zip(&outcome.poses) {
                if let Some((pose, own)) = pose {
                    errors.own += usize::from(*own);
                    errors.add(pose, &trial.pose, (bound.range_share, bound.yaw_rad));
                }
            }
        }
    }
}

impl Errors {
    fn add(&mut self, pose: &RoundelPose, truth: &Isometry3<f64>, bounds: (f64, Option<f64>)) {
        let block = |corner: usize| -> Matrix3<f64> {
            pose.covariance.fixed_view::<3, 3>(corner, corner).into()
        };
        let shift = pose.position_m - truth.translation.vector;
        let depth = shift.dot(&truth.translation.vector) / truth.translation.vector.norm_squared();
        self.depths.push(depth / bounds.0);
        let square = normalized3(&shift, &block(0)).unwrap_or(f64::NAN);
        let (Some(yaw_rad), Some(bound)) = (pose.yaw_rad, bounds.1) else {
            self.plain.push(square);
            return;
        };
        self.positions.push(square);
        let normal = truth.rotation * Vector3::z();
        let angle = |one: &Vector3<f64>| one.cross(&normal).norm().atan2(one.dot(&normal));
        self.normals.push(angle(&pose.normal));
        if angle(&pose.normal) > angle(&pose.other_normal) + 1e-6 {
            self.wrong_normals += 1;
            return;
        }
        let upright = UnitQuaternion::rotation_between(&Vector3::z(), &pose.normal).unwrap();
        let turned = upright * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        // The nearer of both directions.
        let half = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
        let error = |found: UnitQuaternion<f64>| (truth.rotation * found.inverse()).scaled_axis();
        let (one, other) = (error(turned), error(turned * half));
        let error = if one.norm() < other.norm() { one } else { other };
        self.rotations.push(normalized3(&error, &block(3)).unwrap_or(f64::NAN));
        let about = error.dot(&pose.normal);
        let stated = pose.normal.dot(&(block(3) * pose.normal)).sqrt();
        self.headings.push([about, about / stated, about / bound]);
    }
}
