//! Rejects new rings whose disc is not white to its centre.
//!
//! A small image of a target with a dot in its disc blurs into a ring with a greyish disc; its rims are ellipses, and
//! its areas fit some ring. The disc of a roundel, however blurred, is brightest at its centre, unless the camera's
//! sharpening brightens its rim. So the centre is compared with the means along ellipses between it and the rim.
//!
//! Among 4,000 rendered roundels, none is darker at the centre by more than 0.04 of the contrast; sharpened photographs reach
//! 0.2. Of 87 targets that passed every other test, all but two exceed 0.34 (`cargo run -p roundel-tests -- recall`,
//! `cargo test -p roundel-core --test main photo::`).
//!
//! Tracked rings are not tested, so that a passing reflection does not end a track.

use crate::{
    ellipse::Ellipse,
    frame::Frame,
    marker::{Ring, kind::Polarity, reject::Reject, validate::outline::levels_along},
};

/// Ellipses compared with the centre, as shares of the inner rim.
const AROUND: [f64; 3] = [0.4, 0.6, 0.8];
/// The centre is averaged over this share of the inner rim.
const MIDDLE: f64 = 0.1;
/// Points along each ellipse.
const POINTS: usize = 16;
/// How much darker the centre may be: a share of the contrast, and grey levels.
const LIMIT: (f64, f64) = (0.22, 5.0);

/// Rejects a ring whose disc is darker at its centre.
pub(crate) fn check_center(frame: &Frame, ring: &Ring) -> Result<(), Reject> {
    let mean_at = |share: f64| {
        let ellipse = Ellipse {
            semi_major_px: share * ring.inner.semi_major_px,
            semi_minor_px: share * ring.inner.semi_minor_px,
            ..ring.inner
        };
        let levels = levels_along::<POINTS>(frame, &ellipse);
        f64::from(levels.iter().sum::<f32>()) / POINTS as f64
    };
    let sign = match ring.polarity {
        Polarity::BlackRing => 1.0,
        Polarity::WhiteRing => -1.0,
    };
    let middle = sign * mean_at(MIDDLE);
    let brightest = AROUND.iter().map(|&share| sign * mean_at(share)).fold(middle, f64::max);
    let limit = LIMIT.0 * (ring.white - ring.black).abs() + LIMIT.1;
    if brightest - middle > limit { Err(Reject::NoWhite) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelPoint;

    /// Grey 200 with a ring of 40 from 3.2 to 8 px and a dot of `dot_px` of grey `dot`, edges 1.5
    /// px wide.
    fn verdict(dot_px: f64, dot: f64, flip: bool) -> Result<(), Reject> {
        let center = PixelPoint { u: 15.3, v: 14.8 };
        let pixel = |index: usize| {
            let r = ((index % 32) as f64 - center.u).hypot((index / 32) as f64 - center.v);
            let within = |edge_px: f64| ((edge_px - r) / 1.5 + 0.5).clamp(0.0, 1.0);
            let ring = 160.0 * (within(8.0) - within(3.2));
            let grey = (200.0 - ring - (200.0 - dot) * within(dot_px)).round() as u8;
            if flip { 255 - grey } else { grey }
        };
        let pixels: Vec<u8> = (0..32 * 32).map(pixel).collect();
        let frame = Frame::new(&pixels, 32, 32, 32).unwrap();
        let circle = |semi_major_px| Ellipse {
            center,
            semi_major_px,
            semi_minor_px: semi_major_px,
            angle_rad: 0.0,
        };
        let ring = Ring::of_rims(circle(8.0), circle(3.2));
        let polarity = if flip { Polarity::WhiteRing } else { Polarity::BlackRing };
        check_center(&frame, &Ring { black: 40.0, white: 200.0, polarity, ..ring })
    }

    #[test]
    fn a_disc_must_be_white_to_its_center() {
        for flip in [false, true] {
            assert_eq!(verdict(0.0, 200.0, flip), Ok(()));
            assert_eq!(verdict(1.0, 40.0, flip), Err(Reject::NoWhite));
            assert_eq!(verdict(1.5, 120.0, flip), Err(Reject::NoWhite));
            // Glare brightens the centre.
            assert_eq!(verdict(1.5, 250.0, flip), Ok(()));
        }
    }
}
