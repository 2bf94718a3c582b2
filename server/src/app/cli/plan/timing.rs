//! The timing case of the options.

use anyhow::bail;
use roundel_core::{marker::Kind, plan::Sensor};

use super::PlanArgs;
use crate::lab::plan::timing::{FRAMES, FrameTimes, TimingCase};

/// Frames with `--count` roundels of this mean diameter, at this scale across the line of sight.
pub(super) fn timing_case(
    arguments: &PlanArgs,
    sensor: &Sensor,
    kind: &Kind,
    diameter_px: f64,
    px_per_m: f64,
) -> anyhow::Result<TimingCase> {
    let (speed, rate, lost) = (arguments.speed.unwrap_or(0.5), arguments.rate(), arguments.lost());
    if !(0.0..=1.0).contains(&lost) {
        bail!("--lost: expected a share of 0 to 1, found {lost}");
    }
    if !(0.0..=1e3).contains(&speed) {
        bail!("--speed: expected 0 to 1000 m/s, found {speed}");
    }
    if !(0.01..=1e5).contains(&rate) {
        bail!("--rate: expected 0.01 to 100000 frames per second, found {rate}");
    }
    let motion_px = speed / rate * px_per_m;
    let size = (sensor.camera.width(), sensor.camera.height());
    if motion_px > size.0 as f64 {
        bail!(
            "--speed: at {speed} m/s and {rate} frames per second a roundel moves by {motion_px:.0} px per frame, \
             more than the width of the picture: use a lower speed, or a higher --rate"
        );
    }
    Ok(TimingCase {
        size,
        kind: kind.clone(),
        mode: sensor.mode,
        imaging: sensor.imaging,
        roundels: arguments.count() as usize,
        diameter_px,
        motion_px,
    })
}

/// How the times were measured.
pub(super) fn times_source(arguments: &PlanArgs, times: &FrameTimes) -> String {
    format!(
        "measured now on one core of this computer, on {FRAMES} simulated frames with {} of {} roundels tracked",
        times.followed,
        arguments.count()
    )
}
