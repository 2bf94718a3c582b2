//! What blur does to levels and sums taken between cuts, and how it is undone.
//!
//! Blur of the deviation σ carries light across a straight edge. Beyond a cut at the distance d from the
//! edge lies the area m = ∫ Φ(-x/σ) dx of it a pixel of rim, x from d on; with z = d/σ that is
//! σ (φ(z) - z Φ(-z)), and of the spread σ² each side lacks a share of 2 s, s = ∫ x Φ(-x/σ) dx / σ²
//! ([`Beyond`]). So, of a rim of radius r in whose belt (from r - d to r + d) grey levels count:
//!
//! - A level, taken from n pixels beyond a cut, is off towards the other one by the share
//!   ε = 2π r' m / n of the contrast, r' the radius of the cut.
//! - The filled rim then gets too much by 2π ε (r - d/2) d of the level inside, and too little by
//!   2π ε (r + d/2) d of the level outside.
//! - It lacks the 2π (r + d) m that lies outside the belt, and has 2π (r - d) m too much inside.
//! - Its spread comes out as σ² (1 - 4 s) - (ε + ε) d².
//!
//! The last line, for both rims, gives σ; the others then say by how much the rims are to be grown.
//! σ contains the pixels' own width, as the spread does.

use fearless_simd::Simd;
use fearless_simd_macros::simd;

use crate::{
    ellipse::{Ellipse, Moments, Shape},
    marker::{belt::WIDE_PX, oval::Rim, thin::Depths, weigh::Grey},
};

/// Deviation of the blurred edge, pixels, where the measured one is out of this range: pixels behind a
/// sharp lens have the least.
const BLUR_LIMITS_PX: (f64, f64) = (0.4, 1.7);
/// Least distance from a rim of levels that are unmixed, pixels.
const LEAST_DISTANCE_PX: f64 = 0.5;
/// Largest share of the other level that a level is taken to hold.
const MOST_MIXED: f64 = 0.3;
/// Turns in which σ and what it mixes are found.
const TURNS: usize = 2;

/// How far from a rim grey levels count, inside and outside, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cuts {
    pub inside_px: f64,
    pub outside_px: f64,
}

/// A rim as weighed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighed {
    pub shape: Shape,
    pub rim: Ellipse,
    pub cuts: Cuts,
}

impl Weighed {
    /// From the weighted sums over pixels counted from `origin`; `None` if they are those of no shape.
    #[inline(always)]
    pub fn new(sums: &Moments, origin: (usize, usize), cuts: Cuts) -> Option<Self> {
        let shape = sums.shape(origin)?;
        Some(Self { shape, rim: shape.ellipse(), cuts })
    }

    /// With its matrix.
    pub fn oval(&self) -> Rim {
        Rim { ellipse: self.rim, matrix: self.shape.matrix_of(&self.rim) }
    }
}

/// A level, and how far from a rim it is taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Taken {
    pub level: f64,
    /// Number of pixels.
    pub pixels: u32,
    pub distance_px: f64,
}

impl Taken {
    pub fn new(grey: Grey, distance_px: f64) -> Self {
        Self { level: grey.mean(), pixels: grey.pixels, distance_px }
    }
}

/// Levels and rims without the blur.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unblurred {
    pub outer: Ellipse,
    pub inner: Ellipse,
    pub black: f64,
    pub white: f64,
}

/// Undoes the blur. `margin` is `None` where the margin is taken to be as white as the disc.
///
/// `thin` has the black's pixels of a ring whose blur reaches all of them.
#[simd]
pub(crate) fn unblur<S: Simd>(
    simd: S,
    (outer, inner): (&Weighed, &Weighed),
    (black, white, margin): (&Taken, &Taken, Option<&Taken>),
    thin: Option<&Depths>,
) -> Unblurred {
    let (r_o, r_i) = (rim_radius_px(&outer.rim), rim_radius_px(&inner.rim));
    let spreads = (outer.shape.spread_px2_of(&outer.rim), inner.shape.spread_px2_of(&inner.rim));
    let mut spread_px2 = spreads.1;
    let mut mixed = Mixed::default();
    let mut grown_px = (0.0, 0.0);
    for _ in 0..TURNS {
        let blur = Blur::new(spread_px2);
        let black_share = match thin {
            Some(depths) => {
                let level = Depths::level(simd, depths, white.level, grown_px, blur.deviation_px);
                let share = (black.level - level) / (white.level - level);
                Some(share.clamp(-MOST_MIXED, MOST_MIXED))
            }
            None => None,
        };
        mixed = Mixed::new((r_o, r_i), (black, white, margin), black_share, &blur);
        // Weights are shares of the contrast as measured.
        let scale = 1.0 / (1.0 - mixed.white - mixed.black);
        let weighed = |share: f64| scale * share;
        let width_px = r_o + grown_px.0 - r_i - grown_px.1;
        let (of_outer, of_inner) = (
            Edge {
                radius_px: r_o,
                cuts: &outer.cuts,
                mixed: (weighed(mixed.black), weighed(mixed.margin)),
            },
            Edge {
                radius_px: r_i,
                cuts: &inner.cuts,
                mixed: (weighed(mixed.white), weighed(mixed.black)),
            },
        );
        let leaks = match thin {
            Some(_) => (
                Leak::new(r_i, width_px - outer.cuts.inside_px, outer.cuts.inside_px, &blur),
                Leak::new(-r_o, width_px - inner.cuts.outside_px, inner.cuts.outside_px, &blur),
            ),
            None => Default::default(),
        };
        let seen =
            (of_outer.seen(spreads.0, &leaks.0, &blur), of_inner.seen(spreads.1, &leaks.1, &blur));
        grown_px = (of_outer.growth_px(&leaks.0, &blur), of_inner.growth_px(&leaks.1, &blur));
        // Without a margin, something else is in the outer one.
        spread_px2 = if margin.is_some() { 0.5 * (seen.0 + seen.1) } else { seen.1 };
    }
    let contrast = (white.level - black.level) / (1.0 - mixed.white - mixed.black);
    Unblurred {
        outer: outer.rim.grown(grown_px.0),
        inner: inner.rim.grown(grown_px.1),
        black: black.level - mixed.black * contrast,
        white: white.level + mixed.white * contrast,
    }
}

/// Radius of the circle whose circumference is about the rim's.
#[inline(always)]
fn rim_radius_px(rim: &Ellipse) -> f64 {
    let (a, b) = (rim.semi_major_px, rim.semi_minor_px);
    (0.5 * (a * a + b * b)).sqrt()
}

/// Shares of the contrast by which the levels are off.
#[derive(Clone, Copy, Debug, Default)]
struct Mixed {
    black: f64,
    white: f64,
    margin: f64,
}

impl Mixed {
    #[inline(always)]
    fn new(
        (r_o, r_i): (f64, f64),
        (black, white, margin): (&Taken, &Taken, Option<&Taken>),
        black_share: Option<f64>,
        blur: &Blur,
    ) -> Self {
        let share = |taken: &Taken, radius_px: f64| {
            // So near to the edge, levels tell more of how a camera sharpens than of its blur.
            if taken.distance_px < LEAST_DISTANCE_PX {
                return 0.0;
            }
            let moved_px = blur.beyond(taken.distance_px).moved_px;
            let share = std::f64::consts::TAU * radius_px.max(0.0) * moved_px;
            (share / f64::from(taken.pixels)).min(MOST_MIXED)
        };
        // Both rims give light to the black, one from each side.
        let of_black = black_share.unwrap_or_else(|| share(black, r_o + r_i));
        let of_white = share(white, r_i - white.distance_px);
        let of_margin = margin.map_or(of_white, |margin| share(margin, r_o + margin.distance_px));
        Self { black: of_black, white: of_white, margin: of_margin }
    }
}

/// Light of the other rim in a rim's belt, where the black is thin.
#[derive(Clone, Copy, Debug, Default)]
struct Leak {
    /// What it adds to the area over 2π, px².
    area: f64,
    /// What it adds to σ².
    spread_px2: f64,
}

impl Leak {
    /// From a rim of this radius, negative if the black is inside of it, to a belt that begins so far
    /// from it, and reaches so far into the black.
    fn new(radius_px: f64, distance_px: f64, reach_px: f64, blur: &Blur) -> Self {
        let moved_px = blur.beyond(distance_px).moved_px;
        Self {
            // Of the disc's light the roundel's weights lose what the disc's own would gain.
            area: -(radius_px + distance_px) * moved_px,
            spread_px2: 2.0 * reach_px * moved_px,
        }
    }
}

/// A rim, its belt, and the shares by which the levels (inside, outside) are off.
#[derive(Clone, Copy, Debug)]
struct Edge<'a> {
    radius_px: f64,
    cuts: &'a Cuts,
    mixed: (f64, f64),
}

impl Edge<'_> {
    /// σ² from the spread between the cuts.
    #[inline(always)]
    fn seen(&self, spread_px2: f64, leak: &Leak, blur: &Blur) -> f64 {
        let (near, far) = (self.cuts.inside_px, self.cuts.outside_px);
        let (inside, outside) = self.mixed;
        let beyond = blur.beyond(near).spread + blur.beyond(far).spread;
        let spread_px2 = spread_px2 - leak.spread_px2;
        (spread_px2 + inside * near * near + outside * far * far) / (1.0 - 2.0 * beyond).max(0.3)
    }

    /// What the rim is to be grown by.
    #[inline(always)]
    fn growth_px(&self, leak: &Leak, blur: &Blur) -> f64 {
        let (near, far) = (self.cuts.inside_px, self.cuts.outside_px);
        let (inside, outside) = self.mixed;
        let r = self.radius_px;
        let outer = (r + far) * blur.beyond(far).moved_px;
        let inner = (r - near) * blur.beyond(near).moved_px;
        let levels = outside * (r + 0.5 * far) * far - inside * (r - 0.5 * near) * near;
        (outer - inner + levels - leak.area) / r
    }
}

/// A blur, with what it carries past the cut that most rims have.
#[derive(Clone, Copy, Debug)]
struct Blur {
    deviation_px: f64,
    wide: Beyond,
}

impl Blur {
    #[inline(always)]
    fn new(spread_px2: f64) -> Self {
        let deviation_px = spread_px2.max(0.0).sqrt().clamp(BLUR_LIMITS_PX.0, BLUR_LIMITS_PX.1);
        Self { deviation_px, wide: Beyond::new(WIDE_PX, deviation_px) }
    }

    #[inline(always)]
    fn beyond(&self, distance_px: f64) -> Beyond {
        if distance_px == WIDE_PX { self.wide } else { Beyond::new(distance_px, self.deviation_px) }
    }
}

/// What of an edge's light lies beyond a cut parallel to it.
#[derive(Clone, Copy, Debug)]
struct Beyond {
    /// ∫ Φ(-x/σ) dx, pixels.
    moved_px: f64,
    /// ∫ x Φ(-x/σ) dx / σ²; 1/4 for a cut on the edge.
    spread: f64,
}

impl Beyond {
    #[inline(always)]
    fn density(z: f64) -> f64 {
        (-0.5 * z * z).exp() * FRAC_1_SQRT_TAU
    }

    #[inline(always)]
    fn new(distance_px: f64, blur_px: f64) -> Self {
        let z = distance_px / blur_px;
        let density = Self::density(z);
        let tail = upper_tail(z.abs(), density);
        let tail = if z < 0.0 { 1.0 - tail } else { tail };
        Self {
            moved_px: (blur_px * (density - z * tail)).max(0.0),
            spread: 0.5 * ((1.0 - z * z) * tail + z * density).max(0.0),
        }
    }
}

/// 1/√(2π).
const FRAC_1_SQRT_TAU: f64 = 0.398_942_280_401_432_7;

/// Φ(-z) for z ≥ 0, given φ(z), to 1e-5 (Abramowitz and Stegun, 26.2.16).
#[inline(always)]
fn upper_tail(z: f64, density: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.33267 * z);
    density * t * (0.436_183_6 + t * (-0.120_167_6 + t * 0.937_298_0))
}

/// φ(z).
pub(crate) fn normal_density(z: f64) -> f64 {
    Beyond::density(z)
}

/// Φ(z), to 1e-5.
pub(crate) fn normal_share(z: f64) -> f64 {
    let tail = upper_tail(z.abs(), Beyond::density(z));
    if z < 0.0 { tail } else { 1.0 - tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Σ of `value` over the half line from `from`, by the midpoint rule.
    fn integral(from: f64, value: impl Fn(f64) -> f64) -> f64 {
        (0..20_000).map(|i| value(from + (f64::from(i) + 0.5) * 5e-4) * 5e-4).sum()
    }

    #[test]
    fn closed_forms_equal_their_integrals() {
        let blur_px = 0.8f64;
        let beyond = |x: f64| Beyond::new(x, blur_px);
        // Φ(-x/σ) is the slope of what lies beyond x.
        let tail = |x: f64| (beyond(x - 1e-4).moved_px - beyond(x + 1e-4).moved_px) / 2e-4;
        for distance_px in [0.1, 0.4, 1.3, 2.5] {
            let moved = integral(distance_px, tail);
            assert!((beyond(distance_px).moved_px - moved).abs() < 1e-4, "{distance_px}");
            let spread = integral(distance_px, |x| x * tail(x)) / blur_px.powi(2);
            assert!((beyond(distance_px).spread - spread).abs() < 1e-3, "{distance_px}");
        }
        assert!((beyond(0.0).spread - 0.25).abs() < 1e-4);
        assert!((upper_tail(1.0, Beyond::density(1.0)) - 0.158_655).abs() < 2e-5);
    }
}
