//! The pose in closed form, for one ring or for several in the lanes of a vector.
//!
//! The steps of [`super::super`] form one chain of about twenty divisions and square roots, each of
//! which waits for the one before. A single ring leaves the processor idle, so [`locate_each`] runs
//! up to [`LANES`] rings of one camera side by side ([`crate::simd`]). A ring that needs a rare
//! step leaves the vector and is finished alone: when the lens distorts it too much for the series
//! ([`rim::lens_series`](super::super::rim)), when it nearly faces the camera ([`super::frontal`]),
//! when one Gauss-Newton step is not enough, or when one of the two circles is invalid
//! ([`super::refine`]). Its result equals that of [`locate`] to the last bit
//! (`locator::tests::batched_rings_equal_single_ones`).
//!
//! PERF: `--bench pose`, 30 px, `plumb_bob`: 0.70 µs alone; one of 64 0.18 µs with AVX-512 and 0.26
//! µs with AVX2 (0.23 µs there in lanes of four, which are slower with AVX-512).

use fearless_simd::{Level, Simd, SimdFrom, dispatch, f64x8};
use fearless_simd_macros::simd;
use nalgebra::{Matrix6, Vector3};

use super::{
    cone::Circle,
    frontal,
    refine::{self, Estimate, Estimates},
};
use crate::{
    camera::Camera,
    pose::{
        PoseError, RoundelPose,
        rim::{
            projection::{self, ConeFrameRims, Rim},
            rim_pair::{RimPair, RingMeasurement},
        },
    },
    rigid::{Covariance6, UNKNOWN_ANGLE_VARIANCE_RAD2},
    simd::{Lane, Mask, Mat3, Vec3},
};

/// Ten numbers of two rims less the five of a pose.
const FREEDOMS: f64 = 5.0;
/// 95 % quantile of χ² with [`FREEDOMS`] degrees of freedom.
const EXPLAINED_MISFIT: f64 = 11.07;

/// Eight lanes are one vector of AVX-512, two of AVX2, four of NEON.
pub const LANES: usize = 8;

/// A pose in each lane; the upper triangle of the covariance.
#[derive(Clone, Copy)]
pub struct PoseLanes<T> {
    position_m: Vec3<T>,
    normal: Vec3<T>,
    normal_likelihood: T,
    other_normal: Vec3<T>,
    covariance: [[T; 6]; 6],
}

pub fn locate(camera: &Camera, measured: &RingMeasurement) -> Result<RoundelPose, PoseError> {
    dispatch!(Level::new(), _ => fit(&projection::project(camera, &measured.rim_pair())?))
}

/// As [`locate`] for each ring that is present; the other entries of `poses` keep their values.
pub fn locate_each(
    camera: &Camera,
    measured: &[Option<RingMeasurement>; LANES],
    poses: &mut [Result<RoundelPose, PoseError>; LANES],
) {
    let mut rings =
        measured.iter().enumerate().filter_map(|(place, one)| Some((place, one.as_ref()?)));
    match (rings.next(), rings.next()) {
        (None, _) => {}
        // Eight lanes take longer than one ring, and less than two.
        (Some((place, one)), None) => poses[place] = locate(camera, one),
        (Some((_, one)), Some(_)) => {
            let all = measured.each_ref().map(|ring| ring.as_ref().unwrap_or(one));
            let requested = measured.each_ref().map(Option::is_some);
            dispatch!(Level::new(), simd => {
                locate_each_with(simd, camera, &all, &requested, poses)
            });
        }
    }
}

#[simd]
fn locate_each_with<S: Simd>(
    simd: S,
    camera: &Camera,
    measured: &[&RingMeasurement; LANES],
    requested: &[bool; LANES],
    poses: &mut [Result<RoundelPose, PoseError>; LANES],
) {
    let pair = RimPair::gather(f64x8::simd_from(simd, 0.0), measured);
    let projected = projection::flatten_by_series(camera, &pair.rims).project(&pair);
    let (circles, is_circle) = Circle::both(&projected.rims[0]);
    let is_upright = frontal::applies(&circles[0], &projected.rims);
    let (estimates, single_step) = refine::refine_once(&circles, &projected.rims);
    let lanes = finish(&projected.local_from_camera, &estimates);
    let valid = projected.valid & is_circle & !is_upright & single_step;
    for (lane, pose) in poses.iter_mut().enumerate().filter(|(lane, _)| requested[*lane]) {
        *pose = if valid.is_set(lane) {
            Ok(lanes.pose(lane))
        } else if projected.valid.is_set(lane) {
            fit(&projected.lane(lane))
        } else {
            locate(camera, measured[lane])
        };
    }
}

/// Vector from the position with the more likely normal to that with the other one, camera frame,
/// metres.
pub fn other_offset_m(
    camera: &Camera,
    measured: &RingMeasurement,
) -> Result<Vector3<f64>, PoseError> {
    let projected = projection::project(camera, &measured.rim_pair())?;
    let Estimates { first, other, .. } = estimate(&projected.rims)?;
    let apart = other.circle.position_m() - first.circle.position_m();
    Ok((projected.local_from_camera.transpose() * apart).into())
}

#[inline(always)]
fn fit(projected: &ConeFrameRims<f64>) -> Result<RoundelPose, PoseError> {
    Ok(finish(&projected.local_from_camera, &estimate(&projected.rims)?).pose(0))
}

/// Both circles, the more likely one first.
#[inline(always)]
pub fn estimate(rims: &[Rim<f64>; 2]) -> Result<Estimates<f64>, PoseError> {
    let (circles, true) = Circle::both(&rims[0]) else { return Err(PoseError::NoCircle) };
    if frontal::applies(&circles[0], rims) {
        return Ok(frontal::estimate(&circles[0], rims));
    }
    refine::refine(&circles, rims).ok_or(PoseError::NoCircle)
}

/// Factor by which the variances grow when the rims fit worse than their errors explain: 1 up to
/// [`EXPLAINED_MISFIT`], then linear up to the misfit over its degrees of freedom.
#[inline(always)]
fn growth<T: Lane>(misfit: T) -> T {
    (misfit - EXPLAINED_MISFIT).larger(misfit.splat(0.0)) * (1.0 / FREEDOMS) + 1.0
}

/// The more likely estimate in the camera frame; its covariance includes the ambiguity of the
/// normal.
#[inline(always)]
pub fn finish<T: Lane>(local_from_camera: &Mat3<T>, estimates: &Estimates<T>) -> PoseLanes<T> {
    let Estimates { first, other, likelihood } = estimates;
    let camera_from_local = local_from_camera.transpose();
    let normal = camera_from_local * first.circle.normal();
    let other_normal = camera_from_local * other.circle.normal();
    let position_m = first.circle.position_m();
    // The two normals give slightly different positions, and which one is right is uncertain.
    let apart = camera_from_local * (other.circle.position_m() - position_m);
    let mut covariance = covariance(first, &camera_from_local);
    let doubt = -*likelihood + 1.0;
    let (a, n) = ([apart.x, apart.y, apart.z], [normal.x, normal.y, normal.z]);
    for row in 0..3 {
        for column in row..3 {
            let own = &mut covariance[row][column];
            *own = *own + a[row] * a[column] * doubt;
            let own = &mut covariance[3 + row][3 + column];
            *own = *own + n[row] * n[column] * UNKNOWN_ANGLE_VARIANCE_RAD2;
        }
    }
    PoseLanes {
        position_m: camera_from_local * position_m,
        normal,
        normal_likelihood: *likelihood,
        other_normal,
        covariance,
    }
}

/// Covariance of (position, rotation) in the camera frame without rotation about the normal; upper
/// triangle.
#[inline(always)]
fn covariance<T: Lane>(estimate: &Estimate<T>, camera_from_local: &Mat3<T>) -> [[T; 6]; 6] {
    let (place, turns) = estimate.changes();
    let mut by = [[place[0].x; 3]; 5];
    for (by, change) in by.iter_mut().zip([place[0], place[1], place[2], turns[0], turns[1]]) {
        let change = *camera_from_local * change;
        *by = [change.x, change.y, change.z];
    }
    let growth = growth(estimate.misfit);
    let c = &estimate.covariance;
    // Rows of the covariance of the five parameters, expanded to six columns.
    let mut projected = [[growth; 6]; 5];
    for (number, row) in projected.iter_mut().enumerate() {
        let c = c[number];
        for k in 0..3 {
            row[k] = growth * (c[0] * by[0][k] + c[1] * by[1][k] + c[2] * by[2][k]);
            row[3 + k] = growth * (c[3] * by[3][k] + c[4] * by[4][k]);
        }
    }
    let mut covariance = [[growth; 6]; 6];
    for row in 0..3 {
        for column in row..6 {
            covariance[row][column] = by[0][row] * projected[0][column]
                + by[1][row] * projected[1][column]
                + by[2][row] * projected[2][column];
        }
        for column in row..3 {
            covariance[3 + row][3 + column] =
                by[3][row] * projected[3][3 + column] + by[4][row] * projected[4][3 + column];
        }
    }
    covariance
}

impl<T: Lane> PoseLanes<T> {
    #[inline(always)]
    pub fn pose(&self, lane: usize) -> RoundelPose {
        let mut covariance: Covariance6 = Matrix6::zeros();
        for row in 0..6 {
            for column in row..6 {
                let own = self.covariance[row][column].lane(lane);
                (covariance[(row, column)], covariance[(column, row)]) = (own, own);
            }
        }
        RoundelPose {
            position_m: self.position_m.lane(lane).into(),
            normal: self.normal.lane(lane).into(),
            normal_likelihood: self.normal_likelihood.lane(lane),
            other_normal: self.other_normal.lane(lane).into(),
            yaw_rad: None,
            yaw_symmetry: 1,
            covariance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        camera::{Lens, PixelPoint},
        ellipse::Ellipse,
        marker::{Kind, Ring},
        pose::{self, PrintedRing, RimNoise, tests::camera},
    };

    /// Different sizes and flattenings; the round ones take the path of `frontal`.
    fn rings() -> [Ring; LANES] {
        std::array::from_fn(|k| {
            let share = [1.0, 0.95, 0.85, 0.7, 0.5, 0.35, 0.999, 0.2][k];
            let rim = |scale: f64, off_px: f64| Ellipse {
                center: PixelPoint { u: 300.0 + 170.0 * k as f64 + off_px, v: 700.0 - off_px },
                semi_major_px: (8.0 + 3.0 * k as f64) * scale,
                semi_minor_px: (8.0 + 3.0 * k as f64) * scale * share,
                angle_rad: 0.3 * k as f64 - 1.1,
            };
            Ring::of_rims(rim(1.0, 0.0), rim(0.4, 0.01))
        })
    }

    #[test]
    fn every_simd_level_gives_the_same_poses() {
        let (kind, noise) = (Kind::plain("robot", 0.16, 0.064), RimNoise::default());
        for lens in [
            Lens::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]),
            // Distorts the larger rings by more than the series allows.
            Lens::PlumbBob([-0.28, 0.09, 0.0012, -0.0008, -0.012]),
            Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]),
        ] {
            let camera = camera(lens);
            let rings = rings();
            let measured = rings.map(|ring| {
                let printed = PrintedRing::designed(&ring);
                pose::measure(&kind, &printed, &noise).unwrap().unwrap()
            });
            let alone = rings.map(|ring| pose::locate(&camera, &kind, &ring, &noise));
            assert!(alone.iter().all(|pose| pose.is_ok()));
            for level in [Level::new(), Level::baseline()] {
                let mut poses = [const { Err(PoseError::NoCircle) }; LANES];
                dispatch!(level, simd => {
                    locate_each_with(simd, &camera, &measured.each_ref(), &[true; LANES], &mut poses)
                });
                assert_eq!(poses, alone, "{level:?}");
            }
        }
    }
}
