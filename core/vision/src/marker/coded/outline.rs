//! Outline of a coded roundel to the accuracy of pixels, by spokes from its core.
//!
//! Teeth are attached to the ring, so from the middle of the white core there is one stretch of black in any
//! direction, and then the margin: its ends are corners of a polygon whose moments give the outer
//! ellipse. From off the middle, a spoke may cut most of a tooth and end in a gap, so the polygon is
//! rough, and inside rather than outside of the ring; the refinement from there
//! ([`crate::marker::coded::outer_rim`]) finds black inside and white outside.
//!
//! Black begins on one of two circles, the core's and the white disc's; relative to
//! the outer rim, their eccentricity gives the shift of the centre by perspective ([`offset`]).

use crate::{
    ellipse::{Ellipse, Moments},
    frame::Frame,
    marker::{
        code::CodeLayout,
        coded::{
            plane_map::{MAX_OFFSET, PlaneMap},
            sampler::Sampler,
        },
        reject::Reject,
        ring::probe::Probe,
    },
};

/// Spokes of the outline.
const SPOKES: usize = 40;
/// Black that is a smaller share of the spoke, within a pixel, is a clipped corner of a tooth: the
/// ring has 280 of 700.
const MIN_BLACK: f64 = 0.3;
/// Spokes for the eccentricity, twice.
const INNER_SPOKES: usize = 30;
const TURNS: usize = 2;
/// They begin at this share of the core's radius, and advance in these steps.
const BEGIN: f64 = 0.6;
const STEP_PX: f64 = 1.0;
/// A beginning further from both radii than this share of the outer one, by iteration, is the side
/// of a tooth.
const SIDE: [f64; TURNS] = [0.1, 0.05];

/// The rough outline around a probe; `inverted` for a white ring.
pub(crate) fn outline(frame: &Frame, probe: &Probe, inverted: bool) -> Result<Ellipse, Reject> {
    let flip = if inverted { 255 } else { 0 };
    let mut spokes = [0.0; SPOKES];
    for (index, spoke) in spokes.iter_mut().enumerate() {
        let (sin, cos) = direction(index);
        *spoke = walk(frame, probe, (cos, sin), flip)?;
    }
    let corner = |index: usize| {
        let (sin, cos) = direction(index);
        (spokes[index] * cos, spokes[index] * sin)
    };
    let mut moments = Moments::default();
    for index in 0..SPOKES {
        add_triangle(&mut moments, corner(index), corner((index + 1) % SPOKES));
    }
    let outer = moments.shape(probe.center).ok_or(Reject::TooSmall)?.ellipse();
    if outer.is_valid() { Ok(outer) } else { Err(Reject::TooSmall) }
}

fn direction(index: usize) -> (f64, f64) {
    (std::f64::consts::TAU * index as f64 / SPOKES as f64).sin_cos()
}

/// Length at which a spoke leaves the black.
fn walk(frame: &Frame, probe: &Probe, (du, dv): (f64, f64), flip: u8) -> Result<f64, Reject> {
    let (u0, v0) = (probe.center.0 as f64 + 0.5, probe.center.1 as f64 + 0.5);
    let bounds = &probe.bounds;
    let level = |length: f64| {
        let (u, v) = (u0 + length * du, v0 + length * dv);
        let inside = u >= bounds.left as f64
            && v >= bounds.top as f64
            && u < bounds.right as f64
            && v < bounds.bottom as f64;
        inside.then(|| frame.row(v as usize)[u as usize] ^ flip)
    };
    let edge = |from: f64, is_black: bool| {
        let mut length = from;
        while let Some(grey) = level(length) {
            if (grey < probe.threshold) == is_black {
                return Some(length - 0.5);
            }
            length += 1.0;
        }
        None
    };
    if level(0.0).is_none_or(|grey| grey < probe.threshold) {
        return Err(Reject::NoWhite);
    }
    // If the bounds are the frame's, the ring may be cut; otherwise it is too large.
    let at_edge = bounds.left == 0
        || bounds.top == 0
        || bounds.right == frame.width()
        || bounds.bottom == frame.height();
    let beyond = if at_edge { Reject::FrameEdge } else { Reject::BlackTooLarge };
    let mut end = 0.0;
    loop {
        let begin = edge(end + 1.0, true).ok_or(Reject::NoBlack)?;
        end = edge(begin + 1.5, false).ok_or(beyond)?;
        if end - begin + 1.0 >= MIN_BLACK * end {
            return Ok(end);
        }
    }
}

/// Adds the triangle of the origin and two corners.
fn add_triangle(moments: &mut Moments, p: (f64, f64), q: (f64, f64)) {
    let area = 0.5 * (p.0 * q.1 - p.1 * q.0);
    moments.n += area;
    moments.u += area * (p.0 + q.0) / 3.0;
    moments.v += area * (p.1 + q.1) / 3.0;
    moments.uu += area * (p.0 * p.0 + p.0 * q.0 + q.0 * q.0) / 6.0;
    moments.vv += area * (p.1 * p.1 + p.1 * q.1 + q.1 * q.1) / 6.0;
    moments.uv += area * (2.0 * p.0 * p.1 + p.0 * q.1 + q.0 * p.1 + 2.0 * q.0 * q.1) / 12.0;
}

/// d of the plane map, by the circles on which black begins: one of radius ρ appears around d (1 -
/// ρ²). `half` is the level between black and white.
pub(crate) fn offset(sampler: &Sampler, outer: &Ellipse, ratio: f64, half: f64) -> (f64, f64) {
    let core = CodeLayout::CORE_SHARE * ratio;
    let step = STEP_PX / outer.mean_radius_px();
    let mut d = (0.0, 0.0);
    for side in SIDE {
        let plane = PlaneMap::with_offset(outer, d);
        let level = |radius: f64, (sin, cos): (f64, f64)| {
            let at = plane.image((radius * cos, radius * sin));
            sampler.at(at.u, at.v)
        };
        let (mut xx, mut xy, mut yy, mut x, mut y) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for index in 0..INNER_SPOKES {
            let turn_rad = std::f64::consts::TAU * index as f64 / INNER_SPOKES as f64;
            let direction = turn_rad.sin_cos();
            let mut radius = BEGIN * core;
            let mut before = level(radius, direction);
            let begin = loop {
                let next = level(radius + step, direction);
                if next < half && before >= half {
                    break radius + step * (before - half) / (before - next);
                }
                (radius, before) = (radius + step, next);
                if radius > ratio + side {
                    break f64::INFINITY;
                }
            };
            let circle = if begin > 0.5 * (core + ratio) { ratio } else { core };
            let beyond = begin - circle;
            if beyond.abs() > side {
                continue;
            }
            let share = 1.0 - circle * circle;
            let (ex, ey) = (share * direction.1, share * direction.0);
            (xx, xy, yy) = (xx + ex * ex, xy + ex * ey, yy + ey * ey);
            (x, y) = (x + ex * beyond, y + ey * beyond);
        }
        let determinant = xx * yy - xy * xy;
        if determinant <= 1.0 {
            return d;
        }
        let more = ((yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant);
        d = (d.0 + more.0, d.1 + more.1);
        if d.0.hypot(d.1) > MAX_OFFSET {
            return (0.0, 0.0);
        }
    }
    d
}
