//! Pose of an object that fits its roundels in one frame best.
//!
//! The cost is that of the page above. The initial orientation comes from a roundel with a yaw; for plain ones only,
//! from their normals and the directions between them, so that Gauss-Newton needs few steps.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};

use super::{PredictedPose, WEAK_INFORMATION};
use crate::{track::smallest_turn, world::body::PartMeasurement};
use roundel_vision::rigid::Rigid;

/// Largest number of roundels for which all choices of normals are tried.
const MAX_EXHAUSTIVE: usize = 4;
/// Largest number of Gauss-Newton steps, and the step length that ends them.
const STEPS: usize = 6;
const MIN_STEP: f64 = 1e-7;

/// One of a roundel's two normals.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Normal {
    pub(crate) orientation: UnitQuaternion<f64>,
    pub(crate) information: Matrix3<f64>,
    /// -2 ln of its likelihood.
    pub(crate) cost: f64,
}

/// A roundel of the object at the frame's time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RoundelTerm {
    pub(crate) mount: Rigid,
    pub(crate) position_m: Vector3<f64>,
    pub(crate) information: Matrix3<f64>,
    pub(crate) normals: [Normal; 2],
    pub(crate) yaw_symmetry: Option<u32>,
}

impl RoundelTerm {
    pub(crate) fn new(
        part: &PartMeasurement,
        dt: f64,
        prediction: Option<&PredictedPose>,
    ) -> Option<Self> {
        let PartMeasurement { body_from_roundel: mount, measurement, .. } = *part;
        let attitude = &measurement.attitude;
        let first = attitude.likelihood.clamp(1e-3, 1.0 - 1e-3);
        let normal = |index: usize| {
            let orientation = attitude.candidates[index];
            let mut information = attitude.candidate_noise(index).total.try_inverse()?;
            if attitude.yaw_symmetry.is_none() {
                let normal = orientation * Vector3::z();
                let across = Matrix3::identity() - normal * normal.transpose();
                information = across * information * across;
            }
            let likelihood = if index == 0 { first } else { 1.0 - first };
            Some(Normal { orientation, information, cost: -2.0 * likelihood.ln() })
        };
        let moved_m = prediction.map_or_else(Vector3::zeros, |prediction| {
            let arm_m = prediction.orientation * mount.translation.vector;
            (prediction.velocity_m_s + prediction.angular_velocity_rad_s.cross(&arm_m)) * dt
        });
        Some(Self {
            mount,
            position_m: measurement.position_m + moved_m,
            information: measurement.position_noise.total.try_inverse()?,
            normals: [normal(0)?, normal(1)?],
            yaw_symmetry: attitude.yaw_symmetry,
        })
    }

    pub(crate) fn residual_count(&self) -> f64 {
        if self.yaw_symmetry.is_some() { 6.0 } else { 5.0 }
    }

    /// Rotation from the predicted orientation of the roundel to the measured one.
    fn turn(&self, normal: &Normal, object: &UnitQuaternion<f64>) -> Vector3<f64> {
        let mounted = object * self.mount.rotation;
        let Some(symmetry) = self.yaw_symmetry else {
            return smallest_turn(&(mounted * Vector3::z()), &(normal.orientation * Vector3::z()));
        };
        let yaw = |step: u32| {
            let angle = 2.0 * PI * f64::from(step) / f64::from(symmetry);
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
        };
        let turns = (0..symmetry)
            .map(|step| (normal.orientation * yaw(step) * mounted.inverse()).scaled_axis());
        turns.min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or_default()
    }
}

/// Pose for one choice of normals.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    pub(crate) position_m: Vector3<f64>,
    pub(crate) orientation: UnitQuaternion<f64>,
    /// Over (position, rotation).
    pub(crate) information: Matrix6<f64>,
    /// Sum of squared residuals.
    pub(crate) misfit: f64,
    /// `misfit` and -2 ln of the likelihood of the normals.
    pub(crate) cost: f64,
}

/// Fits of the best and of the second best choice of normals, if there is one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fits {
    pub(crate) best: Fit,
    pub(crate) second: Option<Fit>,
}

/// Fits of the best and the second best choice of normals.
pub(crate) fn best_fits(terms: &[RoundelTerm], prediction: Option<&PredictedPose>) -> Option<Fits> {
    let count = terms.len();
    if count > MAX_EXHAUSTIVE {
        return greedy(terms, prediction).map(|best| Fits { best, second: None });
    }
    let mut all: Vec<Fit> = (0..1u64 << count).filter_map(|c| fit(terms, c, prediction)).collect();
    all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    Some(Fits { best: *all.first()?, second: all.get(1).copied() })
}

/// Starts with the likelier normals and switches one at a time while that improves the fit.
fn greedy(terms: &[RoundelTerm], prediction: Option<&PredictedPose>) -> Option<Fit> {
    let count = terms.len().min(u64::BITS as usize);
    let mut choice = 0;
    let mut best = fit(terms, choice, prediction)?;
    for _ in 0..count {
        let turned = (0..count).map(|index| choice ^ 1 << index);
        let best_fits = turned.filter_map(|choice| Some((choice, fit(terms, choice, prediction)?)));
        match best_fits.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost)) {
            Some((better, fit)) if fit.cost < best.cost => (choice, best) = (better, fit),
            _ => break,
        }
    }
    Some(best)
}

/// Pose for one choice of normals: bit i selects the normal of term i.
fn fit(terms: &[RoundelTerm], choice: u64, prediction: Option<&PredictedPose>) -> Option<Fit> {
    let chosen = |index: usize| -> &Normal {
        let bit = if index < u64::BITS as usize { choice >> index & 1 } else { 0 };
        &terms[index].normals[bit as usize]
    };
    let orientation = initial_orientation(terms, chosen, prediction);
    let position_m = terms[0].position_m - orientation * terms[0].mount.translation.vector;
    let mut fit =
        Fit { position_m, orientation, information: Matrix6::zeros(), misfit: 0.0, cost: 0.0 };
    for _ in 0..STEPS {
        let gradient = fit.measure(terms, chosen);
        let mut damped = fit.information;
        (3..6).for_each(|axis| damped[(axis, axis)] += WEAK_INFORMATION);
        let step = damped.cholesky()?.solve(&gradient);
        fit.position_m += step.fixed_rows::<3>(0);
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        fit.orientation = turn * fit.orientation;
        if step.norm() < MIN_STEP {
            break;
        }
    }
    fit.measure(terms, chosen);
    fit.cost.is_finite().then_some(fit)
}

impl Fit {
    /// Sets information and cost at this pose; returns the negative gradient.
    fn measure<'a>(
        &mut self,
        terms: &[RoundelTerm],
        chosen: impl Fn(usize) -> &'a Normal,
    ) -> Vector6<f64> {
        let mut gradient = Vector6::zeros();
        self.information = Matrix6::zeros();
        (self.misfit, self.cost) = (0.0, 0.0);
        for (index, term) in terms.iter().enumerate() {
            let normal = chosen(index);
            let arm_m = self.orientation * term.mount.translation.vector;
            let off_m = term.position_m - self.position_m - arm_m;
            let turn = term.turn(normal, &self.orientation);
            let lever = -arm_m.cross_matrix();
            let (position, rotation) = (term.information, normal.information);
            let pull = position * off_m;
            let mut rows = gradient.fixed_rows_mut::<3>(0);
            rows += pull;
            let mut rows = gradient.fixed_rows_mut::<3>(3);
            rows += lever.transpose() * pull + rotation * turn;
            add(&mut self.information, (0, 0), &position);
            add(&mut self.information, (0, 3), &(position * lever));
            add(&mut self.information, (3, 0), &(lever.transpose() * position));
            add(&mut self.information, (3, 3), &(lever.transpose() * position * lever + rotation));
            self.misfit += off_m.dot(&pull) + turn.dot(&(rotation * turn));
            self.cost += normal.cost;
        }
        self.cost += self.misfit;
        gradient
    }
}

pub(crate) fn add(whole: &mut Matrix6<f64>, at: (usize, usize), part: &Matrix3<f64>) {
    let mut block = whole.fixed_view_mut::<3, 3>(at.0, at.1);
    block += part;
}

pub(crate) fn block(whole: &Matrix6<f64>, from: usize) -> Matrix3<f64> {
    whole.fixed_view::<3, 3>(from, from).into_owned()
}

/// Initial orientation: that of a roundel with a yaw; else the predicted one (or any), rotated by the smallest
/// rotation onto the first normal, then about it to match the directions between the roundels.
fn initial_orientation<'a>(
    terms: &[RoundelTerm],
    chosen: impl Fn(usize) -> &'a Normal,
    prediction: Option<&PredictedPose>,
) -> UnitQuaternion<f64> {
    let own = |index: usize| chosen(index).orientation * terms[index].mount.rotation.inverse();
    if let Some(index) = terms.iter().position(|term| term.yaw_symmetry == Some(1)) {
        return own(index);
    }
    let normal = chosen(0).orientation * Vector3::z();
    let orientation = match prediction {
        Some(prediction) => {
            let mounted = prediction.orientation * terms[0].mount.rotation * Vector3::z();
            let turn = smallest_turn(&mounted, &normal);
            UnitQuaternion::from_scaled_axis(turn) * prediction.orientation
        }
        None => own(0),
    };
    let across = |vector: Vector3<f64>| vector - normal * normal.dot(&vector);
    let offset = |index: usize| {
        let mounts = [index, 0].map(|index| terms[index].mount.translation.vector);
        across(orientation * (mounts[0] - mounts[1]))
    };
    let far = (1..terms.len())
        .max_by(|a, b| offset(*a).norm_squared().total_cmp(&offset(*b).norm_squared()));
    let Some(far) = far.filter(|far| offset(*far).norm() > 1e-3) else { return orientation };
    let (mounted, measured) = (offset(far), across(terms[far].position_m - terms[0].position_m));
    let angle = normal.dot(&mounted.cross(&measured)).atan2(mounted.dot(&measured));
    UnitQuaternion::from_scaled_axis(normal * angle) * orientation
}
