//! The pixel's box convolved with the lens' Gaussian, tabulated for one blur.
//!
//! With σ the blur, Φ the normal distribution and φ its density, F(t) = t Φ(t/σ) + σ φ(t/σ):
//!
//! | | | |
//! | --- | --- | --- |
//! | k(t) | Φ((t + ½)/σ) - Φ((t - ½)/σ) | weight of a point t pixels from a pixel's centre |
//! | A(t) | F(t + ½) - F(t - ½) | integral of k |
//! | e(t) | A(t + 1) - A(t) | increase of A from one row to the next |
//!
//! A node at x touches `width` pixels, from ⌊x⌋ - width/2 + 1 on. Only the phase x - ⌊x⌋ matters,
//! so a table has [`PHASES`] rows of values and of their increase to the next phase (error below
//! 5e-5 from a blur of 0.5 px). k is cut off beyond the width, at no more than 7e-4 of its peak. e
//! starts at -1, half a pixel lower; from the middle phase on its rows shift by one to stay
//! central.

use crate::normal_distribution;

/// Phases of a table.
pub const PHASES: usize = 64;
/// k and e.
pub const FUNCTIONS: usize = 2;
/// Range of the blur, pixels.
pub const BLUR_LIMITS_PX: (f64, f64) = (0.26, 2.2);
/// Above this blur a node touches 16 pixels a side instead of 8.
const NARROW_PX: f64 = 1.12;
/// Distance of the tables; between them the model is linear in σ².
const STEP_PX: f64 = 0.03;
const TABLES: usize = 66;

/// Table of one blur: for each phase `width` values of k and as many of e.
#[derive(Clone, Debug)]
pub struct Kernel {
    /// σ.
    pub blur_px: f64,
    /// Pixels a side that a node touches, 8 or 16.
    pub width: usize,
    /// By phase; each function's values, then their increases. Empty until first used.
    pub table: Vec<f32>,
}

/// Offsets at which the widest table needs Φ and F.
const MAX_OFFSETS: usize = (16 + 6) * PHASES + 1;

impl Kernel {
    fn new(blur_px: f64) -> Self {
        let width = if blur_px <= NARROW_PX { 8 } else { 16 };
        Self { blur_px, width, table: Vec::with_capacity(PHASES * FUNCTIONS * 2 * width) }
    }

    fn fill(&mut self) {
        let Self { blur_px, width, ref mut table } = *self;
        // All offsets are multiples of a phase, so one list holds every Φ and F.
        let half = (width as i64 / 2 + 3) * PHASES as i64;
        let mut list = [[0.0; 2]; MAX_OFFSETS];
        for (i, both) in (-half..=half).zip(&mut list) {
            let z = i as f64 / (PHASES as f64 * blur_px);
            let density = normal_distribution::density(z);
            let below = normal_distribution::cumulative_with_density(z, density);
            *both = [below, blur_px * (z * below + density)];
        }
        let box_of = |i: i64, which: usize| {
            let at = |i: i64| list[(i + half) as usize][which];
            at(i + PHASES as i64 / 2) - at(i - PHASES as i64 / 2)
        };
        let step = |i: i64| box_of(i + PHASES as i64, 1) - box_of(i, 1);
        for phase in 0..PHASES {
            let mut put = |shift: usize, value: &dyn Fn(i64) -> f64| {
                let central = width as i64 / 2 - 1 - shift as i64;
                let at = |j: usize| phase as i64 + (central - j as i64) * PHASES as i64;
                table.extend((0..width).map(|j| value(at(j)) as f32));
                table.extend((0..width).map(|j| (value(at(j) + 1) - value(at(j))) as f32));
            };
            put(0, &|i| box_of(i, 0));
            put(fall_shift(phase), &step);
        }
    }
}

/// Rows by which the values of e start lower.
pub fn fall_shift(phase: usize) -> usize {
    usize::from(phase >= PHASES / 2)
}

/// Tables by blur, filled on first use in memory that is reserved from the start.
#[derive(Clone, Debug)]
pub struct Kernels(Vec<Kernel>);

impl Default for Kernels {
    fn default() -> Self {
        let blur_px = |index: usize| BLUR_LIMITS_PX.0 + STEP_PX * index as f64;
        Self((0..TABLES).map(|index| Kernel::new(blur_px(index))).collect())
    }
}

impl Kernels {
    pub fn nearest(&mut self, blur_px: f64) -> &Kernel {
        let place = ((blur_px - BLUR_LIMITS_PX.0) / STEP_PX).round();
        // NaN gives the first table.
        let index = (place.max(0.0) as usize).min(TABLES - 1);
        let kernel = &mut self.0[index];
        if kernel.table.is_empty() {
            kernel.fill();
        }
        kernel
    }
}

/// Weights of central differences over one and two pixels, for an image of this blur.
///
/// They minimize the squared error of the derivative of a straight edge, whose image has the
/// spectrum S(f) = exp(-2π²σ²f²) sinc(f cos θ) sinc(f sin θ)/f, averaged over directions θ and
/// phases.
#[derive(Clone, Copy, Debug)]
pub struct DifferenceWeights {
    /// ∂d/∂u ≈ Σ gradient[k] (d(u + k) - d(u - k)), and the same along v.
    pub gradient: [f32; 2],
    /// ∇²d ≈ Σ curvature[k] (the four pixels k away - 4 d).
    pub curvature: [f32; 2],
    /// 2 ∂²d/∂u∂v ≈ Σ skew[k] (the two pixels k away along both axes or against both - the other
    /// two corners). At a blur of 0.65 px this misses a fourth, since corners are farther away.
    pub skew: [f32; 2],
}

/// Blur and its weights; linear in between.
const TAPS: [(f64, [f64; 6]); 8] = [
    (0.35, [0.8362, -0.1830, 1.9307, -0.2855, 1.0569, -0.1896]),
    (0.5, [0.8174, -0.1700, 1.7743, -0.2255, 1.0089, -0.1708]),
    (0.65, [0.7889, -0.1518, 1.6555, -0.1819, 0.9459, -0.1431]),
    (0.8, [0.7627, -0.1360, 1.5720, -0.1532, 0.8885, -0.1181]),
    (1.0, [0.7363, -0.1207, 1.4995, -0.1299, 0.8298, -0.0942]),
    (1.3, [0.7118, -0.1070, 1.4379, -0.1115, 0.7737, -0.0736]),
    (1.7, [0.6945, -0.0977, 1.3967, -0.0999, 0.7332, -0.0603]),
    (2.2, [0.6838, -0.0920, 1.3720, -0.0933, 0.7077, -0.0527]),
];

impl DifferenceWeights {
    pub fn new(blur_px: f64) -> Self {
        let above = TAPS.iter().position(|(blur, _)| *blur > blur_px).unwrap_or(TAPS.len() - 1);
        let ((b0, low), (b1, high)) = (TAPS[above.max(1) - 1], TAPS[above.max(1)]);
        let share = ((blur_px - b0) / (b1 - b0)).clamp(0.0, 1.0);
        let at = |k: usize| (low[k] + share * (high[k] - low[k])) as f32;
        Self { gradient: [at(0), at(1)], curvature: [at(2), at(3)], skew: [at(4), at(5)] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kernel_has_weight_one_and_the_variance_of_box_and_blur() {
        let mut kernels = Kernels::default();
        for blur_px in [0.5, 0.7, 1.1, 1.6] {
            let kernel = kernels.nearest(blur_px).clone();
            let width = kernel.width;
            for phase in [0, 17, PHASES / 2, PHASES - 1] {
                let list = |which: usize| {
                    &kernel.table[(phase * FUNCTIONS + which) * 2 * width..][..width]
                };
                let offset =
                    |j: usize| phase as f64 / PHASES as f64 + (width / 2 - 1) as f64 - j as f64;
                let moment = |which: usize, n: i32| -> f64 {
                    let value = |j: usize| f64::from(list(which)[j]) * offset(j).powi(n);
                    (0..width).map(value).sum()
                };
                assert!((moment(0, 0) - 1.0).abs() < 2e-3, "{blur_px} {}", moment(0, 0));
                assert!((moment(1, 0) - 1.0).abs() < 2e-3, "{blur_px} {}", moment(1, 0));
                let variance = kernel.blur_px.powi(2) + 1.0 / 12.0;
                assert!((moment(0, 2) / variance - 1.0).abs() < 0.03, "{blur_px}");
            }
        }
    }

    /// Edges at all angles and phases against their exact derivatives.
    #[test]
    fn differences_are_the_derivatives_of_blurred_edges() {
        for (blur_px, miss) in [(0.5, 0.16), (0.72, 0.07), (0.9, 0.04), (1.4, 0.01)] {
            let taps = DifferenceWeights::new(blur_px);
            let (mut wrong, mut whole) = ([0.0; 2], [0.0; 2]);
            for i in 0..400 {
                let (sin, cos) = (f64::from(i) * 0.618).sin_cos();
                let s = f64::from(i) / 400.0 * 6.0 - 3.0;
                // The pixel's box as 16 × 16 points; d and its first two derivatives along the
                // edge's normal.
                let at = |u: f64, v: f64| {
                    let mut sums = [0.0; 3];
                    for k in 0..256 {
                        let (x, y) = (f64::from(k % 16), f64::from(k / 16));
                        let place = |x: f64| (x + 0.5) / 16.0 - 0.5;
                        let z = (s + (u + place(x)) * cos + (v + place(y)) * sin) / blur_px;
                        let density = normal_distribution::density(z);
                        let below = normal_distribution::cumulative(z);
                        sums[0] += below / 256.0;
                        sums[1] += density / blur_px / 256.0;
                        sums[2] -= z * density / (blur_px * blur_px) / 256.0;
                    }
                    sums
                };
                let d = |u: f64, v: f64| at(u, v)[0];
                let [middle, slope, bend] = at(0.0, 0.0);
                let [g1, g2] = taps.gradient.map(f64::from);
                let [c1, c2] = taps.curvature.map(f64::from);
                let along_u = g1 * (d(1.0, 0.0) - d(-1.0, 0.0)) + g2 * (d(2.0, 0.0) - d(-2.0, 0.0));
                let cross = |k: f64| d(k, 0.0) + d(-k, 0.0) + d(0.0, k) + d(0.0, -k) - 4.0 * middle;
                let curvature = c1 * cross(1.0) + c2 * cross(2.0);
                for (j, (found, exact)) in
                    [(along_u, slope * cos), (curvature, bend)].into_iter().enumerate()
                {
                    wrong[j] += (found - exact).powi(2);
                    whole[j] += exact.powi(2);
                }
            }
            for j in 0..2 {
                assert!(
                    wrong[j] < miss * miss * whole[j],
                    "{blur_px} {j}: {}",
                    (wrong[j] / whole[j]).sqrt()
                );
            }
        }
    }
}
