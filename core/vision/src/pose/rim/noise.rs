//! Errors of rims as detected.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use crate::{ellipse::Ellipse, marker::Ring};

/// Unevenness that [`RimNoise`] is stated for.
pub(crate) const CLEAN_UNEVENNESS: f64 = 0.011;
/// Range of the noise of an edge, relative to that.
const EDGE_NOISE_RANGE: (f64, f64) = (0.6, 3.0);
/// Unevenness by noise and pixels alone: share of the contrast, and grey levels.
const NOISE_UNEVENNESS: (f64, f64) = (0.02, 1.0);
/// Error of a rim's harmonics per unit of unevenness, pixels; from rendered rings partly covered by
/// adjacent sheets.
const UNEVEN_PX: f64 = 4.0;
/// White of at least this level may be cut off at the end of the scale, which moves both rims …
const CLIPPED_WHITE: f64 = 250.0;
/// … by this common shift, which compensation does not remove, pixels; from rendered rings.
const CLIPPED_PX: f64 = 0.04;
/// Semiaxis of the white disc at which the errors of both rims double.
const THIN_DISC_PX: f64 = 3.0;
/// Limit of the growth; such rings are hardly detected.
const MAX_GROWTH: f64 = 10.0;
/// Width of the black along the shorter axis at which its share of the growth would be one …
const THIN_BLACK_PX: f64 = 3.5;
/// … without this limit.
const MAX_GROWTH_BY_BLACK: f64 = 0.7;

/// Error of a rim's centre by its position relative to the pixels.
const CENTER_PX: f64 = 0.01;
/// The same for a coded ring, whose rim consists of different points where its teeth are read.
const CODED_CENTER_PX: f64 = 0.025;

/// Effective number of points of a coded outer rim.
const POINTS: f64 = 40.0;
/// Shorter semiaxis at which the errors of a coded outer rim double.
const CODED_PX: f64 = 9.0;
/// Where teeth are read, compensation uses the disc between them. Shorter semiaxis, and half width
/// of a slot, at which the error of the size doubles …
const COMPENSATED_PX: (f64, f64) = (12.5, 1.2);
/// … and half width of a slot at which that of the disc's centre doubles.
const NARROW_SLOT_PX: f64 = 1.5;
/// Error of the disc's centre where teeth are not read, and the shorter semiaxis at which it
/// doubles.
const SPOKES_PX: f64 = 0.06;
const FEW_SPOKES_PX: f64 = 20.0;

/// Errors of detected rims.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RimNoise {
    /// Standard deviation across the rim of one pixel of its length, pixels; it averages out along
    /// the rim.
    pub edge_px: f64,
    /// Standard deviation of a common shift of the rim across itself (blur, bloom), pixels, which
    /// does not average out. A quarter of it also applies to the rim's centre and shape.
    pub floor_px: f64,
    /// Whether both values hold for exactly the ring that they are given with, without corrections
    /// for thin parts and uneven levels.
    pub is_of_ring: bool,
}

impl Default for RimNoise {
    /// Accuracy of the detector at a blur of 0.5 to 0.9 px and noise of 1/60 of the contrast
    /// (`tests/pixels.rs`); the ring itself shows other noise.
    fn default() -> Self {
        Self { edge_px: 0.03, floor_px: 0.0065, is_of_ring: false }
    }
}

impl RimNoise {
    /// Noise of a ring with this shorter semiaxis of the white disc, and this width of the black
    /// along it.
    ///
    /// A disc hardly wider than the blur is washed out, which by compensation degrades both rims.
    /// From rendered rings: factor 2 at a semiaxis of 3 px, 6 at 2.3 px. Thin black degrades less:
    /// factor 1.6 at a width of 4 px. The larger of the two applies: for a ratio of diameters of
    /// 0.4 that of the disc, for 0.6 mostly that of the black.
    pub(crate) fn for_ring(&self, ring: &Ring, disc_px: f64, black_px: f64) -> RingNoise<f64> {
        if self.is_of_ring {
            return RingNoise { rims: [self.as_stated(); 2], disc: DiscWeights::all() };
        }
        let by_disc = (THIN_DISC_PX / disc_px).powi(6).min(MAX_GROWTH);
        let by_black = (THIN_BLACK_PX / black_px).powi(4).min(MAX_GROWTH_BY_BLACK);
        let growth = 1.0 + by_disc.max(by_black);
        let inner = self.for_rim(ring, growth);
        let outer = RimErrors { uneven_px: inner.uneven_px.hypot(ring.margin_px), ..inner };
        RingNoise { rims: [outer, inner], disc: DiscWeights::all() }
    }

    fn as_stated(&self) -> RimErrors<f64> {
        RimErrors { edge_px: self.edge_px, floor_px: self.floor_px, uneven_px: 0.0 }
    }

    /// Noise of a coded ring, whose rims are detected point by point.
    ///
    /// The outer rim has a fixed number of points, so a large rim uses fewer of its pixels. The
    /// disc's rim gives only the centre, since compensation uses its size: from one gap per bit, or
    /// from spokes where the teeth were not read.
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
            of_outer.floor_px = self.floor_of(ring, growth.max(1.0 + compensated.min(MAX_GROWTH)));
            let closed = (NARROW_SLOT_PX / slot_px).powi(2).min(MAX_GROWTH);
            of_inner.edge_px *= (1.0 + closed) * thinned(inner, f64::from(bits));
        } else {
            let off_px = SPOKES_PX * (1.0 + (FEW_SPOKES_PX / minor_px).powi(2));
            of_inner.uneven_px = off_px.hypot(rim.uneven_px);
        }
        // What disturbs the margin often disturbs the disc, so neither rim gains weight.
        for rim in [&mut of_outer, &mut of_inner] {
            rim.uneven_px = rim.uneven_px.hypot(ring.margin_px);
        }
        RingNoise { rims: [of_outer, of_inner], disc: DiscWeights::center_only() }
    }

    /// Variance of either coordinate of the outer rim's centre, pixels².
    pub(crate) fn center_variance_px2(&self, ring: &Ring, is_coded: bool) -> f64 {
        let RimErrors { edge_px, floor_px, uneven_px } = self.for_rim(ring, 1.0);
        let center_px = if is_coded { CODED_CENTER_PX } else { CENTER_PX };
        let edge_px2 = edge_px * edge_px / (PI * ring.outer.mean_radius_px());
        edge_px2 + (0.25 * floor_px).powi(2) + 2.0 * uneven_px * uneven_px + center_px * center_px
    }

    /// Common shift of a rim that is degraded by this factor.
    fn floor_of(&self, ring: &Ring, growth: f64) -> f64 {
        let floor_px = self.floor_px * growth;
        if ring.white >= CLIPPED_WHITE { floor_px.hypot(CLIPPED_PX) } else { floor_px }
    }

    /// Noise of a rim that is degraded by this factor.
    ///
    /// Unevenness of the levels along the rim is image noise up to a limit, and scales the errors
    /// of the edge. Beyond the limit the rim is partly that of something else, and all its
    /// harmonics may be off.
    fn for_rim(&self, ring: &Ring, growth: f64) -> RimErrors<f64> {
        let noise_unevenness =
            NOISE_UNEVENNESS.0 + NOISE_UNEVENNESS.1 / (ring.white - ring.black).max(1.0);
        let noise = (ring.unevenness.min(noise_unevenness) / CLEAN_UNEVENNESS)
            .clamp(EDGE_NOISE_RANGE.0, EDGE_NOISE_RANGE.1);
        RimErrors {
            edge_px: self.edge_px * growth * noise,
            floor_px: self.floor_of(ring, growth),
            uneven_px: (UNEVEN_PX * (ring.unevenness - noise_unevenness).max(0.0))
                .hypot(ring.shadow_px),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct RingNoise<T> {
    /// Outer and inner.
    pub rims: [RimErrors<T>; 2],
    /// Use of the inner rim for the pose.
    pub disc: DiscWeights<T>,
}

#[derive(Clone, Copy, Debug)]
pub struct RimErrors<T> {
    /// As in [`RimNoise`].
    pub edge_px: T,
    /// As in [`RimNoise`].
    pub floor_px: T,
    /// Standard deviation of each harmonic by foreign objects and shadows, pixels.
    pub uneven_px: T,
}

/// Which harmonics of the disc's rim, besides its centre, inform the pose: 1 or 0.
#[derive(Clone, Copy, Debug)]
pub struct DiscWeights<T> {
    pub size: T,
    /// Elongation and turn; 0 if `size` is.
    pub shape: T,
}

impl DiscWeights<f64> {
    /// A circle.
    pub fn all() -> Self {
        Self { size: 1.0, shape: 1.0 }
    }

    /// Not a circle.
    pub fn without_shape() -> Self {
        Self { shape: 0.0, ..Self::all() }
    }

    /// A circle whose shape is that of the other rim.
    pub fn center_only() -> Self {
        Self { size: 0.0, shape: 0.0 }
    }
}
