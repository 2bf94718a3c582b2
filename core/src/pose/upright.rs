//! A circle that nearly faces the camera, from both rims.
//!
//! Up to the second order of the lean w and of the circle's size as an angle, r = R/d, a rim is the
//! circle of radius r (1 - ¼ |w|²) with the elongation -½ w² and the centre α - r² w: so the rims' sizes
//! give the depth once |w|² is known, their elongations w², and the distance of their centres w. Each is
//! a weighted mean, and what is left of all, the tilt, is [`super::facing`]'s.

use nalgebra::{Matrix2, Vector2};

use super::{
    cone::Circle,
    facing::{self, Evidence, Lean},
    refine::{Covariance5, Estimate},
    rim::Rim,
};

/// The one or two circles, the likelier first with its likelihood; `None` where the circle is tilted
/// enough, or seen from near enough, for Gauss and Newton. `about` is the outer rim's own circle.
#[inline(always)]
pub fn estimate(about: &Circle, rims: &[Rim; 2]) -> Option<(Estimate, Option<(Estimate, f64)>)> {
    let r2 = rims.map(|rim| (rim.radius_m / about.depth_m).powi(2));
    // Of an elongation h (rms over the rim) w² is -4√2 h.
    let squared_weight = rims.map(|rim| (rim.information.elongation + rim.information.turn) / 64.0);
    let squared_information = squared_weight[0] + squared_weight[1];
    let squared_sigma = (1.0 / squared_information).sqrt();
    // A shift y of the centre, in radii, is a first harmonic of y/√2.
    let center_weight =
        [0, 1].map(|k| (rims[k].information.along + rims[k].information.across) / (4.0 * r2[k]));
    let center_information = center_weight[0] + center_weight[1];
    let per_center = 1.0 / center_information;
    let apart = r2[0] - r2[1];
    let linear_information = apart * apart * center_weight[0] * center_weight[1] * per_center;
    let tilted = about.lean.norm_squared();
    if !facing::is_needed(tilted, squared_sigma, linear_information) {
        return None;
    }
    let mean = |values: [f64; 2], weights: &[f64; 2]| {
        (values[0] * weights[0] + values[1] * weights[1]) / (weights[0] + weights[1])
    };
    let mean2 = |values: [Vector2<f64>; 2], weights: &[f64; 2]| {
        (values[0] * weights[0] + values[1] * weights[1]) / (weights[0] + weights[1])
    };
    let shapes = [0, 1].map(|k| rims[k].shape / r2[k]);
    let squares = shapes.map(|m| Vector2::new(m.m22 - m.m11, -2.0 * m.m12));
    let squared = mean2(squares, &squared_weight);
    let size_weight = rims.map(|rim| rim.information.size);
    let sizes = shapes.map(|m| 0.25 * (m.m11 * m.m22 - m.m12 * m.m12).ln());
    let size = mean(sizes, &size_weight);
    let centers = [rims[0].center, rims[1].center];
    let center = mean2(centers, &center_weight);
    let follow = mean(r2, &center_weight);
    let linear = (centers[1] - centers[0]) / apart;
    let evidence = Evidence { squared, squared_sigma, linear, linear_information };
    let leans = facing::leans(&evidence);
    let size_information = size_weight[0] + size_weight[1];
    let make = |lean: &Lean| {
        let circle = Circle {
            aside: center + lean.mean * follow,
            depth_m: about.depth_m * (-size - 0.25 * lean.squared).exp(),
            lean: Circle::held(lean.mean),
        };
        let covariance = covariance(lean, per_center, 1.0 / size_information, follow);
        // Five numbers are fitted, and the other five are left: the rims' differences of size and
        // elongation, and what the centres' distance says against this lean.
        let between = |weights: &[f64; 2]| weights[0] * weights[1] / (weights[0] + weights[1]);
        let misfit = between(&size_weight) * (sizes[0] - sizes[1]).powi(2)
            + between(&squared_weight) * (squares[0] - squares[1]).norm_squared()
            + linear_information * (linear - lean.mean).norm_squared();
        Estimate { circle, covariance, misfit }
    };
    let other = leans.other.map(|lean| (make(&lean), leans.likelihood));
    Some((make(&leans.first), other))
}

/// Over (α, ln d, w): α is the centre plus `follow` w, ln d the size and -¼ |w|².
#[inline(always)]
fn covariance(lean: &Lean, center: f64, size: f64, follow: f64) -> Covariance5 {
    let mut all = Covariance5::zeros();
    let aside = Matrix2::identity() * center + lean.covariance * (follow * follow);
    let across = lean.covariance * follow;
    all.fixed_view_mut::<2, 2>(0, 0).copy_from(&aside);
    all.fixed_view_mut::<2, 2>(0, 3).copy_from(&across);
    all.fixed_view_mut::<2, 2>(3, 0).copy_from(&across);
    all.fixed_view_mut::<2, 2>(3, 3).copy_from(&lean.covariance);
    all[(2, 2)] = size + 0.0625 * lean.squared_variance;
    let with_depth = lean.cross * -0.25;
    for k in 0..2 {
        (all[(2, 3 + k)], all[(3 + k, 2)]) = (with_depth[k], with_depth[k]);
        (all[(2, k)], all[(k, 2)]) = (follow * with_depth[k], follow * with_depth[k]);
    }
    all
}
