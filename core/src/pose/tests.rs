//! Round trips of `locate` on circles that this file projects and fits itself.

use nalgebra::{SMatrix, SVector, SymmetricEigen, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;

use super::*;
use crate::{
    camera::{Intrinsics, Lens, PixelPoint},
    rigid::orientation_of_normal,
};

fn camera(lens: Lens) -> Camera {
    Camera::new(Intrinsics {
        width: 1920,
        height: 1080,
        fx_px: 1100.0,
        fy_px: 1105.0,
        cx_px: 957.0,
        cy_px: 541.0,
        lens,
    })
    .unwrap()
}

fn kind() -> Kind {
    Kind { name: "robot".into(), outer_diameter_m: 0.16, inner_diameter_m: 0.064 }
}

/// The ellipse whose conic fits the points best, by the smallest eigenvector of their design.
fn fit_ellipse(points: &[Vector2<f64>]) -> Ellipse {
    let middle = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    let scale = points.iter().map(|p| (p - middle).norm()).sum::<f64>() / points.len() as f64;
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    let mut right = SVector::<f64, 5>::zeros();
    for p in points {
        let p = (p - middle) / scale;
        let row = SVector::<f64, 5>::new(p.x * p.x - p.y * p.y, 2.0 * p.x * p.y, p.x, p.y, 1.0);
        normal += row * row.transpose();
        right += row * p.norm_squared();
    }
    let [a, b, c, d, e]: [f64; 5] = normal.cholesky().unwrap().solve(&right).into();
    // (1 - a) x² - 2 b x y + (1 + a) y² - c x - d y - e = 0
    let form = nalgebra::Matrix2::new(1.0 - a, -b, -b, 1.0 + a);
    let center = form.try_inverse().unwrap() * Vector2::new(c, d) * 0.5;
    let level = e + center.dot(&(form * center));
    let eigen = SymmetricEigen::new(form);
    let major = if eigen.eigenvalues[0] < eigen.eigenvalues[1] { 0 } else { 1 };
    let axis = eigen.eigenvectors.column(major);
    let mut angle_rad = axis.y.atan2(axis.x);
    if angle_rad <= -std::f64::consts::FRAC_PI_2 {
        angle_rad += std::f64::consts::PI;
    } else if angle_rad > std::f64::consts::FRAC_PI_2 {
        angle_rad -= std::f64::consts::PI;
    }
    Ellipse {
        center: PixelPoint { u: middle.x + scale * center.x, v: middle.y + scale * center.y },
        semi_major_px: scale * (level / eigen.eigenvalues[major]).sqrt(),
        semi_minor_px: scale * (level / eigen.eigenvalues[1 - major]).sqrt(),
        angle_rad,
    }
}

fn rim(
    camera: &Camera,
    position_m: &Vector3<f64>,
    normal: &Vector3<f64>,
    diameter_m: f64,
) -> Ellipse {
    let turn = orientation_of_normal(normal);
    let points: Vec<_> = (0..180)
        .map(|k| {
            let (sin, cos) = (k as f64 * std::f64::consts::TAU / 180.0).sin_cos();
            let point = position_m + turn * Vector3::new(cos, sin, 0.0) * (0.5 * diameter_m);
            let pixel = camera.project(&point).unwrap();
            Vector2::new(pixel.u, pixel.v)
        })
        .collect();
    fit_ellipse(&points)
}

fn ring(camera: &Camera, position_m: &Vector3<f64>, normal: &Vector3<f64>) -> Ring {
    let kind = kind();
    Ring {
        outer: rim(camera, position_m, normal, kind.outer_diameter_m),
        inner: rim(camera, position_m, normal, kind.inner_diameter_m),
        kind: None,
        threshold: 128,
        black: 20.0,
        white: 220.0,
    }
}

/// A pose from the pixel it is seen at, its distance, its tilt and the tilt's direction.
fn pose(
    camera: &Camera,
    pixel: PixelPoint,
    distance_m: f64,
    tilt_rad: f64,
    turn_rad: f64,
) -> (Vector3<f64>, Vector3<f64>) {
    let bearing = camera.bearing(pixel).unwrap();
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad)
        * Vector3::new(tilt_rad.sin(), 0.0, tilt_rad.cos());
    (bearing * distance_m, orientation_of_normal(&-bearing) * tilt)
}

proptest! {
    #[test]
    fn exact_rims_give_the_exact_pose(
        u in 50.0..1870.0f64, v in 50.0..1030.0f64, distance_m in 0.7..12.0f64,
        tilt_rad in 0.1..1.2f64, turn_rad in -3.1..3.1f64,
    ) {
        let camera = camera(Lens::PlumbBob([0.0; 5]));
        let (position_m, normal) = pose(&camera, PixelPoint { u, v }, distance_m, tilt_rad, turn_rad);
        let found =
            locate(&camera, &kind(), &ring(&camera, &position_m, &normal), &RimNoise::default()).unwrap();
        prop_assert!((found.position_m - position_m).norm() < 1e-6 * distance_m, "{found:?}");
        prop_assert!((found.normal - normal).norm() < 1e-5, "{found:?} {normal}");
        prop_assert!(found.normal.dot(&found.position_m) < 0.0);
        prop_assert!(found.other_normal.dot(&found.position_m) < 0.0);
        prop_assert!(found.normal_likelihood >= 0.5 && found.normal_likelihood <= 1.0);
        prop_assert!(found.covariance.cholesky().is_some());
    }
}
