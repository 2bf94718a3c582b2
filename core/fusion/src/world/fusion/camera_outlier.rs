//! Holding back, retraction and quarantine of cameras that moved.

use nalgebra::{Matrix3, Vector3};

use super::Fusion;
use crate::{
    track::{Measurement, Retraction, invert_positive},
    world::{
        HeldBack,
        association::{Decision, Sighting},
        camera_outlier::{Admission, InnovationSum, MAX_OTHERS, MAX_SQUARED, ObjectResidual},
        clock::Clocks,
        lifecycle::Track,
    },
};
use roundel_vision::{id::CameraId, time::Timestamp};

/// Measurements of a quarantined camera within this time are retracted.
const QUARANTINE_RETRACTED_NS: i64 = 1_000_000_000;
/// Largest age of another camera's measurement that a sighting is compared with.
const MAX_VIEW_AGE_S: f64 = 0.1;
/// Largest number of an object's measurements searched for that.
const MAX_MEASUREMENTS: usize = 24;
/// Largest interval of two measurements of a camera that determine a velocity.
const MAX_STEP_S: f64 = 0.06;
/// Squared acceleration over the density in the motion model.
const ACCELERATION_RATE_HZ: f64 = 10.0;
/// Smallest number of shared objects that confirm a hold.
const MIN_CONFIRMED: usize = 2;

impl Fusion {
    /// Stops using a camera that has moved until [`Self::set_camera`] sets its pose, and retracts its
    /// measurements of the last second.
    pub fn quarantine(&mut self, camera: CameraId) {
        // While held back, it disturbed nothing.
        let is_held = self.camera_outliers.held_since(camera).is_some();
        self.set_camera(camera, None);
        if let Some(now) = self.timeline.newest().filter(|_| !is_held) {
            self.retract(camera, now.plus_ns(-QUARANTINE_RETRACTED_NS));
        }
    }

    /// Sets whether a camera is exempt: never held back, nor compared with others. For cameras whose pose is
    /// approximate, so that they disagree with others although they stand still.
    pub fn set_hold_back_exempt(&mut self, camera: CameraId, is_exempt: bool) {
        if !is_exempt {
            self.exempt.remove(&camera);
        } else if self.exempt.insert(camera) {
            self.camera_outliers.forget(camera);
        }
    }

    /// Takes the events of held cameras since the last call.
    pub fn drain_held_back(&mut self) -> impl Iterator<Item = HeldBack> + '_ {
        self.camera_outliers.drain()
    }

    /// Whether the frame with these sightings is used.
    pub(super) fn admits(
        &mut self,
        camera: CameraId,
        time: Timestamp,
        decisions: &[Decision],
    ) -> bool {
        let max_held_ns = self.params.held_back_ns;
        let is_guarded = max_held_ns > 0 && !self.exempt.contains(&camera);
        let Some(place) = self.cameras.get(&camera).filter(|_| is_guarded) else {
            return true;
        };
        let mut innovations = InnovationSum::default();
        for (sighting, decision) in self.sightings.iter().zip(decisions) {
            let squared = match decision {
                Some((_, innovation)) => innovation.distance_squared.min(MAX_SQUARED),
                None if claimed_track(&self.tracks, sighting).is_some() => MAX_SQUARED,
                None => continue,
            };
            innovations.sum += squared;
            innovations.count += 1;
        }
        let origin_m = place.world_from_camera.translation.vector;
        let (tracks, sightings) = (&self.tracks, &self.sightings);
        let (clocks, exempt) = (&self.clocks, &self.exempt);
        let (trust, rank) = (&self.trust, self.trust.rank(camera));
        let gather = |by: Option<CameraId>| {
            let queried = |other: CameraId| {
                other != camera
                    && by.is_none_or(|by| by == other)
                    && !exempt.contains(&other)
                    && trust.rank(other) >= rank
            };
            let all = sightings.iter().zip(decisions).filter_map(|(sighting, decision)| {
                let index = decision.map(|(track, _)| track);
                let track = &tracks[index.or_else(|| claimed_track(tracks, sighting))?];
                let residual = object_residual(track, sighting, queried, clocks)?;
                Some(ObjectResidual {
                    arm_m: sighting.measurement.position_m - origin_m,
                    ..residual
                })
            });
            all.collect()
        };
        let admission = self.camera_outliers.judge(camera, time, innovations, max_held_ns, gather);
        if admission == Admission::Consistent {
            self.confirm(decisions);
        }
        admission != Admission::Rejected
    }

    /// Lets a consistent frame confirm the holds of other cameras.
    fn confirm(&mut self, decisions: &[Decision]) {
        let sees = |camera: CameraId, since: Timestamp| {
            let is_shared = |index: usize| {
                self.tracks[index].last_seen_by(camera).is_some_and(|time| time >= since)
            };
            let shared = decisions.iter().flatten().filter(|(track, _)| is_shared(*track));
            shared.count() >= MIN_CONFIRMED
        };
        let confirmed =
            self.camera_outliers.unconfirmed().find(|(camera, since)| sees(*camera, *since));
        if let Some((camera, _)) = confirmed {
            self.camera_outliers.confirm(camera);
        }
    }

    /// Retracts measurements from shortly before cameras were held back.
    pub(super) fn retract_held_back(&mut self) {
        while let Some((camera, since)) = self.camera_outliers.next_retraction() {
            self.retract(camera, since);
        }
    }

    fn retract(&mut self, camera: CameraId, since: Timestamp) {
        let mut index = 0;
        while index < self.tracks.len() {
            let track = &mut self.tracks[index];
            match track.retract(camera, since) {
                Retraction::Removed(count) => {
                    self.counts.retracted += count as u64;
                    index += 1;
                }
                Retraction::NothingLeft => {
                    let ended = self.tracks.remove(index);
                    let newest = ended.newest;
                    self.end(ended, newest);
                }
            }
        }
    }
}

/// Track that a sighting outside all gates belongs to by its camera's tracker or its code.
fn claimed_track(tracks: &[Track], sighting: &Sighting) -> Option<usize> {
    let is_it = |track: &Track| {
        let agrees = sighting.code.and_then(|code| track.codes.agrees(code));
        track.subject == sighting.subject
            && !track.is_tentative()
            && agrees.unwrap_or_else(|| track.is_continued_by(&sighting.measurement))
    };
    tracks.iter().position(is_it)
}

/// Residual of a sighting against where the queried cameras observed the object a moment ago, with the
/// uncertainty of both clocks. The track's own position is not used, since this camera may have moved it already.
fn object_residual(
    track: &Track,
    sighting: &Sighting,
    is_queried: impl Fn(CameraId) -> bool,
    clocks: &Clocks,
) -> Option<ObjectResidual> {
    let measurement = &sighting.measurement;
    if track.is_tentative() {
        return None;
    }
    // PERF: measurements lie most of a kilobyte apart in memory, so the search stops when all expected cameras
    // are found.
    let since = measurement.time.plus_seconds(-MAX_VIEW_AGE_S);
    let expected = track.cameras_since(since).filter(|&camera| is_queried(camera)).count();
    let expected = expected.min(MAX_OTHERS);
    let kalman = &track.history.newest().motion.agile().kalman;
    let mut others = [None; MAX_OTHERS];
    let (mut count, mut precision, mut weighted_sum) = (0, Matrix3::zeros(), Vector3::zeros());
    let track_velocity = Velocity { rate_m_s: kalman.rate, covariance: kalman.covariance.rate };
    let track_weight = invert_positive(&track_velocity.covariance).map(|(weight, _)| weight);
    let acceleration_m2_s4 = track.model.acceleration_density_m2_s3 * ACCELERATION_RATE_HZ;
    let mut views = track.history.measurements().rev().take(2 * MAX_MEASUREMENTS);
    for _ in 0..MAX_MEASUREMENTS {
        let Some(view) = views.next().filter(|_| count < expected) else { break };
        let dt = measurement.time.seconds_since(view.time);
        if dt > MAX_VIEW_AGE_S {
            break;
        }
        let is_new = is_queried(view.camera) && !others.contains(&Some(view.camera));
        if !is_new || dt < -MAX_VIEW_AGE_S {
            continue;
        }
        let curvature = acceleration_m2_s4 * (0.25 * dt.powi(4));
        let Velocity { rate_m_s, covariance: rate_covariance } =
            velocity(view, views.clone(), &track_velocity, track_weight, &acceleration_m2_s4);
        let timing_s = clocks.deviation_s(measurement.camera, view.camera);
        let covariance = view.position_noise.total
            + rate_covariance * (dt * dt)
            + kalman.rate * kalman.rate.transpose() * (timing_s * timing_s)
            + Matrix3::from_diagonal(&curvature);
        let Some((weight, _)) = invert_positive(&covariance) else { continue };
        precision += weight;
        weighted_sum += weight * (view.position_m + rate_m_s * dt);
        others[count] = Some(view.camera);
        count += 1;
    }
    let (covariance, _) = invert_positive(&precision)?;
    let (weight, _) = invert_positive(&(covariance + measurement.position_noise.total))?;
    let residual_m = measurement.position_m - covariance * weighted_sum;
    Some(ObjectResidual { arm_m: measurement.position_m, residual_m, weight, others })
}

/// Velocity of an object with its covariance.
#[derive(Clone, Copy)]
struct Velocity {
    rate_m_s: Vector3<f64>,
    covariance: Matrix3<f64>,
}

/// Velocity of the object at a view, with its covariance: from the same camera's view just before, joined with
/// the track's. With the track's alone, a predicted position was worse than a view, and much worse while views
/// contradict each other, since the camera that moved disturbs it; within one camera's views it does not.
fn velocity<'a>(
    view: &Measurement,
    mut earlier: impl Iterator<Item = &'a Measurement>,
    track: &Velocity,
    track_weight: Option<Matrix3<f64>>,
    acceleration_m2_s4: &Vector3<f64>,
) -> Velocity {
    let is_before = |it: &&Measurement| it.camera == view.camera && it.time < view.time;
    let before = earlier.find(is_before);
    let Some(before) = before.filter(|it| view.time.seconds_since(it.time) < MAX_STEP_S) else {
        return *track;
    };
    let step_s = view.time.seconds_since(before.time);
    let fresh = |it: &Measurement| {
        let noise = &it.position_noise;
        noise.total - noise.systematic_root * noise.systematic_root.transpose()
    };
    // The velocity is that of half a step earlier.
    let curvature = Matrix3::from_diagonal(&(acceleration_m2_s4 * (0.25 * step_s * step_s)));
    let own = (fresh(view) + fresh(before)) / (step_s * step_s) + curvature;
    let own_m_s = (view.position_m - before.position_m) / step_s;
    let joined = invert_positive(&own).zip(track_weight).and_then(|((own_weight, _), weight)| {
        let (covariance, _) = invert_positive(&(own_weight + weight))?;
        let rate_m_s = covariance * (own_weight * own_m_s + weight * track.rate_m_s);
        // Its error is correlated with the view's.
        Some(Velocity { rate_m_s, covariance: covariance * 2.0 })
    });
    joined.unwrap_or(*track)
}
