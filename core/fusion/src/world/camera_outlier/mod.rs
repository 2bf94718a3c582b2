//! Holds back cameras that suddenly disagree with all others as if they had moved, before they disturb tracks.
//!
//! `roundel_calib::watch` needs most of a second to be certain which camera was bumped; until then an object that
//! mainly that camera observes would follow it. So before a frame enters the filters, the small rigid motion of its
//! camera is fitted that best explains its distances from where other cameras observed the same objects within a tenth
//! of a second (`shift`). Lens, clock and pose errors change slowly: their effect is learned as a baseline over
//! [`BASELINE_S`], and only the deviation from it counts. If the motion moves the detections by more than
//! [`MIN_MOVE_M`] with a gain of more than [`MIN_GAIN`], this frame and those after it are rejected, and measurements
//! of the camera within the last [`RETRACTED_NS`] are retracted.
//!
//! The camera of the frame is not necessarily the one that moved. Each other camera is compared separately. If a single
//! one contradicts the motion, that one agrees with the frame's camera, and whichever disagrees with both has moved. If
//! only one supports it, that one is held back at once, before its own next frame. Objects may also move all at once;
//! then every camera seems to move, one after another. So nothing is held back if that would affect half of the cameras
//! that observe the objects, nor without a confirmation: another camera that observes the same objects where they are
//! expected meanwhile.
//!
//! A held camera is used again when it agrees, or after a time if the camera monitor has not removed it: its present
//! pose is then the new baseline.
//!
//! Results (`cargo run --release -p roundel-tests -- healing`, `tests/tests/healing.rs`): R4, cameras bumped by 2 cm
//! or 1° within 0.1 s: no track off by more than 4.4 mm; 18 mm without. 2 cm within 0.1 or 0.3 s at five times of 30
//! seeds: no wrong camera held back, and no track off by more than 5 mm except one, 0.75 s later, that is left to one
//! other camera at the edge of its image (6.0 mm, stated 1.5).
//!
//! Limits: needs at least [`MIN_SHARED`] objects that other cameras observe too; a single camera is never held back.
//!
//! PERF: a frame with usual innovations costs one addition per sighting. The fit runs ten times a second for the
//! baseline, and when something is unusual.

mod shift;

use roundel_vision::{id::CameraId, time::Timestamp};
use shift::{Baseline, Shift, fit};
pub(super) use shift::{MAX_OTHERS, ObjectResidual};

/// Smallest number of objects that other cameras observe too.
const MIN_SHARED: usize = 3;
/// Smallest significant gain: χ² of 6 beyond 1 - 10⁻¹⁰.
const MIN_GAIN: f64 = 60.0;
/// Most of the other cameras, each alone, must gain more than this, and none lose as much; otherwise one of those
/// moved.
const MIN_SINGLE_GAIN: f64 = 10.0;
/// If one camera alone has the whole gain, and the rest together less than this, that camera moved.
const MAX_REST_GAIN: f64 = 5.0;
/// Largest number of cameras compared separately.
const MAX_QUERIED: usize = 8;
/// Smallest rms motion of the detections that matters.
const MIN_MOVE_M: f64 = 0.0015;
/// Limit of an innovation's squared length in the usual sum.
pub(super) const MAX_SQUARED: f64 = 50.0;
/// Sums of squared innovations within this of the usual sum need no fit.
const UNUSUAL: f64 = 25.0;
/// A gain above this raises an alarm: for a time all frames are fitted.
const ALARM_GAIN: f64 = 20.0;
/// Duration of an alarm; a filter that follows a moving camera soon finds it usual.
const ALARM_NS: i64 = 60_000_000;
/// Weight of a frame in the usual squared innovation.
const USUAL_SHARE: f64 = 0.05;
/// Memory of the baseline, seconds.
const BASELINE_S: f64 = 2.0;
/// Interval of additions to the baseline.
const LEARN_NS: i64 = 100_000_000;
/// Time from a camera's first frame or release until it can be held back.
const WARM_UP_NS: i64 = 500_000_000;
/// A hold ends if it is not confirmed within this time.
const CONFIRMATION_NS: i64 = 120_000_000;
/// Measurements from this long before the hold are retracted.
const RETRACTED_NS: i64 = 100_000_000;
/// Number of consecutive frames in agreement that end a hold.
const AGREED_FRAMES: u32 = 6;
/// A camera that was held back in vain is exempt for this long.
const EXEMPT_NS: i64 = 30_000_000_000;

/// Largest number of events kept for the caller.
const MAX_EVENTS: usize = 64;

/// Event of a camera that is held back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeldBack {
    /// The camera.
    pub camera: CameraId,
    /// Capture time from which its frames are rejected.
    pub since: Timestamp,
    /// What happened.
    pub step: HeldStep,
}

/// Step of holding a camera back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeldStep {
    /// Its frames are rejected from now on.
    Started,
    /// Its frames are used again, since it agrees with the others.
    Agreed,
    /// Its frames are used again without agreement, since no monitor reported a motion.
    TimedOut,
}

#[derive(Clone, Copy, Debug)]
struct Hold {
    since: Timestamp,
    is_confirmed: bool,
    agreed: u32,
}

/// What is known about one camera.
#[derive(Clone, Debug)]
struct CameraRecord {
    camera: CameraId,
    /// Usual squared length of an innovation.
    usual: f64,
    baseline: Baseline,
    learned: Option<Timestamp>,
    /// Earliest time of a hold.
    from: Timestamp,
    hold: Option<Hold>,
}

/// All cameras.
#[derive(Clone, Debug, Default)]
pub(super) struct CameraOutliers {
    cameras: Vec<CameraRecord>,
    events: Vec<HeldBack>,
    /// Last time that some camera seemed to move.
    alarm: Option<Timestamp>,
    /// Cameras whose measurements must be retracted, and from when on.
    retractions: Vec<(CameraId, Timestamp)>,
}

/// Sum over a frame's innovations.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct InnovationSum {
    /// Squared lengths, each at most [`MAX_SQUARED`].
    pub(super) sum: f64,
    pub(super) count: usize,
}

/// Decision about a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// Use it; its objects are where they are expected.
    Consistent,
    /// Use it.
    Admitted,
    /// Do not use it.
    Rejected,
}

/// The camera that moved.
enum Culprit {
    Unknown,
    Itself,
    Other(CameraId),
}

impl CameraOutliers {
    /// Forgets a camera whose pose has changed, and the baselines of the others, which were relative to it.
    pub(super) fn forget(&mut self, camera: CameraId) {
        self.cameras.retain(|record| record.camera != camera);
        self.retractions.retain(|(retracted, _)| *retracted != camera);
        for record in self.cameras.iter_mut().filter(|record| record.hold.is_none()) {
            record.baseline = Baseline::default();
            let warm = record.learned.map(|learned| learned.plus_ns(WARM_UP_NS));
            record.from = warm.map_or(record.from, |warm| warm.max(record.from));
        }
    }

    /// Time since which a camera is held back.
    pub(super) fn held_since(&self, camera: CameraId) -> Option<Timestamp> {
        let record = self.cameras.iter().find(|record| record.camera == camera)?;
        record.hold.map(|hold| hold.since)
    }

    /// Cameras held back without confirmation, with the time from which detections may confirm it.
    pub(super) fn unconfirmed(&self) -> impl Iterator<Item = (CameraId, Timestamp)> {
        let unconfirmed = |record: &CameraRecord| {
            let hold = record.hold.filter(|hold| !hold.is_confirmed)?;
            Some((record.camera, hold.since.plus_ns(-RETRACTED_NS)))
        };
        self.cameras.iter().filter_map(unconfirmed)
    }

    /// Confirms a hold: another camera observes the objects where they are expected.
    pub(super) fn confirm(&mut self, camera: CameraId) {
        let record = self.cameras.iter_mut().find(|record| record.camera == camera);
        let Some(hold) = record.and_then(|record| record.hold.as_mut()) else {
            return;
        };
        hold.is_confirmed = true;
        let since = hold.since;
        self.push_event(HeldBack { camera, since, step: HeldStep::Started });
    }

    /// Takes a camera whose measurements must be retracted.
    pub(super) fn next_retraction(&mut self) -> Option<(CameraId, Timestamp)> {
        self.retractions.pop()
    }

    /// Takes the events since the last call.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = HeldBack> + '_ {
        self.events.drain(..)
    }

    fn push_event(&mut self, step: HeldBack) {
        if self.events.len() < MAX_EVENTS {
            self.events.push(step);
        }
    }

    /// Decides about a frame. `gather` collects the distances from what one other camera, or all of them, observed;
    /// it is called only when needed.
    pub(super) fn judge(
        &mut self,
        camera: CameraId,
        time: Timestamp,
        innovations: InnovationSum,
        max_held_ns: i64,
        gather: impl Fn(Option<CameraId>) -> Vec<ObjectResidual>,
    ) -> Admission {
        let index = self.index(camera, time);
        let record = &self.cameras[index];
        let is_usual = innovations.sum <= record.usual * innovations.count as f64 + UNUSUAL;
        let is_usual = is_usual && self.alarm.is_none_or(|alarm| time.ns_since(alarm) > ALARM_NS);
        let is_due = record.learned.is_none_or(|learned| time.ns_since(learned) >= LEARN_NS);
        if record.hold.is_none() && is_usual && !is_due {
            self.cameras[index].update_usual(innovations);
            return Admission::Consistent;
        }
        let residuals = gather(None);
        let is_enough = residuals.len() >= MIN_SHARED;
        let shift = if is_enough { fit(&residuals, &record.baseline) } else { None };
        if shift.as_ref().is_some_and(|it| it.gain > ALARM_GAIN && it.moved_m > MIN_MOVE_M) {
            self.alarm = self.alarm.max(Some(time));
        }
        let moved = shift.filter(|it| it.gain > MIN_GAIN && it.moved_m > MIN_MOVE_M);
        let admission = if self.cameras[index].hold.is_some() {
            self.judge_held(index, time, max_held_ns, shift.map(|_| moved.is_some()))
        } else if let Some(shift) = moved.as_ref().filter(|_| time >= self.cameras[index].from) {
            self.suspect(index, time, shift, &residuals, gather)
        } else {
            self.cameras[index].update_usual(innovations);
            if moved.is_some() { Admission::Admitted } else { Admission::Consistent }
        };
        if is_due && admission != Admission::Rejected {
            self.cameras[index].update_baseline(shift.as_ref(), time);
        }
        admission
    }

    /// Decides about a frame whose camera seems to have moved.
    fn suspect(
        &mut self,
        index: usize,
        time: Timestamp,
        shift: &Shift,
        residuals: &[ObjectResidual],
        gather: impl Fn(Option<CameraId>) -> Vec<ObjectResidual>,
    ) -> Admission {
        let is_queried =
            |record: &&CameraRecord| residuals.iter().any(|residual| residual.is_by(record.camera));
        let others: Vec<&CameraRecord> =
            self.cameras.iter().filter(is_queried).take(MAX_QUERIED).collect();
        let is_unconfirmed =
            |record: &&&CameraRecord| record.hold.is_some_and(|hold| !hold.is_confirmed);
        let unconfirmed_count = 1 + others.iter().filter(is_unconfirmed).count();
        if 2 * unconfirmed_count > others.len() + 1 {
            // The objects moved.
            for record in &mut self.cameras {
                record.hold = record.hold.filter(|hold| hold.is_confirmed);
            }
            return Admission::Admitted;
        }
        match find_culprit(shift, others.iter().map(|record| record.camera), gather) {
            Culprit::Unknown => Admission::Admitted,
            Culprit::Itself => {
                self.hold(index, time);
                Admission::Rejected
            }
            Culprit::Other(camera) => {
                let is_it =
                    |record: &CameraRecord| record.camera == camera && record.hold.is_none();
                let other = self.cameras.iter().position(is_it);
                if let Some(other) = other.filter(|other| time >= self.cameras[*other].from) {
                    self.hold(other, time);
                }
                Admission::Admitted
            }
        }
    }

    fn hold(&mut self, index: usize, time: Timestamp) {
        let record = &mut self.cameras[index];
        record.hold = Some(Hold { since: time, is_confirmed: false, agreed: 0 });
        self.retractions.push((record.camera, time.plus_ns(-RETRACTED_NS)));
    }

    /// Decides about a frame of a camera that is held back. `has_moved` is `None` where that is undetermined.
    fn judge_held(
        &mut self,
        index: usize,
        time: Timestamp,
        max_held_ns: i64,
        has_moved: Option<bool>,
    ) -> Admission {
        let record = &mut self.cameras[index];
        let Some(hold) = &mut record.hold else { return Admission::Admitted };
        hold.agreed = match has_moved {
            Some(false) => hold.agreed + 1,
            Some(true) => 0,
            None => hold.agreed,
        };
        let (since, is_confirmed) = (hold.since, hold.is_confirmed);
        let held_ns = time.ns_since(since);
        let step = if hold.agreed >= AGREED_FRAMES {
            HeldStep::Agreed
        } else if held_ns > max_held_ns || !is_confirmed && held_ns > CONFIRMATION_NS {
            HeldStep::TimedOut
        } else {
            return Admission::Rejected;
        };
        record.hold = None;
        if step == HeldStep::TimedOut && is_confirmed {
            record.baseline = Baseline::default();
            record.from = time.plus_ns(EXEMPT_NS);
        }
        let camera = record.camera;
        if is_confirmed {
            self.push_event(HeldBack { camera, since, step });
        }
        Admission::Admitted
    }

    fn index(&mut self, camera: CameraId, time: Timestamp) -> usize {
        let found = self.cameras.iter().position(|record| record.camera == camera);
        found.unwrap_or_else(|| {
            self.cameras.push(CameraRecord {
                camera,
                usual: 0.0,
                baseline: Baseline::default(),
                learned: None,
                from: time.plus_ns(WARM_UP_NS),
                hold: None,
            });
            self.cameras.len() - 1
        })
    }
}

/// The camera that moved: that of the shift, or one of the others, each compared separately.
fn find_culprit(
    shift: &Shift,
    others: impl Iterator<Item = CameraId>,
    gather: impl Fn(Option<CameraId>) -> Vec<ObjectResidual>,
) -> Culprit {
    let mut is_contradicted = false;
    let mut gains = Vec::new();
    for other in others {
        let residuals = gather(Some(other));
        let gain = shift.gain_of(&residuals);
        is_contradicted |= gain < -MIN_SINGLE_GAIN;
        if residuals.len() >= MIN_SHARED {
            gains.push((gain, other));
        }
    }
    let Some(&(best, other)) = gains.iter().max_by(|one, two| one.0.total_cmp(&two.0)) else {
        return Culprit::Unknown;
    };
    let supporting = gains.iter().filter(|(gain, _)| *gain > MIN_SINGLE_GAIN).count();
    let rest = gains.iter().map(|(gain, _)| gain).sum::<f64>() - best;
    if 2 * supporting > gains.len() && !is_contradicted {
        Culprit::Itself
    } else if gains.len() > 1 && best > MIN_GAIN && rest < MAX_REST_GAIN {
        Culprit::Other(other)
    } else {
        Culprit::Unknown
    }
}

impl CameraRecord {
    fn update_usual(&mut self, innovations: InnovationSum) {
        if innovations.count > 0 {
            let each = innovations.sum / innovations.count as f64;
            self.usual += (each - self.usual) * USUAL_SHARE;
        }
    }

    fn update_baseline(&mut self, shift: Option<&Shift>, time: Timestamp) {
        let since = self.learned.unwrap_or(time);
        if let Some(shift) = shift {
            self.baseline.add(shift, time.seconds_since(since), BASELINE_S);
        }
        self.learned = Some(time);
    }
}
