//! A straight edge under a Gaussian blur: what of it lies beyond a cut parallel to it.

/// Variance that a cut through pixels adds to an edge: 1/12 along u, nothing along v.
const CUT_SPREAD_PX2: f64 = 1.0 / 24.0;

/// ∫ Φ(-x/σ) dx from `distance_px` to infinity: how far a blur of the deviation σ moves an edge's
/// light past a cut at this distance, pixels. With z = distance/σ that is σ (φ(z) - z Φ(-z)).
/// Sharing a pixel between the sides of the cut blurs it once more, by the pixel's width along u.
pub(crate) fn moved_px(distance_px: f64, blur_px: f64) -> f64 {
    let blur_px = (blur_px * blur_px + CUT_SPREAD_PX2).sqrt();
    if distance_px > 6.0 * blur_px {
        return 0.0;
    }
    let z = distance_px / blur_px;
    let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    (blur_px * (density - z * upper_tail(z))).max(0.0)
}

/// ∫ x Φ(-x/σ) dx from `distance_px` to infinity over σ²: the share of an edge's spread, of which each
/// side holds 1/4, that lies beyond a cut at this distance.
pub(crate) fn spread_beyond(distance_px: f64, blur_px: f64) -> f64 {
    let z = distance_px / blur_px;
    let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    0.5 * ((1.0 - z * z) * upper_tail(z) + z * density).max(0.0)
}

/// Φ(-z), to 1e-5 (Abramowitz and Stegun, 26.2.16).
fn upper_tail(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.33267 * z.abs());
    let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    let tail = density * t * (0.436_183_6 + t * (-0.120_167_6 + t * 0.937_298_0));
    if z < 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Σ of `value` over the half line from `from`, by the midpoint rule.
    fn integral(from: f64, value: impl Fn(f64) -> f64) -> f64 {
        (0..20_000).map(|i| value(from + (f64::from(i) + 0.5) * 5e-4) * 5e-4).sum()
    }

    #[test]
    fn closed_forms_equal_their_integrals() {
        let blur_px = 0.8f64;
        let cut_px = (blur_px * blur_px + CUT_SPREAD_PX2).sqrt();
        for distance_px in [-0.5, 0.0, 0.4, 1.3, 2.5] {
            let moved = integral(distance_px, |x| upper_tail(x / cut_px));
            assert!((moved_px(distance_px, blur_px) - moved).abs() < 1e-4, "{distance_px}");
        }
        for distance_px in [0.0, 0.4, 1.3, 2.5] {
            let spread = integral(distance_px, |x| x * upper_tail(x / blur_px)) / blur_px.powi(2);
            assert!((spread_beyond(distance_px, blur_px) - spread).abs() < 1e-4, "{distance_px}");
        }
        assert!((spread_beyond(0.0, 1.0) - 0.25).abs() < 1e-4);
        assert!((upper_tail(1.0) - 0.158_655).abs() < 2e-5);
        assert_eq!(moved_px(9.0, 1.0), 0.0);
    }
}
