use fearless_simd::Level;

use super::{
    solver::{gauss_newton, mirror::evaluate_mirrored, solution::Solution},
    *,
};
use crate::{
    camera::{Intrinsics, Lens},
    ellipse::Ellipse,
    marker::{Code, CodeLayout, CodeReading},
    pose::{PrintDeviation, RimNoise, locate},
};

const SIDE: usize = 64;

fn camera() -> Camera {
    camera_of(600.0)
}

fn camera_of(focal_px: f64) -> Camera {
    Camera::new(Intrinsics {
        width: SIDE,
        height: SIDE,
        fx_px: focal_px,
        fy_px: 1.01 * focal_px,
        cx_px: 31.0,
        cy_px: 32.5,
        lens: Lens::PlumbBob([-0.1, 0.02, 0.0, 0.0, 0.0]),
    })
    .unwrap()
}

/// An image of the pose by 12 × 12 samples over two pixels a side, projected into the print's
/// plane.
fn picture(
    camera: &Camera,
    kind: &Kind,
    position_m: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> Vec<u8> {
    let (outer, inner) = (0.5 * kind.outer_diameter_m, 0.5 * kind.inner_diameter_m);
    picture_of(camera, position_m, normal, |at| !(inner..outer).contains(&at.norm()))
}

/// The same for any pattern, given the position in the plane relative to the middle.
fn picture_of(
    camera: &Camera,
    position_m: &Vector3<f64>,
    normal: &Vector3<f64>,
    is_white: impl Fn(Vector3<f64>) -> bool,
) -> Vec<u8> {
    let white = |u: f64, v: f64| {
        let ray = camera.bearing(crate::camera::PixelPoint { u, v }).unwrap();
        is_white(ray * (normal.dot(position_m) / normal.dot(&ray)) - position_m)
    };
    let pixel = |index: usize| {
        let (column, row) = ((index % SIDE) as f64, (index / SIDE) as f64);
        let at = |i: usize| (i as f64 + 0.5) / 6.0 - 1.0;
        let samples = (0..144).filter(|i| white(column + at(i % 12), row + at(i / 12)));
        (40.0 + 160.0 * samples.count() as f64 / 144.0).round() as u8
    };
    (0..SIDE * SIDE).map(pixel).collect()
}

fn start(camera: &Camera, kind: &Kind, ring: &Ring) -> Start {
    let pose = locate(camera, kind, ring, &RimNoise::default()).unwrap();
    Start {
        pose,
        blur_px: DEFAULT_BLUR_PX,
        motion_px: Vector2::zeros(),
        moved_px: 0.0,
        is_still: false,
        teeth: None,
    }
}

fn input<'a>(frame: &'a Frame, camera: &'a Camera, kind: &'a Kind, ring: &'a Ring) -> FitInput<'a> {
    FitInput { frame, camera, kind, ring, print: PrintDeviation::NONE, skew: None }
}

fn ring() -> Ring {
    ring_of(12.3)
}

fn ring_of(semi_minor_px: f64) -> Ring {
    let rim = |scale: f64| Ellipse {
        center: crate::camera::PixelPoint { u: 33.1, v: 30.2 },
        semi_major_px: 15.1 * scale,
        semi_minor_px: semi_minor_px * scale,
        angle_rad: 0.3,
    };
    Ring { black: 45.0, white: 195.0, ..Ring::of_rims(rim(1.0), rim(0.4)) }
}

/// The image has a box blur, not a Gaussian one, which limits the accuracy.
#[test]
fn the_fit_finds_the_pose_from_a_rough_start_at_every_simd_level() {
    let (camera, kind, ring) = (camera(), Kind::plain("", 0.16, 0.064), ring());
    let start = start(&camera, &kind, &ring);
    let position_m = start.pose.position_m * 1.004;
    let normal = (start.pose.normal + Vector3::new(0.03, -0.04, 0.0)).normalize();
    let pixels = picture(&camera, &kind, &position_m, &normal);
    let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
    let mut poses = Vec::new();
    for level in [Level::new(), Level::baseline()] {
        let mut scratch = FitScratch::with_level(level);
        let found = fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch).unwrap();
        let error_m = (found.pose.position_m - position_m).norm();
        let nearer = [found.pose.normal, found.pose.other_normal].map(|n| n.angle(&normal));
        assert!(error_m < 2e-3 * position_m.norm(), "{error_m}");
        assert!(nearer[0].min(nearer[1]) < 0.02, "{nearer:?}");
        assert!((found.ring.black - 40.0).abs() < 2.0 && (found.ring.white - 200.0).abs() < 2.0);
        poses.push(found.pose);
    }
    assert!((poses[0].position_m - poses[1].position_m).norm() < 1e-6);
    assert!((poses[0].normal - poses[1].normal).norm() < 1e-4);
}

/// The image is the mean of those during the exposure.
#[test]
fn the_fit_finds_the_motion_and_the_pose_of_the_exposures_middle() {
    let (camera, kind, ring) = (camera(), Kind::plain("", 0.16, 0.064), ring());
    let start = start(&camera, &kind, &ring);
    let (position_m, normal) = (start.pose.position_m, start.pose.normal);
    let moved_px = Vector2::new(1.8, -1.1);
    let moved_m = moved_px.push(0.0) * (position_m.z / 600.0);
    let instants = (0..9).map(|i| (f64::from(i) + 0.5) / 9.0 - 0.5);
    let pictures: Vec<Vec<u8>> =
        instants.map(|s| picture(&camera, &kind, &(position_m + moved_m * s), &normal)).collect();
    let mean = |i: usize| pictures.iter().map(|picture| u32::from(picture[i])).sum::<u32>() / 9;
    let pixels: Vec<u8> = (0..SIDE * SIDE).map(|i| mean(i) as u8).collect();
    let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
    for level in [Level::new(), Level::baseline()] {
        let mut scratch = FitScratch::with_level(level);
        let start = Start { moved_px: f64::INFINITY, ..start.clone() };
        let found = fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch).unwrap();
        let off_px = [moved_px, -moved_px].map(|moved_px| (found.motion_px - moved_px).norm());
        assert!(off_px[0].min(off_px[1]) < 0.2, "{}", found.motion_px);
        let error_m = (found.pose.position_m - position_m).norm();
        assert!(error_m < 2e-3 * position_m.norm(), "{error_m}");
    }
}

#[test]
fn fits_leave_the_scratch_reusable() {
    let (camera, kind, ring) = (camera(), Kind::plain("", 0.16, 0.064), ring());
    let start = start(&camera, &kind, &ring);
    let pixels = picture(&camera, &kind, &start.pose.position_m, &start.pose.normal);
    let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
    let mut scratch = FitScratch::default();
    let first = fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch).unwrap();
    assert_eq!(fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch), Ok(first));
}

#[test]
fn a_uniform_image_is_an_error() {
    let (camera, kind, ring) = (camera(), Kind::plain("", 0.16, 0.064), ring());
    let mut start = start(&camera, &kind, &ring);
    let pixels = vec![120; SIDE * SIDE];
    let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
    let mut scratch = FitScratch::default();
    assert!(fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch).is_err());
    start.pose.normal = -start.pose.normal;
    let turned = fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch);
    assert_eq!(turned, Err(FitError::Start));
}

/// Prediction of a fit at the mirrored pose from the products of the first one.
#[test]
fn the_mirrored_pose_is_predicted() {
    // A wide lens, for which the columns of the two poses differ.
    let (camera, kind, ring) = (camera_of(200.0), Kind::plain("", 0.16, 0.064), ring_of(14.7));
    let start = start(&camera, &kind, &ring);
    let pixels = picture(&camera, &kind, &start.pose.position_m, &start.pose.normal);
    let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
    let mut scratch = FitScratch::default();
    let first = fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch).unwrap();
    let position_m = first.pose.position_m;
    let (range_m, radius_m) = (position_m.norm(), 0.5 * kind.outer_diameter_m);
    let local_from_camera = frame_along(&(position_m / range_m));
    let model = &mut scratch.model;
    let lens = LocalLens::new(
        &camera,
        local_from_camera,
        1.05 * radius_m / range_m,
        None,
        model.level,
        &model.plan,
    )
    .unwrap();
    model.window.set_region(&frame, &ring.outer.grown(3.0));
    let problem = Problem {
        print: PrintDeviation::NONE,
        kind: &kind,
        teeth: None,
        radius_m,
        lens: &lens,
        motion_prior: 1.0,
        is_still: false,
        teeth_are_predicted: false,
    };
    let axes = axes_of(&(local_from_camera * first.pose.normal));
    let at = PrintPose { position_m: Vector3::z() * range_m, axes };
    let state = State::new(at, &first.ring, first.blur_px, &first.motion_px);
    let solution = gauss_newton::solve(&problem, state, model).unwrap();
    let Solution { state, equations, noise2, .. } = &solution;
    let promised = evaluate_mirrored(&problem, state, equations, *noise2, model).unwrap();
    let found = gauss_newton::solve(&problem, solution.state.mirrored(), model).unwrap();
    let (promised_m, found_m) = (promised.state.pose.position_m, found.state.pose.position_m);
    let [promised, found] = [promised.misfit, found.misfit].map(|misfit| misfit - solution.misfit);
    assert!((promised / found - 1.0).abs() < 0.2, "{promised} {found}");
    let other_offset_m = found_m - solution.state.pose.position_m;
    assert!((promised_m - found_m).norm() < 0.2 * other_offset_m.norm(), "{promised_m} {found_m}");
}

/// Teeth and yaw, from a reading that is off by a third of a pixel.
#[test]
fn a_coded_roundel_is_fitted_with_its_yaw() {
    const YAW_RAD: f64 = 1.9;
    let layout = CodeLayout { bits: 8, min_distance: 1 };
    let kind = Kind { pattern: Pattern::Coded(layout), ..Kind::plain("", 0.16, 0.096) };
    let (camera, mut ring) = (camera(), ring());
    ring.inner.semi_major_px *= 1.5;
    ring.inner.semi_minor_px *= 1.5;
    let start = start(&camera, &kind, &ring);
    let (position_m, normal) = (start.pose.position_m * 1.003, start.pose.normal);
    let word = 0b0010_1101;
    let teeth = layout.teeth(word);
    let axes = yaw::axes(&normal, YAW_RAD);
    let pixels = picture_of(&camera, &position_m, &normal, |at| {
        let (x, y) = (axes.column(0).dot(&at), axes.column(1).dot(&at));
        let (radius, angle_rad) = (x.hypot(y) / 0.08, y.atan2(x).rem_euclid(std::f64::consts::TAU));
        let in_tooth = teeth.iter().any(|t| t.from_rad <= angle_rad && angle_rad < t.to_rad);
        radius > 1.0 || radius < if in_tooth { 0.6 * CodeLayout::CORE_SHARE } else { 0.6 }
    });
    let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
    let mut scratch = FitScratch::default();
    let unread = fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch);
    assert_eq!(unread, Err(FitError::Pattern));
    for off_rad in [-0.03, 0.03] {
        let axis = yaw::axes(&normal, YAW_RAD + off_rad).column(0) * 0.048;
        let end = |along: f64| camera.project(&(start.pose.position_m + axis * along)).unwrap();
        let reading = CodeReading::certain(Code { bits: 8, number: 1 }, end(1.0));
        ring.code = Some(CodeReading { word: Some(word), opposite: end(-1.0), ..reading });
        let pose = fit(&input(&frame, &camera, &kind, &ring), &start, &mut scratch).unwrap().pose;
        let error_m = (pose.position_m - position_m).norm();
        assert!(error_m < 1e-3 * position_m.norm(), "{error_m}");
        let error_rad = (pose.yaw_rad.unwrap() - YAW_RAD).abs();
        assert!(error_rad < 4e-3 && pose.normal.angle(&normal) < 0.02, "{error_rad}");
        let variance = yaw::deviation_rad(&pose).powi(2);
        assert!((1e-8..1e-5).contains(&variance), "{variance}");
    }
}
