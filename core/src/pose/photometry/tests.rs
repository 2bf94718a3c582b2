use super::*;
use crate::{
    camera::{Intrinsics, Lens},
    pose::{RimNoise, locate},
};

const SIDE: usize = 64;

fn camera() -> Camera {
    Camera::new(Intrinsics {
        width: SIDE,
        height: SIDE,
        fx_px: 600.0,
        fy_px: 605.0,
        cx_px: 31.0,
        cy_px: 32.5,
        lens: Lens::PlumbBob([-0.1, 0.02, 0.0, 0.0, 0.0]),
    })
    .unwrap()
}

/// Both rims of the pose, and a picture of it by 12 × 12 samples over two pixels
/// a side, cast into the print's plane.
fn picture(
    camera: &Camera,
    kind: &Kind,
    position_m: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> Vec<u8> {
    let (outer, inner) = (0.5 * kind.outer_diameter_m, 0.5 * kind.inner_diameter_m);
    let white = |u: f64, v: f64| {
        let ray = camera.bearing(crate::camera::PixelPoint { u, v }).unwrap();
        let place = ray * (normal.dot(position_m) / normal.dot(&ray)) - position_m;
        !(inner..outer).contains(&place.norm())
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
    Start { pose, blur_px: DEFAULT_BLUR_PX }
}

fn ring() -> Ring {
    let rim = |scale: f64| Ellipse {
        center: crate::camera::PixelPoint { u: 33.1, v: 30.2 },
        semi_major_px: 15.1 * scale,
        semi_minor_px: 12.3 * scale,
        angle_rad: 0.3,
    };
    Ring { black: 45.0, white: 195.0, ..Ring::of_rims(rim(1.0), rim(0.4)) }
}

/// The picture's blur is a box and not Gaussian: the fit is off by what that costs, and no more.
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
        let mut scratch = FitScratch { level, ..FitScratch::default() };
        let found = fit(&frame, &camera, &kind, &ring, &start, &mut scratch).unwrap();
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

#[test]
fn a_fit_leaves_its_scratch_as_it_was() {
    let (camera, kind, ring) = (camera(), Kind::plain("", 0.16, 0.064), ring());
    let start = start(&camera, &kind, &ring);
    let pixels = picture(&camera, &kind, &start.pose.position_m, &start.pose.normal);
    let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
    let mut scratch = FitScratch::default();
    let first = fit(&frame, &camera, &kind, &ring, &start, &mut scratch).unwrap();
    assert_eq!(fit(&frame, &camera, &kind, &ring, &start, &mut scratch), Ok(first));
}

#[test]
fn what_is_no_roundel_is_an_error() {
    let (camera, kind, ring) = (camera(), Kind::plain("", 0.16, 0.064), ring());
    let mut start = start(&camera, &kind, &ring);
    let pixels = vec![120; SIDE * SIDE];
    let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
    let mut scratch = FitScratch::default();
    assert!(fit(&frame, &camera, &kind, &ring, &start, &mut scratch).is_err());
    start.pose.normal = -start.pose.normal;
    let turned = fit(&frame, &camera, &kind, &ring, &start, &mut scratch);
    assert_eq!(turned, Err(FitError::Start));
}
