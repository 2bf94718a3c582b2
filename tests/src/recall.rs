//! Share of roundels that are found, and false detections, in seeded frames with dense clutter.
//!
//! A frame has roundels of one print, as many as fit without overlapping sheets. Their shorter imaged diameter,
//! [`Range::minor_px`], is log-uniform; tilt, place, ratio of diameters, margin, light, blur and noise vary. A
//! roundel is found if a ring matches it in position and size. Every other ring is a false detection, including a
//! second one on the same roundel and one of the wrong size.
//!
//! `cargo run -p roundel-tests -- recall` prints the table; `tests/recall.rs` requires bars on fewer frames.

use std::collections::VecDeque;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use roundel_core::{
    frame::Frame,
    marker::{Detector, Kind, Params, Reject, Ring, Scratch},
};

use crate::{
    clutter::{Clutter, background},
    optics::{Distortion, Pinhole},
    random::Random,
    render::{Image, Imaging, MovingPrint, Print, Renderer},
};

const OUTER_M: f64 = 0.16;
/// Minimum difference between black and white anywhere in a frame, grey levels.
const MIN_CONTRAST: f64 = 90.0;
/// Minimum distance between a ring and the frame's edge.
const EDGE_PX: f64 = 4.0;
/// Places that are tried for a roundel before it is deferred to the next frame.
const TRIES: usize = 60;

/// Contents of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Shorter imaged diameter of the outer rim.
    pub minor_px: [f64; 2],
    /// Maximum angle between normal and line of sight.
    pub max_tilt_rad: f64,
    /// Maximum number of roundels per frame.
    pub per_frame: usize,
    pub clutter: Clutter,
}

impl Default for Range {
    fn default() -> Self {
        Self {
            minor_px: [10.0, 200.0],
            max_tilt_rad: 60f64.to_radians(),
            per_frame: 40,
            clutter: Clutter::JUNK,
        }
    }
}

/// One roundel of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShownRoundel {
    /// camera_from_roundel.
    pub pose: Isometry3<f64>,
    /// Angle between normal and line of sight.
    pub tilt_rad: f64,
    /// Image of the outer rim.
    pub rim: ImagedRim,
    /// Circle about the image of its sheet: centre and radius.
    sheet_circle: (Vector2<f64>, f64),
}

/// Image of a rim, from the moments of the enclosed area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImagedRim {
    /// Pixels.
    pub center: Vector2<f64>,
    pub semi_major_px: f64,
    pub semi_minor_px: f64,
}

/// One frame and its contents.
pub struct Scene {
    /// Number of the frame.
    pub seed: u64,
    pub image: Image,
    pub imaging: Imaging,
    /// Inner over outer diameter of the print.
    pub ratio: f64,
    pub shown: Vec<ShownRoundel>,
}

/// A roundel that was not found.
#[derive(Clone, Debug)]
pub struct Miss {
    pub shown: ShownRoundel,
    /// Reasons for which candidates near it were rejected when its neighbourhood was searched alone, with counts.
    pub rejects: Vec<(Reject, u32)>,
}

/// Result of one frame.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Indices into [`Scene::shown`].
    pub found: Vec<usize>,
    pub missed: Vec<Miss>,
    /// Rings where no roundel is.
    pub false_detections: Vec<Ring>,
}

/// Generates frames until `count` roundels are placed. Roundels that do not fit wait for the next frame, so that
/// large ones are as frequent as small ones.
pub struct Scenes {
    range: Range,
    camera: Pinhole,
    waiting: VecDeque<[f64; 2]>,
    left: usize,
    seed: u64,
    random: Random,
}

impl Scenes {
    /// Frames of 1920 × 1080 with `count` roundels in total; the same for the same `seed`.
    pub fn new(range: Range, count: usize, seed: u64) -> Self {
        let distortion = Distortion::PlumbBob([-0.08, 0.02, 4e-4, -3e-4, 0.0]);
        let camera = Pinhole::centered(1920, 1080, 1100.0, distortion);
        let random = Random::new(seed, 0);
        Self { range, camera, waiting: VecDeque::new(), left: count, seed: seed << 32, random }
    }

    fn place(&mut self, print: &Print, random: &mut Random) -> Vec<ShownRoundel> {
        let mut shown: Vec<ShownRoundel> = Vec::new();
        let mut attempts = self.waiting.len().max(self.range.per_frame);
        while attempts > 0 && shown.len() < self.range.per_frame && self.left > 0 {
            attempts -= 1;
            let [low, high] = self.range.minor_px;
            let new_size = [
                low * (high / low).powf(self.random.uniform(0.0, 1.0)),
                // Uniform cosines, as for normals in all directions.
                self.random.uniform(self.range.max_tilt_rad.cos(), 1.0).acos(),
            ];
            let [minor_px, tilt_rad] = self.waiting.pop_front().unwrap_or(new_size);
            let fits = (0..TRIES).find_map(|_| {
                let new = show(&self.camera, print, minor_px, tilt_rad, random)?;
                let apart = |other: &ShownRoundel| {
                    (other.sheet_circle.0 - new.sheet_circle.0).norm()
                        > other.sheet_circle.1 + new.sheet_circle.1 + EDGE_PX
                };
                shown.iter().all(apart).then_some(new)
            });
            match fits {
                Some(new) => {
                    shown.push(new);
                    self.left -= 1;
                }
                None => self.waiting.push_back([minor_px, tilt_rad]),
            }
        }
        shown
    }
}

/// A frame before it is rendered.
pub struct Plan {
    camera: Pinhole,
    clutter: Clutter,
    seed: u64,
    imaging: Imaging,
    ratio: f64,
    print: Print,
    shown: Vec<ShownRoundel>,
}

impl Iterator for Scenes {
    type Item = Plan;

    fn next(&mut self) -> Option<Plan> {
        if self.left == 0 {
            return None;
        }
        self.seed += 1;
        let mut random = Random::new(self.seed, 1);
        let imaging = imaging(&mut random);
        let ratio = random.uniform(0.4, 0.6);
        let print = Print::plain(OUTER_M, OUTER_M * ratio, random.uniform(0.2, 0.35));
        let shown = self.place(&print, &mut random);
        let (camera, clutter, seed) = (self.camera, self.range.clutter, self.seed);
        Some(Plan { camera, clutter, seed, imaging, ratio, print, shown })
    }
}

impl Plan {
    /// A frame of clutter alone, with its own `seed`.
    pub fn empty(clutter: Clutter, seed: u64) -> Self {
        let mut random = Random::new(seed, 1);
        let imaging = imaging(&mut random);
        let camera = Pinhole::centered(1920, 1080, 1100.0, Distortion::NONE);
        let print = Print::plain(OUTER_M, OUTER_M / 2.0, 0.25);
        Self { camera, clutter, seed, imaging, ratio: 0.5, print, shown: Vec::new() }
    }

    pub fn render(self) -> Scene {
        let renderer = Renderer::new(self.camera, self.imaging);
        let mut random = Random::new(self.seed, 2);
        let floor = random.uniform(60.0, 180.0);
        let background = background(&renderer, floor, &self.clutter, &mut random);
        let poses: Vec<_> = self.shown.iter().map(|shown| move |_: f64| shown.pose).collect();
        let moving: Vec<_> =
            poses.iter().map(|motion| MovingPrint { print: &self.print, motion }).collect();
        let image = renderer.frame(&background, &moving, &mut random);
        let (seed, imaging, ratio) = (self.seed, self.imaging, self.ratio);
        Scene { seed, image, imaging, ratio, shown: self.shown }
    }
}

/// Light and lens of one frame: at its darkest place the contrast is still [`MIN_CONTRAST`], at its brightest, white
/// may just saturate.
fn imaging(random: &mut Random) -> Imaging {
    let gradient = [random.uniform(-0.35, 0.35), random.uniform(-0.35, 0.35)];
    let reach = 0.5 * (gradient[0].abs() + gradient[1].abs());
    let black = random.uniform(8.0, 50.0);
    let min_white = black + MIN_CONTRAST / (1.0 - reach);
    let max_white = (255.0 / (1.0 + reach)).max(min_white);
    Imaging {
        blur_px: random.uniform(0.5, 1.1),
        noise: random.uniform(0.0, 4.0),
        black,
        white: random.uniform(min_white, max_white),
        gradient,
        ..Imaging::default()
    }
}

/// A roundel somewhere in the image, at the distance where its rim is `minor_px` wide. `None` if it does not fit into
/// the frame.
fn show(
    camera: &Pinhole,
    print: &Print,
    minor_px: f64,
    tilt_rad: f64,
    random: &mut Random,
) -> Option<ShownRoundel> {
    let pixel = Vector2::new(
        random.uniform(0.0, camera.width as f64),
        random.uniform(0.0, camera.height as f64),
    );
    let ray = camera.ray(&pixel)?.normalize();
    let axis = random.uniform(0.0, std::f64::consts::TAU);
    let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-ray)?;
    let lean =
        UnitQuaternion::from_scaled_axis(Vector3::new(axis.cos(), axis.sin(), 0.0) * tilt_rad);
    let at = |range_m: f64| Isometry3::from_parts(Translation3::from(ray * range_m), facing * lean);
    let mut range_m = camera.focal_px[0] * OUTER_M * tilt_rad.cos() / minor_px;
    for _ in 0..4 {
        let seen_px = 2.0 * imaged_rim(camera, &at(range_m), OUTER_M)?.semi_minor_px;
        range_m *= seen_px / minor_px;
    }
    let pose = at(range_m);
    let crate::render::Outline::Disc { diameter_m } = print.sheet else { return None };
    let (rim, sheet) =
        (imaged_rim(camera, &pose, OUTER_M)?, imaged_rim(camera, &pose, diameter_m)?);
    let inside = |x: f64, side: usize| {
        let reach = rim.semi_major_px + EDGE_PX;
        x >= reach && x <= side as f64 - 1.0 - reach
    };
    let whole = inside(rim.center.x, camera.width) && inside(rim.center.y, camera.height);
    whole.then_some(ShownRoundel {
        pose,
        tilt_rad,
        rim,
        sheet_circle: (sheet.center, sheet.semi_major_px),
    })
}

/// Centre and semiaxes of a circle's image, from the moments of a polygon of its points.
fn imaged_rim(camera: &Pinhole, pose: &Isometry3<f64>, diameter_m: f64) -> Option<ImagedRim> {
    const POINTS: usize = 256;
    let point = |i: usize| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / POINTS as f64).sin_cos();
        camera.project(&(pose * Point3::new(0.5 * diameter_m * cos, 0.5 * diameter_m * sin, 0.0)))
    };
    let points: Vec<Vector2<f64>> = (0..POINTS).map(point).collect::<Option<_>>()?;
    let origin = points[0];
    let (mut area, mut first, mut second) = (0.0, Vector2::zeros(), [0.0; 3]);
    for (i, point) in points.iter().enumerate() {
        let (p, q) = (point - origin, points[(i + 1) % POINTS] - origin);
        let cross = p.perp(&q);
        area += cross / 2.0;
        first += (p + q) * (cross / 6.0);
        second[0] += cross * (p.x * p.x + p.x * q.x + q.x * q.x) / 12.0;
        second[1] += cross * (2.0 * (p.x * p.y + q.x * q.y) + p.x * q.y + q.x * p.y) / 24.0;
        second[2] += cross * (p.y * p.y + p.y * q.y + q.y * q.y) / 12.0;
    }
    let mean = first / area;
    let uu = second[0] / area - mean.x * mean.x;
    let uv = second[1] / area - mean.x * mean.y;
    let vv = second[2] / area - mean.y * mean.y;
    let (half, apart) = (0.5 * (uu + vv), (0.5 * (uu - vv)).hypot(uv));
    let semi = |variance: f64| 2.0 * variance.max(0.0).sqrt();
    let (semi_major_px, semi_minor_px) = (semi(half + apart), semi(half - apart));
    Some(ImagedRim { center: origin + mean, semi_major_px, semi_minor_px })
}

/// Whether a ring matches this roundel: centre within a twentieth and size within a tenth of the rim's radius, plus
/// half a pixel.
fn matches(ring: &Ring, shown: &ShownRoundel) -> bool {
    let rim = &shown.rim;
    let radius_px = (rim.semi_major_px * rim.semi_minor_px).sqrt();
    let center = Vector2::new(ring.outer.center.u, ring.outer.center.v);
    let size = |found: f64, shown: f64| (found - shown).abs() <= 0.5 + 0.1 * shown;
    (center - rim.center).norm() <= 0.5 + 0.05 * radius_px
        && size(ring.outer.semi_major_px, rim.semi_major_px)
        && size(ring.outer.semi_minor_px, rim.semi_minor_px)
}

impl Scene {
    /// A detector that knows this frame's print, or one that accepts any ratio.
    pub fn detector(&self, print_is_known: bool) -> Detector {
        let kind = Kind::plain("shown", OUTER_M, OUTER_M * self.ratio);
        let kinds = if print_is_known { vec![kind] } else { Vec::new() };
        Detector::new(kinds, Params::default()).expect("a print within the limits")
    }

    /// Runs the detector and compares its rings with the contents.
    pub fn judge(&self, detector: &Detector, scratch: &mut Scratch) -> Outcome {
        let Image { width, height, pixels } = &self.image;
        let frame = Frame::new(pixels, *width, *height, *width).expect("a whole image");
        let mut outcome = Outcome::default();
        for ring in detector.detect(&frame, scratch) {
            let is_open = |index: &usize| !outcome.found.contains(index);
            let mut open = (0..self.shown.len()).filter(is_open);
            match open.find(|&index| matches(ring, &self.shown[index])) {
                Some(index) => outcome.found.push(index),
                None => outcome.false_detections.push(*ring),
            }
        }
        for (index, shown) in self.shown.iter().enumerate() {
            if !outcome.found.contains(&index) {
                let rejects = self.rejects_near(detector, shown, scratch);
                outcome.missed.push(Miss { shown: *shown, rejects });
            }
        }
        outcome
    }

    /// Reasons for which candidates near a roundel are rejected when its neighbourhood is searched alone.
    fn rejects_near(
        &self,
        detector: &Detector,
        shown: &ShownRoundel,
        scratch: &mut Scratch,
    ) -> Vec<(Reject, u32)> {
        let reach = 1.2 * shown.rim.semi_major_px + 6.0;
        let cut = |x: f64, side: usize| x.clamp(0.0, side as f64) as usize;
        let (width, height) = (self.image.width, self.image.height);
        let (left, right) =
            (cut(shown.rim.center.x - reach, width), cut(shown.rim.center.x + reach, width));
        let (top, bottom) =
            (cut(shown.rim.center.y - reach, height), cut(shown.rim.center.y + reach, height));
        let part = &self.image.pixels[top * width + left..];
        let Ok(frame) = Frame::new(part, right - left, bottom - top, width) else {
            return Vec::new();
        };
        detector.detect(&frame, scratch);
        scratch.rejects().iter().filter(|(_, count)| *count > 0).collect()
    }
}
