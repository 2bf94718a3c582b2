//! Cameras that suddenly disagree with all others as if they had moved: held back before they spoil tracks.
//!
//! [`roundel_calib::watch`] needs most of a second to be sure who was bumped; until then an object that only
//! that camera sees well would go with it. So before a frame enters the filters, the small rigid motion of
//! the camera is fitted that explains best how far what it sees lies from where others saw the same within a tenth of a second (`shift`).
//! Lens, clock and place err slowly: what they make is learned over [`BASELINE_S`], and only what is beyond it counts.
//! A frame whose motion moves what is seen by more than [`LEAST_MOVE_M`], with a gain of more than [`SURE_GAIN`],
//! does not enter, neither do those after it, and what the camera saw within [`BEFORE_NS`] is taken back.
//!
//! Who moved? Not the camera against which a single one of the others, asked by itself, speaks: that one agrees with
//! it, and who disagrees with both has moved; where only one of them speaks against it at all, that one is held back at
//! once, before its own next frame. Objects may move as well, all at once, and then every camera seems to,
//! one after another. So if as many as half of those that see the objects would have to be held back, nobody
//! is, and neither without a witness: another camera that sees the same objects where they are expected meanwhile.
//! A camera that agrees again is used again; one that does not is as well after a time, if who watches the cameras has
//! not taken it out by then: as it stands is the new baseline.
//!
//! Reached (`cargo run --release -p roundel-tests --bin healing`, `tests/tests/healing.rs`): R4, cameras bumped by 2 cm or 1°
//! within 0.1 s, no track off by more than 4.4 mm; 18 mm without. 2 cm within 0.1 or 0.3 s at five times of 30 seeds:
//! nobody held back in its stead, and no track off by more than 5 mm but one, 0.75 s later, that the bumped camera's
//! absence leaves to one other at the edge of its picture (6.0 mm, stated 1.5).
//!
//! Limits. Where fewer than [`LEAST_SHARED`] objects are seen by others too, nothing can be told, and a camera alone is
//! never held back.
//!
//! PERF: a frame whose innovations are as large as usual costs an addition for each; the fit is made ten times a
//! second for the baseline, of a crowd with a part of it each time, and with all when something is unusual.

mod query;
mod shift;

pub(super) use query::{InnovationSum, MAX_SQUARED, Query};
use roundel_vision::{id::CameraId, time::Timestamp};
use shift::{Baseline, Shift, fit};
pub(super) use shift::{MAX_OTHERS, ObjectResidual};

/// Fewer objects that others see, too, say nothing.
const MIN_SHARED: usize = 3;
/// A gain below this is chance: χ² of 6 beyond 1 - 10⁻¹⁰.
const MIN_GAIN: f64 = 60.0;
/// Most of the other cameras, each by itself, gain more than this, and none loses as much: else it is one of those
/// that moved.
const MIN_SINGLE_GAIN: f64 = 10.0;
/// Where one alone gains all, and the rest together less than this, that one has moved.
const MAX_REST_GAIN: f64 = 5.0;
/// Cameras that are asked for that.
const MAX_QUERIED: usize = 8;
/// Motions that move less of what is seen, rms, spoil nothing.
const MIN_MOVE_M: f64 = 0.0015;
/// Frames whose sum of these exceeds what is usual by less are not looked at.
const UNUSUAL: f64 = 25.0;
/// After a motion with a gain of more than this nothing is taken for usual …
const ALARM_GAIN: f64 = 20.0;
/// … for so long: a filter that follows a camera that moves finds it usual soon.
const ALARM_NS: i64 = 60_000_000;
/// Share of a frame in what is usual.
const USUAL_SHARE: f64 = 0.05;
/// Time in which the baseline forgets itself, seconds, …
const BASELINE_S: f64 = 2.0;
/// … and how often something is added to it.
const LEARN_NS: i64 = 100_000_000;
/// So much has to be known of a camera, from its first frame or its release on.
const WARM_UP_NS: i64 = 500_000_000;
/// Without a witness within this, nobody is held back.
const CONFIRMATION_NS: i64 = 120_000_000;
/// What a camera saw so long before it was held back is not used either.
const RETRACTED_NS: i64 = 100_000_000;
/// Frames in a row that agree end it.
const AGREED_FRAMES: u32 = 6;
/// A camera that was held back in vain is not again for so long.
const EXEMPT_NS: i64 = 30_000_000_000;

/// Steps kept for a caller that does not fetch them.
const MAX_EVENTS: usize = 64;

/// A camera's being held back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeldBack {
    /// Which.
    pub camera: CameraId,
    /// From when on, capture time.
    pub since: Timestamp,
    /// What became of it.
    pub step: HeldStep,
}

/// What becomes of a camera that is held back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeldStep {
    /// Its frames are not used.
    Begun,
    /// They are again: it agrees with the others.
    Agreed,
    /// They are again though it does not agree, since nobody said that it had moved.
    InVain,
}

#[derive(Clone, Copy, Debug)]
struct Hold {
    since: Timestamp,
    is_confirmed: bool,
    agreed: u32,
}

/// What is known of one camera.
#[derive(Clone, Debug)]
struct CameraRecord {
    camera: CameraId,
    /// Squared length of an innovation, usually.
    usual: f64,
    baseline: Baseline,
    learned: Option<Timestamp>,
    /// It is not held back before.
    from: Timestamp,
    hold: Option<Hold>,
}

/// All cameras.
#[derive(Clone, Debug, Default)]
pub(super) struct CameraOutliers {
    cameras: Vec<CameraRecord>,
    events: Vec<HeldBack>,
    residuals: Vec<ObjectResidual>,
    /// When some camera seemed to move last.
    alarm: Option<Timestamp>,
    /// Cameras whose measurements are to be taken back, and from when on.
    retractions: Vec<(CameraId, Timestamp)>,
}

/// Whether a frame is to be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// It is, and it says that things are where they are expected.
    Consistent,
    /// It is.
    Admitted,
    /// It is not.
    Rejected,
}

/// Who has moved.
enum Culprit {
    Nobody,
    Itself,
    Other(CameraId),
}

impl CameraOutliers {
    /// Forgets a camera: it stands elsewhere. What is usual of the others was against where it stood.
    pub(super) fn forget(&mut self, camera: CameraId) {
        self.cameras.retain(|camera_record| camera_record.camera != camera);
        self.retractions.retain(|(retractions, _)| *retractions != camera);
        for camera_record in
            self.cameras.iter_mut().filter(|camera_record| camera_record.hold.is_none())
        {
            camera_record.baseline = Baseline::default();
            let warm = camera_record.learned.map(|learned| learned.plus_ns(WARM_UP_NS));
            camera_record.from =
                warm.map_or(camera_record.from, |warm| warm.max(camera_record.from));
        }
    }

    /// From when on a camera is held back.
    pub(super) fn held_since(&self, camera: CameraId) -> Option<Timestamp> {
        let camera_record =
            self.cameras.iter().find(|camera_record| camera_record.camera == camera)?;
        camera_record.hold.map(|hold| hold.since)
    }

    /// Cameras held back without a witness yet, with the time from which on they may have seen what others see.
    pub(super) fn unconfirmed(&self) -> impl Iterator<Item = (CameraId, Timestamp)> {
        let unconfirmed_count = |camera_record: &CameraRecord| {
            let hold = camera_record.hold.filter(|hold| !hold.is_confirmed)?;
            Some((camera_record.camera, hold.since.plus_ns(-RETRACTED_NS)))
        };
        self.cameras.iter().filter_map(unconfirmed_count)
    }

    /// Another camera sees where they are expected what this one saw.
    pub(super) fn confirm(&mut self, camera: CameraId) {
        let camera_record =
            self.cameras.iter_mut().find(|camera_record| camera_record.camera == camera);
        let Some(hold) = camera_record.and_then(|camera_record| camera_record.hold.as_mut()) else {
            return;
        };
        hold.is_confirmed = true;
        let since = hold.since;
        self.push_event(HeldBack { camera, since, step: HeldStep::Begun });
    }

    /// A camera whose measurements are to be taken back.
    pub(super) fn next_retraction(&mut self) -> Option<(CameraId, Timestamp)> {
        self.retractions.pop()
    }

    /// What became known.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = HeldBack> + '_ {
        self.events.drain(..)
    }

    fn push_event(&mut self, step: HeldBack) {
        if self.events.len() < MAX_EVENTS {
            self.events.push(step);
        }
    }

    /// Whether a frame is to be used; `gather` tells, if that is in doubt, how far it lies from what all others
    /// or one of them saw.
    pub(super) fn judge(
        &mut self,
        (camera, time): (CameraId, Timestamp),
        innovations: InnovationSum,
        max_held_ns: i64,
        gather: impl Fn(Query, &mut Vec<ObjectResidual>),
    ) -> Admission {
        let index = self.index(camera, time);
        let camera_record = &self.cameras[index];
        let is_usual = innovations.sum <= camera_record.usual * innovations.count as f64 + UNUSUAL;
        let is_usual = is_usual && self.alarm.is_none_or(|alarm| time.ns_since(alarm) > ALARM_NS);
        let is_due = camera_record.learned.is_none_or(|learned| time.ns_since(learned) >= LEARN_NS);
        if camera_record.hold.is_none() && is_usual && !is_due {
            self.cameras[index].update_usual(innovations);
            return Admission::Consistent;
        }
        let is_quiet = camera_record.hold.is_none() && is_usual;
        let mut residuals = std::mem::take(&mut self.residuals);
        let mut fitted = |query: Query| {
            gather(query, &mut residuals);
            shift_of(&residuals, &camera_record.baseline)
        };
        let is_alarming = |it: &Shift| it.gain > ALARM_GAIN && it.moved_m > MIN_MOVE_M;
        let turn = (time.as_ns() / LEARN_NS).unsigned_abs();
        let part = Query::part(innovations.count, turn).filter(|_| is_quiet);
        let of_part = part.and_then(&mut fitted).filter(|it| !is_alarming(it));
        let shift = of_part.or_else(|| fitted(Query::whole(None)));
        if shift.as_ref().is_some_and(is_alarming) {
            self.alarm = self.alarm.max(Some(time));
        }
        let moved = shift.filter(|it| it.gain > MIN_GAIN && it.moved_m > MIN_MOVE_M);
        let admission = if self.cameras[index].hold.is_some() {
            self.judge_held(index, time, max_held_ns, shift.map(|_| moved.is_some()))
        } else if let Some(shift) = moved.as_ref().filter(|_| time >= self.cameras[index].from) {
            self.suspect(index, time, (shift, &mut residuals), gather)
        } else {
            self.cameras[index].update_usual(innovations);
            if moved.is_some() { Admission::Admitted } else { Admission::Consistent }
        };
        if is_due && admission != Admission::Rejected {
            self.cameras[index].update_baseline(shift.as_ref(), time);
        }
        self.residuals = residuals;
        admission
    }

    /// What becomes of a frame whose camera seems to have moved.
    fn suspect(
        &mut self,
        index: usize,
        time: Timestamp,
        (shift, residuals): (&Shift, &mut Vec<ObjectResidual>),
        gather: impl Fn(Query, &mut Vec<ObjectResidual>),
    ) -> Admission {
        let sees = |camera_record: &&CameraRecord| {
            residuals.iter().any(|weighted_sum| weighted_sum.is_by(camera_record.camera))
        };
        let (mut others, mut unconfirmed_count) = ([None; MAX_QUERIED], 1);
        let seeing = self.cameras.iter().filter(sees);
        for (camera_record, other) in seeing.zip(&mut others) {
            *other = Some(camera_record.camera);
            unconfirmed_count +=
                usize::from(camera_record.hold.is_some_and(|hold| !hold.is_confirmed));
        }
        let count = others.iter().flatten().count();
        if 2 * unconfirmed_count > count + 1 {
            // It is the objects that moved.
            for camera_record in &mut self.cameras {
                camera_record.hold = camera_record.hold.filter(|hold| hold.is_confirmed);
            }
            return Admission::Admitted;
        }
        match find_culprit(shift, others.into_iter().flatten(), residuals, gather) {
            Culprit::Nobody => Admission::Admitted,
            Culprit::Itself => {
                self.hold(index, time);
                Admission::Rejected
            }
            Culprit::Other(camera) => {
                let of = |camera_record: &CameraRecord| {
                    camera_record.camera == camera && camera_record.hold.is_none()
                };
                let other = self.cameras.iter().position(of);
                if let Some(other) = other.filter(|other| time >= self.cameras[*other].from) {
                    self.hold(other, time);
                }
                Admission::Admitted
            }
        }
    }

    fn hold(&mut self, index: usize, time: Timestamp) {
        let camera_record = &mut self.cameras[index];
        camera_record.hold = Some(Hold { since: time, is_confirmed: false, agreed: 0 });
        self.retractions.push((camera_record.camera, time.plus_ns(-RETRACTED_NS)));
    }

    /// The same for a camera that is held back; whether it seems to have moved, if that can be told.
    fn judge_held(
        &mut self,
        index: usize,
        time: Timestamp,
        max_held_ns: i64,
        has_moved: Option<bool>,
    ) -> Admission {
        let camera_record = &mut self.cameras[index];
        let Some(hold) = &mut camera_record.hold else { return Admission::Admitted };
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
            HeldStep::InVain
        } else {
            return Admission::Rejected;
        };
        camera_record.hold = None;
        if step == HeldStep::InVain && is_confirmed {
            camera_record.baseline = Baseline::default();
            camera_record.from = time.plus_ns(EXEMPT_NS);
        }
        let camera = camera_record.camera;
        if is_confirmed {
            self.push_event(HeldBack { camera, since, step });
        }
        Admission::Admitted
    }

    fn index(&mut self, camera: CameraId, time: Timestamp) -> usize {
        let kalman_rate =
            self.cameras.iter().position(|camera_record| camera_record.camera == camera);
        kalman_rate.unwrap_or_else(|| {
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

/// Who has moved, a camera with this shift or one of the others, each asked by itself.
fn find_culprit(
    shift: &Shift,
    others: impl Iterator<Item = CameraId>,
    residuals: &mut Vec<ObjectResidual>,
    gather: impl Fn(Query, &mut Vec<ObjectResidual>),
) -> Culprit {
    let (mut queried, mut is_contradicted) = (0, false);
    let mut gains = [(0.0, CameraId(0)); MAX_QUERIED];
    for other in others {
        gather(Query::whole(Some(other)), residuals);
        let gain = shift.gain_of(residuals);
        is_contradicted |= gain < -MIN_SINGLE_GAIN;
        if residuals.len() >= MIN_SHARED {
            gains[queried] = (gain, other);
            queried += 1;
        }
    }
    let gains = &gains[..queried];
    let Some(&(best, other)) = gains.iter().max_by(|one, two| one.0.total_cmp(&two.0)) else {
        return Culprit::Nobody;
    };
    let supporting = gains.iter().filter(|(gain, _)| *gain > MIN_SINGLE_GAIN).count();
    let rest = gains.iter().map(|(gain, _)| gain).sum::<f64>() - best;
    if 2 * supporting > queried && !is_contradicted {
        Culprit::Itself
    } else if queried > 1 && best > MIN_GAIN && rest < MAX_REST_GAIN {
        Culprit::Other(other)
    } else {
        Culprit::Nobody
    }
}

fn shift_of(residuals: &[ObjectResidual], baseline: &Baseline) -> Option<Shift> {
    if residuals.len() < MIN_SHARED { None } else { fit(residuals, baseline) }
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
