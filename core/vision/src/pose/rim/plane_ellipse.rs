//! An ellipse in a plane in front of the camera, and points on it.

use super::rim_pair::RimEllipse;
use crate::{
    camera::NearRays,
    simd::{Lane, Mat2, Mat3, Vec2, Vec3},
};

/// Points on a rim. Five harmonics need at least five; eight prevent aliasing of those that a lens
/// adds, up to the fifth.
pub const POINTS: usize = 8;
const H: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// cos t of the points …
pub const COS: [f64; POINTS] = [1.0, H, 0.0, -H, -1.0, -H, 0.0, H];
/// … and sin t.
pub const SIN: [f64; POINTS] = [0.0, H, 1.0, H, 0.0, -H, -1.0, -H];

/// An ellipse in the plane z = 1 of the base frame.
#[derive(Clone, Copy, Debug)]
pub struct PlaneEllipse<T> {
    pub center: Vec2<T>,
    pub semiaxes: Mat2<T>,
    /// As in [`Rim`].
    pub residual_shape: T,
}

impl<T: Lane> PlaneEllipse<T> {
    /// Axis of the cone through the ellipse: the eigenvector of its dual conic that lies inside.
    /// The other eigenvalues are smaller by the square of the ellipse's size, so two iterations of
    /// the power method from the centre find it.
    #[inline(always)]
    pub fn cone_axis(&self) -> Vec3<T> {
        let shape = self.semiaxes.square();
        let mut axis = self.center;
        for _ in 0..2 {
            let inside = self.center.dot(axis) + 1.0;
            axis = self.center - shape * axis * inside.under(1.0);
        }
        axis.push(axis.x.splat(1.0))
    }

    /// Centre, shape A Aᵀ, and semiaxes without second-order perspective in the plane z = 1 of
    /// another frame; and where it is an ellipse there.
    #[inline(always)]
    pub fn in_frame(&self, local_from_base: &Mat3<T>) -> (Vec2<T>, Mat2<T>, Mat2<T>, T::Mask) {
        // The dual conic is p pᵀ - a aᵀ - b bᵀ.
        let [x, y, z] = local_from_base.transpose().0;
        let [a, b] = self.semiaxes.columns();
        let (a, b) = (x * a.x + y * a.y, x * b.x + y * b.y);
        let p = x * self.center.x + y * self.center.y + z;
        let scale = p.z * p.z - a.z * a.z - b.z * b.z;
        let (fp, fa, fb) = (p.xy(), a.xy(), b.xy());
        let per_scale = scale.under(1.0);
        let center = (fp * p.z - fa * a.z - fb * b.z) * per_scale;
        let c = center;
        let m11 = c.x * c.x - (fp.x * fp.x - fa.x * fa.x - fb.x * fb.x) * per_scale;
        let m12 = c.x * c.y - (fp.x * fp.y - fa.x * fa.y - fb.x * fb.y) * per_scale;
        let m22 = c.y * c.y - (fp.y * fp.y - fa.y * fa.y - fb.y * fb.y) * per_scale;
        let per_depth = p.z.under(1.0);
        let flat = fp * per_depth;
        let semiaxes =
            Mat2::of_columns((fa - flat * a.z) * per_depth, (fb - flat * b.z) * per_depth);
        (center, Mat2::new(m11, m12, m12, m22), semiaxes, scale.is_positive())
    }
}

/// Intersections of rays with the plane z = 1 of the base frame, and where all rays lie less than
/// 90° from its axis.
#[inline(always)]
pub fn plane_points<T: Lane>(
    rays: &[[T; POINTS]; 3],
    base_from_camera: &Option<Mat3<T>>,
) -> ([[T; POINTS]; 2], T::Mask) {
    let mut points = [rays[0], rays[1]];
    let mut ahead = rays[2][0].is_positive();
    if let Some(turn) = base_from_camera {
        for i in 0..POINTS {
            let ray = *turn * Vec3::new(rays[0][i], rays[1][i], rays[2][i]);
            let per_depth = ray.z.under(1.0);
            (points[0][i], points[1][i]) = (ray.x * per_depth, ray.y * per_depth);
            let is_ahead = ray.z.is_positive();
            ahead = if i == 0 { is_ahead } else { ahead & is_ahead };
        }
    }
    (points, ahead)
}

/// Image of the rim's centre, and of its semiaxes by the derivative there.
#[inline(always)]
pub fn linearized_lens<T: Lane, const N: usize>(
    near: &NearRays<T, N>,
    middle_px: Vec2<T>,
    rim: &RimEllipse<T>,
    base_from_camera: &Option<Mat3<T>>,
) -> (Vec2<T>, Mat2<T>) {
    let (mut flat, [mut by_u, mut by_v]) =
        (near.middle.xy(), [near.by_pixel[0].xy(), near.by_pixel[1].xy()]);
    if let Some(turn) = base_from_camera {
        let middle = *turn * near.middle;
        let per_depth = middle.z.under(1.0);
        flat = middle.xy() * per_depth;
        let [u, v] = [*turn * near.by_pixel[0], *turn * near.by_pixel[1]];
        by_u = (u.xy() - flat * u.z) * per_depth;
        by_v = (v.xy() - flat * v.z) * per_depth;
    }
    let slope = Mat2::of_columns(by_u, by_v);
    let [major, minor] = rim.semiaxes();
    let semiaxes = Mat2::of_columns(slope * major, slope * minor);
    (flat + slope * (rim.center - middle_px), semiaxes)
}
