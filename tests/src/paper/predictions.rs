//! What the model predicts of errors in the hall: equations 17 to 19, and the tiles.

use roundel_core::plan::paper::{AXIS_ERROR_PX, lens_share, range_share};

use super::{
    hall::{Hall, TILES_M},
    lens::Calibrated,
    model,
};

/// What the tiles alone leave, metres: the mean length of an error of [`TILES_M`] along both axes, √(π/2) of it, and
/// beside a roundel's own tile those of the four that define the frame, which between them count 0.48 in squares.
const TILES_MEAN_M: f64 = 1.253 * 1.216 * TILES_M;

/// What the model predicts of one picture's errors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Predicted {
    /// Mean, metres.
    pub mean_m: f64,
    /// Greatest, metres.
    pub most_m: f64,
    /// Mean of the shares of the distance.
    pub mean_share: f64,
    /// Greatest of them.
    pub most_share: f64,
    /// In the mean share, by itself: the tiles.
    pub tiles_share: f64,
    /// Coefficients of the lens (equation 18).
    pub lens_share: f64,
    /// The axis of the rim, which counts in space (equation 19) …
    pub axis_share: f64,
    /// … the same with the paper's error of the axis …
    pub papers_axis_share: f64,
    /// … and the focal length.
    pub focal_share: f64,
}

impl Predicted {
    /// Means over pictures.
    pub fn mean(pictures: &[Self]) -> Self {
        let of = |field: fn(&Self) -> f64| {
            pictures.iter().map(field).sum::<f64>() / pictures.len() as f64
        };
        Self {
            mean_m: of(|it| it.mean_m),
            most_m: of(|it| it.most_m),
            mean_share: of(|it| it.mean_share),
            most_share: of(|it| it.most_share),
            tiles_share: of(|it| it.tiles_share),
            lens_share: of(|it| it.lens_share),
            axis_share: of(|it| it.axis_share),
            papers_axis_share: of(|it| it.papers_axis_share),
            focal_share: of(|it| it.focal_share),
        }
    }

    /// Which parts the mean share has, per cent.
    pub fn told(&self, plane: bool) -> String {
        let Self { tiles_share, lens_share, axis_share, papers_axis_share, focal_share, .. } = self;
        let [tiles, lens, axis, papers_axis, focal] =
            [tiles_share, lens_share, axis_share, papers_axis_share, focal_share]
                .map(|it| 100.0 * it);
        if plane {
            format!("tiles {tiles:.4}, lens {lens:.4}; the rest of the paper's is its lens")
        } else {
            format!(
                "tiles {tiles:.4}, lens {lens:.4}, focal length {focal:.4}, axis {axis:.4}, for which the paper's 0.15 px \
                 would make {papers_axis:.2}"
            )
        }
    }
}

/// Equations 17 to 19, and the tiles, over what is measured.
pub fn predicted(hall: &Hall, lens: &Calibrated, plane: bool) -> Predicted {
    let measured: Vec<usize> =
        (0..hall.true_m.len()).filter(|&index| !Hall::is_reference(index)).collect();
    let of_one = |&index: &usize| {
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
        Predicted {
            mean_m: mean_share * place.norm(),
            mean_share,
            tiles_share,
            lens_share,
            axis_share,
            papers_axis_share: AXIS_ERROR_PX / semiaxes_px[0],
            focal_share: lens.focal_share,
            ..Predicted::default()
        }
    };
    let each: Vec<Predicted> = measured.iter().map(of_one).collect();
    let most_m = model::greatest(&each.iter().map(|it| it.mean_m).collect::<Vec<_>>());
    let most_share = model::greatest(&each.iter().map(|it| it.mean_share).collect::<Vec<_>>());
    Predicted { most_m, most_share, ..Predicted::mean(&each) }
}
