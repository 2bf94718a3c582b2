//! Least covariance of detections that a remote program states.
//!
//! A program may state any covariance, and one that is far too small outvotes all other cameras. Its detections get the
//! covariance of rims that are known to `error_px`, in addition to the stated one. With distance d, focal length f and
//! the outer diameter D in pixels:
//!
//! - across the line of sight: d `error_px` / f;
//! - along the line of sight: d `error_px` / D, since distance follows from the diameter;
//! - rotation: `error_px` / D.

use nalgebra::Matrix3;
use roundel_core::{camera::Camera, pose::Detection};

pub(super) fn apply(detection: &mut Detection, camera: &Camera, error_px: f64) {
    let diameter_px = 2.0 * detection.ring.outer.semi_major_px;
    let Some(pose) = detection.pose.as_mut().filter(|_| error_px > 0.0 && diameter_px > 0.0) else {
        return;
    };
    let distance_m = pose.position_m.norm();
    let Some(sight) = pose.position_m.try_normalize(0.0) else { return };
    let across_m = distance_m * error_px / camera.intrinsics().fx_px;
    let along_m = distance_m * error_px / diameter_px;
    let along = sight * sight.transpose();
    let position = along * along_m.powi(2) + (Matrix3::identity() - along) * across_m.powi(2);
    let rotation = Matrix3::identity() * (error_px / diameter_px).powi(2);
    let mut block = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
    block += position;
    let mut block = pose.covariance.fixed_view_mut::<3, 3>(3, 3);
    block += rotation;
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};
    use roundel_core::{
        camera::{Intrinsics, Lens, PixelPoint},
        ellipse::Ellipse,
        id::TrackNumber,
        marker::Ring,
        pose::RoundelPose,
        rigid::Covariance6,
        time::Timestamp,
    };

    use super::*;

    #[test]
    fn stated_errors_are_at_least_those_of_the_rims() {
        let (width, height, fx_px, fy_px) = (640, 480, 500.0, 500.0);
        let lens = Lens::PlumbBob([0.0; 5]);
        let camera = Camera::new(Intrinsics {
            width,
            height,
            fx_px,
            fy_px,
            cx_px: 320.0,
            cy_px: 240.0,
            lens,
        });
        let center = PixelPoint { u: 320.0, v: 240.0 };
        let rim = Ellipse { center, semi_major_px: 25.0, semi_minor_px: 25.0, angle_rad: 0.0 };
        let pose = RoundelPose {
            position_m: Vector3::new(0.0, 0.0, 2.0),
            normal: -Vector3::z(),
            normal_likelihood: 1.0,
            other_normal: -Vector3::z(),
            yaw_rad: None,
            yaw_symmetry: 1,
            covariance: Covariance6::from_diagonal_element(4e-10),
        };
        let ring = Ring::of_rims(rim, rim);
        let (track, capture_time) = (TrackNumber(1), Timestamp::default());
        let mut detection = Detection { track, ring, capture_time, pose: Some(pose) };
        let camera = camera.unwrap();
        apply(&mut detection, &camera, 0.0);
        assert_eq!(detection.pose.as_ref().unwrap().covariance[(0, 0)], 4e-10);
        apply(&mut detection, &camera, 0.1);
        let covariance = detection.pose.as_ref().unwrap().covariance;
        let sigma = |axis: usize| covariance[(axis, axis)].sqrt();
        // 2 m * 0.1 px over the focal length, and over the diameter.
        let expected = Vector3::new(0.4e-3, 0.4e-3, 4e-3);
        let found = Vector3::new(sigma(0), sigma(1), sigma(2));
        assert!((found - expected).amax() < 1e-5, "{found}");
        let turned: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into_owned();
        assert!((turned[(0, 0)].sqrt() - 0.002).abs() < 1e-4, "{turned}");
    }
}
