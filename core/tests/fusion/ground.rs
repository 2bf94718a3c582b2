//! What drives, held to its floor: with one camera alone, where it helps most, and with all.

use roundel_core::{
    id::{CameraId, KindId},
    world::{FrameObservations, Fusion, FusionParams, MotionClass, WrongHeight},
};

use super::{
    arena::{Arena, Setting},
    score::{Score, fusion_of, run},
};

/// All of them drive, their roundels 0.3 m high.
fn driving() -> Arena {
    Arena::new(Setting { random: true, ground: true, rate_hz: 60.0, ..Setting::default() })
}

fn scored(arena: &Arena, frames: &[FrameObservations], class: MotionClass) -> Score {
    let mut fusion: Fusion = fusion_of(arena, FusionParams::default());
    fusion.set_motion(KindId(0), class);
    let score = run(arena, &mut fusion, frames, (1.5, 60.0));
    println!("{class:?}: {}", score.summary());
    assert_eq!(score.swaps, 0, "{class:?}");
    score
}

#[test]
fn one_camera_alone_knows_a_driving_robot_by_its_floor() {
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
fn all_cameras_lose_nothing_by_the_floor() {
    let arena = driving();
    let frames = arena.frames(8.0);
    let free = scored(&arena, &frames, MotionClass::Free);
    let held = scored(&arena, &frames, MotionClass::Ground { height_m: Some(0.3) });
    assert!(held.rms_mm() < free.rms_mm());
    assert!(held.shares().into_iter().all(|share| share > 0.92), "{}", held.summary());
}

/// What is said of heights while these frames are taken in, of robots that are held at `height_m`.
fn told(arena: &Arena, frames: &[FrameObservations], height_m: f64) -> (Vec<WrongHeight>, Fusion) {
    let mut fusion: Fusion = fusion_of(arena, FusionParams::default());
    fusion.set_motion(KindId(0), MotionClass::Ground { height_m: Some(height_m) });
    let mut told = Vec::new();
    for frame in frames {
        fusion.observe(frame);
        told.extend(fusion.drain_wrong_heights());
    }
    (told, fusion)
}

#[test]
fn a_wrong_height_is_told_once_with_the_right_one() {
    let arena = driving();
    let mut frames = arena.frames(30.0);
    let (wrong, fusion) = told(&arena, &frames, 0.3);
    assert!(wrong.is_empty(), "{wrong:?}");
    let begun = fusion.counts().begun;
    let (wrong, fusion) = told(&arena, &frames, 0.1);
    // These are the ghosts that would go without a word.
    assert!(fusion.counts().begun > 4 * begun, "{begun} {:?}", fusion.counts());
    let [wrong] = &wrong[..] else { panic!("{wrong:?}") };
    assert_eq!((wrong.kind, wrong.body, wrong.said_m), (Some(KindId(0)), None, 0.1));
    assert!((wrong.seen_m - 0.3).abs() < 0.01, "{wrong:?}");
    assert!(wrong.cameras.len() > 1, "{wrong:?}");
    // One camera alone sees it too.
    frames.retain(|frame| frame.camera == CameraId(0));
    let (wrong, _) = told(&arena, &frames, 0.5);
    assert_eq!((wrong.len(), &wrong[0].cameras[..]), (1, &[CameraId(0)][..]));
    assert!((wrong[0].seen_m - 0.3).abs() < 0.02, "{wrong:?}");
}
