//! Tests of the position of painted rims.
//!
//! The reference is the projected rim, shifted inwards by σ²κ/2 for the curvature κ, as blur does. The painted rim is where
//! the grey level along the image of a radius crosses the middle between ring and paper.

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};

use super::{
    Renderer, Scenario, ScenarioParams,
    canvas::Canvas,
    noise::STEPS_PER_LEVEL,
    patch::{Inside, Patch, Setting, Shape, Sheet},
    ray::RayGrid,
};
use roundel_vision::{camera::Camera, rigid::Rigid};

/// Interpolated grey levels (Lagrange polynomial of 6 x 6 pixels; fewer would shift rims with small radii).
struct Picture<'a> {
    width: usize,
    level: &'a dyn Fn(usize) -> f64,
}

/// Weights of samples at -2 … 3 for a position in 0 to 1.
fn lagrange_weights(place: f64) -> [f64; 6] {
    std::array::from_fn(|i| {
        let here = i as f64 - 2.0;
        (0..6)
            .filter(|&j| j != i)
            .map(|j| j as f64 - 2.0)
            .map(|other| (place - other) / (here - other))
            .product()
    })
}

impl Picture<'_> {
    fn at(&self, u: f64, v: f64) -> f64 {
        let (columns, rows) = (lagrange_weights(u - u.floor()), lagrange_weights(v - v.floor()));
        let (column, row) = (u.floor() as usize - 2, v.floor() as usize - 2);
        let mut sum = 0.0;
        for (j, down) in rows.iter().enumerate() {
            for (i, right) in columns.iter().enumerate() {
                sum += down * right * (self.level)((row + j) * self.width + column + i);
            }
        }
        sum
    }

    /// Largest distance between the painted and the blurred true rim, and their mean signed distance (outwards
    /// positive), pixels. The roundel moves by `motion_m` during the exposure, and by `per_row_m` per row.
    fn rim_error_px(
        &self,
        camera: &Camera,
        camera_from_roundel: &Rigid,
        radii_m: [f64; 4],
        [motion_m, per_row_m]: [Vector3<f64>; 2],
    ) -> [f64; 2] {
        const DIRECTIONS: u32 = 64;
        let center_m = camera_from_roundel.translation.vector;
        let row_px = camera.project(&center_m).unwrap().v;
        let imaged = |point_m: Vector3<f64>| {
            let mut pixel = camera.project(&point_m).unwrap();
            for _ in 0..5 {
                pixel = camera.project(&(point_m + per_row_m * (pixel.v - row_px))).unwrap();
            }
            pixel
        };
        let seen = |point_m: Vector3<f64>| {
            let pixel = imaged(point_m);
            Vector2::new(pixel.u, pixel.v)
        };
        let motion_px = seen(center_m + 0.5 * motion_m) - seen(center_m - 0.5 * motion_m);
        let [inside_m, radius_m, outside_m, white_m] = radii_m;
        let (mut largest, mut sum) = (0f64, 0.0);
        for i in 0..DIRECTIONS {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(DIRECTIONS);
            let pixel = |radius_m: f64| {
                let point = Point3::new(radius_m * angle.cos(), radius_m * angle.sin(), 0.0);
                imaged((camera_from_roundel * point).coords)
            };
            let level = |radius_m: f64| {
                let pixel = pixel(radius_m);
                self.at(pixel.u, pixel.v)
            };
            // Light is linear over a roundel: white on both sides of the ring gives its value at the rim.
            let slope = if white_m > 0.0 { (level(white_m) - level(0.0)) / white_m } else { 0.0 };
            let white = |radius_m: f64| level(0.0) + slope * radius_m;
            let black_m = (INNER_M + OUTER_M) / 2.0;
            let black = level(black_m) * white(radius_m) / white(black_m);
            let middle = (black + white(radius_m)) / 2.0;
            let rising = level(outside_m) > level(inside_m);
            // Bisection along the image of a radius.
            let (mut low, mut high) = (inside_m, outside_m);
            for _ in 0..40 {
                let half = (low + high) / 2.0;
                if (level(half) < middle) == rising { low = half } else { high = half }
            }
            let on_rim = |angle: f64| {
                let point = Point3::new(radius_m * angle.cos(), radius_m * angle.sin(), 0.0);
                seen((camera_from_roundel * point).coords)
            };
            let [before, here, after] = [angle - 0.02, angle, angle + 0.02].map(on_rim);
            let tangent = (after - before).normalize();
            // Curvature of the circle through the three points.
            let curvature = 2.0 * (here - before).perp(&(after - here)).abs()
                / ((here - before).norm() * (after - here).norm() * (after - before).norm());
            let variance_px2 = BLUR_PX * BLUR_PX + (1.0 + motion_px.dot(&tangent).powi(2)) / 12.0;
            let outwards = Vector2::new(-tangent.y, tangent.x);
            let outwards = outwards * outwards.dot(&(here - seen(center_m))).signum();
            let found = pixel(low);
            let off = (Vector2::new(found.u, found.v) - here).dot(&outwards)
                + 0.5 * variance_px2 * curvature;
            largest = largest.max(off.abs());
            sum += off;
        }
        [largest, sum / f64::from(DIRECTIONS)]
    }
}

/// As in the presets.
const BLUR_PX: f64 = 0.7;
const OUTER_M: f64 = 0.08;
const INNER_M: f64 = 0.032;
/// Both rims, each with radii inside and outside of it, and the radius where white is sampled outside of the ring
/// (0: inside only).
fn rims_m(white_m: f64) -> [[f64; 4]; 2] {
    let black_m = (INNER_M + OUTER_M) / 2.0;
    [[0.0, INNER_M, black_m, white_m], [black_m, OUTER_M, 1.17 * OUTER_M, white_m]]
}

/// A roundel on the ray (x, y, 1) that faces the camera, rotated by `tilt_rad` about an axis in the image plane.
fn roundel_pose([x, y]: [f64; 2], depth_m: f64, tilt_rad: f64, axis_rad: f64) -> Rigid {
    let axis = Vector3::new(axis_rad.cos(), axis_rad.sin(), 0.0);
    let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let turn = UnitQuaternion::from_scaled_axis(axis * tilt_rad) * flip;
    Rigid::from_parts(Vector3::new(x * depth_m, y * depth_m, depth_m).into(), turn)
}

/// Motion during the exposure.
const MOTION_M: [f64; 3] = [0.003, -0.001, 0.0];
/// Motion per row: 1 m/s at 12 µs.
const PER_ROW_M: [f64; 3] = [7e-6, -9e-6, 0.0];

/// Working image of a roundel on an even page.
fn painted(camera: &Camera, camera_from_roundel: Rigid, sheet: Sheet) -> Canvas {
    let setting = Setting {
        light: [0.8, 0.05, -0.03],
        motion_m: Vector3::from(MOTION_M),
        per_row_m: Vector3::from(PER_ROW_M),
        blur_px: BLUR_PX,
    };
    let inside = Inside::Disc(INNER_M as f32);
    let shape = Shape::Roundel { outer_radius_m: OUTER_M as f32, inside, sheet };
    let patch = Patch::new(camera, camera_from_roundel, &setting).expect("seen from the front");
    let page = vec![150 * STEPS_PER_LEVEL; camera.width() * camera.height()];
    let mut canvas = Canvas::new(camera.width(), page);
    canvas.paint(camera, &RayGrid::new(camera).unwrap(), &patch, &shape);
    canvas
}

#[test]
fn half_levels_lie_on_the_projected_rims() {
    let scenario = Scenario::new(ScenarioParams::r4_lite(1)).unwrap();
    let camera = &scenario.cameras()[0].camera;
    let width = camera.width();
    let sheets = [Sheet::Disc(1.5 * OUTER_M as f32), Sheet::Square(1.5 * OUTER_M as f32)];
    let mut checked = 0;
    // Outer diameters of 16 to 110 px, positions from the middle to the corner.
    for (depth_m, sheet) in [7.0, 5.0, 3.0, 1.1].into_iter().zip(sheets.into_iter().cycle()) {
        for place in [[0.0, 0.0], [0.31, -0.22], [-0.75, 0.38]] {
            for (tilt_rad, axis_rad) in [(0.0, 0.0), (0.5, 0.7), (0.9, 2.9)] {
                let camera_from_roundel = roundel_pose(place, depth_m, tilt_rad, axis_rad);
                // The smallest radius of curvature of the disc's image is b² / a; near the blur, interpolation is
                // too inexact.
                let sight = camera_from_roundel.translation.vector.normalize();
                let facing = (camera_from_roundel.rotation * Vector3::z()).dot(&sight);
                if INNER_M * 733.0 / depth_m * facing * facing < 2.2 {
                    continue;
                }
                checked += 1;
                let canvas = painted(camera, camera_from_roundel, sheet);
                let level = |i: usize| f64::from(canvas.row(i / width)[i % width]);
                let picture = Picture { width, level: &level };
                for radii_m in rims_m(1.25 * OUTER_M) {
                    let motions_m = [MOTION_M, PER_ROW_M].map(Vector3::from);
                    let [largest, mean] =
                        picture.rim_error_px(camera, &camera_from_roundel, radii_m, motions_m);
                    assert!(
                        largest < 0.03 && mean.abs() < 0.015,
                        "rim {} m at {depth_m} m, {place:?}, tilt {tilt_rad}: \
                         {largest} px, mean {mean} px",
                        radii_m[1]
                    );
                }
            }
        }
    }
    assert!(checked >= 25, "only {checked} of 36 poses were large enough");
}

#[test]
fn frames_show_robots_where_the_truth_has_them() {
    let mut params = ScenarioParams::r4_lite(8);
    params.image.noise_levels = 0.0;
    params.booms = 0;
    let scenario = Scenario::new(params).unwrap();
    let mut checked = 0;
    for (index, camera) in scenario.cameras().iter().enumerate() {
        let mut renderer = Renderer::new(&scenario, index).unwrap();
        let (width, height) = (camera.camera.width(), camera.camera.height());
        let mut pixels = vec![0; width * height];
        let time_s = renderer.render(40, &mut pixels).unwrap();
        let level = |i: usize| f64::from(pixels[i]);
        let picture = Picture { width, level: &level };
        for robot in scenario.truth(time_s) {
            let center = Point3::from(robot.world_from_roundel.translation.vector);
            let distance_m =
                camera.world_from_camera.inverse_transform_point(&center).coords.norm();
            // Farther roundels are small, and the rotors of a neighbour may cover one.
            if distance_m > 5.2 || !camera.sees(&center, 30.0) {
                continue;
            }
            let pixel = camera.project(&center).unwrap();
            let crowded = scenario.truth(time_s).iter().any(|other| {
                let place = Point3::from(other.world_from_roundel.translation.vector);
                other.index != robot.index
                    && camera
                        .project(&place)
                        .is_some_and(|it| (it.u - pixel.u).hypot(it.v - pixel.v) < 100.0)
            });
            if crowded {
                continue;
            }
            let row_time_s = camera.row_time_s(time_s, pixel.v);
            let exposed = scenario.robot(robot.index, row_time_s);
            let camera_from_roundel =
                camera.world_from_camera.inverse() * exposed.world_from_roundel;
            for radii_m in rims_m(0.0) {
                // Motion during the exposure is negligible.
                let turn = camera.world_from_camera.rotation.inverse();
                let per_row_m = turn * exposed.velocity_m_s * camera.line_time_s;
                let motions_m = [Vector3::zeros(), per_row_m];
                let [largest, mean] =
                    picture.rim_error_px(&camera.camera, &camera_from_roundel, radii_m, motions_m);
                assert!(
                    largest < 0.08 && mean.abs() < 0.02,
                    "{}: robot {} at {distance_m} m, rim {} m: {largest} px, mean {mean} px",
                    camera.name,
                    robot.index,
                    radii_m[1]
                );
            }
            checked += 1;
        }
    }
    assert!(checked > 20, "only {checked} robots were clear");
}
