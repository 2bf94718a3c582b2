//! Within the late window, the order of arrival does not change the result.

use proptest::prelude::*;
use roundel_core::world::{FusionParams, Snapshot};

use super::{
    arena::{Arena, START, Setting},
    score::fusion_of,
};

fn end_of(arena: &Arena, delays_s: &[f64]) -> Snapshot {
    let mut frames = arena.frames(1.2);
    for (frame, delay_s) in frames.iter_mut().zip(delays_s.iter().cycle()) {
        frame.received_time = frame.capture_time.plus_seconds(*delay_s);
    }
    frames.sort_by_key(|frame| (frame.received_time, frame.camera));
    let mut fusion = fusion_of(arena, FusionParams::default());
    for frame in &frames {
        fusion.observe(frame);
    }
    assert_eq!(fusion.counts().late, 0);
    fusion.snapshot(START.plus_seconds(1.25))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn arrival_in_any_order_ends_the_same(
        seed in 1..50u64,
        delays_s in proptest::collection::vec(0.0..0.28f64, 37),
    ) {
        let setting = Setting { seed, objects: 4, cameras: 3, random: true, ..Setting::default() };
        let arena = Arena::new(setting);
        let (ordered, shuffled) = (end_of(&arena, &[0.0]), end_of(&arena, &delays_s));
        prop_assert_eq!(ordered.objects.len(), shuffled.objects.len());
        for expected in &ordered.objects {
            let found = shuffled
                .objects
                .iter()
                .min_by(|a, b| {
                    let far = |o: &&roundel_core::world::ObjectState| {
                        (o.position_m - expected.position_m).norm()
                    };
                    far(a).total_cmp(&far(b))
                })
                .unwrap();
            prop_assert!((found.position_m - expected.position_m).norm() < 1e-9);
            prop_assert!((found.velocity_m_s - expected.velocity_m_s).norm() < 1e-9);
            prop_assert!((found.covariance - expected.covariance).norm() < 1e-9);
            prop_assert!(found.orientation.angle_to(&expected.orientation) < 1e-7);
            prop_assert_eq!(found.observations, expected.observations);
            prop_assert_eq!(found.newest_observation, expected.newest_observation);
        }
    }
}
