//! Pose of a camera from the landmarks in one frame.
//!
//! A landmark is a roundel at a known position w in the world, mostly with known orientation Q. A detection at p in the
//! camera frame with orientation C has, for the camera's pose (R, t), the residuals
//!
//! e_p = w - R p - t, e_θ = log(Q (R C)⁻¹)
//!
//! with the detection's covariance Σ rotated by R, plus that of the landmark itself. With δx = (δt, δθ), e_p ≈ [I -[R
//! p]×] δx and e_θ ≈ [0 I] δx. Gauss-Newton minimizes Σ eᵀ W e over all landmarks in view. The covariance is (Σ Aᵀ W
//! A)⁻¹, of which each cause has the part Σ Kᵢ Σᵢ Kᵢᵀ, Kᵢ = (Σ Aᵀ W A)⁻¹ Aᵢᵀ Wᵢ. For a roundel without a code, e_θ
//! rotates the normal only.
//!
//! An ellipse allows two normals. Each landmark with a code and a known orientation gives a start for either; three or
//! more known positions give another ([`super::super::reference::align`]), and the expected pose a last one. From each
//! start every detection takes the normal that fits better. Different results remain as hypotheses, weighted by their
//! costs: one landmark has two; several that are not in one plane nearly always leave one.

use nalgebra::{Matrix3, Matrix6, Rotation3, SMatrix, UnitQuaternion, Vector3, Vector6};

use crate::track::smallest_turn;
use crate::world::{
    measurement::orientations,
    reference::{self, PLACE_SIGMA_M, align},
};
use roundel_vision::{
    id::{KindId, TrackNumber},
    marker::Code,
    pose::RoundelPose,
    rigid::{
        Covariance6, Rigid, UNKNOWN_ANGLE_VARIANCE_RAD2, mahalanobis_squared, rotate_covariance,
    },
};

/// Default standard deviation of a landmark's orientation about each axis, radians: a print hung by hand.
pub const TURN_SIGMA_RAD: f64 = 0.01;
/// Largest number of Gauss-Newton steps from each start.
const STEPS: usize = 8;
/// Step length that ends the iteration, m and rad.
const MIN_STEP: f64 = 1e-7;
/// Squared Mahalanobis length below which two results are the same.
const SAME_SQUARED: f64 = 4.0;
/// Squared residual above which a detection is not the landmark (χ², 6 degrees of freedom, 1 - 10⁻⁸).
const OUTLIER_SQUARED: f64 = 50.0;
/// Largest rms uncertainty of a usable rotation, radians.
const MAX_ROTATION_DEVIATION_RAD: f64 = 0.3;

/// A roundel at a known position in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmark {
    /// Kind of the roundel.
    pub kind: KindId,
    /// Its code; `None` if it has none and is identified by its position.
    pub code: Option<Code>,
    /// Centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each coordinate, metres.
    pub position_deviation_m: f64,
    /// world_from_roundel, if known; only the z axis counts for a plain roundel.
    pub orientation: Option<UnitQuaternion<f64>>,
    /// Standard deviation of the orientation about each axis, radians.
    pub orientation_deviation_rad: f64,
}

impl Landmark {
    /// A landmark measured with a tape and hung by hand, of unknown orientation.
    pub fn new(kind: KindId, code: Option<Code>, position_m: Vector3<f64>) -> Self {
        Self {
            kind,
            code,
            position_m,
            position_deviation_m: PLACE_SIGMA_M,
            orientation: None,
            orientation_deviation_rad: TURN_SIGMA_RAD,
        }
    }
}

/// A landmark with its detection, in the camera frame at the frame's time.
#[derive(Clone, Debug)]
pub(crate) struct LandmarkMatch {
    pub(crate) landmark: Landmark,
    pub(crate) number: TrackNumber,
    pub(crate) pose: RoundelPose,
}

/// A pose that explains the detections.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseSolution {
    pub(crate) world_from_camera: Rigid,
    /// Parts of the covariance by the detections and by the landmarks.
    pub(crate) observed: Covariance6,
    pub(crate) stated_covariance: Covariance6,
    /// -2 ln likelihood up to a constant.
    pub(crate) cost: f64,
}

impl PoseSolution {
    pub(crate) fn covariance(&self) -> Covariance6 {
        self.observed + self.stated_covariance
    }
}

/// Residual of one detection at a given pose.
struct Residual {
    error: Vector6<f64>,
    jacobian: Matrix6<f64>,
    observed: Covariance6,
    stated_covariance: Covariance6,
    weight: Matrix6<f64>,
    cost: f64,
}

/// The poses that explain the detections of landmarks, best first, at most two. Empty if they contradict each
/// other or determine too little. Removes landmarks from `pairs` that contradict the others.
pub(crate) fn solve_camera_pose(
    pairs: &mut Vec<LandmarkMatch>,
    expected: Option<&Rigid>,
) -> Vec<PoseSolution> {
    loop {
        let mut solutions = solutions(pairs, expected);
        let Some(best) = solutions.first() else { return solutions };
        let worst = pairs
            .iter()
            .enumerate()
            .filter_map(|(index, pair)| {
                Some((index, residual(pair, &best.world_from_camera)?.cost))
            })
            .max_by(|one, other| one.1.total_cmp(&other.1));
        match worst {
            Some((index, cost)) if cost > OUTLIER_SQUARED => {
                if pairs.len() < 3 {
                    // With two left, the wrong one is unknown.
                    return Vec::new();
                }
                pairs.remove(index);
            }
            _ => {
                solutions.truncate(2);
                return solutions;
            }
        }
    }
}

fn solutions(pairs: &[LandmarkMatch], expected: Option<&Rigid>) -> Vec<PoseSolution> {
    let mut starts: Vec<Rigid> = expected.copied().into_iter().collect();
    for pair in
        pairs.iter().filter(|pair| pair.pose.yaw_rad.is_some() && pair.pose.yaw_symmetry == 1)
    {
        let Some(turned) = pair.landmark.orientation else { continue };
        starts.extend(orientations(&pair.pose).map(|observed| {
            let rotation = turned * observed.inverse();
            let origin_m = pair.landmark.position_m - rotation * pair.pose.position_m;
            Rigid::from_parts(origin_m.into(), rotation)
        }));
    }
    let world_m: Vec<_> = pairs.iter().map(|pair| pair.landmark.position_m).collect();
    let observed: Vec<_> = pairs.iter().map(|pair| reference::Sighting::from(&pair.pose)).collect();
    starts.extend(align(&world_m, &observed).map(|placement| placement.world_from_camera));
    let mut found: Vec<PoseSolution> = Vec::new();
    for end in starts.into_iter().filter_map(|start| gauss_newton(pairs, start)) {
        let is_same = |other: &&mut PoseSolution| {
            let pose_difference = pose_difference(&end.world_from_camera, &other.world_from_camera);
            let spread = end.covariance() + other.covariance();
            mahalanobis_squared(&pose_difference, &spread)
                .is_some_and(|square| square < SAME_SQUARED)
        };
        match found.iter_mut().find(is_same) {
            Some(other) if end.cost < other.cost => *other = end,
            Some(_) => {}
            None => found.push(end),
        }
    }
    found.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    found
}

/// Difference of two poses: translation, and rotation vector in the world.
pub(crate) fn pose_difference(from: &Rigid, to: &Rigid) -> Vector6<f64> {
    let moved = to.translation.vector - from.translation.vector;
    let turned = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(moved.x, moved.y, moved.z, turned.x, turned.y, turned.z)
}

fn gauss_newton(pairs: &[LandmarkMatch], mut place: Rigid) -> Option<PoseSolution> {
    for _ in 0..STEPS {
        let (mut information, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
        for pair in pairs {
            let residual = residual(pair, &place)?;
            let weighted = residual.jacobian.transpose() * residual.weight;
            information += weighted * residual.jacobian;
            gradient += weighted * residual.error;
        }
        let step = information.cholesky()?.solve(&gradient);
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        let moved_m = place.translation.vector + step.fixed_rows::<3>(0);
        place = Rigid::from_parts(moved_m.into(), turn * place.rotation);
        if step.norm() < MIN_STEP {
            break;
        }
    }
    let residuals: Vec<Residual> =
        pairs.iter().map(|pair| residual(pair, &place)).collect::<Option<_>>()?;
    let mut information = Matrix6::zeros();
    for residual in &residuals {
        information += residual.jacobian.transpose() * residual.weight * residual.jacobian;
    }
    let inverse = information.cholesky()?.inverse();
    let (mut observed, mut stated_covariance) = (Covariance6::zeros(), Covariance6::zeros());
    for residual in &residuals {
        let gain = inverse * residual.jacobian.transpose() * residual.weight;
        observed += gain * residual.observed * gain.transpose();
        stated_covariance += gain * residual.stated_covariance * gain.transpose();
    }
    let cost = residuals.iter().map(|residual| residual.cost).sum::<f64>();
    let turn = (observed + stated_covariance).fixed_view::<3, 3>(3, 3).trace();
    let is_valid_pose =
        cost.is_finite() && turn < MAX_ROTATION_DEVIATION_RAD * MAX_ROTATION_DEVIATION_RAD;
    is_valid_pose.then_some(PoseSolution {
        world_from_camera: place,
        observed,
        stated_covariance,
        cost,
    })
}

/// By the normal that fits the pose better.
fn residual(pair: &LandmarkMatch, place: &Rigid) -> Option<Residual> {
    let (pose, landmark) = (&pair.pose, &pair.landmark);
    let arm_m = place.rotation * pose.position_m;
    let error_m = landmark.position_m - arm_m - place.translation.vector;
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    let turned = rotate_covariance(&place.rotation, &pose.covariance);
    let variance = landmark.position_deviation_m * landmark.position_deviation_m;
    let angle_variance = landmark.orientation_deviation_rad * landmark.orientation_deviation_rad;
    let mut stated_covariance = Covariance6::from_diagonal_element(variance);
    stated_covariance
        .fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&Matrix3::from_diagonal_element(angle_variance));
    let Some(stated) = landmark.orientation else {
        return position_residual(&turned, &stated_covariance, &error_m, jacobian);
    };
    let has_yaw = pose.yaw_rad.is_some() && pose.yaw_symmetry == 1;
    let candidates = orientations(pose).map(|turn| place.rotation * turn);
    let likelihood = pose.normal_likelihood.clamp(1e-3, 1.0 - 1e-3);
    let mut best: Option<Residual> = None;
    for (candidate, likelihood) in candidates.into_iter().zip([likelihood, 1.0 - likelihood]) {
        let normal = candidate * Vector3::z();
        let mirrored = smallest_turn(&(candidates[0] * Vector3::z()), &normal);
        let turn = Rotation3::new(mirrored);
        let mut whole = Matrix6::identity();
        whole.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
        let mut angle = (stated * candidate.inverse()).scaled_axis();
        let mut unknown = Matrix3::zeros();
        if !has_yaw {
            let about = normal * normal.transpose();
            let across = (Matrix3::identity() - about) * turn.matrix();
            whole.fixed_view_mut::<3, 3>(3, 3).copy_from(&across);
            unknown = about * UNKNOWN_ANGLE_VARIANCE_RAD2;
            angle = smallest_turn(&normal, &(stated * Vector3::z()));
        }
        let mut observed = whole * turned * whole.transpose();
        let mut rotation = observed.fixed_view_mut::<3, 3>(3, 3);
        rotation += unknown;
        let mut error = Vector6::zeros();
        error.fixed_rows_mut::<3>(0).copy_from(&error_m);
        error.fixed_rows_mut::<3>(3).copy_from(&angle);
        let weight = (observed + stated_covariance).cholesky()?.inverse();
        let cost = error.dot(&(weight * error)) - 2.0 * likelihood.ln();
        if best.as_ref().is_none_or(|best| cost < best.cost) {
            best = Some(Residual { error, jacobian, observed, stated_covariance, weight, cost });
        }
    }
    best
}

/// For a landmark of unknown orientation.
fn position_residual(
    turned: &Covariance6,
    stated_covariance: &Covariance6,
    error_m: &Vector3<f64>,
    jacobian: Matrix6<f64>,
) -> Option<Residual> {
    let total: Matrix3<f64> = (turned + stated_covariance).fixed_view::<3, 3>(0, 0).into_owned();
    let inverse = total.cholesky()?.inverse();
    let lift: SMatrix<f64, 6, 3> = SMatrix::identity();
    let weight = lift * inverse * lift.transpose();
    let cost = error_m.dot(&(inverse * error_m));
    Some(Residual {
        error: lift * error_m,
        jacobian,
        observed: *turned,
        stated_covariance: *stated_covariance,
        weight,
        cost,
    })
}
