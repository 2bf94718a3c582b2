//! Images of printed ellipses through a camera.

use nalgebra::Vector3;
use roundel_core::{
    camera::{Camera, PixelPoint},
    ellipse::{Ellipse, Shape, Symmetric2},
    rigid::orientation_of_normal,
};

/// Ellipse with the area, centre and second moments of the image of an ellipse with yaw 0.
pub fn ellipse(
    camera: &Camera,
    position_m: &Vector3<f64>,
    normal: &Vector3<f64>,
    radii_m: [f64; 2],
) -> Ellipse {
    const POINTS: usize = 400;
    let turn = orientation_of_normal(normal);
    let at = |i: usize| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / POINTS as f64).sin_cos();
        let point = position_m + turn * Vector3::new(cos * radii_m[0], sin * radii_m[1], 0.0);
        camera.project(&point).expect("it is in front of the camera")
    };
    let middle = camera.project(position_m).expect("it is in front of the camera");
    let mut sums = [0.0; 6];
    for i in 0..POINTS {
        let (here, next) = (at(i), at(i + 1));
        let (x, y) = (0.5 * (here.u + next.u) - middle.u, 0.5 * (here.v + next.v) - middle.v);
        let swept = x * (next.v - here.v) - y * (next.u - here.u);
        for (sum, value) in sums.iter_mut().zip([0.5, x / 3.0, y / 3.0, x * x, x * y, y * y]) {
            *sum += value * swept;
        }
    }
    let area = sums[0];
    let (u, v) = (sums[1] / area, sums[2] / area);
    let covariance = Symmetric2 {
        uu: 0.25 * sums[3] / area - u * u,
        uv: 0.25 * sums[4] / area - u * v,
        vv: 0.25 * sums[5] / area - v * v,
    };
    let center = PixelPoint { u: middle.u + u, v: middle.v + v };
    Shape { area_px2: area.abs(), center, covariance }.ellipse()
}
