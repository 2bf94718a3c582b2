//! A coded roundel's outer rim to a fraction of a pixel, from points where the grey level is halfway.
//!
//! Across the rim, the place of the level halfway between ring and margin is looked for at points
//! evenly spaced in the ellipse's parameter t. How far outwards of the ellipse they lie, as a share q(t)
//! of its size, has five harmonics that an ellipse can follow:
//! q = α + βₓ cos t + βᵧ sin t + γ cos 2t + η sin 2t, the ellipse's map A becoming A (1 + S) with
//! S = [α+γ η; η α-γ] and its centre moving by A β. The rest of q is how uneven the rim is.
//!
//! A blur of deviation σ draws the half level of a rim of curvature κ inwards by σ²κ/2; σ is told by
//! the rim's slope, (W - B)/(√(2π) σ). B and W are seen a few pixels inside and outside of the rim, of small
//! or tilted ones nearer, where they are mixed; by how much, the blur tells.

use crate::{
    camera::PixelPoint,
    ellipse::{Ellipse, Symmetric2},
    frame::Frame,
    marker::{normal::normal_share, reject::Reject},
};

/// A rim more uneven than this is partly covered, or none.
const MOST_UNEVEN: f64 = 0.25;
/// Points of the outer rim.
const POINTS: usize = 48;
/// Where ring and margin have their levels, pixels from the rim, at least and at most, and between those a
/// share of the shorter semiaxis: the margin may be hardly wider. As far inside as outside, where the levels
/// are mixed alike and the one halfway is that of the whole levels.
const LEVEL_PX: (f64, f64) = (1.0, 2.5);
const LEVEL_SHARE: f64 = 0.14;
/// How wide the ring is, as a share of the radius.
const RING_SHARE: f64 = 0.4;
/// What blur leaves of the contrast between those levels, at least.
const LEAST_LEFT: f64 = 0.5;
/// By turn, how far from the ellipse a point may be, as a share of the shorter semiaxis …
const WALKS: [f64; 4] = [0.35, 0.12, 0.05, 0.02];
/// … and pixels on top.
const WALK_PX: f64 = 1.5;
/// Turns in which the rim is found, at most: of a small one, whose levels are seen near its edge, each leaves
/// up to two thirds of what it was off …
const MOST_TURNS: usize = 14;
/// … and the last one moves it by less than this, pixels.
const SETTLED_PX: f64 = 0.002;
/// Points without an edge, of all, at most.
const MOST_MISSING: usize = POINTS / 6;
/// Variance of a slope's width, px².
const SLOPE_PX2: f64 = 1.0 / 12.0;
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
    for turn in 0..MOST_TURNS {
        let share = WALKS[turn.min(WALKS.len() - 1)];
        let reach_px = WALK_PX + share * rim.ellipse.semi_minor_px;
        let before = rim.ellipse;
        rim = fitted(light, &rim, (turn == 0).then_some(threshold), reach_px)?;
        let grown_px = rim.ellipse.mean_radius_px() - before.mean_radius_px();
        if turn + 1 >= WALKS.len() && grown_px.abs() < SETTLED_PX {
            break;
        }
    }
    if rim.unevenness > MOST_UNEVEN { Err(Reject::Covered) } else { Ok(rim) }
}

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

impl Point {
    /// What a blur draws the half level inwards by.
    fn drawn_px(&self, blur_px: f64) -> f64 {
        0.5 * blur_px * blur_px * self.curvature_per_px
    }
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
    let aside_px = (LEVEL_SHARE * minor).clamp(LEVEL_PX.0, LEVEL_PX.1);
    let share = |px: f64| normal_share(px / rim.blur_px);
    let (mut blacks, mut margins) = ([0.0; POINTS], [0.0; POINTS]);
    for (index, point) in points.iter().enumerate() {
        let drawn_px = point.drawn_px(rim.blur_px);
        let to_teeth_px = RING_SHARE * point.height_px + drawn_px / (1.0 - RING_SHARE) - aside_px;
        // What of the margin's light is seen there, of the gaps' and of the black.
        let of_margin = share(drawn_px - aside_px) + 0.5 * share(-to_teeth_px);
        let of_black = share(-drawn_px - aside_px);
        let (dark, bright) = (level(point, -aside_px), level(point, aside_px));
        let contrast = (bright - dark) / (1.0 - of_margin - of_black).max(LEAST_LEFT);
        blacks[index] = dark - of_margin * contrast;
        margins[index] = bright + of_black * contrast;
    }
    let (blacks, margins) = (tilted(&points, &blacks), smoothed(&margins));
    let mean = |levels: &[f64; POINTS]| levels.iter().sum::<f64>() / POINTS as f64;
    let black = mean(&blacks);
    let contrast = mean(&margins) - black;
    if threshold.is_none() && (contrast.is_nan() || contrast < 1.0) {
        return Err(Reject::Contrast);
    }
    let (mut shares, mut missing) = ([0.0; POINTS], 0);
    let (mut steep, mut seen) = (0.0, 0);
    for (index, point) in points.iter().enumerate() {
        let half = threshold.unwrap_or(0.5 * (blacks[index] + margins[index]));
        match crossing(|out_px| level(point, out_px) - half, reach_px) {
            Some((out_px, slope)) => {
                shares[index] = (out_px + point.drawn_px(rim.blur_px)) / point.height_px;
                steep += slope;
                seen += 1;
            }
            None => missing += 1,
        }
    }
    if missing > MOST_MISSING {
        return Err(Reject::Covered);
    }
    // A slope over a pixel is that of an edge blurred by a pixel more.
    let seen_px = contrast * f64::from(seen) / (steep * std::f64::consts::TAU.sqrt());
    let blur_px = (seen_px * seen_px - SLOPE_PX2).sqrt();
    let blur_px = if threshold.is_none() { blur_px.max(BLURS_PX.0).min(BLURS_PX.1) } else { 1.0 };
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

/// The plane through them: what a light varies, and not what teeth near by add here and there.
fn tilted(points: &[Point; POINTS], levels: &[f64; POINTS]) -> [f64; POINTS] {
    let (mut mean, mut x, mut y) = (0.0, 0.0, 0.0);
    for (point, level) in points.iter().zip(levels) {
        mean += level / POINTS as f64;
        x += 2.0 * level * point.parameter.0 / POINTS as f64;
        y += 2.0 * level * point.parameter.1 / POINTS as f64;
    }
    points.each_ref().map(|point| mean + x * point.parameter.0 + y * point.parameter.1)
}

/// Where a rising profile crosses zero, nearest to 0, and how steeply; `None` if not within reach.
pub(super) fn crossing(profile: impl Fn(f64) -> f64, reach_px: f64) -> Option<(f64, f64)> {
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
pub(super) fn of_columns(center: PixelPoint, [p, q]: [(f64, f64); 2]) -> Ellipse {
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
