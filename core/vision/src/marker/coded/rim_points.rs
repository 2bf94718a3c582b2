//! Points along a coded roundel's outer rim: levels near them, and where the half level is crossed.
//!
//! Loops run over whole arrays, so that the compiler vectorizes them.

use std::sync::LazyLock;

use crate::{
    ellipse::Ellipse,
    marker::coded::sampler::{SamplePoints, Sampler},
    normal_distribution::normal_each,
};

/// Points of the outer rim.
pub(super) const POINTS: usize = 48;
/// Distance of the sampled levels of ring and margin from the rim, pixels, smallest and largest,
/// and in between a share of the shorter semiaxis, as the margin may be hardly wider. The same
/// inside and outside, so that the levels are mixed equally and the half level is unaffected.
const LEVEL_PX: (f64, f64) = (1.0, 2.5);
const LEVEL_SHARE: f64 = 0.14;
/// Width of the ring as a share of the radius.
const RING_SHARE: f64 = 0.4;
/// Smallest share of the contrast left by blur between those levels.
const MIN_LEFT: f32 = 0.5;
/// Range of origins, which avoids overflow together with a frame's side.
const MAX_ORIGIN_PX: f64 = 1e6;
/// Smallest slope of an edge, grey levels per pixel.
const MIN_SLOPE: f64 = 1.0;

/// A number for each point.
pub(super) type PerPoint = [f32; POINTS];

/// cos t and sin t of the points, cos 2t and sin 2t.
static HARMONICS: LazyLock<[PerPoint; 4]> = LazyLock::new(|| {
    let turn = |index: usize| std::f64::consts::TAU * index as f64 / POINTS as f64;
    [
        std::array::from_fn(|index| turn(index).cos() as f32),
        std::array::from_fn(|index| turn(index).sin() as f32),
        std::array::from_fn(|index| turn(2 * index).cos() as f32),
        std::array::from_fn(|index| turn(2 * index).sin() as f32),
    ]
});

/// cos t, sin t, cos 2t and sin 2t of the points.
#[inline(always)]
pub(super) fn harmonics() -> &'static [PerPoint; 4] {
    &HARMONICS
}

/// The points of a rim.
pub(super) struct Points {
    /// Pixel of the frame that coordinates are relative to.
    origin: (i32, i32),
    u: PerPoint,
    v: PerPoint,
    /// Outward unit normal.
    normal_u: PerPoint,
    normal_v: PerPoint,
    /// Component of the vector from the centre along the normal, pixels.
    pub height_px: PerPoint,
    /// Inward shift of the half level by blur, over its square: half the curvature.
    pub drawn_per_px: PerPoint,
}

impl Points {
    #[inline(always)]
    pub fn of(ellipse: &Ellipse) -> Self {
        // Anything further away is outside of any frame.
        let whole = |center: f64| center.floor().clamp(-MAX_ORIGIN_PX, MAX_ORIGIN_PX) as i32;
        let origin = (whole(ellipse.center.u), whole(ellipse.center.v));
        let (middle_u, middle_v) = (
            (ellipse.center.u - f64::from(origin.0)) as f32,
            (ellipse.center.v - f64::from(origin.1)) as f32,
        );
        let (sin_tilt, cos_tilt) = ellipse.angle_rad.sin_cos();
        let (sin_tilt, cos_tilt) = (sin_tilt as f32, cos_tilt as f32);
        let (a, b) = (ellipse.semi_major_px as f32, ellipse.semi_minor_px as f32);
        let (per_a, per_b) = (1.0 / a, 1.0 / b);
        let bend = 0.5 * (per_a * per_b) * (per_a * per_b);
        let [mut u, mut v, mut normal_u, mut normal_v] = [[0.0; POINTS]; 4];
        let [mut height_px, mut drawn_per_px] = [[0.0; POINTS]; 2];
        let [cos, sin, ..] = harmonics();
        for index in 0..POINTS {
            let (cos, sin) = (cos[index], sin[index]);
            let (x, y) = (a * cos, b * sin);
            u[index] = middle_u + (x * cos_tilt - y * sin_tilt);
            v[index] = middle_v + (x * sin_tilt + y * cos_tilt);
            let (x, y) = (cos * per_a, sin * per_b);
            let height = 1.0 / (x * x + y * y).sqrt();
            normal_u[index] = (x * cos_tilt - y * sin_tilt) * height;
            normal_v[index] = (x * sin_tilt + y * cos_tilt) * height;
            height_px[index] = height;
            drawn_per_px[index] = bend * height * height * height;
        }
        Self { origin, u, v, normal_u, normal_v, height_px, drawn_per_px }
    }

    /// Levels at these distances outwards of each point.
    #[inline(always)]
    fn levels(&self, sampler: &Sampler, out_px: &PerPoint) -> PerPoint {
        let mut points = SamplePoints { origin: self.origin, u: self.u, v: self.v };
        for (index, out_px) in out_px.iter().enumerate() {
            points.u[index] += out_px * self.normal_u[index];
            points.v[index] += out_px * self.normal_v[index];
        }
        sampler.each(&points)
    }

    /// The level at a distance outwards of one point.
    fn level(&self, sampler: &Sampler, index: usize, out_px: f64) -> f64 {
        let along = |origin: i32, place: &PerPoint, normal: &PerPoint| {
            f64::from(origin) + f64::from(place[index]) + out_px * f64::from(normal[index])
        };
        sampler.at(
            along(self.origin.0, &self.u, &self.normal_u),
            along(self.origin.1, &self.v, &self.normal_v),
        )
    }

    /// Levels of ring and margin, without the mixing by blur.
    #[inline(always)]
    pub fn black_and_white(
        &self,
        sampler: &Sampler,
        semi_minor_px: f64,
        blur_px: f64,
    ) -> (PerPoint, PerPoint) {
        let aside_px = (LEVEL_SHARE * semi_minor_px).clamp(LEVEL_PX.0, LEVEL_PX.1);
        let blacks = self.levels(sampler, &[-aside_px as f32; POINTS]);
        let margins = self.levels(sampler, &[aside_px as f32; POINTS]);
        let (mut pure_blacks, mut pure_margins) = (blacks, margins);
        let (aside_px, blur_px) = (aside_px as f32, blur_px as f32);
        let (to_blurs, ring_share) = (1.0 / blur_px, RING_SHARE as f32);
        let share = |px: f32| normal_each(px * to_blurs).1;
        for index in 0..POINTS {
            let drawn_px = self.drawn_per_px[index] * blur_px * blur_px;
            let height_px = self.height_px[index];
            let to_teeth_px = ring_share * height_px + drawn_px / (1.0 - ring_share) - aside_px;
            // Shares of the light of the margin, of the gaps, and of the black.
            let of_margin = share(drawn_px - aside_px) + 0.5 * share(-to_teeth_px);
            let of_black = share(-drawn_px - aside_px);
            let mixed = margins[index] - blacks[index];
            let contrast = mixed / (1.0 - of_margin - of_black).max(MIN_LEFT);
            pure_blacks[index] -= of_margin * contrast;
            pure_margins[index] += of_black * contrast;
        }
        (pure_blacks, pure_margins)
    }
}

/// Where the levels cross the half level.
pub(super) struct Edges {
    /// Distance outwards of the points.
    pub out_px: PerPoint,
    /// Slope there; 0 without an edge.
    pub slope: PerPoint,
    pub missing: usize,
}

impl Edges {
    /// Within half a pixel; edges that seem more than a pixel away do not count.
    #[inline(always)]
    pub fn near(sampler: &Sampler, points: &Points, half: &PerPoint) -> Self {
        Self::about(sampler, points, half, &[0.0; POINTS], &[true; POINTS], 1.0)
    }

    /// As [`crossing`], at all points at once where the edge is within a pixel.
    #[inline(always)]
    pub fn far(sampler: &Sampler, points: &Points, half: &PerPoint, reach_px: f64) -> Self {
        let here = points.levels(sampler, &[0.0; POINTS]);
        let inside = points.levels(sampler, &[-1.0; POINTS]);
        let outside = points.levels(sampler, &[1.0; POINTS]);
        let (mut out_px, mut is_near) = ([0.0; POINTS], [true; POINTS]);
        for index in 0..POINTS {
            let level = here[index] - half[index];
            let is_inside = level >= 0.0;
            let next = if is_inside { inside[index] } else { outside[index] } - half[index];
            let step = if is_inside { -1.0 } else { 1.0 };
            out_px[index] = step * level / (level - next);
            is_near[index] = (next < 0.0) != (level < 0.0);
        }
        let mut is_seen = [true; POINTS];
        for index in 0..POINTS {
            if !is_near[index] {
                let profile =
                    |out_px: f64| points.level(sampler, index, out_px) - f64::from(half[index]);
                let found = walk_to_crossing(profile, reach_px);
                is_seen[index] = found.is_some();
                out_px[index] = found.unwrap_or_default() as f32;
            }
        }
        Self::about(sampler, points, half, &out_px, &is_seen, f32::INFINITY)
    }

    /// From levels half a pixel to either side of the estimates, at most `max_px` from there.
    #[inline(always)]
    fn about(
        sampler: &Sampler,
        points: &Points,
        half: &PerPoint,
        estimate_px: &PerPoint,
        is_seen: &[bool; POINTS],
        max_px: f32,
    ) -> Self {
        let [mut before, mut after] = [*estimate_px; 2];
        for index in 0..POINTS {
            before[index] -= 0.5;
            after[index] += 0.5;
        }
        let (before, after) = (points.levels(sampler, &before), points.levels(sampler, &after));
        let (mut slope, mut out_px) = ([0.0; POINTS], *estimate_px);
        let mut missing = 0;
        for index in 0..POINTS {
            let (before, after) = (before[index] - half[index], after[index] - half[index]);
            let steep = after - before;
            let beyond = -0.5 * (before + after) / steep;
            let is_edge = is_seen[index] && steep >= MIN_SLOPE as f32 && beyond.abs() <= max_px;
            missing += usize::from(!is_edge);
            slope[index] = if is_edge { steep } else { 0.0 };
            out_px[index] += beyond.clamp(-0.5, 0.5);
        }
        Self { out_px, slope, missing }
    }
}

/// Means over neighbours: less noise, while lighting variations remain.
#[inline(always)]
pub(super) fn smoothed(levels: &PerPoint) -> PerPoint {
    const SIDE: usize = 3;
    let mut round = [0.0; POINTS + 2 * SIDE];
    round[SIDE..SIDE + POINTS].copy_from_slice(levels);
    round[..SIDE].copy_from_slice(&levels[POINTS - SIDE..]);
    round[SIDE + POINTS..].copy_from_slice(&levels[..SIDE]);
    let mut means = [0.0; POINTS];
    for by in 0..=2 * SIDE {
        for (mean, level) in means.iter_mut().zip(&round[by..by + POINTS]) {
            *mean += level / (2 * SIDE + 1) as f32;
        }
    }
    means
}

/// The plane through the levels: keeps lighting variations, without the effect of nearby teeth.
#[inline(always)]
pub(super) fn tilted(levels: &PerPoint) -> PerPoint {
    let [cos, sin, ..] = harmonics();
    let mean = mean(levels) as f32;
    let x = (2.0 * sum(|index| levels[index] * cos[index]) / POINTS as f64) as f32;
    let y = (2.0 * sum(|index| levels[index] * sin[index]) / POINTS as f64) as f32;
    let mut plane = [0.0; POINTS];
    for (index, level) in plane.iter_mut().enumerate() {
        *level = mean + x * cos[index] + y * sin[index];
    }
    plane
}

/// Where a rising profile crosses zero, closest to 0, and its slope; `None` if out of range.
pub(super) fn crossing(profile: impl Fn(f64) -> f64, reach_px: f64) -> Option<(f64, f64)> {
    let place = walk_to_crossing(&profile, reach_px)?;
    // Refined symmetrically.
    let (before, after) = (profile(place - 0.5), profile(place + 0.5));
    let slope = after - before;
    if slope.is_nan() || slope < MIN_SLOPE {
        return None;
    }
    Some((place - (0.5 * (before + after) / slope).clamp(-0.5, 0.5), slope))
}

/// The whole steps from 0 between which it crosses, interpolated linearly.
fn walk_to_crossing(profile: impl Fn(f64) -> f64, reach_px: f64) -> Option<f64> {
    let mut place = 0.0;
    let mut level = profile(0.0);
    let step = if level < 0.0 { 1.0 } else { -1.0 };
    loop {
        let next = profile(place + step);
        if (next < 0.0) != (level < 0.0) {
            return Some(place + step * level / (level - next));
        }
        (place, level) = (place + step, next);
        if place.abs() > reach_px {
            return None;
        }
    }
}

/// Sum over the points, with eight partial sums.
#[inline(always)]
pub(super) fn sum(of: impl Fn(usize) -> f32) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0; LANES];
    for first in (0..POINTS).step_by(LANES) {
        for (lane, sum) in sums.iter_mut().enumerate() {
            *sum += f64::from(of(first + lane));
        }
    }
    sums.iter().sum()
}

#[inline(always)]
pub(super) fn mean(levels: &PerPoint) -> f64 {
    sum(|index| levels[index]) / POINTS as f64
}
