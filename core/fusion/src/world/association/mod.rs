//! Assignment of one frame's sightings to tracks.
//!
//! A pair is possible if the kinds are equal (or both belong to one body) and the innovation lies inside the gate:
//! squared Mahalanobis length of the position with its whole covariance, so the gate is much longer along the line of
//! sight than across it. Its cost is -2 ln likelihood up to a constant, d² + ln det S - ln det R, less a bonus if the
//! camera's own tracker continues the track, and a larger one if the code agrees. Another code adds to the cost, once
//! more for each in a row. A track that is not observed at present is not matched against another code at all: it may
//! be anywhere, and a robot that comes into view there would take over its id. Independent groups of pairs are solved
//! one by one, each optimally; leaving a sighting out costs [`UNASSIGNED_COST`].

mod assignment;
mod gate;

use assignment::{FORBIDDEN, assign};
use gate::{GateProbe, TrackBatches};

use super::{FusionParams, clock::Clocks, identity::Subject, lifecycle::Track};
use crate::track::{ErrorSource, Innovation, Measurement, Noise};
use roundel_vision::marker::Code;

/// Cost of leaving a sighting without a track: above that of a true pair at the gate whose velocity is not known
/// yet.
const UNASSIGNED_COST: f64 = 60.0;
/// Bonus if the camera's own tracker continues: likelihood e⁶.
const CONTINUITY_BONUS: f64 = 12.0;
/// Factor on the gate in that case, since a momentary error is then the better explanation; the filter gives such
/// innovations less weight.
const CONTINUITY_GATE: f64 = 3.0;
/// Bonus if the track's code was read: likelihood e¹⁰, and the wider gate. The same as a cost for each
/// consecutive reading of another code.
const CODE_BONUS: f64 = 20.0;
/// Cost of a tentative track, so that it takes nothing from a confirmed one.
const TENTATIVE_COST: f64 = 6.0;

/// A detection in the world frame, or all those of one body, with subject and code.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    pub(super) subject: Subject,
    pub(super) code: Option<Code>,
    pub(super) measurement: Measurement,
}

/// Index of the track that a sighting belongs to, with its innovation; `None` if it fits no track.
pub(super) type Decision = Option<(usize, Innovation)>;

#[derive(Clone, Copy, Debug)]
struct Pair {
    sighting: usize,
    track: usize,
    /// -2 ln likelihood up to a constant.
    cost: f64,
    innovation: Innovation,
}

/// Buffers reused between frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    batches: TrackBatches,
    candidates: Vec<usize>,
    pairs: Vec<Pair>,
    group_of_sighting: Vec<usize>,
    group_of_track: Vec<usize>,
}

/// Decides for every sighting of one frame; each track gets at most one.
pub(super) fn associate(
    tracks: &[Track],
    sightings: &[Sighting],
    params: &FusionParams,
    clocks: &Clocks,
    scratch: &mut Scratch,
) -> Vec<Decision> {
    let mut decisions = vec![None; sightings.len()];
    let Some(first) = sightings.first() else { return decisions };
    let time = first.measurement.time;
    let offset_s = |sighting: &Sighting| sighting.measurement.time.seconds_since(time);
    let span_s = sightings.iter().map(|sighting| offset_s(sighting).abs()).fold(0.0, f64::max);
    let timing_s =
        if clocks.is_estimating() { clocks.max_deviation_s(first.measurement.camera) } else { 0.0 };
    scratch.batches.fill(tracks, time, span_s, timing_s);
    scratch.pairs.clear();
    for (index, sighting) in sightings.iter().enumerate() {
        let measurement = &sighting.measurement;
        let place_m = measurement.position_m.into();
        let probe = GateProbe::new(place_m, &measurement.position_noise, offset_s(sighting));
        let gate = params.gate_distance_squared;
        scratch.batches.candidates(&probe, gate * CONTINUITY_GATE, &mut scratch.candidates);
        let noise_det = probe.determinant.max(f64::MIN_POSITIVE);
        for &number in &scratch.candidates {
            let found = pair_cost(sighting, &tracks[number], params, clocks, noise_det);
            let Some((cost, innovation)) = found else { continue };
            scratch.pairs.push(Pair { sighting: index, track: number, cost, innovation });
        }
    }
    label_groups(sightings.len(), tracks.len(), scratch);
    solve(&mut decisions, scratch);
    decisions
}

/// Cost of assigning a sighting to a track, if that is possible.
fn pair_cost(
    sighting: &Sighting,
    track: &Track,
    params: &FusionParams,
    clocks: &Clocks,
    noise_det: f64,
) -> Option<(f64, Innovation)> {
    if track.subject != sighting.subject {
        return None;
    }
    let measurement = &sighting.measurement;
    // Each body exists once.
    let is_body = sighting.subject.body.map(|_| true);
    let code_agrees = is_body.or(sighting.code.and_then(|read| track.codes.agrees(read)));
    let unobserved_ns = measurement.time.ns_since(track.newest);
    if code_agrees == Some(false) && unobserved_ns > params.predicted_after_ns {
        return None;
    }
    let newest = track.history.newest();
    let dt = measurement.time.seconds_since(newest.time);
    let agile = newest.motion.agile();
    let residual_m = measurement.position_m - agile.position_m - agile.kalman.rate * dt;
    let noise =
        Noise { timing_s: track.timing_s(measurement, clocks), ..measurement.position_noise };
    let innovation = agile.kalman.innovation_after(
        dt,
        &track.model,
        &residual_m,
        ErrorSource { noise: &noise, camera: measurement.camera },
    )?;
    let is_continued = track.is_continued_by(measurement);
    let is_expected = code_agrees.unwrap_or(is_continued);
    let gate = params.gate_distance_squared;
    let limit = if is_expected { gate * CONTINUITY_GATE } else { gate };
    if innovation.distance_squared > limit {
        return None;
    }
    let code_cost = match code_agrees {
        None => 0.0,
        Some(true) => -CODE_BONUS,
        Some(false) => CODE_BONUS * f64::from(1 + track.codes.contradictions()),
    };
    let rest = innovation.distance_squared - if is_continued { CONTINUITY_BONUS } else { 0.0 }
        + code_cost
        + if track.is_tentative() { TENTATIVE_COST } else { 0.0 };
    let cost = rest + (innovation.determinant / noise_det).ln();
    Some((cost, innovation))
}

/// Labels the groups of sightings and tracks that share pairs by their lowest sighting.
fn label_groups(sightings: usize, tracks: usize, scratch: &mut Scratch) {
    scratch.group_of_sighting.clear();
    scratch.group_of_sighting.extend(0..sightings);
    scratch.group_of_track.clear();
    scratch.group_of_track.resize(tracks, usize::MAX);
    // A group's lowest label moves forward over any number of pairs in one round, so few rounds are needed.
    let mut changed = true;
    while changed {
        changed = false;
        for pair in &scratch.pairs {
            let of_sighting = scratch.group_of_sighting[pair.sighting];
            let of_track = scratch.group_of_track[pair.track];
            let lowest = of_sighting.min(of_track);
            changed |= of_sighting != lowest || (of_track != lowest && of_track != usize::MAX);
            scratch.group_of_sighting[pair.sighting] = lowest;
            scratch.group_of_track[pair.track] = lowest;
        }
    }
}

fn solve(decisions: &mut [Decision], scratch: &mut Scratch) {
    let groups = &scratch.group_of_sighting;
    // Stable: within a group, pairs stay ordered by sighting, then track.
    scratch.pairs.sort_by_key(|pair| groups[pair.sighting]);
    for pairs in scratch.pairs.chunk_by(|a, b| groups[a.sighting] == groups[b.sighting]) {
        if let [only] = pairs {
            if only.cost < UNASSIGNED_COST {
                decisions[only.sighting] = Some((only.track, only.innovation));
            }
            continue;
        }
        let mut rows: Vec<usize> = pairs.iter().map(|pair| pair.sighting).collect();
        rows.dedup();
        let mut columns: Vec<usize> = pairs.iter().map(|pair| pair.track).collect();
        columns.sort_unstable();
        columns.dedup();
        // After the tracks, each sighting has a column of its own for staying unassigned.
        let width = columns.len() + rows.len();
        let mut costs = vec![FORBIDDEN; rows.len() * width];
        for row in 0..rows.len() {
            costs[row * width + columns.len() + row] = UNASSIGNED_COST;
        }
        let place = |list: &[usize], value: usize| list.binary_search(&value).unwrap_or(0);
        for pair in pairs {
            let (row, column) = (place(&rows, pair.sighting), place(&columns, pair.track));
            costs[row * width + column] = pair.cost;
        }
        for (row, column) in assign(&costs, rows.len(), width).into_iter().enumerate() {
            let Some(&track) = columns.get(column) else { continue };
            let chosen =
                pairs.iter().find(|pair| pair.sighting == rows[row] && pair.track == track);
            decisions[rows[row]] = chosen.map(|pair| (track, pair.innovation));
        }
    }
}
