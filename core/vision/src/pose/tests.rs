//! Round trips of `locate` on circles that this file projects and fits.

use nalgebra::{SMatrix, SVector, SymmetricEigen, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

use crate::{
    camera::{Intrinsics, Lens, PixelPoint},
    pose::{
        circle::refine::Estimates,
        rim::noise::{CLEAN_UNEVENNESS, RimErrors},
        *,
    },
    rigid::{UNKNOWN_ANGLE_VARIANCE_RAD2, mahalanobis_squared, orientation_of_normal},
};

pub fn camera(lens: Lens) -> Camera {
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
    Kind::plain("robot", 0.16, 0.064)
}

/// Least-squares conic through the points.
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
    rim_of(camera, position_m, &orientation_of_normal(normal), [0.5 * diameter_m; 2])
}

/// Image of an ellipse with these semiaxes along a roundel's x and y.
pub fn rim_of(
    camera: &Camera,
    position_m: &Vector3<f64>,
    turn: &UnitQuaternion<f64>,
    semiaxes_m: [f64; 2],
) -> Ellipse {
    let points: Vec<_> = (0..180)
        .map(|k| {
            let (sin, cos) = (k as f64 * std::f64::consts::TAU / 180.0).sin_cos();
            let place = Vector3::new(semiaxes_m[0] * cos, semiaxes_m[1] * sin, 0.0);
            let point = position_m + turn * place;
            let pixel = camera.project(&point).unwrap();
            Vector2::new(pixel.u, pixel.v)
        })
        .collect();
    fit_ellipse(&points)
}

fn ring(camera: &Camera, position_m: &Vector3<f64>, normal: &Vector3<f64>) -> Ring {
    let kind = kind();
    Ring {
        unevenness: CLEAN_UNEVENNESS,
        ..Ring::of_rims(
            rim(camera, position_m, normal, kind.outer_diameter_m),
            rim(camera, position_m, normal, kind.inner_diameter_m),
        )
    }
}

/// Pose for a pixel, a distance, a tilt and the tilt's direction.
pub fn pose(
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
        // At smaller tilts a small ring gets the mean of the tilt's posterior.
        tilt_rad in 0.35..1.2f64, turn_rad in -3.1..3.1f64,
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

/// A detected ellipse: white noise along the arc of its rim, of which an ellipse keeps the first
/// harmonics, and a floor on its harmonics.
fn stray(ellipse: &Ellipse, noise: &RimErrors<f64>, draw: &mut impl FnMut() -> f64) -> Ellipse {
    const SAMPLES: usize = 48;
    let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
    let step = std::f64::consts::TAU / SAMPLES as f64;
    let basis = |k: usize| {
        let (sin, cos) = (k as f64 * step).sin_cos();
        let harmonics = [1.0, cos, sin, 2.0 * cos * cos - 1.0, 2.0 * sin * cos];
        (sin, cos, SVector::<f64, 5>::from(harmonics))
    };
    let twice = SVector::<f64, 5>::new(1.0, 2.0, 2.0, 2.0, 2.0);
    let mut numbers = SVector::<f64, 5>::zeros();
    for k in 0..SAMPLES {
        let (sin, cos, harmonics) = basis(k);
        let g = (a * sin).hypot(b * cos);
        let q = g * noise.edge_px / (g * step).sqrt() * draw() / (a * b);
        numbers += harmonics.component_mul(&twice) * (q / SAMPLES as f64);
    }
    // The floor: a shift of the rim across itself, and a quarter of it for the other harmonics.
    let shift = noise.floor_px * draw() / (a * b);
    for k in 0..SAMPLES {
        let (sin, cos, harmonics) = basis(k);
        let q = (a * sin).hypot(b * cos) * shift;
        numbers += harmonics.component_mul(&twice) * (q / SAMPLES as f64);
    }
    let [along, across, longer, turn] = [0.0; 4].map(|_: f64| 0.25 * noise.floor_px * draw());
    let even = (0.5 / (a * b)).sqrt();
    numbers += SVector::<f64, 5>::new(0.0, along / a, across / b, even * longer, even * turn);
    let (axis_sin, axis_cos) = ellipse.angle_rad.sin_cos();
    let points: Vec<_> = (0..SAMPLES)
        .map(|k| {
            let (sin, cos, harmonics) = basis(k);
            let q = harmonics.dot(&numbers);
            let (x, y) = ((1.0 + q) * a * cos, (1.0 + q) * b * sin);
            Vector2::new(
                ellipse.center.u + axis_cos * x - axis_sin * y,
                ellipse.center.v + axis_sin * x + axis_cos * y,
            )
        })
        .collect();
    fit_ellipse(&points)
}

/// Results over many roundels of one size and a range of tilts.
#[derive(Debug, Default)]
struct Statistics {
    runs: usize,
    /// Pose errors, with the nearer normal, inside the 95 % ellipsoid of five dimensions.
    whole_inside: usize,
    /// Reported positions inside the 95 % ellipsoid, with either normal.
    position_inside: usize,
    /// Reported normals that are not the nearer one.
    wrong: usize,
    /// Sum of the likelihoods of that.
    expected_wrong: f64,
    /// Sums of the relative depth error, of its square, and of that over the stated variance.
    depth: f64,
    depth_squared: f64,
    depth_normalized: f64,
}

fn statistics(
    radius_px: f64,
    tilts_rad: std::ops::Range<f64>,
    runs: usize,
    noise: &RimNoise,
) -> Statistics {
    let camera = camera(Lens::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]));
    let kind = kind();
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let mut statistics = Statistics { runs, ..Statistics::default() };
    for _ in 0..runs {
        // Normals uniform over their part of the sphere.
        let cos = random.random_range(tilts_rad.end.cos()..tilts_rad.start.cos());
        let pixel = PixelPoint {
            u: random.random_range(200.0..1700.0),
            v: random.random_range(150.0..900.0),
        };
        let distance_m = 0.5 * kind.outer_diameter_m * 1100.0 / radius_px;
        let (position_m, normal) =
            pose(&camera, pixel, distance_m, cos.acos(), random.random_range(-3.1..3.1));
        let exact = ring(&camera, &position_m, &normal);
        let mut draw = || -> f64 { StandardNormal.sample(&mut random) };
        let disc_px = exact.inner.semi_minor_px;
        let for_ring = noise.for_ring(&exact, disc_px, exact.outer.semi_minor_px - disc_px);
        let outer = stray(&exact.outer, &for_ring.rims[0], &mut draw);
        let inner = stray(&exact.inner, &for_ring.rims[1], &mut draw);
        let found = Ring { outer, inner, ..exact };
        let reported = locate(&camera, &kind, &found, noise).unwrap();
        let off_m = position_m - reported.position_m;
        let spread = reported.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        statistics.position_inside +=
            usize::from(mahalanobis_squared(&off_m, &spread).unwrap() < 7.815);
        let radii_m = [0.5 * kind.outer_diameter_m, 0.5 * kind.inner_diameter_m];
        let nearer = if reported.normal == reported.other_normal {
            reported
        } else {
            let off = |n: &Vector3<f64>| (n - normal).norm();
            let right = off(&reported.normal) <= off(&reported.other_normal);
            statistics.wrong += usize::from(!right);
            statistics.expected_wrong += 1.0 - reported.normal_likelihood;
            let projected = rim::projection::project(
                &camera,
                &RingMeasurement::new(&found, radii_m, for_ring).rim_pair(),
            )
            .unwrap();
            let Estimates { first, other, .. } = closed_form::estimate(&projected.rims).unwrap();
            let alone = Estimates::alone(if right { first } else { other });
            closed_form::finish(&projected.local_from_camera, &alone).pose(0)
        };
        let off_m = position_m - nearer.position_m;
        let turn = nearer.normal.cross(&normal);
        let error = SVector::<f64, 6>::new(off_m.x, off_m.y, off_m.z, turn.x, turn.y, turn.z);
        // The rotation has no component about the normal, whose variance does not matter here.
        let square = mahalanobis_squared(&error, &nearer.covariance).unwrap();
        statistics.whole_inside += usize::from(square < 11.07);
        let axis = position_m.normalize();
        let depth = -off_m.dot(&axis) / distance_m;
        statistics.depth += depth;
        statistics.depth_squared += depth * depth;
        let stated = axis.dot(&(nearer.covariance.fixed_view::<3, 3>(0, 0) * axis));
        statistics.depth_normalized += (depth * distance_m).powi(2) / stated;
    }
    statistics
}

/// Realistic covariances from small to large and from face-on to steep, at the detector's noise and
/// several times that, where errors are not linear.
#[test]
fn covariance_matches_the_errors() {
    let degrees = |range: std::ops::Range<f64>| range.start.to_radians()..range.end.to_radians();
    let loud = RimNoise { edge_px: 0.15, floor_px: 0.02, ..RimNoise::default() };
    let cases = [
        (RimNoise::default(), [6.0, 8.0, 11.0, 15.0, 30.0, 60.0].as_slice()),
        (loud, [11.0, 15.0, 30.0, 60.0].as_slice()),
    ];
    println!("edge, radius, tilt: whole pose and position inside 95 %, wrong normals, depth");
    for (noise, radii_px) in cases {
        for &radius_px in radii_px {
            for tilts in [0.0..0.01, 0.0..5.0, 5.0..15.0, 15.0..30.0, 30.0..50.0, 50.0..60.0] {
                let statistics = statistics(radius_px, degrees(tilts.clone()), 800, &noise);
                let share = |count: f64| count / statistics.runs as f64;
                let (bias, rms) = (share(statistics.depth), share(statistics.depth_squared).sqrt());
                let whole = share(statistics.whole_inside as f64);
                let position = share(statistics.position_inside as f64);
                let (wrong, expected) =
                    (share(statistics.wrong as f64), share(statistics.expected_wrong));
                let name = format!(
                    "{:.2} px, {radius_px:2} px, {:4.1}-{:4.1}°: {whole:.3} {position:.3}, \
                     {wrong:.3} ({expected:.3}), bias {:+.2} of rms {:.4} %, {:.2} of stated",
                    noise.edge_px,
                    tilts.start,
                    tilts.end,
                    bias / rms,
                    100.0 * rms,
                    share(statistics.depth_normalized).sqrt(),
                );
                println!("{name}");
                // The standard deviation over 800 runs is 0.8 %.
                assert!((0.92..0.985).contains(&position), "{name}");
                assert!(bias.abs() < rms / 3.0, "{name}");
                // Exactly face-on the two hypotheses fit worst.
                let minimum = if tilts.end > 1.0 { 0.92 } else { 0.89 };
                assert!((minimum..0.985).contains(&whole), "{name}");
                assert!(tilts.end < 1.0 || (wrong - expected).abs() < 0.05, "{name}");
            }
        }
    }
}

#[test]
fn small_plain_rings_have_ambiguous_normals() {
    let camera = camera(Lens::PlumbBob([0.0; 5]));
    let likelihood = |radius_px: f64| {
        let pixel = PixelPoint { u: 900.0, v: 500.0 };
        let (position_m, normal) = pose(&camera, pixel, 0.08 * 1100.0 / radius_px, 0.6, 0.4);
        let ring = ring(&camera, &position_m, &normal);
        locate(&camera, &kind(), &ring, &RimNoise::default()).unwrap().normal_likelihood
    };
    assert!((0.5..0.65).contains(&likelihood(6.0)), "{}", likelihood(6.0));
    assert!(likelihood(60.0) > 0.999, "{}", likelihood(60.0));
}

#[test]
fn a_face_on_roundel_has_one_broad_normal() {
    let camera = camera(Lens::PlumbBob([0.0; 5]));
    let axis = PixelPoint { u: 957.0, v: 541.0 };
    let (position_m, normal) = pose(&camera, axis, 6.0, 0.0, 0.0);
    let found =
        locate(&camera, &kind(), &ring(&camera, &position_m, &normal), &RimNoise::default())
            .unwrap();
    assert_eq!((found.normal, found.normal_likelihood), (found.other_normal, 1.0));
    assert!(found.normal.angle(&normal) < 1e-3, "{}", found.normal);
    let sigma_m = found.covariance[(2, 2)].sqrt();
    assert!((found.position_m - position_m).norm() < sigma_m && sigma_m < 0.006);
    let sigma_rad = found.covariance[(3, 3)].sqrt();
    assert!((0.01..0.1).contains(&sigma_rad), "{sigma_rad}");
    // The rotation about the normal, here -z, is unknown.
    assert!((found.covariance[(5, 5)] - UNKNOWN_ANGLE_VARIANCE_RAD2).abs() < 1e-2);
    assert!(found.covariance.cholesky().is_some());
}

#[test]
fn fisheyes_locate_beyond_ninety_degrees() {
    let camera = Camera::new(Intrinsics {
        width: 1280,
        height: 1280,
        fx_px: 300.0,
        fy_px: 300.0,
        cx_px: 640.0,
        cy_px: 640.0,
        lens: Lens::Equidistant([0.01, 0.0, 0.0, 0.0]),
    })
    .unwrap();
    let bearing = Vector3::new((1.75f64).sin(), 0.0, (1.75f64).cos());
    let position_m = bearing * 0.9;
    let normal = -(UnitQuaternion::from_euler_angles(0.3, 0.4, 0.0) * bearing);
    let ring = ring(&camera, &position_m, &normal);
    let found = locate(&camera, &kind(), &ring, &RimNoise::default()).unwrap();
    assert!(found.position_m.z < 0.0);
    assert!((found.position_m - position_m).norm() < 1e-3, "{found:?}");
    let off = found.normal.angle(&normal).min(found.other_normal.angle(&normal));
    assert!(off < 5e-3, "{off}");
}

#[test]
fn rims_that_contradict_each_other_widen_the_covariance() {
    let camera = camera(Lens::PlumbBob([0.0; 5]));
    let position_m = Vector3::new(0.5, -0.3, 5.0);
    let normal = Vector3::new(0.3, 0.2, -1.0).normalize();
    let exact = ring(&camera, &position_m, &normal);
    let noise = RimNoise::default();
    let clean = locate(&camera, &kind(), &exact, &noise).unwrap();
    // A shadow over one side of the ring shrinks its outer rim.
    for cut_px in [0.5, 1.0, 2.0] {
        let mut cut = exact;
        cut.outer.center.u += cut_px / 2.0;
        cut.outer.semi_minor_px -= cut_px / 2.0;
        let wrong = locate(&camera, &kind(), &cut, &noise).unwrap();
        let block = |pose: &RoundelPose| pose.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        assert!(block(&wrong).trace() > 4.0 * block(&clean).trace(), "cut by {cut_px} px");
        let error = wrong.position_m - position_m;
        let distance = mahalanobis_squared(&error, &block(&wrong)).unwrap();
        assert!(distance < 21.1, "cut by {cut_px} px: {distance}");
    }
}

#[test]
fn broken_input_is_a_typed_error() {
    let camera = camera(Lens::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]));
    let (position_m, normal) = pose(&camera, PixelPoint { u: 900.0, v: 500.0 }, 3.0, 0.5, 0.4);
    let good = ring(&camera, &position_m, &normal);
    let noise = RimNoise::default();
    let refused = |ring: Ring, kind: Kind, noise: RimNoise| {
        locate(&camera, &kind, &ring, &noise).unwrap_err()
    };
    let mut flat = good;
    flat.inner.semi_minor_px = 1e-9;
    assert!(matches!(refused(flat, kind(), noise), PoseError::Ellipse { rim: "inner", .. }));
    let mut nowhere = good;
    nowhere.outer.center.u = f64::NAN;
    assert!(matches!(refused(nowhere, kind(), noise), PoseError::Ellipse { rim: "outer", .. }));
    let mut swapped = kind();
    std::mem::swap(&mut swapped.inner_diameter_m, &mut swapped.outer_diameter_m);
    assert!(matches!(refused(good, swapped, noise), PoseError::Diameter { .. }));
    let noiseless = RimNoise { edge_px: 0.0, floor_px: 0.0, ..RimNoise::default() };
    assert!(matches!(refused(good, kind(), noiseless), PoseError::Noise { .. }));
    // This lens ends 773 px from its middle, so half of a rim there lies outside.
    let mut beyond = good;
    beyond.outer.center = PixelPoint { u: 957.0 + 760.0, v: 541.0 };
    beyond.inner.center = beyond.outer.center;
    let error = refused(beyond, kind(), noise);
    assert_eq!(error, PoseError::Lens { rim: "outer", source: LensError::Outside });
    assert_eq!(
        error.to_string(),
        "outer rim: expected a point within the lens model's reach, found one outside"
    );
}
