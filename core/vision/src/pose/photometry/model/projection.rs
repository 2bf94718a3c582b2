//! Projection of a roundel's contour into the window: plane → local rays → pixels.
//!
//! A point (x, y) of the plane, in outer radii R, lies at Q = p + R (x a + y b) in the local frame.
//! Its ray is t = (Q₁, Q₂)/(s Q₃), its pixel the polynomial of [`LocalLens`]. All sums start from
//! the middle of the roundel, so f32 keeps coordinates to 1e-5 px.

use fearless_simd::{Level, dispatch, prelude::*};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector2, Vector3};

use super::{
    blur_kernel::PHASES,
    contour::{Contour, MAX_NODES, PACK},
    local_lens::{LocalLens, TERMS},
};
use crate::pose::yaw;

/// Pose of a roundel in the local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintPose {
    /// p.
    pub position_m: Vector3<f64>,
    /// Columns a, b and n: the print's x and y, and its normal.
    pub axes: Matrix3<f64>,
}

impl PrintPose {
    /// Axes for another normal; along the line of sight, the print's x still points the same way.
    pub fn axes_with_normal(&self, normal: &Vector3<f64>) -> Matrix3<f64> {
        yaw::axes_with_normal(&self.axes, &self.position_m, normal)
    }
}

/// Contour nodes in the window.
#[derive(Clone, Debug)]
pub struct Nodes {
    /// Column, from the window's left.
    pub x: Vec<f32>,
    /// Row, from the window's top.
    pub y: Vec<f32>,
    /// Share of the contour, pixels.
    pub dx: Vec<f32>,
    /// Share of the contour, pixels.
    pub dy: Vec<f32>,
    /// Column and row in whole phases of the kernel …
    pub steps: [Vec<i32>; 2],
    /// … and the rest, in phases.
    pub rest: [Vec<f32>; 2],
    /// Number of nodes of the outer rim, which come first.
    pub outer: usize,
    /// Normals of the contour, while rims are moved.
    normals: Vec<[f32; 2]>,
}

impl Default for Nodes {
    /// Empty, with capacity for any contour.
    fn default() -> Self {
        let list = || Vec::with_capacity(MAX_NODES);
        let steps = [(); 2].map(|()| Vec::with_capacity(MAX_NODES));
        let rest = [(); 2].map(|()| list());
        let normals = Vec::with_capacity(MAX_NODES);
        Self { x: list(), y: list(), dx: list(), dy: list(), steps, rest, outer: 0, normals }
    }
}

impl Nodes {
    /// Repeats each node at several positions along a motion, weighted by its share of the
    /// exposure.
    pub fn smear(&mut self, level: Level, motion_px: &Vector2<f64>, places: &[(f32, f32)]) {
        let (outer, count) = (self.outer, self.x.len());
        let copies = places.len();
        if copies * count > MAX_NODES {
            return;
        }
        self.resize(copies * count);
        self.outer = copies * outer;
        let motion = [motion_px.x as f32, motion_px.y as f32];
        // Backwards, so that no node is overwritten before it is read.
        for (from, to, length) in [(outer, copies * outer, count - outer), (0, 0, outer)] {
            for (k, &(along, share)) in places.iter().enumerate().rev() {
                let copy = NodeCopy { from, to: to + k * length, length, share };
                let by = motion.map(|part| along * part);
                dispatch!(level, simd => smear_all(simd, self, &copy, by));
            }
        }
    }

    /// Moves both rims into the black.
    pub fn move_rims(&mut self, level: Level, by_px: f64) {
        let by_px = by_px as f32;
        self.normals.clear();
        self.normals.extend(self.dx.iter().zip(&self.dy).map(|(dx, dy)| {
            let per_length = 1.0 / (dx * dx + dy * dy).sqrt();
            [-dy * per_length, dx * per_length]
        }));
        for (from, to) in [(0, self.outer), (self.outer, self.x.len())] {
            let normals = &self.normals[from..to];
            let count = normals.len();
            let normal = |i: usize| normals[i % count];
            // The contour may run against the order of the nodes.
            let (x, y) = (&self.x[from..], &self.y[from..]);
            let forward = (x[1] - x[0]) * self.dx[from] + (y[1] - y[0]) * self.dy[from];
            let along_px = by_px * forward.signum();
            for (i, own) in normals.iter().enumerate() {
                let (next, before) = (normal(i + 1), normal(i + count - 1));
                let (second, second_before) = (normal(i + 2), normal(i + count - 2));
                // Change of the normal from node to node, to fourth order.
                let change = [0, 1]
                    .map(|k| (8.0 * (next[k] - before[k]) - (second[k] - second_before[k])) / 12.0);
                self.x[from + i] += by_px * own[0];
                self.y[from + i] += by_px * own[1];
                self.dx[from + i] += along_px * change[0];
                self.dy[from + i] += along_px * change[1];
            }
        }
        let all = NodeCopy { from: 0, to: 0, length: self.x.len(), share: 1.0 };
        dispatch!(level, simd => smear_all(simd, self, &all, [0.0; 2]));
    }

    fn resize(&mut self, count: usize) {
        for list in [&mut self.x, &mut self.y, &mut self.dx, &mut self.dy] {
            list.resize(count, 0.0);
        }
        for list in &mut self.rest {
            list.resize(count, 0.0);
        }
        for list in &mut self.steps {
            list.resize(count, 0);
        }
    }
}

struct NodeCopy {
    from: usize,
    to: usize,
    length: usize,
    /// Share of the exposure.
    share: f32,
}

#[simd]
fn smear_all<S: Simd>(simd: S, nodes: &mut Nodes, copy: &NodeCopy, by: [f32; 2]) {
    let width = S::f32s::LEN;
    for start in (0..copy.length).step_by(width).rev() {
        let (from, to) = (copy.from + start, copy.to + start);
        let of = |list: &[f32]| S::f32s::from_slice(simd, &list[from..from + width]);
        let (u, v) = (of(&nodes.x) + by[0], of(&nodes.y) + by[1]);
        let (du, dv) = (of(&nodes.dx) * copy.share, of(&nodes.dy) * copy.share);
        store::<S>(nodes, to, [u, v, du, dv]);
    }
}

/// Stores column, row and shares of the contour at `start`.
#[inline(always)]
fn store<S: Simd>(nodes: &mut Nodes, start: usize, [u, v, du, dv]: [S::f32s; 4]) {
    let end = start + S::f32s::LEN;
    u.store_slice(&mut nodes.x[start..end]);
    v.store_slice(&mut nodes.y[start..end]);
    let (fine_u, fine_v) = (u * PHASES as f32, v * PHASES as f32);
    let (whole_u, whole_v) = (fine_u.floor(), fine_v.floor());
    whole_u.to_int::<S::i32s>().store_slice(&mut nodes.steps[0][start..end]);
    whole_v.to_int::<S::i32s>().store_slice(&mut nodes.steps[1][start..end]);
    (fine_u - whole_u).store_slice(&mut nodes.rest[0][start..end]);
    (fine_v - whole_v).store_slice(&mut nodes.rest[1][start..end]);
    du.store_slice(&mut nodes.dx[start..end]);
    dv.store_slice(&mut nodes.dy[start..end]);
}

/// Coefficients of the projection, as f32.
struct ProjectionTerms {
    /// Constant, x and y terms of Q₁ and Q₂, over s p₃.
    above: [[f32; 3]; 2],
    /// x and y terms of Q₃ over p₃; the constant is 1.
    below: [f32; 2],
    terms: [[f32; TERMS]; 2],
    /// From the lens' origin to the window's.
    shift: [f32; 2],
    /// Factor on the nodes after those of the outer rim.
    disc_scale: f32,
    /// -1 where the projection reverses the orientation.
    sign: f32,
}

/// A print in front of a lens, and the window that it is projected into.
#[derive(Clone, Copy)]
pub struct ProjectedPrint<'a> {
    pub lens: &'a LocalLens,
    pub pose: &'a PrintPose,
    pub radius_m: f64,
    /// Factor on the disc's rim.
    pub disc_scale: f64,
    /// The window's top left pixel.
    pub window: (i64, i64),
}

pub fn project(level: Level, print: &ProjectedPrint, contour: Contour, nodes: &mut Nodes) {
    let ProjectedPrint { lens, pose, radius_m, disc_scale, window } = *print;
    let (p, axes) = (&pose.position_m, &pose.axes);
    let scale = 1.0 / (lens.spread * p.z);
    let above = [0, 1]
        .map(|i| [p[i] * scale, radius_m * axes[(i, 0)] * scale, radius_m * axes[(i, 1)] * scale]);
    let turn = above[0][1] * above[1][2] - above[0][2] * above[1][1];
    let slope = &lens.slope;
    let view = ProjectionTerms {
        above: above.map(|row| row.map(|value| value as f32)),
        below: [0, 1].map(|j| (radius_m * axes[(2, j)] / p.z) as f32),
        terms: lens.terms,
        shift: [(lens.origin.u as i64 - window.0) as f32, (lens.origin.v as i64 - window.1) as f32],
        disc_scale: disc_scale as f32,
        sign: if turn * slope.determinant() > 0.0 { 1.0 } else { -1.0 },
    };
    nodes.resize(contour.nodes[0].len());
    nodes.outer = contour.outer;
    dispatch!(level, simd => project_all(simd, &view, contour, nodes));
}

#[simd]
fn project_all<S: Simd>(simd: S, view: &ProjectionTerms, contour: Contour, nodes: &mut Nodes) {
    let width = S::f32s::LEN;
    debug_assert!(PACK.is_multiple_of(width));
    let one = S::f32s::splat(simd, 1.0);
    let [[c1, x1, y1], [c2, x2, y2]] = view.above;
    let [x, y, dx, dy] = contour.nodes;
    for start in (0..x.len()).step_by(width) {
        let end = start + width;
        let scale = if start < contour.outer { 1.0 } else { view.disc_scale };
        let x = S::f32s::from_slice(simd, &x[start..end]) * scale;
        let y = S::f32s::from_slice(simd, &y[start..end]) * scale;
        let dx = S::f32s::from_slice(simd, &dx[start..end]) * scale;
        let dy = S::f32s::from_slice(simd, &dy[start..end]) * scale;
        let per_below = one / (x * view.below[0] + y * view.below[1] + one);
        let along_below = dx * view.below[0] + dy * view.below[1];
        let t1 = (x * x1 + y * y1 + c1) * per_below;
        let t2 = (x * x2 + y * y2 + c2) * per_below;
        let dt1 = (dx * x1 + dy * y1 - t1 * along_below) * per_below;
        let dt2 = (dx * x2 + dy * y2 - t2 * along_below) * per_below;
        let (u, u1, u2) = polynomial(simd, &view.terms[0], t1, t2);
        let (v, v1, v2) = polynomial(simd, &view.terms[1], t1, t2);
        let du = (u1 * dt1 + u2 * dt2) * view.sign;
        let dv = (v1 * dt1 + v2 * dt2) * view.sign;
        store::<S>(nodes, start, [u + view.shift[0], v + view.shift[1], du, dv]);
    }
}

/// Value of a polynomial and its derivatives by both variables.
#[inline(always)]
fn polynomial<S: Simd>(
    simd: S,
    terms: &[f32; TERMS],
    t1: S::f32s,
    t2: S::f32s,
) -> (S::f32s, S::f32s, S::f32s) {
    let zero = S::f32s::splat(simd, 0.0);
    let (mut value, mut by_t1, mut by_t2) = (zero, zero, zero);
    let mut end = TERMS;
    // Horner's scheme, from the highest power of t₁, whose factor is a constant, down.
    for count in 1..=6 {
        let (mut inner, mut slope) = (zero, zero);
        for place in (end - count..end).rev() {
            slope = slope.mul_add(t2, inner);
            inner = inner.mul_add(t2, S::f32s::splat(simd, terms[place]));
        }
        end -= count;
        by_t1 = by_t1.mul_add(t1, value);
        value = value.mul_add(t1, inner);
        by_t2 = by_t2.mul_add(t1, slope);
    }
    (value, by_t1, by_t2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring of radii 12 and 5 px; `turn` is the direction of its nodes.
    fn ring(turn: f64) -> Nodes {
        let mut nodes = Nodes::default();
        nodes.resize(128);
        for (rim, (radius, sign)) in [(12.0, 1.0), (5.0, -1.0)].into_iter().enumerate() {
            for i in 0..64 {
                let step = std::f64::consts::TAU / 64.0;
                let (sin, cos) = (turn * step * i as f64).sin_cos();
                let node = 64 * rim + i;
                nodes.x[node] = (24.3 + radius * cos) as f32;
                nodes.y[node] = (23.8 + radius * sin) as f32;
                nodes.dx[node] = (-sign * step * radius * sin) as f32;
                nodes.dy[node] = (sign * step * radius * cos) as f32;
            }
        }
        nodes.outer = 64;
        nodes
    }

    #[test]
    fn a_bloom_takes_black_from_both_rims() {
        let bloom_px = 0.4;
        for turn in [1.0, -1.0] {
            let mut nodes = ring(turn);
            nodes.move_rims(Level::new(), bloom_px);
            let area: f32 = nodes.x.iter().zip(&nodes.dy).map(|(x, dy)| x * dy).sum();
            let expected =
                std::f64::consts::PI * ((12.0 - bloom_px).powi(2) - (5.0 + bloom_px).powi(2));
            assert!((f64::from(area) / expected - 1.0).abs() < 1e-3, "{turn}: {area} {expected}");
            let node = 70;
            let phase = nodes.steps[0][node] as f32 + nodes.rest[0][node];
            assert!((phase / PHASES as f32 - nodes.x[node]).abs() < 1e-4);
        }
    }
}
