//! Lens distortion: where a ray through the camera's centre meets the image, in focal lengths.
//!
//! With (x, y, z) in the camera frame, x' = x/z, y' = y/z and r² = x'² + y'²:
//!
//! - `plumb_bob` and `rational_polynomial` (Brown; OpenCV's `projectPoints`):
//!   x″ = x' g(r²) + 2 p₁ x' y' + p₂ (r² + 2 x'²), y″ = y' g(r²) + p₁ (r² + 2 y'²) + 2 p₂ x' y', where
//!   g(s) = (1 + k₁ s + k₂ s² + k₃ s³) / (1 + k₄ s + k₅ s² + k₆ s³), k₄ to k₆ zero for `plumb_bob`;
//! - `equidistant` (Kannala and Brandt 2006; OpenCV's `fisheye`): with θ the angle to the optical
//!   axis, (x″, y″) = (x, y)/√(x² + y²) · θ (1 + k₁ θ² + k₂ θ⁴ + k₃ θ⁶ + k₄ θ⁸). Valid beyond 90°.
//!
//! Outside the image they were fitted to, polynomials turn back and two rays share one pixel. Each lens therefore has a
//! *reach*, the radius (or angle) up to which the image radius is strictly increasing; nothing is projected beyond it.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use super::LensError;
use crate::simd::{Lane, Mask, Mat2, Vec2};

/// A distortion model with its coefficients, named and ordered as in ROS' `camera_info`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// `plumb_bob`: k1 k2 p1 p2 k3.
    PlumbBob([f64; 5]),
    /// `rational_polynomial`: k1 k2 p1 p2 k3 k4 k5 k6.
    Rational([f64; 8]),
    /// `equidistant`: k1 k2 k3 k4 (Kannala-Brandt).
    Equidistant([f64; 4]),
}

/// Steps in which the angle from the axis is scanned for the reach.
const REACH_STEPS: usize = 4096;
/// Largest angle from the axis of a planar model (x/z), radians (89.9°).
const PLANAR_LIMIT_RAD: f64 = 1.569_051_0;
/// Newton steps before giving up; four or five usually suffice.
const MAX_STEPS: usize = 60;
/// Newton's method stops at a step this small, relative to the point: convergence is quadratic, so
/// the point is then exact to rounding.
const STEP_TOLERANCE: f64 = 1e-9;

impl Lens {
    /// The model with this ROS name and coefficients in ROS' order; `plumb_bob` may omit k3. `None`
    /// for an unknown name or a wrong number of coefficients.
    pub fn from_ros(name: &str, coefficients: &[f64]) -> Option<Self> {
        match (name, coefficients) {
            ("plumb_bob", &[k1, k2, p1, p2]) => Some(Self::PlumbBob([k1, k2, p1, p2, 0.0])),
            ("plumb_bob", k) => k.try_into().ok().map(Self::PlumbBob),
            ("rational_polynomial", k) => k.try_into().ok().map(Self::Rational),
            ("equidistant" | "fisheye", k) => k.try_into().ok().map(Self::Equidistant),
            _ => None,
        }
    }

    /// ROS' name of the model.
    pub fn name(&self) -> &'static str {
        match self {
            Lens::PlumbBob(_) => "plumb_bob",
            Lens::Rational(_) => "rational_polynomial",
            Lens::Equidistant(_) => "equidistant",
        }
    }

    /// The coefficients in ROS' order.
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Lens::PlumbBob(k) => k,
            Lens::Rational(k) => k,
            Lens::Equidistant(k) => k,
        }
    }

    /// Radius up to which the image radius increases: r = tan θ for the planar models, θ in radians
    /// (at most π) for `equidistant`.
    pub(super) fn reach(&self) -> f64 {
        let limit_rad = match self {
            Lens::Equidistant(_) => std::f64::consts::PI,
            _ => PLANAR_LIMIT_RAD,
        };
        let radius = |angle_rad: f64| match self {
            Lens::Equidistant(_) => angle_rad,
            _ => angle_rad.tan(),
        };
        let grows = |angle_rad: f64| self.radial(radius(angle_rad)).is_some_and(|(_, d)| d > 0.0);
        let step_rad = limit_rad / REACH_STEPS as f64;
        for step in 1..=REACH_STEPS {
            let mut beyond = step as f64 * step_rad;
            if grows(beyond) {
                continue;
            }
            let mut within = (step - 1) as f64 * step_rad;
            for _ in 0..52 {
                let middle = 0.5 * (within + beyond);
                if grows(middle) { within = middle } else { beyond = middle }
            }
            return radius(within);
        }
        radius(limit_rad)
    }

    /// The distorted radius and its derivative at radius r (planar) or angle θ (equidistant), without
    /// tangential terms; `None` past a pole.
    fn radial(&self, radius: f64) -> Option<(f64, f64)> {
        match self {
            Lens::Equidistant(k) => Some(equidistant_radius(k, radius)),
            _ => {
                let s = radius * radius;
                let (g, dg_ds, is_known) = self.planar()?.gain(s);
                is_known.then_some((radius * g, g + 2.0 * s * dg_ds))
            }
        }
    }

    /// The planar model's coefficients; `None` for `equidistant`.
    pub(super) fn planar(&self) -> Option<Planar> {
        match *self {
            Lens::PlumbBob([k1, k2, p1, p2, k3]) => {
                Some(Planar { above: [k1, k2, k3], below: None, p1, p2 })
            }
            Lens::Rational([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                Some(Planar { above: [k1, k2, k3], below: Some([k4, k5, k6]), p1, p2 })
            }
            Lens::Equidistant(_) => None,
        }
    }

    /// Where the ray through `point` meets the image, in focal lengths, with the derivative by the
    /// point.
    pub(super) fn project(
        &self,
        reach: f64,
        point: &Vector3<f64>,
    ) -> Result<(Vector2<f64>, Matrix2x3<f64>), LensError> {
        if !(point.x.is_finite() && point.y.is_finite() && point.z.is_finite()) {
            return Err(LensError::NotFinite);
        }
        if let Lens::Equidistant(_) = self {
            return self.project_equidistant(reach, point);
        }
        if point.z <= 0.0 {
            return Err(LensError::Behind);
        }
        let inverse_z = 1.0 / point.z;
        let normalized = Vector2::new(point.x * inverse_z, point.y * inverse_z);
        let (image, slope) = self.distort(reach, &normalized)?;
        let along_z = -(slope * normalized) * inverse_z;
        let planar = slope * inverse_z;
        Ok((
            image,
            Matrix2x3::new(
                planar.m11, planar.m12, along_z.x, //
                planar.m21, planar.m22, along_z.y,
            ),
        ))
    }

    /// Distorts a point of the plane z = 1, with the derivative; planar models only.
    fn distort(
        &self,
        reach: f64,
        point: &Vector2<f64>,
    ) -> Result<(Vector2<f64>, Matrix2<f64>), LensError> {
        let planar = self.planar().ok_or(LensError::Outside)?;
        if point.norm_squared() > reach * reach {
            return Err(LensError::Outside);
        }
        let (image, slope, is_known) = planar.distort(Vec2::new(point.x, point.y));
        // Tangential terms can fold the image within the radial reach.
        if !is_known || slope.determinant() <= 0.0 {
            return Err(LensError::Outside);
        }
        Ok((image.into(), slope.into()))
    }

    fn project_equidistant(
        &self,
        reach: f64,
        point: &Vector3<f64>,
    ) -> Result<(Vector2<f64>, Matrix2x3<f64>), LensError> {
        let rho = point.x.hypot(point.y);
        let angle_rad = rho.atan2(point.z);
        if rho == 0.0 && point.z <= 0.0 {
            return Err(LensError::Behind);
        }
        if angle_rad >= reach {
            return Err(LensError::Outside);
        }
        let (image_radius, slope) = self.radial(angle_rad).ok_or(LensError::Outside)?;
        let distance_squared = rho * rho + point.z * point.z;
        let (ux, uy) = if rho > 0.0 { (point.x / rho, point.y / rho) } else { (1.0, 0.0) };
        // Across the radius the image scales by image_radius / rho, along it by the slope times dθ/dρ.
        let across = if rho > 0.0 { image_radius / rho } else { 1.0 / point.z };
        let along = slope * point.z / distance_squared;
        let by_z = -slope * rho / distance_squared;
        let mixed = (along - across) * ux * uy;
        Ok((
            Vector2::new(ux * image_radius, uy * image_radius),
            Matrix2x3::new(
                across + (along - across) * ux * ux,
                mixed,
                by_z * ux,
                mixed,
                across + (along - across) * uy * uy,
                by_z * uy,
            ),
        ))
    }

    /// A vector along the ray that meets the image at `image` (in focal lengths), with its derivative
    /// by the image point: (x', y', 1) for planar models, a unit vector for `equidistant`.
    pub(super) fn ray(&self, reach: f64, image: &Vector2<f64>) -> Result<Ray, LensError> {
        if !(image.x.is_finite() && image.y.is_finite()) {
            return Err(LensError::NotFinite);
        }
        match self.planar() {
            Some(planar) => {
                let (point, slope) = self.undistort_planar(&planar, reach, image)?;
                let inverse = slope.try_inverse().ok_or(LensError::Outside)?;
                Ok(Ray {
                    direction: point.push(1.0),
                    by_image: [inverse.column(0).push(0.0), inverse.column(1).push(0.0)],
                })
            }
            None => self.ray_equidistant(reach, image),
        }
    }

    /// The angle to the axis, radians, at which the image has this radius, with the derivative of the
    /// radius there; `equidistant` only.
    pub(super) fn angle(&self, reach: f64, image_radius: f64) -> Result<(f64, f64), LensError> {
        if !image_radius.is_finite() {
            return Err(LensError::NotFinite);
        }
        let angle_rad = if image_radius == 0.0 {
            0.0
        } else {
            self.invert_radial(reach, image_radius).ok_or(LensError::Outside)?
        };
        let slope = self.radial(angle_rad).ok_or(LensError::Outside)?.1;
        if slope <= 0.0 || angle_rad >= reach {
            return Err(LensError::Outside);
        }
        Ok((angle_rad, slope))
    }

    /// Newton's method on both coordinates, started at the distorted point; if that fails, at the
    /// exact inverse of the radial model.
    fn undistort_planar(
        &self,
        planar: &Planar,
        reach: f64,
        image: &Vector2<f64>,
    ) -> Result<(Vector2<f64>, Matrix2<f64>), LensError> {
        let newton = |start: &Vector2<f64>| {
            let start = Vec2::new(start.x, start.y);
            let (point, slope, is_found) = planar.newton(reach, start, Vec2::new(image.x, image.y));
            is_found.then(|| (point.into(), slope.into()))
        };
        if let Some(found) = newton(image) {
            return Ok(found);
        }
        let image_radius = image.norm();
        // Slightly outside the radial image, the tangential terms may still reach the point.
        let radius = self.invert_radial(reach, image_radius).unwrap_or(0.999 * reach);
        let start = image * (radius / image_radius);
        newton(&start).ok_or(LensError::Outside)
    }

    /// The radius (or angle) within the reach whose distorted radius is `image_radius`.
    fn invert_radial(&self, reach: f64, image_radius: f64) -> Option<f64> {
        let (mut low, mut high) = (0.0, reach);
        if self.radial(reach)?.0 < image_radius {
            return None;
        }
        let mut radius = image_radius.min(reach);
        for _ in 0..2 * MAX_STEPS {
            let (value, slope) = self.radial(radius)?;
            if value < image_radius {
                low = radius
            } else {
                high = radius
            }
            let step = (image_radius - value) / slope;
            let mut next = radius + step;
            // Newton's method leaves the bracket only where the curve is nearly flat: bisect there.
            if !(next >= low && next <= high) {
                next = 0.5 * (low + high);
            }
            let moved = (next - radius).abs();
            radius = next;
            if moved <= STEP_TOLERANCE * radius && step.abs() <= STEP_TOLERANCE * radius
                || moved <= 1e-15 * radius
            {
                // One more quadratic step from within the tolerance is exact to rounding.
                let (value, slope) = self.radial(radius)?;
                return Some((radius + (image_radius - value) / slope).clamp(low, high));
            }
        }
        None
    }

    fn ray_equidistant(&self, reach: f64, image: &Vector2<f64>) -> Result<Ray, LensError> {
        let image_radius = image.norm();
        if image_radius == 0.0 {
            return Ok(Ray { direction: Vector3::z(), by_image: [Vector3::x(), Vector3::y()] });
        }
        let (angle_rad, slope) = self.angle(reach, image_radius)?;
        let (sin, cos) = angle_rad.sin_cos();
        let (ux, uy) = (image.x / image_radius, image.y / image_radius);
        let along = Vector3::new(cos * ux, cos * uy, -sin) / slope;
        let across = Vector3::new(-uy, ux, 0.0) * (sin / image_radius);
        Ok(Ray {
            direction: Vector3::new(sin * ux, sin * uy, cos),
            by_image: [along * ux - across * uy, along * uy + across * ux],
        })
    }
}

/// Radius of the image at an angle to the axis, in focal lengths, and its derivative.
#[inline(always)]
pub(super) fn equidistant_radius<T: Lane>(k: &[f64; 4], angle_rad: T) -> (T, T) {
    let [k1, k2, k3, k4] = *k;
    let s = angle_rad * angle_rad;
    let scale = s * (s * (s * (s * k4 + k3) + k2) + k1) + 1.0;
    let slope = s * (s * (s * (s * (9.0 * k4) + 7.0 * k3) + 5.0 * k2) + 3.0 * k1) + 1.0;
    (angle_rad * scale, slope)
}

/// A direction, with its derivative by the image point, in focal lengths.
pub(super) struct Ray {
    pub direction: Vector3<f64>,
    pub by_image: [Vector3<f64>; 2],
}

/// Coefficients of the models that distort the plane z = 1.
pub(super) struct Planar {
    pub above: [f64; 3],
    pub below: Option<[f64; 3]>,
    pub p1: f64,
    pub p2: f64,
}

impl Planar {
    /// g(s) and dg/ds, and the lanes before any pole.
    #[inline(always)]
    fn gain<T: Lane>(&self, s: T) -> (T, T, T::Mask) {
        let [k1, k2, k3] = self.above;
        let value = s * (s * (s * k3 + k2) + k1) + 1.0;
        let slope = s * (s * (3.0 * k3) + 2.0 * k2) + k1;
        let Some([k4, k5, k6]) = self.below else {
            return (value, slope, s.at_most(s));
        };
        let below = s * (s * (s * k6 + k5) + k4) + 1.0;
        let per_below = below.under(1.0);
        let gain = value * per_below;
        let slope = (slope - gain * (s * (s * (3.0 * k6) + 2.0 * k5) + k4)) * per_below;
        (gain, slope, below.is_positive())
    }

    /// The distorted point and its derivative, and the lanes where they exist.
    #[inline(always)]
    pub fn distort<T: Lane>(&self, point: Vec2<T>) -> (Vec2<T>, Mat2<T>, T::Mask) {
        let Vec2 { x, y } = point;
        let (xx, xy, yy) = (x * x, x * y, y * y);
        let s = xx + yy;
        let (g, dg_ds, is_known) = self.gain(s);
        let mixed = (xy * dg_ds + x * self.p1 + y * self.p2) * 2.0;
        let image = Vec2::new(
            x * g + xy * (2.0 * self.p1) + (s + xx * 2.0) * self.p2,
            y * g + (s + yy * 2.0) * self.p1 + xy * (2.0 * self.p2),
        );
        let slope = Mat2::new(
            g + xx * dg_ds * 2.0 + y * (2.0 * self.p1) + x * (6.0 * self.p2),
            mixed,
            mixed,
            g + yy * dg_ds * 2.0 + y * (6.0 * self.p1) + x * (2.0 * self.p2),
        );
        (image, slope, is_known)
    }

    /// The point within the reach that distorts to `image`, with the derivative there, and the
    /// lanes where it was found.
    #[inline(always)]
    pub(super) fn newton<T: Lane>(
        &self,
        reach: f64,
        start: Vec2<T>,
        image: Vec2<T>,
    ) -> (Vec2<T>, Mat2<T>, T::Mask) {
        let limit = image.x.splat(reach * reach);
        let (mut point, mut slope) = (start, Mat2::new(limit, limit, limit, limit));
        let mut open = point.square().at_most(limit);
        let mut found = open & !open;
        for _ in 0..MAX_STEPS {
            let (value, at, is_known) = self.distort(point);
            let determinant = at.determinant();
            open = open & is_known & determinant.is_positive();
            let miss = image - value;
            let per_determinant = determinant.under(1.0);
            let step =
                Vec2::new(at.m22 * miss.x - at.m12 * miss.y, at.m11 * miss.y - at.m21 * miss.x)
                    * per_determinant;
            point = Vec2::choose(open, point + step, point);
            slope = Mat2::choose(open, at, slope);
            let square = point.square();
            let is_last = step.square().at_most((square + 1.0) * (STEP_TOLERANCE * STEP_TOLERANCE));
            open = open & square.at_most(limit);
            found = found | (open & is_last);
            open = open & !is_last;
            if !open.any() {
                break;
            }
        }
        (point, slope, found)
    }
}
