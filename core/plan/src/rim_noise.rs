//! Predicted noise of the rims that each mode of the detector finds.
//!
//! **Precise mode.** A straight edge of contrast C, blurred to s² = blur² + 1/12 by lens and pixel, has the variance
//!
//! v = σ² 2√π s / C²,  σ² = noise² + 1/12
//!
//! per unit of length (Fisher information of its pixels, ∫ g′² = C²/(2√π s); quantization adds 1/12). The fit to grey
//! levels reaches this bound except where disc or ring is hardly wider than the blur.
//!
//! **Fast mode.** Moments weigh all pixels of a band of width w alike ([`roundel_vision::marker`]):
//!
//! v = σ² w / C²
//!
//! - Compensation computes both radii from both rims; for the ratio r, 1/(r (1 + r)) of the outer radius' variance remains
//!   instead of the optimum 1/(1 + r³).
//! - Light beyond the cut at distance d, m(d) = ∫ Φ(-x/s) dx from d on, enters the levels and shifts the rims by what one
//!   correction leaves: m(d)/(ρ - d) for a disc of radius ρ, m(d) for the ring. The cut is nearer where the band does not fit.
//! - The end of the band is at a random position on the pixels, so this light varies along the rim.
//!
//! The factors were fitted to rendered roundels of 14 to 90 px, ratios of 0.35 to 0.6, blurs of 0.5 to 1.1 px, noise of 1
//! to 4 levels and tilts up to 55°. Below about 30 px they are corrected by trials (`monte_carlo`).

use std::f64::consts::{PI, TAU};

use super::{Imaging, Sensor, roundel_image::RoundelImage};
use roundel_vision::{
    marker::{Kind, Mode, WIDE_PX},
    normal_distribution::Beyond,
    pose::RimNoise,
};

/// Residual shift of a rim by blur and bloom, pixels, and growth of errors with the fourth power of blur over the
/// narrower one of disc and ring. Fitted to set-ups other than those of the comparison.
const FIT_FLOOR_PX: f64 = 0.0005;
const FIT_BLURRED: f64 = 20.0;
/// Fitted to 200 set-ups other than those of the comparison. Growth of noise with the square of blur over disc and
/// ring; residual noise of a radius …
const MOMENTS_BLURRED: f64 = 3.8;
const MOMENTS_SIZE: f64 = 2.9;
/// … noise by light beyond the band's end …
const MOMENTS_END: f64 = 2.1;
/// … shift by light mixed into the levels; for the disc in pixels.
const MIXED_DISC_PX: f64 = 0.86;
const MIXED_BLACK: f64 = 0.28;
/// Minimum semiaxis of the disc's core and minimum width of the ring besides the bands, pixels.
const MIN_CORE_PX: f64 = 1.6;
const MIN_BLACK_PX: f64 = 1.4;
/// Minimum distance of a cut from its rim, pixels.
const MIN_CUT_PX: f64 = 0.2;

/// Rim noise of a ring in the sensor's mode.
pub fn rim_noise(sensor: &Sensor, kind: &Kind, image: &RoundelImage) -> RimNoise {
    let Imaging { noise, blur_px, .. } = sensor.imaging;
    let variance = noise.powi(2) + 1.0 / 12.0;
    let spread_px = (blur_px.powi(2) + 1.0 / 12.0).sqrt();
    let per_length = 2.0 * PI.sqrt() * spread_px / sensor.imaging.contrast().powi(2);
    let edge_px = (variance * per_length).sqrt();
    // The narrower one of disc and ring determines how much is blurred away.
    let (min, max) = kind.ratios();
    let semi_px = 0.5 * image.minor_px;
    let (disc_px, black_px) = (semi_px * min, semi_px * (1.0 - max));
    match sensor.mode {
        Mode::Precise => {
            let blurred = spread_px / disc_px.min(black_px);
            let growth = 1.0 + FIT_BLURRED * blurred.powi(4);
            let (edge_px, floor_px) = (edge_px * growth, FIT_FLOOR_PX * growth);
            RimNoise { edge_px, floor_px, is_of_ring: true }
        }
        Mode::Fast => {
            let of_belt = variance * 2.0 * WIDE_PX / sensor.imaging.contrast().powi(2);
            let moments = Moments { of_belt, spread_px, disc_px, black_px };
            moments.noise(image.ring.outer.mean_radius_px(), kind.ratio())
        }
    }
}

/// Parameters of the rim noise by moments.
struct Moments {
    /// Variance per unit of length by the noise of a band's pixels, pixels³.
    of_belt: f64,
    /// Blur of the edge, pixels.
    spread_px: f64,
    /// Shorter semiaxis of the disc, and width of the ring along it, pixels.
    disc_px: f64,
    black_px: f64,
}

impl Moments {
    /// For a ring with this outer radius and ratio of diameters.
    fn noise(&self, radius_px: f64, ratio: f64) -> RimNoise {
        let Self { of_belt, spread_px, disc_px, black_px } = *self;
        let beyond_px = |cut_px: f64| Beyond::new(cut_px, spread_px).moved_px;
        let cut_px = |available_px: f64| available_px.clamp(MIN_CUT_PX, WIDE_PX);
        let blurred = (spread_px / disc_px).powi(2) + (spread_px / black_px).powi(2);
        let edge_px = of_belt.sqrt() * (1.0 + MOMENTS_BLURRED * blurred);
        let edge_px = edge_px.hypot(MOMENTS_END * beyond_px(WIDE_PX));
        let more = 1.0 / (ratio * (1.0 + ratio)) - 1.0 / (1.0 + ratio.powi(3));
        let of_size = MOMENTS_SIZE * of_belt / (TAU * radius_px) * more.max(0.0);
        let cut_disc_px = cut_px(disc_px - MIN_CORE_PX);
        let by_disc_px =
            MIXED_DISC_PX * beyond_px(cut_disc_px) / (disc_px - cut_disc_px).max(MIN_CUT_PX);
        let by_black_px = MIXED_BLACK * beyond_px(cut_px(0.5 * (black_px - MIN_BLACK_PX)));
        let floor_px = of_size.sqrt().hypot(by_disc_px).hypot(by_black_px);
        RimNoise { edge_px, floor_px, is_of_ring: true }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(blur_px: f64, disc_px: f64, black_px: f64) -> RimNoise {
        let spread_px = (blur_px.powi(2) + 1.0 / 12.0).sqrt();
        let of_belt = 1e-4 * 2.0 * WIDE_PX;
        Moments { of_belt, spread_px, disc_px, black_px }.noise(disc_px + black_px, 0.5)
    }

    /// As long as the band contains all the light.
    #[test]
    fn band_noise_does_not_depend_on_the_blur() {
        let [sharp, blurred] = [0.4, 0.6].map(|blur_px| noise(blur_px, 40.0, 40.0).edge_px);
        assert!((blurred / sharp - 1.0).abs() < 0.01, "{sharp} {blurred}");
        assert!((sharp / (1e-4 * 2.0 * WIDE_PX).sqrt() - 1.0).abs() < 0.01, "{sharp}");
    }

    #[test]
    fn blur_shifts_small_discs_and_thin_rings() {
        for (disc_px, black_px) in [(2.5, 20.0), (20.0, 2.5)] {
            let [wide, sharp, blurred] =
                [(0.5, 20.0, 20.0), (0.5, disc_px, black_px), (1.0, disc_px, black_px)]
                    .map(|(blur_px, disc_px, black_px)| noise(blur_px, disc_px, black_px).floor_px);
            assert!(wide < sharp && 3.0 * sharp < blurred, "{wide} {sharp} {blurred}");
        }
    }
}
