//! What is in a picture, which decides about its time.

use anyhow::bail;
use roundel_core::{
    marker::{Kind, Pattern},
    plan::{Sensor, time::Load},
};

use super::PlanArgs;

/// How large roundels are in a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct ApparentSize {
    /// Mean diameter, pixels.
    pub(super) diameter_px: f64,
    /// Pixels a metre across the line of sight.
    pub(super) per_m: f64,
}

/// What is done in a frame with as many roundels as `--count` says.
pub(super) fn load(
    arguments: &PlanArgs,
    sensor: &Sensor,
    kind: &Kind,
    size: ApparentSize,
) -> anyhow::Result<Load> {
    let (count, speed, rate, lost) =
        (arguments.count(), arguments.speed(), arguments.rate(), arguments.lost());
    if !(0.0..=1.0).contains(&lost) {
        bail!("--lost: expected a share of 0 to 1, found {lost}");
    }
    if !(0.0..=1e3).contains(&speed) {
        bail!("--speed: expected 0 to 1000 m/s, found {speed}");
    }
    if !(0.01..=1e5).contains(&rate) {
        bail!("--rate: expected 0.01 to 100000 frames a second, found {rate}");
    }
    let motion_px = speed / rate * size.per_m;
    let (width, height) = (sensor.camera.width(), sensor.camera.height());
    if motion_px > width as f64 {
        bail!(
            "--speed: at {speed} m/s and {rate} frames a second a roundel moves by {motion_px:.0} px a frame, \
             farther than the picture is wide: say less, or a higher --rate"
        );
    }
    let load = Load {
        image_px: (width * height) as f64,
        roundels: f64::from(count),
        diameter_px: size.diameter_px,
        motion_px,
        is_coded: matches!(kind.pattern, Pattern::Coded(_)),
        searched_share: lost,
    };
    load.check()?;
    Ok(load)
}
