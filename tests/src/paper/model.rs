//! What Roundel's columns take from the sensor model of the paper's section 5 ([`roundel_core::plan::paper`]).
//!
//! Two constants are not the paper's: D, the smallest diameter, is [`LEAST_PX`]; and Δe₀, the error of the ellipse's
//! axis, which the paper takes as 0.15 px, follows from noise and blur ([`axis_error_px`]), since a fit to the grey
//! levels is limited by nothing else.

use std::f64::consts::PI;

use roundel_core::plan::paper;

use super::scene::RATIO;
use crate::{
    optics::{Distortion, Pinhole},
    render::Imaging,
};

/// D: the shorter diameter from which on roundels are found reliably, pixels. The detector takes them from 8 px on
/// by default; from 10 px on it finds all (`cargo run -p roundel-tests --bin recall`).
pub const LEAST_PX: f64 = 10.0;

/// The model's camera, with Roundel's D, a lens that shrinks by `shrink`, and a roundel that is tilted about
/// whichever axis shortens it more.
pub fn pinhole(optics: &Pinhole, outer_m: f64, tilt_rad: f64, shrink: [f64; 2]) -> paper::Pinhole {
    paper::Pinhole {
        size_px: [optics.width as f64, optics.height as f64],
        focal_px: optics.focal_px,
        outer_m,
        tilt_rad: [tilt_rad; 2],
        min_px: LEAST_PX,
        shrink,
    }
}

/// k_x and k_y of equation 15 at (x, y) of the plane z = 1; the model knows only lenses of `plumb_bob`.
pub fn shrinking(optics: &Pinhole, x: f64, y: f64) -> [f64; 2] {
    match optics.distortion {
        Distortion::PlumbBob(coefficients) => paper::shrink(coefficients, [x, y]),
        Distortion::Equidistant(_) => [1.0; 2],
    }
}

/// Δe₀: deviation of the outer rim's longer semiaxis, pixels, that noise leaves to a fit of both rims.
///
/// A blurred edge of height h tells its place to σ² 2√π s/h² per pixel of its length, s² = blur² + 1/12. Of
/// the displacements δa cos²φ + δb sin²φ of two free semiaxes the means of cos⁴φ, sin⁴φ and cos²φ sin²φ are
/// 3/8, 3/8 and 1/8, which leaves δa three times the variance of a size alone.
pub fn axis_error_px(imaging: &Imaging, semiaxes_px: [f64; 2]) -> f64 {
    let blur_px = (imaging.blur_px.powi(2) + 1.0 / 12.0).sqrt();
    let variance = imaging.noise.powi(2) + 1.0 / 12.0;
    let of_length =
        (imaging.white - imaging.black).powi(2) / (2.0 * PI.sqrt() * blur_px * variance);
    let [major, minor] = semiaxes_px;
    // The inner rim is shorter by the ratio, and moves as much less.
    let around_px =
        PI * (3.0 * (major + minor) - ((3.0 * major + minor) * (major + 3.0 * minor)).sqrt());
    (3.0 / (of_length * around_px * (1.0 + RATIO.powi(3)))).sqrt()
}

/// The greatest of errors that vary about these means as distances on a plane do (Rayleigh), in the mean: the integral of
/// 1 - Π (1 - exp(-π x² / 4 m²)) over x.
pub fn greatest(means: &[f64]) -> f64 {
    const STEPS: usize = 2000;
    // Beyond six times the largest there is nothing.
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

    /// Against the bound of a roundel's depth in rendered pixels, tilted so that both axes are free.
    #[test]
    fn noise_leaves_the_axis_what_the_bound_says() {
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
    fn the_greatest_of_one_is_its_mean_and_of_many_what_maxima_are() {
        assert!((greatest(&[0.3]) - 0.3).abs() < 1e-4);
        // Of two alike: m (2 - 1/√2).
        assert!((greatest(&[0.3, 0.3]) - 0.3 * (2.0 - 0.5f64.sqrt())).abs() < 1e-4);
        assert!((greatest(&[0.3, 0.0]) - 0.3).abs() < 1e-4 && greatest(&[]) == 0.0);
    }
}
