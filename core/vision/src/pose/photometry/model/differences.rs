//! Central differences of the image, as its derivatives, over one and two pixels each way with the
//! weights of [`super::blur_kernel`] for the blur.

use fearless_simd::{Simd, prelude::*};

use super::blur_kernel::DifferenceWeights;

/// Pixels each way that a difference spans.
pub const DIFFERENCE: usize = 2;

/// d of a row and of [`DIFFERENCE`] rows to either side.
pub struct ImageRows<'a> {
    pub image: &'a [f32],
    /// Length of a row.
    pub width: usize,
}

/// d and its differences at the pixels of a vector.
pub struct Differences<S: Simd> {
    /// d.
    pub share: S::f32s,
    /// ∂d/∂u, ∂d/∂v.
    pub slope: [S::f32s; 2],
    /// ∇²d.
    pub curvature: S::f32s,
    /// h: ∂²d/∂u² - ∂²d/∂v², 2 ∂²d/∂u∂v.
    pub bend: [S::f32s; 2],
}

/// h is computed for `MOTION` only.
#[inline(always)]
pub fn differences<S: Simd, const MOTION: bool>(
    simd: S,
    lines: &ImageRows,
    start: usize,
    taps: &DifferenceWeights,
) -> Differences<S> {
    let lanes = S::f32s::LEN;
    let width = lines.width;
    // One bounds check for all reads of the row.
    let reach = lanes + 2 * DIFFERENCE;
    let beside = &lines.image[DIFFERENCE * width + start - DIFFERENCE..][..reach];
    let at = |place: usize| S::f32s::from_slice(simd, &beside[place..place + lanes]);
    let (left_2, left, share, right, right_2) = (at(0), at(1), at(2), at(3), at(4));
    let of_row =
        |row: usize| S::f32s::from_slice(simd, &lines.image[row * width + start..][..lanes]);
    let (up_2, up, down, down_2) = (of_row(0), of_row(1), of_row(3), of_row(4));
    let [g1, g2] = taps.gradient.map(|tap| S::f32s::splat(simd, tap));
    let along_u = (right - left).mul_add(g1, (right_2 - left_2) * g2);
    let along_v = (down - up).mul_add(g1, (down_2 - up_2) * g2);
    let [c1, c2] = taps.curvature.map(|tap| S::f32s::splat(simd, tap));
    let (near_u, near_v) = (left + right, up + down);
    let (far_u, far_v) = (left_2 + right_2, up_2 + down_2);
    let (near, far) = (near_u + near_v, far_u + far_v);
    let rest = share * S::f32s::splat(simd, -4.0 * (taps.curvature[0] + taps.curvature[1]));
    let curvature = near.mul_add(c1, far.mul_add(c2, rest));
    let slope = [along_u, along_v];
    if !MOTION {
        return Differences { share, slope, curvature, bend: [S::f32s::splat(simd, 0.0); 2] };
    }
    let stretch = (near_u - near_v).mul_add(c1, (far_u - far_v) * c2);
    // 2 ∂²d/∂u∂v by the squares with corners one and two pixels away.
    let [s1, s2] = taps.skew.map(|tap| S::f32s::splat(simd, tap));
    let skew = corners(simd, lines, start, 1).mul_add(s1, corners(simd, lines, start, 2) * s2);
    Differences { share, slope, curvature, bend: [stretch, skew] }
}

/// d at the two corners along both axes or against both, less that at the other two. No closures,
/// which would not be inlined here.
#[inline(always)]
fn corners<S: Simd>(simd: S, lines: &ImageRows, start: usize, by: usize) -> S::f32s {
    let lanes = S::f32s::LEN;
    let reach = lanes + 2 * by;
    let above = &lines.image[(DIFFERENCE - by) * lines.width + start - by..][..reach];
    let below = &lines.image[(DIFFERENCE + by) * lines.width + start - by..][..reach];
    let falling = S::f32s::from_slice(simd, &below[2 * by..2 * by + lanes])
        + S::f32s::from_slice(simd, &above[..lanes]);
    let rising = S::f32s::from_slice(simd, &below[..lanes])
        + S::f32s::from_slice(simd, &above[2 * by..2 * by + lanes]);
    falling - rising
}
