//! Golden vectors for core/docs/conventions.md, line by line, with numbers worked out by hand.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

use nalgebra::{Matrix6, Point3, Quaternion, UnitQuaternion, Vector3, Vector6};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    ellipse::Ellipse,
    marker::{Kind, Ring},
    pose::{RimNoise, locate},
    rigid::{
        Rigid, UNKNOWN_ANGLE_VARIANCE_RAD2, from_upper_triangle, orientation_of_normal,
        rotate_covariance, upper_triangle,
    },
    time::{Timestamp, row_time},
};

fn assert_close(found: Vector3<f64>, expected: [f64; 3]) {
    assert!((found - Vector3::from(expected)).norm() < 1e-12, "{found} is not {expected:?}");
}

/// 640 x 480, f = 500 px, and the principal point at the image centre.
fn camera() -> Camera {
    Camera::new(Intrinsics {
        width: 640,
        height: 480,
        fx_px: 500.0,
        fy_px: 500.0,
        cx_px: 319.5,
        cy_px: 239.5,
        lens: Lens::PlumbBob([0.0; 5]),
    })
    .unwrap()
}

fn pixel(u: f64, v: f64) -> PixelPoint {
    PixelPoint { u, v }
}

#[test]
fn pixel_centres_lie_on_integers() {
    let camera = camera();
    // The image extends by half a pixel around its outermost centres, and no more.
    assert!(camera.contains(pixel(-0.5, -0.5)) && camera.contains(pixel(639.5, 479.5)));
    assert!(!camera.contains(pixel(-0.6, 0.0)) && !camera.contains(pixel(0.0, 479.6)));
    // The centre of 640 columns, 0 to 639, is 319.5.
    assert_close(camera.bearing(pixel(319.5, 239.5)).unwrap(), [0.0, 0.0, 1.0]);
}

#[test]
fn camera_looks_along_z_with_x_right_and_y_down() {
    let camera = camera();
    // A metre to the right at two metres: 250 px to the right. Likewise down.
    assert_eq!(camera.project(&Vector3::new(1.0, 0.0, 2.0)).unwrap(), pixel(569.5, 239.5));
    assert_eq!(camera.project(&Vector3::new(0.0, 0.5, 2.0)).unwrap(), pixel(319.5, 364.5));
    let undistorted = camera.undistort(pixel(569.5, 114.5)).unwrap();
    assert!((undistorted.x - 0.5).abs() < 1e-12 && (undistorted.y + 0.25).abs() < 1e-12);
}

#[test]
fn quaternions_are_hamilton_and_stored_x_y_z_w() {
    // A quarter turn about z, counterclockwise seen from its tip: x goes to y.
    let quarter =
        UnitQuaternion::new_unchecked(Quaternion::from([0.0, 0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2]));
    assert_close(quarter * Vector3::x(), [0.0, 1.0, 0.0]);
    assert_eq!(quarter.coords.as_slice()[3], FRAC_1_SQRT_2);
    // Hamilton: i j = k. A product applies its right factor first.
    let (i, j) = (Quaternion::new(0.0, 1.0, 0.0, 0.0), Quaternion::new(0.0, 0.0, 1.0, 0.0));
    assert_eq!(i * j, Quaternion::new(0.0, 0.0, 0.0, 1.0));
    let about_x = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), FRAC_PI_2);
    assert_close((about_x * quarter) * Vector3::x(), [0.0, 0.0, 1.0]);
}

#[test]
fn a_from_b_turns_coordinates_of_b_into_those_of_a() {
    // A camera 5 m above the world's origin, looking down, with its right along the world's x: its down is the
    // world's -y, its forward the world's -z, which is half a turn about x.
    let world_from_camera = Rigid::from_parts(
        Vector3::new(0.0, 0.0, 5.0).into(),
        UnitQuaternion::new_unchecked(Quaternion::from([1.0, 0.0, 0.0, 0.0])),
    );
    let camera_from_roundel = Rigid::translation(0.3, 0.2, 4.0);
    let world_from_roundel = world_from_camera * camera_from_roundel;
    let center = world_from_roundel * Point3::origin();
    assert_close(center.coords, [0.3, -0.2, 1.0]);
    // A robot on the floor at the world's -y appears in the image's lower half.
    let seen = camera().project(&camera_from_roundel.translation.vector).unwrap();
    assert!((seen.u - 357.0).abs() < 1e-12 && (seen.v - 264.5).abs() < 1e-12);
}

#[test]
fn a_plain_roundel_has_the_smallest_rotation() {
    // Facing up the world's z: no rotation. Tilted by 30° towards +x: rotated about +y.
    assert!(orientation_of_normal(&Vector3::z()).angle() < 1e-12);
    let (sin, cos) = (PI / 6.0).sin_cos();
    let tilted = orientation_of_normal(&Vector3::new(sin, 0.0, cos));
    assert_close(tilted.scaled_axis(), [0.0, PI / 6.0, 0.0]);
    assert_close(tilted * Vector3::y(), [0.0, 1.0, 0.0]);
    // Facing a camera straight on, in the camera frame: half a turn about x. The print's right stays the image's
    // right, and its up, y, becomes the image's up, -y.
    let facing = orientation_of_normal(&-Vector3::z());
    assert_close(facing * Vector3::x(), [1.0, 0.0, 0.0]);
    assert_close(facing * Vector3::y(), [0.0, -1.0, 0.0]);
    assert_close(facing * Vector3::z(), [0.0, 0.0, -1.0]);
}

#[test]
fn covariance_is_a_left_perturbation_in_the_outer_frame() {
    // R takes x to y. A small rotation about the outer frame's x, applied after R, moves the image of
    // the inner x, which is the outer y, towards the outer z.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
    let small = UnitQuaternion::from_scaled_axis(Vector3::new(0.001, 0.0, 0.0));
    let moved = (small * turn) * Vector3::x();
    assert!((moved - Vector3::new(0.0, 1.0, 0.001)).norm() < 1e-6);
    // Under the same rotation, x becomes y, for position (0 to 2) and rotation (3 to 5) alike.
    let covariance = Matrix6::from_diagonal(&Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0));
    let carried = rotate_covariance(&turn, &covariance);
    let expected = Matrix6::from_diagonal(&Vector6::new(2.0, 1.0, 3.0, 5.0, 4.0, 6.0));
    assert!((carried - expected).norm() < 1e-12);
}

#[test]
fn upper_triangle_runs_row_by_row() {
    let matrix = Matrix6::from_fn(|row, column| (10 * row.min(column) + row.max(column)) as f64);
    let numbers = upper_triangle(&matrix);
    let expected = [
        0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 11.0, 12.0, 13.0, 14.0, 15.0, 22.0, 23.0, 24.0, 25.0, 33.0,
        34.0, 35.0, 44.0, 45.0, 55.0,
    ];
    assert_eq!(numbers, expected);
    assert_eq!(from_upper_triangle::<6>(&numbers), Some(matrix));
}

/// The rims of a roundel of 160 and 64 mm on the optical axis at 4 m, tilted by 60° about the image's
/// vertical: a circle of radius 80 mm, whose points nearest and farthest lie at 4 m ± 80 mm sin 60°.
fn tilted_ring() -> Ring {
    let rim = |radius_m: f64| {
        let (across_m, along_m) = (radius_m * 0.5, radius_m * 0.75f64.sqrt());
        let (near, far) = (500.0 * across_m / (4.0 - along_m), 500.0 * across_m / (4.0 + along_m));
        // The rim's points above and below the centre lie at 4 m. The ellipse's centre lies beside them; for an
        // ellipse with semiaxis b that is cut at x from its centre, y² = a² (1 - x²/b²).
        let (minor_px, center_px) = (0.5 * (near + far), 0.5 * (near - far));
        let height_px = 500.0 * radius_m / 4.0;
        let major_px = height_px / (1.0 - (center_px / minor_px).powi(2)).sqrt();
        Ellipse {
            center: pixel(319.5 + center_px, 239.5),
            semi_major_px: major_px,
            semi_minor_px: minor_px,
            angle_rad: FRAC_PI_2,
        }
    };
    Ring::of_rims(rim(0.08), rim(0.032))
}

#[test]
fn an_ellipse_has_two_normals_that_face_the_camera() {
    let kind = Kind::plain("robot", 0.16, 0.064);
    let pose = locate(&camera(), &kind, &tilted_ring(), &RimNoise::default()).unwrap();
    assert!((pose.position_m - Vector3::new(0.0, 0.0, 4.0)).norm() < 1e-9, "{}", pose.position_m);
    assert!(pose.normal.dot(&pose.position_m) < 0.0);
    assert!(pose.other_normal.dot(&pose.position_m) < 0.0);
    // The right side is nearer and appears larger: the face looks towards -x and -z.
    let (sin, cos) = (PI / 3.0).sin_cos();
    assert_close_to(pose.normal, [-sin, 0.0, -cos], 1e-6);
    assert_close_to(pose.other_normal, [sin, 0.0, -cos], 0.03);
    assert!((0.5..=1.0).contains(&pose.normal_likelihood));
    assert_eq!(pose.yaw_rad, None);
    // The rotation about the normal is unknown: π²/3.
    let rotation = pose.covariance.fixed_view::<3, 3>(3, 3);
    let about_normal = pose.normal.dot(&(rotation * pose.normal));
    assert!((about_normal - PI * PI / 3.0).abs() < 1e-9);
    assert!((UNKNOWN_ANGLE_VARIANCE_RAD2 - 3.289_868_133_696_453).abs() < 1e-15);
}

fn assert_close_to(found: Vector3<f64>, expected: [f64; 3], tolerance: f64) {
    assert!((found - Vector3::from(expected)).norm() < tolerance, "{found} is not {expected:?}");
}

#[test]
fn times_are_nanoseconds_and_lower_rows_are_later() {
    let frame = Timestamp::from_ns(1_700_000_000_000_000_000);
    assert_eq!(frame.plus_seconds(1.0).as_ns(), 1_700_000_001_000_000_000);
    // 480 rows: the centre is row 239.5. At 12 µs a row, row 0 is 2.874 ms earlier.
    assert_eq!(row_time(frame, 239.5, 480, 12e-6), frame);
    assert_eq!(row_time(frame, 0.0, 480, 12e-6).ns_since(frame), -2_874_000);
    assert_eq!(row_time(frame, 479.0, 480, 12e-6).ns_since(frame), 2_874_000);
    // With a global shutter all rows have the same time.
    assert_eq!(row_time(frame, 479.0, 480, 0.0), frame);
}
