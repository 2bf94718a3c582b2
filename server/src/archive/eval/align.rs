//! Alignment of recording and truth: one time offset and one rigid transform for all trajectories.
//!
//! The transform is Umeyama's (1991, without scale): with centred positions of estimate x and truth y, the singular
//! value decomposition of Σ y xᵀ = U D Vᵀ gives R = U diag(1, 1, det U det V) Vᵀ and t = ȳ - R x̄. The offset minimizes
//! the error after this transform: a search in steps of [`STEP_S`], refined by golden sections. Trajectories without
//! motion do not determine it.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use roundel_core::rigid::Rigid;

use super::{Sample, Trajectory};

/// Step of the offset search.
const STEP_S: f64 = 0.02;
/// Golden sections; each keeps 0.62 of the interval.
const SECTIONS: usize = 40;
/// Maximum number of samples per trajectory in the offset search.
const MAX_INSTANTS: usize = 400;

/// Estimate and truth at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    pub estimate: Sample,
    pub truth: Sample,
}

/// Pairs of an estimate's samples with the truth. The truth's clock is `offset_s` ahead.
pub fn pairs(estimate: &Trajectory, truth: &Trajectory, offset_s: f64) -> Vec<Pair> {
    let pair = |sample: &Sample| {
        let truth = truth.at(sample.time.plus_seconds(offset_s))?;
        Some(Pair { estimate: *sample, truth })
    };
    estimate.samples.iter().filter_map(pair).collect()
}

/// The least-squares truth_from_estimate; `None` for fewer than three pairs.
pub fn rigid<'a>(pairs: impl Iterator<Item = &'a Pair> + Clone) -> Option<Rigid> {
    let count = pairs.clone().count();
    if count < 3 {
        return None;
    }
    let mean =
        |of: fn(&Pair) -> Vector3<f64>| pairs.clone().map(of).sum::<Vector3<f64>>() / count as f64;
    let (from, to) = (mean(|it| it.estimate.position_m), mean(|it| it.truth.position_m));
    let mut spread = Matrix3::zeros();
    for pair in pairs {
        let (x, y) = (pair.estimate.position_m - from, pair.truth.position_m - to);
        spread += y * x.transpose();
    }
    // The decomposition of a matrix that is not finite does not end.
    if !spread.iter().all(|number| number.is_finite()) {
        return None;
    }
    let svd = spread.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sign = Matrix3::identity();
    if u.determinant() * v_t.determinant() < 0.0 {
        // nalgebra sorts the smallest singular value last.
        sign[(2, 2)] = -1.0;
    }
    let turn = Rotation3::from_matrix_unchecked(u * sign * v_t);
    let turn = UnitQuaternion::from_rotation_matrix(&turn);
    Some(Rigid::from_parts((to - turn * from).into(), turn))
}

/// Error of a pair after a transform.
pub fn error_m(pair: &Pair, truth_from_estimate: &Rigid) -> Vector3<f64> {
    let moved = truth_from_estimate * nalgebra::Point3::from(pair.estimate.position_m);
    moved.coords - pair.truth.position_m
}

/// Rms distance after a transform.
pub fn rms_m<'a>(pairs: impl Iterator<Item = &'a Pair>, truth_from_estimate: &Rigid) -> f64 {
    let squares: Vec<f64> =
        pairs.map(|pair| error_m(pair, truth_from_estimate).norm_squared()).collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}

/// Estimates the lead of the truth's clock over the recording's, within ± `max_s`; 0 without motion. With `aligns`, frames may
/// differ as well.
pub fn offset_s(matched: &[(&Trajectory, &Trajectory)], max_s: f64, aligns: bool) -> f64 {
    let thin = |trajectory: &Trajectory| {
        let every = trajectory.samples.len().div_ceil(MAX_INSTANTS).max(1);
        let samples = trajectory.samples.iter().step_by(every).copied().collect();
        Trajectory { name: String::new(), samples }
    };
    let thinned: Vec<(Trajectory, &Trajectory)> =
        matched.iter().map(|(estimate, truth)| (thin(estimate), *truth)).collect();
    let whole: usize = thinned.iter().map(|(estimate, _)| estimate.samples.len()).sum();
    let error_m = |offset_s: f64| {
        let all = thinned.iter().flat_map(|(estimate, truth)| pairs(estimate, truth, offset_s));
        let all: Vec<Pair> = all.collect();
        // A short overlap may agree by chance.
        if all.len() * 2 < whole.min(2 * super::MIN_PAIRS) || all.len() < super::MIN_PAIRS {
            return f64::INFINITY;
        }
        let frame = if aligns { rigid(all.iter()) } else { Some(Rigid::identity()) };
        frame.map_or(f64::INFINITY, |frame| rms_m(all.iter(), &frame))
    };
    let steps = (max_s / STEP_S).ceil() as i64;
    let tried = (-steps..=steps).map(|step| step as f64 * STEP_S);
    // The offset nearest to 0 among equally good ones.
    let better =
        |a: &(f64, f64), b: &(f64, f64)| a.1.total_cmp(&b.1).then(a.0.abs().total_cmp(&b.0.abs()));
    let best = tried.map(|offset| (offset, error_m(offset))).min_by(better).unwrap_or_default();
    if !best.1.is_finite() {
        return 0.0;
    }
    let ratio = (5f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (best.0 - STEP_S, best.0 + STEP_S);
    for _ in 0..SECTIONS {
        let (left, right) = (high - ratio * (high - low), low + ratio * (high - low));
        if error_m(left) <= error_m(right) { high = right } else { low = left }
    }
    let refined = (low + high) / 2.0;
    // Without motion, any offset is equally good.
    if error_m(refined) < error_m(0.0) { refined } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use roundel_core::time::Timestamp;

    use super::*;

    fn course(offset_s: f64, frame: &Rigid) -> Trajectory {
        let sample = |step: usize| {
            let time_s = step as f64 / 60.0;
            let at_s = time_s + offset_s;
            let place =
                Vector3::new((0.7 * at_s).cos(), (1.1 * at_s).sin(), 0.2 * (0.4 * at_s).sin());
            Sample {
                time: Timestamp::from_ns(1_700_000_000_000_000_000).plus_seconds(time_s),
                position_m: (frame * nalgebra::Point3::from(place)).coords,
                orientation: None,
            }
        };
        Trajectory { name: String::new(), samples: (0..1200).map(sample).collect() }
    }

    #[test]
    fn offset_and_frame_are_found() {
        let turn = UnitQuaternion::from_euler_angles(0.3, -0.2, 2.0);
        let frame = Rigid::from_parts(Vector3::new(3.0, -1.0, 0.5).into(), turn);
        // The truth's clock is 83.7 ms ahead, so at an equal reading it shows an earlier pose.
        let (estimate, truth) = (course(0.0, &Rigid::identity()), course(-0.0837, &frame));
        let found_s = offset_s(&[(&estimate, &truth)], 1.0, true);
        assert!((found_s - 0.0837).abs() < 1e-4, "{found_s}");
        let pairs = pairs(&estimate, &truth, found_s);
        let found = rigid(pairs.iter()).unwrap();
        assert!((found.translation.vector - frame.translation.vector).norm() < 1e-3);
        assert!(found.rotation.angle_to(&turn) < 1e-3);
        assert!(rms_m(pairs.iter(), &found) < 1e-3);
    }

    #[test]
    fn positions_that_overflow_have_no_transform() {
        let at = |x: f64| Sample {
            time: Timestamp::default(),
            position_m: Vector3::new(x, 0.0, 0.0),
            orientation: None,
        };
        for far in [1e200, 1.7e308, f64::INFINITY, f64::NAN] {
            let pairs = [far, -far, far].map(|x| Pair { estimate: at(x), truth: at(x) });
            assert_eq!(rigid(pairs.iter()), None, "{far}");
        }
    }

    #[test]
    fn without_motion_the_offset_is_zero() {
        let mut still = course(0.0, &Rigid::identity());
        let place = still.samples[0].position_m;
        still.samples.iter_mut().for_each(|sample| sample.position_m = place);
        assert_eq!(offset_s(&[(&still, &still)], 1.0, false), 0.0);
    }
}
