//! The sensor model of the paper (section 5, equations 12 to 20) for a pinhole, for comparison; with the corrections in
//! `core/docs/errata.md`.
//!
//! Symbols are those of the paper: d₀ is the roundel's outer diameter, φ and ψ its tilts, D the minimum detected diameter
//! in pixels, ε the uncertainties of the lens' coefficients. Distances are measured from the image plane, along the optical
//! axis.

use std::f64::consts::FRAC_PI_4;

/// D of equation (14): the diameter that WhyCon detects reliably, pixels.
pub const MIN_DIAMETER_PX: f64 = 12.0;
/// Typical Δe₀ of equation (19), pixels.
pub const AXIS_ERROR_PX: f64 = 0.15;

/// An ideal pinhole with a roundel in front of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// w and h, pixels.
    pub size_px: [f64; 2],
    /// fₓ and f_y, pixels.
    pub focal_px: [f64; 2],
    /// d₀, metres.
    pub outer_m: f64,
    /// φ and ψ, radians.
    pub tilt_rad: [f64; 2],
    /// D, pixels.
    pub min_px: f64,
    /// kₓ and k_y of equation (15) in the relevant corner ([`shrink`]); 1 without distortion.
    pub shrink: [f64; 2],
}

impl Pinhole {
    /// Equation (12): width and height of the pattern at this distance, pixels.
    pub fn pattern_px(&self, distance_m: f64) -> [f64; 2] {
        [0, 1]
            .map(|axis| self.focal_px[axis] * self.outer_m / distance_m * self.tilt_rad[axis].cos())
    }

    /// Equation (13): v_min, metres.
    pub fn min_distance_m(&self) -> f64 {
        let per_size = [0, 1].map(|axis| self.focal_px[axis] / self.size_px[axis]);
        self.outer_m * per_size[0].max(per_size[1])
    }

    /// Equation (14): v′_max, on the optical axis, metres.
    pub fn max_distance_m(&self) -> f64 {
        Self { shrink: [1.0; 2], ..*self }.max_corner_distance_m()
    }

    /// Equation (15): v_max, at the picture's corners, metres.
    pub fn max_corner_distance_m(&self) -> f64 {
        let seen =
            [0, 1].map(|axis| self.shrink[axis] * self.focal_px[axis] * self.tilt_rad[axis].cos());
        self.outer_m / self.min_px * seen[0].min(seen[1])
    }

    /// Equation (16): v_y and v_z, the base at v_max, metres.
    pub fn base_m(&self) -> [f64; 2] {
        let max_m = self.max_corner_distance_m();
        [0, 1].map(|axis| self.size_px[axis] * max_m / self.focal_px[axis] - 2.0 * self.outer_m)
    }
}

/// kₓ and k_y of equation (15): scale of the image along both axes at (x, y) of the plane z = 1, for `plumb_bob`
/// coefficients (k₁ k₂ p₁ p₂ k₃). The equation ignores p₁ and p₂.
pub fn shrink([k1, k2, _, _, k3]: [f64; 5], [x, y]: [f64; 2]) -> [f64; 2] {
    let r2 = x * x + y * y;
    let factor = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
    let slope = 2.0 * (k1 + 2.0 * k2 * r2 + 3.0 * k3 * r2.powi(2));
    [factor + x * x * slope, factor + y * y * slope]
}

/// Equations (17) and (18), η_hom: relative position error at (x, y) of the plane z = 1 for uncertainties ε₁ to ε₅
/// of the coefficients (k₁ k₂ p₁ p₂ k₃).
pub fn lens_share([k1, k2, p1, p2, k3]: [f64; 5], [x, y]: [f64; 2]) -> f64 {
    let (x, y) = (x.abs(), y.abs());
    let r2 = x * x + y * y;
    let radial = k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
    let along = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
    let across = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y);
    along.hypot(across)
}

/// Equation (19): relative distance error from Δf / f, Δe₀ and e₀ (pixels, longer semiaxis of the outer rim) and
/// η_hom. They are independent and add in squares.
pub fn range_share(
    focal_share: f64,
    axis_error_px: f64,
    semi_major_px: f64,
    lens_share: f64,
) -> f64 {
    focal_share.hypot(axis_error_px / semi_major_px).hypot(lens_share)
}

/// s_p: pixels of a pattern.
pub fn pattern_pixels(diameter_px: f64) -> f64 {
    FRAC_PI_4 * diameter_px.powi(2)
}

/// Constants of equation (20) for one machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speed {
    /// k₀ o: time per pattern, seconds.
    pub pattern_s: f64,
    /// k₁ o: time per pixel of a pattern, seconds.
    pub pixel_s: f64,
    /// Time per pixel of a searched image, seconds; the paper uses `pixel_s`.
    pub searched_pixel_s: f64,
}

impl Speed {
    /// The paper's constants and example: two cores with 53·10⁹ operations per second in total.
    pub const PAPER: Speed = Speed {
        pattern_s: 5e5 * 2.0 / 53e9,
        pixel_s: 900.0 * 2.0 / 53e9,
        searched_pixel_s: 900.0 * 2.0 / 53e9,
    };

    /// Equation (20): seconds per frame for `count` patterns of this diameter, of which the share α is lost and
    /// searched in all `image_px` pixels.
    pub fn frame_s(&self, count: usize, diameter_px: f64, lost_share: f64, image_px: f64) -> f64 {
        let followed_s = self.pixel_s * pattern_pixels(diameter_px) * (1.0 - lost_share);
        let searched_s = self.searched_pixel_s * image_px * lost_share;
        count as f64 * (self.pattern_s + followed_s + searched_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 50 patterns of 30 px on two cores and 53 GIPS: 2.1 ms, where the paper prints 1.2.
    #[test]
    fn the_example_of_equation_20_is_reproduced() {
        let frame_s = Speed::PAPER.frame_s(50, 30.0, 0.0, 640.0 * 480.0);
        assert!((frame_s - 2.14e-3).abs() < 1e-5, "{frame_s}");
        let lost_s = Speed::PAPER.frame_s(50, 30.0, 1.0, 640.0 * 480.0);
        let searched_s = 50.0 * 900.0 * 640.0 * 480.0 * 2.0 / 53e9;
        assert!((lost_s / searched_s - 1.0).abs() < 0.01, "{lost_s}");
    }

    #[test]
    fn distances_scale_as_in_the_equations() {
        let pinhole = Pinhole {
            size_px: [640.0, 480.0],
            focal_px: [500.0, 500.0],
            outer_m: 0.06,
            tilt_rad: [0.0, 0.0],
            min_px: MIN_DIAMETER_PX,
            shrink: [0.9, 0.95],
        };
        assert!((pinhole.min_distance_m() - 0.06 * 500.0 / 480.0).abs() < 1e-12);
        assert!((pinhole.max_distance_m() - 2.5).abs() < 1e-12);
        assert!((pinhole.max_corner_distance_m() - 2.25).abs() < 1e-12);
        let tilted = Pinhole { tilt_rad: [1.0, 0.0], ..pinhole };
        assert!((tilted.max_distance_m() / 2.5 - 1f64.cos()).abs() < 1e-12);
        assert!((pinhole.pattern_px(2.5)[0] - 12.0).abs() < 1e-12);
        let [wide, high] = pinhole.base_m();
        assert!((wide - (640.0 * 2.25 / 500.0 - 0.12)).abs() < 1e-12 && high < wide);
        // Three thousandths of the focal length, 0.06 of 15 px, and twelve thousandths for the lens.
        let share = range_share(3e-3, 0.06, 15.0, 12e-3);
        assert!((share - 13e-3).abs() < 1e-12, "{share}");
    }

    #[test]
    fn shrink_is_the_derivative_of_the_distortion() {
        let bent = [-0.12, 0.05, 0.0, 0.0, -0.01];
        let distorted = |x: f64, y: f64| {
            let r2 = x * x + y * y;
            let factor = 1.0 + bent[0] * r2 + bent[1] * r2.powi(2) + bent[4] * r2.powi(3);
            [x * factor, y * factor]
        };
        let (x, y, step) = (0.5, -0.3, 1e-6);
        let along_x = (distorted(x + step, y)[0] - distorted(x - step, y)[0]) / (2.0 * step);
        let along_y = (distorted(x, y + step)[1] - distorted(x, y - step)[1]) / (2.0 * step);
        let [k_x, k_y] = shrink(bent, [x, y]);
        assert!((k_x - along_x).abs() < 1e-6 && (k_y - along_y).abs() < 1e-6);
    }

    #[test]
    fn an_exact_lens_adds_no_error_and_corners_are_symmetric() {
        assert_eq!(lens_share([0.0; 5], [0.3, 0.2]), 0.0);
        let at = |x: f64, y: f64| lens_share([1e-3, 1e-3, 1e-4, 1e-4, 1e-3], [x, y]);
        assert!(at(0.0, 0.0) == 0.0 && at(0.1, 0.05) < at(0.4, 0.2));
        assert_eq!(at(0.4, 0.2), at(-0.4, 0.2));
        assert_eq!(at(0.4, 0.2), at(0.4, -0.2));
    }
}
