//! Where the refinement starts: the focal length from the views' homographies, and the board's places.
//!
//! With the homography H = [h₁ h₂ h₃] ([`Flat`]), the principal point in the middle, square pixels and no distortion, h₁ᵀ ω h₂ = 0 and h₁ᵀ ω h₁ = h₂ᵀ ω h₂ for ω = diag(w, w, 1),
//! w = 1/f² (Zhang 2000, section 3.1), two equations a w + b = 0 a view, solved in least squares.

use nalgebra::{Isometry3, Point2};

use crate::lens::{
    Coverage, LEAST_VIEWS, LensCalibrationError, Sighting, Target, View, views::homography::Flat,
};

/// Focal lengths that are believed, in widths of the picture.
const FOCAL_SHARES: (f64, f64) = (0.2, 20.0);

/// Views to begin with.
pub(crate) struct Started {
    pub(crate) focal_px: f64,
    /// By index of the view, those that are used.
    pub(crate) views: Vec<StartedView>,
}

/// One of them.
pub(crate) struct StartedView {
    pub(crate) index: usize,
    pub(crate) pose: Isometry3<f64>,
    pub(crate) sightings: Vec<(Point2<f64>, Sighting)>,
}

/// Focal length and the board's places, by the views that are not blurred.
pub(crate) fn start(
    target: &Target,
    size: (usize, usize),
    views: &[View],
    blurred: &[bool],
) -> Result<Started, LensCalibrationError> {
    let flats: Vec<(usize, Flat)> = views
        .iter()
        .enumerate()
        .filter(|(index, _)| !blurred[*index])
        .filter_map(|(index, view)| Some((index, Flat::of(target, view)?)))
        .collect();
    let mut coverage = Coverage::new(size);
    for (index, flat) in &flats {
        coverage.add(&views[*index], flat, size);
    }
    let (found, missing) = (flats.len(), coverage.wants());
    if found < LEAST_VIEWS {
        return Err(LensCalibrationError::TooFew { found, missing });
    }
    let focal_px = coverage.is_tilted().then(|| focal_px(&flats, size)).flatten();
    let Some(focal_px) = focal_px else {
        return Err(LensCalibrationError::TooSimilar { found, missing });
    };
    let views = flats.into_iter().filter_map(|(index, flat)| {
        let pose = flat.pose(focal_px, size)?;
        Some(StartedView { index, pose, sightings: flat.sightings })
    });
    let views: Vec<_> = views.collect();
    if views.len() < LEAST_VIEWS {
        return Err(LensCalibrationError::TooFew { found: views.len(), missing });
    }
    Ok(Started { focal_px, views })
}

fn focal_px(flats: &[(usize, Flat)], size: (usize, usize)) -> Option<f64> {
    let (mut ab, mut aa) = (0.0, 0.0);
    for (_, flat) in flats {
        let h = flat.centered(size);
        // Columns of a length near one, so that views count alike.
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
    let (least, most) = FOCAL_SHARES;
    (least * width..=most * width).contains(&focal_px).then_some(focal_px)
}
