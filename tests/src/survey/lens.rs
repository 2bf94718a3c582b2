//! Cameras configured with wrong lenses, and the world's error after the lenses were refined.

use nalgebra::{Matrix3, Point3, Vector3};
use roundel_core::{
    calib::arena::{ArenaCalibration, ArenaCamera, LensDeviation, Recording},
    camera::{Camera, Intrinsics, PixelPoint},
    id::CameraId,
};

use super::Survey;
use crate::{random::Random, sensor::Sensing};

/// Grid of points at which the world's error is measured: largest coordinates, spacing and heights.
const REACH_M: [f64; 2] = [3.0, 2.25];
const STEP_M: f64 = 0.75;
const HEIGHTS_M: [f64; 2] = [0.1, 0.5];

/// The configured lens of every camera of a survey.
#[derive(Clone, Debug)]
pub struct WrongLenses {
    configured: Vec<Camera>,
}

impl WrongLenses {
    /// Lenses with these errors of the focal length, relative, and of each coordinate of the principal point, with
    /// alternating signs from camera to camera.
    pub fn by(survey: &Survey, relative: f64, center_px: f64) -> Self {
        let mut sign = -1.0;
        Self::new(survey, || {
            sign = -sign;
            [relative * sign, center_px * sign, -center_px * sign]
        })
    }

    /// Lenses with normally distributed errors of these deviations.
    pub fn drawn(survey: &Survey, relative: f64, center_px: f64) -> Self {
        let mut random = Random::new(survey.arena.seed, 1 << 30);
        Self::new(survey, || {
            [relative, center_px, center_px].map(|deviation| deviation * f64::from(random.normal()))
        })
    }

    fn new(survey: &Survey, mut error: impl FnMut() -> [f64; 3]) -> Self {
        let configured = survey.cameras().into_iter().map(|camera| {
            let [relative, u, v] = error();
            let lens = camera.lens.intrinsics().clone();
            let configured = Intrinsics {
                fx_px: lens.fx_px * (1.0 + relative),
                fy_px: lens.fy_px * (1.0 + relative),
                cx_px: lens.cx_px + u,
                cy_px: lens.cy_px + v,
                ..lens
            };
            Camera::new(configured).expect("survey: a lens that core takes")
        });
        Self { configured: configured.collect() }
    }

    /// The survey's cameras with these lenses, exact or to be refined.
    pub fn cameras(&self, survey: &Survey, deviation: Option<LensDeviation>) -> Vec<ArenaCamera> {
        let camera = |(camera, lens): (ArenaCamera, &Camera)| ArenaCamera {
            lens: lens.clone(),
            lens_deviation: deviation,
            ..camera
        };
        survey.cameras().into_iter().zip(&self.configured).map(camera).collect()
    }

    /// A recording of poses that were computed with these lenses.
    pub fn record(
        &self,
        survey: &Survey,
        sensing: Sensing,
        seconds: f64,
        max_hz: f64,
    ) -> Recording {
        let cameras = survey.cameras();
        survey.record_with_lenses(sensing, seconds, max_hz, |camera: CameraId, place_m| {
            let index = camera.0 as usize;
            measured(&cameras[index].lens, &self.configured[index], place_m)
        })
    }
}

/// Rms error of points of the arena, triangulated with the calibration from all cameras that see them, at least two.
/// `cameras` are the inputs of the calibration.
pub fn world_error_m(
    survey: &Survey,
    found: &ArenaCalibration,
    cameras: &[ArenaCamera],
) -> Option<f64> {
    let along = |reach_m: f64| {
        let steps = (reach_m / STEP_M) as i32;
        (-steps..=steps).map(|step| f64::from(step) * STEP_M)
    };
    let squares: Vec<f64> = HEIGHTS_M
        .into_iter()
        .flat_map(|z| along(REACH_M[0]).map(move |x| (x, z)))
        .flat_map(|(x, z)| along(REACH_M[1]).map(move |y| Point3::new(x, y, z)))
        .filter_map(|point| {
            let placed = placed(survey, found, cameras, &point)?;
            Some((placed - point.coords).norm_squared())
        })
        .collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// The point closest to all rays on which cameras see a point, weighted by the inverse square of their distances.
fn placed(
    survey: &Survey,
    found: &ArenaCalibration,
    cameras: &[ArenaCamera],
    point: &Point3<f64>,
) -> Option<Vector3<f64>> {
    let (mut information, mut weighted, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
    for result in &found.cameras {
        let index = result.camera.0 as usize;
        let Some([u, v]) = survey.arena.pixel(&survey.arena.sites[index], point) else { continue };
        let lens = result.lens.as_ref().map_or(&cameras[index].lens, |lens| &lens.camera);
        let place = &result.world_from_camera;
        let ray = place.rotation * lens.bearing(PixelPoint { u, v }).ok()?.normalize();
        let eye_m = place.translation.vector;
        let across =
            (Matrix3::identity() - ray * ray.transpose()) / (point.coords - eye_m).norm_squared();
        information += across;
        weighted += across * eye_m;
        count += 1;
    }
    (count > 1).then(|| information.cholesky()).flatten().map(|root| root.solve(&weighted))
}

/// The position that a camera with a wrong lens measures for an object at `place_m`: along the wrong lens' ray, at
/// the distance that gives the object the same size in the image.
fn measured(lens: &Camera, configured: &Camera, place_m: &Vector3<f64>) -> Vector3<f64> {
    let pixel = lens.project(place_m).expect("survey: what is seen has a pixel");
    let bearing = configured.bearing(pixel).expect("survey: a pixel with a ray");
    bearing * (size_px(configured, &bearing) / size_px(lens, place_m))
}

/// Root of the area of a small square across the line of sight in the image, over its side.
fn size_px(lens: &Camera, place_m: &Vector3<f64>) -> f64 {
    let side_m = 1e-4 * place_m.norm();
    let across = place_m.cross(&Vector3::y()).normalize();
    let down = place_m.cross(&across).normalize();
    let [u, v] = [across, down].map(|axis| {
        let [one, other] = [1.0, -1.0].map(|sign| {
            lens.project(&(place_m + axis * (sign * side_m))).expect("survey: a point in sight")
        });
        [(one.u - other.u) / (2.0 * side_m), (one.v - other.v) / (2.0 * side_m)]
    });
    (u[0] * v[1] - u[1] * v[0]).abs().sqrt()
}
