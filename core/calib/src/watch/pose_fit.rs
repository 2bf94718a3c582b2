//! Meetings held against places: how well they agree, and how one camera would have to stand for that.
//!
//! Camera c at (R, t) has its view p of a roundel at m_c = R p + t with covariance Σ_c, weight W_c = Σ_c⁻¹; all
//! views together have it at p̂ = (Σ W)⁻¹ Σ W m, and disagree by e = Σ (m - p̂)ᵀ W (m - p̂), of which
//! 3 (views - 1) are expected. Against the others' place p̂' with weight W' alone, camera c's residual
//! r = m_c - p̂' has covariance Σ_c + W'⁻¹ and adds rᵀ (Σ_c + W'⁻¹)⁻¹ r to e: what is to be made small over
//! its place, r ≈ r₀ + J δ with δ = (δt, δθ), J = [I | -[R p]×], by Gauss and Newton's steps. Meetings count
//! with Huber's cost ρ(e), linear in √e beyond [`ROBUST`], so that a roundel taken for another pulls little.

use nalgebra::{Matrix3, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector6};

use super::{
    BIN_S, WatchParams,
    co_observation::{Meeting, Roundel, place},
};
use roundel_fusion::track::invert_positive;
use roundel_vision::rigid::Rigid;

/// √e beyond which a meeting's cost grows linearly.
const ROBUST: f64 = 5.0;
/// Steps at most …
const STEPS: usize = 12;
/// … and shorter than this the last one, metres and radians.
const SHORT: f64 = 1e-6;
/// Of what a fit says nothing it finds nothing: deviations of (place, rotation) before it, metres and radians.
const PRIOR: (f64, f64) = (0.5, 0.2);
/// Median of χ² over its degrees of freedom, for about five of these.
const MEDIAN_SHARE: f64 = 0.87;

/// Stands for the post of a known place.
const KNOWN: usize = usize::MAX;

/// One view, in the world.
#[derive(Clone, Copy, Debug)]
struct Look {
    post: usize,
    position_m: Vector3<f64>,
    world_m: Vector3<f64>,
    covariance: Matrix3<f64>,
    weight: Matrix3<f64>,
}

/// A meeting, in the world.
#[derive(Clone, Debug)]
pub(super) struct Round {
    pub(super) roundel: Roundel,
    looks: Vec<Look>,
    /// e, of the looks as they are.
    energy: f64,
}

/// Where a camera would have to stand.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    pub(super) place: Rigid,
    /// (place, rotation), world frame.
    pub(super) covariance: Matrix6<f64>,
    /// Of what it sees by the change, rms, metres.
    pub(super) moved_m: f64,
}

/// J, of what is seen at `arm_m` from the camera, in the world's directions.
pub(super) fn jacobian(arm_m: &Vector3<f64>) -> SMatrix<f64, 3, 6> {
    let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    jacobian
}

/// A place moved by δ.
pub(super) fn moved(place: &Rigid, change: &Vector6<f64>) -> Rigid {
    let turn = UnitQuaternion::from_scaled_axis(change.fixed_rows::<3>(3).into_owned());
    let mut rotation = turn * place.rotation;
    rotation.renormalize();
    let origin_m = place.translation.vector + change.fixed_rows::<3>(0);
    Rigid::from_parts(origin_m.into(), rotation)
}

/// Information about a place before anything is seen.
pub(super) fn prior() -> Matrix6<f64> {
    let (place, turn) = (PRIOR.0.powi(-2), PRIOR.1.powi(-2));
    Matrix6::from_diagonal(&Vector6::new(place, place, place, turn, turn, turn))
}

/// Huber's cost of e, and its slope.
pub(super) fn robust(energy: f64) -> (f64, f64) {
    if energy <= ROBUST * ROBUST {
        (energy, 1.0)
    } else {
        let root = energy.sqrt();
        (2.0 * ROBUST * root - ROBUST * ROBUST, ROBUST / root)
    }
}

impl Round {
    /// Of cameras that stand at `places`, `None` where one is not to be used; `bins` are looked at together.
    pub(super) fn of(
        meeting: &Meeting,
        places: &[Option<Rigid>],
        bins: usize,
        params: &WatchParams,
    ) -> Option<Self> {
        let stays_s = meeting.stood_s.max(2.0 * params.systematic_time_s);
        // An error that stays counts as often as there are bins in the time in which it does.
        let repeats = (stays_s / BIN_S).clamp(1.0, bins.max(1) as f64);
        let share = params.systematic_share;
        let least_m2 = params.least_deviation_m * params.least_deviation_m;
        let mut looks = Vec::with_capacity(meeting.sights.len() + 1);
        for (post, sight) in &meeting.sights {
            let Some(world_from_camera) = places[*post] else { continue };
            let turn = world_from_camera.rotation.to_rotation_matrix().into_inner();
            let scale = share * repeats + (1.0 - share) * sight.fresh;
            let seen = turn * (sight.covariance * scale) * turn.transpose();
            let added = sight.added_m2 + least_m2 * repeats;
            let covariance = seen + Matrix3::from_diagonal_element(added);
            let world_m = place(&world_from_camera, &sight.position_m);
            looks.push(look(*post, sight.position_m, world_m, covariance)?);
        }
        if let Some((world_m, variance_m2)) = meeting.fixed {
            let known = Matrix3::from_diagonal_element(variance_m2 * bins.max(1) as f64);
            looks.push(look(KNOWN, Vector3::zeros(), world_m, known)?);
        }
        let mut round = Self { roundel: meeting.roundel, looks, energy: 0.0 };
        round.energy = round.disagreement();
        (round.looks.len() > 1).then_some(round)
    }

    /// Cameras in it, by post.
    pub(super) fn posts(&self) -> impl Iterator<Item = usize> {
        self.looks.iter().map(|look| look.post).filter(|post| *post != KNOWN)
    }

    /// Place and weight by all looks but those from `without`.
    fn middle(&self, without: Option<usize>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let (mut weight, mut pull) = (Matrix3::zeros(), Vector3::zeros());
        for look in self.looks.iter().filter(|look| Some(look.post) != without) {
            weight += look.weight;
            pull += look.weight * look.world_m;
        }
        let (covariance, _) = invert_positive(&weight)?;
        Some((covariance * pull, covariance))
    }

    /// e.
    pub(super) fn energy(&self) -> f64 {
        self.energy
    }

    fn disagreement(&self) -> f64 {
        let Some((middle_m, _)) = self.middle(None) else { return 0.0 };
        let own = |look: &Look| {
            let apart_m = look.world_m - middle_m;
            apart_m.dot(&(look.weight * apart_m))
        };
        self.looks.iter().map(own).sum()
    }

    /// What is expected of e.
    pub(super) fn freedom(&self) -> f64 {
        3.0 * (self.looks.len() - 1) as f64
    }

    /// Information about all cameras' changes and its product with these, to be added to sums by posts.
    pub(super) fn tell(
        &self,
        places: &[Option<Rigid>],
        mut add: impl FnMut(usize, &Vector6<f64>, &[(usize, Matrix6<f64>)], &Matrix6<f64>),
    ) {
        let Some((middle_m, covariance)) = self.middle(None) else { return };
        let seeing =
            || self.looks.iter().filter_map(|look| Some((look, (*places.get(look.post)?)?)));
        let jacobians: Vec<(usize, Matrix3<f64>, SMatrix<f64, 3, 6>)> = seeing()
            .map(|(look, place)| {
                (look.post, look.weight, jacobian(&(place.rotation * look.position_m)))
            })
            .collect();
        for (own, (look, _)) in seeing().enumerate() {
            let (post, weight, jacobian) = &jacobians[own];
            let score = -(jacobian.transpose() * (weight * (look.world_m - middle_m)));
            let row = jacobian.transpose() * weight;
            let cross = |(other, (to, weight, far)): (
                usize,
                &(usize, Matrix3<f64>, SMatrix<f64, 3, 6>),
            )| {
                let mut block = -(row * covariance * weight * far);
                if other == own {
                    block += row * far;
                }
                (*to, block)
            };
            let blocks: Vec<(usize, Matrix6<f64>)> =
                jacobians.iter().enumerate().map(cross).collect();
            add(*post, &score, &blocks, &(jacobian.transpose() * jacobian));
        }
    }
}

fn look(
    post: usize,
    position_m: Vector3<f64>,
    world_m: Vector3<f64>,
    covariance: Matrix3<f64>,
) -> Option<Look> {
    let (weight, _) = invert_positive(&covariance)?;
    Some(Look { post, position_m, world_m, covariance, weight })
}

/// Robust cost of all rounds.
pub(super) fn cost(rounds: &[Round]) -> f64 {
    rounds.iter().map(|round| robust(round.energy()).0).sum()
}

/// By how much disagreements are larger than expected, in the median, 1 at least: what is left unsaid by
/// covariances counts as noise.
pub(super) fn excess(rounds: &[Round]) -> f64 {
    let mut ratios: Vec<f64> =
        rounds.iter().map(|round| round.energy() / round.freedom()).collect();
    if ratios.is_empty() {
        return 1.0;
    }
    let middle = ratios.len() / 2;
    let (_, median, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
    (*median / MEDIAN_SHARE).max(1.0)
}

/// Information about a camera's change and its product with that, by all rounds as they count now.
fn normal(rounds: &[Round], post: usize, place: &Rigid) -> (Matrix6<f64>, Vector6<f64>) {
    let (mut information, mut score) = (prior(), Vector6::zeros());
    for round in rounds {
        let Some(look) = round.looks.iter().find(|look| look.post == post) else { continue };
        let Some((middle_m, spread)) = round.middle(Some(post)) else { continue };
        let Some((weight, _)) = invert_positive(&(look.covariance + spread)) else { continue };
        let (_, trust) = robust(round.energy());
        let jacobian = jacobian(&(place.rotation * look.position_m));
        let weighted = weight * jacobian * trust;
        information += jacobian.transpose() * weighted;
        score -= weighted.transpose() * (look.world_m - middle_m);
    }
    (information, score)
}

/// What a camera's first step would gain.
pub(super) fn first_gain(rounds: &[Round], post: usize, place: &Rigid) -> f64 {
    let (information, score) = normal(rounds, post, place);
    information.cholesky().map_or(0.0, |factor| score.dot(&factor.solve(&score)))
}

/// Lets a camera stand where the rounds want it, with all others as they are; the rounds see it there.
pub(super) fn release(rounds: &mut [Round], post: usize, from: &Rigid) -> Option<Fit> {
    let mut place_now = *from;
    let mut covariance = Matrix6::zeros();
    for _ in 0..STEPS {
        let (information, score) = normal(rounds, post, &place_now);
        let factor = information.cholesky()?;
        covariance = factor.inverse();
        let change = factor.solve(&score);
        place_now = moved(&place_now, &change);
        for round in rounds.iter_mut() {
            if let Some(look) = round.looks.iter_mut().find(|look| look.post == post) {
                look.world_m = place(&place_now, &look.position_m);
                round.energy = round.disagreement();
            }
        }
        if change.amax() < SHORT {
            break;
        }
    }
    let (mut sum, mut count) = (0.0, 0.0);
    for look in rounds.iter().flat_map(|round| &round.looks).filter(|look| look.post == post) {
        sum += (look.world_m - place(from, &look.position_m)).norm_squared();
        count += 1.0;
    }
    (count > 0.0).then(|| Fit { place: place_now, covariance, moved_m: f64::sqrt(sum / count) })
}
