//! Calibration of arenas: camera poses from moving robots, and the errors reported where that is impossible.

use nalgebra::Vector3;
use roundel_core::{
    calib::arena::{
        ArenaCalibration, ArenaError, ArenaParams, Finding, LensDeviation, Recording, calibrate,
    },
    id::CameraId,
};
use roundel_tests::{
    arena::{Arena, Path, look_at},
    sensor::{Sensing, Stream},
    survey::{Survey, WrongLenses, world_error_m},
};

/// Noise of precise detections, approximately.
const SENSING: Sensing = Sensing { noise_px: 0.03, ..Sensing::DEFAULT };
const SECONDS: f64 = 20.0;
const MAX_HZ: f64 = 30.0;

fn run(survey: &Survey) -> Result<ArenaCalibration, ArenaError> {
    let recording = survey.record(SENSING, SECONDS, MAX_HZ);
    let params = ArenaParams::default();
    calibrate(&recording, &survey.cameras(), &survey.references, &params, |_| true)
}

fn r4(seed: u64) -> Survey {
    Survey::new(Arena::r4(seed).with_unsynchronized_clocks())
}

/// Largest position error of any camera.
fn worst_m(survey: &Survey, found: &ArenaCalibration) -> f64 {
    found.cameras.iter().map(|it| survey.error(it, SECONDS).position_m).fold(0.0, f64::max)
}

#[test]
fn errors_of_cameras_and_clocks_match_their_covariances() {
    let (mut square, mut count) = (0.0, 0.0);
    for seed in 1..=4 {
        let survey = r4(seed);
        let found = run(&survey).unwrap();
        assert_eq!(found.cameras.len(), 4);
        assert!(found.findings.is_empty(), "{:?}", found.findings);
        for camera in &found.cameras {
            let error = survey.error(camera, SECONDS);
            assert!(error.position_m < 1e-3 && error.rotation_rad.to_degrees() < 0.01, "{error:?}");
            assert!(error.clock_s.abs() < 1e-4, "{error:?}");
            assert!(camera.coverage > 0.3 && camera.neighbours.len() == 3);
            square += error.square / 6.0;
            count += 1.0;
        }
    }
    // Cameras of one arena share the references' errors, so these are few independent samples.
    let mean = square / count;
    assert!((0.3..2.5).contains(&mean), "{mean}");
}

#[test]
fn the_same_recording_gives_the_same_bits() {
    let survey = r4(5);
    let [one, other] = [0, 1].map(|_| run(&survey).unwrap());
    for (one, other) in one.cameras.iter().zip(&other.cameras) {
        assert_eq!(one.world_from_camera, other.world_from_camera);
        assert_eq!(one.covariance, other.covariance);
    }
}

#[test]
fn a_chain_of_cameras_is_calibrated_from_the_first() {
    let mut arena = Arena::r16(6).with_unsynchronized_clocks();
    // One row, in which each camera overlaps with its neighbours.
    arena.sites.truncate(4);
    let survey = Survey::new(arena);
    let found = run(&survey).unwrap();
    assert_eq!(found.cameras.len(), 4);
    assert!(worst_m(&survey, &found) < 6e-3, "{}", worst_m(&survey, &found));
    let deviation = |index: usize| found.cameras[index].covariance.fixed_view::<3, 3>(0, 0).trace();
    assert!(deviation(3) > deviation(1), "uncertainty grows along the chain");
}

#[test]
fn robots_without_codes_are_distinguished_by_their_motion() {
    for seed in 21..=23 {
        let survey = r4(seed);
        let recording = survey.record_plain(SENSING, 2.0 * SECONDS, MAX_HZ);
        let params = ArenaParams::default();
        let cameras = survey.cameras();
        let found = calibrate(&recording, &cameras, &survey.references, &params, |_| true).unwrap();
        assert_eq!(found.cameras.len(), 4, "{:?}", found.findings);
        assert!(worst_m(&survey, &found) < 1e-3, "{}", worst_m(&survey, &found));
        let square: f64 =
            found.cameras.iter().map(|it| survey.error(it, 2.0 * SECONDS).square / 6.0).sum();
        assert!(square / 4.0 < 3.0, "{square}");
    }
}

#[test]
fn a_wrong_lens_is_refined() {
    let survey = r4(7);
    let wrong = WrongLenses::by(&survey, 3e-3, 1.5);
    let seen = wrong.record(&survey, SENSING, SECONDS, MAX_HZ);
    let params = ArenaParams::default();
    let [as_believed, refined] = [None, Some(LensDeviation::default())].map(|deviation| {
        let cameras = wrong.cameras(&survey, deviation);
        let found = calibrate(&seen, &cameras, &survey.references, &params, |_| true).ok()?;
        world_error_m(&survey, &found, &cameras)
    });
    // If such lenses are assumed exact, references contradict one another, or points are far off.
    let refined = refined.unwrap();
    let as_believed = as_believed.unwrap_or(f64::INFINITY);
    assert!(refined < 1e-3 && refined < 0.5 * as_believed, "{as_believed} m, {refined} m");
}

#[test]
fn a_camera_that_overlaps_with_none_is_named() {
    let mut survey = r4(8);
    survey.arena.sites[2].world_from_camera =
        look_at(Vector3::new(40.0, 40.0, 5.0), Vector3::new(40.0, 40.0, 0.0));
    let found = run(&survey).unwrap();
    assert_eq!(found.cameras.len(), 3);
    let unseen = |finding: &Finding| matches!(finding, Finding::Unseen { camera: CameraId(2), .. });
    assert!(found.findings.iter().any(unseen), "{:?}", found.findings);
    assert!(worst_m(&survey, &found) < 1e-3);
}

#[test]
fn too_little_motion_is_reported() {
    let mut arena = Arena::r4(9);
    arena.robots.truncate(1);
    arena.robots[0].path = Path::still(Vector3::new(0.0, 0.0, 0.3));
    let found = run(&Survey::new(arena)).unwrap();
    let little = found
        .findings
        .iter()
        .filter(|finding| matches!(finding, Finding::TooLittleMotion { .. }))
        .count();
    assert_eq!((found.cameras.len(), little), (1, 3), "{:?}", found.findings);
}

#[test]
fn a_misplaced_reference_is_named_and_ignored() {
    let mut survey = r4(10);
    survey.references[2].position_m.y += 0.05;
    let found = run(&survey).unwrap();
    let misplaced = |finding: &Finding| match finding {
        Finding::Misplaced { reference: 2, off_m, .. } => (off_m - 0.05).abs() < 0.005,
        _ => false,
    };
    assert!(found.findings.iter().any(misplaced), "{:?}", found.findings);
    assert!(worst_m(&survey, &found) < 2e-3, "{}", worst_m(&survey, &found));
}

#[test]
fn two_misplaced_references_are_an_error_with_their_distances() {
    let mut survey = r4(11);
    survey.references[1].position_m.x += 0.08;
    survey.references[2].position_m.y += 0.05;
    let error = run(&survey).unwrap_err();
    assert!(
        matches!(&error, ArenaError::Misplaced { camera: CameraId(0), offs_m } if offs_m.len() == 4)
    );
    assert!(error.to_string().contains("measure their places"), "{error}");
}

#[test]
fn too_few_references_are_an_error_with_counts_by_camera() {
    let mut survey = r4(12);
    survey.references.truncate(2);
    let error = run(&survey).unwrap_err().to_string();
    assert!(error.contains("camera 0 sees 2, camera 1 sees 0"), "{error}");
}

#[test]
fn two_roundels_with_one_code_do_no_harm() {
    let mut survey = r4(13);
    survey.arena.robots[5].code = survey.arena.robots[9].code;
    let found = run(&survey).unwrap();
    let twice = |finding: &Finding| {
        matches!(finding, Finding::Twice { code, .. } | Finding::Elsewhere { code, .. }
            if Some(code.number) == survey.arena.robots[9].code)
    };
    assert!(found.findings.iter().any(twice), "{:?}", found.findings);
    assert!(worst_m(&survey, &found) < 1e-3, "{}", worst_m(&survey, &found));
}

#[test]
fn a_camera_that_confuses_two_robots_is_named() {
    let survey = r4(16);
    let [one, other] = [5, 9].map(|robot: usize| survey.arena.robots[robot].code.unwrap());
    let mut recording = Recording::new(MAX_HZ);
    for mut frame in Stream::new(&survey.arena, SENSING, SECONDS) {
        let swaps = frame.camera == CameraId(1);
        let readings = frame.detections.iter_mut().filter_map(|it| it.ring.code.as_mut());
        for reading in readings.filter(|_| swaps) {
            let number = &mut reading.code.number;
            *number = match *number {
                it if it == one => other,
                it if it == other => one,
                it => it,
            };
        }
        recording.add(&survey.without_references(frame));
    }
    let params = ArenaParams::default();
    let found =
        calibrate(&recording, &survey.cameras(), &survey.references, &params, |_| true).unwrap();
    for number in [one, other] {
        let named = |finding: &Finding| {
            matches!(finding, Finding::Elsewhere { camera: CameraId(1), code, off_m, .. }
                if code.number == number && *off_m > 0.1)
        };
        assert!(found.findings.iter().any(named), "{number}: {:?}", found.findings);
    }
    assert!(worst_m(&survey, &found) < 1e-3, "{}", worst_m(&survey, &found));
}

#[test]
fn swapped_references_are_an_error() {
    let mut survey = r4(17);
    let place_m = survey.references[1].position_m;
    survey.references[1].position_m = survey.references[2].position_m;
    survey.references[2].position_m = place_m;
    let error = run(&survey).unwrap_err();
    assert!(matches!(&error, ArenaError::Misplaced { camera: CameraId(0), .. }), "{error}");
}

#[test]
fn a_wrong_lens_is_not_mistaken_for_a_duplicate_code() {
    let survey = r4(13);
    let wrong = WrongLenses::by(&survey, 1e-3, 1.0);
    let recording = wrong.record(&survey, SENSING, SECONDS, MAX_HZ);
    let (cameras, params) = (wrong.cameras(&survey, None), ArenaParams::default());
    let found = calibrate(&recording, &cameras, &survey.references, &params, |_| true).unwrap();
    let findings: Vec<String> = found.findings.iter().map(ToString::to_string).collect();
    assert!(findings.iter().any(|it| it.contains("mm from where others did")), "{findings:#?}");
    assert!(findings.iter().all(|it| it.contains("lens")), "{findings:#?}");
}

#[test]
fn a_reference_that_moves_is_named() {
    let mut survey = r4(14);
    let last = survey.arena.robots.len() - 1;
    let place_m = survey.references[3].position_m;
    // Moves by 2 cm and back over the recording and beyond.
    survey.arena.robots[last].path = Path::circuit(place_m, 0.02, 0.002, 0.0);
    let found = run(&survey).unwrap();
    let moved = |finding: &Finding| matches!(finding, Finding::Moved { reference: 3, .. });
    assert!(found.findings.iter().any(moved), "{:?}", found.findings);
    assert!(worst_m(&survey, &found) < 2e-3, "{}", worst_m(&survey, &found));
}

#[test]
fn calibration_can_be_cancelled() {
    let survey = r4(15);
    let recording = survey.record(SENSING, 5.0, MAX_HZ);
    let params = ArenaParams::default();
    let stopped =
        calibrate(&recording, &survey.cameras(), &survey.references, &params, |it| it.step < 2);
    assert_eq!(stopped.unwrap_err(), ArenaError::Cancelled);
}
