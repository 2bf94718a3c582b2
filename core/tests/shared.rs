//! Poses are the same whether one thread or a pool computes them. Once it is late, rings are located by their rims.

use crate::drawing::{SIDE, frame, nine};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    marker::{Detector, Kind, Mode, Params, Tracker},
    pose::{Located, Locator, PoseError},
    time::Timestamp,
};

const FRAMES: u64 = 6;

/// All rings of some consecutive frames; `is_late` by frame.
fn located(is_late: Option<fn(u64) -> bool>) -> Vec<Result<Located, PoseError>> {
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
        let tracked = tracker.process(&frame);
        match is_late {
            None => locator.locate_all(&frame, tracked, &mut newest),
            Some(is_late) => {
                let (time, is_late) = (Timestamp::default(), || is_late(number));
                locator.locate_all_until(&frame, time, tracked, &mut newest, &is_late);
            }
        }
        all.append(&mut newest);
    }
    all
}

#[test]
fn a_pool_computes_the_same_poses_as_one_thread() {
    let alone = located(None);
    assert_eq!(alone.len(), 9 * FRAMES as usize);
    assert!(alone.iter().flatten().filter(|one| one.by == Mode::Precise).count() >= 50);
    for threads in [2, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| located(None)), alone, "{threads} threads");
    }
}

#[test]
fn late_rings_are_located_by_their_rims() {
    let unlimited = located(None);
    assert_eq!(located(Some(|_| false)), unlimited);
    let limited = located(Some(|number| number == 2));
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
