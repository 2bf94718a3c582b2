//! Poses of single roundels by core's public interface, and their errors relative to the Cramér-Rao bound.
//!
//! A [`Trial`] is one roundel (outer 160 mm, on a white sheet on a grey floor) before the reference camera
//! (1920x1080, f = 1100 px, mild `plumb_bob`), at a random subpixel position anywhere in the image. It has two frames
//! or more. The first is searched. In the others the roundel is tracked; it moves by about a pixel and rotates by
//! about a degree from frame to frame. Blur, noise and pose are drawn at random within a [`Range`] and unknown to
//! core. To save time, only a window about the roundel is rendered: that is the same camera with another principal
//! point.
//!
//! Errors are compared trial by trial: [`Summary::depth_over_bound`] is the rms of error over bound, so that cells of
//! mixed size and noise are comparable, and easy trials cannot hide bad ones.

use nalgebra::{
    Isometry3, Matrix5, Matrix6, SMatrix, Translation3, UnitQuaternion, Vector3, Vector5,
};
use rayon::prelude::*;
use roundel_core::{
    marker::{Mode, Params},
    pose::RoundelPose,
    rigid::orientation_of_normal,
};

use crate::{
    arena::Kind,
    bound::{Bound, Scene, Unknowns, bound},
    coded::{coded_print, words},
    optics::{Distortion, Pinhole},
    pipeline::Observer,
    random::Random,
    render::{Canvas, Imaging, MovingPrint, Print, Renderer},
    score::{CHI2_95_3, normalized3},
};

/// 95 % of χ² with five degrees of freedom.
pub const CHI2_95_5: f64 = 11.070;
/// Side of the window that is rendered.
const SIDE_PX: usize = 256;
/// Grey level of the floor.
pub(crate) const FLOOR: f64 = 120.0;
/// A margin whose edge is out of reach of edge measurements, as a share of the outer diameter.
pub const WIDE_MARGIN: f64 = 1.0;
/// A margin as on real prints: the blur of a small roundel's rim overlaps that of the sheet's edge.
pub const NARROW_MARGIN: f64 = 0.25;

/// Ratio of the diameters of most prints.
pub const RATIO: f64 = 0.4;

/// Uniform distributions, minimum to maximum, of a trial's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Outer diameter over depth times focal length.
    pub diameter_px: (f64, f64),
    /// Angle between normal and line of sight.
    pub tilt_deg: (f64, f64),
    /// Deviation of the blur.
    pub blur_px: (f64, f64),
    /// Deviation of the noise, grey levels.
    pub noise: (f64, f64),
    /// Motion within the exposure, across the line of sight in a random direction.
    pub motion_px: (f64, f64),
    /// White margin, as a share of the outer diameter.
    pub margin: f64,
    /// Diameter of the white disc, as a share of the outer one.
    pub ratio: f64,
}

/// One roundel in consecutive frames.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Outer diameter over depth times focal length.
    pub diameter_px: f64,
    /// Angle between normal and line of sight in the first frame.
    pub tilt_deg: f64,
    /// Deviation of the blur.
    pub blur_px: f64,
    /// Deviation of the noise, grey levels.
    pub noise: f64,
    /// Motion within the exposure.
    pub motion_px: f64,
    /// The first is searched; in the others the roundel is tracked.
    pub frames: Vec<TrialFrame>,
}

/// One frame, with the result of each mode.
#[derive(Clone, Debug)]
pub struct TrialFrame {
    /// Bound of the frame's pixels.
    pub bound: Bound,
    /// By mode, as in [`MODES`]; `None` if the roundel was not found.
    pub errors: [Option<Errors>; 2],
}

/// The reference camera.
pub(crate) fn reference() -> Pinhole {
    let distortion = Distortion::PlumbBob([-0.12, 0.03, 4e-4, -3e-4, 0.0]);
    Pinhole::centered(1920, 1080, 1100.0, distortion)
}

pub const MODES: [Mode; 2] = [Mode::Fast, Mode::Precise];

/// Errors of one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Relative error of the range.
    pub depth: f64,
    /// Squared Mahalanobis length of the position's error; NaN if the covariance is not positive definite.
    pub position_square: f64,
    /// The same for position and tilt; `None` if the second normal is the right one.
    pub pose_square: Option<f64>,
    /// Angle between the first and the true normal.
    pub normal_rad: f64,
    /// Angle between the closer one of the two normals and the true one.
    pub closer_rad: f64,
    /// Stated likelihood of the first normal.
    pub likelihood: f64,
    /// Rotation about the normal, if a code was read and the first normal is the right one.
    pub yaw: Option<YawError>,
}

/// Error of the rotation about the normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct YawError {
    pub error_rad: f64,
    /// As stated.
    pub deviation_rad: f64,
}

impl Errors {
    pub(crate) fn of(pose: &RoundelPose, truth: &Isometry3<f64>) -> Self {
        let shift = pose.position_m - truth.translation.vector;
        let range_m = truth.translation.vector.norm();
        let position = pose.covariance.fixed_view::<3, 3>(0, 0).into();
        let normal = truth.rotation * Vector3::z();
        let (given, other) = (angle(&pose.normal, &normal), angle(&pose.other_normal, &normal));
        Self {
            depth: shift.dot(&truth.translation.vector) / range_m.powi(2),
            position_square: normalized3(&shift, &position).unwrap_or(f64::NAN),
            pose_square: (given <= other + 1e-6).then(|| pose_square(pose, &shift, &normal)),
            normal_rad: given,
            closer_rad: given.min(other),
            likelihood: pose.normal_likelihood,
            yaw: pose
                .yaw_rad
                .filter(|_| given <= other)
                .map(|yaw_rad| yaw_error(pose, yaw_rad, truth)),
        }
    }
}

fn yaw_error(pose: &RoundelPose, yaw_rad: f64, truth: &Isometry3<f64>) -> YawError {
    let given = orientation_of_normal(&pose.normal)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    let turn = (given * truth.rotation.inverse()).scaled_axis();
    let rotation = pose.covariance.fixed_view::<3, 3>(3, 3);
    let variance = pose.normal.dot(&(rotation * pose.normal));
    YawError { error_rad: turn.dot(&pose.normal), deviation_rad: variance.sqrt() }
}

fn angle(one: &Vector3<f64>, other: &Vector3<f64>) -> f64 {
    one.cross(other).norm().atan2(one.dot(other))
}

/// Squared Mahalanobis length of the error of the position and of the two rotations across the normal.
fn pose_square(pose: &RoundelPose, shift: &Vector3<f64>, normal: &Vector3<f64>) -> f64 {
    let axis = pose.normal.cross(normal);
    let turn =
        axis.try_normalize(0.0).map_or(Vector3::zeros(), |unit| unit * angle(&pose.normal, normal));
    let helper = if pose.normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let across = pose.normal.cross(&helper).normalize();
    let along = pose.normal.cross(&across);
    // The estimate's error has the opposite sign, which does not matter for the square if both signs change.
    let mut pick = SMatrix::<f64, 5, 6>::zeros();
    pick.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    pick.fixed_view_mut::<1, 3>(3, 3).copy_from(&across.transpose());
    pick.fixed_view_mut::<1, 3>(4, 3).copy_from(&along.transpose());
    // Left perturbation: truth = exp(turn) · estimate, truth = estimate - shift.
    let error = Vector5::new(-shift.x, -shift.y, -shift.z, turn.dot(&across), turn.dot(&along));
    let covariance: Matrix5<f64> = pick * Matrix6::from(pose.covariance) * pick.transpose();
    covariance.cholesky().map_or(f64::NAN, |root| error.dot(&root.solve(&error)))
}

/// `count` trials of a range, computed in parallel; the same for the same `seed`.
pub fn trials(range: &Range, count: usize, seed: u64) -> Vec<Trial> {
    tracked_trials(range, FRAMES, count, seed)
}

/// Trials with this number of frames.
pub fn tracked_trials(range: &Range, frames: usize, count: usize, seed: u64) -> Vec<Trial> {
    let one = |index| trial(range, None, frames, Random::new(index, seed));
    (0..count as u64).into_par_iter().map(one).collect()
}

/// Frames of most trials.
const FRAMES: usize = 2;

/// Trials of roundels with random codes of `bits` bits at random yaw; the ratio is that of coded prints.
pub fn coded_trials(range: &Range, bits: u8, count: usize, seed: u64) -> Vec<Trial> {
    trials_of(range, &Codes { bits, words: &words(bits), read: [true; 2] }, count, seed)
}

/// Like [`coded_trials`], with no code read in the second frame.
pub fn trials_read_once(range: &Range, bits: u8, count: usize, seed: u64) -> Vec<Trial> {
    trials_of(range, &Codes { bits, words: &words(bits), read: [true, false] }, count, seed)
}

/// Roundels with teeth that are no code: they look the same after half a turn.
pub fn uncoded_trials(range: &Range, bits: u8, count: usize, seed: u64) -> Vec<Trial> {
    let half = u32::from(bits / 2);
    let words: Vec<u16> = (1..(1 << half) - 1).map(|part: u16| part << half | part).collect();
    trials_of(range, &Codes { bits, words: &words, read: [true; 2] }, count, seed)
}

fn trials_of(range: &Range, codes: &Codes, count: usize, seed: u64) -> Vec<Trial> {
    let one = |index| trial(range, Some(codes), FRAMES, Random::new(index, seed));
    (0..count as u64).into_par_iter().map(one).collect()
}

/// Codes of the prints.
struct Codes<'a> {
    bits: u8,
    words: &'a [u16],
    /// Whether codes can be read, by frame.
    read: [bool; FRAMES],
}

fn trial(range: &Range, codes: Option<&Codes>, frames: usize, mut random: Random) -> Trial {
    let mut draw = |(low, high): (f64, f64)| random.uniform(low, high);
    let (diameter_px, tilt_deg) = (draw(range.diameter_px), draw(range.tilt_deg));
    let (blur_px, noise) = (draw(range.blur_px), draw(range.noise));
    let motion_px = if range.motion_px.1 > 0.0 { draw(range.motion_px) } else { 0.0 };
    let imaging = Imaging { blur_px, noise, exposure_s: 1.0, ..Imaging::default() };
    let (kind, print) = printed(range, codes.map(|codes| (codes.bits, codes.words)), &mut random);

    let whole = reference();
    let mut truth = pose(&whole, diameter_px, tilt_deg.to_radians(), &mut random);
    if codes.is_some() {
        let yaw_rad = random.uniform(0.0, std::f64::consts::TAU);
        truth.rotation *= UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    }
    let second = moved(&truth, 1.0 / diameter_px, &mut random);
    let camera = window(&whole, &truth);
    let renderer = Renderer::new(camera, imaging);
    let floor = Canvas::flat(camera.width, camera.height, FLOOR);
    let kinds = std::slice::from_ref(&kind);
    let mut observers = MODES.map(|mode| {
        let params = Params { mode, ..Params::default() };
        Observer::with_params(&camera, kinds, 0.0, params).expect("a camera and a kind as above")
    });
    let side = if motion_px > 0.0 { random.uniform(0.0, std::f64::consts::TAU) } else { 0.0 };
    let motion_px_of = [motion_px * side.cos(), motion_px * side.sin()];
    let mut shoot = |truth: Isometry3<f64>, read: bool, random: &mut Random| {
        let per_px = truth.translation.z / whole.focal_px[0];
        let [x_m, y_m] = motion_px_of.map(|px| px * per_px);
        let motion = |time_s: f64| Translation3::new(x_m * time_s, y_m * time_s, 0.0) * truth;
        let moving = [MovingPrint { print: &print, motion: &motion }];
        let image = renderer.frame(&floor, &moving, random);
        let errors = observers.each_mut().map(|observer| {
            let found =
                if read { observer.observe(&image, 0) } else { observer.observe_unread(&image) };
            let found = found.expect("a frame of the camera's size");
            let pose = found.into_iter().find_map(|detection| detection.pose)?;
            Some(Errors::of(&pose, &truth))
        });
        let scene = Scene { camera, imaging, print: &print, pose: truth, motion_px: motion_px_of };
        let unknowns =
            Unknowns { yaw: codes.is_some(), motion: motion_px > 0.0, ..Unknowns::default() };
        let bound = bound(&scene, unknowns).expect("a roundel in plain view");
        TrialFrame { bound, errors }
    };
    let frames = (0..frames)
        .map(|frame| {
            truth = match frame {
                0 => truth,
                1 => second,
                _ => moved(&truth, 1.0 / diameter_px, &mut random),
            };
            shoot(truth, codes.is_none_or(|codes| codes.read[frame]), &mut random)
        })
        .collect();
    Trial { diameter_px, tilt_deg, blur_px, noise, motion_px, frames }
}

/// A kind and its print.
pub(crate) fn printed(
    range: &Range,
    codes: Option<(u8, &[u16])>,
    random: &mut Random,
) -> (Kind, Print) {
    if let Some((bits, words)) = codes {
        let kind = Kind::coded(bits);
        let word = words[(random.next_u64() % words.len() as u64) as usize];
        let print = coded_print(kind.outer_diameter_m, bits, word, range.margin);
        return (kind, print);
    }
    let robot = Kind::robot();
    let kind = Kind { inner_diameter_m: range.ratio * robot.outer_diameter_m, ..robot };
    let print = Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, range.margin);
    (kind, print)
}

/// A pose of this size and tilt, leaning in a random direction, at a random place of the image.
pub(crate) fn pose(
    camera: &Pinhole,
    diameter_px: f64,
    tilt_rad: f64,
    random: &mut Random,
) -> Isometry3<f64> {
    let z = camera.focal_px[0] * Kind::robot().outer_diameter_m / diameter_px;
    let at = [random.uniform(-0.75, 0.75), random.uniform(-0.4, 0.4)];
    let position = Vector3::new(at[0] * z, at[1] * z, z);
    let axis = random.uniform(0.0, std::f64::consts::TAU);
    let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-position)
        .expect("a position in front of the camera");
    let lean =
        UnitQuaternion::from_scaled_axis(Vector3::new(axis.cos(), axis.sin(), 0.0) * tilt_rad);
    Isometry3::from_parts(Translation3::from(position), facing * lean)
}

/// The pose one frame later: shifted by up to `share` of its depth's diameter, rotated by up to a degree.
fn moved(pose: &Isometry3<f64>, share: f64, random: &mut Random) -> Isometry3<f64> {
    let max_m = share * Kind::robot().outer_diameter_m;
    let shift = Vector3::from_fn(|_, _| random.uniform(-max_m, max_m));
    let turn = Vector3::from_fn(|_, _| random.uniform(-0.01, 0.01));
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector + shift),
        UnitQuaternion::from_scaled_axis(turn) * pose.rotation,
    )
}

/// A camera that reads out a window about a roundel.
pub(crate) fn window(whole: &Pinhole, pose: &Isometry3<f64>) -> Pinhole {
    let center = whole.project(&pose.translation.vector.into()).expect("a place in the image");
    let half = SIDE_PX as f64 / 2.0;
    let (left, top) = ((center.x - half).round(), (center.y - half).round());
    let center_px = [whole.center_px[0] - left, whole.center_px[1] - top];
    Pinhole { width: SIDE_PX, height: SIDE_PX, center_px, ..*whole }
}

/// Statistics of frames in one mode.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    pub frames: usize,
    /// Frames in which the roundel was not found.
    pub missed: usize,
    /// Relative errors and bounds of the depth.
    depths: Vec<(f64, f64)>,
    position_inside: usize,
    poses: usize,
    pose_inside: usize,
    normals_rad: Vec<f64>,
    closer_rad: Vec<f64>,
    normal_bounds_rad: Vec<f64>,
    likelihood: f64,
    /// Errors of the yaw, with their bounds.
    yaws: Vec<(YawError, f64)>,
}

impl Summary {
    /// Statistics for the mode of this index in [`MODES`].
    pub fn of<'a>(frames: impl IntoIterator<Item = &'a TrialFrame>, mode: usize) -> Self {
        let mut summary = Self::default();
        for frame in frames {
            summary.frames += 1;
            let Some(errors) = &frame.errors[mode] else {
                summary.missed += 1;
                continue;
            };
            summary.depths.push((errors.depth, frame.bound.range_share));
            summary.position_inside += usize::from(errors.position_square <= CHI2_95_3);
            if let Some(square) = errors.pose_square {
                summary.poses += 1;
                summary.pose_inside += usize::from(square <= CHI2_95_5);
            }
            summary.normals_rad.push(errors.normal_rad);
            summary.closer_rad.push(errors.closer_rad);
            summary.normal_bounds_rad.push(frame.bound.normal_rad());
            summary.likelihood += errors.likelihood;
            summary.yaws.extend(errors.yaw.zip(frame.bound.yaw_rad));
        }
        summary.normals_rad.sort_by(f64::total_cmp);
        summary.closer_rad.sort_by(f64::total_cmp);
        summary.normal_bounds_rad.sort_by(f64::total_cmp);
        summary
    }

    /// Frames in which the roundel was found.
    pub fn found(&self) -> usize {
        self.depths.len()
    }

    fn mean(&self, value: impl Fn(&(f64, f64)) -> f64) -> f64 {
        self.depths.iter().map(value).sum::<f64>() / self.found() as f64
    }

    /// Relative rms error of the depth.
    pub fn depth_rms(&self) -> f64 {
        self.mean(|(error, _)| error * error).sqrt()
    }

    /// Rms of the depth's relative bounds.
    pub fn depth_bound(&self) -> f64 {
        self.mean(|(_, bound)| bound * bound).sqrt()
    }

    /// Rms of error over bound.
    pub fn depth_over_bound(&self) -> f64 {
        self.mean(|(error, bound)| (error / bound).powi(2)).sqrt()
    }

    /// Mean of error over bound, in units of its rms: the bias.
    pub fn bias_over_rms(&self) -> f64 {
        self.mean(|(error, bound)| error / bound) / self.depth_over_bound()
    }

    /// Share of positions inside the stated 95 % ellipsoid.
    pub fn position_share(&self) -> f64 {
        self.position_inside as f64 / self.found() as f64
    }

    /// Share of poses (position and tilt) inside their ellipsoid, among those with the right normal.
    pub fn pose_share(&self) -> f64 {
        self.pose_inside as f64 / self.poses as f64
    }

    /// Share of poses whose first normal is the wrong one.
    pub fn wrong_normal_share(&self) -> f64 {
        1.0 - self.poses as f64 / self.found() as f64
    }

    /// Mean stated probability that the first normal is wrong.
    pub fn stated_wrong_share(&self) -> f64 {
        1.0 - self.likelihood / self.found() as f64
    }

    /// Roundels with an estimated yaw.
    pub fn turned(&self) -> usize {
        self.yaws.len()
    }

    /// Rms of the yaw's error over its bound.
    pub fn yaw_over_bound(&self) -> f64 {
        self.yaw_mean(|(yaw, bound)| (yaw.error_rad / bound).powi(2)).sqrt()
    }

    /// Rms of the yaw's error over its stated deviation.
    pub fn yaw_over_stated(&self) -> f64 {
        self.yaw_mean(|(yaw, _)| (yaw.error_rad / yaw.deviation_rad).powi(2)).sqrt()
    }

    /// Rms error of the yaw.
    pub fn yaw_deg(&self) -> f64 {
        self.yaw_mean(|(yaw, _)| yaw.error_rad.powi(2)).sqrt().to_degrees()
    }

    fn yaw_mean(&self, value: impl Fn(&(YawError, f64)) -> f64) -> f64 {
        self.yaws.iter().map(value).sum::<f64>() / self.turned() as f64
    }

    /// Quantile of the normal's error.
    pub fn normal_deg(&self, share: f64) -> f64 {
        quantile(&self.normals_rad, share).to_degrees()
    }

    /// Quantile of the error of the closer one of the two normals.
    pub fn closer_deg(&self, share: f64) -> f64 {
        quantile(&self.closer_rad, share).to_degrees()
    }

    /// Rms error of the closer one of the two normals.
    pub fn closer_rms_deg(&self) -> f64 {
        let squares: f64 = self.closer_rad.iter().map(|angle| angle * angle).sum();
        (squares / self.found() as f64).sqrt().to_degrees()
    }

    /// Median of the bound of the normal's rms error.
    pub fn normal_bound_deg(&self) -> f64 {
        quantile(&self.normal_bounds_rad, 0.5).to_degrees()
    }
}

/// The value at a share of a sorted list, or NaN of an empty one.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1) as f64;
    sorted.get((share * last).round() as usize).copied().unwrap_or(f64::NAN)
}
