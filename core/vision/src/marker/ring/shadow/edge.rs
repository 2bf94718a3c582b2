//! The line between light and shadow, by the variance that two levels per class explain.
//!
//! For a direction, the samples are sorted into strips along it; running sums then give the explained variance
//! Σ n₁ n₂ (μ₁ - μ₂)² / (n₁ + n₂) over both classes for a line after any strip. Directions are refined by halving
//! their steps. With m the share of the light at a sample, from the levels of its class, the line's offset within its
//! strip follows from Σ m, and the deviation of a blurred edge or penumbra from Σ m (1 - m), whose integral across the edge
//! is σ/√π.

use std::f32::consts::PI;

use crate::{
    frame::{Frame, Window},
    marker::ring::{
        measure::MeasureScratch,
        probe::Probe,
        shadow::samples::{LightSample, MAX_SAMPLES, collect},
    },
    normal_distribution::normal_each,
};

/// Directions of the first turn, over half a circle, and how often their step is halved.
const DIRECTIONS: u16 = 12;
const HALVINGS: usize = 4;
/// Strips of a direction.
const STRIPS: usize = 64;
/// Smallest width of a strip, pixels.
const MIN_STRIP_PX: f32 = 0.5;
/// Smallest number of samples on a side. A class with fewer there has the other class' quotient of levels …
const MIN_COUNT: f32 = 6.0;
/// … if its levels differ by at least this, grey levels.
const MIN_APART: f32 = 6.0;
/// Smallest share of the variance that an edge explains, in the best of the first directions and in the end.
const MIN_EXPLAINED_FIRST: f32 = 0.35;
const MIN_EXPLAINED: f32 = 0.7;
/// Largest and smallest share of the light left in a shadow.
const SHADES: (f32, f32) = (0.3, 0.93);
/// Light and shadow may differ by this factor in how much of it they leave to black and white; stray light and a
/// camera's tone curve do so.
const UNEQUAL: f32 = 1.6;
/// Levels are taken beyond this distance from the line, pixels.
const ASIDE_PX: f32 = 2.0;
/// The edge's deviation is sought within this distance from the line, pixels.
const REACH_PX: f32 = 6.0;
/// Range of the edge's deviation, pixels.
const BLURS_PX: (f32, f32) = (0.5, 3.0);
/// Beyond this many deviations there is light or shadow alone.
const FAR_BLURS: f32 = 3.0;
/// Error that remains in each harmonic of a rim, pixels, per share of the light that is lost; from rendered rings.
const RIM_ERROR_PX: f64 = 0.12;

/// A straight edge between light and shadow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShadowEdge {
    /// A pixel of the frame; the line's distance from it.
    origin: (usize, usize),
    offset_px: f32,
    /// Unit normal, towards the light.
    normal: (f32, f32),
    blur_px: f32,
    light: SideLevels,
    shadow: SideLevels,
}

/// Levels of one side of an edge.
#[derive(Clone, Copy, Debug)]
struct SideLevels {
    dark: f32,
    bright: f32,
}

/// Finds the edge of a shadow across the ring at a probe, whose threshold separates black in the light from white in
/// the shadow. `None` if the ring is evenly lit.
pub(crate) fn find_edge(
    frame: &Frame,
    probe: &Probe,
    scratch: &mut MeasureScratch,
    samples: &mut Vec<LightSample>,
) -> Option<ShadowEdge> {
    if !collect(frame, probe, scratch, samples) {
        return None;
    }
    let found = edge_of(samples, probe.center);
    if found.is_some() {
        return found;
    }
    samples.retain(|sample| !sample.is_margin);
    edge_of(samples, probe.center)
}

fn edge_of(samples: &[LightSample], origin: (usize, usize)) -> Option<ShadowEdge> {
    let total = Split::total_variance(samples)?;
    let mut best = Split::default();
    let mut step_rad = PI / f32::from(DIRECTIONS);
    for direction in 0..DIRECTIONS {
        best = best.better(Split::along(samples, step_rad * f32::from(direction)));
    }
    if best.explained < MIN_EXPLAINED_FIRST * total {
        return None;
    }
    for _ in 0..HALVINGS {
        step_rad *= 0.5;
        let from = best;
        best = best.better(Split::along(samples, from.direction_rad - step_rad));
        best = best.better(Split::along(samples, from.direction_rad + step_rad));
    }
    if best.explained < MIN_EXPLAINED * total {
        return None;
    }
    ShadowEdge::of_split(samples, &best, origin)
}

/// The best line of a direction.
#[derive(Clone, Copy, Debug, Default)]
struct Split {
    /// Σ (level - mean)² less, due to the line.
    explained: f32,
    direction_rad: f32,
    offset_px: f32,
}

#[derive(Clone, Copy, Debug, Default)]
struct LevelSum {
    count: f32,
    sum: f32,
}

impl LevelSum {
    fn add(&mut self, other: LevelSum) {
        self.count += other.count;
        self.sum += other.sum;
    }

    fn mean(self) -> f32 {
        self.sum / self.count
    }

    /// Variance explained by the means of this part and of the rest of `all`.
    fn explained_of(self, all: LevelSum) -> f32 {
        let rest = LevelSum { count: all.count - self.count, sum: all.sum - self.sum };
        if self.count == 0.0 || rest.count == 0.0 {
            return 0.0;
        }
        let apart = self.mean() - rest.mean();
        self.count * rest.count / all.count * apart * apart
    }
}

impl Split {
    fn better(self, other: Split) -> Split {
        if other.explained > self.explained { other } else { self }
    }

    /// Σ (level - mean)² over the classes. `None` if the samples are too few, or too even for a shadow.
    fn total_variance(samples: &[LightSample]) -> Option<f32> {
        let mut classes = [LevelSum::default(); 2];
        for sample in samples {
            classes[usize::from(sample.is_bright)].add(LevelSum { count: 1.0, sum: sample.level });
        }
        if classes[1].count < 2.0 * MIN_COUNT {
            return None;
        }
        let means = classes.map(LevelSum::mean);
        let mut totals = [0.0; 2];
        for sample in samples {
            let class = usize::from(sample.is_bright);
            let off = sample.level - means[class];
            totals[class] += off * off;
        }
        // As if the fewest samples were in the faintest shadow.
        let is_uneven = |class: usize| {
            let faintest = ((1.0 - SHADES.1) * means[class]).max(MIN_APART);
            totals[class] > 0.5 * MIN_COUNT * faintest * faintest
        };
        (is_uneven(0) || is_uneven(1)).then_some(totals[0] + totals[1])
    }

    fn along(samples: &[LightSample], direction_rad: f32) -> Self {
        let (sin, cos) = direction_rad.sin_cos();
        let mut places = [0.0f32; MAX_SAMPLES];
        let (mut from, mut to) = (f32::MAX, f32::MIN);
        for (place, sample) in places.iter_mut().zip(samples) {
            *place = sample.u * cos + sample.v * sin;
            (from, to) = (from.min(*place), to.max(*place));
        }
        let strip_px = ((to - from) / (STRIPS - 1) as f32).max(MIN_STRIP_PX);
        let mut strips = [[LevelSum::default(); 2]; STRIPS];
        let mut all = [LevelSum::default(); 2];
        for (place, sample) in places.iter().zip(samples) {
            let class = usize::from(sample.is_bright);
            let one = LevelSum { count: 1.0, sum: sample.level };
            strips[(((place - from) / strip_px) as usize).min(STRIPS - 1)][class].add(one);
            all[class].add(one);
        }
        let mut best = Self { direction_rad, ..Self::default() };
        let mut before = [LevelSum::default(); 2];
        for (strip, sums) in strips.iter().enumerate() {
            before[0].add(sums[0]);
            before[1].add(sums[1]);
            let count = before[0].count + before[1].count;
            if count < MIN_COUNT || samples.len() as f32 - count < MIN_COUNT {
                continue;
            }
            let explained = before[0].explained_of(all[0]) + before[1].explained_of(all[1]);
            if explained > best.explained {
                let offset_px = from + strip_px * (strip + 1) as f32;
                best = Self { explained, direction_rad, offset_px };
            }
        }
        best
    }
}

impl ShadowEdge {
    fn of_split(samples: &[LightSample], split: &Split, origin: (usize, usize)) -> Option<Self> {
        let (sin, cos) = split.direction_rad.sin_cos();
        let distance = |sample: &LightSample| sample.u * cos + sample.v * sin - split.offset_px;
        // The dark and bright ones before and beyond the line; all of them where few are far enough from it.
        let mut sums = [[LevelSum::default(); 2]; 2];
        let mut all = sums;
        for sample in samples {
            let (side, class) =
                (usize::from(distance(sample) > 0.0), usize::from(sample.is_bright));
            let one = LevelSum { count: 1.0, sum: sample.level };
            all[side][class].add(one);
            if distance(sample).abs() > ASIDE_PX {
                sums[side][class].add(one);
            }
        }
        for side in 0..2 {
            for class in 0..2 {
                if sums[side][class].count < MIN_COUNT {
                    sums[side][class] = all[side][class];
                }
            }
        }
        let [mut dark, mut bright] =
            [0, 1].map(|class| [0, 1].map(|side| sums[side][class].mean()));
        let rare = |class: usize| (0..2).find(|&side| sums[side][class].count < MIN_COUNT);
        match (rare(0), rare(1)) {
            (None, None) => (),
            (Some(side), None) => dark[side] = dark[1 - side] * bright[side] / bright[1 - side],
            (None, Some(side)) if (dark[0] - dark[1]).abs() >= MIN_APART => {
                bright[side] = bright[1 - side] * dark[side] / dark[1 - side];
            }
            _ => return None,
        }
        let lit = usize::from(bright[1] > bright[0]);
        let shade = bright[1 - lit] / bright[lit];
        let levels = |side: usize| SideLevels { dark: dark[side], bright: bright[side] };
        let (light, shadow) = (levels(lit), levels(1 - lit));
        let share = (shadow.bright - shadow.dark) / (light.bright - light.dark);
        // False for NaN, without any dark sample.
        let is_shadow = shade >= SHADES.0
            && shade <= SHADES.1
            && share <= UNEQUAL * shade
            && share >= shade / UNEQUAL
            && light.dark < shadow.bright;
        if !is_shadow {
            return None;
        }
        let sign = if lit == 1 { 1.0 } else { -1.0 };
        let mut edge = Self {
            origin,
            offset_px: sign * split.offset_px,
            normal: (sign * cos, sign * sin),
            blur_px: BLURS_PX.0,
            light,
            shadow,
        };
        edge.refine(samples);
        Some(edge)
    }

    /// Offset and deviation by the shares of light near the line.
    fn refine(&mut self, samples: &[LightSample]) {
        let (mut count, mut surplus, mut mixed) = (0.0f32, 0.0f32, 0.0f32);
        for sample in samples {
            let out_px = self.distance_px(sample.u, sample.v);
            if out_px.abs() > REACH_PX || !sample.is_bright {
                continue;
            }
            let (shadow, light) = (self.shadow.bright, self.light.bright);
            let share = ((sample.level - shadow) / (light - shadow)).clamp(0.0, 1.0);
            count += 1.0;
            surplus += share - if out_px > 0.0 { 1.0 } else { 0.0 };
            mixed += share * (1.0 - share);
        }
        if count >= MIN_COUNT {
            let per_px = count / (2.0 * REACH_PX);
            self.offset_px -= (surplus / per_px).clamp(-ASIDE_PX, ASIDE_PX);
            self.blur_px = (PI.sqrt() * mixed / per_px).clamp(BLURS_PX.0, BLURS_PX.1);
        }
    }

    /// Distance towards the light of a place relative to the origin.
    fn distance_px(&self, u: f32, v: f32) -> f32 {
        u * self.normal.0 + v * self.normal.1 - self.offset_px
    }

    /// The level halfway between black and white in the light.
    pub fn threshold(&self) -> u8 {
        (0.5 * (self.light.dark + self.light.bright)).round().clamp(1.0, 255.0) as u8
    }

    /// A level that separates black from white on both sides.
    pub fn common_threshold(&self) -> u8 {
        (0.5 * (self.light.dark + self.shadow.bright)).round().clamp(1.0, 255.0) as u8
    }

    /// Writes the window of the frame to `evened`, row by row, with the shadow's levels mapped to those of the light.
    pub fn even_out(&self, frame: &Frame, window: &Window, evened: &mut Vec<u8>) {
        evened.clear();
        for v in window.top..window.bottom {
            let row = &frame.row(v)[window.left..window.right];
            let down = v as f32 - self.origin.1 as f32;
            for (u, &grey) in (window.left..).zip(row) {
                let out_px = self.distance_px(u as f32 - self.origin.0 as f32, down);
                let blurs = out_px / self.blur_px;
                evened.push(if blurs > FAR_BLURS {
                    grey
                } else if blurs < -FAR_BLURS {
                    self.lit(grey, 0.0)
                } else {
                    self.lit(grey, normal_each(blurs).1)
                });
            }
        }
    }

    /// Error that remains in each harmonic of the rims, pixels.
    pub fn rim_error_px(&self) -> f64 {
        RIM_ERROR_PX * f64::from(1.0 - self.shadow.bright / self.light.bright)
    }

    /// A level at a place with this share of the light, as it would be in the light.
    fn lit(&self, grey: u8, share: f32) -> u8 {
        let mixed = |shadow: f32, light: f32| shadow + share * (light - shadow);
        let dark = mixed(self.shadow.dark, self.light.dark);
        let bright = mixed(self.shadow.bright, self.light.bright);
        let gain = (self.light.bright - self.light.dark) / (bright - dark);
        (self.light.dark + (f32::from(grey) - dark) * gain).round().clamp(0.0, 255.0) as u8
    }
}
