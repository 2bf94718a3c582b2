//! Ratio of diameters as printed and as imaged, estimated from frame to frame.
//!
//! Printers scale, cut and spread ink, and cameras let white bloom, so the disc's share of the outer
//! diameter differs from the design by some percent. In: the rims of a ring as they appear. Out: a
//! factor δ (logarithm) on the disc's diameter, and a shift t of both rims into the black, pixels,
//! each with its variance.
//!
//! With the semiaxes a, b of a rim, h = ½ (1/a + 1/b) is the relative growth of its mean radius per
//! pixel of shift. The measured ratio deviates by
//!
//!   y = ln(ρ / ρ₀) = δ + (h_i + h_o) t
//!
//! which a Kalman filter with constant states follows. One size of a ring shows only y; its priors
//! divide it between δ and t, and rings of several sizes separate them. The closed form takes the
//! part that δ does not explain for a shift (paper, eqs. 7 and 8).
//!
//! Perspective changes the ratio as well: with q = r sin θ / d, a circle of radius r at distance d and
//! tilt θ has the mean radius f (r/d) √cos θ (1 - q²)^(-3/4).
//!
//! Deviations within [`SIGNIFICANT`] standard deviations count as none, so that noise does not
//! degrade exact prints. Nothing is learned from frames with clipped white, which blooms, and in
//! precise mode from rings that move within the exposure or have not been fitted yet: motion washes
//! a small disc out.
//!
//! **Limits.** Ink that spreads by the same distance at both rims changes the ratio as δ does, and
//! the outer diameter too, which the ratio does not show.

use super::{RimNoise, RoundelPose};
use crate::marker::{Kind, Pattern, Ring, compensated, rim_shift_px};

/// Standard deviation of δ of prints: a ratio within ±3 %, and ink spread.
const RATIO_PRIOR: f64 = 0.02;
/// Standard deviation of t by cameras: gamma, sharpening, thresholds.
const SHIFT_PRIOR_PX: f64 = 0.1;
/// Standard deviations from which a deviation counts.
const SIGNIFICANT: f64 = 4.0;
/// Error of a rim by motion and light that the rims' noise does not contain, pixels.
const UNMODELLED_PX: f64 = 0.01;
/// Number of consecutive frames with the same systematic error of the rims.
const CORRELATED_FRAMES: f64 = 25.0;
/// White and black this close to the ends of the scale are clipped.
const CLIPPED: f64 = 4.0;
/// Common shift of the rims of a coded ring by clipping, pixels: teeth hide the size of the disc, which would show it.
/// From rendered rings.
const CODED_CLIPPED_PX: f64 = 0.12;

/// What the rings of a track have shown of its print.
#[derive(Clone, Copy, Debug)]
pub struct PrintEstimate {
    log_ratio: f64,
    shift_px: f64,
    /// Covariance of δ and t: δδ, δt, tt.
    covariance: [f64; 3],
    frames: f64,
}

impl Default for PrintEstimate {
    /// The prior.
    fn default() -> Self {
        let covariance = [RATIO_PRIOR * RATIO_PRIOR, 0.0, SHIFT_PRIOR_PX * SHIFT_PRIOR_PX];
        Self { log_ratio: 0.0, shift_px: 0.0, covariance, frames: 0.0 }
    }
}

/// How a print and its image differ from the design.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintDeviation {
    /// Factor on the diameter of the disc.
    pub disc_scale: f64,
    /// Shift of both rims into the black in the image, pixels.
    pub shift_px: f64,
}

impl PrintDeviation {
    /// As designed.
    pub const NONE: Self = Self { disc_scale: 1.0, shift_px: 0.0 };
}

/// A ring with its print.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintedRing {
    /// The ring, compensated for the ratio as printed.
    pub ring: Ring,
    /// The print.
    pub print: PrintDeviation,
    /// Relative standard deviation of the outer rim's size, since the division between print and
    /// image is uncertain, or white is clipped.
    pub size_deviation: f64,
}

impl PrintedRing {
    /// A ring as designed.
    pub fn designed(ring: &Ring) -> Self {
        Self { ring: *ring, print: PrintDeviation::NONE, size_deviation: 0.0 }
    }

    /// Another image of the ring, compensated alike.
    pub fn compensated(&self, ring: &Ring) -> Ring {
        let shift_px = self.ring.shift_px;
        match compensated(&ring.outer, &ring.inner, shift_px - ring.shift_px) {
            Some((outer, inner)) => Ring { outer, inner, shift_px, ..*ring },
            None => *ring,
        }
    }

    /// Adds the uncertainty of the size to a pose.
    pub fn widen(&self, pose: &mut RoundelPose) {
        pose.add_size_deviation(self.size_deviation);
    }
}

/// Deviation of one ring's ratio.
struct RatioMeasurement {
    /// y.
    deviation: f64,
    /// h_i + h_o, 1/pixels.
    per_px: f64,
    /// Variance of y from frame to frame.
    noise: f64,
    /// Variance of y by errors that last.
    lasting: f64,
}

impl PrintEstimate {
    /// Learns from a ring, if its rims are not known to be blurred by motion, and returns it with its
    /// print and the error of its size. `focal_px` is the camera's focal length.
    pub fn update(
        &mut self,
        kind: &Kind,
        ring: &Ring,
        focal_px: f64,
        noise: &RimNoise,
        is_sharp: bool,
    ) -> PrintedRing {
        let mut printed = self.explained(kind, ring, focal_px, noise, is_sharp);
        if is_clipped(ring) && matches!(kind.pattern, Pattern::Coded(_)) {
            let clipped = CODED_CLIPPED_PX / ring.outer.mean_radius_px();
            printed.size_deviation = printed.size_deviation.hypot(clipped);
        }
        printed
    }

    fn explained(
        &mut self,
        kind: &Kind,
        ring: &Ring,
        focal_px: f64,
        noise: &RimNoise,
        is_sharp: bool,
    ) -> PrintedRing {
        let Some(measured) = RatioMeasurement::new(kind, ring, focal_px, noise) else {
            return PrintedRing::designed(ring);
        };
        if is_sharp && !is_clipped(ring) {
            self.learn(&measured);
        }
        if !self.is_significant(measured.per_px) {
            return PrintedRing::designed(ring);
        }
        self.applied(kind, ring, measured.per_px).unwrap_or(PrintedRing::designed(ring))
    }

    fn learn(&mut self, measured: &RatioMeasurement) {
        self.frames = (self.frames + 1.0).min(CORRELATED_FRAMES);
        let [dd, dt, tt] = self.covariance;
        let g = measured.per_px;
        // Covariance of δ and t with y.
        let (with_ratio, with_shift) = (dd + g * dt, dt + g * tt);
        let variance =
            with_ratio + g * with_shift + measured.noise + self.frames * measured.lasting;
        let innovation = measured.deviation - self.log_ratio - g * self.shift_px;
        self.log_ratio += with_ratio / variance * innovation;
        self.shift_px += with_shift / variance * innovation;
        self.covariance = [
            dd - with_ratio * with_ratio / variance,
            dt - with_ratio * with_shift / variance,
            tt - with_shift * with_shift / variance,
        ];
    }

    /// Whether the deviation of rings with this growth per pixel is more than noise.
    fn is_significant(&self, per_px: f64) -> bool {
        let [dd, dt, tt] = self.covariance;
        let deviation = self.log_ratio + per_px * self.shift_px;
        let variance = dd + per_px * (2.0 * dt + per_px * tt);
        self.frames > 0.0 && deviation * deviation > SIGNIFICANT * SIGNIFICANT * variance
    }

    /// The ring, compensated for the ratio as printed; `None` if its rims allow none.
    fn applied(&self, kind: &Kind, ring: &Ring, per_px: f64) -> Option<PrintedRing> {
        let (outer, inner) = compensated(&ring.outer, &ring.inner, -ring.shift_px)?;
        let disc_scale = self.log_ratio.exp();
        let shift_px = rim_shift_px(&outer, &inner, kind.ratio() * disc_scale)?;
        let (outer, inner) = compensated(&outer, &inner, shift_px)?;
        Some(PrintedRing {
            ring: Ring { outer, inner, shift_px, ..*ring },
            print: PrintDeviation { disc_scale, shift_px: self.shift_px },
            size_deviation: self.covariance[0].sqrt() / (per_px * outer.mean_radius_px()),
        })
    }
}

fn is_clipped(ring: &Ring) -> bool {
    ring.white > 255.0 - CLIPPED || ring.black < CLIPPED
}

impl RatioMeasurement {
    /// `None` where the ratio was not measured.
    fn new(kind: &Kind, ring: &Ring, focal_px: f64, noise: &RimNoise) -> Option<Self> {
        let (outer, inner) = compensated(&ring.outer, &ring.inner, -ring.shift_px)?;
        let rims = match kind.pattern {
            Pattern::Plain => {
                let disc_px = inner.semi_minor_px;
                noise.for_ring(ring, disc_px, outer.semi_minor_px - disc_px).rims
            }
            Pattern::Coded(layout) if ring.code.is_some() => {
                noise.for_coded_ring(ring, layout.bits).rims
            }
            Pattern::Coded(_) | Pattern::Elliptical { .. } => return None,
        };
        let minor_share = outer.semi_minor_px / outer.semi_major_px;
        let outer_q2 = (outer.semi_major_px / focal_px).powi(2) * (1.0 - minor_share * minor_share);
        let inner_q2 = outer_q2 * kind.ratio() * kind.ratio();
        let perspective = 0.75 * ((1.0 - outer_q2) / (1.0 - inner_q2)).ln();
        let measured = (inner.mean_radius_px() / outer.mean_radius_px()).ln();
        let mut found = Self {
            deviation: measured - kind.ratio().ln() - perspective,
            per_px: 0.0,
            noise: 0.0,
            lasting: 0.0,
        };
        for (rim, errors) in [&outer, &inner].into_iter().zip(rims) {
            let growth = 0.5 * (1.0 / rim.semi_major_px + 1.0 / rim.semi_minor_px);
            let around_px = std::f64::consts::TAU * rim.mean_radius_px();
            found.per_px += growth;
            found.noise += (growth * errors.edge_px).powi(2) / around_px;
            found.lasting += growth.powi(2)
                * (errors.floor_px.powi(2) + errors.uneven_px.powi(2) + UNMODELLED_PX.powi(2));
        }
        found.deviation.is_finite().then_some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{camera::PixelPoint, ellipse::Ellipse};

    const FOCAL_PX: f64 = 1100.0;

    /// A ring as the tracker finds it: white has bloomed by `shift_px`, the disc is printed larger
    /// by `disc`, and the rims are compensated for the design.
    fn ring(kind: &Kind, radius_px: f64, disc: f64, shift_px: f64) -> Ring {
        let rim = |radius_px: f64| Ellipse {
            center: PixelPoint { u: 100.0, v: 100.0 },
            semi_major_px: radius_px,
            semi_minor_px: 0.8 * radius_px,
            angle_rad: 0.3,
        };
        let outer = rim(radius_px).grown(-shift_px);
        let inner = rim(kind.ratio() * disc * radius_px).grown(shift_px);
        let shift_px = rim_shift_px(&outer, &inner, kind.ratio()).unwrap();
        let (outer, inner) = compensated(&outer, &inner, shift_px).unwrap();
        Ring { shift_px, unevenness: 0.011, ..Ring::of_rims(outer, inner) }
    }

    fn kind() -> Kind {
        Kind::plain("robot", 0.16, 0.064)
    }

    #[test]
    fn a_print_as_designed_is_left_alone() {
        let (kind, noise) = (kind(), RimNoise::default());
        let mut estimate = PrintEstimate::default();
        for frame in 0..300 {
            // A tenth of a percent and back.
            let disc = 1.0 + 1e-3 * f64::from(frame % 3 - 1);
            let observed = ring(&kind, 18.0, disc, 0.0);
            let printed = estimate.update(&kind, &observed, FOCAL_PX, &noise, true);
            assert_eq!(printed, PrintedRing::designed(&observed), "{frame}");
        }
    }

    #[test]
    fn rings_of_several_sizes_tell_a_print_from_bloom() {
        let (kind, noise) = (kind(), RimNoise::default());
        for (disc, shift_px) in [(0.97, 0.0), (1.03, 0.0), (1.0, 0.2), (1.015, -0.1)] {
            let mut estimate = PrintEstimate::default();
            let mut last = None;
            for frame in 0..2000 {
                let radius_px = 12.0 + f64::from(frame % 40);
                let observed = ring(&kind, radius_px, disc, shift_px);
                last = Some((radius_px, estimate.update(&kind, &observed, FOCAL_PX, &noise, true)));
            }
            let (radius_px, printed) = last.unwrap();
            let found = printed.print;
            assert!((found.disc_scale / disc - 1.0).abs() < 2e-3, "{disc} {shift_px}: {found:?}");
            assert!((found.shift_px - shift_px).abs() < 0.02, "{disc} {shift_px}: {found:?}");
            // The outer rim is where it would be without bloom.
            let size = printed.ring.outer.mean_radius_px() / (radius_px * 0.8f64.sqrt());
            assert!((size - 1.0).abs() < 3.0 * printed.size_deviation.max(1e-3), "{size}");
        }
    }

    #[test]
    fn what_one_size_leaves_open_is_stated() {
        let (kind, noise) = (kind(), RimNoise::default());
        for (disc, shift_px) in [(0.97, 0.0), (1.0, 0.15)] {
            let mut estimate = PrintEstimate::default();
            let observed = ring(&kind, 18.0, disc, shift_px);
            let printed = estimate.update(&kind, &observed, FOCAL_PX, &noise, true);
            let size = printed.ring.outer.mean_radius_px() / (18.0 * 0.8f64.sqrt());
            assert!((size - 1.0).abs() > 1e-3, "the test has no error to state: {size}");
            assert!((size - 1.0).abs() < 2.0 * printed.size_deviation, "{size} {printed:?}");
            // Ratio and shift together explain the rims.
            let ratio = printed.ring.inner.mean_radius_px() / printed.ring.outer.mean_radius_px();
            let expected = kind.ratio() * printed.print.disc_scale;
            assert!((ratio / expected - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn clipped_white_teaches_nothing() {
        let (kind, noise) = (kind(), RimNoise::default());
        let mut estimate = PrintEstimate::default();
        for _ in 0..100 {
            let observed = Ring { white: 255.0, ..ring(&kind, 18.0, 1.0, 0.5) };
            let printed = estimate.update(&kind, &observed, FOCAL_PX, &noise, true);
            assert_eq!(printed.print, PrintDeviation::NONE);
        }
        let observed = ring(&kind, 18.0, 1.0, 0.0);
        let printed = estimate.update(&kind, &observed, FOCAL_PX, &noise, true);
        assert_eq!(printed, PrintedRing::designed(&observed));
    }
}
