//! Fit of the small rigid motion of a camera that best explains its residuals.
//!
//! Object i lies at the lever arm aᵢ from the camera; its residual is rᵢ with covariance Sᵢ, Wᵢ = Sᵢ⁻¹. A camera that
//! moved by δ = (δt, δθ) has rᵢ = -Jᵢ δ, J = [I | -[a]×]. δ minimizes Σ ρ(eᵢᵀ Wᵢ eᵢ), e = r + J δ, with Huber's ρ, so
//! that a single object that jumps has little weight. Gauss-Newton: Λ = Σ w Jᵀ W J + Λ₀, δ = -Λ⁻¹ Σ w Jᵀ W r.
//!
//! The baseline δ̄ comes from decaying sums of Λ and Λ δ over frames. The gain is the cost at δ̄ less that at δ, over
//! the excess of the remaining cost.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use roundel_vision::id::CameraId;

/// √e above which an object's cost is linear.
const ROBUST: f64 = 4.0;
/// Largest number of other cameras that an object is compared with.
pub(crate) const MAX_OTHERS: usize = 4;
/// Number of reweightings.
const STEPS: usize = 3;
/// Prior standard deviations of translation and rotation.
const PRIOR_M: f64 = 0.2;
const PRIOR_RAD: f64 = 0.1;
/// Number of unknowns.
const NUMBERS: usize = 6;

/// Residual of one object.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObjectResidual {
    /// From the camera to the object, world frame.
    pub(crate) arm_m: Vector3<f64>,
    /// Observed less expected position.
    pub(crate) residual_m: Vector3<f64>,
    /// Inverse covariance of the residual.
    pub(crate) weight: Matrix3<f64>,
    /// Cameras that observed it recently.
    pub(crate) others: [Option<CameraId>; MAX_OTHERS],
}

/// A fitted motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shift {
    information: Matrix6<f64>,
    baseline: Vector6<f64>,
    change: Vector6<f64>,
    pub(super) gain: f64,
    /// Rms motion of the detections against the baseline, metres.
    pub(super) moved_m: f64,
}

/// Usual motion of a camera.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Baseline {
    information: Matrix6<f64>,
    score: Vector6<f64>,
}

impl ObjectResidual {
    pub(super) fn is_by(&self, camera: CameraId) -> bool {
        self.others.contains(&Some(camera))
    }

    /// J δ.
    fn displacement(&self, change: &Vector6<f64>) -> Vector3<f64> {
        change.fixed_rows::<3>(0) + change.fixed_rows::<3>(3).cross(&self.arm_m)
    }

    /// e and eᵀ W e.
    fn remaining(&self, change: &Vector6<f64>) -> (Vector3<f64>, f64) {
        let remaining_m = self.residual_m + self.displacement(change);
        (remaining_m, remaining_m.dot(&(self.weight * remaining_m)))
    }
}

impl Baseline {
    /// Adds a frame, `seconds` after the one before.
    pub(super) fn add(&mut self, shift: &Shift, seconds: f64, lasts_s: f64) {
        let kept = (-seconds.max(0.0) / lasts_s).exp();
        self.information = self.information * kept + shift.information;
        self.score = self.score * kept + shift.information * shift.change;
    }

    fn change(&self) -> Vector6<f64> {
        let factor = (self.information + prior()).cholesky();
        factor.map_or_else(Vector6::zeros, |factor| factor.solve(&self.score))
    }
}

impl Shift {
    /// Gain of the same motion for other residuals.
    pub(super) fn gain_of(&self, residuals: &[ObjectResidual]) -> f64 {
        cost(residuals, &self.baseline) - cost(residuals, &self.change)
    }
}

/// `None` if the residuals have no valid covariance.
pub(super) fn fit(residuals: &[ObjectResidual], baseline: &Baseline) -> Option<Shift> {
    let baseline = baseline.change();
    let mut change = baseline;
    let mut information = prior();
    for _ in 0..STEPS {
        information = prior();
        let mut score = -prior() * change;
        for residual in residuals {
            let (remaining_m, squared) = residual.remaining(&change);
            let weight = residual.weight * (ROBUST / squared.sqrt()).min(1.0);
            let weighted = weight * remaining_m;
            let turned = residual.arm_m.cross(&weighted);
            score -= Vector6::new(weighted.x, weighted.y, weighted.z, turned.x, turned.y, turned.z);
            add_information(&mut information, &weight, &residual.arm_m);
        }
        change += information.cholesky()?.solve(&score);
    }
    let [before, remaining] = [&baseline, &change].map(|change| cost(residuals, change));
    let freedom = (3 * residuals.len()).saturating_sub(NUMBERS).max(1) as f64;
    let beyond_baseline = change - baseline;
    let moved = residuals
        .iter()
        .map(|residual| residual.displacement(&beyond_baseline).norm_squared())
        .sum::<f64>();
    Some(Shift {
        information: information - prior(),
        baseline,
        change,
        gain: (before - remaining) / (remaining / freedom).max(1.0),
        moved_m: (moved / residuals.len() as f64).sqrt(),
    })
}

fn cost(residuals: &[ObjectResidual], change: &Vector6<f64>) -> f64 {
    residuals.iter().map(|residual| robust(residual.remaining(change).1)).sum()
}

/// Adds Jᵀ W J.
fn add_information(sum: &mut Matrix6<f64>, weight: &Matrix3<f64>, arm_m: &Vector3<f64>) {
    let cross = arm_m.cross_matrix();
    let turned = cross * weight;
    let mut block = sum.fixed_view_mut::<3, 3>(0, 0);
    block += weight;
    let mut block = sum.fixed_view_mut::<3, 3>(3, 0);
    block += turned;
    let mut block = sum.fixed_view_mut::<3, 3>(0, 3);
    block += turned.transpose();
    let mut block = sum.fixed_view_mut::<3, 3>(3, 3);
    block -= turned * cross;
}

fn prior() -> Matrix6<f64> {
    let (place, turn) = (PRIOR_M.powi(-2), PRIOR_RAD.powi(-2));
    Matrix6::from_diagonal(&Vector6::new(place, place, place, turn, turn, turn))
}

/// Huber's cost.
fn robust(squared: f64) -> f64 {
    if squared <= ROBUST * ROBUST {
        squared
    } else {
        2.0 * ROBUST * squared.sqrt() - ROBUST * ROBUST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Objects in a row with a deviation of 1 mm, displaced by a motion of the camera.
    fn residuals(count: usize, change: &Vector6<f64>) -> Vec<ObjectResidual> {
        let residual = |index: usize| {
            let arm_m = Vector3::new(index as f64 - 2.0, (index * index % 5) as f64, -4.0);
            let weight = Matrix3::from_diagonal_element(1e6);
            let residual =
                ObjectResidual { arm_m, residual_m: Vector3::zeros(), weight, others: [None; 4] };
            ObjectResidual { residual_m: -residual.displacement(change), ..residual }
        };
        (0..count).map(residual).collect()
    }

    #[test]
    fn a_motion_is_estimated() {
        let change = Vector6::new(0.01, -0.02, 0.005, 0.001, 0.002, -0.003);
        let shift = fit(&residuals(8, &change), &Baseline::default()).unwrap();
        assert!((shift.change - change).amax() < 1e-4, "{}", shift.change);
        assert!(shift.gain > 1000.0 && shift.moved_m > 0.01, "{shift:?}");
    }

    #[test]
    fn a_single_jumping_object_has_little_weight() {
        let mut residuals = residuals(8, &Vector6::zeros());
        residuals[3].residual_m = Vector3::new(0.1, 0.0, 0.0);
        let shift = fit(&residuals, &Baseline::default()).unwrap();
        assert!(shift.moved_m < 2e-3, "{shift:?}");
    }

    #[test]
    fn a_constant_offset_becomes_the_baseline() {
        let change = Vector6::new(0.01, 0.0, 0.0, 0.0, 0.001, 0.0);
        let residuals = residuals(8, &change);
        let mut baseline = Baseline::default();
        for _ in 0..20 {
            let shift = fit(&residuals, &baseline).unwrap();
            baseline.add(&shift, 0.1, 2.0);
        }
        let shift = fit(&residuals, &baseline).unwrap();
        assert!(shift.gain < 1.0 && shift.moved_m < 1e-4, "{shift:?}");
    }
}
