//! Finds the new pose of a moved camera from its views since then.
//!
//! While its poses over consecutive seconds differ, the camera still moves and the search restarts. Then its pose is
//! estimated from all views since it rests until the precision suffices, and is finally checked against the views of
//! another second.

use std::collections::{BTreeSet, VecDeque};

use nalgebra::{Point3, Vector6};

use super::{
    BIN_S, WatchParams,
    co_observation::{CoObservation, Roundel},
    pose_fit::{Comparison, PoseFit, cost, excess, fit_pose},
};
use roundel_vision::rigid::{Rigid, mahalanobis_squared};

/// Bins of a pose estimate for the check of rest, and of the final check.
const CHECK_BINS: usize = 4;
const MAX_BINS: usize = 240;
/// Poses that differ by more than both limits indicate motion: χ² of 6 beyond 1 - 10⁻⁶, and metres.
const MOVES_SQUARED: f64 = 40.0;
const MOVES_M: f64 = 1e-3;
/// The same for the final check.
const REJECTED_SQUARED: f64 = 40.0;
const REJECTED_M: f64 = 1.5e-3;

/// A camera that is not in use.
#[derive(Clone, Debug)]
pub(super) struct Recovery {
    pub(super) pose: Rigid,
    /// Co-observations with cameras in use by bin, the newest last.
    bins: VecDeque<Vec<CoObservation>>,
    candidate: Option<PoseFit>,
    checked: usize,
}

impl Recovery {
    pub(super) fn new(pose: Rigid) -> Self {
        Self { pose, bins: VecDeque::new(), candidate: None, checked: 0 }
    }

    /// Drops the views of another camera.
    pub(super) fn forget(&mut self, slot: usize) {
        self.bins.iter_mut().flatten().for_each(|group| group.forget(slot));
        self.candidate = None;
    }

    /// Landmarks and slots of other cameras that it shares roundels with.
    pub(super) fn counterparts(&self, slot: usize) -> (BTreeSet<Roundel>, BTreeSet<usize>) {
        let counterparts = || {
            let groups = self.bins.iter().flatten();
            groups.filter(|group| group.views.iter().any(|(it, _)| *it == slot))
        };
        let fixed = counterparts().filter(|group| group.fixed.is_some());
        let others = counterparts().flat_map(|group| group.views.iter().map(|(other, _)| *other));
        (fixed.map(|group| group.roundel).collect(), others.filter(|it| *it != slot).collect())
    }

    pub(super) fn restart(&mut self) {
        *self = Self::new(self.pose);
    }

    /// Adds a bin; returns the pose once it is confirmed. `others` are the poses of cameras in use.
    pub(super) fn advance(
        &mut self,
        slot: usize,
        groups: &[CoObservation],
        others: &[Option<Rigid>],
        params: &WatchParams,
    ) -> Option<PoseFit> {
        let is_usable = |group: &&CoObservation| {
            let mut slots = group.views.iter().map(|(slot, _)| *slot);
            let is_known = |it: usize| it != slot && others[it].is_some();
            slots.clone().any(|it| it == slot) && (group.fixed.is_some() || slots.any(is_known))
        };
        let usable: Vec<CoObservation> = groups.iter().filter(is_usable).cloned().collect();
        if usable.is_empty() {
            return None;
        }
        self.bins.push_back(usable);
        if self.bins.len() > MAX_BINS {
            self.bins.pop_front();
        }
        let count = self.bins.len();
        if let Some(fit) = self.candidate {
            self.checked += 1;
            if self.checked < CHECK_BINS {
                return None;
            }
            self.candidate = None;
            let newest = self.fit_bins(count - CHECK_BINS..count, slot, others, params)?;
            if differ(&fit, &newest, REJECTED_SQUARED, REJECTED_M) {
                self.restart();
                return None;
            }
            return Some(fit);
        }
        if count < 2 * CHECK_BINS || !count.is_multiple_of(CHECK_BINS) {
            return None;
        }
        let before =
            self.fit_bins(count - 2 * CHECK_BINS..count - CHECK_BINS, slot, others, params);
        let newest = self.fit_bins(count - CHECK_BINS..count, slot, others, params)?;
        self.pose = newest.pose;
        if before.is_none_or(|before| differ(&before, &newest, MOVES_SQUARED, MOVES_M)) {
            self.bins.drain(..count - CHECK_BINS);
            return None;
        }
        let all = self.fit_bins(0..count, slot, others, params)?;
        self.pose = all.pose;
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

    fn fit_bins(
        &self,
        bins: std::ops::Range<usize>,
        slot: usize,
        others: &[Option<Rigid>],
        params: &WatchParams,
    ) -> Option<PoseFit> {
        let mut poses = others.to_vec();
        poses[slot] = Some(self.pose);
        let count = bins.len();
        let compared = |group: &CoObservation| Comparison::of(group, &poses, count, params);
        let mut comparisons: Vec<Comparison> =
            self.bins.range(bins).flatten().filter_map(compared).collect();
        let fit = fit_pose(&mut comparisons, slot, &self.pose)?;
        debug_assert!(cost(&comparisons).is_finite());
        Some(PoseFit { covariance: fit.covariance * excess(&comparisons), ..fit })
    }
}

/// Standard deviations of position, metres, and rotation, radians: square roots of the traces.
fn deviations(fit: &PoseFit) -> [f64; 2] {
    [0, 3].map(|corner| fit.covariance.fixed_view::<3, 3>(corner, corner).trace().sqrt())
}

/// Whether two poses from different views differ significantly.
fn differ(one: &PoseFit, other: &PoseFit, max_squared: f64, max_m: f64) -> bool {
    let shift = other.pose.translation.vector - one.pose.translation.vector;
    let turn = (other.pose.rotation * one.pose.rotation.inverse()).scaled_axis();
    let change = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
    let squared = mahalanobis_squared(&change, &(one.covariance + other.covariance));
    displacement_m(one, other) > max_m && squared.is_none_or(|squared| squared > max_squared)
}

/// Maximum distance between the views of two poses a few metres ahead.
fn displacement_m(one: &PoseFit, other: &PoseFit) -> f64 {
    let ahead = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]].map(|[x, y]| Point3::new(x, y, 4.0));
    ahead.iter().map(|point| (one.pose * point - other.pose * point).norm()).fold(0.0, f64::max)
}
