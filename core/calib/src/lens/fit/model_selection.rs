//! Which distortion model: the one for which most speaks.
//!
//! Of models that explain n numbers with a sum of squares S by k parameters, that with the least n ln(S/n) + k ln n (Schwarz
//! 1978) is the likeliest. A simpler one is taken unless the evidence against it is strong, a difference of 6 (Kass, Raftery
//! 1995): of two models that differ by one coefficient, which is nothing in truth, noise alone makes the larger one likelier in
//! 1 of 150 lenses, and by so much in 1 of 5,000.

use super::{
    bundle::{Bundle, Fit},
    distortion_model::Model,
    initial::Started,
    parameters::PINHOLE,
};
use crate::lens::{LeftOut, LensCalibration, Target, ViewFit};

/// Evidence that is strong: by so much the criterion of a simpler model may be worse and it is taken.
pub const STRONG: f64 = 6.0;

/// What speaks for a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// The model.
    pub model: Model,
    /// Rms distance between seen and predicted centres, pixels.
    pub rms_px: f64,
    /// Schwarz's criterion less the least of them: 0 of the likeliest; [`STRONG`] is strong evidence against a model.
    pub against: f64,
}

/// The best model's fit.
pub(crate) struct Best {
    model: Model,
    fit: Fit,
    evidence: Vec<Evidence>,
}

/// `None` if no model converges.
pub(crate) fn best(
    target: &Target,
    size: (usize, usize),
    started: &Started,
    models: &[Model],
) -> Option<Best> {
    let judged = |&model: &Model| {
        let fit = Bundle::new(size, target.rim_m(), started, model).fit()?;
        let (count, parameters) = (fit.count as f64, (PINHOLE + model.free().len()) as f64);
        let criterion = (fit.squares / count).max(1e-300).ln() * count + parameters * count.ln();
        Some(Judged { model, rms_px: fit.rms_px, criterion, count, fit })
    };
    let (model, fit, evidence) = taken(models.iter().filter_map(judged).collect())?;
    Some(Best { model, fit, evidence })
}

/// A model's fit as it is judged.
pub(crate) struct Judged<T> {
    pub(crate) model: Model,
    pub(crate) rms_px: f64,
    /// Schwarz's.
    pub(crate) criterion: f64,
    /// Numbers that went into it.
    pub(crate) count: f64,
    pub(crate) fit: T,
}

/// The model that is taken with its fit, and what speaks against each, the likeliest first.
pub(crate) fn taken<T>(mut fits: Vec<Judged<T>>) -> Option<(Model, T, Vec<Evidence>)> {
    // Only among those that explain as much: a model that leaves out half of the views fits the rest well.
    let most = fits.iter().map(|it| it.count).max_by(f64::total_cmp)?;
    fits.retain(|it| it.count * 10.0 >= most * 9.0);
    // Models that leave out other views are told by what a number costs them.
    let cost = |it: &Judged<T>| it.criterion / it.count * most;
    fits.sort_by(|one, other| cost(one).total_cmp(&cost(other)));
    let least = cost(fits.first()?);
    let evidence: Vec<Evidence> = fits
        .iter()
        .map(|it| Evidence { model: it.model, rms_px: it.rms_px, against: cost(it) - least })
        .collect();
    let Judged { model, fit, .. } = fits.swap_remove(simplest(&evidence)?);
    Some((model, fit, evidence))
}

/// Which of the models is taken: of those against which there is no strong evidence one with the fewest coefficients, of equally
/// many the likeliest.
fn simplest(evidence: &[Evidence]) -> Option<usize> {
    let stays = |&index: &usize| evidence[index].against < STRONG;
    let key = |index: &usize| (evidence[*index].model.free().len(), evidence[*index].against);
    (0..evidence.len()).filter(stays).min_by(|one, other| {
        let (one, other) = (key(one), key(other));
        one.0.cmp(&other.0).then(one.1.total_cmp(&other.1))
    })
}

impl Best {
    /// As it is told, for so many views that were given.
    pub(crate) fn told(self, blurred: &[bool], started: &Started) -> LensCalibration {
        let Self { model, fit, evidence } = self;
        let why = |&blurred: &bool| if blurred { LeftOut::Blurred } else { LeftOut::Contradicts };
        let mut views: Vec<_> = blurred.iter().map(|blurred| Err(why(blurred))).collect();
        let mut outliers = 0;
        for station in &fit.stations {
            let begun = started.views.iter().find(|view| view.index == station.index);
            outliers += begun.map_or(0, |view| view.sightings.len()) - station.points.len();
            views[station.index] = Ok(ViewFit {
                pose: station.pose,
                rms_px: station.rms_px(&fit.camera),
                roundels: station.points.len(),
            });
        }
        LensCalibration {
            camera: fit.camera,
            model,
            covariance: fit.covariance,
            rms_px: fit.rms_px,
            views,
            outliers,
            evidence,
            width: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coefficient_needs_strong_evidence() {
        let evidence = |of: &[(Model, f64)]| -> Vec<Evidence> {
            let one = |&(model, against): &(Model, f64)| Evidence { model, rms_px: 0.1, against };
            of.iter().map(one).collect()
        };
        use Model::{Equidistant, PlumbBob, Radial2, Rational, Tangential};
        let of = |list: &[(Model, f64)]| simplest(&evidence(list)).map(|index| list[index].0);
        // A needless k3 that noise likes, and one that is there.
        assert_eq!(of(&[(PlumbBob, 0.0), (Tangential, 2.5), (Radial2, 80.0)]), Some(Tangential));
        assert_eq!(of(&[(PlumbBob, 0.0), (Tangential, 6.5), (Radial2, 80.0)]), Some(PlumbBob));
        assert_eq!(
            of(&[(Equidistant, 0.0), (Tangential, 3.0), (Rational, 1.0)]),
            Some(Equidistant)
        );
        assert_eq!(of(&[]), None);
    }
}
