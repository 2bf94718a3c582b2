//! Sequences of verdicts on the newest bins, and the actions that follow.

use std::collections::BTreeSet;

use super::{
    CameraSlot, WINDOWS, Watch,
    attribution::{self, Verdict, has_enough_roundels},
    drift::Drift,
    event::WatchEvent,
    pose_fit::Comparison,
    recovery::Recovery,
};
use roundel_vision::{id::CameraId, rigid::Rigid};

/// Identical verdicts required for a moved camera …
const MOVED_STREAK: usize = 2;
/// … for a contradiction …
const UNCLEAR_STREAK: usize = 8;
/// … and for the end of one.
const AGREED_STREAK: usize = 12;

#[derive(Clone, Debug, Default)]
pub(super) struct Streak {
    pub(super) slots: Vec<usize>,
    pub(super) is_unclear: bool,
    pub(super) count: usize,
}

impl Watch {
    /// Updates the verdicts of all windows; returns whether all cameras in use agree.
    pub(super) fn update_verdicts(&mut self) -> bool {
        let mut is_calm = true;
        for (index, window) in WINDOWS.into_iter().enumerate() {
            let poses = self.poses();
            let comparisons = self.comparisons(window, &poses);
            let verdict = attribution::attribute(&comparisons, &poses, &self.min_moves());
            let (named, is_unclear) = match &verdict {
                Verdict::Agreed => (Vec::new(), false),
                Verdict::Moved(moved) => (moved.iter().map(|(slot, _)| *slot).collect(), false),
                Verdict::Unclear(slots) => (slots.clone(), true),
            };
            is_calm &= named.is_empty();
            let streak = &mut self.streaks[index];
            if streak.slots == named && streak.is_unclear == is_unclear {
                streak.count += 1;
            } else {
                *streak = Streak { slots: named, is_unclear, count: 1 };
            }
            let count = streak.count;
            if index + 1 == WINDOWS.len() && is_calm && self.bins.len() >= window {
                self.trust(&comparisons);
            }
            let is_doubtful = verdict != Verdict::Agreed && self.doubt(&comparisons, count);
            match verdict {
                _ if is_doubtful => {}
                Verdict::Moved(moved) if count >= MOVED_STREAK => self.bumped(&moved),
                Verdict::Unclear(slots) if count >= UNCLEAR_STREAK => self.contradict(&slots),
                _ => {}
            }
        }
        let is_over = |streak: &Streak| streak.slots.is_empty() && streak.count >= AGREED_STREAK;
        if self.streaks.iter().all(is_over) {
            self.end_contradiction();
        }
        is_calm && self.contradiction.is_none()
    }

    /// Displacement of its views for which each camera counts as moved.
    fn min_moves(&self) -> Vec<f64> {
        let params = &self.params;
        let min_m = |slot: &CameraSlot| match (slot.is_held, slot.is_settled) {
            (true, true) => params.min_held_bump_m,
            (false, false) => params.min_first_bump_m,
            (true, false) | (false, true) => params.min_bump_m,
        };
        self.slots.iter().map(min_m).collect()
    }

    fn trust(&mut self, comparisons: &[Comparison]) {
        for index in 0..self.slots.len() {
            if !self.slots[index].is_trusted && has_enough_roundels(comparisons, index) {
                self.slots[index].is_trusted = true;
                let camera = self.slots[index].camera;
                self.misplaced.retain(|it| *it != camera);
            }
        }
    }

    /// Whether a disagreeing camera has a manually entered pose; reports it once.
    fn doubt(&mut self, comparisons: &[Comparison], count: usize) -> bool {
        let seen = comparisons.iter().flat_map(Comparison::slots);
        let doubtful: BTreeSet<CameraId> = seen
            .filter(|slot| !self.slots[*slot].is_trusted)
            .map(|slot| self.slots[slot].camera)
            .collect();
        let is_known = doubtful.iter().all(|camera| self.misplaced.contains(camera));
        if count >= UNCLEAR_STREAK && !is_known {
            self.misplaced = doubtful.iter().copied().collect();
            let cameras = self.misplaced.clone();
            self.events.push(WatchEvent::Misplaced { cameras });
        }
        !doubtful.is_empty()
    }

    fn comparisons(&self, window: usize, poses: &[Option<Rigid>]) -> Vec<Comparison> {
        let newest = self.bins.iter().rev().take(window).flatten();
        newest.filter_map(|it| Comparison::of(it, poses, window, &self.params)).collect()
    }

    fn bumped(&mut self, moved: &[(usize, Rigid)]) {
        self.end_contradiction();
        for (index, pose) in moved {
            let slot = &mut self.slots[*index];
            let before = &slot.placement.world_from_camera;
            self.events.push(WatchEvent::Bumped {
                camera: slot.camera,
                moved_m: (pose.translation.vector - before.translation.vector).norm(),
                turned_rad: pose.rotation.angle_to(&before.rotation),
            });
            slot.recovery = Some(Recovery::new(*pose));
            slot.is_held = false;
        }
        // Common evidence with moved cameras is invalid.
        self.drift = Drift::new(self.slots.len());
        self.streaks = Default::default();
        for slot in &mut self.slots {
            if let Some(recovery) = &mut slot.recovery {
                recovery.restart();
            }
        }
    }

    fn contradict(&mut self, slots: &[usize]) {
        let mut cameras: Vec<CameraId> =
            slots.iter().map(|slot| self.slots[*slot].camera).collect();
        cameras.sort_unstable();
        if self.contradiction.as_ref() != Some(&cameras) {
            self.end_contradiction();
            self.events.push(WatchEvent::Contradiction { cameras: cameras.clone() });
            self.contradiction = Some(cameras);
            self.drift = Drift::new(self.slots.len());
        }
    }

    pub(super) fn end_contradiction(&mut self) {
        if let Some(cameras) = self.contradiction.take() {
            self.events.push(WatchEvent::Agreed { cameras });
        }
    }
}
