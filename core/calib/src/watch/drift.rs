//! Slow drift: sums over the last minute or so, of all cameras' disagreements.
//!
//! With meetings' residuals e = m - p̂ ([`super::pose_fit`]), information Λ and score η of all cameras' changes are
//! summed and fade with time. Freeing camera c with all others held would move it by δ = Λ_cc⁻¹ η_c and gain
//! η_cᵀ Λ_cc⁻¹ η_c. Once a place is changed by δ, what was summed is as if seen from there: η ← η - Λ_·c δ.

use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::{
    BIN_S, Watch, WatchEvent, WatchParams,
    co_observation::Meeting,
    pose_fit::{Round, moved, prior, robust},
};
use roundel_vision::rigid::Rigid;

/// A gain below this is chance: about five deviations, with six numbers free.
const SURE_GAIN: f64 = 45.0;
/// The next best camera's gain is so much less.
const CLEAR_GAIN: f64 = 20.0;
/// It is looked at every so many bins.
const EVERY: i64 = 8;
/// Sums tell nothing before so much of a window has passed.
const LEAST_SHARE: f64 = 0.7;

/// Numbers of a camera.
const NUMBERS: usize = 6;

/// How far a camera is off, as the others see it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offset {
    pub(super) change: Vector6<f64>,
    pub(super) covariance: Matrix6<f64>,
    /// Of what it sees, rms, metres.
    pub(super) moved_m: f64,
    gain: f64,
}

/// Sums that fade.
#[derive(Clone, Debug, Default)]
pub(super) struct Drift {
    information: DMatrix<f64>,
    score: DVector<f64>,
    /// Of Jᵀ J and its count, by camera.
    arms: Vec<(Matrix6<f64>, f64)>,
    energy: f64,
    freedom: f64,
    /// How full the window is, 0 to 1.
    filled: f64,
}

impl Drift {
    /// Nothing seen by so many cameras.
    pub(super) fn new(posts: usize) -> Self {
        Self {
            information: DMatrix::zeros(posts * NUMBERS, posts * NUMBERS),
            score: DVector::zeros(posts * NUMBERS),
            arms: vec![(Matrix6::zeros(), 0.0); posts],
            energy: 0.0,
            freedom: 0.0,
            filled: 0.0,
        }
    }

    /// Lets a bin's time pass and takes in what was seen in it.
    pub(super) fn add(&mut self, rounds: &[Round], places: &[Option<Rigid>], params: &WatchParams) {
        let kept = (-BIN_S / params.drift_window_s).exp();
        self.information *= kept;
        self.score *= kept;
        self.energy *= kept;
        self.freedom *= kept;
        self.filled = self.filled * kept + (1.0 - kept);
        for (arm, count) in &mut self.arms {
            *arm *= kept;
            *count *= kept;
        }
        for round in rounds {
            let (cost, trust) = robust(round.energy());
            self.energy += cost;
            self.freedom += round.freedom();
            round.tell(places, |post, score, blocks, arm| {
                let row = post * NUMBERS;
                let mut own = self.score.fixed_rows_mut::<NUMBERS>(row);
                own += score * trust;
                for (other, block) in blocks {
                    let column = other * NUMBERS;
                    let mut sum = self.information.fixed_view_mut::<NUMBERS, NUMBERS>(row, column);
                    sum += block * trust;
                }
                self.arms[post].0 += arm;
                self.arms[post].1 += 1.0;
            });
        }
    }

    /// How far a camera is off; `None` if nothing was seen of it.
    pub(super) fn offset(&self, post: usize) -> Option<Offset> {
        let (arm, count) = self.arms.get(post)?;
        if *count < 1e-3 {
            return None;
        }
        let at = post * NUMBERS;
        let own = self.information.fixed_view::<NUMBERS, NUMBERS>(at, at) + prior();
        let score = self.score.fixed_rows::<NUMBERS>(at).into_owned();
        let factor = own.cholesky()?;
        let change = factor.solve(&score);
        Some(Offset {
            change,
            covariance: factor.inverse() * self.excess(),
            moved_m: (change.dot(&(arm * change)) / count).max(0.0).sqrt(),
            gain: change.dot(&score),
        })
    }

    /// Whether there is enough in the sums.
    pub(super) fn is_filled(&self) -> bool {
        self.filled >= LEAST_SHARE
    }

    /// By how much disagreements are larger than expected.
    fn excess(&self) -> f64 {
        if self.freedom > 0.0 { (self.energy / self.freedom).max(1.0) } else { 1.0 }
    }

    /// The camera that is off, if one clearly is.
    pub(super) fn adrift(&self, params: &WatchParams) -> Option<(usize, Offset)> {
        if !self.is_filled() {
            return None;
        }
        let offsets = (0..self.arms.len()).filter_map(|post| Some((post, self.offset(post)?)));
        let mut offsets: Vec<(usize, Offset)> = offsets.collect();
        offsets.sort_by(|one, other| other.1.gain.total_cmp(&one.1.gain));
        let (post, best) = *offsets.first()?;
        let next = offsets.get(1).map_or(0.0, |(_, next)| next.gain);
        let scale = self.excess();
        let is_sure = best.gain > SURE_GAIN * scale && best.gain - next > CLEAR_GAIN * scale;
        (is_sure && best.moved_m > params.least_drift_m).then_some((post, best))
    }

    /// Takes in one more camera.
    pub(super) fn grow(&mut self) {
        self.arms.push((Matrix6::zeros(), 0.0));
        let numbers = self.arms.len() * NUMBERS;
        self.information.resize_mut(numbers, numbers, 0.0);
        self.score.resize_vertically_mut(numbers, 0.0);
    }

    /// Forgets where a camera stands: what the others' sums owe to that is taken out, Λ ← Λ - Λ_·c Λ_cc⁻¹ Λ_c·,
    /// η ← η - Λ_·c Λ_cc⁻¹ η_c, and what they know of one another stays.
    pub(super) fn forget(&mut self, post: usize) {
        let at = post * NUMBERS;
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
        self.arms[post] = (Matrix6::zeros(), 0.0);
    }

    /// Says that a camera's place was changed.
    pub(super) fn change(&mut self, post: usize, change: &Vector6<f64>) {
        let column = self.information.fixed_columns::<NUMBERS>(post * NUMBERS);
        self.score -= column * change;
    }
}

impl Watch {
    /// Takes a bin into the slow sums, and corrects who drifted.
    pub(super) fn follow(&mut self, meetings: &[Meeting], bin: i64) {
        let places = self.places();
        // Over the sums' whole time, errors that stay count as often as there are bins in it.
        let window = (self.params.drift_window_s / BIN_S) as usize;
        let of = |meeting: &Meeting| Round::of(meeting, &places, window, &self.params);
        let rounds: Vec<Round> = meetings.iter().filter_map(of).collect();
        self.drift.add(&rounds, &places, &self.params);
        if bin.rem_euclid(EVERY) != 0 {
            return;
        }
        let Some((index, offset)) = self.drift.adrift(&self.params) else {
            self.settle();
            return;
        };
        self.drift.change(index, &offset.change);
        let post = &mut self.posts[index];
        let place = &mut post.placement;
        place.world_from_camera = moved(&place.world_from_camera, &offset.change);
        self.events.push(WatchEvent::Drifted {
            camera: post.camera,
            placement: *place,
            moved_m: offset.moved_m,
        });
    }

    /// Notes who has agreed with others for a while.
    fn settle(&mut self) {
        for (index, post) in self.posts.iter_mut().enumerate() {
            let offset = self.drift.offset(index).filter(|_| self.drift.is_filled());
            post.is_settled |= offset.is_some_and(|it| it.moved_m < 0.5 * self.params.least_bump_m);
        }
    }
}
