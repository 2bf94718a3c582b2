//! Levenberg and Marquardt's steps (Levenberg 1944, Marquardt 1963), for whatever is refined.

/// Beyond this damping no step is short enough to help.
const MOST_DAMPING: f64 = 1e8;
const LEAST_DAMPING: f64 = 1e-12;

/// Unknowns with what they should explain. Errors beyond the limit, in whatever they are weighed in, count linearly.
pub(crate) trait Descent: Sized {
    /// Derivatives at the unknowns as they are.
    type Normal;
    const MOST_STEPS: usize;
    /// A step that lowers the cost by less than this share of it ends the descent.
    const SETTLED: f64;

    /// `None`: it is no camera.
    fn cost(&self, limit: f64) -> Option<f64>;
    fn normal(&self, limit: f64) -> Option<Self::Normal>;
    /// One step away; `None` if it cannot be computed.
    fn stepped(&self, normal: &Self::Normal, damping: f64) -> Option<Self>;
}

/// Steps until nothing is gained; `None`: it does not begin at a camera.
pub(crate) fn descend<T: Descent>(state: &mut T, limit: f64) -> Option<()> {
    let mut damping = 1e-3;
    let mut cost = state.cost(limit)?;
    for _ in 0..T::MOST_STEPS {
        let normal = state.normal(limit)?;
        let mut is_done = true;
        while damping < MOST_DAMPING {
            let stepped = state.stepped(&normal, damping);
            let stepped_cost = stepped.as_ref().and_then(|it| it.cost(limit));
            if let (Some(stepped), Some(stepped_cost)) = (stepped, stepped_cost)
                && stepped_cost <= cost
            {
                is_done = cost - stepped_cost <= T::SETTLED * cost;
                *state = stepped;
                cost = stepped_cost;
                damping = (damping * 0.1).max(LEAST_DAMPING);
                break;
            }
            damping *= 10.0;
        }
        if is_done {
            break;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley, from the far side of which the plain step leads astray.
    struct Valley(f64, f64);

    impl Descent for Valley {
        type Normal = ([[f64; 2]; 2], [f64; 2]);
        const MOST_STEPS: usize = 60;
        const SETTLED: f64 = 1e-12;

        fn cost(&self, _: f64) -> Option<f64> {
            Some((10.0 * (self.1 - self.0 * self.0)).powi(2) + (1.0 - self.0).powi(2))
        }

        fn normal(&self, _: f64) -> Option<Self::Normal> {
            let (x, across, along) = (self.0, 10.0 * (self.1 - self.0 * self.0), 1.0 - self.0);
            let information = [[400.0 * x * x + 1.0, -200.0 * x], [-200.0 * x, 100.0]];
            Some((information, [20.0 * x * across + along, -10.0 * across]))
        }

        fn stepped(&self, (a, g): &Self::Normal, damping: f64) -> Option<Self> {
            let (p, q, r) = (a[0][0] * (1.0 + damping), a[0][1], a[1][1] * (1.0 + damping));
            let determinant = p * r - q * q;
            let (by_x, by_y) = (r * g[0] - q * g[1], p * g[1] - q * g[0]);
            Some(Self(self.0 + by_x / determinant, self.1 + by_y / determinant))
        }
    }

    #[test]
    fn a_bent_valley_is_followed_to_its_end() {
        let mut valley = Valley(-1.2, 1.0);
        descend(&mut valley, f64::MAX).unwrap();
        assert!((valley.0 - 1.0).abs() < 1e-6 && (valley.1 - 1.0).abs() < 1e-6, "{}", valley.0);
    }
}
