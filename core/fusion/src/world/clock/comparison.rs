//! Comparison of several cameras' views of one moving object, for evidence about their clocks.
//!
//! Over a window each camera's positions are fitted by a parabola at the corrected times, and evaluated at the middle:
//! m_c = p - v ε_c + b_c + n_c, with the object's velocity v there, the error ε_c of the estimated clock offset, the
//! camera's systematic error b_c and noise n_c. With R_c the covariance of b_c + n_c, A_c = R_c⁻¹ and A = Σ A_c, the
//! unknown position p is eliminated. For ε remain
//!
//! information Λ_cj = vᵀ A_c v [c = j] - vᵀ A_c A⁻¹ A_j v, score η_c = -vᵀ A_c (m_c - p̂), p̂ = A⁻¹ Σ A_c m_c
//!
//! Nothing is extrapolated, so the object's further motion does not matter, and late frames have arrived. b_c lasts
//! longer than a window, so successive windows are correlated: its covariance is multiplied by the number of windows in
//! twice its correlation time. The parabola's remainder, ½ a ε², counts as error.

use nalgebra::{Matrix3, Vector3};

use super::{
    estimator::Clocks,
    evidence::{Comparison, FittedView},
};
use crate::track::{History, MAX_SOURCES, Measurement};

use roundel_vision::{id::CameraId, time::Timestamp};

/// Length of the window.
pub(crate) const WINDOW_NS: i64 = 180_000_000;
/// Time from the window's end to the newest measurement: frames may be late, and clocks off.
const DELAY_NS: i64 = 110_000_000;
/// Cameras with fewer positions in the window are left out.
const MIN_POSITIONS: usize = 4;
/// Cameras whose positions do not reach this far to either side, as a share of the half window, are left out.
const MIN_REACH: f64 = 0.5;
/// Objects slower than this give no evidence, m/s.
const MIN_SPEED_M_S: f64 = 0.05;
/// Smallest ratio of the squared speed to its variance.
const MIN_SPEED_RATIO_SQUARED: f64 = 16.0;

/// Sums over one camera's measurements in the window.
#[derive(Clone, Copy)]
struct Sums {
    camera: CameraId,
    count: usize,
    /// Sums of powers of the time, in half windows from the middle.
    powers: [f64; 5],
    positions: [Vector3<f64>; 3],
    white: Matrix3<f64>,
    systematic: Matrix3<f64>,
    reach: (f64, f64),
}

/// Value, slope and curvature of a parabola, and the variances of the first two in units of one position's.
struct Parabola {
    terms: [Vector3<f64>; 3],
    variances: [f64; 2],
}

/// Compares the measurements in the window before `now`; `None` if they give no evidence.
pub(crate) fn compare(
    history: &History,
    now: Timestamp,
    clocks: &Clocks,
    systematic_time_s: f64,
) -> Option<Comparison> {
    let half_s = 0.5e-9 * WINDOW_NS as f64;
    // Weight of an exponentially correlated error in a mean.
    let repeats = (systematic_time_s / half_s).max(1.0);
    let middle = now.plus_ns(-DELAY_NS - WINDOW_NS / 2);
    let mut sums: Vec<Sums> = Vec::with_capacity(MAX_SOURCES);
    for measurement in history.measurements() {
        let moved_s = measurement.clock_correction_s - clocks.offset_now_s(measurement.camera);
        let time = (measurement.time.seconds_since(middle) + moved_s) / half_s;
        if time.abs() > 1.0 || !clocks.is_compared(measurement.camera, measurement.time) {
            continue;
        }
        match sums.iter_mut().find(|sums| sums.camera == measurement.camera) {
            Some(sums) => sums.add(time, measurement),
            None => {
                let mut own = Sums::new(measurement.camera);
                own.add(time, measurement);
                sums.push(own);
            }
        }
    }
    let fits: Vec<(Sums, Parabola)> =
        sums.into_iter().filter_map(|sums| Some((sums, sums.parabola()?))).collect();
    if fits.len() < 2 {
        return None;
    }
    let (mut slope, mut curvature, mut weight, mut noise) =
        (Vector3::zeros(), Vector3::zeros(), 0.0, 0.0);
    for (sums, fit) in &fits {
        let own = 1.0 / (fit.variances[1] * sums.white.trace());
        slope += fit.terms[1] * own;
        curvature += fit.terms[2] * own;
        weight += own;
        noise += own;
    }
    let velocity_m_s: Vector3<f64> = slope / (weight * half_s);
    let min_squared =
        (MIN_SPEED_RATIO_SQUARED / (noise * half_s * half_s)).max(MIN_SPEED_M_S.powi(2));
    if velocity_m_s.norm_squared() < min_squared {
        return None;
    }
    let acceleration_m_s2 = curvature.norm() * 2.0 / (weight * half_s * half_s);
    let cameras: Vec<CameraId> = fits.iter().map(|(sums, _)| sums.camera).collect();
    let views = fits.iter().map(|(sums, fit)| {
        let deviations_s = cameras.iter().map(|other| clocks.deviation_s(sums.camera, *other));
        let curvature_error_m = 0.5 * acceleration_m_s2 * deviations_s.fold(0.0, f64::max).powi(2);
        let per_count = 1.0 / sums.count as f64;
        let covariance = sums.white * (fit.variances[0] * per_count)
            + sums.systematic * (repeats * per_count)
            + Matrix3::from_diagonal_element(curvature_error_m * curvature_error_m);
        FittedView { camera: sums.camera, position_m: fit.terms[0], covariance }
    });
    Some(Comparison { velocity_m_s, views: views.collect() })
}

impl Sums {
    fn new(camera: CameraId) -> Self {
        Self {
            camera,
            count: 0,
            powers: [0.0; 5],
            positions: [Vector3::zeros(); 3],
            white: Matrix3::zeros(),
            systematic: Matrix3::zeros(),
            reach: (1.0, -1.0),
        }
    }

    fn add(&mut self, time: f64, measurement: &Measurement) {
        self.count += 1;
        self.reach = (self.reach.0.min(time), self.reach.1.max(time));
        let mut power = 1.0;
        for index in 0..5 {
            self.powers[index] += power;
            if index < 3 {
                self.positions[index] += measurement.position_m * power;
            }
            power *= time;
        }
        let noise = &measurement.position_noise;
        let systematic = noise.systematic_root * noise.systematic_root.transpose();
        self.white += noise.total - systematic;
        self.systematic += systematic;
    }

    /// Least-squares parabola; `None` if the positions are too few or one-sided.
    fn parabola(&self) -> Option<Parabola> {
        let covers = self.reach.0 <= -MIN_REACH && self.reach.1 >= MIN_REACH;
        if self.count < MIN_POSITIONS || !covers {
            return None;
        }
        let [p0, p1, p2, p3, p4] = self.powers;
        let inverse = Matrix3::new(p0, p1, p2, p1, p2, p3, p2, p3, p4).try_inverse()?;
        let term =
            |row: usize| (0..3).map(|column| self.positions[column] * inverse[(row, column)]).sum();
        let terms = [term(0), term(1), term(2)];
        Some(Parabola { terms, variances: [inverse[(0, 0)], inverse[(1, 1)]] })
    }
}
