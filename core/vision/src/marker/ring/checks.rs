//! Tests of a ring, cheapest first (paper, sections 3.1 and 3.3, algorithm 2): sizes and
//! areas of the segments, then the shapes of disc and roundel as weighed by grey levels
//! ([`crate::marker::ring::subpixel::moments`]): against their boxes, concentricity, roundness, similarity.
//!
//! Eq. (1) derives the pixels of an elliptic ring from its box, s = π/4 b_u b_v (d_o² - d_i²)/d_o².
//! That holds if an axis of the ellipse is along u; at 45°, the box of a ring tilted by 60° is 5/4 times as large.
//! With the correlation c of u and v over the segment,
//!
//!   s = π/4 b_u b_v √(1 - c²) (1 - d_i²/d_o²),   c² = C_uv² / (C_uu C_vv)
//!
//! holds for every angle (the box of the ellipse with the matrix M has the half sides √M_uu, √M_vv,
//! its area is π √det M). The tests below use this form.
//!
//! Eq. (5) compares the number of pixels with the area of the moments' ellipse. It holds for filled
//! ellipses, so s and the moments are those of black and white together: the moments of the ring
//! alone would be those of an ellipse √(1 + d_i²/d_o²) times as large. Weighed moments include the blur,
//! so the test allows for as much of it as a camera may have.

use crate::{
    marker::{
        reject::Reject,
        ring::{
            pixels::segments::SegmentSize,
            probe::Rules,
            weighed_rim::{LaneEllipse, WeighedRim},
        },
    },
    simd::Lane,
};

/// Relative tolerance ρ_tol of eq. (2), plus a pixel of each side of the box.
const BOX_TOLERANCE: f64 = 0.15;
/// Relative tolerance ρ_prec of eq. (5), and its increase for a rim of r pixels as 1/r.
const ROUNDNESS_TOLERANCE: (f64, f64) = (0.02, 0.6);
/// Distance of the centres: a share of the outer mean radius, plus pixels.
const CENTER_TOLERANCE: (f64, f64) = (0.06, 0.4);
/// Perspective moves the centres apart along the shorter axis, inversely to the focal length; the
/// shortest focal length allowed for, pixels …
const MIN_FOCAL_PX: f64 = 350.0;
/// … and, far from the image's middle, this share of it along the longer axis.
const ASIDE_SHARE: f64 = 0.4;
/// Difference of the two normalized shapes, and its increase for a disc of r pixels as 1/r. The
/// maximum of 1,600 rendered rings from 10 px on is two thirds of it.
const SIMILARITY_TOLERANCE: (f64, f64) = (0.06, 0.3);
/// Largest variance that blur and pixel width add to a shape, px²: a blur of 1.2 px.
pub(crate) const MAX_SPREAD_PX2: f64 = 1.5;
/// Error of a rim at any threshold, pixels, in the ratio of diameters.
const RATIO_RIM_PX: f64 = 1.6;

/// Smallest distance of the outer rim from the frame's edge, pixels.
const EDGE_PX: f64 = 1.0;

/// Tolerance of levels beyond the range of a pixel: a share of the contrast, plus grey levels.
const LEVEL_TOLERANCE: (f64, f64) = (0.1, 10.0);

impl SegmentSize {
    /// Pixels of a segment as a share of those of an ellipse in its box, eqs. (1) and (2) corrected
    /// for the angle: 1 for a disc, 1 - d_i²/d_o² for a ring.
    fn box_share(&self, [uu, uv, vv]: [f64; 3]) -> f64 {
        let upright = ((uu * vv - uv * uv) / (uu * vv)).sqrt();
        self.pixels / (std::f64::consts::FRAC_PI_4 * self.width * self.height * upright)
    }

    fn box_tolerance(&self) -> f64 {
        BOX_TOLERANCE + 1.0 / self.width + 1.0 / self.height
    }
}

/// Tests the black segment's size and the ratio of the segments' areas, which gives that of the
/// diameters (algorithm 2).
pub(crate) fn check_sizes(
    black: &SegmentSize,
    white: &SegmentSize,
    rules: &Rules,
) -> Result<(), Reject> {
    let smallest_side = 2.0 * rules.min_semi_minor_px - 1.0;
    if black.width.min(black.height) < smallest_side {
        return Err(Reject::TooSmall);
    }
    let (black, white) = (black.pixels, white.pixels);
    let ratio = (white / (white + black)).sqrt();
    let radius_px = ((white + black) * std::f64::consts::FRAC_1_PI).sqrt();
    let slack = RATIO_RIM_PX / radius_px;
    let (min, max) = rules.ratios;
    if ratio < min - slack || ratio > max + slack { Err(Reject::AreaRatio) } else { Ok(()) }
}

/// Tests the black segment against its box, eqs. (1), (2).
pub(crate) fn check_ring_box(
    black: &SegmentSize,
    outer: &WeighedRim,
    rules: &Rules,
) -> Result<(), Reject> {
    let filled = black.box_share(outer.covariance);
    let tolerance = black.box_tolerance();
    let (max, min) = (1.0 - rules.ratios.0.powi(2), 1.0 - rules.ratios.1.powi(2));
    let is_filled = (min * (1.0 - tolerance)..=max * (1.0 + tolerance)).contains(&filled);
    if is_filled { Ok(()) } else { Err(Reject::BlackBox) }
}

/// Tests the disc against its box, eq. (2).
pub(crate) fn check_disc_box(white: &SegmentSize, inner: &WeighedRim) -> Result<(), Reject> {
    let filled = white.box_share(inner.covariance);
    if (filled - 1.0).abs() > white.box_tolerance() { Err(Reject::WhiteBox) } else { Ok(()) }
}

/// The tests of the shapes of both rims, one ring per lane.
pub(crate) struct ShapeTests<T: Lane> {
    is_large: T::Mask,
    is_upright: T::Mask,
    /// Without the allowance for perspective.
    is_concentric: T::Mask,
    is_round: T::Mask,
    is_similar: T::Mask,
}

impl<T: Lane> ShapeTests<T> {
    #[inline(always)]
    pub fn new(outer: &WeighedRim<T>, inner: &WeighedRim<T>, rules: &Rules) -> Self {
        let (o, i) = (&outer.rim, &inner.rim);
        let (du, dv) = (o.u - i.u, o.v - i.v);
        let tolerance = center_tolerance_px(o);
        Self {
            is_large: o.b.splat(rules.min_semi_minor_px).at_most(o.b),
            is_upright: (o.a * rules.min_axis_ratio).at_most(o.b),
            is_concentric: (du * du + dv * dv).at_most(tolerance * tolerance),
            is_round: is_round(outer, rules) & is_round(inner, rules),
            is_similar: are_similar(outer, inner),
        }
    }

    /// The lanes that pass all tests.
    #[inline(always)]
    pub fn all(&self) -> T::Mask {
        self.is_large & self.is_upright & self.is_concentric & self.is_round & self.is_similar
    }
}

/// Tests size, tilt, concentricity, eq. (5) and similarity. Returns whether the shapes are similar,
/// where they need not be.
#[inline(always)]
pub(crate) fn check_shapes(
    outer: &WeighedRim,
    inner: &WeighedRim,
    rules: &Rules,
) -> Result<bool, Reject> {
    let tests = ShapeTests::new(outer, inner, rules);
    if !tests.is_large {
        Err(Reject::TooSmall)
    } else if !tests.is_upright {
        Err(Reject::Tilt)
    } else if !tests.is_concentric && !is_concentric_in_perspective(&outer.rim, &inner.rim) {
        Err(Reject::Concentricity)
    } else if !tests.is_round {
        Err(Reject::Roundness)
    } else if rules.similar && !tests.is_similar {
        Err(Reject::Similarity)
    } else {
        Ok(tests.is_similar)
    }
}

/// Whether levels without blur are plausible; other objects than rings may have levels outside of the
/// range of a pixel.
#[inline(always)]
pub(crate) fn are_levels<T: Lane>(black: T, white: T, rules: &Rules) -> T::Mask {
    let contrast = white - black;
    let beyond = contrast * LEVEL_TOLERANCE.0 + LEVEL_TOLERANCE.1;
    contrast.splat(rules.min_contrast).at_most(contrast)
        & (-beyond).at_most(black)
        & white.at_most(beyond + 255.0)
}

/// Whether the rim is far enough from the edge of a frame of this size.
#[inline(always)]
pub(crate) fn is_inside<T: Lane>(
    (width, height): (usize, usize),
    outer: &WeighedRim<T>,
) -> T::Mask {
    let (u, v) = (outer.rim.u, outer.rim.v);
    let (half_u, half_v) = (outer.matrix[0].root() + EDGE_PX, outer.matrix[2].root() + EDGE_PX);
    half_u.at_most(u)
        & half_v.at_most(v)
        & (u + half_u).at_most(u.splat((width - 1) as f64))
        & (v + half_v).at_most(v.splat((height - 1) as f64))
}

#[inline(always)]
fn center_tolerance_px<T: Lane>(outer: &LaneEllipse<T>) -> T {
    outer.mean_radius_px() * CENTER_TOLERANCE.0 + CENTER_TOLERANCE.1
}

/// For a circle with semiaxes a, b, a focal length f and a tilt θ, cos θ = b/a, the centre of the
/// image is (a²/f) sin θ cos θ off the image of the centre, along the shorter axis; for the disc's
/// rim it is less by the square of the ratio of diameters.
fn is_concentric_in_perspective(outer: &LaneEllipse<f64>, inner: &LaneEllipse<f64>) -> bool {
    let (du, dv) = (outer.u - inner.u, outer.v - inner.v);
    let (a, b) = (outer.a, outer.b);
    let ratio2 = inner.a * inner.b / (a * b);
    let perspective_px = (a * a - b * b).sqrt() * b / a * (1.0 - ratio2) * a / MIN_FOCAL_PX;
    let (sin, cos) = outer.angle_rad.sin_cos();
    let (along_major, along_minor) = (du * cos + dv * sin, dv * cos - du * sin);
    let beyond = |px: f64, allowed_px: f64| (px.abs() - allowed_px).max(0.0);
    let along_minor = beyond(along_minor, perspective_px);
    let along_major = beyond(along_major, ASIDE_SHARE * perspective_px);
    along_major.hypot(along_minor) <= center_tolerance_px(outer)
}

/// Eq. (5), with blur: a spread of σ² enlarges an ellipse's moments by `share`.
#[inline(always)]
fn is_round<T: Lane>(weighed: &WeighedRim<T>, rules: &Rules) -> T::Mask {
    let (rim, spread_px2) = (&weighed.rim, weighed.spread().spread_px2);
    let tolerance = rim.b.under(ROUNDNESS_TOLERANCE.1) + ROUNDNESS_TOLERANCE.0;
    let share = ((rim.a * rim.a).under(1.0) + (rim.b * rim.b).under(1.0)) * 2.0;
    (-tolerance).at_most(spread_px2 * share)
        & ((spread_px2 - rules.max_spread_px2) * share).at_most(tolerance)
}

/// Both rims are images of circles in one plane, so they have the same shape except for
/// perspective.
#[inline(always)]
fn are_similar<T: Lane>(outer: &WeighedRim<T>, inner: &WeighedRim<T>) -> T::Mask {
    let (o, i) = (&outer.rim, &inner.rim);
    // Scaled to determinant 1.
    let (of_outer, of_inner) = ((o.a * o.b).under(1.0), (i.a * i.b).under(1.0));
    let (m, n) = (&outer.matrix, &inner.matrix);
    let along = ((m[0] - m[2]) * of_outer - (n[0] - n[2]) * of_inner) * 0.5;
    let askew = m[1] * of_outer - n[1] * of_inner;
    // The flatter an ellipse, the more an error of one pixel changes its normalized matrix.
    let (share, rim_px) = SIMILARITY_TOLERANCE;
    let tolerance = (i.b.under(rim_px) + share) * (o.a / o.b);
    (along * along + askew * askew).at_most(tolerance * tolerance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        camera::PixelPoint,
        ellipse::{Chords, Ellipse, Moments, Shape, Symmetric2, tests::add_run},
        marker::ring::pixels::segment_fill::{Extent, Span},
    };

    /// A black segment and its hole, as pixel centres inside ellipses: their sizes, the shapes of
    /// black and white together and of the hole, and the sums of the black alone.
    fn ring(angle_rad: f64, tilt: f64, ratio: f64) -> ([(SegmentSize, Shape); 2], Moments) {
        let rim = |scale: f64| {
            Chords::new(&Ellipse {
                center: PixelPoint { u: 60.3, v: 59.8 },
                semi_major_px: 50.0 * scale,
                semi_minor_px: 50.0 * scale * tilt,
                angle_rad,
            })
        };
        let (outer, inner) = (rim(1.0), rim(ratio));
        let (mut black, mut white) = (Moments::default(), Moments::default());
        let mut boxes = [Extent { top: 999, bottom: 0, columns: Span { first: 999, end: 0 } }; 2];
        for v in 0..120 {
            let columns = |(from, to): (f64, f64)| (from.ceil(), to.ceil());
            let o = columns(outer.span(f64::from(v)));
            let i = columns(inner.span(f64::from(v)));
            add_run(&mut black, v, o.0, i.0.clamp(o.0, o.1));
            add_run(&mut black, v, i.1.clamp(o.0, o.1), o.1);
            add_run(&mut white, v, i.0, i.1);
            for (extent, (first, end)) in boxes.iter_mut().zip([o, i]) {
                if first < end {
                    extent.columns.first = extent.columns.first.min(first as u32);
                    extent.columns.end = extent.columns.end.max(end as u32);
                    extent.top = extent.top.min(v as usize);
                    extent.bottom = v as usize + 1;
                }
            }
        }
        let mut both = black;
        both.add(&white, 1.0);
        let sized = |pixels: f64, extent: &Extent, sums: &Moments| {
            (SegmentSize::new(pixels as u32, extent), sums.shape((0, 0)).unwrap())
        };
        ([sized(black.n, &boxes[0], &both), sized(white.n, &boxes[1], &white)], black)
    }

    fn entries(matrix: &Symmetric2) -> [f64; 3] {
        [matrix.uu, matrix.uv, matrix.vv]
    }

    #[test]
    fn equation_1_holds_at_every_angle() {
        for step in 0..12 {
            let angle = f64::from(step) * 0.26;
            let ([(black, outer), (white, inner)], _) = ring(angle, 0.5, 0.4);
            let found = black.box_share(entries(&outer.covariance));
            assert!((found - (1.0 - 0.16)).abs() < 0.05, "{angle} {found}");
            let found = white.box_share(entries(&inner.covariance));
            assert!((found - 1.0).abs() < 0.09, "{angle} {found}");
        }
        // The published form is off by a quarter for an ellipse at 45°.
        let ([(black, _), _], _) = ring(std::f64::consts::FRAC_PI_4, 0.5, 0.4);
        let printed = std::f64::consts::FRAC_PI_4 * black.width * black.height * (1.0 - 0.16);
        assert!(printed / black.pixels > 1.2);
    }

    /// π e₀ e₁ / s with the semiaxes of eq. (4), the left side of eq. (5): 1 for an ellipse, above 1
    /// for any other shape. The pixels' own variance 1/12 is added, because the moments are those of
    /// pixel centres.
    fn roundness(shape: &Shape) -> f64 {
        let c = shape.covariance;
        let grown = Symmetric2 { uu: c.uu + 1.0 / 12.0, uv: c.uv, vv: c.vv + 1.0 / 12.0 };
        4.0 * std::f64::consts::PI * grown.determinant().sqrt() / shape.area_px2
    }

    #[test]
    fn equation_5_needs_black_and_white_together() {
        let ([(_, outer), _], black) = ring(0.4, 0.7, 0.5);
        assert!((roundness(&outer) - 1.0).abs() < 0.01);
        // For the ring alone: (1 + r²) / (1 - r²) with r² = 1/4.
        let black = black.shape((0, 0)).unwrap();
        assert!((roundness(&black) - 1.25 / 0.75).abs() < 0.02);
    }
}
