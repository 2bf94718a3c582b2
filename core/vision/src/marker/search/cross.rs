//! Second step of the search: chords through a hit, along the column, the row and both diagonals.
//!
//! The middle of the column's chord and then that of the row through it are near the roundel's
//! centre. Through the centre, white has the same share of every chord, and the half chords r of an
//! ellipse at 0°, 45°, 90° and 135° obey
//!
//!   1/r₀² + 1/r₉₀² = 1/r₄₅² + 1/r₁₃₅²
//!
//! (both sides are the trace of the ellipse's matrix), which excludes squares and letters.
//! These four chords also determine the whole ring: points all around it are sampled before any segment is filled.

use crate::{
    frame::Frame,
    marker::{
        kind::Polarity,
        reject::Reject,
        search::{
            chord::{Binary, Evenness},
            hits::Hit,
        },
    },
};

/// Distance of the ring's middle from the disc's as a share of the ring's radius …
const CENTER_SHARE: f64 = 0.3;
/// … and in pixels; one of the limits must hold.
const CENTER_PX: f64 = 1.5;
/// White's shares of two chords through the centre may differ by [`Evenness::ratio_slack`] and this
/// many pixels of the shorter half chord.
const RATIO_SLACK_PX: f64 = 1.5;
/// The half chords' traces may differ by this share …
const TRACE_SHARE: f64 = 0.12;
/// … plus the effect of this error in each half chord, pixels.
const TRACE_PX: f64 = 0.6;
/// Uncertainty of semiaxes derived from the chords, pixels.
const AXIS_PX: f64 = 1.0;
/// Rings with black at least this wide are sampled all around, pixels.
const ROUND_PX: f64 = 4.0;
/// Distance of the sampled margin from the ring: a share of the radius, and at least in pixels.
const MARGIN: (f64, f64) = (0.06, 1.5);
/// How many of the eight points may be wrong, in the ring and in the margin each.
const WRONG_POINTS: usize = 1;

/// A place from which to fill segments.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    /// A pixel of the disc near its centre.
    pub center: (usize, usize),
    /// The ring's centre; perspective moves it off the disc's.
    pub ring_center: (f64, f64),
    /// Half the sides of the ring's box, along u and v.
    pub half_box_px: (f64, f64),
    /// Pixels below it are black.
    pub threshold: u8,
}

/// Limits for the chords.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CrossRules {
    pub evenness: Evenness,
    /// Smallest ratio of the ring's axes.
    pub min_axis_ratio: f64,
    /// Smallest shorter semiaxis of the ring, pixels.
    pub min_semi_minor_px: f64,
    /// Where the ring is certainly black, as a share of its radius; `None`: midway between disc and
    /// rim.
    pub black_at: Option<f64>,
}

/// Tests the chords through a hit.
pub(crate) fn cross(
    frame: &Frame,
    hit: &Hit,
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
    let (u, v) = (hit.u, hit.v);
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
    shape.check_round(&binary, center, ring_center, black_at, share)?;
    Ok(Candidate { center, ring_center, half_box_px: shape.half_box_px(), threshold })
}

/// Half chords through an ellipse's centre.
struct Halves {
    along_u: f64,
    along_v: f64,
    diagonals: [f64; 2],
}

/// An approximate ellipse: a u² + 2 b u v + c v² = 1.
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

    /// The ellipse's centre x, from the intersection of its diagonal chords: the middle of a chord
    /// along d is t = dᵀ M x / dᵀ M d steps away, for d = (1, 1) and (1, -1).
    fn center(&self, [falling, rising]: [f64; 2]) -> (f64, f64) {
        let Self { a, b, c } = self;
        let (right_1, right_2) = (falling * (a + 2.0 * b + c), rising * (a - 2.0 * b + c));
        let determinant = 2.0 * (b * b - a * c);
        let u = (right_1 * (b - c) - right_2 * (b + c)) / determinant;
        let v = (right_2 * (a + b) - right_1 * (a - b)) / determinant;
        (u, v)
    }

    /// Tests ring and margin between the directions of the four chords: black between the rims
    /// about the disc's centre, white beyond the ring about its own.
    fn check_round(
        &self,
        binary: &Binary,
        (u, v): (usize, usize),
        ring_center: (f64, f64),
        black_at: f64,
        white_share: f64,
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

    #[test]
    fn four_chords_give_the_ellipse_and_reject_a_square() {
        let rules = CrossRules {
            evenness: Evenness::plain((0.2, 0.8)),
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
