//! Measurement update in two steps: compute the innovation, which shows how well the measurement fits, then apply it.

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{
    Correction, ErrorSource, Innovation, Kalman, Noise,
    block::{Block, Columns, StateBlocks, StateColumns},
    consider::ClockTerms,
    innovation_covariance, invert_positive,
};
use roundel_vision::id::CameraId;

/// Exponents of q in the steady state's gains of value and rate.
const VALUE_ORDER: f64 = 0.25;
const RATE_ORDER: f64 = 0.5;

/// Innovation and covariances of a measurement before its update.
pub(crate) struct PreparedUpdate {
    /// Place of its camera among the considered errors.
    own: usize,
    /// M and N for known clocks.
    cross: StateColumns,
    /// S for known clocks.
    covariance: Matrix3<f64>,
    /// Terms by clock errors.
    clocks: Option<ClockTerms>,
    /// Inverse of S with clock errors.
    inverse: Matrix3<f64>,
    pub(crate) innovation: Innovation,
}

impl Kalman {
    /// Adds a measurement; returns the correction of the value. A measurement whose innovation has no positive
    /// definite covariance changes nothing and has an infinite distance.
    pub fn update(
        &mut self,
        residual: &Vector3<f64>,
        noise: &Noise,
        camera: CameraId,
        robust_distance_squared: f64,
    ) -> Correction {
        let source = ErrorSource { noise, camera };
        let applied = self.update_if(|_| true, residual, source, robust_distance_squared);
        let nothing = Vector3::zeros();
        applied.unwrap_or_else(|| Correction {
            value: nothing,
            innovation: Innovation::invalid(),
            slope: nothing,
        })
    }

    /// The same if `is_good` accepts the innovation. `None`, and no change, if it does not or the covariance is
    /// not positive definite.
    pub(crate) fn update_if(
        &mut self,
        is_good: impl Fn(&Innovation) -> bool,
        residual: &Vector3<f64>,
        source: ErrorSource<'_>,
        robust_distance_squared: f64,
    ) -> Option<Correction> {
        dispatch!(Level::new(), simd => {
            self.update_if_with(simd, &is_good, residual, source, robust_distance_squared)
        })
    }

    #[simd]
    fn update_if_with<S: Simd, F: Fn(&Innovation) -> bool>(
        &mut self,
        simd: S,
        is_good: &F,
        residual: &Vector3<f64>,
        source: ErrorSource<'_>,
        robust_distance_squared: f64,
    ) -> Option<Correction> {
        let prepared = self.prepare(simd, residual, source)?;
        if !is_good(&prepared.innovation) {
            return None;
        }
        Some(self.apply(simd, residual, source.noise, &prepared, robust_distance_squared))
    }

    /// Computes the part of [`Self::update`] that shows how well a measurement fits. `None` if the innovation's
    /// covariance is not positive definite.
    pub(crate) fn prepare_update(
        &mut self,
        residual: &Vector3<f64>,
        source: ErrorSource<'_>,
    ) -> Option<PreparedUpdate> {
        dispatch!(Level::new(), simd => self.prepare_with(simd, residual, source))
    }

    #[simd]
    fn prepare_with<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        source: ErrorSource<'_>,
    ) -> Option<PreparedUpdate> {
        self.prepare(simd, residual, source)
    }

    /// Applies an update prepared after the last applied one.
    pub(crate) fn correct(
        &mut self,
        residual: &Vector3<f64>,
        noise: &Noise,
        prepared: &PreparedUpdate,
        robust_distance_squared: f64,
    ) -> Correction {
        dispatch!(Level::new(), simd => {
            self.apply_with(simd, residual, noise, prepared, robust_distance_squared)
        })
    }

    #[simd]
    fn apply_with<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        noise: &Noise,
        prepared: &PreparedUpdate,
        robust_distance_squared: f64,
    ) -> Correction {
        self.apply(simd, residual, noise, prepared, robust_distance_squared)
    }

    #[inline(always)]
    fn prepare<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        ErrorSource { noise, camera }: ErrorSource<'_>,
    ) -> Option<PreparedUpdate> {
        let own = self.considered.find_or_insert(camera);
        self.considered.set_timing(own, noise.timing_s);
        let correlation = self.considered.correlation(simd, own);
        let root = &noise.systematic_root;
        let value =
            Block::from_matrix(simd, &self.covariance.value).add_product(correlation.value, root);
        let rate = Block::from_transposed(simd, &self.covariance.cross)
            .add_product(correlation.rate, root);
        let mut covariance = innovation_covariance(&self.covariance.value, &value.matrix(), noise);
        let mut whole = covariance;
        let mut clocks = None;
        if noise.timing_s > 0.0 {
            covariance += self.covariance.rate * noise.timing_s.powi(2);
            let clock_terms = self.considered.clocks(simd, own, noise.timing_s, &self.rate);
            whole = covariance + clock_terms.innovation;
            clocks = Some(clock_terms);
        }
        let (inverse, determinant) = invert_positive(&whole)?;
        let distance_squared = residual.dot(&(inverse * residual));
        Some(PreparedUpdate {
            own,
            cross: StateBlocks { value, rate }.to_columns(),
            covariance,
            clocks,
            inverse,
            innovation: Innovation { distance_squared, determinant },
        })
    }

    #[inline(always)]
    fn apply<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        noise: &Noise,
        prepared: &PreparedUpdate,
        robust_distance_squared: f64,
    ) -> Correction {
        let PreparedUpdate { own, cross, covariance, clocks, inverse, innovation } = prepared;
        let clockless = StateBlocks::from_columns(simd, cross);
        let StateBlocks { value: mut value_cov, rate: mut rate_cov } = clockless;
        if let Some(clocks) = clocks {
            value_cov = value_cov.add(Block::from_matrix(simd, &clocks.value));
            rate_cov = rate_cov.add(Block::from_matrix(simd, &clocks.rate));
        }
        let weighted = inverse * residual;
        let excess = weighted.component_mul(&weighted) - inverse.diagonal();
        let slope = weighted.component_mul(&self.value_slope)
            + self.process_noise.value.component_mul(&excess) * 0.5;
        let distance_squared = innovation.distance_squared;
        let weight = if distance_squared > robust_distance_squared {
            (robust_distance_squared / distance_squared).sqrt()
        } else {
            1.0
        };
        // The update needs the negative gain.
        let gain_blocks = StateBlocks {
            value: value_cov.times(inverse).scaled(-weight),
            rate: rate_cov.times(inverse).scaled(-weight),
        };
        let StateBlocks { value: value_gain, rate: rate_gain } = gain_blocks;
        let gain = gain_blocks.to_columns();
        if clocks.is_some() {
            self.add(simd, gain_blocks, cross);
            let left = StateBlocks {
                value: clockless.value.add_product(value_gain, covariance),
                rate: clockless.rate.add_product(rate_gain, covariance),
            };
            self.add(simd, left, &gain);
        } else {
            self.add(simd, gain_blocks.scaled(2.0 - weight), cross);
        }
        make_symmetric(&mut self.covariance.value);
        make_symmetric(&mut self.covariance.rate);
        self.considered.correct(simd, *own, &gain, &noise.systematic_root, &self.rate);
        self.process_noise.update(&-diagonal(&gain.value), &-diagonal(&gain.rate));
        let lag = self.value_slope;
        self.value_slope -= value_gain.times_vector(&(residual * VALUE_ORDER - lag));
        self.rate_slope -= rate_gain.times_vector(&(residual * RATE_ORDER - lag));
        self.rate -= rate_gain.times_vector(residual);
        Correction { value: -value_gain.times_vector(residual), innovation: *innovation, slope }
    }

    /// Adds the product of one block column with another's transpose to P, in parts of value and rate.
    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, left: StateBlocks<S>, right: &StateColumns) {
        let covariance = &mut self.covariance;
        Block::from_matrix(simd, &covariance.value)
            .add_product_with_array(left.value, &right.value)
            .write(&mut covariance.value);
        Block::from_matrix(simd, &covariance.cross)
            .add_product_with_array(left.value, &right.rate)
            .write(&mut covariance.cross);
        Block::from_matrix(simd, &covariance.rate)
            .add_product_with_array(left.rate, &right.rate)
            .write(&mut covariance.rate);
    }
}

#[inline(always)]
fn diagonal(columns: &Columns) -> Vector3<f64> {
    Vector3::new(columns[0][0], columns[1][1], columns[2][2])
}

#[inline(always)]
fn make_symmetric(matrix: &mut Matrix3<f64>) {
    for (row, column) in [(1, 0), (2, 0), (2, 1)] {
        let mean = 0.5 * (matrix[(row, column)] + matrix[(column, row)]);
        matrix[(row, column)] = mean;
        matrix[(column, row)] = mean;
    }
}
