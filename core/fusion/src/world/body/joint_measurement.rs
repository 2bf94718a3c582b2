//! One measurement of an object from all of its roundels in one frame.
//!
//! Roundel i, mounted on the object at (Rᵢ, tᵢ), is measured at pᵢ with orientation qᵢ (only the normal of a plain
//! roundel, the nearer of both headings of an elliptical disc). The object's pose (R, p) minimizes
//!
//! Σ |pᵢ - p - R tᵢ|² + |log qᵢ (R Rᵢ)⁻¹|² - 2 ln Lᵢ
//!
//! with each length weighted by its inverse covariance: Gauss-Newton with J = [I -[R tᵢ]×; 0 I]. Each roundel has two
//! normals qᵢ of likelihood Lᵢ. All choices of normals are tried, or for many roundels one after the other is switched.
//! The best two choices become the candidates of [`AttitudeMeasurement`].
//!
//! The position depends on the orientation by the levers tᵢ. Where the frame does not determine the orientation (a
//! single plain roundel) and the object is tracked already, the position uses its predicted orientation. The part of
//! the position's error that stems from the prediction lasts as long as that, so it is systematic. An angle that
//! neither frame nor prediction determines (about the normal of a plain roundel) leaves a circle: the measurement is
//! its centre, with half of its squared radius as variance.
//!
//! Roundels that contradict the others by far (a misread code) are left out one by one. Smaller contradictions widen
//! the covariance: mounts are measured by hand, and their error is not part of it.
//!
//! `core/tests/fusion/body.rs` checks that position and orientation are as precise as stated.

mod fit;

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};

use fit::{Fit, Fits, RoundelTerm, add, best_fits, block};

use super::PartMeasurement;
use crate::track::{AttitudeMeasurement, Measurement, Noise, cholesky_lower};
use crate::world::{
    lifecycle::{CameraView, Track},
    measurement::FLOOR_VARIANCE,
};
use roundel_vision::rigid::mahalanobis_squared;

/// Information about an unknown rotation, rad⁻²; close to none.
const WEAK_INFORMATION: f64 = 1e-3;
/// Variance above which an angle is unknown, rad².
const UNKNOWN_RAD2: f64 = 1.0;
/// Largest mean squared residual of roundels that agree: five standard deviations each.
const MAX_MISFIT: f64 = 25.0;
/// Smallest probability of the second choice as a candidate.
const MIN_SECOND_PROBABILITY: f64 = 1e-4;

/// Prediction of the object at the frame's time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PredictedPose {
    position_m: Vector3<f64>,
    velocity_m_s: Vector3<f64>,
    position_covariance: Matrix3<f64>,
    orientation: UnitQuaternion<f64>,
    angular_velocity_rad_s: Vector3<f64>,
    rotation_covariance: Matrix3<f64>,
    has_yaw: bool,
    /// Number of cameras that observe it at present, including the frame's own.
    cameras: f64,
}

impl PredictedPose {
    pub(crate) fn from_track(track: &Track, first: &Measurement, fresh_ns: i64) -> Self {
        let mut state = *track.history.newest();
        state.predict(first.time, &track.model);
        let is_other = |view: &&CameraView| {
            view.camera != first.camera
                && first.time.ns_since(view.time).saturating_abs() < fresh_ns
        };
        let others = track.views.iter().filter(is_other).count();
        let filter = state.motion.agile();
        let attitude = state.attitude.estimate(0.0, &track.model);
        Self {
            position_m: filter.position_m,
            velocity_m_s: filter.kalman.rate,
            position_covariance: filter.kalman.reported().value,
            orientation: attitude.orientation,
            angular_velocity_rad_s: attitude.angular_velocity_rad_s,
            rotation_covariance: attitude.covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            has_yaw: attitude.yaw_symmetry.is_some(),
            cameras: 1.0 + others as f64,
        }
    }

    fn is_orientation_known(&self) -> bool {
        self.has_yaw && self.rotation_covariance.trace() < UNKNOWN_RAD2
    }

    fn information(&self) -> Matrix3<f64> {
        self.rotation_covariance.try_inverse().unwrap_or_else(Matrix3::zeros)
    }
}

/// Measurement from the parts of one body in one frame (at least one), with `share` of the errors systematic, and
/// the number of parts that were left out. `None` if nothing fits.
pub(crate) fn joint_measurement(
    parts: &[PartMeasurement],
    prediction: Option<&PredictedPose>,
    share: f64,
) -> Option<(Measurement, usize)> {
    let first = &parts[0].measurement;
    let since_s = |part: &PartMeasurement| part.measurement.time.seconds_since(first.time);
    let mean_s = parts.iter().map(since_s).sum::<f64>() / parts.len() as f64;
    let mut terms = Vec::with_capacity(parts.len());
    for part in parts {
        terms.push(RoundelTerm::new(part, mean_s - since_s(part), prediction)?);
    }
    let mut fits = best_fits(&terms, prediction)?;
    while terms.len() > 1 && fits.best.misfit > MAX_MISFIT * degrees_of_freedom(&terms) {
        (terms, fits) = without_worst(&terms, prediction)?;
    }
    let attitude = attitude(&terms, &fits, prediction, share)?;
    let (position_m, position_noise) = position(&terms, &fits, prediction, share)?;
    let measurement = Measurement {
        time: first.time.plus_seconds(mean_s),
        position_m,
        position_noise,
        attitude,
        ..*first
    };
    Some((measurement, parts.len() - terms.len()))
}

/// Number of residuals less number of unknowns.
fn degrees_of_freedom(terms: &[RoundelTerm]) -> f64 {
    (terms.iter().map(RoundelTerm::residual_count).sum::<f64>() - 6.0).max(1.0)
}

/// All roundels except the one whose absence leaves the best fit, taking the prediction into account.
fn without_worst(
    terms: &[RoundelTerm],
    prediction: Option<&PredictedPose>,
) -> Option<(Vec<RoundelTerm>, Fits)> {
    let without = |index: usize| {
        let mut others = terms.to_vec();
        others.remove(index);
        let fits = best_fits(&others, prediction)?;
        let prior_cost = prediction.map_or(0.0, |prediction| {
            let off_m = fits.best.position_m - prediction.position_m;
            mahalanobis_squared(
                &off_m,
                &(prediction.position_covariance + Matrix3::from_diagonal_element(1e-4)),
            )
            .unwrap_or(0.0)
        });
        Some((fits.best.cost + prior_cost, (others, fits)))
    };
    // In reverse, so that the first of equals is kept.
    let all = (0..terms.len()).rev().filter_map(without);
    all.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, left)| left)
}

/// Factor on the variances for residuals larger than stated.
fn inflation(terms: &[RoundelTerm], fit: &Fit) -> f64 {
    let degrees_of_freedom = degrees_of_freedom(terms);
    (fit.misfit / (degrees_of_freedom + 3.0 * (2.0 * degrees_of_freedom).sqrt())).max(1.0)
}

fn second_probability(best: f64, second: f64) -> f64 {
    1.0 / (1.0 + (0.5 * (second - best)).exp())
}

/// Orientation by the frame alone.
fn attitude(
    terms: &[RoundelTerm],
    fits: &Fits,
    prediction: Option<&PredictedPose>,
    share: f64,
) -> Option<AttitudeMeasurement> {
    let usable = prediction.filter(|prediction| prediction.is_orientation_known());
    // Far less than the track's own information, but enough that a rival normal, which starts with it, does not
    // blur it.
    let weak = usable.map_or(Matrix3::from_diagonal_element(WEAK_INFORMATION), |usable| {
        usable.information() * WEAK_INFORMATION
    });
    let noise = |fit: &Fit| {
        let mut information = fit.information;
        add(&mut information, (3, 3), &weak);
        let covariance = information.cholesky()?.inverse();
        let inflation = inflation(terms, fit);
        let total = symmetric(&block(&covariance, 3)) * inflation;
        let systematic = symmetric(&block(&(covariance * fit.information * covariance), 3))
            * (inflation * share);
        Some(Noise {
            total: total + Matrix3::from_diagonal_element(FLOOR_VARIANCE),
            systematic_root: cholesky_lower(&systematic).unwrap_or_else(Matrix3::zeros),
            timing_s: 0.0,
        })
    };
    let Fits { best, second } = fits;
    let best_noise = noise(best)?;
    let is_whole = best_noise.total.trace() < UNKNOWN_RAD2;
    let second = second
        .as_ref()
        .filter(|second| second_probability(best.cost, second.cost) > MIN_SECOND_PROBABILITY);
    let (other, other_noise) = match second {
        Some(second) => (second, noise(second)?),
        None => (best, best_noise),
    };
    // A single roundel flat on the object passes its symmetry on to the object.
    let symmetry = match terms {
        [only] if (only.mount.rotation * Vector3::z()).z.abs() > 1.0 - 1e-6 => only.yaw_symmetry,
        _ => None,
    };
    Some(AttitudeMeasurement {
        candidates: [best.orientation, other.orientation],
        likelihood: 1.0 - second.map_or(0.0, |second| second_probability(best.cost, second.cost)),
        yaw_symmetry: (is_whole || usable.is_some()).then_some(symmetry.unwrap_or(1)),
        noise: best_noise,
        other_noise: Some(other_noise),
    })
}

/// Position by the frame and the predicted orientation.
fn position(
    terms: &[RoundelTerm],
    &Fits { best, second }: &Fits,
    prediction: Option<&PredictedPose>,
    share: f64,
) -> Option<(Vector3<f64>, Noise)> {
    let prior_cost = |fit: &Fit| {
        let Some(prediction) = prediction else { return 0.0 };
        let off = (prediction.orientation * fit.orientation.inverse()).scaled_axis();
        let spread = prediction.rotation_covariance + Matrix3::from_diagonal_element(1e-4);
        mahalanobis_squared(&off, &spread).unwrap_or(0.0)
    };
    let (mut first, mut other) = (best, second);
    let (mut cost, mut other_cost) =
        (best.cost + prior_cost(&best), second.map(|fit| fit.cost + prior_cost(&fit)));
    if let (Some(fit), Some(lower)) = (other, other_cost.filter(|other| *other < cost)) {
        (first, other) = (fit, Some(first));
        (cost, other_cost) = (lower, Some(cost));
    }
    let (position_m, mut total, mut systematic) = position_for(terms, &first, prediction, share)?;
    if let (Some(fit), Some(other_cost)) = (other, other_cost) {
        let weight = second_probability(cost, other_cost);
        if weight > MIN_SECOND_PROBABILITY {
            let apart_m = position_for(terms, &fit, prediction, share)?.0 - position_m;
            let between = apart_m * apart_m.transpose() * weight;
            total += between;
            systematic += between;
        }
    }
    let inflation = inflation(terms, &first);
    let noise = Noise {
        total: total * inflation + Matrix3::from_diagonal_element(FLOOR_VARIANCE),
        systematic_root: cholesky_lower(&(systematic * inflation)).unwrap_or_else(Matrix3::zeros),
        timing_s: 0.0,
    };
    cholesky_lower(&noise.total).map(|_| (position_m, noise))
}

/// Position for one choice of normals: value, covariance and the systematic part of the covariance.
fn position_for(
    terms: &[RoundelTerm],
    fit: &Fit,
    prediction: Option<&PredictedPose>,
    share: f64,
) -> Option<(Vector3<f64>, Matrix3<f64>, Matrix3<f64>)> {
    let mut prior = Matrix6::zeros();
    let mut gradient = Vector6::zeros();
    let mut alone = fit.information;
    (3..6).for_each(|axis| alone[(axis, axis)] += WEAK_INFORMATION);
    let is_determined = alone.cholesky()?.inverse().fixed_view::<3, 3>(3, 3).trace() < UNKNOWN_RAD2;
    if let Some(prediction) = prediction.filter(|_| !is_determined) {
        let information = prediction.information();
        let off = (prediction.orientation * fit.orientation.inverse()).scaled_axis();
        add(&mut prior, (3, 3), &information);
        gradient.fixed_rows_mut::<3>(3).copy_from(&(information * off));
    }
    let mut whole = fit.information + prior;
    (3..6).for_each(|axis| whole[(axis, axis)] += WEAK_INFORMATION);
    let mut covariance = whole.cholesky()?.inverse();
    let rotation = symmetric(&block(&covariance, 3));
    let mut circle = Matrix3::zeros();
    let mut position_m = fit.position_m;
    if rotation.trace() > UNKNOWN_RAD2 {
        // The rotation about this axis is unknown.
        let eigen = rotation.symmetric_eigen();
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let across = Matrix3::identity() - axis * axis.transpose();
        let level_m = across * (position_m - terms[0].position_m);
        position_m -= level_m;
        circle = across * (0.5 * level_m.norm_squared());
        let axis_information = axis * axis.transpose() / FLOOR_VARIANCE;
        add(&mut whole, (3, 3), &axis_information);
        covariance = whole.cholesky()?.inverse();
    }
    position_m += (covariance * gradient).fixed_rows::<3>(0);
    let by_frame = block(&(covariance * fit.information * covariance), 0);
    // All cameras use the same prediction, while their systematic errors are treated as independent: the factor
    // makes their mean's error right. The other factor of two covers the origin, where the error of the
    // orientation adds to that of the position, from which it stems, while both are treated as independent.
    let shared = prediction.map_or(1.0, |prediction| 2.0 * prediction.cameras);
    let predicted = block(&(covariance * prior * covariance), 0) * shared;
    let total = symmetric(&(block(&covariance, 0) + predicted * (1.0 - 1.0 / shared))) + circle;
    Some((position_m, total, symmetric(&(by_frame * share + predicted)) + circle))
}

fn symmetric(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}
