//! Rays of many pixels that lie near one.
//!
//! A ring's points are near each other, so that the derivative at their middle inverts the lens for all
//! of them: with the middle's ray x₀ known exactly and J the derivative of the distortion D there,
//!
//! x ← x + J⁻¹ (m - D(x))
//!
//! gains the factor ‖J(x) - J‖/‖J‖ a turn, a thousandth for a small ring in a mild lens, and a turn is a
//! few multiplications a point, alike for all, which compilers turn into vector instructions. Where it
//! does not settle (a ring half of the image wide, or at the lens model's end), each pixel is solved for
//! itself.
//!
//! For `equidistant` the same is done for the angle θ to the axis alone, and its sine and cosine are
//! those of the middle's angle turned by the small difference.

use nalgebra::{Matrix2, Vector3};

use super::{Camera, Lens, LensError, PixelPoint};

/// Turns before each pixel is solved for itself.
const MAX_TURNS: usize = 12;
/// What a point may be off, as a share of the points' distance from the middle.
const TOLERANCE: f64 = 1e-9;
/// Angles from the middle, radians, up to which the series of sine and cosine are exact to 1e-11.
const SERIES_RAD: f64 = 0.5;

/// Rays near one, structure of arrays: (x, y, 1) for planar models, unit vectors for `equidistant`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearRays<const N: usize> {
    /// Of the middle.
    pub middle: Vector3<f64>,
    /// Derivatives of the middle's by u and v, per pixel.
    pub by_pixel: [Vector3<f64>; 2],
    /// x, y and z of all of them.
    pub rays: [[f64; N]; 3],
}

impl Camera {
    /// The rays of the pixels at `offsets_px` from `middle`, in the order of the offsets.
    #[inline(always)]
    pub(crate) fn rays_near<const N: usize>(
        &self,
        middle: PixelPoint,
        offsets_px: &[[f64; N]; 2],
    ) -> Result<NearRays<N>, LensError> {
        let (mut near, settled) = match self.intrinsics.lens {
            Lens::Equidistant(coefficients) => {
                self.equidistant_near(&coefficients, middle, offsets_px)?
            }
            _ => self.planar_near(middle, offsets_px)?,
        };
        if !settled {
            near.rays = self.rays_one_by_one(middle, offsets_px)?;
        }
        Ok(near)
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

    /// With whether the turns settle: where not, the rays are not yet right.
    #[inline(always)]
    fn planar_near<const N: usize>(
        &self,
        middle: PixelPoint,
        offsets_px: &[[f64; N]; 2],
    ) -> Result<(NearRays<N>, bool), LensError> {
        let lens = &self.intrinsics.lens;
        let image = self.to_image(middle);
        let (point, slope) = lens.undistorted(self.reach, &image)?;
        let inverse = slope.try_inverse().ok_or(LensError::Outside)?;
        let ([mut x, mut y], mut wanted_x, mut wanted_y) = ([[0.0; N]; 2], [0.0; N], [0.0; N]);
        let (per_fx, per_fy) = (1.0 / self.intrinsics.fx_px, 1.0 / self.intrinsics.fy_px);
        let mut size: f64 = 0.0;
        for i in 0..N {
            let (dx, dy) = (offsets_px[0][i] * per_fx, offsets_px[1][i] * per_fy);
            (wanted_x[i], wanted_y[i]) = (image.x + dx, image.y + dy);
            let (dx, dy) =
                (inverse.m11 * dx + inverse.m12 * dy, inverse.m21 * dx + inverse.m22 * dy);
            (x[i], y[i]) = (point.x + dx, point.y + dy);
            size = largest(size, dx.abs() + dy.abs());
        }
        let settled = settles(
            size,
            #[inline(always)]
            || planar_turn(lens, &inverse, (&wanted_x, &wanted_y), &mut x, &mut y),
        );
        let limit = self.reach * self.reach;
        let inside = (0..N).fold(true, |inside, i| inside & (x[i] * x[i] + y[i] * y[i] <= limit));
        let near = NearRays {
            middle: point.push(1.0),
            by_pixel: [inverse.column(0).push(0.0) * per_fx, inverse.column(1).push(0.0) * per_fy],
            rays: [x, y, [1.0; N]],
        };
        Ok((near, settled && inside))
    }

    /// As [`Self::planar_near`]; also where the series do not reach it has not settled.
    #[inline(always)]
    fn equidistant_near<const N: usize>(
        &self,
        k: &[f64; 4],
        middle: PixelPoint,
        offsets_px: &[[f64; N]; 2],
    ) -> Result<(NearRays<N>, bool), LensError> {
        let image = self.to_image(middle);
        let middle_radius = image.norm();
        let (angle_rad, slope) = self.intrinsics.lens.angle(self.reach, middle_radius)?;
        let per_slope = 1.0 / slope;
        let (per_fx, per_fy) = (1.0 / self.intrinsics.fx_px, 1.0 / self.intrinsics.fy_px);
        let (mut x, mut y, mut radius, mut turned) = ([0.0; N], [0.0; N], [0.0; N], [0.0; N]);
        let mut size: f64 = 0.0;
        for i in 0..N {
            x[i] = image.x + offsets_px[0][i] * per_fx;
            y[i] = image.y + offsets_px[1][i] * per_fy;
            radius[i] = (x[i] * x[i] + y[i] * y[i]).sqrt();
            turned[i] = (radius[i] - middle_radius) * per_slope;
            size = largest(size, turned[i].abs());
        }
        let settled = size <= SERIES_RAD
            && settles(
                size,
                #[inline(always)]
                || {
                    let mut most: f64 = 0.0;
                    for i in 0..N {
                        let angle = angle_rad + turned[i];
                        let s = angle * angle;
                        let value = angle * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))));
                        let by = (radius[i] - value) * per_slope;
                        turned[i] += by;
                        most = largest(most, by.abs());
                    }
                    most
                },
            );
        let (sin, cos) = angle_rad.sin_cos();
        let mut z = [0.0; N];
        let mut inside = true;
        for i in 0..N {
            let (sin_of, cos_of) = small_sin_cos(turned[i]);
            let across = sin * cos_of + cos * sin_of;
            // At the very axis the image is the ray's own scale.
            let scale = if radius[i] > 1e-12 { across / radius[i] } else { 1.0 };
            x[i] *= scale;
            y[i] *= scale;
            z[i] = cos * cos_of - sin * sin_of;
            inside &= angle_rad + turned[i] < self.reach;
        }
        let (ux, uy, scale) = if middle_radius > 1e-12 {
            (image.x / middle_radius, image.y / middle_radius, sin / middle_radius)
        } else {
            (1.0, 0.0, 1.0)
        };
        let along = Vector3::new(cos * ux, cos * uy, -sin) * per_slope;
        let across = Vector3::new(-uy, ux, 0.0) * scale;
        let near = NearRays {
            middle: Vector3::new(sin * ux, sin * uy, cos),
            by_pixel: [(along * ux - across * uy) * per_fx, (along * uy + across * ux) * per_fy],
            rays: [x, y, z],
        };
        Ok((near, settled && inside))
    }

    /// Whether rays are points (x, y, 1) of one plane.
    pub(crate) fn is_planar(&self) -> bool {
        !matches!(self.intrinsics.lens, Lens::Equidistant(_))
    }
}

/// One turn for all points; the largest step.
#[inline(always)]
fn planar_turn<const N: usize>(
    lens: &Lens,
    inverse: &Matrix2<f64>,
    (wanted_x, wanted_y): (&[f64; N], &[f64; N]),
    x: &mut [f64; N],
    y: &mut [f64; N],
) -> f64 {
    let (above, below, p1, p2) = match *lens {
        Lens::PlumbBob([k1, k2, p1, p2, k3]) => ([k1, k2, k3], [0.0; 3], p1, p2),
        Lens::Rational([k1, k2, p1, p2, k3, k4, k5, k6]) => ([k1, k2, k3], [k4, k5, k6], p1, p2),
        Lens::Equidistant(_) => return f64::INFINITY,
    };
    let divides = below != [0.0; 3];
    let mut gains = [0.0; N];
    for i in 0..N {
        let s = x[i] * x[i] + y[i] * y[i];
        gains[i] = 1.0 + s * (above[0] + s * (above[1] + s * above[2]));
    }
    if divides {
        for i in 0..N {
            let s = x[i] * x[i] + y[i] * y[i];
            gains[i] /= 1.0 + s * (below[0] + s * (below[1] + s * below[2]));
        }
    }
    let mut steps = [0.0; N];
    for i in 0..N {
        let (px, py) = (x[i], y[i]);
        let s = px * px + py * py;
        let miss_x = wanted_x[i] - px * gains[i] - 2.0 * p1 * px * py - p2 * (s + 2.0 * px * px);
        let miss_y = wanted_y[i] - py * gains[i] - p1 * (s + 2.0 * py * py) - 2.0 * p2 * px * py;
        let dx = inverse.m11 * miss_x + inverse.m12 * miss_y;
        let dy = inverse.m21 * miss_x + inverse.m22 * miss_y;
        x[i] = px + dx;
        y[i] = py + dy;
        steps[i] = dx.abs() + dy.abs();
    }
    steps.iter().fold(0.0, |most, &step| largest(most, step))
}

/// The larger one; not a number if the second is not.
#[inline(always)]
fn largest(one: f64, other: f64) -> f64 {
    if other <= one { one } else { other }
}

/// Turns until the error left, which shrinks as the steps do, is below the tolerance.
#[inline(always)]
fn settles(size: f64, mut turn: impl FnMut() -> f64) -> bool {
    let mut before = size;
    for _ in 0..MAX_TURNS {
        let step = turn();
        // A step of at most half the last one leaves at most itself times their ratio.
        if step * step <= TOLERANCE * size * before {
            return true;
        }
        if step.is_nan() || step > 0.5 * before {
            return false;
        }
        before = step;
    }
    false
}

/// Sine and cosine of an angle of up to [`SERIES_RAD`].
#[inline(always)]
fn small_sin_cos(angle: f64) -> (f64, f64) {
    let s = angle * angle;
    let sin = 1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0)));
    let cos =
        1.0 - s / 2.0 * (1.0 - s / 12.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0 * (1.0 - s / 90.0))));
    (angle * sin, cos)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use proptest::prelude::*;

    fn camera(lens: Lens) -> Camera {
        Camera::new(Intrinsics {
            width: 1280,
            height: 720,
            fx_px: 700.0,
            fy_px: 710.0,
            cx_px: 645.0,
            cy_px: 352.0,
            lens,
        })
        .unwrap()
    }

    proptest! {
        #[test]
        fn near_rays_are_the_pixels_own(
            u in 0.0..1279.0f64, v in 0.0..719.0f64, radius_px in 1.0..120.0f64,
        ) {
            for lens in [
                Lens::PlumbBob([0.0; 5]),
                Lens::PlumbBob([-0.28, 0.09, 0.0012, -0.0008, -0.012]),
                Lens::PlumbBob([0.35, 0.12, -0.002, 0.003, 0.05]),
                Lens::Rational([8.1, 5.2, 0.0004, -0.0002, 0.21, 8.4, 8.0, 1.3]),
                Lens::Equidistant([0.0; 4]),
                Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]),
            ] {
                let camera = camera(lens);
                let middle = PixelPoint { u, v };
                let angles: [f64; 8] = std::array::from_fn(|i| i as f64);
                let offsets = [angles.map(|a| radius_px * a.cos()), angles.map(|a| radius_px * a.sin())];
                let found = camera.rays_near(middle, &offsets);
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
    fn the_axis_of_a_fisheye_is_no_hole() {
        let camera = camera(Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]));
        let middle = PixelPoint { u: 647.0, v: 352.0 };
        let offsets = [[-2.0, 0.0], [0.0, 1.0]];
        let found = camera.rays_near(middle, &offsets).unwrap().rays;
        assert!((found[0][0].abs()) < 1e-12 && (found[2][0] - 1.0).abs() < 1e-12);
        assert!(
            (found[0][1] - 2.0 / 700.0).abs() < 1e-7 && (found[1][1] - 1.0 / 710.0).abs() < 1e-7
        );
    }
}
