//! A coded roundel's two rims to a fraction of a pixel, from points where the grey level is halfway.
//!
//! Across the outer rim, the place of the level halfway between ring and margin is looked for at points
//! evenly spaced in the ellipse's parameter t. How far outwards of the ellipse they lie, as a share q(t)
//! of its size, has five harmonics that an ellipse can follow:
//! q = α + βₓ cos t + βᵧ sin t + γ cos 2t + η sin 2t, the ellipse's map A becoming A (1 + S) with
//! S = [α+γ η; η α-γ] and its centre moving by A β. The rest of q is how uneven the rim is.
//!
//! The white disc's rim is seen between the teeth alone. There its size and its centre are fitted, its
//! shape being that of the outer rim as the chart carries it.
//!
//! A blur of deviation σ draws the half level of a rim of curvature κ inwards by σ²κ/2; σ is told by
//! the outer rim's slope, (W - B)/(√(2π) σ).

use crate::{
    camera::PixelPoint,
    ellipse::{Ellipse, Symmetric2},
    frame::Frame,
    marker::{
        code::{CodeLayout, chart::Chart},
        reject::Reject,
    },
};

/// Points of the outer rim.
const POINTS: usize = 48;
/// Where ring and margin have their levels, pixels from the rim, and at most as a share of the shorter
/// semiaxis: the ring is 0.4 of it wide, the margin hardly more than 0.15.
const LEVEL_PX: f64 = 2.5;
const LEVEL_SHARE: (f64, f64) = (0.2, 0.14);
/// By turn, how far from the ellipse a point may be, as a share of the shorter semiaxis …
const WALKS: [f64; 4] = [0.35, 0.12, 0.05, 0.02];
/// … and pixels on top.
const WALK_PX: f64 = 1.5;
/// Turns in which the inner one is.
const INNER_TURNS: usize = 2;
/// Points without an edge, of all, at most.
const MOST_MISSING: usize = POINTS / 6;
/// Deviations that the slope of an edge may tell, pixels: pixels and interpolation alone give the
/// first.
const BLURS_PX: (f64, f64) = (0.5, 3.0);

/// The outer rim.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rim {
    pub ellipse: Ellipse,
    /// Level of the ring.
    pub black: f64,
    /// Deviation of the blur as the interpolated picture has it, pixels.
    pub blur_px: f64,
    /// Rms of the levels along the rim about halfway, as a share of the contrast, as
    /// [`crate::marker::Ring::unevenness`].
    pub unevenness: f64,
}

/// Grey levels between pixels; a point outside of the frame is as its edge.
pub(crate) struct Light<'a, 'f> {
    pub frame: &'a Frame<'f>,
    /// A white ring is seen as a black one.
    pub inverted: bool,
}

impl Light<'_, '_> {
    pub fn at(&self, u: f64, v: f64) -> f64 {
        let (width, height) = (self.frame.width(), self.frame.height());
        let (u, v) = (u.clamp(0.0, width as f64 - 1.001), v.clamp(0.0, height as f64 - 1.001));
        let (left, top) = (u as usize, v as usize);
        let (du, dv) = (u - left as f64, v - top as f64);
        let row = |v: usize| {
            let row = self.frame.row(v);
            let (here, next) = (f64::from(row[left]), f64::from(row[(left + 1).min(width - 1)]));
            here + (next - here) * du
        };
        let level = row(top) + (row((top + 1).min(height - 1)) - row(top)) * dv;
        if self.inverted { 255.0 - level } else { level }
    }
}

/// The outer rim near a rough outline; `threshold` parts black from white at first.
pub(crate) fn outer_rim(light: &Light, outline: &Ellipse, threshold: f64) -> Result<Rim, Reject> {
    let mut rim = Rim { ellipse: *outline, black: 0.0, blur_px: 1.0, unevenness: 0.0 };
    for (turn, share) in WALKS.iter().enumerate() {
        let reach_px = WALK_PX + share * rim.ellipse.semi_minor_px;
        rim = fitted(light, &rim, (turn == 0).then_some(threshold), reach_px)?;
    }
    if rim.unevenness > super::measure::MOST_UNEVEN { Err(Reject::Covered) } else { Ok(rim) }
}

/// Where the level of a gap is taken, as a share of the white disc's radius.
const LEVEL_AT: f64 = 0.8;

/// A point of a rim.
#[derive(Clone, Copy, Default)]
struct Point {
    /// cos t, sin t.
    parameter: (f64, f64),
    at: (f64, f64),
    /// Unit normal outwards.
    normal: (f64, f64),
    /// Normal part of the way from the centre.
    height_px: f64,
    curvature_per_px: f64,
}

fn points(ellipse: &Ellipse) -> [Point; POINTS] {
    let (sin_tilt, cos_tilt) = ellipse.angle_rad.sin_cos();
    let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
    let turned = |x: f64, y: f64| (x * cos_tilt - y * sin_tilt, x * sin_tilt + y * cos_tilt);
    std::array::from_fn(|index| {
        let (sin, cos) = (std::f64::consts::TAU * index as f64 / POINTS as f64).sin_cos();
        let offset = turned(a * cos, b * sin);
        let length = (cos / a).hypot(sin / b);
        let normal = turned(cos / (a * length), sin / (b * length));
        Point {
            parameter: (cos, sin),
            at: (ellipse.center.u + offset.0, ellipse.center.v + offset.1),
            normal,
            height_px: 1.0 / length,
            curvature_per_px: a * b / (a * sin).hypot(b * cos).powi(3),
        }
    })
}

/// One turn; the level halfway is `threshold` or what the neighbourhood says.
fn fitted(light: &Light, rim: &Rim, threshold: Option<f64>, reach_px: f64) -> Result<Rim, Reject> {
    let points = points(&rim.ellipse);
    let minor = rim.ellipse.semi_minor_px;
    let level = |point: &Point, out_px: f64| {
        light.at(point.at.0 + out_px * point.normal.0, point.at.1 + out_px * point.normal.1)
    };
    let (inside_px, outside_px) =
        (LEVEL_PX.min(LEVEL_SHARE.0 * minor), LEVEL_PX.min(LEVEL_SHARE.1 * minor).max(1.0));
    let blacks = points.each_ref().map(|point| level(point, -inside_px));
    let margins = points.each_ref().map(|point| level(point, outside_px));
    let mean = |levels: &[f64; POINTS]| levels.iter().sum::<f64>() / POINTS as f64;
    let (black, margin) = (mean(&blacks), mean(&margins));
    let contrast = margin - black;
    if threshold.is_none() && (contrast.is_nan() || contrast < 1.0) {
        return Err(Reject::Contrast);
    }
    let (blacks, margins) = (smoothed(&blacks), smoothed(&margins));
    let (mut shares, mut missing) = ([0.0; POINTS], 0);
    let (mut steep, mut seen) = (0.0, 0);
    for (index, point) in points.iter().enumerate() {
        let half = threshold.unwrap_or(0.5 * (blacks[index] + margins[index]));
        match crossing(|out_px| level(point, out_px) - half, reach_px) {
            Some((out_px, slope)) => {
                let drawn_px = 0.5 * rim.blur_px * rim.blur_px * point.curvature_per_px;
                shares[index] = (out_px + drawn_px) / point.height_px;
                steep += slope;
                seen += 1;
            }
            None => missing += 1,
        }
    }
    if missing > MOST_MISSING {
        return Err(Reject::Covered);
    }
    let blur_px = contrast * f64::from(seen) / (steep * std::f64::consts::TAU.sqrt());
    let blur_px = if threshold.is_none() { blur_px.clamp(BLURS_PX.0, BLURS_PX.1) } else { 1.0 };
    let (ellipse, rest_px) = moved(&rim.ellipse, &points, &shares).ok_or(Reject::Profile)?;
    // What an edge strays, in levels; points without one stray by half the contrast.
    let strays = rest_px / (std::f64::consts::TAU.sqrt() * blur_px);
    let gone = missing as f64 / POINTS as f64;
    let unevenness = (strays * strays + 0.25 * gone).sqrt();
    Ok(Rim { ellipse, black, blur_px, unevenness })
}

/// Means over neighbours: less noise, and what light varies stays.
fn smoothed(levels: &[f64; POINTS]) -> [f64; POINTS] {
    std::array::from_fn(|index| {
        let near = (POINTS - 3..=POINTS + 3).map(|by| levels[(index + by) % POINTS]);
        near.sum::<f64>() / 7.0
    })
}

/// Where a rising profile crosses zero, nearest to 0, and how steeply; `None` if not within reach.
fn crossing(profile: impl Fn(f64) -> f64, reach_px: f64) -> Option<(f64, f64)> {
    let mut place = 0.0;
    let mut level = profile(0.0);
    let step = if level < 0.0 { 1.0 } else { -1.0 };
    loop {
        let next = profile(place + step);
        if (next < 0.0) != (level < 0.0) {
            place += step * level / (level - next);
            break;
        }
        (place, level) = (place + step, next);
        if place.abs() > reach_px {
            return None;
        }
    }
    // Once more, even to both sides.
    let (before, after) = (profile(place - 0.5), profile(place + 0.5));
    let slope = after - before;
    if slope.is_nan() || slope < 1.0 {
        return None;
    }
    Some((place - (0.5 * (before + after) / slope).clamp(-0.5, 0.5), slope))
}

/// The ellipse that follows the points, and the rms of what they stray from it, pixels.
fn moved(
    ellipse: &Ellipse,
    points: &[Point; POINTS],
    shares: &[f64; POINTS],
) -> Option<(Ellipse, f64)> {
    let mut sums = [0.0; 5];
    for (point, share) in points.iter().zip(shares) {
        for (sum, basis) in sums.iter_mut().zip(basis(point.parameter)) {
            *sum += share * basis;
        }
    }
    let n = POINTS as f64;
    let [alpha, x, y, gamma, eta] =
        [sums[0] / n, 2.0 * sums[1] / n, 2.0 * sums[2] / n, 2.0 * sums[3] / n, 2.0 * sums[4] / n];
    let followed = |point: &Point| {
        let basis = basis(point.parameter);
        alpha + x * basis[1] + y * basis[2] + gamma * basis[3] + eta * basis[4]
    };
    let rest: f64 = points
        .iter()
        .zip(shares)
        .map(|(point, share)| ((share - followed(point)) * point.height_px).powi(2))
        .sum();
    let (sin, cos) = ellipse.angle_rad.sin_cos();
    let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
    let major = (a * cos, a * sin);
    let minor = (-b * sin, b * cos);
    let column = |p: f64, q: f64| (major.0 * p + minor.0 * q, major.1 * p + minor.1 * q);
    let (shift_u, shift_v) = column(x, y);
    let columns = [column(1.0 + alpha + gamma, eta), column(eta, 1.0 + alpha - gamma)];
    let center = PixelPoint { u: ellipse.center.u + shift_u, v: ellipse.center.v + shift_v };
    let ellipse = of_columns(center, columns);
    ellipse.is_valid().then_some((ellipse, (rest / n).sqrt()))
}

fn basis((cos, sin): (f64, f64)) -> [f64; 5] {
    [1.0, cos, sin, cos * cos - sin * sin, 2.0 * sin * cos]
}

/// The image of the unit circle under the map of these columns.
fn of_columns(center: PixelPoint, [p, q]: [(f64, f64); 2]) -> Ellipse {
    let matrix = Symmetric2 {
        uu: p.0 * p.0 + q.0 * q.0,
        uv: p.0 * p.1 + q.0 * q.1,
        vv: p.1 * p.1 + q.1 * q.1,
    };
    let (long, short, angle_rad) = matrix.eigen();
    Ellipse {
        center,
        semi_major_px: long.max(0.0).sqrt(),
        semi_minor_px: short.max(0.0).sqrt(),
        angle_rad,
    }
}

/// A gap between teeth, or one slot of it, in the chart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gap {
    /// cos and sin of its middle's angle.
    pub direction: (f64, f64),
    /// Angles to the next teeth on both sides, radians.
    pub to_teeth_rad: (f64, f64),
}

/// The white disc's rim, by the gaps between teeth; `black` is the ring's level. Without enough gaps it
/// is where the chart has it.
///
/// In the middle of a gap, teeth on both sides take some of the white away by blur; the level halfway
/// is lower by as much. How white a gap is, is seen well inside it.
pub(crate) fn inner_rim(
    light: &Light,
    chart: &Chart,
    ratio: f64,
    gaps: impl Iterator<Item = Gap> + Clone,
    (black, blur_px): (f64, f64),
) -> Option<Ellipse> {
    let mut radius = ratio;
    let mut shift = (0.0, 0.0);
    for _ in 0..INNER_TURNS {
        let mut normal = nalgebra::Matrix3::<f64>::zeros();
        let mut right = nalgebra::Vector3::<f64>::zeros();
        for gap in gaps.clone() {
            let (cos, sin) = gap.direction;
            let at = |share: f64| {
                let x = (radius * share * cos + shift.0, radius * share * sin + shift.1);
                chart.image(x)
            };
            let (rim, beyond, place) = (at(1.0), at(1.02), at(LEVEL_AT));
            let (du, dv) = (beyond.u - rim.u, beyond.v - rim.v);
            let length_px = du.hypot(dv);
            if length_px.is_nan() || length_px <= 0.0 {
                return None;
            }
            // A whole radius is 50 times the step above.
            let (du, dv) = (du / length_px, dv / length_px);
            let aside = chart.image((radius * (cos - 0.02 * sin), radius * (sin + 0.02 * cos)));
            let px_per_rad = 50.0 * (aside.u - rim.u).hypot(aside.v - rim.v);
            let share = |px: f64| normal_share(px / blur_px);
            let open = |at: f64| {
                let (one, other) = gap.to_teeth_rad;
                share(one * px_per_rad * at) + share(other * px_per_rad * at) - 1.0
            };
            // At its place the level has lost to the ring and gained from the core as well.
            let size_px = 50.0 * length_px;
            let from_core = share((CodeLayout::CORE_SHARE - LEVEL_AT) * size_px);
            let from_ring = share((LEVEL_AT - 1.0) * size_px);
            let expected = open(LEVEL_AT) * (1.0 - from_ring - from_core) + from_core;
            let level = light.at(place.u, place.v) - black;
            let half = black + 0.5 * level * open(1.0) / expected;
            let dark = |out_px: f64| half - light.at(rim.u + out_px * du, rim.v + out_px * dv);
            let Some((out_px, _)) = crossing(dark, 3.0) else { continue };
            let drawn_px = 0.5 * blur_px * blur_px / size_px;
            let share = (out_px + drawn_px) / size_px;
            let row = nalgebra::Vector3::new(1.0, cos, sin);
            normal += row * row.transpose();
            right += row * share;
        }
        let change = normal.cholesky().map(|normal| normal.solve(&right));
        let Some(change) = change else { break };
        shift = (shift.0 + radius * change[1], shift.1 + radius * change[2]);
        radius *= 1.0 + change[0];
    }
    let fits = radius > 0.5 * ratio && radius < 0.5 * (1.0 + ratio) && shift.0.hypot(shift.1) < 0.1;
    let (radius, shift) = if fits { (radius, shift) } else { (ratio, (0.0, 0.0)) };
    let (center, columns) = chart.circle(shift, radius);
    let ellipse = of_columns(center, columns);
    ellipse.is_valid().then_some(ellipse)
}

/// Φ, to 0.01.
fn normal_share(z: f64) -> f64 {
    1.0 / (1.0 + (-1.702 * z).exp())
}
