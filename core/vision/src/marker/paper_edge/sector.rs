//! One sector of a rim next to the paper's edge.

use std::{array, sync::LazyLock};

use nalgebra::{SMatrix, SVector};

use super::{RoughRing, SECTORS};
use crate::{
    frame::Frame,
    marker::Polarity,
    normal_distribution::{cumulative, normal_each},
};

/// Rays whose levels are averaged in a sector.
const RAYS: usize = 4;
/// Samples on a ray, their distance, and the first one's from the rim, pixels.
pub(super) const SAMPLES: usize = 16;
const STEP_PX: f32 = 0.5;
const FIRST_PX: f32 = -2.5;
/// Widths of margins at the start: this many, a step apart, from two steps on.
const WIDTHS: usize = 9;
/// Vector lanes of sums.
const LANES: usize = 8;
/// Deviation of a sector's levels from the model, as a share of the contrast.
pub(super) const ERROR: f32 = 0.02;
/// δ, m, D and the deviations of B and W: pixels, pixels, and shares of the contrast.
const UNKNOWNS: usize = 5;
/// Standard deviations of their priors.
const PRIORS: [f32; UNKNOWNS] = [1.0, 1.5, 0.5, 0.03, 0.03];
/// Range of σ, with pixels and interpolation, and its start, pixels.
const BLURS_PX: (f32, f32) = (0.5, 3.0);
pub(super) const FIRST_BLUR_PX: f32 = 0.9;
/// Largest steps of σ, and of δ and m, pixels.
const MAX_BLUR_STEP_PX: f32 = 0.3;
const MAX_STEP_PX: f32 = 0.7;
/// Smallest margin, pixels.
const MIN_MARGIN_PX: f32 = 0.3;

/// A number for each sample.
type Profile = [f32; SAMPLES];

/// An edge with the blur at the start, at all distances of samples from rims and margins: by steps, from
/// [`FIRST_PX`] less [`SAMPLES`] steps on.
static FIRST_EDGE: LazyLock<[f32; 2 * SAMPLES]> = LazyLock::new(|| {
    array::from_fn(|step| {
        let out_px = FIRST_PX + STEP_PX * (step as f32 - SAMPLES as f32);
        cumulative(f64::from(out_px / FIRST_BLUR_PX)) as f32
    })
});

fn out_px(sample: usize) -> f32 {
    FIRST_PX + STEP_PX * sample as f32
}

/// Levels across the rim in one sector, and what is known of its edges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sector {
    /// Mean levels by distance, as shares of the contrast above black.
    profile: Profile,
    unknowns: [f32; UNKNOWNS],
    /// Where the prior holds them.
    expected: [f32; UNKNOWNS],
    /// Distance of the disc's rim inwards, pixels, and its white share.
    disc_px: f32,
    disc_share: f32,
    /// Half the rim's curvature.
    pub bend_per_px: f64,
    /// Component of the vector from the centre along the normal, pixels.
    pub height_px: f64,
    /// Rms, as a share of the contrast, before the newest step.
    pub residual: f32,
}

impl Sector {
    /// Samples the `index`-th sector, with the margin that leaves the least residual.
    pub fn new(frame: &Frame, ring: &RoughRing, index: usize) -> Self {
        let RoughRing { outer, black, white, polarity, disc_ratio, disc_share } = ring;
        let is_inverted = *polarity == Polarity::WhiteRing;
        let product_px2 = outer.semi_major_px * outer.semi_minor_px;
        let mut sums = [0.0; SAMPLES];
        let (mut bend_per_px, mut height_px) = (0.0, 0.0);
        for ray in 0..RAYS {
            let part = (ray as f64 + 0.5) / RAYS as f64;
            let t = std::f64::consts::TAU * (index as f64 + part) / SECTORS as f64;
            let point = outer.rim_point(t);
            for (sample, sum) in sums.iter_mut().enumerate() {
                *sum += frame.level_at(point.outwards(f64::from(out_px(sample))));
            }
            bend_per_px += 0.5 * point.height_px.powi(3) / product_px2.powi(2) / RAYS as f64;
            height_px += point.height_px / RAYS as f64;
        }
        let share = |sum: f64| {
            let level = sum / RAYS as f64;
            let level = if is_inverted { 255.0 - level } else { level };
            ((level - black) / (white - black)) as f32
        };
        let mut sector = Self {
            profile: sums.map(share),
            unknowns: [0.0; UNKNOWNS],
            expected: [0.0; UNKNOWNS],
            disc_px: (height_px * (1.0 - disc_ratio)) as f32,
            disc_share: *disc_share as f32,
            bend_per_px,
            height_px,
            residual: f32::INFINITY,
        };
        sector.start();
        sector
    }

    /// δ, pixels.
    pub fn rim_px(&self) -> f32 {
        self.unknowns[0]
    }

    /// m, pixels.
    pub fn margin_px(&self) -> f32 {
        self.unknowns[1]
    }

    /// D, as a share of the contrast.
    pub fn step(&self) -> f32 {
        self.unknowns[2]
    }

    /// Deviation of black or white, as a share of the contrast.
    pub fn level_deviation(&self) -> f32 {
        self.unknowns[3].abs().max(self.unknowns[4].abs())
    }

    /// The margin that leaves the least residual, of [`WIDTHS`], with [`FIRST_BLUR_PX`].
    #[inline(always)]
    fn start(&mut self) {
        let table = &*FIRST_EDGE;
        let mut rest = self.profile;
        for (sample, rest) in rest.iter_mut().enumerate() {
            let to_disc = (-out_px(sample) - self.disc_px) / FIRST_BLUR_PX;
            *rest -= table[SAMPLES + sample] + self.disc_share * normal_each(to_disc).1;
        }
        let (mut best_gain, mut best) = (0.0, (STEP_PX * 2.0, 0.0));
        for width in 2..2 + WIDTHS {
            let share = |sample: usize| table[SAMPLES + sample - width];
            let (mut product, mut square) = (0.0, 1e-3);
            for (sample, rest) in rest.iter().enumerate() {
                product += rest * share(sample);
                square += share(sample) * share(sample);
            }
            let step = product / square;
            if step * product > best_gain {
                (best_gain, best) = (step * product, (STEP_PX * width as f32, step));
            }
        }
        self.expected = [0.0, best.0, best.1, 0.0, 0.0];
        self.unknowns = self.expected;
    }

    /// Residuals, their derivatives by the unknowns, and by σ.
    #[inline(always)]
    fn linearized(&self, blur_px: f32) -> (Profile, [Profile; UNKNOWNS], Profile) {
        let [rim_px, margin_px, step, black, white] = self.unknowns;
        let Self { disc_px, disc_share, .. } = *self;
        let per_blur = 1.0 / blur_px;
        let contrast = 1.0 + white - black;
        let (mut rest, mut by_blur) = (self.profile, [0.0; SAMPLES]);
        let mut columns = [[0.0; SAMPLES]; UNKNOWNS];
        for sample in 0..SAMPLES {
            let out_px = out_px(sample);
            let z_rim = (out_px - rim_px) * per_blur;
            let z_paper = z_rim - margin_px * per_blur;
            let (d_rim, s_rim) = normal_each(z_rim);
            let (d_paper, s_paper) = normal_each(z_paper);
            let s_rim = s_rim + disc_share * normal_each(-(out_px + disc_px) * per_blur).1;
            rest[sample] -= black + contrast * s_rim + step * s_paper;
            let rim_slope = contrast * d_rim * per_blur;
            let paper_slope = step * d_paper * per_blur;
            columns[0][sample] = -rim_slope - paper_slope;
            columns[1][sample] = -paper_slope;
            columns[2][sample] = s_paper;
            columns[3][sample] = 1.0 - s_rim;
            columns[4][sample] = s_rim;
            by_blur[sample] = -rim_slope * z_rim - paper_slope * z_paper;
        }
        (rest, columns, by_blur)
    }
}

#[inline(always)]
fn dot(one: &Profile, other: &Profile) -> f32 {
    let mut sums = [0.0; LANES];
    for (one, other) in one.chunks_exact(LANES).zip(other.chunks_exact(LANES)) {
        for (sum, (one, other)) in sums.iter_mut().zip(one.iter().zip(other)) {
            *sum += one * other;
        }
    }
    sums.iter().sum()
}

/// A step of all sectors and of the blur.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub blur_px: f32,
    /// Largest change, pixels.
    pub change_px: f32,
    /// Mean variance of δ in a sector, and that by the blur, which all sectors have in common, px².
    pub own_px2: f32,
    pub common_px2: f32,
}

/// One Gauss-Newton step; `None` if the normal equations have no solution.
#[inline(always)]
pub(super) fn descend(sectors: &mut [Sector; SECTORS], blur_px: f32) -> Option<Step> {
    type Square = SMatrix<f32, UNKNOWNS, UNKNOWNS>;
    type Column = SVector<f32, UNKNOWNS>;
    const WEIGHT: f32 = 1.0 / (ERROR * ERROR);
    let mut blocks = [(Column::zeros(), Column::zeros()); SECTORS];
    let (mut blur_square, mut blur_product) = (0.0, 0.0);
    let (mut own_px2, mut by_blur_px) = (0.0, 0.0);
    for (sector, block) in sectors.iter_mut().zip(&mut blocks) {
        let (rest, columns, by_blur) = sector.linearized(blur_px);
        sector.residual = (dot(&rest, &rest) / SAMPLES as f32).sqrt();
        let (mut square, mut product, mut cross) =
            (Square::zeros(), Column::zeros(), Column::zeros());
        for row in 0..UNKNOWNS {
            for column in 0..=row {
                square[(row, column)] = WEIGHT * dot(&columns[row], &columns[column]);
                square[(column, row)] = square[(row, column)];
            }
            product[row] = WEIGHT * dot(&columns[row], &rest);
            cross[row] = WEIGHT * dot(&columns[row], &by_blur);
            let per_variance = 1.0 / (PRIORS[row] * PRIORS[row]);
            square[(row, row)] += per_variance;
            product[row] += per_variance * (sector.expected[row] - sector.unknowns[row]);
        }
        let solver = square.cholesky()?;
        let (solved, crossed) = (solver.solve(&product), solver.solve(&cross));
        blur_square += WEIGHT * dot(&by_blur, &by_blur) - cross.dot(&crossed);
        blur_product += WEIGHT * dot(&by_blur, &rest) - cross.dot(&solved);
        own_px2 += solver.solve(&Column::x())[0] / SECTORS as f32;
        by_blur_px += crossed[0] / SECTORS as f32;
        *block = (solved, crossed);
    }
    let wanted_px = (blur_product / blur_square).clamp(-MAX_BLUR_STEP_PX, MAX_BLUR_STEP_PX);
    let next_px = (blur_px + wanted_px).clamp(BLURS_PX.0, BLURS_PX.1);
    let step_px = next_px - blur_px;
    let mut change_px = step_px.abs();
    for (sector, (solved, crossed)) in sectors.iter_mut().zip(blocks) {
        let change = solved - crossed * step_px;
        let moved_px = change[0].abs().max(change[1].abs());
        change_px = change_px.max(moved_px);
        let scale = (MAX_STEP_PX / moved_px).min(1.0);
        for (unknown, change) in sector.unknowns.iter_mut().zip(change.iter()) {
            *unknown += change * scale;
        }
        sector.unknowns[1] = sector.unknowns[1].max(MIN_MARGIN_PX);
    }
    let common_px2 = by_blur_px * by_blur_px / blur_square;
    next_px.is_finite().then_some(Step { blur_px: next_px, change_px, own_px2, common_px2 })
}
