//! Rims without blur, with the tests they must pass, and their kinds; one ring per lane.

use crate::{
    marker::{
        batch::{
            shapes::{LaneEllipse, Levels, RimRows, Shape, read},
            table::{Row, Table},
        },
        classify::{
            compensation::shift_px,
            plain::{SHIFT_PX, SHIFT_SHARE},
        },
        kind::{Kind, Pattern, Polarity},
        ring::{
            checks::{
                CENTER_TOLERANCE, LEVEL_TOLERANCE, MAX_SPREAD_PX2, ROUNDNESS_TOLERANCE,
                SIMILARITY_TOLERANCE,
            },
            probe::Rules,
            subpixel::{EDGE_PX, blur::BlurCorrection, levels::gradient},
        },
    },
    simd::Lane,
};
/// The rims of rings, with their levels and kinds.
pub(super) struct Rims<T: Lane> {
    /// The lanes that passed all tests.
    pub valid: T::Mask,
    /// Outer and inner rim without blur.
    pub raw: [LaneEllipse<T>; 2],
    /// The rims compensated for the kind.
    pub compensated: [LaneEllipse<T>; 2],
    pub kind: T,
    pub black: T,
    pub white: T,
    /// Contrast before the blur was removed.
    pub contrast: T,
    /// Centre and matrix of the outer rim before the blur was removed.
    pub edge: [T; 5],
}

impl<T: Lane> Rims<T> {
    #[inline(always)]
    pub fn of(
        zero: T,
        table: &Table,
        size: (usize, usize),
        (rules, kinds): (&Rules, &[Kind]),
    ) -> Self {
        let levels = Levels::of(zero, table);
        let (black, white, margin) = (&levels.black, &levels.white, &levels.margin);
        let contrast = white.level - black.level;
        let of_outer = RimRows { band: Row::OuterBand, reach: Row::OuterReach, ellipses: (2, 3) };
        let of_inner = RimRows { band: Row::InnerBand, reach: Row::InnerReach, ellipses: (0, 1) };
        let outer = Shape::of(table, &of_outer, (margin.level, black.level));
        let inner = Shape::of(table, &of_inner, (black.level, white.level));
        let (outer_spread, inner_spread) = (outer.spread(), inner.spread());
        let correction =
            BlurCorrection::of_wide((&outer_spread, &inner_spread), (black, white, Some(margin)));
        let (black, white) = correction.levels(black.level, white.level);

        let spreads = (outer_spread.spread_px2, inner_spread.spread_px2);
        let good = zero.splat(rules.min_contrast).at_most(contrast)
            & levels.valid
            & outer.valid
            & inner.valid
            & are_levels(black, white, rules)
            & are_shapes(&outer, &inner, spreads, rules)
            & is_within(size, &outer);
        let radii = ((outer.rim.a * outer.rim.b).root(), (inner.rim.a * inner.rim.b).root());
        let along = gradient(levels.slopes, radii);
        let raw = [
            moved(&outer, radii.0, -contrast, along).grown(correction.grown_px.0),
            moved(&inner, radii.1, contrast, along).grown(correction.grown_px.1),
        ];
        let is_white = read(zero, table, Row::IsWhite, 0);
        let nearest = Nearest::of(&raw, is_white, kinds);
        let compensated = [
            LaneEllipse {
                a: raw[0].a + nearest.shift_px,
                b: raw[0].b + nearest.shift_px,
                ..raw[0]
            },
            LaneEllipse {
                a: raw[1].a - nearest.shift_px,
                b: raw[1].b - nearest.shift_px,
                ..raw[1]
            },
        ];
        let [uu, uv, vv] = outer.matrix;
        Self {
            valid: good & nearest.valid & are_rims(&compensated),
            raw,
            compensated,
            kind: nearest.kind,
            black,
            white,
            contrast,
            edge: [outer.rim.u, outer.rim.v, uu, uv, vv],
        }
    }
}

/// Removes the shift by the lighting gradient, as
/// [`crate::marker::ring::subpixel::levels::Levels::movement`].
#[inline(always)]
fn moved<T: Lane>(shape: &Shape<T>, radius_px: T, contrast: T, along: (T, T)) -> LaneEllipse<T> {
    let scale = shape.band * radius_px / (contrast * shape.area_px2);
    let rim = shape.rim;
    LaneEllipse {
        u: rim.u - scale * shape.matrix[0].root() * along.0,
        v: rim.v - scale * shape.matrix[2].root() * along.1,
        ..rim
    }
}

/// [`crate::marker::ring::checks::check_levels`].
#[inline(always)]
fn are_levels<T: Lane>(black: T, white: T, rules: &Rules) -> T::Mask {
    let contrast = white - black;
    let beyond = contrast * LEVEL_TOLERANCE.0 + LEVEL_TOLERANCE.1;
    contrast.splat(rules.min_contrast).at_most(contrast)
        & (-beyond).at_most(black)
        & white.at_most(beyond + 255.0)
}

/// [`crate::marker::ring::checks::check_shapes`], without the allowance for perspective.
#[inline(always)]
fn are_shapes<T: Lane>(
    outer: &Shape<T>,
    inner: &Shape<T>,
    spreads_px2: (T, T),
    rules: &Rules,
) -> T::Mask {
    let (o, i) = (&outer.rim, &inner.rim);
    let is_large = o.b.splat(rules.min_semi_minor_px).at_most(o.b);
    let is_tilted_little = (o.a * rules.min_axis_ratio).at_most(o.b);
    let (du, dv) = (o.u - i.u, o.v - i.v);
    let tolerance = (o.a * o.b).root() * CENTER_TOLERANCE.0 + CENTER_TOLERANCE.1;
    let is_concentric = (du * du + dv * dv).at_most(tolerance * tolerance);
    // Both scaled to determinant 1.
    let (of_outer, of_inner) = ((o.a * o.b).under(1.0), (i.a * i.b).under(1.0));
    let (m, n) = (&outer.matrix, &inner.matrix);
    let along = ((m[0] - m[2]) * of_outer - (n[0] - n[2]) * of_inner) * 0.5;
    let askew = m[1] * of_outer - n[1] * of_inner;
    let (share, rim_px) = SIMILARITY_TOLERANCE;
    let tolerance = (i.b.under(rim_px) + share) * (o.a / o.b);
    let is_similar = (along * along + askew * askew).at_most(tolerance * tolerance);
    is_large
        & is_tilted_little
        & is_concentric
        & is_similar
        & is_round(o, spreads_px2.0)
        & is_round(i, spreads_px2.1)
}

/// Eq. (5), with blur.
#[inline(always)]
fn is_round<T: Lane>(rim: &LaneEllipse<T>, spread_px2: T) -> T::Mask {
    let tolerance = rim.b.under(ROUNDNESS_TOLERANCE.1) + ROUNDNESS_TOLERANCE.0;
    let share = ((rim.a * rim.a).under(1.0) + (rim.b * rim.b).under(1.0)) * 2.0;
    (-tolerance).at_most(spread_px2 * share)
        & ((spread_px2 - MAX_SPREAD_PX2) * share).at_most(tolerance)
}

/// Whether the rim is far enough from the frame's edge.
#[inline(always)]
fn is_within<T: Lane>((width, height): (usize, usize), shape: &Shape<T>) -> T::Mask {
    let (u, v) = (shape.rim.u, shape.rim.v);
    let (half_u, half_v) = (shape.matrix[0].root() + EDGE_PX, shape.matrix[2].root() + EDGE_PX);
    half_u.at_most(u)
        & half_v.at_most(v)
        & (u + half_u).at_most(u.splat((width - 1) as f64))
        & (v + half_v).at_most(v.splat((height - 1) as f64))
}

/// Whether both are ellipses, the second one smaller.
#[inline(always)]
fn are_rims<T: Lane>([outer, inner]: &[LaneEllipse<T>; 2]) -> T::Mask {
    is_rim(outer) & is_rim(inner) & inner.a.below(outer.a) & inner.b.below(outer.b)
}

/// Whether it is an ellipse; its centre is known to lie in the frame.
#[inline(always)]
fn is_rim<T: Lane>(rim: &LaneEllipse<T>) -> T::Mask {
    // NaN does not equal itself.
    rim.b.is_positive() & rim.b.at_most(rim.a) & rim.angle_rad.at_most(rim.angle_rad)
}

/// The kinds closest to the rims, as [`crate::marker::classify::plain::nearest_kind`].
struct Nearest<T: Lane> {
    kind: T,
    shift_px: T,
    valid: T::Mask,
}

impl<T: Lane> Nearest<T> {
    #[inline(always)]
    fn of([outer, inner]: &[LaneEllipse<T>; 2], is_white: T, kinds: &[Kind]) -> Self {
        let limit_px = (outer.a * outer.b).root() * SHIFT_SHARE + SHIFT_PX;
        let far = limit_px.splat(f64::INFINITY);
        let mut nearest = Self { kind: far, shift_px: far, valid: far.below(far) };
        for (index, kind) in kinds.iter().enumerate() {
            if !matches!(kind.pattern, Pattern::Plain) {
                continue;
            }
            let (shift_px, is_one) = shift_px([outer.a, outer.b], [inner.a, inner.b], kind.ratio());
            let of_white = is_white.splat(0.5).below(is_white);
            let is_same = if kind.polarity == Polarity::WhiteRing { of_white } else { !of_white };
            let is_nearer = shift_px.size().below(nearest.shift_px.size())
                & shift_px.size().at_most(limit_px)
                & is_one
                & is_same;
            nearest.kind = T::choose(is_nearer, far.splat(index as f64), nearest.kind);
            nearest.shift_px = T::choose(is_nearer, shift_px, nearest.shift_px);
            nearest.valid = nearest.valid | is_nearer;
        }
        nearest
    }
}
