//! Where a recording's other cameras had the coded roundels that one camera saw.
//!
//! Observations are fused anew, but for those of the camera in question, which is not to judge itself. Each instant is
//! asked for [`LAG_S`] after it has passed: by then all that was seen until then has come, so that nothing is
//! predicted.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use nalgebra::{Matrix3, Matrix3x6};
use prost::Message;
use roundel_core::{
    calib::lens::moving::{Glimpse, Way, Waypoint},
    id::KindId,
    marker::Code,
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
        config::{Config, ObjectRoundels},
        suggestion::{list, nearest},
    },
};

/// An instant is asked for so long after it, seconds, or after half of the time for which fusion waits.
const LAG_S: f64 = 0.1;
/// Instants are so far apart, seconds.
const STEP_S: f64 = 1.0 / 50.0;
/// After a gap of this length nothing is asked of the time in it, seconds.
const MAX_GAP_S: f64 = 1.0;
/// A roundel whose place is known no better than this is not known, metres.
const MAX_DEVIATION_M: f64 = 0.05;
/// Stamps that differ from the time of arrival by more than this are of another epoch, seconds.
const EPOCH_DIFFERENCE_S: f64 = 1.0;

/// What the others had, and what the camera saw.
#[derive(Clone, Debug)]
pub struct Correspondences {
    /// Columns and rows of the camera's picture.
    pub size: (usize, usize),
    /// Of each coded roundel that both saw.
    pub ways: Vec<Way>,
    /// The camera's sightings of these.
    pub glimpses: Vec<Glimpse>,
    /// What is known of the camera's clock.
    pub clock: ClockPrior,
    /// Frames of the camera, and coded roundels that were read in them.
    pub frames: u64,
    /// Of these, sightings of codes that no other camera saw.
    pub unmatched: usize,
    /// What of the recording could not be read, in sentences.
    pub damage: Vec<String>,
}

/// Why there is nothing to judge a camera by.
#[derive(Debug, Error)]
pub enum CorrespondenceError {
    /// The recording cannot be fused anew.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// It has no such camera.
    #[error("{}: expected one of the recorded cameras {cameras}, found \"{camera}\"{hint}", .path.display())]
    NoCamera {
        path: PathBuf,
        camera: String,
        cameras: String,
        /// What may have been meant.
        hint: String,
    },
    /// It does not stand.
    #[error(
        "{}: camera \"{camera}\" rides on an object; only the lens of a camera that stands is found this way: calibrate \
         this one with the printed board", .path.display()
    )]
    Rides { path: PathBuf, camera: String },
    /// Nobody saw anything, or not the camera.
    #[error(
        "{}: camera \"{camera}\" saw no coded roundel in {frames} frames of {others} frames of all cameras: record while robots \
         with coded roundels ([[roundel]] with `code`) drive before it", .path.display()
    )]
    SawNothing { path: PathBuf, camera: String, frames: u64, others: u64 },
    /// No other camera saw what it saw.
    #[error(
        "{}: camera \"{camera}\" saw coded roundels {sightings} times, and no other camera saw one of them at the same time: \
         cameras must overlap, and the others must be placed (`roundel calibrate arena`)", .path.display()
    )]
    Alone { path: PathBuf, camera: String, sightings: usize },
}

type CodedRoundel = (KindId, Code);

#[derive(Default)]
struct CorrespondenceBuilder {
    waypoints: BTreeMap<CodedRoundel, Vec<Waypoint>>,
    sightings: Vec<(CodedRoundel, Glimpse)>,
    frames: u64,
    of_all: u64,
    /// Least time from stamp to arrival.
    lateness_s: Option<f64>,
}

/// Plays a recording without a camera; `advance` hears of each second that is done.
pub fn correspondences(
    file: &Path,
    camera: &str,
    mut advance: impl FnMut(f64),
) -> Result<Correspondences, CorrespondenceError> {
    let options =
        ReplayOptions { file: file.to_owned(), from: ReplayFrom::Observations, config: None };
    let mut session = ReplaySession::open(&options)?;
    let config = session.engine.config().cloned();
    let lens = config.as_ref().and_then(|config| {
        let found = config.cameras.iter().find(|it| it.name == camera)?;
        Some((found.calibration.width(), found.calibration.height()))
    });
    let (Some(config), Some(size)) = (config.as_ref(), lens) else {
        return Err(no_camera(file, camera, config.as_ref()));
    };
    let (path, name) = (file.to_owned(), camera.to_owned());
    let mut clock = ClockPrior::EXACT;
    for (_, told) in &session.updates {
        let FusionUpdate::Camera(told) = told else { continue };
        if told.camera != camera {
            continue;
        }
        if told.place() == v1::FusedPlace::Rides {
            return Err(CorrespondenceError::Rides { path, camera: name });
        }
        if told.clock() == v1::FusedClock::Estimated {
            clock = ClockPrior { offset_s: told.clock_offset_s, skew: told.clock_skew };
        }
    }
    session
        .updates
        .retain(|(_, told)| !matches!(told, FusionUpdate::Camera(told) if told.camera == camera));
    let gathered = play(&mut session, camera, &mut advance)?;
    let CorrespondenceBuilder { frames, of_all: others, .. } = gathered;
    let sightings = gathered.sightings.len();
    if sightings == 0 {
        return Err(CorrespondenceError::SawNothing { path, camera: name, frames, others });
    }
    let mut found = gathered.build(size, clock, config);
    found.damage = session.reader.file().damage().sentences.clone();
    if found.glimpses.is_empty() {
        return Err(CorrespondenceError::Alone { path, camera: name, sightings });
    }
    Ok(found)
}

fn no_camera(file: &Path, camera: &str, config: Option<&Config>) -> CorrespondenceError {
    let names = config.into_iter().flat_map(|config| &config.cameras);
    let names: Vec<&str> = names.map(|camera| camera.name.as_str()).collect();
    let hint = nearest(camera, names.iter().copied())
        .map_or_else(String::new, |near| format!("; did you mean \"{near}\"?"));
    CorrespondenceError::NoCamera {
        path: file.to_owned(),
        camera: camera.to_owned(),
        cameras: list(names),
        hint,
    }
}

fn play(
    session: &mut ReplaySession,
    camera: &str,
    advance: &mut impl FnMut(f64),
) -> Result<CorrespondenceBuilder, ReplayError> {
    let (begin, _) = session.reader.span();
    session.engine.restart(&session.updates, begin)?;
    let lag_s = LAG_S.min(0.5e-3 * session.late_window_ms);
    let (mut gathered, mut asked, mut newest) = (CorrespondenceBuilder::default(), begin, begin);
    while let Some(raw) = session.reader.take()? {
        newest = newest.max(raw.log_time);
        let past = newest.plus_seconds(-lag_s);
        if past.seconds_since(asked) > MAX_GAP_S {
            asked = past.plus_seconds(-STEP_S);
        }
        while past.seconds_since(asked) >= STEP_S {
            asked = asked.plus_seconds(STEP_S);
            session.engine.publish_at(asked, newest);
            gathered.add_waypoints(session, asked.seconds_since(begin));
            advance(newest.seconds_since(begin));
        }
        match &raw.channel {
            Channel::Topic(Topic::Observations) => {
                gathered.of_all += 1;
                let Ok(message) = v1::FrameObservations::decode(raw.data.as_slice()) else {
                    continue;
                };
                if message.camera == camera {
                    gathered.add_sightings(session, message, begin);
                } else {
                    session.engine.process(&raw, &mut session.reader);
                }
            }
            Channel::Topic(Topic::Calibration) => {
                let told = v1::FusedCamera::decode(raw.data.as_slice());
                if told.is_ok_and(|told| told.camera != camera) {
                    session.engine.process(&raw, &mut session.reader);
                }
            }
            Channel::Topic(Topic::Configuration) => {
                session.engine.process(&raw, &mut session.reader)
            }
            // Asked for when it suits, or said by fusion anew.
            Channel::Topic(Topic::Snapshots | Topic::Events | Topic::Health)
            | Channel::Frame(_)
            | Channel::Foreign(_) => {}
        }
    }
    Ok(gathered)
}

impl CorrespondenceBuilder {
    /// Of the newest snapshot.
    fn add_waypoints(&mut self, session: &ReplaySession, time_s: f64) {
        let fused = session.hub.snapshots().borrow().clone();
        let mut now: BTreeMap<CodedRoundel, Vec<Waypoint>> = BTreeMap::new();
        for state in &fused.snapshot.objects {
            if state.stage != LifeStage::Tracked {
                continue;
            }
            for (name, object_from_roundel) in roundels(session, state) {
                let waypoint = waypoint(state, &object_from_roundel, time_s);
                if waypoint.covariance_m2.trace() < MAX_DEVIATION_M * MAX_DEVIATION_M {
                    now.entry(name).or_default().push(waypoint);
                }
            }
        }
        for (name, mut found) in now {
            // What is in two places is in none.
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
            let glimpse = Glimpse { way: 0, stamp_s, center: outer.center, radius_px };
            self.sightings.push(((kind, code.code), glimpse));
        }
    }

    /// Ways by number, their times about the middle of the recording.
    fn build(self, size: (usize, usize), clock: ClockPrior, config: &Config) -> Correspondences {
        let Self { mut waypoints, sightings, frames, lateness_s, .. } = self;
        let epoch_s = lateness_s.filter(|it| it.abs() > EPOCH_DIFFERENCE_S).unwrap_or(0.0);
        let stamps = sightings.iter().map(|(_, glimpse)| glimpse.stamp_s + epoch_s);
        let (least_s, most_s) =
            stamps.fold((f64::MAX, f64::MIN), |(least, most), it| (least.min(it), most.max(it)));
        let middle_s = 0.5 * (least_s + most_s);
        let names: BTreeSet<CodedRoundel> = sightings.iter().map(|(name, _)| *name).collect();
        waypoints.retain(|name, _| names.contains(name));
        let numbers: BTreeMap<CodedRoundel, usize> =
            waypoints.keys().enumerate().map(|(number, name)| (*name, number)).collect();
        let ways = waypoints.into_iter().map(|((kind, _), mut waypoints)| {
            waypoints.iter_mut().for_each(|it| it.time_s -= middle_s);
            let kind = config.kinds.get(usize::from(kind.0));
            Way::new(kind.map_or(0.0, |kind| kind.outer_diameter_m) / 2.0, waypoints)
        });
        let ways: Vec<Way> = ways.collect();
        let all = sightings.len();
        let glimpses = sightings.into_iter().filter_map(|(name, glimpse)| {
            let stamp_s = glimpse.stamp_s + epoch_s - middle_s;
            Some(Glimpse { way: *numbers.get(&name)?, stamp_s, ..glimpse })
        });
        // An estimate of the clock moves them by less than it may be off.
        let slack_s = clock.offset_s.max(STEP_S);
        let is_matched = |glimpse: &Glimpse| {
            let way = &ways[glimpse.way];
            [-slack_s, 0.0, slack_s].iter().any(|by_s| way.at(glimpse.stamp_s + by_s).is_some())
        };
        let glimpses: Vec<Glimpse> = glimpses.filter(is_matched).collect();
        let unmatched = all - glimpses.len();
        Correspondences { size, unmatched, ways, glimpses, clock, frames, damage: Vec::new() }
    }
}

/// The coded roundels of an object, where they are on it.
fn roundels(session: &ReplaySession, state: &ObjectState) -> Vec<(CodedRoundel, Rigid)> {
    for (object, body) in session.engine.objects() {
        match &object.carries {
            ObjectRoundels::Body(it) if body.is_some() && body == state.body => {
                let coded = it.mounts.iter().filter_map(|mount| {
                    Some(((mount.kind, mount.code?), mount.object_from_roundel))
                });
                return coded.collect();
            }
            ObjectRoundels::Kind { kind, offset_m, .. }
                if state.body.is_none() && state.kind == Some(*kind) =>
            {
                let name = state.kind.zip(state.code);
                let place = Rigid::translation(-offset_m.x, -offset_m.y, -offset_m.z);
                return name.map(|name| (name, place)).into_iter().collect();
            }
            _ => {}
        }
    }
    let alone = state.kind.zip(state.code).filter(|_| state.body.is_none());
    alone.map(|name| (name, Rigid::identity())).into_iter().collect()
}

/// One of an object's roundels: with its arm r from the tracked point, δc = δp - [r]× δθ.
fn waypoint(state: &ObjectState, object_from_roundel: &Rigid, time_s: f64) -> Waypoint {
    let arm_m = state.orientation * object_from_roundel.translation.vector;
    let mut carry = Matrix3x6::zeros();
    carry.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
    carry.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    Waypoint {
        time_s,
        place_m: state.position_m + arm_m,
        velocity_m_s: state.velocity_m_s + state.angular_velocity_rad_s.cross(&arm_m),
        orientation: state.orientation * object_from_roundel.rotation,
        covariance_m2: carry * state.covariance * carry.transpose(),
    }
}
