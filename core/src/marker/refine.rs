//! Rims to a fraction of a pixel, from grey levels.
//!
//! Counted pixels place a rim only where the threshold cuts it. Here each pixel near a rim counts by
//! its grey level: (I - B)/(W - B) of it is disc, (W - I)/(W - B) of it is roundel, with the black
//! level B and white level W taken next to the rims. Blur moves weight across a rim but loses none,
//! so area and centre of the weighted disc are those of the sharp one, and the semiaxes follow from
//! the area and the difference of the covariance's eigenvalues ([`Shape::ellipse`]), which blur does
//! not change either.
//!
//! Eight ellipses, parallel to the coarse rims, cut the plane into zones; one pass over the rows sums
//! grey levels and pixels of each zone, and the levels enter afterwards:
//!
//! | zone | between | the disc counts | the roundel counts | level from it |
//! | --- | --- | --- | --- | --- |
//! | 0 | – , inner - d | 1 | 1 | white of the disc |
//! | 1, 2 | , inner + g | by grey level | 1 | black (2) |
//! | 3 | , outer - g | 0 | 1 | black |
//! | 4, 5 | , outer + m | 0 | by grey level | black (4) |
//! | 6, 7 | two shells | – | – | white of the margin |
//!
//! The shells lie beyond m where the margin is wide. Where it is narrower, zone 5 ends earlier, the
//! shells end at m, and grey levels count in them too; where it is narrower still, or the ring near
//! the frame's edge, there are none, and the margin is taken to be as white as the disc.
//!
//! Where the ring is thin, g is half its width: what the disc's blur loses to the other side, the
//! ring's blur gives back. Pixels further off count 0 or 1, so noise comes from the rims alone.
//!
//! Blur also mixes the levels, and carries light past the cuts. For a straight edge both are known
//! functions of its deviation σ, which the disc's spread tells ([`Shape::spread_px2`]); levels, σ and
//! rims are found by turns.
//!
//! Accuracy against drawn rings (`tests/precision.rs`; inner/outer 0.4, margin 1.4, contrast 160, blur
//! 0.7 px, noise 2): with a known kind the mean radius has a bias below 0.05 % and a deviation of 0.04 %
//! at 30 px of diameter, 0.01 % at 81; at 20 px 0.1 and 0.1 %, and at 12 px 0.7 and 0.2 %.
//!
//! Limits: where the disc's shorter semiaxis is below three times the blur, rims come out short (2 to
//! 3 % at 12 px and a blur of 1.1); a margin narrower than 2 px makes them long by up to 0.1 px.
//!
//! A linear change of lighting leaves areas and axes but moves centres; its gradient is measured in
//! black and margin, and the movement taken out.

use crate::{
    camera::PixelPoint,
    ellipse::{Chords, Ellipse, Moments, Shape},
    frame::Frame,
    marker::{
        examine::{Coarse, check_similarity},
        reject::Reject,
    },
};

/// How far from a rim grey levels count, pixels: beyond it, a blur of 1 px has moved 0.002 px.
const REACH_PX: f64 = 2.5;
/// The margin's level is taken from two shells that begin, meet and end at these distances beyond the
/// rim: where there is room, beyond what blur and a camera's sharpening do to the edge …
const FAR_SHELLS_PX: [f64; 3] = [REACH_PX, 3.25, 4.0];
/// … and else as far out as grey levels count.
const NEAR_SHELLS_PX: [f64; 3] = [1.4, 1.95, REACH_PX];
/// Least shorter semiaxis of rings that are tried with the far shells first; the margin of smaller
/// ones is seldom as wide.
const FAR_SEMI_MINOR_PX: f64 = 12.0;
/// The margin that is sure to be there, as a share of the outer semiaxis …
const SURE_MARGIN_SHARE: f64 = 0.15;
/// … of which so many pixels are left to the blur of its own edge, but never all of it.
const MARGIN_EDGE_PX: f64 = 0.8;
/// Least reach beyond the outer rim, pixels.
const LEAST_REACH_PX: f64 = 0.6;
/// The margin is white where its level does not fall outwards by more than this share of the contrast
/// and so many grey levels …
const MARGIN_FALL: (f64, f64) = (0.012, 0.4);
/// … and does not vary by more than this.
const MARGIN_DEVIATION: (f64, f64) = (0.1, 3.0);
/// Deviation of the blurred edge, pixels, where the measured one is out of this range.
const BLUR_LIMITS_PX: (f64, f64) = (0.4, 1.6);
/// Variance that a cut through pixels adds to an edge: 1/12 along u, nothing along v.
const CUT_SPREAD_PX2: f64 = 1.0 / 24.0;
/// Turns in which levels and blur are found.
const BLUR_TURNS: usize = 2;
/// Turns in which they and the rims are found.
const RIM_TURNS: usize = 2;
/// Least distance of the outer rim from the frame's edge, pixels.
const EDGE_PX: f64 = 1.0;
/// Rims may move by this much from where counted pixels had them, pixels and share of the radius.
const MOVE_TOLERANCE: (f64, f64) = (0.7, 0.03);
/// Difference of the two rims' normalized shapes, and what a disc of r pixels adds to it as 1/r.
const SIMILARITY_TOLERANCE: (f64, f64) = (0.1, 0.35);

/// A ring's rims, and the levels next to them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fine {
    pub outer: Ellipse,
    pub inner: Ellipse,
    pub black: f64,
    pub white: f64,
}

/// Places both rims by grey levels.
pub(crate) fn refine(
    frame: &Frame,
    coarse: &Coarse,
    scratch: &mut RowScratch,
) -> Result<Fine, Reject> {
    let to_edge_px = reach_to_edge(frame, &coarse.outer);
    if to_edge_px < EDGE_PX {
        return Err(Reject::FrameEdge);
    }
    let room = |shells: [f64; 3]| to_edge_px >= shells[2];
    let far = room(FAR_SHELLS_PX) && coarse.outer.semi_minor_px >= FAR_SEMI_MINOR_PX;
    let sure_px = SURE_MARGIN_SHARE * coarse.outer.semi_minor_px - MARGIN_EDGE_PX;
    let sure_px = sure_px.clamp(LEAST_REACH_PX, REACH_PX.min(to_edge_px));
    let ways = [
        far.then_some((REACH_PX, Some(FAR_SHELLS_PX))),
        room(NEAR_SHELLS_PX).then_some((REACH_PX, Some(NEAR_SHELLS_PX))),
        Some((sure_px, None)),
    ];
    let fine = ways.into_iter().flatten().find_map(|(reach_px, shells_px)| {
        solve(&Zones::collect(frame, coarse, Cuts::new(coarse, reach_px, shells_px), scratch))
    });
    let fine = fine.ok_or(Reject::Profile)?;
    check_moves(coarse, &fine)?;
    check_similarity(&fine.outer, &fine.inner, SIMILARITY_TOLERANCE)?;
    Ok(fine)
}

/// Distance from the ellipse's box to the centres of the frame's outermost pixels.
fn reach_to_edge(frame: &Frame, rim: &Ellipse) -> f64 {
    let (half_u, half_v) = rim.half_box_px();
    let PixelPoint { u, v } = rim.center;
    (u - half_u)
        .min(v - half_v)
        .min((frame.width() - 1) as f64 - (u + half_u))
        .min((frame.height() - 1) as f64 - (v + half_v))
}

/// Sums over the pixels of one zone, u and v from the common origin.
#[derive(Clone, Copy, Debug, Default)]
struct Zone {
    pixels: Moments,
    grey: Moments,
    grey_squared: f64,
}

impl Zone {
    fn mean(&self) -> f64 {
        self.grey.n / self.pixels.n
    }
}

const ZONES: usize = 8;

/// Distances of the cuts from the rims, pixels.
#[derive(Clone, Copy, Debug)]
struct Cuts {
    /// d: the disc's core begins this far inside its rim.
    core_px: f64,
    /// g: grey levels count so far into the black, from the inner and from the outer rim.
    grey_px: (f64, f64),
    /// The black's level is taken so far from the inner and the outer rim.
    black_px: (f64, f64),
    /// m: grey levels count so far into the margin.
    reach_px: f64,
    /// The margin's level is taken from two shells between these distances; `None` if the margin is
    /// too narrow to have one.
    shells_px: Option<[f64; 3]>,
    /// Width of the black ring.
    ring_px: f64,
}

impl Cuts {
    fn new(coarse: &Coarse, reach_px: f64, shells_px: Option<[f64; 3]>) -> Self {
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
    fn margin_band(&self) -> std::ops::RangeInclusive<usize> {
        match self.shells_px {
            Some(shells) if shells[0] >= self.reach_px => 4..=5,
            _ => 4..=7,
        }
    }

    /// The same cuts, measured from rims further out by (inner, outer) pixels.
    fn seen_from(&self, (inner, outer): (f64, f64)) -> Self {
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
    /// edge holds σ²/4, of which ∫ x Φ(-x/σ) dx from the cut on is beyond it.
    fn spread_share(&self, blur_px: f64) -> f64 {
        if blur_px <= 0.0 {
            return 1.0;
        }
        let beyond = |distance_px: f64| {
            let z = distance_px / blur_px;
            let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
            0.5 * ((1.0 - z * z) * upper_tail(z) + z * density).max(0.0)
        };
        (1.0 - 2.0 * (beyond(self.grey_px.0) + beyond(self.core_px))).max(0.3)
    }
}

struct Zones {
    zones: [Zone; ZONES],
    origin: (usize, usize),
    cuts: Cuts,
    outer: Ellipse,
    inner: Ellipse,
}

impl Zones {
    fn collect(frame: &Frame, coarse: &Coarse, cuts: Cuts, scratch: &mut RowScratch) -> Self {
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

    fn pixels(&self, range: std::ops::RangeInclusive<usize>) -> Moments {
        let mut sum = Moments::default();
        self.zones[range].iter().for_each(|zone| sum.add(&zone.pixels, 1.0));
        sum
    }

    fn grey(&self, range: std::ops::RangeInclusive<usize>) -> Moments {
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

/// Memory of [`refine`]: one row's prefix sums.
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

/// Grey levels next to the rims.
#[derive(Clone, Copy, Debug)]
struct Levels {
    black: f64,
    disc: f64,
    margin: f64,
}

impl Levels {
    /// Black and the disc's white, with the deviation of the blurred edge, pixels. The blur follows
    /// from the levels (by the disc's spread) and the levels from the blur (which mixes them), so
    /// both are found by turns. The margin is taken to be as white as the disc.
    fn of_disc(zones: &Zones, cuts: &Cuts, blur_px: f64) -> Option<(Self, f64)> {
        let black = zones.grey(2..=4).n / zones.pixels(2..=4).n;
        let disc = zones.zones[0].mean();
        let measured = Self { black, disc, margin: disc };
        let (mut levels, mut blur_px) = (measured.unmixed(zones, cuts, blur_px), blur_px);
        for _ in 0..BLUR_TURNS {
            let seen = disc_shape(zones, &levels)?.spread_px2() / cuts.spread_share(blur_px);
            blur_px = seen.max(0.0).sqrt().clamp(BLUR_LIMITS_PX.0, BLUR_LIMITS_PX.1);
            levels = measured.unmixed(zones, cuts, blur_px);
        }
        Some((levels, blur_px))
    }

    /// The levels without the blur that mixes black into white and white into black.
    fn unmixed(&self, zones: &Zones, cuts: &Cuts, blur_px: f64) -> Self {
        let between = |from_px: f64, to_px: f64| {
            (moved_px(from_px, blur_px) - moved_px(to_px, blur_px)) / (to_px - from_px)
        };
        let (near_inner, near_outer) = cuts.black_px;
        let of_black = between(near_inner, cuts.ring_px - near_outer)
            + between(near_outer, cuts.ring_px - near_inner);
        let core = zones.inner.grown(-zones.cuts.core_px).mean_radius_px();
        let rim = core + cuts.core_px;
        let of_disc = 2.0 * rim * moved_px(cuts.core_px, blur_px) / (core * core);
        let (of_black, of_disc) = (of_black.clamp(0.0, 0.4), of_disc.clamp(0.0, 0.4));
        // Measured black = black + share × (white - black), and the same of white, solved for both.
        let contrast = (self.disc - self.black) / (1.0 - of_black - of_disc);
        let disc = self.disc + of_disc * contrast;
        Self { black: self.black - of_black * contrast, disc, margin: disc }
    }

    /// These levels with the margin's own from the two shells, or `None` if they are not white margin
    /// alone.
    fn margin(
        &self,
        zones: &Zones,
        [from_px, parted_px, to_px]: [f64; 3],
        blur_px: f64,
    ) -> Option<Self> {
        let (near, far) = (&zones.zones[6], &zones.zones[7]);
        let unmixed = |zone: &Zone, from_px: f64, to_px: f64| {
            let of_margin =
                (moved_px(from_px, blur_px) - moved_px(to_px, blur_px)) / (to_px - from_px);
            (zone.mean() - of_margin * self.black) / (1.0 - of_margin)
        };
        let near_level = unmixed(near, from_px, parted_px);
        let far_level = unmixed(far, parted_px, to_px);
        let contrast = far_level - self.black;
        let falls = near_level - far_level > MARGIN_FALL.0 * contrast + MARGIN_FALL.1;
        // What a gradient of the lighting explains is no deviation.
        let g = slope(&far.pixels, &far.grey);
        let explained = (far.pixels.uu * g.0 * g.0
            + 2.0 * far.pixels.uv * g.0 * g.1
            + far.pixels.vv * g.1 * g.1)
            / far.pixels.n;
        let variance = far.grey_squared / far.pixels.n - far.mean().powi(2) - explained;
        let limit = (MARGIN_DEVIATION.0 * contrast).powi(2) + MARGIN_DEVIATION.1.powi(2);
        if contrast > 0.0 && !falls && variance <= limit {
            let (n, m) = (near.pixels.n, far.pixels.n);
            Some(Self { margin: (n * near_level + m * far_level) / (n + m), ..*self })
        } else {
            None
        }
    }
}

/// ∫ Φ(-x/σ) dx from `distance_px` to infinity: how far a blur of the deviation σ moves an edge's
/// light past a cut at this distance, pixels. With z = distance/σ that is σ (φ(z) - z Φ(-z)).
/// Sharing a pixel between the sides of the cut blurs it once more, by the pixel's width along u.
fn moved_px(distance_px: f64, blur_px: f64) -> f64 {
    let blur_px = (blur_px * blur_px + CUT_SPREAD_PX2).sqrt();
    if distance_px > 6.0 * blur_px {
        return 0.0;
    }
    let z = distance_px / blur_px;
    let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    (blur_px * (density - z * upper_tail(z))).max(0.0)
}

/// Φ(-z), to 1e-5 (Abramowitz and Stegun, 26.2.16).
fn upper_tail(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.33267 * z.abs());
    let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    let tail = density * t * (0.436_183_6 + t * (-0.120_167_6 + t * 0.937_298_0));
    if z < 0.0 { 1.0 - tail } else { tail }
}

/// Least-squares gradient of the grey level over a zone.
fn slope(pixels: &Moments, grey: &Moments) -> (f64, f64) {
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

/// Levels, blur and rims, found by turns: how the blur mixes the levels depends on the distances
/// between the cuts and the rims. `None` if the rims cannot be placed, or if the shells meant for the
/// margin's level hold something else.
fn solve(zones: &Zones) -> Option<Fine> {
    let mut cuts = zones.cuts;
    let mut blur_px = 0.0;
    let mut fine = None;
    for _ in 0..RIM_TURNS {
        let (levels, blur) = Levels::of_disc(zones, &cuts, blur_px)?;
        blur_px = blur;
        let placed = match cuts.shells_px {
            Some(shells_px) => {
                let levels = levels.margin(zones, shells_px, blur_px)?;
                place(zones, &cuts, &levels, (blur_px, gradient(zones)))?
            }
            None => place(zones, &cuts, &levels, (blur_px, (0.0, 0.0)))?,
        };
        let moved = |to: &Ellipse, from: &Ellipse| {
            (to.mean_radius_px() - from.mean_radius_px()).clamp(-0.4, 0.4)
        };
        cuts = zones
            .cuts
            .seen_from((moved(&placed.inner, &zones.inner), moved(&placed.outer, &zones.outer)));
        fine = Some(placed);
    }
    fine
}

/// Both rims from the zones' sums and the levels, with what the blur carries past the cuts brought
/// back.
fn place(
    zones: &Zones,
    cuts: &Cuts,
    levels: &Levels,
    (blur_px, gradient): (f64, (f64, f64)),
) -> Option<Fine> {
    let to_disc = levels.disc - levels.black;
    let to_margin = levels.margin - levels.black;

    // Light brighter by γ·x on one side adds γ·x / (W - B) to the disc's weights there, and takes
    // as much from the roundel's.
    let disc = disc_shape(zones, levels)?;
    let disc = undisturbed(disc, &zones.pixels(1..=2), gradient, to_disc);
    let roundel = roundel_shape(zones, levels)?;
    let roundel =
        undisturbed(roundel, &zones.pixels(zones.cuts.margin_band()), gradient, -to_margin);
    let (inner, outer) = (disc.ellipse(), roundel.ellipse());

    let beyond = |distance_px: f64| moved_px(distance_px, blur_px);
    let share = inner.mean_radius_px() / outer.mean_radius_px();
    let outer = outer.grown(
        beyond(cuts.reach_px) - beyond(cuts.grey_px.1)
            + share * beyond(cuts.ring_px - cuts.grey_px.1),
    );
    let inner = inner.grown(
        beyond(cuts.grey_px.0)
            - beyond(cuts.core_px)
            - beyond(cuts.ring_px - cuts.grey_px.0) / share,
    );
    let (black, white) = (levels.black, levels.disc);
    (outer.is_valid() && inner.is_valid()).then_some(Fine { outer, inner, black, white })
}

fn disc_shape(zones: &Zones, levels: &Levels) -> Option<Shape> {
    let contrast = levels.disc - levels.black;
    if contrast.is_nan() || contrast <= 0.0 {
        return None;
    }
    let mut disc = zones.zones[0].pixels;
    disc.add(&zones.grey(1..=2), 1.0 / contrast);
    disc.add(&zones.pixels(1..=2), -levels.black / contrast);
    disc.shape(zones.origin)
}

fn roundel_shape(zones: &Zones, levels: &Levels) -> Option<Shape> {
    let contrast = levels.margin - levels.black;
    if contrast.is_nan() || contrast <= 0.0 {
        return None;
    }
    let mut roundel = zones.pixels(0..=3);
    let band = zones.cuts.margin_band();
    roundel.add(&zones.pixels(band.clone()), levels.margin / contrast);
    roundel.add(&zones.grey(band), -1.0 / contrast);
    roundel.shape(zones.origin)
}

/// Change of the grey level by pixel along u and v, mean of black and white.
fn gradient(zones: &Zones) -> (f64, f64) {
    let black = slope(&zones.pixels(2..=4), &zones.grey(2..=4));
    let white = slope(&zones.pixels(6..=7), &zones.grey(6..=7));
    (0.5 * (black.0 + white.0), 0.5 * (black.1 + white.1))
}

/// The shape with its centre moved back by what a gradient of the lighting has moved it.
fn undisturbed(shape: Shape, band: &Moments, gradient: (f64, f64), contrast: f64) -> Shape {
    let (mu, mv) = (band.u / band.n, band.v / band.n);
    let uu = band.uu - band.n * mu * mu;
    let uv = band.uv - band.n * mu * mv;
    let vv = band.vv - band.n * mv * mv;
    let scale = 1.0 / (contrast * shape.area_px2);
    let center = PixelPoint {
        u: shape.center.u - (uu * gradient.0 + uv * gradient.1) * scale,
        v: shape.center.v - (uv * gradient.0 + vv * gradient.1) * scale,
    };
    Shape { center, ..shape }
}

/// Grey levels that are a roundel's leave the rims about where counted pixels had them.
fn check_moves(coarse: &Coarse, fine: &Fine) -> Result<(), Reject> {
    for (from, to) in [(&coarse.outer, &fine.outer), (&coarse.inner, &fine.inner)] {
        let limit = MOVE_TOLERANCE.0 + MOVE_TOLERANCE.1 * from.mean_radius_px();
        let moved = (to.center.u - from.center.u)
            .hypot(to.center.v - from.center.v)
            .max((to.semi_major_px - from.semi_major_px).abs())
            .max((to.semi_minor_px - from.semi_minor_px).abs());
        if moved > limit {
            return Err(Reject::Profile);
        }
    }
    Ok(())
}
