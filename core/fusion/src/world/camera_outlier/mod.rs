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

pub(super) use query::{Inquiry, MOST_SQUARED, Surprise};
use roundel_vision::{id::CameraId, time::Timestamp};
use shift::{Baseline, Shift, fit};
pub(super) use shift::{MOST_OTHERS, Pull};

/// Fewer objects that others see, too, say nothing.
const LEAST_SHARED: usize = 3;
/// A gain below this is chance: χ² of 6 beyond 1 - 10⁻¹⁰.
const SURE_GAIN: f64 = 60.0;
/// Most of the other cameras, each by itself, gain more than this, and none loses as much: else it is one of those
/// that moved.
const SINGLE_GAIN: f64 = 10.0;
/// Where one alone gains all, and the rest together less than this, that one has moved.
const REST_GAIN: f64 = 5.0;
/// Cameras that are asked for that.
const MOST_SEEING: usize = 8;
/// Motions that move less of what is seen, rms, spoil nothing.
const LEAST_MOVE_M: f64 = 0.0015;
/// Frames whose sum of these exceeds what is usual by less are not looked at.
const UNUSUAL: f64 = 25.0;
/// After a motion with a gain of more than this nothing is taken for usual …
const ALARMING_GAIN: f64 = 20.0;
/// … for so long: a filter that follows a camera that moves finds it usual soon.
const ALARM_NS: i64 = 60_000_000;
/// Share of a frame in what is usual.
const USUAL_SHARE: f64 = 0.05;
/// Time in which the baseline forgets itself, seconds, …
const BASELINE_S: f64 = 2.0;
/// … and how often something is added to it.
const LEARN_NS: i64 = 100_000_000;
/// So much has to be known of a camera, from its first frame or its release on.
const WARM_NS: i64 = 500_000_000;
/// Without a witness within this, nobody is held back.
const WITNESS_NS: i64 = 120_000_000;
/// What a camera saw so long before it was held back is not used either.
const BEFORE_NS: i64 = 100_000_000;
/// Frames in a row that agree end it.
const AGREED_FRAMES: u32 = 6;
/// A camera that was held back in vain is not again for so long.
const SPARED_NS: i64 = 30_000_000_000;

/// Steps kept for a caller that does not fetch them.
const MOST_TOLD: usize = 64;

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
    is_witnessed: bool,
    agreed: u32,
}

/// What is known of one camera.
#[derive(Clone, Debug)]
struct Member {
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
pub(super) struct Guards {
    members: Vec<Member>,
    told: Vec<HeldBack>,
    pulls: Vec<Pull>,
    /// When some camera seemed to move last.
    alarm: Option<Timestamp>,
    /// Cameras whose measurements are to be taken back, and from when on.
    spoiled: Vec<(CameraId, Timestamp)>,
}

/// Whether a frame is to be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Passage {
    /// It is, and it says that things are where they are expected.
    Calm,
    /// It is.
    Open,
    /// It is not.
    Closed,
}

/// Who has moved.
enum Accused {
    Nobody,
    Itself,
    Other(CameraId),
}

impl Guards {
    /// Forgets a camera: it stands elsewhere. What is usual of the others was against where it stood.
    pub(super) fn forget(&mut self, camera: CameraId) {
        self.members.retain(|member| member.camera != camera);
        self.spoiled.retain(|(spoiled, _)| *spoiled != camera);
        for member in self.members.iter_mut().filter(|member| member.hold.is_none()) {
            member.baseline = Baseline::default();
            let warm = member.learned.map(|learned| learned.plus_ns(WARM_NS));
            member.from = warm.map_or(member.from, |warm| warm.max(member.from));
        }
    }

    /// From when on a camera is held back.
    pub(super) fn held_since(&self, camera: CameraId) -> Option<Timestamp> {
        let member = self.members.iter().find(|member| member.camera == camera)?;
        member.hold.map(|hold| hold.since)
    }

    /// Cameras held back without a witness yet, with the time from which on they may have seen what others see.
    pub(super) fn unwitnessed(&self) -> impl Iterator<Item = (CameraId, Timestamp)> {
        let lonely = |member: &Member| {
            let hold = member.hold.filter(|hold| !hold.is_witnessed)?;
            Some((member.camera, hold.since.plus_ns(-BEFORE_NS)))
        };
        self.members.iter().filter_map(lonely)
    }

    /// Another camera sees where they are expected what this one saw.
    pub(super) fn witness(&mut self, camera: CameraId) {
        let member = self.members.iter_mut().find(|member| member.camera == camera);
        let Some(hold) = member.and_then(|member| member.hold.as_mut()) else { return };
        hold.is_witnessed = true;
        let since = hold.since;
        self.tell(HeldBack { camera, since, step: HeldStep::Begun });
    }

    /// A camera whose measurements are to be taken back.
    pub(super) fn take_spoiled(&mut self) -> Option<(CameraId, Timestamp)> {
        self.spoiled.pop()
    }

    /// What became known.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = HeldBack> + '_ {
        self.told.drain(..)
    }

    fn tell(&mut self, step: HeldBack) {
        if self.told.len() < MOST_TOLD {
            self.told.push(step);
        }
    }

    /// Whether a frame is to be used; `gather` tells, if that is in doubt, how far it lies from what all others
    /// or one of them saw.
    pub(super) fn judge(
        &mut self,
        (camera, time): (CameraId, Timestamp),
        surprise: Surprise,
        most_held_ns: i64,
        gather: impl Fn(Inquiry, &mut Vec<Pull>),
    ) -> Passage {
        let index = self.index(camera, time);
        let member = &self.members[index];
        let is_usual = surprise.sum <= member.usual * surprise.count as f64 + UNUSUAL;
        let is_usual = is_usual && self.alarm.is_none_or(|alarm| time.ns_since(alarm) > ALARM_NS);
        let is_due = member.learned.is_none_or(|learned| time.ns_since(learned) >= LEARN_NS);
        if member.hold.is_none() && is_usual && !is_due {
            self.members[index].grow_used_to(surprise);
            return Passage::Calm;
        }
        let is_quiet = member.hold.is_none() && is_usual;
        let mut pulls = std::mem::take(&mut self.pulls);
        let mut fitted = |inquiry: Inquiry| {
            gather(inquiry, &mut pulls);
            shift_of(&pulls, &member.baseline)
        };
        let is_alarming = |it: &Shift| it.gain > ALARMING_GAIN && it.moved_m > LEAST_MOVE_M;
        let turn = (time.as_ns() / LEARN_NS).unsigned_abs();
        let part = Inquiry::part(surprise.count, turn).filter(|_| is_quiet);
        let of_part = part.and_then(&mut fitted).filter(|it| !is_alarming(it));
        let shift = of_part.or_else(|| fitted(Inquiry::whole(None)));
        if shift.as_ref().is_some_and(is_alarming) {
            self.alarm = self.alarm.max(Some(time));
        }
        let moved = shift.filter(|it| it.gain > SURE_GAIN && it.moved_m > LEAST_MOVE_M);
        let passage = if self.members[index].hold.is_some() {
            self.judge_held(index, time, most_held_ns, shift.map(|_| moved.is_some()))
        } else if let Some(shift) = moved.as_ref().filter(|_| time >= self.members[index].from) {
            self.suspect(index, time, (shift, &mut pulls), gather)
        } else {
            self.members[index].grow_used_to(surprise);
            if moved.is_some() { Passage::Open } else { Passage::Calm }
        };
        if is_due && passage != Passage::Closed {
            self.members[index].learn(shift.as_ref(), time);
        }
        self.pulls = pulls;
        passage
    }

    /// What becomes of a frame whose camera seems to have moved.
    fn suspect(
        &mut self,
        index: usize,
        time: Timestamp,
        (shift, pulls): (&Shift, &mut Vec<Pull>),
        gather: impl Fn(Inquiry, &mut Vec<Pull>),
    ) -> Passage {
        let sees = |member: &&Member| pulls.iter().any(|pull| pull.is_by(member.camera));
        let (mut others, mut lonely) = ([None; MOST_SEEING], 1);
        let seeing = self.members.iter().filter(sees);
        for (member, other) in seeing.zip(&mut others) {
            *other = Some(member.camera);
            lonely += usize::from(member.hold.is_some_and(|hold| !hold.is_witnessed));
        }
        let count = others.iter().flatten().count();
        if 2 * lonely > count + 1 {
            // It is the objects that moved.
            for member in &mut self.members {
                member.hold = member.hold.filter(|hold| hold.is_witnessed);
            }
            return Passage::Open;
        }
        match accused(shift, others.into_iter().flatten(), pulls, gather) {
            Accused::Nobody => Passage::Open,
            Accused::Itself => {
                self.hold(index, time);
                Passage::Closed
            }
            Accused::Other(camera) => {
                let of = |member: &Member| member.camera == camera && member.hold.is_none();
                let other = self.members.iter().position(of);
                if let Some(other) = other.filter(|other| time >= self.members[*other].from) {
                    self.hold(other, time);
                }
                Passage::Open
            }
        }
    }

    fn hold(&mut self, index: usize, time: Timestamp) {
        let member = &mut self.members[index];
        member.hold = Some(Hold { since: time, is_witnessed: false, agreed: 0 });
        self.spoiled.push((member.camera, time.plus_ns(-BEFORE_NS)));
    }

    /// The same for a camera that is held back; whether it seems to have moved, if that can be told.
    fn judge_held(
        &mut self,
        index: usize,
        time: Timestamp,
        most_held_ns: i64,
        has_moved: Option<bool>,
    ) -> Passage {
        let member = &mut self.members[index];
        let Some(hold) = &mut member.hold else { return Passage::Open };
        hold.agreed = match has_moved {
            Some(false) => hold.agreed + 1,
            Some(true) => 0,
            None => hold.agreed,
        };
        let (since, is_witnessed) = (hold.since, hold.is_witnessed);
        let held_ns = time.ns_since(since);
        let step = if hold.agreed >= AGREED_FRAMES {
            HeldStep::Agreed
        } else if held_ns > most_held_ns || !is_witnessed && held_ns > WITNESS_NS {
            HeldStep::InVain
        } else {
            return Passage::Closed;
        };
        member.hold = None;
        if step == HeldStep::InVain && is_witnessed {
            member.baseline = Baseline::default();
            member.from = time.plus_ns(SPARED_NS);
        }
        let camera = member.camera;
        if is_witnessed {
            self.tell(HeldBack { camera, since, step });
        }
        Passage::Open
    }

    fn index(&mut self, camera: CameraId, time: Timestamp) -> usize {
        let known = self.members.iter().position(|member| member.camera == camera);
        known.unwrap_or_else(|| {
            self.members.push(Member {
                camera,
                usual: 0.0,
                baseline: Baseline::default(),
                learned: None,
                from: time.plus_ns(WARM_NS),
                hold: None,
            });
            self.members.len() - 1
        })
    }
}

/// Who has moved, a camera with this shift or one of the others, each asked by itself.
fn accused(
    shift: &Shift,
    others: impl Iterator<Item = CameraId>,
    pulls: &mut Vec<Pull>,
    gather: impl Fn(Inquiry, &mut Vec<Pull>),
) -> Accused {
    let (mut asked, mut is_denied) = (0, false);
    let mut gains = [(0.0, CameraId(0)); MOST_SEEING];
    for other in others {
        gather(Inquiry::whole(Some(other)), pulls);
        let gain = shift.gain_of(pulls);
        is_denied |= gain < -SINGLE_GAIN;
        if pulls.len() >= LEAST_SHARED {
            gains[asked] = (gain, other);
            asked += 1;
        }
    }
    let gains = &gains[..asked];
    let Some(&(best, other)) = gains.iter().max_by(|one, two| one.0.total_cmp(&two.0)) else {
        return Accused::Nobody;
    };
    let sure = gains.iter().filter(|(gain, _)| *gain > SINGLE_GAIN).count();
    let rest = gains.iter().map(|(gain, _)| gain).sum::<f64>() - best;
    if 2 * sure > asked && !is_denied {
        Accused::Itself
    } else if asked > 1 && best > SURE_GAIN && rest < REST_GAIN {
        Accused::Other(other)
    } else {
        Accused::Nobody
    }
}

fn shift_of(pulls: &[Pull], baseline: &Baseline) -> Option<Shift> {
    if pulls.len() < LEAST_SHARED { None } else { fit(pulls, baseline) }
}

impl Member {
    fn grow_used_to(&mut self, surprise: Surprise) {
        if surprise.count > 0 {
            let each = surprise.sum / surprise.count as f64;
            self.usual += (each - self.usual) * USUAL_SHARE;
        }
    }

    fn learn(&mut self, shift: Option<&Shift>, time: Timestamp) {
        let since = self.learned.unwrap_or(time);
        if let Some(shift) = shift {
            self.baseline.add(shift, time.seconds_since(since), BASELINE_S);
        }
        self.learned = Some(time);
    }
}
