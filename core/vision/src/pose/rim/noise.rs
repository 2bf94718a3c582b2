//! How far rims as found stray from rims as they are.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use crate::{ellipse::Ellipse, marker::Ring};

/// The unevenness that [`RimNoise`] is stated for …
pub(crate) const CLEAN_UNEVENNESS: f64 = 0.011;
/// … how much quieter and noisier a rim can be …
const EDGE_NOISE_RANGE: (f64, f64) = (0.6, 3.0);
/// … and the unevenness that noise and pixels alone come to: a share of the contrast, and grey levels.
const NOISE_UNEVENNESS: (f64, f64) = (0.02, 1.0);
/// Pixels that a rim's numbers are off for each unit of its unevenness; from rendered rings partly
/// covered by their neighbours' sheets.
const UNEVEN_PX: f64 = 4.0;
/// At this semiaxis of the white disc the errors of both rims have doubled, pixels.
const THIN_DISC_PX: f64 = 3.0;
/// They grow no further than by this factor; such rings are hardly found.
const MAX_GROWTH: f64 = 10.0;
/// The share that the black adds is one at this width of it, along the shorter axis, pixels …
const THIN_BLACK_PX: f64 = 3.5;
/// … if it were not this at most.
const MAX_GROWTH_BY_BLACK: f64 = 0.7;

/// What a rim's centre is off by from frame to frame, as it lies on the pixels, pixels.
const CENTER_PX: f64 = 0.01;
/// The same of a coded one's, which is found by other points where its teeth are read.
const CODED_CENTER_PX: f64 = 0.025;

/// Points of a coded outer rim, less what blur adds to their errors.
const POINTS: f64 = 40.0;
/// At this shorter semiaxis of it its errors have doubled, pixels.
const CODED_PX: f64 = 9.0;
/// Where the teeth are read it is compensated by what of the disc is seen between them: its size's errors have
/// doubled at this shorter semiaxis, or at this half width of a slot …
const COMPENSATED_PX: (f64, f64) = (12.5, 1.2);
/// … and those of the disc's centre at this one.
const NARROW_SLOT_PX: f64 = 1.5;
/// What the centre is off by where they are not, pixels, and the shorter semiaxis at which that has doubled.
const SPOKES_PX: f64 = 0.06;
const FEW_SPOKES_PX: f64 = 20.0;

/// How far rims as found stray from rims as they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RimNoise {
    /// Standard deviation of one pixel's worth of rim, across the rim, pixels; it averages out along
    /// the rim.
    pub edge_px: f64,
    /// Standard deviation of a shift of the whole rim across itself (blur, bloom), pixels, which no
    /// averaging removes; a quarter of it is also counted for the rim's centre and shape.
    pub floor_px: f64,
    /// Whether both are stated for just the ring that they are given with, whose thin parts and uneven levels
    /// then change nothing about them.
    pub is_of_ring: bool,
}

impl Default for RimNoise {
    /// What the detector reaches at a blur of 0.5 to 0.9 px and noise of a 60th of the contrast
    /// (`tests/pixels.rs`); other noise is told by the ring itself.
    fn default() -> Self {
        Self { edge_px: 0.03, floor_px: 0.0065, is_of_ring: false }
    }
}

impl RimNoise {
    /// The noise of a ring whose white disc has so short a semiaxis, and whose black is so narrow along it.
    /// A disc hardly wider than the blur is washed out, and with it, by compensation, both rims are found
    /// worse. From rendered rings: double at a semiaxis of 3 px, sixfold at 2.3 px.
    ///
    /// A black ring grown thin adds less: across 4 px of it errors are 1.6 times as large. The larger of the
    /// two counts, which at a ratio of diameters of 0.4 is the disc's, at 0.6 mostly the black's.
    pub(crate) fn for_ring(&self, ring: &Ring, disc_px: f64, black_px: f64) -> RingNoise<f64> {
        if self.is_of_ring {
            return RingNoise { rims: [self.as_stated(); 2], disc: DiscWeights::all() };
        }
        let by_disc = (THIN_DISC_PX / disc_px).powi(6).min(MAX_GROWTH);
        let by_black = (THIN_BLACK_PX / black_px).powi(4).min(MAX_GROWTH_BY_BLACK);
        let growth = 1.0 + by_disc.max(by_black);
        let rim = self.for_rim(ring, growth);
        RingNoise { rims: [rim; 2], disc: DiscWeights::all() }
    }

    fn as_stated(&self) -> RimErrors<f64> {
        RimErrors { edge_px: self.edge_px, floor_px: self.floor_px, uneven_px: 0.0 }
    }

    /// The noise of a ring of these bits, whose rims are found point by point.
    ///
    /// The outer rim's points are as many on a large rim as on a small one, so that more pixels of a large one
    /// are not seen. Of the disc's rim only the centre is left, its size being used up in compensation: told
    /// by as many gaps as there are bits, and where these were not read, by spokes.
    pub(crate) fn for_coded_ring(&self, ring: &Ring, bits: u8) -> RingNoise<f64> {
        let (outer, inner) = (&ring.outer, &ring.inner);
        let minor_px = outer.semi_minor_px;
        let growth = 1.0 + (CODED_PX / minor_px).powi(8).min(MAX_GROWTH);
        let rim = self.for_rim(ring, growth);
        let thinned = |rim: &Ellipse, points: f64| {
            let radius_px = rim.semi_major_px.hypot(rim.semi_minor_px) * FRAC_1_SQRT_2;
            (TAU * radius_px / points).max(1.0).sqrt()
        };
        let mut of_outer = RimErrors { edge_px: rim.edge_px * thinned(outer, POINTS), ..rim };
        let mut of_inner = rim;
        if ring.code.is_some() {
            let slot_px = 0.5 * PI / f64::from(bits) * inner.semi_minor_px;
            let compensated =
                (COMPENSATED_PX.0 / minor_px).powi(4) + (COMPENSATED_PX.1 / slot_px).powi(2);
            of_outer.floor_px = self.floor_px * growth.max(1.0 + compensated.min(MAX_GROWTH));
            let closed = (NARROW_SLOT_PX / slot_px).powi(2).min(MAX_GROWTH);
            of_inner.edge_px *= (1.0 + closed) * thinned(inner, f64::from(bits));
        } else {
            let off_px = SPOKES_PX * (1.0 + (FEW_SPOKES_PX / minor_px).powi(2));
            of_inner.uneven_px = off_px.hypot(rim.uneven_px);
        }
        RingNoise { rims: [of_outer, of_inner], disc: DiscWeights::center_only() }
    }

    /// Variance of either coordinate of the outer rim's centre, pixels²: of a circle's, by the same errors.
    pub(crate) fn center_variance_px2(&self, ring: &Ring, is_coded: bool) -> f64 {
        let RimErrors { edge_px, floor_px, uneven_px } = self.for_rim(ring, 1.0);
        let center_px = if is_coded { CODED_CENTER_PX } else { CENTER_PX };
        let edge_px2 = edge_px * edge_px / (PI * ring.outer.mean_radius_px());
        edge_px2 + (0.25 * floor_px).powi(2) + 2.0 * uneven_px * uneven_px + center_px * center_px
    }

    /// The noise of a rim that is found worse by this factor.
    ///
    /// What the levels along the rim stray is the image's noise, up to a point, and moves the rim's
    /// edge in proportion; beyond that the rim is partly another's, and all its numbers may be off.
    fn for_rim(&self, ring: &Ring, growth: f64) -> RimErrors<f64> {
        let noise_unevenness =
            NOISE_UNEVENNESS.0 + NOISE_UNEVENNESS.1 / (ring.white - ring.black).max(1.0);
        let noise = (ring.unevenness.min(noise_unevenness) / CLEAN_UNEVENNESS)
            .clamp(EDGE_NOISE_RANGE.0, EDGE_NOISE_RANGE.1);
        RimErrors {
            edge_px: self.edge_px * growth * noise,
            floor_px: self.floor_px * growth,
            uneven_px: UNEVEN_PX * (ring.unevenness - noise_unevenness).max(0.0),
        }
    }
}

/// How far one ring's rims stray.
#[derive(Clone, Copy, Debug)]
pub struct RingNoise<T> {
    /// Outer and inner.
    pub rims: [RimErrors<T>; 2],
    /// What the inner one says of the pose.
    pub disc: DiscWeights<T>,
}

/// How far a rim strays.
#[derive(Clone, Copy, Debug)]
pub struct RimErrors<T> {
    /// As in [`RimNoise`].
    pub edge_px: T,
    /// As in [`RimNoise`].
    pub floor_px: T,
    /// Standard deviation of each of a rim's five numbers from what does not belong to it, pixels.
    pub uneven_px: T,
}

/// Which of a rim's numbers say something of the pose, besides its centre: 1 for those that do, else 0.
#[derive(Clone, Copy, Debug)]
pub struct DiscWeights<T> {
    pub size: T,
    /// Elongation and turn; never without the size.
    pub shape: T,
}

impl DiscWeights<f64> {
    /// Of a circle.
    pub fn all() -> Self {
        Self { size: 1.0, shape: 1.0 }
    }

    /// Of what is no circle.
    pub fn without_shape() -> Self {
        Self { shape: 0.0, ..Self::all() }
    }

    /// Of a circle whose shape is that of another one.
    pub fn center_only() -> Self {
        Self { size: 0.0, shape: 0.0 }
    }
}
