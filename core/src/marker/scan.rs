//! The search's first step: places that look like a roundel's disc, from single rows.
//!
//! Lighting differs over a frame, and no threshold suits all of it (paper, section 3.6). A row is
//! therefore not thresholded but cut into alternating valleys and peaks of at least the least
//! contrast. A peak between two valleys may be a disc between two sides of its ring; its own
//! threshold is halfway between them, eq. (3).
//!
//! Parallel chords of two concentric, similar ellipses have the same middle. So where a row or a
//! column crosses the disc, the black must be equally wide on both sides of the white. This test
//! costs a hundred pixels or so and leaves few candidates to be filled. The middle of a column's
//! chord and then that of the row through it are near the roundel's centre.

use crate::{
    frame::Frame,
    marker::{kind::RATIO_LIMITS, reject::Reject},
    segment::Window,
};

/// Rows are looked at in pairs, as their mean: less noise, and half the work.
pub(crate) const ROW_STEP: usize = 2;

/// White's share of two chords through the centre may differ by this much …
const RATIO_SLACK: f64 = 0.1;
/// … and by a pixel and a half of the shorter half chord.
const RATIO_SLACK_PX: f64 = 1.5;

/// A peak of a row between two valleys.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Peak {
    pub u: usize,
    pub white: u8,
    /// The brighter valley's level.
    pub black: u8,
}

/// A place to fill from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    /// A pixel of the disc near its centre.
    pub center: (usize, usize),
    /// A pixel of the ring in the same row.
    pub black: (usize, usize),
    /// Half the ring's chords through the centre, along u and v.
    pub half_chords_px: (f64, f64),
}

/// Means of the rows `v` and `v + 1` (of row `v` alone at the bottom).
pub(crate) fn pair_of_rows(frame: &Frame, v: usize, window: &Window, line: &mut Vec<u8>) {
    let columns = window.left..window.right;
    let upper = &frame.row(v)[columns.clone()];
    let lower = &frame.row((v + 1).min(frame.height() - 1))[columns];
    line.clear();
    line.extend(
        upper.iter().zip(lower).map(|(&a, &b)| (u16::from(a) + u16::from(b)).div_ceil(2) as u8),
    );
}

/// All peaks of a line that stand at least `contrast` above the valleys on both sides, which in turn
/// lie as far below what is beyond them.
pub(crate) fn find_peaks(line: &[u8], contrast: u8, peaks: &mut Vec<Peak>) {
    peaks.clear();
    let Some(&first) = line.first() else { return };
    let (mut low, mut high, mut high_at) = (first, first, 0);
    // The valley before the newest peak, once there was one with a fall before it.
    let mut before: Option<u8> = None;
    let mut peak: Option<Peak> = None;
    let mut rising = true;
    for (u, &value) in line.iter().enumerate() {
        if rising {
            if value > high {
                (high, high_at) = (value, u);
            } else if high - value >= contrast {
                peak = before.map(|black| Peak { u: high_at, white: high, black });
                (rising, low) = (false, value);
            }
        } else if value < low {
            low = value;
        } else if value - low >= contrast {
            if let Some(peak) = peak.take() {
                peaks.push(Peak { black: peak.black.max(low), ..peak });
            }
            before = Some(low);
            (rising, high, high_at) = (true, value, u);
        }
    }
}

/// White between two blacks along a row or column: the first white pixel, the first pixel past
/// it, and the same of the black round it.
#[derive(Clone, Copy, Debug)]
struct Chord {
    outer: (usize, usize),
    inner: (usize, usize),
}

impl Chord {
    fn middle(&self) -> usize {
        (self.inner.0 + self.inner.1 - 1) / 2
    }

    /// Share of white.
    fn ratio(&self) -> f64 {
        (self.inner.1 - self.inner.0) as f64 / (self.outer.1 - self.outer.0) as f64
    }

    fn half_px(&self) -> f64 {
        0.5 * (self.outer.1 - self.outer.0) as f64
    }

    /// Equal black on both sides, and a share of white that a roundel can have.
    fn is_even(&self) -> bool {
        let left = (self.inner.0 - self.outer.0) as f64;
        let right = (self.outer.1 - self.inner.1) as f64;
        let white = (self.inner.1 - self.inner.0) as f64;
        // Rows off the centre cross less of the disc, so there is only half of the least share to
        // be asked for; perspective and thresholds move the sides apart by a few pixels.
        let share = white / (left + white + right);
        (left - right).abs() <= 0.25 * left.max(right) + 2.0
            && share >= 0.5 * RATIO_LIMITS.0
            && share <= 0.5 * (1.0 + RATIO_LIMITS.1)
    }
}

/// The chord through pixel `at` of a line of `length`, no black side longer than `limit`.
fn chord(length: usize, at: usize, limit: usize, white: impl Fn(usize) -> bool) -> Option<Chord> {
    if !white(at) {
        return None;
    }
    let lowest = at.saturating_sub(limit);
    let highest = (at + limit).min(length);
    let inner_first = (lowest..at).rev().find(|&x| !white(x))? + 1;
    let outer_first = (lowest..inner_first - 1).rev().find(|&x| white(x))? + 1;
    let inner_end = (at + 1..highest).find(|&x| !white(x))?;
    let outer_end = (inner_end + 1..highest).find(|&x| white(x))?;
    Some(Chord { outer: (outer_first, outer_end), inner: (inner_first, inner_end) })
}

/// Looks along the row, the column and the row again through a peak.
pub(crate) fn cross(
    frame: &Frame,
    (u, v): (usize, usize),
    threshold: u8,
    min_axis_ratio: f64,
) -> Result<Candidate, Reject> {
    let along_row = |u: usize, v: usize, limit: usize| {
        let row = frame.row(v);
        chord(frame.width(), u, limit, |x| row[x] >= threshold)
            .filter(Chord::is_even)
            .ok_or(Reject::Chord)
    };
    let first = along_row(u, v, frame.width())?;
    let u = first.middle();
    let limit = (2.0 * first.half_px() / min_axis_ratio) as usize + 2;
    let column = chord(frame.height(), v, limit, |y| frame.row(y)[u] >= threshold)
        .filter(Chord::is_even)
        .ok_or(Reject::Chord)?;
    let v = column.middle();
    let row = along_row(u, v, limit)?;
    let u = row.middle();
    // Through the centre, white has the same share of every chord; both diagonals tell squares and
    // letters from rings.
    let white = |u: usize, v: usize| frame.row(v)[u] >= threshold;
    let (left, up, down) = (u.min(v), v.min(frame.width() - 1 - u), frame.height() - 1 - v);
    let falling = left + (frame.width() - 1 - u).min(down) + 1;
    let falling = chord(falling, left, limit, |x| white(u + x - left, v + x - left));
    let rising = up + u.min(down) + 1;
    let rising = chord(rising, up, limit, |x| white(u + up - x, v + x - up));
    let slack = RATIO_SLACK + RATIO_SLACK_PX / row.half_px().min(column.half_px());
    for diagonal in [falling, rising] {
        let diagonal = diagonal.filter(Chord::is_even).ok_or(Reject::Chord)?;
        if (diagonal.ratio() - row.ratio()).abs() > slack {
            return Err(Reject::Chord);
        }
    }
    Ok(Candidate {
        center: (row.middle(), v),
        black: ((row.outer.0 + row.inner.0) / 2, v),
        half_chords_px: (row.half_px(), column.half_px()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_needs_a_valley_on_both_sides() {
        let mut peaks = Vec::new();
        find_peaks(&[90, 90, 10, 12, 80, 82, 81, 20, 20, 90], 30, &mut peaks);
        assert_eq!(peaks, [Peak { u: 5, white: 82, black: 20 }]);
        // The first valley has nothing bright before it, the last nothing after.
        find_peaks(&[10, 80, 10], 30, &mut peaks);
        assert!(peaks.is_empty());
        find_peaks(&[90, 10, 80, 10], 30, &mut peaks);
        assert!(peaks.is_empty());
        find_peaks(&[], 30, &mut peaks);
        assert!(peaks.is_empty());
    }

    #[test]
    fn noise_below_the_contrast_makes_no_peak() {
        let line: Vec<u8> = (0..200).map(|u| 100 + (u * 7 % 19) as u8).collect();
        let mut peaks = Vec::new();
        find_peaks(&line, 20, &mut peaks);
        assert!(peaks.is_empty());
    }

    #[test]
    fn chords_must_be_even() {
        let line = [9, 0, 0, 0, 9, 9, 0, 0, 0, 9];
        let even = chord(10, 4, 10, |x| line[x] > 5).unwrap();
        assert_eq!((even.outer, even.inner), ((1, 9), (4, 6)));
        assert!(even.is_even());
        let line = [9, 0, 9, 9, 0, 0, 0, 0, 0, 0, 0, 9];
        assert!(!chord(12, 2, 12, |x| line[x] > 5).unwrap().is_even());
        assert!(chord(12, 0, 12, |x| line[x] > 5).is_none());
    }
}
