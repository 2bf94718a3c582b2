//! The circle of two rims that nearly faces the camera.
//!
//! To second order in the lean w and in the angular radius r = R/d, a rim is the circle of radius r
//! (1 - ¼ |w|²) with elongation -½ w² and centre α - r² w. The sizes of the rims therefore give the
//! depth once |w|² is known, their elongations give w², and the distance of their centres gives w.
//! Each is a weighted mean, and the tilt follows from the posterior of [`super::tilt_posterior`].

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector2, Vector3};

use super::{
    cone::Circle,
    motion_blur::MODEL_ERROR,
    refine::{Estimate, Estimates},
    tilt_posterior::{self, Evidence, Lean},
};
use crate::{
    pose::rim::projection::Rim,
    simd::{Lane, Vec2},
};

/// Information of both rims about the tilt.
#[derive(Clone, Copy)]
struct Weights<T> {
    /// Squared angular radii.
    r2: [T; 2],
    /// Information of each elongation about w², and the standard deviation of their weighted mean.
    squared: [T; 2],
    squared_sigma: T,
    /// Information of each centre, and that of their distance about w.
    center: [T; 2],
    linear: T,
}

impl<T: Lane> Weights<T> {
    #[inline(always)]
    fn new(about: &Circle<T>, rims: &[Rim<T>; 2]) -> Self {
        let [outer, inner] = rims;
        let per_depth = about.depth_m.under(1.0);
        let r2 = [(outer.radius_m * per_depth).squared(), (inner.radius_m * per_depth).squared()];
        let (one, other) = (&outer.information, &inner.information);
        // An elongation h (rms over the rim) is -w²/(4√2).
        let squared = [
            (one.elongation + one.turn) * (1.0 / 64.0),
            (other.elongation + other.turn) * (1.0 / 64.0),
        ];
        let squared_sigma = (squared[0] + squared[1]).under(1.0).root();
        // A shift y of the centre, in radii, is a first harmonic of y/√2.
        let center =
            [(one.along + one.across) * 0.25 / r2[0], (other.along + other.across) * 0.25 / r2[1]];
        let apart = r2[0] - r2[1];
        let linear = apart * apart * center[0] * center[1] / (center[0] + center[1]);
        Self { r2, squared, squared_sigma, center, linear }
    }
}

/// Where the tilt and the angular size are too small for a Gauss-Newton step. `about` is the circle
/// of the outer rim alone.
#[inline(always)]
pub fn applies<T: Lane>(about: &Circle<T>, rims: &[Rim<T>; 2]) -> T::Mask {
    let weights = Weights::new(about, rims);
    tilt_posterior::applies(about.lean.square(), weights.squared_sigma, weights.linear)
}

/// One or two circles, where [`applies`].
pub fn estimate(about: &Circle<f64>, rims: &[Rim<f64>; 2]) -> Estimates<f64> {
    let weights = Weights::new(about, rims);
    let Weights { r2, linear: linear_information, .. } = weights;
    let mean = |values: [f64; 2], weights: &[f64; 2]| {
        (values[0] * weights[0] + values[1] * weights[1]) / (weights[0] + weights[1])
    };
    let mean2 = |values: [Vector2<f64>; 2], weights: &[f64; 2]| {
        (values[0] * weights[0] + values[1] * weights[1]) / (weights[0] + weights[1])
    };
    let shapes = [0, 1].map(|k| Matrix2::from(rims[k].shape) / r2[k]);
    let squares = shapes.map(|m| Vector2::new(m.m22 - m.m11, -2.0 * m.m12));
    let outer = &rims[0];
    let lens_part = outer.residual_shape * Matrix2::from(outer.shape).determinant();
    let elongation = ElongationWeights::new(&squares, &weights, lens_part);
    let squared = mean2(squares, &elongation.weights);
    let squared_sigma = elongation.sigma;
    let size_weight = rims.map(|rim| rim.information.size);
    let sizes = shapes.map(|m| 0.25 * (m.m11 * m.m22 - m.m12 * m.m12).ln());
    let size = mean(sizes, &size_weight);
    let centers = rims.map(|rim| Vector2::from(rim.center));
    let center = mean2(centers, &weights.center);
    let follow = mean(r2, &weights.center);
    let linear = (centers[1] - centers[0]) / (r2[0] - r2[1]);
    let evidence = Evidence { squared, squared_sigma, linear, linear_information };
    let leans = tilt_posterior::leans(&evidence);
    let size_information = size_weight[0] + size_weight[1];
    let per_center = 1.0 / (weights.center[0] + weights.center[1]);
    let make = |lean: &Lean| {
        let aside = center + lean.mean * follow;
        let circle = Circle {
            aside: Vec2::new(aside.x, aside.y),
            depth_m: about.depth_m * (-size - 0.25 * lean.squared).exp(),
            lean: Circle::clamped(Vec2::new(lean.mean.x, lean.mean.y)),
        };
        // α = centre + `follow` w, ln d = size - ¼ |w|².
        let variances = Vector3::new(per_center, per_center, 1.0 / size_information);
        let follow = Matrix3x2::new(follow, 0.0, 0.0, follow, 0.0, 0.0);
        let covariance = lean.joint_covariance(&Matrix3::from_diagonal(&variances), &follow).into();
        // Five of ten numbers are fitted. The misfit comes from the other five: differences of size
        // and elongation, and the distance of the centres against this lean.
        let between = |weights: &[f64; 2]| weights[0] * weights[1] / (weights[0] + weights[1]);
        let misfit = between(&size_weight) * (sizes[0] - sizes[1]).powi(2)
            + (squares[0] - squares[1]).norm_squared() / elongation.apart
            + linear_information * (linear - lean.mean).norm_squared();
        Estimate { circle, covariance, misfit }
    };
    let first = make(&leans.first);
    match leans.other {
        Some(other) => Estimates { first, other: make(&other), likelihood: leans.likelihood },
        None => Estimates::alone(first),
    }
}

/// Weights of the elongations with motion within the exposure ([`super::motion_blur`]), which adds
/// ν over the squared radius to w² of either rim.
struct ElongationWeights {
    /// Sum 1; one of them may be negative.
    weights: [f64; 2],
    /// Standard deviation of the mean, and variance of the difference, of either component.
    sigma: f64,
    apart: f64,
}

impl ElongationWeights {
    /// `lens_part` is the share of |ν̂|² that lens distortion explains.
    fn new(squares: &[Vector2<f64>; 2], weights: &Weights<f64>, lens_part: f64) -> Self {
        let sigma = weights.squared_sigma;
        // The rim of an elliptical disc has no information.
        if weights.squared[1] <= 0.0 {
            return Self { weights: [1.0, 0.0], sigma, apart: f64::INFINITY };
        }
        let [outer, inner] = weights.squared.map(|weight| 1.0 / weight);
        let [by_outer, by_inner] = weights.r2.map(|r2| 1.0 / r2);
        let per_apart = 1.0 / (by_inner - by_outer).powi(2);
        let found = (squares[1] - squares[0]).norm_squared() * per_apart;
        let prior = 0.5 * (found - lens_part).max(0.0);
        let model_error = MODEL_ERROR * prior;
        let (outer, inner) =
            (outer + model_error * by_outer.powi(2), inner + model_error * by_inner.powi(2));
        let both = prior * by_outer * by_inner;
        let (outer, inner) =
            (outer + prior * by_outer * by_outer, inner + prior * by_inner * by_inner);
        let apart = outer + inner - 2.0 * both;
        let weights = [(inner - both) / apart, (outer - both) / apart];
        Self { weights, sigma: ((outer * inner - both * both) / apart).sqrt(), apart }
    }
}
