//! The search's second step: chords through a hit, along the column, the row and both diagonals.
//!
//! The middle of the column's chord and then that of the row through it are near the roundel's
//! centre. Through the centre, white has the same share of every chord, and the half chords r of an
//! ellipse at 0°, 45°, 90° and 135° obey
//!
//!   1/r₀² + 1/r₉₀² = 1/r₄₅² + 1/r₁₃₅²
//!
//! (both sides are the trace of the ellipse's matrix), which tells squares and letters from rings.
//! These four chords also say where the whole ring must be: points all the way round it are looked
//! up before anything is filled.

use crate::{
    frame::Frame,
    marker::{kind::Polarity, reject::Reject, scan::Hit},
};

/// Perspective moves the disc off the ring's middle by (1 - ratio²)·(R/f)·tan(tilt) of the shorter
/// semiaxis: for a tilt to 60° and no less than half of the frame's width as focal length f, the
/// sides of a chord of so many frame widths differ by this share …
const PERSPECTIVE_SHARE: f64 = 2.4;
/// … and never by more.
const MOST_SIDE_SHARE: f64 = 0.55;
/// The ring's middle may be off the disc's by this share of the ring's radius there …
const CENTER_SHARE: f64 = 0.3;
/// … and by so many pixels.
const CENTER_PX: f64 = 1.5;
/// White's share of two chords through the centre may differ by this much …
pub(crate) const RATIO_SLACK: f64 = 0.1;
/// … and by a pixel and a half of the shorter half chord.
const RATIO_SLACK_PX: f64 = 1.5;
/// Pixels by which perspective, blur and thresholds move the two sides of a chord apart.
const SIDE_SLACK_PX: f64 = 1.5;

/// With teeth, ring and tooth (460 of 700) may stand against the ring alone (280 of 700), which off the
/// centre grows to twice that …
const TEETH_SIDE_SHARE: f64 = 0.5;
/// … and the core (480 of 1400) against the whole disc (840 of 1400).
const TEETH_RATIO_SLACK: f64 = 0.3;
/// Black that ends before so large a share of the way from the centre is its own is no ring with or
/// without a tooth (280 of 700 at least) but a tooth whose corner the way has cut.
const TEETH_BLACK_SHARE: f64 = 0.3;
/// The half chords' traces may differ by this share …
const TRACE_SHARE: f64 = 0.12;
/// … and by what an error of so many pixels in each half chord makes.
const TRACE_PX: f64 = 0.6;
/// Axes are known to so many pixels from the chords.
const AXIS_PX: f64 = 1.0;
/// Rings whose black is at least so wide are looked up all the way round, pixels.
const ROUND_PX: f64 = 4.0;
/// So far beyond the ring lies its margin, as a share of the radius and at least in pixels.
const MARGIN: (f64, f64) = (0.06, 1.5);
/// Of the eight points in the ring, in the disc and in the margin, one each may be wrong.
const WRONG_POINTS: usize = 1;

/// How even black must be on both sides of white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Evenness {
    /// The sides' difference as a share of the wider one.
    pub side_share: f64,
    /// What each pixel of a chord adds to it, for the perspective of large rings.
    pub share_per_px: f64,
    /// Least and largest share of white.
    pub white: (f64, f64),
    /// White's shares of two chords through the centre may differ by this much.
    pub ratio_slack: f64,
    /// The middle of the ring's chord is that of the roundel; else, that of the disc's.
    pub outer_middle: bool,
    /// The least share of the way from the centre that is the ring's black.
    pub black_share: f64,
}

impl Evenness {
    /// That of plain rings of these ratios of diameters.
    pub fn of_plain((least, most): (f64, f64)) -> Self {
        // Rows off the centre cross less of the disc, so there is only half of the least share to be
        // asked for.
        Self {
            side_share: 0.25,
            share_per_px: 0.0,
            white: (0.5 * least, 0.5 * (1.0 + most)),
            ratio_slack: RATIO_SLACK,
            outer_middle: false,
            black_share: 0.0,
        }
    }

    /// Room for teeth round the disc that leave a core of this share of it: they widen one side or
    /// the other, and only the ring's rim is where it would be.
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
    pub fn seen_in(self, width: usize) -> Self {
        Self { share_per_px: PERSPECTIVE_SHARE / width as f64, ..self }
    }

    fn side_share_of(&self, total: f64) -> f64 {
        let most = MOST_SIDE_SHARE.max(self.side_share);
        (self.side_share + self.share_per_px * total).min(most)
    }

    /// Whether left black, white and right black of these widths can be a chord.
    pub fn allows(&self, left: f64, white: f64, right: f64) -> bool {
        let total = left + white + right;
        // All at once: a branch for each costs more than it saves.
        ((left - right).abs() <= self.side_share_of(total) * left.max(right) + SIDE_SLACK_PX)
            & (white >= self.white.0 * total)
            & (white <= self.white.1 * total)
    }

    /// Most steps that an even chord goes on, where it has the ring's black and the white beyond it so
    /// many steps before.
    fn room_after(&self, (black, white): (i32, i32)) -> usize {
        let side = f64::from(white - black);
        let other = (side + SIDE_SLACK_PX) / (1.0 - self.side_share_of(4.0 * f64::from(white)));
        let disc = self.white.1 / (1.0 - self.white.1) * (side + other);
        (disc - f64::from(black) + other).max(0.0) as usize + 2
    }

    /// Four times the middle of a chord, from twice the ends of its two black sides.
    pub fn middle(&self, left: (i32, i32), right: (i32, i32)) -> i32 {
        if self.outer_middle { left.0 + right.1 } else { left.1 + right.0 }
    }
}

/// A place to fill from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    /// A pixel of the disc near its centre.
    pub center: (usize, usize),
    /// The ring's centre, off the disc's where perspective moves it.
    pub ring_center: (f64, f64),
    /// Half the sides of the ring's box, along u and v.
    pub half_box_px: (f64, f64),
    /// Pixels below it are black.
    pub threshold: u8,
}

/// What the chords must look like.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CrossRules {
    pub evenness: Evenness,
    /// Smallest ratio of the ring's axes.
    pub min_axis_ratio: f64,
    /// Smallest shorter semiaxis of the ring, pixels.
    pub min_semi_minor_px: f64,
    /// Where the ring is surely black, as a share of its radius; `None`: midway to the disc.
    pub black_at: Option<f64>,
}

/// White between two blacks along a line, counted in steps from the place where it was looked for:
/// the first white pixel and the first past it, and the same of the black round it.
#[derive(Clone, Copy, Debug)]
struct Chord {
    outer: (i32, i32),
    inner: (i32, i32),
}

impl Chord {
    fn white_share(&self) -> f64 {
        f64::from(self.inner.1 - self.inner.0) / f64::from(self.outer.1 - self.outer.0)
    }

    fn half(&self) -> f64 {
        0.5 * f64::from(self.outer.1 - self.outer.0)
    }

    fn is_even(&self, evenness: &Evenness) -> bool {
        let width = |(from, to): (i32, i32)| f64::from(to - from);
        let left = width((self.outer.0, self.inner.0));
        evenness.allows(left, width(self.inner), width((self.inner.1, self.outer.1)))
    }

    /// Steps to the roundel's middle.
    fn middle(&self, evenness: &Evenness) -> isize {
        let (from, to) = if evenness.outer_middle { self.outer } else { self.inner };
        ((from + to - 1) >> 1) as isize
    }
}

/// A frame as black and white.
#[derive(Clone, Copy)]
struct Binary<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
    threshold: u8,
    /// Bits of a pixel that are turned over: all of them where black and white change roles.
    flip: u8,
    /// See [`Evenness::black_share`].
    black_share: f64,
}

impl Binary<'_> {
    fn is_white(&self, index: usize) -> bool {
        self.pixels[index] ^ self.flip >= self.threshold
    }

    /// The same for places that may lie outside, where nothing is white.
    fn is_white_at(&self, (u, v): (f64, f64)) -> bool {
        let (u, v) = (u.round(), v.round());
        let inside = u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64;
        inside && self.is_white(v as usize * self.stride + u as usize)
    }

    /// Steps from a white pixel to the first one of the ring's black, and on to the first white one.
    fn side(&self, from: usize, step: isize, room: usize) -> Option<(i32, i32)> {
        let mut at = from;
        let mut steps = 0;
        let mut walk = |white: bool| {
            while steps < room {
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

    /// The chord through (u, v) in steps of (du, dv), at most `limit` of them on each side; of one that
    /// is surely uneven, nothing.
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
        let room = |at: usize, size: usize, d: isize| match d {
            0 => usize::MAX,
            1 => size - 1 - at,
            _ => at,
        };
        let rooms = |sign: isize| {
            limit.min(room(u, self.width, sign * du)).min(room(v, self.height, sign * dv))
        };
        let step = dv * self.stride as isize + du;
        let before = self.side(from, -step, rooms(-1))?;
        let after = self.side(from, step, rooms(1).min(evenness.room_after(before)))?;
        Some(Chord { outer: (1 - before.1, after.1), inner: (1 - before.0, after.0) })
    }

    fn even_chord(
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

/// Looks along column, row and diagonals through a hit in row `v`, whose `u` counts from the
/// frame's side.
pub(crate) fn cross(
    frame: &Frame,
    (hit, v): (&Hit, usize),
    threshold: u8,
    rules: &CrossRules,
    polarity: Polarity,
) -> Result<Candidate, Reject> {
    let (pixels, stride) = frame.pixels();
    let flip = polarity.flip();
    let (width, height) = (frame.width(), frame.height());
    let evenness = &rules.evenness;
    let black_share = evenness.black_share;
    let binary = Binary { pixels, width, height, stride, threshold, flip, black_share };
    let limit = (2.0 * hit.half_px / rules.min_axis_ratio) as usize + 2;
    let u = hit.u;
    let column = binary.even_chord((u, v), (0, 1), limit, evenness)?;
    let v = v.wrapping_add_signed(column.middle(evenness));
    let row = binary.even_chord((u, v), (1, 0), limit, evenness)?;
    let moved = row.middle(evenness);
    let center = (u.wrapping_add_signed(moved), v);
    let slack = evenness.ratio_slack + RATIO_SLACK_PX / row.half().min(column.half());
    let mut diagonals = [0.0; 2];
    let mut middles = [0.0; 2];
    let through = diagonals.iter_mut().zip(&mut middles);
    for ((half, middle), step) in through.zip([(1, 1), (1, -1)]) {
        let chord = binary.even_chord(center, step, limit, evenness)?;
        if (chord.white_share() - row.white_share()).abs() > slack {
            return Err(Reject::Chord);
        }
        *half = std::f64::consts::SQRT_2 * chord.half();
        *middle = 0.5 * f64::from(chord.outer.0 + chord.outer.1 - 1);
    }
    let shape = Halves { along_u: row.half(), along_v: column.half(), diagonals }.shape(rules)?;
    let share = row.white_share();
    let black_at = rules.black_at.unwrap_or(0.5 * (1.0 + share));
    let (du, dv) = shape.center(middles);
    if shape.radii((du, dv)) > CENTER_SHARE && du.hypot(dv) > CENTER_PX {
        return Err(Reject::Chord);
    }
    let ring_center = (center.0 as f64 + du, center.1 as f64 + dv);
    shape.check_round(&binary, center, ring_center, (black_at, share))?;
    Ok(Candidate { center, ring_center, half_box_px: shape.half_box_px(), threshold })
}

/// Half chords through an ellipse's centre.
struct Halves {
    along_u: f64,
    along_v: f64,
    diagonals: [f64; 2],
}

/// A coarse ellipse: a u² + 2 b u v + c v² = 1.
struct Coarse {
    a: f64,
    b: f64,
    c: f64,
}

impl Halves {
    fn shape(&self, rules: &CrossRules) -> Result<Coarse, Reject> {
        let [falling, rising] = self.diagonals;
        let inverse = |half: f64| 1.0 / (half * half);
        let (a, c) = (inverse(self.along_u), inverse(self.along_v));
        let (d, e) = (inverse(falling), inverse(rising));
        let error: f64 = [self.along_u, self.along_v, falling, rising]
            .iter()
            .map(|half| 2.0 * TRACE_PX * inverse(*half) / half)
            .sum();
        if (a + c - d - e).abs() > TRACE_SHARE * 0.5 * (a + c + d + e) + error {
            return Err(Reject::Chord);
        }
        let shape = Coarse { a, b: 0.5 * (d - e), c };
        // Eigenvalues are the inverse squares of the semiaxes.
        let mean = 0.5 * (a + c);
        let spread = (0.5 * (a - c)).hypot(shape.b);
        let minor = 1.0 / (mean + spread).sqrt() + AXIS_PX;
        if minor < rules.min_semi_minor_px {
            return Err(Reject::TooSmall);
        }
        let flattest = minor / rules.min_axis_ratio;
        if mean - spread <= 0.0 || 1.0 / (mean - spread).sqrt() > flattest + AXIS_PX {
            return Err(Reject::Tilt);
        }
        Ok(shape)
    }
}

impl Coarse {
    fn half_box_px(&self) -> (f64, f64) {
        let determinant = self.a * self.c - self.b * self.b;
        ((self.c / determinant).sqrt(), (self.a / determinant).sqrt())
    }

    /// A distance from the centre in radii of that direction.
    fn radii(&self, (u, v): (f64, f64)) -> f64 {
        (self.a * u * u + 2.0 * self.b * u * v + self.c * v * v).sqrt()
    }

    /// The ellipse's centre x, from the place where its diagonal chords meet: the middle of a chord
    /// along d is t = dᵀ M x / dᵀ M d steps away, for d = (1, 1) and (1, -1).
    fn center(&self, [falling, rising]: [f64; 2]) -> (f64, f64) {
        let Self { a, b, c } = self;
        let (right_1, right_2) = (falling * (a + 2.0 * b + c), rising * (a - 2.0 * b + c));
        let determinant = 2.0 * (b * b - a * c);
        let u = (right_1 * (b - c) - right_2 * (b + c)) / determinant;
        let v = (right_2 * (a + b) - right_1 * (a - b)) / determinant;
        (u, v)
    }

    /// Whether ring and margin are there between the directions of the four chords: black between
    /// the rims about the disc's centre, white beyond the ring about its own.
    fn check_round(
        &self,
        binary: &Binary,
        (u, v): (usize, usize),
        ring_center: (f64, f64),
        (black_at, white_share): (f64, f64),
    ) -> Result<(), Reject> {
        let (mut open, mut bridged) = (0, 0);
        // 22.5° and on in steps of 45°.
        let (near, far) = (0.923_879_532_511_286_7, 0.382_683_432_365_089_8);
        for (x, y) in [(near, far), (far, near), (-far, near), (-near, far)] {
            let radius = 1.0 / self.radii((x, y));
            if radius * (1.0 - white_share) < ROUND_PX {
                continue;
            }
            let beyond = radius + (MARGIN.0 * radius).max(MARGIN.1);
            for (x, y) in [(x, y), (-x, -y)] {
                let at = |(u, v): (f64, f64), r: f64| (u + r * x, v + r * y);
                let disc_center = (u as f64, v as f64);
                open += usize::from(binary.is_white_at(at(disc_center, black_at * radius)));
                bridged += usize::from(!binary.is_white_at(at(ring_center, beyond)));
            }
        }
        if open > WRONG_POINTS {
            Err(Reject::Chord)
        } else if bridged > WRONG_POINTS {
            Err(Reject::BlackTooLarge)
        } else {
            Ok(())
        }
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
        let evenness = Evenness::of_plain((0.2, 0.8));
        let line = [9, 0, 0, 0, 9, 9, 0, 0, 0, 9];
        let even = binary(&line, 10).chord((4, 0), (1, 0), 10, &evenness).unwrap();
        assert_eq!((even.outer, even.inner), ((-3, 5), (0, 2)));
        assert_eq!(even.middle(&evenness), 0);
        assert!(even.is_even(&evenness));
        // The same along a column, and with the roles changed.
        let column = Binary { flip: 255, threshold: 250, ..binary(&line, 1) };
        assert!(column.chord((0, 4), (0, 1), 10, &evenness).is_none());
        let line: Vec<u8> = line.iter().map(|grey| 255 - grey).collect();
        let column = Binary { flip: 255, ..binary(&line, 1) };
        assert!(column.chord((0, 4), (0, 1), 10, &evenness).unwrap().is_even(&evenness));
        // A tooth's corner is passed over.
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

    #[test]
    fn four_chords_give_the_ellipse_and_refuse_a_square() {
        let rules = CrossRules {
            evenness: Evenness::of_plain((0.2, 0.8)),
            min_axis_ratio: 0.25,
            min_semi_minor_px: 4.0,
            black_at: None,
        };
        // Semiaxes 20 and 10 at 30°.
        let (cos, sin) = (0.75f64.sqrt(), 0.5f64);
        let half = |x: f64, y: f64| {
            let (along, across) = (x * cos + y * sin, y * cos - x * sin);
            1.0 / ((along / 20.0).powi(2) + (across / 10.0).powi(2)).sqrt()
        };
        let s = 0.5f64.sqrt();
        let halves = Halves {
            along_u: half(1.0, 0.0),
            along_v: half(0.0, 1.0),
            diagonals: [half(s, s), half(s, -s)],
        };
        let (half_u, half_v) = halves.shape(&rules).unwrap().half_box_px();
        assert!((half_u - (400.0 * 0.75 + 100.0 * 0.25f64).sqrt()).abs() < 1e-9);
        assert!((half_v - (400.0 * 0.25 + 100.0 * 0.75f64).sqrt()).abs() < 1e-9);
        let diagonals = [10.0 / s; 2];
        let square = Halves { along_u: 10.0, along_v: 10.0, diagonals };
        assert_eq!(square.shape(&rules).err(), Some(Reject::Chord));
        let small = Halves { along_u: 2.5, along_v: 2.5, diagonals: [2.5; 2] };
        assert_eq!(small.shape(&rules).err(), Some(Reject::TooSmall));
    }
}
