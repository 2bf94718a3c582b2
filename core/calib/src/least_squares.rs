//! Damped least squares (Levenberg 1944, Marquardt 1963), shared by all adjustments of this crate.
//!
//! A problem provides its cost, its normal equations and the state after a step that solves them with the diagonal
//! multiplied by 1 + damping. The damping falls by ten after each accepted step and rises by ten after each rejected one.

use nalgebra::{
    DMatrix, DVector, DefaultAllocator, Dim, Matrix2xX, OMatrix, Vector2, allocator::Allocator,
};

/// A state of unknowns with residuals.
pub(crate) trait LeastSquares: Sized {
    type Normal;

    /// Sum of squares, robust beyond `limit`; `None` if the state is invalid.
    fn cost(&self, limit: f64) -> Option<f64>;
    fn normal(&self, limit: f64) -> Option<Self::Normal>;
    /// The state after a damped step; `None` if the equations cannot be solved.
    fn stepped(&self, normal: &Self::Normal, damping: f64) -> Option<Self>;
}

/// Current damping and its limits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Damping {
    pub(crate) value: f64,
    pub(crate) min: f64,
    pub(crate) max: f64,
}

impl Damping {
    /// Takes a step that does not increase `cost`. Returns the new cost, `Some(None)` if there is no such step, and
    /// `None` if the state has no normal equations.
    pub(crate) fn step<T: LeastSquares>(
        &mut self,
        state: &mut T,
        limit: f64,
        cost: f64,
    ) -> Option<Option<f64>> {
        let normal = state.normal(limit)?;
        while self.value < self.max {
            let stepped = state.stepped(&normal, self.value);
            let stepped_cost = stepped.as_ref().and_then(|it| it.cost(limit));
            if let (Some(stepped), Some(stepped_cost)) = (stepped, stepped_cost)
                && stepped_cost <= cost
            {
                *state = stepped;
                self.value = (self.value * 0.1).max(self.min);
                return Some(Some(stepped_cost));
            }
            self.value *= 10.0;
        }
        Some(None)
    }
}

/// Takes up to `max_steps` steps, until one lowers the cost by less than the share `tolerance`. Returns `None` if the
/// initial state is invalid.
pub(crate) fn minimize<T: LeastSquares>(
    state: &mut T,
    limit: f64,
    max_steps: usize,
    tolerance: f64,
) -> Option<()> {
    let mut damping = Damping { value: 1e-3, min: 1e-12, max: 1e8 };
    let mut cost = state.cost(limit)?;
    for _ in 0..max_steps {
        let Some(lower) = damping.step(state, limit, cost)? else { break };
        let is_converged = cost - lower <= tolerance * cost;
        cost = lower;
        if is_converged {
            break;
        }
    }
    Some(())
}

/// Information matrix and negative gradient over all unknowns.
#[derive(Clone, Debug)]
pub(crate) struct NormalEquations {
    pub(crate) information: DMatrix<f64>,
    pub(crate) gradient: DVector<f64>,
}

impl NormalEquations {
    pub(crate) fn zeros(size: usize) -> Self {
        Self { information: DMatrix::zeros(size, size), gradient: DVector::zeros(size) }
    }

    /// Adds a weighted residual with its derivatives.
    pub(crate) fn add(&mut self, slopes: &Matrix2xX<f64>, error: &Vector2<f64>) {
        self.information += slopes.transpose() * slopes;
        self.gradient -= slopes.transpose() * error;
    }

    /// Damped step; `None` if an unknown is undetermined.
    pub(crate) fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let step = damped(self.information.clone(), damping).cholesky()?.solve(&self.gradient);
        step.iter().all(|value| value.is_finite()).then_some(step)
    }
}

/// Multiplies the diagonal by 1 + damping.
pub(crate) fn damped<D: Dim>(
    mut information: OMatrix<f64, D, D>,
    damping: f64,
) -> OMatrix<f64, D, D>
where
    DefaultAllocator: Allocator<D, D>,
{
    for index in 0..information.nrows() {
        information[(index, index)] *= 1.0 + damping;
    }
    information
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley, started on the side where undamped steps diverge.
    struct Valley(f64, f64);

    impl LeastSquares for Valley {
        type Normal = NormalEquations;

        fn cost(&self, _: f64) -> Option<f64> {
            Some((10.0 * (self.1 - self.0 * self.0)).powi(2) + (1.0 - self.0).powi(2))
        }

        fn normal(&self, _: f64) -> Option<Self::Normal> {
            let (x, across, along) = (self.0, 10.0 * (self.1 - self.0 * self.0), 1.0 - self.0);
            let information = [400.0 * x * x + 1.0, -200.0 * x, -200.0 * x, 100.0];
            let gradient = [20.0 * x * across + along, -10.0 * across];
            Some(NormalEquations {
                information: DMatrix::from_row_slice(2, 2, &information),
                gradient: DVector::from_row_slice(&gradient),
            })
        }

        fn stepped(&self, normal: &NormalEquations, damping: f64) -> Option<Self> {
            let step = normal.step(damping)?;
            Some(Self(self.0 + step[0], self.1 + step[1]))
        }
    }

    #[test]
    fn a_curved_valley_is_followed_to_its_minimum() {
        let mut valley = Valley(-1.2, 1.0);
        minimize(&mut valley, f64::MAX, 60, 1e-12).unwrap();
        assert!((valley.0 - 1.0).abs() < 1e-6 && (valley.1 - 1.0).abs() < 1e-6, "{}", valley.0);
    }
}
