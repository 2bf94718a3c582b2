//! Cameras that moved, kept from spoiling tracks: held back at once, taken back once that is sure.

use nalgebra::{Matrix3, Vector3};

use super::Fusion;
use crate::{
    track::{Kernel, Measurement, TakenBack, invert_positive},
    world::{
        HeldBack,
        association::{Decision, Sighting},
        camera_outlier::{Inquiry, MOST_OTHERS, MOST_SQUARED, Passage, Pull, Surprise},
        clock::Clocks,
        lifecycle::Track,
    },
};
use roundel_vision::{id::CameraId, time::Timestamp};

/// Of a camera that was bumped, what it saw within this time is not used.
const SPOILED_NS: i64 = 1_000_000_000;
/// An object counts that another camera saw within this time.
const CONFIRMED_S: f64 = 0.1;
/// Measurements of an object that are looked at for that at most.
const MOST_LOOKED_AT: usize = 24;
/// Two views of a camera that follow each other within this tell a velocity.
const STEP_S: f64 = 0.06;
/// a² over the density that the model has of it.
const ACCELERATION_RATE_HZ: f64 = 10.0;
/// Objects that a witness sees.
const LEAST_WITNESSED: usize = 2;

impl Fusion {
    /// A camera has moved: it is not used any more until [`Self::set_camera`] says where it stands, and what it saw within
    /// the last second is taken back.
    pub fn quarantine(&mut self, camera: CameraId) {
        // Held back since then, it spoiled nothing.
        let is_held = self.guards.held_since(camera).is_some();
        self.set_camera(camera, None);
        if let Some(now) = self.timeline.newest().filter(|_| !is_held) {
            self.take_back(camera, now.plus_ns(-SPOILED_NS));
        }
    }

    /// Says whether a camera is never held back, nor asked about others: its place may be rough, so that it disagrees
    /// with them though it stands still.
    pub fn spare(&mut self, camera: CameraId, is_spared: bool) {
        match self.spared.binary_search(&camera) {
            Err(index) if is_spared => {
                self.spared.insert(index, camera);
                self.guards.forget(camera);
            }
            Ok(index) if !is_spared => {
                self.spared.remove(index);
            }
            _ => {}
        }
    }

    /// Takes what became known since the last call of cameras that are held back.
    pub fn drain_held_back(&mut self) -> impl Iterator<Item = HeldBack> + '_ {
        self.guards.drain()
    }

    /// Whether the frame with these sightings is to be used.
    pub(super) fn lets_in(
        &mut self,
        (camera, time): (CameraId, Timestamp),
        decisions: &[Decision],
    ) -> bool {
        let most_held_ns = self.params.held_back_ns;
        let is_guarded = most_held_ns > 0 && self.spared.binary_search(&camera).is_err();
        let Some(place) = self.cameras.get(&camera).filter(|_| is_guarded) else {
            return true;
        };
        let mut surprise = Surprise::default();
        for (sighting, decision) in self.sightings.iter().zip(decisions) {
            let squared = match decision {
                Some((_, innovation)) => innovation.distance_squared.min(MOST_SQUARED),
                None if follows(&self.tracks, sighting).is_some() => MOST_SQUARED,
                None => continue,
            };
            surprise.sum += squared;
            surprise.count += 1;
        }
        let origin_m = place.world_from_camera.translation.vector;
        let (tracks, sightings) = (&self.tracks, &self.sightings);
        let (clocks, spared) = (&self.clocks, self.spared.as_slice());
        let (trust, rank) = (&self.trust, self.trust.rank(camera));
        let gather = |Inquiry { by, every, skipped }: Inquiry, pulls: &mut Vec<Pull>| {
            let asked = |other: CameraId| {
                other != camera
                    && by.is_none_or(|by| by == other)
                    && spared.binary_search(&other).is_err()
                    && trust.rank(other) >= rank
            };
            let inquired = sightings.iter().zip(decisions).skip(skipped).step_by(every);
            let each = inquired.filter_map(|(sighting, decision)| {
                let index = decision.map(|(track, _)| track);
                let track = &tracks[index.or_else(|| follows(tracks, sighting))?];
                let pull = pull(track, sighting, asked, clocks)?;
                Some(Pull { arm_m: sighting.measurement.position_m - origin_m, ..pull })
            });
            pulls.clear();
            pulls.extend(each);
        };
        let passage = self.guards.judge((camera, time), surprise, most_held_ns, gather);
        if passage == Passage::Calm {
            self.witness(decisions);
        }
        passage != Passage::Closed
    }

    /// Lets a frame that is as expected be witness against cameras that are held back.
    fn witness(&mut self, decisions: &[Decision]) {
        let sees = |camera: CameraId, since: Timestamp| {
            let is_shared =
                |index: usize| self.tracks[index].seen_by(camera).is_some_and(|time| time >= since);
            let shared = decisions.iter().flatten().filter(|(track, _)| is_shared(*track));
            shared.count() >= LEAST_WITNESSED
        };
        let sure = self.guards.unwitnessed().find(|(camera, since)| sees(*camera, *since));
        if let Some((camera, _)) = sure {
            self.guards.witness(camera);
        }
    }

    /// Takes back what cameras saw shortly before they were held back.
    pub(super) fn clean(&mut self) {
        while let Some((camera, since)) = self.guards.take_spoiled() {
            self.take_back(camera, since);
        }
    }

    fn take_back(&mut self, camera: CameraId, since: Timestamp) {
        let mut index = 0;
        while index < self.tracks.len() {
            let track = &mut self.tracks[index];
            match track.take_back(camera, since) {
                TakenBack::All(count) => {
                    self.counts.taken_back += count as u64;
                    index += 1;
                }
                TakenBack::NothingElse => {
                    let mut gone = self.tracks.remove(index);
                    let is_known = !gone.is_tentative();
                    let event = gone.lose(gone.newest);
                    self.end(gone, is_known.then_some(event));
                }
            }
        }
    }
}

/// The track that a sighting that lies nowhere near it is said to be of, by its camera or by its code.
fn follows(tracks: &[Track], sighting: &Sighting) -> Option<usize> {
    let is_it = |track: &Track| {
        let agrees = sighting.code.and_then(|code| track.codes.agrees(code));
        track.subject == sighting.subject
            && !track.is_tentative()
            && agrees.unwrap_or_else(|| track.is_continued_by(&sighting.measurement))
    };
    tracks.iter().position(is_it)
}

/// What a sighting says of its camera's motion: how far it lies from where those that are asked saw the object a moment
/// ago, which is known the worse the less is known of both cameras' clocks. The track's own place is
/// not asked, since the camera may have led it astray already.
fn pull(
    track: &Track,
    sighting: &Sighting,
    is_asked: impl Fn(CameraId) -> bool,
    clocks: &Clocks,
) -> Option<Pull> {
    let seen = &sighting.measurement;
    if track.is_tentative() {
        return None;
    }
    // PERF: a measurement is most of a kilobyte away from the next, so who is not there is not looked for.
    let since = seen.time.plus_seconds(-CONFIRMED_S);
    let expected = track.seen_since(since).filter(|&camera| is_asked(camera)).count();
    let expected = expected.min(MOST_OTHERS);
    let kernel = &track.history.newest().motion.agile().kernel;
    let mut others = [None; MOST_OTHERS];
    let (mut count, mut precision, mut pull) = (0, Matrix3::zeros(), Vector3::zeros());
    let known = (kernel, invert_positive(&kernel.spread.rate).map(|(weight, _)| weight));
    let most_m2_s4 = track.model.acceleration_density_m2_s3 * ACCELERATION_RATE_HZ;
    let mut views = track.history.measurements().rev().take(2 * MOST_LOOKED_AT);
    for _ in 0..MOST_LOOKED_AT {
        let Some(view) = views.next().filter(|_| count < expected) else { break };
        let dt = seen.time.seconds_since(view.time);
        if dt > CONFIRMED_S {
            break;
        }
        let is_new = is_asked(view.camera) && !others.contains(&Some(view.camera));
        if !is_new || dt < -CONFIRMED_S {
            continue;
        }
        let bent = most_m2_s4 * (0.25 * dt.powi(4));
        let (rate, rate_covariance) = velocity(view, views.clone(), &known, &most_m2_s4);
        let timing_s = clocks.deviation_s(seen.camera, view.camera);
        let covariance = view.position_noise.total
            + rate_covariance * (dt * dt)
            + kernel.rate * kernel.rate.transpose() * (timing_s * timing_s)
            + Matrix3::from_diagonal(&bent);
        let Some((weight, _)) = invert_positive(&covariance) else { continue };
        precision += weight;
        pull += weight * (view.position_m + rate * dt);
        others[count] = Some(view.camera);
        count += 1;
    }
    let (covariance, _) = invert_positive(&precision)?;
    let (weight, _) = invert_positive(&(covariance + seen.position_noise.total))?;
    let residual_m = seen.position_m - covariance * pull;
    Some(Pull { arm_m: seen.position_m, residual_m, weight, others })
}

/// How fast the object of a view was, and the covariance of that: from the same camera's view just before, joined with
/// what the track knows. By that alone a foreseen place was worse than a view, and while views contradict one another
/// it is worse yet, and led astray by who moved; within one camera's views they do not.
fn velocity<'a>(
    view: &Measurement,
    mut earlier: impl Iterator<Item = &'a Measurement>,
    (kernel, known_weight): &(&Kernel, Option<Matrix3<f64>>),
    most_m2_s4: &Vector3<f64>,
) -> (Vector3<f64>, Matrix3<f64>) {
    let (known_m_s, known) = (kernel.rate, kernel.spread.rate);
    let is_before = |it: &&Measurement| it.camera == view.camera && it.time < view.time;
    let before = earlier.find(is_before);
    let Some(before) = before.filter(|it| view.time.seconds_since(it.time) < STEP_S) else {
        return (known_m_s, known);
    };
    let step_s = view.time.seconds_since(before.time);
    let fresh = |it: &Measurement| {
        let noise = &it.position_noise;
        noise.total - noise.systematic_root * noise.systematic_root.transpose()
    };
    // It is the velocity half a step ago.
    let bent = Matrix3::from_diagonal(&(most_m2_s4 * (0.25 * step_s * step_s)));
    let own = (fresh(view) + fresh(before)) / (step_s * step_s) + bent;
    let own_m_s = (view.position_m - before.position_m) / step_s;
    let joined = invert_positive(&own).zip(*known_weight).and_then(|((own_weight, _), weight)| {
        let (covariance, _) = invert_positive(&(own_weight + weight))?;
        Some((covariance * (own_weight * own_m_s + weight * known_m_s), covariance))
    });
    // Its error goes with the view's.
    joined.map_or((known_m_s, known), |(rate_m_s, covariance)| (rate_m_s, covariance * 2.0))
}
