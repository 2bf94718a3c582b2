//! Disagreement of co-observations, and the camera pose that minimizes it.
//!
//! A camera at (R, t) sees a roundel at p, in the world at m = R p + t with covariance Σ and weight W = Σ⁻¹. All views
//! together have p̂ = (Σ W)⁻¹ Σ W m and the disagreement e = Σ (m - p̂)ᵀ W (m - p̂), with the expectation 3 (views - 1).
//! Relative to the mean p̂' of the other views with weight W', the residual r = m - p̂' of one camera has the covariance
//! Σ + W'⁻¹ and contributes rᵀ (Σ + W'⁻¹)⁻¹ r to e. This is minimized over the pose, r ≈ r₀ + J δ with δ = (δt, δθ) and
//! J = [I | -[R p]×], by Gauss-Newton steps with Huber's cost ρ(e), linear in √e beyond [`HUBER`].

use nalgebra::{Matrix3, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector6};

use super::{
    BIN_S, WatchParams,
    co_observation::{CoObservation, Roundel, to_world},
};
use crate::robust::median;
use roundel_fusion::track::invert_positive;
use roundel_vision::rigid::Rigid;

/// √e beyond which the cost grows linearly.
const HUBER: f64 = 5.0;
/// Maximum number of steps …
const STEPS: usize = 12;
/// … and length at which they end, metres and radians.
const SHORT: f64 = 1e-6;
/// Prior deviations of position and rotation, metres and radians.
const PRIOR: (f64, f64) = (0.5, 0.2);
/// Median of χ² over its degrees of freedom, for about five of them.
const MEDIAN_SHARE: f64 = 0.87;

const LANDMARK: usize = usize::MAX;

#[derive(Clone, Copy, Debug)]
struct WorldView {
    slot: usize,
    position_m: Vector3<f64>,
    world_m: Vector3<f64>,
    covariance: Matrix3<f64>,
    weight: Matrix3<f64>,
}

#[derive(Clone, Debug)]
pub(super) struct Comparison {
    pub(super) roundel: Roundel,
    world_views: Vec<WorldView>,
    /// Disagreement e of the current views.
    pub(super) energy: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct PoseFit {
    pub(super) pose: Rigid,
    /// (position, rotation), world frame.
    pub(super) covariance: Matrix6<f64>,
    /// Rms displacement of its observations by the change, metres.
    pub(super) moved_m: f64,
}

/// J for a point at `arm_m` from the camera, world axes.
pub(super) fn jacobian(arm_m: &Vector3<f64>) -> SMatrix<f64, 3, 6> {
    let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    jacobian
}

pub(super) fn moved(pose: &Rigid, change: &Vector6<f64>) -> Rigid {
    let turn = UnitQuaternion::from_scaled_axis(change.fixed_rows::<3>(3).into_owned());
    let mut rotation = turn * pose.rotation;
    rotation.renormalize();
    let origin_m = pose.translation.vector + change.fixed_rows::<3>(0);
    Rigid::from_parts(origin_m.into(), rotation)
}

/// Prior information about a pose.
pub(super) fn prior() -> Matrix6<f64> {
    let (pose, turn) = (PRIOR.0.powi(-2), PRIOR.1.powi(-2));
    Matrix6::from_diagonal(&Vector6::new(pose, pose, pose, turn, turn, turn))
}

/// Huber's cost of e, and its derivative.
pub(super) fn huber(energy: f64) -> (f64, f64) {
    if energy <= HUBER * HUBER {
        (energy, 1.0)
    } else {
        let root = energy.sqrt();
        (2.0 * HUBER * root - HUBER * HUBER, HUBER / root)
    }
}

impl Comparison {
    /// Views of cameras at `poses`, `None` for those not in use; `bins` are judged together.
    pub(super) fn of(
        group: &CoObservation,
        poses: &[Option<Rigid>],
        bins: usize,
        params: &WatchParams,
    ) -> Option<Self> {
        let stays_s = group.rest_s.max(2.0 * params.systematic_time_s);
        // A persistent error counts once per bin for as long as it persists.
        let repeats = (stays_s / BIN_S).clamp(1.0, bins.max(1) as f64);
        let share = params.systematic_share;
        let min_m2 = params.min_deviation_m * params.min_deviation_m;
        let mut world_views = Vec::with_capacity(group.views.len() + 1);
        for (slot, view) in &group.views {
            let Some(world_from_camera) = poses[*slot] else { continue };
            let turn = world_from_camera.rotation.to_rotation_matrix().into_inner();
            let scale = share * repeats + (1.0 - share) * view.fresh;
            let seen = turn * (view.covariance * scale) * turn.transpose();
            let added = view.added_m2 + min_m2 * repeats;
            let covariance = seen + Matrix3::from_diagonal_element(added);
            let world_m = to_world(&world_from_camera, &view.position_m);
            world_views.push(world_view(*slot, view.position_m, world_m, covariance)?);
        }
        if let Some((world_m, variance_m2)) = group.fixed {
            let known = Matrix3::from_diagonal_element(variance_m2 * bins.max(1) as f64);
            world_views.push(world_view(LANDMARK, Vector3::zeros(), world_m, known)?);
        }
        let mut comparison = Self { roundel: group.roundel, world_views, energy: 0.0 };
        comparison.energy = comparison.disagreement();
        (comparison.world_views.len() > 1).then_some(comparison)
    }

    pub(super) fn slots(&self) -> impl Iterator<Item = usize> {
        self.world_views.iter().map(|world_view| world_view.slot).filter(|slot| *slot != LANDMARK)
    }

    /// Position and covariance from all views except those of `without`.
    fn mean_without(&self, without: Option<usize>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let (mut weight, mut pull) = (Matrix3::zeros(), Vector3::zeros());
        for view in self.world_views.iter().filter(|view| Some(view.slot) != without) {
            weight += view.weight;
            pull += view.weight * view.world_m;
        }
        let (covariance, _) = invert_positive(&weight)?;
        Some((covariance * pull, covariance))
    }

    fn disagreement(&self) -> f64 {
        let Some((middle_m, _)) = self.mean_without(None) else { return 0.0 };
        let own = |world_view: &WorldView| {
            let apart_m = world_view.world_m - middle_m;
            apart_m.dot(&(world_view.weight * apart_m))
        };
        self.world_views.iter().map(own).sum()
    }

    /// Expected disagreement.
    pub(super) fn degrees_of_freedom(&self) -> f64 {
        3.0 * (self.world_views.len() - 1) as f64
    }

    /// Passes the gradient, the information blocks and Jᵀ J of each camera to `add`.
    pub(super) fn accumulate(
        &self,
        poses: &[Option<Rigid>],
        mut add: impl FnMut(usize, &Vector6<f64>, &[(usize, Matrix6<f64>)], &Matrix6<f64>),
    ) {
        let Some((middle_m, covariance)) = self.mean_without(None) else { return };
        let with_jacobian = |view: &WorldView| {
            let pose = (*poses.get(view.slot)?)?;
            Some((*view, jacobian(&(pose.rotation * view.position_m))))
        };
        let views: Vec<(WorldView, SMatrix<f64, 3, 6>)> =
            self.world_views.iter().filter_map(with_jacobian).collect();
        for (own, jacobian) in &views {
            let score = -(jacobian.transpose() * (own.weight * (own.world_m - middle_m)));
            let row = jacobian.transpose() * own.weight;
            let block = |(other, far): &(WorldView, SMatrix<f64, 3, 6>)| {
                let mut block = -(row * covariance * other.weight * far);
                if other.slot == own.slot {
                    block += row * far;
                }
                (other.slot, block)
            };
            let blocks: Vec<(usize, Matrix6<f64>)> = views.iter().map(block).collect();
            add(own.slot, &score, &blocks, &(jacobian.transpose() * jacobian));
        }
    }
}

fn world_view(
    slot: usize,
    position_m: Vector3<f64>,
    world_m: Vector3<f64>,
    covariance: Matrix3<f64>,
) -> Option<WorldView> {
    let (weight, _) = invert_positive(&covariance)?;
    Some(WorldView { slot, position_m, world_m, covariance, weight })
}

pub(super) fn cost(comparisons: &[Comparison]) -> f64 {
    comparisons.iter().map(|comparison| huber(comparison.energy).0).sum()
}

/// Median ratio of disagreements to their expectation, at least 1. Covers errors that covariances do not state.
pub(super) fn excess(comparisons: &[Comparison]) -> f64 {
    let ratio = |it: &Comparison| it.energy / it.degrees_of_freedom();
    let mut ratios: Vec<f64> = comparisons.iter().map(ratio).collect();
    median(&mut ratios).map_or(1.0, |median| (median / MEDIAN_SHARE).max(1.0))
}

/// Information and gradient of a camera's pose with robust weights.
fn normal(comparisons: &[Comparison], slot: usize, pose: &Rigid) -> (Matrix6<f64>, Vector6<f64>) {
    let (mut information, mut score) = (prior(), Vector6::zeros());
    for comparison in comparisons {
        let own = comparison.world_views.iter().find(|view| view.slot == slot);
        let Some(world_view) = own else { continue };
        let Some((middle_m, spread)) = comparison.mean_without(Some(slot)) else { continue };
        let Some((weight, _)) = invert_positive(&(world_view.covariance + spread)) else {
            continue;
        };
        let (_, trust) = huber(comparison.energy);
        let jacobian = jacobian(&(pose.rotation * world_view.position_m));
        let weighted = weight * jacobian * trust;
        information += jacobian.transpose() * weighted;
        score -= weighted.transpose() * (world_view.world_m - middle_m);
    }
    (information, score)
}

/// Gain of a camera's first step.
pub(super) fn first_gain(comparisons: &[Comparison], slot: usize, pose: &Rigid) -> f64 {
    let (information, score) = normal(comparisons, slot, pose);
    information.cholesky().map_or(0.0, |factor| score.dot(&factor.solve(&score)))
}

/// Minimizes the cost over one camera's pose with all others fixed, and updates the comparisons.
pub(super) fn fit_pose(
    comparisons: &mut [Comparison],
    slot: usize,
    from: &Rigid,
) -> Option<PoseFit> {
    let mut place_now = *from;
    let mut covariance = Matrix6::zeros();
    for _ in 0..STEPS {
        let (information, score) = normal(comparisons, slot, &place_now);
        let factor = information.cholesky()?;
        covariance = factor.inverse();
        let change = factor.solve(&score);
        place_now = moved(&place_now, &change);
        for comparison in comparisons.iter_mut() {
            let world_view = comparison.world_views.iter_mut().find(|view| view.slot == slot);
            if let Some(world_view) = world_view {
                world_view.world_m = to_world(&place_now, &world_view.position_m);
                comparison.energy = comparison.disagreement();
            }
        }
        if change.amax() < SHORT {
            break;
        }
    }
    let (mut sum, mut count) = (0.0, 0.0);
    let views = comparisons.iter().flat_map(|comparison| &comparison.world_views);
    for view in views.filter(|view| view.slot == slot) {
        sum += (view.world_m - to_world(from, &view.position_m)).norm_squared();
        count += 1.0;
    }
    (count > 0.0).then(|| PoseFit { pose: place_now, covariance, moved_m: f64::sqrt(sum / count) })
}
