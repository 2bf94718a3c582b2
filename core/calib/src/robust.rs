//! Robust scale and loss for residuals with outliers.

/// Residuals beyond this number of deviations enter linearly, and finally are rejected.
pub(crate) const HUBER: f64 = 2.5;
pub(crate) const OUTLIER: f64 = 5.0;
/// Median of the Rayleigh distribution, in deviations of one coordinate.
const RAYLEIGH: f64 = 1.1774;

/// Huber's loss (1964): quadratic up to the limit, then linear.
pub(crate) fn huber(error: f64, limit: f64) -> f64 {
    if error <= limit { error * error } else { limit * (2.0 * error - limit) }
}

/// Standard deviation of one coordinate from the median of two-dimensional distances; `None` if there are none.
pub(crate) fn deviation(distances: &mut [f64]) -> Option<f64> {
    Some(median(distances)? / RAYLEIGH)
}

/// Upper median; `None` if empty.
pub(crate) fn median(numbers: &mut [f64]) -> Option<f64> {
    if numbers.is_empty() {
        return None;
    }
    let middle = numbers.len() / 2;
    Some(*numbers.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outliers_do_not_increase_the_deviation() {
        // Quantiles of the Rayleigh distribution with deviation 2, and a tenth of outliers.
        let quantile = |share: f64| 2.0 * (-2.0 * (1.0 - share).ln()).sqrt();
        let mut distances: Vec<f64> =
            (0..900).map(|i| quantile((f64::from(i) + 0.5) / 900.0)).collect();
        distances.extend([1e6; 100]);
        let found = deviation(&mut distances).unwrap();
        assert!((2.0..2.3).contains(&found), "{found}");
        assert_eq!(deviation(&mut []), None);
    }

    #[test]
    fn huber_loss_continues_with_its_tangent() {
        assert_eq!(huber(2.0, 2.5), 4.0);
        let (limit, step) = (2.5, 1e-6);
        assert!(
            (huber(limit + step, limit) - huber(limit, limit) - 2.0 * limit * step).abs() < 1e-11
        );
        assert_eq!(huber(10.0, limit) - huber(9.0, limit), 2.0 * limit);
    }
}
