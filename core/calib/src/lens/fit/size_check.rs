//! Whether the roundels of a board look as wide, beside the way from one to the next, as is said of it.
//!
//! The lens follows from where centres are, so a wrong diameter or pitch hardly shows in the residuals, but moves what is
//! found all the same: of a board with 36 mm that is called one with 60, focal lengths are off by thirty of their stated
//! deviations.
//!
//! Of each view, the mean radius of its rims r is held against the one that the lens and what is said foretell, e. Pictures
//! that bloom make rims wider or narrower by some part of a pixel b, near or far; so
//!
//! r = w e + b
//!
//! over all views tells w apart from b, the better the more their distances differ. w - 1 is what diameter and pitch are
//! off by against each other. Which of them it is cannot be told, nor anything of both, since nothing in a picture of a
//! plane has a length. What is left in w of rendered prints that are as they are said is below 0.001
//! (`tests/tests/lens.rs`); ink that runs is in it as well, a tenth of a millimetre of the rim of one of 30 mm being 0.007.

use nalgebra::Point2;

use super::rim;
use crate::lens::{LEAST_VIEWS, LensCalibration, LensCalibrationError, Target, View};

/// What a print may be off by before there is no lens.
const SHARE: f64 = 0.05;
/// What it may be off by before somebody is told, beside this many deviations: more than ink runs.
const DOUBTED_SHARE: f64 = 0.01;
const DEVIATIONS: f64 = 3.0;

/// How wide a board's roundels look beside their pitch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Width {
    /// Over what is said: diameter over pitch, by how rims grow from view to view.
    pub ratio: f64,
    /// Its deviation.
    pub deviation: f64,
    /// Diameter as said, millimetres.
    pub outer_mm: f64,
    /// From centre to centre as said, millimetres.
    pub pitch_mm: f64,
}

impl Width {
    /// Whether what is said looks wrong, by more than a print is off by and by more than chance.
    pub fn is_doubtful(&self) -> bool {
        (self.ratio - 1.0).abs() > DOUBTED_SHARE.max(DEVIATIONS * self.deviation)
    }

    /// Diameter as it looks if the pitch is as said, millimetres.
    pub fn found_outer_mm(&self) -> f64 {
        self.outer_mm * self.ratio
    }

    /// From centre to centre as it looks if the diameter is as said, millimetres.
    pub fn found_pitch_mm(&self) -> f64 {
        self.pitch_mm / self.ratio
    }
}

/// How wide they look, of a board of roundels whose views tell; an error, if the lens was found from roundels of quite
/// another diameter or pitch than is said.
pub(crate) fn check(
    target: &Target,
    views: &[View],
    found: &LensCalibration,
) -> Result<Option<Width>, LensCalibrationError> {
    let Some(rim_m) = target.rim_m() else { return Ok(None) };
    let (mut ratios, mut means) = (Vec::new(), Vec::new());
    for (view, fit) in views.iter().zip(&found.views) {
        let Ok(fit) = fit else { continue };
        let pair = |number: u16, radius_px: f64| {
            let center: Point2<f64> = target.at(number)?;
            let expected = rim::image(&found.camera, &fit.pose, &center, rim_m).ok()?;
            Some((expected.radius_px, radius_px))
        };
        let sightings = view.sightings.iter();
        let pairs: Vec<_> = sightings.filter_map(|one| pair(one.number, one.radius_px)).collect();
        ratios.extend(pairs.iter().map(|(expected_px, seen_px)| seen_px / expected_px));
        let mean =
            |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
        if !pairs.is_empty() {
            means.push((mean(|pair| pair.0), mean(|pair| pair.1)));
        }
    }
    let said = Width {
        ratio: 1.0,
        deviation: 0.0,
        outer_mm: rim_m * 2e3,
        pitch_mm: target.pitch_m() * 1e3,
    };
    ratios.sort_by(f64::total_cmp);
    match ratios.get(ratios.len() / 2) {
        Some(&ratio) if (ratio - 1.0).abs() > SHARE => {
            let found = Width { ratio, ..said };
            Err(LensCalibrationError::OtherWidth {
                outer_mm: found.outer_mm,
                pitch_mm: found.pitch_mm,
                found_outer_mm: found.found_outer_mm(),
                found_pitch_mm: found.found_pitch_mm(),
            })
        }
        _ => Ok(slope(&means).map(|(ratio, deviation)| Width { ratio, deviation, ..said })),
    }
}

/// Of the line through these points by least squares, and its deviation; `None` if they do not tell.
fn slope(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let count = points.len() as f64;
    if points.len() < LEAST_VIEWS {
        return None;
    }
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
        points.iter().map(|point| of(point.0 - x, point.1 - y)).sum()
    };
    let (squares, products) = (sum(&|x, _| x * x), sum(&|x, y| x * y));
    let slope = products / squares;
    let left = sum(&|x, y| (y - slope * x).powi(2)) / (count - 2.0);
    let deviation = (left / squares).sqrt();
    (slope.is_finite() && deviation.is_finite()).then_some((slope, deviation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_told_with_its_deviation() {
        let line = |x: f64| (x, 1.02 * x - 0.4);
        let (ratio, deviation) = slope(&[10.0, 20.0, 25.0, 30.0, 40.0].map(line)).unwrap();
        assert!((ratio - 1.02).abs() < 1e-12 && deviation < 1e-12, "{ratio} ± {deviation}");
        let off = [0.1, -0.1, 0.0, -0.1, 0.1];
        let points: Vec<_> = (0..5).map(|x| (2.0 * f64::from(x), off[x as usize])).collect();
        let (ratio, deviation) = slope(&points).unwrap();
        assert!(ratio.abs() < 1e-12, "{ratio}");
        assert!((deviation - (0.04f64 / 3.0 / 40.0).sqrt()).abs() < 1e-12, "{deviation}");
        // All from as far away, or too few.
        assert_eq!(slope(&[(10.0, 10.0); 9]), None);
        assert_eq!(slope(&[10.0, 20.0, 30.0, 40.0].map(line)), None);
    }
}
