//! Who is believed to have moved: verdicts on the newest bins, and what follows from several in a row.

use std::collections::BTreeSet;

use super::{
    Post, WINDOWS, Watch,
    attribution::{self, Verdict, is_backed},
    drift::Drift,
    event::WatchEvent,
    pose_fit::Round,
    recovery::Recovery,
};
use roundel_vision::{id::CameraId, rigid::Rigid};

/// Verdicts in a row that are believed, on one who moved …
const MOVED_STREAK: usize = 2;
/// … on that one of several did …
const UNCLEAR_STREAK: usize = 8;
/// … and that this is over.
const AGREED_STREAK: usize = 12;

/// The verdicts on one window, in a row.
#[derive(Clone, Debug, Default)]
pub(super) struct Streak {
    pub(super) posts: Vec<usize>,
    pub(super) is_unclear: bool,
    pub(super) count: usize,
}

impl Watch {
    /// Whether cameras in service agree of late; who does not is named.
    pub(super) fn judge(&mut self) -> bool {
        let mut is_calm = true;
        for (index, window) in WINDOWS.into_iter().enumerate() {
            let places = self.places();
            let rounds = self.rounds(window, &places);
            let verdict = attribution::judge(&rounds, &places, &self.least_moves());
            let (named, is_unclear) = match &verdict {
                Verdict::Agreed => (Vec::new(), false),
                Verdict::Moved(moved) => (moved.iter().map(|(post, _)| *post).collect(), false),
                Verdict::Unclear(posts) => (posts.clone(), true),
            };
            is_calm &= named.is_empty();
            let streak = &mut self.streaks[index];
            if streak.posts == named && streak.is_unclear == is_unclear {
                streak.count += 1;
            } else {
                *streak = Streak { posts: named, is_unclear, count: 1 };
            }
            let count = streak.count;
            if index + 1 == WINDOWS.len() && is_calm && self.bins.len() >= window {
                self.trust(&rounds);
            }
            let is_doubtful = verdict != Verdict::Agreed && self.doubt(&rounds, count);
            match verdict {
                _ if is_doubtful => {}
                Verdict::Moved(moved) if count >= MOVED_STREAK => self.bumped(&moved),
                Verdict::Unclear(posts) if count >= UNCLEAR_STREAK => self.contradict(&posts),
                _ => {}
            }
        }
        let is_over = |streak: &Streak| streak.posts.is_empty() && streak.count >= AGREED_STREAK;
        if self.streaks.iter().all(is_over) {
            self.end_contradiction();
        }
        is_calm && self.contradiction.is_none()
    }

    /// What each camera's view has to be off by to be called bumped.
    fn least_moves(&self) -> Vec<f64> {
        let params = &self.params;
        let least_m = |post: &Post| match (post.is_held, post.is_settled) {
            (true, true) => params.least_held_bump_m,
            (false, false) => params.least_first_bump_m,
            (true, false) | (false, true) => params.least_bump_m,
        };
        self.posts.iter().map(least_m).collect()
    }

    /// Trusts who agrees with others.
    fn trust(&mut self, rounds: &[Round]) {
        for index in 0..self.posts.len() {
            if !self.posts[index].is_trusted && is_backed(rounds, index) {
                self.posts[index].is_trusted = true;
                let camera = self.posts[index].camera;
                self.misplaced.retain(|it| *it != camera);
            }
        }
    }

    /// Whether somebody among those who disagree may never have stood where he was said to; told once.
    fn doubt(&mut self, rounds: &[Round], count: usize) -> bool {
        let seen = rounds.iter().flat_map(Round::posts);
        let doubtful: BTreeSet<CameraId> = seen
            .filter(|post| !self.posts[*post].is_trusted)
            .map(|post| self.posts[post].camera)
            .collect();
        let is_known = doubtful.iter().all(|camera| self.misplaced.contains(camera));
        if count >= UNCLEAR_STREAK && !is_known {
            self.misplaced = doubtful.iter().copied().collect();
            let cameras = self.misplaced.clone();
            self.events.push(WatchEvent::Misplaced { cameras });
        }
        !doubtful.is_empty()
    }

    fn rounds(&self, window: usize, places: &[Option<Rigid>]) -> Vec<Round> {
        let newest = self.bins.iter().rev().take(window).flatten();
        newest.filter_map(|it| Round::of(it, places, window, &self.params)).collect()
    }

    fn bumped(&mut self, moved: &[(usize, Rigid)]) {
        self.end_contradiction();
        for (index, place) in moved {
            let post = &mut self.posts[*index];
            let before = &post.placement.world_from_camera;
            self.events.push(WatchEvent::Bumped {
                camera: post.camera,
                moved_m: (place.translation.vector - before.translation.vector).norm(),
                turned_rad: place.rotation.angle_to(&before.rotation),
            });
            post.recovery = Some(Recovery::new(*place));
            post.is_held = false;
        }
        // What was seen together with them says nothing of the others.
        self.drift = Drift::new(self.posts.len());
        self.streaks = Default::default();
        for post in &mut self.posts {
            if let Some(recovery) = &mut post.recovery {
                recovery.restart();
            }
        }
    }

    fn contradict(&mut self, posts: &[usize]) {
        let mut cameras: Vec<CameraId> =
            posts.iter().map(|post| self.posts[*post].camera).collect();
        cameras.sort_unstable();
        if self.contradiction.as_ref() != Some(&cameras) {
            self.end_contradiction();
            self.events.push(WatchEvent::Contradiction { cameras: cameras.clone() });
            self.contradiction = Some(cameras);
            self.drift = Drift::new(self.posts.len());
        }
    }

    pub(super) fn end_contradiction(&mut self) {
        if let Some(cameras) = self.contradiction.take() {
            self.events.push(WatchEvent::Agreed { cameras });
        }
    }
}
