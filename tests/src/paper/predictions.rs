//! The model's prediction of errors in the hall: equations 17 to 19, and the tiles.

use roundel_core::plan::paper::{AXIS_ERROR_PX, lens_share, range_share};

use super::{
    hall::{Hall, TILES_M},
    lens::Calibrated,
    model,
};

/// Mean error from the tiles alone: the mean length of an error of [`TILES_M`] along both axes is √(π/2) of it;
/// besides a roundel's own tile, those of the four that define the frame add 0.48 in squares.
const TILES_MEAN_M: f64 = 1.253 * 1.216 * TILES_M;

/// The model's prediction of one picture's errors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Prediction {
    /// Mean.
    pub mean_m: f64,
    /// Maximum.
    pub max_m: f64,
    /// Mean of the errors relative to the distance.
    pub mean_share: f64,
    /// Maximum of the relative errors.
    pub max_share: f64,
    /// Contribution of the tiles alone to the mean share.
    pub tiles_share: f64,
    /// Coefficients of the lens (equation 18).
    pub lens_share: f64,
    /// The axis of the rim, which matters in space (equation 19).
    pub axis_share: f64,
    /// The same with the paper's error of the axis.
    pub papers_axis_share: f64,
    /// The focal length.
    pub focal_share: f64,
}

impl Prediction {
    /// Means over pictures.
    pub fn mean(pictures: &[Self]) -> Self {
        let mean = |field: fn(&Self) -> f64| {
            pictures.iter().map(field).sum::<f64>() / pictures.len() as f64
        };
        Self {
            mean_m: mean(|it| it.mean_m),
            max_m: mean(|it| it.max_m),
            mean_share: mean(|it| it.mean_share),
            max_share: mean(|it| it.max_share),
            tiles_share: mean(|it| it.tiles_share),
            lens_share: mean(|it| it.lens_share),
            axis_share: mean(|it| it.axis_share),
            papers_axis_share: mean(|it| it.papers_axis_share),
            focal_share: mean(|it| it.focal_share),
        }
    }

    /// Contributions to the mean share, per cent.
    pub fn contributions(&self, plane: bool) -> String {
        let Self { tiles_share, lens_share, axis_share, papers_axis_share, focal_share, .. } = self;
        let [tiles, lens, axis, papers_axis, focal] =
            [tiles_share, lens_share, axis_share, papers_axis_share, focal_share]
                .map(|it| 100.0 * it);
        if plane {
            format!("tiles {tiles:.4}, lens {lens:.4}; the rest of the paper's is its lens")
        } else {
            format!(
                "tiles {tiles:.4}, lens {lens:.4}, focal length {focal:.4}, axis {axis:.4}, {papers_axis:.2} with the paper's 0.15 px"
            )
        }
    }
}

/// Equations 17 to 19, and the tiles, over the measured roundels.
pub fn predicted(hall: &Hall, lens: &Calibrated, plane: bool) -> Prediction {
    let measured: Vec<usize> =
        (0..hall.true_m.len()).filter(|&index| !Hall::is_reference(index)).collect();
    let predict = |&index: &usize| {
        let place = hall.pose(index).translation.vector;
        let lens_share = lens_share(lens.coefficients, [place.x / place.z, place.y / place.z]);
        let tiles_share = TILES_MEAN_M / place.norm();
        let semiaxes_px = hall.semiaxes_px(index);
        let axis_share = model::axis_error_px(&hall.camera.imaging, semiaxes_px) / semiaxes_px[0];
        let mean_share = if plane {
            lens_share.hypot(tiles_share)
        } else {
            let axis_error_px = axis_share * semiaxes_px[0];
            range_share(lens.focal_share, axis_error_px, semiaxes_px[0], lens_share)
                .hypot(tiles_share)
        };
        Prediction {
            mean_m: mean_share * place.norm(),
            mean_share,
            tiles_share,
            lens_share,
            axis_share,
            papers_axis_share: AXIS_ERROR_PX / semiaxes_px[0],
            focal_share: lens.focal_share,
            ..Prediction::default()
        }
    };
    let each: Vec<Prediction> = measured.iter().map(predict).collect();
    let max_m = model::expected_max(&each.iter().map(|it| it.mean_m).collect::<Vec<_>>());
    let max_share = model::expected_max(&each.iter().map(|it| it.mean_share).collect::<Vec<_>>());
    Prediction { max_m, max_share, ..Prediction::mean(&each) }
}
