//! Rims carried through the lens.
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
//! and the ellipse exact. What is left out is of the third order of P₂, by [`LEFT_OUT`].
//!
//! The ellipse with centre c and semiaxes A = (a b), in homogeneous coordinates, is the *dual conic*
//! D = (c cᵀ - A Aᵀ, c; cᵀ, 1), the set of its tangents l, lᵀ D l = 0. It turns with the frame:
//! D → R D Rᵀ.

use super::{
    PoseError,
    bend::Bend,
    information::Information,
    seen::{RimSeen, RingSeen},
};
use crate::{
    camera::{Camera, LensError, NearRays},
    lanes::{Lane, Mask, Mat2, Mat3, Vec2, Vec3},
};

/// Points on a rim. Five harmonics need at least five; eight keep those that a lens adds, up to the
/// fifth, from being mistaken for them.
pub const POINTS: usize = 8;
/// Turns, at most, in which the ellipse through the points is found …
const TURNS: usize = 8;
/// … and what a turn that moves it by no more than this leaves is nothing: it gains two digits.
const SETTLED: f64 = 1e-6;
/// What the turns leave out of a rim's shape, in cubes of |P₂|: as much as rims under the strongest lenses have shown
/// (`tests/golden.rs`), exact ones 1.3, those fitted to points 5.
const LEFT_OUT: f64 = 5.0;

/// A rim in the plane z = 1 of a local frame.
#[derive(Clone, Copy, Debug)]
pub struct Rim<T> {
    /// The circle's radius, metres.
    pub radius_m: T,
    /// Centre of the ellipse.
    pub center: Vec2<T>,
    /// A Aᵀ.
    pub shape: Mat2<T>,
    /// A⁻¹, but for perspective's second order.
    pub inverse: Mat2<T>,
    /// Product of its semiaxes as seen, pixels².
    pub area_px2: T,
    /// Squared share of that by which its shape may be another, since a lens bends it.
    pub left_out: T,
    /// Of its five numbers.
    pub information: Information<T>,
}

/// Both rims in a frame whose z is the axis of the outer rim's cone, so that a circle of which the rim is an
/// image lies on it up to its tilt.
#[derive(Clone, Copy, Debug)]
pub struct Carried<T: Lane> {
    pub local_from_camera: Mat3<T>,
    /// Outer and inner.
    pub rims: [Rim<T>; 2],
    /// Where they are ellipses there.
    pub known: T::Mask,
}

/// Both rims in the plane z = 1 of a base frame.
#[derive(Clone, Copy, Debug)]
pub struct Flattened<T: Lane> {
    /// The base frame; `None` for the camera's own.
    pub base_from_camera: Option<Mat3<T>>,
    /// Outer and inner.
    pub flats: [Flat<T>; 2],
    /// Where that holds.
    pub known: T::Mask,
}

/// The rims through any lens.
#[inline(always)]
pub fn carry(camera: &Camera, seen: &RingSeen<f64>) -> Result<Carried<f64>, PoseError> {
    let mut flattened = flat_closed(camera, &seen.rims);
    if !flattened.known {
        flattened = flat_by_turns(camera, &seen.rims)?;
    }
    let carried = flattened.carry(seen);
    if carried.known { Ok(carried) } else { Err(PoseError::NoCircle) }
}

/// The rims in closed form, where the lens bends them little.
#[inline(always)]
pub fn flat_closed<T: Lane>(camera: &Camera, rims: &[RimSeen<T>; 2]) -> Flattened<T> {
    let [outer, inner] = rims;
    let near = camera.rays_near_each(outer.center, &points(outer, outer.center));
    let base_from_camera = base(camera, near.middle);
    let (middle, semiaxes) = line(&near, outer.center, outer, &base_from_camera);
    let (points, ahead) = plane_points(&near.rays, &base_from_camera);
    let (bend, bent_little) = Bend::of(&points, middle, semiaxes);
    let mut known = near.settled & bent_little;
    if base_from_camera.is_some() {
        known = known & ahead;
    }
    Flattened { base_from_camera, flats: [bend.outer(), bend.inner(outer, inner)], known }
}

/// The same for any lens.
#[inline(always)]
pub fn flat_by_turns(
    camera: &Camera,
    seen: &[RimSeen<f64>; 2],
) -> Result<Flattened<f64>, PoseError> {
    let near = match camera.rays_near(seen[0].center, &offsets(seen)) {
        Ok(near) => near,
        Err(source) => return Err(PoseError::Lens { rim: refused(camera, &seen[0]), source }),
    };
    let base_from_camera = base(camera, near.middle);
    let outer = Flat::through(&near, 0, seen, &base_from_camera);
    let inner = Flat::through(&near, 1, seen, &base_from_camera);
    let behind = |rim| PoseError::Lens { rim, source: LensError::Behind };
    let (outer, inner) = (outer.ok_or(behind("outer"))?, inner.ok_or(behind("inner"))?);
    Ok(Flattened { base_from_camera, flats: [outer, inner], known: true })
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

/// A rim's points from a pixel.
#[inline(always)]
fn points<T: Lane>(rim: &RimSeen<T>, from: Vec2<T>) -> [[T; POINTS]; 2] {
    let [major, minor] = rim.semiaxes();
    let at = rim.center - from;
    let mut points = [[at.x; POINTS], [at.y; POINTS]];
    for i in 0..POINTS {
        points[0][i] = at.x + major.x * COS[i] + minor.x * SIN[i];
        points[1][i] = at.y + major.y * COS[i] + minor.y * SIN[i];
    }
    points
}

/// The rims' points from the outer rim's centre, pixels: the outer rim's, then the inner one's.
#[inline(always)]
fn offsets(rims: &[RimSeen<f64>; 2]) -> [[f64; 2 * POINTS]; 2] {
    let mut offsets = [[0.0; 2 * POINTS]; 2];
    for (rim, seen) in rims.iter().enumerate() {
        let points = points(seen, rims[0].center);
        for axis in 0..2 {
            offsets[axis][rim * POINTS..(rim + 1) * POINTS].copy_from_slice(&points[axis]);
        }
    }
    offsets
}

/// Where rays cross the plane z = 1 of the base frame, and where none lies 90° or more from its axis.
#[inline(always)]
fn plane_points<T: Lane>(
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

/// Image of the rim's own centre, and of its semiaxes by the derivative there.
#[inline(always)]
fn line<T: Lane, const N: usize>(
    near: &NearRays<T, N>,
    middle_px: Vec2<T>,
    rim: &RimSeen<T>,
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

/// The first rim of which a point has no ray.
fn refused(camera: &Camera, outer: &RimSeen<f64>) -> &'static str {
    let outer = camera.rays_near(outer.center, &points(outer, outer.center));
    if outer.is_err() { "outer" } else { "inner" }
}

impl<T: Lane> Flattened<T> {
    /// In the frame along the outer rim's cone.
    #[inline(always)]
    pub fn carry(&self, seen: &RingSeen<T>) -> Carried<T> {
        let [outer, inner] = &self.flats;
        let local_from_base = frame_along(outer.cone_axis());
        let (outer, outer_known) = outer.rim(&local_from_base, seen, 0);
        let (inner, inner_known) = inner.rim(&local_from_base, seen, 1);
        let local_from_camera = match self.base_from_camera {
            Some(base_from_camera) => local_from_base.times(base_from_camera),
            None => local_from_base,
        };
        let known = self.known & outer_known & inner_known;
        Carried { local_from_camera, rims: [outer, inner], known }
    }
}

/// An ellipse in the plane z = 1 of the base frame.
#[derive(Clone, Copy, Debug)]
pub struct Flat<T> {
    pub center: Vec2<T>,
    pub semiaxes: Mat2<T>,
    /// As in [`Rim`].
    pub left_out: T,
}

impl Flat<f64> {
    /// The ellipse through the images of a rim's points, the outer (0) or the inner one (1); `None` if
    /// one lies 90° or more from the frame's axis.
    #[inline(always)]
    fn through(
        near: &NearRays<f64, { 2 * POINTS }>,
        rim: usize,
        seen: &[RimSeen<f64>; 2],
        base_from_camera: &Option<Mat3<f64>>,
    ) -> Option<Self> {
        let own = near.rays.map(|axis| std::array::from_fn(|i| axis[rim * POINTS + i]));
        let ([mut x, mut y], ahead) = plane_points(&own, base_from_camera);
        if !ahead {
            return None;
        }
        let center = Vec2::new(mean(&x, &ONE), mean(&y, &ONE));
        let affine = Mat2::new(
            2.0 * mean(&x, &COS),
            2.0 * mean(&x, &SIN),
            2.0 * mean(&y, &COS),
            2.0 * mean(&y, &SIN),
        );
        let (inverse, true) = affine.inverse() else { return None };
        for i in 0..POINTS {
            let v = inverse * (Vec2::new(x[i], y[i]) - center);
            (x[i], y[i]) = (v.x, v.y);
        }
        let (middle, linear) = line(near, seen[0].center, &seen[rim], base_from_camera);
        let (middle, linear) = (inverse * (middle - center), inverse.times(linear));
        // dy/ds = P₁ + 2 P₂ + 3 P₃, with the even part y₀ + P₂ and the odd one P₁ + P₃.
        let (mut along_x, mut along_y) = ([0.0; POINTS], [0.0; POINTS]);
        let mut bent = 0.0;
        for i in 0..POINTS {
            let opposite = (i + POINTS / 2) % POINTS;
            let (even, odd) = (0.5 * (x[i] + x[opposite]), 0.5 * (x[i] - x[opposite]));
            let first = linear.m11 * COS[i] + linear.m12 * SIN[i];
            along_x[i] = 3.0 * odd - 2.0 * first + 2.0 * (even - middle.x);
            bent += (even - middle.x).powi(2);
            let (even, odd) = (0.5 * (y[i] + y[opposite]), 0.5 * (y[i] - y[opposite]));
            let first = linear.m21 * COS[i] + linear.m22 * SIN[i];
            along_y[i] = 3.0 * odd - 2.0 * first + 2.0 * (even - middle.y);
            bent += (even - middle.y).powi(2);
        }
        // The unit circle's own ellipse: moved by `shift`, its points longer by the factor `grown`.
        let mut shift = Vec2::new(0.0, 0.0);
        let mut grown = Mat2::new(1.0, 0.0, 0.0, 1.0);
        for _ in 0..TURNS {
            let (back, true) = grown.inverse() else { return None };
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
            let moved = Vec2::new(2.0 * mean(&q, &COS), 2.0 * mean(&q, &SIN));
            let (size, elongation, turn) =
                (mean(&q, &ONE), 2.0 * mean(&q, &COS_2), 2.0 * mean(&q, &SIN_2));
            shift = shift + moved;
            grown.m11 += size + elongation;
            grown.m12 += turn;
            grown.m21 += turn;
            grown.m22 += size - elongation;
            let most = moved.x.abs() + moved.y.abs() + size.abs() + elongation.abs() + turn.abs();
            if most <= SETTLED {
                break;
            }
        }
        let left_out = (bent / POINTS as f64).powi(3) * (LEFT_OUT * LEFT_OUT);
        Some(Self { center: center + affine * shift, semiaxes: affine.times(grown), left_out })
    }
}

impl<T: Lane> Flat<T> {
    /// This rim, the outer (0) or the inner one (1), as it is seen from another frame, with what is known of
    /// its errors; and where it is an ellipse there.
    #[inline(always)]
    fn rim(
        &self,
        local_from_base: &Mat3<T>,
        seen: &RingSeen<T>,
        number: usize,
    ) -> (Rim<T>, T::Mask) {
        let (center, shape, semiaxes, is_ellipse) = self.seen_from(local_from_base);
        let (mut information, is_informed) =
            Information::of(&seen.rims[number], &seen.noise.rims[number]);
        if number == 1 {
            information = information.only(&seen.noise.disc);
        }
        let (inverse, regular) = semiaxes.inverse();
        let RimSeen { semi_major_px, semi_minor_px, .. } = seen.rims[number];
        let area_px2 = semi_major_px * semi_minor_px;
        let radius_m = seen.radii_m[number];
        let left_out = self.left_out;
        let rim = Rim { radius_m, center, shape, inverse, area_px2, left_out, information };
        (rim, is_ellipse & is_informed & regular)
    }

    /// The axis of the cone through the ellipse, that eigenvector of its dual conic which lies inside:
    /// its other eigenvalues are smaller by the square of the ellipse's size, so that two turns of the
    /// power method from the centre find it.
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

    /// Centre, shape A Aᵀ and, but for perspective's second order, semiaxes in the plane z = 1 of another
    /// frame; and where the ellipse is one there.
    #[inline(always)]
    fn seen_from(&self, local_from_base: &Mat3<T>) -> (Vec2<T>, Mat2<T>, Mat2<T>, T::Mask) {
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

impl<T: Lane> Carried<T> {
    #[inline(always)]
    pub fn lane(&self, lane: usize) -> Carried<f64> {
        Carried {
            local_from_camera: self.local_from_camera.lane(lane),
            rims: [self.rims[0].lane(lane), self.rims[1].lane(lane)],
            known: self.known.is_set(lane),
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
            left_out: self.left_out.lane(lane),
            information: self.information.lane(lane),
        }
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
