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
//! 0.7 px, noise 2, kind known), mean radius, bias and rms: at 81 px of diameter and any tilt to 60°
//! 0.002 and 0.01 %; to 30° of tilt, at 30 px 0.05 and 0.06 %, at 20 px 0.1 and 0.13 %, at 12 px 0.6 and
//! 0.7 %; at 60°, 0.1 % at 30 px.
//!
//! Limits: where the disc's shorter semiaxis is below three times the blur, rims come out short (2 to
//! 3 % at 12 px and a blur of 1.1); a margin narrower than 2 px makes them long by up to 0.1 px.
//!
//! A linear change of lighting leaves areas and axes but moves centres; its gradient is measured in
//! black and margin, and the movement taken out.

use crate::{
    camera::PixelPoint,
    ellipse::{Ellipse, Moments, Shape},
    frame::Frame,
    marker::{
        blur::moved_px,
        examine::{Coarse, check_similarity},
        reject::Reject,
        zone::{Cuts, REACH_PX, RowScratch, Zone, Zones, slope},
    },
};

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
