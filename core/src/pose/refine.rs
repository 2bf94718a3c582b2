//! A circle's pose refined on both rims, with covariance and misfit.
//!
//! The unknowns are the position and two small rotations about axes across the normal. A rim point's
//! ray m meets the roundel's plane at X = m (n·p)/(n·m); with ρ = |X - p|, the modelled rim crosses
//! the line of q at q = (R - ρ)/(∂ρ/∂q). The five harmonics of q over each rim are the residuals, and
//! Gauss and Newton's steps minimize their squares, weighted by the rims' information.

use nalgebra::{Matrix2, SMatrix, SVector, Vector3};

use super::{
    cone::Circle,
    rim::{Harmonics, RIM_POINTS, Rim},
};
use crate::rigid::Covariance6;

/// A refined pose in the local frame.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Centre, metres.
    pub position_m: Vector3<f64>,
    /// Unit normal facing the camera.
    pub normal: Vector3<f64>,
    /// Over (position, rotation), with nothing about the normal.
    pub covariance: Covariance6,
    /// Squared Mahalanobis length of what the pose leaves unexplained of both rims.
    pub misfit: f64,
}

/// Steps at most; one or two are the rule, since the cone's circle is close.
const MAX_STEPS: usize = 6;
/// A step of this squared Mahalanobis length (a hundredth of a standard deviation) is the last one.
const LAST_STEP: f64 = 1e-4;

type Matrix5 = SMatrix<f64, 5, 5>;
type Vector5 = SVector<f64, 5>;

/// Refines `start` on both rims; `None` if it leaves the space of circles in front of the camera.
pub fn refine(start: &Circle, rims: &[Rim; 2]) -> Option<Estimate> {
    let Circle { mut position_m, mut normal } = *start;
    for step in 1..=MAX_STEPS {
        let axes = axes_across(&normal);
        let linear = rims.each_ref().map(|rim| linearize(rim, &position_m, &normal, &axes));
        let mut information = Matrix5::zeros();
        let mut gradient = Vector5::zeros();
        for (rim, (harmonics, jacobian)) in rims.iter().zip(&linear) {
            let weighted = jacobian.transpose() * rim.information;
            information += weighted * jacobian;
            gradient -= weighted * harmonics;
        }
        add_curvature(&mut information, rims);
        let factor = information.cholesky()?;
        let change = factor.solve(&gradient);
        position_m += change.fixed_rows::<3>(0);
        let turn = axes[0] * change[3] + axes[1] * change[4];
        normal = (normal + turn.cross(&normal)).normalize();
        if !(normal.dot(&position_m) < 0.0 && position_m.z > 0.0) {
            return None;
        }
        if change.dot(&gradient) > LAST_STEP && step < MAX_STEPS {
            continue;
        }
        let misfit = rims.iter().zip(&linear).map(|(rim, (harmonics, jacobian))| {
            let left = harmonics + jacobian * change;
            left.dot(&(rim.information * left))
        });
        return Some(Estimate {
            position_m,
            normal,
            misfit: misfit.sum(),
            covariance: covariance(&factor.inverse(), &axes),
        });
    }
    None
}

/// Two unit vectors that make a right-handed frame with `normal`.
fn axes_across(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let helper = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let first = helper.cross(normal).normalize();
    [first, normal.cross(&first)]
}

/// A rim's five residual harmonics at a pose, with their derivative by position and tilt.
fn linearize(
    rim: &Rim,
    position_m: &Vector3<f64>,
    normal: &Vector3<f64>,
    axes: &[Vector3<f64>; 2],
) -> (Harmonics, Matrix5) {
    let height = normal.dot(position_m);
    let mut harmonics = Harmonics::zeros();
    let mut jacobian = Matrix5::zeros();
    for point in &rim.points {
        let ray = point.ray.push(1.0);
        let radial = point.radial.push(0.0);
        let facing = 1.0 / normal.dot(&ray);
        let scale = height * facing;
        let offset = ray * scale - position_m;
        let distance = offset.norm();
        let outward = offset / distance;
        let slope =
            scale * (outward.dot(&radial) - outward.dot(&ray) * normal.dot(&radial) * facing);
        let per_slope = 1.0 / slope;
        let grazing = outward.dot(&ray) * facing;
        let by_position = (outward - normal * grazing) * per_slope;
        let tilt = grazing * distance * per_slope;
        let row = Vector5::new(
            by_position.x,
            by_position.y,
            by_position.z,
            -tilt * axes[1].dot(&outward),
            tilt * axes[0].dot(&outward),
        );
        harmonics += point.basis * ((rim.radius_m - distance) * per_slope);
        jacobian += point.basis * row.transpose();
    }
    let mean = 1.0 / RIM_POINTS as f64;
    (harmonics * mean, jacobian * mean)
}

/// Adds what the rims say of the tilt in second order.
fn add_curvature(information: &mut Matrix5, rims: &[Rim; 2]) {
    let elongation: f64 =
        rims.iter().map(|rim| 0.5 * (rim.information[(3, 3)] + rim.information[(4, 4)])).sum();
    let tilt: Matrix2<f64> = information.fixed_view::<2, 2>(3, 3).into_owned();
    let mean = 0.5 * tilt.trace();
    let smaller = mean - (0.5 * (tilt.m11 - tilt.m22)).hypot(tilt.m12);
    let variance = 2.0 * ((smaller * smaller + elongation).sqrt() - smaller) / elongation;
    let curvature = 0.25 * variance * elongation;
    information[(3, 3)] += curvature;
    information[(4, 4)] += curvature;
}

/// From (position, two tilts) to (position, rotation).
fn covariance(parameters: &Matrix5, axes: &[Vector3<f64>; 2]) -> Covariance6 {
    let mut spread = SMatrix::<f64, 6, 5>::zeros();
    spread.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    spread.fixed_view_mut::<3, 1>(3, 3).copy_from(&axes[0]);
    spread.fixed_view_mut::<3, 1>(3, 4).copy_from(&axes[1]);
    spread * parameters * spread.transpose()
}
