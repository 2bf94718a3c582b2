//! A circle's pose refined on both rims, with covariance and misfit.
//!
//! The unknowns are the position and two small rotations about axes across the normal. A rim point's
//! ray m meets the roundel's plane at X = m (n·p)/(n·m); with ρ = |X - p|, the modelled rim crosses
//! the line of q at q = (R - ρ)/(∂ρ/∂q). The five harmonics of q over each rim are the residuals, and
//! Gauss and Newton's steps minimize their squares, weighted by the rims' information.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, SMatrix, SVector, Vector3};

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
/// A step of this squared Mahalanobis length (a tenth of a standard deviation) is the last one: what
/// it leaves is smaller by another factor of ten at least.
const LAST_STEP: f64 = 1e-2;
/// Variance that face-on adds to the tilt, in units of the elongation's standard deviation…
const FACE_ON: f64 = 1.5;
/// … up to an elongation of about so many standard deviations.
const FACE_ON_END: f64 = 2.5;

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
        let elongation = rims.iter().map(Rim::elongation_information).sum();
        let split = Split::new(&information, elongation)?;
        let change = split.solve(&gradient)?;
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
        let misfit = misfit.sum();
        return Some(Estimate { position_m, normal, misfit, covariance: split.covariance(&axes)? });
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

/// Information about (position, tilt), split so that the tilt's own part can be mended.
///
/// A circle tilted by θ has an elongation that grows with θ², so that face-on the first derivative, and
/// with it the information, vanishes, and the inverse would claim that nothing is known of the tilt.
/// In truth an elongation known to ±σ bounds the tilt to about √σ.
struct Split {
    /// Inverse information of the position, the tilt being known.
    position: Matrix3<f64>,
    /// How the position follows the tilt.
    follow: Matrix3x2<f64>,
    /// Information of the tilt, the position being free, to first order.
    tilt: Matrix2<f64>,
    /// Its smaller eigenvalue.
    least: f64,
    /// Information of the elongation's two numbers, each.
    elongation: f64,
}

impl Split {
    fn new(information: &Matrix5, elongation: f64) -> Option<Self> {
        let position = information.fixed_view::<3, 3>(0, 0).into_owned().cholesky()?.inverse();
        let coupling = information.fixed_view::<3, 2>(0, 3).into_owned();
        let follow = -(position * coupling);
        let tilt = information.fixed_view::<2, 2>(3, 3) + coupling.transpose() * follow;
        let spread = (0.5 * (tilt.m11 - tilt.m22)).hypot(tilt.m12);
        let least = (0.5 * tilt.trace() - spread).max(0.0);
        Some(Self { position, follow, tilt, least, elongation })
    }

    /// The tilt's variance, each axis, in which its curvature is counted: a spread of variance s² sees
    /// on average information s² E/4 more than the first derivative's l, so 1/s² = l + s² E/4.
    fn curved_variance(&self) -> f64 {
        let Self { least, elongation, .. } = *self;
        // The difference of two nearly equal numbers where the tilt is large, hence its inverse.
        2.0 / ((least * least + elongation).sqrt() + least)
    }

    /// The damped step: curvature keeps it finite face-on.
    fn solve(&self, gradient: &Vector5) -> Option<Vector5> {
        let (by_position, by_tilt) =
            (gradient.fixed_rows::<3>(0).into_owned(), gradient.fixed_rows::<2>(3).into_owned());
        let curvature = 0.25 * self.curved_variance() * self.elongation;
        let information = self.tilt + Matrix2::from_diagonal_element(curvature);
        let turn = information.try_inverse()? * (by_tilt + self.follow.transpose() * by_position);
        let shift = self.position * by_position + self.follow * turn;
        Some(Vector5::new(shift.x, shift.y, shift.z, turn.x, turn.y))
    }

    /// Over (position, rotation), with the tilt's variance as it is.
    ///
    /// Where elongation is no larger than its error, noise alone makes a roundel look tilted, and the
    /// error of the tilt is that tilt itself: [`FACE_ON`] adds it. Its shape was fitted to the posterior
    /// of a tilt of which nothing is known beforehand, and of an untilted roundel; the test
    /// `covariance_is_that_of_the_errors` holds it.
    fn covariance(&self, axes: &[Vector3<f64>; 2]) -> Option<Covariance6> {
        let unit = (2.0 / self.elongation).sqrt();
        // The elongation in its standard deviations.
        let seen = self.least * unit;
        let face_on = FACE_ON * (-(seen / FACE_ON_END).powi(4)).exp();
        let curvature = 0.25 * self.curved_variance() * self.elongation;
        let curved = (self.tilt + Matrix2::from_diagonal_element(curvature)).try_inverse()?;
        // How the position follows an imagined tilt is as uncertain as the tilt: it takes part in the
        // position's variance, but not in the covariance of the two.
        let tilt = curved + Matrix2::from_diagonal_element(face_on * unit);
        let cross = self.follow * curved;
        let position = self.position + self.follow * tilt * self.follow.transpose();
        let across = Matrix3x2::from_columns(axes);
        let mut covariance = Covariance6::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&position);
        covariance.fixed_view_mut::<3, 3>(0, 3).copy_from(&(cross * across.transpose()));
        covariance.fixed_view_mut::<3, 3>(3, 0).copy_from(&(across * cross.transpose()));
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&(across * tilt * across.transpose()));
        Some(covariance)
    }
}
