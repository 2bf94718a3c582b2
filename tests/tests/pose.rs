//! Poses of single roundels in single frames against the independent renderer: how large are the
//! errors, and are they as large as the covariances say?

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;
use roundel_core::{
    marker::{Mode, Params},
    pose::RoundelPose,
};
use roundel_tests::{
    arena::Kind,
    normal::Random,
    optics::{Distortion, Pinhole},
    pipeline::Observer,
    render::{Canvas, Imaging, Print, Renderer, Seen},
    score::{CHI2_95_2, CHI2_95_3, Errors, normal_error, normalized3},
};

/// Errors of the poses of one range of sizes.
#[derive(Default)]
struct Bin {
    shown: usize,
    found: usize,
    /// Relative, with their normalized squares of one degree of freedom.
    depth: Errors,
    depth_bias: f64,
    /// Metres, two degrees of freedom.
    lateral: Errors,
    /// Three degrees of freedom.
    position: Errors,
    /// Of the nearer of the two normals, radians, two degrees of freedom.
    normal: Errors,
    /// Poses whose first normal was the wrong one.
    mistaken: usize,
}

impl Bin {
    fn take(&mut self, pose: &RoundelPose, truth: &Isometry3<f64>) {
        let error = pose.position_m - truth.translation.vector;
        let position: Matrix3<f64> = pose.covariance.fixed_view::<3, 3>(0, 0).into();
        let range_m = truth.translation.vector.norm();
        let ray = truth.translation.vector / range_m;
        let along = error.dot(&ray);
        let depth_variance = (ray.transpose() * position * ray)[0];
        self.depth.push(along / range_m, along * along / depth_variance);
        self.depth_bias += along / range_m;
        let x = ray.cross(&Vector3::y()).normalize();
        let y = ray.cross(&x);
        let block =
            nalgebra::Matrix2::from_fn(|i, j| ([x, y][i].transpose() * position * [x, y][j])[0]);
        let across = Vector2::new(error.dot(&x), error.dot(&y));
        let square = across.dot(&block.cholesky().unwrap().solve(&across));
        self.lateral.push(across.norm(), square);
        self.position.push(error.norm(), normalized3(&error, &position).unwrap());
        let true_normal = truth.rotation * Vector3::z();
        let angle = |normal: &Vector3<f64>| normal.angle(&true_normal);
        let mistaken = angle(&pose.other_normal) + 1e-6 < angle(&pose.normal);
        self.mistaken += usize::from(mistaken);
        if !mistaken {
            let rotation: Matrix3<f64> = pose.covariance.fixed_view::<3, 3>(3, 3).into();
            let (angle, square) = normal_error(&pose.normal, &true_normal, &rotation).unwrap();
            self.normal.push(angle, square);
        }
        self.found += 1;
    }
}

/// A roundel of this size at a random place, tilted up to `max_tilt_rad`.
fn random_pose(
    camera: &Pinhole,
    diameter_px: f64,
    max_tilt_rad: f64,
    random: &mut Random,
) -> Isometry3<f64> {
    let z = camera.focal_px[0] * Kind::robot().outer_diameter_m / diameter_px;
    let at = [random.uniform(-0.3, 0.3), random.uniform(-0.2, 0.2)];
    let position = Vector3::new(at[0] * z, at[1] * z, z);
    // Tilt is against the line of sight, cosines evenly spread as for normals in all directions.
    let tilt = random.uniform(max_tilt_rad.cos(), 1.0).acos();
    let axis = random.uniform(0.0, std::f64::consts::TAU);
    let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-position).unwrap();
    let lean = UnitQuaternion::from_scaled_axis(Vector3::new(axis.cos(), axis.sin(), 0.0) * tilt);
    Isometry3::from_parts(Translation3::from(position), facing * lean)
}

/// Random blur, noise, place and tilt to 60°, one roundel a frame.
fn bin(low_px: f64, high_px: f64, count: usize, mode: Mode) -> Bin {
    let distortion = Distortion::PlumbBob([-0.08, 0.02, 4e-4, -3e-4, 0.0]);
    let camera = Pinhole::centered(640, 480, 700.0, distortion);
    let kind = Kind::robot();
    let print = Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, 0.25);
    let results: Vec<_> = (0..count)
        .into_par_iter()
        .map(|i| {
            let mut random = Random::new(i as u64, low_px.to_bits());
            let imaging = Imaging {
                blur_px: random.uniform(0.5, 0.9),
                noise: random.uniform(1.0, 3.0),
                ..Imaging::default()
            };
            let diameter_px = random.uniform(low_px, high_px);
            let truth = random_pose(&camera, diameter_px, 60f64.to_radians(), &mut random);
            let renderer = Renderer::new(camera, imaging);
            let motion = |_: f64| truth;
            let seen = [Seen { print: &print, motion: &motion }];
            let image = renderer.frame(&Canvas::flat(640, 480, 120.0), &seen, &mut random);
            let params = Params { mode, ..Params::default() };
            let kinds = std::slice::from_ref(&kind);
            let mut observer = Observer::with_params(&camera, kinds, 0.0, params).unwrap();
            let found = observer.observe(&image, 0).unwrap();
            (truth, found.into_iter().find_map(|detection| detection.pose))
        })
        .collect();
    let mut bin = Bin { shown: count, ..Bin::default() };
    for (truth, pose) in results {
        if let Some(pose) = pose {
            bin.take(&pose, &truth);
        }
    }
    bin
}

/// Both modes at all sizes.
fn cases() -> Vec<(Mode, f64, f64)> {
    let sizes = [(10.0, 14.0), (14.0, 20.0), (20.0, 30.0), (30.0, 60.0), (60.0, 110.0)];
    let of = |mode| sizes.map(|(low, high)| (mode, low, high));
    [of(Mode::Fast), of(Mode::Precise)].concat()
}

#[test]
fn errors_stay_within_what_is_stated() {
    println!(
        "rms and actual over stated errors; the share of them inside the stated 95 % ellipsoid"
    );
    println!(
        "diameter | found |        depth          |     across     |            normal          | position"
    );
    for (mode, low, high) in cases() {
        let bin = bin(low, high, 150, mode);
        let found = bin.found as f64;
        let share = bin.position.share_within(CHI2_95_3);
        println!(
            "{mode:?} {low:3}-{high:3} px|{:5.1} %|{:6.3} % {:+6.3} % {:5.2}|{:6.3} mm {:5.2} |{:6.2}° {:5.2} {:5.1} % {:4.1} %|{:5.1} %",
            100.0 * found / bin.shown as f64,
            100.0 * bin.depth.rms(),
            100.0 * bin.depth_bias / found,
            bin.depth.mean_normalized().sqrt(),
            1e3 * bin.lateral.rms(),
            (bin.lateral.mean_normalized() / 2.0).sqrt(),
            bin.normal.rms().to_degrees(),
            (bin.normal.mean_normalized() / 2.0).sqrt(),
            100.0 * bin.normal.share_within(CHI2_95_2),
            100.0 * bin.mistaken as f64 / found,
            100.0 * share,
        );
        if low >= 20.0 {
            assert_eq!(bin.found, bin.shown, "{low} to {high} px");
            assert!(share >= 0.92, "{mode:?}, {low} to {high} px: {share}");
            assert!(bin.depth.rms() < 0.01, "{low} to {high} px: {}", bin.depth.rms());
        }
    }
}
