//! Selection of the distortion model by Schwarz's criterion.
//!
//! For a model with k parameters that fits n numbers with the sum of squares S, the criterion is n ln(S/n) + k ln n
//! (Schwarz 1978); the lowest value is best. A simpler model is selected unless the evidence against it is strong, a
//! difference of 6 (Kass, Raftery 1995). If a coefficient is zero in truth, noise alone prefers the model with it for 1 of
//! 150 lenses, and with strong evidence for 1 of 5,000.

use super::{
    bundle::Bundle,
    distortion_model::DistortionModel,
    initial::InitialEstimate,
    parameters::{CameraParameters, PINHOLE_COUNT},
};
use crate::lens::{LensCalibration, Target, ViewFit, ViewRejection};

/// Difference of the criterion beyond which the evidence against a simpler model is strong.
pub const STRONG_EVIDENCE: f64 = 6.0;

/// Evidence for a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// The model.
    pub model: DistortionModel,
    /// Rms distance of observed and predicted centres, pixels.
    pub rms_px: f64,
    /// Schwarz's criterion minus the lowest one. 0 is the best model; [`STRONG_EVIDENCE`] or more is strong
    /// evidence against a model.
    pub against: f64,
}

/// Fits all `models` and selects one; returns `None` if none converges. `blurred` views are not in `initial`.
pub(crate) fn select_model(
    target: &Target,
    size: (usize, usize),
    initial: &InitialEstimate,
    models: &[DistortionModel],
    blurred: &[bool],
) -> Option<LensCalibration> {
    let scored = |&model: &DistortionModel| {
        let bundle = Bundle {
            parameters: CameraParameters::new(size, initial.focal_px, model),
            rim_m: target.rim_m(),
            board_views: initial.views.clone(),
        };
        let fit = bundle.fit()?;
        let (count, parameters) = (fit.count as f64, (PINHOLE_COUNT + model.free().len()) as f64);
        let criterion = (fit.squares / count).max(1e-300).ln() * count + parameters * count.ln();
        Some(ScoredFit { model, rms_px: fit.rms_px, criterion, count, fit })
    };
    let (model, fit, evidence) = select_fit(models.iter().filter_map(scored).collect())?;
    let why = |&blurred: &bool| {
        if blurred { ViewRejection::Blurred } else { ViewRejection::Contradicts }
    };
    let mut views: Vec<_> = blurred.iter().map(|blurred| Err(why(blurred))).collect();
    let mut outliers = 0;
    for board_view in &fit.board_views {
        let initial_view = initial.views.iter().find(|view| view.index == board_view.index);
        outliers += initial_view.map_or(0, |view| view.points.len()) - board_view.points.len();
        views[board_view.index] = Ok(ViewFit {
            pose: board_view.pose,
            rms_px: board_view.rms_px(&fit.camera),
            roundels: board_view.points.len(),
        });
    }
    Some(LensCalibration {
        camera: fit.camera,
        model,
        covariance: fit.covariance,
        rms_px: fit.rms_px,
        views,
        outliers,
        evidence,
        diameter_check: None,
    })
}

pub(crate) struct ScoredFit<T> {
    pub(crate) model: DistortionModel,
    pub(crate) rms_px: f64,
    pub(crate) criterion: f64,
    /// Number of fitted values.
    pub(crate) count: f64,
    pub(crate) fit: T,
}

/// The selected model with its fit, and the evidence for all, best first.
pub(crate) fn select_fit<T>(
    mut fits: Vec<ScoredFit<T>>,
) -> Option<(DistortionModel, T, Vec<Evidence>)> {
    // Compares only fits of about the same number of values: a model that rejects half of the views fits the rest
    // well.
    let max = fits.iter().map(|it| it.count).max_by(f64::total_cmp)?;
    fits.retain(|it| it.count * 10.0 >= max * 9.0);
    // Per value, since models reject different views.
    let cost = |it: &ScoredFit<T>| it.criterion / it.count * max;
    fits.sort_by(|one, other| cost(one).total_cmp(&cost(other)));
    let min = cost(fits.first()?);
    let evidence: Vec<Evidence> = fits
        .iter()
        .map(|it| Evidence { model: it.model, rms_px: it.rms_px, against: cost(it) - min })
        .collect();
    let ScoredFit { model, fit, .. } = fits.swap_remove(simplest(&evidence)?);
    Some((model, fit, evidence))
}

/// Index of the selected model: among those without strong evidence against them, the one with the fewest
/// coefficients, then the best.
fn simplest(evidence: &[Evidence]) -> Option<usize> {
    let stays = |&index: &usize| evidence[index].against < STRONG_EVIDENCE;
    let key = |index: &usize| (evidence[*index].model.free().len(), evidence[*index].against);
    (0..evidence.len()).filter(stays).min_by(|one, other| {
        let (one, other) = (key(one), key(other));
        one.0.cmp(&other.0).then(one.1.total_cmp(&other.1))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coefficient_needs_strong_evidence() {
        let evidence = |of: &[(DistortionModel, f64)]| -> Vec<Evidence> {
            let one = |&(model, against): &(DistortionModel, f64)| Evidence {
                model,
                rms_px: 0.1,
                against,
            };
            of.iter().map(one).collect()
        };
        use DistortionModel::{Equidistant, PlumbBob, Radial2, Rational, Tangential};
        let of =
            |list: &[(DistortionModel, f64)]| simplest(&evidence(list)).map(|index| list[index].0);
        // A superfluous k3 that noise prefers, and a real one.
        assert_eq!(of(&[(PlumbBob, 0.0), (Tangential, 2.5), (Radial2, 80.0)]), Some(Tangential));
        assert_eq!(of(&[(PlumbBob, 0.0), (Tangential, 6.5), (Radial2, 80.0)]), Some(PlumbBob));
        assert_eq!(
            of(&[(Equidistant, 0.0), (Tangential, 3.0), (Rational, 1.0)]),
            Some(Equidistant)
        );
        assert_eq!(of(&[]), None);
    }
}
