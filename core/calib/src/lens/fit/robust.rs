//! Errors among which some are others': how large they are in truth, and how those beyond count.

/// Errors beyond this many deviations count linearly, and are left out at last.
pub(crate) const HUBER: f64 = 2.5;
pub(crate) const OUTLIER: f64 = 5.0;
/// Rayleigh's median, in deviations.
const RAYLEIGH: f64 = 1.1774;

/// Half of a square grows linearly beyond the limit (Huber 1964).
pub(crate) fn huber(error: f64, limit: f64) -> f64 {
    if error <= limit { error * error } else { limit * (2.0 * error - limit) }
}

/// Deviation of one of two coordinates, by the median of the distances, which follow Rayleigh; `None` without any.
pub(crate) fn deviation(distances: &mut [f64]) -> Option<f64> {
    Some(median(distances)? / RAYLEIGH)
}

/// The upper one of two; `None` of nothing.
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
    fn a_few_that_are_far_off_do_not_widen_the_deviation() {
        // Quantiles of Rayleigh's distribution with deviation 2, and a tenth of nonsense.
        let quantile = |share: f64| 2.0 * (-2.0 * (1.0 - share).ln()).sqrt();
        let mut distances: Vec<f64> =
            (0..900).map(|i| quantile((f64::from(i) + 0.5) / 900.0)).collect();
        distances.extend([1e6; 100]);
        let found = deviation(&mut distances).unwrap();
        assert!((2.0..2.3).contains(&found), "{found}");
        assert_eq!(deviation(&mut []), None);
    }

    #[test]
    fn a_square_goes_on_as_its_tangent() {
        assert_eq!(huber(2.0, 2.5), 4.0);
        let (limit, step) = (2.5, 1e-6);
        assert!(
            (huber(limit + step, limit) - huber(limit, limit) - 2.0 * limit * step).abs() < 1e-11
        );
        assert_eq!(huber(10.0, limit) - huber(9.0, limit), 2.0 * limit);
    }
}
