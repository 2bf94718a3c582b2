//! Ids are stable, and errors match the covariances: 95 % inside the 95 % ellipsoids, in several worlds.

use roundel_core::world::FusionParams;

use super::{
    arena::{Arena, Setting},
    score::{Score, fusion_of, run},
};

const BAND: std::ops::RangeInclusive<f64> = 0.92..=0.98;

fn scored(name: &str, setting: Setting, params: FusionParams, seconds: f64) -> Score {
    let arena = Arena::new(setting);
    let mut fusion = fusion_of(&arena, params);
    let score = run(&arena, &mut fusion, &arena.frames(seconds), 1.5);
    println!("{name}: {}", score.summary());
    assert_eq!(score.ids.len(), setting.objects, "{name}: one id per object");
    assert_eq!((score.swaps, score.ghosts), (0, 0), "{name}: swaps and ghosts");
    assert_eq!(fusion.counts().invalid, 0);
    score
}

#[test]
fn moving_at_random() {
    for seed in 1..4 {
        let setting = Setting { seed, random: true, clutter: 0.1, ..Setting::default() };
        let score = scored("random", setting, FusionParams::default(), 10.0);
        let [position, velocity, normal] = score.shares();
        assert!(BAND.contains(&position) && BAND.contains(&velocity), "{}", score.summary());
        assert!(normal >= 0.92, "{}", score.summary());
    }
}

/// On sines the acceleration is bounded, so large velocity errors are rarer than Gaussian ones.
#[test]
fn moving_smoothly() {
    let setting = Setting { clutter: 0.1, ..Setting::default() };
    let score = scored("smooth", setting, FusionParams::default(), 10.0);
    let [position, velocity, normal] = score.shares();
    assert!(BAND.contains(&position), "{}", score.summary());
    assert!(velocity >= 0.92 && normal >= 0.92, "{}", score.summary());
    assert!(score.rms_mm() < 3.0, "{}", score.summary());
}

#[test]
fn standing_still_with_systematic_errors() {
    let setting = Setting { still: 1, ..Setting::default() };
    let score = scored("still", setting, FusionParams::default(), 10.0);
    assert!(BAND.contains(&score.shares()[0]), "{}", score.summary());
    assert!(score.rms_mm() < 1.0, "{}", score.summary());
}

/// Counter-check: the same scenario without the systematic share.
#[test]
fn standing_still_without_a_systematic_share_is_overconfident() {
    let setting = Setting { still: 1, ..Setting::default() };
    let params = FusionParams { systematic_share: 0.0, ..FusionParams::default() };
    let score = scored("without systematic share", setting, params, 10.0);
    assert!(score.shares()[0] < 0.90, "{}", score.summary());
}

#[test]
fn standing_and_moving_together() {
    let setting = Setting { still: 2, random: true, clutter: 0.1, ..Setting::default() };
    let score = scored("half of them still", setting, FusionParams::default(), 10.0);
    assert!(BAND.contains(&score.shares()[0]), "{}", score.summary());
}

#[test]
fn sixty_four_objects_eight_cameras() {
    let synchronized = Setting {
        objects: 64,
        cameras: 8,
        rate_hz: 100.0,
        unsynchronized: false,
        jitter_s: 0.0,
        noise_px: 0.5,
        clutter: 0.1,
        random: true,
        ..Setting::default()
    };
    let late = Setting { unsynchronized: true, jitter_s: 0.02, ..synchronized };
    for (name, setting) in [("64 x 8", synchronized), ("64 x 8, 0 to 40 ms late", late)] {
        let score = scored(name, setting, FusionParams::default(), 6.0);
        let [position, velocity, _] = score.shares();
        assert!(BAND.contains(&position), "{}", score.summary());
        assert!(velocity >= 0.92, "{}", score.summary());
    }
}

/// `Snapshot::predicted` equals what fusion itself would return.
#[test]
fn predicted_snapshot_equals_a_later_one() {
    let arena = Arena::new(Setting { objects: 4, ..Setting::default() });
    let mut fusion = fusion_of(&arena, FusionParams::default());
    let frames = arena.frames(2.0);
    for frame in &frames {
        fusion.observe(frame);
    }
    let now = frames.last().unwrap().received_time;
    let (soon, later) = (fusion.snapshot(now), fusion.snapshot(now.plus_seconds(0.05)));
    let predicted = soon.predicted(0.05);
    assert_eq!(predicted.pose_time, later.pose_time);
    assert_eq!(predicted.objects.len(), 4);
    for ((a, b), from) in predicted.objects.iter().zip(&later.objects).zip(&soon.objects) {
        assert!((a.position_m - b.position_m).norm() < 1e-9);
        assert!(a.orientation.angle_to(&b.orientation) < 1e-3);
        let ratio = a.motion_covariance.trace() / b.motion_covariance.trace();
        assert!((0.8..1.25).contains(&ratio), "{ratio}");
        let grown = a.covariance - from.covariance;
        assert!(grown.trace() > 0.0 && a.covariance.cholesky().is_some());
    }
    assert_eq!(soon.predicted(f64::NAN), soon);
}

/// Robots that stood for seconds, so that fusion has learned a low process noise, start to move.
#[test]
fn setting_off_after_a_long_stand() {
    let setting = Setting { start_s: 4.0, ..Setting::default() };
    let score = scored("setting off", setting, FusionParams::default(), 8.0);
    assert!(score.shares()[0] >= 0.92, "{}", score.summary());
    assert!(score.rms_mm() < 3.0, "{}", score.summary());
}

/// Pairs of plain roundels that pass each other at 0.25 m.
#[test]
fn passing_each_other() {
    let setting = Setting { passing: true, random: false, dropout: 0.1, ..Setting::default() };
    let score = scored("passing", setting, FusionParams::default(), 20.0);
    assert!(score.shares()[0] >= 0.92, "{}", score.summary());
}
