//! Prints of another size than configured: measured by several cameras, and reported.

use roundel_core::{
    id::{CameraId, KindId},
    world::{
        FrameObservations, Fusion, FusionParams, KindPrintSize, Landmark, LifeStage, PrintSize,
        PrintSizeState,
    },
};

use super::{
    arena::{Arena, START, Setting},
    score::{Score, fusion_of, run},
};

const KIND: KindId = KindId(0);
const TOLERANCE: f64 = 0.03;

fn arena(seed: u64) -> Arena {
    Arena::new(Setting { seed, objects: 9, random: true, ..Setting::default() })
}

/// Frames of prints that are `factor` times as large as the detector assumes.
fn frames_of(arena: &Arena, factor: f64, seconds: f64) -> Vec<FrameObservations> {
    let mut frames = arena.frames(seconds);
    for frame in &mut frames {
        for pose in frame.detections.iter_mut().filter_map(|it| it.pose.as_mut()) {
            pose.position_m /= factor;
            let mut block = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
            block /= factor * factor;
        }
    }
    frames
}

fn fused(arena: &Arena, frames: &[FrameObservations], from_s: f64) -> (Score, Fusion) {
    let mut fusion = fusion_of(arena, FusionParams::default());
    fusion.set_print_tolerance(KIND, TOLERANCE, 0.0);
    let score = run(arena, &mut fusion, frames, from_s);
    (score, fusion)
}

fn reports(fusion: &mut Fusion) -> Vec<KindPrintSize> {
    fusion.drain_wrong_print_sizes().collect()
}

#[test]
fn the_scale_of_prints_is_measured() {
    for (seed, factor) in [(1, 1.0), (2, 0.97), (3, 1.03), (4, 0.94)] {
        let arena = arena(seed);
        let frames = frames_of(&arena, factor, 8.0);
        let exact = run(
            &arena,
            &mut fusion_of(&arena, FusionParams::default()),
            &frames_of(&arena, 1.0, 8.0),
            2.0,
        );
        let (score, mut fusion) = fused(&arena, &frames, 2.0);
        let PrintSize { factor: measured, deviation, .. } = fusion.print_size(KIND);
        println!(
            "{factor}: {measured:.5} ± {deviation:.5}, {}; exact {}",
            score.summary(),
            exact.summary()
        );
        assert!((measured / factor - 1.0).abs() < 0.001 && deviation < 0.001);
        assert!((measured / factor).ln().abs() < 3.0 * deviation);
        assert!(score.rms_mm() < 1.2 * exact.rms_mm());
        assert!(score.shares().into_iter().all(|share| share > 0.92));
        let reports = reports(&mut fusion);
        assert_eq!(reports.len(), usize::from(factor != 1.0), "{reports:?}");
        for report in reports {
            assert!(
                report.state == PrintSizeState::Measured
                    && report.kind == KIND
                    && report.cameras.len() == 4
            );
        }
    }
}

#[test]
fn robots_keep_one_id_from_the_start() {
    for (seed, factor) in [(5, 0.97), (6, 1.03)] {
        let arena = arena(seed);
        let (score, _) = fused(&arena, &frames_of(&arena, factor, 6.0), 1.0);
        println!("{factor}: {}", score.summary());
        assert_eq!((score.swaps, score.ghosts), (0, 0));
        assert_eq!(score.ids.len(), arena.setting.objects);
        assert!(score.shares()[0] > 0.92);
    }
}

#[test]
fn a_size_that_cannot_be_right_is_reported_and_not_used() {
    let arena = arena(7);
    let frames = frames_of(&arena, 122.0 / 160.0, 6.0);
    let (_, mut fusion) = fused(&arena, &frames, 1.0);
    let [report] = &reports(&mut fusion)[..] else { panic!("one report") };
    assert_eq!(report.state, PrintSizeState::Contradicted);
    assert!((report.size.factor - 122.0 / 160.0).abs() < 0.01, "{report:?}");
    assert_eq!(
        fusion.print_size(KIND),
        PrintSize { deviation: TOLERANCE / 2.0, ..PrintSize::EXACT }
    );
    let resized = fusion.resized(&frames[0]).expect("detections of the kind are left out");
    assert!(resized.detections.is_empty());
}

#[test]
fn a_single_camera_states_the_tolerance() {
    let arena = arena(8);
    let mut frames = frames_of(&arena, 0.98, 6.0);
    frames.retain(|frame| frame.camera == CameraId(0));
    let (_, mut fusion) = fused(&arena, &frames, 1.0);
    assert_eq!(
        fusion.print_size(KIND),
        PrintSize { deviation: TOLERANCE / 2.0, ..PrintSize::EXACT }
    );
    assert!(reports(&mut fusion).is_empty());
    let snapshot = fusion.snapshot(frames.last().unwrap().capture_time);
    let observed: Vec<_> =
        snapshot.objects.iter().filter(|it| it.stage == LifeStage::Tracked).collect();
    assert!(!observed.is_empty());
    let camera_m = arena.placements[0].world_from_camera.translation.vector;
    for object in observed {
        let arm_m = object.position_m - camera_m;
        let block = object.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let along_m = arm_m.normalize().dot(&(block * arm_m.normalize())).sqrt();
        assert!(along_m > 0.5 * TOLERANCE / 2.0 * arm_m.norm(), "{along_m}");
    }
}

#[test]
fn a_single_camera_measures_the_scale_with_references() {
    let factor = 0.97;
    let arena = Arena::new(Setting { seed: 9, objects: 9, still: 2, ..Setting::default() });
    let mut frames = frames_of(&arena, factor, 8.0);
    frames.retain(|frame| frame.camera == CameraId(0));
    let mut fusion = fusion_of(&arena, FusionParams::default());
    fusion.set_print_tolerance(KIND, TOLERANCE, 0.0);
    let still = (0..arena.setting.objects).step_by(arena.setting.still);
    let reference = |index| Landmark::new(KIND, None, arena.truth(index, START).position_m);
    fusion.set_landmarks(still.map(reference).collect());
    let score = run(&arena, &mut fusion, &frames, 2.0);
    let PrintSize { factor: measured, deviation, .. } = fusion.print_size(KIND);
    println!("{measured:.5} ± {deviation:.5}, {}", score.summary());
    assert!(deviation < 0.002, "{deviation}");
    assert!((measured / factor).ln().abs() < 3.0 * deviation, "{measured}");
    let [report] = &reports(&mut fusion)[..] else { panic!("one report") };
    assert_eq!(report.cameras, [CameraId(0)]);
}
