//! What the cameras' errors have to do with the state's, all cameras side by side.
//!
//! Of each camera 24 numbers are carried: E[x̃ βᵀ], six rows by three columns, and q = ∂x̃/∂ε. A gain
//! K takes K u from all of them, u the same three rows for every camera but the measurement's own; so each
//! number lies beside that of the other cameras, and all cameras' are one vector of AVX-512, two of AVX2,
//! four of NEON. Places without a camera hold zeros, which stay zeros.
//!
//! The plain reference is the filter over all errors in `super::tests`.
//!
//! PERF: a filter's step with eight cameras, `cargo bench -p roundel-core --bench fusion`.

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, SimdMask, dispatch, f64x8};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{
    super::covariance::Spread,
    MAX_SOURCES,
    block::{Block, Numbers},
};
use roundel_vision::id::CameraId;

/// Sources whose correlation has decayed below exp(-this) are let go.
const FORGOTTEN_TIMES: f64 = 6.0;
/// Nobody's.
const NO_CAMERA: CameraId = CameraId(u32::MAX);

/// One number of each camera.
type Row = [f64; MAX_SOURCES];
const ZEROS: Row = [0.0; MAX_SOURCES];
/// What one camera of all is, as numbers.
const ONLY: [Row; MAX_SOURCES] = {
    let mut only = [ZEROS; MAX_SOURCES];
    let mut index = 0;
    while index < MAX_SOURCES {
        only[index][index] = 1.0;
        index += 1;
    }
    only
};

/// The cameras' systematic errors and the state, E[x̃ βᵀ], and their clocks' errors and the state, q.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sources {
    cameras: [CameraId; MAX_SOURCES],
    ages_s: Row,
    /// σ.
    timings_s: Row,
    len: usize,
    /// Whether a clock is considered; until then nothing is computed for it.
    is_timed: bool,
    /// By component of β, then of the state: value, rate.
    systematic: [[Row; 6]; 3],
    by_clock: [Row; 6],
}

/// What clocks add to the covariances of the errors of value and rate with an innovation, and to that of the
/// innovation.
pub(super) struct ByClocks {
    pub(super) value: Matrix3<f64>,
    pub(super) rate: Matrix3<f64>,
    pub(super) innovation: Matrix3<f64>,
}

impl Sources {
    /// Of one camera, after one measurement of the value: the estimate is the measurement, p̂ = p + L β + w, so that
    /// E[(p - p̂) βᵀ] = -L.
    pub(super) fn begin(camera: CameraId, systematic_root: &Matrix3<f64>, is_timed: bool) -> Self {
        let mut sources = Self {
            cameras: [NO_CAMERA; MAX_SOURCES],
            ages_s: ZEROS,
            timings_s: ZEROS,
            len: 1,
            is_timed,
            systematic: [[ZEROS; 6]; 3],
            by_clock: [ZEROS; 6],
        };
        sources.cameras[0] = camera;
        for component in 0..3 {
            for axis in 0..3 {
                sources.systematic[component][axis][0] = -systematic_root[(axis, component)];
            }
        }
        sources
    }

    /// `dt` seconds later, when the systematic errors have kept this share.
    pub(super) fn predict(&mut self, dt: f64, kept: f64, systematic_time_s: f64) {
        let most_s = FORGOTTEN_TIMES * systematic_time_s;
        let is_any_old =
            dispatch!(Level::new(), simd => self.predict_with(simd, (dt, kept), most_s));
        if is_any_old {
            self.forget(most_s);
        }
    }

    /// True if a camera was not heard of for longer than so many seconds.
    #[simd]
    fn predict_with<S: Simd>(&mut self, simd: S, (dt, kept): (f64, f64), most_s: f64) -> bool {
        for rows in &mut self.systematic {
            for axis in 0..3 {
                let rate = load(simd, &rows[axis + 3]) * kept;
                rate.mul_add(dt, load(simd, &rows[axis]) * kept).store_array(&mut rows[axis]);
                rate.store_array(&mut rows[axis + 3]);
            }
        }
        if self.is_timed {
            self.by_clock = moved(simd, &self.by_clock, dt);
        }
        let ages_s = load(simd, &self.ages_s) + dt.abs();
        ages_s.store_array(&mut self.ages_s);
        ages_s.simd_gt(most_s).any_true()
    }

    /// Lets go of cameras that were not heard of for longer than so many seconds.
    fn forget(&mut self, most_s: f64) {
        for index in (0..self.len).rev() {
            if self.ages_s[index] > most_s {
                self.remove(index);
            }
        }
        // Nobody's age.
        self.ages_s[self.len..].fill(0.0);
    }

    /// The correlations with a camera's systematic error, value and rate.
    #[inline(always)]
    pub(super) fn with<S: Simd>(&self, simd: S, index: usize) -> (Block<S>, Block<S>) {
        let [x, y, z] = &self.systematic;
        let value = [at(x, 0, index), at(y, 0, index), at(z, 0, index)];
        let rate = [at(x, 3, index), at(y, 3, index), at(z, 3, index)];
        (Block::of_columns(simd, value), Block::of_columns(simd, rate))
    }

    /// After a correction with a gain of which this is the negative, value and rate, by a measurement of the camera `own`, whose systematic error has
    /// this root; `rate` is the state's before it.
    #[inline(always)]
    pub(super) fn correct<S: Simd>(
        &mut self,
        simd: S,
        own: usize,
        gain: &(Numbers, Numbers),
        systematic_root: &Matrix3<f64>,
        rate: &Vector3<f64>,
    ) {
        self.ages_s[own] = 0.0;
        let only = load(simd, &ONLY[own]);
        for (component, rows) in self.systematic.iter_mut().enumerate() {
            let x = only.mul_add(systematic_root[(0, component)], load(simd, &rows[0]));
            let y = only.mul_add(systematic_root[(1, component)], load(simd, &rows[1]));
            let z = only.mul_add(systematic_root[(2, component)], load(simd, &rows[2]));
            shrink(simd, rows, gain, [x, y, z]);
        }
        if self.is_timed {
            let u = innovation_by(simd, &self.by_clock, own, rate);
            shrink(simd, &mut self.by_clock, gain, u);
        }
    }

    /// What all clocks may add; that of the camera `own` by this deviation.
    #[inline(always)]
    pub(super) fn clocks<S: Simd>(
        &self,
        simd: S,
        (own, timing_s): (usize, f64),
        rate: &Vector3<f64>,
    ) -> ByClocks {
        let mut timings_s = self.timings_s;
        timings_s[own] = timing_s;
        let u = innovation_by(simd, &self.by_clock, own, rate);
        let weighted = weighted(simd, u, &timings_s);
        let mut sums = [Matrix3::zeros(); 3];
        for row in 0..3 {
            let lines =
                [load(simd, &self.by_clock[row]), load(simd, &self.by_clock[row + 3]), u[row]];
            for column in 0..3 {
                for part in 0..3 {
                    sums[part][(row, column)] = (lines[part] * weighted[column]).reduce_sum();
                }
            }
        }
        let [value, rate, innovation] = sums;
        ByClocks { value, rate, innovation }
    }

    /// What they may add to the covariance of an innovation `dt` seconds from now; a camera that is not among
    /// them is on its own.
    pub(super) fn clocks_of_innovation(
        &self,
        dt: f64,
        (own, timing_s): (Option<usize>, f64),
        rate: &Vector3<f64>,
    ) -> Matrix3<f64> {
        let mut timings_s = self.timings_s;
        let Some(own) = own else {
            let all = dispatch!(Level::new(), simd => {
                self.innovation_clocks(simd, dt, (0, &timings_s), &Vector3::zeros())
            });
            return all + rate * rate.transpose() * (timing_s * timing_s);
        };
        timings_s[own] = timing_s;
        dispatch!(Level::new(), simd => {
            self.innovation_clocks(simd, dt, (own, &timings_s), rate)
        })
    }

    /// Σ σ² u uᵀ.
    #[simd]
    fn innovation_clocks<S: Simd>(
        &self,
        simd: S,
        dt: f64,
        (own, timings_s): (usize, &Row),
        rate: &Vector3<f64>,
    ) -> Matrix3<f64> {
        let u = innovation_by(simd, &moved(simd, &self.by_clock, dt), own, rate);
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

    /// Adds to a covariance what all clocks may.
    pub(super) fn add_told(&self, spread: &mut Spread) {
        if !self.is_timed {
            return;
        }
        for index in 0..self.len {
            let square = self.timings_s[index] * self.timings_s[index];
            let [value, rate] = self.clock(index);
            spread.value += value * value.transpose() * square;
            spread.cross += value * rate.transpose() * square;
            spread.rate += rate * rate.transpose() * square;
        }
    }

    /// The traces of what [`Self::add_told`] adds.
    pub(super) fn told_traces(&self) -> [f64; 3] {
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
    pub(super) fn systematic(&self) -> Matrix3<f64> {
        let own = |index: usize| {
            Matrix3::from_fn(|row, component| self.systematic[component][row][index])
        };
        (0..self.len).map(|index| own(index) * own(index).transpose()).sum()
    }

    /// Says how far a camera's clock may be off.
    pub(super) fn set_timing(&mut self, index: usize, timing_s: f64) {
        self.timings_s[index] = timing_s;
        self.is_timed |= timing_s > 0.0;
    }

    /// A camera's place.
    pub(super) fn find(&self, camera: CameraId) -> Option<usize> {
        self.cameras[..self.len].iter().position(|known| *known == camera)
    }

    /// A camera's place; of a new one nothing is correlated. Where there is none left, that of the camera not
    /// heard of longest.
    pub(super) fn find_or_new(&mut self, camera: CameraId) -> usize {
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

    /// Lets go of a camera; those behind it move up.
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
        let rows = self.systematic.iter_mut().flatten().chain(&mut self.by_clock);
        for row in rows.chain([&mut self.ages_s, &mut self.timings_s]) {
            row[index] = number(row);
        }
    }

    fn clock(&self, index: usize) -> [Vector3<f64>; 2] {
        [0, 3].map(|from| Vector3::from_fn(|axis, _| self.by_clock[from + axis][index]))
    }
}

#[inline(always)]
fn load<S: Simd>(simd: S, row: &Row) -> f64x8<S> {
    f64x8::load_array_ref(simd, row)
}

/// q, `dt` seconds later.
#[inline(always)]
fn moved<S: Simd>(simd: S, by_clock: &[Row; 6], dt: f64) -> [Row; 6] {
    let mut moved = *by_clock;
    for axis in 0..3 {
        let rate = load(simd, &by_clock[axis + 3]);
        (load(simd, &by_clock[axis]) + rate * dt).store_array(&mut moved[axis]);
    }
    moved
}

/// u: what each clock's error adds to an innovation, each second.
#[inline(always)]
fn innovation_by<S: Simd>(
    simd: S,
    by_clock: &[Row; 6],
    own: usize,
    rate: &Vector3<f64>,
) -> [f64x8<S>; 3] {
    let only = load(simd, &ONLY[own]);
    [
        load(simd, &by_clock[0]) - only * rate.x,
        load(simd, &by_clock[1]) - only * rate.y,
        load(simd, &by_clock[2]) - only * rate.z,
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
fn shrink<S: Simd>(
    simd: S,
    rows: &mut [Row; 6],
    (value, rate): &(Numbers, Numbers),
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

/// Three rows' numbers of one camera.
#[inline(always)]
fn at(rows: &[Row; 6], from: usize, index: usize) -> [f64; 3] {
    [rows[from][index], rows[from + 1][index], rows[from + 2][index]]
}
