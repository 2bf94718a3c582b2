//! The figures of an evaluation.

use nalgebra::Vector3;
use roundel_core::rigid::Rigid;
use serde::Serialize;

use super::{
    EvalError, MIN_PAIRS, Trajectory,
    align::{self, Pair},
    estimate::RecordedTrajectories,
};

/// A pause this many times as long as usual is a gap.
const GAP_FACTOR: f64 = 3.0;

#[derive(Clone, Debug)]
pub struct EvalSettings {
    /// Whether frames may differ by a rigid transform.
    pub aligns: bool,
    /// What the truth's clock is ahead, seconds; `None`: found out, within `most_offset_s`.
    pub offset_s: Option<f64>,
    /// See `offset_s`.
    pub most_offset_s: f64,
    /// Relative errors are of pairs so many samples apart.
    pub delta: usize,
    /// The object that is meant, by name, id or code, where the truth does not say.
    pub object: Option<String>,
}

impl Default for EvalSettings {
    fn default() -> Self {
        Self { aligns: true, offset_s: None, most_offset_s: 1.0, delta: 60, object: None }
    }
}

/// Of errors, all in one unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// Root mean square.
    pub rms: f64,
    pub mean: f64,
    pub median: f64,
    /// Standard deviation about the mean.
    pub std: f64,
    /// Exceeded by one in twenty.
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
    /// The recording's id of it.
    pub object_id: u64,
    /// Distance after the alignment, metres.
    pub ate_m: ErrorStatistics,
    /// Angle after the alignment, degrees; `None`: one of both says none.
    pub ate_deg: Option<ErrorStatistics>,
    /// Error of moves over `delta` samples, metres.
    pub rpe_m: ErrorStatistics,
    /// What changes from one sample to the next: the error's white part, each axis, metres.
    pub jitter_m: f64,
    /// Pauses that are far longer than usual, while the truth goes on.
    pub gaps: usize,
    /// The longest, seconds.
    pub longest_gap_s: f64,
    /// Share of the recording's snapshots, while the truth lasts, in which it was observed.
    pub seen: f64,
    /// Both, instant by instant.
    #[serde(skip)]
    pub pairs: Vec<Pair>,
}

#[derive(Clone, Debug, Serialize)]
pub struct EvalMetrics {
    /// What the truth's clock was taken to be ahead of the recording's, seconds.
    pub offset_s: f64,
    /// truth_from_recording: metres, …
    pub translation_m: [f64; 3],
    /// … and the turn as x y z w.
    pub rotation_xyzw: [f64; 4],
    /// Of all objects together, metres.
    pub ate_m: ErrorStatistics,
    pub rpe_m: ErrorStatistics,
    /// Samples between the ends of a move.
    pub rpe_delta: usize,
    /// From the newest capture to the snapshot with it, milliseconds.
    pub latency_ms: ErrorStatistics,
    pub objects: Vec<ObjectMetrics>,
    /// Names in the truth for which the recording has no object.
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
    let found = |most_s| align::offset_s(&trajectories, most_s, settings.aligns);
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
    let objects: Vec<ObjectMetrics> = matched
        .iter()
        .zip(paired)
        .map(|(&(id, truth), pairs)| {
            object_metrics(id, (truth, offset_s), pairs, &frame, (estimate, settings.delta))
        })
        .collect();
    let all = |errors: fn(&ObjectMetrics, &Rigid, usize) -> Vec<f64>| {
        ErrorStatistics::of(
            objects.iter().flat_map(|it| errors(it, &frame, settings.delta)).collect(),
        )
    };
    let turn = frame.rotation;
    Ok(EvalMetrics {
        offset_s,
        translation_m: frame.translation.vector.into(),
        rotation_xyzw: [turn.i, turn.j, turn.k, turn.w],
        ate_m: all(|object, frame, _| distances(&object.pairs, frame)),
        rpe_m: all(|object, _, delta| relative_errors(&object.pairs, delta)),
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

/// Which object each truth is of, and those truths that are of none.
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
        let by = |of: &dyn Fn(u64, &super::estimate::RecordedObject) -> bool| {
            let mut all = estimate.objects.iter().filter(|(id, seen)| of(**id, seen));
            // Of several of one name, the one that was seen longest.
            let longest = all.by_ref().max_by_key(|(_, seen)| seen.trajectory.samples.len());
            longest.map(|(id, _)| *id)
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
                "which object of the recording the truth is of is not clear; say it with --object: there are {}",
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
            "no name of the truth ({}) is a name, code or id of an object of the recording; there are {}",
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
        "the first object was seen from {begin} to {end} ns, and the truth is of {from} to {to} ns: if their clocks \
         differ by more than --max-offset, say by how much with --offset"
    )
}

fn object_metrics(
    id: u64,
    (truth, offset_s): (&Trajectory, f64),
    pairs: Vec<Pair>,
    frame: &Rigid,
    (estimate, delta): (&RecordedTrajectories, usize),
) -> ObjectMetrics {
    let samples = &estimate.objects[&id].trajectory.samples;
    let steps: Vec<f64> =
        samples.windows(2).map(|pair| pair[1].time.seconds_since(pair[0].time)).collect();
    let usual_s = ErrorStatistics::of(steps.clone()).median;
    let gaps = steps.iter().copied().filter(|step| *step > GAP_FACTOR * usual_s);
    let (count, longest) = gaps.fold((0, 0.0), |(n, most), gap| (n + 1, f64::max(most, gap)));
    let lasts =
        |time: &&roundel_core::time::Timestamp| truth.at(time.plus_seconds(offset_s)).is_some();
    let possible = estimate.times.iter().filter(lasts).count();
    let angles: Option<Vec<f64>> = pairs
        .iter()
        .map(|pair| {
            let turned = frame.rotation * pair.estimate.orientation?;
            Some(turned.angle_to(&pair.truth.orientation?).to_degrees())
        })
        .collect();
    ObjectMetrics {
        name: truth.name.clone(),
        object_id: id,
        ate_m: ErrorStatistics::of(distances(&pairs, frame)),
        ate_deg: angles.filter(|angles| !angles.is_empty()).map(ErrorStatistics::of),
        rpe_m: ErrorStatistics::of(relative_errors(&pairs, delta)),
        jitter_m: jitter_m(&pairs, frame),
        gaps: count,
        longest_gap_s: longest,
        seen: pairs.len() as f64 / possible.max(1) as f64,
        pairs,
    }
}

/// Error vectors after the alignment.
pub fn errors(pairs: &[Pair], frame: &Rigid) -> Vec<Vector3<f64>> {
    let moved = |it: &Pair| frame * nalgebra::Point3::from(it.estimate.position_m);
    pairs.iter().map(|pair| moved(pair).coords - pair.truth.position_m).collect()
}

fn distances(pairs: &[Pair], frame: &Rigid) -> Vec<f64> {
    errors(pairs, frame).iter().map(Vector3::norm).collect()
}

/// Errors of the moves from sample to sample, `delta` apart, one after the other: of the relative pose's translation
/// where both say how they are turned, else of the distance that was moved.
fn relative_errors(pairs: &[Pair], delta: usize) -> Vec<f64> {
    let steps: Vec<&Pair> = pairs.iter().step_by(delta.max(1)).collect();
    let error = |ends: &[&Pair]| {
        let [first, second] = [ends[0], ends[1]];
        let pose = |sample: &super::Sample| {
            Some(Rigid::from_parts(sample.position_m.into(), sample.orientation?))
        };
        let relative = |first, second| Some(pose(first)?.inverse() * pose(second)?);
        let turned =
            relative(&first.truth, &second.truth).zip(relative(&first.estimate, &second.estimate));
        match turned {
            Some((truth, estimate)) => (truth.inverse() * estimate).translation.vector.norm(),
            None => {
                let far = |first: &super::Sample, second: &super::Sample| {
                    (second.position_m - first.position_m).norm()
                };
                let truth = far(&first.truth, &second.truth);
                (truth - far(&first.estimate, &second.estimate)).abs()
            }
        }
    };
    steps.windows(2).map(error).collect()
}

/// Of white noise σ the second difference has the variance 6 σ²; what changes slowly has next to none.
fn jitter_m(pairs: &[Pair], frame: &Rigid) -> f64 {
    let errors = errors(pairs, frame);
    let second = errors.windows(3).map(|it| (it[0] - it[1] * 2.0 + it[2]).norm_squared() / 3.0);
    let count = errors.len().saturating_sub(2).max(1);
    (second.sum::<f64>() / count as f64 / 6.0).sqrt()
}
