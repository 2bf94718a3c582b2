//! Lenses as Roundel's calibration finds them: from rendered views of its board, selected and fitted by core.
//!
//! For large sensors the views are rendered at a fraction of the resolution and the lens is scaled up, as if a camera
//! were calibrated from its video instead of its photographs: cheaper, and no better than full views.

use anyhow::{Context, bail};
use roundel_core::camera::Lens;

use super::{Length, scene::PaperCamera};
use crate::{
    board,
    optics::{Distortion, Pinhole},
    random::Random,
};

/// Widest rendered view.
const WIDEST_PX: usize = 1300;

/// A calibrated lens with its stated deviations.
#[derive(Clone, Copy, Debug)]
pub struct Calibrated {
    pub optics: Pinhole,
    /// Relative deviation of the focal length.
    pub focal_share: f64,
    /// Deviations of k1 k2 p1 p2 k3; zero for those fixed at zero.
    pub coefficients: [f64; 5],
}

/// Calibrates a camera's lens from 30 views, or 16 in short.
pub fn calibrated(camera: &PaperCamera, length: Length, seed: u64) -> anyhow::Result<Calibrated> {
    let views = length.pick(16, 30);
    let whole = &camera.optics;
    let times = whole.width.div_ceil(WIDEST_PX);
    let scale = times as f64;
    let small = Pinhole {
        width: whole.width / times,
        height: whole.height / times,
        focal_px: whole.focal_px.map(|px| px / scale),
        center_px: whole.center_px.map(|px| (px + 0.5) / scale - 0.5),
        ..*whole
    };
    let poses = board::poses(&small, views, &mut Random::new(seed, 3));
    let pictures = board::pictures(&small, camera.imaging, &board::board_print(), &poses, seed);
    let found = board::lens(&pictures).with_context(|| format!("the lens of {}", camera.name))?;
    let is = found.camera.intrinsics();
    let Lens::PlumbBob(distortion) = is.lens else {
        bail!(
            "{}: expected plumb_bob, the model of the rendered lens, found {}",
            camera.name,
            is.lens.name()
        );
    };
    let deviations = found.deviations();
    let mut coefficients = [0.0; 5];
    for (&index, &deviation) in found.model.free().iter().zip(&deviations[4..]) {
        coefficients[index] = deviation;
    }
    let optics = Pinhole {
        width: whole.width,
        height: whole.height,
        focal_px: [is.fx_px * scale, is.fy_px * scale],
        center_px: [is.cx_px, is.cy_px].map(|px| (px + 0.5) * scale - 0.5),
        distortion: Distortion::PlumbBob(distortion),
    };
    Ok(Calibrated { optics, focal_share: deviations[0] / is.fx_px, coefficients })
}
