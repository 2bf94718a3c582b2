//! Merging of two tracks of one object.
//!
//! Two cameras that disagree by more than they state start two tracks of one object. When these come within their
//! uncertainties, and no camera ever showed both in one frame, they are merged. The older id stays, unless only the
//! younger track is confirmed. Two near tracks with the same settled code are merged whatever their uncertainties, two
//! with different codes never.

use nalgebra::Vector3;

use super::track::Track;
use roundel_vision::time::Timestamp;

/// Squared Mahalanobis distance below which two tracks may be one (χ², 3 degrees of freedom, 0.95).
const SAME_DISTANCE_SQUARED: f64 = 7.8;
/// Largest rms uncertainty of both tracks together, metres; less certain ones are compared later.
const MAX_DEVIATION_M: f64 = 0.25;
/// Largest distance of two tracks to compare, metres.
const MAX_DISTANCE_M: f64 = 1.0;

/// Finds two tracks of one object: the index of the one to keep and of the one to remove.
pub(crate) fn find_duplicates(tracks: &mut [Track], now: Timestamp) -> Option<(usize, usize)> {
    let places: Vec<Vector3<f64>> =
        tracks.iter().map(|track| track.coarse.predicted(now).position_m).collect();
    for older in 0..tracks.len() {
        for younger in older + 1..tracks.len() {
            let apart_m = places[older] - places[younger];
            if apart_m.norm_squared() > MAX_DISTANCE_M * MAX_DISTANCE_M
                || tracks[older].subject != tracks[younger].subject
                || tracks[older].distinct_from.contains(&tracks[younger].id)
            {
                continue;
            }
            let [a, b] = [older, younger].map(|index| tracks[index].codes.settled());
            if a.is_some() && b.is_some() && a != b {
                continue;
            }
            let is_same_code = a.is_some() && a == b;
            if are_in_one_frame(&tracks[older], &tracks[younger]) {
                let (low, high) = (tracks[older].id, tracks[younger].id);
                tracks[older].distinct_from.push(high);
                tracks[younger].distinct_from.push(low);
            } else if is_same_code
                || are_at_one_place(&tracks[older], &tracks[younger], &apart_m, now)
            {
                let swap = tracks[older].is_tentative() && !tracks[younger].is_tentative();
                return Some(if swap { (younger, older) } else { (older, younger) });
            }
        }
    }
    None
}

fn are_in_one_frame(a: &Track, b: &Track) -> bool {
    a.views.iter().any(|view| {
        b.views.iter().any(|other| (other.camera, other.frame) == (view.camera, view.frame))
    })
}

fn are_at_one_place(a: &Track, b: &Track, apart_m: &Vector3<f64>, now: Timestamp) -> bool {
    let [of_a, of_b] = [a, b].map(|track| {
        let newest = track.history.newest();
        let mut spread = newest.motion.agile().kalman.covariance;
        let dt = now.seconds_since(newest.time);
        spread.predict(dt, &track.model.acceleration_density_m2_s3);
        spread.value
    });
    let both = of_a + of_b;
    both.trace() < MAX_DEVIATION_M * MAX_DEVIATION_M
        && both
            .cholesky()
            .is_some_and(|root| apart_m.dot(&root.solve(apart_m)) < SAME_DISTANCE_SQUARED)
}
