//! Predicted pose of a roundel, with the covariance that rim noise, compensation and wrong normals cause.

use nalgebra::{Matrix3, Vector3};

use super::{Sensor, rim_noise::rim_noise, roundel_image::RoundelImage};
use roundel_vision::{
    camera::Camera,
    marker::{Kind, Mode, Pattern, Ring, compensated, rim_shift_px},
    normal_distribution,
    pose::{RimNoise, RoundelPose, locate, other_offset_m},
};

/// Predicts the pose without correction by trials; `None` if the ring cannot be located.
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

#[cfg(test)]
mod tests {
    use super::super::{range::pose_in_front, roundel_image::image_roundel, tests::sensor};
    use super::*;
    use roundel_vision::camera::NormalizedPoint;

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
