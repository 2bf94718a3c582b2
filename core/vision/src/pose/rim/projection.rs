//! Rims taken through the lens.
//!
//! A rim is sampled at points c + a cos t + b sin t, t evenly spaced, with the semiaxes a and b as
//! vectors. A slightly different ellipse crosses the line from the centre through such a point at 1 + q(t)
//! times its distance. To first order q = ψ·h with five harmonics, ψ = (1, √2 cos t, √2 sin
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
    lens_iteration,
    lens_series::LensSeries,
    plane_ellipse::{COS, POINTS, PlaneEllipse, SIN, linearized_lens, plane_points},
    rim_pair::{RimEllipse, RimPair},
};
use crate::{
    camera::{Camera, LensError},
    pose::PoseError,
    simd::{Lane, Mask, Mat2, Mat3, Vec2, Vec3, lane_by_field},
};

/// A rim in the plane z = 1 of a local frame.
#[derive(Clone, Copy, Debug)]
pub struct Rim<T> {
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
    pub information: Information<T>,
}

lane_by_field!(Rim { radius_m, center, shape, inverse, area_px2, residual_shape, information });

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
    let (bend, bent_little) = LensSeries::new(&points, middle, semiaxes);
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
    let outer = lens_iteration::fit(&near, 0, pair, &base_from_camera);
    let inner = lens_iteration::fit(&near, 1, pair, &base_from_camera);
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
            Information::new(&pair.rims[number], &pair.noise.rims[number]);
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
