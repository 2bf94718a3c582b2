//! The camera of a plan, from a camera file or from resolution and field of view.

use anyhow::{Context, bail};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    plan::{Sensor, TrialCache},
};

use super::PlanArgs;
use crate::model::camera_file;

/// Allowed horizontal fields of view of a pinhole camera, degrees.
const FOV_RANGE_DEG: std::ops::RangeInclusive<f64> = 1.0..=150.0;

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
    if !FOV_RANGE_DEG.contains(&fov_deg) {
        bail!(
            "--fov: expected {} to {} degrees, found {fov_deg}; for a wider lens, use --camera with its calibration",
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

/// Horizontal and vertical field of view, degrees; `None` where the lens model does not reach the picture's edge.
pub(super) fn fields_deg(camera: &Camera) -> [Option<f64>; 2] {
    let Intrinsics { width, height, cx_px, cy_px, .. } = *camera.intrinsics();
    let at = |u: f64, v: f64| camera.bearing(PixelPoint { u, v }).ok();
    let edges = [
        at(-0.5, cy_px).zip(at(width as f64 - 0.5, cy_px)),
        at(cx_px, -0.5).zip(at(cx_px, height as f64 - 0.5)),
    ];
    edges.map(|edges| edges.map(|(from, to)| from.angle(&to).to_degrees()))
}
