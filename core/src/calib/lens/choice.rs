//! Which distortion model: the one for which most speaks.
//!
//! Of models that explain n numbers with a sum of squares S by k parameters, the one with the least n ln(S/n) + k ln n
//! is taken (Schwarz 1978): a further coefficient has to earn its keep.

use super::{
    LensCalibration, ViewFit,
    bundle::{Bundle, Fit},
    candidate::PINHOLE,
    model::Model,
    start::Started,
    target::Target,
};

/// What speaks for a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// The model.
    pub model: Model,
    /// Rms distance between seen and predicted centres, pixels.
    pub rms_px: f64,
    /// Schwarz's criterion; the smaller the better. Ten more is decisive.
    pub criterion: f64,
}

/// The best model's fit.
pub(super) struct Best {
    model: Model,
    fit: Fit,
    evidence: Vec<Evidence>,
}

/// `None` if no model converges.
pub(super) fn best(
    target: &Target,
    size: (usize, usize),
    started: &Started,
    models: &[Model],
) -> Option<Best> {
    let mut fits: Vec<(Evidence, Fit)> = models
        .iter()
        .filter_map(|&model| {
            let fit = Bundle::new(size, target.rim_m(), started, model).fit()?;
            let (count, parameters) = (fit.count as f64, (PINHOLE + model.free().len()) as f64);
            // Models that leave out other views are told by what a sighting costs them.
            let criterion =
                (fit.squares / count).max(1e-300).ln() * count + parameters * count.ln();
            Some((Evidence { model, rms_px: fit.rms_px, criterion }, fit))
        })
        .collect();
    // Only among those that explain as much: a model that leaves out half of the views fits the rest well.
    let most = fits.iter().map(|(_, fit)| fit.count).max()?;
    fits.retain(|(_, fit)| fit.count * 10 >= most * 9);
    fits.sort_by(|one, other| {
        let per_number = |it: &(Evidence, Fit)| it.0.criterion / it.1.count as f64;
        per_number(one).total_cmp(&per_number(other))
    });
    let evidence = fits.iter().map(|(evidence, _)| *evidence).collect();
    let (Evidence { model, .. }, fit) = fits.into_iter().next()?;
    Some(Best { model, fit, evidence })
}

impl Best {
    /// As it is told, for so many views that were given.
    pub(super) fn told(self, given: usize, started: &Started) -> LensCalibration {
        let Self { model, fit, evidence } = self;
        let mut views = vec![None; given];
        let mut outliers = 0;
        for station in &fit.stations {
            let begun = started.views.iter().find(|view| view.index == station.index);
            outliers += begun.map_or(0, |view| view.sightings.len()) - station.points.len();
            views[station.index] = Some(ViewFit {
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
        }
    }
}
