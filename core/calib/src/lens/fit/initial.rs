//! Initial estimate: focal length from the homographies of the views, then the board's poses.
//!
//! With the homography H = [h₁ h₂ h₃] ([`BoardHomography`]), the principal point in the middle of the picture, square
//! pixels and no distortion, h₁ᵀ ω h₂ = 0 and h₁ᵀ ω h₁ = h₂ᵀ ω h₂ for ω = diag(w, w, 1) and w = 1/f² (Zhang 2000,
//! section 3.1): two equations a w + b = 0 per view, solved by least squares.

use super::bundle::BoardView;
use crate::lens::{
    Coverage, LensCalibrationError, MIN_VIEWS, Target, View, views::homography::BoardHomography,
};

/// Plausible focal lengths in picture widths.
const FOCAL_SHARES: (f64, f64) = (0.2, 20.0);

pub(crate) struct InitialEstimate {
    pub(crate) focal_px: f64,
    pub(crate) views: Vec<BoardView>,
}

/// Focal length and board poses from the views that are not blurred.
pub(crate) fn estimate(
    target: &Target,
    size: (usize, usize),
    views: &[View],
    blurred: &[bool],
) -> Result<InitialEstimate, LensCalibrationError> {
    let homography = |index: usize| Some((index, BoardHomography::fit(target, &views[index])?));
    let sharp = (0..views.len()).filter(|index| !blurred[*index]);
    let homographies: Vec<(usize, BoardHomography)> = sharp.filter_map(homography).collect();
    let mut coverage = Coverage::new(size);
    for (index, homography) in &homographies {
        coverage.add(&views[*index], homography);
    }
    let (found, missing) = (homographies.len(), coverage.missing_views());
    if found < MIN_VIEWS {
        return Err(LensCalibrationError::TooFew { found, missing });
    }
    let focal_px = coverage.is_tilted().then(|| focal_px(&homographies, size)).flatten();
    let Some(focal_px) = focal_px else {
        return Err(LensCalibrationError::TooSimilar { found, missing });
    };
    let views = homographies.into_iter().filter_map(|(index, homography)| {
        Some(BoardView::new(index, homography.pose(focal_px, size)?, &homography.sightings))
    });
    let views: Vec<_> = views.collect();
    if views.len() < MIN_VIEWS {
        return Err(LensCalibrationError::TooFew { found: views.len(), missing });
    }
    Ok(InitialEstimate { focal_px, views })
}

fn focal_px(homographies: &[(usize, BoardHomography)], size: (usize, usize)) -> Option<f64> {
    let (mut ab, mut aa) = (0.0, 0.0);
    for (_, homography) in homographies {
        let h = homography.centered(size);
        // Normalizes the columns so that all views have equal weight.
        let scale = 1.0 / (0.5 * (h.column(0).norm_squared() + h.column(1).norm_squared()));
        let dot = |one: usize, other: usize| {
            let (a, b) = (h.column(one), h.column(other));
            (scale * (a.x * b.x + a.y * b.y), scale * a.z * b.z)
        };
        let ((a, b), (a11, b11), (a22, b22)) = (dot(0, 1), dot(0, 0), dot(1, 1));
        for (a, b) in [(a, b), (a11 - a22, b11 - b22)] {
            ab += a * b;
            aa += a * a;
        }
    }
    let focal_px = (-aa / ab).sqrt();
    let width = size.0.max(size.1) as f64;
    let (min, max) = FOCAL_SHARES;
    (min * width..=max * width).contains(&focal_px).then_some(focal_px)
}
