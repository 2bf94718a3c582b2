//! A measurement's way into the filter, in two steps: what it would do, which tells how well it fits, and doing it.

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{
    Correction, Innovation, Kernel, Noise,
    block::{Block, Numbers},
    consider::ByClocks,
    innovation_covariance, invert_positive,
};
use roundel_vision::id::CameraId;

/// Powers of q by which the steady state's gains of value and rate grow.
const VALUE_ORDER: f64 = 0.25;
const RATE_ORDER: f64 = 0.5;

/// What is known of a measurement before it is taken in.
pub(in crate::track) struct Foreseen {
    /// Place of its camera among the sources.
    own: usize,
    /// M and N, and S, as if the clocks were known …
    value: Numbers,
    rate: Numbers,
    covariance: Matrix3<f64>,
    /// … and what they add.
    clocks: Option<ByClocks>,
    /// Of the whole of S.
    inverse: Matrix3<f64>,
    pub(in crate::track) innovation: Innovation,
}

impl Kernel {
    /// Takes in a measurement; gives the correction of the value. A measurement whose innovation
    /// has no positive definite covariance changes nothing and has an infinite distance.
    pub fn update(
        &mut self,
        residual: &Vector3<f64>,
        noise: &Noise,
        camera: CameraId,
        robust_distance_squared: f64,
    ) -> Correction {
        let taken = self.update_if(|_| true, residual, (noise, camera), robust_distance_squared);
        let nothing = Vector3::zeros();
        taken.unwrap_or_else(|| Correction {
            value: nothing,
            innovation: Innovation::none(),
            slope: nothing,
        })
    }

    /// The same if its innovation is good; `None`, and nothing is changed, if it is not or has no positive definite
    /// covariance.
    pub(in crate::track) fn update_if(
        &mut self,
        is_good: impl Fn(&Innovation) -> bool,
        residual: &Vector3<f64>,
        by: (&Noise, CameraId),
        robust_distance_squared: f64,
    ) -> Option<Correction> {
        dispatch!(Level::new(), simd => {
            self.update_if_with(simd, &is_good, residual, by, robust_distance_squared)
        })
    }

    #[simd]
    fn update_if_with<S: Simd, F: Fn(&Innovation) -> bool>(
        &mut self,
        simd: S,
        is_good: &F,
        residual: &Vector3<f64>,
        (noise, camera): (&Noise, CameraId),
        robust_distance_squared: f64,
    ) -> Option<Correction> {
        let foreseen = self.foreseen(simd, residual, (noise, camera))?;
        if !is_good(&foreseen.innovation) {
            return None;
        }
        Some(self.corrected(simd, residual, (noise, &foreseen), robust_distance_squared))
    }

    /// What a measurement would do: all of [`Self::update`] that is needed to tell how well it fits. `None` if the
    /// innovation's covariance is not positive definite.
    pub(in crate::track) fn foresee(
        &mut self,
        residual: &Vector3<f64>,
        noise: &Noise,
        camera: CameraId,
    ) -> Option<Foreseen> {
        dispatch!(Level::new(), simd => self.foresee_with(simd, residual, (noise, camera)))
    }

    #[simd]
    fn foresee_with<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        by: (&Noise, CameraId),
    ) -> Option<Foreseen> {
        self.foreseen(simd, residual, by)
    }

    /// Takes in the measurement that was foreseen last, or one foreseen since the last one was taken in.
    pub(in crate::track) fn correct(
        &mut self,
        residual: &Vector3<f64>,
        noise: &Noise,
        foreseen: &Foreseen,
        robust_distance_squared: f64,
    ) -> Correction {
        dispatch!(Level::new(), simd => {
            self.correct_with(simd, residual, (noise, foreseen), robust_distance_squared)
        })
    }

    #[simd]
    fn correct_with<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        by: (&Noise, &Foreseen),
        robust_distance_squared: f64,
    ) -> Correction {
        self.corrected(simd, residual, by, robust_distance_squared)
    }

    #[inline(always)]
    fn foreseen<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        (noise, camera): (&Noise, CameraId),
    ) -> Option<Foreseen> {
        let own = self.sources.find_or_new(camera);
        self.sources.set_timing(own, noise.timing_s);
        let (of_value, of_rate) = self.sources.with(simd, own);
        let root = &noise.systematic_root;
        let value = Block::of(simd, &self.spread.value).plus(of_value, root);
        let rate = Block::of_transposed(simd, &self.spread.cross).plus(of_rate, root);
        let mut covariance = innovation_covariance(&self.spread.value, &value.matrix(), noise);
        let mut whole = covariance;
        let mut clocks = None;
        if noise.timing_s > 0.0 {
            covariance += self.spread.rate * noise.timing_s.powi(2);
            let by_clocks = self.sources.clocks(simd, (own, noise.timing_s), &self.rate);
            whole = covariance + by_clocks.innovation;
            clocks = Some(by_clocks);
        }
        let (inverse, determinant) = invert_positive(&whole)?;
        let distance_squared = residual.dot(&(inverse * residual));
        Some(Foreseen {
            own,
            value: value.numbers(),
            rate: rate.numbers(),
            covariance,
            clocks,
            inverse,
            innovation: Innovation { distance_squared, determinant },
        })
    }

    #[inline(always)]
    fn corrected<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        (noise, foreseen): (&Noise, &Foreseen),
        robust_distance_squared: f64,
    ) -> Correction {
        let Foreseen { own, value, rate, covariance, clocks, inverse, innovation } = foreseen;
        let by = (*value, *rate);
        let given = (Block::of_numbers(simd, value), Block::of_numbers(simd, rate));
        let (mut value_cov, mut rate_cov) = given;
        if let Some(clocks) = clocks {
            value_cov = value_cov.sum(Block::of(simd, &clocks.value));
            rate_cov = rate_cov.sum(Block::of(simd, &clocks.rate));
        }
        let weighted = inverse * residual;
        let surprise = weighted.component_mul(&weighted) - inverse.diagonal();
        let slope = weighted.component_mul(&self.value_slope)
            + self.disturbed.value.component_mul(&surprise) * 0.5;
        let distance_squared = innovation.distance_squared;
        let weight = if distance_squared > robust_distance_squared {
            (robust_distance_squared / distance_squared).sqrt()
        } else {
            1.0
        };
        // Of K its negative is wanted.
        let value_gain = value_cov.times(inverse).scaled(-weight);
        let rate_gain = rate_cov.times(inverse).scaled(-weight);
        let gain = (value_gain.numbers(), rate_gain.numbers());
        if clocks.is_some() {
            self.add(simd, (value_gain, rate_gain), &by);
            let (value_cov, rate_cov) = given;
            let left =
                (value_cov.plus(value_gain, covariance), rate_cov.plus(rate_gain, covariance));
            self.add(simd, left, &gain);
        } else {
            let share = 2.0 - weight;
            self.add(simd, (value_gain.scaled(share), rate_gain.scaled(share)), &by);
        }
        make_symmetric(&mut self.spread.value);
        make_symmetric(&mut self.spread.rate);
        self.sources.correct(simd, *own, &gain, &noise.systematic_root, &self.rate);
        self.disturbed.update(&-diagonal(&gain.0), &-diagonal(&gain.1));
        let lag = self.value_slope;
        self.value_slope -= value_gain.times_vector(&(residual * VALUE_ORDER - lag));
        self.rate_slope -= rate_gain.times_vector(&(residual * RATE_ORDER - lag));
        self.rate -= rate_gain.times_vector(residual);
        Correction { value: -value_gain.times_vector(residual), innovation: *innovation, slope }
    }

    /// Adds to P the product of one with another transposed, each in parts of value and rate.
    #[inline(always)]
    fn add<S: Simd>(
        &mut self,
        simd: S,
        (value, rate): (Block<S>, Block<S>),
        (by_value, by_rate): &(Numbers, Numbers),
    ) {
        let spread = &mut self.spread;
        Block::of(simd, &spread.value).plus_by(value, by_value).write(&mut spread.value);
        Block::of(simd, &spread.cross).plus_by(value, by_rate).write(&mut spread.cross);
        Block::of(simd, &spread.rate).plus_by(rate, by_rate).write(&mut spread.rate);
    }
}

#[inline(always)]
fn diagonal(of: &Numbers) -> Vector3<f64> {
    Vector3::new(of[0][0], of[1][1], of[2][2])
}

#[inline(always)]
fn make_symmetric(matrix: &mut Matrix3<f64>) {
    for (row, column) in [(1, 0), (2, 0), (2, 1)] {
        let mean = 0.5 * (matrix[(row, column)] + matrix[(column, row)]);
        matrix[(row, column)] = mean;
        matrix[(column, row)] = mean;
    }
}
