//! Where a camera is, from the landmarks in one frame: the observations of a standing camera, turned round.
//!
//! A landmark is a roundel whose place in the world is known: its centre w, and mostly how it is turned,
//! Q. A detection of it at p in the camera, turned by C, gives for the camera's pose (R, t) the errors
//!
//! e_p = w - R p - t,  e_θ = log(Q (R C)⁻¹)
//!
//! with the detection's covariance Σ turned by R, and that of the landmark's own place beside. With
//! δx = (δt, δθ), e_p ≈ [I -[R p]×] δx and e_θ ≈ [0 I] δx: Gauss and Newton's steps minimize Σ eᵀ W e
//! over all landmarks in view, and (Σ Aᵀ W A)⁻¹ is the covariance, of which each cause has its part
//! Σ Kᵢ Σᵢ Kᵢᵀ, Kᵢ = (Σ Aᵀ W A)⁻¹ Aᵢᵀ Wᵢ. Of a roundel without a code, e_θ turns the normal only.
//!
//! An ellipse allows two normals. Each landmark with a code and a known orientation gives a start for
//! either, three or more in known places another ([`super::reference::align`]), and where the carrier is
//! expected a last one. From each start every detection takes the normal that suits it. Different ends
//! stay hypotheses, weighed by how well each explains what is seen: one landmark has two, of several
//! that are not in one plane nearly always one is left.

use nalgebra::{Matrix3, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector6};

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

/// Standard deviation of a landmark's stated orientation, about each axis: a print hung by hand, radians.
pub const TURN_SIGMA_RAD: f64 = 0.01;
/// Gauss and Newton's steps from each start.
const STEPS: usize = 8;
/// A step shorter than this ends them, m and rad.
const SHORT: f64 = 1e-7;
/// Two ends no further apart than this are one, squared Mahalanobis length.
const SAME_SQUARED: f64 = 4.0;
/// A landmark further off than this is something else (χ², 6 degrees of freedom, 1 - 10⁻⁸).
const OUTLIER_SQUARED: f64 = 50.0;
/// A camera whose rotation is known no better than this, rms, has no place, radians.
const MOST_TURN_RAD: f64 = 0.3;

/// A roundel whose place in the world is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmark {
    /// Its kind.
    pub kind: KindId,
    /// Its code; `None` where it has none and is known by where it is.
    pub code: Option<Code>,
    /// Centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// Standard deviation of that, each coordinate, metres.
    pub position_deviation_m: f64,
    /// world_from_roundel, where known; of a plain roundel its z alone counts.
    pub orientation: Option<UnitQuaternion<f64>>,
    /// Standard deviation of that, about each axis, radians.
    pub orientation_deviation_rad: f64,
}

impl Landmark {
    /// One that was measured with a tape and hung by hand.
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

/// A landmark as it is seen, in the camera's frame at one instant.
#[derive(Clone, Debug)]
pub(in crate::world) struct Pair {
    pub(in crate::world) landmark: Landmark,
    pub(in crate::world) number: TrackNumber,
    pub(in crate::world) pose: RoundelPose,
}

/// A place that explains what is seen.
#[derive(Clone, Copy, Debug)]
pub(in crate::world) struct Solution {
    pub(in crate::world) world_from_camera: Rigid,
    /// From what cameras see, and from where the landmarks are.
    pub(in crate::world) seen: Covariance6,
    pub(in crate::world) placed: Covariance6,
    /// -2 ln likelihood, up to a constant.
    pub(in crate::world) cost: f64,
}

impl Solution {
    pub(in crate::world) fn covariance(&self) -> Covariance6 {
        self.seen + self.placed
    }
}

/// One detection's say, given where the camera is.
struct Say {
    error: Vector6<f64>,
    jacobian: Matrix6<f64>,
    seen: Covariance6,
    placed: Covariance6,
    weight: Matrix6<f64>,
    cost: f64,
}

/// The places that explain what is seen of landmarks, the best first, two at most; none if it contradicts
/// itself or says too little. Landmarks that fit with no others are taken out of `pairs`.
pub(in crate::world) fn solve(pairs: &mut Vec<Pair>, expected: Option<&Rigid>) -> Vec<Solution> {
    loop {
        let mut solutions = ends(pairs, expected);
        let Some(best) = solutions.first() else { return solutions };
        let worst = pairs
            .iter()
            .enumerate()
            .filter_map(|(index, pair)| Some((index, say(pair, &best.world_from_camera)?.cost)))
            .max_by(|one, other| one.1.total_cmp(&other.1));
        match worst {
            Some((index, cost)) if cost > OUTLIER_SQUARED => {
                if pairs.len() < 3 {
                    // Which of two is wrong cannot be said.
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

fn ends(pairs: &[Pair], expected: Option<&Rigid>) -> Vec<Solution> {
    let mut starts: Vec<Rigid> = expected.copied().into_iter().collect();
    for pair in
        pairs.iter().filter(|pair| pair.pose.yaw_rad.is_some() && pair.pose.yaw_symmetry == 1)
    {
        let Some(turned) = pair.landmark.orientation else { continue };
        starts.extend(orientations(&pair.pose).map(|seen| {
            let rotation = turned * seen.inverse();
            let origin_m = pair.landmark.position_m - rotation * pair.pose.position_m;
            Rigid::from_parts(origin_m.into(), rotation)
        }));
    }
    let world_m: Vec<_> = pairs.iter().map(|pair| pair.landmark.position_m).collect();
    let seen: Vec<_> = pairs.iter().map(|pair| reference::Sighting::from(&pair.pose)).collect();
    starts.extend(align(&world_m, &seen).map(|placement| placement.world_from_camera));
    let mut found: Vec<Solution> = Vec::new();
    for end in starts.into_iter().filter_map(|start| descend(pairs, start)) {
        let is_same = |other: &&mut Solution| {
            let apart = apart(&end.world_from_camera, &other.world_from_camera);
            let spread = end.covariance() + other.covariance();
            mahalanobis_squared(&apart, &spread).is_some_and(|square| square < SAME_SQUARED)
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

/// From one place to another: translation, and rotation vector in the world.
pub(in crate::world) fn apart(from: &Rigid, to: &Rigid) -> Vector6<f64> {
    let moved = to.translation.vector - from.translation.vector;
    let turned = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(moved.x, moved.y, moved.z, turned.x, turned.y, turned.z)
}

fn descend(pairs: &[Pair], mut place: Rigid) -> Option<Solution> {
    for _ in 0..STEPS {
        let (mut information, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
        for pair in pairs {
            let say = say(pair, &place)?;
            let weighted = say.jacobian.transpose() * say.weight;
            information += weighted * say.jacobian;
            gradient += weighted * say.error;
        }
        let step = information.cholesky()?.solve(&gradient);
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        let moved_m = place.translation.vector + step.fixed_rows::<3>(0);
        place = Rigid::from_parts(moved_m.into(), turn * place.rotation);
        if step.norm() < SHORT {
            break;
        }
    }
    let says: Vec<Say> = pairs.iter().map(|pair| say(pair, &place)).collect::<Option<_>>()?;
    let mut information = Matrix6::zeros();
    for say in &says {
        information += say.jacobian.transpose() * say.weight * say.jacobian;
    }
    let inverse = information.cholesky()?.inverse();
    let (mut seen, mut placed) = (Covariance6::zeros(), Covariance6::zeros());
    for say in &says {
        let gain = inverse * say.jacobian.transpose() * say.weight;
        seen += gain * say.seen * gain.transpose();
        placed += gain * say.placed * gain.transpose();
    }
    let cost = says.iter().map(|say| say.cost).sum::<f64>();
    let turn = (seen + placed).fixed_view::<3, 3>(3, 3).trace();
    let is_sound = cost.is_finite() && turn < MOST_TURN_RAD * MOST_TURN_RAD;
    is_sound.then_some(Solution { world_from_camera: place, seen, placed, cost })
}

/// By the normal that suits the place better.
fn say(pair: &Pair, place: &Rigid) -> Option<Say> {
    let (pose, landmark) = (&pair.pose, &pair.landmark);
    let arm_m = place.rotation * pose.position_m;
    let error_m = landmark.position_m - arm_m - place.translation.vector;
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm_m.cross_matrix());
    let turned = rotate_covariance(&place.rotation, &pose.covariance);
    let variance = landmark.position_deviation_m * landmark.position_deviation_m;
    let angle_variance = landmark.orientation_deviation_rad * landmark.orientation_deviation_rad;
    let mut placed = Covariance6::from_diagonal_element(variance);
    placed.fixed_view_mut::<3, 3>(3, 3).copy_from(&Matrix3::from_diagonal_element(angle_variance));
    let Some(stands) = landmark.orientation else {
        return position_say(&turned, &placed, &error_m, jacobian);
    };
    let has_yaw = pose.yaw_rad.is_some() && pose.yaw_symmetry == 1;
    let candidates = orientations(pose).map(|turn| place.rotation * turn);
    let likelihood = pose.normal_likelihood.clamp(1e-3, 1.0 - 1e-3);
    let mut best: Option<Say> = None;
    for (candidate, likelihood) in candidates.into_iter().zip([likelihood, 1.0 - likelihood]) {
        let normal = candidate * Vector3::z();
        let turn = between(&(candidates[0] * Vector3::z()), &normal).to_rotation_matrix();
        let mut whole = Matrix6::identity();
        whole.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
        let mut angle = (stands * candidate.inverse()).scaled_axis();
        let mut unknown = Matrix3::zeros();
        if !has_yaw {
            let about = normal * normal.transpose();
            let across = (Matrix3::identity() - about) * turn.matrix();
            whole.fixed_view_mut::<3, 3>(3, 3).copy_from(&across);
            unknown = about * UNKNOWN_ANGLE_VARIANCE_RAD2;
            angle = between(&normal, &(stands * Vector3::z())).scaled_axis();
        }
        let mut seen = whole * turned * whole.transpose();
        let mut rotation = seen.fixed_view_mut::<3, 3>(3, 3);
        rotation += unknown;
        let mut error = Vector6::zeros();
        error.fixed_rows_mut::<3>(0).copy_from(&error_m);
        error.fixed_rows_mut::<3>(3).copy_from(&angle);
        let weight = (seen + placed).cholesky()?.inverse();
        let cost = error.dot(&(weight * error)) - 2.0 * likelihood.ln();
        if best.as_ref().is_none_or(|best| cost < best.cost) {
            best = Some(Say { error, jacobian, seen, placed, weight, cost });
        }
    }
    best
}

/// Of a landmark of which nobody has said how it is turned.
fn position_say(
    turned: &Covariance6,
    placed: &Covariance6,
    error_m: &Vector3<f64>,
    jacobian: Matrix6<f64>,
) -> Option<Say> {
    let total: Matrix3<f64> = (turned + placed).fixed_view::<3, 3>(0, 0).into_owned();
    let inverse = total.cholesky()?.inverse();
    let lift: SMatrix<f64, 6, 3> = SMatrix::identity();
    let weight = lift * inverse * lift.transpose();
    let cost = error_m.dot(&(inverse * error_m));
    Some(Say { error: lift * error_m, jacobian, seen: *turned, placed: *placed, weight, cost })
}

/// The smallest rotation from one unit vector to another.
fn between(from: &Vector3<f64>, to: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(from, to).unwrap_or_else(|| {
        let aside = if from.x.abs() < 0.9 { Vector3::x_axis() } else { Vector3::y_axis() };
        let across = nalgebra::Unit::new_normalize(from.cross(&aside));
        UnitQuaternion::from_axis_angle(&across, std::f64::consts::PI)
    })
}
