//! Compares the renderer with brute force in the opposite direction: rays through a fine grid of subpixels,
//! undistorted by Newton's method, intersected with the roundel's plane at the time of the row's exposure, and
//! blurred by summing a Gaussian over them.

use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;
use roundel_tests::{
    half_plane::HalfPlane,
    light::{Light, Shadow},
    optics::{Distortion, Pinhole},
    random::Random,
    render::{Canvas, Imaging, MovingPrint, Print, Renderer},
};

const OUTER_M: f64 = 0.16;
const INNER_M: f64 = 0.064;
const MARGIN: f64 = 0.25;
const FLOOR: f64 = 110.0;
/// Instants of an exposure.
const INSTANTS: usize = 24;

/// A roundel that faces the camera from `position_m`, tilted about an axis in the image plane.
fn pose(position_m: [f64; 3], tilt_rad: f64, axis_rad: f64) -> Isometry3<f64> {
    let axis = Vector3::new(axis_rad.cos(), axis_rad.sin(), 0.0) * tilt_rad;
    // z points out of the print, towards the camera: half a turn about x.
    let facing = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let turn = Rotation3::new(axis) * facing;
    let rotation = UnitQuaternion::from_rotation_matrix(&turn);
    Isometry3::from_parts(Translation3::from(Vector3::from(position_m)), rotation)
}

/// One case: a camera and a moving roundel.
struct Case<'a> {
    camera: Pinhole,
    imaging: Imaging,
    /// Subpixels along a pixel's side; edges are smooth over one of them.
    fine: usize,
    motion: &'a (dyn Fn(f64) -> Isometry3<f64> + Sync),
}

impl Case<'_> {
    /// Distance, from the roundel's centre, of the point that appears at a place in the image.
    fn radius_m(&self, at: Vector2<f64>, offset_s: f64) -> f64 {
        let row_s = (at.y - (self.camera.height as f64 - 1.0) / 2.0) * self.imaging.line_time_s;
        let pose = (self.motion)(offset_s + row_s);
        let ray = self.camera.ray(&at).unwrap();
        let normal = pose.rotation * Vector3::z();
        let distance = normal.dot(&pose.translation.vector) / normal.dot(&ray);
        (ray * distance - pose.translation.vector).norm()
    }

    /// Grey level of the subpixel about `at`, from its share within each rim.
    fn sub_pixel(&self, at: Vector2<f64>, offset_s: f64) -> f64 {
        let half = 0.5 / self.fine as f64;
        let radius_m = self.radius_m(at, offset_s);
        let near_m = 8.0 * half * (self.motion)(0.0).translation.z / self.camera.focal_px[0];
        let reaches = |rim_m: f64| (radius_m - rim_m).abs() < near_m;
        let rims = [OUTER_M * (0.5 + MARGIN), OUTER_M / 2.0, INNER_M / 2.0];
        let greys = [FLOOR, self.imaging.white, self.imaging.black, self.imaging.white];
        let slope_m = if rims.into_iter().any(reaches) {
            let along =
                |d: Vector2<f64>| self.radius_m(at + d, offset_s) - self.radius_m(at - d, offset_s);
            along(Vector2::new(half, 0.0)).hypot(along(Vector2::new(0.0, half)))
        } else {
            1e-9
        };
        let mut grey = greys[0];
        for (i, rim_m) in rims.into_iter().enumerate() {
            let inside = (0.5 + (rim_m - radius_m) / slope_m).clamp(0.0, 1.0);
            grey += inside * (greys[i + 1] - greys[i]);
        }
        let Some(Shadow { area, loss }) = self.imaging.light.shadow else { return grey };
        let shaded = (0.5 + area.depth_px(&at) * self.fine as f64).clamp(0.0, 1.0);
        grey * (1.0 - loss * shaded)
    }

    fn offsets_s(&self) -> Vec<f64> {
        if self.imaging.exposure_s == 0.0 {
            return vec![0.0];
        }
        let place = |i: usize| (i as f64 + 0.5) / INSTANTS as f64 - 0.5;
        (0..INSTANTS).map(|i| self.imaging.exposure_s * place(i)).collect()
    }

    /// Grey values of the square of `half` pixels about `center`, row by row.
    fn brute_force(&self, center: [usize; 2], half: usize) -> Vec<f64> {
        let sigma = self.imaging.blur_px;
        let reach = (5.0 * sigma).ceil() as usize + 1;
        let side = (2 * (half + reach) + 1) * self.fine;
        let offsets_s = self.offsets_s();
        let place = |i: usize, middle: usize| {
            middle as f64 - (half + reach) as f64 - 0.5 + (i as f64 + 0.5) / self.fine as f64
        };
        let fine: Vec<f64> = (0..side * side)
            .into_par_iter()
            .map(|i| {
                let at = Vector2::new(place(i % side, center[0]), place(i / side, center[1]));
                let sum: f64 = offsets_s.iter().map(|offset| self.sub_pixel(at, *offset)).sum();
                sum / offsets_s.len() as f64
            })
            .collect();
        // Box and Gaussian as one row of weights over subpixels; that of pixel i starts at i · fine.
        let wing = (reach * self.fine) as i64;
        let gauss = |i: i64| (-0.5 * (i as f64 / self.fine as f64 / sigma).powi(2)).exp();
        let sum: f64 = (-wing..=wing).map(gauss).sum();
        let mut weights = vec![0.0; 2 * wing as usize + self.fine];
        for i in -wing..=wing {
            for weight in &mut weights[(i + wing) as usize..][..self.fine] {
                *weight += gauss(i) / sum / self.fine as f64;
            }
        }
        let blurred_row = |v: usize| {
            let mut row = vec![0.0; side];
            for (k, weight) in weights.iter().enumerate() {
                for (sum, value) in row.iter_mut().zip(&fine[(v * self.fine + k) * side..][..side])
                {
                    *sum += weight * value;
                }
            }
            row
        };
        (0..2 * half + 1)
            .into_par_iter()
            .flat_map_iter(|v| {
                let row = blurred_row(v);
                let pixel = |u: usize| -> f64 {
                    weights
                        .iter()
                        .zip(&row[u * self.fine..])
                        .map(|(weight, value)| weight * value)
                        .sum()
                };
                (0..2 * half + 1).map(pixel).collect::<Vec<_>>()
            })
            .collect()
    }

    /// Maximum and rms difference from the renderer, grey levels.
    fn difference(&self) -> (f64, f64) {
        let center = self.camera.project(&(self.motion)(0.0).translation.vector.into()).unwrap();
        let center = [center.x.round() as usize, center.y.round() as usize];
        let scale_px = self.camera.focal_px[0] / (self.motion)(0.0).translation.z;
        let half = (OUTER_M * (0.5 + MARGIN) * scale_px * 1.35).ceil() as usize + 6;
        let renderer = Renderer::new(self.camera, self.imaging);
        let print = Print::plain(OUTER_M, INNER_M, MARGIN);
        let moving = [MovingPrint { print: &print, motion: self.motion }];
        let background = Canvas::flat(self.camera.width, self.camera.height, FLOOR);
        let rendered = renderer.ideal(&background, &moving);
        let expected = self.brute_force(center, half);
        let (mut max, mut squares) = (0.0f64, 0.0);
        for (i, grey) in expected.iter().enumerate() {
            let (u, v) =
                (center[0] + i % (2 * half + 1) - half, center[1] + i / (2 * half + 1) - half);
            let apart = (f64::from(rendered.grey[v * rendered.width + u]) - grey).abs();
            max = max.max(apart);
            squares += apart * apart;
        }
        (max, (squares / expected.len() as f64).sqrt())
    }
}

const PLUMB_BOB: Distortion = Distortion::PlumbBob([-0.12, 0.03, 8e-4, -6e-4, 0.0]);
const FISHEYE: Distortion = Distortion::Equidistant([-0.02, 0.004, -0.001, 0.0002]);

/// Depth at which the outer rim is `diameter_px` across.
fn depth_m(diameter_px: f64) -> f64 {
    700.0 * OUTER_M / diameter_px
}

#[test]
fn still_roundels_equal_brute_force() {
    for (name, distortion, diameter_px, tilt_deg, blur_px, place) in [
        ("face on", Distortion::NONE, 30.5, 0.0, 0.7, [0.0, 0.0]),
        ("tilted", PLUMB_BOB, 41.0, 60.0, 0.7, [0.12, -0.08]),
        ("corner", PLUMB_BOB, 30.0, 35.0, 0.5, [-0.33, 0.18]),
        ("fisheye", FISHEYE, 36.0, 45.0, 1.1, [0.3, 0.15]),
        ("inner disc of 4 px", PLUMB_BOB, 10.0, 30.0, 0.7, [0.1, 0.1]),
        ("inner disc of 1.5 px", Distortion::NONE, 3.75, 0.0, 1.1, [-0.2, 0.05]),
        ("sharp", Distortion::NONE, 20.0, 20.0, 0.3, [0.05, 0.02]),
    ] {
        let z = depth_m(diameter_px);
        let pose = pose([place[0] * z, place[1] * z, z], f64::to_radians(tilt_deg), 0.7);
        let case = Case {
            camera: Pinhole::centered(640, 480, 700.0, distortion),
            imaging: Imaging { blur_px, ..Imaging::default() },
            fine: 32,
            motion: &|_| pose,
        };
        let (max, rms) = case.difference();
        println!("{name}: max {max:.4}, rms {rms:.4} grey levels");
        assert!(max < 0.1 && rms < 0.01, "{name}: {max}");
    }
}

/// Lines that cross rims, touch one, and miss the roundel's white disc.
#[test]
fn shadows_equal_brute_force() {
    for (name, heading_rad, aside_px) in [
        ("through the centre", 0.3, 0.0),
        ("along the inner rim", 2.0, 8.0),
        ("along the outer rim", 4.0, 20.5),
        ("vertical", std::f64::consts::FRAC_PI_2, -14.0),
    ] {
        let z = depth_m(41.0);
        let pose = pose([0.12 * z, -0.08 * z, z], 0.3, 0.7);
        let camera = Pinhole::centered(640, 480, 700.0, PLUMB_BOB);
        let center = camera.project(&pose.translation.vector.into()).unwrap();
        let aside = Vector2::new(-heading_rad.sin(), heading_rad.cos()) * aside_px;
        let area = HalfPlane { through_px: (center + aside).into(), heading_rad };
        let light = Light { shadow: Some(Shadow { area, loss: 0.6 }), ..Light::default() };
        let imaging = Imaging { light, ..Imaging::default() };
        let case = Case { camera, imaging, fine: 32, motion: &|_| pose };
        let (max, rms) = case.difference();
        println!("{name}: max {max:.4}, rms {rms:.4} grey levels");
        assert!(max < 0.1 && rms < 0.01, "{name}: {max} {rms}");
    }
}

#[test]
fn moving_roundels_equal_brute_force() {
    for (name, speed_m_s, exposure_s, line_time_s) in [
        ("exposure", 1.5, 4e-3, 0.0),
        ("long exposure", 3.0, 12e-3, 0.0),
        ("rolling shutter", 3.0, 0.0, 30e-6),
        ("both", 1.5, 4e-3, 12e-6),
    ] {
        let z = depth_m(20.0);
        let motion = move |t: f64| {
            let shift = [0.3 + speed_m_s * t, -0.8 + 0.7 * speed_m_s * t, z];
            pose(shift, 0.5 + 2.0 * t, 0.4)
        };
        let case = Case {
            camera: Pinhole::centered(640, 480, 700.0, PLUMB_BOB),
            imaging: Imaging { exposure_s, line_time_s, ..Imaging::default() },
            fine: 16,
            motion: &motion,
        };
        let (max, rms) = case.difference();
        println!("{name}: max {max:.4}, rms {rms:.4} grey levels");
        assert!(max < 0.1 && rms < 0.01, "{name}: {max}");
    }
}

#[test]
fn noise_and_light_have_the_requested_strength() {
    let camera = Pinhole::centered(320, 240, 300.0, Distortion::NONE);
    let imaging = Imaging { noise: 3.0, gradient: [0.2, -0.1], ..Imaging::default() };
    let renderer = Renderer::new(camera, imaging);
    let background = Canvas::flat(320, 240, 120.0);
    let ideal = renderer.ideal(&background, &[]);
    assert!((ideal.grey[0] - 120.0 * (1.0 - 0.1 + 0.05)).abs() < 0.1);
    assert!((ideal.grey[320 * 240 - 1] - 120.0 * (1.0 + 0.1 - 0.05)).abs() < 0.1);
    let frame = |stream| renderer.frame(&background, &[], &mut Random::new(1, stream));
    let (one, other) = (frame(1), frame(2));
    assert_eq!(one, frame(1));
    assert_ne!(one, other);
    let errors =
        std::iter::zip(&one.pixels, &ideal.grey).map(|(p, g)| f64::from(*p) - f64::from(*g));
    let variance = errors.map(|e| e * e).sum::<f64>() / ideal.grey.len() as f64;
    // Rounding adds 1/12.
    assert!((variance - 9.0 - 1.0 / 12.0).abs() < 0.15, "{variance}");
}

#[test]
fn roundels_that_face_away_or_lie_behind_are_not_drawn() {
    let camera = Pinhole::centered(320, 240, 300.0, Distortion::NONE);
    let renderer = Renderer::new(camera, Imaging::default());
    let background = Canvas::flat(320, 240, 120.0);
    let print = Print::plain(OUTER_M, INNER_M, MARGIN);
    let from_behind = |_: f64| Isometry3::translation(0.0, 0.0, 1.0);
    let behind = |_: f64| pose([0.0, 0.0, -1.0], 0.0, 0.0);
    let cut = |_: f64| pose([0.53, 0.0, 1.0], 0.0, 0.0);
    let draw = |motion| renderer.ideal(&background, &[MovingPrint { print: &print, motion }]);
    assert_eq!(draw(&from_behind), background);
    assert_eq!(draw(&behind), background);
    assert_ne!(draw(&cut), background);
}
