//! Compares core with OpenCV's numbers, which `data/generate.py` writes.

use nalgebra::Vector3;
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, NormalizedPoint, PixelPoint},
    ellipse::Ellipse,
    marker::{Kind, Ring},
    pose::{RimNoise, locate},
};
use serde::Deserialize;

#[derive(Deserialize)]
struct CameraData {
    name: String,
    width: usize,
    height: usize,
    fx_px: f64,
    fy_px: f64,
    cx_px: f64,
    cy_px: f64,
    lens: String,
    distortion: Vec<f64>,
}

impl CameraData {
    fn camera(&self) -> Camera {
        let lens = match self.lens.as_str() {
            "plumb_bob" => Lens::PlumbBob(self.distortion.as_slice().try_into().unwrap()),
            "rational_polynomial" => Lens::Rational(self.distortion.as_slice().try_into().unwrap()),
            "equidistant" => Lens::Equidistant(self.distortion.as_slice().try_into().unwrap()),
            other => panic!("unknown lens {other}"),
        };
        Camera::new(Intrinsics {
            width: self.width,
            height: self.height,
            fx_px: self.fx_px,
            fy_px: self.fy_px,
            cx_px: self.cx_px,
            cy_px: self.cy_px,
            lens,
        })
        .unwrap()
    }
}

#[derive(Deserialize)]
struct LensData {
    lenses: Vec<LensCase>,
}

#[derive(Deserialize)]
struct LensCase {
    camera: CameraData,
    projected: Vec<Projected>,
    undistorted: Vec<Undistorted>,
}

#[derive(Deserialize)]
struct Projected {
    point_m: [f64; 3],
    pixel: [f64; 2],
}

#[derive(Deserialize)]
struct Undistorted {
    pixel: [f64; 2],
    normalized: [f64; 2],
}

#[derive(Deserialize)]
struct CircleData {
    outer_diameter_m: f64,
    inner_diameter_m: f64,
    cameras: Vec<CameraData>,
    circles: Vec<CircleCase>,
}

#[derive(Deserialize)]
struct CircleCase {
    camera: String,
    position_m: [f64; 3],
    normal: [f64; 3],
    fitted: Rims,
    moments: Rims,
}

#[derive(Deserialize)]
struct Rims {
    outer: EllipseData,
    inner: EllipseData,
}

#[derive(Deserialize)]
struct EllipseData {
    center_px: [f64; 2],
    semi_major_px: f64,
    semi_minor_px: f64,
    angle_rad: f64,
}

impl EllipseData {
    fn ellipse(&self) -> Ellipse {
        Ellipse {
            center: PixelPoint { u: self.center_px[0], v: self.center_px[1] },
            semi_major_px: self.semi_major_px,
            semi_minor_px: self.semi_minor_px,
            angle_rad: self.angle_rad,
        }
    }
}

fn lenses() -> Vec<LensCase> {
    serde_json::from_str::<LensData>(include_str!("data/lens.json")).unwrap().lenses
}

#[test]
fn projection_matches_opencv() {
    for case in lenses() {
        let camera = case.camera.camera();
        for Projected { point_m, pixel } in &case.projected {
            let found = camera.project(&Vector3::from(*point_m)).unwrap();
            let off = (found.u - pixel[0]).hypot(found.v - pixel[1]);
            assert!(off < 1e-9, "{}: {point_m:?} at {found:?}, not {pixel:?}", case.camera.name);
        }
    }
}

#[test]
fn distortion_and_undistortion_match_opencv() {
    for case in lenses() {
        let camera = case.camera.camera();
        for Undistorted { pixel: [u, v], normalized: [x, y] } in &case.undistorted {
            let found = camera.undistort(PixelPoint { u: *u, v: *v }).unwrap();
            let off = (found.x - x).hypot(found.y - y);
            // Near 90°, points on the plane z = 1 approach infinity, so the tolerance grows with the squared distance
            // from the camera, like the error of their angle.
            let tolerance = 1e-9 * (1.0 + x * x + y * y);
            assert!(off < tolerance, "{}: ({u}, {v}) at {found:?}, not {x}, {y}", case.camera.name);
            let back = camera.distort(NormalizedPoint { x: *x, y: *y }).unwrap();
            assert!((back.u - u).hypot(back.v - v) < 1e-9, "{}: {back:?}", case.camera.name);
        }
    }
}

/// Worst errors of one camera's poses: relative position and angle of the nearer normal.
#[derive(Debug)]
struct Errors {
    position: f64,
    normal_rad: f64,
}

impl Errors {
    fn within(&self, limit: &Errors) -> bool {
        self.position < limit.position && self.normal_rad < limit.normal_rad
    }
}

fn worst_errors(
    data: &CircleData,
    camera_data: &CameraData,
    rims: fn(&CircleCase) -> &Rims,
) -> Errors {
    let camera = camera_data.camera();
    let kind = Kind::plain("golden", data.outer_diameter_m, data.inner_diameter_m);
    let mut worst = Errors { position: 0.0, normal_rad: 0.0 };
    for case in data.circles.iter().filter(|case| case.camera == camera_data.name) {
        let rims = rims(case);
        let ring = Ring::of_rims(rims.outer.ellipse(), rims.inner.ellipse());
        let pose = locate(&camera, &kind, &ring, &RimNoise::default()).unwrap();
        let position_m = Vector3::from(case.position_m);
        let normal = Vector3::from(case.normal);
        let position = (pose.position_m - position_m).norm() / position_m.norm();
        let normal_rad = pose.normal.angle(&normal).min(pose.other_normal.angle(&normal));
        worst.position = worst.position.max(position);
        worst.normal_rad = worst.normal_rad.max(normal_rad);
    }
    worst
}

/// Accuracy of the method: relative error of position and error of the normal, radians, of rims given by their areas'
/// moments, and of rims given by a direct fit. Without distortion, the former is that of the polygon used for the
/// moments. With distortion, the image of a circle is not an ellipse; the worst cases are rims of 70 to 180 px radius
/// at the edge of the image. One ring under `pincushion` is so small and upright that its normal is the mean of those
/// consistent with its noise.
const ACCURACY: [(&str, Errors, Errors); 9] = [
    ("pinhole", errors(1e-7, 1e-7), errors(1e-9, 1e-7)),
    ("mild", errors(2e-6, 1e-6), errors(3e-5, 3e-5)),
    ("webcam", errors(6e-6, 2e-5), errors(6e-5, 1e-4)),
    ("barrel", errors(2e-4, 2e-4), errors(3e-4, 6e-4)),
    ("pincushion", errors(1e-4, 5e-3), errors(6e-4, 5e-3)),
    ("rational", errors(3e-5, 3e-5), errors(2e-4, 4e-4)),
    ("wide", errors(1e-4, 2e-4), errors(1e-3, 2e-3)),
    ("fisheye", errors(2e-3, 1e-3), errors(3e-3, 4e-3)),
    ("pure fisheye", errors(2e-3, 1e-3), errors(3e-3, 2e-3)),
];

const fn errors(position: f64, normal_rad: f64) -> Errors {
    Errors { position, normal_rad }
}

#[test]
fn poses_match_circles_projected_by_opencv() {
    let data: CircleData = serde_json::from_str(include_str!("data/circle.json")).unwrap();
    assert_eq!(data.cameras.len(), ACCURACY.len());
    for (camera, (name, moments, fitted)) in data.cameras.iter().zip(&ACCURACY) {
        assert_eq!(&camera.name, name);
        let found = worst_errors(&data, camera, |case| &case.moments);
        assert!(found.within(moments), "{name}, moments: {found:?}, expected {moments:?}");
        let found = worst_errors(&data, camera, |case| &case.fitted);
        assert!(found.within(fitted), "{name}, fitted: {found:?}, expected {fitted:?}");
    }
}
