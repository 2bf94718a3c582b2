//! A roundel's contour carried into the window: plane → local rays → pixels.
//!
//! A point (x, y) of the plane, in outer radii R, lies at Q = p + R (x a + y b) in the local frame;
//! its ray is t = (Q₁, Q₂)/(s Q₃), its pixel the polynomial of [`LocalLens`]. All sums start from the
//! middle of the roundel, so that f32 keeps coordinates to 1e-5 px.

use fearless_simd::{Level, dispatch, prelude::*};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{
    contour::{Contour, PACK},
    lens::{LocalLens, TERMS},
};

/// A roundel's place in the local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// p, metres.
    pub position_m: Vector3<f64>,
    /// Columns a, b and n: the print's x and y, and its normal.
    pub axes: Matrix3<f64>,
}

/// Contour nodes in the window, with their shares of the way in pixels.
#[derive(Clone, Debug, Default)]
pub struct Nodes {
    /// Column, from the window's left.
    pub x: Vec<f32>,
    /// Row, from the window's top.
    pub y: Vec<f32>,
    /// Share of the way.
    pub dx: Vec<f32>,
    /// Share of the way.
    pub dy: Vec<f32>,
    /// dx and dy as shares of the gradient by t.
    pub by_t: [Vec<f32>; 2],
    /// How many are the outer rim's: the first ones.
    pub outer: usize,
}

impl Nodes {
    /// Makes room for as many nodes.
    fn resize(&mut self, count: usize) {
        let [first, second] = &mut self.by_t;
        for list in [&mut self.x, &mut self.y, &mut self.dx, &mut self.dy, first, second] {
            list.resize(count, 0.0);
        }
    }
}

/// The projection's numbers, as f32.
struct View {
    /// Constant, x and y terms of Q₁ and Q₂, over s p₃.
    above: [[f32; 3]; 2],
    /// x and y terms of Q₃ over p₃, whose constant is 1.
    below: [f32; 2],
    terms: [[f32; TERMS]; 2],
    /// From the lens' origin to the window's.
    shift: [f32; 2],
    /// -1 where the projection turns counter-clockwise into clockwise.
    sign: f32,
    slope: [f32; 4],
}

/// Carries a contour into the window whose top left pixel is `window`.
pub fn project(
    level: Level,
    (lens, place, radius_m): (&LocalLens, &Place, f64),
    contour: &Contour,
    window: (i64, i64),
    nodes: &mut Nodes,
) {
    let (p, axes) = (&place.position_m, &place.axes);
    let scale = 1.0 / (lens.spread * p.z);
    let above = [0, 1]
        .map(|i| [p[i] * scale, radius_m * axes[(i, 0)] * scale, radius_m * axes[(i, 1)] * scale]);
    let turn = above[0][1] * above[1][2] - above[0][2] * above[1][1];
    let slope = &lens.slope;
    let view = View {
        above: above.map(|row| row.map(|value| value as f32)),
        below: [0, 1].map(|j| (radius_m * axes[(2, j)] / p.z) as f32),
        terms: lens.terms,
        shift: [(lens.origin.u as i64 - window.0) as f32, (lens.origin.v as i64 - window.1) as f32],
        sign: if turn * slope.determinant() > 0.0 { 1.0 } else { -1.0 },
        slope: [slope.m11, slope.m12, slope.m21, slope.m22].map(|value| value as f32),
    };
    nodes.resize(contour.x.len());
    nodes.outer = contour.outer;
    dispatch!(level, simd => project_all(simd, &view, contour, nodes));
}

#[simd]
fn project_all<S: Simd>(simd: S, view: &View, contour: &Contour, nodes: &mut Nodes) {
    let width = S::f32s::LEN;
    debug_assert!(PACK.is_multiple_of(width));
    let splat = |value: f32| S::f32s::splat(simd, value);
    for start in (0..contour.x.len()).step_by(width) {
        let lanes = start..start + width;
        let load = |list: &[f32]| S::f32s::from_slice(simd, &list[lanes.clone()]);
        let (x, y) = (load(&contour.x), load(&contour.y));
        let (dx, dy) = (load(&contour.dx), load(&contour.dy));
        let below = x * view.below[0] + y * view.below[1] + splat(1.0);
        let per_below = splat(1.0) / below;
        let along_below = dx * view.below[0] + dy * view.below[1];
        let ray = view.above.map(|[constant, by_x, by_y]| {
            let t = (x * by_x + y * by_y + splat(constant)) * per_below;
            (t, (dx * by_x + dy * by_y - t * along_below) * per_below)
        });
        let [(t1, dt1), (t2, dt2)] = ray;
        let at = view.terms.each_ref().map(|terms| {
            let (value, [by_t1, by_t2]) = polynomial(simd, terms, t1, t2);
            (value, (by_t1 * dt1 + by_t2 * dt2) * view.sign)
        });
        let [(u, du), (v, dv)] = at;
        let [m11, m12, m21, m22] = view.slope;
        (u + view.shift[0]).store_slice(&mut nodes.x[lanes.clone()]);
        (v + view.shift[1]).store_slice(&mut nodes.y[lanes.clone()]);
        du.store_slice(&mut nodes.dx[lanes.clone()]);
        dv.store_slice(&mut nodes.dy[lanes.clone()]);
        (dv * m11 - du * m21).store_slice(&mut nodes.by_t[0][lanes.clone()]);
        (dv * m12 - du * m22).store_slice(&mut nodes.by_t[1][lanes.clone()]);
    }
}

/// A polynomial's value and its derivatives by both variables.
#[simd]
fn polynomial<S: Simd>(
    simd: S,
    terms: &[f32; TERMS],
    t1: S::f32s,
    t2: S::f32s,
) -> (S::f32s, [S::f32s; 2]) {
    let zero = S::f32s::splat(simd, 0.0);
    let (mut value, mut by_t1, mut by_t2) = (zero, zero, zero);
    let mut end = TERMS;
    // From the highest power of t₁, whose only factor is a constant, down.
    for count in 1..=6 {
        let row = &terms[end - count..end];
        end -= count;
        let (mut inner, mut slope) = (zero, zero);
        for &term in row.iter().rev() {
            slope = slope.mul_add(t2, inner);
            inner = inner.mul_add(t2, S::f32s::splat(simd, term));
        }
        by_t1 = by_t1.mul_add(t1, value);
        value = value.mul_add(t1, inner);
        by_t2 = by_t2.mul_add(t1, slope);
    }
    (value, [by_t1, by_t2])
}
