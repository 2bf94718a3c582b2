//! Compares the predictions of [`roundel_core::plan`] with simulation: random set-ups, rendered, detected and
//! located.
//!
//! A [`SetUp`] is a camera, a print, a tilt, an imaging and a mode. Two predictions are compared: the largest
//! distance at which roundels are found near the optical axis ([`SetUp::reach`]), and the rms errors of roundels of
//! one size anywhere in the picture, along the line of sight and across it ([`SetUp::errors`]). The plan knows the
//! lens and the imaging, but not the pixels. [`times`] compares times.

pub mod times;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;
use roundel_core::{
    marker::{Kind, Mode, Params, Pattern, Polarity},
    plan::{
        Imaging as PlannedImaging, PlanError, Sensor, TrialCache,
        precision::predict,
        range::{DetectionRange, detection_range},
    },
};

use crate::{
    arena,
    optics::{Distortion, Pinhole},
    pipeline::{Observer, core_camera},
    precision::{FLOOR, window},
    random::Random,
    render::{Canvas, Imaging, MovingPrint, Print, Renderer},
};

/// Simulated distances, in steps relative to the predicted one.
const STEPS: std::ops::RangeInclusive<i32> = -10..=8;
const STEP: f64 = 0.02;
/// Share of roundels that must be found at a distance.
const RELIABLE: f64 = 0.9;
/// Frames in which a roundel is tracked before its error counts.
const FRAMES: usize = 3;
/// White margin, as a share of the outer diameter; wide enough not to affect the rims.
const MARGIN: f64 = 0.4;

#[derive(Clone, Debug)]
pub struct SetUp {
    pub camera: Pinhole,
    /// Exposure and shutter are ignored.
    pub imaging: Imaging,
    /// Outer diameter.
    pub outer_m: f64,
    /// Inner over outer diameter.
    pub ratio: f64,
    /// Against the image plane for the reach, against the line of sight for the errors.
    pub tilt_rad: f64,
    /// Outer diameter over depth times focal length, for the errors.
    pub diameter_px: f64,
    pub mode: Mode,
}

/// A predicted figure and the simulated one.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    pub planned: f64,
    pub simulated: f64,
}

impl Pair {
    pub fn ratio(&self) -> f64 {
        self.planned / self.simulated
    }

    /// Whether the relative error of the prediction is at most `share`.
    pub fn holds(&self, share: f64) -> bool {
        (self.ratio() - 1.0).abs() <= share
    }
}

/// Rms errors of one set-up.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Along the line of sight.
    pub depth_m: Pair,
    /// Each of the two across it.
    pub across_m: Pair,
    /// Roundels that were not found.
    pub missed: usize,
}

impl SetUp {
    /// The random set-up of this number.
    pub fn draw(number: u64) -> Self {
        let mut random = Random::new(number, 0x91a);
        let sizes = [(640, 480), (1280, 720), (1920, 1080)];
        let (width, height) = sizes[(random.next_u64() % 3) as usize];
        let focal_px = width as f64 * random.uniform(0.5, 1.1);
        let bend = random.uniform(-0.12, 0.02);
        let lens = Distortion::PlumbBob([bend, -0.2 * bend, 4e-4, -3e-4, 0.0]);
        let imaging = Imaging {
            noise: random.uniform(1.0, 4.0),
            blur_px: random.uniform(0.5, 1.1),
            black: random.uniform(20.0, 60.0),
            white: random.uniform(170.0, 230.0),
            exposure_s: 0.0,
            ..Imaging::default()
        };
        Self {
            camera: Pinhole::centered(width, height, focal_px, lens),
            imaging,
            outer_m: random.uniform(0.05, 0.3),
            ratio: random.uniform(0.35, 0.6),
            tilt_rad: random.uniform(0.0, 55.0).to_radians(),
            diameter_px: random.uniform(14f64.ln(), 90f64.ln()).exp(),
            mode: if number.is_multiple_of(2) { Mode::Precise } else { Mode::Fast },
        }
    }

    /// The print in core's type.
    pub fn kind(&self) -> Kind {
        Kind {
            pattern: Pattern::Plain,
            polarity: Polarity::BlackRing,
            ..Kind::plain("planned", self.outer_m, self.ratio * self.outer_m)
        }
    }

    /// Input of the plan.
    pub fn sensor(&self) -> Sensor {
        let Imaging { noise, blur_px, black, white, .. } = self.imaging;
        Sensor {
            camera: core_camera(&self.camera).expect("a camera as drawn"),
            lens_uncertainty: None,
            imaging: PlannedImaging { noise, blur_px, black, white },
            mode: self.mode,
            trials: TrialCache::default(),
        }
    }

    pub fn planned_reach(&self) -> Result<DetectionRange, PlanError> {
        detection_range(&self.sensor(), &self.kind(), self.tilt_rad)
    }

    /// The largest distance at which nine of ten of `count` roundels are found, metres.
    pub fn reach(&self, count: usize) -> Result<Pair, PlanError> {
        let planned = self.planned_reach()?.max_m;
        let mut simulated = f64::NAN;
        for step in STEPS {
            let distance_m = planned * (1.0 + STEP * f64::from(step));
            let found =
                (0..count as u64).filter(|&number| self.is_found(distance_m, number)).count();
            if (found as f64) < RELIABLE * count as f64 {
                break;
            }
            simulated = distance_m;
        }
        Ok(Pair { planned, simulated })
    }

    fn is_found(&self, distance_m: f64, number: u64) -> bool {
        let mut random = Random::new(number, 7);
        let place = [random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05)];
        let position = Vector3::new(place[0], place[1], 1.0) * distance_m;
        let pose = self.tilted(position, Vector3::z(), &mut random);
        self.observe(&[pose], &mut random).is_some()
    }

    /// Rms errors of `count` roundels of its size anywhere in the picture.
    pub fn errors(&self, count: usize) -> Errors {
        let (sensor, kind) = (self.sensor(), self.kind());
        let (mut sums, mut missed, mut found) = ([[0.0; 2]; 2], 0, 0.0);
        for number in 0..count as u64 {
            let mut random = Random::new(number, 8);
            let poses = self.course(&mut random);
            let last = poses[poses.len() - 1];
            let truth = last.translation.vector;
            let Some(expected) = predict(&sensor, &kind, &last) else {
                missed += 1;
                continue;
            };
            let Some(position) = self.observe(&poses, &mut random) else {
                missed += 1;
                continue;
            };
            let error = position - truth;
            let along = error.dot(&truth.normalize());
            let across2 = 0.5 * (error.norm_squared() - along * along);
            sums[0][0] += expected.depth_m().powi(2);
            sums[0][1] += along * along;
            sums[1][0] += expected.across_m().powi(2);
            sums[1][1] += across2;
            found += 1.0;
        }
        let [depth_m, across_m] = sums.map(|[planned, simulated]: [f64; 2]| Pair {
            planned: (planned / found).sqrt(),
            simulated: (simulated / found).sqrt(),
        });
        Errors { depth_m, across_m, missed }
    }

    /// Poses of one roundel in consecutive frames.
    fn course(&self, random: &mut Random) -> Vec<Isometry3<f64>> {
        let depth_m = self.camera.focal_px[0] * self.outer_m / self.diameter_px;
        let edge_px = 0.6 * self.diameter_px + 8.0;
        let size = [self.camera.width as f64, self.camera.height as f64];
        let pixel = Vector2::new(
            random.uniform(edge_px, size[0] - edge_px),
            random.uniform(edge_px, size[1] - edge_px),
        );
        let ray = self.camera.ray(&pixel).expect("a pixel of the picture");
        let first = self.tilted(ray * (depth_m / ray.z), ray, random);
        let mut poses = vec![first];
        for _ in 1..FRAMES {
            let last = poses[poses.len() - 1];
            let per_px = depth_m / self.camera.focal_px[0];
            let shift = Vector3::from_fn(|_, _| random.uniform(-per_px, per_px));
            let turn = Vector3::from_fn(|_, _| random.uniform(-0.01, 0.01));
            poses.push(Isometry3::from_parts(
                Translation3::from(last.translation.vector + shift),
                UnitQuaternion::from_scaled_axis(turn) * last.rotation,
            ));
        }
        poses
    }

    /// Tilted against the plane across `axis`, in a random direction.
    fn tilted(
        &self,
        position: Vector3<f64>,
        axis: Vector3<f64>,
        random: &mut Random,
    ) -> Isometry3<f64> {
        let side = random.uniform(0.0, std::f64::consts::TAU);
        let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-axis).unwrap_or_else(|| {
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        });
        let lean = Vector3::new(side.cos(), side.sin(), 0.0) * self.tilt_rad;
        let rotation = facing * UnitQuaternion::from_scaled_axis(lean);
        Isometry3::from_parts(Translation3::from(position), rotation)
    }

    /// Position in the last frame, or `None` if the roundel is not found there.
    fn observe(&self, poses: &[Isometry3<f64>], random: &mut Random) -> Option<Vector3<f64>> {
        let camera = window(&self.camera, &poses[0]);
        let kind = arena::Kind {
            outer_diameter_m: self.outer_m,
            inner_diameter_m: self.ratio * self.outer_m,
            ..arena::Kind::robot()
        };
        let print = Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, MARGIN);
        let renderer = Renderer::new(camera, self.imaging);
        let floor = Canvas::flat(camera.width, camera.height, FLOOR);
        let params = Params { mode: self.mode, ..Params::default() };
        let mut observer = Observer::with_params(&camera, &[kind], 0.0, params)
            .expect("a camera and a kind as drawn");
        let mut position = None;
        for pose in poses {
            let motion = |_: f64| *pose;
            let image =
                renderer.frame(&floor, &[MovingPrint { print: &print, motion: &motion }], random);
            let found = observer.observe(&image, 0).expect("a frame of the camera's size");
            position = found.into_iter().find_map(|one| one.pose).map(|pose| pose.position_m);
        }
        position
    }
}

/// The first `count` set-ups with their reach and errors, from `reaches` and `shots` roundels each.
pub fn compare(
    count: u64,
    reaches: usize,
    shots: usize,
) -> Vec<(SetUp, Result<Pair, PlanError>, Errors)> {
    let one = |number| {
        let set_up = SetUp::draw(number);
        let (reach, errors) = (set_up.reach(reaches), set_up.errors(shots));
        (set_up, reach, errors)
    };
    (0..count).into_par_iter().map(one).collect()
}
