//! Motion within the exposure.
//!
//! Even motion by m pixels while the shutter is open adds a box blur along m to the lens' Gaussian.
//! The pose is that at the middle of the exposure. Along a rim's normal n the variance of an edge
//! is σ² + (m·n)²/12, and m cannot be distinguished from -m. The square μ = m² (m a complex number)
//! expresses both. Unlike m, it enters the image linearly at zero motion: with h = (∂²/∂u² -
//! ∂²/∂v², 2 ∂²/∂u∂v) d,
//!
//!   σ² + m mᵀ/12 = (σ² + |μ|/24) I + [[μ₁, μ₂], [μ₂, -μ₁]]/24,   ∂d/∂μ = h/48.
//!
//! The unknowns of the fit are therefore the mean σ² + |μ|/24, as without motion, and μ. The prior
//! of μ has zero mean, and as variance its own size plus that of the track's displacement
//! ([`prior`]): a track that hardly moves from frame to frame does not move within one either. Up
//! to [`LINEAR_PX2`] the image is that without motion plus the linear terms. Beyond, each contour
//! node is repeated along m at the points of Gauss-Legendre quadrature ([`quadrature`]), and only
//! the derivatives are those of the second moments.
//!
//! **Accuracy** (`roundel-tests`, `tests/robustness.rs`: 20 to 60 px, motion of 0.5 to 3 px, tilt
//! to 50°, unknown blur and noise): rms of the depth 0.84 to 1.11 of the bound with unknown motion,
//! bias below a tenth of it, 95 % of the positions inside the stated 95 % ellipsoid. The error of
//! the mixed derivative ([`super::blur_kernel`]) contributes to that; the residual is exact beyond
//! [`LINEAR_PX2`].
//!
//! **Held motion.** Where a track shows no motion (`photometry::history`) μ is held at zero and its
//! columns are left out, which saves a sixth of the time of a linearization.
//!
//! **Limits.** The robust fit, for residuals that neither noise nor motion explains, has no motion.
//! Motion is assumed even and across the line of sight; rotation, change of distance and
//! acceleration within the exposure are not modelled.

use nalgebra::Vector2;

/// Range of the expected motion, pixels, however still or fast a track is, since the exposure time
/// is unknown.
const PRIOR_RANGE_PX: (f64, f64) = (0.3, 1.4);
/// |μ| up to which the image is linear in it, px².
const LINEAR_PX2: f64 = 0.35;
/// Limit of |μ|, px².
const MAX_PX2: f64 = 64.0;

/// Points and weights of Gauss-Legendre quadrature over a unit length, for motion up to this
/// number of blurs.
const QUADRATURES: [(f64, &[(f32, f32)]); 4] = [
    (1.0, &[(-0.288_675_13, 0.5), (0.288_675_13, 0.5)]),
    (2.2, &[(-0.387_298_33, 0.277_777_8), (0.0, 0.444_444_45), (0.387_298_33, 0.277_777_8)]),
    (
        4.5,
        &[
            (-0.453_089_92, 0.118_463_44),
            (-0.269_234_66, 0.239_314_34),
            (0.0, 0.284_444_45),
            (0.269_234_66, 0.239_314_34),
            (0.453_089_92, 0.118_463_44),
        ],
    ),
    (
        f64::INFINITY,
        &[
            (-0.480_144_93, 0.050_614_27),
            (-0.398_333_24, 0.111_190_52),
            (-0.262_766_2, 0.156_853_32),
            (-0.091_717_32, 0.181_341_89),
            (0.091_717_32, 0.181_341_89),
            (0.262_766_2, 0.156_853_32),
            (0.398_333_24, 0.111_190_52),
            (0.480_144_93, 0.050_614_27),
        ],
    ),
];

/// Contribution of μ to the variance of edges, averaged over directions, px².
pub fn mean_variance(motion2: &Vector2<f64>) -> f64 {
    motion2.norm() / 24.0
}

/// Variance of μ, besides its own size, for this displacement from frame to frame, px⁴.
pub fn prior(moved_px: f64) -> f64 {
    moved_px.clamp(PRIOR_RANGE_PX.0, PRIOR_RANGE_PX.1).powi(4)
}

/// Limited so that it explains no more than this variance of edges.
pub fn clamped(motion2: &Vector2<f64>, mean_px2: f64) -> Vector2<f64> {
    motion2.cap_magnitude((24.0 * mean_px2).clamp(0.0, MAX_PX2))
}

/// m for μ, or its opposite.
pub fn from_square(motion2: &Vector2<f64>) -> Vector2<f64> {
    let (length, angle) = (motion2.norm().sqrt(), 0.5 * motion2.y.atan2(motion2.x));
    Vector2::new(angle.cos(), angle.sin()) * length
}

/// μ for m.
pub fn to_square(motion_px: &Vector2<f64>) -> Vector2<f64> {
    let (x, y) = (motion_px.x, motion_px.y);
    Vector2::new(x * x - y * y, 2.0 * x * y)
}

/// The part of μ that the linear terms represent: all of it, or nothing.
pub fn linear_part(motion2: &Vector2<f64>) -> Vector2<f64> {
    if is_linear(motion2) { *motion2 } else { Vector2::zeros() }
}

pub fn is_linear(motion2: &Vector2<f64>) -> bool {
    motion2.norm() <= LINEAR_PX2
}

/// Positions along m, with their shares of the exposure.
pub fn quadrature(motion2: &Vector2<f64>, blur_px: f64) -> &'static [(f32, f32)] {
    let blurs = motion2.norm().sqrt() / blur_px;
    let found = QUADRATURES.iter().find(|(limit, _)| blurs <= *limit);
    found.map_or(QUADRATURES[QUADRATURES.len() - 1].1, |(_, quadrature)| quadrature)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadratures_have_the_moments_of_a_box() {
        for (_, quadrature) in QUADRATURES {
            let moment = |power: i32| -> f64 {
                quadrature.iter().map(|(s, w)| f64::from(*w) * f64::from(*s).powi(power)).sum()
            };
            assert!((moment(0) - 1.0).abs() < 1e-6 && moment(1).abs() < 1e-7);
            assert!((moment(2) - 1.0 / 12.0).abs() < 1e-6);
            assert!(quadrature.len() == 2 || (moment(4) - 1.0 / 80.0).abs() < 1e-6);
        }
    }

    #[test]
    fn motion_and_square_are_inverse() {
        for i in 0..24 {
            let (sin, cos) = (f64::from(i) * 0.4).sin_cos();
            let motion_px = Vector2::new(cos, sin) * 1.7;
            let found = from_square(&to_square(&motion_px));
            assert!((found - motion_px).norm().min((found + motion_px).norm()) < 1e-12);
        }
    }
}
