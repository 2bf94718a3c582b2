//! Predicted pose of a roundel, with the covariance that rim noise, compensation and wrong normals cause, without correction
//! by trials.
//!
//! **Rims in precise mode.** A straight edge of contrast C, blurred to s² = blur² + 1/12 by lens and pixel, has the variance
//!
//! v = σ² 2√π s / C²,  σ² = noise² + 1/12
//!
//! per unit of length (Fisher information of its pixels, ∫ g′² = C²/(2√π s); quantization adds 1/12). The fit to grey
//! levels reaches this bound except where disc or ring is hardly wider than the blur.
//!
//! **Rims in fast mode.** Moments weigh all pixels of a band of width w alike ([`roundel_vision::marker`]):
//!
//! v = σ² w / C²
//!
//! - Compensation computes both radii from both rims; for the ratio r, 1/(r (1 + r)) of the outer radius' variance remains
//!   instead of the optimum 1/(1 + r³).
//! - The end of the band is at a random position on the pixels, so the light beyond it varies along the rim.
//!
//! The factors were fitted to rendered roundels of 14 to 90 px, ratios of 0.35 to 0.6, blurs of 0.5 to 1.1 px, noise of 1
//! to 4 levels and tilts up to 55°. Below 32 px, where light of other edges shifts the rims as well, errors are corrected
//! by trials (`monte_carlo`). From there on, trials agree to within 20 %, or 45 % near face-on with a ratio of 0.6.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Vector3};

use super::{Imaging, Sensor, roundel_image::RoundelImage};
use roundel_vision::{
    camera::Camera,
    marker::{Kind, Mode, Pattern, Ring, WIDE_PX, compensated, rim_shift_px},
    normal_distribution::{self, Beyond},
    pose::{RimNoise, RoundelPose, locate, other_offset_m},
};

/// Residual shift of a rim by blur and bloom, pixels, and growth of errors with the fourth power of blur over the
/// narrower one of disc and ring. Fitted to set-ups other than those of the comparison.
const FIT_FLOOR_PX: f64 = 0.0005;
const FIT_BLURRED: f64 = 20.0;
/// Fitted to 200 set-ups other than those of the comparison. Growth of noise with the square of blur over disc and
/// ring; residual noise of a radius; noise by light beyond the band's end.
const MOMENTS_BLURRED: f64 = 3.8;
const MOMENTS_SIZE: f64 = 2.9;
const MOMENTS_END: f64 = 2.1;

/// Predicts the pose; `None` if the ring cannot be located.
pub(super) fn predict_pose(
    sensor: &Sensor,
    kind: &Kind,
    image: &RoundelImage,
) -> Option<RoundelPose> {
    let (solid_kind, noise) = (without_teeth(kind), rim_noise(sensor, kind, image));
    let mut pose = locate(&sensor.camera, &solid_kind, &image.ring, &noise).ok()?;
    let apart = other_offset_m(&sensor.camera, &solid_kind, &image.ring, &noise).ok()?;
    let wrong = wrong_share(pose.normal_likelihood) - (1.0 - pose.normal_likelihood);
    let moved = match sensor.mode {
        Mode::Precise => Vector3::zeros(),
        Mode::Fast => compensation_shift_m(&sensor.camera, &solid_kind, &image.ring),
    };
    let mut of_position = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
    of_position += apart * apart.transpose() * wrong + moved * moved.transpose();
    Some(pose)
}

/// Share of noisy pictures that prefer the wrong normal, if the noise-free ring prefers the right one with this
/// likelihood.
fn wrong_share(likelihood: f64) -> f64 {
    let misfit = 2.0 * (likelihood / (1.0 - likelihood)).ln().max(0.0);
    normal_distribution::cumulative(-0.5 * misfit.sqrt())
}

/// Error of compensation where the ratio of the rims' areas differs from the print's, camera frame, metres.
fn compensation_shift_m(camera: &Camera, kind: &Kind, ring: &Ring) -> Vector3<f64> {
    if kind.pattern != Pattern::Plain {
        return Vector3::zeros();
    }
    let position = |ring: &Ring| {
        let pose = locate(camera, kind, ring, &RimNoise::default()).ok()?;
        Some(pose.position_m)
    };
    let moved = || {
        let shift_px = rim_shift_px(&ring.outer, &ring.inner, kind.ratio())?;
        let (outer, inner) = compensated(&ring.outer, &ring.inner, shift_px)?;
        Some(position(&Ring { outer, inner, ..*ring })? - position(ring)?)
    };
    moved().unwrap_or_else(Vector3::zeros)
}

/// The kind with a solid disc: the fit uses parts of the disc's rim at both ends of the teeth.
pub(super) fn without_teeth(kind: &Kind) -> Kind {
    match kind.pattern {
        Pattern::Coded(_) => Kind { pattern: Pattern::Plain, ..kind.clone() },
        Pattern::Plain | Pattern::Elliptical { .. } => kind.clone(),
    }
}

/// Standard deviation of a position along an axis, metres.
pub(super) fn along_m(position_m2: &Matrix3<f64>, axis: &Vector3<f64>) -> f64 {
    let unit = axis.normalize();
    unit.dot(&(position_m2 * unit)).max(0.0).sqrt()
}

/// Rim noise of a ring in the sensor's mode.
pub fn rim_noise(sensor: &Sensor, kind: &Kind, image: &RoundelImage) -> RimNoise {
    let Imaging { noise, blur_px, .. } = sensor.imaging;
    let variance = noise.powi(2) + 1.0 / 12.0;
    let spread_px = (blur_px.powi(2) + 1.0 / 12.0).sqrt();
    let per_length = 2.0 * PI.sqrt() * spread_px / sensor.imaging.contrast().powi(2);
    let edge_px = (variance * per_length).sqrt();
    // The narrower one of disc and ring determines how much is blurred away.
    let (min, max) = kind.ratios();
    let semi_px = 0.5 * image.minor_px;
    let (disc_px, black_px) = (semi_px * min, semi_px * (1.0 - max));
    match sensor.mode {
        Mode::Precise => {
            let blurred = spread_px / disc_px.min(black_px);
            let growth = 1.0 + FIT_BLURRED * blurred.powi(4);
            let (edge_px, floor_px) = (edge_px * growth, FIT_FLOOR_PX * growth);
            RimNoise { edge_px, floor_px, is_of_ring: true }
        }
        Mode::Fast => {
            let band = variance * 2.0 * WIDE_PX / sensor.imaging.contrast().powi(2);
            let blurred = (spread_px / disc_px).powi(2) + (spread_px / black_px).powi(2);
            let edge_px = band.sqrt() * (1.0 + MOMENTS_BLURRED * blurred);
            let edge_px = edge_px.hypot(MOMENTS_END * Beyond::new(WIDE_PX, spread_px).moved_px);
            let ratio = kind.ratio();
            let excess = 1.0 / (ratio * (1.0 + ratio)) - 1.0 / (1.0 + ratio.powi(3));
            let radius_px = image.ring.outer.mean_radius_px();
            let size_px2 = MOMENTS_SIZE * band / (TAU * radius_px) * excess.max(0.0);
            RimNoise { edge_px, floor_px: size_px2.sqrt(), is_of_ring: true }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::{range::pose_in_front, roundel_image::image_roundel, tests::sensor},
        *,
    };
    use roundel_vision::camera::NormalizedPoint;

    #[test]
    fn band_noise_does_not_depend_on_the_blur() {
        let kind = Kind::plain("", 0.16, 0.08);
        let noise = |blur_px: f64| {
            let imaging = Imaging { blur_px, ..Imaging::default() };
            let sensor = Sensor { imaging, mode: Mode::Fast, ..sensor() };
            let pose = pose_in_front(NormalizedPoint::default(), 0.5, 0.0);
            let image = image_roundel(&sensor.camera, &kind, &imaging, &pose).unwrap();
            rim_noise(&sensor, &kind, &image).edge_px
        };
        let (sharp, blurred) = (noise(0.4), noise(0.6));
        assert!((blurred / sharp - 1.0).abs() < 0.01, "{sharp} {blurred}");
    }

    /// Φ of Abramowitz and Stegun's table 26.1.
    #[test]
    fn the_share_of_wrong_normals_follows_from_the_misfit() {
        for (misfit, share) in
            [(0.0, 0.5), (1.0, 0.308_537_5), (4.0, 0.158_655_3), (16.0, 0.022_750_1)]
        {
            let odds = f64::exp(0.5 * misfit);
            let found = wrong_share(odds / (1.0 + odds));
            assert!((found - share).abs() < 1e-6, "{misfit}: {found}");
        }
        assert_eq!(wrong_share(1.0), 0.0);
    }

    /// Perspective makes the areas of a large tilted ring's rims more similar than on the print.
    #[test]
    fn compensation_shifts_large_tilted_rings() {
        let kind = Kind::plain("", 0.16, 0.064);
        let moved = |diameter_px: f64, tilt_rad: f64| {
            let distance_m = sensor().camera.intrinsics().fx_px * 0.16 / diameter_px;
            let pose = pose_in_front(NormalizedPoint::default(), distance_m, tilt_rad);
            let seen = image_roundel(&sensor().camera, &kind, &sensor().imaging, &pose).unwrap();
            compensation_shift_m(&sensor().camera, &kind, &seen.ring).norm() / distance_m
        };
        let share = moved(100.0, 0.8);
        assert!((1e-4..1e-2).contains(&share), "{share}");
        assert!(moved(25.0, 0.8) < 0.2 * share && moved(100.0, 0.0) < 0.2 * share);
    }
}
