//! Whether the roundels of a board look as wide, beside the way from one to the next, as is said of it.
//!
//! The lens follows from where centres are, so a wrong diameter or pitch hardly shows in the residuals, but moves what is
//! found all the same: of a board with 36 mm that is called one with 60, focal lengths are off by thirty of their stated
//! deviations.

use nalgebra::{Isometry3, Point3, Vector3};

use super::{LensCalibration, LensCalibrationError, Target, view::View};
use crate::camera::Camera;

/// What a print may be off by: ink that runs and pictures that bloom take some percent of small roundels.
const SHARE: f64 = 0.05;
/// Points of a rim of which the area is taken.
const STEPS: usize = 32;

/// An error, if the lens was found from roundels of another diameter or pitch than is said.
pub(super) fn check(
    target: &Target,
    views: &[View],
    found: &LensCalibration,
) -> Result<(), LensCalibrationError> {
    let Some(rim_m) = target.rim_m() else { return Ok(()) };
    let mut ratios = Vec::new();
    for (view, fit) in views.iter().zip(&found.views) {
        let Ok(fit) = fit else { continue };
        for sighting in &view.sightings {
            let Some(center) = target.at(sighting.number) else { continue };
            let center = Point3::new(center.x, center.y, 0.0);
            let expected_px = radius_px(&found.camera, &fit.pose, center, rim_m);
            ratios.extend(expected_px.map(|expected_px| sighting.radius_px / expected_px));
        }
    }
    ratios.sort_by(f64::total_cmp);
    match ratios.get(ratios.len() / 2) {
        Some(&ratio) if (ratio - 1.0).abs() > SHARE => Err(LensCalibrationError::OtherWidth {
            outer_mm: rim_m * 2e3,
            pitch_mm: target.pitch_m() * 1e3,
            found_outer_mm: rim_m * 2e3 * ratio,
            found_pitch_mm: target.pitch_m() * 1e3 / ratio,
        }),
        _ => Ok(()),
    }
}

/// Radius of the circle with the area of a rim's image; `None` where the lens does not reach.
pub(super) fn radius_px(
    camera: &Camera,
    pose: &Isometry3<f64>,
    center: Point3<f64>,
    rim_m: f64,
) -> Option<f64> {
    let at = |step: usize| {
        let (sin, cos) = (std::f64::consts::TAU * step as f64 / STEPS as f64).sin_cos();
        camera.project(&(pose * (center + Vector3::new(cos, sin, 0.0) * rim_m)).coords).ok()
    };
    let mut twice_px2 = 0.0;
    let mut before = at(0)?;
    for step in 1..=STEPS {
        let next = at(step)?;
        twice_px2 += before.u * next.v - next.u * before.v;
        before = next;
    }
    // The polygon's corners lie on the rim, so its area is a little less than the ellipse's.
    let step_rad = std::f64::consts::TAU / STEPS as f64;
    let share = step_rad.sin() / step_rad;
    Some((0.5 * twice_px2.abs() / share / std::f64::consts::PI).sqrt())
}
