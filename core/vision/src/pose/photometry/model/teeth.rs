//! The rim of a coded print's white disc, teeth included, as quadrature nodes.
//!
//! Each of the 2N slots has an arc, at the disc's radius or, where its tooth is, at the core's; a
//! radial edge connects arcs of different radii. Equal steps do not converge across corners, so
//! every arc and every edge has Gauss-Legendre nodes of its own, spaced about like those of the
//! smooth outer rim.

use std::f64::consts::PI;

use crate::marker::CodeLayout;

/// The teeth of a print.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Teeth {
    /// Number of bits of its code.
    pub bits: u8,
    /// As printed, first bit most significant.
    pub word: u16,
}

/// Limit of the nodes of the outer rim that leaves space for those of teeth: arcs and edges are 1.2
/// outer rims long, with [`DENSITY`] nodes per length and [`EXTRA_NODES`] on each.
pub const MAX_OUTER_NODES: usize = 16_384;
/// Nodes of a panel over those of equal steps on a smooth curve …
const DENSITY: f64 = 1.3;
/// … and in addition.
const EXTRA_NODES: f64 = 0.7;
/// Longest panel, in spacings.
const PANEL_SPACINGS: f64 = 8.0;

/// A piece of the contour.
#[derive(Clone, Copy, Debug)]
enum Piece {
    /// At a radius, between two angles.
    Arc(f64, [f64; 2]),
    /// At an angle, between two radii.
    Edge(f64, [f64; 2]),
}

impl Teeth {
    /// Whether a slot, modulo the number of slots, holds a tooth; that of a 0 is in the first slot
    /// of its bit.
    fn is_tooth(self, slot: u32) -> bool {
        let bits = u32::from(self.bits);
        let slot = slot % (2 * bits);
        u32::from(self.word >> (bits - 1 - slot / 2) & 1) == slot % 2
    }

    /// Nodes (x, y, dx, dy) counter-clockwise around the white of a disc of radius `ratio`, spaced
    /// like steps of `spacing`; in outer radii.
    pub fn nodes(self, ratio: f64, spacing: f64) -> impl Iterator<Item = [f64; 4]> {
        self.pieces(ratio).flat_map(move |piece| piece.nodes(spacing))
    }

    fn pieces(self, ratio: f64) -> impl Iterator<Item = Piece> {
        let slot_rad = PI / f64::from(self.bits);
        let radius = move |slot: u32| {
            if self.is_tooth(slot) { ratio * CodeLayout::CORE_SHARE } else { ratio }
        };
        (0..2 * u32::from(self.bits)).flat_map(move |slot| {
            let (here, next) = (radius(slot), radius(slot + 1));
            let ends_rad = [slot, slot + 1].map(|slot| slot_rad * f64::from(slot));
            let edge = (here != next).then_some(Piece::Edge(ends_rad[1], [here, next]));
            std::iter::once(Piece::Arc(here, ends_rad)).chain(edge)
        })
    }
}

impl Piece {
    fn nodes(self, spacing: f64) -> impl Iterator<Item = [f64; 4]> {
        let (Self::Arc(_, [from, to]) | Self::Edge(_, [from, to])) = self;
        let length = match self {
            Self::Arc(radius, _) => radius * (to - from),
            Self::Edge(..) => (to - from).abs(),
        };
        let panels = (length / (PANEL_SPACINGS * spacing)).ceil().max(1.0);
        let count = (DENSITY * length / (panels * spacing) + EXTRA_NODES).ceil() as usize;
        let half = 0.5 * (to - from) / panels;
        (0..panels as usize).flat_map(move |panel| {
            let middle = from + half * (2.0 * panel as f64 + 1.0);
            (0..count).map(move |index| {
                let (place, weight) = gauss(count, index);
                self.node(middle + half * place, half * weight)
            })
        })
    }

    /// At a position between its ends, with a share of the length.
    fn node(self, place: f64, share: f64) -> [f64; 4] {
        match self {
            Self::Arc(radius, _) => {
                let (sin, cos) = place.sin_cos();
                [radius * cos, radius * sin, -radius * sin * share, radius * cos * share]
            }
            Self::Edge(angle, _) => {
                let (sin, cos) = angle.sin_cos();
                [place * cos, place * sin, cos * share, sin * share]
            }
        }
    }
}

/// Node and weight of Gauss-Legendre quadrature over [-1, 1].
fn gauss(count: usize, index: usize) -> (f64, f64) {
    let n = count as f64;
    let mut x = (PI * (index as f64 + 0.75) / (n + 0.5)).cos();
    let mut slope = 1.0;
    // Newton's steps from this close double the digits.
    for _ in 0..5 {
        let (mut before, mut value) = (0.0, 1.0);
        for degree in 0..count {
            let k = degree as f64;
            (before, value) = (value, ((2.0 * k + 1.0) * x * value - k * before) / (k + 1.0));
        }
        slope = n * (x * value - before) / (x * x - 1.0);
        x -= value / slope;
    }
    (x, 2.0 / ((1.0 - x * x) * slope * slope))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATIO: f64 = CodeLayout::RATIO;

    #[test]
    fn half_of_the_annulus_between_core_and_rim_is_white() {
        let core = RATIO * CodeLayout::CORE_SHARE;
        for (bits, word) in [(5, 1), (8, 0b0010_1101), (12, 0b0000_0101_0111), (16, 0x1357)] {
            for spacing in [0.02, 0.3] {
                let nodes = Teeth { bits, word }.nodes(RATIO, spacing);
                let area: f64 = nodes.map(|[x, y, dx, dy]| 0.5 * (x * dy - y * dx)).sum();
                let expected = 0.5 * PI * (RATIO * RATIO + core * core);
                assert!((area - expected).abs() < 1e-9, "{bits} bits: {area}");
            }
        }
    }

    #[test]
    fn teeth_are_where_the_layout_has_them() {
        let (bits, word) = (8, 0b0010_1101);
        let printed = CodeLayout { bits, min_distance: 1 }.teeth(word);
        let teeth = Teeth { bits, word };
        for slot in 0..16 {
            let middle_rad = (f64::from(slot) + 0.5) * PI / 8.0;
            let is_tooth = printed
                .iter()
                .any(|tooth| tooth.from_rad < middle_rad && middle_rad < tooth.to_rad);
            assert_eq!(teeth.is_tooth(slot), is_tooth, "slot {slot}");
        }
    }

    /// Error of the usual spacing, in units of the contrast, for a Gaussian anywhere.
    #[test]
    fn the_usual_spacing_is_accurate() {
        // An edge that blur and pixels have rounded.
        let deviation = 0.06;
        let image = |spacing: f64, [u, v]: [f64; 2]| -> f64 {
            let nodes = Teeth { bits: 8, word: 0b0010_1101 }.nodes(RATIO, spacing);
            let terms = nodes.map(|[x, y, dx, _]| {
                let (p, q) = ((x - u) / deviation, (y - v) / deviation);
                // An approximation of Φ that both sums share.
                let above = 1.0 / (1.0 + (-1.702 * q).exp());
                -above * (-0.5 * p * p).exp() * dx / (deviation * (2.0 * PI).sqrt())
            });
            terms.sum()
        };
        let usual = super::super::contour::SPACING_BLURS * deviation;
        let mut worst: f64 = 0.0;
        for i in 0..400 {
            let at = [f64::from(i % 20), f64::from(i / 20)].map(|k| 0.07 * (k - 9.7));
            worst = worst.max((image(usual, at) - image(0.2 * usual, at)).abs());
        }
        assert!(worst < 2e-3, "{worst}");
    }
}
