//! The pose in closed form: of one ring, or of several side by side.
//!
//! What [`super`] describes is one chain of some twenty divisions and roots, each of which waits for the one
//! before, with little in it that one ring could do at a time. Rings of one camera take the same chain,
//! each in its lane ([`crate::lanes`]): [`locate_each`]. Where a ring needs what is rare, it leaves the others
//! for it: before the fit if the lens bends it too much for the closed form (`rim`), after that if it nearly
//! faces the camera (`upright`), if a second step is needed or if one circle is none (`refine`). Its result is
//! that of [`locate`] to the last bit (`locator::tests::rings_side_by_side_are_each_as_alone`).
//!
//! PERF: `--bench pose`, 30 px, `plumb_bob`: 0.70 µs alone; one of 64 0.18 µs with AVX-512 and 0.26 µs with AVX2
//! (by fours 0.23 µs there, and more with AVX-512).

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
    lanes::{Lane, Mask, Mat3, Vec3},
    pose::{
        PoseError, RoundelPose,
        rim::{
            projection::{self, ConeFrameRims, Rim},
            rim_pair::{RimPair, RingMeasurement},
        },
    },
    rigid::{Covariance6, UNKNOWN_ANGLE_VARIANCE_RAD2},
};

/// What two rims' ten numbers say beyond the five of a pose.
const FREEDOMS: f64 = 5.0;
/// Squared misfit that their errors explain in 95 of 100 rings (χ² of that many degrees of freedom).
const EXPLAINED_MISFIT: f64 = 11.07;

/// Rings side by side. Eight are one vector of AVX-512, two of AVX2, four of NEON.
pub const LANES: usize = 8;

/// The numbers of a pose.
#[derive(Clone, Copy)]
pub struct PoseLanes<T> {
    position_m: Vec3<T>,
    normal: Vec3<T>,
    normal_likelihood: T,
    other_normal: Vec3<T>,
    covariance: [[T; 6]; 6],
}

/// Of one ring.
pub fn locate(camera: &Camera, found: &RingMeasurement) -> Result<RoundelPose, PoseError> {
    dispatch!(Level::new(), simd => locate_with(simd, camera, found))
}

#[simd]
fn locate_with<S: Simd>(
    simd: S,
    camera: &Camera,
    found: &RingMeasurement,
) -> Result<RoundelPose, PoseError> {
    let _ = simd;
    fit(&projection::project(camera, &found.rim_pair())?)
}

/// Of each ring there is, as [`locate`] gives it; other places keep what they have.
pub fn locate_each(
    camera: &Camera,
    found: &[Option<RingMeasurement>; LANES],
    poses: &mut [Result<RoundelPose, PoseError>; LANES],
) {
    let mut rings =
        found.iter().enumerate().filter_map(|(place, one)| Some((place, one.as_ref()?)));
    match (rings.next(), rings.next()) {
        (None, _) => {}
        // Eight take longer than one, and not as long as two.
        (Some((place, one)), None) => poses[place] = locate(camera, one),
        (Some((_, one)), Some(_)) => {
            let all = found.each_ref().map(|ring| ring.as_ref().unwrap_or(one));
            let requested = found.each_ref().map(Option::is_some);
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
    found: &[&RingMeasurement; LANES],
    requested: &[bool; LANES],
    poses: &mut [Result<RoundelPose, PoseError>; LANES],
) {
    let pair = RimPair::gather(f64x8::simd_from(simd, 0.0), found);
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
            fit_alone(&projected.lane(lane))
        } else {
            locate(camera, found[lane])
        };
    }
}

fn fit_alone(projected: &ConeFrameRims<f64>) -> Result<RoundelPose, PoseError> {
    dispatch!(Level::new(), simd => fit_with(simd, projected))
}

#[simd]
fn fit_with<S: Simd>(simd: S, projected: &ConeFrameRims<f64>) -> Result<RoundelPose, PoseError> {
    let _ = simd;
    fit(projected)
}

/// From where the likelier normal puts the centre to where the other one does, camera frame, metres.
pub fn other_offset_m(camera: &Camera, found: &RingMeasurement) -> Result<Vector3<f64>, PoseError> {
    let projected = projection::project(camera, &found.rim_pair())?;
    let Estimates { first, other, .. } = estimate(&projected.rims)?;
    let apart = other.circle.position_m() - first.circle.position_m();
    Ok((projected.local_from_camera.transpose() * apart).into())
}

/// From rims carried through the lens.
#[inline(always)]
fn fit(projected: &ConeFrameRims<f64>) -> Result<RoundelPose, PoseError> {
    Ok(finish(&projected.local_from_camera, &estimate(&projected.rims)?).pose(0))
}

/// Both circles, the likelier one first.
#[inline(always)]
pub fn estimate(rims: &[Rim<f64>; 2]) -> Result<Estimates<f64>, PoseError> {
    let (circles, true) = Circle::both(&rims[0]) else { return Err(PoseError::NoCircle) };
    if frontal::applies(&circles[0], rims) {
        return Ok(frontal::estimate(&circles[0], rims));
    }
    refine::refine(&circles, rims).ok_or(PoseError::NoCircle)
}

/// How much wider than stated errors must be, as a factor of the variance, for rims of this squared
/// misfit: 1 for what is explained, then steadily up to the misfit over its degrees of freedom.
#[inline(always)]
fn growth<T: Lane>(misfit: T) -> T {
    (misfit - EXPLAINED_MISFIT).larger(misfit.splat(0.0)) * (1.0 / FREEDOMS) + 1.0
}

/// The first estimate in the camera frame, with what the other leaves in doubt.
#[inline(always)]
pub fn finish<T: Lane>(local_from_camera: &Mat3<T>, estimates: &Estimates<T>) -> PoseLanes<T> {
    let Estimates { first, other, likelihood } = estimates;
    let camera_from_local = local_from_camera.transpose();
    let normal = camera_from_local * first.circle.normal();
    let other_normal = camera_from_local * other.circle.normal();
    let position_m = first.circle.position_m();
    // The two normals put the centre at slightly different places, and which is right is not known.
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

/// An estimate's covariance in the camera frame, with nothing about the normal; the upper triangle.
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
    // Rows of the five numbers' covariance, each carried to six.
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
    /// In one lane.
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
        pose::{self, RimNoise, tests::camera},
    };

    /// Of a size and a flatness each; round ones need the way of upright circles.
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
            // It bends the larger ones by more than the closed form holds for.
            Lens::PlumbBob([-0.28, 0.09, 0.0012, -0.0008, -0.012]),
            Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]),
        ] {
            let camera = camera(lens);
            let rings = rings();
            let found = rings.map(|ring| pose::found(&kind, &ring, &noise).unwrap().unwrap());
            let alone = rings.map(|ring| pose::locate(&camera, &kind, &ring, &noise));
            assert!(alone.iter().all(|pose| pose.is_ok()));
            for level in [Level::new(), Level::baseline()] {
                let mut poses = [const { Err(PoseError::NoCircle) }; LANES];
                dispatch!(level, simd => {
                    locate_each_with(simd, &camera, &found.each_ref(), &[true; LANES], &mut poses)
                });
                assert_eq!(poses, alone, "{level:?}");
            }
        }
    }
}
