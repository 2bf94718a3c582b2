//! The floor constraint: with a single camera, where it helps, and with many, where it does no harm; and a wrong
//! height, which is reported.

use roundel_core::{
    id::{CameraId, KindId},
    world::{FrameObservations, Fusion, FusionParams, MotionClass, WrongHeight},
};

use super::{
    arena::{Arena, Setting},
    score::{Score, fusion_of, run},
};

/// All objects drive, with roundels at a height of 0.3 m.
fn driving() -> Arena {
    Arena::new(Setting { random: true, ground: true, rate_hz: 60.0, ..Setting::default() })
}

fn scored(arena: &Arena, frames: &[FrameObservations], class: MotionClass) -> Score {
    let mut fusion: Fusion = fusion_of(arena, FusionParams::default());
    fusion.set_motion(KindId(0), class);
    let score = run(arena, &mut fusion, frames, 1.5);
    println!("{class:?}: {}", score.summary());
    assert_eq!(score.swaps, 0, "{class:?}");
    score
}

#[test]
fn a_single_camera_locates_a_robot_on_its_floor() {
    let arena = driving();
    let mut frames = arena.frames(8.0);
    frames.retain(|frame| frame.camera == CameraId(0));
    let free = scored(&arena, &frames, MotionClass::Free);
    let level = scored(&arena, &frames, MotionClass::Ground { height_m: None });
    let held = scored(&arena, &frames, MotionClass::Ground { height_m: Some(0.3) });
    assert!(held.rms_mm() < 0.4 * free.rms_mm() && level.rms_mm() < free.rms_mm());
    for score in [free, level, held] {
        assert!(score.shares()[0] > 0.92, "{}", score.summary());
    }
}

#[test]
fn the_floor_does_no_harm_with_all_cameras() {
    let arena = driving();
    let frames = arena.frames(8.0);
    let free = scored(&arena, &frames, MotionClass::Free);
    let held = scored(&arena, &frames, MotionClass::Ground { height_m: Some(0.3) });
    assert!(held.rms_mm() < free.rms_mm());
    assert!(held.shares().into_iter().all(|share| share > 0.92), "{}", held.summary());
}

/// Wrong heights reported for these frames, with robots constrained to `height_m`.
fn reported_heights(
    arena: &Arena,
    frames: &[FrameObservations],
    height_m: f64,
) -> (Vec<WrongHeight>, Fusion) {
    let mut fusion: Fusion = fusion_of(arena, FusionParams::default());
    fusion.set_motion(KindId(0), MotionClass::Ground { height_m: Some(height_m) });
    let mut reported = Vec::new();
    for frame in frames {
        fusion.observe(frame);
        reported.extend(fusion.drain_wrong_heights());
    }
    (reported, fusion)
}

#[test]
fn a_wrong_height_is_reported_once() {
    let arena = driving();
    let mut frames = arena.frames(30.0);
    let (heights, fusion) = reported_heights(&arena, &frames, 0.3);
    assert!(heights.is_empty(), "{heights:?}");
    let begun = fusion.counts().begun;
    let (heights, fusion) = reported_heights(&arena, &frames, 0.1);
    // False tracks that would otherwise appear without a report.
    assert!(fusion.counts().begun > 4 * begun, "{begun} {:?}", fusion.counts());
    let [wrong] = &heights[..] else { panic!("{heights:?}") };
    assert_eq!((wrong.kind, wrong.body, wrong.configured_m), (Some(KindId(0)), None, 0.1));
    assert!((wrong.measured_m - 0.3).abs() < 0.01, "{wrong:?}");
    assert!(wrong.cameras.len() > 1, "{heights:?}");
    // A single camera detects it too.
    frames.retain(|frame| frame.camera == CameraId(0));
    let (heights, _) = reported_heights(&arena, &frames, 0.5);
    assert_eq!((heights.len(), &heights[0].cameras[..]), (1, &[CameraId(0)][..]));
    assert!((heights[0].measured_m - 0.3).abs() < 0.02, "{heights:?}");
}
