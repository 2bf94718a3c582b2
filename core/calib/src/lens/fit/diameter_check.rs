//! Compares the apparent ratio of diameter and pitch with the stated one.
//!
//! The lens follows from the positions of centres. A wrong diameter or pitch hardly shows in the residuals but biases the
//! result: with 60 mm stated for a board of 36 mm, focal lengths are off by thirty of their stated deviations.
//!
//! For each view, the mean observed radius r is compared with the mean radius e predicted from the calibrated lens and the
//! stated dimensions. Blooming changes all radii by a fraction of a pixel b, at any distance, so
//!
//! r = w e + b
//!
//! over all views separates w from b, the better the more the distances differ. w - 1 is the relative error of diameter
//! over pitch. Which of the two is wrong cannot be determined, nor an error of both, since a picture of a plane has no
//! absolute scale. On renderings of correctly stated prints |w - 1| is below 0.001 (`tests/tests/lens.rs`); ink spread
//! contributes as well: 0.1 mm at the rim of 30 mm roundels is 0.007.

use nalgebra::Vector2;

use super::rim;
use crate::lens::{LensCalibration, LensCalibrationError, MIN_VIEWS, Sighting, Target, View};
use crate::robust::median;

/// Maximum relative error that still yields a calibration.
const MAX_DEVIATION_SHARE: f64 = 0.05;
/// A relative error beyond this and this number of deviations causes a warning. Ink spread stays below it.
const DOUBTFUL_SHARE: f64 = 0.01;
const DEVIATIONS: f64 = 3.0;

/// Apparent ratio of diameter to pitch of a board's roundels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiameterCheck {
    /// Apparent over stated ratio of diameter to pitch.
    pub ratio: f64,
    /// Standard deviation of the ratio.
    pub deviation: f64,
    /// Stated diameter, millimetres.
    pub outer_mm: f64,
    /// Stated pitch, millimetres.
    pub pitch_mm: f64,
}

impl DiameterCheck {
    /// Whether the stated dimensions are probably wrong, beyond ink spread and noise.
    pub fn is_doubtful(&self) -> bool {
        (self.ratio - 1.0).abs() > DOUBTFUL_SHARE.max(DEVIATIONS * self.deviation)
    }

    /// Diameter that matches the stated pitch, millimetres.
    pub fn found_outer_mm(&self) -> f64 {
        self.outer_mm * self.ratio
    }

    /// Pitch that matches the stated diameter, millimetres.
    pub fn found_pitch_mm(&self) -> f64 {
        self.pitch_mm / self.ratio
    }
}

/// Checks the dimensions of a board of roundels. Returns an error if they are so wrong that the lens is unusable,
/// and `None` if the views do not determine the ratio.
pub(crate) fn check(
    target: &Target,
    views: &[View],
    found: &LensCalibration,
) -> Result<Option<DiameterCheck>, LensCalibrationError> {
    let Some(rim_m) = target.rim_m() else { return Ok(None) };
    let (mut ratios, mut means) = (Vec::new(), Vec::new());
    for (view, fit) in views.iter().zip(&found.views) {
        let Ok(fit) = fit else { continue };
        // Expected and observed radius.
        let pair = |one: &Sighting| {
            let center = target.point_m(one.number)?;
            let expected = rim::project_rim(&found.camera, &fit.pose, &center, rim_m).ok()?;
            Some(Vector2::new(expected.radius_px, one.radius_px))
        };
        let pairs: Vec<Vector2<f64>> = view.sightings.iter().filter_map(pair).collect();
        ratios.extend(pairs.iter().map(|pair| pair.y / pair.x));
        if !pairs.is_empty() {
            means.push(pairs.iter().sum::<Vector2<f64>>() / pairs.len() as f64);
        }
    }
    let stated = DiameterCheck {
        ratio: 1.0,
        deviation: 0.0,
        outer_mm: rim_m * 2e3,
        pitch_mm: target.pitch_m() * 1e3,
    };
    match median(&mut ratios) {
        Some(ratio) if (ratio - 1.0).abs() > MAX_DEVIATION_SHARE => {
            let found = DiameterCheck { ratio, ..stated };
            Err(LensCalibrationError::OtherWidth {
                outer_mm: found.outer_mm,
                pitch_mm: found.pitch_mm,
                found_outer_mm: found.found_outer_mm(),
                found_pitch_mm: found.found_pitch_mm(),
            })
        }
        _ => {
            let slope = fit_slope(&means);
            Ok(slope.map(|(ratio, deviation)| DiameterCheck { ratio, deviation, ..stated }))
        }
    }
}

/// Slope of the least-squares line with its standard deviation; `None` if undetermined.
fn fit_slope(points: &[Vector2<f64>]) -> Option<(f64, f64)> {
    if points.len() < MIN_VIEWS {
        return None;
    }
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector2<f64>>() / count;
    let offsets: Vec<Vector2<f64>> = points.iter().map(|point| point - mean).collect();
    let squares: f64 = offsets.iter().map(|it| it.x * it.x).sum();
    let slope = offsets.iter().map(|it| it.x * it.y).sum::<f64>() / squares;
    let rest: f64 = offsets.iter().map(|it| (it.y - slope * it.x).powi(2)).sum();
    let deviation = (rest / (count - 2.0) / squares).sqrt();
    (slope.is_finite() && deviation.is_finite()).then_some((slope, deviation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_of_a_line_is_fitted_with_its_deviation() {
        let line = |x: f64| Vector2::new(x, 1.02 * x - 0.4);
        let (ratio, deviation) = fit_slope(&[10.0, 20.0, 25.0, 30.0, 40.0].map(line)).unwrap();
        assert!((ratio - 1.02).abs() < 1e-12 && deviation < 1e-12, "{ratio} ± {deviation}");
        let off = [0.1, -0.1, 0.0, -0.1, 0.1];
        let points = [0, 1, 2, 3, 4].map(|x| Vector2::new(2.0 * x as f64, off[x]));
        let (ratio, deviation) = fit_slope(&points).unwrap();
        assert!(ratio.abs() < 1e-12, "{ratio}");
        assert!((deviation - (0.04f64 / 3.0 / 40.0).sqrt()).abs() < 1e-12, "{deviation}");
        // Equal distances, and too few points.
        assert_eq!(fit_slope(&[Vector2::new(10.0, 10.0); 9]), None);
        assert_eq!(fit_slope(&[10.0, 20.0, 30.0, 40.0].map(line)), None);
    }
}
