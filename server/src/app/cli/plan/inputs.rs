//! Inputs of a plan: the camera, from a camera file or from resolution and field of view, and the frames to time.

use anyhow::{Context, bail};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    marker::Kind,
    plan::{Sensor, TrialCache},
};

use super::PlanArgs;
use crate::{lab::plan::timing::TimingCase, model::camera_file};

/// The camera, and its name in the report.
pub(super) fn sensor(arguments: &PlanArgs) -> anyhow::Result<(Sensor, String)> {
    let (camera, lens_uncertainty, name) = if let Some(path) = &arguments.camera {
        let (camera, uncertainty) = camera_file::load_with_uncertainty(path)?;
        (camera, uncertainty, path.display().to_string())
    } else if let (Some(size), Some(fov_deg)) = (arguments.resolution, arguments.fov) {
        (pinhole(size, fov_deg)?, None, "pinhole".to_owned())
    } else {
        bail!(
            "expected a camera: add --camera FILE (a ROS camera_info YAML, as `roundel calibrate lens` writes), or \
             --resolution WIDTHxHEIGHT and --fov DEGREES"
        );
    };
    let (imaging, mode) = (arguments.imaging(), arguments.mode.unwrap_or_default());
    let trials = TrialCache::default();
    Ok((Sensor { camera, lens_uncertainty, imaging, mode, trials }, name))
}

fn pinhole((width, height): (usize, usize), fov_deg: f64) -> anyhow::Result<Camera> {
    let focal_px = 0.5 * width as f64 / (0.5 * fov_deg.to_radians()).tan();
    let middle = |side: usize| 0.5 * (side as f64 - 1.0);
    Camera::new(Intrinsics {
        width,
        height,
        fx_px: focal_px,
        fy_px: focal_px,
        cx_px: middle(width),
        cy_px: middle(height),
        lens: Lens::PlumbBob([0.0; 5]),
    })
    .context("--resolution")
}

/// Frames with `--count` roundels of this mean diameter, at this scale across the line of sight.
pub(super) fn timing_case(
    arguments: &PlanArgs,
    sensor: &Sensor,
    kind: &Kind,
    diameter_px: f64,
    px_per_m: f64,
) -> anyhow::Result<TimingCase> {
    let (speed, rate) = (arguments.speed.unwrap_or(0.5), arguments.rate());
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
