//! Metrics of an evaluation.

use nalgebra::Vector3;
use roundel_core::{rigid::Rigid, time::Timestamp};
use serde::Serialize;

use super::{
    EvalError, MIN_PAIRS, Sample, Trajectory,
    align::{self, Pair, error_m},
    estimate::{RecordedObject, RecordedTrajectories},
};

/// Steps longer than the median by this factor are gaps.
const GAP_FACTOR: f64 = 3.0;

#[derive(Clone, Debug)]
pub struct EvalSettings {
    /// Whether frames may differ by a rigid transform.
    pub aligns: bool,
    /// How far the truth's clock is ahead, seconds; `None`: estimated within ± `most_offset_s`.
    pub offset_s: Option<f64>,
    pub most_offset_s: f64,
    /// Number of samples between the poses of a relative error.
    pub delta: usize,
    /// The truth's object, by name, id or code, if the truth has no name.
    pub object: Option<String>,
}

impl Default for EvalSettings {
    fn default() -> Self {
        Self { aligns: true, offset_s: None, most_offset_s: 1.0, delta: 60, object: None }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ErrorStatistics {
    pub rms: f64,
    pub mean: f64,
    pub median: f64,
    pub std: f64,
    /// 95th percentile.
    pub p95: f64,
    pub max: f64,
    pub count: usize,
}

impl ErrorStatistics {
    pub fn of(mut errors: Vec<f64>) -> Self {
        if errors.is_empty() {
            return Self::default();
        }
        errors.sort_by(f64::total_cmp);
        let count = errors.len();
        let mean = errors.iter().sum::<f64>() / count as f64;
        let square = errors.iter().map(|error| error * error).sum::<f64>() / count as f64;
        let about = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / count as f64;
        let at = |share: f64| errors[((count - 1) as f64 * share).round() as usize];
        let middle = |of: &[f64]| (of[(count - 1) / 2] + of[count / 2]) / 2.0;
        Self {
            rms: square.sqrt(),
            mean,
            median: middle(&errors),
            std: about.sqrt(),
            p95: at(0.95),
            max: errors[count - 1],
            count,
        }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct ObjectMetrics {
    pub name: String,
    /// In the recording.
    pub object_id: u64,
    /// Absolute error after the alignment, metres.
    pub ate_m: ErrorStatistics,
    /// Absolute angle after the alignment, degrees; `None`: estimate or truth has no orientation.
    pub ate_deg: Option<ErrorStatistics>,
    /// Relative error over `delta` samples, metres.
    pub rpe_m: ErrorStatistics,
    /// Standard deviation of the error's white noise, per axis, metres.
    pub jitter_m: f64,
    /// Number of unusually long steps.
    pub gaps: usize,
    pub longest_gap_s: f64,
    /// Share of the snapshots during the truth in which the object was observed.
    pub seen: f64,
    #[serde(skip)]
    pub pairs: Vec<Pair>,
}

#[derive(Clone, Debug, Serialize)]
pub struct EvalMetrics {
    /// How far the truth's clock is ahead of the recording's, seconds.
    pub offset_s: f64,
    /// Translation of truth_from_recording, metres.
    pub translation_m: [f64; 3],
    /// Rotation of truth_from_recording, x y z w.
    pub rotation_xyzw: [f64; 4],
    /// Absolute error of all objects, metres.
    pub ate_m: ErrorStatistics,
    /// Relative error of all objects, metres.
    pub rpe_m: ErrorStatistics,
    /// Number of samples between the poses of a relative error.
    pub rpe_delta: usize,
    /// From the newest capture to the snapshot, milliseconds.
    pub latency_ms: ErrorStatistics,
    pub objects: Vec<ObjectMetrics>,
    /// Names in the truth that no object of the recording has.
    pub missing: Vec<String>,
    /// truth_from_recording.
    #[serde(skip)]
    pub truth_from_estimate: Rigid,
}

/// Compares a recording with the truth.
pub fn evaluate(
    estimate: &RecordedTrajectories,
    truths: &[Trajectory],
    settings: &EvalSettings,
) -> Result<EvalMetrics, EvalError> {
    let (matched, missing) = matched(estimate, truths, settings)?;
    let trajectories: Vec<(&Trajectory, &Trajectory)> =
        matched.iter().map(|(id, truth)| (&estimate.objects[id].trajectory, *truth)).collect();
    let found = |max_s| align::offset_s(&trajectories, max_s, settings.aligns);
    let offset_s = settings.offset_s.unwrap_or_else(|| found(settings.most_offset_s));
    let paired: Vec<Vec<Pair>> = trajectories
        .iter()
        .map(|(estimate, truth)| align::pairs(estimate, truth, offset_s))
        .collect();
    let found: usize = paired.iter().map(Vec::len).sum();
    if found < MIN_PAIRS {
        return Err(EvalError::Apart { found, hint: hint(&trajectories) });
    }
    let frame = if settings.aligns { align::rigid(paired.iter().flatten()) } else { None };
    let frame = frame.unwrap_or_else(Rigid::identity);
    let mut objects = Vec::new();
    for (&(object_id, truth), pairs) in matched.iter().zip(paired) {
        let exists = |time: &&Timestamp| truth.at(time.plus_seconds(offset_s)).is_some();
        let possible = estimate.times.iter().filter(exists).count();
        let samples = &estimate.objects[&object_id].trajectory.samples;
        let (gaps, longest_gap_s) = gaps(samples);
        objects.push(ObjectMetrics {
            name: truth.name.clone(),
            object_id,
            ate_m: ErrorStatistics::of(distances(&pairs, &frame)),
            ate_deg: angles_deg(&pairs, &frame).map(ErrorStatistics::of),
            rpe_m: ErrorStatistics::of(relative_errors(&pairs, settings.delta)),
            jitter_m: jitter_m(&pairs, &frame),
            gaps,
            longest_gap_s,
            seen: pairs.len() as f64 / possible.max(1) as f64,
            pairs,
        });
    }
    let all = |errors: &dyn Fn(&[Pair]) -> Vec<f64>| {
        ErrorStatistics::of(objects.iter().flat_map(|object| errors(&object.pairs)).collect())
    };
    let turn = frame.rotation;
    Ok(EvalMetrics {
        offset_s,
        translation_m: frame.translation.vector.into(),
        rotation_xyzw: [turn.i, turn.j, turn.k, turn.w],
        ate_m: all(&|pairs| distances(pairs, &frame)),
        rpe_m: all(&|pairs| relative_errors(pairs, settings.delta)),
        rpe_delta: settings.delta,
        latency_ms: ErrorStatistics::of(
            estimate.latencies_s.iter().map(|late_s| late_s * 1e3).collect(),
        ),
        objects,
        missing,
        truth_from_estimate: frame,
    })
}

/// Objects with their truths, and names of truths without an object.
type MatchedTrajectories<'a> = (Vec<(u64, &'a Trajectory)>, Vec<String>);

fn matched<'a>(
    estimate: &RecordedTrajectories,
    truths: &'a [Trajectory],
    settings: &EvalSettings,
) -> Result<MatchedTrajectories<'a>, EvalError> {
    let known = || {
        let each = estimate.objects.iter().map(|(id, seen)| {
            let name = &seen.trajectory.name;
            let code = seen.code.map_or(String::new(), |code| format!(", code {code}"));
            if name.is_empty() { format!("{id}{code}") } else { format!("{id} ({name}{code})") }
        });
        each.collect::<Vec<_>>().join(", ")
    };
    let named = |name: &str| {
        // The longest trajectory, if there are several with this name.
        let by = |is_it: &dyn Fn(u64, &RecordedObject) -> bool| {
            let all = estimate.objects.iter().filter(|(id, seen)| is_it(**id, seen));
            all.max_by_key(|(_, seen)| seen.trajectory.samples.len()).map(|(id, _)| *id)
        };
        by(&|_, seen| !name.is_empty() && seen.trajectory.name == name)
            .or_else(|| by(&|_, seen| seen.code.is_some_and(|code| code.to_string() == name)))
            .or_else(|| by(&|id, _| id.to_string() == name))
    };
    if let [truth] = truths {
        let wanted = settings.object.as_deref().unwrap_or(&truth.name);
        let only = estimate.objects.keys().next().filter(|_| estimate.objects.len() == 1).copied();
        let id = named(wanted).or_else(|| only.filter(|_| settings.object.is_none()));
        let id = id.ok_or_else(|| {
            EvalError::Object(format!(
                "the truth's object in the recording is ambiguous: select one with --object; the recording has {}",
                known()
            ))
        })?;
        return Ok((vec![(id, truth)], Vec::new()));
    }
    let (mut matched, mut missing) = (Vec::new(), Vec::new());
    for truth in truths {
        match named(&truth.name) {
            Some(id) if matched.iter().all(|(other, _)| *other != id) => matched.push((id, truth)),
            _ => missing.push(truth.name.clone()),
        }
    }
    if matched.is_empty() {
        return Err(EvalError::Object(format!(
            "no name in the truth ({}) is a name, code or id of an object in the recording, which has {}",
            missing.join(", "),
            known()
        )));
    }
    Ok((matched, missing))
}

fn hint(trajectories: &[(&Trajectory, &Trajectory)]) -> String {
    let span = |trajectory: &Trajectory| {
        let times = [trajectory.samples.first(), trajectory.samples.last()];
        times.map(|sample| sample.map_or(0, |sample| sample.time.as_ns()))
    };
    let Some((estimate, truth)) = trajectories.first() else { return String::new() };
    let ([begin, end], [from, to]) = (span(estimate), span(truth));
    format!(
        "the first object was seen from {begin} to {end} ns, and the truth covers {from} to {to} ns: if their clocks differ by \
         more than --max-offset, set the difference with --offset"
    )
}

/// Number of gaps, and the longest, seconds.
fn gaps(samples: &[Sample]) -> (usize, f64) {
    let steps: Vec<f64> =
        samples.windows(2).map(|pair| pair[1].time.seconds_since(pair[0].time)).collect();
    let usual_s = ErrorStatistics::of(steps.clone()).median;
    let gaps = steps.into_iter().filter(|step| *step > GAP_FACTOR * usual_s);
    gaps.fold((0, 0.0), |(count, longest), gap| (count + 1, f64::max(longest, gap)))
}

/// `None` if a pose has no orientation.
fn angles_deg(pairs: &[Pair], frame: &Rigid) -> Option<Vec<f64>> {
    let angle = |pair: &Pair| {
        let turned = frame.rotation * pair.estimate.orientation?;
        Some(turned.angle_to(&pair.truth.orientation?).to_degrees())
    };
    pairs.iter().map(angle).collect::<Option<Vec<f64>>>().filter(|angles| !angles.is_empty())
}

fn distances(pairs: &[Pair], frame: &Rigid) -> Vec<f64> {
    pairs.iter().map(|pair| error_m(pair, frame).norm()).collect()
}

/// Relative errors of consecutive poses `delta` samples apart: of the relative translation if both have orientations,
/// otherwise of the distance.
fn relative_errors(pairs: &[Pair], delta: usize) -> Vec<f64> {
    let steps: Vec<&Pair> = pairs.iter().step_by(delta.max(1)).collect();
    let error = |ends: &[&Pair]| {
        let [first, second] = [ends[0], ends[1]];
        let pose = |sample: &Sample| {
            Some(Rigid::from_parts(sample.position_m.into(), sample.orientation?))
        };
        let relative = |first, second| Some(pose(first)?.inverse() * pose(second)?);
        let turned =
            relative(&first.truth, &second.truth).zip(relative(&first.estimate, &second.estimate));
        match turned {
            Some((truth, estimate)) => (truth.inverse() * estimate).translation.vector.norm(),
            None => {
                let far =
                    |first: &Sample, second: &Sample| (second.position_m - first.position_m).norm();
                let truth = far(&first.truth, &second.truth);
                (truth - far(&first.estimate, &second.estimate)).abs()
            }
        }
    };
    steps.windows(2).map(error).collect()
}

/// Second differences of white noise σ have the variance 6 σ²; slow changes of the error contribute little.
fn jitter_m(pairs: &[Pair], frame: &Rigid) -> f64 {
    let errors: Vec<Vector3<f64>> = pairs.iter().map(|pair| error_m(pair, frame)).collect();
    let second = errors.windows(3).map(|it| (it[0] - it[1] * 2.0 + it[2]).norm_squared() / 3.0);
    let count = errors.len().saturating_sub(2).max(1);
    (second.sum::<f64>() / count as f64 / 6.0).sqrt()
}
