//! Roundels that move past a camera with a rolling shutter, and the errors of their poses frame by frame.
//!
//! Like [`crate::precision`], but over [`FRAMES`] frames at 60 Hz, with a velocity, an acceleration of a few m/s² and
//! rotation. The renderer shows each row as it is when it is exposed, and each pose is compared with the truth at its
//! stated time.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use roundel_core::marker::Params;

use crate::{
    arena::Kind,
    bound::{Scene, Unknowns, bound},
    coded::words,
    pipeline::Observer,
    precision::{Errors, FLOOR, MODES, Range, TrialFrame, pose, printed, reference, window},
    random::Random,
    render::{Canvas, Imaging, MovingPrint, Print, Renderer},
};

/// Frames of each sequence.
pub const FRAMES: usize = 6;
const RATE_HZ: f64 = 60.0;
/// Exposure of each row.
const EXPOSURE_S: f64 = 1e-3;
/// Largest acceleration along any axis, m/s², and rotation about any axis, rad/s.
const MAX_MOTION: (f64, f64) = (3.0, 1.0);

#[derive(Clone, Copy, Debug)]
pub enum MarkerType {
    Plain,
    /// With a code of this many bits.
    Coded(u8),
    /// With an elliptical disc.
    Elliptical,
}

#[derive(Clone, Copy, Debug)]
pub struct Drive {
    pub marker: MarkerType,
    /// Across the line of sight.
    pub speed_m_s: f64,
    /// Time between the exposures of two rows.
    pub line_time_s: f64,
    /// The line time that core is configured with.
    pub configured_line_time_s: f64,
}

/// `count` sequences of roundels within a range, computed in parallel; the same for the same `seed`.
pub fn sequences(
    range: &Range,
    drive: &Drive,
    count: usize,
    seed: u64,
) -> Vec<[TrialFrame; FRAMES]> {
    (0..count).into_par_iter().map(|index| sequence(range, drive, seed, index as u64)).collect()
}

/// Pose over time.
struct Motion {
    central: Isometry3<f64>,
    velocity_m_s: Vector3<f64>,
    acceleration_m_s2: Vector3<f64>,
    turn_rad_s: Vector3<f64>,
}

impl Motion {
    fn new(central: Isometry3<f64>, speed_m_s: f64, random: &mut Random) -> Self {
        let (sin, cos) = random.uniform(0.0, TAU).sin_cos();
        let along = random.uniform(-0.5, 0.5);
        let mut drawn = |max: f64| Vector3::from_fn(|_, _| random.uniform(-max, max));
        Self {
            central,
            velocity_m_s: Vector3::new(cos, sin, along) * speed_m_s,
            acceleration_m_s2: drawn(MAX_MOTION.0),
            turn_rad_s: drawn(MAX_MOTION.1),
        }
    }

    fn at(&self, t: f64) -> Isometry3<f64> {
        let moved = self.velocity_m_s * t + self.acceleration_m_s2 * (0.5 * t * t);
        let turn = UnitQuaternion::from_scaled_axis(self.turn_rad_s * t);
        let Isometry3 { rotation, translation } = self.central;
        Isometry3::from_parts(Translation3::from(translation.vector + moved), turn * rotation)
    }
}

fn sequence(range: &Range, drive: &Drive, seed: u64, index: u64) -> [TrialFrame; FRAMES] {
    let mut random = Random::new(index, seed);
    let mut draw = |(low, high): (f64, f64)| random.uniform(low, high);
    let (diameter_px, tilt_deg) = (draw(range.diameter_px), draw(range.tilt_deg));
    let (blur_px, noise) = (draw(range.blur_px), draw(range.noise));
    let line_time_s = drive.line_time_s;
    let imaging =
        Imaging { blur_px, noise, exposure_s: EXPOSURE_S, line_time_s, ..Imaging::default() };
    let (kind, print) = printed_marker(range, drive.marker, &mut random);
    let whole = reference();
    let mut central = pose(&whole, diameter_px, tilt_deg.to_radians(), &mut random);
    let yaw_rad = random.uniform(0.0, TAU);
    central.rotation *= UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    let camera = window(&whole, &central);
    let motion = Motion::new(central, drive.speed_m_s, &mut random);
    let renderer = Renderer::new(camera, imaging);
    let floor = Canvas::flat(camera.width, camera.height, FLOOR);
    let kinds = std::slice::from_ref(&kind);
    let mut observers = MODES.map(|mode| {
        let params = Params { mode, ..Params::default() };
        Observer::with_params(&camera, kinds, drive.configured_line_time_s, params)
            .expect("a camera and a kind")
    });
    std::array::from_fn(|frame| {
        let time_s = (frame as f64 - 0.5 * (FRAMES - 1) as f64) / RATE_HZ;
        let pose = |offset_s: f64| motion.at(time_s + offset_s);
        let image =
            renderer.frame(&floor, &[MovingPrint { print: &print, motion: &pose }], &mut random);
        let time_ns = (time_s * 1e9).round() as i64;
        let errors = observers.each_mut().map(|observer| {
            let found = observer.observe(&image, time_ns).expect("a frame of the camera's size");
            found.into_iter().find_map(|detection| {
                let truth = motion.at(detection.capture_time.as_ns() as f64 * 1e-9);
                Some(Errors::of(&detection.pose?, &truth))
            })
        });
        let scene =
            Scene { camera, imaging, print: &print, pose: motion.at(time_s), motion_px: [0.0; 2] };
        let yaw = !matches!(drive.marker, MarkerType::Plain);
        let bound = bound(&scene, Unknowns { yaw, ..Unknowns::default() });
        TrialFrame { bound: bound.expect("a roundel in plain view"), errors }
    })
}

fn printed_marker(range: &Range, marker: MarkerType, random: &mut Random) -> (Kind, Print) {
    match marker {
        MarkerType::Plain => printed(range, None, random),
        MarkerType::Coded(bits) => printed(range, Some((bits, &words(bits))), random),
        MarkerType::Elliptical => {
            let (outer_m, disc_m) = (Kind::robot().outer_diameter_m, (0.096, 0.064));
            let kind =
                Kind { inner_diameter_m: disc_m.0, inner_minor_m: Some(disc_m.1), ..Kind::robot() };
            (kind, Print::elliptical(outer_m, disc_m, range.margin))
        }
    }
}
