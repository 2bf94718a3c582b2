//! How far beyond the outer rim the image shows nothing but the margin.
//!
//! Along rays across the rim, the level rises from black to the white of the margin. Where it falls
//! again by [`FALL`] of the contrast, the blur of the paper's edge has begun. The model, which knows
//! no such edge, ends before: by [`EDGE_BLURS`], and further where the margin is so narrow that its
//! level never reaches white. Some rays may meet dirt or a neighbour: the robust fit rejects those.

use crate::{
    frame::Frame,
    marker::{Polarity, Ring},
};

const RAYS: usize = 32;
/// Rays that may end before the margin does.
const DISTURBED_RAYS: usize = 4;
/// Distance of the points on a ray, pixels.
const STEP_PX: f64 = 0.5;
/// Fall of the level below its maximum, as a share of the contrast, where paper ends.
const FALL: f64 = 0.06;
/// Multiple of the ring's unevenness, which is that of the noise, that such a fall exceeds.
const UNEVENNESS: f64 = 6.0;
/// From there back to where the paper's edge changes the level by at most a fiftieth of the contrast,
/// in standard deviations of an edge, and its increase with what the maximum lacks of the contrast.
/// From blurred steps of 0.56 of the contrast at 1.5 to 3 standard deviations from the rim.
const EDGE_BLURS: (f64, f64) = (0.72, 4.3);
/// Variance of a pixel's box.
const PIXEL_PX2: f64 = 1.0 / 12.0;
/// Beyond the rim this much is always counted, pixels; inside, if negative.
const MIN_PX: f64 = -0.3;

/// Distance from the outer rim up to which there is margin alone, at most `reach_px`.
pub fn clear_px(frame: &Frame, ring: &Ring, reach_px: f64, blur_px: f64) -> f64 {
    let edge_px = (blur_px * blur_px + PIXEL_PX2).sqrt();
    // Bright is up, also around a white ring.
    let sign = if ring.polarity == Polarity::WhiteRing { -1.0 } else { 1.0 };
    let contrast = (ring.white - ring.black).abs();
    let fall = FALL.max(UNEVENNESS * ring.unevenness) * contrast;
    let white = if sign > 0.0 { ring.white } else { -ring.black };
    let steps = ((reach_px + 2.0 * edge_px) / STEP_PX).ceil() as usize;
    let mut clear = [reach_px; RAYS];
    for (ray, clear_px) in clear.iter_mut().enumerate() {
        let point = ring.outer.rim_point(std::f64::consts::TAU * ray as f64 / RAYS as f64);
        let (mut brightest, mut before) = (f64::NEG_INFINITY, 0.0);
        for step in 0..=steps {
            let away_px = STEP_PX * step as f64;
            let level = sign * frame.level_at(point.outwards(away_px));
            let limit = brightest - fall;
            if level < limit {
                let fallen_px = away_px - STEP_PX * (limit - level) / (before - level);
                let lack = ((white - brightest) / contrast).max(0.0);
                let back_px = edge_px * (EDGE_BLURS.0 + EDGE_BLURS.1 * lack);
                *clear_px = (fallen_px - back_px).clamp(MIN_PX, reach_px);
                break;
            }
            (brightest, before) = (brightest.max(level), level);
        }
    }
    *clear.select_nth_unstable_by(DISTURBED_RAYS, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{camera::PixelPoint, ellipse::Ellipse, normal_distribution};

    const SIDE: usize = 100;
    const RADIUS_PX: f64 = 18.0;

    /// A ring on paper that ends `margin_px` beyond its rim, on a floor of this level.
    fn picture(margin_px: f64, floor: f64, blur_px: f64) -> Vec<u8> {
        let edge_px = (blur_px * blur_px + PIXEL_PX2).sqrt();
        let step = |away_px: f64| normal_distribution::cumulative(away_px / edge_px);
        let level = |u: usize, v: usize| {
            let away_px = (u as f64 - 49.7).hypot(v as f64 - 50.2) - RADIUS_PX;
            40.0 + 160.0 * step(away_px) + (floor - 200.0) * step(away_px - margin_px)
        };
        (0..SIDE * SIDE).map(|i| level(i % SIDE, i / SIDE).round() as u8).collect()
    }

    fn clear(pixels: &[u8], blur_px: f64) -> f64 {
        let frame = Frame::new(pixels, SIDE, SIDE, SIDE).unwrap();
        let outer = Ellipse {
            center: PixelPoint { u: 49.7, v: 50.2 },
            semi_major_px: RADIUS_PX,
            semi_minor_px: RADIUS_PX,
            angle_rad: 0.0,
        };
        let ring = Ring { black: 40.0, white: 200.0, ..Ring::of_rims(outer, outer.grown(-10.0)) };
        clear_px(&frame, &ring, 6.0, blur_px)
    }

    #[test]
    fn the_model_ends_before_the_papers_edge() {
        for blur_px in [0.5, 0.7, 1.0] {
            for floor in [30.0, 110.0, 140.0] {
                let edge_px = f64::hypot(blur_px, PIXEL_PX2.sqrt());
                for margin_px in [1.5, 2.2, 3.0, 4.5] {
                    let clear_px = clear(&picture(margin_px, floor, blur_px), blur_px);
                    let share = normal_distribution::cumulative((clear_px - margin_px) / edge_px);
                    let off = share * (200.0 - floor) / 160.0;
                    let case = format!("{blur_px} {floor} {margin_px}: {clear_px} {off}");
                    assert!(off < 0.1 || clear_px <= MIN_PX, "{case}");
                    // And not much before.
                    assert!(clear_px > margin_px - 3.5 * edge_px - 0.5, "{case}");
                }
                assert_eq!(clear(&picture(20.0, floor, blur_px), blur_px), 6.0);
            }
        }
    }

    #[test]
    fn a_few_disturbed_rays_do_not_count() {
        let mut pixels = picture(20.0, 110.0, 0.7);
        // A neighbour three pixels from the rim.
        for v in 45..56 {
            pixels[v * SIDE + 71..(v + 1) * SIDE].fill(30);
        }
        assert_eq!(clear(&pixels, 0.7), 6.0);
    }
}
