//! The camera that is planned with.

use anyhow::{Context, bail};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    plan::{Sensor, Trials, precision::LensDoubt},
};

use super::PlanArgs;
use crate::model::camera_file;

/// Fields of view that a pinhole has, degrees.
const FOV_RANGE_DEG: std::ops::RangeInclusive<f64> = 1.0..=150.0;

/// The camera, how well its lens is known, and what to call it.
pub(super) fn sensor(arguments: &PlanArgs) -> anyhow::Result<(Sensor, Option<LensDoubt>, String)> {
    let (camera, uncertainty, name) = if let Some(path) = &arguments.camera {
        let (camera, uncertainty) = camera_file::load_with_uncertainty(path)?;
        (camera, uncertainty, path.display().to_string())
    } else if let (Some(size), Some(fov_deg)) = (arguments.resolution, arguments.fov) {
        (pinhole(size, fov_deg)?, None, "pinhole".to_owned())
    } else {
        bail!(
            "which camera? Say --camera FILE (a ROS camera_info YAML, as `roundel calibrate lens` writes), or its \
             --resolution WIDTHxHEIGHT and --fov DEGREES"
        );
    };
    let (imaging, mode) = (arguments.imaging(), arguments.mode());
    let sensor = Sensor { camera, imaging, mode, trials: Trials::default() };
    Ok((sensor, uncertainty, name))
}

fn pinhole((width, height): (usize, usize), fov_deg: f64) -> anyhow::Result<Camera> {
    if !FOV_RANGE_DEG.contains(&fov_deg) {
        bail!(
            "--fov: expected {} to {} degrees, found {fov_deg}; a wider lens is no pinhole: calibrate it and say \
             --camera",
            FOV_RANGE_DEG.start(),
            FOV_RANGE_DEG.end()
        );
    }
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

/// Horizontal and vertical field of view, degrees; where the lens' model ends before the picture does, none.
pub(super) fn fields_deg(camera: &Camera) -> [Option<f64>; 2] {
    let Intrinsics { width, height, cx_px, cy_px, .. } = *camera.intrinsics();
    let between = |one: PixelPoint, other: PixelPoint| {
        let (one, other) = (camera.bearing(one).ok()?, camera.bearing(other).ok()?);
        Some(one.angle(&other).to_degrees())
    };
    let level = |u: f64| PixelPoint { u, v: cy_px };
    let upright = |v: f64| PixelPoint { u: cx_px, v };
    [
        between(level(-0.5), level(width as f64 - 0.5)),
        between(upright(-0.5), upright(height as f64 - 0.5)),
    ]
}
