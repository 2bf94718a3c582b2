//! One measurement of an object out of all of its roundels that a frame shows.
//!
//! Roundel i, mounted on the object at (Rᵢ, tᵢ), is seen at pᵢ and turned by qᵢ (of a plain roundel only
//! the normal counts, of an elliptical disc the nearer of both headings). The object's pose (R, p) is the
//! one that makes
//!
//! Σ |pᵢ - p - R tᵢ|² + |log qᵢ (R Rᵢ)⁻¹|² - 2 ln Lᵢ
//!
//! least, each length by its inverse covariance: Gauss and Newton with J = [I -[R tᵢ]×; 0 I]. Each roundel
//! has two normals qᵢ of likelihood Lᵢ, and all choices of normals are tried, or of many roundels one
//! after the other turned to the other one. Best and second best become the two candidates of
//! [`AttitudeMeasurement`].
//!
//! What one frame says of the place depends on how the object is turned, by the levers tᵢ. Where the
//! object is followed already, the place is that which agrees with its predicted orientation as well; the
//! part of the place's error that stems from the prediction is as long-lived as that, so it is systematic.
//! An angle that neither frame nor prediction knows (about the normal of a plain roundel) leaves a circle:
//! its centre is told, with half of its radius squared as variance.
//!
//! Roundels that contradict the others by far (a misread code) are left out one by one. Less than
//! that widens the covariance: mounts are measured by hand, and an error of them is no part of it.
//!
//! `core/tests/fusion/body.rs` holds position and orientation to be as good as they say.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};

use super::{
    body::SeenPart,
    life::{Track, View},
};
use crate::{
    rigid::{Rigid, mahalanobis_squared},
    track::{AttitudeMeasurement, Measurement, Noise, positive_root, smallest_turn},
};

/// Up to so many roundels all choices of normals are tried.
const MOST_CHOICES: usize = 4;
/// Steps of Gauss and Newton at most, and the step below which there is no more to gain.
const STEPS: usize = 6;
const LEAST_STEP: f64 = 1e-7;
/// Information about a rotation of which nothing is known, rad⁻²: next to none.
const LOOSE: f64 = 1e-3;
/// An angle with a variance above this is not known, rad².
const UNKNOWN_RAD2: f64 = 1.0;
/// Squared residuals above so many times their number contradict each other: five deviations each.
const CONTRADICTION: f64 = 25.0;
/// The second choice is no candidate below this probability.
const LEAST_RIVAL: f64 = 1e-4;
/// As for single roundels.
const FLOOR_VARIANCE: f64 = 1e-10;

/// What is expected of the object at the frame's time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected {
    position_m: Vector3<f64>,
    velocity_m_s: Vector3<f64>,
    place: Matrix3<f64>,
    orientation: UnitQuaternion<f64>,
    angular_velocity_rad_s: Vector3<f64>,
    rotation: Matrix3<f64>,
    knows_yaw: bool,
    /// That see it now, the frame's own included.
    cameras: f64,
}

impl Expected {
    /// By its track, predicted to the frame.
    pub(super) fn of(track: &Track, seen: &Measurement, fresh_ns: i64) -> Self {
        let mut estimate = *track.history.newest();
        estimate.predict(seen.time, &track.model);
        let is_other = |view: &&View| {
            view.camera != seen.camera && seen.time.ns_since(view.time).saturating_abs() < fresh_ns
        };
        let others = track.views.iter().filter(is_other).count();
        let filter = estimate.motion.agile();
        let attitude = estimate.attitude.estimate(0.0, &track.model);
        Self {
            position_m: filter.position_m,
            velocity_m_s: filter.kernel.rate,
            place: filter.kernel.told().value,
            orientation: attitude.orientation,
            angular_velocity_rad_s: attitude.angular_velocity_rad_s,
            rotation: attitude.covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            knows_yaw: attitude.yaw_symmetry.is_some(),
            cameras: 1.0 + others as f64,
        }
    }

    fn is_turned_known(&self) -> bool {
        self.knows_yaw && self.rotation.trace() < UNKNOWN_RAD2
    }

    fn information(&self) -> Matrix3<f64> {
        self.rotation.try_inverse().unwrap_or_else(Matrix3::zeros)
    }
}

/// One of a roundel's two normals.
#[derive(Clone, Copy, Debug)]
struct Normal {
    orientation: UnitQuaternion<f64>,
    information: Matrix3<f64>,
    /// -2 ln of its likelihood.
    cost: f64,
}

/// A roundel of the object, at the frame's time.
#[derive(Clone, Copy, Debug)]
struct Piece {
    mount: Rigid,
    position_m: Vector3<f64>,
    information: Matrix3<f64>,
    normals: [Normal; 2],
    yaw_symmetry: Option<u32>,
}

impl Piece {
    fn of(seen: &SeenPart, dt: f64, expected: Option<&Expected>) -> Option<Self> {
        let SeenPart { body_from_roundel: mount, measurement, .. } = *seen;
        let attitude = &measurement.attitude;
        let first = attitude.likelihood.clamp(1e-3, 1.0 - 1e-3);
        let normal = |index: usize| {
            let orientation = attitude.candidates[index];
            let mut information = attitude.noises[index].total.try_inverse()?;
            if attitude.yaw_symmetry.is_none() {
                let normal = orientation * Vector3::z();
                let across = Matrix3::identity() - normal * normal.transpose();
                information = across * information * across;
            }
            let likelihood = if index == 0 { first } else { 1.0 - first };
            Some(Normal { orientation, information, cost: -2.0 * likelihood.ln() })
        };
        let moved_m = expected.map_or_else(Vector3::zeros, |expected| {
            let arm_m = expected.orientation * mount.translation.vector;
            (expected.velocity_m_s + expected.angular_velocity_rad_s.cross(&arm_m)) * dt
        });
        Some(Self {
            mount,
            position_m: measurement.position_m + moved_m,
            information: measurement.position_noise.total.try_inverse()?,
            normals: [normal(0)?, normal(1)?],
            yaw_symmetry: attitude.yaw_symmetry,
        })
    }

    /// What there is to fit.
    fn numbers(&self) -> f64 {
        if self.yaw_symmetry.is_some() { 6.0 } else { 5.0 }
    }

    /// The rotation from where the object puts it to where it is seen.
    fn turn(&self, normal: &Normal, object: &UnitQuaternion<f64>) -> Vector3<f64> {
        let mounted = object * self.mount.rotation;
        let Some(symmetry) = self.yaw_symmetry else {
            return smallest_turn(&(mounted * Vector3::z()), &(normal.orientation * Vector3::z()));
        };
        let yaw = |step: u32| {
            let angle = 2.0 * PI * f64::from(step) / f64::from(symmetry);
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
        };
        let turns = (0..symmetry)
            .map(|step| (normal.orientation * yaw(step) * mounted.inverse()).scaled_axis());
        turns.min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or_default()
    }
}

/// The pose that fits one choice of normals.
#[derive(Clone, Copy, Debug)]
struct Fit {
    position_m: Vector3<f64>,
    orientation: UnitQuaternion<f64>,
    /// Over (position, rotation).
    information: Matrix6<f64>,
    /// Squared residuals …
    misfit: f64,
    /// … and -2 ln of the likelihood of its normals.
    cost: f64,
}

/// One measurement of parts of one body, not empty and of one frame, with `share` of the errors
/// systematic, and how many of them were left out; `None` if nothing fits.
pub(super) fn assemble(
    parts: &[SeenPart],
    expected: Option<&Expected>,
    share: f64,
) -> Option<(Measurement, usize)> {
    let first = &parts[0].measurement;
    let since_s = |seen: &SeenPart| seen.measurement.time.seconds_since(first.time);
    let mean_s = parts.iter().map(since_s).sum::<f64>() / parts.len() as f64;
    let mut pieces = Vec::with_capacity(parts.len());
    for seen in parts {
        pieces.push(Piece::of(seen, mean_s - since_s(seen), expected)?);
    }
    let (mut best, mut second) = fits(&pieces, expected)?;
    while pieces.len() > 1 && best.misfit > CONTRADICTION * freedom(&pieces) {
        (pieces, best, second) = without_worst(&pieces, expected)?;
    }
    let attitude = attitude(&pieces, (&best, second.as_ref()), expected, share)?;
    let (position_m, position_noise) = place(&pieces, (best, second), expected, share)?;
    let measurement = Measurement {
        time: first.time.plus_seconds(mean_s),
        position_m,
        position_noise,
        attitude,
        ..*first
    };
    Some((measurement, parts.len() - pieces.len()))
}

/// Numbers that are measured beyond those that are asked for.
fn freedom(pieces: &[Piece]) -> f64 {
    (pieces.iter().map(Piece::numbers).sum::<f64>() - 6.0).max(1.0)
}

/// All roundels but the one whose absence leaves the best fit, nearest to what is expected.
fn without_worst(
    pieces: &[Piece],
    expected: Option<&Expected>,
) -> Option<(Vec<Piece>, Fit, Option<Fit>)> {
    let without = |index: usize| {
        let mut others = pieces.to_vec();
        others.remove(index);
        let (best, second) = fits(&others, expected)?;
        let surprise = expected.map_or(0.0, |expected| {
            let off_m = best.position_m - expected.position_m;
            mahalanobis_squared(&off_m, &(expected.place + Matrix3::from_diagonal_element(1e-4)))
                .unwrap_or(0.0)
        });
        Some((best.cost + surprise, (others, best, second)))
    };
    // The last one first, so that of equals the first one stays.
    let all = (0..pieces.len()).rev().filter_map(without);
    all.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, left)| left)
}

/// The best choice of normals and the second best.
fn fits(pieces: &[Piece], expected: Option<&Expected>) -> Option<(Fit, Option<Fit>)> {
    let count = pieces.len();
    if count > MOST_CHOICES {
        return greedy(pieces, expected).map(|fit| (fit, None));
    }
    let mut all: Vec<Fit> = (0..1u64 << count).filter_map(|c| fit(pieces, c, expected)).collect();
    all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    Some((*all.first()?, all.get(1).copied()))
}

/// The likelier normals, each turned to the other one as long as that fits better.
fn greedy(pieces: &[Piece], expected: Option<&Expected>) -> Option<Fit> {
    let count = pieces.len().min(u64::BITS as usize);
    let mut choice = 0;
    let mut best = fit(pieces, choice, expected)?;
    for _ in 0..count {
        let turned = (0..count).map(|index| choice ^ 1 << index);
        let fits = turned.filter_map(|choice| Some((choice, fit(pieces, choice, expected)?)));
        match fits.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost)) {
            Some((better, fit)) if fit.cost < best.cost => (choice, best) = (better, fit),
            _ => break,
        }
    }
    Some(best)
}

/// The pose for one choice of normals: bit i says which one of piece i.
fn fit(pieces: &[Piece], choice: u64, expected: Option<&Expected>) -> Option<Fit> {
    let chosen = |index: usize| -> &Normal {
        let bit = if index < u64::BITS as usize { choice >> index & 1 } else { 0 };
        &pieces[index].normals[bit as usize]
    };
    let orientation = start(pieces, chosen, expected);
    let position_m = pieces[0].position_m - orientation * pieces[0].mount.translation.vector;
    let mut fit =
        Fit { position_m, orientation, information: Matrix6::zeros(), misfit: 0.0, cost: 0.0 };
    for _ in 0..STEPS {
        let gradient = fit.measure(pieces, chosen);
        let mut damped = fit.information;
        (3..6).for_each(|axis| damped[(axis, axis)] += LOOSE);
        let step = damped.cholesky()?.solve(&gradient);
        fit.position_m += step.fixed_rows::<3>(0);
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        fit.orientation = turn * fit.orientation;
        if step.norm() < LEAST_STEP {
            break;
        }
    }
    fit.measure(pieces, chosen);
    fit.cost.is_finite().then_some(fit)
}

impl Fit {
    /// Sums up what the pieces say here; gives the direction that the residuals pull to.
    fn measure<'a>(
        &mut self,
        pieces: &[Piece],
        chosen: impl Fn(usize) -> &'a Normal,
    ) -> Vector6<f64> {
        let mut gradient = Vector6::zeros();
        self.information = Matrix6::zeros();
        (self.misfit, self.cost) = (0.0, 0.0);
        for (index, piece) in pieces.iter().enumerate() {
            let normal = chosen(index);
            let arm_m = self.orientation * piece.mount.translation.vector;
            let off_m = piece.position_m - self.position_m - arm_m;
            let turn = piece.turn(normal, &self.orientation);
            let lever = -arm_m.cross_matrix();
            let (place, rotation) = (piece.information, normal.information);
            let pull = place * off_m;
            let mut rows = gradient.fixed_rows_mut::<3>(0);
            rows += pull;
            let mut rows = gradient.fixed_rows_mut::<3>(3);
            rows += lever.transpose() * pull + rotation * turn;
            add(&mut self.information, (0, 0), &place);
            add(&mut self.information, (0, 3), &(place * lever));
            add(&mut self.information, (3, 0), &(lever.transpose() * place));
            add(&mut self.information, (3, 3), &(lever.transpose() * place * lever + rotation));
            self.misfit += off_m.dot(&pull) + turn.dot(&(rotation * turn));
            self.cost += normal.cost;
        }
        self.cost += self.misfit;
        gradient
    }
}

fn add(whole: &mut Matrix6<f64>, at: (usize, usize), part: &Matrix3<f64>) {
    let mut block = whole.fixed_view_mut::<3, 3>(at.0, at.1);
    block += part;
}

fn block(whole: &Matrix6<f64>, from: usize) -> Matrix3<f64> {
    whole.fixed_view::<3, 3>(from, from).into_owned()
}

/// An orientation to begin with: that of a roundel with a yaw; else the expected one (or any), turned by
/// least onto the first normal, and about it until the roundels lie in the right direction of each other.
fn start<'a>(
    pieces: &[Piece],
    chosen: impl Fn(usize) -> &'a Normal,
    expected: Option<&Expected>,
) -> UnitQuaternion<f64> {
    let own = |index: usize| chosen(index).orientation * pieces[index].mount.rotation.inverse();
    if let Some(index) = pieces.iter().position(|piece| piece.yaw_symmetry == Some(1)) {
        return own(index);
    }
    let normal = chosen(0).orientation * Vector3::z();
    let orientation = match expected {
        Some(expected) => {
            let mounted = expected.orientation * pieces[0].mount.rotation * Vector3::z();
            let turn = smallest_turn(&mounted, &normal);
            UnitQuaternion::from_scaled_axis(turn) * expected.orientation
        }
        None => own(0),
    };
    let across = |vector: Vector3<f64>| vector - normal * normal.dot(&vector);
    let apart = |index: usize| {
        let mounts = [index, 0].map(|index| pieces[index].mount.translation.vector);
        across(orientation * (mounts[0] - mounts[1]))
    };
    let far = (1..pieces.len())
        .max_by(|a, b| apart(*a).norm_squared().total_cmp(&apart(*b).norm_squared()));
    let Some(far) = far.filter(|far| apart(*far).norm() > 1e-3) else { return orientation };
    let (mounted, seen) = (apart(far), across(pieces[far].position_m - pieces[0].position_m));
    let angle = normal.dot(&mounted.cross(&seen)).atan2(mounted.dot(&seen));
    UnitQuaternion::from_scaled_axis(normal * angle) * orientation
}

/// By how much residuals beyond their deviations widen the variances.
fn excess(pieces: &[Piece], fit: &Fit) -> f64 {
    let freedom = freedom(pieces);
    (fit.misfit / (freedom + 3.0 * (2.0 * freedom).sqrt())).max(1.0)
}

/// Probability of the second choice.
fn rival(best: f64, second: f64) -> f64 {
    1.0 / (1.0 + (0.5 * (second - best)).exp())
}

/// How the frame alone says that the object is turned.
fn attitude(
    pieces: &[Piece],
    (best, second): (&Fit, Option<&Fit>),
    expected: Option<&Expected>,
    share: f64,
) -> Option<AttitudeMeasurement> {
    let known = expected.filter(|expected| expected.is_turned_known());
    // Far less than the track knows itself, and not so little that a rival normal, which begins with
    // this, would blur it.
    let loose =
        known.map_or(Matrix3::from_diagonal_element(LOOSE), |known| known.information() * LOOSE);
    let noise = |fit: &Fit| {
        let mut information = fit.information;
        add(&mut information, (3, 3), &loose);
        let covariance = information.cholesky()?.inverse();
        let excess = excess(pieces, fit);
        let total = symmetric(&block(&covariance, 3)) * excess;
        let systematic =
            symmetric(&block(&(covariance * fit.information * covariance), 3)) * (excess * share);
        Some(Noise {
            total: total + Matrix3::from_diagonal_element(FLOOR_VARIANCE),
            systematic_root: positive_root(&systematic).unwrap_or_else(Matrix3::zeros),
            timing_s: 0.0,
        })
    };
    let of_best = noise(best)?;
    let is_whole = of_best.total.trace() < UNKNOWN_RAD2;
    let second = second.filter(|second| rival(best.cost, second.cost) > LEAST_RIVAL);
    let (other, of_other) = match second {
        Some(second) => (second, noise(second)?),
        None => (best, of_best),
    };
    // One roundel alone, flat on the object, whose opposite looks the same: so does the object.
    let symmetry = match pieces {
        [only] if (only.mount.rotation * Vector3::z()).z.abs() > 1.0 - 1e-6 => only.yaw_symmetry,
        _ => None,
    };
    Some(AttitudeMeasurement {
        candidates: [best.orientation, other.orientation],
        likelihood: 1.0 - second.map_or(0.0, |second| rival(best.cost, second.cost)),
        yaw_symmetry: (is_whole || known.is_some()).then_some(symmetry.unwrap_or(1)),
        noises: [of_best, of_other],
    })
}

/// Where the object is, by the frame and the orientation that is expected.
fn place(
    pieces: &[Piece],
    (best, second): (Fit, Option<Fit>),
    expected: Option<&Expected>,
    share: f64,
) -> Option<(Vector3<f64>, Noise)> {
    let surprise = |fit: &Fit| {
        let Some(expected) = expected else { return 0.0 };
        let off = (expected.orientation * fit.orientation.inverse()).scaled_axis();
        let spread = expected.rotation + Matrix3::from_diagonal_element(1e-4);
        mahalanobis_squared(&off, &spread).unwrap_or(0.0)
    };
    let (mut first, mut other) = (best, second);
    let (mut cost, mut other_cost) =
        (best.cost + surprise(&best), second.map(|fit| fit.cost + surprise(&fit)));
    if let (Some(fit), Some(lower)) = (other, other_cost.filter(|other| *other < cost)) {
        (first, other) = (fit, Some(first));
        (cost, other_cost) = (lower, Some(cost));
    }
    let (position_m, mut total, mut systematic) = placed(pieces, &first, expected, share)?;
    if let (Some(fit), Some(other_cost)) = (other, other_cost) {
        let weight = rival(cost, other_cost);
        if weight > LEAST_RIVAL {
            let apart_m = placed(pieces, &fit, expected, share)?.0 - position_m;
            let between = apart_m * apart_m.transpose() * weight;
            total += between;
            systematic += between;
        }
    }
    let excess = excess(pieces, &first);
    let noise = Noise {
        total: total * excess + Matrix3::from_diagonal_element(FLOOR_VARIANCE),
        systematic_root: positive_root(&(systematic * excess)).unwrap_or_else(Matrix3::zeros),
        timing_s: 0.0,
    };
    positive_root(&noise.total).map(|_| (position_m, noise))
}

/// The same for one choice of normals: place, covariance and the part of it that stays.
fn placed(
    pieces: &[Piece],
    fit: &Fit,
    expected: Option<&Expected>,
    share: f64,
) -> Option<(Vector3<f64>, Matrix3<f64>, Matrix3<f64>)> {
    let mut prior = Matrix6::zeros();
    let mut pull = Vector6::zeros();
    let mut alone = fit.information;
    (3..6).for_each(|axis| alone[(axis, axis)] += LOOSE);
    let knows = alone.cholesky()?.inverse().fixed_view::<3, 3>(3, 3).trace() < UNKNOWN_RAD2;
    if let Some(expected) = expected.filter(|_| !knows) {
        let information = expected.information();
        let off = (expected.orientation * fit.orientation.inverse()).scaled_axis();
        add(&mut prior, (3, 3), &information);
        pull.fixed_rows_mut::<3>(3).copy_from(&(information * off));
    }
    let mut whole = fit.information + prior;
    (3..6).for_each(|axis| whole[(axis, axis)] += LOOSE);
    let mut covariance = whole.cholesky()?.inverse();
    let rotation = symmetric(&block(&covariance, 3));
    let mut around = Matrix3::zeros();
    let mut position_m = fit.position_m;
    if rotation.trace() > UNKNOWN_RAD2 {
        // About this axis it may be turned in any way.
        let eigen = rotation.symmetric_eigen();
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let across = Matrix3::identity() - axis * axis.transpose();
        let level_m = across * (position_m - pieces[0].position_m);
        position_m -= level_m;
        around = across * (0.5 * level_m.norm_squared());
        let firm = axis * axis.transpose() / FLOOR_VARIANCE;
        add(&mut whole, (3, 3), &firm);
        covariance = whole.cholesky()?.inverse();
    }
    position_m += (covariance * pull).fixed_rows::<3>(0);
    let seen = block(&(covariance * fit.information * covariance), 0);
    // All cameras take it from the same prediction, while each one's systematic error is taken for its
    // own: so much larger, their mean errs as it should. And at the origin the error of the orientation
    // adds to it, from which it stems, while both are taken for independent.
    let shared = expected.map_or(1.0, |expected| 2.0 * expected.cameras);
    let foreseen = block(&(covariance * prior * covariance), 0) * shared;
    let total = symmetric(&(block(&covariance, 0) + foreseen * (1.0 - 1.0 / shared))) + around;
    Some((position_m, total, symmetric(&(seen * share + foreseen)) + around))
}

fn symmetric(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}
