//! Lens calibration from rendered views of the board, with consistent deviations. Blurred, cropped, empty and
//! duplicate views are covered in `lens_command`.

use roundel_core::{calib::board::Board, marker::CodeLayout};
use roundel_tests::{
    board::{board_of, board_print, camera, imaging, lens, lens_by, pictures, poses},
    random::Random,
    render::Imaging,
};

#[test]
fn a_lens_is_calibrated_from_thirty_views() {
    let truth = camera();
    let poses = poses(&truth, 30, &mut Random::new(7, 0));
    let print = board_print();
    let views = pictures(&truth, imaging(), &print, &poses, 7);
    let found = lens(&views).unwrap();
    // Some views resemble others by chance, and are skipped.
    assert!(found.views.iter().flatten().count() >= 25, "{:?}", found.views);
    let intrinsics = found.camera.intrinsics();
    let deviations = found.deviations();
    println!("{intrinsics:?} ± {deviations:?}, rms {} px, {:?}", found.rms_px, found.model);
    for (value, truth) in
        [(intrinsics.fx_px, truth.focal_px[0]), (intrinsics.fy_px, truth.focal_px[1])]
    {
        assert!((value / truth - 1.0).abs() < 5e-4, "{value} for {truth}");
    }
    let off_px =
        (intrinsics.cx_px - truth.center_px[0]).hypot(intrinsics.cy_px - truth.center_px[1]);
    assert!(off_px < 0.5, "{off_px} px");
    assert!(found.rms_px < 0.06, "{} px", found.rms_px);
    assert!(deviations[..2].iter().all(|deviation| *deviation < 0.2), "{deviations:?}");
    let width = found.diameter_check.unwrap();
    println!("roundels appear {} ± {} times as wide as stated", width.ratio, width.deviation);
    assert!((width.ratio - 1.0).abs() < 0.001 && !width.is_doubtful(), "{width:?}");
}

#[test]
fn a_pitch_that_is_two_percent_off_is_reported() {
    let truth = camera();
    for (seed, blur_px) in [(7, 0.5), (8, 0.8), (9, 1.2)] {
        let poses = poses(&truth, 12, &mut Random::new(seed, 0));
        let imaging = Imaging { blur_px, ..imaging() };
        let views = pictures(&truth, imaging, &board_print(), &poses, seed);
        let described = |pitch_m: f64| {
            let layout = CodeLayout { bits: 9, min_distance: 1 };
            let board = Board::new((7, 5), pitch_m, 0.03, layout).unwrap();
            lens_by(board, &views).unwrap().diameter_check.unwrap()
        };
        let (right, wrong) = (described(0.036), described(0.0367));
        println!("blur {blur_px} px: {right:?}, {wrong:?}");
        assert!(!right.is_doubtful(), "{right:?}");
        assert!(wrong.is_doubtful(), "{wrong:?}");
        assert!((wrong.found_pitch_mm() - 36.0).abs() < 0.1, "{wrong:?}");
    }
}

#[test]
fn views_from_one_side_end_with_the_missing_ones_named() {
    let truth = camera();
    let poses = poses(&truth, 40, &mut Random::new(3, 0));
    let facing = |pose: &nalgebra::Isometry3<f64>| {
        let normal = pose.rotation * nalgebra::Vector3::z();
        let ray = pose.translation.vector.normalize();
        normal.dot(&ray).abs() > 0.985
    };
    let flat: Vec<_> = poses.into_iter().filter(facing).take(6).collect();
    let views = pictures(&truth, imaging(), &board_print(), &flat, 3);
    let error = lens(&views).unwrap_err().to_string();
    assert!(error.contains("6 views are too similar to determine the focal length"), "{error}");
    for side in ["right", "left", "lower", "upper"] {
        let expected =
            format!("a view tilted by 20° to 45° with the {side} side nearer to the camera");
        assert!(error.contains(&expected), "no {expected} in {error}");
    }
    let few = pictures(&truth, imaging(), &board_print(), &flat[..3], 4);
    let error = lens(&few).unwrap_err().to_string();
    assert!(error.contains("at least 5 different views of the board, found 3"), "{error}");
    assert!(error.contains("still missing: a view tilted by 20° to 45°"), "{error}");
    // Repetitions of a view count once.
    let again = vec![few[0].clone(); 8];
    let error = lens(&again).unwrap_err().to_string();
    assert!(error.contains("found 1") && error.contains("corner of the picture"), "{error}");
}

#[test]
fn a_board_with_another_layout_is_reported() {
    let truth = camera();
    let poses = poses(&truth, 8, &mut Random::new(5, 0));
    let views = pictures(&truth, imaging(), &board_print(), &poses, 5);
    for described in [(6, 5), (8, 5), (7, 4), (7, 6), (5, 7)] {
        let error = lens_by(board_of(described), &views).unwrap_err().to_string();
        let expected = format!("looks like 7 x 5 roundels, not {} x {}", described.0, described.1);
        assert!(error.contains(&expected), "{described:?}: {error}");
    }
}
