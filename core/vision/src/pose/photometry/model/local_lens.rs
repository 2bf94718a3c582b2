//! The lens around one roundel: a polynomial from its rays to pixels.
//!
//! In a frame whose z passes through the roundel's middle, a ray is (s t₁, s t₂, 1), |t| ≤ 1 within
//! the roundel. Its pixel is a polynomial of fifth order in t, fitted to [`SAMPLES`] exact
//! projections. The error falls with the sixth power of the roundel's size in the image: below 1e-4
//! px up to 110 px at 45° off the axis (test `the_polynomial_is_the_lens`). The effect of a rolling
//! shutter on a moving ring, linear in the image, is included.

use fearless_simd::{Level, dispatch};
use nalgebra::{Matrix2, Matrix3, SMatrix, Vector3};

use crate::{
    camera::{Camera, LensError, PixelPoint},
    pose::Skew,
};

/// Coefficients of a polynomial of fifth order in two variables, of t₁ⁱ t₂ʲ by rising i, then j.
pub const TERMS: usize = 21;
/// The middle and three circles.
pub const SAMPLES: usize = 25;
/// Samples on each circle, and its radius.
const CIRCLES: [(usize, f64); 3] = [(12, 1.0), (8, 0.68), (4, 0.3)];

/// Sample points and the inverse of their design matrix, independent of the lens.
#[derive(Clone, Debug)]
pub struct SamplingPlan {
    places: [[f64; 2]; SAMPLES],
    /// Contribution of each sample to the terms.
    terms_from_samples: Box<[[f64; TERMS]; SAMPLES]>,
}

impl Default for SamplingPlan {
    fn default() -> Self {
        let mut places = [[0.0; 2]; SAMPLES];
        let mut next = 1;
        for (count, radius) in CIRCLES {
            for i in 0..count {
                let (sin, cos) =
                    (std::f64::consts::TAU * (i as f64 + 0.25) / count as f64).sin_cos();
                places[next] = [radius * cos, radius * sin];
                next += 1;
            }
        }
        let mut samples_from_terms = SMatrix::<f64, SAMPLES, TERMS>::zeros();
        for (row, [x, y]) in places.into_iter().enumerate() {
            for (column, (i, j)) in powers().enumerate() {
                samples_from_terms[(row, column)] = x.powi(i) * y.powi(j);
            }
        }
        let normal = samples_from_terms.transpose() * samples_from_terms;
        let inverse = normal.try_inverse().expect("the circles hold all 21 terms apart");
        let terms_from_samples = inverse * samples_from_terms.transpose();
        Self { places, terms_from_samples: Box::new(terms_from_samples.into()) }
    }
}

/// Exponents (i, j) of the terms.
fn powers() -> impl Iterator<Item = (i32, i32)> {
    (0..6).flat_map(|i| (0..6 - i).map(move |j| (i, j)))
}

impl SamplingPlan {
    /// Polynomials of both coordinates.
    #[inline(always)]
    fn terms_of(&self, samples: &[[f64; 2]; SAMPLES]) -> [[f64; TERMS]; 2] {
        let mut terms = [[0.0; TERMS]; 2];
        for (row, sample) in self.terms_from_samples.iter().zip(samples) {
            for (terms, value) in terms.iter_mut().zip(sample) {
                for (term, share) in terms.iter_mut().zip(row) {
                    *term += share * value;
                }
            }
        }
        terms
    }
}

/// The lens around one ray.
#[derive(Clone, Debug)]
pub struct LocalLens {
    /// Rows of the local frame.
    pub local_from_camera: Matrix3<f64>,
    /// s: tangent of the angle at which |t| = 1.
    pub spread: f64,
    /// Pixel of t = 0, rounded; origin of the polynomial's coordinates.
    pub origin: PixelPoint,
    /// Coefficients of u and of v.
    pub terms: [[f32; TERMS]; 2],
    /// Derivative of (u, v) by t in the middle, pixels.
    pub slope: Matrix2<f64>,
}

impl LocalLens {
    /// Fits the polynomial around the z axis of a frame, with the skew of a rolling shutter.
    pub fn new(
        camera: &Camera,
        local_from_camera: Matrix3<f64>,
        spread: f64,
        skew: Option<&Skew>,
        level: Level,
        plan: &SamplingPlan,
    ) -> Result<Self, LensError> {
        let camera_from_local = local_from_camera.transpose();
        let image = |ray: &Vector3<f64>| {
            let pixel = camera.project(ray)?;
            Ok::<_, LensError>(skew.map_or(pixel, |skew| skew.image(pixel)))
        };
        let middle = image(&camera_from_local.column(2).into_owned())?;
        let origin = PixelPoint { u: middle.u.round(), v: middle.v.round() };
        let mut samples = [[0.0; 2]; SAMPLES];
        for (sample, [x, y]) in samples.iter_mut().zip(&plan.places) {
            let pixel = image(&(camera_from_local * Vector3::new(spread * x, spread * y, 1.0)))?;
            *sample = [pixel.u - origin.u, pixel.v - origin.v];
        }
        let found = dispatch!(level, _ => plan.terms_of(&samples));
        let mut terms = [[0.0; TERMS]; 2];
        for (axis, terms) in terms.iter_mut().enumerate() {
            for (term, value) in terms.iter_mut().zip(&found[axis]) {
                *term = *value as f32;
            }
        }
        // Terms 1 and 6 are those of t₂ and t₁.
        let slope = Matrix2::new(found[0][6], found[0][1], found[1][6], found[1][1]);
        Ok(Self { local_from_camera, spread, origin, terms, slope })
    }

    /// Pixel of t, relative to the origin.
    #[cfg(test)]
    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        self.terms.map(|terms| {
            powers().zip(terms).map(|((i, j), term)| f64::from(term) * x.powi(i) * y.powi(j)).sum()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        camera::tests::{camera, lenses},
        pose::frame_along,
    };

    #[test]
    fn the_polynomial_is_the_lens() {
        let plan = SamplingPlan::default();
        let lenses = lenses();
        for lens in [lenses[0], lenses[1], lenses[3], lenses[5]] {
            let camera = camera(lens);
            // 110 px wide at 45° off the axis, and twice as wide up to 30°.
            for (axis, spread) in [
                (Vector3::new(0.6, 0.0, 1.0), 0.08),
                (Vector3::new(0.7, 0.6, 1.0), 0.055),
                (Vector3::new(0.2, -0.4, 1.0), 0.12),
            ] {
                let frame = frame_along(&axis.normalize());
                let local =
                    LocalLens::new(&camera, frame, spread, None, Level::new(), &plan).unwrap();
                for i in 0..400 {
                    let radius = ((i % 20) as f64 / 19.0).sqrt();
                    let (sin, cos) = (f64::from(i) * 0.7).sin_cos();
                    let (x, y) = (radius * cos, radius * sin);
                    let ray = frame.transpose() * Vector3::new(spread * x, spread * y, 1.0);
                    let exact = camera.project(&ray).unwrap();
                    let [u, v] = local.at(x, y);
                    let miss = (u + local.origin.u - exact.u).hypot(v + local.origin.v - exact.v);
                    assert!(miss < 1e-4, "{lens:?} {axis:?}: {miss}");
                }
            }
        }
    }
}
