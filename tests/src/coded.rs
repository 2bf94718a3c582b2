//! Renders coded roundels, reads them with core's detector, and counts wrong readings.
//!
//! The prints follow their specification alone (black disc of radius 700, white disc of 420, black teeth down to a
//! white core of 240, two slots per bit counter-clockwise from the print's right, a 0 with its tooth in the first
//! slot) and share no code with core.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;
use roundel_core::{
    camera::PixelPoint,
    frame::Frame,
    marker::{CodeLayout, CodeReading, Detector, Kind, Params, Pattern, Scratch},
};

use crate::{
    optics::{Distortion, Pinhole},
    random::Random,
    render::{Canvas, Imaging, Ink, MovingPrint, Outline, Print, Renderer},
};

/// Radii of the white disc and of the core over the outer radius.
const DISC: f64 = 420.0 / 700.0;
const CORE: f64 = 240.0 / 700.0;
/// Corners of a slot's arc, including its ends. They lie slightly outside the arc, so that both enclose the same
/// area: corners on the arc would make an 8-bit disc of 60 px smaller by 0.006 px, which a fit detects.
const ARC: usize = 9;
const OUTER_M: f64 = 0.16;
/// A yaw with a larger error counts as wrong: half a slot of 16 bits.
const WRONG_YAW_RAD: f64 = PI / 32.0;

/// Words of all identities of `bits` bits, in the order of their numbers: those smaller than every rotation of
/// themselves.
pub fn words(bits: u8) -> Vec<u16> {
    let bits = u32::from(bits);
    let rotated = |word: u32, by: u32| (word << by | word >> (bits - by)) & ((1 << bits) - 1);
    let is_identity = |&word: &u32| (1..bits).all(|by| word < rotated(word, by));
    (0..1 << bits).filter(is_identity).map(|word| word as u16).collect()
}

/// Print of a word of `bits` bits, most significant bit first.
pub fn coded_print(outer_diameter_m: f64, bits: u8, word: u16, margin: f64) -> Print {
    let mut print = Print::plain(outer_diameter_m, outer_diameter_m * DISC, margin);
    let bits = u32::from(bits);
    let slot_rad = PI / f64::from(bits);
    let step_rad = slot_rad / (ARC - 1) as f64;
    let outside = (step_rad / step_rad.sin()).sqrt();
    let mut corners = Vec::new();
    for slot in 0..2 * bits {
        let bit = u32::from(word >> (bits - 1 - slot / 2) & 1);
        let is_tooth = bit == slot % 2;
        let radius_m = 0.5 * outer_diameter_m * outside * if is_tooth { CORE } else { DISC };
        for corner in 0..ARC {
            let part = corner as f64 / (ARC - 1) as f64;
            let (sin, cos) = (slot_rad * (f64::from(slot) + part)).sin_cos();
            corners.push([radius_m * cos, radius_m * sin]);
        }
    }
    print.inks[1] = Ink { outline: Outline::Polygon(corners), white: true };
    print
}

/// Roundels at random places of a camera's view, with blur 0.5 to 1.1 px, noise to 4 grey levels, contrast 90 to 180,
/// and tilt to 50°.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub layout: CodeLayout,
    /// Minimum and maximum outer diameter as seen face-on.
    pub diameters_px: (f64, f64),
}

#[derive(Clone, Debug, Default)]
pub struct Score {
    pub shown: usize,
    /// Read, rightly or wrongly.
    pub read: usize,
    /// Wrong identities.
    pub wrong: usize,
    /// Right identities with a wrong yaw.
    pub wrong_yaw: usize,
    /// Rms error of the yaw of the others.
    pub yaw_rms_rad: f64,
    /// The same as a multiple of the stated deviation.
    pub yaw_rms_stated: f64,
    /// Reasons of those that were not read.
    pub unread: Vec<String>,
}

/// One rendered roundel.
struct Trial {
    camera: Pinhole,
    imaging: Imaging,
    pose: Isometry3<f64>,
    number: u16,
    print: Print,
}

impl Trial {
    fn new(case: &Case, words: &[u16], index: usize) -> (Self, Random) {
        let mut random = Random::new(index as u64, 77 + u64::from(case.layout.bits));
        let diameter_px = random.uniform(case.diameters_px.0, case.diameters_px.1);
        let side = (diameter_px * 1.5) as usize + 16;
        let mut camera = Pinhole::centered(side, side, 1100.0, Distortion::NONE);
        camera.center_px = [random.uniform(-700.0, 700.0), random.uniform(-400.0, 400.0)];
        let pose = random_pose(&camera, diameter_px, &mut random);
        let contrast = random.uniform(90.0, 180.0);
        let black = random.uniform(15.0, 235.0 - contrast);
        let imaging = Imaging {
            blur_px: random.uniform(0.5, 1.1),
            noise: random.uniform(0.0, 4.0),
            black,
            white: black + contrast,
            ..Imaging::default()
        };
        let index = (random.next_u64() % words.len() as u64) as usize;
        let print = coded_print(OUTER_M, case.layout.bits, words[index], 0.25);
        (Self { camera, imaging, pose, number: index as u16 + 1, print }, random)
    }

    fn pixels(&self, random: &mut Random) -> Vec<u8> {
        let motion = |_: f64| self.pose;
        let moving = [MovingPrint { print: &self.print, motion: &motion }];
        let (width, height) = (self.camera.width, self.camera.height);
        let background = Canvas::flat(width, height, 120.0);
        Renderer::new(self.camera, self.imaging).frame(&background, &moving, random).pixels
    }

    /// Angle, on the print, of the point that a pixel sees.
    fn angle_rad(&self, at: PixelPoint) -> f64 {
        let ray = self.camera.ray(&Vector2::new(at.u, at.v)).unwrap();
        let normal = self.pose.rotation * Vector3::z();
        let scale = normal.dot(&self.pose.translation.vector) / normal.dot(&ray);
        let on_print = self.pose.inverse() * Point3::from(ray * scale);
        on_print.y.atan2(on_print.x)
    }

    /// Error of the mean of a reading's two directions, radians.
    fn yaw_error_rad(&self, reading: &CodeReading) -> f64 {
        let wrapped = |angle: f64| (angle + PI).rem_euclid(TAU) - PI;
        let (one, other) = (self.angle_rad(reading.zero), self.angle_rad(reading.opposite));
        wrapped(one + 0.5 * wrapped(other - one - PI))
    }
}

/// A pose of this diameter near the image centre, with random yaw and a tilt up to 50°.
fn random_pose(camera: &Pinhole, diameter_px: f64, random: &mut Random) -> Isometry3<f64> {
    let z = camera.focal_px[0] * OUTER_M / diameter_px;
    let [x, y] = [0, 1].map(|axis| {
        let size = [camera.width, camera.height][axis] as f64;
        let pixel = 0.5 * (size - 1.0) + random.uniform(-1.0, 1.0);
        (pixel - camera.center_px[axis]) / camera.focal_px[axis] * z
    });
    let position = Vector3::new(x, y, z);
    let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-position)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    let tilt = random.uniform(0.0, 50f64.to_radians());
    let about = random.uniform(0.0, TAU);
    let lean = Vector3::new(about.cos(), about.sin(), 0.0) * tilt;
    let yaw = Vector3::new(0.0, 0.0, random.uniform(0.0, TAU));
    let turn =
        facing * UnitQuaternion::from_scaled_axis(lean) * UnitQuaternion::from_scaled_axis(yaw);
    Isometry3::from_parts(Translation3::from(position), turn)
}

/// Renders `count` roundels, one per frame, and runs a detector that knows their kind.
pub fn run(case: &Case, count: usize) -> Score {
    let pattern = Pattern::Coded(case.layout);
    let kind = Kind { pattern, ..Kind::plain("coded", OUTER_M, OUTER_M * DISC) };
    let detector = Detector::new(vec![kind], Params::default()).unwrap();
    let dictionary = case.layout.codes().unwrap();
    let words: Vec<u16> = dictionary.iter().map(|(_, word)| word).collect();
    let readings: Vec<(Trial, Result<CodeReading, String>)> = (0..count)
        .into_par_iter()
        .map_init(Scratch::default, |scratch, index| {
            let (trial, mut random) = Trial::new(case, &words, index);
            let pixels = trial.pixels(&mut random);
            let (width, height) = (trial.camera.width, trial.camera.height);
            let frame = Frame::new(&pixels, width, height, width).unwrap();
            let rings = detector.detect(&frame, scratch);
            let code = if let [ring] = rings { ring.code } else { None };
            let found = rings.len();
            let rejects = scratch.rejects().iter().filter(|(_, count)| *count > 0);
            let rejects: Vec<String> =
                rejects.map(|(reject, count)| format!("{reject} {count}")).collect();
            let why = || format!("{found} found, {}; {:?}", rejects.join(", "), trial.imaging);
            let reading = code.ok_or_else(why);
            (trial, reading)
        })
        .collect();
    let mut score = Score { shown: count, ..Score::default() };
    let (mut squares, mut stated, mut right) = (0.0, 0.0, 0);
    for (trial, reading) in readings {
        let reading = match reading {
            Ok(reading) => reading,
            Err(why) => {
                score.unread.push(why);
                continue;
            }
        };
        score.read += 1;
        let off_rad = trial.yaw_error_rad(&reading);
        if reading.code.number != trial.number {
            score.wrong += 1;
        } else if off_rad.abs() > WRONG_YAW_RAD {
            score.wrong_yaw += 1;
        } else {
            right += 1;
            squares += off_rad * off_rad;
            stated += (off_rad / reading.yaw_deviation_rad).powi(2);
        }
    }
    score.yaw_rms_rad = (squares / f64::from(right)).sqrt();
    score.yaw_rms_stated = (stated / f64::from(right)).sqrt();
    score
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_have_the_numbers_of_the_dictionary() {
        for bits in [5, 8, 12] {
            let dictionary = CodeLayout { bits, min_distance: 1 }.codes().unwrap();
            let known: Vec<u16> = dictionary.iter().map(|(_, word)| word).collect();
            assert_eq!(words(bits), known);
        }
    }
}
