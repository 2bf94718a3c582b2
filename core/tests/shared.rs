//! Poses are the same whether one thread or a pool computes them. After a deadline, rings are located by their rims.

use std::time::{Duration, Instant};

use crate::drawing::{SIDE, frame, nine};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    marker::{Detector, Kind, Mode, Params, Tracker},
    pose::{Located, Locator, PoseError},
};

const FRAMES: u64 = 6;

/// All rings of some consecutive frames, with the time left for the fits of each.
fn located(left: impl Fn(u64) -> Option<Duration>) -> Vec<Result<Located, PoseError>> {
    let kinds = vec![Kind::plain("robot", 0.16, 0.08)];
    let lens = Lens::PlumbBob([0.0; 5]);
    let (width, height) = (SIDE, SIDE);
    let (cx_px, cy_px) = (149.5, 149.5);
    let intrinsics = Intrinsics { width, height, fx_px: 500.0, fy_px: 500.0, cx_px, cy_px, lens };
    let mut locator = Locator::new(Camera::new(intrinsics).unwrap(), kinds.clone(), Mode::Precise);
    let mut tracker = Tracker::new(Detector::new(kinds, Params::default()).unwrap());
    let (mut newest, mut all) = (Vec::new(), Vec::new());
    for number in 0..FRAMES {
        let picture = nine(number as f64, None, number);
        let frame = frame(&picture, SIDE);
        locator.set_deadline(left(number).map(|left| Instant::now() + left));
        locator.locate_all(&frame, tracker.process(&frame), &mut newest);
        all.append(&mut newest);
    }
    all
}

#[test]
fn a_pool_computes_the_same_poses_as_one_thread() {
    let alone = located(|_| None);
    assert_eq!(alone.len(), 9 * FRAMES as usize);
    assert!(alone.iter().flatten().filter(|one| one.by == Mode::Precise).count() >= 50);
    for threads in [2, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| located(|_| None)), alone, "{threads} threads");
    }
}

#[test]
fn after_the_deadline_rings_are_located_by_their_rims() {
    const LONG: Duration = Duration::from_secs(60);
    let unlimited = located(|_| None);
    assert_eq!(located(|_| Some(LONG)), unlimited);
    // No time in the third frame.
    let limited = located(|number| Some(if number == 2 { Duration::ZERO } else { LONG }));
    for (index, (one, other)) in limited.iter().zip(&unlimited).enumerate() {
        let (one, other) = (one.as_ref().unwrap(), other.as_ref().unwrap());
        let is_late = index / 9 == 2;
        assert_eq!(one.is_deferred, is_late);
        assert!(!is_late || one.by == Mode::Fast);
        assert_eq!(one.work == 0, is_late);
        let apart_m = (one.pose.position_m - other.pose.position_m).norm();
        assert!(apart_m < 0.01 * other.pose.position_m.norm(), "{index}: {apart_m}");
    }
}
