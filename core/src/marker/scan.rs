//! The search's first step: places that look like a roundel's disc, from the edges of single rows.
//!
//! Between a fall of the light and the next rise lies something black. Two of them that follow each
//! other, with white between, may be the two sides of a ring with its disc: parallel chords of two
//! concentric, similar ellipses have the same middle, so where a row crosses the disc, the black is
//! equally wide on both sides of the white. The grey levels that lie there give the threshold that
//! this place needs (paper, section 3.2, eq. (3)), whatever the light is elsewhere.
//!
//! A row of edges costs a few instructions for each 64 pixels ([`crate::marker::edge`]), and a few
//! for each edge; grey levels are looked at only where the widths agree.

use crate::marker::{cross::Evenness, edge::RowEdges};

/// An edge that is so many times weaker than one next to it may be texture or noise.
const TEXTURE: u16 = 4;
/// The margin's level is looked for so far beyond the ring's edge, half pixels.
const MARGIN_HALF_PX: i32 = 8;

/// A place on a row that may be a roundel's disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    /// Middle of the disc's chord, pixels from the row's start.
    pub u: usize,
    /// Half the chord of the ring, pixels.
    pub half_px: f64,
    /// The highest level of the disc, or of the darker side of the margin if that is below it.
    pub white: u8,
    /// The level of the brighter side of the ring.
    pub black: u8,
}

/// What a hit must look like.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HitRules {
    pub evenness: Evenness,
    /// Least chord of the ring, pixels.
    pub least_px: f64,
    /// Least difference of white and black.
    pub contrast: u8,
}

/// From a fall of the light to a rise, in half pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Black {
    fall: i32,
    rise: i32,
}

/// An edge of a row.
#[derive(Clone, Copy, Debug)]
struct Edge {
    /// Half pixels from the row's start.
    at: i32,
    /// Change of the light over two pixels.
    step: u16,
    falls: bool,
}

/// Memory of [`find_hits`].
#[derive(Debug, Default)]
pub(crate) struct HitScratch {
    plain: Plain,
    strong: Vec<Edge>,
    /// The hits of the newest row, from left to right.
    pub hits: Vec<Hit>,
}

/// All hits of a row, from left to right. With `inverted`, rises and falls change their roles and
/// levels are counted from white: a black disc in a white ring.
pub(crate) fn find_hits(
    row: &RowEdges,
    rules: &HitRules,
    inverted: bool,
    scratch: &mut HitScratch,
) {
    let (falls, rises) = if inverted { (&row.rises, &row.falls) } else { (&row.falls, &row.rises) };
    let line = row.line();
    let HitScratch { plain, strong, hits } = scratch;
    *plain = Plain::default();
    strong.clear();
    hits.clear();
    let (mut before_fall, mut before_rise) = (0, 0);
    for ((word, &down), &up) in (0..).zip(falls).zip(rises) {
        // Neighbouring bits are one edge; it lies in their middle.
        let mut starts = (down & !(down << 1 | before_fall)) | (up & !(up << 1 | before_rise));
        (before_fall, before_rise) = (down >> 63, up >> 63);
        while starts != 0 {
            let bit = starts.trailing_zeros();
            starts &= starts - 1;
            let falls = down >> bit & 1 == 1;
            let run = (if falls { down } else { up } >> bit).trailing_ones();
            let at = (128 * word + 2 * bit + run - 1) as i32;
            let middle = (at / 2) as usize;
            let (before, after) =
                (line[middle.saturating_sub(1)], line[(middle + 2).min(line.len() - 1)]);
            let edge = Edge { at, step: before.abs_diff(after).into(), falls };
            let by_strength = add_strong(strong, edge);
            let by_order = plain.add(edge);
            for ring in [by_strength, by_order.filter(|ring| by_strength != Some(*ring))] {
                hits.extend(ring.and_then(|ring| hit(line, &ring, rules, inverted)));
            }
        }
    }
}

/// Edges as they follow each other, whatever their strength: so the sides of a ring are found of
/// which one lies in the shadow.
#[derive(Debug, Default)]
struct Plain {
    fall: Option<i32>,
    last: Option<Black>,
}

impl Plain {
    /// The newest two blacks where an edge ends one. Of several falls the last one counts, of several
    /// rises the first.
    fn add(&mut self, edge: Edge) -> Option<[Black; 2]> {
        if edge.falls {
            self.fall = Some(edge.at);
            return None;
        }
        let black = Black { fall: self.fall.take()?, rise: edge.at };
        Some([self.last.replace(black)?, black])
    }
}

/// The same without the edges between two that are much stronger: so texture, noise and the waves
/// that a camera's sharpening leaves beside an edge part nothing.
fn add_strong(edges: &mut Vec<Edge>, edge: Edge) -> Option<[Black; 2]> {
    while edges.last().is_some_and(|last| TEXTURE * last.step < edge.step) {
        edges.pop();
    }
    match edges.last_mut() {
        Some(last) if last.falls == edge.falls => {
            if edge.falls && TEXTURE * edge.step >= last.step {
                *last = edge;
            }
            return None;
        }
        _ => edges.push(edge),
    }
    match edges[..] {
        [.., a, b, c, d] if !d.falls => {
            Some([Black { fall: a.at, rise: b.at }, Black { fall: c.at, rise: d.at }])
        }
        _ => None,
    }
}

fn hit(line: &[u8], [left, right]: &[Black; 2], rules: &HitRules, inverted: bool) -> Option<Hit> {
    let (a, b, c) = (left.rise - left.fall, right.fall - left.rise, right.rise - right.fall);
    let total = a + b + c;
    let [a_px, b_px, c_px] = [a, b, c].map(|half_px| 0.5 * f64::from(half_px));
    if 0.5 * f64::from(total) < rules.least_px || !rules.evenness.allows(a_px, b_px, c_px) {
        return None;
    }
    let flip = if inverted { 255 } else { 0 };
    let levels = |from: i32, to: i32| {
        let (from, to) = ((from / 2).max(0) as usize, (to as usize).div_ceil(2) + 1);
        line[from..to.min(line.len())].iter().map(move |&grey| grey ^ flip)
    };
    let disc = levels(left.rise, right.fall).max()?;
    let black = levels(left.fall, left.rise).min()?.max(levels(right.fall, right.rise).min()?);
    if disc < black.saturating_add(rules.contrast) {
        return None;
    }
    // Where the margin is narrow, blur makes it darker than the disc. What is hardly brighter than
    // the ring is texture in it, and no margin.
    let reach = MARGIN_HALF_PX;
    let margin = levels(left.fall - reach, left.fall)
        .max()?
        .min(levels(right.rise, right.rise + reach).max()?);
    let is_margin = TEXTURE * u16::from(margin.saturating_sub(black)) >= u16::from(disc - black);
    let white = if is_margin { disc.min(margin) } else { disc };
    let middle = rules.evenness.middle((left.fall, left.rise), (right.fall, right.rise));
    Some(Hit { u: (middle / 4) as usize, half_px: 0.25 * f64::from(total), white, black })
}

#[cfg(test)]
mod tests {
    use fearless_simd::Level;

    use super::*;
    use crate::{frame::Frame, marker::cross::Evenness, segment::Window};

    fn hits(line: &[u8], inverted: bool) -> Vec<Hit> {
        let frame = Frame::new(line, line.len(), 1, line.len()).unwrap();
        let mut row = RowEdges::default();
        row.read(Level::new(), &frame, 0, &Window::of(&frame), 12);
        let evenness = Evenness::of_plain((0.2, 0.8));
        let rules = HitRules { evenness, least_px: 6.0, contrast: 20 };
        let mut scratch = HitScratch::default();
        find_hits(&row, &rules, inverted, &mut scratch);
        scratch.hits
    }

    /// Stretches of a row as (pixels, level).
    fn row(stretches: &[(usize, u8)]) -> Vec<u8> {
        stretches.iter().flat_map(|&(width, level)| vec![level; width]).collect()
    }

    #[test]
    fn a_disc_lies_between_two_equal_blacks() {
        let line = row(&[(70, 90), (5, 200), (6, 30), (8, 210), (6, 40), (5, 190), (9, 90)]);
        let found = hits(&line, false);
        let [hit] = found[..] else { panic!("{found:?}") };
        assert_eq!((hit.u, hit.white, hit.black), (84, 190, 40));
        assert!((hit.half_px - 10.0).abs() <= 0.5, "{hit:?}");
        let inverted: Vec<u8> = line.iter().map(|grey| 255 - grey).collect();
        let found = hits(&inverted, true);
        let [hit] = found[..] else { panic!("{found:?}") };
        assert_eq!((hit.u, hit.white, hit.black), (84, 190, 40));
        let uneven = row(&[(70, 90), (5, 200), (6, 30), (8, 210), (14, 40), (5, 190), (9, 90)]);
        assert!(hits(&uneven, false).is_empty());
    }

    #[test]
    fn waves_beside_strong_edges_part_nothing() {
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
        assert!(hits(&line, false).iter().any(|hit| (24..=26).contains(&hit.u)));
    }

    #[test]
    fn a_side_in_the_shadow_counts_as_much() {
        for mirrored in [false, true] {
            let mut line = row(&[(9, 60), (6, 15), (5, 60), (5, 250), (6, 20), (9, 240)]);
            if mirrored {
                line.reverse();
            }
            assert!(hits(&line, false).iter().any(|hit| (19..=20).contains(&hit.u)), "{mirrored}");
        }
    }

    #[test]
    fn noise_below_the_contrast_makes_no_hit() {
        let line: Vec<u8> = (0..200).map(|u| 100 + (u * 7 % 19) as u8).collect();
        assert!(hits(&line, false).is_empty());
    }
}
