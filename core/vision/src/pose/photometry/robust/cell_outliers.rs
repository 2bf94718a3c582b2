//! Rejection of cells that disagree with the model.
//!
//! A cell's [`CellFit`](super::cells::CellFit) states how far its rim is off the model's, relative
//! to the noise, and what remains of its pixels' residuals then. Most cells of a usable ring are
//! undisturbed, so the medians over all cells describe an undisturbed one. Cells far beyond them
//! are rejected, and may return. The spread of the remaining cells widens the variance of every
//! pixel.

use super::{RobustFit, RobustScratch, cells::Reference};
use crate::pose::photometry::solver::normal_equations::NormalEquations;

/// Limit of δ²/var(δ) of a cell, relative to the median.
const MAX_SQUARE: f64 = 12.0;
/// Limit of the variance of a cell's pixels above the median, in standard deviations.
const MAX_SPREAD: f64 = 5.0;
/// Model error, as a share of the contrast.
const MODEL_SHARE: f64 = 0.01;
/// Range of a cell's contrast over that of the reference.
const CONTRAST: (f64, f64) = (0.2, 3.0);
/// Median of χ² with one degree of freedom.
const MEDIAN_SQUARE: f64 = 0.455;
/// Degrees of freedom of pose and blur.
const FITTED: f64 = 6.0;

impl RobustFit<'_> {
    /// Updates which cells are kept; returns whether any changed.
    pub(super) fn reject_outliers(&mut self) -> bool {
        let taken = self.taken;
        let RobustScratch { cells, list, .. } = &mut *self.scratch;
        let mut reference = self.reference;
        list.clear();
        list.extend(
            cells.iter().filter_map(|cell| Some(cell.evaluate(&reference, &taken)?.variance)),
        );
        reference.noise2 = median(list).max(1.0 / 12.0);
        list.clear();
        list.extend(
            cells.iter().filter_map(|cell| Some(cell.evaluate(&reference, &taken)?.square)),
        );
        let scale = (median(list) / MEDIAN_SQUARE).max(reference.noise2);
        let missed = (MODEL_SHARE * reference.levels[1]).powi(2);
        let mut changed = false;
        for cell in cells {
            let kept = cell.evaluate(&reference, &taken).is_some_and(|evaluate| {
                let spread = 1.0 + MAX_SPREAD * (2.0 / (cell.pixels() - 3.0).max(1.0)).sqrt();
                evaluate.square < MAX_SQUARE * scale
                    && evaluate.variance < reference.noise2 * spread + missed
                    && (CONTRAST.0..CONTRAST.1).contains(&evaluate.contrast)
            });
            changed |= kept != cell.kept;
            cell.kept = kept;
        }
        changed
    }

    /// Factor on the variance of a pixel that makes the cells agree.
    pub(super) fn variance_growth(&self, linear: &NormalEquations) -> f64 {
        let reference = Reference { noise2: linear.noise2(), ..self.reference };
        let kept = self.scratch.cells.iter().filter(|cell| cell.kept);
        let (mut sum, mut count) = (0.0, 0.0);
        for evaluate in kept.filter_map(|cell| cell.evaluate(&reference, &self.taken)) {
            sum += evaluate.square / reference.noise2;
            count += 1.0;
        }
        (sum / (count - FITTED).max(1.0)).max(1.0)
    }

    /// Share of kept cells, of the rim with the smaller one.
    pub(super) fn share_kept(&self) -> f64 {
        let cells = &self.scratch.cells;
        let share = |rim: usize| {
            let all = cells.iter().filter(|cell| cell.rim == rim).count() as f64;
            cells.iter().filter(|cell| cell.rim == rim && cell.kept).count() as f64 / all
        };
        share(0).min(share(1))
    }
}

fn median(list: &mut [f64]) -> f64 {
    let middle = list.len() / 2;
    if list.is_empty() {
        return 0.0;
    }
    *list.select_nth_unstable_by(middle, f64::total_cmp).1
}
