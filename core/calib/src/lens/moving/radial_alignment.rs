//! Initial camera without knowledge of its lens.
//!
//! With the principal point in the middle of the picture, distortion and focal length move an image only along its radius,
//! so u (r₂·p + t_y) = v (r₁·p + t_x) is linear in the first two rows of the pose (radial alignment: Tsai 1987). Points
//! in a volume determine all eight numbers; points in the plane z = 0 determine six, and the third elements of the rows
//! follow from orthonormality. Then f (r₁·p + t_x) - u t_z = u r₃·p, and likewise for v, is linear in f and t_z. Points in
//! a plane that faces the camera do not determine f, so some common focal lengths are tried as well; the refinement
//! selects among them.

use nalgebra::{
    DMatrix, Matrix2, Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3, linalg::SVD,
};

use crate::robust::median;
use roundel_vision::rigid::Rigid;

/// Common focal lengths, in sides of the picture.
const TRIAL_FOCALS: [f64; 3] = [0.5, 0.9, 1.6];
/// Plausible focal lengths, in sides of the picture.
const FOCAL_SHARES: (f64, f64) = (0.1, 20.0);
/// Rounds of trimming, and the limit in medians.
const TRIMS: usize = 3;
const TRIM: f64 = 3.0;

#[derive(Clone, Copy, Debug)]
pub(super) struct InitialCamera {
    pub(super) focal_px: f64,
    pub(super) camera_from_world: Rigid,
}

/// Position of a roundel in the world, metres, and in the picture, pixels from its middle.
pub(super) type Correspondence = (Vector3<f64>, Vector2<f64>);

type Method = fn(&[Correspondence]) -> Vec<PoseRows>;

/// First two rows of the rotation and of the translation.
#[derive(Clone, Copy)]
struct PoseRows {
    right: Vector3<f64>,
    down: Vector3<f64>,
    shift_m: Vector2<f64>,
}

/// Candidates; `side_px` is the longer side of the picture.
pub(super) fn initial_cameras(
    correspondences: &[Correspondence],
    side_px: f64,
) -> Vec<InitialCamera> {
    let Some((frame, center_m)) = principal_frame(correspondences) else { return Vec::new() };
    // Relative to the centroid, the axis of least spread last.
    let local: Vec<Correspondence> = correspondences
        .iter()
        .map(|(world_m, image_px)| (frame.transpose() * (world_m - center_m), *image_px))
        .collect();
    let mut found = Vec::new();
    for method in [from_volume as Method, from_plane] {
        let Some((all, kept)) = trimmed_fit(&local, method) else { continue };
        for rows in all {
            let turn = Matrix3::from_rows(&[
                rows.right.transpose(),
                rows.down.transpose(),
                rows.right.cross(&rows.down).transpose(),
            ]) * frame.transpose();
            let rotation = Rotation3::from_matrix_unchecked(turn).into();
            for (focal_px, depth_m) in depths(&kept, &rows, side_px) {
                let position_m = rows.shift_m.push(depth_m) - turn * center_m;
                if position_m.iter().all(|it| it.is_finite()) {
                    let camera_from_world = Rigid::from_parts(position_m.into(), rotation);
                    found.push(InitialCamera { focal_px, camera_from_world });
                }
            }
        }
    }
    found
}

/// Principal axes, largest spread first, right-handed; and the centroid.
fn principal_frame(correspondences: &[Correspondence]) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let count = correspondences.len() as f64;
    let center_m =
        correspondences.iter().map(|(world_m, _)| world_m).sum::<Vector3<f64>>() / count.max(1.0);
    let scatter = |arm_m: Vector3<f64>| arm_m * arm_m.transpose();
    let scatter: Matrix3<f64> =
        correspondences.iter().map(|(world_m, _)| scatter(world_m - center_m)).sum();
    let mut axes = SVD::new(scatter, true, false).u?;
    if axes.determinant() < 0.0 {
        axes.column_mut(2).neg_mut();
    }
    axes.iter().all(|it| it.is_finite()).then_some((axes, center_m))
}

/// Result of a method after trimming outliers, and the remaining correspondences.
fn trimmed_fit(
    correspondences: &[Correspondence],
    method: Method,
) -> Option<(Vec<PoseRows>, Vec<Correspondence>)> {
    let mut kept: Vec<Correspondence> = correspondences.to_vec();
    let mut found = method(&kept);
    for _ in 0..TRIMS {
        let rows = *found.first()?;
        let errors_px: Vec<f64> = kept.iter().map(|pair| rows.radial_error_px(pair)).collect();
        let limit = TRIM * median(&mut errors_px.clone())?.max(1e-6);
        let mut errors_px = errors_px.iter();
        kept.retain(|_| errors_px.next().is_some_and(|errors_px| *errors_px <= limit));
        found = method(&kept);
    }
    Some((found, kept))
}

/// For points that fill a volume.
fn from_volume(correspondences: &[Correspondence]) -> Vec<PoseRows> {
    let row = |(p, image_px): &Correspondence| {
        let (u, v) = (image_px.x, image_px.y);
        SVector::<f64, 8>::from([v * p.x, v * p.y, v * p.z, v, -u * p.x, -u * p.y, -u * p.z, -u])
    };
    let Some(n) = smallest(correspondences.iter().map(row)) else { return Vec::new() };
    let (right, down) = (Vector3::new(n[0], n[1], n[2]), Vector3::new(n[4], n[5], n[6]));
    let scale = 2.0 / (right.norm() + down.norm());
    let shift_m = Vector2::new(n[3], n[7]) * scale;
    // The nearest orthonormal pair.
    let (sum, difference) =
        (right.normalize() + down.normalize(), right.normalize() - down.normalize());
    let (sum, difference) = (sum.normalize(), difference.normalize());
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rows =
        PoseRows { right: (sum + difference) * half, down: (sum - difference) * half, shift_m };
    rows.is_sound().then(|| rows.oriented_to(correspondences)).into_iter().collect()
}

/// For points in a plane, ignoring the third coordinate: two possible tilts.
fn from_plane(correspondences: &[Correspondence]) -> Vec<PoseRows> {
    let row = |(p, image_px): &Correspondence| {
        let (u, v) = (image_px.x, image_px.y);
        SVector::<f64, 6>::from([v * p.x, v * p.y, v, -u * p.x, -u * p.y, -u])
    };
    let Some(n) = smallest(correspondences.iter().map(row)) else { return Vec::new() };
    let (a, b) = (Vector2::new(n[0], n[1]), Vector2::new(n[3], n[4]));
    let (aa, bb, ab) = (a.norm_squared(), b.norm_squared(), a.dot(&b));
    // (k - aa) (k - bb) = ab², with k at least as large as both.
    let k = 0.5 * (aa + bb + ((aa - bb).powi(2) + 4.0 * ab * ab).sqrt());
    let scale = k.sqrt().recip();
    let (third, other) = ((1.0 - aa / k).max(0.0).sqrt(), (1.0 - bb / k).max(0.0).sqrt());
    let other = if ab > 0.0 { -other } else { other };
    [1.0, -1.0]
        .into_iter()
        .map(|sign| PoseRows {
            right: Vector3::new(a.x * scale, a.y * scale, sign * third),
            down: Vector3::new(b.x * scale, b.y * scale, sign * other),
            shift_m: Vector2::new(n[2], n[5]) * scale,
        })
        .filter(PoseRows::is_sound)
        .map(|rows| rows.oriented_to(correspondences))
        .collect()
}

impl PoseRows {
    fn is_sound(&self) -> bool {
        let numbers = self.right.iter().chain(&self.down).chain(&self.shift_m);
        numbers.copied().all(f64::is_finite)
    }

    /// Position in the camera, perpendicular to the optical axis.
    fn lateral_m(&self, position_m: &Vector3<f64>) -> Vector2<f64> {
        Vector2::new(self.right.dot(position_m), self.down.dot(position_m)) + self.shift_m
    }

    /// Distance of an image from its predicted radius.
    fn radial_error_px(&self, (world_m, image_px): &Correspondence) -> f64 {
        let lateral = self.lateral_m(world_m);
        let errors_px = image_px.perp(&lateral).abs() / lateral.norm().max(1e-12);
        if errors_px.is_finite() { errors_px } else { f64::MAX }
    }

    /// With the sign for which points lie on the side of their images.
    fn oriented_to(self, correspondences: &[Correspondence]) -> Self {
        let side = |(world_m, image_px): &Correspondence| self.lateral_m(world_m).dot(image_px);
        if correspondences.iter().map(|it| side(it).signum()).sum::<f64>() >= 0.0 {
            return self;
        }
        Self { right: -self.right, down: -self.down, shift_m: -self.shift_m }
    }
}

/// Focal lengths with the depth of the centroid.
fn depths(correspondences: &[Correspondence], rows: &PoseRows, side_px: f64) -> Vec<(f64, f64)> {
    let ahead = rows.right.cross(&rows.down);
    let (mut normal, mut gradient) = (Matrix2::zeros(), Vector2::zeros());
    for (world_m, image_px) in correspondences {
        let lateral = rows.lateral_m(world_m);
        for (lateral, image_px) in lateral.iter().zip(image_px) {
            let row = Vector2::new(*lateral, -image_px);
            normal += row * row.transpose();
            gradient += row * (image_px * ahead.dot(world_m));
        }
    }
    let solved = normal.try_inverse().map(|inverse| inverse * gradient);
    let (smallest, max) = FOCAL_SHARES;
    let is_plausible = |focal_px: f64| (smallest * side_px..=max * side_px).contains(&focal_px);
    let solved_focal = solved.map(|it| (it.x, it.y)).filter(|it| is_plausible(it.0) && it.1 > 0.0);
    let trials = TRIAL_FOCALS.map(|share| {
        let focal_px = share * side_px;
        (focal_px, (normal[(0, 1)] * focal_px - gradient.y) / -normal[(1, 1)])
    });
    solved_focal.into_iter().chain(trials).filter(|it| it.1 > 0.0 && it.1.is_finite()).collect()
}

/// Singular vector of the smallest singular value.
fn smallest<const N: usize>(
    rows: impl Iterator<Item = SVector<f64, N>>,
) -> Option<SVector<f64, N>> {
    let mut normal = SMatrix::<f64, N, N>::zeros();
    for row in rows {
        normal += row * row.transpose();
    }
    // Scales the columns to equal size, so that metres and pixels have equal weight.
    let scale = normal.diagonal().map(|it| it.max(1e-300).sqrt().recip());
    let scaled =
        DMatrix::from_fn(N, N, |row, column| normal[(row, column)] * scale[row] * scale[column]);
    if !scaled.iter().all(|it| it.is_finite()) {
        return None;
    }
    let eigen = scaled.symmetric_eigen();
    let column = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    Some(SVector::from_fn(|row, _| column[row] * scale[row]))
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn a_camera_is_found_from_points_in_a_volume_and_in_a_tilted_plane() {
        let turn = UnitQuaternion::from_euler_angles(2.7, 0.2, 0.4);
        let truth = Rigid::from_parts(Vector3::new(0.4, -0.3, 5.0).into(), turn);
        for height_m in [2.0, 0.0] {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut correspondences: Vec<Correspondence> = Vec::new();
            while correspondences.len() < 200 {
                let mut within = |range: f64| rng.random_range(-range..=range);
                let world_m = Vector3::new(within(2.5), within(2.0), within(1.0) * height_m / 2.0);
                let image_px = truth * nalgebra::Point3::from(world_m);
                correspondences
                    .push((world_m, Vector2::new(image_px.x, image_px.y) * (1100.0 / image_px.z)));
            }
            // A pair of swapped observations.
            (correspondences[3].1, correspondences[4].1) =
                (correspondences[4].1, correspondences[3].1);
            let near = initial_cameras(&correspondences, 1920.0).into_iter().any(|start| {
                let errors_px = start.camera_from_world * truth.inverse();
                (start.focal_px / 1100.0 - 1.0).abs() < 1e-3
                    && errors_px.translation.vector.norm() < 0.01
                    && errors_px.rotation.angle() < 1e-3
            });
            assert!(near, "height {height_m}: {:?}", initial_cameras(&correspondences, 1920.0));
        }
    }
}
