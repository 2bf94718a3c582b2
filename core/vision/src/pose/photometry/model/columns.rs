//! Columns of the linear problem at the pixels of a row.
//!
//! The model is (W + C (d + ½ Δσ² ∇²d + Δμ·h/48)) (1 + ℓ·t). h = (∂²d/∂u² - ∂²d/∂v², 2 ∂²d/∂u∂v) is
//! the derivative of d by the motion's square μ ([`super::motion`]), which the nodes contain
//! completely or not at all. The derivative of d by a motion of the contour is -∇d, converted to t.
//! ∇d and ∇²d are central differences of d ([`super::differences`]): they miss 6 % of a column
//! (root mean square) at a blur of 0.7 px and 14 % at 0.5 px. What they miss is orthogonal to what
//! they give, so the variance of the estimate grows by its square.

use fearless_simd::{Simd, prelude::*};

use super::{
    blur_kernel::DifferenceWeights,
    column_products::COLUMNS,
    differences::{Differences, ImageRows, differences},
};

/// Rows of the window are padded to whole vectors of any width.
pub const LANES: usize = 16;

/// Indices of the lanes.
const COUNT: [f32; LANES] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

pub struct RowSpan<'a> {
    pub row: usize,
    pub span: (usize, usize),
    /// Grey values, replaced by residuals.
    pub grey: &'a mut [f32],
    pub around: ImageRows<'a>,
}

/// Coefficients of the model that gather needs, as f32.
#[derive(Clone, Copy, Debug)]
pub struct PixelModel {
    /// W, grey levels.
    pub white: f32,
    /// C = B - W, grey levels.
    pub step: f32,
    /// ½ (σ² - σ² of the table), px².
    pub blur: f32,
    /// Part of μ that the nodes do not contain, over 48, px²; `None` where the motion is held.
    pub motion: Option<[f32; 2]>,
    pub taps: DifferenceWeights,
    /// Derivative of (u, v) by t, row by row, pixels.
    pub slope: [f32; 4],
    /// ℓ.
    pub light: [f32; 2],
    /// t₁ and t₂: constant, column and row terms.
    pub t: [[f32; 3]; 2],
    /// Relative inverse depth p₃/Q₃: constant, t₁ and t₂ terms.
    pub nearness: [f32; 3],
    /// Nearness times the plane's x and y: constant, t₁ and t₂ terms.
    pub plane: [[f32; 3]; 2],
    /// (n₁/s, n₂/s, n₃) R/p₃: change of t by a step along the normal.
    pub lift: [f32; 3],
    /// (p₁, p₂)/(s p₃): the centre.
    pub middle: [f32; 2],
}

/// A function linear in t: constant, t₁ and t₂ terms.
#[inline(always)]
fn linear<S: Simd>(simd: S, terms: &[f32; 3], t1: S::f32s, t2: S::f32s) -> S::f32s {
    let inner = t2.mul_add(S::f32s::splat(simd, terms[2]), S::f32s::splat(simd, terms[0]));
    t1.mul_add(S::f32s::splat(simd, terms[1]), inner)
}

/// Change of d as the plane's points move along a vector; `radial` is g·t.
#[inline(always)]
fn moved<S: Simd>(simd: S, along: &[f32; 3], [g1, g2, radial]: [S::f32s; 3]) -> S::f32s {
    let across = g2.mul_add(S::f32s::splat(simd, along[1]), radial * -along[2]);
    g1.mul_add(S::f32s::splat(simd, along[0]), across)
}

/// The pixels of a vector in a row.
#[derive(Clone, Copy)]
pub struct Pack {
    /// Column of the first pixel.
    pub start: usize,
    /// Number of counted pixels.
    pub count: usize,
}

/// Passes the columns of the row's pixels to `take`, a vector at a time, and replaces the grey
/// values by residuals. `levels` gives W and C of the pixels. With `SPREAD`, the column of the
/// mirrored pose is replaced by the derivative by a motion of the rims into the black: across an
/// edge that is much longer than its blur, the gradient's length.
#[inline(always)]
pub fn add_row<S: Simd, const MOTION: bool, const SPREAD: bool>(
    simd: S,
    line: &mut RowSpan,
    model: &PixelModel,
    levels: impl Fn(Pack) -> [S::f32s; 2],
    mut take: impl FnMut(&[S::f32s; COLUMNS], Pack),
) {
    let lanes = S::f32s::LEN;
    let counted = S::f32s::from_slice(simd, &COUNT[..lanes]);
    let v = line.row as f32;
    let to = line.span.1 as f32;
    let [m11, m12, m21, m22] = model.slope.map(|value| S::f32s::splat(simd, value));
    let [zero, one, two] = [0.0, 1.0, 2.0].map(|value| S::f32s::splat(simd, value));
    let motion = model.motion.unwrap_or_default().map(|value| S::f32s::splat(simd, value));
    let row_t1 = S::f32s::splat(simd, model.t[0][0] + v * model.t[0][2]);
    let row_t2 = S::f32s::splat(simd, model.t[1][0] + v * model.t[1][2]);
    for start in (line.span.0..line.span.1).step_by(lanes) {
        let u = counted + start as f32;
        // Values beyond the span are finite and get weight zero.
        let weight = (S::f32s::splat(simd, to) - u).min(one).max(zero);
        let grey = S::f32s::from_slice(simd, &line.grey[start..start + lanes]);
        let Differences { share, slope, curvature, bend } =
            differences::<S, MOTION>(simd, &line.around, start, &model.taps);
        let ([along_u, along_v], [stretch, skew]) = (slope, bend);
        let (fall_u, fall_v) = (along_u * weight, along_v * weight);
        let g1 = zero - fall_u.mul_add(m11, fall_v * m21);
        let g2 = zero - fall_u.mul_add(m12, fall_v * m22);
        let t1 = u.mul_add(S::f32s::splat(simd, model.t[0][1]), row_t1);
        let t2 = u.mul_add(S::f32s::splat(simd, model.t[1][1]), row_t2);
        let blurred = curvature.mul_add(S::f32s::splat(simd, model.blur), share);
        let blurred = if MOTION {
            stretch.mul_add(motion[0], skew.mul_add(motion[1], blurred))
        } else {
            blurred
        };
        let pack = Pack { start, count: lanes.min(line.span.1 - start) };
        let [white, step] = levels(pack);
        let level = blurred.mul_add(step, white);
        let shade = t1.mul_add(S::f32s::splat(simd, model.light[0]), t2 * model.light[1]);
        let level = level.mul_add(shade, level);
        let near = linear(simd, &model.nearness, t1, t2);
        let x = linear(simd, &model.plane[0], t1, t2);
        let y = linear(simd, &model.plane[1], t1, t2);
        let radial = t1.mul_add(g1, t2 * g2);
        let lift = moved(simd, &model.lift, [g1, g2, radial]);
        let [middle_1, middle_2] = model.middle;
        let to_middle = moved(simd, &[middle_1, middle_2, 1.0], [g1, g2, radial]);
        let lit = level * weight;
        let last = if SPREAD {
            zero - fall_u.mul_add(fall_u, fall_v * fall_v).sqrt()
        } else {
            // In the mirrored pose a point's ray t grows by 1/(2 nearness - 1), from the middle. With
            // x = 2 nearness - 2 this moves it by x/(1 + x); x is a tenth or less, so the series is
            // enough.
            let x2 = near + near - two;
            to_middle * x2 * (x2.mul_add(x2, one) - x2)
        };
        // In the order of `column_products::column`.
        let columns = [
            (grey - level) * weight,
            weight,
            share * weight,
            curvature * weight,
            lit * t1,
            lit * t2,
            near * g1,
            near * g2,
            near * to_middle,
            y * lift,
            zero - x * lift,
            last,
            stretch * weight,
            skew * weight,
        ];
        columns[0].store_slice(&mut line.grey[start..start + lanes]);
        take(&columns, pack);
    }
}
