//! A constant-velocity Kalman filter for a value in three dimensions and its rate, that knows that
//! part of each camera's error is the same from frame to frame.
//!
//! A measurement of camera c is z = p + L β_c + w: the noise w is fresh each time, the systematic
//! part L β_c is not. β_c (three numbers of unit variance) forgets itself with a time constant τ, so
//! averaging a thousand frames of one camera does not average it away, while a second camera, with
//! its own β, does help. β is not estimated but considered (Schmidt, *Application of state-space
//! methods to navigation problems*, 1966): its correlation with the state is carried along, and the
//! gain takes it into account.
//!
//! With x = (p, v), P = [A B; Bᵀ D] and C_c = E[x̃ β_cᵀ] = [Cp; Cv]:
//!
//! - predict: P ← F P Fᵀ + Q, C ← ρ F C, ρ = exp(-dt/τ);
//! - update by camera c: M = A + Cp Lᵀ, N = Bᵀ + Cv Lᵀ (covariances of p̃ and ṽ with the
//!   innovation), S = A + Cp Lᵀ + L Cpᵀ + R, K = [M; N] S⁻¹, P ← P - K S Kᵀ,
//!   C_j ← C_j - K (Cp_j + [j = c] L).
//!
//! A camera's clock may be off: what it stamps t was seen at t - ε, so that z = p - v ε. ε (a deviation
//! σ, the measurement's `timing_s`) is the same for all that the camera sees and forgets nothing; it is
//! considered as well, but apart, since what is known of it grows. P is what would be if the clocks were
//! known, and q_c = ∂x̃/∂ε_c, the state's error by each camera's ε, is carried along:
//!
//! - predict: q ← F q;
//! - update: with u_j = qp_j - [j = c] v, the innovation's error by ε_j, q_j ← q_j - K u_j; the gain is
//!   that of M + Σ σ_j² qp_j u_jᵀ, N + Σ σ_j² qv_j u_jᵀ and S + Σ σ_j² u_j u_jᵀ + σ_c² D (v itself is
//!   known with the covariance D), and P ← P - K Mᵀ - M Kᵀ + K (S + σ_c² D) Kᵀ, as for any gain.
//!
//! What is told is P + Σ σ_j² q_j q_jᵀ ([`Kernel::told`]).
//!
//! An innovation longer than the robust limit k (Mahalanobis) is held back with Huber's weight
//! w = k/d; the covariance is then that of the gain w K: P ← P - (2w - w²) K S Kᵀ.
//!
//! P stays positive definite: S ≥ R, R has a floor and P a ceiling (see `world::params`), so that
//! the subtraction keeps more than six digits; a property test drives it through the extremes.

use nalgebra::{Matrix3, Matrix6, Vector3};

use super::MotionModel;
use crate::id::CameraId;

/// Cameras whose systematic error is carried at most; the one not heard of longest gives way.
pub const MAX_SOURCES: usize = 8;

/// Sources whose correlation has decayed below exp(-this) are let go.
const FORGOTTEN_TIMES: f64 = 6.0;

/// A measurement's error: everything, and the root of the part that stays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Covariance R of the whole error.
    pub total: Matrix3<f64>,
    /// L with L Lᵀ the covariance of the systematic part; zero where nothing is systematic.
    pub systematic_root: Matrix3<f64>,
    /// Deviation of the camera's clock from the others', seconds; comes on top of `total`.
    pub timing_s: f64,
}

/// A camera's systematic error and the state, E[x̃ βᵀ], and its clock's error and the state, q.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Source {
    camera: CameraId,
    age_s: f64,
    value: Matrix3<f64>,
    rate: Matrix3<f64>,
    value_by_clock: Vector3<f64>,
    rate_by_clock: Vector3<f64>,
    /// σ.
    timing_s: f64,
}

const NO_SOURCE: Source = Source {
    camera: CameraId(u32::MAX),
    age_s: 0.0,
    value: Matrix3::new(0., 0., 0., 0., 0., 0., 0., 0., 0.),
    rate: Matrix3::new(0., 0., 0., 0., 0., 0., 0., 0., 0.),
    value_by_clock: Vector3::new(0., 0., 0.),
    rate_by_clock: Vector3::new(0., 0., 0.),
    timing_s: 0.0,
};

impl Source {
    /// What the clock's error adds to an innovation, each second; `own` the rate if it is the clock of
    /// the measurement's camera.
    fn by_clock(&self, own: Option<&Vector3<f64>>) -> Vector3<f64> {
        own.map_or(self.value_by_clock, |rate| self.value_by_clock - rate)
    }

    /// `dt` seconds later, of which the systematic error keeps this share.
    fn predicted(&self, dt: f64, kept: f64) -> Self {
        Self {
            camera: self.camera,
            age_s: self.age_s + dt.abs(),
            value: (self.value + self.rate * dt) * kept,
            rate: self.rate * kept,
            value_by_clock: self.value_by_clock + self.rate_by_clock * dt,
            rate_by_clock: self.rate_by_clock,
            timing_s: self.timing_s,
        }
    }
}

/// Covariance over (value, rate) in blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Of the value: A.
    pub value: Matrix3<f64>,
    /// Between value (rows) and rate (columns): B.
    pub cross: Matrix3<f64>,
    /// Of the rate: D.
    pub rate: Matrix3<f64>,
}

impl Spread {
    /// F P Fᵀ + Q over `dt` seconds (either sign; the noise grows with |dt|), with the noise's
    /// density along each axis.
    pub fn predict(&mut self, dt: f64, density: &Vector3<f64>) {
        let span = dt.abs();
        let sum = self.cross + self.cross.transpose();
        self.value += sum * dt + self.rate * (dt * dt);
        self.cross += self.rate * dt;
        for axis in 0..3 {
            let q = density[axis];
            self.value[(axis, axis)] += q * span * span * span / 3.0;
            self.cross[(axis, axis)] += q * dt * span / 2.0;
            self.rate[(axis, axis)] += q * span;
        }
    }

    /// The whole 6×6.
    pub fn matrix(&self) -> Matrix6<f64> {
        let mut whole = Matrix6::zeros();
        whole.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.value);
        whole.fixed_view_mut::<3, 3>(0, 3).copy_from(&self.cross);
        whole.fixed_view_mut::<3, 3>(3, 0).copy_from(&self.cross.transpose());
        whole.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rate);
        whole
    }

    /// The blocks of a symmetric 6×6.
    pub fn from_matrix(whole: &Matrix6<f64>) -> Self {
        Self {
            value: whole.fixed_view::<3, 3>(0, 0).into_owned(),
            cross: whole.fixed_view::<3, 3>(0, 3).into_owned(),
            rate: whole.fixed_view::<3, 3>(3, 3).into_owned(),
        }
    }
}

/// How far a measurement lies from what was predicted. No logarithms here: who compares two takes
/// one of their ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// Squared Mahalanobis length.
    pub distance_squared: f64,
    /// det S.
    pub determinant: f64,
    /// Of each component given the two others: squared length over variance, (Λν)ᵢ²/Λᵢᵢ, Λ = S⁻¹.
    pub conditional_squared: Vector3<f64>,
    /// And the reciprocal of that variance, Λᵢᵢ.
    pub conditional_precision: Vector3<f64>,
}

impl Innovation {
    fn new(
        residual: &Vector3<f64>,
        weighted: &Vector3<f64>,
        inverse: &Matrix3<f64>,
        determinant: f64,
    ) -> Self {
        let precision = inverse.diagonal();
        Self {
            distance_squared: residual.dot(weighted),
            determinant,
            conditional_squared: weighted.component_mul(weighted).component_div(&precision),
            conditional_precision: precision,
        }
    }

    /// ln det S.
    pub fn log_det(&self) -> f64 {
        self.determinant.ln()
    }
}

/// Covariances of the errors of value and rate with an innovation, M and N, and of that, S.
#[derive(Clone, Copy)]
struct Joint {
    value: Matrix3<f64>,
    rate: Matrix3<f64>,
    innovation: Matrix3<f64>,
}

impl Joint {
    /// As if the clocks were known.
    #[inline]
    fn of(spread: &Spread, source: Option<&Source>, noise: &Noise) -> Self {
        let mut joint = Self {
            value: spread.value,
            rate: spread.cross.transpose(),
            innovation: spread.value + noise.total,
        };
        if let Some(source) = source {
            let root_transposed = noise.systematic_root.transpose();
            let shared = source.value * root_transposed;
            joint.value += shared;
            joint.rate += source.rate * root_transposed;
            joint.innovation += shared + shared.transpose();
        }
        if noise.timing_s > 0.0 {
            joint.innovation += spread.rate * noise.timing_s.powi(2);
        }
        joint
    }

    /// With what a clock may add: `own` the rate if it is that of the measurement's camera.
    #[inline]
    fn add_clock(&mut self, source: &Source, timing_s: f64, own: Option<&Vector3<f64>>) {
        let by_clock = source.by_clock(own);
        let weighted = by_clock.transpose() * (timing_s * timing_s);
        self.value += source.value_by_clock * weighted;
        self.rate += source.rate_by_clock * weighted;
        self.innovation += by_clock * weighted;
    }

    /// With what all clocks may add, that of the measurement's camera among them.
    #[inline]
    fn add_clocks(
        &mut self,
        sources: impl Iterator<Item = Source>,
        rate: &Vector3<f64>,
        (camera, timing_s): (CameraId, f64),
    ) {
        let mut known = false;
        for source in sources {
            let own = source.camera == camera;
            known |= own;
            let timing_s = if own { timing_s } else { source.timing_s };
            self.add_clock(&source, timing_s, own.then_some(rate));
        }
        if !known {
            self.add_clock(&NO_SOURCE, timing_s, Some(rate));
        }
    }

    fn innovation(&self, residual: &Vector3<f64>) -> Option<Innovation> {
        let (inverse, determinant) = invert_positive(&self.innovation)?;
        Some(Innovation::new(residual, &(inverse * residual), &inverse, determinant))
    }
}

/// Rate, covariance and systematic correlations; the value itself lies with the caller, who knows
/// whether it is a vector or a rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// Rate of the value, per second.
    pub rate: Vector3<f64>,
    /// Covariance.
    pub spread: Spread,
    sources: [Source; MAX_SOURCES],
    len: usize,
}

impl Kernel {
    /// After one measurement of the value, with a rate of which only the variance is known.
    pub fn begin(noise: &Noise, camera: CameraId, rate_variance: f64) -> Self {
        let mut kernel = Self {
            rate: Vector3::zeros(),
            spread: Spread {
                // The rate is not known yet, and neither is what the clock's error does.
                value: noise.total
                    + Matrix3::from_diagonal_element(rate_variance * noise.timing_s.powi(2)),
                cross: Matrix3::zeros(),
                rate: Matrix3::from_diagonal_element(rate_variance),
            },
            sources: [NO_SOURCE; MAX_SOURCES],
            len: 1,
        };
        kernel.sources[0] = Source { camera, value: noise.systematic_root, ..NO_SOURCE };
        kernel
    }

    /// Moves the covariance on by `dt` seconds; the caller moves the value by `rate` · dt.
    pub fn predict(&mut self, dt: f64, density: &Vector3<f64>, systematic_time_s: f64) {
        self.spread.predict(dt, density);
        let kept = (-dt.abs() / systematic_time_s).exp();
        let mut live = 0;
        for index in 0..self.len {
            let source = self.sources[index].predicted(dt, kept);
            if source.age_s > FORGOTTEN_TIMES * systematic_time_s {
                continue;
            }
            self.sources[live] = source;
            live += 1;
        }
        self.len = live;
    }

    /// How far `residual` (measured less predicted value) would be from zero, `dt` seconds from
    /// now. `None` if the innovation's covariance is not positive definite.
    pub fn innovation_after(
        &self,
        dt: f64,
        model: &MotionModel,
        residual: &Vector3<f64>,
        (noise, camera): (&Noise, CameraId),
    ) -> Option<Innovation> {
        let mut spread = self.spread;
        spread.predict(dt, &model.acceleration_density());
        let kept = (-dt.abs() / model.systematic_time_s).exp();
        let own = self.source(camera);
        let source = own.map(|index| self.sources[index].predicted(dt, kept));
        let mut joint = Joint::of(&spread, source.as_ref(), noise);
        if noise.timing_s > 0.0 {
            let sources = self.sources[..self.len].iter().map(|source| source.predicted(dt, 1.0));
            joint.add_clocks(sources, &self.rate, (camera, noise.timing_s));
        }
        joint.innovation(residual)
    }

    /// How far `residual` (measured less predicted value) is from zero, by a camera's noise.
    /// `None` if the innovation's covariance is not positive definite.
    pub fn innovation(
        &self,
        residual: &Vector3<f64>,
        noise: &Noise,
        camera: CameraId,
    ) -> Option<Innovation> {
        self.joint(camera, noise).1.innovation(residual)
    }

    /// The covariance with what the clocks may add.
    pub fn told(&self) -> Spread {
        let mut spread = self.spread;
        for source in self.sources[..self.len].iter().filter(|source| source.timing_s > 0.0) {
            let square = source.timing_s * source.timing_s;
            let weighted = source.value_by_clock.transpose() * square;
            spread.value += source.value_by_clock * weighted;
            spread.cross += source.value_by_clock * source.rate_by_clock.transpose() * square;
            spread.rate += source.rate_by_clock * source.rate_by_clock.transpose() * square;
        }
        spread
    }

    /// As if the clocks were known, and with what they may add.
    fn joint(&self, camera: CameraId, noise: &Noise) -> (Joint, Joint) {
        let source = self.source(camera).map(|index| &self.sources[index]);
        let joint = Joint::of(&self.spread, source, noise);
        if noise.timing_s <= 0.0 {
            return (joint, joint);
        }
        let mut whole = joint;
        let sources = self.sources[..self.len].iter().copied();
        whole.add_clocks(sources, &self.rate, (camera, noise.timing_s));
        (joint, whole)
    }

    /// Takes in a measurement; gives the correction of the value. A measurement whose innovation
    /// has no positive definite covariance changes nothing and has an infinite distance.
    pub fn update(
        &mut self,
        residual: &Vector3<f64>,
        noise: &Noise,
        camera: CameraId,
        robust_distance_squared: f64,
    ) -> (Vector3<f64>, Innovation) {
        let own = self.source_or_new(camera);
        self.sources[own].timing_s = noise.timing_s;
        let (given, whole) = self.joint(camera, noise);
        let Joint { value: value_cov, rate: rate_cov, innovation: covariance } = whole;
        let Some((inverse, determinant)) = invert_positive(&covariance) else {
            let nothing = Innovation {
                distance_squared: f64::INFINITY,
                determinant: 1.0,
                conditional_squared: Vector3::zeros(),
                conditional_precision: Vector3::repeat(1.0),
            };
            return (Vector3::zeros(), nothing);
        };
        let weighted = inverse * residual;
        let innovation = Innovation::new(residual, &weighted, &inverse, determinant);
        let distance_squared = innovation.distance_squared;
        let weight = if distance_squared > robust_distance_squared {
            (robust_distance_squared / distance_squared).sqrt()
        } else {
            1.0
        };
        let value_gain = value_cov * inverse;
        let rate_gain = rate_cov * inverse;
        if noise.timing_s > 0.0 {
            self.shrink_by_any(&given, &(value_gain * weight), &(rate_gain * weight));
        } else {
            let share = 2.0 * weight - weight * weight;
            let spread = &mut self.spread;
            spread.value = symmetric(spread.value - value_gain * value_cov.transpose() * share);
            spread.cross -= value_gain * rate_cov.transpose() * share;
            spread.rate = symmetric(spread.rate - rate_gain * rate_cov.transpose() * share);
        }
        let rate = self.rate;
        for (index, source) in self.sources[..self.len].iter_mut().enumerate() {
            let mut with_innovation = source.value;
            let mut by_clock = source.value_by_clock;
            if index == own {
                with_innovation += noise.systematic_root;
                by_clock -= rate;
                source.age_s = 0.0;
            }
            with_innovation *= weight;
            by_clock *= weight;
            source.value -= value_gain * with_innovation;
            source.rate -= rate_gain * with_innovation;
            source.value_by_clock -= value_gain * by_clock;
            source.rate_by_clock -= rate_gain * by_clock;
        }
        self.rate += rate_cov * weighted * weight;
        (value_cov * weighted * weight, innovation)
    }

    /// P after an update with any gain.
    fn shrink_by_any(
        &mut self,
        given: &Joint,
        value_gain: &Matrix3<f64>,
        rate_gain: &Matrix3<f64>,
    ) {
        let spread = &mut self.spread;
        let of_value = value_gain * given.innovation;
        let of_rate = rate_gain * given.innovation;
        let value = value_gain * given.value.transpose();
        spread.value =
            symmetric(spread.value - value - value.transpose() + of_value * value_gain.transpose());
        spread.cross += of_value * rate_gain.transpose()
            - value_gain * given.rate.transpose()
            - given.value * rate_gain.transpose();
        let rate = rate_gain * given.rate.transpose();
        spread.rate =
            symmetric(spread.rate - rate - rate.transpose() + of_rate * rate_gain.transpose());
    }

    fn source(&self, camera: CameraId) -> Option<usize> {
        self.sources[..self.len].iter().position(|source| source.camera == camera)
    }

    fn source_or_new(&mut self, camera: CameraId) -> usize {
        if let Some(index) = self.source(camera) {
            return index;
        }
        let index = if self.len < MAX_SOURCES {
            self.len += 1;
            self.len - 1
        } else {
            let mut oldest = 0;
            for index in 1..MAX_SOURCES {
                if self.sources[index].age_s > self.sources[oldest].age_s {
                    oldest = index;
                }
            }
            oldest
        };
        self.sources[index] = Source { camera, ..NO_SOURCE };
        index
    }
}

fn symmetric(matrix: Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}

/// Lower Cholesky factor; `None` if the matrix is not positive definite (or not finite).
pub(crate) fn positive_root(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let positive = |value: f64| (value.is_finite() && value > 0.0).then(|| value.sqrt());
    let l00 = positive(matrix[(0, 0)])?;
    let l10 = matrix[(1, 0)] / l00;
    let l20 = matrix[(2, 0)] / l00;
    let l11 = positive(matrix[(1, 1)] - l10 * l10)?;
    let l21 = (matrix[(2, 1)] - l20 * l10) / l11;
    let l22 = positive(matrix[(2, 2)] - l20 * l20 - l21 * l21)?;
    Some(Matrix3::new(l00, 0., 0., l10, l11, 0., l20, l21, l22))
}

/// Inverse and determinant of a symmetric positive definite matrix, by its Cholesky factor.
fn invert_positive(matrix: &Matrix3<f64>) -> Option<(Matrix3<f64>, f64)> {
    let l = positive_root(matrix)?;
    let (i00, i11, i22) = (1.0 / l[(0, 0)], 1.0 / l[(1, 1)], 1.0 / l[(2, 2)]);
    let i10 = -l[(1, 0)] * i00 * i11;
    let i21 = -l[(2, 1)] * i11 * i22;
    let i20 = -(l[(2, 0)] * i00 + l[(2, 1)] * i10) * i22;
    let (m01, m02, m12) = (i10 * i11 + i20 * i21, i20 * i22, i21 * i22);
    let inverse = Matrix3::new(
        i00 * i00 + i10 * i10 + i20 * i20,
        m01,
        m02,
        m01,
        i11 * i11 + i21 * i21,
        m12,
        m02,
        m12,
        i22 * i22,
    );
    Some((inverse, (l[(0, 0)] * l[(1, 1)] * l[(2, 2)]).powi(2)))
}

#[cfg(test)]
mod tests;
