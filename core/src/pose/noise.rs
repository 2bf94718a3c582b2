//! How far rims as found stray from rims as they are.

use crate::marker::Ring;

/// The unevenness that [`RimNoise`] is stated for …
pub(super) const CLEAN_UNEVENNESS: f64 = 0.011;
/// … how much quieter and noisier a rim can be …
const NOISE: (f64, f64) = (0.6, 3.0);
/// … and the unevenness that noise and pixels alone come to: a share of the contrast, and grey levels.
const QUIET: (f64, f64) = (0.02, 1.0);
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

/// How far rims as found stray from rims as they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RimNoise {
    /// Standard deviation of one pixel's worth of rim, across the rim, pixels; it averages out along
    /// the rim.
    pub edge_px: f64,
    /// Standard deviation of a shift of the whole rim across itself (blur, bloom), pixels, which no
    /// averaging removes; a quarter of it is also counted for the rim's centre and shape.
    pub floor_px: f64,
}

impl Default for RimNoise {
    /// What the detector reaches at a blur of 0.5 to 0.9 px and noise of a 60th of the contrast
    /// (`tests/pixels.rs`); other noise is told by the ring itself.
    fn default() -> Self {
        Self { edge_px: 0.03, floor_px: 0.0065 }
    }
}

impl RimNoise {
    /// The noise of a ring whose white disc has so short a semiaxis, and whose black is so narrow along it.
    /// A disc hardly wider than the blur is washed out, and with it, by compensation, both rims are found
    /// worse. From rendered rings: double at a semiaxis of 3 px, sixfold at 2.3 px.
    ///
    /// A black ring grown thin adds less: across 4 px of it errors are 1.6 times as large. The larger of the
    /// two counts, which at a ratio of diameters of 0.4 is the disc's, at 0.6 mostly the black's.
    ///
    /// What the levels along the rim stray is the image's noise, up to a point, and moves the rim's
    /// edge in proportion; beyond that the rim is partly another's, and all its numbers may be off.
    pub(super) fn of_ring(&self, ring: &Ring, disc_px: f64, black_px: f64) -> RingNoise<f64> {
        let by_disc = (THIN_DISC_PX / disc_px).powi(6).min(MAX_GROWTH);
        let by_black = (THIN_BLACK_PX / black_px).powi(4).min(MAX_GROWTH_BY_BLACK);
        let growth = 1.0 + by_disc.max(by_black);
        let quiet = QUIET.0 + QUIET.1 / (ring.white - ring.black).max(1.0);
        let noise = (ring.unevenness.min(quiet) / CLEAN_UNEVENNESS).clamp(NOISE.0, NOISE.1);
        RingNoise {
            edge_px: self.edge_px * growth * noise,
            floor_px: self.floor_px * growth,
            uneven_px: UNEVEN_PX * (ring.unevenness - quiet).max(0.0),
            round_disc: true,
        }
    }
}

/// How far one ring's rims stray.
#[derive(Clone, Copy, Debug)]
pub struct RingNoise<T> {
    /// As in [`RimNoise`].
    pub edge_px: T,
    /// As in [`RimNoise`].
    pub floor_px: T,
    /// Standard deviation of each of a rim's five numbers from what does not belong to it, pixels.
    pub uneven_px: T,
    /// Whether the disc's rim is a circle's; of another only size and place say something of the pose.
    pub round_disc: bool,
}
