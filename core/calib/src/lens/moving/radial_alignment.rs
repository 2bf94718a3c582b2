//! Where the refinement of a camera among moving roundels starts, without knowing anything of its lens.
//!
//! With the principal point in the middle, distortion and focal length move an image along its radius only, so
//! u (r₂·p + t_y) = v (r₁·p + t_x) is linear in the first two rows of the camera's pose (radial alignment: Tsai 1987). Points that
//! fill a volume tell all eight numbers; of those in one plane, z = 0, six, and the rows' third elements follow from
//! their being orthonormal. Then f (r₁·p + t_x) - u t_z = u r₃·p, and so for v, is linear in f and t_z. Where
//! points face the camera in one plane that says nothing of f, so some usual ones are tried as well; the refinement
//! tells which is right.

use nalgebra::{
    DMatrix, Matrix2, Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3,
    linalg::SVD,
};

use roundel_vision::rigid::Rigid;

/// Focal lengths that are tried, in sides of the picture.
const USUAL_FOCALS: [f64; 3] = [0.5, 0.9, 1.6];
/// Focal lengths that are believed, in sides of the picture.
const FOCAL_SHARES: (f64, f64) = (0.1, 20.0);
/// Rounds in which what is off by more than this many medians is left out.
const TRIMS: usize = 3;
const TRIM: f64 = 3.0;

/// A camera to begin with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub(super) focal_px: f64,
    pub(super) camera_from_world: Rigid,
}

/// A roundel's centre in the world, metres, and in the picture, pixels from its middle.
pub(super) type Pair = (Vector3<f64>, Vector2<f64>);

type Method = fn(&[Pair]) -> Vec<Rows>;

/// First two rows of the pose and their translations.
#[derive(Clone, Copy)]
struct Rows {
    right: Vector3<f64>,
    down: Vector3<f64>,
    shift_m: Vector2<f64>,
}

/// Cameras that may be it; `side_px` is the picture's longer side.
pub(super) fn starts(pairs: &[Pair], side_px: f64) -> Vec<Start> {
    let Some((frame, middle_m)) = principal_frame(pairs) else { return Vec::new() };
    // About their middle, the axis along which they spread least last.
    let local: Vec<Pair> =
        pairs.iter().map(|(at, seen)| (frame.transpose() * (at - middle_m), *seen)).collect();
    let mut found = Vec::new();
    let each = [solid as Method, flat].into_iter().filter_map(|method| trimmed(&local, method));
    for (rows, kept) in
        each.flat_map(|(all, kept)| all.into_iter().map(move |it| (it, kept.clone())))
    {
        for (focal_px, depth_m) in depths(&kept, &rows, side_px) {
            let turn = Matrix3::from_rows(&[
                rows.right.transpose(),
                rows.down.transpose(),
                rows.right.cross(&rows.down).transpose(),
            ]) * frame.transpose();
            let place_m = Vector3::new(rows.shift_m.x, rows.shift_m.y, depth_m) - turn * middle_m;
            let turn = Rotation3::from_matrix_unchecked(turn);
            let turn = UnitQuaternion::from_rotation_matrix(&turn);
            let camera_from_world = Rigid::from_parts(place_m.into(), turn);
            if camera_from_world.translation.vector.iter().all(|it| it.is_finite()) {
                found.push(Start { focal_px, camera_from_world });
            }
        }
    }
    found
}

/// Axes along which the points spread, most first, right-handed; and their middle.
fn principal_frame(pairs: &[Pair]) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let count = pairs.len() as f64;
    let middle_m = pairs.iter().map(|(at, _)| at).sum::<Vector3<f64>>() / count.max(1.0);
    let spread = pairs
        .iter()
        .map(|(at, _)| (at - middle_m) * (at - middle_m).transpose())
        .sum::<Matrix3<f64>>();
    let svd = SVD::new(spread, true, false);
    let mut axes = svd.u?;
    if axes.determinant() < 0.0 {
        axes.column_mut(2).neg_mut();
    }
    axes.iter().all(|it| it.is_finite()).then_some((axes, middle_m))
}

/// What a method finds when what contradicts the others is left out, and the others.
fn trimmed(pairs: &[Pair], method: Method) -> Option<(Vec<Rows>, Vec<Pair>)> {
    let mut kept: Vec<Pair> = pairs.to_vec();
    let mut found = method(&kept);
    for _ in 0..TRIMS {
        let rows = *found.first()?;
        let off: Vec<f64> = kept.iter().map(|pair| rows.miss_px(pair)).collect();
        let mut sorted = off.clone();
        let middle = sorted.len() / 2;
        let (_, median, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
        let limit = TRIM * median.max(1e-6);
        let mut off = off.iter();
        kept.retain(|_| off.next().is_some_and(|off| *off <= limit));
        found = method(&kept);
    }
    Some((found, kept))
}

/// Of points that fill a volume.
fn solid(pairs: &[Pair]) -> Vec<Rows> {
    let row = |(p, seen): &Pair| {
        let (u, v) = (seen.x, seen.y);
        SVector::<f64, 8>::from([v * p.x, v * p.y, v * p.z, v, -u * p.x, -u * p.y, -u * p.z, -u])
    };
    let Some(n) = least(pairs.iter().map(row)) else { return Vec::new() };
    let (right, down) = (Vector3::new(n[0], n[1], n[2]), Vector3::new(n[4], n[5], n[6]));
    let scale = 2.0 / (right.norm() + down.norm());
    let shift_m = Vector2::new(n[3], n[7]) * scale;
    // The nearest pair of unit vectors at right angles.
    let (sum, difference) =
        (right.normalize() + down.normalize(), right.normalize() - down.normalize());
    let (sum, difference) = (sum.normalize(), difference.normalize());
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rows = Rows { right: (sum + difference) * half, down: (sum - difference) * half, shift_m };
    rows.is_sound().then(|| rows.turned_to(pairs)).into_iter().collect()
}

/// Of points in one plane, whose third coordinate is not looked at: two ways to tilt.
fn flat(pairs: &[Pair]) -> Vec<Rows> {
    let row = |(p, seen): &Pair| {
        let (u, v) = (seen.x, seen.y);
        SVector::<f64, 6>::from([v * p.x, v * p.y, v, -u * p.x, -u * p.y, -u])
    };
    let Some(n) = least(pairs.iter().map(row)) else { return Vec::new() };
    let (a, b) = (Vector2::new(n[0], n[1]), Vector2::new(n[3], n[4]));
    let (aa, bb, ab) = (a.norm_squared(), b.norm_squared(), a.dot(&b));
    // (k - aa) (k - bb) = ab², k at least as large as both.
    let k = 0.5 * (aa + bb + ((aa - bb).powi(2) + 4.0 * ab * ab).sqrt());
    let scale = k.sqrt().recip();
    let (third, other) = ((1.0 - aa / k).max(0.0).sqrt(), (1.0 - bb / k).max(0.0).sqrt());
    let other = if ab > 0.0 { -other } else { other };
    [1.0, -1.0]
        .into_iter()
        .map(|sign| Rows {
            right: Vector3::new(a.x * scale, a.y * scale, sign * third),
            down: Vector3::new(b.x * scale, b.y * scale, sign * other),
            shift_m: Vector2::new(n[2], n[5]) * scale,
        })
        .filter(Rows::is_sound)
        .map(|rows| rows.turned_to(pairs))
        .collect()
}

impl Rows {
    fn is_sound(&self) -> bool {
        let numbers = self.right.iter().chain(&self.down).chain(&self.shift_m);
        numbers.copied().all(f64::is_finite)
    }

    /// Where a point is in the camera, across the line of sight.
    fn across_m(&self, place_m: &Vector3<f64>) -> Vector2<f64> {
        Vector2::new(self.right.dot(place_m), self.down.dot(place_m)) + self.shift_m
    }

    /// How far an image is off its radius.
    fn miss_px(&self, (at, seen): &Pair) -> f64 {
        let across = self.across_m(at);
        let off = seen.perp(&across).abs() / across.norm().max(1e-12);
        if off.is_finite() { off } else { f64::MAX }
    }

    /// With the sign that has images on the side where the points are.
    fn turned_to(self, pairs: &[Pair]) -> Self {
        let side: f64 = pairs.iter().map(|(at, seen)| self.across_m(at).dot(seen).signum()).sum();
        if side >= 0.0 {
            return self;
        }
        Self { right: -self.right, down: -self.down, shift_m: -self.shift_m }
    }
}

/// Focal lengths with the depth of the points' middle.
fn depths(pairs: &[Pair], rows: &Rows, side_px: f64) -> Vec<(f64, f64)> {
    let ahead = rows.right.cross(&rows.down);
    let (mut normal, mut gradient) = (Matrix2::zeros(), Vector2::zeros());
    for (at, seen) in pairs {
        let across = rows.across_m(at);
        for (across, seen) in across.iter().zip(seen) {
            let row = Vector2::new(*across, -seen);
            normal += row * row.transpose();
            gradient += row * (seen * ahead.dot(at));
        }
    }
    let solved = normal.try_inverse().map(|inverse| inverse * gradient);
    let (least, most) = FOCAL_SHARES;
    let is_usual = |focal_px: f64| (least * side_px..=most * side_px).contains(&focal_px);
    let own = solved.map(|it| (it.x, it.y)).filter(|it| is_usual(it.0) && it.1 > 0.0);
    let tried = USUAL_FOCALS.map(|share| {
        let focal_px = share * side_px;
        (focal_px, (normal[(0, 1)] * focal_px - gradient.y) / -normal[(1, 1)])
    });
    own.into_iter().chain(tried).filter(|it| it.1 > 0.0 && it.1.is_finite()).collect()
}

/// The vector that a set of rows maps to least.
fn least<const N: usize>(rows: impl Iterator<Item = SVector<f64, N>>) -> Option<SVector<f64, N>> {
    let mut normal = SMatrix::<f64, N, N>::zeros();
    for row in rows {
        normal += row * row.transpose();
    }
    // Columns of one size, so that metres and pixels count alike.
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
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn a_camera_is_found_from_points_in_a_volume_and_in_a_tilted_plane() {
        let turn = UnitQuaternion::from_euler_angles(2.7, 0.2, 0.4);
        let truth = Rigid::from_parts(Vector3::new(0.4, -0.3, 5.0).into(), turn);
        for height_m in [2.0, 0.0] {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut pairs: Vec<Pair> = Vec::new();
            while pairs.len() < 200 {
                let mut within = |range: f64| rng.random_range(-range..=range);
                let at = Vector3::new(within(2.5), within(2.0), within(1.0) * height_m / 2.0);
                let seen = truth * nalgebra::Point3::from(at);
                pairs.push((at, Vector2::new(seen.x, seen.y) * (1100.0 / seen.z)));
            }
            // One of two that were taken for each other.
            (pairs[3].1, pairs[4].1) = (pairs[4].1, pairs[3].1);
            let near = starts(&pairs, 1920.0).into_iter().any(|start| {
                let off = start.camera_from_world * truth.inverse();
                (start.focal_px / 1100.0 - 1.0).abs() < 1e-3
                    && off.translation.vector.norm() < 0.01
                    && off.rotation.angle() < 1e-3
            });
            assert!(near, "height {height_m}: {:?}", starts(&pairs, 1920.0));
        }
    }
}
