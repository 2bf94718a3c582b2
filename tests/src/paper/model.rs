//! The sensor model of the paper's section 5, as corrected in `core/docs/errata.md`, with Roundel's constants.
//!
//! Two of these are not the paper's: D, the smallest diameter, is [`LEAST_PX`]; and Δe₀, the error of the ellipse's axis, which the paper takes as 0.15 px, follows from noise
//! and blur ([`axis_error_px`]), since a fit to the grey levels is limited by nothing else.

use std::f64::consts::PI;

use super::scene::RATIO;
use crate::{
    optics::{Distortion, Pinhole},
    render::Imaging,
};

/// The paper's Δe₀, pixels.
pub const PAPER_AXIS_ERROR_PX: f64 = 0.15;

/// D: the shorter diameter from which on roundels are found reliably, pixels. The detector takes them from 8 px on
/// by default; from 10 px on it finds all (`cargo run -p roundel-tests --bin recall`).
pub const LEAST_PX: f64 = 10.0;

/// k_x and k_y of equation 15 at (x, y) of the plane z = 1: by how much the lens shrinks along u and v there.
pub fn shrinking(optics: &Pinhole, x: f64, y: f64) -> [f64; 2] {
    let Distortion::PlumbBob([k1, k2, _, _, k3]) = optics.distortion else { return [1.0; 2] };
    let r2 = x * x + y * y;
    let g = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
    let slope = 2.0 * (k1 + 2.0 * k2 * r2 + 3.0 * k3 * r2.powi(2));
    [g + x * x * slope, g + y * y * slope]
}

/// Equation 15: how far a roundel is found, metres, where the lens shrinks by `shrinking`; with 1 equation 14.
pub fn farthest_m(optics: &Pinhole, outer_m: f64, tilt_rad: f64, shrinking: [f64; 2]) -> f64 {
    let along = |axis: usize| shrinking[axis] * optics.focal_px[axis] * tilt_rad.cos();
    outer_m / LEAST_PX * along(0).min(along(1))
}

/// Equation 16: width and height of what is covered at that distance, metres.
pub fn base_m(optics: &Pinhole, farthest_m: f64, outer_m: f64) -> [f64; 2] {
    let side = |pixels: usize, focal_px: f64| pixels as f64 * farthest_m / focal_px - 2.0 * outer_m;
    [side(optics.width, optics.focal_px[0]), side(optics.height, optics.focal_px[1])]
}

/// Equations 17 and 18: error of a place by the lens' distortion, as a share of the distance, at (x, y) of the
/// plane z = 1 when the coefficients' deviations are these (k1 k2 p1 p2 k3).
pub fn lens_share([k1, k2, p1, p2, k3]: [f64; 5], x: f64, y: f64) -> f64 {
    let r2 = x * x + y * y;
    let radial = k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
    let across = x.abs() * radial + 2.0 * p1 * (x * y).abs() + p2 * (r2 + 2.0 * x * x);
    let down = y.abs() * radial + 2.0 * p2 * (x * y).abs() + p1 * (r2 + 2.0 * y * y);
    across.hypot(down)
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

/// Equation 19: error of a roundel's distance as a share of it; independent errors add in squares.
pub fn range_share(
    focal_share: f64,
    axis_error_px: f64,
    semi_major_px: f64,
    lens_share: f64,
) -> f64 {
    focal_share.hypot(axis_error_px / semi_major_px).hypot(lens_share)
}

/// The constants of equation 20 on one machine.
#[derive(Clone, Copy, Debug)]
pub struct Speed {
    /// k₀ o: of each roundel whatever its size, seconds.
    pub roundel_s: f64,
    /// k₁ o: of each of its pixels, seconds.
    pub pixel_s: f64,
    /// Of each pixel of an image that is searched, seconds; the paper's is the same as `pixel_s`.
    pub searched_pixel_s: f64,
}

impl Speed {
    /// The paper's constants and its example: two cores of 53·10⁹ instructions a second in all.
    pub const PAPER: Speed = Speed {
        roundel_s: 5e5 * 2.0 / 53e9,
        pixel_s: 900.0 * 2.0 / 53e9,
        searched_pixel_s: 900.0 * 2.0 / 53e9,
    };

    /// From the time of one roundel each at two diameters, and that of searching one pixel.
    pub fn between([small, large]: [(f64, f64); 2], searched_pixel_s: f64) -> Self {
        let pixel_s = (large.1 - small.1) / (pixels(large.0) - pixels(small.0));
        Self { roundel_s: small.1 - pixel_s * pixels(small.0), pixel_s, searched_pixel_s }
    }

    /// Equation 20: time of a frame, seconds, of whose roundels the share `lost` (α) has to be searched for in an
    /// image of so many pixels.
    pub fn frame_s(&self, count: usize, diameter_px: f64, lost: f64, image_px: f64) -> f64 {
        let followed_s = self.pixel_s * pixels(diameter_px) * (1.0 - lost);
        count as f64 * (self.roundel_s + followed_s + self.searched_pixel_s * image_px * lost)
    }
}

/// s_p: pixels of a roundel.
pub fn pixels(diameter_px: f64) -> f64 {
    PI / 4.0 * diameter_px.powi(2)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    #[test]
    fn shrinking_is_the_slope_of_the_lens() {
        let lens = Distortion::PlumbBob([-0.12, 0.05, 0.0, 0.0, -0.01]);
        let optics = Pinhole::centered(1280, 720, 900.0, lens);
        let at = |x: f64, y: f64| optics.project(&Point3::new(x, y, 1.0)).unwrap() / 900.0;
        let (x, y, step) = (0.5, -0.3, 1e-6);
        let along_x = (at(x + step, y) - at(x - step, y)).x / (2.0 * step);
        let along_y = (at(x, y + step) - at(x, y - step)).y / (2.0 * step);
        let [k_x, k_y] = shrinking(&optics, x, y);
        assert!((k_x - along_x).abs() < 1e-6 && (k_y - along_y).abs() < 1e-6);
    }

    /// The example of the paper's section 5.3, as corrected: 2.1 ms.
    #[test]
    fn the_papers_example() {
        let frame_s = Speed::PAPER.frame_s(50, 30.0, 0.0, 0.0);
        assert!((frame_s - 2.14e-3).abs() < 1e-5, "{frame_s}");
    }

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
}
