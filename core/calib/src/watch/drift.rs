//! Slow drift, from exponentially fading sums of the disagreements of all cameras.
//!
//! With the residuals e = m - p̂ ([`super::pose_fit`]), the information Λ and gradient η of all poses are accumulated.
//! Freeing the camera c alone moves it by δ = Λ_cc⁻¹ η_c with the gain η_cᵀ Λ_cc⁻¹ η_c. After a correction by δ, the sums
//! are updated as if observed from the new pose: η ← η - Λ_·c δ.

use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::{
    BIN_S, Watch, WatchEvent, WatchParams,
    co_observation::CoObservation,
    pose_fit::{Comparison, huber, moved, prior},
};
use roundel_vision::rigid::Rigid;

/// Smaller gains are noise: about five deviations with six degrees of freedom.
const SURE_GAIN: f64 = 45.0;
/// Minimum margin to the gain of the next camera.
const CLEAR_GAIN: f64 = 20.0;
/// Interval of the checks, bins.
const EVERY: i64 = 8;
/// Minimum share of the window that must be filled.
const MIN_SHARE: f64 = 0.7;

const NUMBERS: usize = 6;

/// Estimated displacement of a camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offset {
    pub(super) change: Vector6<f64>,
    pub(super) covariance: Matrix6<f64>,
    /// Displacement of its observations, rms, metres.
    pub(super) moved_m: f64,
    gain: f64,
}

/// Fading sums.
#[derive(Clone, Debug, Default)]
pub(super) struct Drift {
    information: DMatrix<f64>,
    score: DVector<f64>,
    /// Sum of Jᵀ J and count, by camera.
    levers: Vec<(Matrix6<f64>, f64)>,
    energy: f64,
    degrees_of_freedom: f64,
    /// Filled share of the window, 0 to 1.
    filled: f64,
}

impl Drift {
    pub(super) fn new(slots: usize) -> Self {
        let mut drift = Self::default();
        (0..slots).for_each(|_| drift.grow());
        drift
    }

    /// Fades by one bin and adds its comparisons.
    pub(super) fn add(
        &mut self,
        comparisons: &[Comparison],
        poses: &[Option<Rigid>],
        params: &WatchParams,
    ) {
        let kept = (-BIN_S / params.drift_window_s).exp();
        self.information *= kept;
        self.score *= kept;
        self.energy *= kept;
        self.degrees_of_freedom *= kept;
        self.filled = self.filled * kept + (1.0 - kept);
        for (lever, count) in &mut self.levers {
            *lever *= kept;
            *count *= kept;
        }
        for comparison in comparisons {
            let (cost, trust) = huber(comparison.energy);
            self.energy += cost;
            self.degrees_of_freedom += comparison.degrees_of_freedom();
            comparison.accumulate(poses, |slot, score, blocks, lever| {
                let row = slot * NUMBERS;
                let mut own = self.score.fixed_rows_mut::<NUMBERS>(row);
                own += score * trust;
                for (other, block) in blocks {
                    let column = other * NUMBERS;
                    let mut sum = self.information.fixed_view_mut::<NUMBERS, NUMBERS>(row, column);
                    sum += block * trust;
                }
                self.levers[slot].0 += lever;
                self.levers[slot].1 += 1.0;
            });
        }
    }

    /// Displacement of a camera; `None` without observations.
    pub(super) fn offset(&self, slot: usize) -> Option<Offset> {
        let (lever, count) = self.levers.get(slot)?;
        if *count < 1e-3 {
            return None;
        }
        let at = slot * NUMBERS;
        let own = self.information.fixed_view::<NUMBERS, NUMBERS>(at, at) + prior();
        let score = self.score.fixed_rows::<NUMBERS>(at).into_owned();
        let factor = own.cholesky()?;
        let change = factor.solve(&score);
        Some(Offset {
            change,
            covariance: factor.inverse() * self.excess(),
            moved_m: (change.dot(&(lever * change)) / count).max(0.0).sqrt(),
            gain: change.dot(&score),
        })
    }

    pub(super) fn is_filled(&self) -> bool {
        self.filled >= MIN_SHARE
    }

    /// Ratio of disagreements to their expectation, at least 1.
    fn excess(&self) -> f64 {
        if self.degrees_of_freedom > 0.0 {
            (self.energy / self.degrees_of_freedom).max(1.0)
        } else {
            1.0
        }
    }

    /// The drifting camera, if it is unambiguous.
    pub(super) fn drifting_camera(&self, params: &WatchParams) -> Option<(usize, Offset)> {
        if !self.is_filled() {
            return None;
        }
        let offsets = (0..self.levers.len()).filter_map(|slot| Some((slot, self.offset(slot)?)));
        let mut offsets: Vec<(usize, Offset)> = offsets.collect();
        offsets.sort_by(|one, other| other.1.gain.total_cmp(&one.1.gain));
        let (slot, best) = *offsets.first()?;
        let next = offsets.get(1).map_or(0.0, |(_, next)| next.gain);
        let scale = self.excess();
        let is_sure = best.gain > SURE_GAIN * scale && best.gain - next > CLEAR_GAIN * scale;
        (is_sure && best.moved_m > params.min_drift_m).then_some((slot, best))
    }

    pub(super) fn grow(&mut self) {
        self.levers.push((Matrix6::zeros(), 0.0));
        let numbers = self.levers.len() * NUMBERS;
        self.information.resize_mut(numbers, numbers, 0.0);
        self.score.resize_vertically_mut(numbers, 0.0);
    }

    /// Removes a camera's pose by marginalization: Λ ← Λ - Λ_·c Λ_cc⁻¹ Λ_c·, η ← η - Λ_·c Λ_cc⁻¹ η_c. Information
    /// about the other cameras remains.
    pub(super) fn forget(&mut self, slot: usize) {
        let at = slot * NUMBERS;
        let own = self.information.fixed_view::<NUMBERS, NUMBERS>(at, at) + prior();
        if let Some(factor) = own.cholesky() {
            let column = self.information.fixed_columns::<NUMBERS>(at).into_owned();
            let score = self.score.fixed_rows::<NUMBERS>(at).into_owned();
            self.score -= &column * factor.solve(&score);
            self.information -= &column * factor.inverse() * column.transpose();
        }
        self.information.fixed_columns_mut::<NUMBERS>(at).fill(0.0);
        self.information.fixed_rows_mut::<NUMBERS>(at).fill(0.0);
        self.score.fixed_rows_mut::<NUMBERS>(at).fill(0.0);
        self.levers[slot] = (Matrix6::zeros(), 0.0);
    }
}

impl Watch {
    /// Adds a bin and corrects a drifting camera.
    pub(super) fn follow_drift(&mut self, groups: &[CoObservation], bin: i64) {
        let poses = self.poses();
        // Persistent errors count once per bin over the whole window.
        let window = (self.params.drift_window_s / BIN_S) as usize;
        let of = |group: &CoObservation| Comparison::of(group, &poses, window, &self.params);
        let comparisons: Vec<Comparison> = groups.iter().filter_map(of).collect();
        self.drift.add(&comparisons, &poses, &self.params);
        if bin.rem_euclid(EVERY) != 0 {
            return;
        }
        let Some((index, offset)) = self.drift.drifting_camera(&self.params) else {
            self.mark_settled();
            return;
        };
        let column = self.drift.information.fixed_columns::<NUMBERS>(index * NUMBERS);
        self.drift.score -= column * offset.change;
        let slot = &mut self.slots[index];
        let pose = &mut slot.placement;
        pose.world_from_camera = moved(&pose.world_from_camera, &offset.change);
        self.events.push(WatchEvent::Drifted {
            camera: slot.camera,
            placement: *pose,
            moved_m: offset.moved_m,
        });
    }

    /// Marks the cameras that have agreed with others for a window.
    fn mark_settled(&mut self) {
        for (index, slot) in self.slots.iter_mut().enumerate() {
            let offset = self.drift.offset(index).filter(|_| self.drift.is_filled());
            slot.is_settled |= offset.is_some_and(|it| it.moved_m < 0.5 * self.params.min_bump_m);
        }
    }
}
