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

use fearless_simd::{Level, Simd, SimdBase, dispatch, f64x8};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{super::spread::Spread, MAX_SOURCES, innovation::Joint};
use crate::id::CameraId;

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

/// K in rows, value and rate.
pub(super) type Gain = [[f64; 3]; 6];

/// The rows of both parts.
pub(super) fn gain_of(value: &Matrix3<f64>, rate: &Matrix3<f64>) -> Gain {
    let row = |of: &Matrix3<f64>, row: usize| [of[(row, 0)], of[(row, 1)], of[(row, 2)]];
    [row(value, 0), row(value, 1), row(value, 2), row(rate, 0), row(rate, 1), row(rate, 2)]
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
        let mut index = 0;
        while index < self.len {
            self.ages_s[index] += dt.abs();
            if self.ages_s[index] > FORGOTTEN_TIMES * systematic_time_s {
                self.remove(index);
            } else {
                index += 1;
            }
        }
        dispatch!(Level::new(), simd => self.predict_with(simd, dt, kept));
    }

    #[simd]
    fn predict_with<S: Simd>(&mut self, simd: S, dt: f64, kept: f64) {
        for rows in &mut self.systematic {
            for axis in 0..3 {
                let rate = load(simd, &rows[axis + 3]);
                ((load(simd, &rows[axis]) + rate * dt) * kept).store_array(&mut rows[axis]);
                (rate * kept).store_array(&mut rows[axis + 3]);
            }
        }
        if self.is_timed {
            self.by_clock = moved(simd, &self.by_clock, dt);
        }
    }

    /// The correlations with a camera's systematic error, value and rate.
    pub(super) fn with(&self, index: usize) -> (Matrix3<f64>, Matrix3<f64>) {
        let of = |row: usize, component: usize| self.systematic[component][row][index];
        (Matrix3::from_fn(of), Matrix3::from_fn(|row, component| of(row + 3, component)))
    }

    /// After a correction with this gain by a measurement of the camera `own`, whose systematic error has
    /// this root; `rate` is the state's before it.
    #[inline(always)]
    pub(super) fn correct<S: Simd>(
        &mut self,
        simd: S,
        own: usize,
        gain: &Gain,
        systematic_root: &Matrix3<f64>,
        rate: &Vector3<f64>,
    ) {
        self.ages_s[own] = 0.0;
        let only = load(simd, &ONLY[own]);
        for (component, rows) in self.systematic.iter_mut().enumerate() {
            let x = load(simd, &rows[0]) + only * systematic_root[(0, component)];
            let y = load(simd, &rows[1]) + only * systematic_root[(1, component)];
            let z = load(simd, &rows[2]) + only * systematic_root[(2, component)];
            shrink(simd, rows, gain, [x, y, z]);
        }
        if self.is_timed {
            let u = innovation_by(simd, &self.by_clock, own, rate);
            shrink(simd, &mut self.by_clock, gain, u);
        }
    }

    /// Adds what all clocks may, `dt` seconds from now; that of the camera `own` (if it is among them) by this
    /// deviation.
    pub(super) fn add_clocks(
        &self,
        joint: &mut Joint,
        dt: f64,
        (own, timing_s): (Option<usize>, f64),
        rate: &Vector3<f64>,
    ) {
        let mut timings_s = self.timings_s;
        let sums = match own {
            Some(own) => {
                timings_s[own] = timing_s;
                dispatch!(Level::new(), simd => self.clock_sums(simd, dt, (own, &timings_s), rate))
            }
            None => {
                joint.innovation += rate * rate.transpose() * (timing_s * timing_s);
                let still = Vector3::zeros();
                dispatch!(Level::new(), simd => self.clock_sums(simd, dt, (0, &timings_s), &still))
            }
        };
        let block = |from: usize| Matrix3::from_fn(|row, column| sums[from + row][column]);
        joint.value += block(0);
        joint.rate += block(3);
        joint.innovation += block(6);
    }

    /// Σ σ² q uᵀ, and below it Σ σ² u uᵀ.
    #[simd]
    fn clock_sums<S: Simd>(
        &self,
        simd: S,
        dt: f64,
        (own, timings_s): (usize, &Row),
        rate: &Vector3<f64>,
    ) -> [[f64; 3]; 9] {
        let by_clock = moved(simd, &self.by_clock, dt);
        let u = innovation_by(simd, &by_clock, own, rate);
        let timing_s = load(simd, timings_s);
        let squares = timing_s * timing_s;
        let weighted = [u[0] * squares, u[1] * squares, u[2] * squares];
        let mut sums = [[0.0; 3]; 9];
        for row in 0..9 {
            let left = if row < 6 { load(simd, &by_clock[row]) } else { u[row - 6] };
            for column in 0..3 {
                sums[row][column] = (left * weighted[column]).reduce_sum();
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
        let own = |index: usize| self.with(index).0;
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

/// Takes K u from the rows.
#[inline(always)]
fn shrink<S: Simd>(simd: S, rows: &mut [Row; 6], gain: &Gain, u: [f64x8<S>; 3]) {
    for (row, gain) in rows.iter_mut().zip(gain) {
        let taken = u[0] * gain[0] + u[1] * gain[1] + u[2] * gain[2];
        (load(simd, row) - taken).store_array(row);
    }
}
