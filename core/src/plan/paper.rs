//! The sensor model as the paper has it (section 5, equations 12 to 20), for an ideal pinhole and for comparison.
//!
//! Symbols are the paper's: d₀ the roundel's outer diameter, φ and ψ its tilts, D the least diameter in pixels that
//! is found, ε the uncertainties of the lens' coefficients. Distances are those from the image plane, along the
//! optical axis.

/// D of equation (14): the diameter that WhyCon finds reliably, pixels.
pub const LEAST_DIAMETER_PX: f64 = 12.0;
/// Δe₀ of equation (19), typically, pixels.
pub const AXIS_ERROR_PX: f64 = 0.15;
/// k₀ of equation (20), operations a pattern.
pub const OPERATIONS_PER_PATTERN: f64 = 5e5;
/// k₁ of equation (20), operations a pixel of a pattern.
pub const OPERATIONS_PER_PIXEL: f64 = 900.0;

/// An ideal pinhole with the roundel before it.
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
    pub least_px: f64,
    /// kₓ and k_y of equation (15); 1 where the lens does not shrink corners.
    pub shrink: [f64; 2],
}

impl Pinhole {
    /// Equation (12): width and height of the pattern at this distance, pixels.
    pub fn pattern_px(&self, distance_m: f64) -> [f64; 2] {
        [0, 1]
            .map(|axis| self.focal_px[axis] * self.outer_m / distance_m * self.tilt_rad[axis].cos())
    }

    /// Equation (13): v_min, metres.
    pub fn least_distance_m(&self) -> f64 {
        let per_size = [0, 1].map(|axis| self.focal_px[axis] / self.size_px[axis]);
        self.outer_m * per_size[0].max(per_size[1])
    }

    /// Equation (14): v′_max, on the optical axis, metres.
    pub fn most_distance_m(&self) -> f64 {
        Self { shrink: [1.0; 2], ..*self }.most_corner_distance_m()
    }

    /// Equation (15): v_max, at the picture's corners, metres.
    pub fn most_corner_distance_m(&self) -> f64 {
        let seen =
            [0, 1].map(|axis| self.shrink[axis] * self.focal_px[axis] * self.tilt_rad[axis].cos());
        self.outer_m / self.least_px * seen[0].min(seen[1])
    }

    /// Equation (16): v_y and v_z, the base at v_max, metres.
    pub fn base_m(&self) -> [f64; 2] {
        let most_m = self.most_corner_distance_m();
        [0, 1].map(|axis| self.size_px[axis] * most_m / self.focal_px[axis] - 2.0 * self.outer_m)
    }

    /// Equation (19): the distance's error as a share of it, from Δf (pixels), Δe₀ (pixels) and η_rad.
    pub fn depth_share(
        &self,
        distance_m: f64,
        focal_error_px: f64,
        axis_error_px: f64,
        radial_share: f64,
    ) -> f64 {
        let per_pixel = distance_m / (self.focal_px[0] * self.outer_m);
        focal_error_px / self.focal_px[0] + axis_error_px * per_pixel + radial_share
    }
}

/// kₓ and k_y below equation (15) for the radial coefficients k₁ and k₂, at a corner (rₓ, r_y) in focal lengths.
pub fn shrink(k1: f64, k2: f64, [x, y]: [f64; 2]) -> [f64; 2] {
    let along = |own: f64, other: f64| {
        1.0 + 2.0 * k1 * own + 4.0 * k2 * (own.powi(3) + own * other.powi(2))
    };
    [along(x, y), along(y, x)]
}

/// Equations (17) and (18): η_hom, the relative error of a place (x, y) in focal lengths by the uncertainties of k₁, k₂,
/// p₁, p₂, k₃ (ε₁ to ε₅).
pub fn radial_share([x, y]: [f64; 2], epsilon: [f64; 5]) -> f64 {
    let [e1, e2, e3, e4, e5] = epsilon;
    let r = x * x + y * y;
    let radial = e1 * r + e2 * r.powi(2) + e5 * r.powi(3);
    let along = x * (radial + 2.0 * e3 * y) + e4 * (r + 2.0 * x * x);
    let across = y * (radial + 2.0 * e4 * x) + e3 * (r + 2.0 * y * y);
    along.hypot(across)
}

/// Equation (20): seconds a frame for `count` patterns of `pattern_px` pixels, of which the share α is lost and searched
/// in all `image_px` pixels, on a processor of `operations_hz` operations a second and `cores` cores.
pub fn frame_time_s(
    pattern_px: f64,
    image_px: f64,
    lost_share: f64,
    count: f64,
    (operations_hz, cores): (f64, f64),
) -> f64 {
    let pixels = pattern_px * (1.0 - lost_share) + image_px * lost_share;
    (OPERATIONS_PER_PATTERN + OPERATIONS_PER_PIXEL * pixels) * count * cores / operations_hz
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 50 patterns of 30 px on two cores and 53 GIPS. The paper says 1.2 ms, which its own equation does not give.
    #[test]
    fn the_papers_example_of_time_is_what_its_equation_gives() {
        let pattern_px = std::f64::consts::FRAC_PI_4 * 900.0;
        let time_s = frame_time_s(pattern_px, 640.0 * 480.0, 0.0, 50.0, (53e9, 2.0));
        assert!((time_s * 1e3 - 2.1).abs() < 0.1, "{time_s}");
    }

    #[test]
    fn distances_scale_as_the_equations_say() {
        let pinhole = Pinhole {
            size_px: [640.0, 480.0],
            focal_px: [500.0, 500.0],
            outer_m: 0.06,
            tilt_rad: [0.0, 0.0],
            least_px: LEAST_DIAMETER_PX,
            shrink: [0.9, 0.95],
        };
        assert!((pinhole.least_distance_m() - 0.06 * 500.0 / 480.0).abs() < 1e-12);
        assert!((pinhole.most_distance_m() - 2.5).abs() < 1e-12);
        assert!((pinhole.most_corner_distance_m() - 2.25).abs() < 1e-12);
        let tilted = Pinhole { tilt_rad: [1.0, 0.0], ..pinhole };
        assert!((tilted.most_distance_m() / 2.5 - 1f64.cos()).abs() < 1e-12);
        assert!((pinhole.pattern_px(2.5)[0] - 12.0).abs() < 1e-12);
        let [wide, high] = pinhole.base_m();
        assert!((wide - (640.0 * 2.25 / 500.0 - 0.12)).abs() < 1e-12 && high < wide);
        // One pixel of focal length in 500, 0.15 of 30 px, and a tenth of a percent by the lens.
        let share = pinhole.depth_share(1.0, 1.0, AXIS_ERROR_PX, 1e-3);
        assert!((share - (0.002 + 0.005 + 0.001)).abs() < 1e-12);
    }

    #[test]
    fn a_lens_known_exactly_adds_nothing_and_the_middle_is_known_best() {
        assert_eq!(radial_share([0.3, 0.2], [0.0; 5]), 0.0);
        let at = |x: f64| radial_share([x, 0.5 * x], [1e-3, 1e-3, 1e-4, 1e-4, 1e-3]);
        assert!(at(0.0) == 0.0 && at(0.1) < at(0.4));
    }
}
