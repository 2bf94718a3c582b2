//! A rendered arena through core's detection, pose estimation and fusion, scored against the truth: the same scenario
//! and score as over a real server, without its timing.

use roundel_core::{
    marker::Mode,
    time::Timestamp,
    world::{FrameObservations, FusionParams},
};
use roundel_tests::{
    arena::Arena,
    lab::{Lab, LabOutcome},
    pipeline::{fusion, message},
    scenario::pixels::watch,
    score::{CHI2_95_3, Judge, Score},
};

/// Fuses in order, with a snapshot every 1/60 s, at least 10 ms after the newest frame. Scores after the first
/// second, in which tracks begin.
fn score(arena: &Arena, frames: &[FrameObservations], params: FusionParams) -> Score {
    let mut fusion = fusion(arena, params);
    let mut judge = Judge::default();
    let step_ns = 1_000_000_000 / 60;
    let mut pose_ns = arena.start_ns;
    for frame in frames {
        while pose_ns + 10_000_000 <= frame.capture_time.as_ns() {
            let snapshot = fusion.snapshot(Timestamp::from_ns(pose_ns));
            if pose_ns - arena.start_ns > 1_000_000_000 {
                judge.take(&message(&snapshot), &arena.truth(pose_ns));
            }
            pose_ns += step_ns;
        }
        fusion.observe(frame);
    }
    judge.finish()
}

/// Stated covariances are neither too small nor too large, even where neighbours' sheets cover parts of one another's
/// rings.
///
/// An excess shows in the mean of the normalized squares, which is 3 for Gaussian errors. With precise poses, the
/// motion model contributes more to errors than the pixels do: a path with bounded accelerations deviates less than
/// white acceleration may, so that almost no errors lie outside the ellipsoid although it is hardly too large. Pixel
/// errors also persist less from frame to frame than the filter allows for. Robots that stand still have 0.8 to 0.9
/// of 3; those that move lie between.
#[test]
fn errors_of_crowded_robots_match_their_covariances() {
    for seed in [2, 3] {
        let arena = Arena::r4_lite(seed, 24, 8);
        let score = score(&arena, &watch(&arena, 120), FusionParams::default());
        println!("24 robots, seed {seed}\n{score}\n");
        let lost = (score.swaps, score.strays, score.extra_ids, score.misses, score.unusable);
        assert_eq!(lost, (0, 0, 0, 0, 0));
        let share = score.position.share_within(CHI2_95_3);
        assert!(share >= 0.92, "seed {seed}: {share}");
        let normalized = score.position.mean_normalized();
        assert!((1.5..=4.0).contains(&normalized), "seed {seed}: {normalized}");
        assert!(score.velocity.share_within(CHI2_95_3) >= 0.92);
        assert!(score.position.rms() < 0.001, "{}", score.position.rms());
    }
}

#[test]
fn fused_poses_match_their_covariances() {
    let arena = Arena::r4_lite(1, 8, 2);
    let frames = watch(&arena, 90);
    for cameras in [1, 2, 4] {
        let used: Vec<_> =
            frames.iter().filter(|frame| (frame.camera.0 as usize) < cameras).cloned().collect();
        let score = score(&arena, &used, FusionParams::default());
        println!("{cameras} cameras\n{score}\n");
        assert_eq!((score.swaps, score.strays, score.extra_ids, score.unusable), (0, 0, 0, 0));
        assert!(score.position.count() > 500);
        // Depth errors of one camera persist from frame to frame, so a few robots show little of their share. With
        // all cameras it must hold.
        if cameras == 4 {
            assert_eq!(score.misses, 0);
            assert!(score.position.share_within(CHI2_95_3) >= 0.92);
            assert!(score.velocity.share_within(CHI2_95_3) >= 0.92);
            assert!(score.position.rms() < 0.003, "{}", score.position.rms());
        }
    }
}

#[test]
fn robots_keep_their_ids_in_a_lab() -> anyhow::Result<()> {
    for is_plain in [true, false] {
        let lab = Lab {
            seconds: 3.0,
            rate_hz: 15.0,
            scale: 0.97,
            knows_scale: false,
            is_plain,
            mode: Mode::Precise,
            lens_error: 1e-3,
            without: Vec::new(),
            seed: 5,
        };
        let LabOutcome { detections, print_size, tracks } = lab.run()?;
        println!("plain: {is_plain}\n{detections}\n{print_size:?}\n{tracks}");
        assert_eq!((tracks.ids, tracks.extra_ids, tracks.swaps, tracks.strays), (24, 0, 0, 0));
        assert!((print_size.factor / 0.97 - 1.0).abs() < 0.004, "{print_size:?}");
        // Mostly the prediction between frames, of which there are few.
        assert!(tracks.position.rms() < 0.012, "{}", tracks.position.rms());
        let share = tracks.position.share_within(CHI2_95_3);
        assert!(share > 0.8, "{share} of the errors lie inside the 95 % ellipsoid");
    }
    Ok(())
}
