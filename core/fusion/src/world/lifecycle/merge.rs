//! Two tracks of one object become one.
//!
//! Two cameras that disagree by more than they admit begin two tracks of one object. When these
//! come within their uncertainties and no camera has ever shown both in one frame, they are one: the
//! older id stays, unless only the younger one is trusted. One settled code makes two near tracks one
//! whatever their uncertainties say, two different ones never.

use nalgebra::Vector3;

use super::track::Track;
use roundel_vision::time::Timestamp;

/// Squared Mahalanobis distance below which two tracks may be one (χ², 3 degrees of freedom, 0.95).
const SAME_DISTANCE_SQUARED: f64 = 7.8;
/// Tracks less certain than this (rms of both, metres) are compared later.
const CERTAIN_M: f64 = 0.25;
/// Tracks further apart than this are not looked at.
const NEAR_M: f64 = 1.0;

/// Finds a pair that is one object: indexes of the one that stays and the one that goes.
pub(in crate::world) fn find(tracks: &mut [Track], now: Timestamp) -> Option<(usize, usize)> {
    let places: Vec<Vector3<f64>> =
        tracks.iter().map(|track| track.coarse.predicted(now).position_m).collect();
    for older in 0..tracks.len() {
        for younger in older + 1..tracks.len() {
            let apart_m = places[older] - places[younger];
            if apart_m.norm_squared() > NEAR_M * NEAR_M
                || tracks[older].subject != tracks[younger].subject
                || tracks[older].apart.contains(&tracks[younger].id)
            {
                continue;
            }
            let [a, b] = [older, younger].map(|index| tracks[index].codes.settled());
            if a.is_some() && b.is_some() && a != b {
                continue;
            }
            let is_same_code = a.is_some() && a == b;
            if seen_together(&tracks[older], &tracks[younger]) {
                let (low, high) = (tracks[older].id, tracks[younger].id);
                tracks[older].apart.push(high);
                tracks[younger].apart.push(low);
            } else if is_same_code || are_one(&tracks[older], &tracks[younger], &apart_m, now) {
                let swap = tracks[older].is_tentative() && !tracks[younger].is_tentative();
                return Some(if swap { (younger, older) } else { (older, younger) });
            }
        }
    }
    None
}

fn seen_together(a: &Track, b: &Track) -> bool {
    a.views.iter().any(|view| {
        b.views.iter().any(|other| (other.camera, other.frame) == (view.camera, view.frame))
    })
}

fn are_one(a: &Track, b: &Track, apart_m: &Vector3<f64>, now: Timestamp) -> bool {
    let [of_a, of_b] = [a, b].map(|track| {
        let newest = track.history.newest();
        let mut spread = newest.motion.agile().kernel.spread;
        let dt = now.seconds_since(newest.time);
        spread.predict(dt, &track.model.acceleration_density_m2_s3);
        spread.value
    });
    let both = of_a + of_b;
    both.trace() < CERTAIN_M * CERTAIN_M
        && both
            .cholesky()
            .is_some_and(|root| apart_m.dot(&root.solve(apart_m)) < SAME_DISTANCE_SQUARED)
}
