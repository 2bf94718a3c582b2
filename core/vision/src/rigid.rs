//! Rigid transforms and their covariances.
//!
//! A transform `a_from_b` maps coordinates of frame b to coordinates of frame a. Covariances are
//! over (position, rotation) with the rotation as a left perturbation, see [`crate::conventions`].

use nalgebra::{Isometry3, Matrix3, Quaternion, SMatrix, SVector, UnitQuaternion, Vector3};

/// A rigid transform, or the pose of one frame in another.
pub type Rigid = Isometry3<f64>;

/// Covariance over (position m, rotation rad), in the frame of its pose.
pub type Covariance6 = SMatrix<f64, 6, 6>;

/// Variance of a completely unknown angle: π²/3, that of the uniform distribution.
pub const UNKNOWN_ANGLE_VARIANCE_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

/// Squared sine below which series replace sines and arc sines.
pub const SMALL_SQUARED: f64 = 0.01;

/// Squared sine of the angle to straight down below which the smallest rotation is arbitrary.
const MIN_ACROSS: f64 = 1e-30;

/// 1 + cos of the rotation below which the closed form of the smallest rotation loses digits.
const MIN_COSINE: f64 = 0.01;

/// Transforms a covariance by the rotation of a known rigid motion.
pub fn rotate_covariance(rotation: &UnitQuaternion<f64>, covariance: &Covariance6) -> Covariance6 {
    let turn: Matrix3<f64> = rotation.to_rotation_matrix().into_inner();
    let mut both = Covariance6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    both * covariance * both.transpose()
}

/// T A Tᵀ for symmetric A.
pub fn turned_covariance(turn: &Matrix3<f64>, covariance: &Matrix3<f64>) -> Matrix3<f64> {
    let half = turn * covariance;
    let mut turned = Matrix3::zeros();
    for row in 0..3 {
        for column in 0..=row {
            let sum = half[(row, 0)] * turn[(column, 0)]
                + half[(row, 1)] * turn[(column, 1)]
                + half[(row, 2)] * turn[(column, 2)];
            turned[(row, column)] = sum;
            turned[(column, row)] = sum;
        }
    }
    turned
}

/// The upper triangle row by row: 3×3 gives 6 numbers, 6×6 gives 21.
pub fn upper_triangle<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Vec<f64> {
    // Reserved up front: a flattened iterator does not know its length, so collecting would
    // reallocate repeatedly.
    let mut numbers = Vec::with_capacity(N * (N + 1) / 2);
    for row in 0..N {
        numbers.extend((row..N).map(|column| matrix[(row, column)]));
    }
    numbers
}

/// The symmetric matrix with this upper triangle; `None` unless there are N (N + 1) / 2 numbers.
pub fn from_upper_triangle<const N: usize>(numbers: &[f64]) -> Option<SMatrix<f64, N, N>> {
    if numbers.len() != N * (N + 1) / 2 {
        return None;
    }
    let mut matrix = SMatrix::<f64, N, N>::zeros();
    let mut numbers = numbers.iter();
    for row in 0..N {
        for column in row..N {
            let value = *numbers.next()?;
            matrix[(row, column)] = value;
            matrix[(column, row)] = value;
        }
    }
    Some(matrix)
}

/// The orientation of a plain roundel or object whose z axis is `normal` (unit): the smallest
/// rotation from +z; for -z, the half turn about x.
pub fn orientation_of_normal(normal: &Vector3<f64>) -> UnitQuaternion<f64> {
    // (1 + z·n, z × n) is twice the cosine of the half angle times that quaternion.
    let across = normal.x * normal.x + normal.y * normal.y;
    let length = (across + normal.z * normal.z).sqrt();
    let cosine = if normal.z >= 0.0 { length + normal.z } else { across / (length - normal.z) };
    if across < MIN_ACROSS * length && normal.z < 0.0 {
        return UnitQuaternion::from_quaternion(Quaternion::new(0.0, 1.0, 0.0, 0.0));
    }
    UnitQuaternion::new_normalize(Quaternion::new(cosine, -normal.y, normal.x, 0.0))
}

/// The rotation about z with this cosine and sine.
pub fn turn_about_z(cosine: f64, sine: f64) -> UnitQuaternion<f64> {
    // The half angle, from the larger of its sine and cosine.
    let larger = (0.5 * (1.0 + cosine.abs())).sqrt();
    let smaller = 0.5 * sine.abs() / larger;
    let (w, z) = if cosine >= 0.0 { (larger, smaller) } else { (smaller, larger) };
    UnitQuaternion::new_normalize(Quaternion::new(w, 0.0, 0.0, z.copysign(sine)))
}

/// The matrix of the smallest rotation from one unit vector to another; `None` if they are nearly
/// opposite.
pub fn smallest_rotation(from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let cosine = 1.0 + from.dot(to);
    (cosine > MIN_COSINE).then(|| {
        let cross = from.cross(to).cross_matrix();
        Matrix3::identity() + cross + cross * cross / cosine
    })
}

/// [`smallest_rotation`] applied to one vector.
pub fn smallest_rotation_of(
    from: &Vector3<f64>,
    to: &Vector3<f64>,
    vector: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    let cosine = 1.0 + from.dot(to);
    (cosine > MIN_COSINE).then(|| {
        let axis = from.cross(to);
        let across = axis.cross(vector);
        vector + across + axis.cross(&across) / cosine
    })
}

/// The rotation with this rotation vector; small ones by series.
pub fn turn_by(vector: &Vector3<f64>) -> UnitQuaternion<f64> {
    let half = vector * 0.5;
    let x = half.norm_squared();
    if x > SMALL_SQUARED {
        return UnitQuaternion::from_scaled_axis(*vector);
    }
    // cos √x and sin √x / √x.
    let cos = 1.0 - x / 2.0 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0)));
    let sin = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0)));
    UnitQuaternion::new_unchecked(Quaternion::from_parts(cos, half * sin))
}

/// The rotation vector of a rotation; small ones by series.
pub fn vector_of(turn: &UnitQuaternion<f64>) -> Vector3<f64> {
    let part = turn.imag();
    let x = part.norm_squared();
    if x > SMALL_SQUARED {
        return turn.scaled_axis();
    }
    part * (2.0 * arc_sine_share(x)).copysign(turn.w)
}

/// asin √x / √x for x up to [`SMALL_SQUARED`], exact to 1e-16.
pub fn arc_sine_share(x: f64) -> f64 {
    let tail = 63.0 / 2816.0 + x * (231.0 / 13312.0 + x * (143.0 / 10240.0));
    1.0 + x * (1.0 / 6.0 + x * (3.0 / 40.0 + x * (5.0 / 112.0 + x * (35.0 / 1152.0 + x * tail))))
}

/// Whether a symmetric matrix is positive definite, by its L D Lᵀ factors.
pub fn is_positive_definite<const N: usize>(matrix: &SMatrix<f64, N, N>) -> bool {
    let mut left = *matrix;
    for pivot in 0..N {
        let diagonal = left[(pivot, pivot)];
        // NaN is not positive either.
        if !(diagonal > 0.0 && diagonal.is_finite()) {
            return false;
        }
        let per = 1.0 / diagonal;
        for column in pivot + 1..N {
            let factor = left[(column, pivot)] * per;
            for row in column..N {
                left[(row, column)] -= left[(row, pivot)] * factor;
            }
        }
    }
    true
}

/// Squared Mahalanobis length of `error`; `None` if the covariance is not positive definite.
pub fn mahalanobis_squared<const N: usize>(
    error: &SVector<f64, N>,
    covariance: &SMatrix<f64, N, N>,
) -> Option<f64> {
    let factor = covariance.cholesky()?;
    Some(error.dot(&factor.solve(error)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn upper_triangle_round_trips(numbers in proptest::collection::vec(-9.0..9.0f64, 21)) {
            let matrix: Covariance6 = from_upper_triangle(&numbers).unwrap();
            prop_assert_eq!(matrix, matrix.transpose());
            prop_assert_eq!(upper_triangle(&matrix), numbers);
        }

        #[test]
        fn orientation_takes_z_to_the_normal(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64) {
            let normal = Vector3::new(x, y, z);
            prop_assume!(normal.norm() > 1e-3);
            let normal = normal.normalize();
            prop_assert!((orientation_of_normal(&normal) * Vector3::z() - normal).norm() < 1e-9);
        }
    }

    proptest! {
        #[test]
        fn smallest_rotations_equal_rotations_between_vectors(
            from in [-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64].prop_map(Vector3::from),
            to in [-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64].prop_map(Vector3::from),
        ) {
            prop_assume!(from.norm() > 1e-3 && to.norm() > 1e-3);
            let (from, to) = (from.normalize(), to.normalize());
            let Some(expected) = UnitQuaternion::rotation_between(&from, &to) else { return Ok(()) };
            let expected = expected.to_rotation_matrix().into_inner();
            if let Some(found) = smallest_rotation(&from, &to) {
                prop_assert!((found - expected).norm() < 1e-6);
                let vector = Vector3::new(0.3, -0.7, 1.1);
                let turned = smallest_rotation_of(&from, &to, &vector).unwrap();
                prop_assert!((turned - found * vector).norm() < 1e-12);
            } else {
                prop_assert!(from.dot(&to) < -0.98);
            }
            let level = orientation_of_normal(&to) * Vector3::z_axis().cross(&to);
            prop_assert!((level - Vector3::z_axis().cross(&to)).norm() < 1e-9, "turned about itself");
        }

        #[test]
        fn small_rotations_equal_those_by_sines(
            axis in [-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64].prop_map(Vector3::from),
            size in prop_oneof![0.0..0.4f64, 0.0..3.1f64],
        ) {
            prop_assume!(axis.norm() > 1e-3);
            let vector = axis.normalize() * size;
            let turn = UnitQuaternion::from_scaled_axis(vector);
            prop_assert!((turn_by(&vector).coords - turn.coords).norm() < 1e-15);
            prop_assert!((vector_of(&turn) - vector).norm() < 1e-14);
            let opposite = UnitQuaternion::new_unchecked(-turn.into_inner());
            prop_assert!((vector_of(&opposite) - vector).norm() < 1e-14);
            let sine = size.sin();
            if size < 1.5 && sine * sine <= SMALL_SQUARED && sine > 0.0 {
                prop_assert!((arc_sine_share(sine * sine) * sine - size).abs() < 1e-16);
            }
        }

        #[test]
        fn rotated_covariances_equal_matrix_products(
            numbers in proptest::collection::vec(-1.0..1.0f64, 9),
            vector in [-3.0..3.0f64, -3.0..3.0f64, -3.0..3.0f64].prop_map(Vector3::from),
        ) {
            let root = Matrix3::from_column_slice(&numbers);
            let covariance = root * root.transpose();
            let turn = turn_by(&vector).to_rotation_matrix().into_inner();
            let turned = turned_covariance(&turn, &covariance);
            prop_assert!((turned - turn * covariance * turn.transpose()).norm() < 1e-14);
            prop_assert_eq!(turned, turned.transpose());
        }

        #[test]
        fn positive_definite_matrices_have_a_cholesky_factor(
            numbers in proptest::collection::vec(-1.0..1.0f64, 36),
            added in -1.0..2.0f64,
        ) {
            let root = Covariance6::from_column_slice(&numbers);
            let matrix = root + root.transpose() + Covariance6::identity() * (3.0 * added);
            prop_assert_eq!(is_positive_definite(&matrix), matrix.cholesky().is_some());
        }
    }

    #[test]
    fn normals_close_to_straight_down_are_exact() {
        for aside in [0.2, 1e-3, 1e-6, 1e-9, 1e-12] {
            let normal = Vector3::new(0.6 * aside, 0.8 * aside, -f64::sqrt(1.0 - aside * aside));
            let turned = orientation_of_normal(&normal);
            assert!((turned * Vector3::z() - normal).norm() < 1e-15, "{aside}");
            // The rotation axis is the common perpendicular.
            let axis = Vector3::z().cross(&normal).normalize();
            assert!((turned * axis - axis).norm() < 1e-15, "{aside}");
        }
    }

    #[test]
    fn rotations_about_z_equal_axis_angle_rotations() {
        for step in -20..=20 {
            let angle_rad = f64::from(step) * std::f64::consts::PI / 20.0;
            let expected = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle_rad);
            let turn = turn_about_z(angle_rad.cos(), angle_rad.sin());
            assert!(turn.angle_to(&expected) < 1e-7, "{angle_rad}");
        }
    }

    #[test]
    fn downward_normal_is_the_half_turn_about_x() {
        let turned = orientation_of_normal(&-Vector3::z());
        assert!((turned * Vector3::x() - Vector3::x()).norm() < 1e-12);
        assert!((turned * Vector3::z() + Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn a_triangle_of_wrong_length_is_rejected() {
        assert_eq!(from_upper_triangle::<6>(&[0.0; 20]), None);
    }
}
