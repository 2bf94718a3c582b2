//! Detection limits: whether a roundel is detected, and whether its code is read.
//!
//! A roundel is detected if it is completely in the picture, not tilted too much ([`roundel_vision::marker::Params`]) and
//! wide enough for the blur and noise, which trials determine (`monte_carlo`). Codes are read at a fraction of the distance
//! at which the ring is detected, so coverage of coded roundels requires that the code is read.

use super::{
    Sensor,
    monte_carlo::{is_wide_enough, min_detected_px},
    roundel_image::RoundelImage,
};
use roundel_vision::marker::{Kind, Params, Pattern};

/// Bits of a code and minimum outer diameter for reading it, pixels; other codes are interpolated linearly.
const READ_PX: [(f64, f64); 4] = [(5.0, 30.0), (8.0, 36.0), (12.0, 60.0), (16.0, 90.0)];

/// Minimum shorter diameter of the outer rim at which the code is read, pixels; `None` for uncoded kinds. Measured
/// on rendered roundels up to 50° of tilt (`-- codes` of the tests' crate). Applied to the shorter diameter,
/// since teeth at the ends of the longer one are as narrow as that.
pub fn min_readable_px(kind: &Kind) -> Option<f64> {
    let Pattern::Coded(layout) = kind.pattern else { return None };
    let bits = f64::from(layout.bits);
    let more = READ_PX.partition_point(|&(known, _)| known < bits).clamp(1, READ_PX.len() - 1);
    let ((few, few_px), (many, many_px)) = (READ_PX[more - 1], READ_PX[more]);
    Some(few_px + (bits - few) / (many - few) * (many_px - few_px))
}

/// Minimum shorter diameter at which the roundel is detected and, if it is coded, its code read, pixels.
pub fn min_required_px(sensor: &Sensor, kind: &Kind, tilt_rad: f64) -> f64 {
    min_detected_px(sensor, kind, tilt_rad).max(min_readable_px(kind).unwrap_or(0.0))
}

/// Whether it is detected.
pub fn is_detected(sensor: &Sensor, kind: &Kind, image: &RoundelImage) -> bool {
    let outer = &image.ring.outer;
    let params = Params::default();
    image.is_complete
        && outer.semi_minor_px >= params.min_axis_ratio * outer.semi_major_px
        && is_wide_enough(sensor, kind, image)
}

/// Whether it is detected and, if it is coded, its code read.
pub fn is_readable(sensor: &Sensor, kind: &Kind, image: &RoundelImage) -> bool {
    min_readable_px(kind).is_none_or(|min_px| image.minor_px >= min_px)
        && is_detected(sensor, kind, image)
}

/// The requirement in words.
pub(super) fn requirement(kind: &Kind) -> &'static str {
    if min_readable_px(kind).is_some() { "found and its code read" } else { "found" }
}
