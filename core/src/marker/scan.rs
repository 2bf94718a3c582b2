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

/// A place on a row that may be a roundel's disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    /// Middle of the disc's chord, pixels from the row's start.
    pub u: usize,
    /// Half the chord of the ring, pixels.
    pub half_px: f64,
    /// The disc's highest level.
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
#[derive(Clone, Copy, Debug)]
struct Black {
    fall: i32,
    rise: i32,
}

/// All hits of a row, from left to right. With `inverted`, rises and falls change their roles and
/// levels are counted from white: a black disc in a white ring.
pub(crate) fn find_hits(row: &RowEdges, rules: &HitRules, inverted: bool, hits: &mut Vec<Hit>) {
    hits.clear();
    let (falls, rises) = if inverted { (&row.rises, &row.falls) } else { (&row.falls, &row.rises) };
    let (mut before_fall, mut before_rise) = (0, 0);
    let mut fall = None;
    let mut left: Option<Black> = None;
    for ((word, &down), &up) in (0..).zip(falls).zip(rises) {
        // Neighbouring bits are one edge; it lies in their middle.
        let mut starts = (down & !(down << 1 | before_fall)) | (up & !(up << 1 | before_rise));
        (before_fall, before_rise) = (down >> 63, up >> 63);
        while starts != 0 {
            let bit = starts.trailing_zeros();
            starts &= starts - 1;
            let falling = down >> bit & 1 == 1;
            let run = (if falling { down } else { up } >> bit).trailing_ones();
            let at = (128 * word + 2 * bit + run - 1) as i32;
            if falling {
                fall = Some(at);
            } else if let Some(fall) = fall.take() {
                let right = Black { fall, rise: at };
                if let Some(left) = left.replace(right) {
                    hits.extend(hit(row.line(), &left, &right, rules, inverted));
                }
            }
        }
    }
}

fn hit(line: &[u8], left: &Black, right: &Black, rules: &HitRules, inverted: bool) -> Option<Hit> {
    let (a, b, c) = (left.rise - left.fall, right.fall - left.rise, right.rise - right.fall);
    let total = a + b + c;
    let [a_px, b_px, c_px] = [a, b, c].map(|half_px| 0.5 * f64::from(half_px));
    if 0.5 * f64::from(total) < rules.least_px || !rules.evenness.allows(a_px, b_px, c_px) {
        return None;
    }
    let flip = if inverted { 255 } else { 0 };
    let levels = |from: i32, to: i32| {
        let (from, to) = ((from / 2) as usize, (to as usize).div_ceil(2) + 1);
        line[from..to.min(line.len())].iter().map(move |&grey| grey ^ flip)
    };
    let white = levels(left.rise, right.fall).max()?;
    let black = levels(left.fall, left.rise).min()?.max(levels(right.fall, right.rise).min()?);
    if white < black.saturating_add(rules.contrast) {
        return None;
    }
    let middle = rules.evenness.middle((left.fall, left.rise), (right.fall, right.rise));
    Some(Hit { u: (middle / 4) as usize, half_px: 0.25 * f64::from(total), white, black })
}
