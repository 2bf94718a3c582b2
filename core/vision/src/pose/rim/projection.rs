//! Rims taken through the lens.
//!
//! A rim is sampled at points c + a cos t + b sin t, t evenly spaced, with the semiaxes a and b as
//! vectors. A slightly different ellipse crosses the line from the centre through such a point at 1
//! + q(t) times its distance. To first order q = ψ·h with five harmonics, ψ = (1, √2 cos t, √2 sin
//! t, √2 cos 2t, √2 sin 2t): size, shift along either axis, elongation and turn. The five numbers h
//! therefore describe a rim completely, and h = mean(ψ q), the mean over evenly spaced t, is what
//! the moments of a rim's area measure. (The change of an area is ½∮q r×dr = ½ab∮q dt, and those of
//! its first and second moments are the other harmonics.) Affine maps preserve t and h.
//!
//! Where the lens distorts a rim little, the ellipse follows in closed form
//! ([`super::lens_series`]), else by iteration ([`super::lens_iteration`]).
//!
//! The ellipse with centre c and semiaxes A = (a b), in homogeneous coordinates, is the *dual
//! conic* D = (c cᵀ - A Aᵀ, c; cᵀ, 1), the set of its tangents l, lᵀ D l = 0. It rotates with the
//! frame: D → R D Rᵀ.

use super::{
    information::Information,
    lens_series::LensSeries,
    rim_pair::{RimEllipse, RimPair},
};
use crate::{
    camera::{Camera, LensError, NearRays},
    lanes::{Lane, Mask, Mat2, Mat3, Vec2, Vec3},
    pose::PoseError,
};

/// Points on a rim. Five harmonics need at least five; eight prevent aliasing of those that a lens
/// adds, up to the fifth.
pub const POINTS: usize = 8;
/// A rim in the plane z = 1 of a local frame.
#[derive(Clone, Copy, Debug)]
pub struct Rim<T> {
    /// Radius of the circle.
    pub radius_m: T,
    /// Centre of the ellipse.
    pub center: Vec2<T>,
    /// A Aᵀ.
    pub shape: Mat2<T>,
    /// A⁻¹, without second-order perspective.
    pub inverse: Mat2<T>,
    /// Product of the semiaxes in the image.
    pub area_px2: T,
    /// Squared relative error of the shape by lens distortion.
    pub residual_shape: T,
    /// Of the five harmonics.
    pub information: Information<T>,
}

/// Both rims in a frame whose z is the axis of the outer rim's cone, near which the circle lies.
#[derive(Clone, Copy, Debug)]
pub struct ConeFrameRims<T: Lane> {
    pub local_from_camera: Mat3<T>,
    /// Outer and inner.
    pub rims: [Rim<T>; 2],
    /// Where the rims are ellipses there.
    pub valid: T::Mask,
}

/// Both rims in the plane z = 1 of a base frame.
#[derive(Clone, Copy, Debug)]
pub struct PlaneRims<T: Lane> {
    /// `None` for the camera frame.
    pub base_from_camera: Option<Mat3<T>>,
    /// Outer and inner.
    pub flats: [PlaneEllipse<T>; 2],
    pub valid: T::Mask,
}

/// Through any lens.
#[inline(always)]
pub fn project(camera: &Camera, pair: &RimPair<f64>) -> Result<ConeFrameRims<f64>, PoseError> {
    let mut flattened = flatten_by_series(camera, &pair.rims);
    if !flattened.valid {
        flattened = flatten_by_iteration(camera, &pair.rims)?;
    }
    let carried = flattened.project(pair);
    if carried.valid { Ok(carried) } else { Err(PoseError::NoCircle) }
}

/// In closed form, where the lens distorts the rims little.
#[inline(always)]
pub fn flatten_by_series<T: Lane>(camera: &Camera, rims: &[RimEllipse<T>; 2]) -> PlaneRims<T> {
    let [outer, inner] = rims;
    let near = camera.rays_near_each(outer.center, &points(outer, outer.center));
    let base_from_camera = base(camera, near.middle);
    let (middle, semiaxes) = linearized_lens(&near, outer.center, outer, &base_from_camera);
    let (points, ahead) = plane_points(&near.rays, &base_from_camera);
    let (bend, bent_little) = LensSeries::of(&points, middle, semiaxes);
    let mut valid = near.settled & bent_little;
    if base_from_camera.is_some() {
        valid = valid & ahead;
    }
    PlaneRims { base_from_camera, flats: [bend.outer(), bend.inner(outer, inner)], valid }
}

/// For any lens.
#[inline(always)]
pub fn flatten_by_iteration(
    camera: &Camera,
    pair: &[RimEllipse<f64>; 2],
) -> Result<PlaneRims<f64>, PoseError> {
    let near = match camera.rays_near(pair[0].center, &offsets(pair)) {
        Ok(near) => near,
        Err(source) => {
            return Err(PoseError::Lens { rim: first_rejected_rim(camera, &pair[0]), source });
        }
    };
    let base_from_camera = base(camera, near.middle);
    let outer = PlaneEllipse::fitted_through(&near, 0, pair, &base_from_camera);
    let inner = PlaneEllipse::fitted_through(&near, 1, pair, &base_from_camera);
    let behind = |rim| PoseError::Lens { rim, source: LensError::Behind };
    let (outer, inner) = (outer.ok_or(behind("outer"))?, inner.ok_or(behind("inner"))?);
    Ok(PlaneRims { base_from_camera, flats: [outer, inner], valid: true })
}

/// Rays of planar models are points of one plane, in which a lens without distortion is linear.
#[inline(always)]
fn base<T: Lane>(camera: &Camera, middle: Vec3<T>) -> Option<Mat3<T>> {
    if camera.is_planar() { None } else { Some(frame_along(middle)) }
}

/// Rows of a right-handed frame whose z lies along `axis`, of any length.
#[inline(always)]
pub fn frame_along<T: Lane>(axis: Vec3<T>) -> Mat3<T> {
    let z = axis * axis.square().root().under(1.0);
    let zero = z.x.splat(0.0);
    let is_level = z.y.size().below(zero.splat(0.9));
    // y × z, or x × z.
    let across = Vec3::choose(is_level, Vec3::new(z.z, zero, -z.x), Vec3::new(zero, -z.z, z.y));
    let x = across * across.square().root().under(1.0);
    Mat3([x, z.cross(x), z])
}

/// Points of a rim relative to a pixel.
#[inline(always)]
fn points<T: Lane>(rim: &RimEllipse<T>, from: Vec2<T>) -> [[T; POINTS]; 2] {
    let [major, minor] = rim.semiaxes();
    let at = rim.center - from;
    let mut points = [[at.x; POINTS], [at.y; POINTS]];
    for i in 0..POINTS {
        points[0][i] = at.x + major.x * COS[i] + minor.x * SIN[i];
        points[1][i] = at.y + major.y * COS[i] + minor.y * SIN[i];
    }
    points
}

/// Points of the outer rim, then of the inner one, relative to the outer rim's centre, pixels.
#[inline(always)]
fn offsets(rims: &[RimEllipse<f64>; 2]) -> [[f64; 2 * POINTS]; 2] {
    let mut offsets = [[0.0; 2 * POINTS]; 2];
    for (rim, pair) in rims.iter().enumerate() {
        let points = points(pair, rims[0].center);
        for axis in 0..2 {
            offsets[axis][rim * POINTS..(rim + 1) * POINTS].copy_from_slice(&points[axis]);
        }
    }
    offsets
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

/// The first rim with a point that has no ray.
fn first_rejected_rim(camera: &Camera, outer: &RimEllipse<f64>) -> &'static str {
    let outer = camera.rays_near(outer.center, &points(outer, outer.center));
    if outer.is_err() { "outer" } else { "inner" }
}

impl<T: Lane> PlaneRims<T> {
    /// Rotates the rims into the frame of the outer rim's cone.
    #[inline(always)]
    pub fn project(&self, pair: &RimPair<T>) -> ConeFrameRims<T> {
        let [outer, inner] = &self.flats;
        let local_from_base = frame_along(outer.cone_axis());
        let (outer, outer_known) = outer.rim(&local_from_base, pair, 0);
        let (inner, inner_known) = inner.rim(&local_from_base, pair, 1);
        let local_from_camera = match self.base_from_camera {
            Some(base_from_camera) => local_from_base.times(base_from_camera),
            None => local_from_base,
        };
        let valid = self.valid & outer_known & inner_known;
        ConeFrameRims { local_from_camera, rims: [outer, inner], valid }
    }
}

/// An ellipse in the plane z = 1 of the base frame.
#[derive(Clone, Copy, Debug)]
pub struct PlaneEllipse<T> {
    pub center: Vec2<T>,
    pub semiaxes: Mat2<T>,
    /// As in [`Rim`].
    pub residual_shape: T,
}

impl<T: Lane> PlaneEllipse<T> {
    /// The outer (0) or inner rim (1) in another frame, with information; and where it is an
    /// ellipse there.
    #[inline(always)]
    fn rim(
        &self,
        local_from_base: &Mat3<T>,
        pair: &RimPair<T>,
        number: usize,
    ) -> (Rim<T>, T::Mask) {
        let (center, shape, semiaxes, is_ellipse) = self.in_frame(local_from_base);
        let (mut information, is_informed) =
            Information::of(&pair.rims[number], &pair.noise.rims[number]);
        if number == 1 {
            information = information.weighted_by(&pair.noise.disc);
        }
        let (inverse, regular) = semiaxes.inverse();
        let RimEllipse { semi_major_px, semi_minor_px, .. } = pair.rims[number];
        let area_px2 = semi_major_px * semi_minor_px;
        let radius_m = pair.radii_m[number];
        let residual_shape = self.residual_shape;
        let rim = Rim { radius_m, center, shape, inverse, area_px2, residual_shape, information };
        (rim, is_ellipse & is_informed & regular)
    }

    /// Axis of the cone through the ellipse: the eigenvector of its dual conic that lies inside.
    /// The other eigenvalues are smaller by the square of the ellipse's size, so two iterations of
    /// the power method from the centre find it.
    #[inline(always)]
    fn cone_axis(&self) -> Vec3<T> {
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
    fn in_frame(&self, local_from_base: &Mat3<T>) -> (Vec2<T>, Mat2<T>, Mat2<T>, T::Mask) {
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

impl<T: Lane> ConeFrameRims<T> {
    #[inline(always)]
    pub fn lane(&self, lane: usize) -> ConeFrameRims<f64> {
        ConeFrameRims {
            local_from_camera: self.local_from_camera.lane(lane),
            rims: [self.rims[0].lane(lane), self.rims[1].lane(lane)],
            valid: self.valid.is_set(lane),
        }
    }
}

impl<T: Lane> Rim<T> {
    #[inline(always)]
    fn lane(&self, lane: usize) -> Rim<f64> {
        Rim {
            radius_m: self.radius_m.lane(lane),
            center: self.center.lane(lane),
            shape: self.shape.lane(lane),
            inverse: self.inverse.lane(lane),
            area_px2: self.area_px2.lane(lane),
            residual_shape: self.residual_shape.lane(lane),
            information: self.information.lane(lane),
        }
    }
}

const H: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// cos t of the points …
pub const COS: [f64; POINTS] = [1.0, H, 0.0, -H, -1.0, -H, 0.0, H];
/// … and sin t.
pub const SIN: [f64; POINTS] = [0.0, H, 1.0, H, 0.0, -H, -1.0, -H];
