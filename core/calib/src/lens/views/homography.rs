//! The board's plane in one picture: the homography that takes it there, and what follows from that.

use nalgebra::{
    Isometry3, Matrix3, Point2, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector3,
};

use super::{
    target::Target,
    view::{LEAST_ROUNDELS, Sighting, View},
};

/// A roundel this far from where the others' homography has it, in diameters, has another code than was read; a lens
/// bends less.
const MISREAD_DIAMETERS: f64 = 0.6;

/// The board's plane in one picture.
#[derive(Clone, Debug)]
pub(crate) struct Flat {
    /// From the board's metres to raw pixels, up to scale.
    pixel_from_board: Matrix3<f64>,
    /// Roundels that are where it says.
    pub(crate) sightings: Vec<(Point2<f64>, Sighting)>,
}

impl Flat {
    /// The homography of a view, without the roundels that contradict it; `None` if too few are left.
    pub(crate) fn of(target: &Target, view: &View) -> Option<Self> {
        let mut sightings: Vec<(Point2<f64>, Sighting)> = view
            .sightings
            .iter()
            .filter_map(|sighting| Some((target.at(sighting.number)?, *sighting)))
            .collect();
        loop {
            if sightings.len() < LEAST_ROUNDELS {
                return None;
            }
            let pixel_from_board = homography(&sightings)?;
            let flat = Self { pixel_from_board, sightings: sightings.clone() };
            let worst = sightings
                .iter()
                .map(|(at, sighting)| flat.miss(at, sighting))
                .enumerate()
                .max_by(|one, other| one.1.total_cmp(&other.1))?;
            if worst.1 <= MISREAD_DIAMETERS {
                return Some(flat);
            }
            sightings.swap_remove(worst.0);
        }
    }

    /// How far a roundel is from where it should be, in its diameters.
    fn miss(&self, at: &Point2<f64>, sighting: &Sighting) -> f64 {
        let image = self.pixel_from_board * Vector3::new(at.x, at.y, 1.0);
        let off =
            (image.x / image.z - sighting.center.u).hypot(image.y / image.z - sighting.center.v);
        if off.is_finite() { off / (2.0 * sighting.radius_px) } else { f64::MAX }
    }

    /// With pixels from the picture's middle.
    pub(crate) fn centered(&self, (width, height): (usize, usize)) -> Matrix3<f64> {
        let middle = |side: usize| (side as f64 - 1.0) / 2.0;
        let (u, v) = (middle(width), middle(height));
        let to_middle = Matrix3::new(1.0, 0.0, -u, 0.0, 1.0, -v, 0.0, 0.0, 1.0);
        // In pictures' widths, so that its elements are near one.
        let scale = 1.0 / width.max(height) as f64;
        let mut h = Matrix3::from_diagonal(&Vector3::new(scale, scale, 1.0))
            * to_middle
            * self.pixel_from_board;
        let board_scale = 1.0 / h.column(0).norm().max(1e-300);
        h *= board_scale;
        // Back to pixels: the focal length is wanted in them.
        Matrix3::from_diagonal(&Vector3::new(1.0 / scale, 1.0 / scale, 1.0)) * h
    }

    /// camera_from_board for a camera of that focal length; `None`: behind it.
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
        is_sound.then(|| {
            let rotation = Rotation3::from_matrix_unchecked(rotation);
            let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
            Isometry3::from_parts(Translation3::from(place), rotation)
        })
    }

    /// How the board is tilted about the picture's upright and level axis, by the change of its scale: positive where
    /// the right, the lower side is nearer. Rough: for a focal length of the picture's width.
    pub(crate) fn tilt_rad(&self, size: (usize, usize)) -> (f64, f64) {
        let focal_px = size.0.max(size.1) as f64;
        let Some(pose) = self.pose(focal_px, size) else { return (0.0, 0.0) };
        // The board's normal, towards the camera.
        let normal = pose.rotation * Vector3::z();
        let normal = if normal.z > 0.0 { -normal } else { normal };
        // Seen along the ray to the board's middle. Its right side is nearer where it faces to the left.
        let ray = pose.translation.vector.normalize();
        let across = -(normal - ray * normal.dot(&ray));
        (across.x.clamp(-1.0, 1.0).asin(), across.y.clamp(-1.0, 1.0).asin())
    }
}

/// Direct linear transform, with coordinates scaled to their spread (Hartley 1997).
fn homography(sightings: &[(Point2<f64>, Sighting)]) -> Option<Matrix3<f64>> {
    let scaled = |points: &[Point2<f64>]| {
        let count = points.len() as f64;
        let mean =
            points.iter().fold(Vector3::zeros(), |sum, it| sum + Vector3::new(it.x, it.y, 0.0))
                / count;
        let spread =
            points.iter().map(|it| (it.x - mean.x).hypot(it.y - mean.y)).sum::<f64>() / count;
        let scale = 1.0 / spread.max(1e-12);
        Matrix3::new(scale, 0.0, -scale * mean.x, 0.0, scale, -scale * mean.y, 0.0, 0.0, 1.0)
    };
    let board: Vec<_> = sightings.iter().map(|(at, _)| *at).collect();
    let image: Vec<_> =
        sightings.iter().map(|(_, seen)| Point2::new(seen.center.u, seen.center.v)).collect();
    let (of_board, of_image) = (scaled(&board), scaled(&image));
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (at, seen) in board.iter().zip(&image) {
        let p = of_board * Vector3::new(at.x, at.y, 1.0);
        let q = of_image * Vector3::new(seen.x, seen.y, 1.0);
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
    let least = eigen.eigenvalues.imin();
    let h = Matrix3::from_row_slice(eigen.eigenvectors.column(least).as_slice());
    let homography = of_image.try_inverse()? * h * of_board;
    // The board's middle is before the camera.
    let sign = if homography[(2, 2)] < 0.0 { -1.0 } else { 1.0 };
    homography.iter().all(|it| it.is_finite()).then_some(homography * sign)
}
