//! Closed-form rigid alignment (Kabsch 1976, Umeyama 1991: singular value decomposition of the weighted cross
//! covariance), and the extent of point sets.

use nalgebra::{Matrix3, Rotation3, SymmetricEigen, Vector3};

/// Rotation, origin and scale that minimize Σ w |to - R from - t|² over pairs `[to, from]`.
pub fn kabsch(pairs: &[[Vector3<f64>; 2]], weights: &[f64]) -> (Rotation3<f64>, Vector3<f64>, f64) {
    let middle = |which: usize| middle(pairs.iter().map(|pair| pair[which]), weights);
    let (to_middle, from_middle) = (middle(0), middle(1));
    let mut cross = Matrix3::zeros();
    for ([to, from], weight) in std::iter::zip(pairs, weights) {
        cross += (to - to_middle) * (from - from_middle).transpose() * *weight;
    }
    let rotation = nearest_rotation(&cross);
    let (mut together, mut alone) = (0.0, 0.0);
    for ([to, from], weight) in std::iter::zip(pairs, weights) {
        let ray = from - from_middle;
        together += weight * (to - to_middle).dot(&(rotation * ray));
        alone += weight * ray.norm_squared();
    }
    (rotation, to_middle - rotation * from_middle, together / alone)
}

/// Proper rotation R that maximizes tr(Rᵀ M).
pub(super) fn nearest_rotation(matrix: &Matrix3<f64>) -> Rotation3<f64> {
    let decomposed = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (decomposed.u, decomposed.v_t) else {
        return Rotation3::identity();
    };
    let mut signs = Vector3::repeat(1.0);
    if (u * v_t).determinant() < 0.0 {
        // A reflection: flip the axis with the smallest singular value.
        signs[decomposed.singular_values.imin()] = -1.0;
    }
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v_t)
}

/// Weighted root mean square extent of points along their longest direction and along the next.
pub fn spread(points: &[Vector3<f64>], weights: &[f64]) -> [f64; 2] {
    let middle = middle(points.iter().copied(), weights);
    let scatter: Matrix3<f64> = std::iter::zip(points, weights)
        .map(|(point, weight)| (point - middle) * (point - middle).transpose() * *weight)
        .sum::<Matrix3<f64>>()
        / weights.iter().sum::<f64>();
    let mut values: [f64; 3] = SymmetricEigen::new(scatter).eigenvalues.into();
    values.sort_by(f64::total_cmp);
    [values[2], values[1]].map(|value| value.max(0.0).sqrt())
}

fn middle(points: impl Iterator<Item = Vector3<f64>>, weights: &[f64]) -> Vector3<f64> {
    let total: f64 = weights.iter().sum();
    points.zip(weights).map(|(point, weight)| point * (weight / total)).sum()
}
