//! Considered errors of the cameras: their correlation with the state, all cameras in parallel.
//!
//! Each camera has 24 numbers: E[x̃ βᵀ], six rows by three columns, and q = ∂x̃/∂ε. A gain K subtracts K u from all of
//! them, with u the same three rows for every camera except the measurement's own. Each number is therefore stored
//! beside that of the other cameras: one vector of AVX-512, two of AVX2, four of NEON. Unused places hold zeros and
//! stay zero.
//!
//! The plain reference is the filter over all errors in `super::tests`.
//!
//! PERF: a filter step with eight cameras, `cargo bench -p roundel-core --bench fusion`.

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, SimdMask, dispatch, f64x8};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{
    super::covariance::BlockCovariance,
    MAX_SOURCES,
    block::{Block, StateBlocks, StateColumns},
};
use roundel_vision::id::CameraId;

/// Cameras whose correlation has decayed below exp(-this) are removed.
const MAX_AGE_DECAYS: f64 = 6.0;
/// Marks an unused place.
const NO_CAMERA: CameraId = CameraId(u32::MAX);

/// One number of each camera.
type Row = [f64; MAX_SOURCES];
const ZEROS: Row = [0.0; MAX_SOURCES];
/// Row i is the unit vector of camera i.
const UNIT: [Row; MAX_SOURCES] = {
    let mut unit = [ZEROS; MAX_SOURCES];
    let mut index = 0;
    while index < MAX_SOURCES {
        unit[index][index] = 1.0;
        index += 1;
    }
    unit
};

/// Correlations E[x̃ βᵀ] with the systematic errors, and sensitivities q to the clock errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ConsideredErrors {
    cameras: [CameraId; MAX_SOURCES],
    ages_s: Row,
    /// σ.
    timings_s: Row,
    len: usize,
    /// Whether any clock error is considered; without one its terms are skipped.
    is_timed: bool,
    /// By component of β, then of the state: value, rate.
    systematic: [[Row; 6]; 3],
    clock_sensitivity: [Row; 6],
}

/// Terms that clock errors add to the covariances of value and rate with an innovation, and to that of the
/// innovation.
pub(super) struct ClockTerms {
    pub(super) value: Matrix3<f64>,
    pub(super) rate: Matrix3<f64>,
    pub(super) innovation: Matrix3<f64>,
}

impl ConsideredErrors {
    /// After one measurement of the value by one camera. The estimate is the measurement, p̂ = p + L β + w, so
    /// that E[(p - p̂) βᵀ] = -L.
    pub(super) fn begin(camera: CameraId, systematic_root: &Matrix3<f64>, is_timed: bool) -> Self {
        let mut considered = Self {
            cameras: [NO_CAMERA; MAX_SOURCES],
            ages_s: ZEROS,
            timings_s: ZEROS,
            len: 1,
            is_timed,
            systematic: [[ZEROS; 6]; 3],
            clock_sensitivity: [ZEROS; 6],
        };
        considered.cameras[0] = camera;
        for component in 0..3 {
            for axis in 0..3 {
                considered.systematic[component][axis][0] = -systematic_root[(axis, component)];
            }
        }
        considered
    }

    /// Predicts by `dt` seconds; systematic errors keep the share `kept`.
    pub(super) fn predict(&mut self, dt: f64, kept: f64, systematic_time_s: f64) {
        let max_age_s = MAX_AGE_DECAYS * systematic_time_s;
        let is_any_expired =
            dispatch!(Level::new(), simd => self.predict_with(simd, dt, kept, max_age_s));
        if is_any_expired {
            self.remove_old(max_age_s);
        }
    }

    /// Returns whether a camera's newest measurement is older than `max_age_s`.
    #[simd]
    fn predict_with<S: Simd>(&mut self, simd: S, dt: f64, kept: f64, max_age_s: f64) -> bool {
        for rows in &mut self.systematic {
            for axis in 0..3 {
                let rate = load(simd, &rows[axis + 3]) * kept;
                rate.mul_add(dt, load(simd, &rows[axis]) * kept).store_array(&mut rows[axis]);
                rate.store_array(&mut rows[axis + 3]);
            }
        }
        if self.is_timed {
            self.clock_sensitivity = predicted(simd, &self.clock_sensitivity, dt);
        }
        let ages_s = load(simd, &self.ages_s) + dt.abs();
        ages_s.store_array(&mut self.ages_s);
        ages_s.simd_gt(max_age_s).any_true()
    }

    /// Removes cameras whose newest measurement is older than `max_age_s`.
    fn remove_old(&mut self, max_age_s: f64) {
        for index in (0..self.len).rev() {
            if self.ages_s[index] > max_age_s {
                self.remove(index);
            }
        }
        // Ages of unused places.
        self.ages_s[self.len..].fill(0.0);
    }

    /// Correlations of value and rate with a camera's systematic error.
    #[inline(always)]
    pub(super) fn correlation<S: Simd>(&self, simd: S, index: usize) -> StateBlocks<S> {
        let [x, y, z] = &self.systematic;
        let value = [at(x, 0, index), at(y, 0, index), at(z, 0, index)];
        let rate = [at(x, 3, index), at(y, 3, index), at(z, 3, index)];
        StateBlocks {
            value: Block::from_columns(simd, value),
            rate: Block::from_columns(simd, rate),
        }
    }

    /// Update by a measurement of the camera `own`. `gain` is the negative gain of value and rate, `rate` the
    /// state's before the update.
    #[inline(always)]
    pub(super) fn correct<S: Simd>(
        &mut self,
        simd: S,
        own: usize,
        gain: &StateColumns,
        systematic_root: &Matrix3<f64>,
        rate: &Vector3<f64>,
    ) {
        self.ages_s[own] = 0.0;
        let unit = load(simd, &UNIT[own]);
        for (component, rows) in self.systematic.iter_mut().enumerate() {
            let x = unit.mul_add(systematic_root[(0, component)], load(simd, &rows[0]));
            let y = unit.mul_add(systematic_root[(1, component)], load(simd, &rows[1]));
            let z = unit.mul_add(systematic_root[(2, component)], load(simd, &rows[2]));
            subtract_gain(simd, rows, gain, [x, y, z]);
        }
        if self.is_timed {
            let u = innovation_sensitivity(simd, &self.clock_sensitivity, own, rate);
            subtract_gain(simd, &mut self.clock_sensitivity, gain, u);
        }
    }

    /// Terms of all clock errors; that of the camera `own` has the standard deviation `timing_s`.
    #[inline(always)]
    pub(super) fn clocks<S: Simd>(
        &self,
        simd: S,
        own: usize,
        timing_s: f64,
        rate: &Vector3<f64>,
    ) -> ClockTerms {
        let mut timings_s = self.timings_s;
        timings_s[own] = timing_s;
        let u = innovation_sensitivity(simd, &self.clock_sensitivity, own, rate);
        let weighted = weighted(simd, u, &timings_s);
        let mut sums = [Matrix3::zeros(); 3];
        for row in 0..3 {
            let lines = [
                load(simd, &self.clock_sensitivity[row]),
                load(simd, &self.clock_sensitivity[row + 3]),
                u[row],
            ];
            for column in 0..3 {
                for part in 0..3 {
                    sums[part][(row, column)] = (lines[part] * weighted[column]).reduce_sum();
                }
            }
        }
        let [value, rate, innovation] = sums;
        ClockTerms { value, rate, innovation }
    }

    /// Covariance that clock errors add to an innovation `dt` seconds from now. The error of a new camera's clock
    /// is independent of the state.
    pub(super) fn innovation_clock_covariance(
        &self,
        dt: f64,
        own: Option<usize>,
        timing_s: f64,
        rate: &Vector3<f64>,
    ) -> Matrix3<f64> {
        let mut timings_s = self.timings_s;
        let Some(own) = own else {
            let all = dispatch!(Level::new(), simd => {
                self.clock_covariance(simd, dt, 0, &timings_s, &Vector3::zeros())
            });
            return all + rate * rate.transpose() * (timing_s * timing_s);
        };
        timings_s[own] = timing_s;
        dispatch!(Level::new(), simd => {
            self.clock_covariance(simd, dt, own, &timings_s, rate)
        })
    }

    /// Σ σ² u uᵀ.
    #[simd]
    fn clock_covariance<S: Simd>(
        &self,
        simd: S,
        dt: f64,
        own: usize,
        timings_s: &Row,
        rate: &Vector3<f64>,
    ) -> Matrix3<f64> {
        let u =
            innovation_sensitivity(simd, &predicted(simd, &self.clock_sensitivity, dt), own, rate);
        let weighted = weighted(simd, u, timings_s);
        let mut sums = Matrix3::zeros();
        for row in 0..3 {
            for column in 0..=row {
                let sum = (u[row] * weighted[column]).reduce_sum();
                sums[(row, column)] = sum;
                sums[(column, row)] = sum;
            }
        }
        sums
    }

    /// Adds the covariance by clock errors, Σ σ² q qᵀ.
    pub(super) fn add_clock_covariance(&self, covariance: &mut BlockCovariance) {
        if !self.is_timed {
            return;
        }
        for index in 0..self.len {
            let square = self.timings_s[index] * self.timings_s[index];
            let [value, rate] = self.clock(index);
            covariance.value += value * value.transpose() * square;
            covariance.cross += value * rate.transpose() * square;
            covariance.rate += rate * rate.transpose() * square;
        }
    }

    /// Traces of the blocks that [`Self::add_clock_covariance`] adds.
    pub(super) fn reported_traces(&self) -> [f64; 3] {
        let mut traces = [0.0; 3];
        if self.is_timed {
            for index in 0..self.len {
                let square = self.timings_s[index] * self.timings_s[index];
                let [value, rate] = self.clock(index);
                traces[0] += value.norm_squared() * square;
                traces[1] += value.dot(&rate) * square;
                traces[2] += rate.norm_squared() * square;
            }
        }
        traces
    }

    /// Σ Cp Cpᵀ.
    pub(super) fn systematic_covariance(&self) -> Matrix3<f64> {
        let own = |index: usize| {
            Matrix3::from_fn(|row, component| self.systematic[component][row][index])
        };
        (0..self.len).map(|index| own(index) * own(index).transpose()).sum()
    }

    /// Sets the standard deviation of a camera's clock.
    pub(super) fn set_timing(&mut self, index: usize, timing_s: f64) {
        self.timings_s[index] = timing_s;
        self.is_timed |= timing_s > 0.0;
    }

    pub(super) fn find(&self, camera: CameraId) -> Option<usize> {
        self.cameras[..self.len].iter().position(|other| *other == camera)
    }

    /// Place of a camera. A new one starts uncorrelated; if there is no free place, it replaces the camera
    /// without a measurement for longest.
    pub(super) fn find_or_insert(&mut self, camera: CameraId) -> usize {
        if let Some(index) = self.find(camera) {
            return index;
        }
        if self.len == MAX_SOURCES {
            let mut oldest = 0;
            for index in 1..MAX_SOURCES {
                if self.ages_s[index] > self.ages_s[oldest] {
                    oldest = index;
                }
            }
            self.replace(oldest, |_| 0.0);
            self.cameras[oldest] = camera;
            return oldest;
        }
        self.cameras[self.len] = camera;
        self.len += 1;
        self.len - 1
    }

    /// Removes a camera and closes the gap.
    fn remove(&mut self, index: usize) {
        self.cameras[index..self.len].rotate_left(1);
        for place in index..self.len {
            let next = place + 1;
            self.replace(place, |row| if next < MAX_SOURCES { row[next] } else { 0.0 });
        }
        self.len -= 1;
        self.cameras[self.len] = NO_CAMERA;
    }

    /// Writes all numbers of one camera.
    fn replace(&mut self, index: usize, number: impl Fn(&Row) -> f64) {
        let rows = self.systematic.iter_mut().flatten().chain(&mut self.clock_sensitivity);
        for row in rows.chain([&mut self.ages_s, &mut self.timings_s]) {
            row[index] = number(row);
        }
    }

    fn clock(&self, index: usize) -> [Vector3<f64>; 2] {
        [0, 3].map(|from| Vector3::from_fn(|axis, _| self.clock_sensitivity[from + axis][index]))
    }
}

#[inline(always)]
fn load<S: Simd>(simd: S, row: &Row) -> f64x8<S> {
    f64x8::load_array_ref(simd, row)
}

/// q, `dt` seconds later.
#[inline(always)]
fn predicted<S: Simd>(simd: S, clock_sensitivity: &[Row; 6], dt: f64) -> [Row; 6] {
    let mut predicted = *clock_sensitivity;
    for axis in 0..3 {
        let rate = load(simd, &clock_sensitivity[axis + 3]);
        (load(simd, &clock_sensitivity[axis]) + rate * dt).store_array(&mut predicted[axis]);
    }
    predicted
}

/// u, the sensitivity of an innovation to each clock error.
#[inline(always)]
fn innovation_sensitivity<S: Simd>(
    simd: S,
    clock_sensitivity: &[Row; 6],
    own: usize,
    rate: &Vector3<f64>,
) -> [f64x8<S>; 3] {
    let unit = load(simd, &UNIT[own]);
    [
        load(simd, &clock_sensitivity[0]) - unit * rate.x,
        load(simd, &clock_sensitivity[1]) - unit * rate.y,
        load(simd, &clock_sensitivity[2]) - unit * rate.z,
    ]
}

/// σ² u.
#[inline(always)]
fn weighted<S: Simd>(simd: S, u: [f64x8<S>; 3], timings_s: &Row) -> [f64x8<S>; 3] {
    let timing_s = load(simd, timings_s);
    let squares = timing_s * timing_s;
    [u[0] * squares, u[1] * squares, u[2] * squares]
}

/// Adds -K u to the rows.
#[inline(always)]
fn subtract_gain<S: Simd>(
    simd: S,
    rows: &mut [Row; 6],
    StateColumns { value, rate }: &StateColumns,
    [x, y, z]: [f64x8<S>; 3],
) {
    for axis in 0..3 {
        let row = load(simd, &rows[axis]);
        let row = x.mul_add(value[0][axis], row);
        let row = z.mul_add(value[2][axis], y.mul_add(value[1][axis], row));
        row.store_array(&mut rows[axis]);
        let row = load(simd, &rows[axis + 3]);
        let row = x.mul_add(rate[0][axis], row);
        let row = z.mul_add(rate[2][axis], y.mul_add(rate[1][axis], row));
        row.store_array(&mut rows[axis + 3]);
    }
}

/// Three consecutive rows' numbers of one camera.
#[inline(always)]
fn at(rows: &[Row; 6], from: usize, index: usize) -> [f64; 3] {
    [rows[from][index], rows[from + 1][index], rows[from + 2][index]]
}
