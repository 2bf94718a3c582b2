//! Matches one camera's sightings of coded roundels to the trajectories that the other cameras saw.
//!
//! Fuses the observations again, except those of the camera in question, so that it has no influence on its own reference.
//! Each time is sampled [`LAG_S`] later: by then every observation of it has arrived, so nothing is predicted.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use nalgebra::{Matrix3, Matrix3x6};
use prost::Message;
use roundel_core::{
    calib::lens::moving::{RimObservation, Trajectory, Waypoint},
    id::KindId,
    marker::{Code, Kind},
    rigid::Rigid,
    time::Timestamp,
    world::{ClockPrior, LifeStage, ObjectState},
};
use roundel_proto::v1;
use thiserror::Error;

use super::{
    ReplayError, ReplayFrom,
    reader::FusionUpdate,
    session::{ReplayOptions, ReplaySession},
};
use crate::{
    archive::{
        record::{file_reader::Channel, schema::Topic},
        replay::from_recording,
    },
    model::{
        config::ObjectRoundels,
        suggestion::{list, nearest},
    },
};

/// Delay of sampling, seconds; at most half of fusion's late window.
const LAG_S: f64 = 0.1;
/// Interval of samples, seconds.
const STEP_S: f64 = 1.0 / 50.0;
/// Longer gaps are not sampled, seconds.
const MAX_GAP_S: f64 = 1.0;
/// Roundels with a larger standard deviation of position are skipped, metres.
const MAX_DEVIATION_M: f64 = 0.05;
/// Time stamps that differ more from their arrival have another epoch, seconds.
const EPOCH_DIFFERENCE_S: f64 = 1.0;

/// One camera's sightings, and the trajectories from the others.
#[derive(Clone, Debug)]
pub struct Correspondences {
    /// Columns and rows of the camera's picture.
    pub size: (usize, usize),
    /// Trajectories of the coded roundels that both saw.
    pub trajectories: Vec<Trajectory>,
    /// The camera's sightings of these.
    pub observations: Vec<RimObservation>,
    pub clock: ClockPrior,
    /// Number of the camera's frames.
    pub frames: u64,
    /// Number of sightings without a trajectory.
    pub unmatched: usize,
    /// Unreadable parts of the recording.
    pub damage: Vec<String>,
}

#[derive(Debug, Error)]
pub enum CorrespondenceError {
    #[error(transparent)]
    Replay(#[from] ReplayError),
    #[error("{}: expected one of the recorded cameras {cameras}, found \"{camera}\"{hint}", .path.display())]
    NoCamera {
        path: PathBuf,
        camera: String,
        cameras: String,
        /// Suggests a similar name.
        hint: String,
    },
    #[error(
        "{}: camera \"{camera}\" is mounted on an object; this method requires a fixed camera: calibrate it with the \
         printed board", .path.display()
    )]
    Mounted { path: PathBuf, camera: String },
    #[error(
        "{}: camera \"{camera}\" saw no coded roundel ({frames} of the {others} recorded frames are its own): record while \
         robots with coded roundels ([[roundel]] with `code`) drive in its view", .path.display()
    )]
    SawNothing { path: PathBuf, camera: String, frames: u64, others: u64 },
    #[error(
        "{}: camera \"{camera}\" saw coded roundels {sightings} times, but no other camera saw one of them at the same time: \
         its view must overlap with other cameras, whose poses must be known (`roundel calibrate arena`)", .path.display()
    )]
    Alone { path: PathBuf, camera: String, sightings: usize },
    #[error(
        "{}: camera \"{camera}\" saw coded roundels {sightings} times, but the other cameras know their positions only to \
         {deviation_mm:.0} mm or worse: expected at most {max_mm:.0} mm. Record where at least two other cameras see the \
         roundels, or measure the prints and set `tolerance = 0` of their [[roundel]]", .path.display(),
        max_mm = MAX_DEVIATION_M * 1e3
    )]
    Uncertain { path: PathBuf, camera: String, sightings: usize, deviation_mm: f64 },
}

type CodedRoundel = (KindId, Code);

#[derive(Default)]
struct CorrespondenceBuilder {
    waypoints: BTreeMap<CodedRoundel, Vec<Waypoint>>,
    /// Smallest standard deviation of each roundel that was skipped for it, metres.
    uncertain_m: BTreeMap<CodedRoundel, f64>,
    sightings: Vec<(CodedRoundel, RimObservation)>,
    frames: u64,
    /// Frames of all cameras.
    all_frames: u64,
    /// Minimum delay from time stamp to arrival.
    lateness_s: Option<f64>,
}

/// Plays a recording without one camera. Calls `advance` with the recorded seconds done.
pub fn correspondences(
    file: &Path,
    camera: &str,
    mut advance: impl FnMut(f64),
) -> Result<Correspondences, CorrespondenceError> {
    let options =
        ReplayOptions { file: file.to_owned(), from: ReplayFrom::Observations, config: None };
    let mut session = ReplaySession::open(&options)?;
    let config = session.engine.config().cloned();
    let (cameras, kinds) =
        config.as_ref().map_or((&[][..], &[][..]), |it| (&it.cameras[..], &it.kinds[..]));
    let (path, name) = (file.to_owned(), camera.to_owned());
    let Some(found) = cameras.iter().find(|it| it.name == camera) else {
        let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
        let hint = nearest(camera, names.iter().copied())
            .map_or_else(String::new, |near| format!("; did you mean \"{near}\"?"));
        return Err(CorrespondenceError::NoCamera {
            path,
            camera: name,
            cameras: list(names),
            hint,
        });
    };
    let size = (found.calibration.width(), found.calibration.height());
    let is_its =
        |update: &FusionUpdate| matches!(update, FusionUpdate::Camera(it) if it.camera == camera);
    let mut clock = ClockPrior::EXACT;
    for (_, update) in session.updates.extract_if(.., |(_, update)| is_its(update)) {
        let FusionUpdate::Camera(update) = update else { continue };
        if update.place() == v1::FusedPlace::Rides {
            return Err(CorrespondenceError::Mounted { path, camera: name });
        }
        if update.clock() == v1::FusedClock::Estimated {
            clock = ClockPrior { offset_s: update.clock_offset_s, skew: update.clock_skew };
        }
    }
    let builder = play(&mut session, camera, &mut advance)?;
    let (frames, others) = (builder.frames, builder.all_frames);
    let sightings = builder.sightings.len();
    if sightings == 0 {
        return Err(CorrespondenceError::SawNothing { path, camera: name, frames, others });
    }
    let deviation_m = builder.deviation_m();
    let mut found = builder.build(size, clock, kinds);
    found.damage = session.reader.file().damage().sentences.clone();
    if !found.observations.is_empty() {
        return Ok(found);
    }
    let Some(deviation_m) = deviation_m else {
        return Err(CorrespondenceError::Alone { path, camera: name, sightings });
    };
    let deviation_mm = deviation_m * 1e3;
    Err(CorrespondenceError::Uncertain { path, camera: name, sightings, deviation_mm })
}

fn play(
    session: &mut ReplaySession,
    camera: &str,
    advance: &mut impl FnMut(f64),
) -> Result<CorrespondenceBuilder, ReplayError> {
    let (begin, _) = session.reader.span();
    session.engine.restart(&session.updates, begin)?;
    let lag_s = LAG_S.min(0.5e-3 * session.late_window_ms);
    let (mut builder, mut sampled, mut newest) = (CorrespondenceBuilder::default(), begin, begin);
    while let Some(raw) = session.reader.take()? {
        newest = newest.max(raw.log_time);
        let past = newest.plus_seconds(-lag_s);
        if past.seconds_since(sampled) > MAX_GAP_S {
            sampled = past.plus_seconds(-STEP_S);
        }
        while past.seconds_since(sampled) >= STEP_S {
            sampled = sampled.plus_seconds(STEP_S);
            session.engine.publish_at(sampled, newest);
            builder.add_waypoints(session, sampled.seconds_since(begin));
            advance(newest.seconds_since(begin));
        }
        match &raw.channel {
            Channel::Topic(Topic::Observations) => {
                builder.all_frames += 1;
                let Ok(message) = v1::FrameObservations::decode(raw.data.as_slice()) else {
                    continue;
                };
                if message.camera == camera {
                    builder.add_sightings(session, message, begin);
                } else {
                    session.engine.process(&raw, &mut session.reader);
                }
            }
            Channel::Topic(Topic::Calibration) => {
                let update = v1::FusedCamera::decode(raw.data.as_slice());
                if update.is_ok_and(|update| update.camera != camera) {
                    session.engine.process(&raw, &mut session.reader);
                }
            }
            Channel::Topic(Topic::Configuration) => {
                session.engine.process(&raw, &mut session.reader)
            }
            // Fusion makes its own snapshots and events.
            Channel::Topic(Topic::Snapshots | Topic::Events | Topic::Health)
            | Channel::Frame(_)
            | Channel::Foreign(_) => {}
        }
    }
    Ok(builder)
}

impl CorrespondenceBuilder {
    /// Adds the roundels of the newest snapshot.
    fn add_waypoints(&mut self, session: &ReplaySession, time_s: f64) {
        let fused = session.hub.snapshots().borrow().clone();
        let mut now: BTreeMap<CodedRoundel, Vec<Waypoint>> = BTreeMap::new();
        for state in &fused.snapshot.objects {
            if state.stage != LifeStage::Tracked {
                continue;
            }
            for (name, object_from_roundel) in roundels(session, state) {
                let waypoint = waypoint(state, &object_from_roundel, time_s);
                let deviation_m = waypoint.covariance_m2.trace().sqrt();
                if deviation_m < MAX_DEVIATION_M {
                    now.entry(name).or_default().push(waypoint);
                } else {
                    let least_m = self.uncertain_m.entry(name).or_insert(deviation_m);
                    *least_m = least_m.min(deviation_m);
                }
            }
        }
        for (name, mut found) in now {
            // A roundel at two positions is ambiguous.
            if let (Some(waypoint), []) = (found.pop(), found.as_slice()) {
                self.waypoints.entry(name).or_default().push(waypoint);
            }
        }
    }

    fn add_sightings(
        &mut self,
        session: &ReplaySession,
        message: v1::FrameObservations,
        begin: Timestamp,
    ) {
        self.frames += 1;
        let Some(id) = session.hub.installation().camera_id(&message.camera) else { return };
        let read = from_recording::read_observations(&session.hub, id, message);
        let Ok(frame) = read else { return };
        let lateness_s = frame.received_time.seconds_since(frame.capture_time);
        self.lateness_s = Some(self.lateness_s.map_or(lateness_s, |it| it.min(lateness_s)));
        for detection in frame.detections {
            let (Some(kind), Some(code)) = (detection.ring.kind, detection.ring.code) else {
                continue;
            };
            let outer = detection.ring.outer;
            let stamp_s = detection.capture_time.seconds_since(begin);
            let radius_px = outer.mean_radius_px();
            let rim = RimObservation { trajectory: 0, stamp_s, center: outer.center, radius_px };
            self.sightings.push(((kind, code.code), rim));
        }
    }

    /// Smallest standard deviation of the camera's roundels that were skipped for it.
    fn deviation_m(&self) -> Option<f64> {
        let seen = self.sightings.iter().filter_map(|(name, _)| self.uncertain_m.get(name));
        seen.copied().reduce(f64::min)
    }

    /// Numbers the trajectories, with times relative to the middle of the recording.
    fn build(self, size: (usize, usize), clock: ClockPrior, kinds: &[Kind]) -> Correspondences {
        let Self { mut waypoints, sightings, frames, lateness_s, .. } = self;
        let epoch_s = lateness_s.filter(|it| it.abs() > EPOCH_DIFFERENCE_S).unwrap_or(0.0);
        let stamps = sightings.iter().map(|(_, rim)| rim.stamp_s + epoch_s);
        let (least_s, most_s) =
            stamps.fold((f64::MAX, f64::MIN), |(least, most), it| (least.min(it), most.max(it)));
        let middle_s = 0.5 * (least_s + most_s);
        let names: BTreeSet<CodedRoundel> = sightings.iter().map(|(name, _)| *name).collect();
        waypoints.retain(|name, _| names.contains(name));
        let numbers: BTreeMap<CodedRoundel, usize> =
            waypoints.keys().enumerate().map(|(number, name)| (*name, number)).collect();
        let trajectories = waypoints.into_iter().map(|((kind, _), mut waypoints)| {
            waypoints.iter_mut().for_each(|it| it.time_s -= middle_s);
            let kind = kinds.get(usize::from(kind.0));
            Trajectory::new(kind.map_or(0.0, |kind| kind.outer_diameter_m) / 2.0, waypoints)
        });
        let trajectories: Vec<Trajectory> = trajectories.collect();
        let all = sightings.len();
        let observations = sightings.into_iter().filter_map(|(name, rim)| {
            let stamp_s = rim.stamp_s + epoch_s - middle_s;
            Some(RimObservation { trajectory: *numbers.get(&name)?, stamp_s, ..rim })
        });
        // The clock estimate moves sightings by less than its prior deviation.
        let slack_s = clock.offset_s.max(STEP_S);
        let is_matched = |rim: &RimObservation| {
            let trajectory = &trajectories[rim.trajectory];
            [-slack_s, 0.0, slack_s].iter().any(|by_s| trajectory.at(rim.stamp_s + by_s).is_some())
        };
        let observations: Vec<RimObservation> = observations.filter(is_matched).collect();
        let unmatched = all - observations.len();
        Correspondences {
            size,
            unmatched,
            trajectories,
            observations,
            clock,
            frames,
            damage: Vec::new(),
        }
    }
}

/// The coded roundels of an object, with their poses on it.
fn roundels(session: &ReplaySession, state: &ObjectState) -> Vec<(CodedRoundel, Rigid)> {
    let mut object_from_roundel = Rigid::identity();
    for (object, body) in session.engine.objects() {
        match &object.carries {
            ObjectRoundels::Body(it) if body.is_some() && body == state.body => {
                let coded = it.mounts.iter().filter_map(|mount| {
                    Some(((mount.kind, mount.code?), mount.object_from_roundel))
                });
                return coded.collect();
            }
            ObjectRoundels::Kind { kind, offset_m, .. } if state.kind == Some(*kind) => {
                object_from_roundel = Rigid::translation(-offset_m.x, -offset_m.y, -offset_m.z);
            }
            _ => {}
        }
    }
    let alone = state.kind.zip(state.code).filter(|_| state.body.is_none());
    alone.map(|name| (name, object_from_roundel)).into_iter().collect()
}

/// A roundel of an object; its errors are δc = δp - [r]× δθ with the arm r from the tracked point.
fn waypoint(state: &ObjectState, object_from_roundel: &Rigid, time_s: f64) -> Waypoint {
    let arm_m = state.orientation * object_from_roundel.translation.vector;
    let mut carry = Matrix3x6::zeros();
    carry.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
    carry.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    Waypoint {
        time_s,
        position_m: state.position_m + arm_m,
        velocity_m_s: state.velocity_m_s + state.angular_velocity_rad_s.cross(&arm_m),
        orientation: state.orientation * object_from_roundel.rotation,
        covariance_m2: carry * state.covariance * carry.transpose(),
    }
}
