//! Rims carried through the lens, and what is known of their errors.
//!
//! A rim is taken at points c + a cos t + b sin t, t evenly spaced, with the semiaxes a and b as
//! vectors. Another, slightly different ellipse crosses the line from the centre through such a point
//! at 1 + q(t) times its distance, and to first order q = ψ·h with only five harmonics,
//! ψ = (1, √2 cos t, √2 sin t, √2 cos 2t, √2 sin 2t): size, shift along either axis, elongation and
//! turn. Five numbers h therefore say all there is to say of a rim, and h = mean(ψ q), the mean over
//! evenly spaced t, is just what the moments of a rim's area measure. (An area's change is ½∮q r×dr =
//! ½ab∮q dt, and its first and second moments' are the other harmonics.) Affine maps keep t and h.
//!
//! Where the lens bends a rim little, the ellipse follows in closed form ([`super::bend`]); else by turns:
//! eight points go through the lens ([`Camera::rays_near`]). Of their images y, the zeroth and first
//! harmonics over t are the affine part of the lens there, averaged over the rim; in its coordinates y
//! is nearly u = (cos t, sin t). The lens takes the line s u from the rim's centre to
//! y(s) = y₀ + s P₁ + s² P₂ + s³ P₃, of which the middle's ray gives y₀ and P₁, and y at t and t + π the
//! even and the odd part: so dy/ds at the rim is known too, and with it where the line crosses another
//! ellipse, q = (1 - |y|)/(y/|y| · dy/ds) before the unit circle. The ellipse that is sought is the
//! unit circle changed so that mean(ψ q) = 0, found by a few turns. Where the lens adds nothing, q is zero
//! and the ellipse exact.
//!
//! The ellipse with centre c and semiaxes A = (a b), in homogeneous coordinates, is the *dual conic*
//! D = (c cᵀ - A Aᵀ, c; cᵀ, 1), the set of its tangents l, lᵀ D l = 0. It turns with the frame:
//! D → R D Rᵀ.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::{PoseError, RingNoise, bend::Bend};
use crate::{
    camera::{Camera, LensError, NearRays, PixelPoint},
    ellipse::Ellipse,
    marker::Ring,
};

/// Points on a rim. Five harmonics need at least five; eight keep those that a lens adds, up to the
/// fifth, from being mistaken for them.
pub const POINTS: usize = 8;
/// Turns, at most, in which the ellipse through the points is found …
const TURNS: usize = 8;
/// … and what a turn that moves it by no more than this leaves is nothing: it gains two digits.
const SETTLED: f64 = 1e-6;

/// The floor's share of centre, elongation and turn: blur and bloom are nearly even around a rim.
const REST_OF_FLOOR: f64 = 0.25;

/// Five numbers of a rim.
pub type Harmonics = [f64; 5];

/// A rim in the plane z = 1 of a local frame.
#[derive(Clone, Copy, Debug)]
pub struct Rim {
    /// The circle's radius, metres.
    pub radius_m: f64,
    /// Centre of the ellipse.
    pub center: Vector2<f64>,
    /// A Aᵀ.
    pub shape: Matrix2<f64>,
    /// A⁻¹, but for perspective's second order.
    pub inverse: Matrix2<f64>,
    /// Of its five numbers.
    pub information: Information,
}

/// Inverse covariance of a rim's five numbers; what is not here is zero.
#[derive(Clone, Copy, Debug)]
pub struct Information {
    pub size: f64,
    pub size_and_elongation: f64,
    pub elongation: f64,
    pub along: f64,
    pub across: f64,
    pub turn: f64,
}

impl Information {
    /// With elongation and turn unknown.
    fn without_shape(&self) -> Self {
        let size = self.size - self.size_and_elongation.powi(2) / self.elongation;
        Self { size, size_and_elongation: 0.0, elongation: 0.0, turn: 0.0, ..*self }
    }
}

/// Both rims, outer and inner, with the rows of the frame that they are in: its z is the axis of the
/// outer rim's cone, so that a circle of which the rim is an image lies on it up to its tilt.
#[inline(always)]
pub fn carry(
    camera: &Camera,
    ring: &Ring,
    radii_m: [f64; 2],
    noise: &RingNoise,
) -> Result<(Matrix3<f64>, [Rim; 2]), PoseError> {
    let (base_from_camera, [outer, inner]) = match flat_closed(camera, ring) {
        Some(both) => both,
        None => flat_by_turns(camera, ring)?,
    };
    let local_from_base = frame_along(&outer.cone_axis());
    let outer = outer.rim(&local_from_base, &ring.outer, radii_m[0], noise);
    let inner = inner.rim(&local_from_base, &ring.inner, radii_m[1], noise);
    match (outer, inner) {
        (Some(outer), Some(mut inner)) => {
            if !noise.round_disc {
                inner.information = inner.information.without_shape();
            }
            Ok((local_from_base * base_from_camera, [outer, inner]))
        }
        _ => Err(PoseError::NoCircle),
    }
}

/// Both rims in the plane z = 1 of a base frame, with its rows, if the lens bends them little.
#[inline(always)]
pub fn flat_closed(camera: &Camera, ring: &Ring) -> Option<(Matrix3<f64>, [Flat; 2])> {
    let outer = &ring.outer;
    let near = camera.rays_near(outer.center, &points(outer, outer.center)).ok()?;
    let base_from_camera = base(camera, &near.middle);
    let (middle, semiaxes) = line(&near, outer.center, outer, &base_from_camera);
    let points = plane_points(&near.rays, &base_from_camera, camera.is_planar())?;
    let bend = Bend::of(&points, middle, semiaxes)?;
    Some((base_from_camera, [bend.outer(), bend.inner(outer, &ring.inner)]))
}

/// The same for any lens.
#[inline(always)]
pub fn flat_by_turns(camera: &Camera, ring: &Ring) -> Result<(Matrix3<f64>, [Flat; 2]), PoseError> {
    let near = match camera.rays_near(ring.outer.center, &offsets(ring)) {
        Ok(near) => near,
        Err(source) => return Err(PoseError::Lens { rim: refused(camera, ring), source }),
    };
    let base_from_camera = base(camera, &near.middle);
    let outer = Flat::through(&near, 0, ring, &base_from_camera);
    let inner = Flat::through(&near, 1, ring, &base_from_camera);
    let behind = |rim| PoseError::Lens { rim, source: LensError::Behind };
    let (outer, inner) = (outer.ok_or(behind("outer"))?, inner.ok_or(behind("inner"))?);
    Ok((base_from_camera, [outer, inner]))
}

/// Rays of planar models are points of one plane, in which a lens without distortion is linear.
#[inline(always)]
fn base(camera: &Camera, middle: &Vector3<f64>) -> Matrix3<f64> {
    if camera.is_planar() { Matrix3::identity() } else { frame_along(middle) }
}

/// Rows of a right-handed frame whose z lies along `axis`, of any length.
#[inline(always)]
pub fn frame_along(axis: &Vector3<f64>) -> Matrix3<f64> {
    let z = axis / axis.norm_squared().sqrt();
    let across = if z.y.abs() < 0.9 {
        Vector3::new(z.z, 0.0, -z.x) // y × z
    } else {
        Vector3::new(0.0, -z.z, z.y) // x × z
    };
    let x = across / across.norm_squared().sqrt();
    let y = z.cross(&x);
    Matrix3::new(x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z)
}

/// A rim's points from a pixel, pixels.
#[inline(always)]
fn points(ellipse: &Ellipse, from: PixelPoint) -> [[f64; POINTS]; 2] {
    let (sin, cos) = ellipse.angle_rad.sin_cos();
    let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
    let (du, dv) = (ellipse.center.u - from.u, ellipse.center.v - from.v);
    let mut points = [[0.0; POINTS]; 2];
    for i in 0..POINTS {
        let (x, y) = (a * COS[i], b * SIN[i]);
        points[0][i] = du + cos * x - sin * y;
        points[1][i] = dv + sin * x + cos * y;
    }
    points
}

/// The rims' points from the outer rim's centre, pixels: the outer rim's, then the inner one's.
#[inline(always)]
fn offsets(ring: &Ring) -> [[f64; 2 * POINTS]; 2] {
    let mut offsets = [[0.0; 2 * POINTS]; 2];
    for (rim, ellipse) in [&ring.outer, &ring.inner].into_iter().enumerate() {
        let points = points(ellipse, ring.outer.center);
        for axis in 0..2 {
            offsets[axis][rim * POINTS..(rim + 1) * POINTS].copy_from_slice(&points[axis]);
        }
    }
    offsets
}

/// Where rays cross the plane z = 1 of the base frame; `None` if one lies 90° or more from its axis.
#[inline(always)]
fn plane_points(
    rays: &[[f64; POINTS]; 3],
    turn: &Matrix3<f64>,
    is_planar: bool,
) -> Option<[[f64; POINTS]; 2]> {
    if is_planar {
        return Some([rays[0], rays[1]]);
    }
    let mut points = [[0.0; POINTS]; 2];
    let mut depths = [0.0; POINTS];
    for i in 0..POINTS {
        let [u, v, w] = [rays[0][i], rays[1][i], rays[2][i]];
        depths[i] = turn.m31 * u + turn.m32 * v + turn.m33 * w;
        points[0][i] = (turn.m11 * u + turn.m12 * v + turn.m13 * w) / depths[i];
        points[1][i] = (turn.m21 * u + turn.m22 * v + turn.m23 * w) / depths[i];
    }
    depths.iter().fold(true, |ahead, depth| ahead & (*depth > 0.0)).then_some(points)
}

/// Image of the rim's own centre, and of its semiaxes by the derivative there.
#[inline(always)]
fn line<const N: usize>(
    near: &NearRays<N>,
    middle_px: PixelPoint,
    ellipse: &Ellipse,
    base_from_camera: &Matrix3<f64>,
) -> (Vector2<f64>, Matrix2<f64>) {
    let middle = base_from_camera * near.middle;
    let per_depth = 1.0 / middle.z;
    let flat = Vector2::new(middle.x, middle.y) * per_depth;
    let [by_u, by_v] = near.by_pixel.map(|by| {
        let by = base_from_camera * by;
        (Vector2::new(by.x, by.y) - flat * by.z) * per_depth
    });
    let (sin, cos) = ellipse.angle_rad.sin_cos();
    let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
    let (du, dv) = (ellipse.center.u - middle_px.u, ellipse.center.v - middle_px.v);
    let major = (by_u * cos + by_v * sin) * a;
    let minor = (by_v * cos - by_u * sin) * b;
    (flat + by_u * du + by_v * dv, Matrix2::from_columns(&[major, minor]))
}

/// The first rim of which a point has no ray.
fn refused(camera: &Camera, ring: &Ring) -> &'static str {
    let outer = points(&ring.outer, ring.outer.center);
    if camera.rays_near(ring.outer.center, &outer).is_err() { "outer" } else { "inner" }
}

/// An ellipse in the plane z = 1 of the base frame.
#[derive(Clone, Copy, Debug)]
pub struct Flat {
    pub center: Vector2<f64>,
    pub semiaxes: Matrix2<f64>,
}

impl Flat {
    /// The ellipse through the images of a rim's points, the outer (0) or the inner one (1); `None` if
    /// one lies 90° or more from the frame's axis.
    #[inline(always)]
    fn through(
        near: &NearRays<{ 2 * POINTS }>,
        rim: usize,
        ring: &Ring,
        base_from_camera: &Matrix3<f64>,
    ) -> Option<Self> {
        let turn = base_from_camera;
        let own = near.rays.map(|axis| std::array::from_fn(|i| axis[rim * POINTS + i]));
        let is_planar = *turn == Matrix3::identity();
        let [mut x, mut y] = plane_points(&own, turn, is_planar)?;
        let center = Vector2::new(mean(&x, &ONE), mean(&y, &ONE));
        let affine = Matrix2::new(
            2.0 * mean(&x, &COS),
            2.0 * mean(&x, &SIN),
            2.0 * mean(&y, &COS),
            2.0 * mean(&y, &SIN),
        );
        let inverse = affine.try_inverse()?;
        for i in 0..POINTS {
            let (dx, dy) = (x[i] - center.x, y[i] - center.y);
            x[i] = inverse.m11 * dx + inverse.m12 * dy;
            y[i] = inverse.m21 * dx + inverse.m22 * dy;
        }
        let ellipse = [&ring.outer, &ring.inner][rim];
        let (middle, linear) = line(near, ring.outer.center, ellipse, turn);
        let (middle, linear) = (inverse * (middle - center), inverse * linear);
        // dy/ds = P₁ + 2 P₂ + 3 P₃, with the even part y₀ + P₂ and the odd one P₁ + P₃.
        let (mut along_x, mut along_y) = ([0.0; POINTS], [0.0; POINTS]);
        for i in 0..POINTS {
            let opposite = (i + POINTS / 2) % POINTS;
            let (even, odd) = (0.5 * (x[i] + x[opposite]), 0.5 * (x[i] - x[opposite]));
            let first = linear.m11 * COS[i] + linear.m12 * SIN[i];
            along_x[i] = 3.0 * odd - 2.0 * first + 2.0 * (even - middle.x);
            let (even, odd) = (0.5 * (y[i] + y[opposite]), 0.5 * (y[i] - y[opposite]));
            let first = linear.m21 * COS[i] + linear.m22 * SIN[i];
            along_y[i] = 3.0 * odd - 2.0 * first + 2.0 * (even - middle.y);
        }
        // The unit circle's own ellipse: moved by `shift`, its points longer by the factor 1 + `grown`.
        let mut shift = Vector2::zeros();
        let mut grown = Matrix2::zeros();
        for _ in 0..TURNS {
            let back = (Matrix2::identity() + grown).try_inverse()?;
            let mut q = [0.0; POINTS];
            for i in 0..POINTS {
                let (dx, dy) = (x[i] - shift.x, y[i] - shift.y);
                let (dx, dy) = (back.m11 * dx + back.m12 * dy, back.m12 * dx + back.m22 * dy);
                let (ex, ey) = (along_x[i], along_y[i]);
                let (ex, ey) = (back.m11 * ex + back.m12 * ey, back.m12 * ex + back.m22 * ey);
                // |y| - 1 is half of |y|² - 1 less its square's eighth.
                let excess = dx * dx + dy * dy - 1.0;
                let beyond = excess * (0.5 - 0.125 * excess);
                q[i] = beyond * (1.0 + beyond) / (dx * ex + dy * ey);
            }
            let moved = Vector2::new(2.0 * mean(&q, &COS), 2.0 * mean(&q, &SIN));
            let (size, elongation, turn) =
                (mean(&q, &ONE), 2.0 * mean(&q, &COS_2), 2.0 * mean(&q, &SIN_2));
            shift += moved;
            grown += Matrix2::new(size + elongation, turn, turn, size - elongation);
            let most = moved.x.abs() + moved.y.abs() + size.abs() + elongation.abs() + turn.abs();
            if most <= SETTLED {
                break;
            }
        }
        let semiaxes = affine * (Matrix2::identity() + grown);
        Some(Self { center: center + affine * shift, semiaxes })
    }

    /// This rim as it is seen from another frame, with what is known of its errors.
    #[inline(always)]
    fn rim(
        &self,
        local_from_base: &Matrix3<f64>,
        ellipse: &Ellipse,
        radius_m: f64,
        noise: &RingNoise,
    ) -> Option<Rim> {
        let (center, shape, semiaxes) = self.seen_from(local_from_base)?;
        let information = information(ellipse, noise)?;
        Some(Rim { radius_m, center, shape, inverse: semiaxes.try_inverse()?, information })
    }

    /// The axis of the cone through the ellipse, that eigenvector of its dual conic which lies inside:
    /// its other eigenvalues are smaller by the square of the ellipse's size, so that two turns of the
    /// power method from the centre find it.
    #[inline(always)]
    fn cone_axis(&self) -> Vector3<f64> {
        let shape = self.semiaxes * self.semiaxes.transpose();
        let mut axis = self.center;
        for _ in 0..2 {
            let inside = self.center.dot(&axis) + 1.0;
            axis = self.center - shape * axis / inside;
        }
        axis.push(1.0)
    }

    /// Centre, shape A Aᵀ and, but for perspective's second order, semiaxes in the plane z = 1 of another
    /// frame; `None` if the ellipse is none there.
    #[inline(always)]
    fn seen_from(
        &self,
        local_from_base: &Matrix3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2<f64>, Matrix2<f64>)> {
        // The dual conic is p pᵀ - a aᵀ - b bᵀ.
        let [a, b] = [0, 1].map(|k| local_from_base * self.semiaxes.column(k).push(0.0));
        let p = local_from_base * self.center.push(1.0);
        let scale = p.z * p.z - a.z * a.z - b.z * b.z;
        if scale.is_nan() || scale <= 0.0 {
            return None;
        }
        let [fp, fa, fb] = [&p, &a, &b].map(|v| Vector2::new(v.x, v.y));
        let per_scale = 1.0 / scale;
        let center = (fp * p.z - fa * a.z - fb * b.z) * per_scale;
        let dual = fp * fp.transpose() - fa * fa.transpose() - fb * fb.transpose();
        let shape = center * center.transpose() - dual * per_scale;
        let per_depth = 1.0 / p.z;
        let flat = fp * per_depth;
        let semiaxes =
            Matrix2::from_columns(&[(fa - flat * a.z) * per_depth, (fb - flat * b.z) * per_depth]);
        Some((center, shape, semiaxes))
    }
}

#[inline(always)]
fn mean(values: &[f64; POINTS], weights: &[f64; POINTS]) -> f64 {
    let mut sum = 0.0;
    for i in 0..POINTS {
        sum += values[i] * weights[i];
    }
    sum * (1.0 / POINTS as f64)
}

const H: f64 = std::f64::consts::FRAC_1_SQRT_2;
const ONE: [f64; POINTS] = [1.0; POINTS];
/// cos t of the points …
const COS: [f64; POINTS] = [1.0, H, 0.0, -H, -1.0, -H, 0.0, H];
/// … sin t …
const SIN: [f64; POINTS] = [0.0, H, 1.0, H, 0.0, -H, -1.0, -H];
/// … cos 2t …
const COS_2: [f64; POINTS] = [1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0, 0.0];
/// … and sin 2t.
const SIN_2: [f64; POINTS] = [0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0];

/// Inverse covariance of a rim's five numbers.
///
/// The rim's samples stray by n(s) across it, independently from one pixel of arc s to the next, so
/// that q = g n / (ab) with g = ds/dt = √(a² sin² t + b² cos² t) and cov h = σ²/(2π a²b²) mean(g ψψᵀ);
/// to that come the floor and, alike in all five, the unevenness. By symmetry only size and elongation
/// are coupled. The means of g, g cos 2t and g cos 4t are those over the eight points.
#[inline(always)]
pub fn information(ellipse: &Ellipse, noise: &RingNoise) -> Option<Information> {
    let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
    let between = (0.5 * (a * a + b * b)).sqrt();
    let (g0, g2, g4) =
        (0.25 * (a + b + 2.0 * between), 0.25 * (b - a), 0.25 * (a + b - 2.0 * between));
    let edge = noise.edge_px * noise.edge_px / (std::f64::consts::TAU * a * a * b * b);
    // A shift η of the whole rim across itself: q = g η/(ab), whose numbers are size and elongation.
    let per_shift = noise.floor_px / (a * b);
    let (shift_size, shift_elongation) =
        (g0 * per_shift, std::f64::consts::SQRT_2 * g2 * per_shift);
    let rest = (REST_OF_FLOOR * noise.floor_px).powi(2);
    let uneven = noise.uneven_px * noise.uneven_px / (a * b);
    let size = edge * g0 + shift_size * shift_size + uneven;
    let elongation =
        edge * (g0 + g4) + shift_elongation * shift_elongation + 0.25 * rest / (a * b) + uneven;
    let coupling = std::f64::consts::SQRT_2 * edge * g2 + shift_size * shift_elongation;
    let along = edge * (g0 + g2) + 0.5 * rest / (a * a) + uneven;
    let across = edge * (g0 - g2) + 0.5 * rest / (b * b) + uneven;
    let turn = edge * (g0 - g4) + 0.25 * rest / (a * b) + uneven;
    let determinant = size * elongation - coupling * coupling;
    if !(determinant > 0.0 && along > 0.0 && across > 0.0 && turn > 0.0) {
        return None;
    }
    Some(Information {
        size: elongation / determinant,
        size_and_elongation: -coupling / determinant,
        elongation: size / determinant,
        along: 1.0 / along,
        across: 1.0 / across,
        turn: 1.0 / turn,
    })
}
