//! Rims without blur, with the tests they must pass, and their kinds; one ring per lane.

use crate::{
    marker::{
        batch::table::{RimRows, Row, Table},
        classify::plain::NearestKind,
        kind::Kind,
        ring::{
            checks::{ShapeTests, are_levels, is_inside},
            pixels::edge_band::WIDE_PX,
            probe::Rules,
            subpixel::{
                blur::BlurCorrection,
                levels::{LevelSamples, Levels},
            },
            weighed_rim::{LaneEllipse, WeighedRim},
        },
    },
    simd::Lane,
};

/// The rims of rings, with their levels and kinds.
pub(super) struct Rims<T: Lane> {
    /// The lanes that passed all tests.
    pub valid: T::Mask,
    /// Outer rim before the blur was removed.
    pub weighed: WeighedRim<T>,
    /// Contrast before the blur was removed.
    pub contrast: T,
    /// Outer and inner rim without blur.
    pub raw: [LaneEllipse<T>; 2],
    /// The rims compensated for the kind.
    pub compensated: [LaneEllipse<T>; 2],
    /// Their shift.
    pub shift_px: T,
    pub kind: T,
    pub black: T,
    pub white: T,
}

impl<T: Lane> Rims<T> {
    /// As many lanes as `zero` has; `size` is that of the frame.
    #[inline(always)]
    pub fn new(
        zero: T,
        table: &Table,
        size: (usize, usize),
        rules: &Rules,
        kinds: &[Kind],
    ) -> Self {
        let levels = Levels::new(&table.part_sums(zero), WIDE_PX, WIDE_PX);
        let Levels { black, white, margin, .. } = levels;
        let contrast = white.level - black.level;
        let (outer, outer_band) = table.weighed_rim(RimRows::OUTER, (margin.level, black.level));
        let (inner, inner_band) = table.weighed_rim(RimRows::INNER, (black.level, white.level));
        let samples = LevelSamples { black, white, margin: Some(margin) };
        let correction = BlurCorrection::of_wide(&outer.spread(), &inner.spread(), &samples);
        let (black, white) = correction.levels(black.level, white.level);
        let is_ring = zero.splat(rules.min_contrast).at_most(contrast)
            & levels.is_margin
            & outer.valid
            & inner.valid
            & are_levels(black, white, rules)
            & ShapeTests::new(&outer, &inner, rules).all()
            & is_inside(size, &outer);
        let moved = levels.movement((&outer, outer_band), (&inner, inner_band));
        let (grown_outer, grown_inner) = correction.grown_px;
        let raw = [
            displaced(&outer.rim, moved[0]).grown(grown_outer),
            displaced(&inner.rim, moved[1]).grown(grown_inner),
        ];
        let is_white = table.read(zero, Row::IsWhite, 0).is_positive();
        let [outer_px, inner_px] = [[raw[0].a, raw[0].b], [raw[1].a, raw[1].b]];
        let nearest = NearestKind::new(outer_px, inner_px, is_white, kinds);
        let by_px = nearest.shift_px;
        let compensated = [
            LaneEllipse { a: raw[0].a + by_px, b: raw[0].b + by_px, ..raw[0] },
            LaneEllipse { a: raw[1].a - by_px, b: raw[1].b - by_px, ..raw[1] },
        ];
        Self {
            valid: is_ring & nearest.valid & are_rims(&compensated),
            weighed: outer,
            contrast,
            raw,
            compensated,
            shift_px: nearest.shift_px,
            kind: nearest.kind,
            black,
            white,
        }
    }
}

#[inline(always)]
fn displaced<T: Lane>(rim: &LaneEllipse<T>, (du, dv): (T, T)) -> LaneEllipse<T> {
    LaneEllipse { u: rim.u - du, v: rim.v - dv, ..*rim }
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
