//! Contours of the print in its own plane, as quadrature nodes.
//!
//! Lengths are in outer radii, x along the print's right and y up. A node is a point (x, y) with
//! its share (dx, dy) of the contour, so ∮ f dx is the sum of f(x, y) dx. The black area is
//! positive: the outer rim runs counter-clockwise, the rim of the white disc clockwise.
//!
//! Teeth make the white disc's rim one of arcs and radial edges ([`super::teeth`]).
//!
//! On a smooth closed curve equal steps of the angle converge exponentially: a spacing of h at a
//! blur of σ has an error of about 2 exp(-2π²σ²/h²).

use std::ops::Range;

use super::teeth::{self, Teeth};
use crate::marker::Kind;

/// Nodes are padded to multiples of this, which vectors of any width divide.
pub const PACK: usize = 16;
/// Distance of the nodes, in blurs.
pub const SPACING_BLURS: f64 = 1.45;
/// Limits of the cache: contours …
const MAX_CONTOURS: usize = 512;
/// … and nodes of a rim. Beyond either the cache is emptied.
const MAX_RIM_NODES: usize = 65_536;
/// Nodes of a contour, and of the whole cache.
pub const MAX_NODES: usize = 2 * MAX_RIM_NODES;

/// Nodes of both rims of a print.
#[derive(Clone, Copy, Debug)]
pub struct Contour<'a> {
    /// x, y, dx and dy.
    pub nodes: [&'a [f32]; 4],
    /// Number of nodes of the outer rim, which come first.
    pub outer: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Key {
    /// Semiaxes of the disc.
    inner: [f64; 2],
    teeth: Option<Teeth>,
    outer_packs: usize,
    inner_packs: usize,
}

/// Cache of contours by print and number of nodes, in memory that is reserved from the start.
#[derive(Clone, Debug)]
pub struct Contours {
    /// Ranges of the nodes.
    cached: Vec<(Key, Range<usize>)>,
    /// Nodes of all contours, as in [`Contour`].
    nodes: [Vec<f32>; 4],
}

impl Default for Contours {
    fn default() -> Self {
        let nodes = [(); 4].map(|()| Vec::with_capacity(MAX_NODES));
        Self { cached: Vec::with_capacity(MAX_CONTOURS), nodes }
    }
}

impl Contours {
    /// Contour of a print whose outer rim is at most `around_px` long, with nodes at most
    /// `spacing_px` apart.
    pub fn get(
        &mut self,
        kind: &Kind,
        teeth: Option<Teeth>,
        around_px: f64,
        spacing_px: f64,
    ) -> Contour<'_> {
        let (min_ratio, max_ratio) = kind.ratios();
        let max_nodes = if teeth.is_some() { teeth::MAX_OUTER_NODES } else { MAX_RIM_NODES };
        let packs = |share: f64| {
            let nodes = (share * around_px / spacing_px).min(max_nodes as f64);
            ((nodes / PACK as f64).ceil() as usize).max(1)
        };
        let outer_packs = packs(1.0);
        // The number of nodes on teeth follows from that of the outer rim.
        let inner_packs = if teeth.is_some() { 0 } else { packs(max_ratio) };
        let key = Key { inner: [max_ratio, min_ratio], teeth, outer_packs, inner_packs };
        let cached = self.cached.iter().find(|(cached, _)| *cached == key);
        let range = match cached {
            Some((_, range)) => range.clone(),
            None => self.add(key),
        };
        Contour {
            nodes: self.nodes.each_ref().map(|list| &list[range.clone()]),
            outer: key.outer_packs * PACK,
        }
    }

    fn add(&mut self, key: Key) -> Range<usize> {
        let inner_packs = key.teeth.map_or(key.inner_packs, |teeth| {
            teeth.nodes(key.inner[0], spacing(key.outer_packs * PACK)).count().div_ceil(PACK)
        });
        let count = (key.outer_packs + inner_packs) * PACK;
        if self.cached.len() == MAX_CONTOURS || self.nodes[0].len() + count > MAX_NODES {
            self.cached.clear();
            self.nodes.iter_mut().for_each(Vec::clear);
        }
        let first = self.nodes[0].len();
        self.push_ellipse([1.0, 1.0], key.outer_packs * PACK, 1.0);
        match key.teeth {
            None => self.push_ellipse(key.inner, key.inner_packs * PACK, -1.0),
            Some(teeth) => {
                self.push_teeth(teeth, key.inner[0], spacing(key.outer_packs * PACK), first + count)
            }
        }
        let range = first..first + count;
        self.cached.push((key, range.clone()));
        range
    }

    /// The white disc's rim with its teeth, padded with nodes of zero length.
    fn push_teeth(&mut self, teeth: Teeth, ratio: f64, spacing: f64, end: usize) {
        for [x, y, dx, dy] in teeth.nodes(ratio, spacing) {
            self.push([x, y, -dx, -dy]);
        }
        for list in &mut self.nodes {
            list.resize(end, 0.0);
        }
    }

    fn push_ellipse(&mut self, [a, b]: [f64; 2], count: usize, sign: f64) {
        let step = std::f64::consts::TAU / count as f64;
        for i in 0..count {
            let (sin, cos) = (step * i as f64).sin_cos();
            self.push([a * cos, b * sin, -sign * step * a * sin, sign * step * b * cos]);
        }
    }

    fn push(&mut self, node: [f64; 4]) {
        for (list, value) in self.nodes.iter_mut().zip(node) {
            list.push(value as f32);
        }
    }
}

/// Distance of the nodes of the outer rim.
fn spacing(outer: usize) -> f64 {
    std::f64::consts::TAU / outer as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::Pattern;

    #[test]
    fn contours_enclose_the_black_area() {
        let mut contours = Contours::default();
        let kind = Kind::plain("", 0.2, 0.08);
        let contour = contours.get(&kind, None, 90.0, 0.8);
        let [x, _, _, dy] = contour.nodes;
        let terms = x.iter().zip(dy);
        let area: f64 = terms.map(|(x, dy)| f64::from(x * dy)).sum();
        assert!((area - std::f64::consts::PI * (1.0 - 0.16)).abs() < 1e-5, "{area}");
        let pattern = Pattern::Elliptical { minor_diameter_m: 0.06 };
        let contour = contours.get(&Kind { pattern, ..kind }, None, 90.0, 0.8);
        let moment = |x: &[f32], dy: &[f32]| -> f64 {
            x.iter().zip(dy).map(|(x, dy)| f64::from(x * x * x * dy)).sum::<f64>() / 3.0
        };
        // ∬ x² of an ellipse is π a³ b/4; its longer axis lies along x.
        let expected = std::f64::consts::FRAC_PI_4 * (1.0 - 0.4f64.powi(3) * 0.3);
        let [x, _, _, dy] = contour.nodes;
        assert!((moment(x, dy) - expected).abs() < 1e-5);
    }

    #[test]
    fn contours_survive_eviction() {
        let mut contours = Contours::default();
        let kind = Kind::plain("", 0.2, 0.08);
        let first = |contours: &mut Contours| {
            let Contour { nodes, outer } = contours.get(&kind, None, 90.0, 0.8);
            (nodes.map(<[f32]>::to_vec), outer)
        };
        let before = first(&mut contours);
        // The cache holds two of them.
        for around_px in [41_000.0, 40_000.0, 42_000.0] {
            contours.get(&kind, None, around_px, 1.0);
            assert!(contours.nodes[0].len() <= MAX_NODES);
        }
        assert!(contours.cached.len() < 4);
        assert_eq!(first(&mut contours), before);
        let for_rim = contours.get(&kind, None, f64::INFINITY, 1.0);
        assert!(for_rim.outer == MAX_RIM_NODES && for_rim.nodes[0].len() <= MAX_NODES);
    }
}
