//! Poses are the same whether one thread or a pool computes them.

use crate::drawing::{SIDE, frame, nine};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    marker::{Detector, Kind, Mode, Params, Tracker},
    pose::{Located, Locator, PoseError},
};

const FRAMES: u64 = 6;

/// All rings of some consecutive frames.
fn located() -> Vec<Result<Located, PoseError>> {
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
        locator.locate_all(&frame, tracker.process(&frame), &mut newest);
        all.append(&mut newest);
    }
    all
}

#[test]
fn a_pool_computes_the_same_poses_as_one_thread() {
    let alone = located();
    assert_eq!(alone.len(), 9 * FRAMES as usize);
    assert!(alone.iter().flatten().filter(|one| one.by == Mode::Precise).count() >= 50);
    for threads in [2, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(located), alone, "{threads} threads");
    }
}
