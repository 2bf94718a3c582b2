//! First step of the search: possible discs of roundels, from the edges of single rows.
//!
//! Between a fall of the light and the next rise lies something black. Two such runs in succession, with white between,
//! may be the two sides of a ring with its disc: parallel chords of two concentric, similar ellipses have the same
//! middle, so in a row that crosses the disc, black is equally wide on both sides of white. The grey levels there give
//! the local threshold (paper, section 3.2, eq. (3)), whatever the lighting elsewhere.
//!
//! A row costs a few instructions per 64 pixels ([`crate::marker::search::row_edges`]) and a few per edge; grey levels are
//! read only where the widths agree.

use crate::{
    marker::{
        kind::Polarity,
        search::{chord::Evenness, row_edges::RowEdges},
    },
    scratch::reserve_total,
};

/// Minimum steps of the edges considered together, as multiples of the smallest. Waves reach a
/// fifth of the contrast and edges at least half of it, so one of these lies between them.
const MIN_STEPS: [f64; 3] = [6.25, 2.5, 0.0];
/// A margin's contrast to the ring is at least that of the disc divided by this.
const TEXTURE: u16 = 4;
/// The margin's level is taken within this distance of the ring's edge, half pixels.
const MARGIN_HALF_PX: i32 = 8;

/// A place in a row that may be a roundel's disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    /// Middle of the disc's chord, in the frame.
    pub u: usize,
    pub v: usize,
    /// Half the chord of the ring, pixels.
    pub half_px: f64,
    /// The highest level of the disc, or of the darker side of the margin if that is lower.
    pub white: u8,
    /// The level of the brighter side of the ring.
    pub black: u8,
}

/// Limits for hits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HitRules {
    pub evenness: Evenness,
    /// Smallest chord of the ring, pixels.
    pub min_px: f64,
    /// Chords of the ring that are left to other rows, from and to, pixels.
    pub left_out_px: (f64, f64),
    /// Smallest difference of white and black.
    pub contrast: u8,
    /// Smallest step of an edge.
    pub step: u8,
}

/// From a fall of the light to a rise, in half pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct DarkRun {
    fall: i32,
    rise: i32,
}

/// An edge of a row.
#[derive(Clone, Copy, Debug, Default)]
struct Edge {
    /// Half pixels from the row's start.
    at: i32,
    /// Change of the light over two pixels.
    step: i32,
}

/// Memory of [`find_hits`].
#[derive(Debug, Default)]
pub(crate) struct HitScratch {
    edges: Vec<Edge>,
    strong: Vec<Edge>,
    dark_runs: Vec<DarkRun>,
    rings: Vec<[DarkRun; 2]>,
    stronger: Vec<[DarkRun; 2]>,
    /// The hits of the newest row.
    pub hits: Vec<Hit>,
}

impl HitScratch {
    /// Reserves memory for a row with an edge at each of `width` pixels, half of them falls.
    pub fn reserve(&mut self, width: usize) {
        reserve_total(&mut self.edges, width);
        reserve_total(&mut self.strong, width);
        reserve_total(&mut self.dark_runs, width);
        reserve_total(&mut self.rings, width);
        reserve_total(&mut self.stronger, width);
        reserve_total(&mut self.hits, MIN_STEPS.len() * width / 2);
    }
}

/// All hits of a row, those of strong edges first. For white rings, rises and falls change roles,
/// and levels are inverted.
///
/// Weak edges include the waves of a camera's sharpening and texture, which split a ring's sides;
/// strong edges alone miss a ring in shadow. So the row is evaluated with several minimum steps.
pub(crate) fn find_hits(
    row: &RowEdges,
    rules: &HitRules,
    polarity: Polarity,
    scratch: &mut HitScratch,
) {
    let HitScratch { edges, strong, dark_runs, rings, stronger, hits } = scratch;
    hits.clear();
    stronger.clear();
    collect_edges(row, polarity, edges);
    for times in MIN_STEPS {
        let min = (f64::from(rules.step) * times) as i32;
        compress(edges.iter().map(|edge| (*edge, edge.step.abs() >= min)), strong);
        // The last of several falls counts, and the first of several rises.
        let pairs = strong.windows(2).map(|pair| {
            let black = DarkRun { fall: pair[0].at, rise: pair[1].at };
            (black, (pair[0].step < 0) & (pair[1].step > 0))
        });
        compress(pairs, dark_runs);
        let pairs = dark_runs.windows(2).map(|pair| {
            let ring = [pair[0], pair[1]];
            (ring, is_even(&ring, rules))
        });
        compress(pairs, rings);
        // Both are sorted by position; weaker edges reproduce what strong edges have found.
        let mut found = stronger.iter().peekable();
        for ring in &*rings {
            while found.next_if(|earlier| earlier[1].rise < ring[1].rise).is_some() {}
            if found.peek() != Some(&ring) {
                hits.extend(hit(row, ring, rules, polarity));
            }
        }
        std::mem::swap(rings, stronger);
    }
}

/// All edges of a row. Adjacent bits are one edge, at their middle.
fn collect_edges(row: &RowEdges, polarity: Polarity, edges: &mut Vec<Edge>) {
    edges.clear();
    let line = row.line();
    let sign = if polarity == Polarity::WhiteRing { -1 } else { 1 };
    let (mut before_fall, mut before_rise) = (0, 0);
    for ((word, &down), &up) in (0..).zip(&row.falls).zip(&row.rises) {
        let mut starts = (down & !(down << 1 | before_fall)) | (up & !(up << 1 | before_rise));
        (before_fall, before_rise) = (down >> 63, up >> 63);
        while starts != 0 {
            let bit = starts.trailing_zeros();
            starts &= starts - 1;
            // A pixel cannot do both, so only one of them has a run starting here.
            let run = (down >> bit).trailing_ones() + (up >> bit).trailing_ones();
            let at = (128 * word + 2 * bit + run - 1) as i32;
            let middle = (at / 2) as usize;
            let before = line[middle.saturating_sub(1)];
            let after = line[(middle + 2).min(line.len() - 1)];
            edges.push(Edge { at, step: sign * (i32::from(after) - i32::from(before)) });
        }
    }
}

/// Keeps the wanted items without a branch per item, which would be unpredictable.
fn compress<T: Copy + Default>(items: impl ExactSizeIterator<Item = (T, bool)>, kept: &mut Vec<T>) {
    if kept.len() < items.len() {
        kept.resize(items.len(), T::default());
    }
    let mut count = 0;
    for (item, wanted) in items {
        kept[count] = item;
        count += usize::from(wanted);
    }
    kept.truncate(count);
}

fn is_even([left, right]: &[DarkRun; 2], rules: &HitRules) -> bool {
    let width = |from: i32, to: i32| 0.5 * f64::from(to - from);
    let total_px = width(left.fall, right.rise);
    let (a, b) = (width(left.fall, left.rise), width(left.rise, right.fall));
    (total_px >= rules.min_px)
        & ((total_px < rules.left_out_px.0) | (total_px > rules.left_out_px.1))
        & rules.evenness.allows(a, b, width(right.fall, right.rise))
}

fn hit(
    row: &RowEdges,
    [left, right]: &[DarkRun; 2],
    rules: &HitRules,
    polarity: Polarity,
) -> Option<Hit> {
    let (line, flip) = (row.line(), polarity.flip());
    let levels = |from: i32, to: i32| {
        let (from, to) = ((from / 2).max(0) as usize, (to as usize).div_ceil(2) + 1);
        line[from..to.min(line.len())].iter().map(move |&grey| grey ^ flip)
    };
    let disc = levels(left.rise, right.fall).max()?;
    let black = levels(left.fall, left.rise).min()?.max(levels(right.fall, right.rise).min()?);
    if disc < black.saturating_add(rules.contrast) {
        return None;
    }
    // Blur darkens a narrow margin below the disc. Levels hardly brighter than the ring are texture
    // in it, not margin.
    let reach = MARGIN_HALF_PX;
    let margin = levels(left.fall - reach, left.fall)
        .max()?
        .min(levels(right.rise, right.rise + reach).max()?);
    let is_margin = TEXTURE * u16::from(margin.saturating_sub(black)) >= u16::from(disc - black);
    let white = if is_margin { disc.min(margin) } else { disc };
    let middle = rules.evenness.middle((left.fall, left.rise), (right.fall, right.rise));
    Some(Hit {
        u: row.left + (middle / 4) as usize,
        v: row.v,
        half_px: 0.25 * f64::from(right.rise - left.fall),
        white,
        black,
    })
}

#[cfg(test)]
mod tests {
    use fearless_simd::Level;

    use super::*;
    use crate::{
        frame::{Frame, Window},
        marker::search::chord::Evenness,
    };

    fn hits(line: &[u8], polarity: Polarity) -> Vec<Hit> {
        let frame = Frame::new(line, line.len(), 1, line.len()).unwrap();
        let mut row = RowEdges::default();
        row.read(Level::new(), &frame, 0, &Window::of(&frame), 12);
        let evenness = Evenness::plain((0.2, 0.8));
        let rules = HitRules {
            evenness,
            min_px: 6.0,
            left_out_px: (f64::MAX, f64::MAX),
            contrast: 20,
            step: 12,
        };
        let mut scratch = HitScratch::default();
        find_hits(&row, &rules, polarity, &mut scratch);
        scratch.hits
    }

    /// A row made of (pixels, level).
    fn row(stretches: &[(usize, u8)]) -> Vec<u8> {
        stretches.iter().flat_map(|&(width, level)| vec![level; width]).collect()
    }

    #[test]
    fn a_disc_lies_between_two_equal_blacks() {
        let line = row(&[(70, 90), (5, 200), (6, 30), (8, 210), (6, 40), (5, 190), (9, 90)]);
        let found = hits(&line, Polarity::BlackRing);
        let [hit] = found[..] else { panic!("{found:?}") };
        assert_eq!((hit.u, hit.white, hit.black), (84, 190, 40));
        assert!((hit.half_px - 10.0).abs() <= 0.5, "{hit:?}");
        let inverted: Vec<u8> = line.iter().map(|grey| 255 - grey).collect();
        let found = hits(&inverted, Polarity::WhiteRing);
        let [hit] = found[..] else { panic!("{found:?}") };
        assert_eq!((hit.u, hit.white, hit.black), (84, 190, 40));
        let uneven = row(&[(70, 90), (5, 200), (6, 30), (8, 210), (14, 40), (5, 190), (9, 90)]);
        assert!(hits(&uneven, Polarity::BlackRing).is_empty());
    }

    #[test]
    fn waves_beside_strong_edges_do_not_split_a_ring() {
        let line = row(&[
            (9, 150),
            (3, 0),
            (4, 31),
            (3, 3),
            (3, 175),
            (8, 150),
            (3, 178),
            (3, 2),
            (4, 28),
            (3, 0),
            (9, 155),
        ]);
        assert!(hits(&line, Polarity::BlackRing).iter().any(|hit| (24..=26).contains(&hit.u)));
    }

    #[test]
    fn a_ring_half_in_shadow_is_found() {
        for mirrored in [false, true] {
            let mut line = row(&[(9, 60), (6, 15), (5, 60), (5, 250), (6, 20), (9, 240)]);
            if mirrored {
                line.reverse();
            }
            assert!(
                hits(&line, Polarity::BlackRing).iter().any(|hit| (19..=20).contains(&hit.u)),
                "{mirrored}"
            );
        }
    }

    #[test]
    fn noise_below_the_contrast_makes_no_hit() {
        let line: Vec<u8> = (0..200).map(|u| 100 + (u * 7 % 19) as u8).collect();
        assert!(hits(&line, Polarity::BlackRing).is_empty());
    }
}
