//! Blur of a board in a picture, measured at the rims of its rings.
//!
//! Across an edge of contrast C blurred with the deviation s, the grey level changes by C (2 Φ(t/s) - 1) between the points
//! t pixels to either side. The change is sampled around each outer rim (bilinear interpolation adds about 0.4 px of blur
//! to all pictures alike), and the median over the rings gives s. A picture is rejected only relative to the others of the
//! same camera: a soft lens makes all pictures soft.

use crate::robust::median;
use roundel_vision::{
    camera::PixelPoint, frame::Frame, marker::Ring, normal_distribution::cumulative,
};

/// Distance of the samples from the rim, pixels.
const OFFSET_PX: f64 = 1.0;
/// Samples around a rim.
const SAMPLES: usize = 16;
/// Range of measurable deviations, pixels.
const RANGE_PX: [f64; 2] = [0.1, 20.0];
/// A view is blurred if its blur exceeds the median by this factor.
const BLURRED: f64 = 1.7;

/// Standard deviation of the blur across the outer rims, pixels; `None` without rings that are completely in the
/// picture.
pub(crate) fn blur_px<'a>(frame: &Frame<'_>, rings: impl Iterator<Item = &'a Ring>) -> Option<f64> {
    let mut changes: Vec<f64> = rings.filter_map(|ring| edge_change(frame, ring)).collect();
    Some(deviation_px(median(&mut changes)?))
}

/// Marks the views that are blurred relative to the others.
pub(crate) fn blurred(blurs_px: &[Option<f64>]) -> Vec<bool> {
    let mut known_px: Vec<f64> = blurs_px.iter().copied().flatten().collect();
    let Some(median_px) = median(&mut known_px) else { return vec![false; blurs_px.len()] };
    blurs_px.iter().map(|blur_px| blur_px.is_some_and(|px| px > BLURRED * median_px)).collect()
}

/// Mean change of the grey level across a rim, as a share of the contrast.
fn edge_change(frame: &Frame<'_>, ring: &Ring) -> Option<f64> {
    let contrast = ring.white - ring.black;
    let rim = &ring.outer;
    let (sin, cos) = rim.angle_rad.sin_cos();
    let mut sum = 0.0;
    for sample in 0..SAMPLES {
        let angle_rad = std::f64::consts::TAU * sample as f64 / SAMPLES as f64;
        let (cos_angle, sin_angle) = (angle_rad.cos(), angle_rad.sin());
        let point = [rim.semi_major_px * cos_angle, rim.semi_minor_px * sin_angle];
        let normal = [rim.semi_minor_px * cos_angle, rim.semi_major_px * sin_angle];
        let length = normal[0].hypot(normal[1]);
        let level = |off_px: f64| {
            let [x, y] = [0, 1].map(|axis| point[axis] + off_px * normal[axis] / length);
            let (u, v) = (rim.center.u + x * cos - y * sin, rim.center.v + x * sin + y * cos);
            level(frame, PixelPoint { u, v })
        };
        sum += level(OFFSET_PX)? - level(-OFFSET_PX)?;
    }
    (contrast > 0.0 && sum.is_finite()).then(|| sum / SAMPLES as f64 / contrast)
}

/// Bilinear interpolation; `None` outside of the picture.
fn level(frame: &Frame<'_>, PixelPoint { u, v }: PixelPoint) -> Option<f64> {
    let is_inside = |at: f64, side: usize| at >= 0.0 && at < side as f64 - 1.0;
    if !(is_inside(u, frame.width()) && is_inside(v, frame.height())) {
        return None;
    }
    let (column, row) = (u as usize, v as usize);
    let (x, y) = (u - column as f64, v - row as f64);
    let of_row = |row: usize| {
        let pixels = frame.row(row);
        (1.0 - x) * f64::from(pixels[column]) + x * f64::from(pixels[column + 1])
    };
    Some((1.0 - y) * of_row(row) + y * of_row(row + 1))
}

/// Blur of an edge across which the level changes by this share.
fn deviation_px(edge_change: f64) -> f64 {
    let [mut low, mut high] = RANGE_PX;
    for _ in 0..40 {
        let center = (low * high).sqrt();
        if 2.0 * cumulative(OFFSET_PX / center) - 1.0 > edge_change {
            low = center;
        } else {
            high = center;
        }
    }
    (low * high).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use roundel_vision::ellipse::Ellipse;

    /// A black ring on white with blurred rims.
    fn picture(blur_px: f64) -> Vec<u8> {
        let mut pixels = Vec::new();
        for v in 0..120 {
            for u in 0..120 {
                let radius_px = (f64::from(u) - 60.3).hypot(f64::from(v) - 59.6);
                let step = |at: f64| cumulative((radius_px - at) / blur_px);
                pixels.push((220.0 - 180.0 * (step(18.0) - step(40.0))).round() as u8);
            }
        }
        pixels
    }

    fn ring() -> Ring {
        let center = PixelPoint { u: 60.3, v: 59.6 };
        let rim = |radius_px: f64| Ellipse {
            center,
            semi_major_px: radius_px,
            semi_minor_px: radius_px,
            angle_rad: 0.3,
        };
        Ring { black: 40.0, white: 220.0, ..Ring::of_rims(rim(40.0), rim(18.0)) }
    }

    #[test]
    fn blur_is_measured_at_the_rim() {
        for blur_px in [0.8, 1.5, 2.0, 3.0, 5.0] {
            let pixels = picture(blur_px);
            let frame = Frame::new(&pixels, 120, 120, 120).unwrap();
            let found_px = super::blur_px(&frame, [ring()].iter()).unwrap();
            // Interpolation adds a variance of 1/6 px².
            let expected_px = (blur_px * blur_px + 1.0 / 6.0).sqrt();
            assert!((found_px / expected_px - 1.0).abs() < 0.05, "{found_px} for {expected_px}");
        }
    }

    #[test]
    fn cut_off_rings_are_ignored() {
        let pixels = picture(0.8);
        let frame = Frame::new(&pixels, 120, 120, 120).unwrap();
        let mut cut = ring();
        cut.outer.center.u = 30.0;
        assert_eq!(super::blur_px(&frame, [cut].iter()), None);
        assert_eq!(super::blur_px(&frame, [].iter()), None);
    }

    #[test]
    fn views_are_blurred_relative_to_others_only() {
        assert_eq!(blurred(&[0.9, 1.0, 2.1, 1.1].map(Some)), [false, false, true, false]);
        assert_eq!(blurred(&[2.1, 2.0, 2.4].map(Some)), [false; 3]);
        assert_eq!(blurred(&[None, None]), [false; 2]);
    }
}
