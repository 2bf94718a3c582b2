//! A coded roundel's outer rim to a fraction of a pixel, from points of half level.
//!
//! Across the rim, the level halfway between ring and margin is located at points
//! evenly spaced in the ellipse's parameter t. Their distances outwards of the ellipse, as a share q(t)
//! of its size, have five harmonics that an ellipse can follow:
//! q = α + βₓ cos t + βᵧ sin t + γ cos 2t + η sin 2t; the ellipse's map A becomes A (1 + S) with
//! S = [α+γ η; η α-γ], and its centre moves by A β. The remainder of q is the unevenness of the rim.
//!
//! Blur with deviation σ shifts the half level of a rim of curvature κ inwards by σ²κ/2; σ follows from
//! the rim's slope, (W - B)/(√(2π) σ). B and W are sampled a few pixels inside and outside of the rim, closer for small
//! or tilted rims, where they are mixed to a degree that follows from the blur.
//!
//! The iteration ends at a fixed point. A tracked ring starts at its prediction and needs two or three iterations, others
//! start at a rough outline.

use fearless_simd::{Simd, dispatch};
use fearless_simd_macros::simd;

use crate::{
    ellipse::Ellipse,
    marker::{
        coded::{
            rim_points::{Edges, POINTS, PerPoint, Points, harmonics, mean, smoothed, sum, tilted},
            sampler::Sampler,
        },
        reject::Reject,
    },
};

/// Largest unevenness; beyond it the rim is partly covered, or not a rim.
const MAX_UNEVEN: f64 = 0.25;
/// By iteration, the search range of a point about the ellipse: a share of the shorter semiaxis …
const WALKS: [f64; 4] = [0.35, 0.12, 0.05, 0.02];
/// … plus pixels.
const WALK_PX: f64 = 1.5;
/// Search range about predicted rims, pixels.
const EXPECTED_PX: f64 = 3.0;
/// A rim that moved by less than this, pixels, is within half a pixel of its place.
const NEAR_PX: f64 = 0.3;
/// A tracked ring whose growth falls below this, pixels, is extrapolated to the limit of all
/// further iterations …
const FORESEEN_PX: f64 = 0.01;
/// … if each adds at most this share of the one before.
const MAX_LEFT: f64 = 0.7;
/// Largest number of iterations: for a small rim, whose levels are sampled near its edge, each
/// leaves up to two thirds of the error …
const MAX_TURNS: usize = 14;
/// … until one grows the rim by less than this, pixels …
const SETTLED_PX: f64 = 0.002;
/// … and changes centre and shape, which converge quadratically, by less than this.
const SETTLING_PX: f64 = 0.02;
/// Largest number of points without an edge.
const MAX_MISSING: usize = POINTS / 6;
/// Variance of a slope's width, px².
const SLOPE_PX2: f64 = 1.0 / 12.0;
/// Range of the deviation derived from the slope, pixels; the first is that of pixels and
/// interpolation alone.
const BLURS_PX: (f64, f64) = (0.5, 3.0);
/// Initial deviation.
const FIRST_BLUR_PX: f64 = 1.0;

#[derive(Clone, Copy, Debug)]
pub(crate) struct OuterRim {
    pub ellipse: Ellipse,
    /// Level of the ring.
    pub black: f64,
    /// Level of the margin.
    pub margin: f64,
    /// As [`crate::marker::Ring::margin_px`].
    pub margin_px: f64,
    /// Deviation of the blur in the interpolated image, pixels.
    pub blur_px: f64,
    /// Rms deviation of the levels along the rim from the middle, as a share of the contrast, as
    /// [`crate::marker::Ring::unevenness`].
    pub unevenness: f64,
}

impl OuterRim {
    fn about(ellipse: &Ellipse) -> Self {
        Self {
            ellipse: *ellipse,
            black: 0.0,
            margin: 0.0,
            margin_px: 0.0,
            blur_px: FIRST_BLUR_PX,
            unevenness: 0.0,
        }
    }

    /// Rejects an uneven rim.
    fn checked(self) -> Result<Self, Reject> {
        if self.unevenness > MAX_UNEVEN { Err(Reject::Covered) } else { Ok(self) }
    }
}

/// The outer rim near a rough outline; `threshold` separates black from white initially.
pub(crate) fn outer_rim(
    sampler: &Sampler,
    outline: &Ellipse,
    threshold: f64,
) -> Result<OuterRim, Reject> {
    let mut rim = OuterRim::about(outline);
    for turn in 0..MAX_TURNS {
        let share = WALKS[turn.min(WALKS.len() - 1)];
        let reach_px = WALK_PX + share * rim.ellipse.semi_minor_px;
        let before = rim.ellipse;
        rim = fitted(sampler, &rim, (turn == 0).then_some(threshold), Reach::Far(reach_px))?;
        let grown_px = rim.ellipse.mean_radius_px() - before.mean_radius_px();
        if turn + 1 >= WALKS.len() && grown_px.abs() < SETTLED_PX {
            break;
        }
    }
    rim.checked()
}

/// The outer rim of a tracked ring, from its prediction.
pub(crate) fn followed_rim(sampler: &Sampler, expected: &Ellipse) -> Result<OuterRim, Reject> {
    let mut rim = OuterRim::about(expected);
    let (mut reach, mut grown_before_px) = (Reach::Near, f64::NAN);
    for _ in 0..MAX_TURNS {
        let before = rim.ellipse;
        rim = match (fitted(sampler, &rim, None, reach), reach) {
            // It has moved further than usual.
            (Err(Reject::Covered), Reach::Near) => {
                fitted(sampler, &rim, None, Reach::Far(EXPECTED_PX))?
            }
            (turned, _) => turned?,
        };
        let after = &mut rim.ellipse;
        let longer_px = after.semi_major_px - before.semi_major_px;
        let wider_px = after.semi_minor_px - before.semi_minor_px;
        let (du, dv) = (after.center.u - before.center.u, after.center.v - before.center.v);
        let moved_px = du.abs().max(dv.abs()).max((longer_px - wider_px).abs());
        let grown_px = 0.5 * (longer_px + wider_px);
        if grown_px.abs() < FORESEEN_PX && moved_px < SETTLING_PX {
            // NaN after the first iteration.
            let share = grown_px / grown_before_px;
            let rest_px = grown_px * share / (1.0 - share);
            if share.abs() < MAX_LEFT {
                after.semi_major_px += rest_px;
                after.semi_minor_px += rest_px;
                break;
            }
            if grown_px.abs() < SETTLED_PX {
                break;
            }
        }
        grown_before_px = grown_px;
        let is_near = moved_px.max(grown_px.abs()) < NEAR_PX;
        reach = if is_near { Reach::Near } else { Reach::Far(EXPECTED_PX) };
    }
    rim.checked()
}

/// Search range of the points about a rim.
#[derive(Clone, Copy, Debug)]
enum Reach {
    /// Within half a pixel.
    Near,
    /// Within this many pixels.
    Far(f64),
}

/// One iteration; the half level is `threshold`, or derived from the levels nearby.
fn fitted(
    sampler: &Sampler,
    rim: &OuterRim,
    threshold: Option<f64>,
    reach: Reach,
) -> Result<OuterRim, Reject> {
    dispatch!(sampler.level, simd => fitted_with(simd, sampler, rim, threshold, reach))
}

#[simd]
fn fitted_with<S: Simd>(
    _simd: S,
    sampler: &Sampler,
    rim: &OuterRim,
    threshold: Option<f64>,
    reach: Reach,
) -> Result<OuterRim, Reject> {
    if sampler.frame.width() < 2 || sampler.frame.height() < 2 {
        return Err(Reject::FrameEdge);
    }
    let points = Points::of(&rim.ellipse);
    let mut half = [threshold.unwrap_or_default() as f32; POINTS];
    let (mut black, mut contrast) = (0.0, 0.0);
    if threshold.is_none() {
        let (blacks, margins) =
            points.black_and_white(sampler, rim.ellipse.semi_minor_px, rim.blur_px);
        let (blacks, margins) = (tilted(&blacks), smoothed(&margins));
        black = mean(&blacks);
        contrast = mean(&margins) - black;
        if contrast.is_nan() || contrast < 1.0 {
            return Err(Reject::Contrast);
        }
        for index in 0..POINTS {
            half[index] = 0.5 * (blacks[index] + margins[index]);
        }
    }
    let edges = match reach {
        Reach::Near => Edges::near(sampler, &points, &half),
        Reach::Far(reach_px) => Edges::far(sampler, &points, &half, reach_px),
    };
    if edges.missing > MAX_MISSING {
        return Err(Reject::Covered);
    }
    let mut shares = edges.out_px;
    for (index, share) in shares.iter_mut().enumerate() {
        let drawn_px = points.drawn_per_px[index] * (rim.blur_px * rim.blur_px) as f32;
        let out_px = if edges.slope[index] > 0.0 { *share + drawn_px } else { 0.0 };
        *share = out_px / points.height_px[index];
    }
    // A slope over one pixel is that of an edge blurred by one more pixel.
    let count = (POINTS - edges.missing) as f64;
    let steep = mean(&edges.slope) * POINTS as f64;
    let apparent_px = contrast * count / (steep * std::f64::consts::TAU.sqrt());
    let blur_px = (apparent_px * apparent_px - SLOPE_PX2).sqrt();
    let of_slope = blur_px.max(BLURS_PX.0).min(BLURS_PX.1);
    let blur_px = if threshold.is_none() { of_slope } else { FIRST_BLUR_PX };
    let (ellipse, rest_px) = moved(&rim.ellipse, &points, &shares).ok_or(Reject::Profile)?;
    // Deviations as levels; points without an edge count as half the contrast.
    let strays = rest_px / (std::f64::consts::TAU.sqrt() * blur_px);
    let gone = edges.missing as f64 / POINTS as f64;
    let unevenness = (strays * strays + 0.25 * gone).sqrt();
    Ok(OuterRim { ellipse, black, margin: black + contrast, margin_px: 0.0, blur_px, unevenness })
}

/// The ellipse that follows the points, and the rms of their deviations from it, pixels.
#[inline(always)]
fn moved(ellipse: &Ellipse, points: &Points, shares: &PerPoint) -> Option<(Ellipse, f64)> {
    let bases = harmonics();
    let alpha = mean(shares);
    let [x, y, gamma, eta] =
        bases.each_ref().map(|basis| 2.0 * sum(|at| shares[at] * basis[at]) / POINTS as f64);
    let [whole, by_x, by_y, by_p, by_q] = [alpha, x, y, gamma, eta].map(|it| it as f32);
    let mut rest = [0.0; POINTS];
    let [xs, ys, ps, qs] = bases;
    for index in 0..POINTS {
        let followed =
            whole + by_x * xs[index] + by_y * ys[index] + by_p * ps[index] + by_q * qs[index];
        let off_px = (shares[index] - followed) * points.height_px[index];
        rest[index] = off_px * off_px;
    }
    let moved = ellipse.deformed([alpha, x, y, gamma, eta])?;
    Some((moved, mean(&rest).sqrt()))
}
