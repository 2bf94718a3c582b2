//! Zones round a ring's rims, and sums of pixels and grey levels over each of them.
//!
//! Eight ellipses parallel to the coarse rims are the cuts; a zone lies between two of them. One pass
//! over the rows gives, by prefix sums, what lies inside each cut; the difference of two is a zone.

use crate::{
    ellipse::{Chords, Ellipse, Moments},
    frame::Frame,
    marker::{blur::spread_beyond, examine::Coarse},
};

/// How far from a rim grey levels count, pixels: beyond it, a blur of 1 px has moved 0.002 px.
pub(crate) const REACH_PX: f64 = 2.5;

/// Sums over the pixels of one zone, u and v from the common origin.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Zone {
    pub pixels: Moments,
    pub grey: Moments,
    pub grey_squared: f64,
}

impl Zone {
    pub fn mean(&self) -> f64 {
        self.grey.n / self.pixels.n
    }
}

const ZONES: usize = 8;

/// Distances of the cuts from the rims, pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cuts {
    /// d: the disc's core begins this far inside its rim.
    pub core_px: f64,
    /// g: grey levels count so far into the black, from the inner and from the outer rim.
    pub grey_px: (f64, f64),
    /// The black's level is taken so far from the inner and the outer rim.
    pub black_px: (f64, f64),
    /// m: grey levels count so far into the margin.
    pub reach_px: f64,
    /// The margin's level is taken from two shells between these distances; `None` if the margin is
    /// too narrow to have one.
    pub shells_px: Option<[f64; 3]>,
    /// Width of the black ring.
    pub ring_px: f64,
}

impl Cuts {
    pub fn new(coarse: &Coarse, reach_px: f64, shells_px: Option<[f64; 3]>) -> Self {
        let ring_px = (coarse.outer.semi_minor_px - coarse.inner.semi_minor_px).max(0.1);
        let grey_px = (0.5 * ring_px).min(REACH_PX);
        let black_px = grey_px - 0.5 * grey_px.min(1.0);
        Self {
            core_px: (0.55 * coarse.inner.semi_minor_px).min(2.0),
            grey_px: (grey_px, grey_px),
            black_px: (black_px, black_px),
            reach_px,
            shells_px,
            ring_px,
        }
    }

    /// The zones beyond the black in which grey levels count.
    pub fn margin_band(&self) -> std::ops::RangeInclusive<usize> {
        match self.shells_px {
            Some(shells) if shells[0] >= self.reach_px => 4..=5,
            _ => 4..=7,
        }
    }

    /// The same cuts, measured from rims further out by (inner, outer) pixels.
    pub fn seen_from(&self, (inner, outer): (f64, f64)) -> Self {
        Self {
            core_px: self.core_px + inner,
            grey_px: (self.grey_px.0 - inner, self.grey_px.1 + outer),
            black_px: (self.black_px.0 - inner, self.black_px.1 + outer),
            reach_px: self.reach_px - outer,
            shells_px: self.shells_px.map(|shells| shells.map(|px| px - outer)),
            ring_px: self.ring_px + outer - inner,
        }
    }

    /// Share of the disc's spread, σ², that lies between the cuts: on either side of the rim the
    /// edge holds σ²/4, of which a part is beyond the cut.
    pub fn spread_share(&self, blur_px: f64) -> f64 {
        if blur_px <= 0.0 {
            return 1.0;
        }
        let beyond = |distance_px: f64| spread_beyond(distance_px, blur_px);
        (1.0 - 2.0 * (beyond(self.grey_px.0) + beyond(self.core_px))).max(0.3)
    }
}

pub(crate) struct Zones {
    pub zones: [Zone; ZONES],
    pub origin: (usize, usize),
    pub cuts: Cuts,
    pub outer: Ellipse,
    pub inner: Ellipse,
}

impl Zones {
    pub fn collect(frame: &Frame, coarse: &Coarse, cuts: Cuts, scratch: &mut RowScratch) -> Self {
        let (outer, inner) = (coarse.outer, coarse.inner);
        let shells_px = cuts.shells_px.unwrap_or([cuts.reach_px; 3]);
        let chords = [
            Chords::new(&inner.grown(-cuts.core_px)),
            Chords::new(&inner.grown(cuts.black_px.0)),
            Chords::new(&inner.grown(cuts.grey_px.0)),
            Chords::new(&outer.grown(-cuts.grey_px.1)),
            Chords::new(&outer.grown(-cuts.black_px.1)),
            Chords::new(&outer.grown(shells_px[0])),
            Chords::new(&outer.grown(shells_px[1])),
            Chords::new(&outer.grown(shells_px[2])),
        ];
        let origin = (outer.center.u as usize, outer.center.v as usize);
        let half_v = outer.grown(shells_px[2]).half_box_px().1;
        let top = (outer.center.v - half_v).ceil().max(0.0) as usize;
        let bottom = ((outer.center.v + half_v) as usize + 1).min(frame.height());
        let mut zones = [Zone::default(); ZONES];
        for v in top..bottom {
            add_row(&mut zones, &chords, frame, (v, origin), scratch);
        }
        // What lies inside a cut, less what lies inside the next one, is the zone between them.
        for zone in (1..ZONES).rev() {
            let within = zones[zone - 1];
            zones[zone].pixels.add(&within.pixels, -1.0);
            zones[zone].grey.add(&within.grey, -1.0);
            zones[zone].grey_squared -= within.grey_squared;
        }
        Self { zones, origin, cuts, outer, inner }
    }

    pub fn pixels(&self, range: std::ops::RangeInclusive<usize>) -> Moments {
        let mut sum = Moments::default();
        self.zones[range].iter().for_each(|zone| sum.add(&zone.pixels, 1.0));
        sum
    }

    pub fn grey(&self, range: std::ops::RangeInclusive<usize>) -> Moments {
        let mut sum = Moments::default();
        self.zones[range].iter().for_each(|zone| sum.add(&zone.grey, 1.0));
        sum
    }
}

/// Σ I, Σ I u, Σ I u², Σ I² of a row's pixels before one of them.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Prefix {
    s: i64,
    su: i64,
    suu: i64,
    squares: i64,
}

/// Memory of [`Zones::collect`]: one row's prefix sums.
pub(crate) type RowScratch = Vec<Prefix>;

/// A stretch of a row of the frame, columns from `start` on, with its prefix sums; u is counted from
/// the origin and `dv` is the row's distance from it.
struct Line<'a> {
    row: &'a [u8],
    prefix: &'a [Prefix],
    start: usize,
    origin: f64,
    dv: f64,
}

/// Sums of the row before a place, as [n, u, u², I, I u, I u², I²]; pixel u reaches from u - 1/2 to
/// u + 1/2. A pixel that a cut goes through belongs to both sides, by the share of its width: whole
/// pixels would make the sums jump as the rims move.
fn before(line: &Line, place: f64) -> [f64; 7] {
    let whole = ((place + 0.5) as usize - line.start).min(line.row.len() - 1);
    let share = place + 0.5 - (line.start + whole) as f64;
    let n = whole as f64;
    let first = line.start as f64 - line.origin;
    let du = first + n;
    // Σ k = n (n - 1) / 2 and Σ k² = n (n - 1) (2 n - 1) / 6 over 0 ≤ k < n.
    let k = 0.5 * n * (n - 1.0);
    let kk = k * (2.0 * n - 1.0) * (1.0 / 3.0);
    let prefix = &line.prefix[whole];
    let grey = f64::from(line.row[whole]) * share;
    [
        n + share,
        n * first + k + share * du,
        n * first * first + 2.0 * first * k + kk + share * du * du,
        prefix.s as f64 + grey,
        prefix.su as f64 + grey * du,
        prefix.suu as f64 + grey * du * du,
        prefix.squares as f64 + grey * f64::from(line.row[whole]),
    ]
}

/// Adds one row to the sums over what lies inside each cut.
fn add_row(
    inside: &mut [Zone; ZONES],
    chords: &[Chords; ZONES],
    frame: &Frame,
    (v, origin): (usize, (usize, usize)),
    scratch: &mut RowScratch,
) {
    let width = frame.width();
    // From the outside in, so that each chord stays inside the one round it even where the coarse
    // rims are not quite concentric.
    let mut spans = [(0.0, 0.0); ZONES];
    let (mut left, mut right) = (-0.5, width as f64 - 0.5);
    for zone in (0..ZONES).rev() {
        let (from, to) = chords[zone].span(v as f64);
        (left, right) = (from.clamp(left, right), to.clamp(left, right));
        spans[zone] = (left, right);
    }
    let (left, right) = spans[ZONES - 1];
    let start = ((left + 0.5) as usize).min(width - 1);
    let end = ((right + 0.5) as usize + 1).min(width);
    let row = &frame.row(v)[start..end];
    scratch.clear();
    let mut sum = Prefix::default();
    for (u, &grey) in (start as i64 - origin.0 as i64..).zip(row) {
        scratch.push(sum);
        let grey = i64::from(grey);
        sum.s += grey;
        sum.su += grey * u;
        sum.suu += grey * u * u;
        sum.squares += grey * grey;
    }
    let dv = v as f64 - origin.1 as f64;
    let line = Line { row, prefix: scratch, start, origin: origin.0 as f64, dv };
    for (zone, (left, right)) in inside.iter_mut().zip(spans) {
        if left < right {
            let (from, to) = (before(&line, left), before(&line, right));
            let sums: [f64; 7] = std::array::from_fn(|i| to[i] - from[i]);
            add_sums(&mut zone.pixels, [sums[0], sums[1], sums[2]], line.dv);
            add_sums(&mut zone.grey, [sums[3], sums[4], sums[5]], line.dv);
            zone.grey_squared += sums[6];
        }
    }
}

fn add_sums(moments: &mut Moments, [n, u, uu]: [f64; 3], dv: f64) {
    moments.n += n;
    moments.u += u;
    moments.v += n * dv;
    moments.uu += uu;
    moments.uv += u * dv;
    moments.vv += n * dv * dv;
}

/// Least-squares gradient of the grey level over a zone.
pub(crate) fn slope(pixels: &Moments, grey: &Moments) -> (f64, f64) {
    let n = pixels.n;
    let (mu, mv) = (pixels.u / n, pixels.v / n);
    let uu = pixels.uu - n * mu * mu;
    let uv = pixels.uv - n * mu * mv;
    let vv = pixels.vv - n * mv * mv;
    let (gu, gv) = (grey.u - grey.n * mu, grey.v - grey.n * mv);
    let determinant = uu * vv - uv * uv;
    if determinant.is_nan() || determinant <= 1e-6 * uu * vv {
        return (0.0, 0.0);
    }
    ((vv * gu - uv * gv) / determinant, (uu * gv - uv * gu) / determinant)
}
