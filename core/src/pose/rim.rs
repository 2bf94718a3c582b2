//! A rim carried through the lens, and what is known of its errors.
//!
//! A rim is taken at points c + a cos t + b sin t, t evenly spaced, with the semiaxes a and b as
//! vectors. Another, slightly different ellipse crosses the line from the centre through such a point
//! at 1 + q(t) times its distance, and to first order q = ψ·c with only five harmonics,
//! ψ = (1, √2 cos t, √2 sin t, √2 cos 2t, √2 sin 2t): size, shift along either axis, elongation and
//! turn. Five numbers c therefore say all there is to say of a rim, and c = mean(ψ q), the mean over
//! evenly spaced t, is just what the moments of a rim's area measure. (An area's change is ½∮q r×dr =
//! ½ab∮q dt, and its first and second moments' are the other harmonics.)

use nalgebra::{Matrix3, SMatrix, SVector, Vector2};

use super::RingNoise;
use crate::{
    camera::{Camera, LensError, PixelPoint},
    ellipse::Ellipse,
};

/// Points on a rim. Five harmonics need at least five; twice as many leave those that distortion and
/// perspective add room not to be mistaken for them.
pub const RIM_POINTS: usize = 12;

/// The floor's share of centre, elongation and turn: blur and bloom are nearly even around a rim.
const REST_OF_FLOOR: f64 = 0.25;

/// Five numbers of a rim.
pub type Harmonics = SVector<f64, 5>;

/// One point of a rim.
#[derive(Clone, Copy, Debug)]
pub struct RimPoint {
    /// Where its ray meets the plane z = 1 of the local frame.
    pub ray: Vector2<f64>,
    /// How that moves with q.
    pub radial: Vector2<f64>,
    /// ψ(t).
    pub basis: Harmonics,
}

/// A rim of a known circle.
#[derive(Clone, Debug)]
pub struct Rim {
    /// The circle's radius, metres.
    pub radius_m: f64,
    /// Evenly spaced in t.
    pub points: [RimPoint; RIM_POINTS],
    /// Inverse covariance of the five numbers.
    pub information: SMatrix<f64, 5, 5>,
}

impl Rim {
    /// Carries the rim `ellipse` of a circle through the lens. [`LensError`] if any of its points has
    /// no ray, or lies 90° or more from the local axis.
    pub fn new(
        camera: &Camera,
        local_from_camera: &Matrix3<f64>,
        ellipse: &Ellipse,
        radius_m: f64,
        noise: &RingNoise,
    ) -> Result<Self, LensError> {
        let (sin, cos) = ellipse.angle_rad.sin_cos();
        let major = Vector2::new(cos, sin) * ellipse.semi_major_px;
        let minor = Vector2::new(-sin, cos) * ellipse.semi_minor_px;
        let empty =
            RimPoint { ray: Vector2::zeros(), radial: Vector2::zeros(), basis: Harmonics::zeros() };
        let mut points = [empty; RIM_POINTS];
        for (index, point) in points.iter_mut().enumerate() {
            let (cos, sin) = UNIT_CIRCLE[index];
            let offset = major * cos + minor * sin;
            let pixel =
                PixelPoint { u: ellipse.center.u + offset.x, v: ellipse.center.v + offset.y };
            let (ray, slope) = camera.ray_with_jacobian(pixel)?;
            let ray = local_from_camera * ray;
            let radial = local_from_camera * (slope * offset);
            if ray.z <= 0.0 {
                return Err(LensError::Behind);
            }
            let flat = Vector2::new(ray.x, ray.y) / ray.z;
            point.ray = flat;
            point.radial = (Vector2::new(radial.x, radial.y) - flat * radial.z) / ray.z;
            point.basis = basis(cos, sin);
        }
        let information = information(ellipse, noise).ok_or(LensError::NotFinite)?;
        Ok(Self { radius_m, points, information })
    }

    /// Information of the two numbers that tell a circle from an ellipse, their mean.
    pub fn elongation_information(&self) -> f64 {
        0.5 * (self.information[(3, 3)] + self.information[(4, 4)])
    }
}

/// (cos t, sin t) of the points.
const UNIT_CIRCLE: [(f64, f64); RIM_POINTS] = {
    const H: f64 = 0.866_025_403_784_438_6;
    [
        (1.0, 0.0),
        (H, 0.5),
        (0.5, H),
        (0.0, 1.0),
        (-0.5, H),
        (-H, 0.5),
        (-1.0, 0.0),
        (-H, -0.5),
        (-0.5, -H),
        (0.0, -1.0),
        (0.5, -H),
        (H, -0.5),
    ]
};

fn basis(cos: f64, sin: f64) -> Harmonics {
    let root = std::f64::consts::SQRT_2;
    Harmonics::new(
        1.0,
        root * cos,
        root * sin,
        root * (cos * cos - sin * sin),
        root * 2.0 * sin * cos,
    )
}

/// Inverse covariance of a rim's five numbers.
///
/// The rim's samples stray by n(s) across it, independently from one pixel of arc s to the next, so
/// that q = g n / (ab) with g = ds/dt = √(a² sin² t + b² cos² t) and cov c = σ²/(2π a²b²) mean(g ψψᵀ);
/// to that come the floor and, alike in all five, the unevenness. By symmetry only size and elongation are coupled.
fn information(ellipse: &Ellipse, noise: &RingNoise) -> Option<SMatrix<f64, 5, 5>> {
    let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
    let (mut g0, mut g2, mut g4) = (0.0, 0.0, 0.0);
    for (cos, sin) in UNIT_CIRCLE {
        let g = (a * sin).hypot(b * cos) / RIM_POINTS as f64;
        let cos_2t = cos * cos - sin * sin;
        g0 += g;
        g2 += g * cos_2t;
        g4 += g * (2.0 * cos_2t * cos_2t - 1.0);
    }
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
    let mut information = SMatrix::<f64, 5, 5>::zeros();
    information[(0, 0)] = elongation / determinant;
    information[(0, 3)] = -coupling / determinant;
    information[(3, 0)] = -coupling / determinant;
    information[(3, 3)] = size / determinant;
    information[(1, 1)] = 1.0 / along;
    information[(2, 2)] = 1.0 / across;
    information[(4, 4)] = 1.0 / turn;
    Some(information)
}
