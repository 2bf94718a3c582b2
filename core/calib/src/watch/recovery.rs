//! Where a camera stands that was bumped: from its own views since then against what others see.
//!
//! While its place over a second and over the second before differ, it still moves, and all is begun anew.
//! From then on its place is taken over all that was seen since it rests, until that is known well enough, and
//! held against what is seen in the second after, which it was not made from.

use std::collections::{BTreeSet, VecDeque};

use nalgebra::{Point3, Vector6};

use super::{
    BIN_S, WatchParams,
    co_observation::{Meeting, Roundel},
    pose_fit::{Fit, Round, cost, excess, release},
};
use roundel_vision::rigid::{Rigid, mahalanobis_squared};

/// Bins of a look at whether it rests, and of the last check.
const LOOK_BINS: usize = 4;
/// Bins kept.
const MOST_BINS: usize = 240;
/// Two looks that differ by more are of a camera that moves: χ² of 6 beyond 1 - 10⁻⁶, and metres.
const MOVES_SQUARED: f64 = 40.0;
const MOVES_M: f64 = 1e-3;
/// The same in the last check.
const WRONG_SQUARED: f64 = 40.0;
const WRONG_M: f64 = 1.5e-3;

/// A camera out of service.
#[derive(Clone, Debug)]
pub(super) struct Recovery {
    /// As far as is known.
    pub(super) place: Rigid,
    /// A bin's meetings with cameras in service, the newest last.
    bins: VecDeque<Vec<Meeting>>,
    /// Bins without any, one after another.
    pub(super) idle_bins: usize,
    candidate: Option<Fit>,
    checked: usize,
}

impl Recovery {
    pub(super) fn new(place: Rigid) -> Self {
        Self { place, bins: VecDeque::new(), idle_bins: 0, candidate: None, checked: 0 }
    }

    /// What it saw together with that camera is not to be used.
    pub(super) fn forget(&mut self, post: usize) {
        self.bins.iter_mut().flatten().for_each(|meeting| meeting.forget(post));
        self.candidate = None;
    }

    /// With whom it met: landmarks, and other cameras by post.
    pub(super) fn met(&self, post: usize) -> (BTreeSet<Roundel>, BTreeSet<usize>) {
        let met = || {
            let meetings = self.bins.iter().flatten();
            meetings.filter(|meeting| meeting.sights.iter().any(|(it, _)| *it == post))
        };
        let fixed = met().filter(|meeting| meeting.fixed.is_some());
        let others = met().flat_map(|meeting| meeting.sights.iter().map(|(other, _)| *other));
        (fixed.map(|meeting| meeting.roundel).collect(), others.filter(|it| *it != post).collect())
    }

    /// What was seen so far is not to be used.
    pub(super) fn restart(&mut self) {
        *self = Self::new(self.place);
    }

    /// Takes in a bin; where it stands, once that is sure. `others` has the places of cameras in service.
    pub(super) fn advance(
        &mut self,
        post: usize,
        meetings: &[Meeting],
        others: &[Option<Rigid>],
        params: &WatchParams,
    ) -> Option<Fit> {
        let is_told = |meeting: &&Meeting| {
            let sees = |wanted: bool| {
                meeting.sights.iter().any(|(it, _)| {
                    if wanted { *it == post } else { *it != post && others[*it].is_some() }
                })
            };
            sees(true) && (sees(false) || meeting.fixed.is_some())
        };
        let told: Vec<Meeting> = meetings.iter().filter(is_told).cloned().collect();
        if told.is_empty() {
            self.idle_bins += 1;
            return None;
        }
        self.idle_bins = 0;
        self.bins.push_back(told);
        if self.bins.len() > MOST_BINS {
            self.bins.pop_front();
        }
        let count = self.bins.len();
        if let Some(fit) = self.candidate {
            self.checked += 1;
            if self.checked < LOOK_BINS {
                return None;
            }
            self.candidate = None;
            let newest = self.look(count - LOOK_BINS..count, post, others, params)?;
            if differ(&fit, &newest, (WRONG_SQUARED, WRONG_M)) {
                self.restart();
                return None;
            }
            return Some(fit);
        }
        if count < 2 * LOOK_BINS || !count.is_multiple_of(LOOK_BINS) {
            return None;
        }
        let before = self.look(count - 2 * LOOK_BINS..count - LOOK_BINS, post, others, params);
        let newest = self.look(count - LOOK_BINS..count, post, others, params)?;
        self.place = newest.place;
        if before.is_none_or(|before| differ(&before, &newest, (MOVES_SQUARED, MOVES_M))) {
            self.bins.drain(..count - LOOK_BINS);
            return None;
        }
        let all = self.look(0..count, post, others, params)?;
        self.place = all.place;
        let [off_m, off_rad] = deviations(&all);
        let seconds = count as f64 * BIN_S;
        let is_good = |times: f64| {
            off_m < times * params.return_deviation_m
                && off_rad < times * params.return_deviation_rad
        };
        if is_good(1.0) || seconds >= params.return_after_s && is_good(4.0) {
            self.candidate = Some(all);
            self.checked = 0;
        }
        None
    }

    fn look(
        &self,
        bins: std::ops::Range<usize>,
        post: usize,
        others: &[Option<Rigid>],
        params: &WatchParams,
    ) -> Option<Fit> {
        let mut places = others.to_vec();
        places[post] = Some(self.place);
        let count = bins.len();
        let mut rounds: Vec<Round> = self
            .bins
            .range(bins)
            .flatten()
            .filter_map(|meeting| Round::of(meeting, &places, count, params))
            .collect();
        let fit = release(&mut rounds, post, &self.place)?;
        debug_assert!(cost(&rounds).is_finite());
        Some(Fit { covariance: fit.covariance * excess(&rounds), ..fit })
    }
}

/// Of (place m, rotation rad), each as the root of its trace.
pub(super) fn deviations(fit: &Fit) -> [f64; 2] {
    [0, 3].map(|corner| fit.covariance.fixed_view::<3, 3>(corner, corner).trace().sqrt())
}

/// Whether two places, found from different sights, are not the same.
fn differ(one: &Fit, other: &Fit, (most_squared, most_m): (f64, f64)) -> bool {
    let shift = other.place.translation.vector - one.place.translation.vector;
    let turn = (other.place.rotation * one.place.rotation.inverse()).scaled_axis();
    let change = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
    let squared = mahalanobis_squared(&change, &(one.covariance + other.covariance));
    seen_m(one, other) > most_m && squared.is_none_or(|squared| squared > most_squared)
}

/// How far what one place sees a few metres ahead is from what the other sees there.
fn seen_m(one: &Fit, other: &Fit) -> f64 {
    let ahead = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]].map(|[x, y]| Point3::new(x, y, 4.0));
    ahead.iter().map(|point| (one.place * point - other.place * point).norm()).fold(0.0, f64::max)
}
