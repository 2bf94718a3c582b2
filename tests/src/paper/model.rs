//! Predictions by the sensor model of the paper's section 5 ([`roundel_core::plan::paper`]) for Roundel's columns.
//!
//! Two constants differ from the paper's: D, the smallest diameter, is [`MIN_DIAMETER_PX`]; and Δe₀, the error of the
//! ellipse's axis, which the paper takes as 0.15 px, follows from noise and blur ([`axis_error_px`]), the only limits
//! of a fit to the grey levels.

use std::f64::consts::PI;

use roundel_core::plan::paper;

use super::scene::RATIO;
use crate::{
    optics::{Distortion, Pinhole},
    render::Imaging,
};

/// D: the shorter diameter from which on roundels are found reliably. By default the detector accepts 8 px; from 10
/// px on it finds all (`cargo run -p roundel-tests -- recall`).
pub const MIN_DIAMETER_PX: f64 = 10.0;

/// The model's camera, with Roundel's D, a lens that shrinks by `shrink`, and a roundel that is tilted about the axis
/// that shortens it more.
pub fn pinhole(optics: &Pinhole, outer_m: f64, tilt_rad: f64, shrink: [f64; 2]) -> paper::Pinhole {
    paper::Pinhole {
        size_px: [optics.width as f64, optics.height as f64],
        focal_px: optics.focal_px,
        outer_m,
        tilt_rad: [tilt_rad; 2],
        min_px: MIN_DIAMETER_PX,
        shrink,
    }
}

/// k_x and k_y of equation 15 at (x, y) on the plane z = 1. The model supports `plumb_bob` lenses only.
pub fn shrinking(optics: &Pinhole, x: f64, y: f64) -> [f64; 2] {
    match optics.distortion {
        Distortion::PlumbBob(coefficients) => paper::shrink(coefficients, [x, y]),
        Distortion::Equidistant(_) => [1.0; 2],
    }
}

/// Δe₀: deviation, pixels, of the outer rim's longer semiaxis from a fit of both rims that is limited by noise alone.
///
/// A blurred edge of height h gives its position with a variance of σ² 2√π s/h² per pixel of its length, s² = blur² +
/// 1/12. For the displacements δa cos²φ + δb sin²φ of two free semiaxes, the means of cos⁴φ, sin⁴φ and cos²φ sin²φ
/// are 3/8, 3/8 and 1/8, which gives δa three times the variance of a size alone.
pub fn axis_error_px(imaging: &Imaging, semiaxes_px: [f64; 2]) -> f64 {
    let blur_px = (imaging.blur_px.powi(2) + 1.0 / 12.0).sqrt();
    let variance = imaging.noise.powi(2) + 1.0 / 12.0;
    let variance_per_length =
        (imaging.white - imaging.black).powi(2) / (2.0 * PI.sqrt() * blur_px * variance);
    let [major, minor] = semiaxes_px;
    // The inner rim is shorter by the ratio, and moves less by the same ratio.
    let around_px =
        PI * (3.0 * (major + minor) - ((3.0 * major + minor) * (major + 3.0 * minor)).sqrt());
    (3.0 / (variance_per_length * around_px * (1.0 + RATIO.powi(3)))).sqrt()
}

/// Expected maximum of errors that vary about these means like distances on a plane (Rayleigh): the integral of 1 - Π
/// (1 - exp(-π x² / 4 m²)) over x.
pub fn expected_max(means: &[f64]) -> f64 {
    const STEPS: usize = 2000;
    // Beyond six times the largest mean the integrand vanishes.
    let step = 6.0 * means.iter().copied().fold(0.0, f64::max) / STEPS as f64;
    if step <= 0.0 {
        return 0.0;
    }
    let is_more = |x: f64| {
        let below = |mean: &f64| 1.0 - (-0.25 * PI * (x / mean.max(1e-300)).powi(2)).exp();
        1.0 - means.iter().map(below).product::<f64>()
    };
    (0..STEPS).map(|number| is_more((number as f64 + 0.5) * step) * step).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with the bound of a roundel's depth in rendered pixels, tilted so that both axes are free.
    #[test]
    fn the_axis_error_matches_the_bound() {
        use crate::{
            bound::{Scene, Unknowns, bound},
            paper::scene::{printed, slanted},
        };
        let optics = Pinhole::centered(256, 256, 1000.0, Distortion::NONE);
        let imaging = Imaging::default();
        let (_, print) = printed(0.15);
        let pose = slanted(nalgebra::Vector3::new(0.0, 0.0, 3.0), 0.6, 0.3);
        let scene = Scene { camera: optics, imaging, print: &print, pose, motion_px: [0.0; 2] };
        let exact = bound(&scene, Unknowns::default()).unwrap().range_share;
        let semiaxes_px = [25.0, 25.0 * 0.6f64.cos()];
        let share = axis_error_px(&imaging, semiaxes_px) / semiaxes_px[0];
        assert!((share / exact - 1.0).abs() < 0.15, "{share} {exact}");
    }

    #[test]
    fn expected_maxima_are_those_of_rayleigh_distributions() {
        assert!((expected_max(&[0.3]) - 0.3).abs() < 1e-4);
        // Two equal means: m (2 - 1/√2).
        assert!((expected_max(&[0.3, 0.3]) - 0.3 * (2.0 - 0.5f64.sqrt())).abs() < 1e-4);
        assert!((expected_max(&[0.3, 0.0]) - 0.3).abs() < 1e-4 && expected_max(&[]) == 0.0);
    }
}
