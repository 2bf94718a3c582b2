//! Lens calibration from rendered chessboards and ChArUco boards, with the same bars as from roundels.

use nalgebra::Point3;
use roundel_core::{
    calib::lens::{Target, ViewVerdict, calibrate},
    frame::Frame,
};
use roundel_server::lab::lens::{
    board_search::{BoardSearch, CalibrationTarget, SearchError},
    chessboard,
};
use roundel_tests::{
    board::{
        CHARUCO, CHESSBOARD, SQUARE_M, SQUARES, camera, charuco_print, chessboard_print, imaging,
        lens_of_chessboard, pictures, poses,
    },
    random::Random,
    render::{Image, Print},
};

fn sought(text: &str) -> CalibrationTarget {
    CalibrationTarget::Chessboard(chessboard::parse(text).unwrap().unwrap())
}

fn search(text: &str, pictures: &[Image]) -> Result<BoardSearch, SearchError> {
    let mut search = BoardSearch::new(&sought(text), false)?;
    for image in pictures {
        search.look(&frame(image)).unwrap();
    }
    Ok(search)
}

fn frame(image: &Image) -> Frame<'_> {
    Frame::new(&image.pixels, image.width, image.height, image.width).unwrap()
}

fn rendered(print: &Print, count: usize, seed: u64) -> Vec<Image> {
    let truth = camera();
    pictures(&truth, imaging(), print, &poses(&truth, count, &mut Random::new(seed, 0)), seed)
}

fn check(text: &str, print: &Print) {
    let truth = camera();
    let found = lens_of_chessboard(text, &rendered(print, 30, 7)).unwrap();
    let (is, deviations) = (found.camera.intrinsics(), found.deviations());
    println!("{text}: {is:?} ± {deviations:?}, rms {} px, {:?}", found.rms_px, found.model);
    assert!(found.views.iter().flatten().count() >= 24, "{:?}", found.views);
    let errors = [
        is.fx_px - truth.focal_px[0],
        is.fy_px - truth.focal_px[1],
        is.cx_px - truth.center_px[0],
        is.cy_px - truth.center_px[1],
    ];
    for (error, deviation) in errors.iter().zip(&deviations) {
        assert!(error.abs() < 4.0 * deviation && *deviation < 0.2, "{errors:?} {deviations:?}");
    }
    assert_eq!(found.model.ros_name(), "plumb_bob");
    assert!(found.rms_px < 0.04, "{} px", found.rms_px);
}

#[test]
fn a_lens_is_calibrated_from_a_chessboard() {
    check(CHESSBOARD, &chessboard_print());
}

#[test]
fn a_lens_is_calibrated_from_a_charuco_board() {
    check(CHARUCO, &charuco_print());
}

#[test]
fn a_partial_charuco_board_is_a_view_and_a_partial_chessboard_is_not() {
    // The board's left quarter is hidden.
    let truth = camera();
    let pose = poses(&truth, 1, &mut Random::new(3, 0))[0];
    let left_m = -0.25 * SQUARES.0 as f64 * SQUARE_M;
    let edge = truth.project(&(pose * Point3::new(left_m, 0.0, 0.0))).unwrap();
    let cut = |print: &Print| {
        let mut image = rendered(print, 1, 3).remove(0);
        image.pixels.chunks_mut(image.width).for_each(|row| row[..edge.x as usize].fill(120));
        image
    };
    let verdict = |text: &str, image: &Image| {
        BoardSearch::new(&sought(text), false).unwrap().look(&frame(image)).unwrap().0
    };
    let charuco = cut(&charuco_print());
    assert_eq!(verdict(CHARUCO, &charuco), ViewVerdict::Taken);
    let plain = cut(&chessboard_print());
    assert_eq!(verdict(CHESSBOARD, &plain), ViewVerdict::TooLittle);
}

#[test]
fn other_boards_than_described_are_reported() {
    let pictures = rendered(&chessboard_print(), 6, 5);
    // Squares instead of corners, and other counts.
    for described in ["chessboard:10x7:25", "chessboard:8x6:25", "chessboard:9x5:25"] {
        let search = search(described, &pictures).unwrap();
        let error = search.gathered().unwrap().other_print(true).unwrap().to_string();
        assert!(error.contains("shows 9 x 6 inner corners, not"), "{described}: {error}");
    }
    // The orientation does not matter.
    let turned = search("chessboard:6x9:25", &pictures).unwrap();
    let selector = &turned.gathered().unwrap().selector;
    assert_eq!((selector.taken().len(), selector.target().columns()), (6, 6));
    // Another dictionary, and no board at all.
    let charuco = rendered(&charuco_print(), 3, 5);
    let other = search("charuco:10x7:25:17.5:DICT_6X6_50", &charuco).unwrap();
    assert_eq!(other.gathered().unwrap().without_board, 3);
    let gathered = search(CHESSBOARD, &rendered(&Print::plain(0.1, 0.05, 0.1), 2, 5));
    let gathered = gathered.unwrap().into_gathered().unwrap();
    assert_eq!((gathered.without_board, gathered.other_print(true)), (2, None));
    let target: &Target = gathered.selector.target();
    let error = calibrate(target, gathered.size, gathered.selector.taken(), None).unwrap_err();
    assert!(error.to_string().contains("found 0"), "{error}");
    let error = |text: &str| BoardSearch::new(&sought(text), false).err().unwrap().to_string();
    let unknown = error("charuco:10x7:25:17.5:DICT_4X4_60");
    assert!(unknown.contains("`DICT_4X4_60`; expected one of DICT_4X4_100"), "{unknown}");
    let small = error("charuco:20x15:25:17.5:DICT_4X4_50");
    assert!(small.contains("needs 150 markers, dictionary has 50"), "{small}");
}
