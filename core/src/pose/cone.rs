//! The cone of rays through a circle's rim, and the two circles that it can come from.

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, SymmetricEigen, Vector2, Vector3};

use super::rim::{RIM_POINTS, RimPoint};

/// A circle in space: centre and unit normal facing the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Centre, metres.
    pub position_m: Vector3<f64>,
    /// Unit normal with `normal · position < 0`.
    pub normal: Vector3<f64>,
}

/// The conic matrix Q of eq. 9, XᵀQX = 0 for X = (x, y, 1), through the points, in the sense of least
/// squares; `None` if they lie on no ellipse.
///
/// An affine map first takes the points near the unit circle, where |y|² - 1 is linear in the five
/// parameters that are left. Exact for points of a conic, whatever the map.
pub fn fit(points: &[RimPoint; RIM_POINTS]) -> Option<Matrix3<f64>> {
    let mut middle = Vector2::zeros();
    let mut axes = Matrix2::zeros();
    for point in points {
        middle += point.ray;
        // The basis' first harmonics carry √2: x √2 cos t averages to the axis over √2.
        axes += point.ray * Vector2::new(point.basis[1], point.basis[2]).transpose();
    }
    middle /= RIM_POINTS as f64;
    axes *= std::f64::consts::SQRT_2 / RIM_POINTS as f64;
    let unit_from_ray = axes.try_inverse()?;
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    let mut right = SVector::<f64, 5>::zeros();
    for point in points {
        let y = unit_from_ray * (point.ray - middle);
        let row = SVector::<f64, 5>::new(y.x * y.x - y.y * y.y, 2.0 * y.x * y.y, y.x, y.y, 1.0);
        normal += row * row.transpose();
        right += row * (y.norm_squared() - 1.0);
    }
    let [a, b, c, d, e] = normal.cholesky()?.solve(&right).into();
    let unit_conic = Matrix3::new(
        1.0 - a,
        -b,
        -0.5 * c, //
        -b,
        1.0 + a,
        -0.5 * d, //
        -0.5 * c,
        -0.5 * d,
        -1.0 - e,
    );
    let shift = -unit_from_ray * middle;
    let map = Matrix3::new(
        unit_from_ray.m11,
        unit_from_ray.m12,
        shift.x, //
        unit_from_ray.m21,
        unit_from_ray.m22,
        shift.y, //
        0.0,
        0.0,
        1.0,
    );
    Some(map.transpose() * unit_conic * map)
}

/// The two circles of a radius on the cone of a conic (section 4.3, corrected; see
/// [`crate::errata`]); `None` if the conic is no ellipse in front of the origin.
///
/// With eigenvalues λ₀ ≥ λ₁ > 0 > λ₂ and unit eigenvectors q₀, q₂ (q₂ forward),
/// D² = λ₀ - λ₂, A² = (λ₀ - λ₁)/D², B² = (λ₁ - λ₂)/D²:
/// x = R/√(-λ₀λ₂) (λ₀ B q₂ ± λ₂ A q₀), n = -B q₂ ∓ A q₀.
pub fn circles(conic: &Matrix3<f64>, radius_m: f64) -> Option<[Circle; 2]> {
    let eigen = SymmetricEigen::new(*conic);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[j].total_cmp(&eigen.eigenvalues[i]));
    let [l0, l1, l2] = order.map(|index| eigen.eigenvalues[index]);
    if !(l1 > 0.0 && l2 < 0.0) {
        return None;
    }
    let q0 = eigen.eigenvectors.column(order[0]).into_owned();
    let mut q2 = eigen.eigenvectors.column(order[2]).into_owned();
    if q2.z < 0.0 {
        q2 = -q2;
    }
    let tilted = ((l0 - l1) / (l0 - l2)).sqrt();
    let straight = ((l1 - l2) / (l0 - l2)).sqrt();
    let scale = radius_m / (-l0 * l2).sqrt();
    Some([1.0, -1.0].map(|sign| Circle {
        position_m: (q2 * (l0 * straight) + q0 * (sign * l2 * tilted)) * scale,
        normal: -q2 * straight - q0 * (sign * tilted),
    }))
}
