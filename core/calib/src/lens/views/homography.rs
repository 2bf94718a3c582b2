//! Homography from the board's plane to a picture, and the pose and tilt that follow from it.

use nalgebra::{Isometry3, Matrix3, Point2, Rotation3, SMatrix, Vector3};

use super::{
    target::Target,
    view::{MIN_ROUNDELS, Sighting, View},
};

/// A roundel is misread if it is farther than this from its predicted position, in diameters. Distortion is
/// smaller.
const MISREAD_DIAMETERS: f64 = 0.6;

#[derive(Clone, Debug)]
pub(crate) struct BoardHomography {
    /// From the board's metres to raw pixels, up to scale.
    pixel_from_board: Matrix3<f64>,
    /// The consistent roundels.
    pub(crate) sightings: Vec<(Point2<f64>, Sighting)>,
}

impl BoardHomography {
    /// Homography of a view without inconsistent roundels; `None` if too few remain.
    pub(crate) fn fit(target: &Target, view: &View) -> Option<Self> {
        let on_board = |it: &Sighting| Some((target.point_m(it.number)?, *it));
        let mut sightings: Vec<(Point2<f64>, Sighting)> =
            view.sightings.iter().filter_map(on_board).collect();
        loop {
            if sightings.len() < MIN_ROUNDELS {
                return None;
            }
            let pixel_from_board = dlt(&sightings)?;
            let found = Self { pixel_from_board, sightings: sightings.clone() };
            let errors = sightings.iter().map(|(board_m, it)| found.error_diameters(board_m, it));
            let (worst, diameters) =
                errors.enumerate().max_by(|one, other| one.1.total_cmp(&other.1))?;
            if diameters <= MISREAD_DIAMETERS {
                return Some(found);
            }
            sightings.swap_remove(worst);
        }
    }

    /// Distance of a roundel from its predicted position, in its diameters.
    fn error_diameters(&self, board_m: &Point2<f64>, sighting: &Sighting) -> f64 {
        let image = self.pixel_from_board * Vector3::new(board_m.x, board_m.y, 1.0);
        let off =
            (image.x / image.z - sighting.center.u).hypot(image.y / image.z - sighting.center.v);
        if off.is_finite() { off / (2.0 * sighting.radius_px) } else { f64::MAX }
    }

    /// Relative to the middle of the picture, pixels.
    pub(crate) fn centered(&self, (width, height): (usize, usize)) -> Matrix3<f64> {
        let center = |side: usize| (side as f64 - 1.0) / 2.0;
        let (u, v) = (center(width), center(height));
        let to_center = Matrix3::new(1.0, 0.0, -u, 0.0, 1.0, -v, 0.0, 0.0, 1.0);
        // In picture widths, so that the elements are near one.
        let scale = 1.0 / width.max(height) as f64;
        let mut h = Matrix3::from_diagonal(&Vector3::new(scale, scale, 1.0))
            * to_center
            * self.pixel_from_board;
        let board_scale = 1.0 / h.column(0).norm().max(1e-300);
        h *= board_scale;
        // Back to pixels, the unit of the focal length.
        Matrix3::from_diagonal(&Vector3::new(1.0 / scale, 1.0 / scale, 1.0)) * h
    }

    /// camera_from_board for a camera of this focal length; `None` if the board is behind it.
    pub(crate) fn pose(&self, focal_px: f64, size: (usize, usize)) -> Option<Isometry3<f64>> {
        let h = Matrix3::from_diagonal(&Vector3::new(1.0 / focal_px, 1.0 / focal_px, 1.0))
            * self.centered(size);
        let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
        let sign = if h[(2, 2)] < 0.0 { -1.0 } else { 1.0 };
        let h = h * (scale * sign);
        let (right, up) = (h.column(0).into_owned(), h.column(1).into_owned());
        let rough = Matrix3::from_columns(&[right, up, right.cross(&up)]);
        let svd = rough.svd(true, true);
        let rotation = svd.u? * svd.v_t?;
        let place: Vector3<f64> = h.column(2).into_owned();
        let is_sound = rotation.determinant() > 0.0 && place.iter().all(|it| it.is_finite());
        let rotation = Rotation3::from_matrix_unchecked(rotation);
        is_sound.then(|| Isometry3::from_parts(place.into(), rotation.into()))
    }

    /// Tilt of the board about the picture's vertical and horizontal axis, estimated with a focal length of one
    /// picture width: positive if the right or the lower side is nearer.
    pub(crate) fn tilt_rad(&self, size: (usize, usize)) -> (f64, f64) {
        let focal_px = size.0.max(size.1) as f64;
        let Some(pose) = self.pose(focal_px, size) else { return (0.0, 0.0) };
        // Normal of the board towards the camera.
        let normal = pose.rotation * Vector3::z();
        let normal = if normal.z > 0.0 { -normal } else { normal };
        // Relative to the ray to the board's middle. The right side is nearer if the normal points to the left.
        let ray = pose.translation.vector.normalize();
        let lateral = -(normal - ray * normal.dot(&ray));
        (lateral.x.clamp(-1.0, 1.0).asin(), lateral.y.clamp(-1.0, 1.0).asin())
    }
}

/// Direct linear transform with normalized coordinates (Hartley 1997).
fn dlt(sightings: &[(Point2<f64>, Sighting)]) -> Option<Matrix3<f64>> {
    let scaled = |points: &[Vector3<f64>]| {
        let count = points.len() as f64;
        let mean = points.iter().sum::<Vector3<f64>>() / count;
        let spread =
            points.iter().map(|it| (it.x - mean.x).hypot(it.y - mean.y)).sum::<f64>() / count;
        let scale = 1.0 / spread.max(1e-12);
        Matrix3::new(scale, 0.0, -scale * mean.x, 0.0, scale, -scale * mean.y, 0.0, 0.0, 1.0)
    };
    let homogeneous = |x: f64, y: f64| Vector3::new(x, y, 1.0);
    let (board, image): (Vec<_>, Vec<_>) = sightings
        .iter()
        .map(|(at, Sighting { center, .. })| {
            (homogeneous(at.x, at.y), homogeneous(center.u, center.v))
        })
        .unzip();
    let (board_normalizer, image_normalizer) = (scaled(&board), scaled(&image));
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (board_m, observed) in board.iter().zip(&image) {
        let (p, q) = (board_normalizer * board_m, image_normalizer * observed);
        let rows = [
            [p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y, -q.x],
            [0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y, -q.y],
        ];
        for row in rows {
            let row = SMatrix::<f64, 9, 1>::from(row);
            normal += row * row.transpose();
        }
    }
    let eigen = normal.symmetric_eigen();
    let min = eigen.eigenvalues.imin();
    let h = Matrix3::from_row_slice(eigen.eigenvectors.column(min).as_slice());
    let homography = image_normalizer.try_inverse()? * h * board_normalizer;
    // The middle of the board is in front of the camera.
    let sign = if homography[(2, 2)] < 0.0 { -1.0 } else { 1.0 };
    homography.iter().all(|it| it.is_finite()).then_some(homography * sign)
}
