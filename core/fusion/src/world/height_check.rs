//! Whether what drives is as high as was said.
//!
//! A wrong height is not harmless: every track is held to it, so that sightings do not fit the tracks that they
//! belong to, each camera sees the object elsewhere on the wrong plane, and ghosts come and go. What a camera
//! measures, held to nothing, gives it away: d = z - h with the variance v = σ_z² + σ_floor². A frame is off if
//! even the sighting of the kind that fits best has d² > 16 v (some robots may be carried about, but not
//! all), by the mean of its d weighted by 1/v. A camera doubts the height when nearly all of
//! [`SAMPLES`] frames, [`EVERY_S`] apart, are off, and the height is told as wrong when one camera has doubted it
//! twice in a row and all that have an opinion doubt it and agree on d, the median.
//!
//! Cameras that disagree have wrong places rather, which is not told here; and a wrong diameter, which all
//! of them see alike, cannot be told from a wrong height.

use std::collections::BTreeMap;

use super::{identity::Subject, params::FLOOR_M};
use crate::track::Measurement;
use roundel_vision::{
    id::{BodyId, CameraId, KindId},
    time::Timestamp,
};

/// Frames in a camera's opinion.
const SAMPLES: usize = 64;
/// No two of them are closer, seconds.
const EVERY_S: f64 = 0.1;
/// So many of them are off, of a camera that doubts.
const MOST: usize = 58;
/// A sighting further off than this many deviations is off.
const SIGMAS: f64 = 4.0;
/// Heights as wrong as this do no harm, metres.
const LEAST_M: f64 = 0.02;
/// Cameras that agree differ by no more than this part of the distance.
const AGREE: f64 = 0.25;

/// Objects that cameras see at another height than was said of them.
#[derive(Clone, Debug, PartialEq)]
pub struct WrongHeight {
    /// Their kind.
    pub kind: Option<KindId>,
    /// Which body, if it is one.
    pub body: Option<BodyId>,
    /// What was said of the kind's roundels, or of the body's origin, metres.
    pub said_m: f64,
    /// What the cameras see, metres.
    pub seen_m: f64,
    /// Who agrees on that.
    pub cameras: Vec<CameraId>,
}

/// The sightings of a frame.
#[derive(Clone, Copy, Debug)]
struct Look {
    frame: u64,
    time: Timestamp,
    /// Distances over variances, and these inverted, summed.
    weighted: [f64; 2],
    /// Of the one that fits best.
    sigmas: f64,
}

/// What one camera makes of one height.
#[derive(Clone, Debug)]
struct Opinion {
    frame: Option<Look>,
    /// Distances of frames that are off.
    off_m: [f64; SAMPLES],
    off: usize,
    samples: usize,
    voice: Voice,
    /// Doubted so often in a row.
    rounds: u32,
}

/// What it came to, last.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Voice {
    /// Too little seen so far.
    Silent,
    Content,
    /// By the median distance.
    Doubts(f64),
}

/// All cameras' opinions of one height.
#[derive(Clone, Debug, Default)]
struct Floor {
    opinions: BTreeMap<CameraId, Opinion>,
    is_told: bool,
}

/// Every height that was said.
#[derive(Clone, Debug, Default)]
pub(super) struct Floors {
    floors: BTreeMap<Subject, Floor>,
    wrong: Vec<WrongHeight>,
}

impl Opinion {
    fn new() -> Self {
        let voice = Voice::Silent;
        Self { frame: None, off_m: [0.0; SAMPLES], off: 0, samples: 0, voice, rounds: 0 }
    }

    /// Takes one sighting; true when the opinion has been formed anew.
    fn add(&mut self, look: Look) -> bool {
        let Some(before) = &mut self.frame else {
            self.frame = Some(look);
            return false;
        };
        if before.frame == look.frame {
            before.sigmas = before.sigmas.min(look.sigmas);
            before.weighted[0] += look.weighted[0];
            before.weighted[1] += look.weighted[1];
            return false;
        }
        if look.time.seconds_since(before.time) < EVERY_S {
            return false;
        }
        let whole = std::mem::replace(before, look);
        if whole.sigmas > SIGMAS {
            self.off_m[self.off] = whole.weighted[0] / whole.weighted[1];
            self.off += 1;
        }
        self.samples += 1;
        if self.samples < SAMPLES {
            return false;
        }
        self.off_m[..self.off].sort_unstable_by(f64::total_cmp);
        let median_m = self.off_m[self.off / 2];
        let doubts = self.off >= MOST && median_m.abs() > LEAST_M;
        self.voice = if doubts { Voice::Doubts(median_m) } else { Voice::Content };
        self.rounds = if doubts { self.rounds.saturating_add(1) } else { 0 };
        (self.off, self.samples) = (0, 0);
        true
    }
}

impl Floor {
    /// The mean distance of all who have an opinion, if they all doubt and agree.
    fn agreed_m(&self) -> Option<f64> {
        let (mut sum_m, mut count) = (0.0, 0.0);
        let (mut least_m, mut most_m) = (f64::INFINITY, f64::NEG_INFINITY);
        for opinion in self.opinions.values() {
            match opinion.voice {
                Voice::Silent => continue,
                Voice::Content => return None,
                Voice::Doubts(off_m) => {
                    (least_m, most_m) = (least_m.min(off_m), most_m.max(off_m));
                    sum_m += off_m;
                    count += 1.0;
                }
            }
        }
        let mean_m: f64 = sum_m / count;
        (count > 0.0 && most_m - least_m <= AGREE * mean_m.abs()).then_some(mean_m)
    }
}

impl Floors {
    /// Forgets what cameras made of a height that is another now.
    pub(super) fn forget(&mut self, subject: &Subject) {
        self.floors.remove(subject);
    }

    /// Takes a sighting of what is held at `held_m`, which was told as `said_m`.
    pub(super) fn note(
        &mut self,
        subject: Subject,
        seen: &Measurement,
        (held_m, said_m): (f64, f64),
    ) {
        let floor = self.floors.entry(subject).or_default();
        let opinion = floor.opinions.entry(seen.camera).or_insert_with(Opinion::new);
        let off_m = seen.position_m.z - held_m;
        let variance = seen.position_noise.total[(2, 2)] + FLOOR_M * FLOOR_M;
        let look = Look {
            frame: seen.frame,
            time: seen.time,
            weighted: [off_m / variance, 1.0 / variance],
            sigmas: off_m.abs() / variance.sqrt(),
        };
        if !opinion.add(look) {
            return;
        }
        let is_sure = opinion.rounds >= 2;
        let Some(agreed_m) = floor.agreed_m() else {
            floor.is_told = false;
            return;
        };
        if is_sure && !floor.is_told {
            floor.is_told = true;
            let doubting = |(&camera, opinion): (&CameraId, &Opinion)| {
                matches!(opinion.voice, Voice::Doubts(_)).then_some(camera)
            };
            self.wrong.push(WrongHeight {
                kind: subject.kind,
                body: subject.body,
                said_m,
                seen_m: said_m + agreed_m,
                cameras: floor.opinions.iter().filter_map(doubting).collect(),
            });
        }
    }

    /// What was found out since the last call.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = WrongHeight> + '_ {
        self.wrong.drain(..)
    }
}
