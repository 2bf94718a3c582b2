//! How far rims stray as each mode finds them.
//!
//! A straight edge of contrast C, blurred to s² = blur² + 1/12 by lens and pixel, tells its
//! place across itself, a unit of its length, with the variance
//!
//! v = σ² 2√π s / C²,  σ² = noise² + 1/12
//!
//! (Fisher's information of its pixels, ∫ g′² = C²/(2√π s); rounding to whole grey levels adds 1/12). With that
//! noise of rims [`roundel_vision::pose::locate`] gives the pose's covariance, as it does of rings that are seen. The fit to grey
//! levels reaches this bound but where a disc or a black is hardly wider than the blur.
//!
//! **From rims by moments.** They weigh all pixels of a belt of the width w alike ([`roundel_vision::marker`]), sharp or not:
//!
//! v = σ² w / C²
//!
//! - Compensation makes both rims' sizes out of both rims' errors: instead of 1/(1 + r³), the best that the outer and
//!   the inner one can say together (r their ratio), of what the outer one's size strays is left 1/(r (1 + r)).
//! - Light beyond a cut at the distance d, m(d) = ∫ Φ(-x/s) dx from d on, is mixed into the levels, and moves rims by
//!   what undoing that once leaves ([`roundel_vision::marker`]'s `blur`): of a disc of radius ρ by m(d)/(ρ - d), of a black as it
//!   is. Where there is no room for a whole belt, the cut is nearer.
//! - The belt's end lies on pixels as it may: what light is beyond is another at each point of the rim.
//!
//! Their factors were found on rendered roundels of 14 to 90 px, ratios of 0.35 to 0.6, blurs of 0.5 to 1.1 px, noise of 1
//! to 4 levels and tilts to 55°. For rings below some 30 px they are no more than a beginning, which what is tried of those
//! multiplies (`tried`).

use std::f64::consts::{PI, TAU};

use super::{Imaging, Sensor, sight::Sighting};
use roundel_vision::{
    marker::{Kind, Mode, WIDE_PX},
    normal_distribution::Beyond,
    pose::RimNoise,
};

/// What the fit to grey levels leaves of blur's and bloom's shift of a whole rim, pixels, and how errors grow with the
/// fourth power of blur over the narrower one of disc and black; from rendered roundels. The latter is of set-ups beside
/// those that the plan is compared with (29 of 80 with the numbers 1000 to 1158, the washed ones, by least squares of
/// the logarithms of both errors).
const FIT_FLOOR_PX: f64 = 0.0005;
const FIT_WASHED: f64 = 20.0;
/// Rims by moments, by least squares of the logarithms of both errors of 200 set-ups beside those that the plan is
/// compared with (the odd ones of the numbers 1001 to 1399, 300 roundels each). How their noise grows with the square of
/// blur over disc and over black; what compensation and the levels leave of a size's noise …
const MOMENTS_WASHED: f64 = 3.8;
const MOMENTS_SIZE: f64 = 2.9;
/// … what each point of a rim strays by light beyond the belt's end …
const MOMENTS_END: f64 = 2.1;
/// … what the light mixed into the levels shifts rims by; of the disc's in pixels.
const MIXED_DISC_PX: f64 = 0.86;
const MIXED_BLACK: f64 = 0.28;
/// Of these semiaxes, pixels, the disc's core and of these widths the black beside the belts can be no smaller.
const LEAST_CORE_PX: f64 = 1.6;
const LEAST_BLACK_PX: f64 = 1.4;
/// A cut is no nearer to its rim, pixels.
const LEAST_CUT_PX: f64 = 0.2;

/// The noise of a ring's rims, as its mode finds them.
pub fn rim_noise(sensor: &Sensor, kind: &Kind, sighting: &Sighting) -> RimNoise {
    let Imaging { noise, blur_px, .. } = sensor.imaging;
    let variance = noise.powi(2) + 1.0 / 12.0;
    let spread_px = (blur_px.powi(2) + 1.0 / 12.0).sqrt();
    let per_length = 2.0 * PI.sqrt() * spread_px / sensor.imaging.contrast().powi(2);
    let edge_px = (variance * per_length).sqrt();
    // What is narrower than its blur is washed out: the disc, or the black beside it.
    let (least, most) = kind.ratios();
    let semi_px = 0.5 * sighting.minor_px;
    let (disc_px, black_px) = (semi_px * least, semi_px * (1.0 - most));
    match sensor.mode {
        Mode::Precise => {
            let washed = spread_px / disc_px.min(black_px);
            let growth = 1.0 + FIT_WASHED * washed.powi(4);
            let (edge_px, floor_px) = (edge_px * growth, FIT_FLOOR_PX * growth);
            RimNoise { edge_px, floor_px, is_of_ring: true }
        }
        Mode::Fast => {
            let of_belt = variance * 2.0 * WIDE_PX / sensor.imaging.contrast().powi(2);
            let moments = Moments { of_belt, spread_px, disc_px, black_px };
            moments.noise(sighting.ring.outer.mean_radius_px(), kind.ratio())
        }
    }
}

/// What the noise of rims by moments depends on.
struct Moments {
    /// Variance that a unit of an edge's length has by the noise of a belt's pixels, pixels³.
    of_belt: f64,
    /// The edge's blur, pixels.
    spread_px: f64,
    /// The disc's shorter semiaxis, and the width of the black along it, pixels.
    disc_px: f64,
    black_px: f64,
}

impl Moments {
    /// Of a ring of this outer radius and ratio of diameters.
    fn noise(&self, radius_px: f64, ratio: f64) -> RimNoise {
        let Self { of_belt, spread_px, disc_px, black_px } = *self;
        let beyond_px = |cut_px: f64| Beyond::new(cut_px, spread_px).moved_px;
        let cut_px = |room_px: f64| room_px.clamp(LEAST_CUT_PX, WIDE_PX);
        let washed = (spread_px / disc_px).powi(2) + (spread_px / black_px).powi(2);
        let edge_px = of_belt.sqrt() * (1.0 + MOMENTS_WASHED * washed);
        let edge_px = edge_px.hypot(MOMENTS_END * beyond_px(WIDE_PX));
        let more = 1.0 / (ratio * (1.0 + ratio)) - 1.0 / (1.0 + ratio.powi(3));
        let of_size = MOMENTS_SIZE * of_belt / (TAU * radius_px) * more.max(0.0);
        let cut_disc_px = cut_px(disc_px - LEAST_CORE_PX);
        let by_disc_px =
            MIXED_DISC_PX * beyond_px(cut_disc_px) / (disc_px - cut_disc_px).max(LEAST_CUT_PX);
        let by_black_px = MIXED_BLACK * beyond_px(cut_px(0.5 * (black_px - LEAST_BLACK_PX)));
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

    /// As long as none of the light is beyond them.
    #[test]
    fn belts_are_as_noisy_before_sharp_edges_as_before_blurred_ones() {
        let [sharp, blurred] = [0.4, 0.6].map(|blur_px| noise(blur_px, 40.0, 40.0).edge_px);
        assert!((blurred / sharp - 1.0).abs() < 0.01, "{sharp} {blurred}");
        assert!((sharp / (1e-4 * 2.0 * WIDE_PX).sqrt() - 1.0).abs() < 0.01, "{sharp}");
    }

    #[test]
    fn small_discs_and_thin_blacks_are_shifted_the_more_the_more_blur_there_is() {
        for (disc_px, black_px) in [(2.5, 20.0), (20.0, 2.5)] {
            let [wide, sharp, blurred] =
                [(0.5, 20.0, 20.0), (0.5, disc_px, black_px), (1.0, disc_px, black_px)]
                    .map(|(blur_px, disc_px, black_px)| noise(blur_px, disc_px, black_px).floor_px);
            assert!(wide < sharp && 3.0 * sharp < blurred, "{wide} {sharp} {blurred}");
        }
    }
}
