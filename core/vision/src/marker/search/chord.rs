//! Chords of a ring along a line of pixels: black, white, black, and whether they are even.
//!
//! Parallel chords of two concentric, similar ellipses have the same middle, so black is as wide before
//! white as after it, except for perspective, which moves the disc off the ring's middle, and for teeth.

use crate::marker::reject::Reject;

/// Perspective moves the disc off the ring's middle by (1 - ratio²)·(R/f)·tan(tilt) of the shorter
/// semiaxis. For a tilt up to 60° and a focal length f of at least half the frame's width, this is
/// the difference of the sides per frame width of chord, as a share …
const PERSPECTIVE_SHARE: f64 = 2.4;
/// … and this is its maximum.
const MAX_SIDE_SHARE: f64 = 0.55;
/// White's shares of two chords through the centre may differ by this much.
pub(crate) const RATIO_SLACK: f64 = 0.1;
/// Difference of the two sides due to blur and thresholds, pixels.
const SIDE_SLACK_PX: f64 = 1.5;

/// With teeth, ring and tooth (460 of 700) may face the ring alone (280 of 700), which doubles off
/// the centre …
const TEETH_SIDE_SHARE: f64 = 0.5;
/// … and the core (480 of 1400) the whole disc (840 of 1400).
const TEETH_RATIO_SLACK: f64 = 0.3;
/// Black that is a smaller share of its distance from the centre is not the ring, with or without a
/// tooth (280 of 700 at least), but a clipped corner of a tooth.
const TEETH_BLACK_SHARE: f64 = 0.3;

/// How even black must be on both sides of white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Evenness {
    /// Difference of the sides as a share of the wider one.
    pub side_share: f64,
    /// Increase of `side_share` per pixel of the chord, for the perspective of large rings.
    pub share_per_px: f64,
    /// Smallest and largest share of white.
    pub white: (f64, f64),
    /// White's shares of two chords through the centre may differ by this much.
    pub ratio_slack: f64,
    /// The middle of the ring's chord is that of the roundel; otherwise that of the disc's chord.
    pub outer_middle: bool,
    /// Smallest share of black in the distance from the centre.
    pub black_share: f64,
}

impl Evenness {
    /// For plain rings with these ratios of diameters.
    pub fn plain((min, max): (f64, f64)) -> Self {
        // Rows off the centre cross less of the disc, hence only half of the smallest ratio.
        Self {
            side_share: 0.25,
            share_per_px: 0.0,
            white: (0.5 * min, 0.5 * (1.0 + max)),
            ratio_slack: RATIO_SLACK,
            outer_middle: false,
            black_share: 0.0,
        }
    }

    /// Tolerates teeth around the disc that leave a core of this share of it: they widen either
    /// side, and only the ring's outer rim is in place.
    pub fn with_teeth(self, core_share: f64) -> Self {
        Self {
            side_share: TEETH_SIDE_SHARE,
            share_per_px: self.share_per_px,
            white: (core_share * self.white.0, self.white.1),
            ratio_slack: TEETH_RATIO_SLACK,
            outer_middle: true,
            black_share: TEETH_BLACK_SHARE,
        }
    }

    /// The same in a frame of this width.
    pub fn for_width(self, width: usize) -> Self {
        Self { share_per_px: PERSPECTIVE_SHARE / width as f64, ..self }
    }

    #[inline]
    fn side_share_of(&self, total: f64) -> f64 {
        let max = MAX_SIDE_SHARE.max(self.side_share);
        (self.side_share + self.share_per_px * total).min(max)
    }

    /// Whether left black, white and right black of these widths can be a chord.
    #[inline]
    pub fn allows(&self, left: f64, white: f64, right: f64) -> bool {
        let total = left + white + right;
        // Without branches, which would cost more than they save.
        ((left - right).abs() <= self.side_share_of(total) * left.max(right) + SIDE_SLACK_PX)
            & (white >= self.white.0 * total)
            & (white <= self.white.1 * total)
    }

    /// Largest number of steps of an even chord on the other side, if black begins and ends after
    /// these numbers of steps on one side.
    #[inline]
    fn steps_after(&self, (black, white): (i32, i32)) -> usize {
        let side = f64::from(white - black);
        let other = (side + SIDE_SLACK_PX) / (1.0 - self.side_share_of(4.0 * f64::from(white)));
        let disc = self.white.1 / (1.0 - self.white.1) * (side + other);
        (disc - f64::from(black) + other).max(0.0) as usize + 2
    }

    /// Four times the middle of a chord, from twice the ends of its two black sides.
    #[inline]
    pub fn middle(&self, left: (i32, i32), right: (i32, i32)) -> i32 {
        if self.outer_middle { left.0 + right.1 } else { left.1 + right.0 }
    }
}

/// White between two blacks along a line, in steps from the starting point: the first white pixel
/// and the first past it, and likewise the black around it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chord {
    pub outer: (i32, i32),
    pub inner: (i32, i32),
}

impl Chord {
    #[inline]
    pub fn white_share(&self) -> f64 {
        f64::from(self.inner.1 - self.inner.0) / f64::from(self.outer.1 - self.outer.0)
    }

    #[inline]
    pub fn half(&self) -> f64 {
        0.5 * f64::from(self.outer.1 - self.outer.0)
    }

    #[inline]
    fn is_even(&self, evenness: &Evenness) -> bool {
        let width = |(from, to): (i32, i32)| f64::from(to - from);
        let left = width((self.outer.0, self.inner.0));
        evenness.allows(left, width(self.inner), width((self.inner.1, self.outer.1)))
    }

    /// Steps to the roundel's middle.
    #[inline]
    pub fn middle(&self, evenness: &Evenness) -> isize {
        let (from, to) = if evenness.outer_middle { self.outer } else { self.inner };
        ((from + to - 1) >> 1) as isize
    }
}

/// A frame, thresholded.
#[derive(Clone, Copy)]
pub(crate) struct Binary<'a> {
    pub pixels: &'a [u8],
    pub width: usize,
    pub height: usize,
    pub stride: usize,
    pub threshold: u8,
    /// Mask of the bits of a pixel to invert: all of them for a white ring.
    pub flip: u8,
    /// See [`Evenness::black_share`].
    pub black_share: f64,
}

impl Binary<'_> {
    #[inline]
    fn is_white(&self, index: usize) -> bool {
        self.pixels[index] ^ self.flip >= self.threshold
    }

    /// As `is_white`, for positions that may lie outside, where nothing is white.
    #[inline]
    pub fn is_white_at(&self, (u, v): (f64, f64)) -> bool {
        let (u, v) = (u.round(), v.round());
        let inside = u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64;
        inside && self.is_white(v as usize * self.stride + u as usize)
    }

    /// Steps from a white pixel to the first black one of the ring, and to the first white one
    /// behind it.
    #[inline]
    fn side(&self, from: usize, step: isize, limit: usize) -> Option<(i32, i32)> {
        let mut at = from;
        let mut steps = 0;
        let mut walk = |white: bool| {
            while steps < limit {
                steps += 1;
                at = at.wrapping_add_signed(step);
                if self.is_white(at) == white {
                    return Some(steps as i32);
                }
            }
            None
        };
        loop {
            let (black, white) = (walk(false)?, walk(true)?);
            if f64::from(white - black + 1) >= self.black_share * f64::from(white) {
                return Some((black, white));
            }
        }
    }

    /// The chord through (u, v) in steps of (du, dv), at most `limit` of them on each side; `None`
    /// if it is certainly uneven.
    fn chord(
        &self,
        (u, v): (usize, usize),
        (du, dv): (isize, isize),
        limit: usize,
        evenness: &Evenness,
    ) -> Option<Chord> {
        let from = v * self.stride + u;
        if !self.is_white(from) {
            return None;
        }
        let to_edge = |at: usize, size: usize, d: isize| match d {
            0 => usize::MAX,
            1 => size - 1 - at,
            _ => at,
        };
        let limits = |sign: isize| {
            limit.min(to_edge(u, self.width, sign * du)).min(to_edge(v, self.height, sign * dv))
        };
        let step = dv * self.stride as isize + du;
        let before = self.side(from, -step, limits(-1))?;
        let after = self.side(from, step, limits(1).min(evenness.steps_after(before)))?;
        Some(Chord { outer: (1 - before.1, after.1), inner: (1 - before.0, after.0) })
    }

    pub fn even_chord(
        &self,
        at: (usize, usize),
        step: (isize, isize),
        limit: usize,
        evenness: &Evenness,
    ) -> Result<Chord, Reject> {
        self.chord(at, step, limit, evenness)
            .filter(|chord| chord.is_even(evenness))
            .ok_or(Reject::Chord)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn binary(pixels: &[u8], width: usize) -> Binary<'_> {
        let height = pixels.len() / width;
        Binary { pixels, width, height, stride: width, threshold: 6, flip: 0, black_share: 0.0 }
    }

    #[test]
    fn chords_must_be_even() {
        let evenness = Evenness::plain((0.2, 0.8));
        let line = [9, 0, 0, 0, 9, 9, 0, 0, 0, 9];
        let even = binary(&line, 10).chord((4, 0), (1, 0), 10, &evenness).unwrap();
        assert_eq!((even.outer, even.inner), ((-3, 5), (0, 2)));
        assert_eq!(even.middle(&evenness), 0);
        assert!(even.is_even(&evenness));
        // The same along a column, and inverted.
        let column = Binary { flip: 255, threshold: 250, ..binary(&line, 1) };
        assert!(column.chord((0, 4), (0, 1), 10, &evenness).is_none());
        let line: Vec<u8> = line.iter().map(|grey| 255 - grey).collect();
        let column = Binary { flip: 255, ..binary(&line, 1) };
        assert!(column.chord((0, 4), (0, 1), 10, &evenness).unwrap().is_even(&evenness));
        // A clipped corner of a tooth is skipped.
        let mut line = [0; 24];
        line[7..16].fill(9);
        [line[0], line[17], line[23]] = [9; 3];
        let cut = binary(&line, 24).chord((9, 0), (1, 0), 24, &evenness).unwrap();
        assert_eq!((cut.outer, cut.inner), ((-8, 8), (-2, 7)));
        let toothed = Binary { black_share: 0.3, ..binary(&line, 24) };
        let whole = toothed.chord((9, 0), (1, 0), 24, &evenness).unwrap();
        assert_eq!((whole.outer, whole.inner), ((-8, 14), (-2, 9)));
        let line = [9, 0, 9, 9, 0, 0, 0, 0, 0, 0, 0, 9];
        let uneven = binary(&line, 12).chord((2, 0), (1, 0), 12, &evenness).unwrap();
        assert!(!uneven.is_even(&evenness));
        assert!(binary(&line, 12).chord((0, 0), (1, 0), 12, &evenness).is_none());
        assert!(binary(&line, 12).chord((2, 0), (1, 0), 3, &evenness).is_none());
    }
}
