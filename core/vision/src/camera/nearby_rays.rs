//! Rays of many pixels close to one.
//!
//! The points of a ring are close together, so the derivative at their middle inverts the lens for all of them: with the
//! middle's ray x₀ known exactly and J the derivative of the distortion D there,
//!
//! x ← x + J⁻¹ (m - D(x))
//!
//! reduces the error by ‖J(x) - J‖/‖J‖ per iteration, a thousandth for a small ring in a mild lens. An iteration is a few
//! multiplications per point, the same for all, which the compiler vectorizes. Where it does not converge (a ring half
//! as wide as the image, or at the edge of the lens model), each pixel is solved separately.
//!
//! For `equidistant` the same iteration runs on the angle θ to the axis; sine and cosine follow from the middle's angle
//! by the addition theorem.

use super::{
    Camera, Intrinsics, Lens, LensError, PixelPoint,
    lens::{Planar, equidistant_radius},
};
use crate::simd::{Lane, Mask, Vec2, Vec3};

/// Iterations before each pixel is solved separately.
const MAX_TURNS: usize = 12;
/// Tolerance of a point, as a share of the points' distance from the middle.
const TOLERANCE: f64 = 1e-9;
/// Angles from the middle, radians, beyond which each pixel is solved separately.
const MAX_RAD: f64 = 0.5;

/// Rays close to one, as a structure of arrays: (x, y, 1) for planar models, unit vectors for
/// `equidistant`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearRays<T: Lane, const N: usize> {
    /// Ray of the middle.
    pub middle: Vec3<T>,
    /// Derivatives of the middle's ray by u and v, per pixel.
    pub by_pixel: [Vec3<T>; 2],
    /// x, y and z of all rays.
    pub rays: [[T; N]; 3],
    /// Lanes where the iteration converged; the rays of the others are not valid.
    pub settled: T::Mask,
}

impl Camera {
    /// The rays of the pixels at `offsets_px` from `middle`, in the order of the offsets.
    #[inline(always)]
    pub(crate) fn rays_near<const N: usize>(
        &self,
        middle: Vec2<f64>,
        offsets_px: &[[f64; N]; 2],
    ) -> Result<NearRays<f64, N>, LensError> {
        let mut near = self.rays_near_each(middle, offsets_px);
        if !near.settled {
            let middle = PixelPoint { u: middle.x, v: middle.y };
            let lens = &self.intrinsics.lens;
            let ray = lens.ray(self.reach, &self.to_image(middle))?;
            near.middle = Vec3::new(ray.direction.x, ray.direction.y, ray.direction.z);
            let [by_x, by_y] = ray.by_image;
            let (per_fx, per_fy) = (1.0 / self.intrinsics.fx_px, 1.0 / self.intrinsics.fy_px);
            near.by_pixel = [
                Vec3::new(by_x.x, by_x.y, by_x.z) * per_fx,
                Vec3::new(by_y.x, by_y.y, by_y.z) * per_fy,
            ];
            near.rays = self.rays_one_by_one(middle, offsets_px)?;
        }
        Ok(near)
    }

    /// [`Camera::rays_near`] per lane, without the fallback for lanes that do not converge.
    #[inline(always)]
    pub(crate) fn rays_near_each<T: Lane, const N: usize>(
        &self,
        middle_px: Vec2<T>,
        offsets_px: &[[T; N]; 2],
    ) -> NearRays<T, N> {
        let Intrinsics { fx_px, fy_px, cx_px, cy_px, lens, .. } = &self.intrinsics;
        let (per_fx, per_fy) = (1.0 / fx_px, 1.0 / fy_px);
        let middle = Vec2::new((middle_px.x - *cx_px) * per_fx, (middle_px.y - *cy_px) * per_fy);
        let mut offsets = *offsets_px;
        for i in 0..N {
            offsets[0][i] = offsets_px[0][i] * per_fx;
            offsets[1][i] = offsets_px[1][i] * per_fy;
        }
        let mut near = match (lens.planar(), lens) {
            (Some(planar), _) => self.planar_near(&planar, middle, &offsets),
            (None, Lens::Equidistant(k)) => self.equidistant_near(k, middle, &offsets),
            (None, _) => unreachable!("a lens is planar or equidistant"),
        };
        let [by_x, by_y] = near.by_pixel;
        let one = middle.x.splat(1.0);
        near.by_pixel = [by_x * (one * per_fx), by_y * (one * per_fy)];
        near
    }

    fn rays_one_by_one<const N: usize>(
        &self,
        middle: PixelPoint,
        offsets_px: &[[f64; N]; 2],
    ) -> Result<[[f64; N]; 3], LensError> {
        let mut rays = [[0.0; N]; 3];
        for i in 0..N {
            let pixel =
                PixelPoint { u: middle.u + offsets_px[0][i], v: middle.v + offsets_px[1][i] };
            let ray = self.intrinsics.lens.ray(self.reach, &self.to_image(pixel))?.direction;
            (rays[0][i], rays[1][i], rays[2][i]) = (ray.x, ray.y, ray.z);
        }
        Ok(rays)
    }

    /// Positions in focal lengths, and derivatives by them.
    #[inline(always)]
    fn planar_near<T: Lane, const N: usize>(
        &self,
        lens: &Planar,
        image: Vec2<T>,
        offsets: &[[T; N]; 2],
    ) -> NearRays<T, N> {
        let (point, slope, found) = lens.newton(self.reach, image, image);
        let (inverse, regular) = slope.inverse();
        let (zero, one) = (image.x.splat(0.0), image.x.splat(1.0));
        let mut wanted = *offsets;
        let mut points = *offsets;
        let mut size = zero;
        for i in 0..N {
            let offset = Vec2::new(offsets[0][i], offsets[1][i]);
            let by = inverse * offset;
            (wanted[0][i], wanted[1][i]) = (image.x + offset.x, image.y + offset.y);
            (points[0][i], points[1][i]) = (point.x + by.x, point.y + by.y);
            size = largest(size, by.x.size() + by.y.size());
        }
        let mut settled = settles(
            size,
            found & regular,
            #[inline(always)]
            |open| {
                let mut steps = [zero; N];
                for i in 0..N {
                    let point = Vec2::new(points[0][i], points[1][i]);
                    let (image, ..) = lens.distort(point);
                    let by = inverse * (Vec2::new(wanted[0][i], wanted[1][i]) - image);
                    points[0][i] = T::choose(open, point.x + by.x, point.x);
                    points[1][i] = T::choose(open, point.y + by.y, point.y);
                    steps[i] = by.x.size() + by.y.size();
                }
                let mut max = zero;
                for step in steps {
                    max = largest(max, step);
                }
                max
            },
        );
        let limit = zero.splat(self.reach * self.reach);
        for (x, y) in points[0].iter().zip(&points[1]) {
            let square = *x * *x + *y * *y;
            settled = settled & square.at_most(limit);
        }
        let [by_x, by_y] = inverse.columns();
        NearRays {
            middle: point.push(one),
            by_pixel: [by_x.push(zero), by_y.push(zero)],
            rays: [points[0], points[1], [one; N]],
            settled,
        }
    }

    /// As [`Self::planar_near`]; points too far from the middle do not converge.
    #[inline(always)]
    fn equidistant_near<T: Lane, const N: usize>(
        &self,
        k: &[f64; 4],
        image: Vec2<T>,
        offsets: &[[T; N]; 2],
    ) -> NearRays<T, N> {
        let lens = &self.intrinsics.lens;
        let (zero, one) = (image.x.splat(0.0), image.x.splat(1.0));
        let middle_radius = image.square().root();
        let [angle_rad, slope, sin, cos] = one.each(
            #[inline(always)]
            |lane| match lens.angle(self.reach, middle_radius.lane(lane)) {
                Ok((angle_rad, slope)) => [angle_rad, slope, angle_rad.sin(), angle_rad.cos()],
                Err(_) => [f64::NAN; 4],
            },
        );
        let per_slope = slope.under(1.0);
        let (mut x, mut y, mut radius, mut turned) = (offsets[0], offsets[1], [one; N], [one; N]);
        let mut size = zero;
        for i in 0..N {
            x[i] = image.x + offsets[0][i];
            y[i] = image.y + offsets[1][i];
            radius[i] = (x[i] * x[i] + y[i] * y[i]).root();
            turned[i] = (radius[i] - middle_radius) * per_slope;
            size = largest(size, turned[i].size());
        }
        let mut settled = settles(
            size,
            size.at_most(zero.splat(MAX_RAD)),
            #[inline(always)]
            |open| {
                let mut max = zero;
                for i in 0..N {
                    let (value, _) = equidistant_radius(k, angle_rad + turned[i]);
                    let by = (radius[i] - value) * per_slope;
                    turned[i] = T::choose(open, turned[i] + by, turned[i]);
                    max = largest(max, by.size());
                }
                max
            },
        );
        let mut z = [zero; N];
        // On the axis itself the scale is that of the image.
        let axis = zero.splat(1e-12);
        for i in 0..N {
            let (sin_of, cos_of) = turned[i].sine_and_cosine();
            let across = sin * cos_of + cos * sin_of;
            let scale = T::choose(axis.below(radius[i]), across / radius[i], one);
            x[i] = x[i] * scale;
            y[i] = y[i] * scale;
            z[i] = cos * cos_of - sin * sin_of;
            settled = settled & (angle_rad + turned[i]).below(zero.splat(self.reach));
        }
        let is_aside = axis.below(middle_radius);
        let per_radius = middle_radius.under(1.0);
        let ux = T::choose(is_aside, image.x * per_radius, one);
        let uy = T::choose(is_aside, image.y * per_radius, zero);
        let scale = T::choose(is_aside, sin * per_radius, one);
        let along = Vec3::new(cos * ux, cos * uy, -sin) * per_slope;
        let across = Vec3::new(-uy, ux, zero) * scale;
        NearRays {
            middle: Vec3::new(sin * ux, sin * uy, cos),
            by_pixel: [along * ux - across * uy, along * uy + across * ux],
            rays: [x, y, z],
            settled,
        }
    }

    /// Whether rays are points (x, y, 1) of one plane.
    pub(crate) fn is_planar(&self) -> bool {
        !matches!(self.intrinsics.lens, Lens::Equidistant(_))
    }
}

/// The larger of both; NaN if the second is NaN.
#[inline(always)]
fn largest<T: Lane>(one: T, other: T) -> T {
    T::choose(other.at_most(one), one, other)
}

/// Iterates where `open` until the remaining error, which shrinks as the steps do, is below the
/// tolerance; returns the lanes that converged.
#[inline(always)]
fn settles<T: Lane>(size: T, open: T::Mask, mut turn: impl FnMut(T::Mask) -> T) -> T::Mask {
    let mut before = size;
    let mut open = open;
    let mut settled = open & !open;
    for _ in 0..MAX_TURNS {
        let step = turn(open);
        // A step of at most half the last one leaves at most itself times their ratio.
        let is_last = (step * step).at_most(size * before * TOLERANCE);
        settled = settled | (open & is_last);
        open = open & !is_last & step.at_most(before * 0.5);
        if !open.any() {
            break;
        }
        before = step;
    }
    settled
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::{camera, lenses};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn nearby_rays_equal_single_rays(
            u in 0.0..1279.0f64, v in 0.0..719.0f64, radius_px in 1.0..120.0f64,
        ) {
            for lens in lenses() {
                let camera = camera(lens);
                let middle = PixelPoint { u, v };
                let angles: [f64; 8] = std::array::from_fn(|i| i as f64);
                let offsets = [angles.map(|a| radius_px * a.cos()), angles.map(|a| radius_px * a.sin())];
                let found = camera.rays_near(Vec2::new(u, v), &offsets);
                let exact = camera.rays_one_by_one(middle, &offsets);
                match (found, exact) {
                    (Ok(found), Ok(exact)) => {
                        for (one, other) in found.rays.iter().flatten().zip(exact.iter().flatten()) {
                            let off = (one - other).abs();
                            prop_assert!(off < 1e-8 * radius_px / 700.0, "{lens:?}: {off}");
                        }
                    }
                    (found, exact) => prop_assert!(found.is_err() == exact.is_err(), "{lens:?}"),
                }
            }
        }
    }

    #[test]
    fn rays_near_the_axis_of_a_fisheye_are_regular() {
        let camera = camera(Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]));
        let middle = Vec2::new(647.0, 352.0);
        let offsets = [[-2.0, 0.0], [0.0, 1.0]];
        let found = camera.rays_near(middle, &offsets).unwrap().rays;
        assert!((found[0][0].abs()) < 1e-12 && (found[2][0] - 1.0).abs() < 1e-12);
        assert!(
            (found[0][1] - 2.0 / 700.0).abs() < 1e-7 && (found[1][1] - 1.0 / 710.0).abs() < 1e-7
        );
    }
}
