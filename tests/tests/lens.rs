//! A lens is found from rendered views of the board, with deviations that hold; views that are smeared, cut off or
//! there twice are left out.

use roundel_tests::{
    board::{board_of, board_print, camera, imaging, lens, lens_by, pictures, poses},
    normal::Random,
    render::Imaging,
};

#[test]
fn thirty_views_tell_the_lens() {
    let truth = camera();
    let poses = poses(&truth, 30, &mut Random::new(7, 0));
    let print = board_print();
    let mut views = pictures(&truth, imaging(), &print, &poses, 7);
    // The same view once more, one out of focus, and an empty picture.
    views.push(views[0].clone());
    let blurred = Imaging { blur_px: 6.0, ..imaging() };
    views.extend(pictures(&truth, blurred, &print, &poses[3..4], 8));
    views.extend(pictures(&truth, imaging(), &print, &[], 9));
    let found = lens(&views).unwrap();
    assert!(found.views.len() <= 30, "{} views taken", found.views.len());
    assert!(found.views.iter().flatten().count() >= 25);
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
}

#[test]
fn views_from_one_side_end_in_what_is_missing() {
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
    assert!(error.contains("still missing: a view tilted"), "{error}");
}

#[test]
fn a_board_that_is_not_as_described_is_told() {
    let truth = camera();
    let poses = poses(&truth, 8, &mut Random::new(5, 0));
    let views = pictures(&truth, imaging(), &board_print(), &poses, 5);
    for described in [(6, 5), (8, 5), (7, 4), (7, 6), (5, 7)] {
        let error = lens_by(board_of(described), &views).unwrap_err().to_string();
        let expected = format!("looks like 7 x 5 roundels, not {} x {}", described.0, described.1);
        assert!(error.contains(&expected), "{described:?}: {error}");
    }
}
