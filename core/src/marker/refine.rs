//! Rims to a fraction of a pixel, from grey levels.
//!
//! Counted pixels place a rim only where the threshold cuts it. Here each pixel near a rim counts by
//! its grey level: (I - B)/(W - B) of it is disc, (W - I)/(W - B) of it is roundel, with the black
//! level B and white level W taken next to the rims. Blur moves weight across a rim but loses none,
//! so area and centre of the weighted disc are those of the sharp one, and the semiaxes follow from
//! the area and the difference of the covariance's eigenvalues ([`Shape::ellipse`]), which blur does
//! not change either.
//!
//! Seven ellipses, parallel to the coarse rims, cut the plane into zones; one pass over the rows sums
//! grey levels and pixels of each zone, and the levels enter afterwards:
//!
//! | zone | between | the disc counts | the roundel counts | level from it |
//! | --- | --- | --- | --- | --- |
//! | 0 | – , inner - d | 1 | 1 | white of the disc |
//! | 1, 2 | , inner + g | by grey level | 1 | black (2) |
//! | 3 | , outer - g | 0 | 1 | black |
//! | 4, 5 | , outer + m | 0 | by grey level | black (4) |
//! | 6 | , outer + m | 0 | by grey level | white of the margin |
//!
//! Where the ring is thin, g is half its width: what the disc's blur loses to the other side, the
//! ring's blur gives back. Pixels further off count 0 or 1, so noise comes from the rims alone.
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
    segment::powers,
};

/// How far from a rim grey levels count, pixels: four times a blur of 0.6.
const REACH_PX: f64 = 2.5;
/// Where the margin's level begins, pixels beyond the rim.
const SHELL_PX: f64 = 1.4;
/// The margin that is sure to be there, as a share of the outer semiaxis.
const MARGIN_SHARE: f64 = 0.15;
/// The margin is taken for white if its grey levels' deviation is below this share of the contrast.
const MARGIN_DEVIATION: f64 = 0.16;
/// Least distance of the outer rim from the frame's edge, pixels.
const EDGE_PX: f64 = 1.0;
/// Rims may move by this much from where counted pixels had them, pixels and share of the radius.
const MOVE_TOLERANCE: (f64, f64) = (0.7, 0.03);

/// Difference of the two rims' normalized shapes, and what a disc of r pixels adds to it as 1/r.
const SIMILARITY_TOLERANCE: (f64, f64) = (0.1, 0.35);

const ZONES: usize = 7;

/// A ring's rims, and the levels next to them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fine {
    pub outer: Ellipse,
    pub inner: Ellipse,
    pub black: f64,
    pub white: f64,
}

/// Places both rims by grey levels.
pub(crate) fn refine(frame: &Frame, coarse: &Coarse) -> Result<Fine, Reject> {
    let reach_px = reach_to_edge(frame, &coarse.outer).min(REACH_PX);
    if reach_px < EDGE_PX {
        return Err(Reject::FrameEdge);
    }
    let sure_px = (MARGIN_SHARE * coarse.outer.semi_minor_px).max(EDGE_PX).min(reach_px);
    let mut zones = Zones::collect(frame, coarse, reach_px);
    let mut levels = Levels::of(&zones);
    if zones.reach_px < SHELL_PX + 0.5 || !levels.margin_is_white {
        if sure_px < reach_px {
            zones = Zones::collect(frame, coarse, sure_px);
            levels = Levels::of(&zones);
        }
        levels.margin = levels.disc;
        levels.gradient = (0.0, 0.0);
    }
    let fine = place(&zones, &levels).ok_or(Reject::Profile)?;
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

struct Zones {
    zones: [Zone; ZONES],
    origin: (usize, usize),
    reach_px: f64,
}

impl Zones {
    fn collect(frame: &Frame, coarse: &Coarse, reach_px: f64) -> Self {
        let (outer, inner) = (&coarse.outer, &coarse.inner);
        let half_ring_px = 0.5 * (outer.semi_minor_px - inner.semi_minor_px);
        let g = half_ring_px.min(REACH_PX);
        let q = 0.5 * g.min(1.0);
        let core_px = (0.55 * inner.semi_minor_px).min(2.0);
        let shell_px = SHELL_PX.min(0.6 * reach_px);
        let cuts = [
            Chords::new(&inner.grown(-core_px)),
            Chords::new(&inner.grown(g - q)),
            Chords::new(&inner.grown(g)),
            Chords::new(&outer.grown(-g)),
            Chords::new(&outer.grown(q - g)),
            Chords::new(&outer.grown(shell_px)),
            Chords::new(&outer.grown(reach_px)),
        ];
        let origin = (outer.center.u as usize, outer.center.v as usize);
        let half_v = outer.grown(reach_px).half_box_px().1;
        let top = (outer.center.v - half_v).ceil().max(0.0) as usize;
        let bottom = ((outer.center.v + half_v) as usize + 1).min(frame.height());
        let mut zones = [Zone::default(); ZONES];
        for v in top..bottom {
            add_row(&mut zones, &cuts, frame.row(v), v, origin);
        }
        Self { zones, origin, reach_px }
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

/// Adds one row's pixels to their zones.
fn add_row(
    zones: &mut [Zone; ZONES],
    cuts: &[Chords; ZONES],
    row: &[u8],
    v: usize,
    origin: (usize, usize),
) {
    // From the outside in, so that each chord stays inside the one round it even where the coarse
    // rims are not quite concentric.
    let (mut first, mut end) = ([0usize; ZONES], [0usize; ZONES]);
    let (mut left, mut right) = (0, row.len());
    for zone in (0..ZONES).rev() {
        let (a, b) = cuts[zone].columns(v as f64);
        left = (a.max(0) as usize).clamp(left, right);
        right = (b.max(0) as usize).clamp(left, right);
        (first[zone], end[zone]) = (left, right);
    }
    let dv = v as f64 - origin.1 as f64;
    for zone in 0..ZONES {
        if zone == 0 || first[zone - 1] == end[zone - 1] {
            add_piece(&mut zones[zone], row, (first[zone], end[zone]), origin.0, dv);
        } else {
            add_piece(&mut zones[zone], row, (first[zone], first[zone - 1]), origin.0, dv);
            add_piece(&mut zones[zone], row, (end[zone - 1], end[zone]), origin.0, dv);
        }
    }
}

fn add_piece(zone: &mut Zone, row: &[u8], (first, end): (usize, usize), origin: usize, dv: f64) {
    if first >= end {
        return;
    }
    let start = first as i64 - origin as i64;
    let (mut s, mut su, mut suu, mut squares) = (0i64, 0i64, 0i64, 0i64);
    for (u, &grey) in (start..).zip(&row[first..end]) {
        let grey = i64::from(grey);
        s += grey;
        su += grey * u;
        suu += grey * u * u;
        squares += grey * grey;
    }
    let (n, u, uu) = powers(start, end as i64 - origin as i64);
    add_sums(&mut zone.pixels, (n as f64, u as f64, uu as f64), dv);
    add_sums(&mut zone.grey, (s as f64, su as f64, suu as f64), dv);
    zone.grey_squared += squares as f64;
}

fn add_sums(moments: &mut Moments, (n, u, uu): (f64, f64, f64), dv: f64) {
    moments.n += n;
    moments.u += u;
    moments.v += n * dv;
    moments.uu += uu;
    moments.uv += u * dv;
    moments.vv += n * dv * dv;
}

/// Grey levels next to the rims.
struct Levels {
    black: f64,
    disc: f64,
    margin: f64,
    margin_is_white: bool,
    /// Change of the grey level by pixel along u and v, mean of black and white.
    gradient: (f64, f64),
}

impl Levels {
    fn of(zones: &Zones) -> Self {
        let (black_pixels, black_grey) = (zones.pixels(2..=4), zones.grey(2..=4));
        let black = black_grey.n / black_pixels.n;
        let disc = zones.zones[0].mean();
        let shell = &zones.zones[6];
        let margin = shell.mean();
        let gradient = {
            let black = slope(&black_pixels, &black_grey);
            let white = slope(&shell.pixels, &shell.grey);
            (0.5 * (black.0 + white.0), 0.5 * (black.1 + white.1))
        };
        // What the gradient explains is no deviation.
        let explained = {
            let g = slope(&shell.pixels, &shell.grey);
            let n = shell.pixels.n;
            (shell.pixels.uu * g.0 * g.0
                + 2.0 * shell.pixels.uv * g.0 * g.1
                + shell.pixels.vv * g.1 * g.1)
                / n
        };
        let variance = shell.grey_squared / shell.pixels.n - margin * margin - explained;
        let deviation = variance.max(0.0).sqrt();
        let margin_is_white = deviation < MARGIN_DEVIATION * (margin - black);
        Self { black, disc, margin, margin_is_white, gradient }
    }
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

/// Both rims from the zones' sums and the levels.
fn place(zones: &Zones, levels: &Levels) -> Option<Fine> {
    let (to_disc, to_margin) = (levels.disc - levels.black, levels.margin - levels.black);
    if to_disc.is_nan() || to_margin.is_nan() || to_disc <= 0.0 || to_margin <= 0.0 {
        return None;
    }
    let disc_band = zones.pixels(1..=2);
    let mut disc = zones.zones[0].pixels;
    disc.add(&zones.grey(1..=2), 1.0 / to_disc);
    disc.add(&disc_band, -levels.black / to_disc);

    let roundel_band = zones.pixels(4..=6);
    let mut roundel = zones.pixels(0..=3);
    roundel.add(&roundel_band, levels.margin / to_margin);
    roundel.add(&zones.grey(4..=6), -1.0 / to_margin);

    // Light brighter by γ·x on one side adds γ·x / (W - B) to the disc's weights there, and takes
    // as much from the roundel's.
    let inner = undisturbed(disc.shape(zones.origin)?, &disc_band, levels.gradient, to_disc);
    let outer =
        undisturbed(roundel.shape(zones.origin)?, &roundel_band, levels.gradient, -to_margin);
    let (outer, inner) = (outer.ellipse(), inner.ellipse());
    let white = levels.disc;
    (outer.is_valid() && inner.is_valid()).then_some(Fine {
        outer,
        inner,
        black: levels.black,
        white,
    })
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
