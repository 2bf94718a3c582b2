//! Predicted precision of a roundel's pose.
//!
//! - **Picture**: the noise of the rims (`pose_model`) is carried to the pose by [`roundel_vision::pose::locate`], as for
//!   detected rings.
//! - **Compensation**, in fast mode: it assumes that the rims' areas scale as r². Perspective and lens violate this for
//!   large tilted or near rings. The error is computed from the projected rims.
//! - **Wrong normal**: without noise, the right normal has the likelihood L, a misfit D = 2 ln(L/(1-L)) of the other one.
//!   Noise changes the misfit with the deviation 2√D, so the share Φ(-√D/2) of pictures prefers the wrong normal and shifts
//!   the centre accordingly. It replaces the share 1-L of a single picture's covariance.
//! - **Trials**: where disc or ring is hardly wider than the blur, and in fast mode up to 32 px, errors are corrected by
//!   measured ratios (`monte_carlo`): the covariance C of the position becomes S C S with S = a l lᵀ + b (I - l lᵀ) for the
//!   line of sight l. The covariance of the normal stays.
//! - **Lens** (the paper's Δf of equation 19 and ε of equation 17): with the derivatives J of the position by fx, fy, cx, cy
//!   and the coefficients, and their covariance Σ, J Σ Jᵀ is added. It is constant, so filters do not reduce it.

use nalgebra::{DMatrix, Matrix3, Matrix3xX, Vector3};

use super::{
    Sensor,
    monte_carlo::{ErrorFactors, factors},
    pose_model::{along_m, predict_pose, rim_noise, without_teeth},
    roundel_image::{RoundelImage, image_roundel},
    visibility::{is_detected, is_readable},
};
use roundel_vision::{
    camera::{Camera, Intrinsics, Lens},
    id::TrackNumber,
    marker::Kind,
    pose::{Detection, RoundelPose, locate},
    rigid::Rigid,
    time::Timestamp,
};

/// Steps of the numerical derivatives: pixels, and coefficients.
const STEP_PX: f64 = 1e-2;
const STEP: f64 = 1e-5;

/// Uncertainty of a camera's parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct LensUncertainty {
    /// Indices of the estimated coefficients, ascending; the others are exact.
    pub free: Vec<usize>,
    /// Over fx, fy, cx, cy (pixels) and these coefficients.
    pub covariance: DMatrix<f64>,
}

/// Predicted detection of a roundel.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// The roundel's image.
    pub image: RoundelImage,
    /// Whether its code is read; true without a code.
    pub is_readable: bool,
    /// Pose with the covariance of the picture alone.
    pub pose: RoundelPose,
    /// Covariance of the position by the lens, camera frame, m²; zero for an exact lens.
    pub by_lens_m2: Matrix3<f64>,
}

/// Predicts the detection of a roundel at a pose; `None` if it is not detected.
pub fn predict(sensor: &Sensor, kind: &Kind, camera_from_roundel: &Rigid) -> Option<Prediction> {
    // The centre alone excludes most roundels outside of the view.
    let center = sensor.camera.project(&camera_from_roundel.translation.vector).ok()?;
    if !sensor.camera.contains(center) {
        return None;
    }
    let image = image_roundel(&sensor.camera, kind, &sensor.imaging, camera_from_roundel)?;
    if !is_detected(sensor, kind, &image) {
        return None;
    }
    let mut pose = predict_pose(sensor, kind, &image)?;
    let ErrorFactors { along, across } =
        factors(sensor, kind, &image, &camera_from_roundel.translation.vector);
    let sight = pose.position_m.normalize();
    let scaled = Matrix3::identity() * across + sight * sight.transpose() * (along - across);
    let mut block = pose.covariance.fixed_view_mut::<3, 6>(0, 0);
    block.copy_from(&(scaled * &block));
    let mut block = pose.covariance.fixed_view_mut::<6, 3>(0, 0);
    block.copy_from(&(&block * scaled));
    let by_lens_m2 = match &sensor.lens_uncertainty {
        Some(lens_uncertainty) => {
            let (solid_kind, noise) = (without_teeth(kind), rim_noise(sensor, kind, &image));
            let located = |camera: &Camera| locate(camera, &solid_kind, &image.ring, &noise);
            let position = |camera: &Camera| Some(located(camera).ok()?.position_m);
            lens_uncertainty.carried(&sensor.camera, position)?
        }
        None => Matrix3::zeros(),
    };
    let is_readable = is_readable(sensor, kind, &image);
    Some(Prediction { image, is_readable, pose, by_lens_m2 })
}

impl Prediction {
    /// Covariance of the position, camera frame, m².
    pub fn position_m2(&self) -> Matrix3<f64> {
        self.pose.covariance.fixed_view::<3, 3>(0, 0) + self.by_lens_m2
    }

    /// Standard deviation along the line of sight, metres.
    pub fn depth_m(&self) -> f64 {
        along_m(&self.position_m2(), &self.pose.position_m)
    }

    /// Rms standard deviation across the line of sight, metres: the error of each coordinate on a known plane (2D
    /// mode).
    pub fn across_m(&self) -> f64 {
        let depth = self.depth_m();
        (0.5 * (self.position_m2().trace() - depth * depth)).max(0.0).sqrt()
    }

    /// Rms position error, metres.
    pub fn position_m(&self) -> f64 {
        self.position_m2().trace().max(0.0).sqrt()
    }

    /// Rms angle error of the normal if the right one of the two was selected, radians.
    pub fn normal_rad(&self) -> f64 {
        let rotation = self.pose.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        let about = self.pose.normal.dot(&(rotation * self.pose.normal));
        (rotation.trace() - about).max(0.0).sqrt()
    }

    /// The detection as input of fusion, including the uncertainty of the lens.
    pub fn detection(&self) -> Detection {
        let mut pose = self.pose.clone();
        let mut position = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
        position += self.by_lens_m2;
        let (track, capture_time) = (TrackNumber(0), Timestamp::default());
        Detection { track, ring: self.image.ring, capture_time, pose: Some(pose) }
    }
}

impl LensUncertainty {
    /// Covariance of a position that depends on the camera's parameters.
    fn carried(
        &self,
        camera: &Camera,
        position: impl Fn(&Camera) -> Option<Vector3<f64>>,
    ) -> Option<Matrix3<f64>> {
        let count = 4 + self.free.len();
        let mut slopes = Matrix3xX::zeros(count);
        for number in 0..count {
            let step = if number < 4 { STEP_PX } else { STEP };
            let at = |step: f64| position(&self.moved(camera, number, step)?);
            slopes.set_column(number, &((at(step)? - at(-step)?) / (2.0 * step)));
        }
        let carried = &slopes * &self.covariance * slopes.transpose();
        Some((carried + carried.transpose()) * 0.5)
    }

    fn moved(&self, camera: &Camera, number: usize, step: f64) -> Option<Camera> {
        let mut to: Intrinsics = camera.intrinsics().clone();
        match number {
            0 => to.fx_px += step,
            1 => to.fy_px += step,
            2 => to.cx_px += step,
            3 => to.cy_px += step,
            _ => {
                let mut coefficients = to.lens.coefficients().to_vec();
                *coefficients.get_mut(self.free[number - 4])? += step;
                to.lens = Lens::from_ros(to.lens.name(), &coefficients)?;
            }
        }
        Camera::new(to).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{range::pose_in_front, tests::sensor};
    use super::*;
    use roundel_vision::camera::NormalizedPoint;

    fn face_on(sensor: &Sensor, diameter_px: f64) -> Prediction {
        let kind = Kind::plain("", 0.16, 0.064);
        let distance_m = sensor.camera.intrinsics().fx_px * 0.16 / diameter_px;
        let pose = pose_in_front(NormalizedPoint::default(), distance_m, 0.0);
        predict(sensor, &kind, &pose).unwrap()
    }

    /// With a known tilt it would be 1/7000 (the Cramér-Rao bound of the pixels); face-on, the unknown tilt adds to
    /// it.
    #[test]
    fn the_distance_error_at_30_px_is_a_fortieth_of_a_percent() {
        let expected = face_on(&sensor(), 30.5);
        let share = expected.depth_m() / expected.pose.position_m.norm();
        assert!((1.42e-4..2.9e-4).contains(&share), "{share}");
        // Half of the rim's length, 30.5 π 1.4 px, contributes to each direction.
        let px = expected.across_m() / expected.pose.position_m.norm() * 700.0;
        assert!((0.002..0.006).contains(&px), "{px}");
    }

    #[test]
    fn noise_and_an_uncertain_lens_reduce_precision() {
        let clean = face_on(&sensor(), 30.0).depth_m();
        let mut noisy = sensor();
        noisy.imaging.noise = 4.0;
        let ratio = face_on(&noisy, 30.0).depth_m() / clean;
        assert!((1.3..3.0).contains(&ratio), "{ratio}");
        // Both focal lengths are off by one thousandth, and so is the distance.
        let mut covariance = DMatrix::zeros(4, 4);
        covariance.view_mut((0, 0), (2, 2)).fill(0.7f64.powi(2));
        let lens_uncertainty = Some(LensUncertainty { free: Vec::new(), covariance });
        let expected = face_on(&Sensor { lens_uncertainty, ..sensor() }, 30.0);
        let by_lens = expected.depth_m().powi(2) - clean.powi(2);
        let share = by_lens.sqrt() / expected.pose.position_m.norm();
        assert!((share / 1e-3 - 1.0).abs() < 0.1, "{share}");
    }
}
