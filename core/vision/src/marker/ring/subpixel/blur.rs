//! The effect of blur on levels and sums between cuts, and its removal.
//!
//! Blur with the deviation σ carries light across a straight edge. Per pixel of rim, the area
//! m = ∫ Φ(-x/σ) dx, x from d on, lies beyond a cut at the distance d; with z = d/σ it is
//! σ (φ(z) - z Φ(-z)). Each side lacks a share 2 s of the spread σ², s = ∫ x Φ(-x/σ) dx / σ²
//! ([`Beyond`]). So, for a rim of radius r with a band from r - d to r + d:
//!
//! - A level of n pixels beyond a cut deviates towards the other one by the share
//!   ε = 2π r' m / n of the contrast, r' the radius of the cut.
//! - The filled rim gains 2π ε (r - d/2) d from the level inside, and loses
//!   2π ε (r + d/2) d to the level outside.
//! - It lacks the 2π (r + d) m that lies outside the band, and has 2π (r - d) m too much inside.
//! - Its spread comes out as σ² (1 - 4 s) - (ε + ε) d².
//!
//! The last line, for both rims, gives σ; the others then give the growth of the rims.
//! σ includes the pixels' own width, as the spread does.

use fearless_simd::Simd;
use fearless_simd_macros::simd;

use crate::{
    ellipse::Ellipse,
    marker::ring::{
        pixels::edge_band::WIDE_PX,
        subpixel::{
            levels::{LevelSample, LevelSamples},
            thin_ring::RimDistances,
        },
        weighed_rim::{RimSpread, WeighedRim},
    },
    normal_distribution::Beyond,
    simd::Lane,
};

/// Range of the blurred edge's deviation, pixels, to which a measured one is clamped: the first is
/// that of pixels behind a sharp lens.
const BLUR_LIMITS_PX: (f64, f64) = (0.4, 1.7);
/// Smallest distance from a rim of levels that are corrected, pixels.
const MIN_DISTANCE_PX: f64 = 0.5;
/// Largest share of the other level in a level.
const MAX_MIXED: f64 = 0.3;
/// Iterations in which σ and the mixed shares are found.
const TURNS: usize = 2;

/// Levels and rims without blur.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SharpRims {
    pub outer: Ellipse,
    pub inner: Ellipse,
    pub black: f64,
    pub white: f64,
}

/// Removes the blur. `thin` has the black pixels of a ring that blur reaches everywhere.
#[simd]
pub(crate) fn remove_blur<S: Simd>(
    simd: S,
    outer: &WeighedRim,
    inner: &WeighedRim,
    levels: &LevelSamples<f64>,
    thin: Option<&RimDistances>,
) -> SharpRims {
    let LevelSamples { black, white, .. } = levels;
    let rims = (outer.spread(), inner.spread());
    let mut correction = BlurCorrection::none(rims.1.spread_px2);
    for _ in 0..TURNS {
        let blur = Blur::new(correction.spread_px2);
        let black_share = thin.map(|distances| {
            let (grown_px, blur_px) = (correction.grown_px, blur.deviation_px);
            let level = RimDistances::level(simd, distances, white.level, grown_px, blur_px);
            let share = (black.level - level) / (white.level - level);
            share.clamp(-MAX_MIXED, MAX_MIXED)
        });
        correction = correction.turn(&rims.0, &rims.1, levels, &blur, black_share);
    }
    let (black, white) = correction.levels(black.level, white.level);
    let (outer, inner) = (
        outer.rim.grown(correction.grown_px.0).at(0),
        inner.rim.grown(correction.grown_px.1).at(0),
    );
    SharpRims { outer, inner, black, white }
}

/// The current estimate of the blur and its effects.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlurCorrection<T> {
    /// Growth of the rims, the outer one first.
    pub grown_px: (T, T),
    /// The blur's variance.
    spread_px2: T,
    mixed: LevelErrors<T>,
}

impl<T: Lane> BlurCorrection<T> {
    /// The initial estimate, from the spread of a rim.
    #[inline(always)]
    pub fn none(spread_px2: T) -> Self {
        let none = spread_px2.splat(0.0);
        let mixed = LevelErrors { black: none, white: none, margin: none };
        Self { grown_px: (none, none), spread_px2, mixed }
    }

    /// The final estimate for rims with wide bands and all levels beyond them.
    #[inline(always)]
    pub fn of_wide(outer: &RimSpread<T>, inner: &RimSpread<T>, levels: &LevelSamples<T>) -> Self {
        let mut correction = Self::none(inner.spread_px2);
        for _ in 0..TURNS {
            let blur = Blur::new(correction.spread_px2);
            correction = correction.turn(outer, inner, levels, &blur, None);
        }
        correction
    }

    /// The next iteration. `black_share` is the error of a thin ring's level.
    #[inline(always)]
    fn turn(
        &self,
        outer: &RimSpread<T>,
        inner: &RimSpread<T>,
        levels: &LevelSamples<T>,
        blur: &Blur<T>,
        black_share: Option<T>,
    ) -> Self {
        let (r_o, r_i) = (outer.radius_px, inner.radius_px);
        let mixed = LevelErrors::new(r_o, r_i, levels, black_share, blur);
        // Weights are shares of the measured contrast.
        let scale = (-mixed.white - mixed.black + 1.0).under(1.0);
        let (of_outer, of_inner) = (
            BlurredEdge { spread: outer, mixed: (mixed.black * scale, mixed.margin * scale) },
            BlurredEdge { spread: inner, mixed: (mixed.white * scale, mixed.black * scale) },
        );
        let none = r_o.splat(0.0);
        let none = Leak { area: none, spread_px2: none };
        let leaks = match black_share {
            Some(_) => {
                let width_px = r_o + self.grown_px.0 - r_i - self.grown_px.1;
                let (near, far) = (outer.cuts.inside_px, inner.cuts.outside_px);
                (
                    Leak::new(r_i, width_px - near, near, blur),
                    Leak::new(-r_o, width_px - far, far, blur),
                )
            }
            None => (none, none),
        };
        let spread_px2 = (of_outer.spread_px2(&leaks.0, blur), of_inner.spread_px2(&leaks.1, blur));
        Self {
            grown_px: (of_outer.growth_px(&leaks.0, blur), of_inner.growth_px(&leaks.1, blur)),
            // Without a margin, something else lies in the outer band.
            spread_px2: match levels.margin {
                Some(_) => (spread_px2.0 + spread_px2.1) * 0.5,
                None => spread_px2.1,
            },
            mixed,
        }
    }

    /// Black and white without blur.
    #[inline(always)]
    pub fn levels(&self, black: T, white: T) -> (T, T) {
        let contrast = (white - black) / (-self.mixed.white - self.mixed.black + 1.0);
        (black - self.mixed.black * contrast, white + self.mixed.white * contrast)
    }
}

/// Errors of the levels as shares of the contrast.
#[derive(Clone, Copy, Debug)]
struct LevelErrors<T> {
    black: T,
    white: T,
    margin: T,
}

impl<T: Lane> LevelErrors<T> {
    #[inline(always)]
    fn new(
        r_o: T,
        r_i: T,
        levels: &LevelSamples<T>,
        black_share: Option<T>,
        blur: &Blur<T>,
    ) -> Self {
        let LevelSamples { black, white, margin } = levels;
        // Both rims give light to the black, one from each side.
        let of_black = match black_share {
            Some(share) => share,
            None => blur.share(black, r_o + r_i),
        };
        let of_white = blur.share(white, r_i - white.distance_px);
        let of_margin = match margin {
            Some(margin) => blur.share(margin, r_o + margin.distance_px),
            None => of_white,
        };
        Self { black: of_black, white: of_white, margin: of_margin }
    }
}

/// Light of the other rim in a rim's band, where the black is thin.
#[derive(Clone, Copy, Debug)]
struct Leak<T> {
    /// Its contribution to the area over 2π, px².
    area: T,
    /// Its contribution to σ².
    spread_px2: T,
}

impl<T: Lane> Leak<T> {
    /// From a rim with this radius, negative if the black is inside of it, to a band that begins at
    /// this distance and extends this far into the black.
    #[inline(always)]
    fn new(radius_px: T, distance_px: T, reach_px: f64, blur: &Blur<T>) -> Self {
        let moved_px = Beyond::new(distance_px, blur.deviation_px).moved_px;
        Self {
            // The roundel's weights lose the disc's light that the disc's own would gain.
            area: -(radius_px + distance_px) * moved_px,
            spread_px2: moved_px * (2.0 * reach_px),
        }
    }
}

/// A rim, and the errors of the levels (inside, outside).
#[derive(Clone, Copy, Debug)]
struct BlurredEdge<'a, T> {
    spread: &'a RimSpread<T>,
    mixed: (T, T),
}

impl<T: Lane> BlurredEdge<'_, T> {
    /// σ² from the spread between the cuts.
    #[inline(always)]
    fn spread_px2(&self, leak: &Leak<T>, blur: &Blur<T>) -> T {
        let (near, far) = (self.spread.cuts.inside_px, self.spread.cuts.outside_px);
        let (inside, outside) = self.mixed;
        let beyond = blur.beyond(near).spread + blur.beyond(far).spread;
        let spread_px2 = self.spread.spread_px2 - leak.spread_px2;
        let share = -(beyond * 2.0) + 1.0;
        (spread_px2 + inside * near * near + outside * far * far) / share.larger(share.splat(0.3))
    }

    /// Growth of the rim.
    #[inline(always)]
    fn growth_px(&self, leak: &Leak<T>, blur: &Blur<T>) -> T {
        let (near, far) = (self.spread.cuts.inside_px, self.spread.cuts.outside_px);
        let (inside, outside) = self.mixed;
        let r = self.spread.radius_px;
        let outer = (r + far) * blur.beyond(far).moved_px;
        let inner = (r - near) * blur.beyond(near).moved_px;
        let levels = outside * (r + 0.5 * far) * far - inside * (r - 0.5 * near) * near;
        (outer - inner + levels - leak.area) / r
    }
}

/// A blur, and its effect beyond the usual cut.
#[derive(Clone, Copy, Debug)]
struct Blur<T> {
    deviation_px: T,
    wide: Beyond<T>,
}

impl<T: Lane> Blur<T> {
    #[inline(always)]
    fn new(spread_px2: T) -> Self {
        let (min, max) = BLUR_LIMITS_PX;
        let deviation_px = spread_px2.larger(spread_px2.splat(0.0)).root();
        let deviation_px =
            deviation_px.larger(spread_px2.splat(min)).smaller(spread_px2.splat(max));
        Self { deviation_px, wide: Beyond::new(spread_px2.splat(WIDE_PX), deviation_px) }
    }

    #[inline(always)]
    fn beyond(&self, distance_px: f64) -> Beyond<T> {
        if distance_px == WIDE_PX {
            self.wide
        } else {
            Beyond::new(self.deviation_px.splat(distance_px), self.deviation_px)
        }
    }

    /// Error of a level with a cut of this radius, as a share of the contrast.
    #[inline(always)]
    fn share(&self, taken: &LevelSample<T>, radius_px: T) -> T {
        // This close to the edge, levels depend more on a camera's sharpening than on its blur.
        if taken.distance_px < MIN_DISTANCE_PX {
            return radius_px.splat(0.0);
        }
        let moved_px = self.beyond(taken.distance_px).moved_px;
        let radius_px = radius_px.larger(radius_px.splat(0.0));
        let share = radius_px * std::f64::consts::TAU * moved_px;
        (share / taken.pixels).smaller(share.splat(MAX_MIXED))
    }
}
