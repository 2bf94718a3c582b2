//! Albedo of a point of a print, with edges widened by blur and motion: see [`super::patch`].

use roundel_vision::marker::{CodeLayout, Tooth};

/// Albedo of white paper and of black print.
pub(super) const WHITE: f32 = 0.90;
pub(super) const BLACK: f32 = 0.07;

/// A pixel's point of the plane, with its derivatives by u and v.
pub(super) struct PlanePoint {
    pub(super) x_m: f32,
    pub(super) y_m: f32,
    pub(super) x_by_px: [f32; 2],
    pub(super) y_by_px: [f32; 2],
    /// Motion during the exposure.
    pub(super) motion_px: [f32; 2],
    /// Variance of the blur.
    pub(super) variance_px2: f32,
}

/// Distance from the plane's origin, the factor from distances to standard deviations, and half of the blur's
/// variance along a rim.
pub(super) struct Radial {
    radius_m: f32,
    sharpness: f32,
    half_variance_m2: f32,
}

impl PlanePoint {
    /// Variance of the blur in the plane, for a coordinate with this gradient.
    #[inline(always)]
    pub(super) fn variance(&self, gradient: [f32; 2]) -> f32 {
        let along = self.motion_px[0] * gradient[0] + self.motion_px[1] * gradient[1];
        let slope = gradient[0] * gradient[0] + gradient[1] * gradient[1];
        self.variance_px2 * slope + along * along * (1.0 / 12.0)
    }

    /// 1 / standard deviation, in the plane, of an edge whose distance has this gradient.
    #[inline(always)]
    pub(super) fn sharpness(&self, gradient: [f32; 2]) -> f32 {
        1.0 / (self.variance(gradient) + 1e-24).sqrt()
    }

    #[inline(always)]
    pub(super) fn radial(&self) -> Radial {
        let squared = self.x_m * self.x_m + self.y_m * self.y_m + 1e-12;
        let radius_m = squared.sqrt();
        // Scaled by the radius, so that one division suffices.
        let gradient =
            [0, 1].map(|axis| self.x_m * self.x_by_px[axis] + self.y_m * self.y_by_px[axis]);
        let along =
            [0, 1].map(|axis| self.x_m * self.y_by_px[axis] - self.y_m * self.x_by_px[axis]);
        Radial {
            radius_m,
            sharpness: radius_m * self.sharpness(gradient),
            half_variance_m2: 0.5 * self.variance(along) / squared,
        }
    }

    /// Scales the plane so that the ellipse becomes the unit circle.
    #[inline(always)]
    pub(super) fn elliptical_albedo(&self, outer_radius_m: f32, semiaxes_m: [f32; 2]) -> f32 {
        let [per_x, per_y] = semiaxes_m.map(|semiaxis_m| 1.0 / semiaxis_m);
        let scaled = PlanePoint {
            x_m: self.x_m * per_x,
            y_m: self.y_m * per_y,
            x_by_px: self.x_by_px.map(|slope| slope * per_x),
            y_by_px: self.y_by_px.map(|slope| slope * per_y),
            ..*self
        };
        let black = self.radial().inside(outer_radius_m) - scaled.radial().inside(1.0);
        WHITE - (WHITE - BLACK) * black
    }

    /// Coverage of the half plane counter-clockwise of the ray from the origin with this cosine and sine.
    #[inline(always)]
    pub(super) fn beside(&self, cosine: f32, sine: f32) -> f32 {
        let gradient = [0, 1].map(|axis| cosine * self.y_by_px[axis] - sine * self.x_by_px[axis]);
        normal_cdf((cosine * self.y_m - sine * self.x_m) * self.sharpness(gradient))
    }

    #[inline(always)]
    pub(super) fn coded_albedo(&self, outer_radius_m: f32, teeth: &Teeth) -> f32 {
        let radial = self.radial();
        let disc = radial.inside(teeth.inner_radius_m);
        let mut share = 0.0;
        for [from_cosine, from_sine, to_cosine, to_sine] in teeth.edges() {
            // The difference of two half planes is the wedge, and negative on the opposite side. Their product
            // would be wrong for narrow teeth.
            let wedge = self.beside(*from_cosine, *from_sine) - self.beside(*to_cosine, *to_sine);
            share += wedge.max(0.0);
        }
        let black = radial.inside(outer_radius_m) - disc
            + (disc - radial.inside(teeth.core_radius_m)) * share.min(1.0);
        WHITE - (WHITE - BLACK) * black
    }

    /// Coverage of a rectangle.
    #[inline(always)]
    pub(super) fn within(&self, half_m: [f32; 2]) -> f32 {
        let across = self.sharpness(self.x_by_px);
        let along = self.sharpness(self.y_by_px);
        normal_cdf((half_m[0] - self.x_m.abs()) * across)
            * normal_cdf((half_m[1] - self.y_m.abs()) * along)
    }
}

impl Radial {
    /// Coverage of a disc.
    #[inline(always)]
    pub(super) fn inside(&self, radius_m: f32) -> f32 {
        let shift_m = self.half_variance_m2 / radius_m;
        normal_cdf((radius_m - self.radius_m - shift_m) * self.sharpness)
    }

    #[inline(always)]
    pub(super) fn ring_albedo(&self, outer_radius_m: f32, inner_radius_m: f32) -> f32 {
        WHITE - (WHITE - BLACK) * (self.inside(outer_radius_m) - self.inside(inner_radius_m))
    }
}

const MAX_TEETH: usize = CodeLayout::BITS.1 as usize;

/// Teeth of a coded roundel between the rim of the white disc and its core, each the wedge between two half planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Teeth {
    pub inner_radius_m: f32,
    pub core_radius_m: f32,
    /// Cosine and sine of the angles where a tooth begins and ends.
    edges: [[f32; 4]; MAX_TEETH],
    count: usize,
}

impl Teeth {
    /// `inner_radius_m` is the radius of the white disc between the teeth.
    pub fn new(layout: CodeLayout, word: u16, inner_radius_m: f32) -> Self {
        let mut edges = [[0.0; 4]; MAX_TEETH];
        let teeth = layout.teeth(word);
        for (edge, Tooth { from_rad, to_rad }) in edges.iter_mut().zip(&teeth) {
            let (from, to) = (from_rad.sin_cos(), to_rad.sin_cos());
            *edge = [from.1, from.0, to.1, to.0].map(|number| number as f32);
        }
        let core_radius_m = inner_radius_m * CodeLayout::CORE_SHARE as f32;
        Self { inner_radius_m, core_radius_m, edges, count: teeth.len() }
    }

    /// Cosine and sine of the angles where each tooth begins and ends.
    pub fn edges(&self) -> &[[f32; 4]] {
        &self.edges[..self.count]
    }
}

/// Standard normal distribution, accurate to 2e-7 (Abramowitz and Stegun 7.1.28, without a branch).
#[inline(always)]
pub(super) fn normal_cdf(x: f32) -> f32 {
    // Constant beyond 6 standard deviations, where powers would overflow.
    let t = (x.abs() * std::f32::consts::FRAC_1_SQRT_2).min(4.5);
    let series = 1.0
        + t * (0.070_523_08
            + t * (0.042_282_01
                + t * (0.009_270_527
                    + t * (0.000_152_014_3 + t * (0.000_276_567_2 + t * 0.000_043_063_8)))));
    let power2 = series * series;
    let power4 = power2 * power2;
    let power8 = power4 * power4;
    let half_tail = 0.5 / (power8 * power8);
    0.5 + (0.5 - half_tail).copysign(x)
}
