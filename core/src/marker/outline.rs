//! Whether the outer rim is there all the way round.
//!
//! Moments see a rim as a whole: a neighbour's sheet that covers a little of it moves them by a
//! fraction of a pixel, too little for the tests of shape and many times more than the pose's
//! covariance allows for. Along a rim that is where the ellipse says, though, every point has the
//! level halfway between black and white; where something covers it, the level is one or the other.
//!
//! So the pose is told how uneven the rim is, and takes it into its covariance. The deviation is the rms over the rim of (level - mean level) / contrast, without its first
//! harmonic, which is that of a lighting gradient.

use crate::{ellipse::Ellipse, frame::Frame, marker::reject::Reject};

/// Points along the rim.
const POINTS: usize = 32;
/// Beyond this share more of the rim is gone than an ellipse can be trusted with.
const LARGEST: f64 = 0.25;

/// How uneven the outer rim is, as [`deviation`] says, or that it is covered.
///
/// Rendered whole rings (contrast 120, noise 2) have 0.011, at the most 0.017 of 3,000, which is two
/// thirds of the noise's share of the contrast. Prints on bent paper or after JPEG have up to 0.09;
/// rings that a neighbour's sheet covers in part have 0.03 to 0.23.
pub(crate) fn unevenness(frame: &Frame, outer: &Ellipse, contrast: f64) -> Result<f64, Reject> {
    let uneven = deviation(frame, outer, contrast);
    // Not a number where the contrast is none.
    if uneven <= LARGEST { Ok(uneven) } else { Err(Reject::Covered) }
}

/// Rms deviation of the levels along the outer rim, as a share of the contrast. The rim lies inside
/// the frame.
fn deviation(frame: &Frame, outer: &Ellipse, contrast: f64) -> f64 {
    let (sin_tilt, cos_tilt) = outer.angle_rad.sin_cos();
    let (mut sum, mut squares, mut along, mut across) = (0.0, 0.0, 0.0, 0.0);
    for point in 0..POINTS {
        let (sin, cos) = (std::f64::consts::TAU * point as f64 / POINTS as f64).sin_cos();
        let (x, y) = (outer.semi_major_px * cos, outer.semi_minor_px * sin);
        let u = outer.center.u + x * cos_tilt - y * sin_tilt;
        let v = outer.center.v + x * sin_tilt + y * cos_tilt;
        let level = level_at(frame, u, v);
        sum += level;
        squares += level * level;
        along += level * cos;
        across += level * sin;
    }
    let n = POINTS as f64;
    // Parseval: the mean square less those of the constant and of the first harmonic.
    let variance =
        squares / n - (sum / n).powi(2) - 2.0 * ((along / n).powi(2) + (across / n).powi(2));
    variance.max(0.0).sqrt() / contrast
}

/// Grey level between the pixels, bilinear.
pub(crate) fn level_at(frame: &Frame, u: f64, v: f64) -> f64 {
    let (u, v) =
        (u.clamp(0.0, (frame.width() - 1) as f64), v.clamp(0.0, (frame.height() - 1) as f64));
    let (left, top) = (u as usize, v as usize);
    let (right, bottom) = ((left + 1).min(frame.width() - 1), (top + 1).min(frame.height() - 1));
    let (du, dv) = (u - left as f64, v - top as f64);
    let row = |v: usize| {
        let row = frame.row(v);
        let (left, right) = (f64::from(row[left]), f64::from(row[right]));
        left + (right - left) * du
    };
    row(top) + (row(bottom) - row(top)) * dv
}
